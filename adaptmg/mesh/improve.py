r"""Meshes refined uniformly (``halved``) and with better shapes (``improved``), their boundaries unchanged.

halved: new nodes are the middles of edges. A tetrahedron without its corners is an octahedron, which is cut in four
along the shortest of its three diagonals: on Netgen's meshes the children are then better shaped than along a fixed
one.

improved: an edge between triangles is swapped where the angles opposite to it sum up to more than :math:`\pi`
(Delaunay). An inner node p goes to the minimum of the sum over its elements of

.. math:: \frac{\sum_{edges} l^2}{4\sqrt3\,A} \quad\text{or}\quad \frac{\sum_{edges} l^2}{12\,(3 V)^{2/3}} ,

which is 1 for an equilateral element of any size, so that grading stays. Squares over a power of at most 1 of a linear
function are convex where measures are positive: one Newton step is taken, halved until the sum falls.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from adaptmg._numba import inner_kernel, kernel
from adaptmg.geometry.predicates import in_circle
from adaptmg.mesh.arrays import MeshArrays, trusted


@kernel
def cells_around(elements, n_nodes):
    """Return compressed rows of corners, as ``corners * element + corner``."""
    start = np.empty(n_nodes + 1, dtype=np.int64)
    for i in range(n_nodes + 1):
        start[i] = 0
    for e in range(len(elements)):
        for k in range(elements.shape[1]):
            start[elements[e, k] + 1] += 1
    for i in range(n_nodes):
        start[i + 1] += start[i]
    items = np.empty(elements.size, dtype=np.int64)
    for e in range(len(elements) - 1, -1, -1):
        for k in range(elements.shape[1] - 1, -1, -1):
            i = elements[e, k] + 1
            start[i] -= 1
            items[start[i]] = elements.shape[1] * e + k
    # every row now begins where the one before it should
    for i in range(n_nodes):
        start[i] = start[i + 1]
    start[n_nodes] = elements.size
    return start, items


# edges of a simplex by their corners: the middle of edge k is number k of those below
_EDGES = {2: np.array([[1, 2], [0, 2], [0, 1]]), 3: np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])}
# children by corners (0 ..) and middles of edges (dim + 1 ..)
_TRIANGLES = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2], [3, 4, 5]])
_CORNERS = np.array([[0, 4, 5, 6], [4, 1, 7, 8], [5, 7, 2, 9], [6, 8, 9, 3]])
# a diagonal of the octahedron, and the other middles in turn around it
_OCTAHEDRA = np.array([[4, 9, 5, 6, 8, 7], [5, 8, 4, 7, 9, 6], [6, 7, 4, 5, 9, 8]])
_AROUND = _OCTAHEDRA[:, [[0, 1, 2 + k, 2 + (k + 1) % 4] for k in range(4)]]


@inner_kernel
def _middle(head, following, highs, count, a, b):
    """The number of the edge (a, b), entered as ``count`` if it is not known yet."""
    low, high = (a, b) if a < b else (b, a)
    k = head[low]
    # a list without circles: what follows was entered before
    while k >= 0 and highs[k] != high:
        k = following[k]
    if k < 0:
        k = count
        highs[k], following[k], head[low] = high, head[low], k
    return k


@kernel
def _number(cells, ends, head, following, highs, lows, numbers):
    """Fill ``numbers`` (n, n_edges) of each cell's edges; ``head`` comes as -1. Returns how many edges there are.
    Called for the elements first, then for the facets, whose edges are known."""
    count = 0
    for e in range(len(cells)):
        for k in range(len(ends)):
            a, b = cells[e, ends[k, 0]], cells[e, ends[k, 1]]
            number = _middle(head, following, highs, count, a, b)
            if number == count:
                lows[count] = a if a < b else b
                count += 1
            numbers[e, k] = number
    return count


@kernel
def _known(cells, ends, head, following, highs, numbers):
    """Fill ``numbers`` (n, n_edges) of cells all of whose edges are known."""
    for e in range(len(cells)):
        for k in range(len(ends)):
            numbers[e, k] = _middle(head, following, highs, -1, cells[e, ends[k, 0]], cells[e, ends[k, 1]])


def _inside(points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Four children (n, 4, 4) of each octahedron; ``nodes`` (n, 10): corners and middles of each element."""
    ends = points[nodes[:, _OCTAHEDRA[:, :2]]]
    lengths = np.square(ends[:, :, 0] - ends[:, :, 1]).sum(axis=2)
    best, shortest = np.zeros(len(nodes), dtype=np.int64), lengths[:, 0]
    for d in (1, 2):
        # of equal ones the first
        shorter = lengths[:, d] < (1.0 - 1e-9) * shortest
        best, shortest = np.where(shorter, d, best), np.where(shorter, lengths[:, d], shortest)
    return nodes[np.arange(len(nodes))[:, None, None], _AROUND[best]]


