r"""A change of displacement that lets the contact status change: the contact problem in the span of aggregates.

Where the status of a displacement is wrong, what is missing in the space of that status says little: a beam whose tip
should touch, a body that hovers. The change d is then sought in the span of P, the rigid motions of
:mod:`adaptmg.solver.aggregates` smoothed by one step of damped Jacobi, under the conditions of all contact nodes. With
the residual r of the displacement, gaps g, slips :math:`\tau`, pressures p and friction :math:`-q`

.. math:: P^T(A P c + N^T p + T^T q - r) = 0,\quad y = g - N P c,\quad p\,y = \varepsilon,\quad
          B v - q\cdot\tau = \varepsilon,\quad v\,q - B\,\tau = 0,\quad B = s + \mu p,

with (B, q) and (v, :math:`\tau`) inside of second-order cones: a primal-dual interior point method (predictor and
corrector), Coulomb's law without a fixed point. The unknowns that reach no contact node are eliminated before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse.linalg import splu

from adaptmg.discrete.problem import DiscreteProblem, remembered_of_structure
from adaptmg.solver.aggregates import aggregates_of, raised

#: steps at most; the work left in the conditions, of the energy of the change, at which they end; of the way to the
#: edge of a cone that a step goes
_STEPS, _ENOUGH, _SHORT, _SOFT = 60, 1e-4, 0.99, 1e-4


@dataclass(frozen=True, eq=False)
class AtNodes:
    """What the nodes that carry the contact conditions have."""

    gap: np.ndarray  # (n_contact,) m
    slip: np.ndarray  # (n_contact, dim), in the tangent plane, m
    pressure: np.ndarray  # (n_contact,) N
    friction: np.ndarray  # (n_contact, dim) N

    def forces(self, normals: np.ndarray) -> np.ndarray:
        """Contact forces (n_contact, dim), N."""
        return self.friction - self.pressure[:, None] * normals


class _Coarse:
    """The smoothed aggregates of a problem: the matrix in their span, condensed to what reaches contact nodes."""

    def __init__(self, problem: DiscreteProblem) -> None:
        aggregates, dim, n = aggregates_of(problem), problem.dim, problem.n_nodes
        matrix, free = sparse.csr_array(problem.matrix), ~problem.fixed
        modes, count = 3 * dim - 3, len(aggregates.starts) - 1
        inside = np.flatnonzero(aggregates.label >= 0)
        motions = np.zeros((len(inside), dim, modes))
        motions[:] = _rigid(aggregates.offset[inside])
        rows = (dim * inside[:, None, None] + np.arange(dim)[:, None]) + np.zeros(modes, dtype=np.int64)
        columns = (modes * aggregates.label[inside].astype(np.int64)[:, None, None] + np.arange(modes)
                   + np.zeros((dim, 1), dtype=np.int64))
        basis = sparse.csr_array((motions.reshape(-1), (rows.reshape(-1), columns.reshape(-1))),
                                 shape=(n * dim, modes * count))
        only_free = sparse.diags_array(free.astype(float), format="csr")
        basis = only_free @ basis
        inverse = np.where(free, 1 / matrix.diagonal(), 0.0)
        vector = np.where(free, np.sin(np.arange(n * dim) ** 2.0), 0.0)
        for _ in range(10):
            largest = np.linalg.norm(vector)
            vector = inverse * (matrix @ (vector / largest))
        damping = 4 / 3 / (1.1 * np.linalg.norm(vector))
        self.span = sparse.csr_array(basis - sparse.diags_array(damping * inverse) @ (matrix @ basis))
        self.span.eliminate_zeros()
        coarse = sparse.csc_array(self.span.T @ (matrix @ self.span))
        coarse = coarse + sparse.diags_array(raised(coarse.diagonal()), format="csc")
        nodes = problem.contact.nodes
        at_contact = self.span[(dim * nodes[:, None] + np.arange(dim)).reshape(-1)]
        touched = np.zeros(modes * count, dtype=bool)
        touched[at_contact.indices] = True
        self.near, self.far = np.flatnonzero(touched), np.flatnonzero(~touched)
        self.rows = sparse.csr_array(at_contact[:, self.near])
        self._factors = splu(sparse.csc_array(coarse[self.far][:, self.far])) if len(self.far) else None
        self._coupling = sparse.csc_array(coarse[self.far][:, self.near])
        self.matrix = coarse[self.near][:, self.near].toarray()
        if self._factors is not None:
            self.matrix -= self._coupling.T @ self._factors.solve(self._coupling.toarray())

    def condense(self, load: np.ndarray) -> np.ndarray:
        """Of forces (n_coarse,) what the condensed equations take."""
        if self._factors is None:
            return load[self.near]
        return load[self.near] - self._coupling.T @ self._factors.solve(load[self.far])

    def recover(self, load: np.ndarray, near: np.ndarray) -> np.ndarray:
        """The displacement (n_dofs,) of condensed unknowns."""
        values = np.zeros(self.span.shape[1])
        values[self.near] = near
        if self._factors is not None:
            values[self.far] = self._factors.solve(load[self.far] - self._coupling @ near)
        return self.span @ values


_coarse_of = remembered_of_structure(_Coarse)


def _rigid(offset: np.ndarray) -> np.ndarray:
    """Rigid motions (n, dim, modes) at places (n, dim) from the centre of their aggregates."""
    n, dim = offset.shape
    if dim == 2:
        turns = np.stack([-offset[:, 1], offset[:, 0]], axis=1)[:, :, None]
    else:
        turns = np.cross(np.eye(3)[None], offset[:, None]).swapaxes(1, 2)
    return np.concatenate([np.broadcast_to(np.eye(dim), (n, dim, dim)), turns], axis=2)


def changed_status(problem: DiscreteProblem, residual: np.ndarray, here: AtNodes, stiffness: np.ndarray,
                   limit: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The change (n_dofs,) of unknowns with this residual (n_dofs,), and the contact forces (n_contact, dim) that it
    ends with; None if it is not found. ``stiffness`` and ``limit`` (n_contact,): of the nodes, N/m, and of friction
    without pressure, N."""
    coarse = _coarse_of(problem)
    load, n = coarse.span.T @ residual, len(problem.contact)
    # where a support holds a tangent its reaction takes the place of friction
    free = ~problem.fixed.reshape(-1, problem.dim)[problem.contact.nodes].any(axis=1)
    law = limit * free, problem.law.bounds(n)[1] * free
    try:
        found = _InteriorPoint(coarse, coarse.condense(load), problem.contact.normals, here, stiffness, *law).solve()
    except np.linalg.LinAlgError:
        return None
    return None if found is None else (coarse.recover(load, found[0]), found[1])


