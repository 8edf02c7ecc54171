r"""of_boundary: the Delaunay triangulation of a closed boundary and of slits; nodes put into triangles.

Put one by one into the two triangles of a box around the domain, with swaps of edges (C. L. Lawson, 1977), nodes give a
Delaunay triangulation. Where it lacks an edge of the boundary, the triangles that this edge crosses are replaced (M. V.
Anglada, 1997); triangles outside are dropped. An edge of a slit is given in both directions: triangles on its two sides
are no neighbours.

Triangles and their neighbours are a closed table from the first to the last step, and no step turns a triangle over.
"""

from __future__ import annotations

import numpy as np

from adaptmg._numba import inner_kernel, kernel
from adaptmg.geometry.predicates import in_circle, turn
from adaptmg.mesh.improve import opposite, replace_neighbour, swap_edge

#: nodes after which kernels come back to Python, so that Ctrl-C ends them
BATCH = 50_000


class Untriangulated(ValueError):
    """A domain whose boundary the triangulation does not hold."""


def of_boundary(places: np.ndarray, edges: np.ndarray, spread: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the triangles inside a boundary of directed edges (n, 2), their neighbours, and which edges are among
    theirs. If ``spread``, every second node comes last, and so on: one after the other around a thin ring each would
    swap all the edges across it."""
    n = len(places)
    low, high = places.min(axis=0), places.max(axis=0)
    corners = 0.5 * (low + high) + 5 * (high - low).max() * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0],
                                                                      [-1.0, 1.0]])
    elements, across = np.empty((2 * n + 2, 3), dtype=np.int32), np.full((2 * n + 2, 3), -1, dtype=np.int32)
    elements[:2] = [[n, n + 1, n + 2], [n, n + 2, n + 3]]
    across[0, 1], across[1, 2] = 1, 0
    found = np.zeros(len(edges), dtype=bool)
    points, count, e = np.concatenate([places, corners]), 2, 0
    order = np.arange(n)
    if spread:
        order = order[np.argsort(-(order & -order), kind="stable")]
    for begin in range(0, n, BATCH):
        count, e = _put(points, elements, across, order[begin:begin + BATCH], count, e)
        if e < 0:
            raise Untriangulated(f"nodes at {places[begin:begin + 1]}")
    rows = np.argsort(edges[:, 0], kind="stable")
    tails, heads = np.ascontiguousarray(edges[rows].T)
    start = np.searchsorted(tails, np.arange(n + 1))
    at, missing = np.empty(n + 4, dtype=np.int64), np.zeros(len(edges), dtype=bool)
    at[elements[:count]] = np.arange(count)[:, None]
    for begin in range(0, len(edges), BATCH):
        _force(points, elements, across, count, start, tails, heads, begin, min(len(edges), begin + BATCH), at, missing)
    if missing.any():
        found[rows] = ~missing
        return elements, across, found
    there = np.zeros(len(edges), dtype=bool)
    count = _cut_out(elements, across, count, start, heads, there)
    found[rows] = there
    return elements[:count], across[:count], found


@inner_kernel
def walk(points, elements, across, e, p):
    """Return the triangle that holds node p, on the straight way from triangle e; -1 if that leaves the mesh. In a
    Delaunay triangulation no triangle comes twice: the power of p with respect to their circles falls."""
    for _ in range(len(elements)):
        worst, side = 0.0, -1
        for k in range(3):
            away = turn(points, np.int64(elements[e, (k + 1) % 3]), np.int64(elements[e, (k + 2) % 3]), p)
            if away < worst:
                worst, side = away, k
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
def insert(points, elements, across, n, e, p, settled):
    """Cut triangle e at the node p in it, or at an edge both triangles there, and swap edges; returns the number of
    triangles. Nothing happens at a node or an edge of the boundary. Triangles that change are no longer ``settled``."""
    k, on = 0, 0
    for j in range(3):
        if turn(points, np.int64(elements[e, (j + 1) % 3]), np.int64(elements[e, (j + 2) % 3]), p) == 0.0:
            k, on = j, on + 1
    a, b, c = elements[e, k], elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
    over_a, over_b, over_c = across[e, k], across[e, (k + 1) % 3], across[e, (k + 2) % 3]
    m = n + 1
    if on == 0:
        _place(elements, across, e, p, a, b, over_c, n, m)
        _place(elements, across, n, p, b, c, over_a, m, e)
        _place(elements, across, m, p, c, a, over_b, e, n)
        replace_neighbour(across, over_a, e, n)
        replace_neighbour(across, over_b, e, m)
    else:
        f = np.int64(over_a)
        if f < 0 or on > 1:
            return n
        j = opposite(elements, f, b, c)
        d, beyond_c, beyond_b = elements[f, j], across[f, (j + 1) % 3], across[f, (j + 2) % 3]
        _place(elements, across, e, p, a, b, over_c, m, n)
        _place(elements, across, n, p, c, a, over_b, e, f)
        _place(elements, across, f, p, d, c, beyond_b, n, m)
        _place(elements, across, m, p, b, d, beyond_c, f, e)
        replace_neighbour(across, over_b, e, n)
        replace_neighbour(across, beyond_c, f, m)
    # around the node, which comes first in its triangles; ends as swaps do
    first = e
    while True:
        settled[e] = False
        if across[e, 0] < 0 or not swap_edge(points, elements, across, e, np.int64(0)):
            e = np.int64(across[e, 1])
            if e == first:
                return m + 1


@kernel
def _put(points, elements, across, nodes, count, e):
    """Put nodes into the triangles, the way to the first from triangle e. Returns the number of triangles and the last
    one; -1 where a node lies on another one."""
    settled = np.empty(len(elements), dtype=np.bool_)
    for p in nodes:
        e, before = walk(points, elements, across, e, p), count
        if e >= 0:
            count = insert(points, elements, across, count, e, p, settled)
        if count == before:
            return count, np.int64(-1)
    return count, e


@inner_kernel
def _edge(start, heads, a, b):
    """The number of the edge of the boundary from node a to node b, -1 where there is none."""
    if a < len(start) - 1:
        for i in range(start[a], start[a + 1]):
            if heads[i] == b:
                return np.int64(i)
    return np.int64(-1)


@inner_kernel
def _crossed(points, elements, across, start, heads, e, a, b, chains, outer, cells):
    """Look from node a, a corner of triangle e, to node b. Fill ``cells``, the triangles between them; ``chains``, the
    nodes to the right and to the left from a to b; and ``outer``: start, end, and triangle beyond, of the sides of all
    these triangles. Returns the numbers of triangles, of nodes to the right and to the left; no triangles where the
    edge is there, -1 and the first node of what is in the way where that is an edge of the boundary, or a node."""
    first = e
    while True:  # once around a
        k = 0 if elements[e, 0] == a else 1 if elements[e, 1] == a else 2
        u, v = np.int64(elements[e, (k + 1) % 3]), np.int64(elements[e, (k + 2) % 3])
        if u == b or v == b:
            return 0, 0, 0
        right, left = turn(points, a, u, b), turn(points, a, v, b)
        ahead = ((points[u, 0] - points[a, 0]) * (points[b, 0] - points[a, 0])
                 + (points[u, 1] - points[a, 1]) * (points[b, 1] - points[a, 1]))
        if right == 0.0 and ahead > 0.0:
            return -1, u, 0
        if right > 0.0 and left < 0.0:
            break
        e = np.int64(across[e, (k + 1) % 3])
        if e == first:
            return -1, np.int64(a), 0
    chains[0, 0], chains[0, 1], chains[1, 0], chains[1, 1], n, n_right, n_left = a, u, a, v, 0, 2, 2
    # on the way no triangle comes twice
    while True:
        for j in range(3):
            outer[3 * n + j, 0], outer[3 * n + j, 1] = elements[e, (j + 1) % 3], elements[e, (j + 2) % 3]
            outer[3 * n + j, 2] = across[e, j]
        cells[n] = e
        n += 1
        if elements[e, 0] == b or elements[e, 1] == b or elements[e, 2] == b:
            chains[0, n_right], chains[1, n_left] = b, b
            return n, n_right + 1, n_left + 1
        if max(_edge(start, heads, u, v), _edge(start, heads, v, u)) >= 0:
            return -1, u if _edge(start, heads, u, v) >= 0 else v, 0
        e = np.int64(across[e, opposite(elements, e, u, v)])
        w = np.int64(elements[e, opposite(elements, e, u, v)])
        side = turn(points, a, b, w)
        if w != b and side == 0.0:
            return -1, w, 0
        if w != b and side > 0.0:
            v, chains[1, n_left], n_left = w, w, n_left + 1
        elif w != b:
            u, chains[0, n_right], n_right = w, w, n_right + 1


@inner_kernel
def _retriangulate(points, elements, chain, m, cells, n, ranges):
    """Write Delaunay triangles (M. V. Anglada, 1997) between the m nodes of a chain, counter-clockwise, from number n
    of ``cells`` on; returns the number after the last."""
    ranges[0, 0], ranges[0, 1], depth = 0, m - 1, 1
    while depth > 0:  # a range of k nodes leaves two which have k + 1
        depth -= 1
        low, high = ranges[depth, 0], ranges[depth, 1]
        best = np.int64(-1)
        for k in range(low + 1, high):
            if turn(points, chain[low], chain[k], chain[high]) > 0.0 and (
                    best < 0 or in_circle(points, chain[low], chain[best], chain[high], chain[k]) > 0.0):
                best = k
        if best < 0:
            continue
        e = cells[n]
        elements[e, 0], elements[e, 1], elements[e, 2] = chain[low], chain[best], chain[high]
        n += 1
        for begin, end in ((low, best), (best, high)):
            if end - begin > 1:
                ranges[depth, 0], ranges[depth, 1] = begin, end
                depth += 1
    return n


@kernel
def _force(points, elements, across, count, start, tails, heads, begin, end, at, missing):
    """Make edges from ``tails`` to ``heads``; ``at``: a triangle of each node. ``missing`` becomes True for those that
    cross others, and for these."""
    chains, outer = np.empty((2, count + 2), dtype=np.int64), np.empty((3 * count, 3), dtype=np.int64)
    cells, ranges = np.empty(count, dtype=np.int64), np.empty((count, 2), dtype=np.int64)
    for edge in range(begin, end):
        a, b = tails[edge], heads[edge]
        n, n_right, n_left = _crossed(points, elements, across, start, heads, at[a], a, b, chains, outer, cells)
        if n < 0:
            missing[edge] = missing[min(start[min(n_right, len(start) - 1)], len(missing) - 1)] = True
        if n <= 0:
            continue
        # the left chain from b to a
        for i in range(n_left // 2):
            chains[1, i], chains[1, n_left - 1 - i] = chains[1, n_left - 1 - i], chains[1, i]
        half = _retriangulate(points, elements, chains[0], n_right, cells, np.int64(0), ranges)
        if _retriangulate(points, elements, chains[1], n_left, cells, half, ranges) < n:
            missing[:] = True
            return
        for i in range(n):
            e = cells[i]
            for k in range(3):
                p, q = elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
                at[p] = e
                across[e, k] = -1
                for j in range(3 * n):
                    f, m = cells[j // 3], j % 3
                    if elements[f, (m + 1) % 3] == q and elements[f, (m + 2) % 3] == p:
                        across[e, k] = f
                if across[e, k] >= 0:
                    continue
                for j in range(3 * n):
                    if outer[j, 0] == p and outer[j, 1] == q:
                        f = across[e, k] = outer[j, 2]
                        if f >= 0:
                            across[f, opposite(elements, f, p, q)] = e


@kernel
def _cut_out(elements, across, count, start, heads, found):
    """Drop the triangles outside. ``found`` becomes True for the edges that are there. Returns how many triangles are
    left."""
    # triangles to the left of edges of the boundary, and all that hang together with them
    number = np.full(count, -1, dtype=np.int32)
    queue, last = np.empty(count, dtype=np.int64), 0
    for e in range(count):
        for k in range(3):
            i = _edge(start, heads, elements[e, (k + 1) % 3], elements[e, (k + 2) % 3])
            if i >= 0:
                found[i] = True
                across[e, k] = -1
                if number[e] < 0:
                    number[e], queue[last] = 0, e
                    last += 1
    for i in range(len(found)):
        if not found[i]:
            return 0
    for first in range(count):
        # no triangle is put into the queue twice
        for k in range(3 if first < last else 0):
            f = across[queue[first], k]
            if f >= 0 and number[f] < 0:
                number[f], queue[last] = 0, f
                last += 1
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
