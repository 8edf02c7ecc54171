"""ActiveSet: the semismooth Newton method, from a given start or from an interior point.

A step decides the status of every contact node and linearises its conditions
(:mod:`adaptmg.smoother.conditions`); the equations are solved on the dense Schur complement of the
contact dofs or on the sparse matrix. Their right-hand side is the residual of the full matrix, so
that every step is one of iterative refinement, too."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, cast

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.coordinates import rotate
from adaptmg.discrete.elasticity import dofs_of
from adaptmg.discrete.problem import DiscreteProblem, remembered
from adaptmg.grids import Grids
from adaptmg.multigrid.volume_pressures import Augmented, augmented_problem
from adaptmg.smoother.conditions import Linearised, hold_all, linearise
from adaptmg.smoother.factorisation import Condensed, condense_problem
from adaptmg.smoother.interior_point import Interior, Span, interior_point
from adaptmg.smoother.linear import Direct, LinearSolution, LinearSolver, Prepared, solution_of
from adaptmg.smoother.system import LocalProblem, local_system
from adaptmg.solver.iterate import Measure, Measured, StopTest, iterate
from adaptmg.solver.record import Outcome, Run, Status
from adaptmg.transfer.galerkin import without_fixed

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ActiveSet(checks.Checked):
    """Semismooth Newton (active set) method on the finest grid; see
    :mod:`adaptmg.solver.active_set`.

    Parameters
    ----------
    linear : Direct, AMG or user-defined
        Solver of the linear steps.
    condensed : bool, optional
        Take the steps on the Schur complement of the contact dofs, with one factorisation in all.
        Default: with ``Direct()``.
    start : {"interior", "held"}, optional
        Where steps without a given start begin: at the solution of an interior point method, or
        with all nodes touching and, under friction, sticking. Default: "interior" where the steps
        are condensed; otherwise an interior point costs as many linear solves as all the Newton
        steps that it saves.
    rtol : float
        For the relative A-norm of the last Newton step (ten times that while the contact status
        changes), which bounds the error of the iterate before it, and, times 10, for the relative
        natural residual. Where initial strains act, relative to u without what expands freely.
    max_steps : int
        Steps at most, in all solves. In a step of a load path that finds motions of
        :class:`adaptmg.Rigid` obstacles or :class:`adaptmg.Preload` no contact problem begins after
        ``max_steps`` Newton steps in all of them together: the step takes less than twice that number,
        and the Newton steps that tighten a bolt until it pulls.
    nested_start : bool
        Solve on the coarser levels first, each from the solution of the level below.

    Notes
    -----
    The interior point method (:mod:`adaptmg.smoother.interior_point`) finds the contact status in 5
    to 20 steps on the bodies that were tried, slender and folded ones among them. Where a status
    comes back in the Newton steps after it, or from a given start, or leaves a motion free, they
    begin again from an interior point, with a smaller tolerance each time. Steps of both kinds
    count. Problems of up to 10 000 dofs (in 3D 3000) remember their factors, and share them with
    those that differ in load, gaps or friction alone. Smoothed elements with Poisson's ratios above
    .499 take several solves with the same factors (:mod:`adaptmg.multigrid.volume_pressures`);
    above .4 the matrix has 2 to 3 times the entries.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.solve(grids, am.ActiveSet(linear=am.Direct())).status.name
    'CONVERGED'
    """

    #: a given start is one on the finest level, which no nested start precedes
    reads_coarse_starts: ClassVar[bool] = False

    linear: Annotated[
        LinearSolver,
        partial(checks.offers, method="setup", words="Direct(), AMG(...) or offer setup()"),
    ] = field(default_factory=Direct)
    condensed: checks.Flag | None = None
    start: Literal["interior", "held"] | None = None
    rtol: checks.Tolerance = 1e-10
    max_steps: checks.Count = 200
    nested_start: checks.Flag = False

    def __post_init__(self) -> None:
        """Check the options, and fill in the defaults that depend on others."""
        super().__post_init__()
        if self.condensed is None:
            object.__setattr__(self, "condensed", isinstance(self.linear, Direct))
        if self.condensed and not isinstance(self.linear, Direct):
            raise ValueError("condensed=True needs linear=Direct(), got another linear solver")
        if self.start is None:
            object.__setattr__(self, "start", "interior" if self.condensed else "held")

    def run(self, hierarchy: Grids, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level, with ``nested_start`` first on the levels below it, from a
        start (n_unknowns,) or as ``start`` of the method says."""
        finest = len(hierarchy) - 1
        coarsest = finest
        if self.nested_start and start is None:
            hierarchy.need_discretised("the nested start of ActiveSet")
            hierarchy.finest.discrete.need_no_volumes("the nested start of ActiveSet")
            coarsest = 0
        outcome = self._solved(
            hierarchy[coarsest].discrete, coarsest, start, run, coarsest == finest
        )
        for number in range(coarsest + 1, finest + 1):
            level = hierarchy[number]
            # the solution of the level below, interpolated
            nodal = outcome.solution.reshape(-1, level.discrete.dim)
            start = (level.prolongation @ nodal).reshape(-1)
            run.visit(number, "start")
            outcome = self._solved(level.discrete, number, start, run, number == finest)
        return outcome

    def _equations(
        self, problem: DiscreteProblem, run: Run, lenient: bool = False
    ) -> Condensed | SparseEquations:
        """Return the linear equations of the steps of a problem; ``lenient``: the matrix may be
        singular."""
        if self.condensed:
            return condense_problem(problem, lenient)
        return SparseEquations(local_system(problem), self.linear, run)

    def _solved(
        self,
        problem: DiscreteProblem,
        number: int,
        start: np.ndarray | None,
        run: Run,
        is_finest: bool,
    ) -> Outcome:
        r"""Solve the problem of level ``number`` from a start (n_unknowns,), if there is one, by one
        factorisation and with volumes perhaps several solves.

        With the symbols of :mod:`adaptmg.multigrid.volume_pressures`, a solve that begins with the
        pressures p_0 finds a displacement u of a problem without volumes, and leaves the pressures
        :math:`p = (1 - \tilde\kappa/\kappa)\,p_0 + \tilde\kappa\,b\,u`. One solve is exact where
        :math:`\tilde\kappa = \kappa`. Otherwise the last solve, which the certificate confirms, is the
        one whose start fulfils :math:`|b\,u - p_0/\kappa| \le rtol\,|p_0|/(\lambda_1 + \mu)`, or the
        ``Augmented.MOST``-th one."""
        if self.condensed:
            # three dense matrices of 8 bytes an entry: that of the contact dofs, its copy with the
            # conditions of a step, and the factors of the copy
            entries = (problem.dim * len(problem.contact)) ** 2
            content = "the dense matrix of the contact nodes (condensed=False does without)"
            checks.fits("condensed", 24.0 * entries, content)
        displacement: np.ndarray | Any = None
        pressures = np.zeros(len(problem.volumes))
        if start is not None:
            displacement, pressures = problem.parts(start)
        cycles = 0
        first_cycle = run.first_cycle
        past_pressures: list[tuple[np.ndarray, np.ndarray]] = []
        augmented = augmented_problem(problem, pressures)
        with run.phase("factorise" if self.condensed else "setup"):
            linear = self._equations(augmented.problem, run)
        for solve in range(Augmented.MOST):
            # before the first solve the start may be a given one, which was solved for another load
            volumes_met = solve > 0 and augmented.missed(displacement) <= self.rtol
            is_last = augmented.exact or volumes_met or solve == Augmented.MOST - 1
            newton = _Newton(
                options=self,
                linear=linear,
                run=run,
                level=number,
                start=displacement,
                most=self.max_steps - cycles,
                finest=is_finest,
                whole=augmented.whole,
            )
            # a solve counts its steps from zero, the history those of all solves together
            run.first_cycle = first_cycle + cycles
            state, status, stop = newton.solve(certified=is_finest and is_last)
            cycles += state.cycles
            displacement = newton.local.to_cartesian(state.unknowns)
            pressures = augmented.pressures(displacement)
            if is_last:
                break
            if cycles >= self.max_steps:
                status = Status.LIMIT
                break
            pressures = augmented.accelerated(pressures, past_pressures)
            augmented = Augmented(problem, pressures)
            linear = linear.posing(augmented.problem)
        run.first_cycle = first_cycle
        solution = np.append(displacement, pressures)
        return Outcome(solution, status, cycles, self.rtol, stop.error_estimate, stop.rate)


