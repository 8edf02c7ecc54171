r"""turn, in_circle: on which side of a line, or of a circle, a point lies, right where rounding
would decide.

.. math:: \det(b - a, c - a), \qquad \det(b - d, c - d)\,(b - a)\cdot(c - a) - \det(b - a, c - a)\,(b - d)\cdot(c - d)

The second is positive where d lies inside the circle through a, b, c (counter-clockwise).
Floating-point values whose sign is beyond their error bound are returned. Others are computed again
as sums of floating-point numbers that do not overlap, without any error (J. R. Shewchuk, 1997,
doi:10.1007/PL00009321), which takes some hundred times as long. Products are split after Dekker: no
fused operations are needed, none are made (kernels compile without fastmath)."""

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
def _add_product(terms, n, factors, sign, work):
    """Add a signed product of factors, each of two terms, to the sum of n terms; returns how many
    they are then."""
    work[0, 0] = sign
    count = 1
    for f in factors:
        size = np.int64(0)
        for i in range(count):
            for value in f:
                product, error = _product(work[0, i], value)
                size = _add(work[1], _add(work[1], size, error), product)
        count = size
        for i in range(count):
            work[0, i] = work[1, i]
    for i in range(count):
        n = _add(terms, n, work[0, i])
    return n


@inner_kernel
def _exact(points, a, b, c, d):
    """Return the value of ``in_circle``, or for d < 0 of ``turn``, with the right sign: all products
    in the formulas above are added up without error, each difference as a sum of two terms."""
    terms = np.empty(8 * _TERMS)
    work = np.empty((2, _TERMS))
    factors = np.empty((4, 2))
    n = np.int64(0)
    sides = np.empty((2, 2, 2, 2))  # from a and from d to b and to c, component, terms
    for k in range(2):
        for i in range(2):
            for j in range(2):
                start = d if i == 1 and d >= 0 else a
                end = c if j == 1 else b
                sides[i, j, k, 0], sides[i, j, k, 1] = _sum(points[end, k], -points[start, k])
    for k in range(2):
        sign = 1.0 - 2.0 * k
        if d < 0:
            for t in range(2):  # whole rows would compile the text of numpy's error: a second more
                factors[0, t], factors[1, t] = sides[0, 0, k, t], sides[0, 1, 1 - k, t]
            n = _add_product(terms, n, factors[:2], sign, work)
            continue
        # det(from d) dot(from a) - det(from a) dot(from d): component k of one side and 1 - k of
        # the other make the determinant, components m of both the scalar product
        for m in range(2):
            for i in range(2):
                for t in range(2):
                    factors[0, t], factors[1, t] = sides[i, 0, k, t], sides[i, 1, 1 - k, t]
                    factors[2, t], factors[3, t] = sides[1 - i, 0, m, t], sides[1 - i, 1, m, t]
                n = _add_product(terms, n, factors, sign * (2.0 * i - 1.0), work)
    return terms[n - 1] if n > 0 else 0.0
