r"""TruncatedMachine: one run of the truncated multigrid: nested start, cycles, safe cycles, stopping, fallback.

The energy :math:`\eta_k^2 = \tilde r_k \cdot e_k` of the correction that the next coarser level proposes estimates the
error it removes; with the rate :math:`\rho = \eta_k/\eta_{k-1}` (the larger of the last ratio and the mean of the last
three) the error after the next smoothing is :math:`\rho\,\eta_k`. Together with the natural residual, which every
smoothing leaves behind, it decides when to stop, at no further pass over a matrix. Where safe cycles do not help either
(friction of 3, say), a :class:`~adaptmg.solver.fallback.Fallback` takes over for the cycles that are left.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.linear.galerkin_levels import galerkin_levels, nodal_prolongations
from adaptmg.multigrid.linear.linear_cycle import LinearCycle
from adaptmg.multigrid.nested import NestedStart
from adaptmg.multigrid.truncated.contact import TruncatedContact
from adaptmg.multigrid.truncated.interface import Interface
from adaptmg.multigrid.truncated.rigid_motions import RigidMotions
from adaptmg.multigrid.truncated.step import TruncatedStep
from adaptmg.solver.active_set import ActiveSet
from adaptmg.solver.convergence import Convergence
from adaptmg.solver.fallback import Fallback
from adaptmg.solver.run import Outcome, Run
from adaptmg.solver.status import Status
from adaptmg.solver.truncated_watch import TruncatedWatch

if TYPE_CHECKING:
    from adaptmg.solver.multigrid import Multigrid

__all__ = ["TruncatedMachine"]

_LOG = logging.getLogger(__name__)


class TruncatedMachine:
    """One run of the truncated multigrid.

    Parameters
    ----------
    options : Multigrid
        With :class:`~adaptmg.multigrid.Truncated` as correction.
    hierarchy : Hierarchy
    run : Run

    Attributes
    ----------
    nbytes : int
        Memory of the arrays of the solver on all levels, with the contact data of the level last worked on.
    """

    #: complete nested starts stop after so many cycles on a level
    COMPLETE_LIMIT = 60
    #: natural residual, relative, above which a nested start is not left to Newton cycles nor to the next level
    TRUSTED = 0.1
    #: times that safe cycles are tried when the residual stops falling
    TROUBLES = 1
    #: times that an iterate which meets the test is held against its certificate
    DOUBTS = 3
    #: of the diagonal, added to a coarsest matrix that the active set method is to solve
    SHIFT = 1e-9

    def __init__(self, options: Multigrid, hierarchy: Hierarchy, run: Run) -> None:
        self.options, self.hierarchy, self.run = options, hierarchy, run
        self.nbytes = 0
        with run.phase("setup"):
            prolongations = nodal_prolongations(hierarchy)
            levels = galerkin_levels(hierarchy, prolongations)
            self.cycle = LinearCycle(levels, prolongations, run, options.correction.sweeps(levels),
                                     options.correction.coarse_solve, options.correction.coarse_smoother)
        self.problems: list[DiscreteProblem | None] = [level.discrete for level in hierarchy.levels]

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

    def finish(self, unknowns: np.ndarray, cold: bool) -> Outcome:
        """Cycles on the finest level.

        Parameters
        ----------
        unknowns : (n_dofs,) array
            Start, Cartesian, from the prescribed values.
        cold : bool
            Whether the contact status of the start means nothing.
        """
        number = len(self.hierarchy) - 1
        start = unknowns.copy() if self.options.rtol == "discretisation" else None
        runner = self._runner(number, unknowns)
        with self.run.phase("cycles"):
            watch = TruncatedWatch(self.problems[-1], self.options.rtol, self.run)
            status, cycles = self._cycles(runner, watch, cold, self.options.max_cycles, start)
        displacement = (runner.unknowns + self.problems[-1].fixed_values).reshape(-1, self.problems[-1].dim)
        outcome = Outcome(displacement, status, cycles, watch.rtol, watch.error_estimate, watch.rate)
        failed = status in (Status.STALLED, Status.DIVERGED) and not watch.at_rounding(runner.rounding())
        if failed and cycles < self.options.max_cycles and watch.rtol > 0:
            better = watch.residual < watch.residuals[0] and not watch.diverged
            return Fallback(self.options, self.hierarchy, self.run, watch.rtol).finish(outcome, better)
        return outcome

    def _falls_short(self, runner: TruncatedStep, watch: TruncatedWatch) -> bool:
        """Whether an iterate that meets the test is further off than the watch thinks, which then thinks worse."""
        if watch.run is None or watch.doubts >= self.DOUBTS or watch.at_rounding(runner.rounding()):
            return False
        ratio = self.run.shortfall(runner.unknowns + self.problems[-1].fixed_values, watch.rtol)
        watch.doubt(ratio)
        return ratio > 0.0

    @property
    def _may_hand_over(self) -> bool:
        """Whether the active set method can go on where cycles are slow: see :class:`Fallback`."""
        problem = self.problems[-1]
        return problem.n_dofs <= Fallback.FACTORISED[problem.dim]

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
        contact, load = TruncatedContact.of(problem, cycle.levels[number]), _load(problem)
        contact.start(unknowns)
        options, interface = self.options.correction, None
        if problem.coupling is not None and options.interface_sweeps:
            interface = Interface(cycle.levels[number], problem.coupling)
        return TruncatedStep(cycle, number, contact, load, unknowns, options.recombine,
                              RigidMotions.of(problem, contact, load), interface, options.interface_sweeps)

    def _start_cycles(self, runner: TruncatedStep, number: int, start: NestedStart) -> None:
        """The cycles of a nested start on one level."""
        if start.cycles == "complete":
            watch = TruncatedWatch(self.problems[number], start.rtol)
            self._cycles(runner, watch, False, self.COMPLETE_LIMIT, None)
            return
        watch = TruncatedWatch(self.problems[number], 0.0)
        wanted = start.cycles_on(self.problems[number], self.problems[number + 1])
        for cycle in range(max(wanted, self.options.correction.safe_cycles)):
            runner.smooth()
            state = runner.truncate(safe=False, trusted=self.TRUSTED * watch.sizes.forces(runner.unknowns, 0.0))
            watch.check(state.residual, watch.sizes.forces(runner.unknowns, state.reactions), 0.0)
            runner.correct()
            if cycle + 1 >= wanted and watch.residual <= self.TRUSTED:
                return

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
        identity = sparse.csr_array((np.ones(n), np.arange(n, dtype=np.int32), np.arange(n + 1, dtype=np.int32)))
        cycle = LinearCycle([level.copy(), level], [identity], _OnCoarsest(self.run), (1, 1),
                            self.options.correction.coarse_solve)
        runner = self._cycle_on(problem, cycle, 1, np.zeros(problem.n_dofs))
        status, _ = self._cycles(runner, TruncatedWatch(problem, start.rtol), True, self.COMPLETE_LIMIT, None)
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
        grids = Hierarchy.single(replace(problem, matrix=whole, load=_load(problem)))
        try:
            found = ActiveSet(rtol=start.rtol).run(grids, Run(unit=self.run.unit), None)
        except np.linalg.LinAlgError as error:
            _LOG.info("coarsest level: the active set method gives up: %s", error)
            return np.zeros(problem.n_dofs), False
        self.run.count(found.cycles, level.nonzeros)
        self.run.visit(0, "solve", found.cycles)
        return found.displacement.reshape(-1) - problem.fixed_values, found.status.ok

    def _prolonged(self, number: int, unknowns: np.ndarray) -> np.ndarray:
        """Interpolated to the next finer level, prescribed values respected."""
        coarse, fine = self.problems[number], self.problems[number + 1]
        displacement = (unknowns + coarse.fixed_values).reshape(-1, coarse.dim)
        result = (self.cycle.prolongations[number] @ displacement).reshape(-1) - fine.fixed_values
        result[fine.fixed] = 0.0
        return result

    def _cycles(self, runner: TruncatedStep, watch: TruncatedWatch, cold: bool, limit: int,
                start: np.ndarray | None) -> tuple[Status, int]:
        """Cycle until the watch is content.

        Safe cycles are taken while the contact status of a cold start changes, and after trouble; each time at most so
        many, twice as many as the time before.
        """
        cycles, troubles, most = 0, 0, self.options.correction.safe_cycles
        left = most if cold else 0
        while True:
            runner.smooth()
            watch.measure(runner, cycles)
            state = runner.truncate(safe=left > 0)
            left = left - 1 if left > 0 and state.changed else 0
            # an exact start has no rate to measure, and needs none
            floor = runner.rounding() if cycles < 2 or watch.sizes.prescribed else 0.0
            forces = watch.sizes.forces(runner.unknowns, state.reactions)
            idle = watch.sizes.nothing_strains(forces, Convergence.ROUNDING * floor, runner.unknowns)
            met = watch.check(state.residual, forces, floor if cycles < 2 or idle else 0.0, idle)
            watch.record(runner, cycles, state.changed)
            if met and not self._falls_short(runner, watch):
                return Status.CONVERGED, cycles
            if watch.diverged:
                return Status.DIVERGED, cycles
            if watch.stalled:
                return Status.STALLED, cycles
            if cycles >= limit:
                return Status.LIMIT, cycles
            watch.corrected(runner.correct())
            cycles += 1
            if left == 0 and watch.in_trouble():
                troubles += 1
                if troubles > self.TROUBLES:
                    return Status.STALLED, cycles
                most *= 2
                left = most
            if left == 0 and watch.run is not None and self._may_hand_over and watch.too_slow(limit - cycles):
                return Status.STALLED, cycles
            if cycles == 1 and start is not None:
                watch.take_discretisation_error(runner.distance(start))


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


def _load(problem: DiscreteProblem) -> np.ndarray:
    """b - A u_fixed, zero at fixed dofs (n_dofs,), Cartesian."""
    load = problem.load - problem.matrix @ problem.fixed_values if problem.fixed_values.any() else problem.load.copy()
    load[problem.fixed] = 0.0
    return load