class _NewtonTest(StopTest):
    """The last step bounds the error of the iterate before it. Every step refines, so that a residual
    at rounding does not replace this bound."""

    def judge(self, state: Measured) -> None:
        """Judge a state as other tests do; then replace the estimate of the error, which comes from a
        rate or from a residual at rounding, by the last step: ``change`` is ||w_k - w_(k-1)||_A over
        ``size`` = ||u||_A. The certificate multiplies it by the factor by which it found an earlier
        one too small."""
        super().judge(state)
        if self.met and self.error_estimate == 0.0:
            return  # the residual is zero, since nothing strains the bodies
        if not self.changes:  # no step comes before the first state
            self.error_estimate = np.inf
        elif self.size > 0:
            self.error_estimate = self._caution * self.change
        else:  # of u = 0, to which no step is small
            self.error_estimate = 0.0 if self.changes[-1] == 0 else np.inf
        self.met = self._small_enough()


class _CoarsestTest(_NewtonTest):
    """After a step a small natural residual suffices, too: the start that comes from a coarsest solution
    needs no bound of its error. This spares the step that only shows that the one before it was the
    last: 20 load steps with 4225 nodes take 21 Newton steps in place of 40."""

    def judge(self, state: Measured) -> None:
        super().judge(state)
        self.met = self.met or (bool(self.changes) and self.residual <= self.rtol)


