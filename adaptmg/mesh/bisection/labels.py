"""The first labels of a mesh: which edge of each element is halved first, and what the marks of tetrahedra are.

The longest edge goes first, of a face as of an element; among edges of one length that with the highest node numbers.
This is one order of all edges of a mesh: a face is marked alike from both its sides, as the bisection of tetrahedra
asks for.
"""

from __future__ import annotations

import numpy as np

from adaptmg.mesh.bisection.children import marks_code
from adaptmg.runtime.compiled import inner_kernel, kernel

__all__ = ["CODES", "EVEN", "first_labels"]

# for each longest edge (i, j) of a tetrahedron, i < j: an even order of the corners that begins with it
EVEN = np.array([[[0, 1, 2, 3], [0, 1, 2, 3], [0, 2, 3, 1], [0, 3, 1, 2]],
                  [[0, 1, 2, 3], [0, 1, 2, 3], [1, 2, 0, 3], [1, 3, 2, 0]],
                  [[0, 1, 2, 3], [0, 1, 2, 3], [0, 1, 2, 3], [2, 3, 0, 1]]], dtype=np.int64)
# codes of the marks of both faces that hold corners 2 and 3, by the number of the longest edge
CODES = np.array([[marks_code(i, j) for j in range(3)] for i in range(3)], dtype=np.int32)


@inner_kernel
def _longer(points, a, b, c, d):
    """Whether the edge (a, b) comes before (c, d); lengths are added up alike from both sides of a face."""
    if a > b:
        a, b = b, a
    if c > d:
        c, d = d, c
    first, second = 0.0, 0.0
    for k in range(points.shape[1]):
        first += (points[a, k] - points[b, k]) ** 2
        second += (points[c, k] - points[d, k]) ** 2
    if first != second:
        return first > second
    return b > d or (b == d and a > c)


@inner_kernel
def _mark(points, x, y, z):
    """Of the face (x, y, z): 0 if (x, y) is its longest edge, 1 if (x, z), 2 if (y, z)."""
    if _longer(points, x, y, x, z):
        return 0 if _longer(points, x, y, y, z) else 2
    return 1 if _longer(points, x, z, y, z) else 2


@kernel
def first_labels(points, cells, n_cells, corners, even, codes):
    """Turn the corners of each element so that its longest edge comes first, and mark the faces of tetrahedra.

    Parameters
    ----------
    points : (n, dim) array
    cells : (n, width) int32 array
        Changed: corners, the facets opposite them, marks; see :mod:`adaptmg.mesh.bisection.tables`.
    n_cells, corners : int
    even, codes : arrays
        ``EVEN`` and ``CODES``.
    """
    old = np.empty(2 * corners, dtype=np.int32)
    for e in range(n_cells):
        for k in range(2 * corners):
            old[k] = cells[e, k]
        first, second = 0, 1
        for j in range(1, corners):
            for i in range(j):
                if (i, j) != (0, 1) and _longer(points, old[i], old[j], old[first], old[second]):
                    first, second = i, j
        for k in range(corners):
            # a triangle is turned round; its longest edge (0, 2) begins with 2
            source = (k + (first if second == first + 1 else 2)) % 3 if corners == 3 else even[first, second, k]
            cells[e, k] = old[source]
            cells[e, corners + k] = old[corners + source]
        if corners == 4:
            a, b, c, d = cells[e, 0], cells[e, 1], cells[e, 2], cells[e, 3]
            cells[e, 8] = codes[_mark(points, b, c, d), _mark(points, a, c, d)]
        else:
            cells[e, 6] = 0
