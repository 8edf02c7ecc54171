r"""How one element is bisected: its two children, their order of corners and their marks.

The edge between the first two corners is halved, at the new node p, which is the last corner of both children.

Triangles (a, b, c), newest-vertex bisection: children (c, a, p) and (b, c, p).

Tetrahedra, after D. N. Arnold, A. Mukherjee, L. Pouly (SIAM J. Sci. Comput. 22, 2000,
doi:10.1137/S1064827597323373). Of each face one edge is marked; of the two that hold the halved edge it is that edge,
the other two are (1, 2, 3) and (0, 2, 3), whose marks are coded 0, 1, 2: to corner 2, to corner 3, the edge (2, 3).
A child's edge to be halved next is the mark of the face it inherits; the cut faces are marked opposite p, the new face
(p, 2, 3) too, unless all marks of the parent lie in one plane and it is flagged: then from p to the next edge. Children
of an unflagged plane one are flagged. From any tetrahedron this makes a bounded number of similarity classes.

Refinement: what a mesh knows of the bisections it came from. They go on from it, and are taken back by it.

The tables that a bisection works on: a row of 32 bit integers for each element, bisected element and node.

Cut edges are found through lists, one for each node: ``nodes[i, HEAD]`` is the first node that halves an edge from i to
a lower number, ``nodes[p, NEXT]`` the next one. Unlike a hash table the lists need no room of their own, and lie
where the mesh around them lies.

The first labels of a mesh: which edge of each element is halved first, and what the marks of tetrahedra are.

The longest edge goes first, of a face as of an element; among edges of one length that with the highest node numbers.
This is one order of all edges of a mesh: a face is marked alike from both its sides, as the bisection of tetrahedra
asks for.

Which face of which element a boundary facet is, and back: facets follow the elements through a bisection.

The history of a bisected mesh as plain arrays, for files; and back, checked as if a stranger had written them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from adaptmg._runtime import inner_kernel, kernel
from adaptmg.mesh.arrays import MeshArrays, trusted

__all__ = ["CODES", "EVEN", "FLAG", "FOREBEAR", "HEAD", "HIGH", "LOW", "NEXT", "NODE_COLUMNS", "Refinement",
           "as_initial", "columns_of_cells", "columns_of_tree", "cut_edge", "facets_into_cells", "facets_of_cells",
           "first_labels", "history_arrays", "longer", "marks_code", "midpoint_of", "roomier", "with_history",
           "with_refinement", "write_children"]

# what a flagged element has its marks raised by
FLAG = 9


def marks_code(first: int, second: int) -> int:
    """Marks of the faces opposite the first and the second corner in one number, unflagged."""
    return 3 * first + second


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
def write_children(cells, e, n, tree, m, p):
    """Bisect element e at node p: children into rows e and n of the cells, itself into row m of the tree."""
    corners = tree.shape[1] - 3
    marks = 2 * corners
    for j in range(corners):
        tree[m, j] = cells[e, j]
    tree[m, corners] = cells[e, marks]
    tree[m, corners + 1] = cells[e, marks + 1]
    tree[m, corners + 2] = p
    if corners == 3:
        _triangle(cells, e, n, p)
        cells[n, marks] = 0
    else:
        _tetrahedron(cells, e, n, p)
    cells[e, marks + 1] = m
    cells[n, marks + 1] = m
    cells[e, marks + 2] += 1
    cells[n, marks + 2] = cells[e, marks + 2]
    cells[n, marks + 3] = cells[e, marks + 3]


@dataclass(frozen=True, eq=False)
class Refinement:
    """The history of a bisected mesh, as frozen arrays; held by ``mesh.refinement``.

    The corners of such a mesh's elements are in the order of bisection: the edge between the first two is halved next.
    An element that was bisected is a row of the tree.
    """

    parents: np.ndarray  # (n_nodes, 2) int32
    marks: np.ndarray  # (n_elements,) int8: marked edges of tetrahedra, see children; 0 of triangles
    generation: np.ndarray  # (n_elements,) int16: how many bisections lead to the element
    forebear: np.ndarray  # (n_elements,) int32
    tree: np.ndarray  # (n_bisected, dim + 4) int32: corners, marks, forebear and new node of each bisected element

    def __post_init__(self) -> None:
        for one in fields(self):
            getattr(self, one.name).flags.writeable = False

    def __reduce__(self) -> tuple[Any, ...]:
        # by way of __init__: arrays come out of a pickle writable
        return type(self), tuple(getattr(self, one.name) for one in fields(self))


def with_refinement(mesh: MeshArrays, refinement: Refinement | None) -> MeshArrays:
    """The same mesh with another history, its source and soundness kept."""
    result = trusted(mesh, vars(mesh)["source"], mesh.sound)
    object.__setattr__(result, "refinement", refinement)
    return result


def as_initial(mesh: MeshArrays) -> MeshArrays:
    """The mesh with its labels, but without its past: nothing is taken back below it."""
    history = mesh.refinement
    if history is None:
        return mesh
    own = np.repeat(np.arange(mesh.n_nodes, dtype=np.int32), 2).reshape(-1, 2)
    n = len(mesh.elements)
    return with_refinement(mesh, Refinement(own, history.marks, np.zeros(n, np.int16), np.full(n, -1, np.int32),
                                            history.tree[:0].copy()))


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
    """Turn the corners of each element so that its longest edge comes first, and mark the faces of tetrahedra."""
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
    """Write into the cells which boundary facet lies opposite each corner, -1 where there is none."""
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
    """The boundary facets of the cells, in the order of the facets they come from."""
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


_TYPES = {"parents": np.int32, "marks": np.int8, "generation": np.int16, "forebear": np.int32, "tree": np.int32}
# marks of tetrahedra, flagged or not: see adaptmg.mesh.bisection.children
_MOST_MARKS = {2: 0, 3: 17}


def history_arrays(mesh: MeshArrays) -> dict[str, np.ndarray]:
    """The arrays of a mesh's :class:`~adaptmg.mesh.bisection.children.Refinement` by name; empty without one."""
    if mesh.refinement is None:
        return {}
    return {one.name: getattr(mesh.refinement, one.name) for one in fields(Refinement)}


