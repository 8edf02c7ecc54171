r"""ActiveSet: the semismooth Newton method, with direct or algebraic multigrid solves.

The linearised contact conditions: one step of the semismooth Newton method at the contact nodes.

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
:math:`(B/|\tau|)\,\Pi`. Without the Coulomb term :math:`\mu z A_n` the matrix is symmetric and positive definite.

How the equations of a Newton step are solved: on the sparse matrix, or condensed to the contact nodes.

Both solve for a change of all unknowns whose right-hand side is the residual of the full sparse matrix, so that every
step of the active set method is a step of iterative refinement too.

The glued problem: all contact dofs fixed where they are, a linear problem that every linear solver can be timed on.

It is the yardstick of the comparison with algebraic multigrid: the same body, mesh and supports without the
nonlinearity of contact.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy import linalg, sparse

from adaptmg import _checks as checks
from adaptmg.discrete.coordinates import rotate
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.smoother.residuals import natural_residual, residual
from adaptmg.smoother.system import LocalProblem, NodalContact, contact_codes, local_system
from adaptmg.solver.factorisation import Condensed, condense
from adaptmg.solver.iterate import IterateTest, iterate
from adaptmg.solver.linear import Direct, LinearSolver, Prepared, solution_of
from adaptmg.solver.record import Outcome, Run, Status
from adaptmg.transfer.galerkin import without_fixed

__all__ = ["ActiveSet", "CondensedSteps", "Linearised", "SparseSteps", "Steps", "glued_system", "hold_all", "linearise",
           "local_near_nullspace"]

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ActiveSet:
    """Semismooth Newton (active set) method on the finest grid; see :mod:`adaptmg.solver.active_set`.

    Parameters
    ----------
    linear : Direct, AMG or one's own
        Solver of the linear steps.
    condensed : bool, optional
        Take the steps on the Schur complement of the contact dofs, with one factorisation in all. Default: with
        ``Direct()``.
    rtol : float
        For the relative A-norm of the last Newton step (ten times that while the contact status changes), which bounds
        the error of the iterate before it, and, times 10, for the relative natural residual.
    max_steps : int
        Newton steps at most.
    linear_rtol : float
        Relative residual to which an iterative linear solver solves each step.
    nested_start : bool
        Solve on the coarser levels first, each from the solution of the level below.

    Notes
    -----
    Without a start all nodes touch and, under friction, stick: a state that is not singular where the problem is well
    posed. If a later one is (a body that only contact holds and that has lost it), the iteration goes back to that
    state. If a status comes back, the iteration may be cycling: the step is halved, and gaps weigh less against forces.
    If either happens again, springs tie the contact nodes to the last iterate that is trusted (a proximal point
    method): each problem with springs is solved until its residual is a tenth of that of its centre, which then moves
    to its solution. The springs become weaker with every problem that is solved and stiffer with every other one, and
    nothing is left of them at the end.
    """

    linear: LinearSolver = field(default_factory=Direct)
    condensed: bool | None = None
    rtol: float = 1e-10
    max_steps: int = 200
    linear_rtol: float = 1e-2
    nested_start: bool = False

    def __post_init__(self) -> None:
        checks.offers("linear", self.linear, "setup", "Direct(), AMG(...) or offer setup()")
        if self.condensed is None:
            object.__setattr__(self, "condensed", isinstance(self.linear, Direct))
        for name in ("condensed", "nested_start"):
            checks.flag(name, getattr(self, name))
        if self.condensed and not isinstance(self.linear, Direct):
            raise ValueError("condensed=True factorises the interior directly: leave linear at Direct(), "
                             "or say condensed=False")
        for name in ("rtol", "linear_rtol"):
            object.__setattr__(self, name, checks.tolerance(name, getattr(self, name)))
        checks.integer("max_steps", self.max_steps, 1)

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level; see :class:`adaptmg.solver.record.Solver`."""
        if self.nested_start and start is None:
            hierarchy.need_discretised("the nested start of ActiveSet")
        first = 0 if self.nested_start and start is None else len(hierarchy) - 1
        for number in range(first, len(hierarchy)):
            level, finest = hierarchy[number], number == len(hierarchy) - 1
            if start is not None and number > first:
                start = level.prolongation @ start
                run.visit(number, "start")
            with run.phase("setup"):
                local = local_system(level.discrete)
            steps = _NewtonSteps(self, local, run, number, None if start is None else local.to_local(start))
            stop = _NewtonTest(local, self.rtol, self.max_steps, run if finest else None,
                               displacement=local.to_cartesian if finest else None)
            if finest:
                run.start_work_units = run.work_units
            status = iterate(steps, stop, run if finest else None)
            start = local.to_cartesian(steps.unknowns)
        return Outcome(start, status, steps.cycles, self.rtol, stop.error_estimate, stop.rate)


