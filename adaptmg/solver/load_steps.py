r"""KeptMultigrid: the truncated multigrid through load steps, set up once; what each step starts from.

Matrices, transfers, and the lists by which the contact status changes coarse matrices stay; loads, gaps and slip
references change. The nested start of a step carries only what the step changes: level l solves its step from

.. math:: u_l^{k-1} + P\,(u_{l-1}^k - u_{l-1}^{k-1}),

with its history :math:`u_l^0, u_l^1, \dots` and slips measured against that. The error of such a start is the
discretisation error of the increment, not of the whole displacement; it finds nodes that stick, and slips that turn
round when a load is taken back, where the interpolation of the whole displacement would let every node slip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import lsmr

from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.cycle import NestedStart
from adaptmg.multigrid.subspaces import RigidMotions
from adaptmg.multigrid.truncated_step import TruncatedStep
from adaptmg.multigrid.volume_pressures import prolonged_pressures
from adaptmg.smoother.system import local_contact
from adaptmg.solver.examine import Examiner
from adaptmg.solver.iterate import StopTest
from adaptmg.solver.multigrid import FullMultigrid, Multigrid
from adaptmg.solver.record import Outcome, Run
from adaptmg.solver.truncated import Truncated, TruncatedRun

#: displacement (n_dofs,) of the finest level, and pressures of its volumes, if it has them
Start = tuple[np.ndarray, np.ndarray | None]


@dataclass(frozen=True, eq=False)
class Past:
    """What is known before a step."""

    levels: list[np.ndarray]  # displacements (n_dofs,) after the step before, coarsest level first
    last: Start  # after the step before
    extrapolated: Start
    given: bool  # whether there is a step before


def better_start(examiner: Examiner, past: Past, run: Run) -> np.ndarray:
    """Return the displacement of the step before or the extrapolated one, the one with the smaller residual."""
    with run.phase("start"):
        starts = past.last, past.extrapolated
        displacement, run.pressures = min(starts, key=lambda start: examiner.relative_residual(*start))
    return displacement


def coarse_displacements(hierarchy: Hierarchy, displacement: np.ndarray) -> list[np.ndarray]:
    """Return a displacement of the finest level on all discretised ones: the next coarser ones that interpolate it
    best."""
    result = [displacement]
    for level in reversed(hierarchy.levels[1:] if hierarchy.discretised else ()):
        columns = result[0].reshape(level.n_nodes, -1).T
        nodal = [lsmr(level.prolongation, column, atol=1e-8, btol=1e-8)[0] for column in columns]
        result.insert(0, np.stack(nodal, axis=1).reshape(-1))
    return result


class KeptMultigrid(TruncatedRun):
    """The truncated multigrid for a sequence of steps."""

    def __init__(self, parts: Truncated, hierarchy: Hierarchy, run: Run, rtol: float | str, max_cycles: int) -> None:
        super().__init__(parts, hierarchy, run, rtol, max_cycles)
        self._steps: dict[int, TruncatedStep] = {}

    def take(self, hierarchy: Hierarchy, run: Run) -> None:
        """Go on to the next step: ``hierarchy`` differs in loads, prescribed values and slip references only."""
        self.hierarchy, self.run, self.cycle.recorder = hierarchy, run, run
        self.problems = [level.discrete_or_none for level in hierarchy.levels]
        self.pressures = run.pressures
        if len(hierarchy) - 1 in self._steps:
            with run.phase("setup"):
                self._steps[len(hierarchy) - 1].truncation.restore()

    def increment(self, start: NestedStart, past: list[np.ndarray]) -> list[np.ndarray]:
        """Return the displacements (n_dofs,) of all levels from which a step begins."""
        result: list[np.ndarray] = []
        for number, problem in enumerate(self.problems):
            if number == 0:
                unknowns = self._solve_coarsest(start, past[0] if past[0].any() else None)
            else:
                change = (result[-1] - past[number - 1]).reshape(-1, problem.dim)
                unknowns = past[number] + (self.cycle.levels[number].prolongation @ change).reshape(-1)
                unknowns = problem.from_prescribed(unknowns)
                self.pressures = prolonged_pressures(self.problems[number - 1], problem,
                                                     self.cycle.levels[number].prolongation, self.pressures)
                self.run.visit(number, "start")
                if number < len(self.problems) - 1:
                    unknowns = self._start_cycles(number, unknowns, start)
            result.append(problem.with_prescribed(unknowns))
        if self.run.pressures is not None:
            self.pressures = self.run.pressures
        self.run.start_work_units = self.run.work_units
        return result

    def _step(self, number: int, unknowns: np.ndarray) -> TruncatedStep:
        if number not in self._steps:
            self._steps[number] = super()._step(number, unknowns)
            return self._steps[number]
        step, problem = self._steps[number], self.problems[number]
        with self.run.phase("setup"):
            data, _ = local_contact(problem)
            contact, load = step.contact, problem.load_from_prescribed()
            contact.renew(data)
            contact.start(unknowns)
            if step.pressures is not None:
                # coarse levels go on from their own
                step.pressures.pose(problem, self.pressures if number == len(self.problems) - 1 else None)
            step.load, step.unknowns = load, unknowns
            step.motions = RigidMotions.of(problem, contact, load)
        return step


class TruncatedSteps:
    """The truncated multigrid, with or without nested start."""

    #: extrapolation is taken where it leaves less than this share of the residual of the nested start, whose error
    #: is rough and soon smoothed away
    EXTRAPOLATE = 0.05

    def __init__(self, solver: Multigrid) -> None:
        self.parts, self.rtol, self.max_cycles = solver.correction, solver.rtol, solver.max_cycles
        self.start = solver.start if isinstance(solver, FullMultigrid) else None
        self.multigrid: KeptMultigrid | None = None

    def run(self, hierarchy: Hierarchy, examiner: Examiner, run: Run, past: Past
            ) -> tuple[Outcome, list[np.ndarray] | None]:
        multigrid, coarse, kind = self.multigrid, None, "given" if past.given else "zero"
        if multigrid is None or not hierarchy.finest.discrete.alike(multigrid.problems[-1]):
            multigrid = KeptMultigrid(self.parts, hierarchy, run, self.rtol, self.max_cycles)
        else:
            multigrid.take(hierarchy, run)
        multigrid.rtol = self.rtol
        if self.start is not None:
            *coarse, start = multigrid.increment(self.start, past.levels)
            kind = "given" if past.given else "nested"
            with run.phase("start"):
                # not where the nested start sets the tolerance
                extrapolated, pressures = past.extrapolated
                if (past.given and self.rtol != "discretisation" and examiner.relative_residual(extrapolated, pressures)
                        <= self.EXTRAPOLATE * examiner.relative_residual(start, multigrid.pressures)):
                    start, multigrid.pressures = extrapolated, pressures
        else:
            start = better_start(examiner, past, run) if past.given else np.zeros(examiner.discrete.n_dofs)
            multigrid.pressures = run.pressures
        outcome = multigrid.finish(examiner.discrete.from_prescribed(start), kind)
        self.hold(outcome.rtol)
        # what a cycle that ran away leaves behind is not used again
        self.multigrid = None if outcome.left else multigrid
        return outcome, coarse

    def hold(self, rtol: float) -> None:
        """Keep the tolerance that the discretisation error of the first step has set: increments have smaller ones."""
        if self.rtol == "discretisation":
            self.rtol = max(rtol, StopTest.ROUNDING_LIMIT)
