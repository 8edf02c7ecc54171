r"""Galerkin coarse matrices :math:`P^T A P` of a block matrix and a nodal prolongation; coarse
spaces of a bare matrix from pyamg's smoothed aggregation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._threads import one_blas_thread, seeded
from adaptmg.discrete.block_rows import diagonal_places
from adaptmg.discrete.contact_nodes import checked_mask
from adaptmg.mesh.arrays import mask_of


def galerkin_product(matrix: sparse.bsr_array, nodal: sparse.csr_array) -> sparse.bsr_array:
    """Return P'AP (n_dofs coarse, n_dofs coarse) of a matrix of square blocks, with P = nodal on
    every component.

    Sorted columns; every coarse node has a diagonal block, that of a node which nothing reaches is
    the mean of the others' diagonals. TypeError or ValueError where the matrices do not fit, or
    their indices are damaged.

    Examples
    --------
    >>> from scipy import sparse
    >>> matrix = sparse.bsr_array(np.diag([2.0, 2.0, 4.0, 4.0]), blocksize=(2, 2))     # 2 nodes in 2D
    >>> am.transfer.galerkin_product(matrix, sparse.csr_array([[1.0], [0.5]])).toarray().tolist()
    [[3.0, 0.0], [0.0, 3.0]]
    """
    checks.instance("matrix", matrix, sparse.bsr_array)
    n_dofs = matrix.shape[0]
    checks.sparse_matrix("matrix", matrix, (n_dofs, n_dofs))
    rows = checks.sparse_matrix("nodal", nodal, (n_dofs // matrix.blocksize[0], None))
    return coarse_matrix(matrix, sparse.csr_array(rows))


def coarse_matrix(matrix: sparse.bsr_array, nodal: sparse.csr_array) -> sparse.bsr_array:
    """Return P'AP as :func:`galerkin_product` does, of matrices that need no checks."""
    dim = matrix.blocksize[0]
    n, coarse = nodal.shape
    # the entries of a block side by side, as P multiplies all of them by the same number: products of
    # blocks, with dim times as many multiplications, take 1.06 times as long in loops that remesh, and up
    # to 1.3 times for single products of 2k to 22k nodes. Truncation needs the
    # whole pattern, but products of single numbers drop those that vanish: these get a zero more
    size = max(dim * dim, 2)
    entries = matrix.data.reshape(-1, dim * dim, 1)
    if dim == 1:
        entries = np.pad(entries, ((0, 0), (0, 1), (0, 0)))
    # A P with the entries of a block as a column, (n * size, coarse), then as a row, (n, coarse * size)
    half = sparse.bsr_array((entries, matrix.indices, matrix.indptr), shape=(n * size, n)) @ nodal
    half = sparse.bsr_array(
        (half.data.reshape(-1, 1, size), half.indices, half.indptr), shape=(n, coarse * size)
    )
    product = nodal.T.tocsr().tobsr((1, 1)) @ half
    blocks = np.ascontiguousarray(product.data[:, 0, : dim * dim]).reshape(-1, dim, dim)
    indptr, indices, data = _with_diagonal_blocks(product.indptr, product.indices, blocks)
    result = sparse.bsr_array((data, indices, indptr), shape=(coarse * dim, coarse * dim))
    result.sort_indices()
    diagonal = result.diagonal()
    empty = ~(diagonal > 0)
    if empty.any():
        # dofs without stiffness get the mean diagonal of the others, in place: a sum would drop
        # blocks that vanish
        node, component = np.nonzero(empty.reshape(-1, dim))
        mean = diagonal[~empty].mean() if not empty.all() else 1.0
        result.data[diagonal_places(result)[node], component, component] = mean
    # scipy would look through them again
    result.has_canonical_format = True
    return result


