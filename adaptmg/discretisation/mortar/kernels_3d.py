r"""Which parts of two triangulated surfaces face each other (kernels).

For every slave facet there is a frame (e1, e2, n) with its origin at the centroid: e1 and e2 span the auxiliary plane,
n is the averaged normal along which everything is projected (Puso and Laursen 2004, doi:10.1016/j.cma.2003.06.010).
Coordinates in it are called local. The gap of a pair is then affine on the plane: height of the master's plane less
that of the slave's.
"""

from __future__ import annotations

import numpy as np

from adaptmg.geometry.box_tree import STACK, leaf_range
from adaptmg.geometry.polygons import (
    MOMENTS,
    ROOM,
    add_visible,
    clip,
    polygon_moments,
    separated,
)
from adaptmg.runtime.compiled import inner_kernel, kernel

__all__ = ["common_moments", "find_opposite"]

GRAZING = 1e-2
"""A master facet faces the normal of a slave facet if it leans towards it by more than this angle (rad)."""

SLIVER = 1e-14
"""Common parts smaller than this share of the slave facet are rounding."""

THIN = 1e-10
"""Overlaps of master facets thinner than this share of the slave facet's size are rounding."""

@kernel
def find_opposite(frames, origins, low, high, boxes, order, corners, vectors, start, fill, found):
    """Master facets that face a slave facet and meet the box of its local extents.

    Parameters
    ----------
    frames : (n_slave, 3, 3) array
        Rows e1, e2, n.
    origins, low, high : (n_slave, 3) arrays
        The last two local, m; may be infinite.
    boxes : (2 n_leaves - 1, 6) array
        Of a :class:`~adaptmg.geometry.box_tree.BoxTree` of the master facets.
    order : (n_master,) array
        Numbers of master facets at the positions of the tree.
    corners : (n_master, 3, 3) array
    vectors : (n_master, 3) array
        Their area vectors.
    start : (n_slave + 1,) array
        If not ``fill``, the number found for the facet s is written at [s + 1]; else where those of s begin.
    fill : bool
        Whether to write to ``found``.
    found : (start[-1],) array
        Result.
    """
    n_leaves = (len(boxes) + 1) // 2
    stack = np.empty(STACK, dtype=np.int64)
    for s in range(len(frames)):
        count = 0
        stack[0], depth = 0, 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            if not _box_meets(boxes[node], frames[s], origins[s], low[s], high[s]):
                continue
            if node < n_leaves - 1:
                stack[depth], stack[depth + 1] = 2 * node + 1, 2 * node + 2
                depth += 2
                continue
            first, last = leaf_range(node, n_leaves, len(order))
            for i in range(first, last):
                m = order[i]
                if _faces(vectors[m], frames[s]) and _facet_meets(corners[m], frames[s], origins[s], low[s], high[s]):
                    if fill:
                        found[start[s] + count] = m
                    count += 1
        if not fill:
            start[s + 1] = count


@inner_kernel
def _box_meets(box, frame, origin, low, high):
    for a in range(3):
        centre, radius = 0.0, 0.0
        for c in range(3):
            centre += frame[a, c] * (0.5 * (box[c] + box[3 + c]) - origin[c])
            radius += abs(frame[a, c]) * 0.5 * (box[3 + c] - box[c])
        if centre - radius > high[a] or centre + radius < low[a]:
            return False
    return True


@inner_kernel
def _facet_meets(corners, frame, origin, low, high):
    for a in range(3):
        lowest, highest = np.inf, -np.inf
        for k in range(3):
            value = _local(corners[k], frame, origin, a)
            lowest, highest = min(lowest, value), max(highest, value)
        if lowest > high[a] or highest < low[a]:
            return False
    return True


@inner_kernel
def _faces(vector, frame):
    along, square = 0.0, 0.0
    for c in range(3):
        along += vector[c] * frame[2, c]
        square += vector[c] * vector[c]
    return along < -GRAZING * np.sqrt(square)


@kernel
def _local(point, frame, origin, a):
    result = 0.0
    for c in range(3):
        result += frame[a, c] * (point[c] - origin[c])
    return result


