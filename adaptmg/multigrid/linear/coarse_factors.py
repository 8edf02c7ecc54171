"""CoarseFactors: the solution of the coarsest linear problems, by LU factors or by a user's own solver."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from adaptmg.multigrid.linear.own_parts import LinearSolve, OwnSolve, regular_matrix
from adaptmg.multigrid.linear.split_matrix import SplitMatrix

__all__ = ["CoarseFactors"]


class CoarseFactors:
    """Solves with the coarsest matrix; a singular one is shifted by a small part of its diagonal before it is
    factorised, dense or sparse by its size.

    Parameters
    ----------
    level : SplitMatrix
    own : LinearSolve, optional
        Solves in place of the factors.
    """

    #: a pivot below this times the largest means singular, and the shift that mends it, over the diagonal
    SINGULAR, SHIFT = 1e-13, 1e-6
    #: dofs up to which dense factors are quicker
    DENSE = 1500

    def __init__(self, level: SplitMatrix, own: LinearSolve | None = None) -> None:
        self.level, self.own = level, own
        scale = np.abs(level.diagonal.reshape(-1, level.dim, level.dim).diagonal(axis1=1, axis2=2)).reshape(-1)
        self._scale = np.where(scale > 0, scale, scale.max() or 1.0)
        self._solve: Callable[[np.ndarray], np.ndarray] | None = None
        self._own_solve: OwnSolve | None = None

    def renew(self) -> None:
        """Factorise the matrix as it is now."""
        matrix = regular_matrix(self.level, self._scale)
        if self.own is not None:
            self._own_solve = OwnSolve(self.own, matrix)
            return
        factorise = _dense_factors if matrix.shape[0] <= self.DENSE else _sparse_factors
        self._solve = factorise(matrix, self.SINGULAR)
        if self._solve is None:
            self._solve = factorise(matrix + sparse.diags_array(self.SHIFT * self._scale), 0.0)

    def solve(self, load: np.ndarray, result: np.ndarray) -> float:
        """Solve into ``result`` (n_dofs,); returns the passes over the matrix, 0 for factors."""
        if self._own_solve is not None:
            return self._own_solve.solve(load, result)
        result[:] = self._solve(load)
        return 0.0


def _dense_factors(matrix: sparse.csr_array, singular: float) -> Callable[[np.ndarray], np.ndarray] | None:
    """Solves with a matrix, or None if a pivot is below ``singular`` times the largest."""
    # LAPACK itself: scipy's wrapper warns of what the caller mends
    factors, pivots, _ = linalg.lapack.dgetrf(matrix.toarray())
    sizes = np.abs(factors.diagonal())
    if singular and not sizes.min() > singular * sizes.max():
        return None
    return lambda load: linalg.lapack.dgetrs(factors, pivots, load)[0]


def _sparse_factors(matrix: sparse.csr_array, singular: float) -> Callable[[np.ndarray], np.ndarray] | None:
    """As :func:`_dense_factors`, by SuperLU."""
    try:
        factors = splu(sparse.csc_array(matrix), permc_spec="MMD_AT_PLUS_A")
    except RuntimeError:
        # an exactly vanishing pivot
        return None
    sizes = np.abs(factors.U.diagonal())
    return None if singular and not sizes.min() > singular * sizes.max() else factors.solve
