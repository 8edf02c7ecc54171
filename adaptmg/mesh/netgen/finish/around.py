"""The elements around each node of a mesh, and which of their corners it is."""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import kernel, read_only

__all__ = ["cells_around"]


@kernel
def _fill(elements, start, items):
    """Fill compressed rows; ``start`` (n_nodes + 1,) comes as 0."""
    corners = elements.shape[1]
    for e in range(len(elements)):
        for k in range(corners):
            start[elements[e, k] + 1] += 1
    for i in range(len(start) - 1):
        start[i + 1] += start[i]
    for e in range(len(elements)):
        for k in range(corners):
            items[start[elements[e, k]]] = corners * e + k
            start[elements[e, k]] += 1
    for i in range(len(start) - 1, 0, -1):
        start[i] = start[i - 1]
    start[0] = 0


def cells_around(elements: np.ndarray, n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Compressed rows of corners, as ``corners * element + corner``.

    Parameters
    ----------
    elements : (n, corners) int32 array
    n_nodes : int

    Returns
    -------
    start : (n_nodes + 1,) int64 array
    items : (n * corners,) int64 array
        Those of node i in ``start[i] .. start[i + 1]``, ascending.
    """
    start, items = np.zeros(n_nodes + 1, dtype=np.int64), np.empty(elements.size, dtype=np.int64)
    _fill(read_only(elements), start, items)
    return start, items