class _NewtonTest(IterateTest):
    """The last step bounds the error of the iterate before it; every step refines, so that rounding excuses none.

    As long as the contact status changes, nodes may follow one another: many such steps may be left.
    """

    stalled, settled = False, False
    #: times a step that the error may be as long as the status changes
    UNSETTLED = 10.0

    def take_residual(self, residual: float, forces: float, floor: float, idle: bool = False) -> None:
        """See :class:`~adaptmg.solver.iterate.StopTest`."""
        super().take_residual(residual, forces, floor, idle)
        if self.met and self.error_estimate == 0.0:
            return  # nothing strains
        self.error_estimate = np.inf
        if self.changes:
            change = self.change if self.size > 0 else (0.0 if self.changes[-1] == 0 else np.inf)
            self.error_estimate = self._caution * change * (1.0 if self.settled else self.UNSETTLED)
        self.met = self._small_enough()


class _NewtonSteps:
    """The Newton steps on one level; see :class:`~adaptmg.solver.iterate.Iteration`."""

    #: springs, relative to the diagonal: the first ones, the stiffest, those that count as none; the factors by which
    #: they become weaker and stiffer; to what a problem with them reduces the residual, and in how many steps
    SPRING, STIFFEST, NONE, WEAKER, STIFFER, REDUCED, TRIES = 1e-2, 1e2, 1e-6, 0.5, 10.0, 0.1, 5
    #: repeated states before springs are set
    PATIENCE = 3
    #: every so many steps the iteration is taken to repeat itself
    LONG = 15
    #: augmentation c over the diagonal of the matrix; it weighs gaps against forces where a status is decided: small
    #: values change fewer nodes at a time. It is not reduced below the second, lest rounding decide.
    FACTOR, SMALLEST_FACTOR = 0.1, 1e-4

    def __init__(self, options: ActiveSet, local: LocalProblem, run: Run, level: int,
                 start: np.ndarray | None) -> None:
        self.options, self.local, self.run, self.level = options, local, run, level
        self.methods: Steps = (CondensedSteps(local, run) if options.condensed
                               else SparseSteps(local, options.linear, run))
        self.unknowns = np.zeros(local.system.n_dofs) if start is None else start
        self.cycles, self.held, self._hold_first = 0, False, start is None
        self._factor, self._repeats, self._last = self.FACTOR, 0, b""
        self._seen: set[bytes] = set()
        self._forces, self._equations = np.empty(0), None
        # springs, what they tie the contact nodes to, its residual, and the steps since
        self._spring, self._stiffness, self._centre, self._size, self._tries = 0.0, self.SPRING, None, np.inf, 0

    def start(self) -> None:
        """Nothing: the start is measured."""

    def measure(self, stop: IterateTest) -> None:
        """Residual, and the contact status that it decides."""
        defect = residual(self.local.system, self.local.load, self.unknowns)
        self.run.count(1, self.local.system.nonzeros)
        tied = defect if self._centre is None else self._tied(defect)
        self._decide(tied, hold=self._hold_first and self.cycles == 0)
        # with springs a short step does not bound the error
        stop.settled = not self._spring and self._equations.key == self._last
        stop.take(self.unknowns, defect)

    def _decide(self, defect: np.ndarray, hold: bool = False) -> None:
        self._forces = self.methods.contact_residual(defect)
        self._equations = self._linearised(self._factor, hold)

    def _tied(self, defect: np.ndarray) -> np.ndarray:
        """The residual with springs; where it is small enough their centre moves to the present iterate."""
        tied, system = defect.copy(), self.local.system
        pull = (self.unknowns - self._centre).reshape(-1, system.dim)[system.nodes]
        tied.reshape(-1, system.dim)[system.nodes] -= self._spring * self.methods.stiffness * pull
        if not self._tries or self._natural(tied) > self.REDUCED * self._size:
            return tied
        self._stiffness *= self.WEAKER
        self._tie(defect, self._stiffness if self._stiffness > self.NONE else 0.0)
        return defect

    def _natural(self, defect: np.ndarray) -> float:
        vector = natural_residual(self.local.system, self.local.contact, self.local.load, self.unknowns, defect)
        return float(np.linalg.norm(vector))

    def _tie(self, defect: np.ndarray, spring: float) -> None:
        """Springs to the present iterate with the residual ``defect``."""
        self._centre, self._size = self.unknowns, self._natural(defect)
        self._spring, self._tries, self._factor, self._last = spring, 0, self.FACTOR, b""
        self._seen.clear()

    def _stiffen(self) -> None:
        """Springs; where there are some already, stiffer ones, and back to their centre."""
        if self._centre is not None:
            self.unknowns = self._centre
            # without any, those that were the last
            self._stiffness = max(self._stiffness, self.NONE) * (self.STIFFER if self._spring else 1.0)
        _LOG.info("step %d: springs of %.1e at contact", self.cycles, self._stiffness)
        defect = residual(self.local.system, self.local.load, self.unknowns)
        self.run.count(1, self.local.system.nonzeros)
        self._tie(defect, self._stiffness)
        self._decide(defect)

    def row(self, stop: IterateTest) -> dict[str, float]:
        """See :class:`~adaptmg.solver.iterate.Iteration`."""
        active = self._equations.active
        return {"active": int(active.sum()), "slip": int((active & self._equations.slip).sum()), **stop.measures()}

    def step(self, stop: IterateTest) -> Status | None:
        """A step, shorter where a status comes back; with springs where it does so again."""
        key = self._equations.key
        # in 3D the direction of a slip may go round while no status comes back
        repeated = (key in self._seen and key != self._last) or self.cycles % self.LONG == self.LONG - 1
        if self._centre is not None:
            if repeated or self._tries >= self.TRIES:
                self._stiffen()
                repeated = False
        elif repeated:
            self._repeats += 1
            self._factor = min(self._factor, max(0.1 * self._factor, self.SMALLEST_FACTOR))
            _LOG.info("step %d: the contact status comes back (%d times); halving the step", self.cycles, self._repeats)
            if self._repeats > self.PATIENCE:
                self._stiffen()
                repeated = False
        if self._stiffness > self.STIFFEST:
            return Status.CYCLING
        change = self._solved()
        self._last = self._equations.key
        self._seen.add(self._last)
        self.unknowns = self.unknowns + (0.5 if repeated else 1.0) * change
        self.cycles += 1
        self._tries += 1
        self.run.visit(self.level, "solve")
        return None

    def _linearised(self, factor: float, hold: bool) -> Linearised:
        system, contact = self.local.system, self.local.contact
        at_contact = self.unknowns.reshape(-1, system.dim)[system.nodes]
        if hold:
            self.held = True
            return hold_all(contact, at_contact, self._forces)
        return linearise(contact, at_contact, self._forces, self.methods.stiffness, factor)

    def _solved(self) -> np.ndarray:
        """The change of a step; where it is singular, from the safe state, then with springs."""
        while True:
            try:
                return self.methods.solve(self._equations, self.options.linear_rtol, self._spring)
            except np.linalg.LinAlgError as error:
                _LOG.info("step %d: %s", self.cycles, error)
                if self._stiffness > self.STIFFEST:
                    raise
            if self.held:
                self._stiffen()
            else:
                self._equations = self._linearised(0.0, hold=True)


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
        """Whether the matrix of the step is symmetric."""
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
    """Every node that has an obstacle touches and, where the law has friction, sticks: a safe state to start from."""
    active = np.isfinite(contact.gap)
    slip = ~((contact.limit > 0) | (active & (contact.friction > 0)))
    zero = np.zeros(len(active))
    equations = _equations(contact, unknowns, residual, active, slip, np.zeros_like(unknowns[:, 1:]), zero, zero, zero)
    equations.change[contact.driven, 1] = 0.0
    return equations