def halved(mesh: MeshArrays) -> MeshArrays:
    """Return the mesh with every edge cut in two."""
    dim, n = mesh.dim, mesh.n_nodes
    ends = _EDGES[dim]
    numbers = np.empty((len(mesh.elements), len(ends)), dtype=np.int32)
    head = np.full(n, -1, dtype=np.int32)
    following, highs, lows = (np.empty(numbers.size, dtype=np.int32) for _ in range(3))
    count = _number(mesh.elements, ends, head, following, highs, lows, numbers)
    points = np.concatenate([mesh.points, 0.5 * (mesh.points[lows[:count]] + mesh.points[highs[:count]])])
    nodes = np.concatenate([mesh.elements, n + numbers], axis=1)
    if dim == 2:
        elements = nodes[:, _TRIANGLES]
        sides = np.array([[0, 1]])
    else:
        elements = np.concatenate([nodes[:, _CORNERS], _inside(points, nodes)], axis=1)
        sides = _EDGES[2]
    numbers = np.empty((len(mesh.facets), len(sides)), dtype=np.int32)
    _known(mesh.facets, sides, head, following, highs, numbers)
    on = np.concatenate([mesh.facets, n + numbers], axis=1)
    facets = on[:, [[0, 2], [2, 1]] if dim == 2 else _TRIANGLES]
    return trusted(replace(mesh, points=points, elements=elements.reshape(-1, dim + 1), facets=facets.reshape(-1, dim),
                           facet_labels=np.repeat(mesh.facet_labels, facets.shape[1]),
                           element_body=np.repeat(mesh.element_body, elements.shape[1]), source=None), None, mesh.sound)


def improved(mesh: MeshArrays, rounds: int) -> MeshArrays:
    """Return the mesh with better shaped elements, of about the same sizes."""
    held = np.zeros(mesh.n_nodes, dtype=bool)
    held[mesh.facets] = True
    if mesh.dim == 2:
        points, elements = improved_triangles(mesh.points, mesh.elements, held, rounds)
    else:
        points, elements = moved_tetrahedra(mesh.points, mesh.elements, held, rounds), mesh.elements
    # neither a swap nor a move turns an element over
    return trusted(replace(mesh, points=points, elements=elements, source=None), None, mesh.sound)


#: volume that a step leaves, of that before, at least; nodes after which kernels come back, so that Ctrl-C ends them
_KEPT, _BATCH = 0.1, 100_000