@dataclass(frozen=True, eq=False, kw_only=True)
class _NewtonState:
    """An iterate, and the contact status that it decides."""

    unknowns: np.ndarray  # (n_dofs,), local
    # the next three are None at a start; Any, since they are read only after it
    residual: np.ndarray | Any = None  # (n_dofs,): b - A w
    step_data: np.ndarray | Any = None  # (n_dofs,): for the linear step; see contact_residual
    equations: Linearised | Any = None
    cycles: int = 0
    # contact statuses since the last interior point or the start: all of them, and the last one
    past_keys: frozenset[bytes] = frozenset()
    last_key: bytes = b""
    steps_since_interior: int = 0
    tolerances: tuple[float, ...] = ()  # of the interior points that may still follow
    gives_up: Status | None = None


class _Newton:
    """The Newton steps on one level."""

    #: tolerances of the interior point method: the next one is taken when the Newton steps return to an earlier status.
    #: With a hundredth 24 of 119 solves, paths and loops change, with a hundred times 21 (campaign constants)
    TOLERANCES = (1e-9, 1e-12, 1e-15)
    #: steps of the interior point method, at most
    MOST = 60
    #: Newton steps after which the iteration counts as repeating itself: in 3D the direction of a slip may rotate
    #: without end while no status returns
    LONG = 15
    #: augmentation c over the diagonal of the matrix: it weighs gaps against forces where a status is decided: 156
    #: solves take 1195 cycles and steps; 1246 at .001, 1237 at 1, 1299 at 1000
    FACTOR = 0.1

    def __init__(
        self,
        options: ActiveSet,
        linear: Condensed | SparseEquations,
        run: Run,
        level: int,
        start: np.ndarray | None,
        most: int,
        finest: bool = False,
        whole: Callable[[np.ndarray], np.ndarray] = np.asarray,
    ) -> None:
        """Prepare at most ``most`` steps from ``start`` (n_dofs,), Cartesian; without it the option
        ``start`` says where they begin. ``linear`` has the equations of a step, on the contact dofs or
        on all. ``finest``: the run records the steps. ``whole`` makes a solution (n_unknowns,) of the
        posed problem from a displacement (n_dofs,)."""
        self.options = options
        self.linear = linear
        self.local = linear.full
        self.run = run
        self.level = level
        self.most = most
        self.finest = finest
        self.start = start
        self._norms = Measure(self.local, run if finest else None)
        self._whole = whole

    def solve(
        self, certified: bool, test: type[_NewtonTest] = _NewtonTest
    ) -> tuple[_NewtonState, Status, StopTest]:
        """Iterate until a ``test`` ends the iteration. On the finest level the run records the history;
        if ``certified``, the certificate confirms the end."""
        stop = test(
            self.options.rtol,
            self.most,
            self._shortfall if certified else None,
            stalled=None,
        )
        if self.finest and not self.run.history:
            # no step on this level yet: what was counted until here belongs to the nested start
            self.run.start_work_units = self.run.work_units
        unknowns = (
            np.zeros(self.local.system.n_dofs)
            if self.start is None
            else self.local.to_local(self.start)
        )
        state = _NewtonState(unknowns=unknowns, tolerances=self.TOLERANCES)
        begins_inside = self.start is None and self.options.start == "interior"
        if begins_inside and len(self.local.contact.gap):
            state = self._interior(state)
        hold = self.start is None and self.options.start == "held"
        state = self._decided(state, hold)
        run = self.run if self.finest else None
        return *iterate(self.step, self.measure, state, stop, run), stop

    def _shortfall(self, state: _NewtonState, rtol: float) -> float:
        """Let the certificate judge a state; see :meth:`Run.shortfall`."""
        return self.run.shortfall(self._whole(self.local.to_cartesian(state.unknowns)), rtol)

    def measure(self, state: _NewtonState) -> Measured:
        """Return the norms of a state, with the numbers of active and of slipping nodes; of a state
        without equations only the reason."""
        if state.gives_up is not None:
            return Measured(state.cycles, gives_up=state.gives_up)
        active = state.equations.active
        return self._norms(
            state.cycles,
            state.unknowns,
            state.residual,
            active=int(active.sum()),
            slip=int((active & state.equations.slip).sum()),
        )

    def step(self, state: _NewtonState) -> _NewtonState:
        """Return the state after a Newton step. Where a status comes back, the equations are singular, or
        LONG steps have not ended the iteration, return the state at an interior point."""
        key = state.equations.key
        change = None
        # the same status twice in a row is convergence, an earlier one a cycle
        status_returns = key in state.past_keys and key != state.last_key
        if not status_returns and state.steps_since_interior < self.LONG:
            try:
                with self.run.phase("solve"):
                    change = self.linear.newton_change(state.equations, state.step_data)
            except np.linalg.LinAlgError as error:
                _LOG.info("step %d: %s", state.cycles, error)
        if change is None:
            return self._decided(self._interior(state))
        self.run.visit(self.level, "solve")
        return self._decided(
            replace(
                state,
                unknowns=state.unknowns + change,
                cycles=state.cycles + 1,
                past_keys=state.past_keys | {key},
                last_key=key,
                steps_since_interior=state.steps_since_interior + 1,
            )
        )

    def _interior(self, state: _NewtonState) -> _NewtonState:
        """Return the state at the solution that the interior point method finds for the next of the
        tolerances, with no memory of earlier statuses; without contact or tolerances left the state
        gives up."""
        if not len(self.local.contact.gap):
            return replace(state, gives_up=Status.STALLED)  # no contact to be inside of
        if not state.tolerances:
            return replace(state, gives_up=Status.CYCLING)
        tolerance, *later_tolerances = state.tolerances
        with self.run.phase("solve"):
            span, load = self.linear.interior_problem()
        interior = interior_point(
            span,
            load,
            self.local.contact,
            self.linear.stiffness,
            tolerance,
            most=min(self.MOST, self.most - state.cycles),
        )
        _LOG.debug(
            "step %d: an interior point, %.0e, in %d steps",
            state.cycles,
            interior.slack,
            interior.steps,
        )
        self.run.visit(self.level, "solve", interior.steps)
        with self.run.phase("solve"):
            unknowns = self.linear.from_interior(interior)
        return _NewtonState(
            unknowns=unknowns,
            cycles=state.cycles + interior.steps,
            tolerances=tuple(later_tolerances),
        )

    def _decided(self, state: _NewtonState, hold: bool = False) -> _NewtonState:
        """Return the state with its residual and the equations of its contact status; ``hold``: all
        nodes touch and stick. The contact conditions of the problem follow the state, in place: the
        friction of laws that depend on pressure and slip, and the linear law of surface layers."""
        if state.gives_up is not None:
            return state
        system = self.local.system
        contact = self.local.contact
        self.run.count(1.0, system.nonzeros)
        residual = self.local.residual(state.unknowns)
        with self.run.phase("solve"):
            step_data, forces = self.linear.contact_residual(residual)
        at_contact = state.unknowns.reshape(-1, system.dim)[system.nodes]
        contact.follow(at_contact, forces)
        equations = (
            hold_all(contact, at_contact, forces)
            if hold
            else linearise(contact, at_contact, forces, self.linear.stiffness, self.FACTOR)
        )
        return replace(state, residual=residual, step_data=step_data, equations=equations)