def _equations(contact: NodalContact, unknowns: np.ndarray, residual: np.ndarray, active: np.ndarray,
               slip: np.ndarray, trial: np.ndarray, size: np.ndarray, bound: np.ndarray,
               tangential: np.ndarray) -> Linearised:
    """The equations of given states; see the module for the formula."""
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


class Steps(Protocol):
    """Takes the linear steps of one problem."""

    @property
    def stiffness(self) -> np.ndarray:
        """Diagonal (n_contact, dim) of the matrix that the contact nodes see, N/m."""

    def contact_residual(self, residual: np.ndarray) -> np.ndarray:
        """The residual (n_contact, dim) at contact nodes that decides their status, from that at all dofs."""

    def solve(self, equations: Linearised, rtol: float, spring: float) -> np.ndarray:
        """The change (n_dofs,) for the residual last given to :meth:`contact_residual`.

        Parameters
        ----------
        equations : Linearised
        rtol : float
            Of an iterative linear solver.
        spring : float
            Springs of this stiffness, relative to the diagonal, at the contact dofs.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the equations are singular or, without springs, an iterative solver does not reach ``rtol``.
        """


def local_near_nullspace(local: LocalProblem, released: np.ndarray | None = None) -> np.ndarray:
    """Rigid-body modes (n_dofs, k) in local components, zero at fixed dofs.

    Translations where the problem has no ``near_nullspace``.
    """
    problem: DiscreteProblem = local.discrete
    modes = problem.near_nullspace
    if modes is None:
        modes = np.tile(np.eye(problem.dim), (problem.n_nodes, 1))
    modes = np.column_stack([rotate(mode, local.frames, local.system.nodes) for mode in modes.T])
    modes[local.system.fixed if released is None else local.system.fixed | released] = 0.0
    return modes