class _InteriorPoint:
    """Unknowns c; per node p, y, and where there is friction q, v."""

    def __init__(self, coarse: _Coarse, load: np.ndarray, normals: np.ndarray, given: AtNodes, stiffness: np.ndarray,
                 limit: np.ndarray, coefficient: np.ndarray) -> None:
        matrix, rows = self.matrix, self.rows = coarse.matrix, coarse.rows
        self.load, self.normals, self.given, self.limit, self.coefficient = load, normals, given, limit, coefficient
        n, self.dim = normals.shape
        self.rubs = (limit > 0) | (coefficient > 0)
        # springs at all contact nodes take what the given pressures leave
        spring = _SOFT * stiffness
        nodal = sparse.diags_array(np.repeat(spring, self.dim)) @ rows
        pressed = rows.T @ (given.pressure[:, None] * normals).reshape(-1)
        self.c = np.linalg.solve(matrix + (rows.T @ nodal).toarray(), load - pressed)
        gap, slip = self._moved()
        p = np.maximum(given.pressure - spring * np.minimum(gap, 0.0), 0.0)
        # pressures and gaps of a middling size, all with about the same product
        far = np.abs(given.gap - gap).max()
        length = max(np.minimum(np.abs(gap), far).mean(), p.mean() / stiffness.mean()) or 1.0
        size = max(p.mean(), spring.mean() * length)
        self.y = np.maximum(gap, length)
        self.p = size * length / self.y
        self.q = np.zeros((n, self.dim))
        self.v = 1.1 * np.linalg.norm(slip, axis=1) + length

    def _moved(self) -> tuple[np.ndarray, np.ndarray]:
        moved = (self.rows @ self.c).reshape(-1, self.dim)
        along = _inner(moved, self.normals)
        return self.given.gap - along, self.given.slip + moved - along[:, None] * self.normals

    def solve(self) -> tuple[np.ndarray, np.ndarray] | None:
        given, rubs = self.given, self.rubs
        for _ in range(_STEPS):
            gap, slip = self._moved()
            bound = self.limit + self.coefficient * self.p
            missing = gap - self.y
            forces = self.p[:, None] * self.normals + self.q
            rest = self.load - self.matrix @ self.c - self.rows.T @ forces.reshape(-1)
            energy = float(self.c @ (self.matrix @ self.c))
            work = self.p @ self.y + np.sum((bound * self.v - _inner(self.q, slip))[rubs])
            size = np.linalg.norm(self.load) + np.linalg.norm(self.rows.T @ forces.reshape(-1))
            if not np.isfinite(work + energy):
                return None
            if (work <= _ENOUGH * energy + 1e-24 * (self.load @ self.c) and np.linalg.norm(rest) <= 1e-6 * size
                    and np.abs(missing).max() <= 1e-4 * np.abs(given.gap - gap).max()):
                return self.c, -forces
            mean = work / (len(gap) + rubs.sum())
            system = self._system(slip, bound)
            affine = self._direction(system, slip, bound, rest, missing, 0.0, None)
            length = self._length(affine, slip, bound)
            after = ((self.p + length * affine[1]) @ (self.y + length * affine[2]) + np.sum(
                ((bound + length * self.coefficient * affine[1]) * (self.v + length * affine[4])
                 - _inner(self.q + length * affine[3], slip + length * affine[5]))[rubs]))
            centre = min(max((max(after, 0.0) / work) ** 3, 1e-4), 1.0) if length > 0.1 else 0.5
            second = affine if length > 0.5 else None
            step = self._direction(system, slip, bound, rest, missing, centre * mean, second)
            length = self._length(step, slip, bound)
            for values, change in zip((self.c, self.p, self.y, self.q, self.v), step, strict=False):
                values += length * change
        return None

    def _system(self, slip: np.ndarray, bound: np.ndarray) -> tuple:
        """The factors of the condensed equations, and what eliminated friction and pressure in them."""
        q, v, mu, normals = self.q, self.v, self.coefficient, self.normals
        den = np.where(self.rubs, bound * v + _inner(slip, q), 1.0)
        mixed = v[:, None] * q + bound[:, None] * slip
        turn = (bound[:, None, None] * np.eye(self.dim) - q[:, :, None] * mixed[:, None] / den[:, None, None]
                ) / v[:, None, None]
        grow = (slip - q * ((_inner(slip, slip) - v**2) / den)[:, None]) / v[:, None]
        turn[~self.rubs], grow[~self.rubs] = 0.0, 0.0
        tangents = np.eye(self.dim) - normals[:, :, None] * normals[:, None]
        stiff = self.p / self.y
        pushed = normals + mu[:, None] * grow
        blocks = stiff[:, None, None] * pushed[:, :, None] * normals[:, None] + tangents @ turn @ tangents
        n = len(v)
        nodal = sparse.bsr_array((blocks, np.arange(n), np.arange(n + 1)), shape=(n * self.dim,) * 2)
        factors = lu_factor(self.matrix + (self.rows.T @ (nodal @ self.rows)).toarray(), check_finite=False)
        return factors, den, mixed, turn, grow, stiff, pushed

    def _direction(self, system: tuple, slip: np.ndarray, bound: np.ndarray, rest: np.ndarray, missing: np.ndarray,
                   aim: float, second: tuple | None) -> tuple:
        factors, den, mixed, turn, grow, stiff, pushed = system
        p, y, q, v, mu = self.p, self.y, self.q, self.v, self.coefficient
        normal, work, skew = aim - p * y, aim - bound * v + _inner(q, slip), bound[:, None] * slip - v[:, None] * q
        if second is not None:
            _, dp, dy, dq, dv, ds = second
            normal = normal - dp * dy
            work = work - mu * dp * dv + _inner(dq, ds)
            skew = skew - dv[:, None] * dq + (mu * dp)[:, None] * ds
        p0 = normal / y - stiff * missing
        v0 = np.where(self.rubs, (v * work + _inner(slip, skew)) / den, 0.0)
        q0 = np.where(self.rubs[:, None], (skew - q * v0[:, None]) / v[:, None], 0.0)
        forces = p0[:, None] * pushed + q0
        dc = lu_solve(factors, rest - self.rows.T @ forces.reshape(-1), check_finite=False)
        moved = (self.rows @ dc).reshape(-1, self.dim)
        along = _inner(moved, self.normals)
        ds = moved - along[:, None] * self.normals
        dp, dy = p0 + stiff * along, missing - along
        dq = q0 + np.einsum("nij,nj->ni", turn, ds) + (mu * dp)[:, None] * grow
        dv = v0 + np.where(self.rubs, (mu * dp * (_inner(slip, slip) - v**2) + _inner(mixed, ds)) / den, 0.0)
        return dc, dp, dy, dq, dv, ds

    def _length(self, step: tuple, slip: np.ndarray, bound: np.ndarray) -> float:
        _, dp, dy, dq, dv, ds = step
        most = np.inf
        for values, change in ((self.p, dp), (self.y, dy)):
            falls = change < 0
            most = min(most, (values[falls] / -change[falls]).min(initial=np.inf))
        rubs = self.rubs
        most = min(most, _to_cone(bound[rubs], (self.coefficient * dp)[rubs], self.q[rubs], dq[rubs]),
                   _to_cone(self.v[rubs], dv[rubs], slip[rubs], ds[rubs]))
        return min(1.0, _SHORT * most)


def _to_cone(size: np.ndarray, grows: np.ndarray, vector: np.ndarray, change: np.ndarray) -> float:
    """The least length t at which |vector + t change| reaches size + t grows, or infinity."""
    a = _inner(change, change) - grows**2
    b = _inner(vector, change) - size * grows
    c = np.minimum(_inner(vector, vector) - size**2, 0.0)
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    # the first positive root of a t^2 + 2 b t + c, c <= 0
    down = b + root
    with np.errstate(divide="ignore", invalid="ignore"):
        length = np.where((b * b >= a * c) & (down > 0), -c / down, np.inf)
    return float(length.min(initial=np.inf))


def _inner(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)
