r"""ActiveSet: the semismooth Newton method, with direct or algebraic multigrid solves.

With q = b - A w (minus the force on the body), the slip :math:`\tau` and factors :math:`c_n, c_t > 0` (N/m)
the contact conditions are the equations (P. Alart, A. Curnier, Comput. Methods Appl. Mech. Engrg. 92, 1991,
doi:10.1016/0045-7825(91)90022-X)

.. math:: q_n = \max(0, z_n),\quad z_n = q_n + c_n (w_n - g_0);\qquad
          q_t = \min(1, B/|z_t|)\, z_t,\quad z_t = q_t + c_t \tau,\quad B = s + \mu \max(0, z_n).

A node is active where :math:`z_n > 0`, sticks where :math:`|z_t| \le B > 0` and slips elsewhere. A Newton step
:math:`\delta` then satisfies (S. Hueber, G. Stadler, B. Wohlmuth, SIAM J. Sci. Comput. 30, 2008, doi:10.1137/060671061)

- active :math:`\delta_n = g_0 - w_n`, otherwise :math:`(A\delta)_n = q_n`;
- stick :math:`\delta_t = -\tau`;
- slip, with :math:`z = z_t/|z_t|,\ \Pi = I - z z^T` and :math:`\mu = 0` where not active,

.. math:: (A_t - \mu z A_n + \kappa \Pi)\,\delta = z (z\cdot q_t - s - \mu q_n) + \frac{|z_t|}{|z_t| - B}\,\Pi q_t,
          \qquad \kappa = \frac{c_t B}{|z_t| - B} \ge 0.

This is the derivative itself, solved for :math:`\delta q_t`; :math:`\kappa\Pi` tends to the slip Hessian
:math:`(B/|\tau|)\,\Pi`. Without the Coulomb term :math:`\mu z A_n` the matrix is symmetric and positive definite. The
linear equations are solved on the sparse matrix, or condensed to the contact nodes; their right-hand side is the
residual of the full matrix, so every step is a step of iterative refinement too.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy import linalg, sparse

from adaptmg import _checks as checks
from adaptmg.discrete.coordinates import rotate
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.smoother.factorisation import Condensed, condense, condense_coarsest
from adaptmg.smoother.interior_point import ContactDofs, Interior, Span, interior_point
from adaptmg.smoother.residuals import residual
from adaptmg.smoother.system import LocalProblem, NodalContact, contact_codes, local_system
from adaptmg.solver.augmented import Augmented
from adaptmg.solver.iterate import Measure, State, StopTest, iterate
from adaptmg.solver.linear import Direct, LinearSolution, LinearSolver, Prepared, solution_of
from adaptmg.solver.record import Outcome, Run, Status
from adaptmg.transfer.galerkin import without_fixed

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ActiveSet:
    """Semismooth Newton (active set) method on the finest grid; see :mod:`adaptmg.solver.active_set`.

    Parameters
    ----------
    linear : Direct, AMG or user-defined
        Solver of the linear steps.
    condensed : bool, optional
        Take the steps on the Schur complement of the contact dofs, with one factorisation in all. Default: with
        ``Direct()``.
    start : {"interior", "held"}, optional
        Where steps without a given start begin: at the solution of an interior point method, or with all nodes
        touching and, under friction, sticking. Default: "interior" where the steps are condensed; otherwise an
        interior point costs as many linear solves as all the Newton steps that it saves.
    rtol : float
        For the relative A-norm of the last Newton step (ten times that while the contact status changes), which bounds
        the error of the iterate before it, and, times 10, for the relative natural residual. Where initial strains
        act, relative to u without what expands freely.
    max_steps : int
        Steps at most.
    nested_start : bool
        Solve on the coarser levels first, each from the solution of the level below.

    Notes
    -----
    The interior point method (:mod:`adaptmg.smoother.interior_point`) finds the contact status in 5 to 20 steps on
    the bodies that were tried, slender and folded ones among them. Where a status comes back in the Newton steps after
    it, or from a given start, or leaves a motion free, they begin again from an interior point, with a smaller
    tolerance each time. Steps of both kinds count.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.solve(grids, am.ActiveSet(linear=am.Direct())).status.name
    'CONVERGED'
    """

    linear: LinearSolver = field(default_factory=Direct)
    condensed: bool | None = None
    start: str | None = None
    rtol: float = 1e-10
    max_steps: int = 200
    nested_start: bool = False

    def __post_init__(self) -> None:
        checks.offers("linear", self.linear, "setup", "Direct(), AMG(...) or offer setup()")
        if self.condensed is None:
            object.__setattr__(self, "condensed", isinstance(self.linear, Direct))
        checks.convert(self, checks.flag, "condensed", "nested_start")
        if self.condensed and not isinstance(self.linear, Direct):
            raise ValueError("condensed=True needs linear=Direct(), got another linear solver")
        if self.start is None:
            object.__setattr__(self, "start", "interior" if self.condensed else "held")
        checks.choice("start", self.start, ("interior", "held"))
        checks.convert(self, checks.tolerance, "rtol")
        checks.integer("max_steps", self.max_steps, 1)

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        if hierarchy.finest.discrete.volumes is not None:
            return self._augmented(hierarchy, run, start)
        nested = self.nested_start and start is None
        if nested:
            hierarchy.need_discretised("the nested start of ActiveSet")
        first = 0 if nested else len(hierarchy) - 1
        for number in range(first, len(hierarchy)):
            level, finest = hierarchy[number], number == len(hierarchy) - 1
            if start is not None and number > first:
                start = level.prolongation @ start
                run.visit(number, "start")
            with run.phase("setup"):
                local = local_system(level.discrete)
            newton = _Newton(self, local, run, number, None if start is None else local.to_local(start),
                             measure=Measure(local, run if finest else None))
            stop = _NewtonTest(self.rtol, self.max_steps, newton.shortfall if finest else None, stalled=None)
            if finest:
                run.start_work_units = run.work_units
            status = iterate(newton, stop, run if finest else None)
            start = local.to_cartesian(newton.unknowns)
        return Outcome(start, status, newton.cycles, self.rtol, stop.error_estimate, stop.rate)

    def _augmented(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve a finest problem with volumes, by one factorisation and perhaps several solves."""
        if self.nested_start:
            raise ValueError("nested_start=True: ActiveSet has no nested start for smoothed elements with poisson "
                             "above .4; use FullMultigrid")
        problem, number, pressures, cycles = hierarchy.finest.discrete, len(hierarchy) - 1, run.pressures, 0
        with run.phase("setup"):
            first = local_system(Augmented(problem, pressures).problem)
        with run.phase("factorise"):
            condensed = condense(first) if self.condensed else None
        run.start_work_units = run.work_units
        for solve in range(Augmented.MOST):
            augmented = Augmented(problem, pressures)
            local = local_system(augmented.problem, first.system)
            factors = None if condensed is None else replace(condensed, full=local)
            newton = _Newton(self, local, run, number, None if start is None else local.to_local(start),
                             Measure(local, run), factors, augmented.pressures)
            # a given start fits another load
            done = solve > 0 and augmented.missed(start) <= self.rtol
            last = augmented.exact or done or solve == Augmented.MOST - 1
            stop = _NewtonTest(self.rtol, self.max_steps, newton.shortfall if last else None, stalled=None)
            run.first_cycle += cycles
            status = iterate(newton, stop, run)
            run.first_cycle, cycles = run.first_cycle - cycles, cycles + newton.cycles
            start = local.to_cartesian(newton.unknowns)
            pressures = augmented.pressures(start)
            if last:
                break
        return Outcome(start, status, cycles, self.rtol, stop.error_estimate, stop.rate, pressures=pressures)


