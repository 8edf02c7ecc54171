r"""Numba kernels of the linear cycle in 2D: Gauss-Seidel in half passes, on :class:`~adaptmg.multigrid.halves.Halves`.

For :math:`(L + D + U)\,u = f`, not necessarily symmetric. From zero: forward (L), keeping :math:`s = f - L u`; backward
(U), keeping the change :math:`\delta`; then the residual is :math:`-L\delta` (L). After the coarse correction: forward
(L and U), keeping s; backward (U). Two symmetric sweeps and a residual in three passes.
Arguments in the order of the function: indptr, indices, data of a half; ``inverse`` of the diagonal blocks.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from adaptmg.smoother.prefetch import AHEAD, prefetch

__all__ = ["backward_change", "backward_full", "backward_kept", "forward_from_zero", "forward_full", "forward_residual",
           "minus_row", "minus_transposed_row", "residual"]

ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)


@njit(cache=True, inline="always")
def minus_row(i, step, indptr, indices, data, w, r_0, r_1):
    """(r_0, r_1) minus row i of a half times w; ``step``, 1 or -1, the direction in which the half is read."""
    begin, end = np.int64(indptr[i]), np.int64(indptr[i + ONE])
    ahead = np.int64(4) * begin + step * AHEAD
    prefetch(data, ahead)
    prefetch(data, ahead + np.int64(8))
    first = begin if step > 0 else end - np.int64(1)
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        block, j = FOUR * k, TWO * np.uint64(indices[k])
        w_0, w_1 = w[j], w[j + ONE]
        r_0 -= data[block] * w_0 + data[block + ONE] * w_1
        r_1 -= data[block + TWO] * w_0 + data[block + THREE] * w_1
    return r_0, r_1


@njit(cache=True, inline="always")
def minus_transposed_row(i, step, indptr, indices, data, d_0, d_1, w):
    """W minus the transpose of row i of a half times (d_0, d_1), in place."""
    begin, end = np.int64(indptr[i]), np.int64(indptr[i + ONE])
    first = begin if step > 0 else end - np.int64(1)
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        block, j = FOUR * k, TWO * np.uint64(indices[k])
        # all is read before anything is written: the compiler cannot know that w is none of the other arrays
        a_00, a_01, a_10, a_11 = data[block], data[block + ONE], data[block + TWO], data[block + THREE]
        w_0, w_1 = w[j], w[j + ONE]
        w[j] = w_0 - (a_00 * d_0 + a_10 * d_1)
        w[j + ONE] = w_1 - (a_01 * d_0 + a_11 * d_1)


@njit(cache=True)
def forward_from_zero(l_indptr, l_indices, lower, inverse, load, u, kept):
    """u = (L + D)^-1 f, kept = f - L u."""
    for node in range(len(l_indptr) - 1):
        i = np.uint64(node)
        at, block = TWO * i, FOUR * i
        r_0, r_1 = minus_row(i, 1, l_indptr, l_indices, lower, u, load[at], load[at + ONE])
        kept[at], kept[at + ONE] = r_0, r_1
        u[at] = inverse[block] * r_0 + inverse[block + ONE] * r_1
        u[at + ONE] = inverse[block + TWO] * r_0 + inverse[block + THREE] * r_1


@njit(cache=True)
def backward_change(u_indptr, u_indices, upper, inverse, u, kept):
    """Backward sweep that takes f - L u from ``kept`` and leaves the change of u there."""
    for node in range(len(u_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at, block = TWO * i, FOUR * i
        r_0, r_1 = minus_row(i, -1, u_indptr, u_indices, upper, u, kept[at], kept[at + ONE])
        new_0 = inverse[block] * r_0 + inverse[block + ONE] * r_1
        new_1 = inverse[block + TWO] * r_0 + inverse[block + THREE] * r_1
        kept[at], kept[at + ONE] = new_0 - u[at], new_1 - u[at + ONE]
        u[at], u[at + ONE] = new_0, new_1


@njit(cache=True)
def residual(l_indptr, l_indices, lower, kept):
    """The residual after :func:`backward_change`, minus L times the change, in place of the change."""
    for node in range(len(l_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at = TWO * i
        kept[at], kept[at + ONE] = minus_row(i, -1, l_indptr, l_indices, lower, kept, 0.0, 0.0)


@njit(cache=True)
def forward_full(l_indptr, l_indices, lower, u_indptr, u_indices, upper, inverse, load, u, kept):
    """Forward sweep from any u, kept = f - L u."""
    for node in range(len(l_indptr) - 1):
        i = np.uint64(node)
        at, block = TWO * i, FOUR * i
        r_0, r_1 = minus_row(i, 1, l_indptr, l_indices, lower, u, load[at], load[at + ONE])
        kept[at], kept[at + ONE] = r_0, r_1
        r_0, r_1 = minus_row(i, 1, u_indptr, u_indices, upper, u, r_0, r_1)
        u[at] = inverse[block] * r_0 + inverse[block + ONE] * r_1
        u[at + ONE] = inverse[block + TWO] * r_0 + inverse[block + THREE] * r_1


@njit(cache=True)
def backward_kept(u_indptr, u_indices, upper, inverse, u, kept):
    """Backward sweep that takes f - L u from ``kept``."""
    for node in range(len(u_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at, block = TWO * i, FOUR * i
        r_0, r_1 = minus_row(i, -1, u_indptr, u_indices, upper, u, kept[at], kept[at + ONE])
        u[at] = inverse[block] * r_0 + inverse[block + ONE] * r_1
        u[at + ONE] = inverse[block + TWO] * r_0 + inverse[block + THREE] * r_1


@njit(cache=True)
def forward_residual(u_indptr, u_indices, upper, u, result):
    """The residual after :func:`forward_from_zero`: minus U times u."""
    for node in range(len(u_indptr) - 1):
        i = np.uint64(node)
        at = TWO * i
        result[at], result[at + ONE] = minus_row(i, 1, u_indptr, u_indices, upper, u, 0.0, 0.0)


@njit(cache=True)
def backward_full(l_indptr, l_indices, lower, u_indptr, u_indices, upper, inverse, load, u):
    """Backward sweep from any u."""
    for node in range(len(l_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at, block = TWO * i, FOUR * i
        r_0, r_1 = minus_row(i, -1, u_indptr, u_indices, upper, u, load[at], load[at + ONE])
        r_0, r_1 = minus_row(i, -1, l_indptr, l_indices, lower, u, r_0, r_1)
        u[at] = inverse[block] * r_0 + inverse[block + ONE] * r_1
        u[at + ONE] = inverse[block + TWO] * r_0 + inverse[block + THREE] * r_1
