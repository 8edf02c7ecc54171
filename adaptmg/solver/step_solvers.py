"""Step solvers: how each method goes from one load step to the next.

The truncated multigrid keeps its set-up (:mod:`adaptmg.solver.path_machine`). With FullMultigrid each step has a nested
start of the increment, unless the displacement extrapolated in the loads leaves far less: under proportional loading
that is the solution. All other methods start from the better of the displacement of the step before and the
extrapolated one; a FullMultigrid with another correction goes on as a Multigrid.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np

from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.truncated.options import Truncated
from adaptmg.solver.convergence import Convergence
from adaptmg.solver.examiner import Examiner
from adaptmg.solver.multigrid import FullMultigrid, Multigrid
from adaptmg.solver.path_machine import PathMachine, coarse_displacements, from_prescribed
from adaptmg.solver.run import Outcome, Run, Solver

__all__ = ["Past", "StepSolver", "past_of", "step_solver"]


@dataclass(frozen=True, eq=False)
class Past:
    """What is known before a step.

    Attributes
    ----------
    levels : list of (n_dofs,) arrays
        Displacement of the step before, coarsest level first, Cartesian, m; between bodies relative. On the finest
        level alone where the coarse ones are no contact problems.
    extrapolated : (n_dofs,) array
        On the finest level; the displacement of the step before where nothing is known.
    given : bool
        Whether there is a step before, or a start.
    """

    levels: list[np.ndarray]
    extrapolated: np.ndarray
    given: bool


class StepSolver(Protocol):
    """What :func:`adaptmg.solve_path` needs of a method."""

    def run(self, hierarchy: Hierarchy, examiner: Examiner, run: Run, past: Past
            ) -> tuple[Outcome, list[np.ndarray] | None]:
        """Solve a step; with the displacement of the coarse levels if the method has it."""

    def replay(self, hierarchy: Hierarchy, past: Past, rtol: float) -> list[np.ndarray] | None:
        """The coarse displacements of a step whose result is known, solved to ``rtol``."""


def step_solver(solver: Solver) -> StepSolver:
    """The way through the steps for a solver."""
    if not isinstance(solver, Multigrid):
        return _Restarted(solver, solver)
    if isinstance(solver.correction, Truncated):
        return _KeptTruncated(solver)
    if not isinstance(solver, FullMultigrid):
        return _Restarted(solver, solver)
    plain = Multigrid(**{item.name: getattr(solver, item.name) for item in fields(Multigrid)})
    return _Restarted(solver, plain)


class _Restarted:
    """A solver that is run anew for every step: ``first`` without a start, ``later`` with one."""

    def __init__(self, first: Solver, later: Solver) -> None:
        self.first, self.later = first, later

    def run(self, hierarchy: Hierarchy, examiner: Examiner, run: Run, past: Past) -> tuple[Outcome, None]:
        if not past.given:
            return self.first.run(hierarchy, run, None), None
        start = _better(examiner, past, run)
        return self.later.run(hierarchy, run, start.reshape(examiner.discrete.n_nodes, -1)), None

    def replay(self, hierarchy: Hierarchy, past: Past, rtol: float) -> None:
        """Nothing is kept."""


class _KeptTruncated:
    """The truncated multigrid, with or without nested start."""

    #: extrapolation is taken where it leaves less than this share of the residual of the nested start, whose error
    #: is rough and soon smoothed away
    EXTRAPOLATE = 0.05

    def __init__(self, options: Multigrid) -> None:
        self.options = options
        self.machine: PathMachine | None = None

    def run(self, hierarchy: Hierarchy, examiner: Examiner, run: Run, past: Past
            ) -> tuple[Outcome, list[np.ndarray] | None]:
        """See :class:`StepSolver`."""
        machine, coarse, cold = self._machine(hierarchy, run), None, True
        if isinstance(self.options, FullMultigrid):
            *coarse, start = machine.increment(self.options.start, past.levels)
            cold = False
            with run.phase("start"):
                if self._exact_enough(examiner, past, start):
                    start = past.extrapolated
        else:
            start = _better(examiner, past, run) if past.given else np.zeros(examiner.discrete.n_dofs)
        outcome = machine.finish(from_prescribed(examiner.discrete, start), cold)
        self._hold(outcome.rtol)
        return outcome, coarse

    def replay(self, hierarchy: Hierarchy, past: Past, rtol: float) -> list[np.ndarray] | None:
        """See :class:`StepSolver`."""
        coarse = None
        if isinstance(self.options, FullMultigrid):
            machine = self._machine(hierarchy, Run(unit=hierarchy.finest.matrix.nnz))
            coarse = machine.increment(self.options.start, past.levels)[:-1]
        self._hold(rtol)
        return coarse

    def _exact_enough(self, examiner: Examiner, past: Past, nested: np.ndarray) -> bool:
        """Whether to start from the extrapolated displacement; not where the nested start sets the tolerance."""
        if not past.given or self.options.rtol == "discretisation":
            return False
        return (examiner.relative_residual(past.extrapolated)
                <= self.EXTRAPOLATE * examiner.relative_residual(nested))

    def _machine(self, hierarchy: Hierarchy, run: Run) -> PathMachine:
        if len(hierarchy) < 2:
            raise ValueError("grids: multigrid needs at least two levels, got one; use SingleGrid or ActiveSet on one "
                             "grid")
        if isinstance(self.options, FullMultigrid):
            hierarchy.need_discretised("the nested start of FullMultigrid")
        if self.machine is None or self.machine.spent:
            self.machine = PathMachine(self.options, hierarchy, run)
        else:
            self.machine.take(hierarchy, run)
        return self.machine

    def _hold(self, rtol: float) -> None:
        """Keep the tolerance that the discretisation error of the first step has set: increments have smaller ones."""
        if self.options.rtol == "discretisation":
            self.options = replace(self.options, rtol=max(rtol, Convergence.ROUNDING_LIMIT))
            self.machine.options = self.options


def _better(examiner: Examiner, past: Past, run: Run) -> np.ndarray:
    """The displacement of the step before or the extrapolated one, whichever has the smaller natural residual."""
    with run.phase("start"):
        return min(past.levels[-1], past.extrapolated, key=examiner.relative_residual)


def past_of(hierarchy: Hierarchy, displacement: np.ndarray, given: bool) -> Past:
    """What is known before the first step: a displacement (n_dofs,) of the finest level, zero if none is given."""
    if not hierarchy.discretised:
        return Past([displacement], displacement, given)
    if not given:
        return Past([np.zeros(level.discrete.n_dofs) for level in hierarchy.levels], displacement, given)
    return Past(coarse_displacements(hierarchy, displacement), displacement, given)
