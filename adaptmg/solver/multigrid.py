"""Multigrid and FullMultigrid: cycles of a correction and a smoother, from a given start or from a nested one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.coarse import CoarseSolve
from adaptmg.multigrid.correction import Correction
from adaptmg.multigrid.cycle import Cycle
from adaptmg.multigrid.monotone import Monotone
from adaptmg.multigrid.nested import NestedStart, project
from adaptmg.problem import checks
from adaptmg.smoother.gauss_seidel import ProjectedGaussSeidel, Smoother
from adaptmg.solver.machine import Machine
from adaptmg.solver.run import Outcome, Run

__all__ = ["FullMultigrid", "Multigrid"]


@dataclass(frozen=True, kw_only=True)
class Multigrid:
    """Multigrid cycles from zero or from a given start.

    Parameters
    ----------
    cycle : Cycle
    smoother : ProjectedGaussSeidel or one's own
        Anything with ``smooth(system, contact, load, unknowns, sweeps) -> passes``.
    correction : Monotone, PaperCorrection or one's own
        A correction that keeps the first coarse solutions (the paper's 'initial' choices) makes them by nested
        iteration first, and starts from zero all the same; the work is counted.
    coarse : CoarseSolve
        How coarsest problems (with ``Cycle(shape="complete")`` all coarse problems) are solved.
    coarse_matrices : {"galerkin", "discretised"}
    stop : {"error", "change"}
        Test the estimated relative A-norm error (with the natural residual below 10 times the tolerance), or, as the
        paper, the change at the end of step g alone: Euclidean, relative to the solution.
    rtol : float
        Tolerance of that test.
    max_cycles : int
    """

    cycle: Cycle = field(default_factory=Cycle)
    smoother: Smoother = field(default_factory=ProjectedGaussSeidel)
    correction: Correction = field(default_factory=Monotone)
    coarse: CoarseSolve = field(default_factory=CoarseSolve)
    coarse_matrices: str = "galerkin"
    stop: str = "error"
    rtol: float = 1e-8
    max_cycles: int = 100

    def __post_init__(self) -> None:
        if not isinstance(self.cycle, Cycle):
            raise TypeError(f"cycle must be a Cycle, got {self.cycle!r}")
        if not callable(getattr(self.smoother, "smooth", None)):
            raise TypeError("smoother must offer smooth(system, contact, load, unknowns, sweeps) -> passes, "
                            f"got {self.smoother!r}")
        if not callable(getattr(self.correction, "transport", None)):
            raise TypeError("correction must be Monotone(), PaperCorrection() or offer transport, "
                            f"got {self.correction!r}")
        if not isinstance(self.coarse, CoarseSolve):
            raise TypeError(f"coarse must be a CoarseSolve, got {self.coarse!r}")
        checks.choice("coarse_matrices", self.coarse_matrices, ("galerkin", "discretised"))
        checks.choice("stop", self.stop, ("error", "change"))
        object.__setattr__(self, "rtol", checks.positive("rtol", self.rtol))
        checks.integer("max_cycles", self.max_cycles, 1)

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level; see :class:`adaptmg.solver.run.Solver`."""
        _need_levels(hierarchy)
        machine = Machine(self, hierarchy, run)
        if self.correction.needs_initial:
            machine.nested_start(NestedStart())
        local = machine.problems[-1]
        unknowns = np.zeros(local.system.n_dofs) if start is None else local.to_local(start)
        project(local, unknowns)
        return machine.finish(unknowns)


@dataclass(frozen=True, kw_only=True)
class FullMultigrid(Multigrid):
    """The full multigrid method: nested start, then cycles on the finest level.

    Parameters
    ----------
    start : NestedStart
        How the levels below are solved first.

    See :class:`Multigrid` for the others.
    """

    start: NestedStart = field(default_factory=NestedStart)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.start, NestedStart):
            raise TypeError(f"start must be a NestedStart, got {self.start!r}")

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level; see :class:`adaptmg.solver.run.Solver`."""
        if start is not None:
            raise ValueError("start: FullMultigrid makes its own start; use Multigrid to continue from a given one")
        _need_levels(hierarchy)
        machine = Machine(self, hierarchy, run)
        return machine.finish(machine.nested_start(self.start))


def _need_levels(hierarchy: Hierarchy) -> None:
    if len(hierarchy) < 2:
        raise ValueError("grids: multigrid needs at least two levels, got one; use SingleGrid or ActiveSet on one grid")
