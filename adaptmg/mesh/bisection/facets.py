"""Which face of which element a boundary facet is, and back: facets follow the elements through a bisection."""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import inner_kernel, kernel

__all__ = ["facets_into_cells", "facets_of_cells"]


@inner_kernel
def _key(nodes, skip, corners):
    """Sum and largest of the corners but one: with the smallest they tell a face."""
    total, high, low = 0, -1, 2**31
    for k in range(corners):
        if k != skip:
            total += nodes[k]
            high = max(high, nodes[k])
            low = min(low, nodes[k])
    return total, high, low


@kernel
def facets_into_cells(facets, cells, n_cells, corners, n_nodes):
    """Write into the cells which boundary facet lies opposite each corner, -1 where there is none.

    Parameters
    ----------
    facets : (n_facets, dim) int32 array
    cells : (n, width) int32 array
        Changed: the columns after the corners.
    n_cells, corners, n_nodes : int

    Returns
    -------
    int
        How many were found.
    """
    # lists of facets by their highest node
    head = np.full(n_nodes, -1, dtype=np.int32)
    following = np.empty(len(facets), dtype=np.int32)
    on_boundary = np.zeros(n_nodes, dtype=np.bool_)
    for f in range(len(facets)):
        _, high, _ = _key(facets[f], -1, corners - 1)
        following[f] = head[high]
        head[high] = f
        for k in range(corners - 1):
            on_boundary[facets[f, k]] = True
    found = 0
    for e in range(n_cells):
        inside = 0
        for k in range(corners):
            inside += not on_boundary[cells[e, k]]
        for k in range(corners):
            cells[e, corners + k] = -1
            if inside > 1 or (inside == 1 and on_boundary[cells[e, k]]):
                continue
            total, high, low = _key(cells[e], k, corners)
            f = head[high]
            while f >= 0:
                if _key(facets[f], -1, corners - 1) == (total, high, low):
                    cells[e, corners + k] = f
                    found += 1
                    break
                f = following[f]
    return found


@kernel
def facets_of_cells(cells, n_cells, corners, n_facets, opposite):
    """The boundary facets of the cells, in the order of the facets they come from.

    Parameters
    ----------
    cells : (n, width) int32 array
    n_cells, corners : int
    n_facets : int
        How many facets the cells were given.
    opposite : (corners, corners - 1) int array
        Corners of the face opposite each, outwards.

    Returns
    -------
    facets : (n, dim) int32 array
    origin : (n,) int32 array
        The facet each comes from.
    """
    start = np.zeros(n_facets + 1, dtype=np.int64)
    for e in range(n_cells):
        for k in range(corners):
            if cells[e, corners + k] >= 0:
                start[cells[e, corners + k] + 1] += 1
    for f in range(n_facets):
        start[f + 1] += start[f]
    facets = np.empty((start[n_facets], corners - 1), dtype=np.int32)
    origin = np.empty(start[n_facets], dtype=np.int32)
    for e in range(n_cells):
        for k in range(corners):
            f = cells[e, corners + k]
            if f >= 0:
                row = start[f]
                start[f] += 1
                origin[row] = f
                for j in range(corners - 1):
                    facets[row, j] = cells[e, opposite[k, j]]
    return facets, origin
