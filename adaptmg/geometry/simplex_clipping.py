r"""Intersection of simplices and the moments of shape functions over it (kernels, 2D and 3D alike).

A fine element is cut by the d + 1 half-spaces :math:`\mu_m \ge 0` of a coarse one (:math:`\mu` its barycentric
coordinates) by bisecting edges: while a piece has a corner a with :math:`\mu_m > 0` and one b with
:math:`\mu_m < 0`, it is split at the point of the edge ab where :math:`\mu_m = 0`, into pieces with the fractions t and
1 - t of its volume. What is left consists of simplices on which all shape functions are affine, so that with V the
volume of a piece

.. math:: \int \lambda_i \lambda_j = \frac{V}{(d+1)(d+2)} \Big(\sum_v \lambda_i(v)\lambda_j(v)
          + \sum_v \lambda_i(v) \sum_v \lambda_j(v)\Big)

is exact. No topological case is told apart, and a sliver only makes a piece of small volume.
"""

from __future__ import annotations

from adaptmg.runtime.compiled import inner_kernel, kernel

__all__ = ["PIECES", "SNAP", "common_moments"]

PIECES = 32
"""Room for pieces on the stack. A half-space splits a tetrahedron along a path of at most 3 bisections, which leave one
piece waiting each: 4 half-spaces need 13."""

SNAP = 1e-13
"""Barycentric coordinates smaller than this count as zero."""


@kernel
def common_moments(mu, k, pieces, levels, moments):
    """Moments of the fine shape functions over the intersection of a fine and a coarse element.

    Parameters
    ----------
    mu : (k, k) array
        Coarse barycentric coordinate m of the fine corner v at [v, m], snapped.
    k : int
        dim + 1.
    pieces : (PIECES, 1 + 2 k k) array
        Scratch: a piece is its volume fraction, and fine and coarse barycentric coordinates of its corners.
    levels : (PIECES,) int array
        Scratch: the half-space to cut a piece by next.
    moments : (k, k) array
        Result: the integrals of lambda_i lambda_j over the intersection, for a fine element of volume 1.

    Returns
    -------
    float
        Volume of the intersection over that of the fine element.
    """
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
    while depth > 0:
        top = depth - 1
        m = levels[top]
        if m == k:
            covered += pieces[top, 0]
            _add_moments(pieces, top, k, moments)
            depth -= 1
            continue
        inner, outer, n_inner = -1, -1, 0
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
    """Move a corner of a piece along the edge towards the corner ``kept`` to where mu_m = 0."""
    kk = k * k
    first, second = 1 + moved * k, 1 + kept * k
    a, b = pieces[at, kk + first + m], pieces[at, kk + second + m]
    t = b / (b - a)
    for c in range(k):
        pieces[at, first + c] = (1.0 - t) * pieces[at, second + c] + t * pieces[at, first + c]
        pieces[at, kk + first + c] = (1.0 - t) * pieces[at, kk + second + c] + t * pieces[at, kk + first + c]
    # exactly on the plane, or rounding would have it cut again
    pieces[at, kk + first + m] = 0.0
    pieces[at, 0] *= t


@inner_kernel
def _add_moments(pieces, at, k, moments):
    scale = pieces[at, 0] / (k * (k + 1))
    for i in range(k):
        sum_i = 0.0
        for v in range(k):
            sum_i += pieces[at, 1 + v * k + i]
        for j in range(i + 1):
            product, sum_j = 0.0, 0.0
            for v in range(k):
                product += pieces[at, 1 + v * k + i] * pieces[at, 1 + v * k + j]
                sum_j += pieces[at, 1 + v * k + j]
            moments[i, j] += scale * (product + sum_i * sum_j)
            if i != j:
                moments[j, i] = moments[i, j]
