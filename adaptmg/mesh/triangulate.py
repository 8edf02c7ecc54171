r"""triangulated: plane domains meshed by a size field, without Netgen.

Nodes are laid along the edges, the same part of :math:`\int ds / h` apart; h is lowered around short edges. Put one by
one into the two triangles of a box around the domain, with swaps of edges (C. L. Lawson, 1977), they give a Delaunay
triangulation. Where it lacks an edge of the boundary, that edge is cut in the middle, and all is done again; triangles
outside are dropped. Inside, nodes follow as long as a triangle's circumcircle is too large for the field: at its
centre, or nearer to the triangle's shortest side, where they make an equilateral triangle with it, so that good
triangles grow from the boundary. Swaps and moves end it.

Triangles and their neighbours are a closed table from the first to the last step, and no step turns a triangle over.
With the boundary among their edges they cover the domain once: positive areas with the right sum are all there is to
check.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from adaptmg._numba import inner_kernel, kernel
from adaptmg.mesh.arrays import MeshArrays, trusted
from adaptmg.mesh.improve import improved_triangles, replace_neighbour, swap_edge
from adaptmg.mesh.netgen_plane import MAX_BISECTIONS, NODES_PER_CELL, refuse_too_many, unreachable
from adaptmg.problem.plane_domains import Arc, Domain, Outline, Polygon, Rectangle

Plane = Rectangle | Polygon | Outline

# intervals of an edge at first; how often edges that are missing are cut
_INTERVALS, _CUTS = 8, 20
# longest edge on an arc, of its radius
_MAX_EDGE = 0.4
# circumradius above which a triangle gets a node, over the size; least distance from that node to others
_RADIUS, _APART = 0.8, 0.6
# a node lies on an edge when it is this near to it, over the length of the edge
_ON_EDGE = 1e-9
# size at a centroid, over that interpolated there, below which there is a dip
_DIP = 0.6
# circumradius, over that of the right size, up to which sizes are interpolated
_COARSE = 1.4
# an edge is short below this part of the size there; growth of sizes around it
_SHORT, _GROWTH = 0.7, 0.5
# rounds of improvement
_ROUNDS = 3


class Untriangulated(ValueError):
    """A domain whose boundary the triangulation does not hold."""


def triangulated(domain: Plane, field: Callable[[np.ndarray], np.ndarray], growth: float | None = None) -> MeshArrays:
    """A sound mesh of a plane domain whose edges are about as long as the field (n, 2) -> (n,) says. With ``growth``
    sizes grow by at most so much per distance, and dips between nodes are looked for. The boundaries of an outline are
    called by the numbers of its edges. ValueError for too many nodes."""
    outline = domain if isinstance(domain, Outline) else Outline(vertices=domain.polygon.vertices,
                                                                 boundaries=domain.boundaries)
    edges = [outline.edge(i) for i in range(len(outline.vertices))]
    field = _beside_short_edges(edges, outline.lengths, field)
    fractions = _spaced(domain, edges, outline.lengths, field, growth)
    for _ in range(_CUTS):
        places = np.concatenate([edge.at(t) for edge, t in zip(edges, fractions, strict=True)])
        counts = np.array([len(t) for t in fractions])
        first = np.cumsum(counts) - counts
        places[first] = outline.vertices
        following = np.arange(1, len(places) + 1)
        following[first + counts - 1] = first[outline.following]
        elements, across, found = _of_boundary(places, following)
        if found.all():
            break
        for i, (begin, n) in enumerate(zip(first, counts, strict=True)):
            t = fractions[i]
            fractions[i] = np.sort(np.append(t, 0.5 * (t + np.append(t[1:], 1.0))[~found[begin:begin + n]]))
    else:
        raise Untriangulated(f"edges of {domain!r} are missing")
    points, elements = _filled(domain, places, elements, across, field, growth)
    points, elements = improved_triangles(points, elements, np.arange(len(points)) < len(places), _ROUNDS)
    return _mesh(domain, points, elements, following, np.repeat(np.arange(len(edges)), counts))


def _beside_short_edges(edges: list, lengths: tuple[float, ...], field: Callable[[np.ndarray], np.ndarray]
                        ) -> Callable[[np.ndarray], np.ndarray]:
    """The field, lowered around edges that are much shorter than it: triangles at both their ends would be flat."""
    sizes = field(np.concatenate([edge.at(np.array([0.5])) for edge in edges]))
    short = [(edge, length) for edge, length, size in zip(edges, lengths, sizes, strict=True) if length < _SHORT * size]

    def lowered(x: np.ndarray) -> np.ndarray:
        return np.min([field(x), *(length + _GROWTH * edge.distance(x) for edge, length in short)], axis=0)

    return lowered if short else field


def _spaced(domain: Domain, edges: list, lengths: tuple[float, ...], field: Callable[[np.ndarray], np.ndarray],
            growth: float | None) -> list[np.ndarray]:
    """Fractions of each edge at which its nodes lie, its first end included."""
    at = [np.linspace(0.0, 1.0, _INTERVALS + 1)] * len(edges)
    for _ in range(MAX_BISECTIONS):
        sizes = np.split(field(np.concatenate([edge.at(t) for edge, t in zip(edges, at, strict=True)])),
                         np.cumsum([len(t) for t in at])[:-1])
        finer, longs = [], []
        for i, (edge, t, length) in enumerate(zip(edges, at, lengths, strict=True)):
            if isinstance(edge, Arc):
                sizes[i] = np.minimum(sizes[i], _MAX_EDGE * edge.radius)
            if growth is not None:
                slope = growth * length * t
                sizes[i] = np.minimum(np.minimum.accumulate(sizes[i] - slope) + slope,
                                      np.minimum.accumulate((sizes[i] + slope)[::-1])[::-1] - slope)
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
        passed = np.append(0.0, np.cumsum(0.5 * length * np.diff(t) * (1 / h[1:] + 1 / h[:-1])))
        n = max(1, round(float(passed[-1])))
        fractions.append(np.interp(np.arange(n) * (passed[-1] / n), passed, t))
    return fractions


def _of_boundary(places: np.ndarray, following: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The triangles inside a boundary, their neighbours, and which edges from each node to the next are among them."""
    n = len(places)
    low, high = places.min(axis=0), places.max(axis=0)
    corners = 0.5 * (low + high) + 5 * (high - low).max() * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0],
                                                                      [-1.0, 1.0]])
    elements, across = np.empty((2 * n + 2, 3), dtype=np.int32), np.full((2 * n + 2, 3), -1, dtype=np.int32)
    elements[:2] = [[n, n + 1, n + 2], [n, n + 2, n + 3]]
    across[0, 1], across[1, 2] = 1, 0
    found = np.zeros(n, dtype=bool)
    count = _boundary(np.concatenate([places, corners]), elements, across, following, found)
    return elements[:count], across[:count], found