@dataclass(eq=False)
class CondensedSteps:
    """Steps on the dense Schur complement; one sparse factorisation serves them all."""

    local: LocalProblem
    run: Run
    condensed: Condensed = field(init=False)
    _particular: np.ndarray = field(init=False)

    #: reciprocal condition number below which the equations count as singular
    SINGULAR = 1e-13

    def __post_init__(self) -> None:
        with self.run.phase("factorise"):
            self.condensed = condense(self.local)

    @property
    def stiffness(self) -> np.ndarray:
        """See :class:`Steps`."""
        return self.condensed.matrix.diagonal().reshape(-1, self.local.system.dim)

    def contact_residual(self, residual: np.ndarray) -> np.ndarray:
        """The residual with the interior in equilibrium; see :class:`Steps`."""
        with self.run.phase("solve"):
            self._particular, force = self.condensed.reduce(residual)
        return force.reshape(-1, self.local.system.dim)

    def solve(self, equations: Linearised, rtol: float, spring: float) -> np.ndarray:
        """See :class:`Steps`."""
        with self.run.phase("solve"):
            n, dim = equations.force.shape
            matrix = self.condensed.matrix.copy()
            matrix[np.diag_indices(n * dim)] += spring * self.condensed.matrix.diagonal()
            matrix = matrix.reshape(n, dim, n, dim)
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


