r"""Rows of a prolongation: made from weights, freed of tiny entries, corrected to keep their sums and moments.

After entries have been dropped, the rest :math:`p_j` of a row is changed by the smallest :math:`\delta_j` (least
squares) that restores the sum and, where asked for, the first moments :math:`m` the row had before:

.. math:: \min \sum_j \delta_j^2 \quad\text{with}\quad \sum_j (p_j + \delta_j)\, q_j = m, \qquad
          q_j = (1, (x_j - x_i)/h_i), \qquad \delta_j = q_j \cdot G^{-1} \Big(m - \sum_j p_j q_j\Big),\;
          G = \sum_j q_j q_j^T ,

where :math:`h_i` is a size of the mesh: a single coarse node that is left may equal the fine node up to rounding, and
its distance is no scale.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.runtime.compiled import kernel

__all__ = ["CLIP", "clipped_rows", "csr_from_weights", "dropped", "normalised"]

CLIP = 1e-10
"""Weights smaller than this are removed: they would put spurious nodes into minima over the support of P."""

_REACHED = 1e-10
"""A sum, or a first moment over the size of its row, that differs by less from what is asked for is restored."""


@kernel
def _fill_rows(columns, weights, clip, indptr, indices, data):
    """Rows in column order without entries below ``clip``, normalised; returns the number of entries."""
    n, k = columns.shape
    count = 0
    for i in range(n):
        indptr[i] = count
        total = 0.0
        for m in range(k):
            if weights[i, m] < clip:
                continue
            at = count
            while at > indptr[i] and indices[at - 1] > columns[i, m]:
                indices[at], data[at] = indices[at - 1], data[at - 1]
                at -= 1
            indices[at], data[at] = columns[i, m], weights[i, m]
            total += weights[i, m]
            count += 1
        for at in range(indptr[i], count):
            data[at] /= total
    indptr[n] = count
    return count


def csr_from_weights(columns: np.ndarray, weights: np.ndarray, n_columns: int) -> sparse.csr_array:
    """Sparse rows from a fixed number of weights each.

    Parameters
    ----------
    columns : (n, k) array of int
        Distinct within a row.
    weights : (n, k) array
        >= 0; those below ``CLIP`` are left out and the rest of the row normalised.
    n_columns : int

    Returns
    -------
    (n, n_columns) csr_array
        Sorted, row sums 1.
    """
    n, k = columns.shape
    indptr = np.empty(n + 1, dtype=np.int32)
    indices, data = np.empty(n * k, dtype=np.int32), np.empty(n * k)
    count = _fill_rows(columns, weights, CLIP, indptr, indices, data)
    return sparse.csr_array((data[:count].copy(), indices[:count].copy(), indptr), shape=(n, n_columns))


@kernel
def _drop(indptr, indices, data, tolerance, new_indptr, new_indices, new_data):
    count = 0
    for i in range(len(indptr) - 1):
        new_indptr[i] = count
        for at in range(indptr[i], indptr[i + 1]):
            if abs(data[at]) >= tolerance:
                new_indices[count], new_data[count] = indices[at], data[at]
                count += 1
    new_indptr[-1] = count
    return count


def dropped(matrix: sparse.csr_array, tolerance: float) -> sparse.csr_array:
    """A copy without entries whose magnitude is below ``tolerance``."""
    indptr, indices, data = np.empty_like(matrix.indptr), np.empty_like(matrix.indices), np.empty_like(matrix.data)
    count = _drop(matrix.indptr, matrix.indices, matrix.data, tolerance, indptr, indices, data)
    return sparse.csr_array((data[:count].copy(), indices[:count].copy(), indptr), shape=matrix.shape)


def normalised(matrix: sparse.csr_array) -> sparse.csr_array:
    """A copy with row sums 1; ValueError if a row is empty."""
    sums = matrix.sum(axis=1)
    if (sums == 0).any():
        raise ValueError(f"row {np.argmax(sums == 0)} of the prolongation is empty: the fine node lies in no part of "
                         "the coarse mesh")
    data = matrix.data / np.repeat(sums, np.diff(matrix.indptr))
    return sparse.csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)


@kernel
def _moment_systems(indptr, indices, data, points, centres, target, gram, defect, scale):
    """Gram matrices G and moment defects of every row; ``scale`` grows to the extent of the row, if that is larger."""
    dim = points.shape[1]
    q = np.ones(dim + 1)
    for i in range(len(indptr) - 1):
        for at in range(indptr[i], indptr[i + 1]):
            for c in range(dim):
                scale[i] = max(scale[i], abs(points[indices[at], c] - centres[i, c]))
        gram[i] = 0.0
        defect[i, 0] = target[i, 0]
        for c in range(dim):
            defect[i, c + 1] = target[i, c + 1] / scale[i]
        for at in range(indptr[i], indptr[i + 1]):
            for c in range(dim):
                q[c + 1] = (points[indices[at], c] - centres[i, c]) / scale[i]
            for r in range(dim + 1):
                defect[i, r] -= data[at] * q[r]
                for s in range(dim + 1):
                    gram[i, r, s] += q[r] * q[s]


@kernel
def _add_corrections(indptr, indices, data, points, centres, multiplier, scale):
    dim = points.shape[1]
    for i in range(len(indptr) - 1):
        for at in range(indptr[i], indptr[i + 1]):
            data[at] += multiplier[i, 0]
            for c in range(dim):
                data[at] += multiplier[i, c + 1] * (points[indices[at], c] - centres[i, c]) / scale[i]


def _with_moments(matrix: sparse.csr_array, coarse: MeshArrays, fine: MeshArrays, moments: np.ndarray
                  ) -> tuple[sparse.csr_array, np.ndarray]:
    """Change the entries of every row as little as possible so that it has the given moments.

    Parameters
    ----------
    matrix : (n_fine, n_coarse) csr_array
    coarse, fine : MeshArrays
    moments : (n_fine, dim + 1) array
        Wanted: sum of the row, then its first moments about the fine node, m.

    Returns
    -------
    csr_array
        The same pattern. Moments that the pattern cannot change (all columns on one line) are left unchanged.
    reached : (n_fine,) bool array
        Rows that have all their moments.
    """
    n, dim = fine.points.shape
    gram, defect, scale = np.empty((n, dim + 1, dim + 1)), np.empty((n, dim + 1)), np.empty(n)
    scale[fine.elements] = fine.element_sizes[:, None]      # that of one of its elements will do
    data = matrix.data.copy()
    _moment_systems(matrix.indptr, matrix.indices, data, coarse.points, fine.points, moments, gram, defect, scale)
    multiplier, reached = np.zeros((n, dim + 1)), np.ones(n, dtype=bool)
    wrong = np.flatnonzero(np.abs(defect).max(axis=1) > 4 * np.finfo(float).eps)
    inverse = np.linalg.pinv(gram[wrong], rcond=1e-10, hermitian=True)
    multiplier[wrong] = np.einsum("nij,nj->ni", inverse, defect[wrong])
    left = np.einsum("nij,nj->ni", gram[wrong], multiplier[wrong]) - defect[wrong]
    reached[wrong] = np.abs(left).max(axis=1) <= _REACHED
    _add_corrections(matrix.indptr, matrix.indices, data, coarse.points, fine.points, multiplier, scale)
    return sparse.csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape), reached


def clipped_rows(matrix: sparse.csr_array, coarse: MeshArrays, fine: MeshArrays, *, tolerance: float = CLIP,
                 moments: np.ndarray | None = None) -> tuple[sparse.csr_array, np.ndarray]:
    """Drop small entries, and restore row sums 1 and first moments.

    Parameters
    ----------
    matrix : (n_fine, n_coarse) csr_array
    coarse, fine : MeshArrays
    tolerance : float
        Entries of smaller magnitude are dropped; at least ``CLIP``.
    moments : (n_fine, dim + 1) array, optional
        Wanted row sums and first moments about the fine nodes, m. Default: sums 1, and the moments the rows have, over
        their sums.

    Returns
    -------
    csr_array
        No entry is smaller than ``CLIP`` in magnitude.
    reached : (n_fine,) bool array
        Rows that have their moments: near a coarse node what is left may be that node alone.
    """
    if moments is None:
        centre = coarse.points.mean(axis=0)             # far from the origin the differences would lose digits
        moments = matrix @ np.column_stack([np.ones(coarse.n_nodes), coarse.points - centre])
        moments /= moments[:, :1]
        moments[:, 1:] -= fine.points - centre
    rows, reached = _with_moments(dropped(matrix, tolerance), coarse, fine, moments)
    # a correction may make an entry small; each round removes at least one
    while np.abs(rows.data).min() < CLIP:
        rows, again = _with_moments(dropped(rows, CLIP), coarse, fine, moments)
        reached &= again
    return rows, reached
