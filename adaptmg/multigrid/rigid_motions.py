r"""RigidMotions: motions of a body that only contact holds, taken to the least energy.

A combination M of rigid motions that vanishes at the fixed dofs has A M = 0: the step M c changes
no residual, only the slips :math:`\tau_i` and gaps. With the load f, g = s + mu p frozen and the
local values :math:`N_i, T_i` of M at the contact nodes the energy changes by

.. math:: \phi(c) = -(M^T f)\cdot c + \sum_i g_i\,(|\tau_i + T_i c| - |\tau_i|),\qquad N_i c \le g_{0,i} - w_{n,i},

where c moves neither closed nodes along their normals nor sticking nodes along their tangents; open
nodes, whose friction has s alone, may stick, too. While such a c is left, truncated coarse matrices
are singular (2D) or nearly so (3D). The minimum ends that: in 2D it lies where an open node closes
or a slip vanishes (the median of the slips, weighted with g); in 3D slips that are not parallel
hold the body too. A step goes along :math:`-H^{-1} s` with gradient s and (3D) Hessian H of
:math:`\phi`, or -s where H is singular, to the first node that closes, or to the root of the slope

.. math:: -F\cdot d + \sum_i g_i\,\frac{(\tau_i + \alpha T_i d)\cdot T_i d}{|\tau_i + \alpha T_i d|} .
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, cast

import numpy as np
from scipy import linalg

from adaptmg import _checks as checks
from adaptmg.discrete.problem import (
    DiscreteProblem,
    near_nullspace_at,
    remembered_of_structure,
)
from adaptmg.multigrid.truncated_contact import TruncatedContact, friction_slope


def null_combinations(rows: np.ndarray) -> np.ndarray:
    """Return independent columns (k, m) that ``rows`` (n, k) map to zero; entries of a row may
    differ in units."""
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    scaled = rows / size  # columns of length 1, or 0
    # regular rows end here: the squares of the singular values are the eigenvalues of the k x k Gram
    # matrix. Where all of these are above 1e-6, so that Cholesky's factor of the rest exists, the least
    # singular value is above 1e-3, far above ALIKE
    identity = np.eye(rows.shape[1])
    if not linalg.lapack.dpotrf(scaled.T @ scaled - checks.SIX_DIGITS * identity)[1]:
        return np.empty((rows.shape[1], 0))
    return (orthonormal_null_combinations(scaled, checks.ALIKE) / size).T


def orthonormal_null_combinations(rows: np.ndarray, negligible: float) -> np.ndarray:
    """Return orthonormal rows (m, k) of coefficients for which ``rows`` (n, k) vanish, up to
    ``negligible``."""
    # the triangular factor has the same singular values and at most k rows
    _, singular, combinations = np.linalg.svd(np.linalg.qr(rows, mode="r"), full_matrices=True)
    return combinations[np.count_nonzero(singular > negligible) :]


@remembered_of_structure
def _free_combinations(problem: DiscreteProblem) -> tuple[np.ndarray, np.ndarray]:
    """Return the combinations (k, m) of the rigid modes that supports leave free, and the motions
    (n_contact, dim, m) of the contact nodes by them.

    The modes are computed at held and contact nodes only: at all nodes of all levels they take 4 %
    of hierarchy and solve with 263k nodes, and 24 bytes a dof (48 in 3D)."""
    contact_nodes = problem.contact.nodes
    held = problem.fixed_nodes()
    nodes = np.concatenate([contact_nodes, held])
    # without contact nodes no motion is sought; without coordinates none is known
    modes = near_nullspace_at(problem, nodes) if len(contact_nodes) else None
    if modes is None:
        return np.empty((0, 0)), np.empty((len(contact_nodes), problem.dim, 0))
    of_contact, of_held = np.split(modes, [len(contact_nodes)])
    # what supports hold of the modes
    rows = of_held - problem.free_spans(held) @ of_held
    combinations = null_combinations(rows.reshape(-1, modes.shape[2]))
    return combinations, of_contact @ combinations


@remembered_of_structure
def _free_motions(problem: DiscreteProblem) -> np.ndarray:
    """Return the m motions (n_dofs, m) that supports leave free, where there are some."""
    modes = cast("np.ndarray", near_nullspace_at(problem))
    combinations, _ = _free_combinations(problem)
    return modes.reshape(problem.n_dofs, -1) @ combinations


@dataclass(eq=False)
class RigidMotions:
    """The rigid motions of one level that its supports leave free."""

    problem: DiscreteProblem
    load: np.ndarray  # (n_dofs,): f
    at_contact: np.ndarray  # (n_contact, dim, m): their local values N_i, T_i at the contact nodes
    # the last status (closed and held nodes), and the combinations (m, j) of motions that are free in it
    _last_free: tuple[bytes, np.ndarray] = (b"", np.empty(0))

    #: steps at most
    STEPS: ClassVar[int] = 30

    @classmethod
    def of(
        cls, problem: DiscreteProblem, contact: TruncatedContact, load: np.ndarray
    ) -> RigidMotions | None:
        """Return the free motions of a problem under a load (n_dofs,), N, None if it has none, is
        one-dimensional, or its near_nullspace is unknown."""
        # the only motion is a constant: where it is free, the coarsest matrix is singular and shifted
        if problem.dim == 1:
            return None
        _, at_contact = _free_combinations(problem)
        if not at_contact.shape[2]:
            return None
        return cls(problem, load, contact.node_frames @ at_contact)

    def settle(
        self, contact: TruncatedContact, unknowns: np.ndarray, residual: np.ndarray
    ) -> np.ndarray | None:
        """Move unknowns (n_dofs,), and the local values of ``contact`` with them, to the least energy,
        in place; return the motion (n_dofs,), None if they are there."""
        descent = _Descent(self, contact, residual)
        total = np.zeros(self.at_contact.shape[2])
        steps = 0
        while steps < self.STEPS and (change := descent.step()) is not None:
            total += change
            steps += 1
        return self._move(contact, total, unknowns) if steps else None

    def free(self, closed: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return the combinations (m, j) that move ``closed`` nodes along the obstacle only, and ``held``
        ones not along it; masks (n_contact,). An open node may be held, by friction that needs no
        pressure: it then moves along its normal only."""
        key = closed.tobytes() + held.tobytes()
        if key != self._last_free[0]:
            rows = [
                self.at_contact[closed, 0],
                self.at_contact[held, 1:].reshape(-1, self.at_contact.shape[2]),
            ]
            self._last_free = key, null_combinations(np.concatenate(rows))
        return self._last_free[1]

    @cached_property
    def work(self) -> np.ndarray | None:
        """Return the work (m,) of the load on the motions; None where they strain the body, as user-defined
        modes may."""
        motions = _free_motions(self.problem)
        forces = self.problem.decoupled_rows.matrix @ motions
        forces[self.problem.fixed] = 0.0
        scale = np.abs(self.problem.matrix.diagonal()).max() * np.abs(motions).max(axis=0)
        strain = (np.abs(forces).max(axis=0) > checks.ALIKE * scale).any()
        return None if strain else motions.T @ self.load

    def _move(
        self, contact: TruncatedContact, change: np.ndarray, unknowns: np.ndarray
    ) -> np.ndarray:
        """Add a motion, a combination (m,), to unknowns (n_dofs,) in place; the local values of
        ``contact`` contain it already. Return the motion (n_dofs,)."""
        step = _free_motions(self.problem) @ change
        step[self.problem.fixed] = 0.0
        unknowns += step
        # the local values are those of these unknowns up to rounding; gaps and slips that vanish must do
        # so to the bit
        dim = contact.dim
        values = np.einsum("nji,nj->ni", contact.node_frames, contact.values.reshape(-1, dim))
        fixed = self.problem.fixed.reshape(-1, dim)[contact.nodes]
        unknowns.reshape(-1, dim)[contact.nodes] = np.where(fixed, 0.0, values)
        return step


