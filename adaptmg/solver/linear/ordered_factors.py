"""OrderedFactors: sparse LU factors of a matrix of blocks in an elimination order of one's own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

__all__ = ["OrderedFactors", "dofs_of"]


def dofs_of(nodes: np.ndarray, size: int) -> np.ndarray:
    """The dofs of nodes in turn, ``size`` each."""
    return (size * nodes.astype(np.int64)[:, None] + np.arange(size)).reshape(-1)


@dataclass(frozen=True, eq=False)
class OrderedFactors:
    """Factors by SuperLU.

    Attributes
    ----------
    lu : SuperLU
        Of the permuted matrix.
    order : (n_dofs,) int array
        Elimination order.
    diagonal : (n_dofs,) array
        Of the permuted matrix.
    """

    lu: SuperLU
    order: np.ndarray
    diagonal: np.ndarray

    @classmethod
    def of(cls, matrix: sparse.csr_array, order: np.ndarray, threshold: float = 0.0) -> OrderedFactors:
        """Factorise; pivots off the diagonal, which destroy the order, only where the diagonal is below a threshold.

        None at all are safe where the matrix is symmetric and positive definite.

        Raises
        ------
        RuntimeError
            If a pivot vanishes.
        """
        permuted = matrix[order][:, order].tocsc()
        lu = splu(permuted, permc_spec="NATURAL", diag_pivot_thresh=threshold, options={"SymmetricMode": True})
        return cls(lu, order, permuted.diagonal())

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """One solve (n_dofs,)."""
        result = np.empty_like(rhs)
        result[self.order] = self.lu.solve(rhs[self.order])
        return result
