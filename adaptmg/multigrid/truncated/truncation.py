"""Truncation: the matrices below one level, changed near contact whenever the contact status changes.

Changed blocks are carried down by nodal prolongations through lists of products made once; on coarse spaces that are
given dof by dof (algebraic ones, say) by sparse products.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.multigrid.linear.split_matrix import SplitMatrix
from adaptmg.multigrid.truncated import coarse_matrix_kernels as kernels
from adaptmg.multigrid.truncated.contact import TruncatedContact

__all__ = ["DofUpdate", "NodalUpdate", "Truncation"]


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


class Truncation:
    """Keeps the matrices of the levels below one level as the contact status of that level demands.

    Parameters
    ----------
    levels : list of SplitMatrix
        Coarsest first; the last is the level of the contact nodes. The others are changed in place and must come with
        their base matrices, of which ``P' A P`` is the pattern at least near contact.
    prolongations : list of csr_array
        Between neighbours, all of nodes or all of dofs.
    contact : TruncatedContact
        The contact nodes of the last level, whose matrix is taken as symmetric.
    """

    def __init__(self, levels: list[SplitMatrix], prolongations: list[sparse.csr_array],
                 contact: TruncatedContact) -> None:
        self.contact, fine = contact, levels[-1]
        dim = fine.dim
        count = kernels.count_blocks(contact.nodes, contact.contact_of, fine.lower_indptr, fine.lower_indices)
        rows, columns, entries = (np.empty(count, dtype=np.int32) for _ in range(3))
        kernels.collect(contact.nodes, contact.contact_of, fine.lower_indptr, fine.lower_indices, rows, columns,
                        entries)
        # contact node by contact node, so that what is written on the levels below lies close together
        owner = np.where(contact.contact_of[rows] < 0, contact.contact_of[columns], contact.contact_of[rows])
        order = np.argsort(owner, kind="stable")
        self.rows, self.columns = rows[order], columns[order]
        self.blocks, self.change = np.empty(count * dim * dim), np.zeros(count * dim * dim)
        kernels.fetch(dim, self.rows, self.columns, entries[order], fine.lower, contact.diagonal, self.blocks)
        if prolongations[-1].shape[0] == fine.n_nodes:
            self.products: NodalUpdate | DofUpdate = NodalUpdate(levels[:-1], prolongations, self.rows, self.columns)
        else:
            self.products = DofUpdate(levels[:-1], prolongations, dim, self.rows, self.columns)

    def apply(self, newton: bool) -> None:
        """Change the matrices for the present status; ``newton`` False keeps them symmetric, with g frozen."""
        o = self.contact
        kernels.changed_blocks(o.dim, self.rows, self.columns, self.blocks, o.contact_of, o.codes, o.frames,
                               o.friction, o.direction, o.hessian, newton, self.change)
        self.products.update(self.change)

    def restore(self) -> None:
        """Put the base matrices back."""
        self.products.restore()

    @property
    def nbytes(self) -> int:
        """Memory of the arrays, bytes."""
        own = self.rows.nbytes + self.columns.nbytes + self.blocks.nbytes + self.change.nbytes
        return own + self.products.nbytes