@inner_kernel
def _newton(points, cells, first, last, items, x, step):
    """Write the Newton step of the node at x into ``step``; returns the sum at x."""
    total = 0.0
    g0 = g1 = g2 = h00 = h01 = h02 = h11 = h12 = h22 = 0.0
    for s in range(first, last):
        e, k = items[s] // 4, items[s] % 4
        # even permutations, so that the volume stays positive
        a, b, c = cells[e, k ^ 1], cells[e, k ^ 2], cells[e, k ^ 3]
        a0, a1, a2 = points[a, 0] - x[0], points[a, 1] - x[1], points[a, 2] - x[2]
        b0, b1, b2 = points[b, 0] - x[0], points[b, 1] - x[1], points[b, 2] - x[2]
        c0, c1, c2 = points[c, 0] - x[0], points[c, 1] - x[1], points[c, 2] - x[2]
        volume = (a0 * (b1 * c2 - b2 * c1) + a1 * (b2 * c0 - b0 * c2) + a2 * (b0 * c1 - b1 * c0))
        # gradient of the volume: minus the area vector of the face a b c
        p0, p1, p2, q0, q1, q2 = b0 - a0, b1 - a1, b2 - a2, c0 - a0, c1 - a1, c2 - a2
        v0, v1, v2 = p2 * q1 - p1 * q2, p0 * q2 - p2 * q0, p1 * q0 - p0 * q1
        square = (a0 * a0 + a1 * a1 + a2 * a2 + b0 * b0 + b1 * b1 + b2 * b2 + c0 * c0 + c1 * c1 + c2 * c2
                  + p0 * p0 + p1 * p1 + p2 * p2 + q0 * q0 + q1 * q1 + q2 * q2
                  + (b0 - c0)**2 + (b1 - c1)**2 + (b2 - c2)**2)
        s0, s1, s2 = -2.0 * (a0 + b0 + c0), -2.0 * (a1 + b1 + c1), -2.0 * (a2 + b2 + c2)
        inverse = 1.0 / volume
        power = inverse**(2.0 / 3.0)
        total += square * power
        slope, twice = -2.0 / 3.0 * square * inverse, -2.0 / 3.0 * inverse
        bend = 10.0 / 9.0 * square * inverse * inverse
        g0 += power * (s0 + slope * v0)
        g1 += power * (s1 + slope * v1)
        g2 += power * (s2 + slope * v2)
        h00 += power * (6.0 + 2.0 * twice * s0 * v0 + bend * v0 * v0)
        h11 += power * (6.0 + 2.0 * twice * s1 * v1 + bend * v1 * v1)
        h22 += power * (6.0 + 2.0 * twice * s2 * v2 + bend * v2 * v2)
        h01 += power * (twice * (s0 * v1 + s1 * v0) + bend * v0 * v1)
        h02 += power * (twice * (s0 * v2 + s2 * v0) + bend * v0 * v2)
        h12 += power * (twice * (s1 * v2 + s2 * v1) + bend * v1 * v2)
    m00, m01, m02 = h11 * h22 - h12 * h12, h02 * h12 - h01 * h22, h01 * h12 - h02 * h11
    det = h00 * m00 + h01 * m01 + h02 * m02
    if not det > 0.0:
        step[0] = step[1] = step[2] = 0.0
        return total
    m11, m12, m22 = h00 * h22 - h02 * h02, h01 * h02 - h00 * h12, h00 * h11 - h01 * h01
    step[0] = -(m00 * g0 + m01 * g1 + m02 * g2) / det
    step[1] = -(m01 * g0 + m11 * g1 + m12 * g2) / det
    step[2] = -(m02 * g0 + m12 * g1 + m22 * g2) / det
    return total


@inner_kernel
def _volume(points, a, b, c, x0, x1, x2):
    """Six times the volume of a tetrahedron with the corner x."""
    a0, a1, a2 = points[a, 0] - x0, points[a, 1] - x1, points[a, 2] - x2
    b0, b1, b2 = points[b, 0] - x0, points[b, 1] - x1, points[b, 2] - x2
    c0, c1, c2 = points[c, 0] - x0, points[c, 1] - x1, points[c, 2] - x2
    return a0 * (b1 * c2 - b2 * c1) + a1 * (b2 * c0 - b0 * c2) + a2 * (b0 * c1 - b1 * c0)


@inner_kernel
def _sum_at(points, cells, first, last, items, x, y, kept):
    """The sum with the node at y in place of x; infinite where a volume would fall too much."""
    total = 0.0
    for s in range(first, last):
        e, k = items[s] // 4, items[s] % 4
        a, b, c = cells[e, k ^ 1], cells[e, k ^ 2], cells[e, k ^ 3]
        volume = _volume(points, a, b, c, y[0], y[1], y[2])
        if not volume > kept * _volume(points, a, b, c, x[0], x[1], x[2]):
            return np.inf
        square = 0.0
        for m in range(3):
            u, v, w = points[a, m], points[b, m], points[c, m]
            square += ((u - y[m])**2 + (v - y[m])**2 + (w - y[m])**2 + (u - v)**2 + (v - w)**2 + (w - u)**2)
        total += square * volume**(-2.0 / 3.0)
    return total


