r"""bisect, refine_near, refined: nested refinement by bisection of marked elements.

The edge between the first two corners of an element is halved at a new node p, the last corner of
both children. Marked elements are bisected once, or until all their edges are halved (four
triangles; at least eight tetrahedra), then all that have a halved edge, until none has one. That
ends from any conforming mesh: triangles, because only edges of the mesh before are halved;
tetrahedra, because a face is marked alike from both its sides. On curved boundaries new nodes lie
on the chord; :func:`adaptmg.mesh.onto_domain` moves them onto the curve.

Triangles (a, b, c), newest-vertex bisection: children (c, a, p) and (b, c, p).

Tetrahedra, after D. N. Arnold, A. Mukherjee, L. Pouly (SIAM J. Sci. Comput. 22, 2000,
doi:10.1137/S1064827597323373). Of each face one edge is marked; of the two that hold the halved
edge it is that edge, the other two are (1, 2, 3) and (0, 2, 3), whose marks are coded 0, 1, 2: to
corner 2, to corner 3, the edge (2, 3). A child's edge to be halved next is the mark of the face it
inherits; the cut faces are marked opposite p, the new face (p, 2, 3) too, unless all marks of the
parent lie in one plane and it is flagged: then from p to the next edge. Children of an unflagged
plane one are flagged. From any tetrahedron this makes a bounded number of similarity classes.

First labels: the longest edge goes first, of a face as of an element; among edges of one length
that with the highest node numbers. This is one order of all edges of a mesh.

Elements are rows of 32 bit integers: corners, the boundary facet opposite each (-1: none), marks
(of both faces, and the flag), generation (bisections since the initial mesh), origin (the element
of the mesh before); kernels call the table of rows ``cells``, and the number of corners ``corners``.
Halved edges are found through lists, one for each node: ``nodes[i, HEAD]`` is the first node that
halves an edge from i to a lower number, ``nodes[p, NEXT]`` the next one; ``nodes[p, LOW]`` and
``nodes[p, HIGH]`` are the ends of the edge that p halves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptmg import _checks as checks
from adaptmg._numba import inner_kernel, kernel
from adaptmg.mesh.arrays import (
    OPPOSITE,
    MeshArrays,
    Refinement,
    element_facets,
    facet_keys,
    initial_elements,
    mask_of,
    parents_of,
    sound_by_construction,
    trusted,
)
from adaptmg.mesh.sizes import MAX_NODES
from adaptmg.mesh.soundness import check_mesh

__all__ = ["bisect", "check_marked", "refine_near"]

# the column of marks: 3 times the mark of the face (1, 2, 3), plus that of (0, 2, 3), each of which is
# 0, 1 or 2; and _FLAG where the element is flagged. Flagged elements whose marks lie in one plane are
# type P_f of Arnold, Mukherjee and Pouly, unflagged ones P_u
_FLAG = 9
# columns of the nodes: first and next of the list of edges, and both ends of the edge that a node
# halves
_HEAD, _NEXT, _LOW, _HIGH = range(4)
#: by number of corners and of the child, and by the mark of the face that it inherits: which corners of the parent
#: become its corners 0, 1, ... The marked edge comes first, since the edge of corners 0 and 1 is halved next. p stands
#: in place of corner 1 of the parent in child 0, of corner 0 in child 1, and is the last corner of both
_ORDERS = {
    3: np.array([[[2, 0, 1]], [[1, 2, 0]]]),
    4: np.array(
        [[[0, 2, 3, 1], [3, 0, 2, 1], [2, 3, 0, 1]], [[2, 1, 3, 0], [1, 3, 2, 0], [3, 2, 1, 0]]]
    ),
}
#: by child and mark as above, for children of an element of type P_f: what is added to the marks so that the mark of
#: the new face is the edge from p to its other end on the next edge to be halved. That edge goes to corner 3, code 1:
#: 3 where the new face is the face (1, 2, 3) of the child, 1 where it is (0, 2, 3). Marks 2 are in no plane
_NEW_MARK = np.array([[3, 1, 0], [1, 3, 0]])
#: by number of corners: pairs of them, and for each as the longest edge an even order of the corners beginning with it
_PAIRS = {
    3: np.array([[0, 1], [0, 2], [1, 2]]),
    4: np.array([[0, 1], [0, 2], [1, 2], [0, 3], [1, 3], [2, 3]]),
}
_TURNS = {
    3: np.array([[0, 1, 2], [2, 0, 1], [1, 2, 0]]),
    4: np.array(
        [[0, 1, 2, 3], [0, 2, 3, 1], [1, 2, 0, 3], [0, 3, 1, 2], [1, 3, 2, 0], [2, 3, 0, 1]]
    ),
}


def bisect(
    mesh: MeshArrays, marked: np.ndarray, passes: int | None = None
) -> tuple[MeshArrays, np.ndarray]:
    """Refine the marked elements.

    Parameters
    ----------
    mesh : MeshArrays
        Not changed.
    marked : (n_elements,) array of bool
        The elements to refine; at least one.
    passes : int, optional
        How often the marked elements are bisected, >= 1: once gives two of each, and adds fewest
        nodes. By default until all their edges are halved.

    Returns
    -------
    fine : MeshArrays
        Nested in ``mesh``; the old nodes come first and keep their numbers, names and bodies stay.
        It carries its history (``fine.refinement``), by which further bisection goes on.
    parents : (n_fine_nodes, 2) array of int
        Node i of ``fine`` is the midpoint of nodes ``parents[i]``, both below i (they may be new
        nodes themselves); of an old node both are i.

    Raises
    ------
    TypeError, ValueError
        If ``marked`` is not a mask over the elements, or marks none; if ``passes`` is not an
        integer >= 1.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> fine, parents = am.mesh.bisect(mesh, np.arange(len(mesh.elements)) < 2)
    >>> fine.n_nodes > mesh.n_nodes
    True
    """
    marked = check_marked(check_mesh(mesh), marked)
    if not marked.any():
        raise ValueError("marked marks no element: nothing to refine")
    fine = refined(
        mesh, marked, None if passes is None else checks.integer("passes", passes, 1)
    ).mesh
    parents = parents_of(fine).astype(np.int64)
    parents[: mesh.n_nodes] = np.arange(mesh.n_nodes)[:, None]
    return fine, parents


def check_marked(mesh: MeshArrays, marked: np.ndarray) -> np.ndarray:
    """Return ``marked`` as an array (n_elements,); TypeError or ValueError unless it is a boolean mask
    over the elements."""
    marked = np.asarray(marked)
    if marked.dtype != bool:
        raise TypeError(f"marked must be a boolean mask over the elements, got {marked.dtype}")
    if marked.shape != (len(mesh.elements),):
        raise ValueError(f"marked must have shape ({len(mesh.elements)},), got {marked.shape}")
    return marked


def refine_near(
    mesh: MeshArrays, boundaries: str | Sequence[str], levels: int = 1
) -> list[MeshArrays]:
    """Refine the elements that touch some boundaries, again and again.

    Parameters
    ----------
    mesh : MeshArrays
        The coarsest mesh.
    boundaries : str or sequence of str
        Elements with a node on one of these are marked; of several bodies the names are
        "body.edge".
    levels : int
        How many times, >= 1.

    Returns
    -------
    list of MeshArrays
        ``levels + 1`` nested meshes, coarse to fine, the first being ``mesh`` itself.

    Raises
    ------
    ValueError
        On an unknown boundary, ``levels`` < 1, or where more than 5 million nodes (3D: 2 million)
        are expected: each level doubles the elements at the boundaries (3D: four times).

    Notes
    -----
    Elsewhere the mesh stays what it was: so does its part of the discretisation error.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> len(am.mesh.refine_near(mesh, "bottom", levels=2))
    3
    """
    levels = checks.integer("levels", levels, 1)
    names = (
        (boundaries,) if isinstance(boundaries, str) else checks.strings("boundaries", boundaries)
    )
    if not names:
        raise ValueError("boundaries must name at least one boundary")
    meshes = [check_mesh(mesh, names)]
    facets = sum(len(mesh.boundary_facets(name)) for name in names)
    # each facet is cut in 2 (3D: 4) a level. There are at least one (3D: two) new nodes for each of the facets
    # then: 4.7 after 4 levels on a square, 2.3 after 3 on a cube. The exponent is limited against overflow
    expected = facets * (mesh.dim - 1) * 2.0 ** min((mesh.dim - 1) * levels, 1000)
    if mesh.n_nodes + expected > MAX_NODES[mesh.dim]:
        raise ValueError(
            f"levels: {levels} bisections along {facets} facets of {', '.join(names)} ask for about "
            f"{mesh.n_nodes + expected:.1g} nodes (at most {MAX_NODES[mesh.dim]:.0e}); take fewer levels"
        )
    for _ in range(levels):
        meshes.append(bisect(meshes[-1], _touching(meshes[-1], names))[0])
    return meshes


def _touching(mesh: MeshArrays, names: Sequence[str]) -> np.ndarray:
    """Return the mask of the elements with a node on one of some boundaries."""
    facets = np.concatenate([mesh.boundary_facets(name) for name in names])
    return np.any(mask_of(facets, mesh.n_nodes)[mesh.elements], axis=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """A mesh made from another one by bisection."""

    mesh: MeshArrays  # trusted, with its history
    origin: np.ndarray  # (n_elements,) int: the element of the mesh before that holds each element


def refined(mesh: MeshArrays, marked: np.ndarray, passes: int | None = None) -> Refined:
    """Bisect the marked elements (n_elements,) until all their edges are halved; with ``passes``,
    until each element made from them is at least that number of generations younger."""
    if passes is None:
        return _once(mesh, marked, every_edge=True)
    result = _once(mesh, marked, every_edge=False)
    generation = _generations(mesh)
    # conformity may have bisected some elements of a pass several times
    for _ in range(passes - 1):
        is_older = _generations(result.mesh) - generation[result.origin] < passes
        rest = marked[result.origin] & is_older
        if not rest.any():
            break
        following = _once(result.mesh, rest, every_edge=False)
        result = Refined(mesh=following.mesh, origin=result.origin[following.origin])
    return result


def _once(mesh: MeshArrays, marked: np.ndarray, every_edge: bool) -> Refined:
    """Bisect the marked elements once, or (``every_edge``) until all their edges are halved, and
    what conformity asks for."""
    n, corners = mesh.elements.shape
    sizes = np.array([n, mesh.n_nodes])
    n_cells = -1
    # estimate of new elements over elements, and of new nodes over nodes: an element that is refined
    # gives up to 2^dim, or 2, and conformity refines as many others as are marked
    children = 2.0**mesh.dim if every_edge else 2.0
    growth = min(1.0, 2.0 * np.count_nonzero(marked) / n) * children
    while n_cells < 0:  # the tables were too short: again with longer ones
        spare_cells, spare_nodes = (growth * sizes).astype(int) + 16
        cells = np.empty((n + spare_cells, 2 * corners + 3), dtype=np.int32)
        _write_rows(mesh, cells[:n])
        nodes = np.full((mesh.n_nodes + spare_nodes, 4), -1, dtype=np.int32)
        n_cells, n_nodes = _bisected(
            cells,
            n,
            corners,
            nodes,
            mesh.n_nodes,
            marked,
            every_edge,
            _ORDERS[corners],
            _NEW_MARK,
            np.empty(cells.shape[1], dtype=np.int64),  # scratch
        )
        growth = 2 * growth + 0.5
    points = np.empty((n_nodes, mesh.dim))
    points[: mesh.n_nodes] = mesh.points
    _halfway(points, mesh.n_nodes, nodes)
    parents = np.concatenate([parents_of(mesh), nodes[mesh.n_nodes : n_nodes, [_LOW, _HIGH]]])
    # in the order of the elements they come from: neighbours stay near
    cells = cells.take(np.argsort(cells[:n_cells, -1], kind="stable"), axis=0)
    return Refined(mesh=_mesh_of(mesh, points, parents, cells), origin=cells[:, -1].copy())


def _generations(mesh: MeshArrays) -> np.ndarray:
    """Return how many bisections (n_elements,) since the initial mesh lead to each element."""
    if mesh.refinement is not None:
        return mesh.refinement.generation
    return np.zeros(len(mesh.elements), dtype=np.int16)


def _write_rows(mesh: MeshArrays, rows: np.ndarray) -> None:
    """Write the elements as rows of bisection (module docstring); those of a mesh that was never
    bisected get their first labels."""
    n, corners = mesh.elements.shape
    cells = mesh.elements
    sides = _sides(mesh)
    if mesh.refinement is None:
        # corners in an even order that begins with the longest edge
        turn = _TURNS[corners][_longest(mesh.points, cells)]
        cells = np.take_along_axis(cells, turn, axis=1)
        sides = np.take_along_axis(sides, turn, axis=1)
        marks = np.zeros(n, dtype=np.int32)
        if corners == 4:
            # 3 times the mark of the face (1, 2, 3), plus that of (0, 2, 3)
            marks = 3 * _longest(mesh.points, cells[:, 1:]) + _longest(
                mesh.points, cells[:, [0, 2, 3]]
            )
    else:
        marks = mesh.refinement.marks
    rows[:, :corners] = cells
    rows[:, corners : 2 * corners] = sides
    rows[:, -3] = marks
    rows[:, -2] = _generations(mesh)
    rows[:, -1] = np.arange(n)


def _sides(mesh: MeshArrays) -> np.ndarray:
    """Return the number of the boundary facet opposite each corner of each element (n_elements, dim
    + 1), -1 where there is none."""
    on_boundary = np.zeros(mesh.n_nodes, dtype=np.int8)  # 1 where a node is on it
    on_boundary[mesh.facets] = 1
    result = np.full(mesh.elements.shape, -1, dtype=np.int32)
    # only elements with as many boundary nodes as a facet has can have one
    near = np.flatnonzero(sum(on_boundary[nodes] for nodes in mesh.elements.T) >= mesh.dim)
    keys = facet_keys(mesh.facets, mesh.n_nodes)
    order = np.argsort(keys)
    side_keys = facet_keys(element_facets(mesh.elements[near]).reshape(-1, mesh.dim), mesh.n_nodes)
    # the facet with the same key, if there is one; keys above all come out as the last
    facet = order[np.minimum(np.searchsorted(keys[order], side_keys), len(keys) - 1)]
    result[near] = np.where(keys[facet] == side_keys, facet, -1).reshape(len(near), -1)
    return result


def _longest(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return which pair of corners (n,), a row of ``_PAIRS``, is the longest edge of each of ``cells``
    (n, 3 or 4) between ``points`` (n_nodes, dim); of edges of one length that with the higher node numbers."""
    ends = cells[:, _PAIRS[cells.shape[1]]]
    low = ends.min(axis=2)
    high = ends.max(axis=2)
    # lengths are added up alike from both sides of a face
    squared_lengths = sum(np.square(x[low] - x[high]) for x in points.T)
    # lexsort takes the first key last: by length, then by the higher and by the lower node
    return np.lexsort((low, high, squared_lengths), axis=1)[:, -1]