class _Descent:
    """Steps of the motions towards the least energy, which change the values of the contact
    nodes."""

    #: share of F up to which a gradient s counts as zero, by dimension. In 2D the friction of nodes that slip is
    #: constant: only a node that holds the body brings s to zero, but for rounding; in 3D slips may turn until they
    #: balance F. A hundredth and a hundred times change none of 119 solves, paths and loops (campaign constants)
    BALANCED: ClassVar[dict[int, float]] = {2: 1e-12, 3: 1e-2}
    #: friction that does not hold the body yet is raised to this many times what holds it. Any factor above 1 will do:
    #: 1.01 and 100 change none of 160 solves of random problems
    ENOUGH: ClassVar[float] = 2.0

    def __init__(
        self, motions: RigidMotions, contact: TruncatedContact, residual: np.ndarray
    ) -> None:
        """Begin at the values of the contact nodes, with the residual (n_dofs,) there."""
        dim = contact.dim
        self.contact = contact
        self.motions = motions
        self.factor = 1.0  # by which all g are raised
        self.residual = residual
        self.values = contact.values.reshape(-1, dim)  # a view: steps change the contact
        self.reference = contact.reference.reshape(-1, dim - 1)

    @cached_property
    def pressure(self) -> np.ndarray:
        """Return the pressures p (n_contact,), N: most cycles leave no motion free and need none."""
        return np.maximum(self.contact.normal_components(self.residual), 0.0)

    def step(self) -> np.ndarray | None:
        """Take a step; return its combination of motions (m,), None at a minimum."""
        contact = self.contact
        # c moves no closed node along its normal, and no held one along its tangents. Slips are
        # (n_contact, dim - 1), ``tangents`` have the j free motions last
        slip = self.values[:, 1:] - self.reference
        closed = self.values[:, 0] >= contact.gap
        resists = (contact.limit > 0) | (closed & (contact.friction > 0))
        held = resists & ~slip.any(axis=1)
        free = self.motions.free(closed, held)
        if not free.shape[1] or self.motions.work is None:
            return None
        at_contact = self.motions.at_contact
        tangents = at_contact[:, 1:] @ free
        # F = M'f of the free motions, and g = s + mu p
        force = free.T @ self.motions.work
        of_pressure = np.where(closed, contact.friction * self.pressure, 0.0)
        bound = self.factor * np.where(resists, contact.limit + of_pressure, 0.0)
        direction = self._direction(bound, slip, tangents, force)
        if direction is None:
            return None
        # rates of slips and of normal displacements along the direction; where they are rounding a node
        # neither closes nor rubs
        slip_rate = tangents @ direction
        approach = at_contact[:, 0] @ (free @ direction)
        speed = np.linalg.norm(slip_rate, axis=1)
        small = checks.ALIKE * max(speed.max(), np.abs(approach).max())
        bound[speed <= small] = 0.0
        closing = ~closed & (approach > small)
        # lengths of the step at which nodes close, infinite without an obstacle, too
        closes_at = np.full(len(approach), np.inf)
        np.divide(contact.gap - self.values[:, 0], approach, out=closes_at, where=closing)
        first_closing = float(closes_at.min())
        work = float(force @ direction)
        resistance = float(bound @ speed)
        if first_closing == np.inf and not resistance > work:
            # phi has no minimum along the direction: no node closes, and friction with the pressures so
            # far does not hold the body. The same step is taken with all g raised, so that it does
            if not resistance > 0.0:
                return None
            self.factor *= self.ENOUGH * work / resistance
            return self.step()
        length = _step_length(slip, slip_rate, bound, work, first_closing)
        change = length * direction
        if length == first_closing:
            closed[np.argmin(closes_at)] = True
        else:
            # the slip that the step leaves, over the distance by which it moves the node
            left = np.linalg.norm(slip + length * slip_rate, axis=1)
            share_left = np.full(len(left), np.inf)
            np.divide(left, length * speed, out=share_left, where=bound > 0)
            node = int(np.argmin(share_left))
            if share_left[node] < checks.SIX_DIGITS:
                # the least energy lies where the slip of this node vanishes: it does so to the bit
                rest = slip[node] + tangents[node] @ change
                change = change - np.linalg.lstsq(tangents[node], rest, rcond=checks.ALIKE)[0]
                held[node] = True
        change = free @ change
        self._move(change, closed, held)
        return change

    def _move(self, change: np.ndarray, closed: np.ndarray, held: np.ndarray) -> None:
        """Move the values of the contact nodes by a combination of motions (m,); nodes that are
        ``closed`` or ``held`` afterwards are so to the bit."""
        gap = self.contact.gap
        # a closed node keeps its depth, on a spring beyond the gap; one that closes now gets the gap
        depth = np.maximum(self.values[:, 0], gap)
        self.values += self.motions.at_contact @ change
        up_to_gap = np.minimum(self.values[:, 0], gap)
        self.values[:, 0] = np.where(closed, depth, up_to_gap)
        self.values[:, 1:] = np.where(held[:, None], self.reference, self.values[:, 1:])

    def _direction(
        self, bound: np.ndarray, slip: np.ndarray, tangents: np.ndarray, force: np.ndarray
    ) -> np.ndarray | None:
        """Return the direction (j,) of a step in the j free motions, None at a minimum: that of Newton's
        method for sum g |slip| - force, or the steepest descent where the Hessian is singular.
        ``bound`` (n_contact,), ``slip`` (n_contact, dim - 1), ``tangents`` (n_contact, dim - 1, j)
        and ``force`` (j,): g, the slips, the motions at the nodes, and the work of the load."""
        size = np.linalg.norm(slip, axis=1, keepdims=True)
        slip_direction = np.divide(slip, size, out=np.zeros_like(slip), where=size > 0)
        # s = sum g T' tau/|tau| - F
        gradient = np.einsum("n,nt,ntj->j", bound, slip_direction, tangents) - force
        if np.linalg.norm(gradient) <= self.BALANCED[self.contact.dim] * np.linalg.norm(force):
            return None
        if slip.shape[1] == 1:
            return -gradient
        # H = sum (g/|tau|) T' (I - tau tau'/|tau|^2) T
        across_slip = (
            tangents
            - slip_direction[:, :, None]
            * np.einsum("nt,ntj->nj", slip_direction, tangents)[:, None]
        )
        stiffness = np.divide(bound, size[:, 0], out=np.zeros_like(bound), where=size[:, 0] > 0)
        hessian = np.einsum("n,nti,ntj->ij", stiffness, across_slip, tangents)
        eigenvalues, eigenvectors = np.linalg.eigh(hessian)
        if not eigenvalues[0] > checks.ALIKE * eigenvalues[-1]:
            return -gradient
        return -(eigenvectors @ ((eigenvectors.T @ gradient) / eigenvalues))


