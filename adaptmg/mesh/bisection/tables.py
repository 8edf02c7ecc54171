"""The tables that a bisection works on: a row of 32 bit integers for each element, bisected element and node.

Cut edges are found through lists, one for each node: ``nodes[i, HEAD]`` is the first node that halves an edge from i to
a lower number, ``nodes[p, NEXT]`` the next one. Unlike a hash table the lists need no room of their own, and lie
where the mesh around them lies.
"""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import inner_kernel

__all__ = ["FOREBEAR", "HEAD", "HIGH", "LOW", "NEXT", "NODE_COLUMNS", "columns_of_cells", "columns_of_tree", "cut_edge",
           "longer", "midpoint_of", "roomier"]

# columns of the nodes: the list of its edges (see above), and both ends of the edge it halves
HEAD, NEXT, LOW, HIGH = 0, 1, 2, 3
NODE_COLUMNS = 4
# columns after the corners: of a bisected element its marks, its own forebear (row of the tree, -1: none), its new node
FOREBEAR = 1


def columns_of_cells(dim: int) -> int:
    """Corners, the boundary facet of each (-1: none), marks, forebear, generation, origin."""
    return 2 * (dim + 1) + 4


def columns_of_tree(dim: int) -> int:
    """Corners, marks, forebear, new node."""
    return dim + 4


@inner_kernel
def roomier(table):
    """The table with half as much room again."""
    result = np.empty((len(table) + len(table) // 2 + 16, table.shape[1]), table.dtype)
    # loops compile ten times as fast as slices
    for i in range(len(table)):
        for j in range(table.shape[1]):
            result[i, j] = table[i, j]
    return result


@inner_kernel
def longer(stamps):
    """The stamps with room for half as many more."""
    result = np.empty(len(stamps) + len(stamps) // 2 + 16, stamps.dtype)
    for i in range(len(stamps)):
        result[i] = stamps[i]
    return result


@inner_kernel
def midpoint_of(nodes, a, b):
    """The node that halves the edge (a, b), -1 if it is not cut."""
    low, high = min(a, b), max(a, b)
    p = nodes[high, HEAD]
    while p >= 0 and nodes[p, LOW] != low:
        p = nodes[p, NEXT]
    return p


@inner_kernel
def cut_edge(nodes, p, a, b):
    """Enter p, the next free row, as the node that halves the edge (a, b)."""
    low, high = min(a, b), max(a, b)
    nodes[p, HEAD] = -1
    nodes[p, NEXT] = nodes[high, HEAD]
    nodes[p, LOW] = low
    nodes[p, HIGH] = high
    nodes[high, HEAD] = p
