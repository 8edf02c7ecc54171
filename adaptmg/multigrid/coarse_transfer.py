r"""Numba kernels of transfers in the cycle: restriction by scatter, prolongation fused with what follows it.

A nodal prolongation P acts on every component, one of dofs is taken as of nodes with one component; the transpose is
applied from the same arrays.
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["add_prolonged", "combine", "dot", "product_of_change", "restrict", "shorten", "zero_at"]


@njit(cache=True)
def zero_at(vector, positions):
    """Set entries to zero."""
    for k in range(len(positions)):
        vector[positions[k]] = 0.0


@njit(cache=True)
def dot(a, b):
    """a'b, not through BLAS: its threads cost more than they gain."""
    total = 0.0
    for at in range(len(a)):
        total += a[at] * b[at]
    return total


@njit(cache=True)
def product_of_change(r, new, old):
    """r'(new - old)."""
    total = 0.0
    for at in range(len(r)):
        total += r[at] * (new[at] - old[at])
    return total


@njit(cache=True)
def shorten(alpha, old, new):
    """new = old + alpha (new - old)."""
    for at in range(len(old)):
        new[at] = old[at] + alpha * (new[at] - old[at])


@njit(cache=True)
def restrict_1d(indptr, indices, weights, r, coarse):
    """coarse = P' r; returns r'r."""
    coarse[:] = 0.0
    squares = 0.0
    for row in range(len(indptr) - 1):
        i = np.uint64(row)
        squares += r[i] * r[i]
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + np.uint64(1)])):
            coarse[np.uint64(indices[k])] += weights[k] * r[i]
    return squares


@njit(cache=True)
def add_prolonged_1d(indptr, indices, weights, coarse, u):
    """u += P coarse."""
    for row in range(len(indptr) - 1):
        i = np.uint64(row)
        e = 0.0
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + np.uint64(1)])):
            e += weights[k] * coarse[np.uint64(indices[k])]
        u[i] += e


@njit(cache=True)
def combine_1d(indptr, indices, weights, coarse, u, first, second, alpha_1, alpha_2):
    """second = u + alpha_1 (first - u) + alpha_2 (second - u) + P coarse."""
    for row in range(len(indptr) - 1):
        i = np.uint64(row)
        e = u[i] + alpha_1 * (first[i] - u[i]) + alpha_2 * (second[i] - u[i])
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + np.uint64(1)])):
            e += weights[k] * coarse[np.uint64(indices[k])]
        second[i] = e


@njit(cache=True)
def restrict_2d(indptr, indices, weights, r, coarse):
    """coarse = P' r; returns r'r."""
    coarse[:] = 0.0
    squares = 0.0
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        at = np.uint64(2) * i
        r_0, r_1 = r[at], r[at + np.uint64(1)]
        squares += r_0 * r_0 + r_1 * r_1
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + np.uint64(1)])):
            j = np.uint64(2) * np.uint64(indices[k])
            coarse[j] += weights[k] * r_0
            coarse[j + np.uint64(1)] += weights[k] * r_1
    return squares


@njit(cache=True)
def restrict_3d(indptr, indices, weights, r, coarse):
    """coarse = P' r; returns r'r."""
    coarse[:] = 0.0
    squares = 0.0
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        at = np.uint64(3) * i
        r_0, r_1, r_2 = r[at], r[at + np.uint64(1)], r[at + np.uint64(2)]
        squares += r_0 * r_0 + r_1 * r_1 + r_2 * r_2
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + np.uint64(1)])):
            j = np.uint64(3) * np.uint64(indices[k])
            coarse[j] += weights[k] * r_0
            coarse[j + np.uint64(1)] += weights[k] * r_1
            coarse[j + np.uint64(2)] += weights[k] * r_2
    return squares


@njit(cache=True)
def add_prolonged_2d(indptr, indices, weights, coarse, u):
    """u += P coarse."""
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        e_0 = 0.0
        e_1 = 0.0
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + np.uint64(1)])):
            j = np.uint64(2) * np.uint64(indices[k])
            e_0 += weights[k] * coarse[j]
            e_1 += weights[k] * coarse[j + np.uint64(1)]
        u[np.uint64(2) * i] += e_0
        u[np.uint64(2) * i + np.uint64(1)] += e_1


@njit(cache=True)
def add_prolonged_3d(indptr, indices, weights, coarse, u):
    """u += P coarse."""
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        e_0 = 0.0
        e_1 = 0.0
        e_2 = 0.0
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + np.uint64(1)])):
            j = np.uint64(3) * np.uint64(indices[k])
            e_0 += weights[k] * coarse[j]
            e_1 += weights[k] * coarse[j + np.uint64(1)]
            e_2 += weights[k] * coarse[j + np.uint64(2)]
        at = np.uint64(3) * i
        u[at] += e_0
        u[at + np.uint64(1)] += e_1
        u[at + np.uint64(2)] += e_2


@njit(cache=True)
def combine_2d(indptr, indices, weights, coarse, u, first, second, alpha_1, alpha_2):
    """second = u + alpha_1 (first - u) + alpha_2 (second - u) + P coarse."""
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        at = np.uint64(2) * i
        to = at + np.uint64(1)
        e_0, e_1 = u[at], u[to]
        e_0 += alpha_1 * (first[at] - e_0) + alpha_2 * (second[at] - e_0)
        e_1 += alpha_1 * (first[to] - e_1) + alpha_2 * (second[to] - e_1)
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + np.uint64(1)])):
            j = np.uint64(2) * np.uint64(indices[k])
            e_0 += weights[k] * coarse[j]
            e_1 += weights[k] * coarse[j + np.uint64(1)]
        second[at], second[to] = e_0, e_1


@njit(cache=True)
def combine_3d(indptr, indices, weights, coarse, u, first, second, alpha_1, alpha_2):
    """second = u + alpha_1 (first - u) + alpha_2 (second - u) + P coarse."""
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        at = np.uint64(3) * i
        m, to = at + np.uint64(1), at + np.uint64(2)
        e_0, e_1, e_2 = u[at], u[m], u[to]
        e_0 += alpha_1 * (first[at] - e_0) + alpha_2 * (second[at] - e_0)
        e_1 += alpha_1 * (first[m] - e_1) + alpha_2 * (second[m] - e_1)
        e_2 += alpha_1 * (first[to] - e_2) + alpha_2 * (second[to] - e_2)
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + np.uint64(1)])):
            j = np.uint64(3) * np.uint64(indices[k])
            e_0 += weights[k] * coarse[j]
            e_1 += weights[k] * coarse[j + np.uint64(1)]
            e_2 += weights[k] * coarse[j + np.uint64(2)]
        second[at], second[m], second[to] = e_0, e_1, e_2


restrict = {1: restrict_1d, 2: restrict_2d, 3: restrict_3d}
add_prolonged = {1: add_prolonged_1d, 2: add_prolonged_2d, 3: add_prolonged_3d}
combine = {1: combine_1d, 2: combine_2d, 3: combine_3d}
