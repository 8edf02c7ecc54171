"""Interface: the nodes near contact between bodies, which are swept more often than the others."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.multigrid.halves import Halves

__all__ = ["Interface"]


class Interface:
    """Nodes within ``LAYERS`` edges of the graph of the matrix from the slave nodes (master nodes are neighbours).

    Parameters
    ----------
    level : Halves
    nodes : (n_contact,) array
        Slave nodes.

    Attributes
    ----------
    forward, backward : (n,) int32 arrays
        The nodes, ascending and descending.
    nonzeros : int
        Entries of their rows, what a local sweep reads.
    """

    #: one layer does nearly as well, more than two gain nothing
    LAYERS = 2

    def __init__(self, level: Halves, nodes: np.ndarray) -> None:
        n = level.n_nodes
        ones = np.ones(len(level.lower_indices))
        half = sparse.csr_array((ones, level.lower_indices.astype(np.int32), level.lower_indptr), shape=(n, n))
        reached = np.zeros(n)
        reached[nodes] = 1.0
        for _ in range(self.LAYERS):
            reached = ((reached + half @ reached + half.T @ reached) > 0).astype(float)
        self.forward = np.flatnonzero(reached).astype(np.int32)
        self.backward = self.forward[::-1].copy()
        blocks = np.diff(level.lower_indptr) + np.diff(level.upper_indptr) + 1
        self.nonzeros = int(blocks[self.forward].sum()) * level.dim**2