def _mesh_of(
    before: MeshArrays, points: np.ndarray, parents: np.ndarray, cells: np.ndarray
) -> MeshArrays:
    """Return the mesh that rows of bisection (``cells``, module docstring) hold, with the points
    (n_nodes, dim) and their parents (n_nodes, 2), and the boundaries and bodies of the mesh they
    come from."""
    k = before.dim + 1
    elements, old_facets, marks, generation, origin = np.split(
        cells, [k, 2 * k, 2 * k + 1, 2 * k + 2], axis=1
    )
    # a facet for each side that is a part of a facet of the mesh before, in the order of these
    row, side = np.divmod(np.flatnonzero(old_facets >= 0), k)
    old_facet = old_facets[row, side]
    order = np.argsort(old_facet, kind="stable")
    facets = elements[row[order, None], OPPOSITE[before.dim][side[order]]]
    mesh = MeshArrays(
        points,
        elements,
        facets,
        before.facet_labels[old_facet[order]],
        before.boundaries,
        before.element_body[origin[:, 0]],
        before.bodies,
    )
    history = Refinement(
        parents,
        marks[:, 0].astype(np.int8),
        generation[:, 0].astype(np.int16),
        initial_elements(before),
    )
    return with_refinement(sound_by_construction(mesh), history)


