r"""Intersections of simplices in barycentric coordinates and of convex polygons in a plane, with
moments (kernels).

A fine element is cut by the d + 1 half-spaces :math:`\mu_m \ge 0` of a coarse one (:math:`\mu` its
barycentric coordinates) by bisecting edges: while a piece has a corner a with :math:`\mu_m > 0` and
one b with
:math:`\mu_m < 0`, it is split at the point of the edge ab where :math:`\mu_m = 0`, into pieces with the fractions t and
1 - t of its volume. What is left consists of simplices on which all shape functions are affine, so
that with V the volume of a piece

.. math:: \int \lambda_i \lambda_j = \frac{V}{(d+1)(d+2)} \Big(\sum_v \lambda_i(v)\lambda_j(v)
          + \sum_v \lambda_i(v) \sum_v \lambda_j(v)\Big)

is exact. There are no topological cases, and a sliver only makes a piece of small volume.

A polygon is an array (room, 2) of which the first n rows are its corners, counter-clockwise; of a
``window`` m are. Kernels take the ends a and b of a line as ``ax``, ``ay``, ``bx``, ``by``.
Half-planes are taken off one by one (Sutherland and Hodgman 1974, doi:10.1145/360767.360802); the
point where an edge crosses a line is computed only between corners strictly on different sides, so
that coincident edges need no tolerance. Moments are area A, centroid c and covariance :math:`S =
\frac1A \int (x - c)(x - c)^T`, so that those of a small polygon far from the origin lose no digits;
they are merged from triangles, whose negative areas (rounding) count as zero."""

from __future__ import annotations

import numpy as np

from adaptmg import _checks as checks
from adaptmg._numba import inner_kernel, kernel

PIECES = 32
"""Room for pieces on the stack. A half-space splits a tetrahedron along a path of at most 3 bisections, which leave one
piece waiting each: 4 half-spaces need 13."""

SNAP = checks.ROUNDING
"""Barycentric coordinates smaller than this count as zero."""


@kernel
def common_moments(mu, k, pieces, levels, moments):
    """Write the integrals of the products lambda_i lambda_j of fine shape functions over the intersection
    of a fine and a coarse element with k corners each, divided by the measure of the fine one, into
    ``moments`` (k, k); returns the fraction of the fine element that the intersection is.

    ``mu`` (k, k): coarse barycentric coordinates mu[v, m] of the fine corner v. ``pieces`` is a
    stack; a row holds the fraction of the fine element, then for each corner of the piece the k
    fine coordinates lambda, then for each the k coarse ones. ``levels``: how many of the
    half-spaces mu_m >= 0 the piece is known to lie in."""
    kk = k * k
    moments[:] = 0.0
    pieces[0, 0] = 1.0
    for v in range(k):
        for m in range(k):
            pieces[0, 1 + v * k + m] = 1.0 if v == m else 0.0
            pieces[0, 1 + kk + v * k + m] = mu[v, m]
    levels[0] = 0
    depth = 1
    covered = 0.0
    while depth > 0:  # drops a piece, raises its level, or moves one more corner onto a plane
        top = depth - 1
        m = levels[top]
        if m == k:
            covered += pieces[top, 0]
            _add_moments(pieces, top, k, moments)
            depth -= 1
            continue
        # corners strictly on the two sides of the plane mu_m = 0
        inner = -1
        outer = -1
        n_inner = 0
        for v in range(k):
            value = pieces[top, 1 + kk + v * k + m]
            if value > 0.0:
                inner = v
                n_inner += 1
            elif value < 0.0:
                outer = v
        if n_inner == 0:
            depth -= 1
        elif outer < 0:
            levels[top] = m + 1
        else:
            if n_inner > 1:
                # the half that keeps the outer corner still has an inner one
                for c in range(1 + 2 * kk):
                    pieces[depth, c] = pieces[top, c]
                levels[depth] = m
                _cut(pieces, depth, inner, outer, m, k)
                depth += 1
            _cut(pieces, top, outer, inner, m, k)
    return covered