class _NewtonTest(StopTest):
    """The last step bounds the error of the iterate before it; every step refines, so that rounding excuses none. As
    long as the contact status changes, nodes may follow one another: many such steps may be left."""

    UNSETTLED = 10.0  # factor on the last step while the status changes

    def judge(self, state: State) -> None:
        super().judge(state)
        if self.met and self.error_estimate == 0.0:
            return  # nothing strains
        self.error_estimate = np.inf
        if self.changes:
            change = self.change if self.size > 0 else (0.0 if self.changes[-1] == 0 else np.inf)
            self.error_estimate = self._caution * change * (1.0 if state.settled else self.UNSETTLED)
        self.met = self._small_enough()


class _Newton:
    """The Newton steps on one level."""

    #: tolerances of the interior point method, one after the other where the status that it finds comes
    #: back, and its steps at most
    TOLERANCES, MOST = (1e-9, 1e-12, 1e-15), 60
    #: steps after which the iteration counts as repeating itself: in 3D the direction of a slip may go round while no
    #: status comes back
    LONG = 15
    #: augmentation c over the diagonal of the matrix: it weighs gaps against forces where a status is decided
    FACTOR = 0.1

    def __init__(self, options: ActiveSet, local: LocalProblem, run: Run, level: int,
                 start: np.ndarray | None, measure: Measure, condensed: Condensed | None = None,
                 pressures: Callable[[np.ndarray], np.ndarray] | None = None) -> None:
        self.options, self.local, self.run, self.level, self._measure = options, local, run, level, measure
        self.equations_of: LinearSteps = (CondensedSteps(local, run, condensed) if options.condensed
                                          else SparseSteps(local, options.linear, run))
        self._pressures = pressures
        self.unknowns = np.zeros(local.system.n_dofs) if start is None else start
        self.cycles, self._hold_first = 0, start is None and options.start == "held"
        self._from_inside = start is None and options.start == "interior" and len(local.contact.gap) > 0
        self._tolerances = list(self.TOLERANCES)
        self._seen, self._last, self._since = set[bytes](), b"", 0  # states of the steps before, and their number
        self._equations: Linearised | None = None

    def shortfall(self, rtol: float) -> float:
        solved = self.local.to_cartesian(self.unknowns)
        return self.run.shortfall(solved, rtol, None if self._pressures is None else self._pressures(solved))

    def step(self) -> State | Status:
        if self._equations is not None or self._from_inside:
            status = self._interior() if self._equations is None else self._advance()
            if status is not None:
                return status
        residual = self._residual()
        self._decide(residual, self._hold_first and self.cycles == 0)
        active, slip = self._equations.active, self._equations.slip
        return self._measure(self.cycles, self.unknowns, residual, settled=self._equations.key == self._last,
                             active=int(active.sum()), slip=int((active & slip).sum()))

    def _advance(self) -> Status | None:
        """A step; where a status comes back, or a motion is free, a start from inside instead."""
        key = self._equations.key
        change = None
        if not (key in self._seen and key != self._last) and self._since < self.LONG:
            try:
                change = self.equations_of.solve(self._equations)
            except np.linalg.LinAlgError as error:
                _LOG.info("step %d: %s", self.cycles, error)
        if change is None:
            return self._interior()
        self._last = key
        self._seen.add(key)
        self.unknowns = self.unknowns + change
        self.cycles += 1
        self._since += 1
        self.run.visit(self.level, "solve")
        return None

    def _interior(self) -> Status | None:
        """Go to what the interior point method finds, to the next of the tolerances."""
        if not self._tolerances:
            return Status.CYCLING
        tolerance = self._tolerances.pop(0)
        found = interior_point(*self.equations_of.inside(), self.local.contact, self.equations_of.stiffness, tolerance,
                               most=min(self.MOST, self.options.max_steps - self.cycles))
        _LOG.debug("step %d: an interior point, %.0e, in %d steps", self.cycles, found.slack, found.steps)
        self.unknowns = self.equations_of.outside(found)
        self.cycles += found.steps
        self.run.visit(self.level, "solve", found.steps)
        self._seen.clear()
        self._last, self._since = b"", 0
        return None

    def _residual(self) -> np.ndarray:
        self.run.count(1, self.local.system.nonzeros)
        return residual(self.local.system, self.local.load, self.unknowns)

    def _decide(self, residual: np.ndarray, hold: bool) -> None:
        system, contact, forces = self.local.system, self.local.contact, self.equations_of.contact_residual(residual)
        at_contact = self.unknowns.reshape(-1, system.dim)[system.nodes]
        self._equations = hold_all(contact, at_contact, forces) if hold else linearise(
            contact, at_contact, forces, self.equations_of.stiffness, self.FACTOR)


