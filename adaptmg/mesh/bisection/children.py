r"""How one element is bisected: its two children, their order of corners and their marks.

The edge between the first two corners is halved, at the new node p, which is the last corner of both children.

Triangles (a, b, c), newest-vertex bisection: children (c, a, p) and (b, c, p).

Tetrahedra, after D. N. Arnold, A. Mukherjee, L. Pouly (SIAM J. Sci. Comput. 22, 2000,
doi:10.1137/S1064827597323373). Of each face one edge is marked; of the two that hold the halved edge it is that edge,
the other two are (1, 2, 3) and (0, 2, 3), whose marks are coded 0, 1, 2: to corner 2, to corner 3, the edge (2, 3).
A child's edge to be halved next is the mark of the face it inherits; the cut faces are marked opposite p, the new face
(p, 2, 3) too, unless all marks of the parent lie in one plane and it is flagged: then from p to the next edge. Children
of an unflagged plane one are flagged. From any tetrahedron this makes a bounded number of similarity classes.

First labels: the longest edge goes first, of a face as of an element; among edges of one length that with the highest
node numbers. This is one order of all edges of a mesh: a face is marked alike from both its sides, as the bisection of
tetrahedra asks for.
"""

from __future__ import annotations

import numpy as np

from adaptmg._numba import inner_kernel, kernel

# what a flagged element has its marks raised by
FLAG = 9


@inner_kernel
def _triangle(cells, e, n, p):
    """The children of triangle e: the first in its place, the second in row n."""
    a, b, c = cells[e, 0], cells[e, 1], cells[e, 2]
    fa, fb, fc = cells[e, 3], cells[e, 4], cells[e, 5]
    cells[e, 0], cells[e, 1], cells[e, 2] = c, a, p
    cells[e, 3], cells[e, 4], cells[e, 5] = fc, -1, fb
    cells[n, 0], cells[n, 1], cells[n, 2] = b, c, p
    cells[n, 3], cells[n, 4], cells[n, 5] = -1, fc, fa


@inner_kernel
def _place(cells, row, corners, sides, order, marks):
    """A tetrahedron with its corners in another, even order."""
    for j in range(4):
        cells[row, j] = corners[order[j]]
        cells[row, 4 + j] = sides[order[j]]
    cells[row, 8] = marks


@inner_kernel
def _tetrahedron(cells, e, n, p):
    """The children of tetrahedron e: the first in its place, the second in row n."""
    # of one type, so that the tuples can be indexed
    p = np.int64(p)
    v0, v1, v2, v3 = np.int64(cells[e, 0]), np.int64(cells[e, 1]), np.int64(cells[e, 2]), np.int64(cells[e, 3])
    f0, f1, f2, f3 = np.int64(cells[e, 4]), np.int64(cells[e, 5]), np.int64(cells[e, 6]), np.int64(cells[e, 7])
    flagged = cells[e, 8] >= FLAG
    marks = cells[e, 8] - FLAG if flagged else cells[e, 8]
    first, second = marks // 3, marks % 3
    plane = first == second and first < 2
    # the mark of the new face is the edge (2, 3), code 0, or from p to the edge that is halved next, code 1
    to_new = 1 if plane and flagged else 0
    flag = FLAG if plane and not flagged else 0
    # the first child keeps corner 0: p stands for corner 1
    corners, sides = (v0, p, v2, v3), (-1, f1, f2, f3)
    if second == 0:
        _place(cells, e, corners, sides, (0, 2, 3, 1), flag + 3 * to_new)
    elif second == 1:
        _place(cells, e, corners, sides, (3, 0, 2, 1), flag + to_new)
    else:
        _place(cells, e, corners, sides, (2, 3, 0, 1), flag)
    corners, sides = (p, v1, v2, v3), (f0, -1, f2, f3)
    if first == 0:
        _place(cells, n, corners, sides, (2, 1, 3, 0), flag + to_new)
    elif first == 1:
        _place(cells, n, corners, sides, (1, 3, 2, 0), flag + 3 * to_new)
    else:
        _place(cells, n, corners, sides, (3, 2, 1, 0), flag)


@inner_kernel
def write_children(cells, e, n, corners, p):
    """Bisect element e at node p: children into rows e and n of the cells."""
    marks = 2 * corners
    if corners == 3:
        _triangle(cells, e, n, p)
        cells[n, marks] = 0
    else:
        _tetrahedron(cells, e, n, p)
    cells[e, marks + 1] += 1
    cells[n, marks + 1] = cells[e, marks + 1]
    cells[n, marks + 2] = cells[e, marks + 2]


# for each longest edge (i, j) of a tetrahedron, i < j: an even order of the corners that begins with it
EVEN = np.array([[[0, 1, 2, 3], [0, 1, 2, 3], [0, 2, 3, 1], [0, 3, 1, 2]],
                  [[0, 1, 2, 3], [0, 1, 2, 3], [1, 2, 0, 3], [1, 3, 2, 0]],
                  [[0, 1, 2, 3], [0, 1, 2, 3], [0, 1, 2, 3], [2, 3, 0, 1]]], dtype=np.int64)
# codes of the marks of both faces that hold corners 2 and 3, by the number of the longest edge
CODES = np.arange(9, dtype=np.int32).reshape(3, 3)


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
def first_labels(points, cells, n_cells, corners, even, codes, old):
    """Turn the corners of each element so that its longest edge comes first, and mark the faces of tetrahedra. ``old``
    (2 * corners,) is overwritten."""
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