@kernel
def _cut(pieces, at, moved, kept, m, k):
    """Move the corner ``moved`` of a piece along the edge towards the corner ``kept`` to where mu_m = 0: to
    (1 - t) kept + t moved with t = b / (b - a), of mu_m = a at ``moved`` and b at ``kept``. The
    piece, of k corners, keeps the fraction t of its volume; it is row ``at`` of ``pieces``, as
    :func:`common_moments` has them."""
    kk = k * k
    first = 1 + moved * k
    second = 1 + kept * k
    a = pieces[at, kk + first + m]
    b = pieces[at, kk + second + m]
    t = b / (b - a)
    for c in range(k):
        pieces[at, first + c] = (1.0 - t) * pieces[at, second + c] + t * pieces[at, first + c]
        pieces[at, kk + first + c] = (1.0 - t) * pieces[at, kk + second + c] + t * pieces[
            at, kk + first + c
        ]
    # exactly on the plane, or rounding would have it cut again
    pieces[at, kk + first + m] = 0.0
    pieces[at, 0] *= t


@inner_kernel
def _add_moments(pieces, at, k, moments):
    """Add the integrals of lambda_i lambda_j over a piece (module docstring; V is its fraction of the
    fine element) to ``moments`` (k, k); it is row ``at`` of ``pieces``, as :func:`common_moments` has
    them."""
    scale = pieces[at, 0] / (k * (k + 1))
    for i in range(k):
        sum_i = 0.0
        for v in range(k):
            sum_i += pieces[at, 1 + v * k + i]
        for j in range(i + 1):
            product = 0.0
            sum_j = 0.0
            for v in range(k):
                product += pieces[at, 1 + v * k + i] * pieces[at, 1 + v * k + j]
                sum_j += pieces[at, 1 + v * k + j]
            moments[i, j] += scale * (product + sum_i * sum_j)
            if i != j:
                moments[j, i] = moments[i, j]


ROOM = 12
"""Room for the corners of a triangle cut by another one: 6, more where rounding bends edges; the rest is for safety."""

MOMENTS = 6
"""Area, centroid (2), covariance xx, xy, yy."""


@kernel
def _side(polygon, i, ax, ay, bx, by):
    """Return twice the area of the triangle of a, b and corner i: positive to the left of the line from
    a to b."""
    return (bx - ax) * (polygon[i, 1] - ay) - (by - ay) * (polygon[i, 0] - ax)


@inner_kernel
def keep_left(polygon, n, ax, ay, bx, by, out):
    """Write the part of a polygon to the left of the line from a to b to ``out``; returns its
    number of corners. Corners beyond the room of ``out`` are dropped: only rounding makes more, on
    an edge along the line."""
    corners = 0
    room = len(out)
    if n == 0:
        return corners
    last = n - 1
    side_last = _side(polygon, last, ax, ay, bx, by)
    for i in range(n):
        side = _side(polygon, i, ax, ay, bx, by)
        if corners < room and (
            (side > 0.0 and side_last < 0.0) or (side < 0.0 and side_last > 0.0)
        ):
            # the edge crosses the line
            t = side_last / (side_last - side)
            for c in range(2):
                out[corners, c] = (1.0 - t) * polygon[last, c] + t * polygon[i, c]
            corners += 1
        if corners < room and side >= 0.0:
            out[corners, 0], out[corners, 1] = polygon[i, 0], polygon[i, 1]
            corners += 1
        last = i
        side_last = side
    return corners


@kernel
def clip(polygon, n, window, m, out, spare):
    """Write the intersection of a polygon with n corners and a convex one (``window``) with m to
    ``out``; returns its number of corners, 0 if it has no area. ``spare`` is scratch."""
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
    """Return whether ``polygon`` lies to the right of an edge of ``window``, but for a strip as
    wide as ``tolerance``."""
    for i in range(m):
        j = i + 1 if i + 1 < m else 0
        ax = window[i, 0]
        ay = window[i, 1]
        bx = window[j, 0]
        by = window[j, 1]
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
    """Return whether an axis, or an edge of one of two polygons, separates them, but for a strip as wide
    as ``tolerance``."""
    for c in range(2):  # axes first: they part most polygons
        low = np.inf
        high = -np.inf
        window_low = np.inf
        window_high = -np.inf
        for i in range(n):
            low = min(low, polygon[i, c])
            high = max(high, polygon[i, c])
        for i in range(m):
            window_low = min(window_low, window[i, c])
            window_high = max(window_high, window[i, c])
        if low >= window_high - tolerance or window_low >= high - tolerance:
            return True
    return _separated_by_edge(polygon, n, window, m, tolerance) or _separated_by_edge(
        window, m, polygon, n, tolerance
    )