class SparseEquations:
    """The linear equations of a problem on its sparse matrix, of which only rows (and eliminated
    columns) of contact nodes change; :class:`~adaptmg.smoother.factorisation.Condensed` has the same
    on its contact dofs. All dofs are the unknowns of the interior point method."""

    #: relative residual to which an iterative linear solver solves each Newton step, and each interior point step:
    #: 6 random problems take 36 cycles and 3127 work units; 35 and 3434 with half, 37 and 2998 with twice
    RTOL = 1e-2

    def __init__(self, local: LocalProblem, linear: LinearSolver, run: Run) -> None:
        """Prepare the equations of a problem in contact frames; ``linear`` solves them."""
        self.full = local
        self.linear = linear
        self.run = run
        self._matrix = local.system.matrix
        self._contact_dofs = dofs_of(local.system.nodes, local.system.dim)
        self._contact_of_row = local.system.contact_of[
            np.repeat(np.arange(local.system.n_nodes), np.diff(self._matrix.indptr))
        ]  # (n_blocks,): number of the contact node in whose row a block lies, or -1
        self._prepared: Prepared | None = None
        self._prepared_for: Linearised | None = None

    def posing(self, problem: DiscreteProblem) -> SparseEquations:
        """Return the equations of a problem with the same structure."""
        return SparseEquations(local_system(problem, self.full.system), self.linear, self.run)

    @property
    def stiffness(self) -> np.ndarray:
        """Return the diagonal (n_contact, dim) of the matrix at the contact nodes, N/m."""
        system = self.full.system
        return self._matrix.diagonal().reshape(-1, system.dim)[system.nodes]

    def contact_residual(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residual (n_dofs,), the right-hand side of :meth:`newton_change`, and its part (n_contact,
        dim) at the contact nodes, which decides their status."""
        return residual, self.values(residual)

    def interior_problem(self) -> tuple[Span, np.ndarray]:
        """Return the unknowns of the interior point method, all dofs, and their load (n_dofs,)."""
        return self, self.full.load

    def from_interior(self, interior: Interior) -> np.ndarray:
        """Return the unknowns (n_dofs,) of a solution of the interior point method."""
        return interior.unknowns

    def newton_change(self, equations: Linearised, residual: np.ndarray) -> np.ndarray:
        """Return the change (n_dofs,) for a residual (n_dofs,); LinAlgError if the equations are
        singular or an iterative linear solver does not converge."""
        system = self.full.system
        # the rows of contact nodes have the equations of their status, with force as right side
        prescribed = np.zeros(system.n_dofs, dtype=bool)
        prescribed[self._contact_dofs] = equations.prescribed.reshape(-1)
        change = np.zeros(system.n_dofs)
        change[self._contact_dofs] = equations.change.reshape(-1)
        rhs = residual.copy()
        rhs[self._contact_dofs] = equations.force.reshape(-1)
        with self.run.phase("setup"):
            matrix = self._contact_rows(equations)
            if change.any():
                # prescribed changes go to the right-hand side
                rhs -= matrix @ change
                self.run.count(1.0, system.nonzeros)
            rhs[prescribed] = 0.0
        self._prepare(equations, matrix, prescribed)
        with self.run.phase("solve"):
            prepared = cast("Prepared", self._prepared)
            solution = self._solution(prepared, rhs, self.RTOL)
        # a direct solution stays above RTOL by rounding alone: there is no better one
        if not solution.converged and not isinstance(self.linear, Direct):
            raise np.linalg.LinAlgError("the Newton step is not solved")
        return solution.unknowns + change

    def product(self, unknowns: np.ndarray) -> np.ndarray:
        """Return A x; this and the next three are those of :class:`Span`, for all dofs."""
        self.run.count(1.0, self.full.system.nonzeros)
        return self._matrix @ unknowns

    def values(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the entries (n_contact, dim) of a vector (n_dofs,) at the contact nodes."""
        return unknowns[self._contact_dofs].reshape(-1, self.full.system.dim)

    def restricted(self, forces: np.ndarray) -> np.ndarray:
        """Return forces (n_contact, dim) as a vector (n_dofs,), zero at fixed dofs."""
        result = np.zeros(self.full.system.n_dofs)
        result[self._contact_dofs] = forces.reshape(-1)
        return np.where(self.full.system.fixed, 0.0, result)

    def factors(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        """Return the solution of equations with A + B as a function of right-hand sides (n_dofs,), B
        with ``blocks`` (n_contact, dim, dim) at contact nodes; None if A + B is singular. The
        preconditioner is made from A + (B + B')/2."""
        system = self.full.system
        matrix = self._matrix.copy()
        free = ~system.fixed.reshape(-1, system.dim)[system.nodes]
        # B at free components, added to the diagonal blocks
        added = np.zeros((system.n_nodes, system.dim, system.dim))
        added[system.nodes] = blocks * free[:, :, None] * free[:, None, :]
        row = np.repeat(np.arange(system.n_nodes), np.diff(matrix.indptr))
        diagonal = row == matrix.indices
        symmetric = matrix.copy()
        matrix.data[diagonal] += added[row[diagonal]]
        symmetric.data[diagonal] += 0.5 * (added + added.swapaxes(1, 2))[row[diagonal]]
        direct = isinstance(self.linear, Direct)
        try:
            with self.run.phase("factorise" if direct else "setup"):
                prepared = self.linear.setup(
                    matrix,
                    local_near_nullspace(self.full),
                    symmetric=False,
                    preconditioner=symmetric,
                )
        except np.linalg.LinAlgError:
            return None
        return lambda rhs: self._solution(prepared, rhs, self.RTOL).unknowns

    def _solution(self, prepared: Prepared, rhs: np.ndarray, rtol: float) -> LinearSolution:
        """Return the solution for a right-hand side (n_dofs,) with a prepared matrix; count the passes, and
        log if an iterative solver stops early."""
        solution = solution_of(self.linear, prepared, rhs, rtol)
        self.run.count(solution.passes, self.full.system.nonzeros)
        if not solution.converged and not isinstance(self.linear, Direct):
            _LOG.warning(
                "%r stopped after %d iterations at a relative residual of %.1e, not %.0e: take "
                "Direct()",
                self.linear,
                solution.iterations,
                solution.residual,
                rtol,
            )
        return solution

    def _prepare(
        self, equations: Linearised, matrix: sparse.bsr_array, prescribed: np.ndarray
    ) -> None:
        """Set up the linear solver for the matrix of some equations, unless it has the matrix
        already, without the dofs in the mask ``prescribed`` (n_dofs,), whose changes are given. Without
        the Coulomb term the matrix is symmetric, as preconditioners need it."""
        if self._prepared_for is not None and equations.has_matrix_of(self._prepared_for):
            return
        with self.run.phase("factorise" if isinstance(self.linear, Direct) else "setup"):
            eliminated = without_fixed(matrix, prescribed, copy=False)
            uncoupled = (
                None
                if equations.symmetric
                else without_fixed(
                    self._contact_rows(equations, coupled=False), prescribed, copy=False
                )
            )
            modes = local_near_nullspace(self.full, prescribed)
            self._prepared = self.linear.setup(
                eliminated,
                modes,
                symmetric=equations.symmetric,
                preconditioner=uncoupled,
                previous=self._prepared,
            )
        self._prepared_for = equations

    def _contact_rows(self, equations: Linearised, coupled: bool = True) -> sparse.bsr_array:
        """Return the matrix with Coulomb coupling (if ``coupled``) and curvature in the rows of contact
        nodes."""
        data = self._matrix.data.copy()
        # numbers of the blocks in rows of contact nodes
        blocks = np.flatnonzero(self._contact_of_row >= 0)
        diagonal_blocks = blocks[
            self.full.system.nodes[self._contact_of_row[blocks]] == self._matrix.indices[blocks]
        ]
        node = self._contact_of_row[diagonal_blocks]
        # A_t - mu z A_n, and on the diagonal kappa Pi and the springs 1/e
        if coupled and not equations.symmetric:
            pull = equations.pull[self._contact_of_row[blocks]]
            data[blocks, 1:] -= pull[:, :, None] * data[blocks, :1]
        data[diagonal_blocks, 1:, 1:] += equations.curvature[node]
        data[diagonal_blocks, 0, 0] += equations.spring[node]
        return sparse.bsr_array(
            (data, self._matrix.indices, self._matrix.indptr), shape=self._matrix.shape
        )


def local_near_nullspace(local: LocalProblem, prescribed: np.ndarray | None = None) -> np.ndarray:
    """Return rigid-body modes (n_dofs, k) in local components, zero at dofs that are
    fixed or ``prescribed`` (n_dofs,) bool; without ``near_nullspace`` translations."""
    problem = local.discrete
    modes = problem.near_nullspace
    if modes is None:
        modes = np.tile(np.eye(problem.dim), (problem.n_nodes, 1))
    modes = np.column_stack([rotate(mode, local.frames, local.system.nodes) for mode in modes.T])
    modes[local.system.fixed if prescribed is None else local.system.fixed | prescribed] = 0.0
    return modes


@remembered
def coarsest_solution(problem: DiscreteProblem, rtol: float) -> tuple[np.ndarray, int, float]:
    """Return what :func:`coarsest_solution_near` does, from no start: once for a problem, as all
    hierarchies of an adaptive loop have the same coarsest level, whose solution took 4 % of a loop to
    20 000 nodes."""
    solved = coarsest_solution_near(problem, rtol, start=None)
    checks.freeze(*solved)
    return solved


def coarsest_solution_near(
    problem: DiscreteProblem, rtol: float, start: np.ndarray | None
) -> tuple[np.ndarray, int, float]:
    """Return the solution (n_unknowns,) of a coarsest problem, whose matrix may be singular, from
    which finer levels start; the number of its steps, and its work in passes over its matrix.
    ``start`` is a displacement near to it."""
    # one solve from zero pressures: exact up to a Poisson's ratio of .499, and beyond near enough for a
    # start
    augmented = augmented_problem(problem, np.zeros(len(problem.volumes)))
    # of scalar problems all nodes may touch: nothing is condensed
    options = ActiveSet(rtol=rtol, condensed=problem.dim > 1)
    run = Run(unit=augmented.problem.rows.nonzeros)  # a work unit is a pass over this matrix
    linear = options._equations(augmented.problem, run, lenient=True)
    newton = _Newton(options, linear, run, level=0, start=start, most=options.max_steps)
    state, *_ = newton.solve(certified=False, test=_CoarsestTest)
    solution = augmented.whole(newton.local.to_cartesian(state.unknowns).reshape(-1))
    return solution, state.cycles, run.work_units
