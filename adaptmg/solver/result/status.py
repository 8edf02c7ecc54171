"""How a run ended, in words that say what to do, and the exception that carries the result."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from adaptmg.solver.result.result import Result

__all__ = ["NotConverged", "Status"]


class Status(Enum):
    """How a solver ended; the value is advice."""

    CONVERGED = "converged to the tolerance asked for"
    LIMIT = ("the limit on cycles or sweeps was reached before the tolerance: raise it, take a better start "
             "(FullMultigrid), more smoothing, or a looser rtol")
    STALLED = ("the iterates stopped changing but the contact conditions are not met to the tolerance: take "
               "am.Monotone() (the frozen choices of the paper's correction are known to stall), or am.ActiveSet()")
    CYCLING = ("the contact status repeats without converging: reduce the friction or the load step, start from a "
               "nested iteration, or solve with am.Multigrid()")
    DIVERGED = ("the iterates grow without bound: check supports and loads (am.solve checks rigid motions), take "
                "am.Monotone() or omega <= 1")

    @property
    def ok(self) -> bool:
        """True if the tolerance was reached."""
        return self is Status.CONVERGED


class NotConverged(RuntimeError):
    """Raised by :func:`adaptmg.solve` when the tolerance was not reached.

    Attributes
    ----------
    result : Result
        The last iterate with its true residual.
    """

    def __init__(self, result: Result) -> None:
        self.result = result
        super().__init__(f"{result.solver_name}: {result.status.name} after {result.cycles} cycles, natural residual "
                         f"{result.residual:.2e}, estimated error {result.error_estimate:.2e}: {result.status.value}. "
                         "The last iterate is in the exception's .result; throw=False returns it instead.")

    def __reduce__(self) -> tuple[Any, ...]:
        # exceptions are rebuilt from .args, which is the text here: a process that is handed one back must not fail
        return type(self), (self.result,)