def coarsest_solution(problem: DiscreteProblem, rtol: float, start: np.ndarray | None = None
                      ) -> tuple[np.ndarray, np.ndarray | None, int, float]:
    """Displacement (n_nodes, dim) of a coarsest problem, whose matrix may be singular, the pressures of its volumes,
    and the numbers of its steps and of the passes over its matrix. ``start`` is a displacement near to it (not used
    with volumes)."""
    if problem.volumes is not None:
        augmented = Augmented(problem, None)
        solution, _, steps, passes = coarsest_solution(augmented.problem, rtol)
        return solution, augmented.pressures(solution), steps, passes
    options, condensed = ActiveSet(rtol=rtol), condense_coarsest(problem)
    local = condensed.full
    run = Run(unit=local.system.nonzeros)
    near = None if start is None else local.to_local(start)
    newton = _Newton(options, local, run, 0, near, Measure(local), condensed)
    iterate(newton, _NewtonTest(rtol, options.max_steps, stalled=None))
    return local.to_cartesian(newton.unknowns), None, newton.cycles, run.work_units


@dataclass(frozen=True, eq=False)
class Linearised:
    """The equations of one Newton step at the contact nodes; see the module."""

    active: np.ndarray  # (n,) bools
    slip: np.ndarray  # (n,) bools
    direction: np.ndarray  # (n, dim - 1): z, zero where the node sticks
    coupling: np.ndarray  # (n,): mu where the node is active and slips, else 0
    curvature: np.ndarray  # (n, dim - 1, dim - 1): kappa Pi, N/m
    force: np.ndarray  # (n, dim): right-hand sides of the equations that are not prescriptions, N
    prescribed: np.ndarray  # (n, dim) bool: components whose change is given
    change: np.ndarray  # (n, dim): these changes, zero elsewhere, m

    @property
    def symmetric(self) -> bool:
        return not self.coupling.any()

    @property
    def key(self) -> bytes:
        """The contact status: the codes of :mod:`adaptmg.smoother.system`."""
        backwards = ~(self.direction[:, 0] > 0) if self.direction.shape[1] == 1 else False
        return contact_codes(self.active, ~self.slip, backwards).tobytes()

    @property
    def same_matrix(self) -> bool:
        """Whether every step with this :attr:`key` has the same matrix: no curvature, directions in the key."""
        return not self.curvature.any() and (self.direction.shape[1] == 1 or self.symmetric)


