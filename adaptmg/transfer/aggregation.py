"""Coarse spaces of a bare matrix, by pyamg's smoothed aggregation."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.runtime.threads import one_blas_thread, seeded

__all__ = ["aggregated_prolongations", "without_fixed"]


def without_fixed(matrix: sparse.bsr_array, fixed: np.ndarray) -> sparse.bsr_array:
    """A copy in which the rows and columns of fixed dofs (n_dofs,) are zero but for their diagonal."""
    dim = matrix.blocksize[0]
    free = (~fixed).astype(float).reshape(-1, dim)
    rows = np.repeat(np.arange(len(free)), np.diff(matrix.indptr))
    data = matrix.data * free[rows][:, :, None] * free[matrix.indices][:, None, :]
    on_diagonal = np.flatnonzero(rows == matrix.indices)
    data[on_diagonal] += matrix.data[on_diagonal] * (np.eye(dim) * (1 - free[rows[on_diagonal]])[:, :, None])
    return sparse.bsr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)


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