@dataclass(eq=False)
class SparseSteps:
    """Steps on the sparse matrix, of which only rows (and eliminated columns) of contact nodes change."""

    local: LocalProblem
    linear: LinearSolver
    run: Run
    _matrix: sparse.bsr_array = field(init=False)
    _rows: np.ndarray = field(init=False)
    _residual: np.ndarray = field(init=False)
    _prepared: Prepared | None = field(default=None, init=False)
    _prepared_for: tuple[bytes, float] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._matrix = self.local.system.matrix
        self._rows = np.repeat(np.arange(self.local.system.n_nodes), np.diff(self._matrix.indptr))

    @property
    def stiffness(self) -> np.ndarray:
        """See :class:`Steps`."""
        system = self.local.system
        return self._matrix.diagonal().reshape(-1, system.dim)[system.nodes]

    def contact_residual(self, residual: np.ndarray) -> np.ndarray:
        """The rows of the contact nodes; see :class:`Steps`."""
        self._residual = residual
        return residual.reshape(-1, self.local.system.dim)[self.local.system.nodes]

    def solve(self, equations: Linearised, rtol: float, spring: float) -> np.ndarray:
        """See :class:`Steps`."""
        system = self.local.system
        prescribed = np.zeros((system.n_nodes, system.dim), dtype=bool)
        prescribed[system.nodes] = equations.prescribed
        change = np.zeros((system.n_nodes, system.dim))
        change[system.nodes] = equations.change
        rhs = self._residual.reshape(-1, system.dim).copy()
        rhs[system.nodes] = equations.force
        rhs, change = rhs.reshape(-1), change.reshape(-1)
        with self.run.phase("setup"):
            matrix = self._contact_rows(equations, spring, coupled=True)
            if change.any():
                rhs -= matrix @ change
                self.run.count(1, system.nonzeros)
            rhs[prescribed.reshape(-1)] = 0.0
        self._prepare(equations, matrix, prescribed, spring)
        with self.run.phase("solve"):
            solution = solution_of(self.linear, self._prepared, rhs, rtol)
        self.run.count(solution.passes, system.nonzeros)
        if not solution.converged and not isinstance(self.linear, Direct):
            message = (f"{self.linear!r} stopped after {solution.iterations} iterations at a relative residual of "
                       f"{solution.residual:.1e}, wanted {rtol:.1e}: raise max_iterations, or take Direct()")
            if not spring:
                raise np.linalg.LinAlgError(message)
            _LOG.warning(message)
        return solution.unknowns + change

    def _prepare(self, equations: Linearised, matrix: sparse.bsr_array, prescribed: np.ndarray, spring: float) -> None:
        """Set up the linear solver, unless the matrix is the one of the last step."""
        key = (equations.key, spring)
        if equations.same_matrix and key == self._prepared_for:
            return
        phase = "factorise" if isinstance(self.linear, Direct) else "setup"
        with self.run.phase(phase):
            released = prescribed.reshape(-1)
            eliminated = without_fixed(matrix, released, copy=False)
            symmetric, basis = equations.symmetric, None
            if not symmetric:
                basis = without_fixed(self._contact_rows(equations, spring, coupled=False), released, copy=False)
            modes = local_near_nullspace(self.local, released)
            self._prepared = self.linear.setup(eliminated, modes, symmetric=symmetric, preconditioner=basis,
                                               previous=self._prepared)
        self._prepared_for = key

    def _contact_rows(self, equations: Linearised, spring: float, coupled: bool) -> sparse.bsr_array:
        """The matrix with Coulomb coupling (if ``coupled``), curvature and springs in the rows of contact nodes."""
        system = self.local.system
        data = self._matrix.data.copy()
        contact = system.contact_of[self._rows]
        if spring:
            at = np.flatnonzero((contact >= 0) & (self._rows == self._matrix.indices))
            data[at] += spring * self.stiffness[contact[at]][:, :, None] * np.eye(system.dim)
        if coupled and not equations.symmetric:
            at = np.flatnonzero(contact >= 0)
            pull = (equations.coupling[:, None] * equations.direction)[contact[at]]
            data[at, 1:] -= pull[:, :, None] * data[at, :1]
        at = np.flatnonzero((contact >= 0) & (self._rows == self._matrix.indices))
        node = contact[at]
        data[at, 1:, 1:] += equations.curvature[node]
        return sparse.bsr_array((data, self._matrix.indices, self._matrix.indptr), shape=self._matrix.shape)


def glued_system(discrete: DiscreteProblem) -> tuple[sparse.bsr_array, np.ndarray, np.ndarray]:
    """The linear system with all contact dofs fixed."""
    system, load, modes, _ = _glued(discrete)
    return system, load, modes


def _glued(discrete: DiscreteProblem) -> tuple[sparse.bsr_array, np.ndarray, np.ndarray, np.ndarray]:
    local = local_system(discrete)
    dim = discrete.dim
    kept = np.flatnonzero(local.system.contact_of < 0)
    if not len(kept):
        raise ValueError("every node is a contact node: nothing is left of the glued problem")
    dofs = (dim * kept[:, None] + np.arange(dim)).reshape(-1)
    matrix = sparse.csr_array(local.system.matrix)[dofs][:, dofs]
    matrix = sparse.bsr_array(matrix, blocksize=(dim, dim)).sorted_indices()
    return matrix, local.load[dofs], local_near_nullspace(local)[dofs], dofs
