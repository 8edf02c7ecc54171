r"""gradation: sizes at the nodes of a mesh that grow no faster than a bound along its edges.

The largest sizes below the given ones with

.. math:: h_i \le h_j + g\,|x_i - x_j| \quad\text{for every edge } ij ,

found by relaxation from node to node, smallest sizes first: what shortest paths are to Dijkstra's method, with a queue
in place of a heap (a node comes up again only where its size has fallen meanwhile).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg._runtime import kernel
from adaptmg.mesh.arrays import MeshArrays

__all__ = ["ElementsAtNodes", "graded_sizes", "resolving"]

# edges that a boundary keeps along it, however small its error
_EDGES = 4


class ElementsAtNodes:
    """Which elements meet at each node of a mesh: built once, asked often."""

    def __init__(self, points: np.ndarray, elements: np.ndarray) -> None:
        self.points, self.elements = points, elements
        self.start = np.zeros(len(points) + 1, dtype=np.int64)
        self.items = np.empty(elements.size, dtype=np.int32)
        _elements_of_nodes(elements, self.start, self.items)


@kernel
def _elements_of_nodes(elements, start, items):
    """Fill the compressed rows ``start`` (n_nodes + 1,; zeros before), ``items``: the elements of each node."""
    for e in range(len(elements)):
        for k in range(elements.shape[1]):
            start[elements[e, k] + 1] += 1
    for i in range(1, len(start)):
        start[i] += start[i - 1]
    for e in range(len(elements)):
        for k in range(elements.shape[1]):
            i = elements[e, k]
            items[start[i]] = e
            start[i] += 1
    for i in range(len(start) - 1, 0, -1):
        start[i] = start[i - 1]
    start[0] = 0


@kernel
def _relax(points, elements, start, items, growth, sizes, queue, waiting):
    """Lower ``sizes`` in place; ``queue`` (n_nodes,) holds all nodes, smallest first, ``waiting`` all True."""
    n, dim = len(queue), points.shape[1]
    first, count = 0, n
    while count > 0:
        i = queue[first]
        first = first + 1 if first + 1 < n else 0
        count -= 1
        waiting[i] = False
        for s in range(start[i], start[i + 1]):
            e = items[s]
            for k in range(elements.shape[1]):
                j = elements[e, k]
                if sizes[j] <= sizes[i]:
                    continue
                squared = 0.0
                for c in range(dim):
                    squared += (points[i, c] - points[j, c]) ** 2
                bound = sizes[i] + growth * np.sqrt(squared)
                if sizes[j] > bound:
                    sizes[j] = bound
                    if not waiting[j]:
                        waiting[j] = True
                        last = first + count
                        queue[last - n if last >= n else last] = j
                        count += 1


def graded_sizes(neighbours: ElementsAtNodes, sizes: np.ndarray, growth: float) -> np.ndarray:
    """The largest sizes below the given ones that grow by at most ``growth`` per distance along edges."""
    result = np.array(sizes, dtype=np.float64)
    waiting = np.ones(len(result), dtype=np.bool_)
    _relax(neighbours.points, neighbours.elements, neighbours.start, neighbours.items, float(growth), result,
           np.argsort(result), waiting)
    return result


def resolving(mesh: MeshArrays, sizes: np.ndarray, boundaries: Sequence[str], growth: float) -> np.ndarray:
    """Sizes that leave each of some boundaries at least four edges across: contact needs nodes, whatever its error."""
    result = np.array(sizes, dtype=np.float64)
    for name in boundaries:
        facets = mesh.boundary_facets(name)
        sides = mesh.points[facets[:, 1:]] - mesh.points[facets[:, :1]]
        measure = np.sqrt(np.linalg.det(sides @ sides.transpose(0, 2, 1))).sum() / (mesh.dim - 1)
        nodes = np.unique(facets)
        result[nodes] = np.minimum(result[nodes], measure ** (1 / (mesh.dim - 1)) / _EDGES)
    if (result == sizes).all():
        return sizes
    return graded_sizes(ElementsAtNodes(mesh.points, mesh.elements), result, growth)
