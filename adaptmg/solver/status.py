"""How a run ended, in words that say what to do."""

from __future__ import annotations

from enum import Enum

__all__ = ["Status"]


class Status(Enum):
    """How a solver ended; the value is advice."""

    CONVERGED = "converged to the tolerance asked for"
    LIMIT = ("the limit on cycles or sweeps was reached before the tolerance: raise it, take a better start "
             "(FullMultigrid), more smoothing, or a looser rtol")
    STALLED = ("the iterates no longer improve, or the certificate contradicts the last one, short of the "
               "tolerance: take am.Monotone() (the frozen choices of the paper's correction are known to stall), or "
               "am.ActiveSet()")
    CYCLING = ("the contact status repeats without converging: reduce the friction or the load step, start from a "
               "nested iteration, or solve with am.Multigrid()")
    DIVERGED = ("the iterates grow without bound: check supports and loads (am.solve checks rigid motions), take "
                "am.Monotone() or omega <= 1")

    @property
    def ok(self) -> bool:
        """True if the tolerance was reached."""
        return self is Status.CONVERGED
