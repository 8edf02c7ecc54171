r"""Numba kernels of transfers in the cycle: restriction by scatter, prolongation fused with what follows it.

A nodal prolongation P acts on every component, one of dofs is taken as of nodes with one component (``zero`` tells
their number, see :mod:`adaptmg.smoother.blocks`); the transpose is applied from the same arrays.
"""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import kernel
from adaptmg.smoother.blocks import add, in_loop, inner, read, scale, subtract, write

__all__ = ["add_prolonged", "combine", "dot", "product_of_change", "restrict", "shorten", "stiff_squares", "zero_at"]

ONE = np.uint64(1)


@kernel
def zero_at(vector, positions):
    """Set entries to zero."""
    for k in range(len(positions)):
        vector[positions[k]] = 0.0


@kernel
def dot(a, b):
    """a'b, not through BLAS: its threads cost more than they gain."""
    total = 0.0
    for at in range(len(a)):
        total += a[at] * b[at]
    return total


@kernel
def stiff_squares(dim, inverse, u):
    """|D u|^2, D one over the diagonals of the inverse blocks, 0 where these are not positive."""
    total = 0.0
    for at in range(len(u)):
        i, k = at // dim, at % dim
        diagonal = inverse[(i * dim + k) * dim + k]
        if diagonal > 0.0:
            total += ((1.0 / diagonal) * u[at]) ** 2
    return total


@kernel
def product_of_change(r, new, old):
    """r'(new - old)."""
    total = 0.0
    for at in range(len(r)):
        total += r[at] * (new[at] - old[at])
    return total


@kernel
def shorten(alpha, old, new):
    """new = old + alpha (new - old)."""
    for at in range(len(old)):
        new[at] = old[at] + alpha * (new[at] - old[at])


@kernel
def restrict(zero, indptr, indices, weights, r, coarse):
    """coarse = P' r; returns r'r."""
    dim = np.uint64(len(zero))
    coarse[:] = 0.0
    squares = 0.0
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        own = read(r, dim * i, zero)
        squares += inner(own, own)
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = dim * np.uint64(indices[k])
            write(coarse, j, add(read(coarse, j, zero), scale(weights[k], own)))
    return squares


@in_loop
def _plus_prolonged(i, indptr, indices, weights, coarse, e):
    """E plus P coarse at node i."""
    for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        e = add(e, scale(weights[k], read(coarse, np.uint64(len(e)) * np.uint64(indices[k]), e)))
    return e


@kernel
def add_prolonged(zero, indptr, indices, weights, coarse, u):
    """u += P coarse."""
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        at = np.uint64(len(zero)) * i
        write(u, at, add(read(u, at, zero), _plus_prolonged(i, indptr, indices, weights, coarse, zero)))


@kernel
def combine(zero, indptr, indices, weights, coarse, u, first, second, alpha_1, alpha_2):
    """second = u + alpha_1 (first - u) + alpha_2 (second - u) + P coarse."""
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        at = np.uint64(len(zero)) * i
        e = read(u, at, zero)
        e = add(e, add(scale(alpha_1, subtract(read(first, at, zero), e)),
                       scale(alpha_2, subtract(read(second, at, zero), e))))
        write(second, at, _plus_prolonged(i, indptr, indices, weights, coarse, e))
