"""Strips of nodes for sweeps by several threads.

A :class:`Strips` cuts the nodes of a large matrix into strips, such that a node is coupled with its
own strip and one of the two next to it, never with both. All even strips may then be swept at the
same time, and after them all odd ones: no strip reads or writes what another one writes, even where
a sweep scatters to neighbours. The result is that of Gauss-Seidel over all even strips one after
the other, then the odd ones. Small matrices are a single strip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order

from adaptmg import _threads as threads
from adaptmg.discrete.block_rows import BlockRows

#: the least number of strips that pays
FEWEST = 4


@dataclass(frozen=True, eq=False)
class Strips:
    """Nodes in the order of a forward sweep."""

    order: np.ndarray  # (n_nodes,) int32: even strips, then odd ones
    rank: np.ndarray  # (n_nodes,) int32: the place of a node in this order
    colours: list[list[tuple[int, int]]]  # ranges of places that are swept at the same time

    @classmethod
    def of(cls, rows: BlockRows, stored: bool = True) -> Strips:
        """Return the strips of a matrix with a symmetric pattern. Where the numbers of neighbours differ
        much, strips may go by distance in the graph. Sweeps then jump in memory, which is a third slower
        even if the caller has the rows ``stored`` in the order of the strips: so only with that, and only
        for several threads."""
        n = rows.n_nodes
        numbering = np.arange(n, dtype=np.int32)
        single = cls(numbering, numbering, [[(0, n)]])
        if rows.nonzeros < threads.LARGE:
            return single
        strips = _strips(rows, by_distance=stored and threads.several())
        if len(strips) < FEWEST:
            return single
        parts = [*strips[::2], *strips[1::2]]
        ends = np.cumsum([0, *map(len, parts)]).tolist()
        ranges = list(pairwise(ends))
        even = len(strips[::2])
        order = np.concatenate(parts)
        rank = np.empty_like(numbering)
        rank[order] = numbering
        return cls(order, rank, [ranges[:even], ranges[even:]])

    def sweep(self, kernel: Callable[..., Any], *arguments: object, backward: bool = False) -> None:
        """Call ``kernel(first, last, order, *arguments)``, which sweeps over these places, for all
        strips, those of a colour at the same time, ``backward`` the odd ones first."""
        if len(self.colours) == 1:  # quick for small matrices
            kernel(0, len(self.order), self.order, *arguments)
            return
        colours = self.colours[::-1] if backward else self.colours
        threads.in_colours(colours, kernel, self.order, *arguments, joined=True)


def _strips(rows: BlockRows, by_distance: bool) -> list[np.ndarray]:
    """Return an array of nodes (n,) for each strip. Strips are ranges of the numbers of nodes, or, where
    these are too few and ``by_distance`` allows it, ranges of the nodes in the order of their distance.
    Those of lattices are always ranges of numbers."""
    numbering = np.arange(rows.n_nodes, dtype=np.int32)
    bounds = _bounds(rows.last_columns())
    if len(bounds) > FEWEST or not by_distance or len(rows.kinds):
        return [numbering[first:last] for first, last in pairwise(bounds)]
    indptr = rows.matrix.indptr
    indices = rows.matrix.indices
    order = _by_distance(indptr, indices)
    place = np.empty_like(order)
    place[order] = numbering
    last_neighbour = np.maximum.reduceat(place[indices], indptr[:-1])  # its place, by node
    bounds = _bounds(last_neighbour[order])
    # in a strip in the order of the numbers: neighbours in memory
    return [np.sort(order[first:last]) for first, last in pairwise(bounds)]


def _bounds(last_neighbour: np.ndarray) -> list[int]:
    """Return the places at which strips begin, and n: ``last_neighbour`` (n,) is the place of the last
    neighbour of the node at each place."""
    n = len(last_neighbour)
    # nodes at places below k are coupled with places below reach[k] only
    reach = np.append(0, np.maximum.accumulate(last_neighbour) + 1)
    shortest = -(-n // (2 * threads.PARTS))  # rounded up: at most PARTS strips of each colour
    bounds = [0]
    while bounds[-1] < n:
        # a strip from b to reach[reach[b]] or further: a node that is coupled with the strip before it
        # lies below reach[b], and so its neighbours below reach[reach[b]], not in the next strip
        two_layers = int(reach[reach[bounds[-1]]])
        bounds.append(min(max(two_layers, bounds[-1] + shortest), n))
    return bounds


def _by_distance(indptr: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Return the nodes (n_nodes,) in the order of their distance from a first one in the graph of a matrix
    with these CSR arrays, one connected part after the other."""
    n = len(indptr) - 1
    graph = sparse.csr_array((np.ones(len(indices), dtype=np.int8), indices, indptr), shape=(n, n))
    unvisited = np.ones(n, dtype=bool)
    parts = []
    while unvisited.any():
        first = int(np.argmax(unvisited))
        part = breadth_first_order(graph, first, return_predecessors=False)
        parts.append(part)
        unvisited[part] = False
    return np.concatenate(parts).astype(np.int32)
