"""Truncation: the matrices below one level, changed near contact whenever the contact status changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.multigrid import truncation_kernels as kernels
from adaptmg.multigrid.halves import Halves
from adaptmg.multigrid.obstacle import Obstacle
from adaptmg.multigrid.truncation_dofs import DofChain

__all__ = ["Truncation"]


@dataclass(eq=False)
class _Below:
    """The blocks of one coarse level that the contact status changes, and the products they are made of."""

    level: Halves
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


class Truncation:
    """Keeps the matrices of the levels below one level as the contact status of that level demands.

    Parameters
    ----------
    levels : list of Halves
        Coarsest first; the last is the level of the contact nodes. The others are changed in place and must come with
        their base matrices, of which ``P' A P`` is the pattern at least near contact.
    prolongations : list of csr_array
        Between neighbours, all of nodes or all of dofs.
    obstacle : Obstacle
        The contact nodes of the last level, whose matrix is taken as symmetric.
    """

    def __init__(self, levels: list[Halves], prolongations: list[sparse.csr_array], obstacle: Obstacle) -> None:
        self.obstacle, fine = obstacle, levels[-1]
        dim = fine.dim
        count = kernels.count_blocks(obstacle.nodes, obstacle.contact_of, fine.lower_indptr, fine.lower_indices)
        rows, columns, entries = (np.empty(count, dtype=np.int32) for _ in range(3))
        kernels.collect(obstacle.nodes, obstacle.contact_of, fine.lower_indptr, fine.lower_indices, rows, columns,
                        entries)
        # contact node by contact node, so that what is written on the levels below lies close together
        owner = np.where(obstacle.contact_of[rows] < 0, obstacle.contact_of[columns], obstacle.contact_of[rows])
        order = np.argsort(owner, kind="stable")
        self.rows, self.columns = rows[order], columns[order]
        self.blocks, self.change = np.empty(count * dim * dim), np.zeros(count * dim * dim)
        kernels.fetch(dim, self.rows, self.columns, entries[order], fine.lower, obstacle.diagonal, self.blocks)
        if prolongations[-1].shape[0] == fine.n_nodes:
            self.chain: NodalChain | DofChain = NodalChain(levels[:-1], prolongations, self.rows, self.columns)
        else:
            self.chain = DofChain(levels[:-1], prolongations, dim, self.rows, self.columns)

    def apply(self, newton: bool) -> None:
        """Change the matrices for the present status; ``newton`` False keeps them symmetric, with g frozen."""
        o = self.obstacle
        kernels.changed_blocks(o.dim, self.rows, self.columns, self.blocks, o.contact_of, o.codes, o.frames,
                               o.friction, o.direction, o.hessian, newton, self.change)
        self.chain.update(self.change)

    def restore(self) -> None:
        """Put the base matrices back."""
        self.chain.restore()

    @property
    def nbytes(self) -> int:
        """Memory of the arrays, bytes."""
        own = self.rows.nbytes + self.columns.nbytes + self.blocks.nbytes + self.change.nbytes
        return own + self.chain.nbytes


class NodalChain:
    """Carries changed blocks down the levels by nodal prolongations, through lists of products made once.

    Parameters
    ----------
    levels : list of Halves
        The coarse levels, coarsest first.
    prolongations : list of csr_array
        From each of them to the next finer level, nodal.
    rows, columns : int32 arrays
        Of the changed blocks on the finest level.
    """

    def __init__(self, levels: list[Halves], prolongations: list[sparse.csr_array], rows: np.ndarray,
                 columns: np.ndarray) -> None:
        self.below: list[_Below] = []
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


def _products(level: Halves, nodal: sparse.csr_array, rows: np.ndarray, columns: np.ndarray) -> _Below:
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
    return _Below(level, free, source[:count].copy(), target[:count].copy(), weight[:count].copy(), slots,
                  coarse_rows[:met].copy(), coarse_columns[:met].copy(), level.at_slots(slots), np.zeros(met * size))
