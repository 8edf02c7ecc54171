r"""RigidMotions: motions of a body that only contact holds, taken to the least energy.

A combination M of rigid motions that vanishes at the fixed dofs has A M = 0: the step M c changes no residual, only the
slips :math:`\tau_i` and gaps. With the load f, g = s + mu p frozen and the local values :math:`N_i, T_i` of M at the
contact nodes the energy changes by

.. math:: \phi(c) = -(M^T f)\cdot c + \sum_i g_i\,(|\tau_i + T_i c| - |\tau_i|),\qquad N_i c \le g_{0,i} - w_{n,i},

where c moves neither closed nodes along their normals nor sticking nodes at all. While such a c is left, truncated
coarse matrices are singular (2D) or nearly so (3D). The minimum ends that: in 2D it lies where an open node closes or a
slip vanishes (the median of the slips, weighted with g); in 3D slips that are not parallel hold the body too. A step
goes along :math:`-H^{-1} s` with gradient s and (3D) Hessian H of :math:`\phi`, or -s where H is singular, to the first
node that closes, or to the root of the slope

.. math:: -F\cdot d + \sum_i g_i\,\frac{(\tau_i + \alpha T_i d)\cdot T_i d}{|\tau_i + \alpha T_i d|} .
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from adaptmg.discrete.problem import DiscreteProblem, remembered_of_structure
from adaptmg.multigrid.truncated_contact import TruncatedContact

#: singular values and values of motions that count as zero, relative to the largest
_ZERO = 1e-10
#: squares of singular values beyond this, relative to the largest, are none, whatever rounding did to them
_CLEAR = 1e-6


def null_combinations(rows: np.ndarray) -> np.ndarray:
    """Return independent columns (k, m) that ``rows`` (n, k) map to zero; entries of a row may differ in units."""
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    squares = np.linalg.eigvalsh((rows / size).T @ (rows / size)) if rows.size else np.zeros(1)
    if squares[0] > _CLEAR * squares[-1]:
        return np.empty((rows.shape[1], 0))
    # by the triangular factor, which has the same singular values and at most k rows
    _, singular, combinations = np.linalg.svd(np.linalg.qr(rows / size, mode="r"), full_matrices=True)
    singular = np.pad(singular, (0, len(combinations) - len(singular)))
    return (combinations[singular <= _ZERO] / size).T


@dataclass(eq=False)
class RigidContact:
    """The contact nodes between two steps."""

    motions: np.ndarray  # (n, dim, m): N_i, T_i, local values of the rigid motions
    values: np.ndarray  # (n, dim): local unknowns of the level, which steps change
    gap: np.ndarray  # (n,)
    reference: np.ndarray  # (n, dim - 1): of the slip
    limit: np.ndarray  # (n,): s, N
    friction: np.ndarray  # (n,): mu
    pressure: np.ndarray  # (n,): p, N
    factor: float = 1.0  # of the friction, where it does not hold the body

    #: share of F to which a minimum balances the forces; in 2D only a node that holds the body will do
    BALANCED: ClassVar[dict[int, float]] = {2: 1e-12, 3: 1e-2}
    #: a slip that is smaller than this after a step, relative to the step, vanishes
    VANISHES: ClassVar[float] = 1e-6
    #: how many times enough such a friction is made
    ENOUGH: ClassVar[float] = 2.0
    #: reciprocal conditioning from which on H counts as regular
    REGULAR: ClassVar[float] = 1e-8

    @classmethod
    def of(cls, contact: TruncatedContact, motions: np.ndarray, residual: np.ndarray) -> RigidContact:
        """Return the contact nodes of a level with the residual f - A u (n_dofs,)."""
        o, dim = contact, contact.dim
        normals = o.frames.reshape(-1, dim, dim)[:, 0]
        pressure = np.maximum(np.einsum("ni,ni->n", normals, residual.reshape(-1, dim)[o.nodes]), 0.0)
        return cls(motions, o.values.reshape(-1, dim), o.gap, o.reference.reshape(-1, dim - 1), o.limit, o.friction,
                   pressure)

    @property
    def closed(self) -> np.ndarray:
        return self.values[:, 0] == self.gap

    @property
    def slip(self) -> np.ndarray:
        """tau (n, dim - 1)."""
        return self.values[:, 1:] - self.reference

    @property
    def resists(self) -> np.ndarray:
        """Where friction acts (n,) bool."""
        return (self.limit > 0) | (self.closed & (self.friction > 0))

    def free(self, last: tuple[bytes, np.ndarray]) -> tuple[bytes, np.ndarray]:
        """Return the combinations (m, j) that move closed nodes along the obstacle only, and held ones not at all.
        Behind the status that they belong to; ``last`` are those of another time."""
        closed, held = self.closed, self.resists & ~self.slip.any(axis=1)
        count = self.motions.shape[2]
        key = bytes([count]) + closed.tobytes() + held.tobytes()
        if key == last[0]:
            return last
        return key, null_combinations(np.concatenate([self.motions[closed, 0],
                                                      self.motions[held, 1:].reshape(-1, count)]))

    def step(self, free: np.ndarray, work: np.ndarray) -> np.ndarray | None:
        resistance = np.where(self.resists, self.limit + np.where(self.closed, self.friction * self.pressure, 0.0), 0.0)
        tangents, force = self.motions[:, 1:] @ free, free.T @ work
        enough = self.BALANCED[self.values.shape[1]] * np.linalg.norm(force)
        for _ in range(3):
            bound = self.factor * resistance
            direction = self._descent(bound, tangents, force, enough)
            if direction is None:
                return None
            across = self.motions[:, 0] @ (free @ direction)
            line = _Line.along(self, bound, tangents @ direction, across, float(force @ direction))
            if np.isfinite(line.stop) or line.held > line.work:
                break
            if not line.held > 0.0:
                return None
            self.factor *= self.ENOUGH * line.work / line.held
        else:
            return None
        length = line.minimum()
        change = length * direction
        closes = int(np.argmin(line.stops)) if length == line.stop else None
        vanishes = None if closes is not None else line.vanishing(length, self.VANISHES)
        if vanishes is not None:
            # its slip to the last bit
            rest = self.slip[vanishes] + tangents[vanishes] @ change
            change = change - np.linalg.lstsq(tangents[vanishes], rest, rcond=_ZERO)[0]
        change = free @ change
        self._advance(change, closes, vanishes)
        return change

    def _descent(self, bound: np.ndarray, tangents: np.ndarray, force: np.ndarray, enough: float) -> np.ndarray | None:
        """The direction (j,) of a step, None at a minimum."""
        slip = self.slip
        size = np.linalg.norm(slip, axis=1)
        moves = size > 0
        size[~moves] = 1.0
        along = np.where(moves[:, None], slip / size[:, None], 0.0)
        gradient = np.einsum("n,nt,ntj->j", bound, along, tangents) - force
        if np.linalg.norm(gradient) <= enough:
            return None
        if slip.shape[1] == 1:
            return -gradient
        turned = tangents - along[:, :, None] * np.einsum("nt,ntj->nj", along, tangents)[:, None]
        hessian = np.einsum("n,nti,ntj->ij", np.where(moves, bound / size, 0.0), turned, tangents)
        values, vectors = np.linalg.eigh(hessian)
        if not values[0] > self.REGULAR * values[-1]:
            return -gradient
        return -(vectors @ ((vectors.T @ gradient) / values))

    def _advance(self, change: np.ndarray, closes: int | None, vanishes: int | None) -> None:
        """The values after a step (m,); nodes that were closed or held, or are now, are so to the bit."""
        closed, held = self.closed, self.resists & ~self.slip.any(axis=1)
        if closes is not None:
            closed[closes] = True
        if vanishes is not None:
            held[vanishes] = True
        self.values += self.motions @ change
        self.values[:, 0] = np.where(closed, self.gap, np.minimum(self.values[:, 0], self.gap))
        self.values[:, 1:] = np.where(held[:, None], self.reference, self.values[:, 1:])


@dataclass(frozen=True, eq=False)
class _Line:
    """The energy along a direction d."""

    slip: np.ndarray  # (n, dim - 1): tau
    change: np.ndarray  # (n, dim - 1): T d
    speed: np.ndarray  # (n,): |T d|
    bound: np.ndarray  # (n,): g, zero where friction does not act or the node does not move
    work: float  # F.d
    stops: np.ndarray  # (n,): lengths at which open nodes close

    @classmethod
    def along(cls, contact: RigidContact, bound: np.ndarray, change: np.ndarray, across: np.ndarray,
              work: float) -> _Line:
        """Return the line from the present values; ``across`` (n,) is N d."""
        speed = np.linalg.norm(change, axis=1)
        small = _ZERO * max(speed.max(), np.abs(across).max())
        closing = ~contact.closed & (across > small) & np.isfinite(contact.gap)
        stops = np.divide(contact.gap - contact.values[:, 0], across, out=np.full(len(across), np.inf), where=closing)
        return cls(contact.slip, change, speed, np.where(speed > small, bound, 0.0), work, stops)

    @property
    def stop(self) -> float:
        return float(self.stops.min())

    @property
    def held(self) -> float:
        """What friction resists at the end of the line, N m."""
        return float(self.bound @ self.speed)

    def slope(self, length: float) -> float:
        slip = self.slip + length * self.change
        size = np.linalg.norm(slip, axis=1)
        product = np.einsum("nt,nt->n", slip, self.change)
        return float(self.bound @ np.divide(product, size, out=np.zeros_like(size), where=size > 0)) - self.work

    def minimum(self) -> float:
        """Return the length at which the energy is least: at most :attr:`stop`."""
        acts = self.bound > 0
        high = min(self.stop, 2.0 * float((np.linalg.norm(self.slip[acts], axis=1) / self.speed[acts]).max(initial=0.0)
                                          or 1.0) if acts.any() else np.inf)
        while high < self.stop and self.slope(high) < 0.0:
            high = min(2.0 * high, self.stop)
        if self.slope(high) <= 0.0:
            return high
        low = 0.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self.slope(middle) > 0.0 else (middle, high)
        return high

    def vanishing(self, length: float, small: float) -> int | None:
        """Return the node whose slip vanishes at a length, if there is one."""
        left = np.linalg.norm(self.slip + length * self.change, axis=1)
        share = np.divide(left, length * self.speed, out=np.full(len(left), np.inf), where=self.bound > 0)
        node = int(np.argmin(share))
        return node if share[node] < small else None


@remembered_of_structure
def _free_motions(problem: DiscreteProblem) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (k, m) of the motions that supports leave free, and those (n_contact, dim, m) of contact nodes."""
    nodes, fixed = problem.contact.nodes, problem.fixed.reshape(-1, problem.dim)
    held = np.unique(np.flatnonzero(problem.fixed) // problem.dim)
    if problem.near_nullspace is None or not len(nodes):
        return np.empty((0, 0)), np.empty((len(nodes), problem.dim, 0))
    modes = problem.near_nullspace.reshape(problem.n_nodes, problem.dim, -1)
    rows = modes[held][fixed[held]]
    if problem.inclined is not None:
        along = np.einsum("nij,njk->nik", problem.inclined.spans, modes[problem.inclined.nodes])
        rows = np.concatenate([rows, along.reshape(-1, rows.shape[1])])
    coefficients = null_combinations(rows)
    return coefficients, modes[nodes] @ coefficients


@dataclass(eq=False)
class RigidMotions:
    """The rigid motions of one level that its supports leave free."""

    problem: DiscreteProblem
    contact: TruncatedContact  # its values are kept equal to the unknowns
    load: np.ndarray  # (n_dofs,): f
    coefficients: np.ndarray  # (k, m): of the motions, in the columns of problem.near_nullspace
    at_contact: np.ndarray  # (n_contact, dim, m): their local values N_i, T_i at the contact nodes
    _work: np.ndarray | None = field(default=None, init=False)
    _free: tuple[bytes, np.ndarray] = field(default=(b"", np.empty(0)), init=False)  # the last, and of which status

    #: steps at most
    STEPS: ClassVar[int] = 30

    @classmethod
    def of(cls, problem: DiscreteProblem, contact: TruncatedContact, load: np.ndarray) -> RigidMotions | None:
        """Return the free motions of a problem, None if it has none or its near_nullspace is unknown."""
        coefficients, cartesian = _free_motions(problem)
        if not coefficients.shape[1]:
            return None
        return cls(problem, contact, load, coefficients, np.einsum(
            "nij,njk->nik", contact.frames.reshape(-1, problem.dim, problem.dim), cartesian))

    def settle(self, unknowns: np.ndarray, past: list[np.ndarray], residual: np.ndarray) -> int:
        """Move to the least energy, in place; returns the number of steps."""
        if not self.at_contact.shape[2]:  # given up: springs hold them
            return 0
        contact = RigidContact.of(self.contact, self.at_contact, residual)
        total, steps = np.zeros(self.at_contact.shape[2]), 0
        while steps < self.STEPS:
            self._free = contact.free(self._free)
            free = self._free[1]
            if not free.shape[1] or not self._strainless():
                break
            change = contact.step(free, self._work)
            if change is None:
                break
            total += change
            steps += 1
        if steps:
            self._move(total, unknowns, past)
        return steps

    def _strainless(self) -> bool:
        """Whether A M = 0, tested when it first matters; if not, the motions are given up."""
        if self._work is None:
            motions = self.problem.near_nullspace @ self.coefficients
            forces = self.problem.matrix @ motions
            forces[self.problem.fixed] = 0.0
            scale = np.abs(self.problem.matrix.diagonal()).max() * np.abs(motions).max(axis=0)
            if (np.abs(forces).max(axis=0) > _ZERO * scale).any():
                self.at_contact = self.at_contact[:, :, :0]
                return False
            self._work = motions.T @ self.load
        return True

    def _move(self, change: np.ndarray, unknowns: np.ndarray, past: list[np.ndarray]) -> None:
        """Carry out a motion (m,) that the values of the contact contain already."""
        o = self.contact
        step = self.problem.near_nullspace @ (self.coefficients @ change)
        step[self.problem.fixed] = 0.0
        for vector in (unknowns, *past):
            vector += step
        # equal but for rounding; gaps and slips that vanish must do so to the bit
        values = np.einsum("nji,nj->ni", o.frames.reshape(-1, o.dim, o.dim), o.values.reshape(-1, o.dim))
        at = unknowns.reshape(-1, o.dim)
        at[o.nodes] = np.where(self.problem.fixed.reshape(-1, o.dim)[o.nodes], 0.0, values)
