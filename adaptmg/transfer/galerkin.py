r"""Galerkin coarse matrices :math:`P^T A P` of a block matrix and a nodal prolongation, row by row (Gustavson).

Blocks are never expanded: a weight multiplies a block as a whole. Coarse spaces of a bare matrix come from pyamg's
smoothed aggregation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._numba import kernel, read_only
from adaptmg._threads import in_parts, one_blas_thread, seeded

_SMALLEST = 1e-40  # largest weight of a prolongation at least; its inverse is the most


@kernel
def _pattern(first, last, a_indptr, a_indices, b_indptr, b_indices, columns, counts):
    """Entries of the rows of the product of two patterns, one place further: what row pointers are summed from."""
    marker = np.empty(columns, dtype=np.int64)
    for k in range(columns):
        marker[k] = -1
    for i in range(first, last):
        count = 0
        for p in range(a_indptr[i], a_indptr[i + 1]):
            k = a_indices[p]
            for q in range(b_indptr[k], b_indptr[k + 1]):
                if marker[b_indices[q]] != i:
                    marker[b_indices[q]] = i
                    count += 1
        counts[i + 1] = count


@kernel
def _multiply(first, last, zero, left, a_indptr, a_indices, b_indptr, b_indices, weights, blocks, columns, indptr,
              indices, data):
    """Rows of C = A B, one of them weights (A if ``left``), the other one blocks."""
    size, place = len(zero), np.empty(columns, dtype=np.int64)
    for k in range(columns):
        place[k] = -1
    for i in range(first, last):
        begin = indptr[i]
        end = begin
        for s in range(a_indptr[i], a_indptr[i + 1]):
            k = a_indices[s]
            for q in range(b_indptr[k], b_indptr[k + 1]):
                j = b_indices[q]
                weight, of = weights[s if left else q], size * (q if left else s)
                at = place[j]
                if at < begin:
                    at = end
                    place[j] = at
                    indices[at] = j
                    end += 1
                    for c in range(size):
                        data[size * at + c] = 0.0
                for c in range(size):
                    data[size * at + c] += weight * blocks[of + c]


@kernel
def _sort_rows(first, last, dim, indptr, indices, data, longest, new_indices, new_data, diagonal):
    """Blocks in the order of their columns, and the ``diagonal`` (rows * dim,) of those on it."""
    size, order = dim * dim, np.empty(longest, dtype=np.int32)
    for i in range(first, last):
        begin, end = indptr[i], indptr[i + 1]
        for s in range(begin, end):
            at = s - begin
            while at > 0 and indices[order[at - 1]] > indices[s]:  # one further down each time
                order[at] = order[at - 1]
                at -= 1
            order[at] = s
        for k in range(end - begin):
            s, to = order[k], begin + k
            new_indices[to] = indices[s]
            for c in range(size):
                new_data[size * to + c] = data[size * s + c]
            if indices[s] == i:
                for c in range(dim):
                    diagonal[dim * i + c] = data[size * s + c * (dim + 1)]


def galerkin_product(matrix: sparse.bsr_array, nodal: sparse.csr_array) -> sparse.bsr_array:
    """Return P'AP (n_dofs coarse, n_dofs coarse) of a matrix of square blocks, with P = nodal on every component.

    Sorted columns; every coarse node has a diagonal block, that of a node which nothing reaches is the mean of the
    others' diagonals.
    """
    dim = matrix.blocksize[0]
    size, coarse = dim * dim, nodal.shape[1]
    half = _product(size, (matrix.indptr, matrix.indices, matrix.data.reshape(-1)), nodal, coarse, left=False)
    indptr, indices, data = _product(size, half, sparse.csr_array(nodal.T), coarse, left=True)
    indptr, indices, data = _with_diagonal_blocks(indptr, indices, data.reshape(-1, dim, dim))
    in_order, blocks = np.empty_like(indices), np.empty(data.size)
    diagonal, longest = np.empty(coarse * dim), int(np.diff(indptr).max())
    in_parts(_sort_rows, coarse, data.size, dim, indptr, indices, data.reshape(-1), longest, in_order, blocks, diagonal)
    blocks = blocks.reshape(-1, dim, dim)
    empty = ~(diagonal > 0)
    if empty.any():
        # in place: a sum of sparse matrices would drop blocks that vanish, and truncation needs the whole pattern
        node, component = np.nonzero(empty.reshape(-1, dim))
        on = np.flatnonzero(np.repeat(np.arange(coarse), np.diff(indptr)) == in_order)
        blocks[on[node], component, component] = diagonal[~empty].mean() if not empty.all() else 1.0
    result = sparse.bsr_array((blocks, in_order, indptr), shape=(coarse * dim, coarse * dim))
    # scipy would look through them again
    result.has_sorted_indices = result.has_canonical_format = True
    return result


def seen(nodal: sparse.csr_array, finer: sparse.csr_array | None) -> sparse.csr_array:
    """Return a prolongation without what it gives to nodes of which the next finer level takes nothing. The diagonal
    that :func:`galerkin_product` lends such a node (where a mesh is locally finer than the next) is not stiffness: in
    the next product it would hold the coarser functions at zero there."""
    if finer is None:
        return nodal
    idle = np.bincount(finer.indices, weights=np.abs(finer.data), minlength=finer.shape[1]) == 0
    if not idle.any():
        return nodal
    data = np.where(np.repeat(idle, np.diff(nodal.indptr)), 0.0, nodal.data)
    return sparse.csr_array((data, nodal.indices, nodal.indptr), shape=nodal.shape)


def _with_diagonal_blocks(indptr: np.ndarray, indices: np.ndarray, data: np.ndarray
                          ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blocks (indptr, indices, data) of a square matrix with the missing diagonal ones added as zeros."""
    n = len(indptr) - 1
    rows = np.repeat(np.arange(n), np.diff(indptr))
    has = np.zeros(n, dtype=bool)
    has[rows[rows == indices]] = True
    missing = np.flatnonzero(~has)
    if not missing.size:
        return indptr, indices, data
    at = indptr[missing + 1]
    counts = np.diff(indptr) + ~has
    return (np.append(0, np.cumsum(counts)).astype(indptr.dtype), np.insert(indices, at, missing),
            np.insert(data, at, 0.0, axis=0))


