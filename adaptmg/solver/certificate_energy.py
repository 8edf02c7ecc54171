r"""The energy error of a displacement, estimated from the raw matrix by a few conjugate gradient steps.

With the contact status of the displacement held, u is first moved onto its constraints by a change z of constrained
dofs alone: v = u + z has its prescribed values, touching nodes on the obstacle, sticking nodes at zero slip. What is
then missing is a correction in the space of the displacements that keep the status,

.. math:: \|u - u_h\|_A \le \|z\|_A + \|v - u_h\|_A, \qquad \|v - u_h\|_A = |e|_{A^{-1}},

e the forces at v that no load, support or lawful contact force explains. Conjugate gradients give
:math:`|e|^2_{A^{-1}} = \sum_k \alpha_k\,r_k \cdot z_k`, a sum of positive terms, of which some are taken: never too
much. The preconditioner is the diagonal plus constants over boxes of nodes, which see what is smooth. Nothing here
comes from the solvers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import splu

from adaptmg.runtime.compiled import kernel

__all__ = ["FrozenStatus", "residual_energy"]

#: conjugate gradient steps, and the nodes up to which they cost nothing that anybody notices
_STEPS, _MORE_STEPS, _SMALL = 4, 12, 100_000
_BOXES = {2: 12, 3: 5}


@dataclass(frozen=True, eq=False)
class FrozenStatus:
    """The displacements that keep a contact status.

    Attributes
    ----------
    free : (n_nodes, dim) float array
        0 at prescribed components, else 1.
    nodes : (n_contact,) int array
    kept : (n_contact, dim, dim) array
        Projections onto what may move: I, I - n n' (closed, slipping), 0 (closed, sticking).
    stiffening : (n_contact, dim, dim) array
        Of friction that turns with the slip (3D), N/m.
    dragged : (n_contact, dim, dim) array
        Friction for a normal force, of slipping nodes under Coulomb's law; the factorisation alone knows it.
    """

    free: np.ndarray
    nodes: np.ndarray
    kept: np.ndarray
    stiffening: np.ndarray
    dragged: np.ndarray

    def project(self, vector: np.ndarray) -> np.ndarray:
        """The part (n_nodes, dim) that may move; a copy."""
        result = vector * self.free
        result[self.nodes] = self.free[self.nodes] * np.einsum("nij,nj->ni", self.kept, result[self.nodes])
        return result

    def product(self, matrix: sparse.bsr_array, vector: np.ndarray) -> np.ndarray:
        """The projected matrix, friction included, times a projected vector (n_nodes, dim)."""
        result = (matrix @ vector.reshape(-1)).reshape(vector.shape)
        result[self.nodes] += np.einsum("nij,nj->ni", self.stiffening, vector[self.nodes])
        return self.project(result)


def residual_energy(matrix: sparse.bsr_array, status: FrozenStatus, forces: np.ndarray,
                    diagonal: np.ndarray, coordinates: np.ndarray | None, exact: bool = False) -> float:
    """|e|^2 in the inverse of the matrix on the space of a status, N m.

    Parameters
    ----------
    matrix : bsr_array
    status : FrozenStatus
    forces : (n_nodes, dim) array
        e, N.
    diagonal : (n_nodes, dim) array
        Of the matrix.
    coordinates : (n_nodes, dim) array or None
        For the boxes; else nodes are taken in the order of their numbers.
    exact : bool
        By a sparse factorisation; else from below, by conjugate gradients.
    """
    residual = status.project(forces)
    if not np.isfinite(residual).all():
        return float("inf")
    if not residual.any():
        return 0.0
    if exact:
        return _factorised(matrix, status, residual)
    diagonal = diagonal.copy()
    diagonal[status.nodes] += np.diagonal(status.stiffening, axis1=1, axis2=2)
    boxes = _Boxes(matrix, status, coordinates)
    energy, direction, before = 0.0, None, 0.0
    for _ in range(_MORE_STEPS if len(forces) <= _SMALL else _STEPS):
        step = status.project(residual / diagonal)
        boxes.add_correction(residual, step)
        product = _dot(residual, step)
        if not product > 0.0:
            break
        if direction is not None:
            step += (product / before) * direction
        direction = step
        image = status.product(matrix, direction)
        curvature = _dot(direction, image)
        if not curvature > 0.0:
            break  # a motion that nothing holds
        alpha = product / curvature
        energy += alpha * product
        image *= alpha
        residual, before = residual - image, product
    return energy


@kernel
def _sum_boxes(indptr, indices, data, of_node, sums):
    """Add the diagonal entries of all blocks up by the boxes of their nodes."""
    for i in range(len(indptr) - 1):
        for p in range(indptr[i], indptr[i + 1]):
            for k in range(len(sums)):
                sums[k, of_node[i], of_node[indices[p]]] += data[p, k, k]


class _Boxes:
    """Galerkin correction by constants over boxes of nodes that nothing constrains."""

    def __init__(self, matrix: sparse.bsr_array, status: FrozenStatus, coordinates: np.ndarray | None) -> None:
        n, dim = status.free.shape
        inner = status.free.all(axis=1)
        inner[status.nodes] = False
        box = _boxes(n, dim, coordinates)
        used = np.bincount(box[inner], minlength=_BOXES[dim] ** dim) > 0
        self.dim, self.count = dim, int(used.sum())
        # nodes left out go to one box more, which is cut off again
        self.of_node = np.where(inner, (np.cumsum(used) - 1)[box], self.count).astype(np.int32)
        self.factors = []
        # each component by itself: half the work, and as a preconditioner good enough
        sums = np.zeros((dim, self.count + 1, self.count + 1))
        _sum_boxes(matrix.indptr, matrix.indices, matrix.data, self.of_node, sums)
        for k in range(dim if self.count else 0):
            coarse = sums[k, :-1, :-1]
            coarse = coarse + 1e-12 * np.abs(coarse).max() * np.eye(self.count)
            try:
                self.factors.append(cho_factor(coarse))
            except np.linalg.LinAlgError:
                self.factors.append(None)  # a singular matrix: the diagonal alone is a preconditioner too

    def add_correction(self, residual: np.ndarray, step: np.ndarray) -> None:
        """Add P (P' A P)^-1 P' r to ``step``, both (n_nodes, dim)."""
        for k, factor in enumerate(self.factors):
            if factor is not None:
                sums = np.bincount(self.of_node, residual[:, k], minlength=self.count + 1)[:-1]
                step[:, k] += np.append(cho_solve(factor, sums), 0.0)[self.of_node]


def _boxes(n: int, dim: int, coordinates: np.ndarray | None) -> np.ndarray:
    """The number of the box of each node (n,)."""
    side = _BOXES[dim]
    if coordinates is None:
        return np.arange(n) * side**dim // n
    low, extent = coordinates.min(axis=0), np.ptp(coordinates, axis=0)
    place = np.minimum(((coordinates - low) / np.where(extent > 0, extent, 1.0) * side).astype(np.int64), side - 1)
    return np.ravel_multi_index(tuple(place.T), (side,) * dim)


def _factorised(matrix: sparse.bsr_array, status: FrozenStatus, residual: np.ndarray) -> float:
    n, dim = residual.shape
    eye, free = np.tile(np.eye(dim), (n, 1, 1)), status.free
    mask = free[:, :, None] * free[:, None, :]

    def by_node(blocks: np.ndarray, others: np.ndarray) -> sparse.bsr_array:
        every = others.copy()
        every[status.nodes] = blocks
        return sparse.bsr_array((every * mask, np.arange(n), np.arange(n + 1)), shape=matrix.shape)

    keep = by_node(status.kept, eye)
    whole = keep @ (matrix + by_node(status.stiffening, 0 * eye)) + by_node(status.dragged, 0 * eye) @ matrix
    # what may not move gets a diagonal of the size of the others
    rest = np.abs(matrix.diagonal()).max() * (sparse.eye_array(matrix.shape[0]) - keep)
    found = splu(sparse.csc_array(whole @ keep + rest)).solve(residual.reshape(-1))
    return max(_dot(found.reshape(n, dim), (matrix @ found).reshape(n, dim)), 0.0)


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.einsum("nd,nd->", a, b))