@kernel
def common_moments(slave, frames, origins, corners, start, found, below, above, moments):
    """Moments of the visible common parts of slave facets and the master facets found for them.

    A part is dropped if its gap, at its centroid, is outside [-below, above]. Where parts overlap, the one with the
    gap of smaller magnitude, at the centroid of the overlap, hides the other.

    Parameters
    ----------
    slave : (n_slave, 3, 3) array
        Local coordinates of the corners, counter-clockwise in the plane.
    frames, origins, corners, start, found
        As in :func:`find_opposite`; those found for a facet in the order of their lowest local x.
    below, above : float
        m.
    moments : (len(found), MOMENTS) array
        Result, local; area 0 where there is no common part.
    """
    room = 1
    for s in range(len(slave)):
        room = max(room, start[s + 1] - start[s])
    masters, parts, sizes = np.empty((room, 3, 2)), np.empty((room, ROOM, 2)), np.empty(room, dtype=np.int64)
    gaps, base, corner = np.empty((room, 3)), np.empty(3), np.empty((3, 3))
    spare, piece = np.empty((2, 2 * ROOM, 2)), np.empty((2, ROOM, 2))
    boxes, hiding = np.empty((room, 5)), np.empty(room, dtype=np.int64)
    stack, states = np.empty((ROOM * (1 + room), 3, 2)), np.empty((ROOM * (1 + room), 2), dtype=np.int64)
    for s in range(len(slave)):
        area = 0.5 * _plane(slave[s], base)
        first, n, many = start[s], start[s + 1] - start[s], 0
        for i in range(n):
            # seen from the slave a facing facet runs clockwise: turned round
            for k in range(3):
                for a in range(3):
                    corner[2 - k, a] = _local(corners[found[first + i], k], frames[s], origins[s], a)
            _plane(corner, gaps[i])
            for k in range(3):
                gaps[i, k] -= base[k]
                masters[i, k, 0], masters[i, k, 1] = corner[k, 0], corner[k, 1]
            sizes[i] = clip(masters[i], 3, slave[s], 3, parts[i], piece[0])
            polygon_moments(parts[i], sizes[i], moments[first + i])
            gap = _gap(gaps[i], moments[first + i])
            if not moments[first + i, 0] > SLIVER * area or gap > above or gap < -below:
                moments[first + i, 0] = 0.0
                sizes[i] = 0
            if sizes[i] > 0:
                many += 1
        if many > 1:
            tolerance = THIN * np.sqrt(area)
            widest = _bound(parts, sizes, masters, n, boxes)
            for i in range(n):
                n_hiding = _hiding(parts, sizes, masters, gaps, n, i, boxes, widest, tolerance, spare, hiding)
                if n_hiding > 0:
                    add_visible(parts[i], sizes[i], masters, hiding, n_hiding, tolerance, stack, states, piece,
                                moments[first + i])
                    if not moments[first + i, 0] > tolerance * tolerance:
                        moments[first + i, 0] = 0.0


@kernel
def _bound(parts, sizes, masters, n, boxes):
    """Write low x, low y, high x, high y of the parts, and low x of their masters; returns the largest width of one."""
    widest = 0.0
    for i in range(n):
        boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = np.inf, np.inf, -np.inf, -np.inf
        for k in range(sizes[i]):
            for c in range(2):
                boxes[i, c] = min(boxes[i, c], parts[i, k, c])
                boxes[i, 2 + c] = max(boxes[i, 2 + c], parts[i, k, c])
        boxes[i, 4] = min(masters[i, 0, 0], masters[i, 1, 0], masters[i, 2, 0])
        widest = max(widest, max(masters[i, 0, 0], masters[i, 1, 0], masters[i, 2, 0]) - boxes[i, 4])
    return widest


@inner_kernel
def _hiding(parts, sizes, masters, gaps, n, i, boxes, widest, tolerance, spare, hiding):
    """Write those that hide something of part i to ``hiding``; returns their number."""
    count = 0
    if sizes[i] == 0:
        return count
    for step in (-1, 1):
        j = i + step
        while 0 <= j < n and boxes[i, 0] - widest <= boxes[j, 4] < boxes[i, 2]:
            if (sizes[j] > 0 and boxes[j, 0] < boxes[i, 2] - tolerance and boxes[j, 2] > boxes[i, 0] + tolerance
                    and boxes[j, 1] < boxes[i, 3] - tolerance and boxes[j, 3] > boxes[i, 1] + tolerance
                    and _nearer(parts, sizes, masters, gaps, i, j, tolerance, spare) == j):
                hiding[count] = j
                count += 1
            j += step
    return count


@kernel
def _plane(corners, plane):
    """Write height at the origin and slope of the plane through three local points; returns twice their area."""
    x1, y1, z1 = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    x2, y2, z2 = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    double = x1 * y2 - x2 * y1
    plane[1] = (z1 * y2 - z2 * y1) / double
    plane[2] = (z2 * x1 - z1 * x2) / double
    plane[0] = corners[0, 2] - plane[1] * corners[0, 0] - plane[2] * corners[0, 1]
    return double


@inner_kernel
def _gap(plane, moments):
    """Value at the centroid."""
    return plane[0] + plane[1] * moments[1] + plane[2] * moments[2]


@inner_kernel
def _nearer(parts, sizes, masters, gaps, i, j, tolerance, spare):
    """Which of two parts is nearer where they overlap, -1 if they do not; the same for (i, j) and (j, i)."""
    a, b = min(i, j), max(i, j)
    if separated(parts[a], sizes[a], masters[b], 3, tolerance):
        return -1
    common = np.empty(MOMENTS)
    polygon_moments(spare[0], clip(parts[a], sizes[a], masters[b], 3, spare[0], spare[1]), common)
    if not common[0] > tolerance * tolerance:
        return -1
    return a if abs(_gap(gaps[a], common)) <= abs(_gap(gaps[b], common)) else b
