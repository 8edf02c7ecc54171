r"""Better triangles: edges swapped and nodes moved, boundaries as they are.

An edge is swapped where the angles opposite to it sum up to more than :math:`\pi` (Delaunay). A node p goes to the
minimum of the sum over its triangles of

.. math:: \frac{|p - a|^2 + |p - b|^2 + |a - b|^2}{4\sqrt3\,A} ,

1 for an equilateral triangle of any size, so that grading stays. A sum of squares over a linear function, it is convex
where areas are positive: one Newton step is taken, halved until the sum falls.
"""

from __future__ import annotations

import numpy as np

from adaptmg.mesh.netgen.finish.around import cells_around
from adaptmg.runtime.compiled import inner_kernel, kernel

__all__ = ["improved_triangles"]

#: passes of swaps in a round at most; area that a move leaves, of that before, at least
_SWEEPS = 8
_KEPT = 0.1


@kernel
def _across(elements, start, items, across):
    """Fill ``across`` (n, 3), which comes as -1, with the element opposite each corner; ``start`` comes as 0."""
    n = len(elements)
    for e in range(n):
        for k in range(3):
            start[min(elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]) + 1] += 1
    for i in range(len(start) - 1):
        start[i + 1] += start[i]
    for e in range(n):
        for k in range(3):
            low = min(elements[e, (k + 1) % 3], elements[e, (k + 2) % 3])
            items[start[low]] = 3 * e + k
            start[low] += 1
    for i in range(len(start) - 1, 0, -1):
        start[i] = start[i - 1]
    start[0] = 0
    for i in range(len(start) - 1):
        for s in range(start[i], start[i + 1]):
            e, k = items[s] // 3, items[s] % 3
            high = max(elements[e, (k + 1) % 3], elements[e, (k + 2) % 3])
            for t in range(s + 1, start[i + 1]):
                f, m = items[t] // 3, items[t] % 3
                if max(elements[f, (m + 1) % 3], elements[f, (m + 2) % 3]) == high:
                    across[e, k], across[f, m] = f, e


@inner_kernel
def _cross(points, a, b, c):
    """Twice the area of a triangle."""
    return ((points[b, 0] - points[a, 0]) * (points[c, 1] - points[a, 1])
            - (points[b, 1] - points[a, 1]) * (points[c, 0] - points[a, 0]))


@inner_kernel
def _dot(points, a, b, c):
    """Of the sides at a."""
    return ((points[b, 0] - points[a, 0]) * (points[c, 0] - points[a, 0])
            + (points[b, 1] - points[a, 1]) * (points[c, 1] - points[a, 1]))


@inner_kernel
def _replace(across, e, old, new):
    """The neighbour ``old`` of an element is now another one."""
    if e >= 0:
        for k in range(3):
            if across[e, k] == old:
                across[e, k] = new
                return


@kernel
def _swap(points, elements, across):
    """Swap edges once through the mesh; returns how many."""
    swapped = 0
    for e in range(len(elements)):
        for k in range(3):
            f = across[e, k]
            if f < 0:
                continue
            a, b, c = elements[e, k], elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
            m = 0
            while elements[f, m] == b or elements[f, m] == c:
                m += 1
            d = elements[f, m]
            cross_a, cross_d = _cross(points, a, b, c), _cross(points, d, c, b)
            dot_a, dot_d = _dot(points, a, b, c), _dot(points, d, b, c)
            # sine of the sum of the angles
            if cross_a * dot_d + cross_d * dot_a >= -1e-10 * (cross_a * cross_d + abs(dot_a * dot_d)):
                continue
            if not (_cross(points, a, b, d) > 0.0 and _cross(points, a, d, c) > 0.0):
                continue
            beside_b, beside_c = across[e, (k + 2) % 3], across[e, (k + 1) % 3]
            over_b, over_c = across[f, (m + 1) % 3], across[f, (m + 2) % 3]
            # f = d c b: opposite c lies the edge b d, opposite b the edge d c
            elements[e, 0], elements[e, 1], elements[e, 2] = a, b, d
            elements[f, 0], elements[f, 1], elements[f, 2] = a, d, c
            across[e, 0], across[e, 1], across[e, 2] = over_b, f, beside_b
            across[f, 0], across[f, 1], across[f, 2] = over_c, beside_c, e
            _replace(across, over_b, f, e)
            _replace(across, beside_c, e, f)
            swapped += 1
            break
    return swapped


@kernel
def _move(points, elements, start, items, held, kept):
    """Move each node that is not ``held`` once; ``start``, ``items``: 3 * element + corner of each node."""
    for i in range(len(points)):
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
    """Triangles on the same nodes, these moved, after some rounds of swaps and moves.

    Parameters
    ----------
    points : (n_nodes, 2) array
        m.
    elements : (n, 3) int32 array
        Positively oriented; of one body.
    held : (n_nodes,) bool array
        Nodes that stay.
    rounds : int

    Returns
    -------
    points : (n_nodes, 2) array
        m.
    elements : (n, 3) int32 array
    """
    points, elements = np.array(points), np.array(elements, dtype=np.int32)
    across = np.full_like(elements, -1)
    _across(elements, np.zeros(len(points) + 1, dtype=np.int64), np.empty(elements.size, dtype=np.int64), across)
    for _ in range(rounds):
        for _ in range(_SWEEPS):
            if not _swap(points, elements, across):
                break
        _move(points, elements, *cells_around(elements, len(points)), held, _KEPT)
    return points, elements
