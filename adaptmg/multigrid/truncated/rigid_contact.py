r"""RigidContact: the contact nodes of a body that moves rigidly, and the way to its least energy, step by step.

With gradient s and (3D) Hessian H of the energy :math:`\phi` of :mod:`~adaptmg.multigrid.truncated.rigid_motions` a
step goes along :math:`-H^{-1} s`, or -s where H is singular, to the minimum on that line: to the first node that
closes, or to the root of the slope

.. math:: -F\cdot d + \sum_i g_i\,\frac{(\tau_i + \alpha T_i d)\cdot T_i d}{|\tau_i + \alpha T_i d|} .
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from adaptmg.multigrid.truncated.contact import TruncatedContact

__all__ = ["RigidContact", "null_combinations"]

#: singular values and values of motions that count as zero, relative to the largest
_ZERO = 1e-10


def null_combinations(rows: np.ndarray) -> np.ndarray:
    """Independent columns (k, m) that ``rows`` (n, k) map to zero; entries of a row may differ in their units."""
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    # by the triangular factor, which has the same singular values and at most k rows
    _, singular, combinations = np.linalg.svd(np.linalg.qr(rows / size, mode="r"), full_matrices=True)
    singular = np.pad(singular, (0, len(combinations) - len(singular)))
    return (combinations[singular <= _ZERO] / size).T


@dataclass(eq=False)
class RigidContact:
    """The contact nodes between two steps.

    Attributes
    ----------
    motions : (n, dim, m) array
        N_i, T_i: local values of the rigid motions.
    values : (n, dim) array
        Local unknowns, those of the level: steps change them.
    gap : (n,) array
    reference : (n, dim - 1) array
        Of the slip.
    limit, friction, pressure : (n,) arrays
        s, mu and p.
    factor : float
        What g is multiplied by: pressures that are not settled may give a friction that cannot hold the body, and an
        energy without minimum.
    """

    motions: np.ndarray
    values: np.ndarray
    gap: np.ndarray
    reference: np.ndarray
    limit: np.ndarray
    friction: np.ndarray
    pressure: np.ndarray
    factor: float = 1.0

    #: share of F to which a minimum balances the forces; in 2D only a node that holds the body will do
    BALANCED: ClassVar[dict[int, float]] = {2: 1e-12, 3: 1e-2}
    #: a slip that is smaller than this after a step, relative to the step, vanishes
    VANISHES: ClassVar[float] = 1e-6
    #: such a friction is made so many times enough
    ENOUGH: ClassVar[float] = 2.0
    #: conditioning up to which H is taken
    REGULAR: ClassVar[float] = 1e-8

    @classmethod
    def of(cls, contact: TruncatedContact, motions: np.ndarray, defect: np.ndarray) -> RigidContact:
        """The contact nodes of a level with the residual f - A u (n_dofs,)."""
        o, dim = contact, contact.dim
        normals = o.frames.reshape(-1, dim, dim)[:, 0]
        pressure = np.maximum(np.einsum("ni,ni->n", normals, defect.reshape(-1, dim)[o.nodes]), 0.0)
        return cls(motions, o.values.reshape(-1, dim), o.gap, o.reference.reshape(-1, dim - 1), o.limit, o.friction,
                   pressure)

    @property
    def closed(self) -> np.ndarray:
        """(n,) bool."""
        return self.values[:, 0] == self.gap

    @property
    def slip(self) -> np.ndarray:
        """tau (n, dim - 1)."""
        return self.values[:, 1:] - self.reference

    @property
    def resists(self) -> np.ndarray:
        """Where friction acts (n,) bool."""
        return (self.limit > 0) | (self.closed & (self.friction > 0))

    def free(self) -> np.ndarray:
        """Combinations (m, j) that move closed nodes along the obstacle only, and held ones not at all."""
        closed, held = self.closed, self.resists & ~self.slip.any(axis=1)
        count = self.motions.shape[2]
        return null_combinations(np.concatenate([self.motions[closed, 0], self.motions[held, 1:].reshape(-1, count)]))

    def step(self, free: np.ndarray, work: np.ndarray) -> np.ndarray | None:
        """Take one step.

        Parameters
        ----------
        free : (m, j) array
            From :meth:`free`, not empty.
        work : (m,) array
            Of the load on the motions, F.

        Returns
        -------
        (m,) array or None
            None if this is the minimum, or there is none.
        """
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
    """The energy along a direction d.

    Attributes
    ----------
    slip, change : (n, dim - 1) arrays
        tau and T d.
    speed : (n,) array
        |T d|.
    bound : (n,) array
        g, zero where friction does not act or the node does not move.
    work : float
        F.d.
    stops : (n,) array
        Lengths at which open nodes close.
    """

    slip: np.ndarray
    change: np.ndarray
    speed: np.ndarray
    bound: np.ndarray
    work: float
    stops: np.ndarray

    @classmethod
    def along(cls, contact: RigidContact, bound: np.ndarray, change: np.ndarray, across: np.ndarray,
              work: float) -> _Line:
        """The line from the present values; ``across`` (n,) is N d."""
        speed = np.linalg.norm(change, axis=1)
        small = _ZERO * max(speed.max(), np.abs(across).max())
        closing = ~contact.closed & (across > small) & np.isfinite(contact.gap)
        stops = np.divide(contact.gap - contact.values[:, 0], across, out=np.full(len(across), np.inf), where=closing)
        return cls(contact.slip, change, speed, np.where(speed > small, bound, 0.0), work, stops)

    @property
    def stop(self) -> float:
        """Where the first node closes."""
        return float(self.stops.min())

    @property
    def held(self) -> float:
        """What friction resists at the end of the line, N m."""
        return float(self.bound @ self.speed)

    def slope(self, length: float) -> float:
        """Derivative of the energy."""
        slip = self.slip + length * self.change
        size = np.linalg.norm(slip, axis=1)
        product = np.einsum("nt,nt->n", slip, self.change)
        return float(self.bound @ np.divide(product, size, out=np.zeros_like(size), where=size > 0)) - self.work

    def minimum(self) -> float:
        """The length at which the energy is least: at most :attr:`stop`."""
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
        """The node whose slip vanishes at a length, if there is one."""
        left = np.linalg.norm(self.slip + length * self.change, axis=1)
        share = np.divide(left, length * self.speed, out=np.full(len(left), np.inf), where=self.bound > 0)
        node = int(np.argmin(share))
        return node if share[node] < small else None