def with_refinement(mesh: MeshArrays, refinement: Refinement | None) -> MeshArrays:
    """Return a mesh with the nodes and elements of another one, as sound as that, and this history
    of bisections."""
    result = trusted(mesh, mesh.sound)
    object.__setattr__(result, "refinement", refinement)
    return result


@inner_kernel
def _midpoint_of(nodes, a, b):
    """Return the node that halves the edge (a, b), -1 if it is not halved."""
    low, high = (a, b) if a < b else (b, a)
    p = nodes[high, _HEAD]
    while p >= 0 and nodes[p, _LOW] != low:  # what follows in a list was entered before
        p = nodes[p, _NEXT]
    return p


@inner_kernel
def _halve(nodes, n_nodes, a, b):
    """Return the node that halves the edge (a, b), and the number of nodes; a new one is entered in
    the next row, and put first into the list of the higher end."""
    p = np.int64(_midpoint_of(nodes, a, b))
    if p < 0:
        p = n_nodes
        low, high = (a, b) if a < b else (b, a)
        nodes[p, _LOW] = low
        nodes[p, _HIGH] = high
        nodes[p, _NEXT] = nodes[high, _HEAD]
        nodes[high, _HEAD] = p
        n_nodes += 1
    return p, n_nodes


@inner_kernel
def _has_halved_edge(cells, e, corners, nodes):
    """Return whether a node halves an edge of element e, which has this number of ``corners``."""
    for i in range(1, corners):
        for j in range(i):
            if _midpoint_of(nodes, cells[e, i], cells[e, j]) >= 0:
                return True
    return False


