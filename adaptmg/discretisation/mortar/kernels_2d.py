r"""Kernels of the mortar coupling in 2D: which master edges lie in front of a slave edge, and which of them is nearest.

Along slave edge (a, b) let :math:`x(s) = x_a + s\,(x_b - x_a)` and :math:`n(s) = n_a + s\,(n_b - n_a)`, 0 <= s <= 1.
The ray :math:`x(s) + \alpha\,n(s)` meets the line through the master edge :math:`(y_1, y_2)` at

.. math:: \alpha = \frac{(x - y_1)\times(y_2 - y_1)}{f},\qquad \eta = \frac{(x - y_1)\times n}{f},\qquad
   f = (y_2 - y_1)\times n,

and the edge faces the ray if f > 0. The rays do not cross between the surfaces as long as
:math:`(x_b - x_a)\times n - \alpha\; n\times(n_b - n_a) < 0`.
"""

from __future__ import annotations

import numpy as np

from adaptmg.geometry.box_tree import STACK, leaf_range
from adaptmg.runtime.compiled import kernel

__all__ = ["SHORTEST", "distance_along_normal", "nearest_pieces", "search_strips"]

SHORTEST = 1e-13
"""Parts of a slave edge shorter than this fraction of it are joined to the next part."""

_BESIDE = 1e-9  # how far outside a master edge, as a fraction of it, a ray may pass


@kernel
def _meets(boxes, node, strip):
    """Whether a box (x, y lower, x, y upper) meets a strip (the same four, unit axis, lower and upper along it)."""
    if (boxes[node, 0] > strip[2] or boxes[node, 1] > strip[3] or boxes[node, 2] < strip[0]
            or boxes[node, 3] < strip[1]):
        return False
    middle = 0.5 * ((boxes[node, 0] + boxes[node, 2]) * strip[4] + (boxes[node, 1] + boxes[node, 3]) * strip[5])
    half = 0.5 * ((boxes[node, 2] - boxes[node, 0]) * abs(strip[4]) + (boxes[node, 3] - boxes[node, 1]) * abs(strip[5]))
    return middle - half <= strip[7] and middle + half >= strip[6]


@kernel
def search_strips(boxes, edges, strips, starts, counts, found):
    """Master edges whose bounding boxes meet each strip.

    ``boxes`` are those of a :class:`~adaptmg.geometry.box_tree.BoxTree`, ``edges`` (n, 4) those of the edges in its
    order. ``strips`` (n_strips, 8), see ``_meets``. Writes how many edges meet strip e to ``counts[e]`` and, unless
    ``found`` is empty, their positions in the tree from ``found[starts[e]]`` on.
    """
    n_leaves = (len(boxes) + 1) // 2
    stack = np.empty(STACK, dtype=np.int64)
    for e in range(len(strips)):
        counts[e] = 0
        stack[0] = 0
        depth = 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            if not _meets(boxes, node, strips[e]):
                continue
            if node < n_leaves - 1:
                stack[depth], stack[depth + 1] = 2 * node + 1, 2 * node + 2
                depth += 2
                continue
            first, last = leaf_range(node, n_leaves, len(edges))
            for s in range(first, last):
                if _meets(edges, s, strips[e]):
                    if len(found):
                        found[starts[e] + counts[e]] = s
                    counts[e] += 1


@kernel
def distance_along_normal(points, normals, a, b, y1, y2, s):
    """Distance from x(s) of slave edge (a, b) along the unit normal to master edge (y1, y2).

    Infinite if the ray misses the edge, the edge faces away, or rays cross before they reach it.
    """
    ex, ey = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    dx, dy = normals[b, 0] - normals[a, 0], normals[b, 1] - normals[a, 1]
    nx, ny = normals[a, 0] + s * dx, normals[a, 1] + s * dy
    mx, my = points[y2, 0] - points[y1, 0], points[y2, 1] - points[y1, 1]
    rx, ry = points[a, 0] + s * ex - points[y1, 0], points[a, 1] + s * ey - points[y1, 1]
    facing = mx * ny - my * nx
    across = rx * ny - ry * nx
    if facing <= 0.0 or across < -_BESIDE * facing or across > (1.0 + _BESIDE) * facing:
        return np.inf
    distance = (rx * my - ry * mx) / facing
    if (ex * ny - ey * nx) - distance * (nx * dy - ny * dx) >= 0.0:
        return np.inf
    return distance * np.hypot(nx, ny)


@kernel
def nearest_pieces(points, normals, slave, master, starts, facets, lows, highs, breaks, backward, forward, active,
                   piece_edge, piece_facet, piece_ends):
    """Cut each slave edge where a master edge begins or ends; give each part the nearest master edge in front of it.

    Pairs of slave edge e and master edge are ``starts[e]`` to ``starts[e + 1]``, sorted by ``lows``: master edge
    ``facets[p]`` lies in front of the part ``lows[p]`` < s < ``highs[p]``. ``breaks`` are the lows and highs of all
    pairs of an edge, sorted, from 2 ``starts[e]`` on. ``active`` is scratch, as long as the most pairs of an edge.
    Nearest is the smallest distance in size, from -``backward`` to ``forward``. Writes slave edge, master edge and both
    ends of each part to the last three arguments; returns the number of parts, fewer than twice the pairs.
    """
    n_pieces = 0
    for e in range(len(slave)):
        a, b = slave[e, 0], slave[e, 1]
        following, n_active = starts[e], 0
        for at in range(2 * starts[e], 2 * starts[e + 1]):
            high = breaks[at]
            if at == 2 * starts[e]:
                low = high
            if high - low <= SHORTEST:
                continue
            middle = 0.5 * (low + high)
            while following < starts[e + 1] and lows[following] < middle:
                active[n_active] = following
                following += 1
                n_active += 1
            kept, best, best_distance = 0, -1, np.inf
            for k in range(n_active):
                pair = active[k]
                if highs[pair] <= middle:
                    continue
                active[kept] = pair
                kept += 1
                distance = distance_along_normal(points, normals, a, b, master[facets[pair], 0],
                                                 master[facets[pair], 1], middle)
                if -backward <= distance <= forward and abs(distance) < best_distance:
                    best, best_distance = pair, abs(distance)
            n_active = kept
            if best >= 0:
                piece_edge[n_pieces], piece_facet[n_pieces] = e, facets[best]
                piece_ends[n_pieces, 0], piece_ends[n_pieces, 1] = low, high
                n_pieces += 1
            low = high
    return n_pieces
