"""Step solvers: how each method goes from one load step to the next.

The truncated multigrid keeps its set-up (:mod:`adaptmg.solver.history.truncated_steps`). With FullMultigrid each step
has a nested start of the increment, unless the displacement extrapolated in the loads leaves far less: under
proportional loading that is the solution. All other methods start from the better of the displacement of the step
before and the extrapolated one; a FullMultigrid with another correction goes on as a Multigrid.
"""

from __future__ import annotations

from dataclasses import fields

from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.history.past import Past, StepSolver, better_start
from adaptmg.solver.method import own
from adaptmg.solver.multigrid import FullMultigrid, Multigrid
from adaptmg.solver.result.examiner import Examiner
from adaptmg.solver.run import Outcome, Run, Solver

__all__ = ["step_solver"]


def step_solver(solver: Solver) -> StepSolver:
    """The way through the steps for a solver."""
    if not isinstance(solver, Multigrid):
        return _Restarted(solver, solver)
    load_steps = own(solver.correction, "load_steps")
    if load_steps is not None:
        return load_steps(solver)
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
        start = better_start(examiner, past, run)
        return self.later.run(hierarchy, run, start.reshape(examiner.discrete.n_nodes, -1)), None

    def replay(self, hierarchy: Hierarchy, past: Past, rtol: float) -> None:
        """Nothing is kept."""
