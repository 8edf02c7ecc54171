r"""Convex polygons in a plane: intersection, difference and moments (kernels).

A polygon is an array (room, 2) of which the first n rows are its corners, counter-clockwise; repeated corners and
polygons without area are allowed. Half-planes are taken off one by one (Sutherland and Hodgman 1974,
doi:10.1145/360767.360802); the point where an edge crosses a line is computed only between corners strictly on
different sides, so that coincident edges need no tolerance: at worst they leave a sliver.

Moments are kept as area A, centroid c and covariance

.. math:: S = \frac1A \int (x - c)(x - c)^T

so that those of a small polygon far from the origin lose no digits. They are merged from triangles, whose negative
areas (rounding) count as zero: centroids stay inside, covariances positive.
"""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import inner_kernel, kernel

__all__ = ["MOMENTS", "ROOM", "add_visible", "clip", "keep_left", "polygon_moments", "separated"]

ROOM = 12
"""Room for the corners of a triangle cut by another one: 6, more where rounding bends edges; the rest is for safety."""

MOMENTS = 6
"""Area, centroid (2), covariance xx, xy, yy."""


@kernel
def _side(polygon, i, ax, ay, bx, by):
    """Twice the area of the triangle of a, b and corner i: positive to the left of the line from a to b."""
    return (bx - ax) * (polygon[i, 1] - ay) - (by - ay) * (polygon[i, 0] - ax)


@inner_kernel
def keep_left(polygon, n, ax, ay, bx, by, out):
    """Write the part of a polygon to the left of the line from a to b to ``out``; returns its number of corners.

    Corners beyond the room of ``out`` are dropped: only rounding makes so many, on an edge along the line.
    """
    kept, room = 0, len(out)
    if n == 0:
        return kept
    last = n - 1
    side_last = _side(polygon, last, ax, ay, bx, by)
    for i in range(n):
        side = _side(polygon, i, ax, ay, bx, by)
        if kept < room and ((side > 0.0 and side_last < 0.0) or (side < 0.0 and side_last > 0.0)):
            t = side_last / (side_last - side)
            for c in range(2):
                out[kept, c] = (1.0 - t) * polygon[last, c] + t * polygon[i, c]
            kept += 1
        if kept < room and side >= 0.0:
            out[kept, 0], out[kept, 1] = polygon[i, 0], polygon[i, 1]
            kept += 1
        last, side_last = i, side
    return kept


@kernel
def clip(polygon, n, window, m, out, spare):
    """Write the intersection of two polygons to ``out``.

    Parameters
    ----------
    polygon, window : (room, 2) arrays
        With n and m corners.
    out, spare : (room, 2) arrays
        With room for n + m + 1 corners. Result and scratch; neither may be ``polygon`` or ``window``.

    Returns
    -------
    int
        Number of corners of the result; below 3 there is none.
    """
    count = n
    for i in range(n):
        out[i, 0], out[i, 1] = polygon[i, 0], polygon[i, 1]
    for i in range(m):
        j = i + 1 if i + 1 < m else 0
        left = keep_left(out, count, window[i, 0], window[i, 1], window[j, 0], window[j, 1], spare)
        for k in range(left):
            out[k, 0], out[k, 1] = spare[k, 0], spare[k, 1]
        count = left
        if count < 3:
            return 0
    return count


@inner_kernel
def _separated_by_edge(polygon, n, window, m, tolerance):
    """Whether ``polygon`` lies to the right of an edge of ``window``, but for a strip as wide as ``tolerance``."""
    for i in range(m):
        j = i + 1 if i + 1 < m else 0
        ax, ay, bx, by = window[i, 0], window[i, 1], window[j, 0], window[j, 1]
        length = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
        # the direction of a shorter edge is rounding
        if length <= tolerance:
            continue
        apart = True
        for k in range(n):
            if _side(polygon, k, ax, ay, bx, by) > tolerance * length:
                apart = False
                break
        if apart:
            return True
    return False


@inner_kernel
def separated(polygon, n, window, m, tolerance):
    """Whether an edge of one of two polygons separates them, but for a strip as wide as ``tolerance``."""
    for c in range(2):
        low, high, window_low, window_high = np.inf, -np.inf, np.inf, -np.inf
        for i in range(n):
            low, high = min(low, polygon[i, c]), max(high, polygon[i, c])
        for i in range(m):
            window_low, window_high = min(window_low, window[i, c]), max(window_high, window[i, c])
        if low >= window_high - tolerance or window_low >= high - tolerance:
            return True
    return _separated_by_edge(polygon, n, window, m, tolerance) or _separated_by_edge(window, m, polygon, n, tolerance)