def with_history(mesh: MeshArrays, arrays: Mapping[str, np.ndarray]) -> MeshArrays:
    """A mesh of the same arrays with the history that :func:`history_arrays` took from it."""
    if not arrays:
        return with_refinement(mesh, None)
    missing = [name for name in _TYPES if name not in arrays]
    if missing:
        raise ValueError(f"history: {', '.join(missing)} is missing; it takes {', '.join(_TYPES)}")
    given = {name: _whole(name, arrays[name], dtype) for name, dtype in _TYPES.items()}
    n, elements, bisected = mesh.n_nodes, len(mesh.elements), len(given["tree"])
    shapes = {"parents": (n, 2), "marks": (elements,), "generation": (elements,), "forebear": (elements,),
              "tree": (bisected, columns_of_tree(mesh.dim))}
    for name, shape in shapes.items():
        if given[name].shape != shape:
            raise ValueError(f"history: {name} must have shape {shape}, got {given[name].shape}")
    most, corners, tree = _MOST_MARKS[mesh.dim], mesh.dim + 1, given["tree"]
    for name, values, below in (("parents", given["parents"], np.arange(n)[:, None] + 1),
                                ("marks", given["marks"], most + 1), ("generation", given["generation"], 2**15),
                                ("forebear", given["forebear"] + 1, bisected + 1), ("tree", tree[:, :corners], n),
                                ("tree", tree[:, corners], most + 1), ("tree", tree[:, -1], n),
                                ("tree", tree[:, corners + FOREBEAR] + 1, bisected + 1)):
        if not ((values >= 0) & (values < below)).all():
            raise ValueError(f"history: {name} holds numbers out of range; it is not of this mesh")
    used = given["forebear"][given["forebear"] >= 0]
    if not (mesh.elements[given["forebear"] >= 0] == tree[used, -1][:, None]).any(axis=1).all():
        raise ValueError("history: elements lack the node that bisection made them with; it is not of this mesh")
    return with_refinement(mesh, Refinement(**given))


def _whole(name: str, array: np.ndarray, dtype: type) -> np.ndarray:
    """A copy of an array of integers."""
    array = np.asarray(array)
    if array.dtype.kind not in "iu":
        raise ValueError(f"history: {name} must be an array of integers, got {array.dtype}")
    copy = array.astype(dtype)
    if not (copy == array).all():
        raise ValueError(f"history: {name} holds numbers out of range; it is not of this mesh")
    return copy
