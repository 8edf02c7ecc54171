r"""Better tetrahedra: inner nodes moved, those of boundaries stay.

A node p goes to the minimum of the sum over its tetrahedra of

.. math:: \frac{\sum_{edges} l^2}{12\,(3 V)^{2/3}} ,

1 for a regular one of any size, so that grading stays. Squares over a power of at most 1 of a linear function are
convex where volumes are positive: one Newton step is taken, halved until the sum falls.
"""

from __future__ import annotations

import numpy as np

from adaptmg.mesh.netgen.finish.around import cells_around
from adaptmg.runtime.compiled import inner_kernel, kernel

__all__ = ["moved_tetrahedra"]

#: volume that a step leaves, of that before, at least
_KEPT = 0.1


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
def _move(points, cells, start, items, held, kept):
    """Move each node that is not ``held`` once, in place; ``start``, ``items`` as :func:`cells_around` has them."""
    x, y, step = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(points)):
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
    """Places of the nodes after some rounds.

    Parameters
    ----------
    points : (n_nodes, 3) array
        m.
    elements : (n, 4) int32 array
        Positively oriented.
    held : (n_nodes,) bool array
        Nodes that stay.
    rounds : int

    Returns
    -------
    (n_nodes, 3) array
        m.
    """
    result = np.array(points)
    start, items = cells_around(elements, len(points))
    for _ in range(rounds):
        _move(result, elements, start, items, held, _KEPT)
    return result