def linearise(contact: NodalContact, unknowns: np.ndarray, residual: np.ndarray, stiffness: np.ndarray,
              factor: float) -> Linearised:
    """Decide the status of every contact node and set up its equations."""
    tangential = factor * stiffness[:, 1:].max(axis=1)
    with np.errstate(invalid="ignore"):
        augmented = residual[:, 0] + factor * stiffness[:, 0] * (unknowns[:, 0] - contact.gap)
    active = augmented > 0
    tau = unknowns[:, 1:] - contact.slip_reference
    bound = contact.limit + contact.friction * np.maximum(augmented, 0.0)
    trial = residual[:, 1:] + tangential[:, None] * tau
    size = np.linalg.norm(trial, axis=1)
    slip = ~((size <= bound) & (bound > 0))
    slip[contact.driven] = True
    equations = _equations(contact, unknowns, residual, active, slip, trial, size, bound, tangential)
    return _beside_held(contact, tau, residual, equations)


def _beside_held(contact: NodalContact, tau: np.ndarray, residual: np.ndarray, equations: Linearised) -> Linearised:
    r"""The equations, in place, of nodes that slip along a held tangent: there |tau| > 0, and the second tangent has

    .. math:: q_2 = (s + \mu p)\,\tau_2/|\tau|,\qquad \kappa = (s + \mu p)\,\tau_1^2/|\tau|^3 .
    """
    at = contact.driven
    if len(at):
        size = np.linalg.norm(tau[at], axis=1)
        z = tau[at, 1] / size
        mu = np.where(equations.active[at], contact.friction[at], 0.0)
        bound = contact.limit[at] + mu * np.maximum(residual[at, 0], 0.0)
        equations.direction[at] = np.column_stack([np.zeros_like(z), z])
        equations.coupling[at] = mu
        equations.curvature[at] = 0.0
        equations.curvature[at, 1, 1] = bound * (1 - z**2) / size
        equations.force[at, 1] = 0.0
        equations.force[at, 2] = residual[at, 2] - z * (contact.limit[at] + mu * residual[at, 0])
    return equations


