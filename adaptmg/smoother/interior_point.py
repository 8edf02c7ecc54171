r"""interior_point: a contact problem with a small dense matrix, by a primal-dual interior point
method.

With w the displacement of the contact nodes in their frames, forces q = f - S w, the pressure p,
the gap y, the compliance e of their surface, the bound B = s + mu p on friction, the slip
:math:`\tau` and its bound v, each node has a pair and a pair of cones,

.. math:: p\,y = \epsilon,\quad y = g_0 + e p - w_n;\qquad
          B v - q_t\cdot\tau = \epsilon,\quad v q_t = B\tau,\quad B \ge |q_t|,\quad v \ge |\tau|,

and at :math:`\epsilon = 0` Coulomb's law exactly: B follows p, so that the equations are not
symmetric. A step eliminates (v, q_t) and p node by node, which adds a block to S at each node, and
solves with one factorisation for a predictor (:math:`\epsilon = 0`) and a corrector (S. Mehrotra,
SIAM J. Optim. 2, 1992, doi:10.1137/0802028). There is no status that could come back, and the
number of steps hardly depends on the body.

Linearised, with a prime for the changes in a step,

.. math:: (y + e p)\,p' = p\,w_n' + \pi;\qquad
          B v' - \tau\cdot q_t' = q_t\cdot\tau' - \mu v\,p' + \rho,\quad
          q_t v' + v q_t' = B \tau' + \mu\tau\,p' + \sigma,

with what the equations miss, :math:`\rho = \epsilon - (B v - q_t\cdot\tau)` and :math:`\sigma = B\tau -
v q_t`, and :math:`\pi = \epsilon - p y - p\,(g_0 - w_n + e p - y)`. The corrector subtracts the products of
the changes of the predictor.

A plane problem has a second tangent that nothing moves. A state of a node is (w_n, w_1, w_2, p, y,
v, q_1, q_2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, cast

import numpy as np
from scipy import linalg, sparse

from adaptmg import _checks as checks
from adaptmg._numba import inner_kernel, kernel
from adaptmg.smoother.system import Layer, NodalContact

#: columns of a state: the pressure p, the gap y, the bound v on the slip, the friction q_1 and q_2
_PRESSURE, _GAP, _SLIP_BOUND, _FRICTION_1, _FRICTION_2 = range(3, 8)
_FORCES = [_PRESSURE, _FRICTION_1, _FRICTION_2]
#: steps in a row without a better iterate, after which a slack below SIX_DIGITS is at rounding: a hundredth and
#: a hundred times of that slack change none of 119 solves, paths and loops (campaign constants)
_IDLE = 4
#: part of the longest admissible step that is taken; a step shorter than _SHORT is replaced by one that aims at the
#: share _CENTRED of the mean product. Half of _FRACTION changes 29 of 119 solves, paths and loops; half and twice of
#: _SHORT 1 and 3, of _CENTRED 2 and 1 (campaign constants)
_FRACTION, _SHORT, _CENTRED = 0.995, 0.3, 0.3
#: springs of the start, relative to the diagonal, one after the other: where after the number of steps below more
#: than half of the forces that do not balance at the start is left, its displacements are too small, which keeps
#: steps short (a band that slips round a drum). Steps of 12 such bands: 986 with the first springs alone, 335 with
#: 1e-3 as the second ones, 243 with these; of 34 other solves 399. At 4 and 16 steps: 215 and 302; 403 and 399
_SPRINGS = (1e-2, 1e-4, 1e-6)
_FIRST_STEPS = 8
#: the least energy and displacement that count, over those of the start: bodies that stick everywhere have none;
#: a hundredth changes 5 of 119 solves, paths and loops, a hundred times 5 (campaign constants)
_LEAST = 1e-8


@dataclass(frozen=True, eq=False)
class Conditions:
    """Contact conditions of nodes, as those of :class:`adaptmg.smoother.system.NodalContact`."""

    gap: np.ndarray
    slip_reference: np.ndarray
    limit: np.ndarray
    friction: np.ndarray
    lowest: np.ndarray | None = None
    compliance: np.ndarray | None = None
    layer: Layer | None = None


@dataclass(frozen=True, eq=False)
class Interior:
    """An iterate of the method with its slack."""

    values: np.ndarray  # (n_contact, dim): w, m
    forces: np.ndarray  # (n_contact, dim): (p, q_t), N
    unknowns: np.ndarray  # (m,): those of the matrix
    slack: float  # largest of the products over the energy, gap errors over lengths, residual over forces
    steps: int


def interior_point(
    unknowns: Span,
    load: np.ndarray,
    contact: NodalContact | Conditions,
    stiffness: np.ndarray,
    tolerance: float,
    offset: np.ndarray | float = 0.0,
    most: int = 60,
) -> Interior:
    """Solve S x + R'q = f, w = offset + R x, with the contact conditions on w, and return the best
    iterate of at most ``most`` steps, which end where its slack is at most ``tolerance``. S and R are
    those of ``unknowns`` (:class:`Span`); ``load`` (m,) is f, ``offset`` (n_contact, dim) in m.
    ``stiffness`` (n_contact, dim), N/m, scales the start, which needs no admissible displacement."""
    if contact.lowest is not None:
        return _two_obstacles(unknowns, load, contact, stiffness, tolerance, offset, most)
    # the first springs hold the start; softer ones replace it where its first steps stay short
    springs = list(_SPRINGS)
    method = _Method(unknowns, load, contact, springs.pop(0) * stiffness, offset)
    best = method.iterate()
    steps = 0
    idle_steps = 0
    while steps < most and best.slack > tolerance:
        if idle_steps >= _IDLE and best.slack < checks.SIX_DIGITS:
            break
        if springs and method.steps == _FIRST_STEPS and method.unbalanced > 0.5:
            method = _Method(unknowns, load, contact, springs.pop(0) * stiffness, offset)
            method.iterate()  # measures what the next step reads
            idle_steps = 0
        if not method.advance():
            break
        present = method.iterate()
        steps += 1
        idle_steps += 1
        if present.slack < best.slack:
            best = present
            idle_steps = 0
    return replace(best, steps=steps)


def _two_obstacles(
    unknowns: Span,
    load: np.ndarray,
    contact: NodalContact | Conditions,
    stiffness: np.ndarray,
    tolerance: float,
    offset: np.ndarray | float,
    most: int,
) -> Interior:
    """Solve as :func:`interior_point` does, whose arguments these are, with an obstacle on either side:
    each node occurs twice, the second time with the opposite displacement."""
    n = len(stiffness)
    gaps = np.append(contact.gap, -cast("np.ndarray", contact.lowest))
    conditions = Conditions(
        gap=gaps,
        slip_reference=np.zeros((2 * n, 0)),
        limit=np.zeros(2 * n),
        friction=np.zeros(2 * n),
    )
    shift = np.broadcast_to(offset, stiffness.shape)
    shifts = np.concatenate([shift, -shift])
    both = interior_point(
        _TwoObstacles(unknowns),
        load,
        conditions,
        stiffness=np.concatenate([stiffness, stiffness]),
        tolerance=tolerance,
        offset=shifts,
        most=most,
    )
    return replace(both, values=both.values[:n], forces=both.forces[:n] - both.forces[n:])


class _TwoObstacles:
    """Unknowns whose n nodes occur twice, with w and with -w; see :class:`Span`. The blocks of both
    occurrences add up."""

    def __init__(self, unknowns: Span) -> None:
        self.unknowns = unknowns
        self.product = unknowns.product

    def values(self, unknowns: np.ndarray) -> np.ndarray:
        values = self.unknowns.values(unknowns)
        return np.concatenate([values, -values])

    def restricted(self, forces: np.ndarray) -> np.ndarray:
        front, behind = np.split(forces, 2)
        return self.unknowns.restricted(front - behind)

    def factors(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        front, behind = np.split(blocks, 2)
        return self.unknowns.factors(front + behind)


class _Method:
    """The iterate of an interior point method, and its steps; ``springs`` (n_contact, dim), N/m, hold
    the contact nodes at the start.

    ``state`` (n_contact, 8) and its ``change`` have the columns of the module's docstring. The
    eliminated unknowns add ``blocks`` (n_contact, 3, 3) to S; ``terms`` (n_contact, 4) are the
    right-hand sides of their equations. ``n_products`` is the number of the products that tend to 0,
    whose sum is ``total``; ``residual`` (m,) is f - S x - R'q. :meth:`iterate` sets both for the next
    step. Energies below ``least_energy`` and lengths below ``least_length`` count as these."""

    def __init__(
        self,
        unknowns: Span,
        load: np.ndarray,
        contact: NodalContact | Conditions,
        springs: np.ndarray,
        offset: np.ndarray | float,
    ) -> None:
        n, dim = springs.shape
        self.dim = dim
        self.steps = 0
        #: the residual over that of the start
        self.unbalanced = 1.0
        self.load = load
        self.span = unknowns
        # without an obstacle there is no pressure, and so no friction by it
        friction = np.where(np.isfinite(contact.gap), contact.friction, 0.0)
        compliance = np.zeros(n) if contact.compliance is None else contact.compliance
        self.layer = contact.layer
        reference = np.zeros((n, 2))
        reference[:, : dim - 1] = contact.slip_reference
        #: the arrays of contact conditions that kernels read: g_0, the reference of slips, s, mu, e
        self.conditions = contact.gap, reference, contact.limit, friction, compliance
        rough = (contact.limit > 0) | (friction > 0)
        self.n_products = max(int(np.isfinite(contact.gap).sum() + rough.sum()), 1)
        self.blocks = np.zeros((n, 3, 3))
        self.terms = np.zeros((n, 4))
        self.change = np.zeros((n, 8))
        self.state = np.zeros((n, 8))
        self._start(springs, offset)

    def _start(self, springs: np.ndarray, offset: np.ndarray | float) -> None:
        """Set the first state: the displacement, R x plus the ``offset`` (n_contact, dim), m, under the load
        with ``springs`` (n_contact, dim), N/m, in place of contact, then the pairs at that displacement."""
        self.blocks[:, range(self.dim), range(self.dim)] = springs
        solve = self._factorise()
        self.unknowns = np.zeros_like(self.load) if solve is None else solve(self.load)
        self.state[:, : self.dim] = self.span.values(self.unknowns) + offset
        self.least_energy = _LEAST * float(self.load @ self.unknowns)
        # above 0, since lengths are divided by it
        self.least_length = max(_LEAST * np.abs(self.state[:, :3]).max(initial=0.0), 1e-300)
        self._start_pairs(springs[:, 0])

    def _start_pairs(self, spring: np.ndarray) -> None:
        """Set p, y and v of the first state, at the displacement that it has: the pressure of a spring
        (n_contact,), N/m, the gap that is left, and a bound above the slip. Pressures and gaps are at
        least their mean absolute values, so that every product is positive."""
        state = self.state
        gap, reference, limit, friction, _ = self.conditions
        has_obstacle = np.isfinite(gap)
        rough = (limit > 0) | (friction > 0)
        # the springs hold w itself, also across a gap: spring * w is the force that they bear. Where
        # bodies overlap at the start, g_0 < 0, the overlap w - g_0 presses, with or without loads
        pressures = (spring * np.maximum(state[:, 0], state[:, 0] - gap))[has_obstacle]
        gaps = (gap - state[:, 0])[has_obstacle]
        slips = np.linalg.norm(state[rough, 1:3] - reference[rough], axis=1)
        mean_pressure, mean_gap, mean_slip = (
            np.abs(sizes).sum() / max(len(sizes), 1) for sizes in (pressures, gaps, slips)
        )
        # nodes without an obstacle, or without friction, have any positive value
        state[:, [_GAP, _SLIP_BOUND]] = 1.0
        state[has_obstacle, _PRESSURE] = np.maximum(pressures, mean_pressure)
        state[has_obstacle, _GAP] = np.maximum(gaps, mean_gap)
        # v > |tau|, by a tenth and the mean slip, where nothing slips by the mean gap, and never 0
        distance = mean_slip if mean_slip > 0 else max(mean_gap, 1e-300)
        state[rough, _SLIP_BOUND] = 1.1 * slips + distance

    def _factorise(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """Return the solution of equations with S and the ``blocks``; see :meth:`Span.factors`."""
        return self.span.factors(np.ascontiguousarray(self.blocks[:, : self.dim, : self.dim]))

    def iterate(self) -> Interior:
        """Measure the present state, and return it as an iterate with its slack. A nonlinear surface
        layer is linearised at its pressures."""
        product = self.span.product(self.unknowns)
        forces = self.state[:, _FORCES[: self.dim]]
        self.residual = self.load - product - self.span.restricted(forces)  # f - S x - R'q
        if self.layer is not None:
            gap, compliance = self.layer.tangent(self.state[:, _PRESSURE])
            # the reference of slips, s and mu stay
            self.conditions = gap, *self.conditions[1:4], compliance
        self.total, gap_error, length = _measure(self.state, *self.conditions)
        energy = max(float(self.unknowns @ product), self.least_energy)
        force_size = np.abs([self.load, product]).max(initial=0.0)
        # of the products, of the gaps, and of the equilibrium
        slack = max(
            self.total / energy if energy > 0 else np.inf,
            gap_error / max(self.least_length, length),
            np.abs(self.residual).max(initial=0.0) / force_size if force_size > 0 else 0.0,
        )
        return Interior(
            values=self.state[:, : self.dim].copy(),
            forces=forces,
            unknowns=self.unknowns,
            slack=slack,
            steps=0,  # :func:`interior_point` counts them
        )

    def advance(self) -> bool:
        """Take a step; return False if the matrix is singular, the new unknowns are not finite, or no
        product is left that could tend to 0, as without obstacles and friction.

        The predictor aims at products of 0. The corrector aims at their mean times the cube of the
        share that the predictor would leave (Mehrotra). If the corrector allows a short step only, a
        direction without second-order terms replaces it where that allows a longer one."""
        self.blocks[:] = 0.0
        _eliminate(self.state, *self.conditions, self.blocks)
        solve = self._factorise()
        mean = self.total / self.n_products
        if solve is None or not self.total > 0:
            return False
        self.change[:] = 0.0
        _, longest = self._direction(solve, target=0.0, weight=0.0)
        length = min(1.0, longest)
        predicted_total, _, _ = _measure(self.state + length * self.change, *self.conditions)
        centring = min(max(predicted_total / self.total, 0.0), 1.0) ** 3
        # products of changes go with the square of the step: of a short predictor they count in that
        # proportion, of one that goes at least half of its way in full
        second_order = 1.0 if length >= 0.5 else length * length
        step, length = self._direction(solve, target=centring * mean, weight=second_order)
        if _FRACTION * length < _SHORT:
            corrected_step = step
            corrected_length = length
            corrected_change = self.change.copy()
            step, length = self._direction(solve, target=_CENTRED * mean, weight=0.0)
            if length < corrected_length:
                step = corrected_step
                length = corrected_length
                self.change = corrected_change
        length = min(1.0, _FRACTION * length)
        self.state = self.state + length * self.change
        self.unknowns = self.unknowns + length * step
        self.unbalanced *= 1.0 - length
        self.steps += 1
        return bool(np.isfinite(self.unknowns).all())

    def _direction(
        self, solve: Callable[[np.ndarray], np.ndarray], target: float, weight: float
    ) -> tuple[np.ndarray, float]:
        """Return the change (m,) of the unknowns towards products of ``target``, with second-order
        terms of the last change times ``weight``, and the longest step along it that keeps the state
        positive. The change of the state is left in ``change``."""
        sides = np.zeros((len(self.state), 3))
        _right_sides(self.state, *self.conditions, self.change, target, weight, self.terms, sides)
        step = solve(self.residual + self.span.restricted(sides[:, : self.dim]))
        self.change[:, : self.dim] = self.span.values(step)
        return step, _complete_change(self.state, *self.conditions, self.terms, self.change)


class Span(Protocol):
    """The unknowns x (m,) of a matrix S (m, m), and the displacements R x that they give the contact
    nodes, in their frames."""

    def product(self, unknowns: np.ndarray) -> np.ndarray:
        """Return S x."""
        ...

    def values(self, unknowns: np.ndarray) -> np.ndarray:
        """Return R x (n_contact, dim)."""
        ...

    def restricted(self, forces: np.ndarray) -> np.ndarray:
        """Return R'q (m,) of forces q (n_contact, dim)."""
        ...

    def factors(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        """Return the solution of equations with S + R'DR as a function of right-hand sides (m,), D
        the blocks (n_contact, dim, dim) of the nodes; None where the matrix is singular."""


@dataclass(eq=False)
class DenseSpan:
    """Unknowns of a dense matrix S (m, m), with R as ``rows`` (n_contact * dim, m); see
    :class:`Span`. Subclasses define the factors."""

    matrix: np.ndarray
    rows: sparse.csr_array
    dim: int

    def product(self, unknowns: np.ndarray) -> np.ndarray:
        return self.matrix @ unknowns

    def values(self, unknowns: np.ndarray) -> np.ndarray:
        return (self.rows @ unknowns).reshape(-1, self.dim)

    def restricted(self, forces: np.ndarray) -> np.ndarray:
        return self.rows.T @ forces.reshape(-1)


class ContactDofs:
    """The free dofs of contact nodes as unknowns, with a dense matrix; see :class:`Span`."""

    def __init__(self, matrix: np.ndarray, free: np.ndarray) -> None:
        """Take the dofs of a mask ``free`` (n_contact, dim) from the matrix of all contact dofs."""
        self.free = np.flatnonzero(free.reshape(-1))
        self.shape = free.shape
        self.matrix = np.ascontiguousarray(matrix[self.free[:, None], self.free])
        # flat positions of the entries between free dofs of a node, in the blocks (n_contact, dim, dim)
        # and in the matrix, whose rows and columns are the numbers of the dofs among the free ones
        number = (np.cumsum(free) - 1).reshape(free.shape)
        in_matrix = len(self.free) * number[:, :, None] + number[:, None, :]
        self._in_blocks = np.flatnonzero(free[:, :, None] & free[:, None, :])
        self._in_matrix = in_matrix.reshape(-1)[self._in_blocks]

    def product(self, unknowns: np.ndarray) -> np.ndarray:
        return self.matrix @ unknowns

    def values(self, unknowns: np.ndarray) -> np.ndarray:
        result = np.zeros(self.shape)
        result.reshape(-1)[self.free] = unknowns
        return result

    def restricted(self, forces: np.ndarray) -> np.ndarray:
        return forces.reshape(-1)[self.free]

    def factors(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        matrix = self.matrix.copy()
        matrix.reshape(-1)[self._in_matrix] += blocks.reshape(-1)[self._in_blocks]
        return dense_factors(matrix)


def dense_factors(matrix: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
    """Return the solution (m,) of equations with a matrix (m, m), which is overwritten, as a function of
    right-hand sides (m,); None where the matrix is singular."""
    # LAPACK stores by columns: the transpose, in the memory of the matrix, is overwritten without a copy
    lower, pivots, info = linalg.lapack.dgetrf(matrix.T, overwrite_a=True)
    return None if info else lambda rhs: linalg.lapack.dgetrs(lower, pivots, rhs, trans=1)[0]


@inner_kernel
def _node_state(state, i):
    """Return the state of a node as a tuple (w_n, w_1, w_2, p, y, v, q_1, q_2)."""
    return (
        state[i, 0],
        state[i, 1],
        state[i, 2],
        state[i, 3],
        state[i, 4],
        state[i, 5],
        state[i, 6],
        state[i, 7],
    )


@inner_kernel
def _with_slip_and_bound(state, reference, limit, friction, i):
    """Return (w_n, tau_1, tau_2, p, y, v, q_1, q_2, B) of a node."""
    w, w_1, w_2, p, y, v, q_1, q_2 = _node_state(state, i)
    t_1 = w_1 - reference[i, 0]
    t_2 = w_2 - reference[i, 1]
    return w, t_1, t_2, p, y, v, q_1, q_2, limit[i] + friction[i] * p


@inner_kernel
def _solve_cone(b, v, q_1, q_2, t_1, t_2, e, e_1, e_2):
    """Return (dv, dq_1, dq_2) with B dv - tau.dq = e and q dv + v dq = (e_1, e_2), tau = (t_1, t_2)."""
    dv = (e + (t_1 * e_1 + t_2 * e_2) / v) / (b + (t_1 * q_1 + t_2 * q_2) / v)
    return dv, (e_1 - q_1 * dv) / v, (e_2 - q_2 * dv) / v


@inner_kernel
def _longest_step(b, q_1, q_2, db, dq_1, dq_2):
    """Return the longest step t with B + t dB >= |q + t dq|: at most where B + t dB = 0, and the
    least positive root of (B + t dB)^2 - |q + t dq|^2 = a t^2 + 2 h t + c. For h < 0 the root is written
    as c over the other one times a, which does not cancel; for a < 0 there is a root, as c >= 0."""
    a = db * db - dq_1 * dq_1 - dq_2 * dq_2
    h = b * db - q_1 * dq_1 - q_2 * dq_2
    c = max(b * b - q_1 * q_1 - q_2 * q_2, 0.0)
    step = -b / db if db < 0 else np.inf
    discriminant = h * h - a * c
    if h < 0 and discriminant >= 0:
        step = min(step, c / (np.sqrt(discriminant) - h))
    elif a < 0:
        step = min(step, (h + np.sqrt(discriminant)) / -a)
    return step


@kernel
def _measure(state, gap, reference, limit, friction, compliance):
    """Return the sum of the products p y and B v - q.t of all pairs (t the slip), the largest error
    of a gap, and the largest displacement."""
    total = 0.0
    gap_error = 0.0
    size = 0.0
    for i in range(len(state)):
        w, w_1, w_2, p, y, v, q_1, q_2 = _node_state(state, i)
        size = max(size, abs(w), abs(w_1), abs(w_2))
        if np.isfinite(gap[i]):
            total += p * y
            gap_error = max(gap_error, abs(gap[i] - w + compliance[i] * p - y))
        if limit[i] > 0 or friction[i] > 0:
            total += (
                (limit[i] + friction[i] * p) * v
                - q_1 * (w_1 - reference[i, 0])
                - q_2 * (w_2 - reference[i, 1])
            )
    return total, gap_error, size


@kernel
def _eliminate(state, gap, reference, limit, friction, compliance, blocks):
    """Write to ``blocks`` (n, 3, 3), zero before, the derivatives of the eliminated (p, q_1, q_2) of
    each node with respect to (w, w_1, w_2): the solutions of the linearised equations (module) for a
    change of 1 of one of these, all that the equations miss being zero."""
    for i in range(len(state)):
        node = _with_slip_and_bound(state, reference, limit, friction, i)
        _, t_1, t_2, p, y, v, q_1, q_2, b = node
        mu = friction[i]
        # the pair p, y
        if np.isfinite(gap[i]):
            blocks[i, 0, 0] = p / (y + compliance[i] * p)
        # the cones B >= |q_t| and v >= |tau|
        if limit[i] > 0 or mu > 0:
            # columns of w_1 and w_2: q.tau' and B tau'; then that of w, on which q depends through p: the
            # terms of p'
            for j, e, e_1, e_2 in ((1, q_1, b, 0.0), (2, q_2, 0.0, b)):
                _, blocks[i, 1, j], blocks[i, 2, j] = _solve_cone(
                    b, v, q_1, q_2, t_1, t_2, e, e_1, e_2
                )
            _, k_1, k_2 = _solve_cone(b, v, q_1, q_2, t_1, t_2, -v * mu, t_1 * mu, t_2 * mu)
            blocks[i, 1, 0] = k_1 * blocks[i, 0, 0]
            blocks[i, 2, 0] = k_2 * blocks[i, 0, 0]


@kernel
def _right_sides(
    state, gap, reference, limit, friction, compliance, before, target, weight, terms, sides
):
    """Write what the linearised equations (module) miss to ``terms`` (n, 4), which
    :func:`_complete_change` reads: minus the change of p by it, then rho and sigma, named e, e_1 and
    e_2. Minus the changes of (p, q_1, q_2) by all of these go to ``sides`` (n, 3), the right-hand sides
    of the nodes. Products tend to ``target``; those of the changes ``before`` (n, 8) of the predictor
    count times ``weight``."""
    for i in range(len(state)):
        node = _with_slip_and_bound(state, reference, limit, friction, i)
        w, t_1, t_2, p, y, v, q_1, q_2, b = node
        _, d_1, d_2, dp, dy, dv, dq_1, dq_2 = _node_state(before, i)
        mu = friction[i]
        # the pair: y dp + p dy = target - p y, where dy = gap_error + e dp - dw
        pressure_change = 0.0
        if np.isfinite(gap[i]):
            gap_error = gap[i] - w + compliance[i] * p - y
            product_error = target - p * y - weight * dp * dy
            pressure_change = (product_error - p * gap_error) / (y + compliance[i] * p)
        sides[i, 0] = -pressure_change
        terms[i, 0] = -pressure_change
        # the cones; B changes by mu dp
        if limit[i] > 0 or mu > 0:
            e = (
                target
                - (b * v - q_1 * t_1 - q_2 * t_2)
                - weight * (mu * dp * dv - dq_1 * d_1 - dq_2 * d_2)
            )
            e_1 = b * t_1 - v * q_1 - weight * (dv * dq_1 - mu * dp * d_1)
            e_2 = b * t_2 - v * q_2 - weight * (dv * dq_2 - mu * dp * d_2)
            terms[i, 1] = e
            terms[i, 2] = e_1
            terms[i, 3] = e_2
            _, k_1, k_2 = _solve_cone(
                b,
                v,
                q_1,
                q_2,
                t_1,
                t_2,
                e - v * mu * pressure_change,
                e_1 + t_1 * mu * pressure_change,
                e_2 + t_2 * mu * pressure_change,
            )
            sides[i, 1] = -k_1
            sides[i, 2] = -k_2


@kernel
def _complete_change(state, gap, reference, limit, friction, compliance, terms, change):
    """Complete ``change`` (n, 8), whose columns w, w_1, w_2 are given, by the columns p, y, v, q_1,
    q_2, the solution of the linearised equations (module) with the ``terms`` that they miss; return
    the longest step that keeps p, y >= 0, B >= |q_t| and v >= |tau|."""
    longest = 1e30  # no limit
    for i in range(len(state)):
        node = _with_slip_and_bound(state, reference, limit, friction, i)
        w, t_1, t_2, p, y, v, q_1, q_2, b = node
        mu = friction[i]
        d = change[i, 0]
        d_1 = change[i, 1]
        d_2 = change[i, 2]
        # the pair p, y
        dp = 0.0
        if np.isfinite(gap[i]):
            e = compliance[i]
            dp = p / (y + e * p) * d - terms[i, 0]
            dy = gap[i] - w + e * p - y - d + e * dp
            change[i, _PRESSURE] = dp
            change[i, _GAP] = dy
            if dp < 0:
                longest = min(longest, -p / dp)
            if dy < 0:
                longest = min(longest, -y / dy)
        # the cones B >= |q_t| and v >= |tau|
        if limit[i] > 0 or mu > 0:
            dv, dq_1, dq_2 = _solve_cone(
                b,
                v,
                q_1,
                q_2,
                t_1,
                t_2,
                terms[i, 1] - v * mu * dp + q_1 * d_1 + q_2 * d_2,
                terms[i, 2] + b * d_1 + t_1 * mu * dp,
                terms[i, 3] + b * d_2 + t_2 * mu * dp,
            )
            change[i, _SLIP_BOUND] = dv
            change[i, _FRICTION_1] = dq_1
            change[i, _FRICTION_2] = dq_2
            longest = min(
                longest,
                _longest_step(b, q_1, q_2, mu * dp, dq_1, dq_2),
                _longest_step(v, t_1, t_2, dv, d_1, d_2),
            )
    return longest
