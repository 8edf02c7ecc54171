"""Facets of a simplicial mesh: who shares them, which lie on the boundary. Arrays only.

A facet (edge of a triangle, face of a tetrahedron) belongs to two elements inside a mesh and to one on its boundary. It
is identified by its sorted nodes :math:`a < b (< c)`, packed into one integer :math:`(a N + b) N + c`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

__all__ = ["MOST_NODES", "FacetTable", "components", "element_facets", "facet_keys", "facet_table", "same_orientation"]

#: by dimension: node numbers are of 32 bits, and the three of a facet must fit into 63
MOST_NODES = {2: 2**31 - 1, 3: 2**21 - 1}

# facet k lies opposite node k; of a positively oriented element its normal (see MeshArrays.facets) points outwards
_LOCAL = {2: np.array([[1, 2], [2, 0], [0, 1]]), 3: np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])}


@dataclass(frozen=True, eq=False)
class FacetTable:
    """The distinct facets of a mesh, sorted by key.

    Parameters
    ----------
    keys : (n,) array of int64
        Ascending, see :func:`facet_keys`.
    counts : (n,) array of int
        How many elements share the facet.
    first, second : (n,) array of int
        Two of those elements; ``second`` is -1 on the boundary.
    facets : (n, dim) array of int
        Nodes, oriented outwards as seen from ``first``.
    folded : (n,) array of bool
        Whether two elements see the facet in the same sense: of positively oriented ones, both lie on one side of it.
    """

    keys: np.ndarray
    counts: np.ndarray
    first: np.ndarray
    second: np.ndarray
    facets: np.ndarray
    folded: np.ndarray

    def find(self, keys: np.ndarray) -> np.ndarray:
        """Rows of this table that hold ``keys``, -1 where there is no such facet."""
        row = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[row] == keys, row, -1)


def element_facets(elements: np.ndarray) -> np.ndarray:
    """Facets (n_elements, dim + 1, dim) of positively oriented elements, outward, facet k opposite node k."""
    return elements[:, _LOCAL[elements.shape[1] - 1]]


def facet_keys(facets: np.ndarray, n_nodes: int) -> np.ndarray:
    """One integer a facet, the same for every order of its nodes.

    Parameters
    ----------
    facets : (n, dim) array of int
        Node numbers below ``n_nodes``.
    n_nodes : int
        At most ``MOST_NODES``.

    Returns
    -------
    (n,) int64 array
    """
    dim = facets.shape[1]
    if n_nodes > MOST_NODES[dim]:
        raise ValueError(f"a {dim}D mesh may have at most {MOST_NODES[dim]} nodes, got {n_nodes}")
    nodes = np.sort(facets.astype(np.int64), axis=1)
    key = nodes[:, 0]
    for column in nodes.T[1:]:
        key = key * n_nodes + column
    return key


def facet_table(elements: np.ndarray, n_nodes: int) -> FacetTable:
    """All distinct facets of a mesh.

    Parameters
    ----------
    elements : (n_elements, dim + 1) array of int
        At least one, positively oriented.
    n_nodes : int
        Number of nodes of the mesh.

    Returns
    -------
    FacetTable
    """
    dim = elements.shape[1] - 1
    facets = element_facets(elements).reshape(-1, dim)
    keys = facet_keys(facets, n_nodes)
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    start = np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]])
    counts = np.diff(np.r_[start, len(keys)])
    second = np.full(len(start), -1, dtype=np.int64)
    shared = counts > 1
    other = order[start[shared] + 1]
    second[shared] = other // (dim + 1)
    first = facets[order[start]]
    folded = np.zeros(len(start), dtype=bool)
    folded[shared] = same_orientation(first[shared], facets[other])
    return FacetTable(keys[start], counts, order[start] // (dim + 1), second, first, folded)


def same_orientation(facets: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Whether facets with the same nodes also have the same orientation, (n,) bool."""
    if facets.shape[1] == 2:
        return (facets == others).all(axis=1)
    return np.any([(facets == np.roll(others, k, axis=1)).all(axis=1) for k in range(3)], axis=0)


def components(table: FacetTable, element_body: np.ndarray) -> np.ndarray:
    """Connected parts of a mesh: elements of one body that hang together through facets.

    Parameters
    ----------
    table : FacetTable
        Facets of the mesh.
    element_body : (n_elements,) array of int
        Body of each element.

    Returns
    -------
    (n_elements,) int array
        Number of the part.
    """
    inner = table.second >= 0
    a, b = table.first[inner], table.second[inner]
    same = element_body[a] == element_body[b]
    n = len(element_body)
    graph = sparse.coo_array((np.ones(same.sum(), dtype=np.int8), (a[same], b[same])), shape=(n, n))
    return connected_components(graph, directed=False)[1]
