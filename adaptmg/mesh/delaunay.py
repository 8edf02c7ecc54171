r"""of_boundary: the Delaunay triangulation of a closed boundary and of slits; nodes put into
triangles.

Put one by one into the two triangles of a box around the domain, with swaps of edges (C. L. Lawson,
1977), nodes give a Delaunay triangulation. Where it lacks an edge of the boundary, the edges that
this one crosses are swapped (S. W. Sloan, 1993); triangles outside are dropped. An edge of a slit
is given in both directions: triangles on its two sides are no neighbours.

Triangles and their neighbours are a closed table from the first to the last step, and no step turns
a triangle over. In kernels triangle e has the corners ``elements[e]``, counter-clockwise, which are rows
of ``points``, and beyond the side opposite corner k the neighbour ``across[e, k]``, -1 where there is
none; the edges of the boundary from node a lead to ``heads[start[a]:start[a + 1]]``, and
``triangle_of[a]`` is a triangle of node a."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from adaptmg._numba import inner_kernel, kernel
from adaptmg.geometry.predicates import in_circle, turn
from adaptmg.mesh.arrays import mask_of, pair_keys

#: nodes after which kernels come back to Python, so that Ctrl-C ends them
BATCH = 50_000


class Untriangulated(ValueError):
    """A domain whose boundary the triangulation does not hold."""


def of_boundary(places: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the triangles (m, 3) inside a boundary of directed ``edges`` (n_edges, 2) between ``places``
    (n, 2), their neighbours (m, 3), and a mask (n_edges,) of the edges that they have; if one is
    missing, all triangles, which are not yet cut off at the boundary."""
    # two triangles of a square far around the domain; its corners are the last four nodes
    n = len(places)
    low = places.min(axis=0)
    high = places.max(axis=0)
    corners = 0.5 * (low + high) + 5 * (high - low).max() * np.array(
        [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
    )
    elements = np.empty((2 * n + 2, 3), dtype=np.int32)
    across = np.full((2 * n + 2, 3), -1, dtype=np.int32)
    elements[:2] = [[n, n + 1, n + 2], [n, n + 2, n + 3]]
    # the diagonal from n to n + 2 lies opposite corner 1 of the first, corner 2 of the second
    across[0, 1] = 1
    across[1, 2] = 0
    present = np.zeros(len(edges), dtype=bool)
    settled = np.empty(len(elements), dtype=bool)
    points = np.concatenate([places, corners])
    # put in the nodes one by one, from coarse to fine along the boundary: multiples of high powers of
    # two first, odd numbers (and 0) last. In the order along the boundary, where a node may swap all
    # edges of the nodes before it to a corner of the box or across a ring, 4000 nodes take 6 times as
    # long around a square, 10 times around a bar of 10 : 1, and .9 times around a circle; twice as many
    # around a ring with the radii 1 and .97 take 18 times as long
    count = 2  # triangles
    e = 0  # the one where the next search begins
    numbers = np.arange(n)
    power_of_two = numbers & -numbers  # the largest one that divides the number
    order = np.argsort(-power_of_two, kind="stable")
    for begin in range(0, n, BATCH):
        batch = order[begin : begin + BATCH]
        count, e = _put(points, elements, across, batch, count, e, settled)
        if e < 0:
            # each node that was put in has added two triangles to the first two
            raise Untriangulated(f"node at {places[order[count // 2 - 1]]} lies on another")
    # swap until every edge of the boundary is there
    rows = np.argsort(edges[:, 0], kind="stable")
    tails, heads = np.ascontiguousarray(edges[rows].T)
    missing = _missing_after_swaps(points, elements, across, tails, heads)
    if missing.any():
        present[rows] = ~missing
        return elements, across, present
    elements, across, present[rows] = _inside(elements, across, n + 4, tails, heads)
    # edges that were swapped for others may not be Delaunay
    swap_all(points, elements, across, np.ones(len(elements), dtype=bool))
    return elements, across, present


def _missing_after_swaps(
    points: np.ndarray,
    elements: np.ndarray,
    across: np.ndarray,
    tails: np.ndarray,
    heads: np.ndarray,
) -> np.ndarray:
    """Swap edges of triangles ``elements`` (m, 3) between ``points`` (n + 4, 2), the last four of which are the
    corners of the box, with the neighbours ``across`` (m, 3) in place until they have the edges of the
    boundary from ``tails`` (n_edges,), ascending, to ``heads`` (n_edges,), and return the mask (n_edges,) of
    those that they do not have then."""
    # edges from node i have the rows start[i] to start[i + 1]; triangle_of[i] is a triangle of node i,
    # the last four nodes are the corners of the square
    n = len(points) - 4
    start = np.searchsorted(tails, np.arange(n + 1))
    triangle_of = np.empty(n + 4, dtype=np.int64)
    triangle_of[elements] = np.arange(len(elements))[:, None]
    missing = np.zeros(len(tails), dtype=bool)
    for begin in range(0, len(tails), BATCH):
        end = min(len(tails), begin + BATCH)
        _force(points, elements, across, start, tails, heads, begin, end, triangle_of, missing)
    return missing


def _inside(
    elements: np.ndarray, across: np.ndarray, n_nodes: int, tails: np.ndarray, heads: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the triangles (m, 3) inside the boundary, of ``elements`` with the neighbours ``across``: those
    left of its edges from ``tails`` (n_edges,) to ``heads`` (n_edges,); their neighbours (m, 3), and the
    mask (n_edges,) of the edges that they have."""
    # the side opposite each corner, in the direction of its triangle and in the other one
    begins, ends = (np.roll(elements, -k, axis=1) for k in (1, 2))
    keys = np.stack([pair_keys(begins, ends, n_nodes), pair_keys(ends, begins, n_nodes)])
    edges = pair_keys(tails, heads, n_nodes)
    order = np.argsort(edges)
    # for each side of a triangle, in both directions, the number of this edge of the boundary
    edge = order[np.minimum(np.searchsorted(edges, keys, sorter=order), len(edges) - 1)]
    along, against = edges[edge] == keys
    present = mask_of(edge[0][along], len(edges))
    # triangles that are joined without crossing the boundary are all inside, or all outside
    across = np.where(along | against, -1, across)
    joined = across >= 0
    starts = np.append(0, np.cumsum(joined.sum(axis=1)))
    graph = sparse.csr_array(
        (np.ones(starts[-1]), across[joined], starts), shape=(len(elements), len(elements))
    )
    n_parts, part = connected_components(graph, directed=False)
    part_is_inside = mask_of(part[along.any(axis=1)], n_parts)
    inside = part_is_inside[part]
    # the new numbers of triangles; the last entry is that of the neighbour -1, none
    number = np.append(np.cumsum(inside) - 1, -1).astype(np.int32)
    return elements[inside], number[across[inside]], present


@inner_kernel
def _replace_neighbour(across, e, old, new):
    """Replace the neighbour ``old`` of element e by ``new``; nothing happens where e is -1, no element."""
    if e >= 0:
        for k in range(3):
            if across[e, k] == old:
                across[e, k] = new
                return


@inner_kernel
def _opposite(elements, e, a, b):
    """Return which corner, 0 to 2, of element e is neither of its nodes a and b."""
    for k in range(2):
        if elements[e, k] != a and elements[e, k] != b:
            return k
    return 2


@inner_kernel
def _place(elements, across, e, a, b, c, over_a, over_b, over_c):
    """Write triangle e with the corners a, b, c and its neighbours opposite these, all numbers of 64 bits:
    it is compiled once."""
    elements[e, 0] = a
    elements[e, 1] = b
    elements[e, 2] = c
    across[e, 0] = over_a
    across[e, 1] = over_b
    across[e, 2] = over_c


@inner_kernel
def _swap_edge(points, elements, across, e, k):
    """Swap the edge opposite corner k of an element, which has a neighbour there, unless it is
    Delaunay; returns whether. An edge that is not Delaunay is the diagonal of a convex
    quadrilateral: no element is turned over. On fixed points swaps end (C. L. Lawson, 1977): the
    test is exact, and each swap lowers the surface of triangles with the heights x^2 + y^2."""
    a = np.int64(elements[e, k])
    b = np.int64(elements[e, (k + 1) % 3])
    c = np.int64(elements[e, (k + 2) % 3])
    f = np.int64(across[e, k])
    d = np.int64(elements[f, _opposite(elements, f, b, c)])
    if not in_circle(points, a, b, c, d) > 0.0:
        return False
    _swap(elements, across, e, k)
    return True


@inner_kernel
def _swap(elements, across, e, k):
    r"""Swap the edge opposite corner k of an element, the diagonal of a convex quadrilateral. The
    corner k then comes first in both elements.

          c                c
        / | \            / f \
       a e|f d    ->    a-----d
        \ | /            \ e /
          b                b
    """
    f = np.int64(across[e, k])
    a = np.int64(elements[e, k])
    b = np.int64(elements[e, (k + 1) % 3])
    c = np.int64(elements[e, (k + 2) % 3])
    m = _opposite(elements, f, b, c)
    d = np.int64(elements[f, m])
    over_ab = np.int64(across[e, (k + 2) % 3])
    over_ca = np.int64(across[e, (k + 1) % 3])
    over_bd = np.int64(across[f, (m + 1) % 3])
    over_dc = np.int64(across[f, (m + 2) % 3])
    # neighbours beyond the four sides, as f = (d, c, b)
    _place(elements, across, e, a, b, d, over_bd, f, over_ab)
    _place(elements, across, f, a, d, c, over_dc, over_ca, e)
    _replace_neighbour(across, over_bd, f, e)
    _replace_neighbour(across, over_ca, e, f)


@kernel
def swap_all(points, elements, across, suspect):
    """Swap edges of ``suspect`` triangles (m,), a mask that ends all False, until all are Delaunay;
    returns how many."""
    swapped = 0
    before = -1
    while swapped > before:
        before = swapped
        for e in range(len(elements)):
            # a swap makes its two triangles suspect again
            while suspect[e]:
                suspect[e] = False
                for k in range(3):
                    # an edge of two suspect triangles is looked at from the later one
                    f = across[e, k]
                    if f >= 0 and not suspect[f] and _swap_edge(points, elements, across, e, k):
                        suspect[e] = True
                        suspect[f] = True
                        swapped += 1
                        break
    return swapped


@inner_kernel
def walk(points, elements, across, e, p):
    """Return the triangle that holds node p, on the straight way from triangle e; -1 if that leaves
    the mesh, or passes more triangles than there are. In a Delaunay triangulation no triangle comes
    twice: the power of p with respect to their circles falls."""
    for _ in range(len(elements)):
        # leave across the side that has p farthest on its outer side
        worst = 0.0
        side = -1
        for k in range(3):
            away = turn(
                points, np.int64(elements[e, (k + 1) % 3]), np.int64(elements[e, (k + 2) % 3]), p
            )
            if away < worst:
                worst = away
                side = k
        if side < 0:
            return e
        if across[e, side] < 0:
            return np.int64(-1)
        e = np.int64(across[e, side])
    return np.int64(-1)


@inner_kernel
def insert(points, elements, across, n, e, p, settled):
    r"""Cut triangle e at the node p in it, or at an edge both triangles there, and swap edges;
    returns the number of triangles, n before. Nothing happens at a node or an edge of the boundary.
    Triangles that change are no longer ``settled``.

    The new triangles are n and m; of those in the picture on the right f is the one beyond b c:

             c                      c
           / | \                  / | \
          /m p n\                /n | f\
         / /   \ \              a---p---d
        a----e----b              \e | m/
                                  \ | /
                                    b
    """
    # on how many sides p lies: none, one (opposite corner k), or two, where it is a corner
    k = 0
    on = 0
    for j in range(3):
        if (
            turn(points, np.int64(elements[e, (j + 1) % 3]), np.int64(elements[e, (j + 2) % 3]), p)
            == 0.0
        ):
            k = j
            on = on + 1
    a = np.int64(elements[e, k])
    b = np.int64(elements[e, (k + 1) % 3])
    c = np.int64(elements[e, (k + 2) % 3])
    over_a = np.int64(across[e, k])
    over_b = np.int64(across[e, (k + 1) % 3])
    over_c = np.int64(across[e, (k + 2) % 3])
    m = n + 1
    if on == 0:
        _place(elements, across, e, p, a, b, over_c, n, m)
        _place(elements, across, n, p, b, c, over_a, m, e)
        _place(elements, across, m, p, c, a, over_b, e, n)
        _replace_neighbour(across, over_a, e, n)
        _replace_neighbour(across, over_b, e, m)
    else:
        f = over_a
        if f < 0 or on > 1:
            return n
        j = _opposite(elements, f, b, c)
        d = np.int64(elements[f, j])
        beyond_c = np.int64(across[f, (j + 1) % 3])
        beyond_b = np.int64(across[f, (j + 2) % 3])
        _place(elements, across, e, p, a, b, over_c, m, n)
        _place(elements, across, n, p, c, a, over_b, e, f)
        _place(elements, across, f, p, d, c, beyond_b, n, m)
        _place(elements, across, m, p, b, d, beyond_c, f, e)
        _replace_neighbour(across, over_b, e, n)
        _replace_neighbour(across, beyond_c, f, m)
    # go around p, which comes first in its triangles, and swap the sides opposite it; this ends as
    # swaps do
    first = e
    while True:
        settled[e] = False
        if across[e, 0] < 0 or not _swap_edge(points, elements, across, e, np.int64(0)):
            e = np.int64(across[e, 1])
            if e == first:
                return m + 1


@kernel
def _put(points, elements, across, nodes, count, e, settled):
    """Put nodes into the ``count`` triangles; triangle e is where the search for the first of them
    begins, ``settled`` (m,) is scratch. Returns the number of triangles and the last one found, -1 if a
    node lies on another."""
    for p in nodes:
        e = walk(points, elements, across, e, p)
        before = count
        if e >= 0:
            count = insert(points, elements, across, count, e, p, settled)
        if count == before:
            return count, np.int64(-1)
    return count, e


@inner_kernel
def _edge(start, heads, a, b):
    """Return the number of the edge of the boundary from node a to node b, -1 if there is none, as at the
    last four nodes, the corners of the box, for which ``start`` has no entries."""
    if a < len(start) - 1:
        for i in range(start[a], start[a + 1]):
            if heads[i] == b:
                return np.int64(i)
    return np.int64(-1)


@inner_kernel
def _towards(points, elements, across, e, a, b):
    """Look from node a, a corner of triangle e, to node b. Returns a triangle and a corner, or -1 and a
    node:

    - the triangle (a, u, v) that the straight way enters, and which of its corners is a;
    - -1 and b, if a triangle at a has the edge to b;
    - -1 and u, if a node u lies on the way;
    - -1 and a, if the way leaves the mesh at a."""
    first = e
    while True:  # once around a
        k = np.int64(0 if elements[e, 0] == a else 1 if elements[e, 1] == a else 2)
        u = np.int64(elements[e, (k + 1) % 3])
        v = np.int64(elements[e, (k + 2) % 3])
        if u == b or v == b:
            return np.int64(-1), b
        # b to the left of a u and to the right of a v lies in the angle between them
        right = turn(points, a, u, b)
        left = turn(points, a, v, b)
        ahead = (points[u, 0] - points[a, 0]) * (points[b, 0] - points[a, 0]) + (
            points[u, 1] - points[a, 1]
        ) * (points[b, 1] - points[a, 1])
        if right == 0.0 and ahead > 0.0:
            return np.int64(-1), u
        if right > 0.0 and left < 0.0:
            return e, k
        e = np.int64(across[e, (k + 1) % 3])
        if e == first:
            return np.int64(-1), a


@inner_kernel
def _swap_towards(points, elements, across, start, heads, e, k, a, b, far, triangle_of):
    r"""Go from node a, corner k of triangle e, to node b, and swap the first edge on the way that
    ends to the left in node ``far`` (-1: swap none) and is the diagonal of a strictly convex
    quadrilateral. Returns a status and a node:

    - 1 if it swapped an edge, and the farthest node to the left so far;
    - 0 if it came to b, and the farthest node to the left of the whole way;
    - -1 if an edge of the boundary crosses the way, or a node lies on it, and the first node of the
      edge, or this node.

                  v
                / | \
       a .. behind-+--w .. b      e = (behind, u, v), f = (w, v, u): the way crosses u v at +
                \ | /
                  u
    """
    farthest = np.int64(-1)
    most = 0.0
    while True:  # no triangle comes twice
        behind = np.int64(elements[e, k])
        u = np.int64(elements[e, (k + 1) % 3])
        v = np.int64(elements[e, (k + 2) % 3])
        if _edge(start, heads, u, v) >= 0:
            return -1, u
        if _edge(start, heads, v, u) >= 0:
            return -1, v
        f = np.int64(across[e, k])
        w = np.int64(elements[f, _opposite(elements, f, u, v)])
        if v == far and turn(points, behind, u, w) > 0.0 and turn(points, w, v, behind) > 0.0:
            _swap(elements, across, e, k)
            triangle_of[behind] = triangle_of[u] = triangle_of[w] = e
            triangle_of[v] = f
            return 1, farthest
        height = turn(points, a, b, v)
        if height > most:
            farthest = v
            most = height
        side = turn(points, a, b, w)
        if w == b or side == 0.0:
            return (0, farthest) if w == b else (-1, w)
        # the edge that is crossed next lies opposite the node that is left behind
        e = f
        k = np.int64(_opposite(elements, f, w, u if side > 0.0 else v))


@kernel
def _force(points, elements, across, start, tails, heads, begin, end, triangle_of, missing):
    """Make the edges ``begin`` to ``end`` from ``tails`` to ``heads`` by swaps; ``triangle_of`` has a
    triangle of each node. ``missing`` becomes True for an edge that crosses others, and for these.

    Of the edges that a new edge crosses, one can be swapped that ends in the node farthest to the
    left: there it is the diagonal of a convex quadrilateral. A swap takes an edge away from this
    node. After at most as many swaps as edges are crossed none is left there, and another node is the
    farthest: there are at most as many swaps as the square of the number of crossed edges."""
    for edge in range(begin, end):
        a = tails[edge]
        b = heads[edge]
        for _ in range(len(elements)):  # an edge that takes more swaps counts as missing
            e, corner_or_node = _towards(points, elements, across, triangle_of[a], a, b)
            node = corner_or_node
            if e < 0:
                break
            corner = corner_or_node
            # a first way, without swaps, finds the farthest node; the second swaps an edge there
            status, node = _swap_towards(
                points, elements, across, start, heads, e, corner, a, b, np.int64(-1), triangle_of
            )
            if status == 0:
                farthest = node
                status, node = _swap_towards(
                    points, elements, across, start, heads, e, corner, a, b, farthest, triangle_of
                )
            if status < 1:
                break
        if node != b:
            missing[edge] = True
            # so is the first edge that begins at the node in the way; none begins at a corner of the box
            if 0 <= node < len(start) - 1 and start[node] < start[node + 1]:
                missing[start[node]] = True
