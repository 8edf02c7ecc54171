"""Numba kernels of the nonlinear smoothing in 3D; see :mod:`adaptmg.multigrid.projected_sweeps_2d`.

The same functions with three components: ``frames`` and ``diagonal`` 9, ``blocks`` 6 (nn, n1, n2, 11, 12, 22),
``reference`` 2 and ``values`` 3 numbers a contact node.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from adaptmg.multigrid.half_sweeps_3d import minus_row, minus_transposed_row, times_block
from adaptmg.smoother.node_solve import solve_3d

__all__ = ["backward", "energy_product", "forward"]

ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
FIVE, SIX, SEVEN, EIGHT, NINE = np.uint64(5), np.uint64(6), np.uint64(7), np.uint64(8), np.uint64(9)


@njit(cache=True)
def _node(k, frames, blocks, gap, reference, limit, friction, values, c_0, c_1, c_2):
    """Solve a contact node; ``c`` is the Cartesian force without the diagonal block."""
    f, b, at = NINE * k, SIX * k, THREE * k
    c_n, c_s, c_t = times_block(k, frames, c_0, c_1, c_2)
    w_n, w_s, w_t = solve_3d(blocks[b], blocks[b + ONE], blocks[b + TWO], blocks[b + THREE], blocks[b + FOUR],
                             blocks[b + FIVE], c_n, c_s, c_t, gap[k], reference[TWO * k], reference[TWO * k + ONE],
                             limit[k], friction[k])
    values[at], values[at + ONE], values[at + TWO] = w_n, w_s, w_t
    return (frames[f] * w_n + frames[f + THREE] * w_s + frames[f + SIX] * w_t,
            frames[f + ONE] * w_n + frames[f + FOUR] * w_s + frames[f + SEVEN] * w_t,
            frames[f + TWO] * w_n + frames[f + FIVE] * w_s + frames[f + EIGHT] * w_t)


@njit(cache=True)
def backward(l_indptr, l_indices, lower, inverse, load, contact_of, frames, blocks, gap, reference, limit, friction,
             values, u, kept):
    """Backward projected sweep, kept = f - U u."""
    for at in range(len(load)):
        kept[at] = load[at]
    for node in range(len(l_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at = THREE * i
        r_0, r_1, r_2 = minus_row(i, -1, l_indptr, l_indices, lower, u, 0.0, 0.0, 0.0)
        r_0, r_1, r_2 = kept[at] + r_0, kept[at + ONE] + r_1, kept[at + TWO] + r_2
        if contact_of[i] < 0:
            new_0, new_1, new_2 = times_block(i, inverse, r_0, r_1, r_2)
        else:
            new_0, new_1, new_2 = _node(np.uint64(contact_of[i]), frames, blocks, gap, reference, limit, friction,
                                        values, r_0, r_1, r_2)
        u[at], u[at + ONE], u[at + TWO] = new_0, new_1, new_2
        minus_transposed_row(i, -1, l_indptr, l_indices, lower, new_0, new_1, new_2, kept)


@njit(cache=True, fastmath={"contract"})
def forward(l_indptr, l_indices, lower, inverse, diagonal, contact_of, frames, blocks, gap, reference, limit, friction,
            values, u, kept):
    """Forward projected sweep after :func:`backward`; ``kept`` becomes f - A u."""
    for node in range(len(l_indptr) - 1):
        i = np.uint64(node)
        at = THREE * i
        r_0, r_1, r_2 = minus_row(i, 1, l_indptr, l_indices, lower, u, kept[at], kept[at + ONE], kept[at + TWO])
        if contact_of[i] < 0:
            new_0, new_1, new_2 = times_block(i, inverse, r_0, r_1, r_2)
            kept[at], kept[at + ONE], kept[at + TWO] = 0.0, 0.0, 0.0
        else:
            k = np.uint64(contact_of[i])
            new_0, new_1, new_2 = _node(k, frames, blocks, gap, reference, limit, friction, values, r_0, r_1, r_2)
            f_0, f_1, f_2 = times_block(k, diagonal, new_0, new_1, new_2)
            kept[at], kept[at + ONE], kept[at + TWO] = r_0 - f_0, r_1 - f_1, r_2 - f_2
        d_0, d_1, d_2 = new_0 - u[at], new_1 - u[at + ONE], new_2 - u[at + TWO]
        u[at], u[at + ONE], u[at + TWO] = new_0, new_1, new_2
        minus_transposed_row(i, 1, l_indptr, l_indices, lower, d_0, d_1, d_2, kept)


@njit(cache=True)
def energy_product(l_indptr, l_indices, lower, inverse, new, old):
    """(new - old)' A (new - old) from L and the inverse diagonal blocks: half a pass."""
    total = 0.0
    for node in range(len(l_indptr) - 1):
        i = np.uint64(node)
        at, b = THREE * i, NINE * i
        d_0, d_1, d_2 = new[at] - old[at], new[at + ONE] - old[at + ONE], new[at + TWO] - old[at + TWO]
        m_00, m_01, m_02 = inverse[b], inverse[b + ONE], inverse[b + TWO]
        m_11, m_12, m_22 = inverse[b + FOUR], inverse[b + FIVE], inverse[b + EIGHT]
        c_00, c_01, c_02 = m_11 * m_22 - m_12 * m_12, m_02 * m_12 - m_01 * m_22, m_01 * m_12 - m_02 * m_11
        c_11, c_12, c_22 = m_00 * m_22 - m_02 * m_02, m_01 * m_02 - m_00 * m_12, m_00 * m_11 - m_01 * m_01
        determinant = m_00 * c_00 + m_01 * c_01 + m_02 * c_02
        total += (c_00 * d_0 * d_0 + c_11 * d_1 * d_1 + c_22 * d_2 * d_2
                  + 2.0 * (c_01 * d_0 * d_1 + c_02 * d_0 * d_2 + c_12 * d_1 * d_2)) / determinant
        for entry in range(np.uint64(l_indptr[i]), np.uint64(l_indptr[i + ONE])):
            k, j = NINE * entry, THREE * np.uint64(l_indices[entry])
            e_0, e_1, e_2 = new[j] - old[j], new[j + ONE] - old[j + ONE], new[j + TWO] - old[j + TWO]
            total += 2.0 * (d_0 * (lower[k] * e_0 + lower[k + ONE] * e_1 + lower[k + TWO] * e_2)
                            + d_1 * (lower[k + THREE] * e_0 + lower[k + FOUR] * e_1 + lower[k + FIVE] * e_2)
                            + d_2 * (lower[k + SIX] * e_0 + lower[k + SEVEN] * e_1 + lower[k + EIGHT] * e_2))
    return total
