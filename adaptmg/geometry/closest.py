r"""Closest point of a segment, triangle or tetrahedron, as barycentric weights (kernels).

The weights are >= 0 and sum to 1; the closest point is their combination of the corners. The triangle goes through
its Voronoi regions (Ericson, Real-Time Collision Detection, 2005, section 5.1.5); the tetrahedron is the closest of
its four faces (callers test for points inside before).

All kernels read corners from ``points`` (n, 3) (2D is padded with z = 0), write the weights and return the squared
distance, m^2.
"""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import inner_kernel

__all__ = ["closest_on_simplex"]


@inner_kernel
def _difference_dot(points, a, b, c, d):
    """(x_b - x_a) . (x_d - x_c)."""
    total = 0.0
    for m in range(3):
        total += (points[b, m] - points[a, m]) * (points[d, m] - points[c, m])
    return total


@inner_kernel
def _dot_from(points, a, b, x, c):
    """(x_b - x_a) . (x - x_c)."""
    total = 0.0
    for m in range(3):
        total += (points[b, m] - points[a, m]) * (x[m] - points[c, m])
    return total


@inner_kernel
def _on_segment(points, a, b, x):
    """Weight of b in the point of the segment (a, b) closest to x."""
    length = _difference_dot(points, a, b, a, b)
    if length == 0.0:
        return 0.0
    return min(max(_dot_from(points, a, b, x, a) / length, 0.0), 1.0)


@inner_kernel
def _on_triangle(points, a, b, c, x):
    """Weights of b and c in the point of the triangle (a, b, c) closest to x."""
    d1, d2 = _dot_from(points, a, b, x, a), _dot_from(points, a, c, x, a)
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0
    d3, d4 = _dot_from(points, a, b, x, b), _dot_from(points, a, c, x, b)
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return _on_segment(points, a, b, x), 0.0
    d5, d6 = _dot_from(points, a, b, x, c), _dot_from(points, a, c, x, c)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, _on_segment(points, a, c, x)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = _on_segment(points, b, c, x)
        return 1.0 - t, t
    total = va + vb + vc
    return vb / total, vc / total


@inner_kernel
def _squared_distance(points, corners, weights, x):
    total = 0.0
    for m in range(3):
        difference = x[m]
        for k in range(len(corners)):
            difference -= weights[k] * points[corners[k], m]
        total += difference * difference
    return total


@inner_kernel
def closest_on_simplex(points, corners, x, weights, trial):
    """Weights (k,) of the point of the simplex ``corners`` (k,), k = 2, 3, 4, closest to ``x`` (3,).

    ``trial`` (k,) is scratch. Returns the squared distance.
    """
    k = len(corners)
    if k == 2:
        weights[1] = _on_segment(points, corners[0], corners[1], x)
        weights[0] = 1.0 - weights[1]
        return _squared_distance(points, corners, weights, x)
    if k == 3:
        weights[1], weights[2] = _on_triangle(points, corners[0], corners[1], corners[2], x)
        weights[0] = max(1.0 - weights[1] - weights[2], 0.0)
        return _squared_distance(points, corners, weights, x)
    best = np.inf
    for opposite in range(4):
        a, b, c = (opposite + 1) % 4, (opposite + 2) % 4, (opposite + 3) % 4
        wb, wc = _on_triangle(points, corners[a], corners[b], corners[c], x)
        trial[opposite] = 0.0
        trial[a], trial[b], trial[c] = max(1.0 - wb - wc, 0.0), wb, wc
        distance = _squared_distance(points, corners, trial, x)
        if distance < best:
            best = distance
            for m in range(4):
                weights[m] = trial[m]
    return best
