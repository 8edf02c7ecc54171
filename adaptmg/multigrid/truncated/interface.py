"""Interface: the nodes near contact between bodies, which are swept more often than the others."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.coupling import Coupling
from adaptmg.multigrid.linear.split_matrix import SplitMatrix
from adaptmg.multigrid.truncated import interface_rows

__all__ = ["Interface"]


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
        interface_rows.count(level.lower_indptr, level.lower_indices, place, self.indptr)
        self.indices = np.empty(self.indptr[-1], dtype=np.uint32)
        self.blocks = np.empty(self.indptr[-1] * dim * dim)
        interface_rows.fill(dim, *level.lower_arrays, place, self.indptr, self.indices, self.blocks)
        self.diagonal = level.diagonal.reshape(-1, dim * dim)[self.nodes].reshape(-1)
        self._follow(coupling, place)
        self.alone = np.zeros_like(self.diagonal)
        interface_rows.alone(dim, self.nodes, self.indptr, self.indices, self.blocks, self.diagonal,
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
