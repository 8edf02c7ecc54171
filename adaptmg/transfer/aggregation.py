"""Coarse spaces of a bare matrix, by pyamg's smoothed aggregation."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.runtime.threads import one_blas_thread, seeded

__all__ = ["aggregated_prolongations", "without_fixed"]


def without_fixed(matrix: sparse.bsr_array, fixed: np.ndarray, *, copy: bool = True) -> sparse.bsr_array:
    """The matrix with zero rows and columns of fixed dofs (n_dofs,) but for their diagonal; the pattern stays.

    ``copy=False`` changes the given one.
    """
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


def aggregated_prolongations(matrix: sparse.bsr_array, near_nullspace: np.ndarray | None, fixed: np.ndarray, *,
                             strength: float = 0.0, max_coarse: int = 300, max_levels: int = 10
                             ) -> list[sparse.csr_array]:
    """Prolongations of dofs by smoothed aggregation (Vanek, Mandel, Brezina 1996, doi:10.1007/BF02238511).

    Parameters
    ----------
    matrix : bsr_array (n_dofs, n_dofs)
        Symmetric, no boundary condition applied.
    near_nullspace : (n_dofs, k) array, optional
        Rigid-body modes; default the translations.
    fixed : (n_dofs,) bool array
    strength : float
        Drop tolerance of the strength of connection.
    max_coarse, max_levels : int
        Dofs of the coarsest level, and levels, at most.

    Returns
    -------
    list of csr_array
        (n_dofs, n_dofs coarse) each, coarse to fine; empty if the matrix is small.
    """
    import pyamg

    dim = matrix.blocksize[0]
    if near_nullspace is None:
        near_nullspace = np.tile(np.eye(dim), (matrix.shape[0] // dim, 1))
    modes = np.where(fixed[:, None], 0.0, near_nullspace)
    with one_blas_thread(), seeded():
        made = pyamg.smoothed_aggregation_solver(
            sparse.bsr_matrix(without_fixed(matrix, fixed)), B=modes, strength=("symmetric", {"theta": strength}),
            max_coarse=max_coarse, max_levels=max_levels)
    found = [sparse.csr_array(level.P) for level in made.levels[:-1]]
    return found[::-1]
