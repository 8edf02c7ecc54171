r"""PathMachine: the truncated multigrid through load steps, set up once.

Matrices, transfers, and the lists by which the contact status changes coarse matrices stay; loads, gaps and slip
references change. The nested start of a step carries only what the step changes: level l solves its own step from

.. math:: u_l^{k-1} + P\,(u_{l-1}^k - u_{l-1}^{k-1}),

with its own history :math:`u_l^0, u_l^1, \dots` and slips measured against that. The error of such a start is the
discretisation error of the increment, not of the whole displacement; it finds nodes that stick, and slips that turn
round when a load is taken back, where the interpolation of the whole displacement would let every node slip.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse.linalg import lsmr

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.nested import NestedStart
from adaptmg.multigrid.truncated.rigid_motions import RigidMotions
from adaptmg.multigrid.truncated.step import TruncatedStep
from adaptmg.smoother.system import local_contact
from adaptmg.solver.run import Outcome, Run
from adaptmg.solver.truncated_machine import TruncatedMachine

if TYPE_CHECKING:
    from adaptmg.solver.multigrid import Multigrid

__all__ = ["PathMachine", "coarse_displacements", "lifted_load"]


class PathMachine(TruncatedMachine):
    """The truncated multigrid for a sequence of steps.

    Parameters
    ----------
    options : Multigrid
        With :class:`~adaptmg.multigrid.Truncated` as correction.
    hierarchy : Hierarchy
        Of the first step.
    run : Run

    Attributes
    ----------
    spent : bool
        Another method had to take over: what is kept may be spoilt, a new machine is needed.
    """

    def __init__(self, options: Multigrid, hierarchy: Hierarchy, run: Run) -> None:
        super().__init__(options, hierarchy, run)
        self._runners: dict[int, TruncatedStep] = {}
        self.spent = False

    def take(self, hierarchy: Hierarchy, run: Run) -> None:
        """Go on to the next step: ``hierarchy`` differs in loads, prescribed values and slip references only."""
        self.hierarchy, self.run, self.cycle.recorder = hierarchy, run, run
        self.problems = [level.discrete for level in hierarchy.levels]
        with run.phase("setup"):
            finest = self._runners.get(len(hierarchy) - 1)
            if finest is not None:
                finest.truncation.restore()

    def increment(self, start: NestedStart, past: list[np.ndarray]) -> list[np.ndarray]:
        """The nested start of a step.

        Parameters
        ----------
        start : NestedStart
        past : list of (n_dofs,) arrays
            Displacement of the step before on each level, coarsest first, Cartesian, prescribed values included, m;
            between bodies relative.

        Returns
        -------
        list of (n_dofs,) arrays
            The same at this step: solutions of the coarse levels, and the start on the finest.
        """
        result: list[np.ndarray] = []
        for number, problem in enumerate(self.problems):
            if number == 0:
                unknowns = self._solve_coarsest(start)
            else:
                change = (result[-1] - past[number - 1]).reshape(-1, problem.dim)
                unknowns = past[number] + (self.cycle.prolongations[number - 1] @ change).reshape(-1)
                unknowns = from_prescribed(problem, unknowns)
                self.run.visit(number, "start")
                if number < len(self.problems) - 1:
                    runner = self._runner(number, unknowns)
                    with self.run.phase("start"):
                        self._start_cycles(runner, number, start)
                        unknowns = runner.unknowns
                        runner.truncation.restore()
            result.append(unknowns + problem.fixed_values)
        self.run.start_work_units = self.run.work_units
        return result

    def finish(self, unknowns: np.ndarray, cold: bool) -> Outcome:
        """See :class:`TruncatedMachine`."""
        outcome = super().finish(unknowns, cold)
        self.spent = bool(self.run.fallback)
        return outcome

    def _runner(self, number: int, unknowns: np.ndarray) -> TruncatedStep:
        if number not in self._runners:
            self._runners[number] = super()._runner(number, unknowns)
            return self._runners[number]
        runner, problem = self._runners[number], self.problems[number]
        with self.run.phase("setup"):
            data, _ = local_contact(problem)
            contact, load = runner.contact, lifted_load(problem)
            contact.renew(data)
            contact.start(unknowns)
            runner.load, runner.unknowns = load, unknowns
            runner.motions = RigidMotions.of(problem, contact, load)
        return runner


def from_prescribed(problem: DiscreteProblem, displacement: np.ndarray) -> np.ndarray:
    """A displacement (n_dofs,) counted from the prescribed values, zero at fixed dofs, m."""
    result = displacement - problem.fixed_values
    result[problem.fixed] = 0.0
    return result


def lifted_load(problem: DiscreteProblem) -> np.ndarray:
    """b - A u_fixed, zero at fixed dofs (n_dofs,), Cartesian, N."""
    load = problem.load - problem.matrix @ problem.fixed_values if problem.fixed_values.any() else problem.load.copy()
    load[problem.fixed] = 0.0
    return load


def coarse_displacements(hierarchy: Hierarchy, displacement: np.ndarray) -> list[np.ndarray]:
    """A displacement of the finest level on all levels: each next coarser one that interpolates it best.

    Parameters
    ----------
    hierarchy : Hierarchy
        Discretised on all levels.
    displacement : (n_dofs,) array
        m; between bodies relative.

    Returns
    -------
    list of (n_dofs,) arrays
        Coarsest first, least squares in the nodal values.
    """
    result = [displacement]
    for level in reversed(hierarchy.levels[1:]):
        columns = result[0].reshape(level.n_nodes, -1).T
        nodal = [lsmr(level.prolongation, column, atol=1e-8, btol=1e-8)[0] for column in columns]
        result.insert(0, np.stack(nodal, axis=1).reshape(-1))
    return result