@kernel
def _move_nodes_3d(points, cells, start, items, held, kept, begin, end):
    """Move each node that is not ``held`` once, in place; ``start``, ``items`` as :func:`cells_around` has them."""
    x, y, step = np.empty(3), np.empty(3), np.empty(3)
    for i in range(begin, end):
        if held[i]:
            continue
        first, last = start[i], start[i + 1]
        for m in range(3):
            x[m] = points[i, m]
        before, share = _newton(points, cells, first, last, items, x, step), 1.0
        for _ in range(5):
            for m in range(3):
                y[m] = x[m] + share * step[m]
            if _sum_at(points, cells, first, last, items, x, y, kept) < before:
                for m in range(3):
                    points[i, m] = y[m]
                break
            share *= 0.5


def moved_tetrahedra(points: np.ndarray, elements: np.ndarray, held: np.ndarray, rounds: int) -> np.ndarray:
    """Return the places of the nodes after some rounds."""
    result = np.array(points)
    start, items = cells_around(elements, len(points))
    for _ in range(rounds):
        for begin in range(0, len(result), _BATCH):
            _move_nodes_3d(result, elements, start, items, held, _KEPT, begin, min(begin + _BATCH, len(result)))
    return result


#: passes of swaps in a round at most; area that a move leaves, of that before, at least
_SWEEPS = 8


@kernel
def _across(elements, start, items, across):
    """Fill ``across`` (n, 3), which comes as -1, of the element opposite each corner of triangles."""
    for e in range(len(elements)):
        for k in range(3):
            b, c = elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
            for s in range(start[b], start[b + 1]):
                f, m = items[s] // 3, items[s] % 3
                # the neighbour runs along the same edge the other way
                if elements[f, (m + 2) % 3] == c:
                    across[e, k] = f
                    break


@inner_kernel
def replace_neighbour(across, e, old, new):
    """Replace the neighbour ``old`` of an element by another one."""
    if e >= 0:
        for k in range(3):
            if across[e, k] == old:
                across[e, k] = new
                return


@inner_kernel
def opposite(elements, e, a, b):
    """Return which corner of an element is neither a nor b."""
    for k in range(2):
        if elements[e, k] != a and elements[e, k] != b:
            return k
    return 2


@inner_kernel
def swap_edge(points, elements, across, e, k):
    """Swap the edge opposite corner k of an element, which has a neighbour there, unless it is Delaunay; returns
    whether. An edge that is not Delaunay is the diagonal of a convex quadrilateral: no element is turned over. On fixed
    points swaps end (C. L. Lawson, 1977): the test is exact, and each swap lowers the surface of triangles with the
    heights x^2 + y^2."""
    a, b, c = elements[e, k], elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
    d = elements[across[e, k], opposite(elements, across[e, k], b, c)]
    if not in_circle(points, np.int64(a), np.int64(b), np.int64(c), np.int64(d)) > 0.0:
        return False
    swap(elements, across, e, k)
    return True


@inner_kernel
def swap(elements, across, e, k):
    """Swap the edge opposite corner k of an element, the diagonal of a convex quadrilateral. The corner k then comes
    first in both elements."""
    f = np.int64(across[e, k])
    a, b, c = elements[e, k], elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
    m = opposite(elements, f, b, c)
    d = elements[f, m]
    beside_b, beside_c = across[e, (k + 2) % 3], across[e, (k + 1) % 3]
    over_b, over_c = across[f, (m + 1) % 3], across[f, (m + 2) % 3]
    # f = d c b: opposite c lies the edge b d, opposite b the edge d c
    elements[e, 0], elements[e, 1], elements[e, 2] = a, b, d
    elements[f, 0], elements[f, 1], elements[f, 2] = a, d, c
    across[e, 0], across[e, 1], across[e, 2] = over_b, f, beside_b
    across[f, 0], across[f, 1], across[f, 2] = over_c, beside_c, e
    replace_neighbour(across, over_b, f, e)
    replace_neighbour(across, beside_c, e, f)


