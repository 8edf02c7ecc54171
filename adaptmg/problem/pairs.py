"""ContactPair: two boundaries that may touch each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass

import numpy as np

from adaptmg.problem import checks

__all__ = ["COUPLINGS", "ContactPair"]

COUPLINGS = ("mortar", "nodes")


@dataclass(frozen=True, eq=False)
class ContactPair:
    """Two boundaries, of two bodies or of one, that may touch each other.

    Parameters
    ----------
    slave : str
        The boundary that carries the contact nodes: rather that of the softer body, the finer one, and the one that
        lies inside the other. Multigrid is slow where a stiff slave sits on a master that gives way.
    master : str
        The boundary it may touch.
    coupling : {"mortar", "nodes"}
        Mortar integrals with dual multipliers; or node to node, for surfaces whose nodes match.
    allow_interference : bool
        Accept negative initial gaps (an interference fit).
    reach : float, optional
        Largest initial distance at which the surfaces are looked for, m, > 0; by default it is found from the meshes.
    gap : float or callable, optional
        Initial gap along the slave's normal, m, in place of the computed one: a number, or a function of position
        (n, dim) -> (n,).
    """

    slave: str
    master: str
    _: KW_ONLY
    coupling: str = "mortar"
    allow_interference: bool = False
    reach: float | None = None
    gap: float | Callable[[np.ndarray], np.ndarray] | None = None

    def __post_init__(self) -> None:
        checks.boundary_name("slave", self.slave)
        checks.boundary_name("master", self.master)
        if self.slave == self.master:
            raise ValueError(f"slave and master are both {self.slave!r}: name two different boundaries; where a "
                             "surface may touch itself, cut it into two boundaries")
        checks.choice("coupling", self.coupling, COUPLINGS)
        checks.flag("allow_interference", self.allow_interference)
        if self.reach is not None:
            object.__setattr__(self, "reach", checks.quantity("reach", self.reach, positive=True))
        if self.gap is not None and (not callable(self.gap) or isinstance(self.gap, type)):
            object.__setattr__(self, "gap", checks.quantity("gap", self.gap))
            if self.gap < 0 and not self.allow_interference:
                raise ValueError(f"gap must be >= 0, got {self.gap!r}; for an interference fit set "
                                 "allow_interference=True")

    @property
    def boundary(self) -> str:
        """The boundary with the contact nodes: the slave."""
        return self.slave