def _product(size: int, blocks: tuple[np.ndarray, np.ndarray, np.ndarray], weights: sparse.csr_array, columns: int, *,
             left: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blocks (indptr, indices, data) times weights, or (``left``) weights times blocks; n ``columns``."""
    # one kind of index arrays, whether a hierarchy holds them or not
    factors = [tuple(map(read_only, blocks[:2])), (read_only(weights.indptr), read_only(weights.indices))]
    if left:
        factors.reverse()
    # kernels know the number of entries of a block when they are compiled
    zero, indptr, rows = (0.0,) * size, np.zeros(len(factors[0][0]), dtype=np.int64), len(factors[0][0]) - 1
    in_parts(_pattern, rows, len(blocks[2]), *factors[0], *factors[1], columns, indptr)
    np.cumsum(indptr, out=indptr)
    indices, data = np.empty(indptr[-1], dtype=np.int32), np.empty(indptr[-1] * size)
    in_parts(_multiply, rows, len(blocks[2]), zero, left, *factors[0], *factors[1], weights.data, blocks[2], columns,
             indptr, indices, data)
    return indptr.astype(np.int32), indices, data


def _prolongation(name: str, value: object) -> sparse.csr_array:
    # a copy: duplicates are summed in place
    P = sparse.csr_array(checks.sparse_matrix(name, value), dtype=np.float64, copy=True)
    P.sum_duplicates()
    largest = np.abs(P.data).max(initial=0.0)
    if not _SMALLEST <= largest <= 1 / _SMALLEST:
        raise ValueError(f"{name} must have weights of about 1, the largest is {largest:.3g}")
    return P


def coarse_spaces(matrix: sparse.bsr_array, fixed: np.ndarray, prolongations: Sequence[sparse.csr_array]
                  ) -> tuple[list[sparse.csr_array], list[sparse.bsr_array]]:
    """Check prolongations against a matrix and form the Galerkin matrices."""
    listed = checks.listed("prolongations", prolongations, "scipy sparse matrices, coarse to fine")
    given = [_prolongation(f"prolongations[{k}]", P) for k, P in enumerate(listed)]
    if not given:
        raise ValueError("prolongations is empty: give at least one, or use Hierarchy.single")
    dim, n = matrix.blocksize[0], matrix.shape[0]
    if given[-1].shape[0] not in (n, n // dim):
        raise ValueError(f"prolongations[{len(given) - 1}] must have {n // dim} rows (nodes) or {n} (dofs), got "
                         f"{given[-1].shape[0]}")
    of_dofs = given[-1].shape[0] == n
    current = without_fixed(matrix, fixed)
    if of_dofs:
        current = sparse.bsr_array(sparse.csr_array(current), blocksize=(1, 1))
    matrices: list[sparse.bsr_array] = []
    rows, finer = given[-1].shape[0], None
    for k in range(len(given) - 1, -1, -1):
        P = given[k]
        if P.shape[0] != rows or not 0 < P.shape[1] < rows:
            raise ValueError(f"prolongations[{k}] must have {rows} rows and fewer columns, one at least, got "
                             f"{P.shape}: they go from coarse to fine")
        rows = P.shape[1]
        finer = seen(P, finer)
        current = galerkin_product(current, finer)
        matrices.insert(0, current)
    return given, matrices


def without_fixed(matrix: sparse.bsr_array, fixed: np.ndarray, *, copy: bool = True) -> sparse.bsr_array:
    """Return the matrix with zero rows and columns of fixed dofs (n_dofs,) but for their diagonal; the pattern
    stays."""
    dim = matrix.blocksize[0]
    if copy:
        matrix = sparse.bsr_array((matrix.data.copy(), matrix.indices, matrix.indptr), shape=matrix.shape)
    free = (~fixed).astype(np.float64).reshape(-1, dim)
    held = ~free.all(axis=1)
    rows = np.repeat(np.arange(len(free)), np.diff(matrix.indptr))
    # few blocks are touched
    at = np.flatnonzero(held[rows] | held[matrix.indices])
    row, column, blocks = rows[at], matrix.indices[at], matrix.data[at]
    diagonal = (row == column)[:, None, None] * blocks * (np.eye(dim) * (1 - free[row])[:, :, None])
    matrix.data[at] = blocks * free[row][:, :, None] * free[column][:, None, :] + diagonal
    return matrix


def aggregated_prolongations(matrix: sparse.bsr_array, near_nullspace: np.ndarray | None, fixed: np.ndarray,
                             max_coarse: int) -> list[sparse.csr_array]:
    """Return prolongations of dofs by smoothed aggregation (Vanek, Mandel, Brezina 1996, doi:10.1007/BF02238511).

    Coarse to fine, (n_dofs, n_dofs coarse) each, none if the matrix is small. Without modes the translations are taken;
    ``max_coarse`` bounds the nodes of the coarsest level.
    """
    import pyamg

    dim = matrix.blocksize[0]
    if near_nullspace is None:
        near_nullspace = np.tile(np.eye(dim), (matrix.shape[0] // dim, 1))
    modes = np.where(fixed[:, None], 0.0, near_nullspace)
    with one_blas_thread(), seeded():
        made = pyamg.smoothed_aggregation_solver(
            sparse.bsr_matrix(without_fixed(matrix, fixed)), B=modes, strength=("symmetric", {"theta": 0.0}),
            max_coarse=max_coarse, max_levels=10)
    found = [sparse.csr_array(level.P) for level in made.levels[:-1]]
    return found[::-1]
