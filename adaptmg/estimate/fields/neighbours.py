"""Neighbours: which element lies across each facet of an element, and which element a boundary facet belongs to.

Facets are kept in buckets by their lowest node; two are the same if their lowest and highest nodes and the sums of
their nodes agree. A bucket holds about a dozen of them (3D: some dozens), so that no table has to be sorted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.runtime.compiled import inner_kernel, kernel

__all__ = ["Neighbours", "neighbours"]


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Who lies beside whom.

    Attributes
    ----------
    across : (n_elements, dim + 1) int32 array
        Element across the facet opposite each corner; -1 on the boundary of the mesh.
    owner : (n_facets,) int32 array
        Element of each boundary facet of the mesh, the one with the lower number where the facet lies inside.
    corner : (n_facets,) int32 array
        The corner of that element which lies opposite.
    """

    across: np.ndarray
    owner: np.ndarray
    corner: np.ndarray


def neighbours(mesh: MeshArrays) -> Neighbours:
    """Neighbours in a mesh.

    Parameters
    ----------
    mesh : MeshArrays
        Facets that more than two elements share have the last two of them as neighbours.

    Returns
    -------
    Neighbours

    Raises
    ------
    ValueError
        If a boundary facet belongs to no element.
    """
    n, k = mesh.elements.shape
    across = np.full((n, k), -1, dtype=np.int32)
    owner, corner = (np.full(len(mesh.facets), -1, dtype=np.int32) for _ in range(2))
    start = np.zeros(mesh.n_nodes + 1, dtype=np.int64)
    codes, highs, sums = np.empty(n * k, np.int32), np.empty(n * k, np.int32), np.empty(n * k, np.int64)
    find_neighbours(mesh.elements, mesh.facets, start, codes, highs, sums, across, owner, corner)
    if len(owner) and owner.min() < 0:
        i = int(np.argmin(owner))
        raise ValueError(f"mesh: boundary facet {i} of nodes {mesh.facets[i].tolist()} belongs to no element")
    return Neighbours(across, owner, corner)


@inner_kernel
def _keys(nodes, left_out):
    """Lowest and highest node and the sum of nodes, the corner ``left_out`` (-1: none) apart."""
    low, high, total = 2**62, -1, 0
    for k in range(len(nodes)):
        if k != left_out:
            v = nodes[k]
            low, high, total = min(low, v), max(high, v), total + v
    return low, high, total


@inner_kernel
def _fill_buckets(elements, start, codes, highs, sums):
    """Facets, as element * corners + corner, by lowest node: those of node i in start[i] .. start[i + 1]."""
    n, k = elements.shape
    for e in range(n):
        for c in range(k):
            low, high, total = _keys(elements[e], c)
            start[low + 1] += 1
    for i in range(len(start) - 1):
        start[i + 1] += start[i]
    for e in range(n):
        for c in range(k):
            low, high, total = _keys(elements[e], c)
            at = start[low]
            codes[at], highs[at], sums[at] = e * k + c, high, total
            start[low] = at + 1
    for i in range(len(start) - 1, 0, -1):
        start[i] = start[i - 1]
    start[0] = 0


@kernel
def find_neighbours(elements, facets, start, codes, highs, sums, across, owner, corner):
    """Fill ``across``, ``owner`` and ``corner``, which come as -1; ``start`` comes as 0, the others as they are."""
    k = elements.shape[1]
    _fill_buckets(elements, start, codes, highs, sums)
    for i in range(len(start) - 1):
        for a in range(start[i], start[i + 1]):
            for b in range(a + 1, start[i + 1]):
                if highs[a] == highs[b] and sums[a] == sums[b]:
                    across[codes[a] // k, codes[a] % k] = codes[b] // k
                    across[codes[b] // k, codes[b] % k] = codes[a] // k
    for f in range(len(facets)):
        low, high, total = _keys(facets[f], -1)
        for a in range(start[low], start[low + 1]):
            if owner[f] < 0 and highs[a] == high and sums[a] == total:
                owner[f] = codes[a] // k
                corner[f] = codes[a] % k
