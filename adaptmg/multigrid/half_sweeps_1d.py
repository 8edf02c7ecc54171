"""Numba kernels of the linear cycle on scalar matrices (coarse spaces that know no nodes).

The functions of :mod:`adaptmg.multigrid.half_sweeps_2d`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from adaptmg.smoother.prefetch import AHEAD, prefetch

__all__ = ["backward_change", "backward_full", "backward_kept", "forward_from_zero", "forward_full", "forward_residual",
           "minus_row", "residual"]

ONE = np.uint64(1)


@njit(cache=True, inline="always")
def minus_row(i, step, indptr, indices, data, w, r):
    """r minus row i of a half times w; ``step``, 1 or -1, the direction in which the half is read."""
    begin, end = np.int64(indptr[i]), np.int64(indptr[i + ONE])
    first = begin if step > 0 else end - np.int64(1)
    prefetch(data, begin + step * AHEAD)
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        r -= data[k] * w[np.uint64(indices[k])]
    return r


@njit(cache=True)
def forward_from_zero(l_indptr, l_indices, lower, inverse, load, u, kept):
    """u = (L + D)^-1 f, kept = f - L u."""
    for row in range(len(l_indptr) - 1):
        i = np.uint64(row)
        kept[i] = minus_row(i, 1, l_indptr, l_indices, lower, u, load[i])
        u[i] = inverse[i] * kept[i]


@njit(cache=True)
def forward_residual(u_indptr, u_indices, upper, u, result):
    """The residual after :func:`forward_from_zero`: minus U times u."""
    for row in range(len(u_indptr) - 1):
        i = np.uint64(row)
        result[i] = minus_row(i, 1, u_indptr, u_indices, upper, u, 0.0)


@njit(cache=True)
def backward_change(u_indptr, u_indices, upper, inverse, u, kept):
    """Backward sweep that takes f - L u from ``kept`` and leaves the change of u there."""
    for row in range(len(u_indptr) - 2, -1, -1):
        i = np.uint64(row)
        new = inverse[i] * minus_row(i, -1, u_indptr, u_indices, upper, u, kept[i])
        kept[i] = new - u[i]
        u[i] = new


@njit(cache=True)
def residual(l_indptr, l_indices, lower, kept):
    """The residual after :func:`backward_change`, minus L times the change, in place of the change."""
    for row in range(len(l_indptr) - 2, -1, -1):
        i = np.uint64(row)
        kept[i] = minus_row(i, -1, l_indptr, l_indices, lower, kept, 0.0)


@njit(cache=True)
def forward_full(l_indptr, l_indices, lower, u_indptr, u_indices, upper, inverse, load, u, kept):
    """Forward sweep from any u, kept = f - L u."""
    for row in range(len(l_indptr) - 1):
        i = np.uint64(row)
        kept[i] = minus_row(i, 1, l_indptr, l_indices, lower, u, load[i])
        u[i] = inverse[i] * minus_row(i, 1, u_indptr, u_indices, upper, u, kept[i])


@njit(cache=True)
def backward_kept(u_indptr, u_indices, upper, inverse, u, kept):
    """Backward sweep that takes f - L u from ``kept``."""
    for row in range(len(u_indptr) - 2, -1, -1):
        i = np.uint64(row)
        u[i] = inverse[i] * minus_row(i, -1, u_indptr, u_indices, upper, u, kept[i])


@njit(cache=True)
def backward_full(l_indptr, l_indices, lower, u_indptr, u_indices, upper, inverse, load, u):
    """Backward sweep from any u."""
    for row in range(len(l_indptr) - 2, -1, -1):
        i = np.uint64(row)
        r = minus_row(i, -1, u_indptr, u_indices, upper, u, load[i])
        u[i] = inverse[i] * minus_row(i, -1, l_indptr, l_indices, lower, u, r)
