r"""A change of displacement that lets the contact status change: the contact problem in the span of aggregates.

Where the status of a displacement is wrong, what is missing in the space of that status says little: a beam whose tip
should touch, a body that hovers. The change d is then sought in the span of P, the rigid motions of
:mod:`adaptmg.solver.aggregates` smoothed by one step of damped Jacobi, under the conditions of all contact nodes. With
the residual r of the displacement, gaps g, slips :math:`\tau`, pressures p, friction :math:`-q` and its bound

.. math:: P^T(A P c + N^T p + T^T q - r) = 0,\quad 0 \le p \perp g - N P c \ge 0,\quad |q| \le s + \mu p,

and q along the slip :math:`\tau + T P c`. The unknowns that reach no contact node are eliminated, and
:mod:`adaptmg.smoother.interior_point` solves the rest. That module is the only one shared with the solvers: what it
finds is measured on the matrix afterwards, so that no fault in it can make an error small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from adaptmg.discrete.coordinates import frames_of, from_frames, to_frames
from adaptmg.discrete.problem import DiscreteProblem, remembered_of_structure
from adaptmg.smoother.interior_point import Conditions, dense_factors, interior_point
from adaptmg.solver.aggregates import aggregates_of, raised

#: what may be missing in the conditions
_ENOUGH = 1e-4


@dataclass(frozen=True, eq=False)
class AtNodes:
    """What the nodes that carry the contact conditions have."""

    gap: np.ndarray  # (n_contact,) m
    slip: np.ndarray  # (n_contact, dim), in the tangent plane, m
    pressure: np.ndarray  # (n_contact,) N
    friction: np.ndarray  # (n_contact, dim) N

    def forces(self, normals: np.ndarray) -> np.ndarray:
        """Return contact forces (n_contact, dim), N."""
        return self.friction - self.pressure[:, None] * normals


class _Coarse:
    """The smoothed aggregates of a problem: the matrix in their span, condensed to what reaches contact nodes."""

    def __init__(self, problem: DiscreteProblem) -> None:
        aggregates, dim, n = aggregates_of(problem), problem.dim, problem.n_nodes
        matrix, free = sparse.csr_array(problem.matrix), ~problem.fixed
        modes, count = 3 * dim - 3, len(aggregates.starts) - 1
        inside = aggregates.label >= 0
        starts = np.append(0, np.cumsum(inside))
        basis = sparse.bsr_array((_rigid(aggregates.offset[inside]), aggregates.label[inside], starts),
                                 shape=(n * dim, modes * count))
        basis = sparse.diags_array(free.astype(float), format="csr") @ sparse.csr_array(basis)
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
        self.frames = frames_of(problem.contact, problem.fixed.reshape(-1, dim))
        dofs = (dim * nodes[:, None] + np.arange(dim)).reshape(-1)
        at_contact = sparse.csr_array(_by_node(self.frames) @ self.span[dofs])
        touched = np.zeros(modes * count, dtype=bool)
        touched[at_contact.indices] = True
        self.near, self.far = np.flatnonzero(touched), np.flatnonzero(~touched)
        self.rows = sparse.csr_array(at_contact[:, self.near])
        self._solve = splu(sparse.csc_array(coarse[self.far][:, self.far])).solve if len(self.far) else np.asarray
        self._coupling = sparse.csc_array(coarse[self.far][:, self.near])
        self.matrix = (coarse[self.near][:, self.near].toarray()
                       - self._coupling.T @ self._solve(self._coupling.toarray()))

    def product(self, unknowns: np.ndarray) -> np.ndarray:
        return self.matrix @ unknowns

    def values(self, unknowns: np.ndarray) -> np.ndarray:
        return (self.rows @ unknowns).reshape(len(self.frames), -1)

    def restricted(self, forces: np.ndarray) -> np.ndarray:
        return self.rows.T @ forces.reshape(-1)

    def factors(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        return dense_factors(self.matrix + (self.rows.T @ (_by_node(blocks) @ self.rows)).toarray())

    def condense(self, load: np.ndarray) -> np.ndarray:
        """Return what the condensed equations take of forces (n_coarse,)."""
        return load[self.near] - self._coupling.T @ self._solve(load[self.far])

    def recover(self, load: np.ndarray, near: np.ndarray) -> np.ndarray:
        """Return the displacement (n_dofs,) of condensed unknowns."""
        values = np.zeros(self.span.shape[1])
        values[self.near] = near
        values[self.far] = self._solve(load[self.far] - self._coupling @ near)
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


def _by_node(blocks: np.ndarray) -> sparse.bsr_array:
    return sparse.bsr_array((blocks, np.arange(len(blocks)), np.arange(len(blocks) + 1)))


def changed_status(problem: DiscreteProblem, residual: np.ndarray, here: AtNodes, stiffness: np.ndarray,
                   limit: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the change (n_dofs,) of unknowns with this residual (n_dofs,), and the contact forces (n_contact, dim)
    that it ends with; None if it is not found. ``stiffness`` and ``limit`` (n_contact,): of the nodes, N/m, and of
    friction without pressure, N."""
    coarse = _coarse_of(problem)
    load, n, dim = coarse.span.T @ residual, len(problem.contact), problem.dim
    # where a support holds a tangent its reaction takes the place of friction
    free = ~problem.fixed.reshape(-1, dim)[problem.contact.nodes].any(axis=1)
    slip = to_frames(coarse.frames, here.slip)[:, 1:]
    conditions = Conditions(here.gap, -slip, limit * free, problem.law.bounds(n)[1] * free)
    found = interior_point(coarse, coarse.condense(load), conditions, np.tile(stiffness[:, None], dim), _ENOUGH)
    if not found.slack <= _ENOUGH:
        return None
    return coarse.recover(load, found.unknowns), -from_frames(coarse.frames, found.forces)
