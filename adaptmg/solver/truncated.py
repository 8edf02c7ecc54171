r"""TruncatedRun: the truncated nonsmooth Newton multigrid: nested start, cycles on the finest
level.

Truncated are the options of its parts. TruncatedRun solves the coarsest level by the active set
method, the levels above it by a few cycles each, and the finest to the tolerance. Where that does
not converge (friction of 3, say)
:func:`adaptmg.solver.multigrid.handed_over` gives another method the cycles that are left.

The energy :math:`\eta_k^2 = \tilde r_k \cdot e_k` of the correction that the next coarser level
proposes estimates the error it removes; with the rate :math:`\rho = \eta_k/\eta_{k-1}` (the larger
of the last ratio and the mean of the last three) the error after the next smoothing is
:math:`\rho\,\eta_k`. Together with the natural residual, which every smoothing leaves behind, it
decides when the certificate is asked, without a further pass over a matrix.

Where the contact status is not yet known (from zero, or while corrections are large) a contact
problem on a coarse level comes before the cycle (:mod:`adaptmg.multigrid.truncated_step`), and the
linear correction ends where its first open node closes. Where the residual reaches no new minimum
for a while, the iteration has stalled, and another method takes over."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from typing import Any, cast

import numpy as np

from adaptmg.discrete.coordinates import Coupling, rotate, rotate_back
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.grids import Grids
from adaptmg.multigrid.coarse_obstacles import CoarseObstacles
from adaptmg.multigrid.cycle import NestedStart
from adaptmg.multigrid.linear_cycle import LinearCycle
from adaptmg.multigrid.projected_sweeps import Interface
from adaptmg.multigrid.split_matrix import galerkin_levels, nodal_prolongations
from adaptmg.multigrid.truncated_contact import TruncatedContact, with_fields
from adaptmg.multigrid.truncated_parts import FrameSmoother, Truncated
from adaptmg.multigrid.truncated_step import CoarseContact, TruncatedState, TruncatedStep
from adaptmg.multigrid.volume_pressures import prolonged_pressures
from adaptmg.smoother.system import frames_and_fixed
from adaptmg.solver.active_set import coarsest_solution, coarsest_solution_near
from adaptmg.solver.examine import ROUNDING, Sizes
from adaptmg.solver.iterate import Measured, State, StopTest, iterate, nested_start, true_error
from adaptmg.solver.record import Outcome, Run, Status


class TruncatedTest(StopTest):
    """Judges cycles by the energies of their coarse corrections and their residuals."""

    #: the energy of the coarse correction misses what the smoothing removes: the certificate is asked when SAFETY
    #: times the estimate is below rtol. 198 solves of random problems to 1e-6 take 2185 cycles; at 1, 2178
    #: cycles and 5 % more seconds, as more asks are refused
    SAFETY = 3.0
    #: cycles over which the speed is measured, once there are twice as many: where it does not lead to the tolerance
    #: within the cycles left, another method takes over. 140 solves of random problems to 1e-6 and 96 of hard ones to
    #: 1e-3, 1e-6 and 1e-8 take 1590 and 1088 cycles; at 12, 1625 and 1149; at 4, 1539 and 1032, but
    #: one more is handed over, which costs factors on large meshes
    WINDOW = 8
    #: cycles that cost as much as handing over, over n^(2 - 3/dim), the work of factors of n unknowns over that of a
    #: cycle. Before that another method takes over only where fewer than half of the cycles are left. The CPU of the
    #: active set method over that of a cycle is .03 to .4 times this power in space (375 to 15k unknowns: 30 to 3600
    #: cycles). In the plane it is .5 to 1.2 times the power (578 to 33k: 30 to 210 cycles), but there WINDOW decides
    #: below 25 600 unknowns. In space corrections rest while nodes open one after the other: a ball on a plane (1475
    #: nodes) takes 44 cycles and 2.2 s, not 34 and 5.5. Of 300 solves of random problems 5 are handed over without
    #: this, 4 with 0.05, 3 with 0.1 and 0.2; 2931, 2942, 2943, 2943 cycles
    PRICE = 0.1
    #: share of the discretisation error that may remain with rtol="discretisation": 10 random problems take 29 cycles,
    #: 34 with half, 28 with twice
    SHARE = 0.1
    #: the largest tolerance with rtol="discretisation": a start further off shows no discretisation error. The
    #: largest error of these problems is 6.6e-3, with half 3.8e-3 in 33 cycles, with twice 6.6e-3 in 28
    LARGEST_RTOL = 1e-2

    def __init__(self, method: TruncatedCycles, rtol: float | str, limit: float, run: Run) -> None:
        """Begin a test of the states of a method, at most ``limit`` cycles. An ``rtol`` of
        "discretisation" is known after the first cycle (:meth:`set_discretisation_tolerance`); until
        then it is 0, which no estimate meets."""
        super().__init__(0.0 if isinstance(rtol, str) else rtol, limit, run.shortfall)
        self.method = method
        problem = method.problem
        # scalar problems, of dim 1 in any space, count as plane ones: 96 solves of 24 random ones in space to
        # 1e-6 and 1e-10 take 1485 cycles, with the exponent of space 1575, and none is handed over
        cycles_of_handing_over = self.PRICE * problem.n_dofs ** (2 - 3 / max(problem.dim, 2))
        self._cycles_before_stalling = max(
            2 * self.WINDOW, min(cycles_of_handing_over, 0.5 * limit)
        )
        self.residuals: list[float] = []
        self._first_residual = np.nan

    def judge(self, measured: Measured) -> None:
        """Estimate the error of a state, and remember its residual."""
        if measured.from_start is not None:
            self.set_discretisation_tolerance(measured.from_start)
        super().judge(measured)
        self.residuals.append(self.residual)
        self._first_residual = (
            self._last_residual if len(self.residuals) == 1 else self._first_residual
        )

    def set_discretisation_tolerance(self, change: float) -> None:
        r"""Set rtol from the A-norm of the change of the nested start by the first cycle. By
        orthogonality and an error that halves with the mesh size, :math:`|u - u_h| = |u_h -
        u_{2h}|/\sqrt 3`; a tenth of it is the tolerance."""
        if self.size > 0:
            self.rtol = min(self.SHARE * change / np.sqrt(3.0) / self.size, self.LARGEST_RTOL)

    def at_rest(self) -> bool:
        """Return whether the last residual is as small as arithmetic allows."""
        floor = self.method.parts.rounding(self.state)  # the norm of D u, the terms that it sums
        return self.residual_within(ROUNDING * floor, self.ROUNDING_LIMIT)

    @property
    def residual_met(self) -> bool:
        return super().residual_met or self.at_rest()

    @property
    def better(self) -> bool:
        """Return whether the last iterate has a smaller residual than the first one."""
        return self.residual < self.residuals[0] and not self.diverged

    @property
    def stalled(self) -> bool:
        """Return whether, as fast as the last cycles went, the tolerance is not reached in the
        cycles that are left. (The last ratio alone says nothing: recombined corrections fall
        unevenly.)"""
        if self.cycles < self._cycles_before_stalling or not (self.rtol > 0 and self.size > 0):
            return False
        before = max(self.residuals[-1 - self.WINDOW], np.finfo(float).tiny)
        rate = (max(self.residual, np.finfo(float).tiny) / before) ** (1 / self.WINDOW)
        # by how much residual and error exceed what the tolerance allows: excess rate^left > 1
        excess = self.residual / (self.RESIDUAL_FACTOR * self.rtol)
        excess = max(excess, self._remaining(rate) / self.rtol, 1.0)
        return bool(np.log(excess) > (self.limit - self.cycles) * -np.log(rate))

    def shortfall(self) -> float | None:
        """Ask the certificate as :class:`~adaptmg.solver.iterate.StopTest` does; 0 where no iterate can
        be better."""
        if self.at_rest():
            return 0.0
        # mostly the certificate accepts, and no further cycle needs what is set aside
        self.state = self.method.set_aside(self.state)
        solution = self.method.problem.with_prescribed(self.state.iterate)
        return self.method.run.shortfall(solution, self.rtol)

    def _estimate(self) -> float:
        """Return the relative error after the last smoothing, from the energy of the last coarse
        correction and the rate; infinite if corrections do not fall. A correction at
        rounding, as where nearly all nodes are held, has no rate: there the residual stands for the
        error."""
        if self.size > 0 and self.change <= self.ROUNDING_LEVEL:
            # eight square bars of 16 to 128 cells a side that yield all but at their diagonals take 109
            # cycles, at half and twice, too, and 177 without; 24 other solves the same with all of these
            return self.residual
        rate = self.safe_rate
        if not (self.size > 0 and rate < 1):
            return np.inf
        return self._remaining(rate)

    def _remaining(self, rate: float) -> float:
        """Return the error that remains, relative, if corrections fall by ``rate``."""
        return self.SAFETY * self.changes[-1] * rate / self.size  # rho eta_k

    def _ran_away(self) -> bool:
        """Return whether the residual, in N, is a million times the first one (at least 1e-300 N, so
        that rounding after a first one of zero runs away). The relative residual stays small where
        reactions grow with it."""
        return self._last_residual > 1e6 * max(self._first_residual, 1e-300)


class TruncatedCycles:
    """Cycles on the finest level, each perhaps after a contact problem on a coarse level, and norms of
    their states.

    ``origin`` names the start: "zero", "nested" or "given". ``coarse`` returns the coarse contact
    problem. ``nested`` is the nested start (n_unknowns,) if ``rtol="discretisation"``, which is
    measured from it, else None."""

    #: coarse contact problems in a solve at most; a state counts them as its ``moves``
    MOVES = 8
    #: the linear correction, relative, above which there is one: at 0.01 12 of 206 cycles more on ten hard cases,
    #: without contact problems 99 more
    LARGE = 0.05

    def __init__(
        self,
        parts: TruncatedStep,
        problem: DiscreteProblem,
        origin: str,
        coarse: Callable[[], CoarseContact | CoarseObstacles] | None,
        run: Run,
        nested: np.ndarray | None,
    ) -> None:
        """Prepare cycles with the steps ``parts`` of the level of a problem."""
        self.parts = parts
        self.problem = problem
        self.origin = origin
        self.coarse = coarse
        self.run = run
        self.nested = nested
        self.sizes = Sizes(problem)

    def begin(self, iterate: np.ndarray) -> TruncatedState:
        """Return the state of a start (n_unknowns,), which is made admissible in place.

        At the begin of a solve, except from a given start, and after a coarse contact problem the
        contact status is uncertain: a whole correction may carry open nodes through the obstacle. The
        next correction then ends where the first of them closes, if it is larger than LARGE: with small
        ones shortened, too, 6 of 354 solves of random bodies and 3 of 6 meshes of a loop take a cycle
        more, none fewer. Without this 12 of 96 solves of beams from 5 : 1 to 50 : 1 are handed over that
        otherwise converge; 90 solves of random bodies in the plane take 417 cycles with a fifth and
        half of LARGE, too."""
        is_uncertain = self.coarse is not None and self.origin != "given"
        return with_fields(
            self.parts.begin(iterate), shorten_above=self.LARGE if is_uncertain else np.inf
        )

    def step(self, state: TruncatedState) -> TruncatedState:
        """Return the state after a correction (of a start there is none), perhaps a coarse contact
        problem, smoothing and linearisation."""
        parts = self.parts
        new = parts.correct(state)
        if new.cycles == 1 and self.nested is not None:
            nested = self.nested[: parts.matrix.n_dofs]
            new = with_fields(new, from_start=parts.distance(parts.displacement(new), nested))
        if self.coarse is not None and self._seeks_status(new):
            new = self._after_coarse_contact(new, self.coarse())
        # Sizes are measured every fourth cycle and after a coarse contact problem, but every cycle
        # with prescribed displacements, into which the iterate has to grow.
        measured = new.cycles % 4 == 0 or new.moves > state.moves or self.sizes.prescribed
        return parts.linearise(parts.smooth(new), norm=self.sizes.norm if measured else None)

    def _after_coarse_contact(
        self, state: TruncatedState, coarse_contact: CoarseContact | CoarseObstacles
    ) -> TruncatedState:
        """Return the state after smoothing and a coarse contact problem; the same state, without
        smoothing, where no coarse level serves, which is then not asked again.

        A problem whose solution is refused, which returns its argument, counts in ``moves``, too. After
        any other the next linear correction ends where its first open node closes
        (``shorten_above``)."""
        if coarse_contact.number is None:
            self.coarse = None
            return state
        smoothed = self.parts.smooth(state)
        moved = coarse_contact(smoothed)
        shorten_above = np.inf if moved is smoothed else 0.0
        return with_fields(moved, moves=state.moves + 1, shorten_above=shorten_above)

    def _seeks_status(self, state: TruncatedState) -> bool:
        """Return whether the contact status is too uncertain to go on without a coarse contact
        problem."""
        if state.moves >= self.MOVES:
            return False
        if not state.cycles:
            return self.origin == "zero"
        # after a nested start the first cycles settle most statuses by themselves
        change = float(np.sqrt(abs(state.correction)))  # eta_k
        return (change / state.size if state.size > 0 else change) > self.LARGE

    def measure(self, state: TruncatedState) -> Measured:
        """Return the norms of the state after its smoothing."""
        sizes = self.sizes
        unknowns = self.parts.displacement(state)
        columns = {"status_changes": float(state.changed)}
        # |D u| is computed where it decides: before the second cycle, when no rate is known and an
        # exact start is recognised by rounding alone; and where supports that move bodies may exert
        # no force at all. Later the state has 0 there: at_rest computes it where the test needs it.
        early = state.cycles < 2
        floor = self.parts.rounding(state) if early or sizes.prescribed else 0.0
        idle = sizes.nothing_strains(state.reactions, ROUNDING * floor, unknowns)
        if self.run.reference is not None:
            error = unknowns - self.problem.from_prescribed(self.run.reference)
            columns["true_error"] = true_error(error, self.problem.matrix, self.problem, self.run)
        return Measured(
            cycles=state.cycles,
            residual=state.natural,
            forces=sizes.forces(unknowns, state.reactions),
            size=state.size,
            floor=floor if early or idle else 0.0,
            idle=idle,
            change=float(np.sqrt(abs(state.correction))) if state.cycles else None,
            from_start=state.from_start,
            columns=columns,
        )

    def set_aside(self, state: TruncatedState) -> TruncatedState:
        """Free what only further steps read, if it is much: half of the matrix, which is made again
        from the whole one, and past iterates, without which recombination starts again."""
        large = self.parts.matrix.set_aside(self.problem.decoupled_rows, self.problem.fixed)
        return with_fields(state, past=()) if large else state


_LOG = logging.getLogger(__name__)


class TruncatedRun:
    """One run of the truncated multigrid; options as of :class:`adaptmg.Multigrid`."""

    #: times the least residual on a level of the nested start beyond which its cycles diverge, and are rejected
    RUNAWAY = 10.0
    #: cycles at most after which a level of the nested start is trusted
    START_CYCLES = 20
    #: natural residual, relative, above which a start is not believed: at 0.02 one of 116 results was at 1.2
    #: times its tolerance
    TRUSTED = 0.1

    def __init__(
        self,
        parts: Truncated,
        hierarchy: Grids,
        run: Run,
        rtol: float | str,
        max_cycles: int,
        keeps: bool = False,
    ) -> None:
        """Set up the levels and the linear cycle; ``keeps``: steps on them serve several loads."""
        self.parts = parts
        self.hierarchy = hierarchy
        self.run = run
        self.rtol = rtol
        self.max_cycles = max_cycles
        with run.phase("setup"):
            prolongations = nodal_prolongations(hierarchy)
            levels = galerkin_levels(hierarchy, prolongations)
            self.cycle = LinearCycle(
                levels,
                prolongations,
                recorder=run,
                sweeps=parts.sweeps(levels),
                coarse_solve=parts.coarse_solve,
                coarse_smoother=parts.coarse_smoother,
                correct=parts.correct,
            )
        # Any: None on coarse spaces, whose problems nothing reads
        self.problems: list[DiscreteProblem | Any] = [
            level.discrete_or_none for level in hierarchy.levels
        ]
        self._coarse: CoarseContact | CoarseObstacles | None = None
        self._keeps = keeps
        self._steps: dict[int, TruncatedStep] = {}

    def pose(self, hierarchy: Grids, run: Run) -> None:
        """Replace the hierarchy by one that differs only in loads, prescribed values, gaps and slip
        references. Steps that are set up stay if the run ``keeps`` them; data that solves leave in
        coarse factors is dropped, so that a path that is resumed has the same bits."""
        self.hierarchy = hierarchy
        self.run = run
        self.cycle.recorder = run
        self.problems = [level.discrete_or_none for level in hierarchy.levels]
        self.cycle.factors.forget()
        with run.phase("setup"):
            for number, step in self._steps.items():
                step.restore()
                step.pose(self.problems[number])

    def from_given(self, start: np.ndarray | None) -> Outcome:
        """Solve from a solution (n_unknowns,), or from zero (None)."""
        problem = self.problems[-1]
        return self.finish(
            np.zeros(problem.n_unknowns) if start is None else problem.from_prescribed(start),
            "zero" if start is None else "given",
        )

    def from_nested(self, start: NestedStart) -> Outcome:
        """Solve from a nested start."""
        problem = self.problems[-1]
        return self.finish(problem.from_prescribed(self.nested_start(start)[-1]), "nested")

    def cycle_of_states(self) -> Callable[[State], State]:
        """Return a function that takes a state on the finest level through a cycle; a start is only
        smoothed."""
        problem = self.problems[-1]
        problem.need_no_volumes("a step from state to state")
        parts = self.steps_on(len(self.hierarchy) - 1)
        frames, _ = frames_and_fixed(problem)
        nodes = problem.contact.nodes

        def cycle(state: State) -> State:
            before = state.memory or parts.begin(rotate_back(state.unknowns, frames, nodes))
            new = parts.step(before)
            return State(unknowns=rotate(new.iterate, frames, nodes), memory=new)

        return cycle

    def nested_start(
        self, start: NestedStart, past: list[np.ndarray] | None = None
    ) -> list[np.ndarray]:
        """Solve level by level from the coarsest; returns the solutions (n_unknowns,) of the
        levels, on the finest one its start. ``past``: displacements (n_dofs,) of the levels in the last
        load step, whose change is then interpolated from level to level."""
        self.hierarchy.need_discretised("the nested start of FullMultigrid")
        return nested_start(
            self.run,
            len(self.hierarchy),
            partial(self._coarsest, start, past),
            partial(self._prolonged, past),
            partial(self._start_cycles, start),
        )

    def _prolonged(
        self, past: list[np.ndarray] | None, number: int, solutions: list[np.ndarray]
    ) -> list[np.ndarray]:
        """Return the solutions (n_unknowns,) of the levels below ``number``, and the interpolated start
        of level ``number``. ``past``: displacements (n_dofs,) of the levels in the last load step."""
        coarse = self.problems[number - 1]
        fine = self.problems[number]
        fine_level = self.cycle.levels[number]
        # what is prolonged is the change since the last load step, or else the whole solution with a
        # share of its change since the level below
        change, pressures = coarse.parts(solutions[-1])
        start = np.zeros(fine.n_unknowns)
        displacement, prolonged = fine.parts(start)
        extrapolated_share = self._extrapolation(number - 1)
        if past is not None:
            displacement[:] = past[number]
            change = change - past[number - 1]
        elif extrapolated_share > 0:
            prolonged_before = np.zeros(coarse.n_dofs)
            coarser_solution, _ = self.problems[number - 2].parts(solutions[-2])
            self.cycle.levels[number - 1].prolong(coarser_solution, prolonged_before)
            change = change + extrapolated_share * (change - prolonged_before)
        fine_level.prolong(change, displacement)
        prolonged[:] = prolonged_pressures(coarse, fine, fine_level.prolongation, pressures)
        # admissible at fixed dofs
        return [*solutions, fine.with_prescribed(fine.from_prescribed(start))]

    def _extrapolation(self, number: int) -> float:
        """Return the share of its change to level ``number`` by which the solution will change on the
        next level, by Richardson: discretisation errors fall like 1/n on uniform plane grids of n
        nodes. 0 on other meshes."""
        levels = self.hierarchy.levels[number - 1 : number + 2] if number > 0 else ()
        meshes = [level.mesh for level in levels]
        if len(meshes) < 3 or not all(
            mesh is not None and mesh.dim == 2 and mesh.lattices for mesh in meshes
        ):
            return 0.0
        before, middle, after = (1 / mesh.n_nodes for mesh in meshes if mesh is not None)
        # u_h = u + c / n on the three levels
        return (middle - after) / (before - middle)

    def finish(self, start: np.ndarray, origin: str) -> Outcome:
        """Cycle on the finest level from an iterate (n_unknowns,), which comes from "zero", a
        "nested" start or is "given"."""
        problem = self.problems[-1]
        nested = start.copy() if self.rtol == "discretisation" else None
        parts = self.steps_on(len(self.hierarchy) - 1)
        takes_coarse_contact = len(problem.contact) and self.parts.coarse_contact
        coarse = partial(self._coarse_contact, parts) if takes_coarse_contact else None
        cycles = TruncatedCycles(
            parts, problem, origin=origin, coarse=coarse, run=self.run, nested=nested
        )
        stop = TruncatedTest(cycles, self.rtol, self.max_cycles, self.run)
        with self.run.phase("cycles"):
            # no variable refers to the start and the first state, whose long vectors limit the size of a
            # problem
            begun = [cycles.begin(start)]
            del start
            state, status = iterate(
                cycles.step, cycles.measure, cycles.step(begun.pop()), stop, self.run
            )
        # another method takes over, but neither where the residual is rounding nor where the tolerance,
        # that of the discretisation, is not known yet
        failed = (
            status in (Status.STALLED, Status.DIVERGED) and stop.rtol > 0 and not stop.at_rest()
        )
        return Outcome(
            solution=problem.with_prescribed(state.iterate),
            status=status,
            cycles=stop.cycles,
            rtol=stop.rtol,
            error_estimate=stop.error_estimate,
            rate=stop.rate,
            left=self.max_cycles - stop.cycles if failed else 0,
            better=stop.better,
        )

    def steps_on(self, number: int) -> TruncatedStep:
        """Return the steps on level ``number``, made if they are not kept. Those of the finest level
        free diagonal blocks that nothing reads any more."""
        if number in self._steps:
            return self._steps[number]
        with self.run.phase("setup"):
            problem = self.problems[number]
            parts = self.parts
            levels = [level.matrix for level in self.cycle.levels]
            contact = TruncatedContact.of(problem, levels[number])
            interface = (
                Interface(levels[number], cast("Coupling", problem.coupling), problem.fixed)
                if problem.between_bodies and parts.interface_sweeps
                else None
            )
            smoother = (
                None
                if isinstance(parts.smooth, int)
                else FrameSmoother(parts.smooth, problem, levels[number])
            )
            is_finest = number == len(levels) - 1
            if is_finest:
                # only contact and smoother read it: the finest matrix is never truncated
                levels[number].drop_diagonal()
            step = TruncatedStep(
                self.cycle,
                number,
                problem,
                contact,
                options=parts,
                interface=interface,
                smoother=smoother,
            )
            if is_finest and not self.cycle.reads_diagonals and problem.dim > 1:
                # the truncation has read those of coarse levels. The coarsest level is factorised
                # with its own, and a coarse contact problem reads those of a small level, of scalar
                # problems those of all levels.
                for level in levels[1:-1]:
                    if level.n_dofs > CoarseContact.MOST:
                        level.drop_diagonal()
            if self._keeps:
                self._steps[number] = step
            return step

    def _coarse_contact(self, step: TruncatedStep) -> CoarseContact | CoarseObstacles:
        """Return the coarse contact problem of the finest level, made when it is first needed."""
        if self._coarse is None or self._coarse.step is not step:
            coordinates = [
                None if problem is None else problem.coordinates for problem in self.problems
            ]
            scalar = step.contact.dim == 1
            self._coarse = CoarseObstacles(step) if scalar else CoarseContact(step, coordinates)
        return self._coarse

    def _coarsest(self, start: NestedStart, past: list[np.ndarray] | None) -> list[np.ndarray]:
        """Return the solution (n_unknowns,) of the coarsest level, in a list for those of the levels above
        it, by semismooth Newton steps, in a load path from the last step (``past``: displacements of the
        levels). Factorisations count as seconds. Where the method fails the solution is zero but for
        prescribed values."""
        problem = self.problems[0]
        near = None if past is None or not past[0].any() else past[0]
        try:
            solution, steps, passes = (
                coarsest_solution(problem, start.rtol)
                if near is None
                else coarsest_solution_near(problem, start.rtol, near)
            )
        except (np.linalg.LinAlgError, ValueError, MemoryError) as error:
            _LOG.info("coarsest level: the active set method gives up: %s", error)
            return [problem.with_prescribed(np.zeros(problem.n_unknowns))]
        self.run.count(passes, problem.rows.nonzeros)
        self.run.visit(0, "solve", steps)
        return [solution]

    def _start_cycles(
        self, start: NestedStart, number: int, solutions: list[np.ndarray]
    ) -> list[np.ndarray]:
        """Return the solutions (n_unknowns,) of the levels up to ``number``, that of ``number`` after the
        cycles of the nested start, or unchanged if these diverge."""
        parts = self.steps_on(number)
        problem = self.problems[number]
        *below, prolonged = solutions
        state = parts.begin(problem.from_prescribed(prolonged))
        state = self._few_cycles(parts, problem, state, start.cycles)
        # the cycles of finer levels go through the same coarse matrices, which these have truncated
        parts.restore()
        if state is None:
            _LOG.info("level %d: the cycles of the nested start diverge", number)
            return solutions
        return [*below, problem.with_prescribed(state.iterate)]

    def _few_cycles(
        self,
        parts: TruncatedStep,
        problem: DiscreteProblem,
        state: TruncatedState,
        least_cycles: int,
    ) -> TruncatedState | None:
        """Return the state after ``least_cycles`` cycles, or more until its residual is small enough
        for the next level to take over; None if they diverge, to a residual that is neither near the
        least one nor small. The state has had one correction more: the smoothing after it takes place
        on the next level."""
        sizes = Sizes(problem)

        def trust_limit(unknowns: np.ndarray, reactions: float = 0.0) -> float:
            """Return the natural residual, N, up to which a state with these unknowns (n_dofs,) is trusted."""
            return self.TRUSTED * sizes.forces(unknowns, reactions)

        least_residual = np.inf
        for cycle in range(max(least_cycles, self.START_CYCLES)):
            smoothed = parts.smooth(parts.correct(state))
            state = parts.linearise(smoothed, trusted=trust_limit)
            is_trusted = state.natural <= trust_limit(parts.displacement(state), state.reactions)
            least_residual = min(least_residual, state.natural)
            if state.natural > self.RUNAWAY * least_residual and not is_trusted:
                return None
            if cycle + 1 >= least_cycles and is_trusted:
                break
        return parts.correct(state)