@kernel
def swap_all(points, elements, across):
    """Swap edges once through the mesh; returns how many."""
    swapped = 0
    for e in range(len(elements)):
        for k in range(3):
            # each edge is looked at from one side
            if across[e, k] > e and swap_edge(points, elements, across, e, k):
                swapped += 1
                break
    return swapped


@kernel
def _move_nodes_2d(points, elements, start, items, held, kept, begin, end):
    """Move each node that is not ``held`` once; ``start``, ``items``: 3 * element + corner of each node."""
    for i in range(begin, end):
        if held[i]:
            continue
        x, y = points[i, 0], points[i, 1]
        before, gx, gy, hxx, hxy, hyy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for s in range(start[i], start[i + 1]):
            e, k = items[s] // 3, items[s] % 3
            a, b = elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
            ax, ay, bx, by = points[a, 0] - x, points[a, 1] - y, points[b, 0] - x, points[b, 1] - y
            area = ax * by - ay * bx
            square = ax * ax + ay * ay + bx * bx + by * by + (ax - bx)**2 + (ay - by)**2
            sx, sy = -2.0 * (ax + bx), -2.0 * (ay + by)
            dx, dy = ay - by, bx - ax
            ratio, inverse = square / area, 1.0 / area
            before += ratio
            gx += (sx - ratio * dx) * inverse
            gy += (sy - ratio * dy) * inverse
            hxx += (4.0 - 2.0 * sx * dx * inverse + 2.0 * ratio * dx * dx * inverse) * inverse
            hyy += (4.0 - 2.0 * sy * dy * inverse + 2.0 * ratio * dy * dy * inverse) * inverse
            hxy += (-(sx * dy + sy * dx) * inverse + 2.0 * ratio * dx * dy * inverse) * inverse
        det = hxx * hyy - hxy * hxy
        if not det > 0.0:
            continue
        px, py, share = -(hyy * gx - hxy * gy) / det, -(hxx * gy - hxy * gx) / det, 1.0
        for _ in range(5):
            nx, ny, after = x + share * px, y + share * py, 0.0
            for s in range(start[i], start[i + 1]):
                e, k = items[s] // 3, items[s] % 3
                a, b = elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
                ax, ay, bx, by = points[a, 0] - nx, points[a, 1] - ny, points[b, 0] - nx, points[b, 1] - ny
                area = ax * by - ay * bx
                old = ((points[a, 0] - x) * (points[b, 1] - y) - (points[a, 1] - y) * (points[b, 0] - x))
                if not area > kept * old:
                    after = np.inf
                    break
                after += (ax * ax + ay * ay + bx * bx + by * by + (ax - bx)**2 + (ay - by)**2) / area
            if after < before:
                points[i, 0], points[i, 1] = nx, ny
                break
            share *= 0.5


def improved_triangles(points: np.ndarray, elements: np.ndarray, held: np.ndarray, rounds: int
                       ) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles on the same nodes, these moved, after some rounds of swaps and moves."""
    points, elements = np.array(points), np.array(elements, dtype=np.int32)
    around = cells_around(elements, len(points))
    across = np.full(elements.shape, -1, dtype=np.int32)
    _across(elements, *around, across)
    for _ in range(rounds):
        swaps = [swap_all(points, elements, across)]
        while swaps[-1] and len(swaps) < _SWEEPS:
            swaps.append(swap_all(points, elements, across))
        if swaps[0]:
            around = cells_around(elements, len(points))
        for begin in range(0, len(points), _BATCH):
            _move_nodes_2d(points, elements, *around, held, _KEPT, begin, min(begin + _BATCH, len(points)))
    return points, elements
