"""Machine: the nested start and the cycle loop that Multigrid and FullMultigrid share."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.correction import InitialContact
from adaptmg.multigrid.correction_levels import correction_levels
from adaptmg.multigrid.cycle import MultigridCycle
from adaptmg.multigrid.nested import NestedStart, initial_contact, project, prolonged_start
from adaptmg.smoother.system import LocalProblem, LocalSystem, local_system
from adaptmg.solver.condensation import Condensed, condense
from adaptmg.solver.convergence import Convergence
from adaptmg.solver.run import Outcome, Run
from adaptmg.solver.sizes import euclidean_norm
from adaptmg.solver.status import Status

if TYPE_CHECKING:
    from adaptmg.solver.multigrid import Multigrid

__all__ = ["Machine"]


class Machine:
    """One run of a multigrid method.

    Parameters
    ----------
    options : Multigrid
    hierarchy : Hierarchy
    run : Run
    """

    #: of the diagonal, added to a coarsest matrix that is singular
    SHIFT = 1e-9

    def __init__(self, options: Multigrid, hierarchy: Hierarchy, run: Run) -> None:
        hierarchy.need_discretised(f"the correction {type(options.correction).__name__}")
        self.options, self.hierarchy, self.run = options, hierarchy, run
        with run.phase("setup"):
            self.problems: list[LocalProblem] = [local_system(level.discrete) for level in hierarchy.levels]
        self.initial: list[InitialContact] = []

    def runner(self, finest: int) -> MultigridCycle:
        """What runs cycles on level ``finest`` and those below."""
        o = self.options
        with self.run.phase("setup"):
            levels = correction_levels(self.hierarchy, self.problems, finest, o.coarse_matrices)
        condensed = None
        if o.coarse.condensed:
            with self.run.phase("factorise"):
                condensed = self._condensed(levels[0].system)
        return MultigridCycle(levels, o.cycle, o.smoother, o.correction, o.coarse, self.run, self.initial, condensed)

    def _condensed(self, coarsest: LocalSystem) -> Condensed:
        """The coarsest problem on its contact nodes."""
        local = replace(self.problems[0], system=coarsest, load=np.zeros(coarsest.n_dofs))
        try:
            return condense(local)
        except ValueError:
            # where the next mesh is locally the coarser one, some coarse functions vanish on it
            matrix = sparse.csr_array(coarsest.matrix) + self.SHIFT * sparse.diags_array(coarsest.matrix.diagonal())
            blocks = sparse.bsr_array(matrix, blocksize=(coarsest.dim,) * 2)
            return condense(replace(local, system=LocalSystem.from_matrix(blocks, coarsest.fixed, coarsest.nodes)))

    def nested_start(self, start: NestedStart) -> np.ndarray:
        """Solve level by level from the coarsest (steps a and b of the paper).

        Returns
        -------
        (n_dofs,) array
            The start on the finest level, local components.
        """
        unknowns = np.empty(0)
        for level in range(len(self.hierarchy) - 1):
            runner, local = self.runner(level), self.problems[level]
            with self.run.phase("start"):
                if level == 0:
                    unknowns = self._solve_coarsest(runner, start)
                elif start.cycles == "complete":
                    self._by_error(runner, unknowns, start.rtol)
                else:
                    for _ in range(start.cycles_on(local.discrete, self.problems[level + 1].discrete)):
                        runner.cycle(level, local.contact, local.load, unknowns, self.options.cycle.shape)
                if self.options.correction.needs_initial:
                    defect = runner.residual(level, local.load, unknowns)
                    self.initial.append(initial_contact(local, unknowns, defect))
                nodal = self.hierarchy[level + 1].contact_prolongation
                unknowns = prolonged_start(nodal, local, unknowns, self.problems[level + 1])
                self.run.visit(level + 1, "start")
        self.run.start_work_units = self.run.work_units
        return unknowns

    def _solve_coarsest(self, runner: MultigridCycle, start: NestedStart) -> np.ndarray:
        local = self.problems[0]
        unknowns = np.zeros(local.system.n_dofs)
        project(local, unknowns)
        runner.coarse = replace(self.options.coarse, rtol=start.rtol, atol=0.0, test="error")
        runner.solve_coarsest(local.contact, local.load, unknowns)
        return unknowns

    def finish(self, unknowns: np.ndarray) -> Outcome:
        """Cycles on the finest level from ``unknowns`` (n_dofs,), local components."""
        o = self.options
        runner = self.runner(len(self.hierarchy) - 1)
        with self.run.phase("cycles"):
            if o.stop == "error":
                status, cycles, watch = self._by_error(runner, unknowns, o.rtol, record=True)
            else:
                status, cycles, watch = self._by_change(runner, unknowns)
        displacement = self.problems[-1].to_cartesian(unknowns)
        return Outcome(displacement, status, cycles, o.rtol, watch.error_estimate, watch.rate)

    def _by_error(self, runner: MultigridCycle, unknowns: np.ndarray, rtol: float,
                  record: bool = False) -> tuple[Status, int, Convergence]:
        """Cycle until the error is small; tested after the first smoothing of a cycle, where its residual is known."""
        o, local, level = self.options, runner.levels.fine, len(runner.levels) - 1
        watch, cycles = self._watch(local, rtol, record), 0
        while True:
            runner.smooth(level, local.contact, local.load, unknowns, o.cycle.pre)
            defect = runner.residual(level, local.load, unknowns)
            met = watch.check(unknowns, defect)
            if record:
                self.run.record(cycle=cycles, **watch.measures())
            if met:
                return Status.CONVERGED, cycles, watch
            if watch.diverged:
                return Status.DIVERGED, cycles, watch
            if watch.stalled:
                return Status.STALLED, cycles, watch
            if cycles >= o.max_cycles:
                return Status.LIMIT, cycles, watch
            runner.correct(level, local.contact, unknowns, defect)
            runner.smooth(level, local.contact, local.load, unknowns, o.cycle.post)
            cycles += 1

    def _watch(self, local: LocalProblem, rtol: float, record: bool) -> Convergence:
        """A watch on a level; on the finest it knows the reference."""
        known = record and self.run.reference is not None
        return Convergence(local, rtol, self.run, local.to_local(self.run.reference) if known else None)

    def _by_change(self, runner: MultigridCycle, unknowns: np.ndarray) -> tuple[Status, int, Convergence]:
        """Cycle until the change over a cycle is small, the paper's test at the end of step g."""
        o, local, level = self.options, runner.levels.fine, len(runner.levels) - 1
        watch = self._watch(local, o.rtol, True)
        change, cycles = np.inf, 0
        while change > o.rtol and cycles < o.max_cycles:
            before = unknowns.copy()
            runner.smooth(level, local.contact, local.load, unknowns, o.cycle.pre)
            defect = runner.residual(level, local.load, unknowns)
            watch.check(unknowns, defect)
            runner.correct(level, local.contact, unknowns, defect)
            runner.smooth(level, local.contact, local.load, unknowns, o.cycle.post)
            cycles += 1
            size = euclidean_norm(unknowns)
            if not np.isfinite(size):
                return Status.DIVERGED, cycles, watch
            change = euclidean_norm(unknowns - before) / size if size > 0 else 0.0
            self.run.record(cycle=cycles, relative_change=change, **watch.measures())
        watch.check(unknowns, runner.residual(level, local.load, unknowns))
        self.run.record(cycle=cycles, relative_change=change, **watch.measures())
        if change > o.rtol:
            return Status.LIMIT, cycles, watch
        met = watch.residual <= watch.RESIDUAL_FACTOR * o.rtol
        return Status.CONVERGED if met else Status.STALLED, cycles, watch
