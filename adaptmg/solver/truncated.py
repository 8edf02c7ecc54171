"""TruncatedMultigrid: one run of the truncated multigrid: nested start, cycles on the finest level, fallback.

Where safe cycles do not help either (friction of 3, say), a :class:`~adaptmg.solver.truncated.Fallback` takes
over for the cycles that are left.

Fallback: what goes on where the truncated multigrid does not converge: the active set method, or monotone cycles.

The active set method needs the finest level alone and few steps, but factorisations, so it is for problems of
moderate size; larger ones go on with the monotone correction, which is slow but needs no more memory. Newton steps
count as cycles, and the residual of each as one pass over the finest matrix; factorisations count as seconds.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy import sparse

from adaptmg._check_arrays import indices_frozen
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.corrections import Monotone
from adaptmg.multigrid.cycle import NestedStart, project
from adaptmg.multigrid.linear_cycle import LinearCycle
from adaptmg.multigrid.projected_sweeps import Interface
from adaptmg.multigrid.rigid_motions import RigidMotions
from adaptmg.multigrid.split_matrix import galerkin_levels, nodal_prolongations
from adaptmg.multigrid.truncated_contact import TruncatedContact
from adaptmg.multigrid.truncated_step import TruncatedStep
from adaptmg.solver.active_set import ActiveSet
from adaptmg.solver.iterate import iterate
from adaptmg.solver.projected import MultigridOptions, ProjectedMultigrid
from adaptmg.solver.record import Outcome, Run
from adaptmg.solver.status import Status
from adaptmg.solver.truncated_iteration import (
    EnergyTest,
    StartIteration,
    StartTest,
    TruncatedIteration,
    WarmIteration,
    WarmTest,
)

__all__ = ["Fallback", "TruncatedMultigrid"]

_LOG = logging.getLogger(__name__)


class TruncatedMultigrid:
    """One run of the truncated multigrid."""

    #: complete nested starts stop after so many cycles on a level
    COMPLETE_LIMIT = 60
    #: of the diagonal, added to a coarsest matrix that the active set method is to solve
    SHIFT = 1e-9

    def __init__(self, options: MultigridOptions, hierarchy: Hierarchy, run: Run) -> None:
        if options.start is not None:
            hierarchy.need_discretised("the nested start of FullMultigrid")
        self.options, self.hierarchy, self.run = options, hierarchy, run
        self.nbytes = 0
        with run.phase("setup"):
            prolongations = nodal_prolongations(hierarchy)
            levels = galerkin_levels(hierarchy, prolongations)
            self.cycle = LinearCycle(levels, prolongations, run, options.correction.sweeps(levels),
                                     options.correction.coarse_solve, options.correction.coarse_smoother)
        self.problems: list[DiscreteProblem | None] = [level.discrete for level in hierarchy.levels]

    def from_given(self, start: np.ndarray | None) -> Outcome:
        """See :class:`~adaptmg.solver.projected.Method`."""
        return self.finish(self._lifted(start), cold=True)

    def from_warm(self, start: np.ndarray, rate: float) -> Outcome:
        """Solve from a displacement that is nearly solved; see :mod:`adaptmg.solver.multigrid`."""
        return self.finish(self._lifted(start), cold=False, rate=rate)

    def _lifted(self, start: np.ndarray | None) -> np.ndarray:
        """A displacement, or none, as unknowns of the finest level (n_dofs,)."""
        problem = self.problems[-1]
        return np.zeros(problem.n_dofs) if start is None else problem.from_prescribed(start)

    def from_nested(self, start: NestedStart) -> Outcome:
        """See :class:`~adaptmg.solver.projected.Method`."""
        return self.finish(self.nested_start(start), cold=False)

    def nested_start(self, start: NestedStart) -> np.ndarray:
        """Solve level by level from the coarsest; returns the start on the finest level (n_dofs,), Cartesian."""
        unknowns = np.empty(0)
        for number in range(len(self.hierarchy) - 1):
            if number == 0:
                unknowns = self._solve_coarsest(start)
            else:
                runner = self._runner(number, unknowns)
                with self.run.phase("start"):
                    self._start_cycles(runner, number, start)
                    unknowns = runner.unknowns
                    runner.truncation.restore()
            with self.run.phase("start"):
                unknowns = self._prolonged(number, unknowns)
            self.run.visit(number + 1, "start")
        self.run.start_work_units = self.run.work_units
        return unknowns

    def finish(self, unknowns: np.ndarray, cold: bool, rate: float | None = None) -> Outcome:
        """Cycles on the finest level."""
        o, problem = self.options, self.problems[-1]
        start = unknowns.copy() if o.rtol == "discretisation" else None
        runner = self._runner(len(self.hierarchy) - 1, unknowns)

        def shortfall(rtol: float) -> float:
            if stop.at_rounding(runner.rounding()):
                return 0.0
            return self.run.shortfall(problem.with_prescribed(runner.unknowns), rtol)

        with self.run.phase("cycles"):
            stop = (EnergyTest(problem, o.rtol, o.max_cycles, shortfall) if rate is None
                    else WarmTest(problem, o.rtol, o.max_cycles, shortfall, rate))
            kind = TruncatedIteration if rate is None else WarmIteration
            cycles = kind(runner, o.correction.safe_cycles, cold, self.run, problem, start,
                          hands_over=problem.n_dofs <= Fallback.FACTORISED[problem.dim])
            status = iterate(cycles, stop, self.run)
        displacement = problem.with_prescribed(runner.unknowns).reshape(-1, problem.dim)
        outcome = Outcome(displacement, status, cycles.cycles, stop.rtol, stop.error_estimate, stop.rate)
        failed = status in (Status.STALLED, Status.DIVERGED) and not stop.at_rounding(runner.rounding())
        if failed and cycles.cycles < o.max_cycles and stop.rtol > 0:
            return Fallback(o, self.hierarchy, self.run, stop.rtol).finish(outcome, stop.better)
        return outcome

    def _runner(self, number: int, unknowns: np.ndarray) -> TruncatedStep:
        with self.run.phase("setup"):
            problem, levels = self.problems[number], self.cycle.levels
            runner = self._cycle_on(problem, self.cycle, number, unknowns)
            if number == len(levels) - 1 and self.cycle.coarse_smoother is None:
                # the last use of the diagonal blocks but on the coarsest level
                for level in levels[1:]:
                    level.drop_diagonal()
            self.nbytes = self.cycle.nbytes + runner.nbytes
            return runner

    def _cycle_on(self, problem: DiscreteProblem, cycle: LinearCycle, number: int,
                  unknowns: np.ndarray) -> TruncatedStep:
        """Cycles for a problem on level ``number`` of a linear cycle, from ``unknowns`` (n_dofs,)."""
        contact, load = TruncatedContact.of(problem, cycle.levels[number]), problem.load_from_prescribed()
        contact.start(unknowns)
        options, interface = self.options.correction, None
        if problem.coupling is not None and options.interface_sweeps:
            interface = Interface(cycle.levels[number], problem.coupling)
        return TruncatedStep(cycle, number, contact, load, unknowns, options.recombine,
                              RigidMotions.of(problem, contact, load), interface, options.interface_sweeps)

    def _start_cycles(self, runner: TruncatedStep, number: int, start: NestedStart) -> None:
        """The cycles of a nested start on one level."""
        problem, options = self.problems[number], self.options.correction
        if start.cycles == "complete":
            iterate(TruncatedIteration(runner, options.safe_cycles, cold=False),
                    EnergyTest(problem, start.rtol, self.COMPLETE_LIMIT))
            return
        wanted = start.cycles_on(problem, self.problems[number + 1])
        iterate(StartIteration(runner, 0, cold=False), StartTest(problem, wanted, max(wanted, options.safe_cycles)))

    def _solve_coarsest(self, start: NestedStart) -> np.ndarray:
        """The coarsest level; several bodies, near-mechanisms as long as they come loose, by the active set method."""
        methods = [self._coarsest_by_cycles, self._coarsest_by_active_set]
        if self.problems[0].coupling is not None:
            methods.reverse()
        with self.run.phase("start"):
            for method in methods:
                unknowns, solved = method(start)
                if solved:
                    break
        return unknowns

    def _coarsest_by_cycles(self, start: NestedStart) -> tuple[np.ndarray, bool]:
        """The coarsest level as its own coarse level: truncated Newton steps with direct solves between sweeps."""
        problem, level = self.problems[0], self.cycle.levels[0]
        n = level.n_nodes
        identity = indices_frozen(sparse.csr_array(
            (np.ones(n), np.arange(n, dtype=np.int32), np.arange(n + 1, dtype=np.int32))))
        cycle = LinearCycle([level.copy(), level], [identity], _OnCoarsest(self.run), (1, 1),
                            self.options.correction.coarse_solve)
        runner = self._cycle_on(problem, cycle, 1, np.zeros(problem.n_dofs))
        status = iterate(TruncatedIteration(runner, self.options.correction.safe_cycles, cold=True),
                         EnergyTest(problem, start.rtol, self.COMPLETE_LIMIT))
        # unless restored, the matrix stays as the last contact status left it
        runner.truncation.restore()
        return runner.unknowns, status.ok

    def _coarsest_by_active_set(self, start: NestedStart) -> tuple[np.ndarray, bool]:
        """Semismooth Newton steps; each counts a pass, its factorisation as seconds."""
        problem, level = self.problems[0], self.cycle.levels[0]
        # where dofs are fixed the matrix of the level is empty; where the next mesh is locally the coarser one, other
        # coarse functions vanish on it
        diagonal = sparse.diags_array(np.where(problem.fixed, 1.0, self.SHIFT) * problem.matrix.diagonal())
        whole = sparse.bsr_array(sparse.csr_array(level.matrix()) + diagonal, blocksize=(problem.dim,) * 2)
        grids = Hierarchy.single(replace(problem, matrix=whole, load=problem.load_from_prescribed()))
        try:
            found = ActiveSet(rtol=start.rtol).run(grids, Run(unit=self.run.unit), None)
        except np.linalg.LinAlgError as error:
            _LOG.info("coarsest level: the active set method gives up: %s", error)
            return np.zeros(problem.n_dofs), False
        self.run.count(found.cycles, level.nonzeros)
        self.run.visit(0, "solve", found.cycles)
        return problem.from_prescribed(found.displacement), found.status.ok

    def _prolonged(self, number: int, unknowns: np.ndarray) -> np.ndarray:
        """Interpolated to the next finer level, prescribed values respected."""
        coarse, fine = self.problems[number], self.problems[number + 1]
        displacement = coarse.with_prescribed(unknowns).reshape(-1, coarse.dim)
        return fine.from_prescribed(self.cycle.prolongations[number] @ displacement)


@dataclass(frozen=True)
class _OnCoarsest:
    """Notes everything as done on the coarsest level."""

    run: Run

    def count(self, passes: float, nonzeros: int) -> None:
        """Count matrix passes."""
        self.run.count(passes, nonzeros)

    def visit(self, level: int, action: str, times: int = 1) -> None:
        """Note smoothing and solves; what goes between the level and its copy is no transfer."""
        if action in ("smooth", "solve"):
            self.run.visit(0, action, times)


class Fallback:
    """Takes over a run of the truncated multigrid."""

    #: dofs up to which sparse factorisations are sensible, by dimension
    FACTORISED: ClassVar[dict[int, int]] = {2: 200_000, 3: 60_000}
    #: contact dofs up to which the steps are taken on a dense matrix (0.3 GB)
    CONDENSED = 6_000

    def __init__(self, options: MultigridOptions, hierarchy: Hierarchy, run: Run, rtol: float) -> None:
        self.options, self.hierarchy, self.run, self.rtol = options, hierarchy, run, rtol
        self.problem: DiscreteProblem = hierarchy.finest.discrete

    def finish(self, outcome: Outcome, better: bool) -> Outcome:
        """Solve with what is left of the cycles."""
        start = outcome.displacement if better else None
        if self.problem.n_dofs <= self.FACTORISED[self.problem.dim]:
            for first in (start, None) if better else (None,):
                outcome = self._active_set(outcome, first)
                if outcome.status.ok:
                    return outcome
        return self._monotone(outcome, start) if self.hierarchy.discretised else outcome

    def _active_set(self, before: Outcome, start: np.ndarray | None) -> Outcome:
        """Semismooth Newton steps from ``start`` (n_nodes, dim), or from all nodes sticking."""
        left = self.options.max_cycles - before.cycles
        if left < 1:
            return before
        self._take_over(before.cycles, "ActiveSet")
        solver = ActiveSet(rtol=self.rtol, max_steps=left,
                           condensed=self.problem.dim * len(self.problem.contact.nodes) <= self.CONDENSED)
        start_work_units = self.run.start_work_units
        try:
            outcome = solver.run(self.hierarchy, self.run, start)
        except (np.linalg.LinAlgError, ValueError, MemoryError) as error:
            return self._given_up("the active set method", before, error)
        finally:
            self.run.start_work_units = start_work_units
        # Newton steps have no rate of a cycle
        return replace(outcome, cycles=before.cycles + outcome.cycles, rate=np.nan)

    def _monotone(self, before: Outcome, start: np.ndarray | None) -> Outcome:
        """Cycles with the monotone correction from ``start`` (n_nodes, dim), or from zero: slower, but they go on."""
        left = self.options.max_cycles - before.cycles
        if left < 1:
            return before
        self._take_over(before.cycles, "Monotone")
        options = replace(self.options, correction=Monotone(), rtol=self.rtol, max_cycles=left)
        method = ProjectedMultigrid(options, self.hierarchy, self.run)
        local = method.problems[-1]
        unknowns = local.to_local(self.problem.fixed_values if start is None else start)
        project(local, unknowns)
        try:
            outcome = method.finish(unknowns)
        except (np.linalg.LinAlgError, ValueError, MemoryError) as error:
            # a coarsest problem of few contact nodes may be singular where the finest one is not
            return self._given_up("the monotone correction", before, error)
        return replace(outcome, cycles=before.cycles + outcome.cycles)

    def _given_up(self, method: str, before: Outcome, error: Exception) -> Outcome:
        _LOG.info("cycle %d: %s gives up: %s", before.cycles, method, error)
        self.run.first_cycle, self.run.fallback = 0, ""
        return before

    def _take_over(self, cycles: int, method: str) -> None:
        _LOG.info("cycle %d: the truncated multigrid does not converge; going on with %s", cycles, method)
        self.run.first_cycle, self.run.fallback = cycles, f"{method} from cycle {cycles}"
