"""Multigrid and FullMultigrid: cycles of a correction and a smoother, from a given start or from a nested one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.coarse_solve import CoarseSolve
from adaptmg.multigrid.correction import Correction
from adaptmg.multigrid.cycle import Cycle
from adaptmg.multigrid.monotone import Monotone
from adaptmg.multigrid.nested import NestedStart, project
from adaptmg.multigrid.truncated.options import Truncated
from adaptmg.problem import checks
from adaptmg.smoother.gauss_seidel import ProjectedGaussSeidel, Smoother
from adaptmg.solver.machine import Machine
from adaptmg.solver.run import Outcome, Run
from adaptmg.solver.truncated_machine import TruncatedMachine

__all__ = ["FullMultigrid", "Multigrid"]


@dataclass(frozen=True, kw_only=True)
class Multigrid:
    """Multigrid cycles from zero or from a given start.

    Parameters
    ----------
    cycle : Cycle
    smoother : ProjectedGaussSeidel or one's own
        Anything with ``smooth(system, contact, load, unknowns, sweeps) -> passes``.
    correction : Truncated, Monotone, PaperCorrection or one's own
        :class:`~adaptmg.multigrid.Truncated` brings its own cycle, smoother and coarse solve and takes ``cycle``,
        ``smoother``, ``coarse``, ``coarse_matrices`` and ``stop`` at their defaults only. Default: Truncated() if these
        are at their defaults, else Monotone(). Its linear coarse solve and coarse smoother are options of its own.
        A correction that keeps the first coarse solutions (the paper's 'initial' choices) makes them by nested
        iteration first, and starts from zero all the same; the work is counted.
    coarse : CoarseSolve
        How coarsest problems (with ``Cycle(shape="complete")`` all coarse problems) are solved.
    coarse_matrices : {"galerkin", "discretised"}
    stop : {"error", "change"}
        Test the estimated relative A-norm error (with the natural residual below 10 times the tolerance), or, as the
        paper, the change at the end of step g alone: Euclidean, relative to the solution.
    rtol : float or "discretisation"
        Tolerance of that test. "discretisation" (FullMultigrid with Truncated): a tenth of the discretisation error, as
        the nested start shows it.
    max_cycles : int
        With Truncated also for what takes over where it does not converge; ``Result.solver_name`` says what did, see
        :class:`~adaptmg.solver.fallback.Fallback`.
    """

    cycle: Cycle = field(default_factory=Cycle)
    smoother: Smoother = field(default_factory=ProjectedGaussSeidel)
    correction: Correction | Truncated | None = None
    coarse: CoarseSolve = field(default_factory=CoarseSolve)
    coarse_matrices: str = "galerkin"
    stop: str = "error"
    rtol: float = 1e-8
    max_cycles: int = 100

    def __post_init__(self) -> None:
        if self.correction is None:
            object.__setattr__(self, "correction", Monotone() if self._not_for_truncated() else Truncated())
        checks.instance("cycle", self.cycle, Cycle, "a Cycle")
        checks.offers("smoother", self.smoother, "smooth",
                      "a smoother, which offers smooth(system, contact, load, unknowns, sweeps) -> passes")
        if not isinstance(self.correction, Truncated):
            words = "Monotone(), Truncated(), PaperCorrection() or offer transport and needs_initial"
            checks.offers("correction", self.correction, "transport", words)
            checks.flag(f"needs_initial of correction {checks.shown(self.correction)}",
                        getattr(self.correction, "needs_initial", None))
        checks.instance("coarse", self.coarse, CoarseSolve, "a CoarseSolve")
        checks.choice("coarse_matrices", self.coarse_matrices, ("galerkin", "discretised"))
        checks.choice("stop", self.stop, ("error", "change"))
        self._check_rtol()
        checks.integer("max_cycles", self.max_cycles, 1)
        if isinstance(self.correction, Truncated):
            self._check_truncated()

    def _check_rtol(self) -> None:
        if not isinstance(self.rtol, str):
            object.__setattr__(self, "rtol", checks.tolerance("rtol", self.rtol))
        elif self.rtol != "discretisation":
            raise ValueError(f"rtol must be a number > 0 and < 1 or 'discretisation', got {checks.shown(self.rtol)}")
        elif not (isinstance(self, FullMultigrid) and isinstance(self.correction, Truncated)):
            raise ValueError("rtol='discretisation' needs FullMultigrid(correction=Truncated()): the nested start "
                             "shows the discretisation error")

    def _not_for_truncated(self) -> str:
        """Name of an option that is not at its default though Truncated has its own; empty if there is none."""
        defaults = {"cycle": Cycle(), "smoother": ProjectedGaussSeidel(), "coarse": CoarseSolve(),
                    "coarse_matrices": "galerkin", "stop": "error"}
        return next((name for name, default in defaults.items() if getattr(self, name) != default), "")

    def _check_truncated(self) -> None:
        name = self._not_for_truncated()
        if name:
            raise ValueError(f"{name}: Truncated() has its own; leave it at its default, or take correction=Monotone()")

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level; see :class:`adaptmg.solver.run.Solver`."""
        _need_levels(hierarchy)
        if isinstance(self.correction, Truncated):
            discrete = hierarchy.finest.discrete
            unknowns = np.zeros(discrete.n_dofs) if start is None else start.reshape(-1) - discrete.fixed_values
            unknowns[discrete.fixed] = 0.0
            return TruncatedMachine(self, hierarchy, run).finish(unknowns, cold=True)
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
        checks.instance("start", self.start, NestedStart, "a NestedStart")

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level; see :class:`adaptmg.solver.run.Solver`."""
        if start is not None:
            raise ValueError("start: FullMultigrid makes its own start; use Multigrid to continue from a given one")
        _need_levels(hierarchy)
        if isinstance(self.correction, Truncated):
            hierarchy.need_discretised("the nested start of FullMultigrid")
            truncated = TruncatedMachine(self, hierarchy, run)
            return truncated.finish(truncated.nested_start(self.start), cold=False)
        machine = Machine(self, hierarchy, run)
        return machine.finish(machine.nested_start(self.start))


def _need_levels(hierarchy: Hierarchy) -> None:
    if len(hierarchy) < 2:
        raise ValueError("grids: multigrid needs at least two levels, got one; use SingleGrid or ActiveSet on one grid")
