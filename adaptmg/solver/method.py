"""Method: what runs the cycles of a multigrid method. A correction may bring its own."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.coarse_solve import CoarseSolve
from adaptmg.multigrid.cycle import Cycle
from adaptmg.multigrid.nested import NestedStart
from adaptmg.smoother.gauss_seidel import Smoother
from adaptmg.solver.run import Outcome

__all__ = ["Method", "MultigridOptions", "need_levels", "own"]


class MultigridOptions(Protocol):
    """What a method is asked for; :class:`adaptmg.Multigrid` says what each means.

    Attributes
    ----------
    start : NestedStart or None
        None where there is no nested start.
    """

    @property
    def cycle(self) -> Cycle: ...

    @property
    def smoother(self) -> Smoother: ...

    @property
    def correction(self) -> Any: ...

    @property
    def coarse(self) -> CoarseSolve: ...

    @property
    def coarse_matrices(self) -> str: ...

    @property
    def stop(self) -> str: ...

    @property
    def rtol(self) -> float | str: ...

    @property
    def max_cycles(self) -> int: ...

    @property
    def start(self) -> NestedStart | None: ...


class Method(Protocol):
    """One run of a multigrid method."""

    def from_given(self, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level from a displacement (n_nodes, dim), between bodies relative, or from zero."""

    def from_nested(self, start: NestedStart) -> Outcome:
        """Solve level by level from the coarsest."""


def own(correction: Any, hook: str) -> Any:
    """A hook of a correction that brings its own method, None where it has none.

    ``method(options, hierarchy, run) -> Method`` makes what runs it, ``check_options(options)`` refuses options that it
    does not take, ``load_steps(options)`` makes what goes from load step to load step.
    """
    found = getattr(correction, hook, None)
    return found if callable(found) else None


def need_levels(hierarchy: Hierarchy) -> None:
    """Refuse a single level."""
    if len(hierarchy) < 2:
        raise ValueError("grids: multigrid needs at least two levels, got one; use SingleGrid or ActiveSet on one grid")