@inner_kernel
def _write_children(cells, e, n, corners, p, orders, new_mark, old):
    """Bisect element e at node p, the middle of its corners 0 and 1; ``old`` is scratch for its row,
    whose columns the module names, ``orders`` and ``new_mark`` are the tables above.

    Child 0 goes to row e, with p in place of corner 1; child 1 to row n, with p in place of corner
    0. The face between them lies opposite corner 0 in the first, corner 1 in the other. Child 0
    inherits the face (0, 2, 3) and its mark, child 1 the face (1, 2, 3)."""
    for k in range(len(old)):
        old[k] = cells[e, k]
    flagged = old[2 * corners] >= _FLAG
    marks = old[2 * corners] - _FLAG if flagged else old[2 * corners]
    # the marked edges of two faces, 0: to corner 2, 1: to corner 3, 2: the edge (2, 3)
    mark_of_123 = marks // 3
    mark_of_023 = marks % 3
    # both go to the same corner, 2 or 3: they lie in one plane with the halved edge
    plane = corners == 4 and mark_of_123 == mark_of_023 and mark_of_123 < 2
    for child in range(2):
        row = n if child else e
        mark = mark_of_123 if child else mark_of_023
        for j in range(corners):
            k = orders[child, mark, j]
            cells[row, j] = p if k == 1 - child else old[k]
            cells[row, corners + j] = -1 if k == child else old[corners + k]
        # the marks of the child (algorithm BisectTet of Arnold, Mukherjee and Pouly). Its faces (1, 2,
        # 3) and (0, 2, 3) are a half of a cut face and the new face; its corner 3 is p. Code 0 marks in
        # both the edge to corner 2, which lies opposite p. Only where the parent has type P_f the new
        # face is marked from p to the edge of corners 0 and 1, which is halved next
        marked = new_mark[child, mark] if plane and flagged else 0
        # children of an element of type P_u are flagged
        cells[row, 2 * corners] = marked + (_FLAG if plane and not flagged else 0)
        # generation and origin
        cells[row, 2 * corners + 1] = old[2 * corners + 1] + 1
        cells[row, 2 * corners + 2] = old[2 * corners + 2]