def without_idle_rows(nodal: sparse.csr_array, finer: sparse.csr_array | None) -> sparse.csr_array:
    """Return a prolongation without the rows of nodes that the next ``finer`` prolongation does not
    read (where a mesh is locally finer than the next one). The diagonal that
    :func:`galerkin_product` gives such a node is not stiffness: in the next product it would hold the
    coarser functions at zero there."""
    if finer is None:
        return nodal
    idle = np.bincount(finer.indices, weights=np.abs(finer.data), minlength=finer.shape[1]) == 0
    if not idle.any():
        return nodal
    data = np.where(np.repeat(idle, np.diff(nodal.indptr)), 0.0, nodal.data)
    return sparse.csr_array((data, nodal.indices, nodal.indptr), shape=nodal.shape)


def _with_diagonal_blocks(
    indptr: np.ndarray, indices: np.ndarray, data: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the arrays of a square block matrix, ``indptr`` (n + 1,), ``indices`` (m,) and ``data`` (m,
    dim, dim), with the missing diagonal blocks added as zeros, at the end of their rows."""
    n = len(indptr) - 1
    rows = np.repeat(np.arange(n), np.diff(indptr))
    has = mask_of(rows[rows == indices], n)
    missing = np.flatnonzero(~has)
    if not missing.size:
        return indptr, indices, data
    at = indptr[missing + 1]
    counts = np.diff(indptr) + ~has
    return (
        np.append(0, np.cumsum(counts)).astype(indptr.dtype),
        np.insert(indices, at, missing),
        np.insert(data, at, 0.0, axis=0),
    )


def _prolongation(name: str, value: object) -> sparse.csr_array:
    """Return a checked copy of a user's prolongation, without duplicate entries."""
    # a copy: duplicates are summed in place
    given = checks.sparse_matrix(name, value)
    P = sparse.csr_array(given, dtype=np.float64, copy=True)  # pyright: ignore[reportCallIssue, reportArgumentType]  scipy-stubs
    P.sum_duplicates()
    largest = np.abs(P.data).max(initial=0.0)
    if not checks.TINIEST <= largest <= checks.VAST:
        raise ValueError(f"{name} must have weights of about 1, the largest is {largest:.3g}")
    return P


def coarse_spaces(
    matrix: sparse.bsr_array, fixed: np.ndarray, prolongations: Sequence[sparse.csr_array]
) -> tuple[list[sparse.csr_array], list[sparse.bsr_array]]:
    """Check prolongations, coarse to fine, against the matrix of the finest level, whose ``fixed`` dofs
    (n_dofs,) count as decoupled, and form the Galerkin matrices of all coarser levels; returns both,
    coarse to fine."""
    listed = checks.listed("prolongations", prolongations, "scipy sparse matrices, coarse to fine")
    checked = [_prolongation(f"prolongations[{k}]", P) for k, P in enumerate(listed)]
    if not checked:
        raise ValueError("prolongations is empty: give at least one, or use Hierarchy.single")
    dim = matrix.blocksize[0]
    n = matrix.shape[0]
    if checked[-1].shape[0] not in (n, n // dim):
        raise ValueError(
            f"prolongations[{len(checked) - 1}] must have {n // dim} rows (nodes) or {n} (dofs), got "
            f"{checked[-1].shape[0]}"
        )
    of_dofs = checked[-1].shape[0] == n
    current = without_fixed(matrix, fixed)
    if of_dofs:
        current = sparse.bsr_array(sparse.csr_array(current), blocksize=(1, 1))
    matrices: list[sparse.bsr_array] = []
    rows = checked[-1].shape[0]
    # from fine to coarse; each product takes P without nodes that the next finer one does not use
    finer = None
    for k in range(len(checked) - 1, -1, -1):
        P = checked[k]
        if P.shape[0] != rows or not 0 < P.shape[1] < rows:
            raise ValueError(
                f"prolongations[{k}] must have {rows} rows and fewer columns, one at least, got "
                f"{P.shape}: they go from coarse to fine"
            )
        rows = P.shape[1]
        finer = without_idle_rows(P, finer)
        current = coarse_matrix(current, finer)
        matrices.insert(0, current)
    return checked, matrices


def without_fixed(
    matrix: sparse.bsr_array, fixed: np.ndarray, *, copy: bool = True
) -> sparse.bsr_array:
    """Return the matrix with zero rows and columns of fixed dofs (n_dofs,) but for their diagonal;
    the pattern stays. It is the matrix itself, changed, with ``copy=False``.

    Examples
    --------
    >>> from scipy import sparse
    >>> matrix = sparse.bsr_array(np.array([[2.0, 1.0], [1.0, 3.0]]), blocksize=(2, 2))
    >>> am.transfer.without_fixed(matrix, np.array([True, False])).toarray().tolist()
    [[2.0, 0.0], [0.0, 3.0]]
    """
    dim = checks.instance("matrix", matrix, sparse.bsr_array).blocksize[0]
    if checks.flag("copy", copy):
        matrix = sparse.bsr_array(
            (matrix.data.copy(), matrix.indices, matrix.indptr), shape=matrix.shape
        )
    free = (~checked_mask("fixed", fixed, matrix.shape[0])).astype(np.float64).reshape(-1, dim)
    held: np.ndarray = ~np.all(free, axis=1)  # nodes with a fixed dof
    rows = np.repeat(np.arange(len(free)), np.diff(matrix.indptr))
    # change only the blocks in rows and columns of these nodes, which are few
    at = np.flatnonzero(held[rows] | held[matrix.indices])
    row = rows[at]
    column = matrix.indices[at]
    blocks = matrix.data[at]
    diagonal = (row == column)[:, None, None] * blocks * (np.eye(dim) * (1 - free[row])[:, :, None])
    matrix.data[at] = blocks * free[row][:, :, None] * free[column][:, None, :] + diagonal
    return matrix


def aggregated_prolongations(
    matrix: sparse.bsr_array, near_nullspace: np.ndarray | None, fixed: np.ndarray, max_coarse: int
) -> list[sparse.csr_array]:
    """Return prolongations of dofs by smoothed aggregation (Vanek, Mandel, Brezina 1996,
    doi:10.1007/BF02238511).

    Coarse to fine, (n_dofs, n_dofs coarse) each, none if the matrix is small. ``near_nullspace``
    (n_dofs, n_modes) are motions of little energy, made zero at ``fixed`` dofs (n_dofs,); None
    stands for translations. ``max_coarse`` bounds the nodes of the coarsest level."""
    import pyamg

    dim = matrix.blocksize[0]
    if near_nullspace is None:
        near_nullspace = np.tile(np.eye(dim), (matrix.shape[0] // dim, 1))
    modes = np.where(fixed[:, None], 0.0, near_nullspace)
    with one_blas_thread(), seeded():
        multilevel = pyamg.smoothed_aggregation_solver(
            sparse.bsr_matrix(without_fixed(matrix, fixed)),
            B=modes,
            # 0: all neighbours are strongly connected
            strength=("symmetric", {"theta": 0.0}),  # pyright: ignore[reportArgumentType]  pyamg has no stubs
            max_coarse=max_coarse,
            max_levels=10,  # pyamg's default
        )
    prolongations = [sparse.csr_array(level.P) for level in multilevel.levels[:-1]]
    if dim == modes.shape[1] == 1:
        # coarse unknowns are values, for which a coarse obstacle makes sense: rows with sum 1
        sizes = [np.where(level.B[:, 0] != 0.0, level.B[:, 0], 1.0) for level in multilevel.levels]
        prolongations = [
            sparse.csr_array(sparse.diags_array(1 / fine) @ P @ sparse.diags_array(coarse))
            for fine, P, coarse in zip(sizes, prolongations, sizes[1:], strict=False)
        ]
    return prolongations[::-1]