@inner_kernel
def _add_triangle(moments, polygon, i, j, k):
    """Merge the moments of the triangle of three corners into ``moments`` (MOMENTS,): area A,
    centroid c and covariance S.

    With the share s of the triangle of the whole area, and the difference d of the centroids: c + s
    d and (1 - s) S + s S_triangle + s (1 - s) d d'."""
    area = 0.5 * _side(polygon, k, polygon[i, 0], polygon[i, 1], polygon[j, 0], polygon[j, 1])
    if not area > 0.0:
        return
    x = (polygon[i, 0] + polygon[j, 0] + polygon[k, 0]) / 3.0
    y = (polygon[i, 1] + polygon[j, 1] + polygon[k, 1]) / 3.0
    xx = 0.0
    xy = 0.0
    yy = 0.0
    for corner in (i, j, k):
        dx = polygon[corner, 0] - x
        dy = polygon[corner, 1] - y
        xx += dx * dx / 12.0
        xy += dx * dy / 12.0
        yy += dy * dy / 12.0
    total = moments[0] + area
    share = area / total
    dx = x - moments[1]
    dy = y - moments[2]
    rest = share * (1.0 - share)
    moments[0] = total
    moments[1] += share * dx
    moments[2] += share * dy
    moments[3] += share * (xx - moments[3]) + rest * dx * dx
    moments[4] += share * (xy - moments[4]) + rest * dx * dy
    moments[5] += share * (yy - moments[5]) + rest * dy * dy


@kernel
def polygon_moments(polygon, n, moments):
    """Write the moments of a polygon to ``moments`` (MOMENTS,): area, centroid, covariance."""
    for c in range(MOMENTS):
        moments[c] = 0.0
    for i in range(1, n - 1):
        _add_triangle(moments, polygon, 0, i, i + 1)


@kernel
def add_visible(polygon, n, blockers, hiding, n_hiding, tolerance, stack, states, piece, moments):
    """Add the moments of what is left of a polygon when triangles hide parts of it: of ``blockers``
    (n, 3, 2) those with the numbers ``hiding[:n_hiding]``. Its triangles are cut along the edges of one
    blocker after the other, depth first: what lies outside an edge goes on to the next blocker, what
    lies inside all of them is hidden. ``stack`` (room, 3, 2) of triangles, ``states`` (room, 2) of them
    and ``piece`` (2, room, 2) are scratch."""
    for c in range(MOMENTS):
        moments[c] = 0.0
    depth = _push(polygon, n, 0, 0, stack, states, 0)
    while depth > 0:  # at most four pieces follow one, each with a later (blocker, edge)
        # a triangle inside the first ``edge`` edges of blocker ``at``, and outside those before
        depth -= 1
        at = states[depth, 0]
        edge = states[depth, 1]
        if at == n_hiding:
            _add_triangle(moments, stack[depth], 0, 1, 2)
            continue
        blocker = blockers[hiding[at]]
        if edge == 0 and separated(stack[depth], 3, blocker, 3, tolerance):
            states[depth, 0] = at + 1
            depth += 1
            continue
        if edge == 3:  # hidden
            continue
        end = edge + 1 if edge < 2 else 0
        ax = blocker[edge, 0]
        ay = blocker[edge, 1]
        bx = blocker[end, 0]
        by = blocker[end, 1]
        inside = keep_left(stack[depth], 3, ax, ay, bx, by, piece[0])
        outside = keep_left(stack[depth], 3, bx, by, ax, ay, piece[1])
        depth = _push(piece[0], inside, at, edge + 1, stack, states, depth)
        depth = _push(piece[1], outside, at + 1, 0, stack, states, depth)


@inner_kernel
def _push(polygon, n, at, edge, stack, states, depth):
    """Put the fan of triangles that makes a polygon on the stack, with their state: the place ``at`` of the
    next blocker, and the first ``edge`` of it that they have not been cut along. Returns the new depth."""
    for i in range(1, n - 1):
        for c in range(2):
            stack[depth, 0, c] = polygon[0, c]
            stack[depth, 1, c] = polygon[i, c]
            stack[depth, 2, c] = polygon[i + 1, c]
        states[depth, 0] = at
        states[depth, 1] = edge
        depth += 1
    return depth
