"""Interface: the nodes near contact between bodies, swept more often than the others, and their rows of the matrix."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.coupling import Coupling
from adaptmg.multigrid.linear.split_matrix import SplitMatrix
from adaptmg.runtime.compiled import kernel

__all__ = ["Interface"]


@kernel
def _count(indptr, indices, place, result):
    """Row pointers of the rows (without diagonal) of the nodes with ``place`` >= 0."""
    for i in range(len(indptr) - 1):
        for k in range(indptr[i], indptr[i + 1]):
            j = np.int64(indices[k])
            if place[i] >= 0:
                result[place[i] + 1] += 1
            if place[j] >= 0:
                result[place[j] + 1] += 1
    for i in range(len(result) - 1):
        result[i + 1] += result[i]


@kernel
def _fill(dim, indptr, indices, lower, place, row_indptr, columns, blocks):
    """Columns and blocks of those rows; a block above the diagonal is the transpose of the one below."""
    size = dim * dim
    at = row_indptr[:-1].copy()
    for i in range(len(indptr) - 1):
        for k in range(indptr[i], indptr[i + 1]):
            j = np.int64(indices[k])
            p, q = place[i], place[j]
            if p >= 0:
                columns[at[p]] = j
                for c in range(size):
                    blocks[size * at[p] + c] = lower[size * k + c]
                at[p] += 1
            if q >= 0:
                columns[at[q]] = i
                for a in range(dim):
                    for b in range(dim):
                        blocks[size * at[q] + dim * a + b] = lower[size * k + dim * b + a]
                at[q] += 1


@kernel
def _add(dim, p, node, left, right, nodes, indptr, columns, blocks, diagonal, result, at):
    """result += diag(left) A diag(right) for the block in row ``p`` (a position) and column ``node``."""
    size = dim * dim
    if nodes[p] == node:
        for a in range(dim):
            for b in range(dim):
                result[at + dim * a + b] += left[a] * diagonal[size * p + dim * a + b] * right[b]
        return
    for k in range(indptr[p], indptr[p + 1]):
        if np.int64(columns[k]) == node:
            for a in range(dim):
                for b in range(dim):
                    result[at + dim * a + b] += left[a] * blocks[size * k + dim * a + b] * right[b]
            return


@kernel
def _alone(dim, nodes, indptr, columns, blocks, diagonal, follow_indptr, followers, weights, result):
    """Blocks D'AD of the motion D of each node that leaves its followers where they are."""
    one = np.ones(dim)
    left, right = np.empty(dim), np.empty(dim)
    for p in range(len(nodes)):
        at = dim * dim * p
        _add(dim, p, nodes[p], one, one, nodes, indptr, columns, blocks, diagonal, result, at)
        for s in range(follow_indptr[p], follow_indptr[p + 1]):
            for a in range(dim):
                left[a] = -weights[dim * s + a]
            q = followers[s]
            _add(dim, q, nodes[p], left, one, nodes, indptr, columns, blocks, diagonal, result, at)
            _add(dim, p, nodes[q], one, left, nodes, indptr, columns, blocks, diagonal, result, at)
            for t in range(follow_indptr[p], follow_indptr[p + 1]):
                for a in range(dim):
                    right[a] = -weights[dim * t + a]
                _add(dim, q, nodes[followers[t]], left, right, nodes, indptr, columns, blocks, diagonal, result, at)


class Interface:
    """Nodes within ``LAYERS`` edges of the graph of the matrix from the slave nodes (master nodes are neighbours).

    Parameters
    ----------
    level : SplitMatrix
        Only its lower half and its diagonal blocks are read.
    coupling : Coupling

    Attributes
    ----------
    nodes : (n,) int32 array
        Ascending.
    indptr, indices, blocks : arrays
        Their rows of the matrix without diagonal blocks; columns are nodes, blocks flat.
    diagonal : (n * dim * dim,) array
        Diagonal blocks.
    follow_indptr, followers, follow_weights : arrays
        Slave nodes that follow each node, as positions in ``nodes``, and their weights by component (zero where the
        slave is fixed), flat.
    alone : (n * dim * dim,) array
        Inverse blocks of each node moved without its followers.
    forward, backward : (n,) int32 arrays
        Positions in the order of sweeps.
    nonzeros : int
        Entries of the rows, what a sweep reads.
    """

    #: one layer does nearly as well, more than two gain nothing
    LAYERS = 2

    def __init__(self, level: SplitMatrix, coupling: Coupling) -> None:
        n, dim = level.n_nodes, level.dim
        ones = np.ones(len(level.lower_indices))
        half = sparse.csr_array((ones, level.lower_indices.astype(np.int32), level.lower_indptr), shape=(n, n))
        reached = (np.diff(coupling.weights.indptr) > 0).astype(float)
        for _ in range(self.LAYERS):
            reached = ((reached + half @ reached + half.T @ reached) > 0).astype(float)
        self.nodes = np.flatnonzero(reached).astype(np.int32)
        place = np.full(n, -1, dtype=np.int32)
        place[self.nodes] = np.arange(len(self.nodes), dtype=np.int32)
        self.indptr = np.zeros(len(self.nodes) + 1, dtype=np.int64)
        _count(level.lower_indptr, level.lower_indices, place, self.indptr)
        self.indices = np.empty(self.indptr[-1], dtype=np.uint32)
        self.blocks = np.empty(self.indptr[-1] * dim * dim)
        _fill(dim, *level.lower_arrays, place, self.indptr, self.indices, self.blocks)
        self.diagonal = level.diagonal.reshape(-1, dim * dim)[self.nodes].reshape(-1)
        self._follow(coupling, place)
        self.alone = np.zeros_like(self.diagonal)
        _alone(dim, self.nodes, self.indptr, self.indices, self.blocks, self.diagonal,
                             self.follow_indptr, self.followers, self.follow_weights, self.alone)
        # fixed components stay where they are, though followers pull at them
        free = ~coupling.fixed.reshape(-1, dim)[self.nodes]
        blocks = self.alone.reshape(-1, dim, dim) * (free[:, :, None] & free[:, None, :])
        self.alone = np.linalg.pinv(blocks, hermitian=True).reshape(-1)
        self.forward = np.arange(len(self.nodes), dtype=np.int32)
        self.backward = self.forward[::-1].copy()
        self.nonzeros = len(self.blocks) + len(self.diagonal)

    def _follow(self, coupling: Coupling, place: np.ndarray) -> None:
        """The followers of each node; of nodes that follow others themselves none."""
        by_master = sparse.csr_array(coupling.weights.T)[self.nodes]
        itself = np.diff(coupling.weights.indptr)[self.nodes] > 0
        kept = ~np.repeat(itself, np.diff(by_master.indptr))
        self.follow_indptr = np.concatenate([[0], np.cumsum(kept)])[by_master.indptr].astype(np.int32)
        slaves = by_master.indices[kept]
        self.followers = place[slaves]
        free = ~coupling.fixed.reshape(-1, coupling.dim)[slaves]
        self.follow_weights = (by_master.data[kept, None] * free).reshape(-1)

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """What the local sweeps read of it."""
        return (self.nodes, self.indptr, self.indices, self.blocks, self.diagonal, self.follow_indptr, self.followers,
                self.follow_weights, self.alone)

    @property
    def nbytes(self) -> int:
        """Memory of the arrays, bytes."""
        return sum(array.nbytes for array in (*self.arrays, self.forward, self.backward))
