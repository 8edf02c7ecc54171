"""Updates of Galerkin matrices below a level on which blocks change, by nodal prolongations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.multigrid.linear.split_matrix import SplitMatrix
from adaptmg.multigrid.truncated.coarse_matrices import kernels

__all__ = ["NodalUpdate"]


@dataclass(eq=False)
class _ChangedBlocks:
    """The blocks of one coarse level that the contact status changes, and the products they are made of."""

    level: SplitMatrix
    free: np.ndarray
    source: np.ndarray
    target: np.ndarray
    weight: np.ndarray
    slots: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    base: np.ndarray
    change: np.ndarray

    def store(self) -> None:
        """Write base + change into the level."""
        level = self.level
        kernels.store(level.dim, self.slots, self.rows, self.columns, self.base, self.change, self.free,
                      int(level.lower_indptr[-1]), level.lower, level.upper, level.diagonal, level.inverse)


class NodalUpdate:
    """Carries changed blocks down the levels by nodal prolongations, through lists of products made once.

    Parameters
    ----------
    levels : list of SplitMatrix
        The coarse levels, coarsest first.
    prolongations : list of csr_array
        From each of them to the next finer level, nodal.
    rows, columns : int32 arrays
        Of the changed blocks on the finest level.
    """

    def __init__(self, levels: list[SplitMatrix], prolongations: list[sparse.csr_array], rows: np.ndarray,
                 columns: np.ndarray) -> None:
        self.below: list[_ChangedBlocks] = []
        for level, nodal in zip(reversed(levels), reversed(prolongations), strict=True):
            self.below.append(_products(level, nodal, rows, columns))
            rows, columns = self.below[-1].rows, self.below[-1].columns

    def update(self, change: np.ndarray) -> None:
        """Write the matrices for a change (n_blocks * dim^2,) on the finest level."""
        for below in self.below:
            kernels.add_contributions(below.level.dim**2, below.source, below.target, below.weight, change,
                                      below.change)
            below.store()
            change = below.change

    def restore(self) -> None:
        """Put the base matrices back."""
        for below in self.below:
            below.change[:] = 0.0
            below.store()

    @property
    def nbytes(self) -> int:
        """Memory of the arrays, bytes."""
        return sum(value.nbytes for below in self.below for value in vars(below).values()
                   if isinstance(value, np.ndarray))


def _products(level: SplitMatrix, nodal: sparse.csr_array, rows: np.ndarray, columns: np.ndarray) -> _ChangedBlocks:
    """Where the blocks of a finer level go on this one."""
    size = level.dim**2
    room = int(kernels.count_contributions(rows, columns, nodal.indptr))
    source, target, weight = np.empty(room, dtype=np.int32), np.empty(room, dtype=np.int32), np.empty(room)
    slots = np.empty(room, dtype=np.int64)
    coarse_rows, coarse_columns = np.empty(room, dtype=np.int32), np.empty(room, dtype=np.int32)
    below, above, n = int(level.lower_indptr[-1]), int(level.upper_indptr[-1]), level.n_nodes
    number = np.full(below + n + above, -1, dtype=np.int32)
    met, count, lost = kernels.fill_contributions(
        rows, columns, nodal.indptr, nodal.indices, nodal.data, level.lower_indptr, level.lower_indices,
        level.upper_indptr, level.upper_indices, number, source, target, weight, slots, coarse_rows, coarse_columns)
    if lost:
        raise ValueError(f"a coarse matrix lacks {lost} entries of the Galerkin product near contact: build the coarse "
                         "matrices with coarse_matrices='galerkin'")
    slots = slots[:met].copy()
    free = np.ones(level.n_dofs, dtype=bool)
    free[level.fixed] = False
    return _ChangedBlocks(level, free, source[:count].copy(), target[:count].copy(), weight[:count].copy(), slots,
                  coarse_rows[:met].copy(), coarse_columns[:met].copy(), level.at_slots(slots), np.zeros(met * size))
