"""Numba kernels of the linear cycle in 3D; see :mod:`adaptmg.multigrid.half_sweeps_2d`: the same functions."""

from __future__ import annotations

import numpy as np
from numba import njit

from adaptmg.smoother.prefetch import AHEAD, prefetch

__all__ = ["backward_change", "backward_full", "backward_kept", "forward_from_zero", "forward_full", "forward_residual",
           "minus_row", "minus_transposed_row", "residual", "times_block"]

ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
FIVE, SIX, SEVEN, EIGHT, NINE = np.uint64(5), np.uint64(6), np.uint64(7), np.uint64(8), np.uint64(9)


@njit(cache=True, inline="always")
def minus_row(i, step, indptr, indices, data, w, r_0, r_1, r_2):
    """(r_0, r_1, r_2) minus row i of a half times w; ``step``, 1 or -1, the direction in which the half is read."""
    begin, end = np.int64(indptr[i]), np.int64(indptr[i + ONE])
    first = begin if step > 0 else end - np.int64(1)
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        prefetch(data, np.int64(NINE * k) + step * AHEAD)
        block, j = NINE * k, THREE * np.uint64(indices[k])
        w_0, w_1, w_2 = w[j], w[j + ONE], w[j + TWO]
        r_0 -= data[block] * w_0 + data[block + ONE] * w_1 + data[block + TWO] * w_2
        r_1 -= data[block + THREE] * w_0 + data[block + FOUR] * w_1 + data[block + FIVE] * w_2
        r_2 -= data[block + SIX] * w_0 + data[block + SEVEN] * w_1 + data[block + EIGHT] * w_2
    return r_0, r_1, r_2


@njit(cache=True, inline="always")
def minus_transposed_row(i, step, indptr, indices, data, d_0, d_1, d_2, w):
    """W minus the transpose of row i of a half times (d_0, d_1, d_2), in place."""
    begin, end = np.int64(indptr[i]), np.int64(indptr[i + ONE])
    first = begin if step > 0 else end - np.int64(1)
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        block, j = NINE * k, THREE * np.uint64(indices[k])
        # all is read before anything is written: the compiler cannot know that w is none of the other arrays
        a_00, a_01, a_02 = data[block], data[block + ONE], data[block + TWO]
        a_10, a_11, a_12 = data[block + THREE], data[block + FOUR], data[block + FIVE]
        a_20, a_21, a_22 = data[block + SIX], data[block + SEVEN], data[block + EIGHT]
        w_0, w_1, w_2 = w[j], w[j + ONE], w[j + TWO]
        w[j] = w_0 - (a_00 * d_0 + a_10 * d_1 + a_20 * d_2)
        w[j + ONE] = w_1 - (a_01 * d_0 + a_11 * d_1 + a_21 * d_2)
        w[j + TWO] = w_2 - (a_02 * d_0 + a_12 * d_1 + a_22 * d_2)


@njit(cache=True, inline="always")
def times_block(i, blocks, r_0, r_1, r_2):
    """Block i of ``blocks`` times (r_0, r_1, r_2)."""
    b = NINE * i
    return (blocks[b] * r_0 + blocks[b + ONE] * r_1 + blocks[b + TWO] * r_2,
            blocks[b + THREE] * r_0 + blocks[b + FOUR] * r_1 + blocks[b + FIVE] * r_2,
            blocks[b + SIX] * r_0 + blocks[b + SEVEN] * r_1 + blocks[b + EIGHT] * r_2)


@njit(cache=True)
def forward_from_zero(l_indptr, l_indices, lower, inverse, load, u, kept):
    """u = (L + D)^-1 f, kept = f - L u."""
    for node in range(len(l_indptr) - 1):
        i = np.uint64(node)
        at = THREE * i
        r_0, r_1, r_2 = minus_row(i, 1, l_indptr, l_indices, lower, u, load[at], load[at + ONE], load[at + TWO])
        kept[at], kept[at + ONE], kept[at + TWO] = r_0, r_1, r_2
        u[at], u[at + ONE], u[at + TWO] = times_block(i, inverse, r_0, r_1, r_2)


@njit(cache=True)
def backward_change(u_indptr, u_indices, upper, inverse, u, kept):
    """Backward sweep that takes f - L u from ``kept`` and leaves the change of u there."""
    for node in range(len(u_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at = THREE * i
        r_0, r_1, r_2 = minus_row(i, -1, u_indptr, u_indices, upper, u, kept[at], kept[at + ONE], kept[at + TWO])
        new_0, new_1, new_2 = times_block(i, inverse, r_0, r_1, r_2)
        kept[at], kept[at + ONE], kept[at + TWO] = new_0 - u[at], new_1 - u[at + ONE], new_2 - u[at + TWO]
        u[at], u[at + ONE], u[at + TWO] = new_0, new_1, new_2


@njit(cache=True)
def residual(l_indptr, l_indices, lower, kept):
    """The residual after :func:`backward_change`, minus L times the change, in place of the change."""
    for node in range(len(l_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at = THREE * i
        kept[at], kept[at + ONE], kept[at + TWO] = minus_row(i, -1, l_indptr, l_indices, lower, kept, 0.0, 0.0, 0.0)


@njit(cache=True)
def forward_full(l_indptr, l_indices, lower, u_indptr, u_indices, upper, inverse, load, u, kept):
    """Forward sweep from any u, kept = f - L u."""
    for node in range(len(l_indptr) - 1):
        i = np.uint64(node)
        at = THREE * i
        r_0, r_1, r_2 = minus_row(i, 1, l_indptr, l_indices, lower, u, load[at], load[at + ONE], load[at + TWO])
        kept[at], kept[at + ONE], kept[at + TWO] = r_0, r_1, r_2
        r_0, r_1, r_2 = minus_row(i, 1, u_indptr, u_indices, upper, u, r_0, r_1, r_2)
        u[at], u[at + ONE], u[at + TWO] = times_block(i, inverse, r_0, r_1, r_2)


@njit(cache=True)
def backward_kept(u_indptr, u_indices, upper, inverse, u, kept):
    """Backward sweep that takes f - L u from ``kept``."""
    for node in range(len(u_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at = THREE * i
        r_0, r_1, r_2 = minus_row(i, -1, u_indptr, u_indices, upper, u, kept[at], kept[at + ONE], kept[at + TWO])
        u[at], u[at + ONE], u[at + TWO] = times_block(i, inverse, r_0, r_1, r_2)


@njit(cache=True)
def forward_residual(u_indptr, u_indices, upper, u, result):
    """The residual after :func:`forward_from_zero`: minus U times u."""
    for node in range(len(u_indptr) - 1):
        i = np.uint64(node)
        at = THREE * i
        result[at], result[at + ONE], result[at + TWO] = minus_row(i, 1, u_indptr, u_indices, upper, u, 0.0, 0.0, 0.0)


@njit(cache=True)
def backward_full(l_indptr, l_indices, lower, u_indptr, u_indices, upper, inverse, load, u):
    """Backward sweep from any u."""
    for node in range(len(l_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at = THREE * i
        r_0, r_1, r_2 = minus_row(i, -1, u_indptr, u_indices, upper, u, load[at], load[at + ONE], load[at + TWO])
        r_0, r_1, r_2 = minus_row(i, -1, l_indptr, l_indices, lower, u, r_0, r_1, r_2)
        u[at], u[at + ONE], u[at + TWO] = times_block(i, inverse, r_0, r_1, r_2)
