r"""Hats: a coarse space of multilinear functions on a grid of boxes, which sees what is smooth in an error.

The boxes cut the extent of the mesh into equal parts; a node at the place :math:`t \in [0,1]^d` of its box carries the
weights :math:`\prod_l t_l` or :math:`1 - t_l` of the corners. With K the projections onto what a contact status lets
move, the coarse matrix is :math:`P^T K A K P`, all components together: a function that keeps the status at a sloping
contact is one of the space. It is small, dense, and factorised. Nothing here comes from the solvers.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from adaptmg.runtime.compiled import inner_kernel, kernel

__all__ = ["Hats"]

#: boxes along an axis at most, and nodes in each along an axis at least, by dimension
_MOST = {1: 100, 2: 12, 3: 5}
_NODES = 3
#: zeros, as many as a node has components: kernels know their number when they are compiled
_ZEROS = {1: (0.0,), 2: (0.0, 0.0), 3: (0.0, 0.0, 0.0)}


@inner_kernel
def _weight(zero, place, i, corner):
    """Weight of a corner of the box of node i; bit l of its number says at which end of axis l it lies."""
    weight = 1.0
    for axis in range(len(zero)):
        weight *= place[i, axis] if (corner >> axis) & 1 else 1.0 - place[i, axis]
    return weight


@kernel
def _locate(zero, points, low, boxes_per_length, most, strides, cell, place):
    """The lowest corner of the box of each node, and the place in the box."""
    for i in range(len(points)):
        first = 0
        for axis in range(len(zero)):
            t = (points[i, axis] - low[axis]) * boxes_per_length[axis]
            box = min(int(t), most[axis])
            first += box * strides[axis]
            place[i, axis] = t - box
        cell[i] = first


@kernel
def _galerkin(zero, indptr, indices, data, held, kept, cell, place, corners, coarse):
    """coarse (n_hats, n_hats, dim, dim) += half of P' K A K P: the other half is its transpose.

    Of a symmetric matrix the upper triangle is enough. ``held`` numbers the nodes with a projection, else -1.
    """
    dim = len(zero)
    row = np.zeros((len(corners), dim, dim))
    block, other = np.zeros((dim, dim)), np.zeros((dim, dim))
    for i in range(len(indptr) - 1):
        row[:] = 0.0
        for p in range(indptr[i], indptr[i + 1]):
            j = indices[p]
            if j < i:
                continue
            of_block = 0.5 if j == i else 1.0
            if cell[j] == cell[i] and held[i] < 0 and held[j] < 0:
                for c in range(len(corners)):
                    weight = of_block * _weight(zero, place, j, c)
                    for k in range(dim):
                        for m in range(dim):
                            row[c, k, m] += weight * data[p, k, m]
                continue
            _project(zero, data[p], held[i], held[j], kept, other, block)
            for c in range(len(corners)):
                weight = of_block * _weight(zero, place, j, c)
                for b in range(len(corners)):
                    _add(zero, weight * _weight(zero, place, i, b), block,
                         coarse[cell[i] + corners[b], cell[j] + corners[c]])
        for b in range(len(corners)):
            weight = _weight(zero, place, i, b)
            for c in range(len(corners)):
                _add(zero, weight, row[c], coarse[cell[i] + corners[b], cell[i] + corners[c]])


@inner_kernel
def _add(zero, weight, block, to):
    """to += weight block."""
    for k in range(len(zero)):
        for m in range(len(zero)):
            to[k, m] += weight * block[k, m]


@inner_kernel
def _project(zero, block, left, right, kept, half, product):
    """product = K block K, with the projections of these numbers; none where the number is negative."""
    for k in range(len(zero)):
        for m in range(len(zero)):
            half[k, m] = 0.0 if left >= 0 else block[k, m]
            for q in range(len(zero) if left >= 0 else 0):
                half[k, m] += kept[left, k, q] * block[q, m]
    for k in range(len(zero)):
        for m in range(len(zero)):
            product[k, m] = 0.0 if right >= 0 else half[k, m]
            for q in range(len(zero) if right >= 0 else 0):
                product[k, m] += half[k, q] * kept[right, q, m]


@kernel
def _advance(zero, alpha, image, diagonal, residual, cell, place, corners, sums):
    """residual -= alpha image; sums = P' residual; returns residual'D^-1 residual."""
    sums[:] = 0.0
    product = 0.0
    for i in range(len(residual)):
        for k in range(len(zero)):
            residual[i, k] -= alpha * image[i, k]
            product += residual[i, k] * residual[i, k] / diagonal[i, k]
        for c in range(len(corners)):
            weight = _weight(zero, place, i, c)
            for k in range(len(zero)):
                sums[cell[i] + corners[c], k] += weight * residual[i, k]
    return product


@kernel
def _turn(zero, beta, residual, diagonal, cell, place, corners, values, direction):
    """direction = D^-1 residual + P values + beta direction."""
    for i in range(len(residual)):
        for k in range(len(zero)):
            direction[i, k] = beta * direction[i, k] + residual[i, k] / diagonal[i, k]
        for c in range(len(corners)):
            weight = _weight(zero, place, i, c)
            for k in range(len(zero)):
                direction[i, k] += weight * values[cell[i] + corners[c], k]


class Hats:
    """The preconditioner D^-1 + P (P'KAKP)^-1 P' of conjugate gradients, and its passes over vectors.

    Parameters
    ----------
    matrix : bsr_array
    diagonal : (n_nodes, dim) array
        D.
    held : (m,) int array
        Nodes that may not move freely.
    kept : (m, dim, dim) array
        K there, projections onto what may.
    coordinates : (n_nodes, dim) array or None
        Else nodes are taken in the order of their numbers.
    apart : (k,) int array
        Nodes that count from others, whose displacement is relative: they have hats of their own.
    """

    def __init__(self, matrix: sparse.bsr_array, diagonal: np.ndarray, held: np.ndarray, kept: np.ndarray,
                 coordinates: np.ndarray | None, apart: np.ndarray) -> None:
        n, dim = diagonal.shape
        self.diagonal, self._zero = diagonal, _ZEROS[dim]
        self.cell, self.place = np.empty(n, dtype=np.int32), np.empty((n, dim))
        self.corners, count = self._boxes(coordinates)
        if len(apart):
            self.cell[apart] += count
            count *= 2
        self._sums = np.zeros((count, dim))
        number = np.full(n, -1, dtype=np.int32)
        number[held] = np.arange(len(held))
        coarse = np.zeros((count, count, dim, dim))
        _galerkin(self._zero, matrix.indptr, matrix.indices, matrix.data, number, kept, self.cell, self.place,
                  self.corners, coarse)
        self._factorise(coarse.transpose(0, 2, 1, 3).reshape(count * dim, count * dim))

    def _factorise(self, half: np.ndarray) -> None:
        """Factors of the coarse matrix, given half of it, without the hats that no node carries."""
        self._used = np.flatnonzero(half.diagonal() > 0)
        coarse = half[np.ix_(self._used, self._used)]
        coarse = coarse + coarse.T
        coarse += 1e-12 * coarse.max(initial=0.0) * np.eye(len(coarse))
        try:
            self._factor = cho_factor(coarse, lower=True, overwrite_a=True, check_finite=False)
        except np.linalg.LinAlgError:
            self._factor = None  # a singular matrix: the diagonal alone is a preconditioner too

    def _boxes(self, coordinates: np.ndarray | None) -> tuple[np.ndarray, int]:
        """Put the nodes into boxes; returns the steps from the lowest corner of one to all, and the number of hats."""
        n, dim = self.place.shape
        if coordinates is None:
            coordinates = np.zeros((n, dim))
            coordinates[:, 0] = np.arange(n)
        # by axis: over the first axis of a long thin array numpy is slow
        low, high = np.array([[axis.min(), axis.max()] for axis in coordinates.T]).T
        extent = high - low
        axes = max(int(np.count_nonzero(extent > 0)), 1)
        side = int(np.clip(n ** (1 / axes) / _NODES, 1, _MOST[axes]))
        boxes = np.where(extent > 0, side, 1)
        strides = np.cumprod(np.append(1, boxes[:-1] + 1))
        _locate(self._zero, coordinates, low, boxes / np.where(extent > 0, extent, 1.0), boxes - 1, strides, self.cell,
                self.place)
        ends = (np.arange(2**dim)[:, None] >> np.arange(dim)) & 1
        return ends @ strides, int(np.prod(boxes + 1))

    def advance(self, residual: np.ndarray, alpha: float, image: np.ndarray) -> tuple[float, np.ndarray]:
        """Take ``alpha`` times ``image`` from the residual; returns r'z of the preconditioned z and its coarse part."""
        product = _advance(self._zero, alpha, image, self.diagonal, residual, self.cell, self.place, self.corners,
                           self._sums)
        values = np.zeros(self._sums.size)
        if self._factor is not None:
            sums = self._sums.reshape(-1)[self._used]
            values[self._used] = cho_solve(self._factor, sums, check_finite=False)
            product += float(np.einsum("n,n->", values[self._used], sums))
        return product, values.reshape(self._sums.shape)

    def turn(self, residual: np.ndarray, values: np.ndarray, beta: float, direction: np.ndarray) -> None:
        """direction = z + beta direction, z the preconditioned residual with its coarse part ``values``."""
        _turn(self._zero, beta, residual, self.diagonal, self.cell, self.place, self.corners, values, direction)
