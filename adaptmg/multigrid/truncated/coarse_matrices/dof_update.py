"""Updates of Galerkin matrices on coarse spaces that are given dof by dof (algebraic ones, say), by sparse products."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.multigrid.linear.split_matrix import SplitMatrix
from adaptmg.multigrid.truncated.coarse_matrices import kernels

__all__ = ["DofUpdate"]


@dataclass(eq=False)
class _ChangedDofs:
    """One coarse level: the part of the prolongation that changes pass, and where they go."""

    level: SplitMatrix
    weights: sparse.csr_array
    free: np.ndarray
    keys: np.ndarray
    slots: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    base: np.ndarray

    @classmethod
    def of(cls, level: SplitMatrix, weights: sparse.csr_array, dofs: np.ndarray,
           pattern: sparse.csr_array) -> _ChangedDofs:
        """From the weights of the changed dofs, the coarse ones they reach, and the pattern of the change (ones)."""
        order = sparse.coo_array(pattern)
        keys = np.sort(order.row.astype(np.int64) * len(dofs) + order.col)
        rows, columns = dofs[keys // len(dofs)], dofs[keys % len(dofs)]
        slots = np.empty(len(keys), dtype=np.int64)
        kernels.find_slots(rows, columns, level.lower_indptr, level.lower_indices, level.upper_indptr,
                           level.upper_indices, slots)
        if (slots < 0).any():
            raise ValueError("a coarse matrix lacks entries of the Galerkin product near contact: it must be P'AP")
        free = np.ones(level.n_dofs, dtype=bool)
        free[level.fixed] = False
        return cls(level, weights, free, keys, slots, rows, columns, level.at_slots(slots))

    def update(self, change: sparse.csr_array) -> sparse.csr_array:
        """Write the matrix for a change on the finer level; returns the change on this one."""
        result = sparse.coo_array(self.weights.T @ (change @ self.weights))
        # a product may leave out entries that happen to vanish
        values = np.zeros(len(self.keys))
        values[np.searchsorted(self.keys, result.row.astype(np.int64) * result.shape[1] + result.col)] = result.data
        self._store(values)
        return sparse.csr_array(result)

    def restore(self) -> None:
        """Put the base matrix back."""
        self._store(np.zeros(len(self.slots)))

    def _store(self, change: np.ndarray) -> None:
        level = self.level
        kernels.store(1, self.slots, self.rows, self.columns, self.base, change, self.free,
                      int(level.lower_indptr[-1]), level.lower, level.upper, level.diagonal, level.inverse)


class DofUpdate:
    """Carries changed blocks down scalar levels.

    Parameters
    ----------
    levels : list of SplitMatrix
        The coarse levels, coarsest first, of blocks of size 1.
    prolongations : list of csr_array
        From each of them to the next finer level (n_dofs, n_dofs coarse).
    dim : int
        Block size of the finest level.
    rows, columns : int32 arrays
        Of the changed blocks there.
    """

    def __init__(self, levels: list[SplitMatrix], prolongations: list[sparse.csr_array], dim: int, rows: np.ndarray,
                 columns: np.ndarray) -> None:
        components = np.arange(dim)
        shape = (len(rows), dim, dim)
        dof_rows = np.broadcast_to((dim * rows.astype(np.int64)[:, None] + components)[:, :, None], shape).reshape(-1)
        dof_columns = np.broadcast_to((dim * columns.astype(np.int64)[:, None] + components)[:, None, :], shape)
        dofs, position = np.unique(np.concatenate([dof_rows, dof_columns.reshape(-1)]), return_inverse=True)
        self._rows, self._columns = np.split(position, 2)
        self._size = len(dofs)
        pattern = sparse.csr_array(sparse.coo_array((np.ones(len(self._rows)), (self._rows, self._columns)),
                                                    shape=(self._size, self._size)))
        self.below: list[_ChangedDofs] = []
        for level, prolongation in zip(reversed(levels), reversed(prolongations), strict=True):
            weights = sparse.csr_array(prolongation[dofs])
            dofs = np.unique(weights.indices).astype(np.int64)
            weights = sparse.csr_array(weights[:, dofs])
            reach = sparse.csr_array((np.ones(weights.nnz), weights.indices, weights.indptr), shape=weights.shape)
            pattern = sparse.csr_array(reach.T @ (pattern @ reach))
            self.below.append(_ChangedDofs.of(level, weights, dofs, pattern))

    def update(self, change: np.ndarray) -> None:
        """Write the matrices for a change (n_blocks * dim^2,) on the finest level."""
        shape = (self._size, self._size)
        matrix = sparse.csr_array(sparse.coo_array((change, (self._rows, self._columns)), shape=shape))
        for below in self.below:
            matrix = below.update(matrix)

    def restore(self) -> None:
        """Put the base matrices back."""
        for below in self.below:
            below.restore()

    @property
    def nbytes(self) -> int:
        """Memory of the arrays, bytes."""
        arrays = [self._rows, self._columns]
        for below in self.below:
            arrays += [below.weights.data, below.weights.indices, below.keys, below.slots, below.rows, below.columns,
                       below.base]
        return sum(array.nbytes for array in arrays)