@kernel
def _bisected(cells, n_cells, corners, nodes, n_nodes, marked, every_edge, orders, new_mark, old):
    """Bisect the first ``n_cells`` rows that are ``marked`` once, or until ``every_edge`` is halved, and
    what conformity asks for, in tables of which ``n_cells`` and ``n_nodes`` rows are in use; returns these
    numbers, -1 where the tables have too few rows. ``orders``, ``new_mark`` and ``old`` are those of
    :func:`_write_children`."""
    # first halve the edge of corners 0 and 1 of marked elements, or all their edges
    most = corners if every_edge else 2
    for e in range(n_cells):
        if not marked[e]:
            continue
        for i in range(1, most):
            for j in range(i):
                if n_nodes == len(nodes):
                    return -1, -1
                _, n_nodes = _halve(nodes, n_nodes, cells[e, i], cells[e, j])
    before = 0
    # a round in which no edge is halved is the last: closures of these bisections are finite
    # (Maubach, 1995)
    while n_nodes > before:
        before = n_nodes
        e = 0
        # child 0 stays in row e, which is bisected until it has no halved edge; child 1 goes to the
        # last row, and has its turn later
        while e < n_cells:
            while _has_halved_edge(cells, e, corners, nodes):  # each bisection takes up a row
                if n_cells == len(cells) or n_nodes == len(nodes):
                    return -1, -1
                p, n_nodes = _halve(nodes, n_nodes, cells[e, 0], cells[e, 1])
                _write_children(cells, e, n_cells, corners, p, orders, new_mark, old)
                n_cells += 1
            e += 1
    return n_cells, n_nodes


@kernel
def _halfway(points, n_old, nodes):
    """Move the nodes from ``n_old`` on halfway between their parents, in ``points``."""
    for p in range(n_old, len(points)):
        a = nodes[p, _LOW]
        b = nodes[p, _HIGH]
        for k in range(points.shape[1]):
            points[p, k] = 0.5 * (points[a, k] + points[b, k])