def hold_all(contact: NodalContact, unknowns: np.ndarray, residual: np.ndarray) -> Linearised:
    """Every node that has an obstacle touches and, where the law has friction, sticks."""
    active = np.isfinite(contact.gap)
    slip = ~((contact.limit > 0) | (active & (contact.friction > 0)))
    zero = np.zeros(len(active))
    equations = _equations(contact, unknowns, residual, active, slip, np.zeros_like(unknowns[:, 1:]), zero, zero, zero)
    equations.change[contact.driven, 1] = 0.0
    return equations


def _equations(contact: NodalContact, unknowns: np.ndarray, residual: np.ndarray, active: np.ndarray,
               slip: np.ndarray, trial: np.ndarray, size: np.ndarray, bound: np.ndarray,
               tangential: np.ndarray) -> Linearised:
    moving = slip & (size > 0)
    direction = np.where(moving[:, None], trial / np.where(moving, size, 1.0)[:, None], 0.0)
    coupling = np.where(active & moving, contact.friction, 0.0)
    limit = np.where(moving, contact.limit, 0.0)
    beyond = np.where(moving, size - bound, 1.0)
    across = np.eye(trial.shape[1]) - direction[:, :, None] * direction[:, None, :]
    curvature = np.where(moving, tangential * bound / beyond, 0.0)[:, None, None] * across
    along = np.sum(direction * residual[:, 1:], axis=1)
    force = residual.copy()
    force[:, 1:] = (direction * (along - limit - coupling * residual[:, 0])[:, None]
                    + np.where(moving, size / beyond, 1.0)[:, None] * np.einsum("nij,nj->ni", across, residual[:, 1:]))
    prescribed = np.zeros(unknowns.shape, dtype=bool)
    prescribed[active, 0] = True
    prescribed[~slip, 1:] = True
    change = np.zeros_like(unknowns)
    change[active, 0] = (contact.gap - unknowns[:, 0])[active]
    change[~slip, 1:] = (contact.slip_reference - unknowns[:, 1:])[~slip]
    return Linearised(active, slip, direction, coupling, curvature, force, prescribed, change)


class LinearSteps(Protocol):
    """Takes the linear steps of one problem."""

    @property
    def stiffness(self) -> np.ndarray:
        """Diagonal (n_contact, dim) of the matrix that the contact nodes see, N/m."""

    def contact_residual(self, residual: np.ndarray) -> np.ndarray:
        """The residual (n_contact, dim) at contact nodes that decides their status, from that at all dofs."""

    def solve(self, equations: Linearised) -> np.ndarray:
        """The change (n_dofs,) for the last residual. LinAlgError if the equations are singular or an iterative linear
        solver does not converge."""

    def inside(self) -> tuple[Span, np.ndarray]:
        """The unknowns of the interior point method, and their load."""

    def outside(self, found: Interior) -> np.ndarray:
        """The unknowns (n_dofs,) for what the interior point method found."""


