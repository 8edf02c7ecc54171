r"""turn, in_circle: on which side of a line, or of a circle, a point lies, right where rounding
would decide.

.. math:: \det(b - a, c - a), \qquad \det(b - d, c - d)\,(b - a)\cdot(c - a) - \det(b - a, c - a)\,(b - d)\cdot(c - d)

The second is positive where d lies inside the circle through a, b, c (counter-clockwise).
Floating-point values whose sign is beyond their error bound are returned. Others are computed again as
sums of floating-point numbers that do not overlap, without any error (J. R. Shewchuk, 1997,
doi:10.1007/PL00009321), which takes some hundred times as long. Arguments a, b, c, d are rows of
``points`` (n, 2). Products are split after Dekker: no fused operations are needed, none are made
(kernels compile without fastmath)."""

from __future__ import annotations

import numpy as np

from adaptmg._numba import inner_kernel

# error bounds over the sum of the absolute terms: 4 and 10 roundings of 2^-53, and room for those
# of the bounds
_TURN, _CIRCLE = 4.6e-16, 1.3e-15
# terms of a product of four differences, each of two terms; there are eight products
_TERMS = 256


@inner_kernel
def turn(points, a, b, c):
    """Return a number that is positive where c lies to the left of the line from a to b, zero on
    it. Nodes are int64, here and below: kernels are compiled again for other integers."""
    left = (points[b, 0] - points[a, 0]) * (points[c, 1] - points[a, 1])
    right = (points[b, 1] - points[a, 1]) * (points[c, 0] - points[a, 0])
    value = left - right
    if abs(value) > _TURN * (abs(left) + abs(right)):
        return value
    return _exact(points, a, b, c, np.int64(-1))


@inner_kernel
def in_circle(points, a, b, c, d):
    """Return a number that is positive where d lies inside the circle through a, b, c, zero on
    it."""
    # (x, y) = b - a, (z, w) = c - a, (p, q) = b - d, (r, s) = c - d, in the formula above
    x = points[b, 0] - points[a, 0]
    y = points[b, 1] - points[a, 1]
    z = points[c, 0] - points[a, 0]
    w = points[c, 1] - points[a, 1]
    p = points[b, 0] - points[d, 0]
    q = points[b, 1] - points[d, 1]
    r = points[c, 0] - points[d, 0]
    s = points[c, 1] - points[d, 1]
    value = (p * s - q * r) * (x * z + y * w) - (x * w - y * z) * (p * r + q * s)
    # rounding changes the value by less than a part of the sum of its absolute terms
    x = abs(x)
    y = abs(y)
    z = abs(z)
    w = abs(w)
    p = abs(p)
    q = abs(q)
    r = abs(r)
    s = abs(s)
    if abs(value) > _CIRCLE * (
        (p * s + q * r) * (x * z + y * w) + (x * w + y * z) * (p * r + q * s)
    ):
        return value
    return _exact(points, a, b, c, d)


@inner_kernel
def _sum(a, b):
    """Return a sum, and its rounding error."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@inner_kernel
def _product(a, b):
    """Return a product, and its rounding error."""
    # 2^27 + 1: u and v become the upper halves of the 53 digits of a and b (Dekker)
    u = 134217729.0 * a
    v = 134217729.0 * b
    product = a * b
    u = u - (u - a)
    v = v - (v - b)
    return product, (a - u) * (b - v) - (((product - u * v) - (a - u) * v) - u * (b - v))


@inner_kernel
def _add(terms, n, value):
    """Add a number to the sum of n terms, which do not overlap and ascend; returns how many they
    are then."""
    # the rounding errors of the partial sums are the new terms
    m = 0
    for i in range(n):
        value, error = _sum(terms[i], value)
        if error != 0.0:
            terms[m] = error
            m += 1
    if value != 0.0:
        terms[m] = value
        m += 1
    return m


@inner_kernel
def _exact(points, a, b, c, d):
    """Return the value of ``in_circle``, or for d < 0 of ``turn``, with the right sign: all products
    in the formulas above are added up without error, each difference as a sum of two terms.

    With det_0(u, v) = u_x v_y, det_1(u, v) = u_y v_x and dot_0(u, v) = u_x v_x, dot_1(u, v) = u_y v_y
    the products for k and m = 0, 1 are

        of turn                   (1 - 2 k) det_k(b - a, c - a)
        of in_circle, from d      (1 - 2 k) det_k(b - d, c - d) dot_m(b - a, c - a)
        of in_circle, otherwise   (2 k - 1) det_k(b - a, c - a) dot_m(b - d, c - d)"""
    # each kernel that calls this one compiles it again: so arrays have one dimension, there is one loop,
    # and its bounds are unknown to the compiler, which would unroll it
    sums = np.empty(8 * _TERMS)
    old = np.empty(_TERMS)
    new = np.empty(_TERMS)
    n = np.int64(0)
    two = points.shape[1]
    of_turn = d < 0
    for product in range(two if of_turn else 4 * two):
        k = product if of_turn else product // 4
        m = product // 2 % 2
        from_d = not of_turn and product % 2 == 1
        old[0] = 1.0 - 2.0 * k if of_turn or from_d else 2.0 * k - 1.0
        count = 1
        # the factors f: (b - .)_k and (c - .)_(1 - k) of the determinant, (b - .)_m and (c - .)_m
        for f in range(two if of_turn else 2 * two):
            end = b if f % 2 == 0 else c
            start = d if from_d == (f < 2) and not of_turn else a
            component = m if f > 1 else (k if f == 0 else 1 - k)
            value, other = _sum(points[end, component], -points[start, component])
            size = np.int64(0)
            for i in range(count * two):
                rounded, error = _product(old[i // 2], value if i % 2 == 0 else other)
                size = _add(new, _add(new, size, error), rounded)
            count = size
            for i in range(count):
                old[i] = new[i]
        for i in range(count):
            n = _add(sums, n, old[i])
    return sums[n - 1] if n > 0 else 0.0
