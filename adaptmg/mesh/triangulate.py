r"""triangulated: plane domains meshed by a size field, without Netgen.

Nodes are laid along the edges, the same part of :math:`\int ds / h` apart; h is lowered around
short edges, and where the domain is thinner than edges are long: one good element fits across down
to h / 64. They are triangulated (:mod:`adaptmg.mesh.delaunay`) and opened along cracks
(:mod:`adaptmg.mesh.slits`); chords of arcs that cross other edges are halved, and all is done
again. Inside, nodes follow as long as a triangle's circumcircle is too large for the field: at its
centre, or nearer to the triangle's shortest side, where they make an equilateral triangle with it,
so that good triangles grow from the boundary. Swaps and moves end it.

No step turns a triangle over. With the boundary among their edges they cover the domain once:
positive areas with the right sum are all there is to check. Kernels take points, triangles and
neighbours as in :mod:`adaptmg.mesh.delaunay`, and ``sizes`` at the points."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from adaptmg._numba import inner_kernel, kernel
from adaptmg.geometry.predicates import turn
from adaptmg.mesh.arrays import (
    MeshArrays,
    by_first_occurrence,
    centroids,
    places_of,
    signed_measures,
    sweep_order,
    trusted,
)
from adaptmg.mesh.delaunay import BATCH, Untriangulated, insert, of_boundary, walk
from adaptmg.mesh.improve import improve_triangles
from adaptmg.mesh.sizes import (
    MAX_BISECTIONS,
    MAX_NODES,
    NODES_PER_CELL,
    refuse_too_many,
    unreachable,
)
from adaptmg.mesh.slits import opened
from adaptmg.problem.plane_domains import Domain, Outline
from adaptmg.problem.plane_edges import Arc

# intervals of an edge at first; how often edges that cross are halved
_INTERVALS, _CUTS = 8, 20
# longest edge on an arc, of its radius: with half of it triangles below 20 degrees are 1.6 % in
# place of 1.1 % (200 random outlines of the campaign), with twice of it 2 of them go to Netgen
_MAX_EDGE = 0.4
# circumradius above which a triangle gets a node, over the size: measured on 57 random outlines of
# the campaign, with half 31 % more nodes; with twice the edges of a graded square are too long
_RADIUS = 0.8
# least distance from that node to others, over the size: half changes the nodes by .1 %, with twice
# the edges of a graded square are too long
_APART = 0.6
# no node comes nearer to an edge of the boundary, over its length: half and twice change nothing on
# 57 random outlines; without it a tenth of 584 has angles below 1.6 degrees in place of 1.75
_BESIDE = 0.01
# size at a centroid, over that interpolated there, below which there is a dip: measured on 40 rounded
# shapes with fine places inside, half is as none, 1 makes 6 % more nodes
_DIP = 0.6
# circumradius, over that of the right size, up to which sizes are interpolated: measured on 80 random
# outlines, 1.1 makes 2 % fewer nodes and edges up to 1.3 times as long, twice 13 % more nodes
_COARSE = 1.4
# growth of sizes around short edges and thin parts; measured on 200 random outlines of the campaign:
# with half 23 % more nodes, with twice 1.6 % of the triangles below 20 degrees in place of 1.1 %
_GROWTH = 0.5
# a part is thin where its height is below this part of an edge: with half 1.9 % of those triangles
# are below 20 degrees in place of 1.1 %, with twice .8 % in twice the time
_THIN = 0.35
# the size there over the height: with half 1.7 % are below 20 degrees, with twice 2.6 %
_ACROSS = 1.4
# the size over it at most: with 32 2.1 % are below 20 degrees, with 128 1.0 % and 5 % more nodes
_DEEPEST = 64
# how often nodes are laid: half and twice change the nodes by .4 %
_PASSES = 8
# digits of coordinates that the shortest edge of the boundary must leave: of 200 random outlines,
# of which 67 lie far away, half refuses 6, this 5 and twice 3
_RESOLVED = 1e-4
# eight bytes of 1: hundreds of passes go over triangles that are settled but for a few
_EIGHT_SETTLED = 0x0101010101010101
# rounds of improvement
_ROUNDS = 3


def triangulated(
    domain: Outline, field: Callable[[np.ndarray], np.ndarray], growth: float | None = None
) -> MeshArrays:
    """Return a sound mesh of a plane domain whose edges are about as long as the field (n, 2) ->
    (n,) says. With ``growth`` sizes grow by at most so much per distance, and dips between nodes
    are looked for. The boundaries are called by the numbers of the edges. ValueError for too many
    nodes."""
    field = _beside_short_edges(domain, field)
    middle = 0.5 * (domain.lower + domain.upper)
    # a power of two, by which scaling is exact
    scale = 2.0 ** math.frexp((domain.upper - domain.lower).max())[1]
    # lay nodes along the boundary; again with smaller sizes next to thin parts until there are none
    requested = field
    for _ in range(_PASSES):
        places, facets, labels, elements, across = _first_triangles(
            domain, field, growth, middle, scale
        )
        feet, sizes = _thin_parts(places, elements, across)
        thin = sizes > requested(feet) / _DEEPEST
        if not thin.any():
            break
        field = _beside_thin_parts(field, feet[thin], sizes[thin])
    points, elements, across = _filled(
        domain,
        (places - middle) / scale,
        elements,
        across,
        lambda x: field(middle + scale * x) / scale,
        growth,
    )
    # nodes and triangles that are near each other stand near each other in memory: moves and swaps
    # of 80 000 nodes take .7 of the time that they take in the order of insertion
    order, number, rows, elements = sweep_order(points, elements)
    # new numbers of triangles by the old ones, and at the end -1 for -1, no neighbour
    new_rows = places_of(rows, len(rows) + 1, np.int32)
    points = points[order]
    on_boundary = order < len(places)
    improve_triangles(points, elements, new_rows[across[rows]], on_boundary, _ROUNDS)
    points = middle + scale * points
    # the boundary bit for bit
    points[number[: len(places)]] = places
    facets = number[facets]
    return _mesh(domain, points, elements, facets, labels)


def _first_triangles(
    domain: Outline,
    field: Callable[[np.ndarray], np.ndarray],
    growth: float | None,
    middle: np.ndarray,
    scale: float,
) -> tuple[np.ndarray, ...]:
    """Lay nodes along the edges, with the sizes of ``field``, and triangulate them at (x - ``middle``) /
    ``scale``. Returns the nodes (n, 2), the facets (n, 2) from each to the next, the edge (n,) that each
    facet is a part of, the triangles (m, 3) and their neighbours (m, 3); chords that the triangulation
    does not hold are halved first."""
    fractions = _spaced(domain, field, growth)
    for _ in range(_CUTS):
        nodes_of_edges = _nodes_of_edges(domain, fractions)
        places = np.concatenate(nodes_of_edges)
        # after the last node of an edge follows the vertex that the next one begins with
        counts = np.array([len(nodes) for nodes in nodes_of_edges])
        first = np.cumsum(counts) - counts
        following = np.arange(1, len(places) + 1)
        following[first + counts - 1] = first[domain.following]
        refuse_too_many(len(places), domain)
        shortest = np.linalg.norm(places[following] - places, axis=1).min()
        step = np.spacing(np.abs(places).max())
        if not step < _RESOLVED * shortest:
            raise ValueError(
                f"coordinates of {domain!r} differ by {step:.1g} m at least, edges of the mesh are "
                f"{shortest:.1g} m long; move it nearer to the origin, or take larger sizes"
            )
        facets = np.column_stack([np.arange(len(places)), following])
        labels = np.repeat(np.arange(len(counts)), counts)
        if domain.twins:
            places, facets = _joined(places, facets)
        elements, across, present = of_boundary((places - middle) / scale, facets)
        # triangles on both sides of a crack are not neighbours already, as an edge of the boundary lies between
        # them: opening changes corners alone. A facet whose nodes are both tips stays closed
        if present.all() and domain.twins:
            elements, facets, is_open, origin = opened(elements, facets, len(places))
            return places[origin], facets[is_open], labels[is_open], elements, across
        if present.all():
            return places, facets, labels, elements, across
        # halve the facets of each edge that are missing, and begin again
        present_on_edges = np.split(present, first[1:])
        for i, (t, present_on_edge) in enumerate(zip(fractions, present_on_edges, strict=True)):
            middles = 0.5 * (t + np.append(t[1:], 1.0))
            fractions[i] = np.sort(np.append(t, middles[~present_on_edge]))
    raise Untriangulated(f"edges of {domain!r} are missing")


def _nodes_of_edges(domain: Outline, fractions: list[np.ndarray]) -> list[np.ndarray]:
    """Return the nodes (n, 2) of each edge from its vertex on, at its ``fractions`` (n,), without that of
    the next edge."""
    result = [edge.at(t) for edge, t in zip(domain.edges, fractions, strict=True)]
    for right, left in domain.twins.items():
        # those of the left face of a crack in opposite order, but for the vertex at the beginning
        result[right] = np.roll(result[left][::-1], 1, axis=0)
    for nodes, vertex in zip(result, domain.vertices, strict=True):
        nodes[0] = vertex
    return result


def _joined(places: np.ndarray, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the places (m, 2) without those that come again, as on the faces of cracks, in their order,
    and facets (k, 2) between them."""
    first, number = by_first_occurrence(places, axis=0)
    return places[first], number[facets]