class CondensedSteps:
    """Steps on the dense Schur complement; one sparse factorisation serves them all."""

    SINGULAR = 1e-13  # reciprocal condition number below which the equations count as singular

    def __init__(self, local: LocalProblem, run: Run, condensed: Condensed | None = None) -> None:
        self.local, self.run = local, run
        with run.phase("factorise"):
            self.condensed = condense(local) if condensed is None else condensed

    @property
    def stiffness(self) -> np.ndarray:
        return self.condensed.matrix.diagonal().reshape(-1, self.local.system.dim)

    def contact_residual(self, residual: np.ndarray) -> np.ndarray:
        """The residual with the interior in equilibrium."""
        with self.run.phase("solve"):
            self._particular, force = self.condensed.reduce(residual)
        return force.reshape(-1, self.local.system.dim)

    def inside(self) -> tuple[Span, np.ndarray]:
        free = ~self.local.system.fixed[self.condensed.contact]
        with self.run.phase("solve"):
            return (ContactDofs(self.condensed.matrix, free.reshape(-1, self.local.system.dim)),
                    self.condensed.reduce(self.local.load)[1][free])

    def outside(self, found: Interior) -> np.ndarray:
        with self.run.phase("solve"):
            return self.condensed.recover(found.values.reshape(-1))

    def solve(self, equations: Linearised) -> np.ndarray:
        with self.run.phase("solve"):
            n, dim = equations.force.shape
            matrix = self.condensed.matrix.copy().reshape(n, dim, n, dim)
            node = np.arange(n)
            pull = equations.coupling[:, None] * equations.direction
            for k in range(1, dim):
                matrix[:, k] -= pull[:, k - 1, None, None] * matrix[:, 0]
                for j in range(1, dim):
                    matrix[node, k, node, j] += equations.curvature[:, k - 1, j - 1]
            matrix = matrix.reshape(n * dim, n * dim)
            change = equations.change.reshape(-1).copy()
            free = np.flatnonzero(~equations.prescribed.reshape(-1))
            rhs = equations.force.reshape(-1)[free] - matrix[free] @ change
            change[free] = self._dense(matrix[np.ix_(free, free)], rhs)
            return self.condensed.complete(self._particular, change)

    def _dense(self, matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
        if not len(rhs):
            return rhs
        norm = np.abs(matrix).sum(axis=0).max()
        factors, pivots, info = linalg.lapack.dgetrf(matrix)
        rcond = linalg.lapack.dgecon(factors, norm)[0] if info == 0 else 0.0
        if not rcond > self.SINGULAR:
            raise np.linalg.LinAlgError(f"the condensed equations are singular: reciprocal condition {rcond:.1e}")
        return linalg.lapack.dgetrs(factors, pivots, rhs)[0]


class SparseSteps:
    """Steps on the sparse matrix, of which only rows (and eliminated columns) of contact nodes change."""

    #: relative residual to which an iterative linear solver solves each Newton step, and each interior point step
    RTOL, INSIDE = 1e-2, 1e-4

    def __init__(self, local: LocalProblem, linear: LinearSolver, run: Run) -> None:
        self.local, self.linear, self.run = local, linear, run
        self._matrix = local.system.matrix
        self._contact = local.system.contact_of[np.repeat(np.arange(local.system.n_nodes),
                                                          np.diff(self._matrix.indptr))]  # of each block's row, or -1
        self._prepared: Prepared | None = None
        self._prepared_for: bytes | None = None

    @property
    def stiffness(self) -> np.ndarray:
        system = self.local.system
        return self._matrix.diagonal().reshape(-1, system.dim)[system.nodes]

    def contact_residual(self, residual: np.ndarray) -> np.ndarray:
        self._residual = residual
        return residual.reshape(-1, self.local.system.dim)[self.local.system.nodes]

    def inside(self) -> tuple[Span, np.ndarray]:
        return _SparseUnknowns(self), self.local.load

    def outside(self, found: Interior) -> np.ndarray:
        return found.unknowns

    def solve(self, equations: Linearised) -> np.ndarray:
        system = self.local.system
        released = np.zeros((system.n_nodes, system.dim), dtype=bool)
        released[system.nodes] = equations.prescribed
        change = np.zeros((system.n_nodes, system.dim))
        change[system.nodes] = equations.change
        rhs = self._residual.reshape(-1, system.dim).copy()
        rhs[system.nodes] = equations.force
        released, rhs, change = released.reshape(-1), rhs.reshape(-1), change.reshape(-1)
        with self.run.phase("setup"):
            matrix = self._contact_rows(equations)
            if change.any():
                rhs -= matrix @ change
                self.run.count(1, system.nonzeros)
            rhs[released] = 0.0
        self._prepare(equations, matrix, released)
        with self.run.phase("solve"):
            solution = self._solution(self._prepared, rhs, self.RTOL)
        if not solution.converged and not isinstance(self.linear, Direct):
            raise np.linalg.LinAlgError("the Newton step is not solved")
        return solution.unknowns + change

    def solver_with(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        """What solves with blocks (n_contact, dim, dim) added at the contact nodes; None where that is singular."""
        system, matrix = self.local.system, self._matrix.copy()
        free = ~system.fixed.reshape(-1, system.dim)[system.nodes]
        added = np.zeros((system.n_nodes, system.dim, system.dim))
        added[system.nodes] = blocks * free[:, :, None] * free[:, None, :]
        row = np.repeat(np.arange(system.n_nodes), np.diff(matrix.indptr))
        own = row == matrix.indices
        symmetric = matrix.copy()
        matrix.data[own] += added[row[own]]
        symmetric.data[own] += 0.5 * (added + added.swapaxes(1, 2))[row[own]]
        direct = isinstance(self.linear, Direct)
        try:
            with self.run.phase("factorise" if direct else "setup"):
                prepared = self.linear.setup(matrix, local_near_nullspace(self.local), symmetric=False,
                                             preconditioner=symmetric)
        except np.linalg.LinAlgError:
            return None

        return lambda rhs: self._solution(prepared, rhs, self.INSIDE).unknowns

    def _solution(self, prepared: Prepared, rhs: np.ndarray, rtol: float) -> LinearSolution:
        solution = solution_of(self.linear, prepared, rhs, rtol)
        self.run.count(solution.passes, self.local.system.nonzeros)
        if not solution.converged and not isinstance(self.linear, Direct):
            _LOG.warning("%r stopped after %d iterations at a relative residual of %.1e, not %.0e: raise "
                         "max_iterations, or take Direct()", self.linear, solution.iterations, solution.residual, rtol)
        return solution

    def _prepare(self, equations: Linearised, matrix: sparse.bsr_array, released: np.ndarray) -> None:
        key = equations.key
        if equations.same_matrix and key == self._prepared_for:
            return
        with self.run.phase("factorise" if isinstance(self.linear, Direct) else "setup"):
            eliminated, basis = without_fixed(matrix, released, copy=False), None
            if not equations.symmetric:
                basis = without_fixed(self._contact_rows(equations, coupled=False), released, copy=False)
            modes = local_near_nullspace(self.local, released)
            self._prepared = self.linear.setup(eliminated, modes, symmetric=equations.symmetric, preconditioner=basis,
                                               previous=self._prepared)
        self._prepared_for = key

    def _contact_rows(self, equations: Linearised, coupled: bool = True) -> sparse.bsr_array:
        """The matrix with Coulomb coupling (if ``coupled``) and curvature in the rows of contact nodes."""
        system, data = self.local.system, self._matrix.data.copy()
        rows = np.flatnonzero(self._contact >= 0)
        diagonal = rows[system.nodes[self._contact[rows]] == self._matrix.indices[rows]]
        node = self._contact[diagonal]
        if coupled and not equations.symmetric:
            pull = (equations.coupling[:, None] * equations.direction)[self._contact[rows]]
            data[rows, 1:] -= pull[:, :, None] * data[rows, :1]
        data[diagonal, 1:, 1:] += equations.curvature[node]
        return sparse.bsr_array((data, self._matrix.indices, self._matrix.indptr), shape=self._matrix.shape)


class _SparseUnknowns:
    """All dofs as the unknowns of the interior point method."""

    def __init__(self, steps: SparseSteps) -> None:
        self.steps, self.system = steps, steps.local.system

    def product(self, unknowns: np.ndarray) -> np.ndarray:
        self.steps.run.count(1, self.system.nonzeros)
        return self.system.matrix @ unknowns

    def values(self, unknowns: np.ndarray) -> np.ndarray:
        return unknowns.reshape(-1, self.system.dim)[self.system.nodes]

    def restricted(self, forces: np.ndarray) -> np.ndarray:
        result = np.zeros((self.system.n_nodes, self.system.dim))
        result[self.system.nodes] = forces
        result.reshape(-1)[self.system.fixed] = 0.0
        return result.reshape(-1)

    def factors(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        return self.steps.solver_with(blocks)


def local_near_nullspace(local: LocalProblem, released: np.ndarray | None = None) -> np.ndarray:
    """Rigid-body modes (n_dofs, k) in local components, zero at fixed dofs; without ``near_nullspace`` translations."""
    problem = local.discrete
    modes = problem.near_nullspace
    if modes is None:
        modes = np.tile(np.eye(problem.dim), (problem.n_nodes, 1))
    modes = np.column_stack([rotate(mode, local.frames, local.system.nodes) for mode in modes.T])
    modes[local.system.fixed if released is None else local.system.fixed | released] = 0.0
    return modes