def _step_length(
    slip: np.ndarray, slip_rate: np.ndarray, bound: np.ndarray, work: float, stop: float
) -> float:
    """Return the length alpha <= ``stop`` of a step at which the slope of phi along it vanishes,
    -F.d + sum g (tau + alpha T d).T d / |tau + alpha T d|; tau is the ``slip`` and T d the
    ``slip_rate`` (n_contact, dim - 1), g the ``bound`` (n_contact,), 0 where T d is, F.d the
    ``work``."""
    rubs = bound > 0
    size = np.linalg.norm(slip, axis=1)
    speed = np.linalg.norm(slip_rate, axis=1)
    # after this length all slips have turned along the step; 1 where none is left, or nothing rubs
    longest = float((size[rubs] / speed[rubs]).max(initial=0.0)) or 1.0
    slope = friction_slope(slip, slip_rate, bound)
    return _root(lambda alpha: slope(alpha) - work, first=2.0 * longest, stop=stop)


def _root(slope: Callable[[float], float], first: float, stop: float) -> float:
    """Find the root of an increasing function in (0, stop], bracketed from ``first``."""
    low = 0.0
    high = min(first, stop)
    while high < stop and slope(high) < 0.0:
        low = high
        high = min(2.0 * high, stop)
    if slope(high) <= 0.0:
        return high
    # bisection: 60 halvings leave less than the rounding of the first length
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if slope(middle) > 0.0 else (middle, high)
    return high