@inner_kernel
def _add_triangle(moments, polygon, i, j, k):
    """Merge the moments of the triangle of three corners into ``moments`` (MOMENTS,)."""
    area = 0.5 * _side(polygon, k, polygon[i, 0], polygon[i, 1], polygon[j, 0], polygon[j, 1])
    if not area > 0.0:
        return
    x = (polygon[i, 0] + polygon[j, 0] + polygon[k, 0]) / 3.0
    y = (polygon[i, 1] + polygon[j, 1] + polygon[k, 1]) / 3.0
    xx, xy, yy = 0.0, 0.0, 0.0
    for corner in (i, j, k):
        dx, dy = polygon[corner, 0] - x, polygon[corner, 1] - y
        xx += dx * dx / 12.0
        xy += dx * dy / 12.0
        yy += dy * dy / 12.0
    total = moments[0] + area
    share = area / total
    dx, dy = x - moments[1], y - moments[2]
    rest = share * (1.0 - share)
    moments[0] = total
    moments[1] += share * dx
    moments[2] += share * dy
    moments[3] += share * (xx - moments[3]) + rest * dx * dx
    moments[4] += share * (xy - moments[4]) + rest * dx * dy
    moments[5] += share * (yy - moments[5]) + rest * dy * dy


@kernel
def polygon_moments(polygon, n, moments):
    """Moments of a polygon, written to ``moments`` (MOMENTS,): area, centroid, covariance."""
    for c in range(MOMENTS):
        moments[c] = 0.0
    for i in range(1, n - 1):
        _add_triangle(moments, polygon, 0, i, i + 1)


@kernel
def add_visible(polygon, n, blockers, hiding, n_hiding, tolerance, stack, states, piece, moments):
    """Moments of what is left of a polygon when triangles hide parts of it.

    Its triangles are cut along the edges of one blocker after the other, depth first: what lies outside an edge goes
    on to the next blocker, what lies inside all of them is hidden.

    Parameters
    ----------
    polygon : (room, 2) array
        With n corners.
    blockers : (n_triangles, 3, 2) array
        Counter-clockwise, with an area; they may overlap.
    hiding : (room,) array of int
        The first ``n_hiding`` are those that hide parts of this polygon.
    tolerance : float
        Width of overlaps that are passed over, m.
    stack : (room, 3, 2) array, states : (room, 2) array
        Scratch: triangles, and the blocker and its edge to cut them by next. Room: n + 12 for each that hides, as a
        cut leaves at most 4 triangles.
    piece : (2, ROOM, 2) array
        Scratch.
    moments : (MOMENTS,) array
        Result.
    """
    for c in range(MOMENTS):
        moments[c] = 0.0
    depth = _push(polygon, n, 0, 0, stack, states, 0)
    while depth > 0:
        depth -= 1
        at, edge = states[depth, 0], states[depth, 1]
        if at == n_hiding:
            _add_triangle(moments, stack[depth], 0, 1, 2)
            continue
        blocker = blockers[hiding[at]]
        if edge == 0 and separated(stack[depth], 3, blocker, 3, tolerance):
            states[depth, 0] = at + 1
            depth += 1
            continue
        if edge == 3:
            continue
        end = edge + 1 if edge < 2 else 0
        ax, ay, bx, by = blocker[edge, 0], blocker[edge, 1], blocker[end, 0], blocker[end, 1]
        inside = keep_left(stack[depth], 3, ax, ay, bx, by, piece[0])
        outside = keep_left(stack[depth], 3, bx, by, ax, ay, piece[1])
        depth = _push(piece[0], inside, at, edge + 1, stack, states, depth)
        depth = _push(piece[1], outside, at + 1, 0, stack, states, depth)


@inner_kernel
def _push(polygon, n, at, edge, stack, states, depth):
    """Put the triangles of a polygon with their state on the stack; returns its new depth."""
    for i in range(1, n - 1):
        for c in range(2):
            stack[depth, 0, c] = polygon[0, c]
            stack[depth, 1, c] = polygon[i, c]
            stack[depth, 2, c] = polygon[i + 1, c]
        states[depth, 0], states[depth, 1] = at, edge
        depth += 1
    return depth
