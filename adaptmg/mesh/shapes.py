"""Elements of any shape cut into triangles and tetrahedra that fit across faces; no node is
dropped.

Shapes are called and numbered as in meshio (VTK). An element of second order is cut at its middle
nodes into linear cells. A cell of several sides is a pyramid over each face that its smallest node
is not on; a quadrilateral face is cut through its own smallest node. Both neighbours of a face see
the same numbers, so that their cuts agree, whatever their shapes. Where no neighbour looks, the
shorter diagonal is taken: of quadrilaterals in the plane, and of the octahedron inside a
tetrahedron of second order. A twisted cell of which a part would be turned over gets a node at its
centre."""

from __future__ import annotations

from functools import cache

import numpy as np

Corners = tuple[int, ...]
#: local node numbers of the facets of a shape, with their normals inwards, numbered as Abaqus numbers them from 1
FACETS: dict[str, tuple[Corners, ...]] = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetra": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "pyramid": ((0, 1, 2, 3), (0, 4, 1), (1, 4, 2), (2, 4, 3), (3, 4, 0)),
    "wedge": ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)),
    "hexahedron": (
        (0, 1, 2, 3),
        (4, 7, 6, 5),
        (0, 4, 5, 1),
        (1, 5, 6, 2),
        (2, 6, 7, 3),
        (3, 7, 4, 0),
    ),
}
#: ends of the edges of a shape, in the order of the middle nodes of the second order
_EDGES: dict[str, tuple[tuple[int, int], ...]] = {
    "line": ((0, 1),),
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetra": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "pyramid": ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)),
    "wedge": ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
    "hexahedron": (
        (0, 1),
        (1, 2),
        (2, 3),
        (3, 0),
        (4, 5),
        (5, 6),
        (6, 7),
        (7, 4),
        (0, 4),
        (1, 5),
        (2, 6),
        (3, 7),
    ),
}
#: corners of which the nodes behind those of the edges are the centres
_CENTRES: dict[str, tuple[Corners, ...]] = {
    "quad9": ((0, 1, 2, 3),),
    "pyramid14": ((0, 1, 2, 3),),
    "wedge18": ((0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "hexahedron27": (
        (0, 3, 4, 7),
        (1, 2, 5, 6),
        (0, 1, 4, 5),
        (2, 3, 6, 7),
        (0, 1, 2, 3),
        (4, 5, 6, 7),
        tuple(range(8)),
    ),
}
#: number of corners of each shape
_CORNERS = {
    "vertex": 1,
    "line": 2,
    "triangle": 3,
    "quad": 4,
    "tetra": 4,
    "pyramid": 5,
    "wedge": 6,
    "hexahedron": 8,
}
#: dimension of each shape
DIMENSIONS = {
    "vertex": 0,
    "line": 1,
    "triangle": 2,
    "quad": 2,
    "tetra": 3,
    "pyramid": 3,
    "wedge": 3,
    "hexahedron": 3,
}
#: what messages call cells of each shape
_WORDS = {
    "triangle": "triangles",
    "quad": "quadrilaterals",
    "tetra": "tetrahedra",
    "pyramid": "pyramids",
    "wedge": "wedges",
    "hexahedron": "bricks",
}
#: (shape, number of nodes) of every kind of cell: a kind is a shape with or without nodes of second order
KINDS = {shape: (shape, n) for shape, n in _CORNERS.items()}
KINDS |= {
    f"{shape}{n}": (shape, n)
    for shape, n in (
        ("line", 3),
        ("triangle", 6),
        ("quad", 8),
        ("quad", 9),
        ("tetra", 10),
        ("pyramid", 13),
        ("pyramid", 14),
        ("wedge", 15),
        ("wedge", 18),
        ("hexahedron", 20),
        ("hexahedron", 27),
    )
}


def dimension(kind: str) -> int:
    """Return the dimension of a kind of cell, -1 of one that is not known here."""
    return DIMENSIONS[KINDS[kind][0]] if kind in KINDS else -1


def middles(kind: str) -> tuple[Corners, ...]:
    """Return the corners of which each node of second order is the middle or centre."""
    shape, n = KINDS[kind]
    return () if n == _CORNERS[shape] else _EDGES[shape] + _CENTRES.get(kind, ())


def kind_of(shape: str, n: int) -> str | None:
    """Return the kind with a shape and a number of nodes."""
    return next((kind for kind, known in KINDS.items() if known == (shape, n)), None)


@cache
def facets_of(kind: str) -> tuple[tuple[str, Corners], ...]:
    """Return the kind and local nodes of each facet of a cell."""
    result = []
    for corners in FACETS[KINDS[kind][0]]:
        k = len(corners)
        # its edges, of a line only one; then the nodes: corners, middles of edges, the centre
        ring = list(zip(corners, corners[1:] + corners[:1], strict=True))[: 1 if k == 2 else k]
        local = (*corners, *(node for edge in ring for node in _between(kind, *edge)))
        if k == 4:
            local += _between(kind, *corners)
        result.append((kind_of({2: "line", 3: "triangle", 4: "quad"}[k], len(local)), local))
    return tuple(result)


def _between(kind: str, *corners: int) -> Corners:
    """Return the node halfway between corners of an edge, a diagonal or a face (as a tuple of one), if
    the kind has one, else an empty tuple."""
    shape, _ = KINDS[kind]
    nodes = [
        _CORNERS[shape] + i for i, ends in enumerate(middles(kind)) if set(corners) <= set(ends)
    ]
    # the first one: `middles` has edges before the faces, and faces before the whole cell, that contain the
    # same corners
    return tuple(nodes[:1])


def _middle(kind: str, first: int, second: int) -> int:
    """Return the node halfway between two corners, which is there, or the only one."""
    return first if first == second else _between(kind, first, second)[0]


#: the linear cells that a kind of cell is cut into, each as (facets, nodes): ``nodes`` are the corners of the
#: linear cell as local nodes of the kind, and ``facets`` are its facets as places in ``nodes``: those of its
#: shape in FACETS, except for :func:`_core`
Parts = list[tuple[tuple[Corners, ...], Corners]]


@cache
def _parts(kind: str) -> Parts:
    """Return the linear cells that a kind is cut into."""
    shape, n = KINDS[kind]
    if n == _CORNERS[shape]:
        return [(FACETS.get(shape, ()), tuple(range(n)))]
    if shape == "line" or kind in _CENTRES:
        return _halved(kind)
    return [*_cut_corners(kind), _core(kind)]


def _halved(kind: str) -> Parts:
    """Return cells of the same shape and half the size, one at each corner, and those between
    them."""
    shape, _ = KINDS[kind]
    corners = range(_CORNERS[shape])
    facets = FACETS.get(shape, ())
    # the cell at the tip of a pyramid follows below: its base lies on middle nodes, not on the base
    with_cell = corners[:4] if shape == "pyramid" else corners
    result = [(facets, tuple(_middle(kind, a, b) for b in corners)) for a in with_cell]
    if shape == "wedge":
        # between the middle nodes of the triangles (6 to 8, 9 to 11) and the centres of the
        # quadrilaterals (15 to 17)
        result += [(facets, nodes) for nodes in ((6, 7, 8, 15, 16, 17), (15, 16, 17, 9, 10, 11))]
    if shape == "pyramid":
        # one at the tip, one upside down on the centre of the base (13), and a tetrahedron at each
        # edge of the base
        result += [(facets, nodes) for nodes in ((9, 10, 11, 12, 4), (12, 11, 10, 9, 13))]
        result += [(FACETS["tetra"], (5 + i, 13, 9 + i, 9 + (i + 1) % 4)) for i in range(4)]
    return result


def _cut_corners(kind: str) -> Parts:
    """Return the cells that the middle nodes of the edges cut off, one at each corner."""
    shape, _ = KINDS[kind]
    result = []
    for corner in range(_CORNERS[shape]):
        # the normal of the ring, by the right-hand rule, points away from the corner, as that of the
        # nodes 1, 2, 3 of a tetrahedron from node 0. That of the base of a pyramid points to its tip,
        # the last node: the ring is reversed
        ring = _around(kind, corner)
        if len(ring) == 4:
            result.append((FACETS["pyramid"], (*ring[::-1], corner)))
        else:
            result.append((FACETS["triangle" if len(ring) == 2 else "tetra"], (corner, *ring)))
    return result


def _core(kind: str) -> tuple[tuple[Corners, ...], Corners]:
    """Return the cell between the middle nodes of the edges, of kinds that have no other nodes between
    their corners: its facets, as places among its nodes, and its nodes, as local nodes of the kind."""
    shape, n = KINDS[kind]
    n_corners = _CORNERS[shape]
    inner = tuple(range(n_corners, n))
    if DIMENSIONS[shape] == 2:
        return FACETS[shape], inner
    # a face where each corner was cut off, and one in each facet, between its middle nodes
    faces = [_around(kind, corner) for corner in range(n_corners)]
    faces += [tuple(node for node in local if node >= n_corners) for _, local in facets_of(kind)]
    return tuple(tuple(node - n_corners for node in face) for face in faces), inner


def _around(kind: str, corner: int) -> Corners:
    """Return the middle nodes of the edges at a corner, one after the other: in space clockwise, seen
    from the corner; in the plane two, which make a counter-clockwise triangle (corner, first, second)."""
    shape = KINDS[kind][0]
    # each face at the corner leads from the middle of one of its edges to that of the other
    steps = {}
    for face in FACETS[shape] if DIMENSIONS[shape] == 3 else (tuple(range(_CORNERS[shape])),):
        if corner in face:
            at = face.index(corner)
            steps[_middle(kind, corner, face[(at + 1) % len(face)])] = _middle(
                kind, corner, face[at - 1]
            )
    # in the plane the only step, in space steps that close a ring, which begins with its lowest node
    ring = [min(steps)]
    while steps.get(ring[-1], ring[0]) != ring[0]:
        ring.append(steps[ring[-1]])
    return tuple(ring)


def simplices(
    kind: str, nodes: np.ndarray, points: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the simplices that cells ``nodes`` (n, k) of a kind are cut into, oriented as these,
    and the cell that each comes from. With ``points`` (of elements) the shorter diagonals are
    taken, without (of boundary facets) those through the smallest nodes. Simplices that have a node
    twice, as collapsed cells leave them, are dropped."""
    cells = []
    owners = []
    for facets, local in _parts(kind):
        part = nodes[:, local]
        if facets == FACETS["quad"]:
            # turned, then cut through its first node
            start = part.argmin(axis=1)
            if points is not None:
                start = _shorter(part, points, ((0, 2), (1, 3)))
            turned = _turned_rings(part, start)
            cells += [turned[:, :3], turned[:, [0, 2, 3]]]
            owners += [np.arange(len(part))] * 2
        elif len(local) <= 4:  # a simplex
            cells.append(part)
            owners.append(np.arange(len(part)))
        else:
            cones, cone_owners = _cones(facets, part, _apex(kind, part, points))
            cells += cones
            owners += cone_owners
    result = np.concatenate(cells)
    owner = np.concatenate(owners)
    order = np.sort(result, axis=1)
    whole = (order[:, 1:] != order[:, :-1]).all(axis=1)
    return result[whole], owner[whole]


def around_centres(kind: str, nodes: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Return tetrahedra (m, 4) between facets of cells ``nodes`` (n, k) and new nodes ``first``, ... at their
    centres, and the cell of each (m,)."""
    parts = [simplices(facet_kind, nodes[:, local]) for facet_kind, local in facets_of(kind)]
    owner = np.concatenate([cell_of for _, cell_of in parts])
    return np.column_stack([np.concatenate([found for found, _ in parts]), first + owner]), owner


def _apex(kind: str, part: np.ndarray, points: np.ndarray | None) -> np.ndarray:
    """Return the local node (n,) of each cell ``part`` (n, k) that its pyramids meet in: its smallest node,
    or in tetrahedra of second order with ``points`` one at the shortest diagonal of the octahedron."""
    if KINDS[kind] == ("tetra", 10) and points is not None:
        return _shorter(part, points, ((0, 5), (1, 3), (2, 4)))
    return part.argmin(axis=1)


def _shorter(
    part: np.ndarray, points: np.ndarray, pairs: tuple[tuple[int, int], ...]
) -> np.ndarray:
    """Return the first end (n,) of the shortest of some diagonals, ``pairs`` of local nodes, of each cell
    ``part`` (n, k)."""
    lengths = [np.square(points[part[:, a]] - points[part[:, b]]).sum(axis=1) for a, b in pairs]
    return np.array([a for a, _ in pairs])[np.argmin(lengths, axis=0)]


def _turned_rings(ring: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return the nodes ``ring`` (n, k), turned so that each row begins at its place ``start`` (n,)."""
    return np.take_along_axis(
        ring, (start[:, None] + np.arange(ring.shape[1])) % ring.shape[1], axis=1
    )


def _cones(facets: tuple[Corners, ...], part: np.ndarray, apex: np.ndarray) -> tuple[list, list]:
    """Return tetrahedra from the apex (n,), a local node of each cell ``part`` (n, k), to the
    facets that do not hold it, and the rows of the cells that they come from."""
    cells = []
    rows = []
    for top in np.unique(apex):
        cells_of_apex = np.flatnonzero(apex == top)
        for facet in facets:
            if top in facet:
                continue
            base = part[cells_of_apex][:, facet]
            triangles = [base]
            if len(facet) == 4:
                turned = _turned_rings(base, base.argmin(axis=1))
                triangles = [turned[:, :3], turned[:, [0, 2, 3]]]
            for triangle in triangles:
                cells.append(np.column_stack([triangle, part[cells_of_apex, top]]))
                rows.append(cells_of_apex)
    return cells, rows


def cut_note(kind: str, counts: np.ndarray) -> str:
    """Return how the cells of a kind were cut into ``counts`` (n_cells,) simplices, '12 8-node bricks: each
    split into 6 tetrahedra'; "" for simplices, which stay whole."""
    shape, n = KINDS[kind]
    if kind in ("triangle", "tetra"):
        return ""
    least = int(counts.min())
    most = int(counts.max())
    into = "triangles" if DIMENSIONS[shape] == 2 else "tetrahedra"
    number = least if least == most else f"{least} to {most}"
    return f"{len(counts)} {n}-node {_WORDS[shape]}: each split into {number} {into}"