def _thin_parts(
    places: np.ndarray, elements: np.ndarray, across: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find where nodes lie across the domain from facets far longer than it is thick, in triangles
    ``elements`` (m, 3) between ``places`` with the neighbours ``across`` (m, 3), -1 behind the boundary:
    feet (n, 2) of the nodes on these facets, and fitting sizes (n,).

                 c
               . |  .
             .   | height .         part = (foot - a) / (b - a)
           a---foot---------b
    """
    e, k = np.nonzero(across < 0)
    a, b, c = (places[elements[e, (k + i) % 3]] for i in (1, 2, 0))
    along = b - a
    up = c - a
    square = (along * along).sum(axis=1)
    part = (along * up).sum(axis=1) / square
    height = (along[:, 0] * up[:, 1] - along[:, 1] * up[:, 0]) / np.sqrt(square)
    thin = (part > 0) & (part < 1) & (height < _THIN * np.sqrt(square))
    return (a + part[:, None] * along)[thin], _ACROSS * height[thin]


def _beside_thin_parts(
    field: Callable[[np.ndarray], np.ndarray], feet: np.ndarray, sizes: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the field, lowered around the places ``feet`` (n, 2) to given sizes (n,) there."""
    from scipy.spatial import cKDTree  # a first solve without it starts sooner

    tree = cKDTree(feet)

    def lowered(x: np.ndarray) -> np.ndarray:
        away, nearest = tree.query(x)
        return np.minimum(field(x), sizes[nearest] + _GROWTH * away)

    return lowered


def _beside_short_edges(
    domain: Outline, field: Callable[[np.ndarray], np.ndarray]
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the field, lowered around edges that are shorter than it at their middles: triangles at both
    their ends would be flat."""
    sizes = field(np.concatenate([edge.at(np.array([0.5])) for edge in domain.edges]))
    short = [
        (edge, length)
        for edge, length, size in zip(domain.edges, domain.lengths, sizes, strict=True)
        if length < size
    ]

    def lowered(x: np.ndarray) -> np.ndarray:
        return np.min(
            [field(x), *(length + _GROWTH * edge.distance(x) for edge, length in short)], axis=0
        )

    return lowered if short else field


def _spaced(
    domain: Outline,
    field: Callable[[np.ndarray], np.ndarray],
    growth: float | None,
) -> list[np.ndarray]:
    """Return the fractions (n,) of each edge at which its nodes lie, its first end (0) included: the
    integral of ds / h from one to the next is the same, about 1, with the sizes h of ``field`` (points
    (n, 2) to sizes (n,)), whose ``growth`` along an edge is limited if it is given."""
    edges = domain.edges
    lengths = domain.lengths
    # the intervals between fractions ``at`` are halved until each is shorter than the sizes at its ends
    at = [np.linspace(0.0, 1.0, _INTERVALS + 1)] * len(edges)
    for _ in range(MAX_BISECTIONS):
        sizes = np.split(
            field(np.concatenate([edge.at(t) for edge, t in zip(edges, at, strict=True)])),
            np.cumsum([len(t) for t in at])[:-1],
        )
        finer = []
        longs = []
        for i, (edge, t, length) in enumerate(zip(edges, at, lengths, strict=True)):
            if isinstance(edge, Arc):
                sizes[i] = np.minimum(sizes[i], _MAX_EDGE * edge.radius)
            if growth is not None:
                sizes[i] = _limited(sizes[i], growth * length * t)
            long = length * np.diff(t) > np.minimum(sizes[i][1:], sizes[i][:-1])
            longs.append(long)
            finer.append(np.sort(np.append(t, 0.5 * (t[1:] + t[:-1])[long])))
        if not np.concatenate(longs).any():
            break
        refuse_too_many(sum(map(len, finer)), domain)
        at = finer
    else:
        raise unreachable(domain, np.concatenate(longs))
    fractions = []
    for t, h, length in zip(at, sizes, lengths, strict=True):
        # the integral of ds / h up to each fraction, by the trapezoidal rule
        integral = np.append(0.0, np.cumsum(0.5 * length * np.diff(t) * (1 / h[1:] + 1 / h[:-1])))
        n = max(1, round(float(integral[-1])))
        fractions.append(np.interp(np.arange(n) * (integral[-1] / n), integral, t))
    return fractions


def _limited(sizes: np.ndarray, rise: np.ndarray) -> np.ndarray:
    """Return the sizes (n,) along an edge, limited in their growth: min_j h_j + |r_i - r_j| at place i,
    with the ``rise`` r (n,), growth times arc length, ascending."""
    from_before = np.minimum.accumulate(sizes - rise) + rise
    from_behind = np.minimum.accumulate((sizes + rise)[::-1])[::-1] - rise
    return np.minimum(from_before, from_behind)


def _filled(
    domain: Domain,
    places: np.ndarray,
    elements: np.ndarray,
    across: np.ndarray,
    field: Callable[[np.ndarray], np.ndarray],
    growth: float | None,
) -> tuple[np.ndarray, ...]:
    """Put nodes into the triangles ``elements`` (m, 3), with the neighbours ``across`` (m, 3), between the
    nodes ``places`` (n, 2) of a boundary until none is too large for the field. Returns all nodes, the
    triangles and their neighbours.

    A round reads the field at the new nodes, limits the growth of sizes, and puts in nodes with
    interpolated sizes, up to four times as many as there were."""
    # of n nodes the first n_read have sizes of the field, others interpolated ones; tables have room
    # for more rows
    points = places
    n = len(places)
    n_elements = len(elements)
    n_read = 0
    sizes = np.empty(0)
    settled = np.empty(0, dtype=bool)
    while True:
        # sizes are interpolated at new nodes, and read there before there are four times as many
        room = 4 * n
        if len(points) < room:
            points, sizes = (_longer(table, 2 * room) for table in (points, sizes))
            elements, across, settled = (
                _longer(table, n_elements + 4 * room) for table in (elements, across, settled)
            )
        sizes[n_read:n] = field(points[n_read:n])
        dips = np.empty(0)
        if growth is not None:
            # every triangle that is new holds a node that is new
            # by corner: .12 ms for 34 000 triangles, by any(axis=1) .58
            new = np.any([corners >= n_read for corners in elements[:n_elements].T], axis=0)
            dips = np.full(n_elements, np.inf)
            dips[new] = field(centroids(points, elements[:n_elements][new]))
            # sizes come from one node: a path of edges, at most through all nodes
            for _ in range(n):
                if not _limit(points, elements[:n_elements], sizes, growth):
                    break
        cells = _unsettle_new(points, sizes, elements[:n_elements], n_read, settled)
        # triangles between nodes of a fine rim have its sizes, though those inside may be far larger: of
        # many cells they are read there, too
        if n_read > 0 and NODES_PER_CELL[2] * cells > MAX_NODES[2]:
            corners = elements[:n_elements]
            inside = field(centroids(points, corners))
            cells = float(np.sum(signed_measures(points, corners) / inside**2))
            refuse_too_many(NODES_PER_CELL[2] * cells, domain)
        # fill up to four times as many nodes, in batches that Ctrl-C can end
        n_read = n
        for most in range(n_read + BATCH, room + BATCH, BATCH):
            most = min(most, room)
            n, n_elements = _fill(
                points,
                sizes,
                elements,
                across,
                n,
                n_elements,
                most,
                n_read,
                settled,
                settled[: len(settled) // 8 * 8].view(np.uint64),  # eights
                dips,
                np.empty(2),  # place
            )
            if n < most:
                break
        if n == n_read:
            return points[:n], elements[:n_elements], across[:n_elements]


def _longer(table: np.ndarray, rows: int) -> np.ndarray:
    """Return a table (rows, ...) with more rows, which take no memory until they are used."""
    result = np.zeros((rows, *table.shape[1:]), table.dtype)
    result[: len(table)] = table
    return result


def _mesh(
    domain: Outline, points: np.ndarray, elements: np.ndarray, facets: np.ndarray, edge: np.ndarray
) -> MeshArrays:
    """Return the mesh of the triangles ``elements`` (m, 3) between ``points`` (n, 2) with ``facets``
    (n_facets, 2) as arrays, with the boundary "i" of edge i (``edge`` (n_facets,) is that of each
    facet); Untriangulated if a triangle is turned over, or their area is not that inside the
    boundary."""
    mesh = MeshArrays(
        points, elements, facets, edge, tuple(map(str, range(len(domain.boundaries))))
    )
    # the area inside the boundary, of the facets from (x, y) to (u, v)
    (x, y), (u, v) = ((points[nodes] - points[0]).T for nodes in facets.T)
    area = 0.5 * float(np.sum(x * v - y * u))
    if not (mesh.volumes.min() > 0 and abs(mesh.volumes.sum() - area) <= 1e-9 * area):
        raise Untriangulated(f"triangles of {domain!r} are turned over")
    return trusted(mesh)


@kernel
def _limit(points, elements, sizes, growth):
    """Lower sizes that grow by more than ``growth`` per distance along edges, once; returns whether
    there are any."""
    falls = False
    for e in range(len(elements)):
        for k in range(3):
            a = elements[e, k]
            b = elements[e, (k + 1) % 3]
            if sizes[a] > sizes[b]:
                a, b = b, a
            length = np.sqrt(
                (points[a, 0] - points[b, 0]) ** 2 + (points[a, 1] - points[b, 1]) ** 2
            )
            # rises by rounding do not count
            if sizes[b] > (1.0 + 1e-9) * (sizes[a] + growth * length):
                sizes[b] = sizes[a] + growth * length
                falls = True
    return falls


@inner_kernel
def _next_place(points, elements, e, sizes, place):
    """Write into ``place`` (2,) where triangle e gets a node, and return its circumradius: on the
    perpendicular through the middle of its shortest side a b, at the centre of the circle, but at
    most sqrt(3) / 2 h high, where h is the size at that side: of a side of length h this makes an
    equilateral triangle."""
    a = elements[e, 0]
    b = elements[e, 1]
    c = elements[e, 2]
    ab = (points[b, 0] - points[a, 0]) ** 2 + (points[b, 1] - points[a, 1]) ** 2
    bc = (points[c, 0] - points[b, 0]) ** 2 + (points[c, 1] - points[b, 1]) ** 2
    ca = (points[a, 0] - points[c, 0]) ** 2 + (points[a, 1] - points[c, 1]) ** 2
    # the corners are named so that a b becomes the shortest side, in the same sense of rotation
    if bc < ab and bc <= ca:
        a, b, c, ab = b, c, a, bc
    elif ca < ab:
        a, b, c, ab = c, a, b, ca
    x = points[b, 0] - points[a, 0]
    y = points[b, 1] - points[a, 1]
    u = points[c, 0] - points[a, 0]
    v = points[c, 1] - points[a, 1]
    # distance of the circle's centre from the side a b, over the length of this: half of the cotangent of
    # the angle at c, (a - c) . (b - c) / ((a - c) x (b - c))
    away = 0.5 * (u * (u - x) + v * (v - y)) / (x * v - y * u)
    radius = np.sqrt(ab * (0.25 + away * away))
    # the limit of the height: sqrt(3)/2 h, that of the equilateral triangle with side h; over sides
    # longer than 2 h it would leave flat triangles
    h = 0.5 * (sizes[a] + sizes[b])
    if ab < 4.0 * h * h:
        away = min(away, h * np.sqrt(0.75 / ab))
    place[0] = points[a, 0] + 0.5 * x - away * y
    place[1] = points[a, 1] + 0.5 * y + away * x
    return radius


@inner_kernel
def _is_free(points, elements, across, t, p, apart):
    """Return whether node p in triangle t is at least ``apart`` from the corners of t, and not next
    to a side of t that lies on the boundary."""
    x = points[p, 0]
    y = points[p, 1]
    for k in range(3):
        a = elements[t, k]
        b = elements[t, (k + 1) % 3]
        c = elements[t, (k + 2) % 3]
        if (points[a, 0] - x) ** 2 + (points[a, 1] - y) ** 2 < apart * apart:
            return False
        if across[t, k] < 0:
            square = (points[b, 0] - points[c, 0]) ** 2 + (points[b, 1] - points[c, 1]) ** 2
            if turn(points, np.int64(b), np.int64(c), p) < _BESIDE * square:
                return False
    return True


@inner_kernel
def _interpolated(points, elements, t, p, sizes):
    """Return the size at node p in triangle t, by barycentric coordinates from its corners."""
    x = points[p, 0]
    y = points[p, 1]
    total = 0.0
    here = 0.0
    for k in range(3):
        a = elements[t, (k + 1) % 3]
        b = elements[t, (k + 2) % 3]
        weight = (points[a, 0] - x) * (points[b, 1] - y) - (points[a, 1] - y) * (points[b, 0] - x)
        total += weight
        here += weight * sizes[elements[t, k]]
    return here / total


@kernel
def _unsettle_new(points, sizes, elements, n_read, settled):
    """Mark triangles with nodes from ``n_read`` on, whose sizes are new, as not ``settled``. Returns
    the integral of size^-2 over all triangles: the number of squares of that size."""
    cells = 0.0
    for e in range(len(elements)):
        a = elements[e, 0]
        b = elements[e, 1]
        c = elements[e, 2]
        h = (sizes[a] + sizes[b] + sizes[c]) / 3.0
        cells += (
            0.5
            * (
                (points[b, 0] - points[a, 0]) * (points[c, 1] - points[a, 1])
                - (points[b, 1] - points[a, 1]) * (points[c, 0] - points[a, 0])
            )
            / (h * h)
        )
        if a >= n_read or b >= n_read or c >= n_read:
            settled[e] = False
    return cells


@kernel
def _fill(points, sizes, elements, across, n, count, most, n_read, settled, eights, dips, place):
    """Put nodes into triangles that are not ``settled`` and too large until there are none, or
    ``most`` nodes. Sizes at nodes from ``n_read`` on are interpolated; ``eights`` has eight entries of
    ``settled`` in a number, ``dips`` are sizes at centroids, ``place`` (2,) is scratch. Returns the
    numbers of nodes and triangles.

    A triangle is settled while it is small enough, or no node can be put in for it; every triangle that
    changes is not."""
    before = np.int64(-1)
    # each pass but the last adds nodes, and there are ``most``
    while before < n < most:
        before = n
        e = np.int64(0)
        # a step adds a node, settles a triangle, or goes on to the next one
        while e < count and n < most:
            # after a node the same triangle, or what came in its place, is next
            if settled[e]:
                e += 8 if e % 8 == 0 and eights[e // 8] == _EIGHT_SETTLED else 1
                continue
            settled[e] = True
            a = elements[e, 0]
            b = elements[e, 1]
            c = elements[e, 2]
            h = (sizes[a] + sizes[b] + sizes[c]) / 3.0
            is_dip = e < len(dips) and dips[e] < _DIP * h
            if is_dip:
                h = dips[e]
            radius = _next_place(points, elements, e, sizes, place) / (_RADIUS * h)
            # far from the right size what is interpolated is far from the field
            if not radius > 1.0 or (
                radius > _COARSE and (a >= n_read or b >= n_read or c >= n_read)
            ):
                continue
            # the node goes to the centroid, where a dip was read, or to ``place`` in triangle t
            t = e
            for k in range(2):
                centroid = (points[a, k] + points[b, k] + points[c, k]) / 3.0
                points[n, k] = centroid if is_dip else place[k]
            if is_dip:
                dips[e] = np.inf
                sizes[n] = h
            else:
                t = walk(points, elements, across, e, n)
                # where the bounded walk does not arrive the triangle keeps its size
                if t < 0:
                    continue
                # a long triangle's mean size is not that at one of its ends: with it a node in the
                # middle of a disc, which all triangles of the rim meet in, would keep others out
                sizes[n] = _interpolated(points, elements, t, n, sizes)
            if _is_free(points, elements, across, t, n, _APART * sizes[n]):
                more = insert(points, elements, across, count, t, n, settled)
                if more > count:
                    n = n + 1
                    count = more
                    settled[e] = False
    return n, count