def _filled(domain: Domain, places: np.ndarray, elements: np.ndarray, across: np.ndarray,
            field: Callable[[np.ndarray], np.ndarray], growth: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Nodes put into the triangles of a boundary."""
    points, n, n_elements, n_read = places, len(places), len(elements), 0
    sizes, settled = np.empty(0), np.zeros(n_elements, dtype=bool)
    while True:
        # sizes are interpolated at new nodes, and read there before there are four times as many
        room = 3 * n
        sizes = np.concatenate([sizes[:n_read], field(points[n_read:n]), np.empty(room)])
        dips = np.empty(0)
        if growth is not None:
            # every triangle that is new holds a node that is new
            new = (elements[:n_elements] >= n_read).any(axis=1)
            dips = np.full(n_elements, np.inf)
            dips[new] = field(points[elements[:n_elements][new]].mean(axis=1))
            _limit(points, elements[:n_elements], sizes, growth)
        points = np.concatenate([points[:n], np.empty((room, 2))])
        spare = np.empty((2 * room, 3), dtype=np.int32)
        elements, across = (np.concatenate([table[:n_elements], spare]) for table in (elements, across))
        settled = np.concatenate([settled[:n_elements], np.zeros(len(spare), dtype=bool)])
        before = n
        n, n_elements, cells = _fill(points, sizes, elements, across, n, n_elements, n_read, settled, dips)
        n_read = before
        refuse_too_many(NODES_PER_CELL[2] * cells, domain)
        if n == n_read:
            return points[:n], elements[:n_elements]


def _mesh(domain: Plane, points: np.ndarray, elements: np.ndarray, following: np.ndarray, edge: np.ndarray
          ) -> MeshArrays:
    """The mesh, its boundary from each node to the following one."""
    names = tuple(str(i) for i in range(len(domain.boundaries)))
    if not isinstance(domain, Outline):
        names = tuple(dict.fromkeys(domain.boundaries))
        edge = np.array([names.index(name) for name in domain.boundaries])[edge]
    mesh = MeshArrays(points, elements, np.column_stack([np.arange(len(following)), following]), edge, names)
    (x, y), (u, v) = points[:len(following)].T, points[following].T
    area = 0.5 * float(np.sum(x * v - y * u))
    if not (mesh.volumes.min() > 0 and abs(mesh.volumes.sum() - area) <= 1e-9 * area):
        raise Untriangulated(f"triangles of {domain!r} are turned over")
    return trusted(mesh, None)


@inner_kernel
def _walk(points, elements, across, e, x, y):
    """The triangle that holds a place, on the straight way from triangle e; -1 if that leaves the mesh."""
    for _ in range(len(elements)):
        worst, side = 0.0, -1
        for k in range(3):
            a, b = elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
            cross = ((points[b, 0] - points[a, 0]) * (y - points[a, 1])
                     - (points[b, 1] - points[a, 1]) * (x - points[a, 0]))
            if cross < worst:
                worst, side = cross, k
        if side < 0:
            return e
        if across[e, side] < 0:
            return np.int64(-1)
        e = np.int64(across[e, side])
    return np.int64(-1)


@inner_kernel
def _place(elements, across, e, a, b, c, over_a, over_b, over_c):
    """Write a triangle and its neighbours."""
    elements[e, 0], elements[e, 1], elements[e, 2] = a, b, c
    across[e, 0], across[e, 1], across[e, 2] = over_a, over_b, over_c


@inner_kernel
def _insert(points, elements, across, n, e, p, stack, settled):
    """Cut triangle e at the node p in it, or at an edge both triangles there, and swap edges; returns the number of
    triangles. Nothing happens at an edge of the boundary. Triangles that change are no longer ``settled``."""
    k, nearest = 0, np.inf
    for j in range(3):
        b, c = elements[e, (j + 1) % 3], elements[e, (j + 2) % 3]
        x, y = points[c, 0] - points[b, 0], points[c, 1] - points[b, 1]
        away = (x * (points[p, 1] - points[b, 1]) - y * (points[p, 0] - points[b, 0])) / (x * x + y * y)
        if away < nearest:
            nearest, k = away, j
    a, b, c = elements[e, k], elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
    over_a, over_b, over_c = across[e, k], across[e, (k + 1) % 3], across[e, (k + 2) % 3]
    m = n + 1
    if nearest > _ON_EDGE:
        _place(elements, across, e, p, a, b, over_c, n, m)
        _place(elements, across, n, p, b, c, over_a, m, e)
        _place(elements, across, m, p, c, a, over_b, e, n)
        replace_neighbour(across, over_a, e, n)
        replace_neighbour(across, over_b, e, m)
        stack[0], stack[1], stack[2], depth = e, n, m, 3
    else:
        f = np.int64(over_a)
        if f < 0:
            return n
        j = 0
        while elements[f, j] == b or elements[f, j] == c:
            j += 1
        d, beyond_c, beyond_b = elements[f, j], across[f, (j + 1) % 3], across[f, (j + 2) % 3]
        _place(elements, across, e, p, a, b, over_c, m, n)
        _place(elements, across, n, p, c, a, over_b, e, f)
        _place(elements, across, f, p, d, c, beyond_b, n, m)
        _place(elements, across, m, p, b, d, beyond_c, f, e)
        replace_neighbour(across, over_b, e, n)
        replace_neighbour(across, beyond_c, f, m)
        stack[0], stack[1], stack[2], stack[3], depth = e, n, f, m, 4
    while depth > 0:
        depth -= 1
        e = stack[depth]
        settled[e] = False
        f = np.int64(across[e, 0])
        # the new node comes first
        if f >= 0 and depth + 2 <= len(stack) and swap_edge(points, elements, across, e, 0):
            stack[depth], stack[depth + 1] = e, f
            depth += 2
    return m + 1


@kernel
def _boundary(points, elements, across, following, found):
    """Put all nodes but the last four, which are corners of a box, into its two triangles, and drop those outside.
    ``found`` becomes True where the edge to the following node is there. Returns how many triangles are left."""
    n, count, e = len(following), np.int64(2), np.int64(0)
    stack, settled = np.empty(256, dtype=np.int64), np.empty(len(elements), dtype=np.bool_)
    for p in range(n):
        e = _walk(points, elements, across, e, points[p, 0], points[p, 1])
        if e < 0:
            return 0
        count = _insert(points, elements, across, count, e, p, stack, settled)
    # triangles to the left of edges of the boundary, and all that hang together with them
    number = np.full(count, -1, dtype=np.int32)
    queue, last = np.empty(count, dtype=np.int64), 0
    for e in range(count):
        for k in range(3):
            a, b = elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
            if a < n and following[a] == b:
                found[a] = True
                across[e, k] = -1
                if number[e] < 0:
                    number[e], queue[last] = 0, e
                    last += 1
    for i in range(n):
        if not found[i]:
            return 0
    first = 0
    while first < last:
        for k in range(3):
            f = across[queue[first], k]
            if f >= 0 and number[f] < 0:
                number[f], queue[last] = 0, f
                last += 1
        first += 1
    left = 0
    for e in range(count):
        if number[e] == 0:
            number[e] = left
            left += 1
    for e in range(count):
        if number[e] >= 0:
            for k in range(3):
                f = across[e, k]
                elements[number[e], k] = elements[e, k]
                across[number[e], k] = number[f] if f >= 0 else -1
    return left


@kernel
def _limit(points, elements, sizes, growth):
    """Lower sizes until they grow by at most so much per distance along edges."""
    falls = True
    while falls:
        falls = False
        for e in range(len(elements)):
            for k in range(3):
                a, b = elements[e, k], elements[e, (k + 1) % 3]
                if sizes[a] > sizes[b]:
                    a, b = b, a
                length = np.sqrt((points[a, 0] - points[b, 0])**2 + (points[a, 1] - points[b, 1])**2)
                if sizes[b] > (1.0 + 1e-9) * (sizes[a] + growth * length):
                    sizes[b] = sizes[a] + growth * length
                    falls = True


@inner_kernel
def _next_place(points, elements, e, sizes, place):
    """Write where a triangle gets a node; returns its circumradius."""
    a, b, c = elements[e, 0], elements[e, 1], elements[e, 2]
    ab = (points[b, 0] - points[a, 0])**2 + (points[b, 1] - points[a, 1])**2
    bc = (points[c, 0] - points[b, 0])**2 + (points[c, 1] - points[b, 1])**2
    ca = (points[a, 0] - points[c, 0])**2 + (points[a, 1] - points[c, 1])**2
    if bc < ab and bc <= ca:
        a, b, c, ab = b, c, a, bc
    elif ca < ab:
        a, b, c, ab = c, a, b, ca
    x, y = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    u, v = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
    # distance of the circle's centre from the shortest side, over the length of this
    away = 0.5 * (u * (u - x) + v * (v - y)) / (x * v - y * u)
    radius = np.sqrt(ab * (0.25 + away * away))
    h = 0.5 * (sizes[a] + sizes[b])
    if ab < 4.0 * h * h:
        away = min(away, h * np.sqrt(0.75 / ab))
    place[0] = points[a, 0] + 0.5 * x - away * y
    place[1] = points[a, 1] + 0.5 * y + away * x
    return radius


@inner_kernel
def _is_free(points, elements, t, place, apart):
    """Whether a place in triangle t is so far from its corners."""
    for k in range(3):
        a = elements[t, k]
        if (points[a, 0] - place[0])**2 + (points[a, 1] - place[1])**2 < apart * apart:
            return False
    return True


@inner_kernel
def _interpolated(points, elements, t, place, sizes):
    """The size at a place in triangle t."""
    x, y, total, here = place[0], place[1], 0.0, 0.0
    for k in range(3):
        a, b = elements[t, (k + 1) % 3], elements[t, (k + 2) % 3]
        weight = (points[a, 0] - x) * (points[b, 1] - y) - (points[a, 1] - y) * (points[b, 0] - x)
        total += weight
        here += weight * sizes[elements[t, k]]
    return here / total


@kernel
def _fill(points, sizes, elements, across, n, count, n_read, settled, dips):
    """Put nodes into triangles that are too large until there are none, or no room. Sizes at nodes from ``n_read`` on
    are new; ``settled`` triangles without these are left; ``dips`` are sizes at centroids. Returns the numbers of nodes
    and triangles, and the integral of the power -2 of the size."""
    stack, place = np.empty(256, dtype=np.int64), np.empty(2)
    cells = 0.0
    for e in range(count):
        a, b, c = elements[e, 0], elements[e, 1], elements[e, 2]
        h = (sizes[a] + sizes[b] + sizes[c]) / 3.0
        cells += 0.5 * ((points[b, 0] - points[a, 0]) * (points[c, 1] - points[a, 1])
                        - (points[b, 1] - points[a, 1]) * (points[c, 0] - points[a, 0])) / (h * h)
        if max(a, b, c) >= n_read:
            settled[e] = False
    n_read, before = n, np.int64(-1)
    while n > before and n < len(points):
        before = n
        e = np.int64(-1)
        while e + 1 < count and n < len(points):
            e += 1
            # after a node the same triangle, or what came in its place, is next
            while not settled[e] and n < len(points):
                settled[e] = True
                a, b, c = elements[e, 0], elements[e, 1], elements[e, 2]
                h = (sizes[a] + sizes[b] + sizes[c]) / 3.0
                dip = e < len(dips) and dips[e] < _DIP * h
                if dip:
                    h = dips[e]
                radius = _next_place(points, elements, e, sizes, place) / (_RADIUS * h)
                # far from the right size what is interpolated is far from the field
                if not radius > 1.0 or (radius > _COARSE and max(a, b, c) >= n_read):
                    continue
                t = e
                if dip:
                    for k in range(2):
                        place[k] = (points[a, k] + points[b, k] + points[c, k]) / 3.0
                    dips[e] = np.inf
                else:
                    t = _walk(points, elements, across, e, place[0], place[1])
                if t >= 0 and _is_free(points, elements, t, place, _APART * h):
                    points[n, 0], points[n, 1] = place[0], place[1]
                    sizes[n] = h if dip else _interpolated(points, elements, t, place, sizes)
                    more = _insert(points, elements, across, count, t, n, stack, settled)
                    if more > count:
                        n, count = n + 1, more
                        settled[e] = False
    return n, count, cells
