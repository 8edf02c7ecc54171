r"""Numba kernels of the projected block Gauss-Seidel method in 3D; see :mod:`adaptmg.smoother.kernels_2d`.

The same kernels with the same arguments; ``reference`` holds two numbers a contact node, one after the other.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from adaptmg.smoother.node_solve import solve_3d
from adaptmg.smoother.prefetch import AHEAD, prefetch

__all__ = ["energy", "natural_residual", "normal_residual", "residual", "sweep"]

ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
FIVE, SIX, SEVEN, EIGHT, NINE = np.uint64(5), np.uint64(6), np.uint64(7), np.uint64(8), np.uint64(9)


@njit(cache=True, inline="always")
def _residual_at(i, indptr, indices, data, load, w, step):
    """The residual (b - A w) at node i; ``step``, 1 or -1, the direction in which the matrix is read."""
    begin, end = np.int64(indptr[i]), np.int64(indptr[i + ONE])
    first = begin if step > 0 else end - np.int64(1)
    at = THREE * i
    r_0, r_1, r_2 = load[at], load[at + ONE], load[at + TWO]
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        prefetch(data, np.int64(NINE * k) + step * AHEAD)
        block, j = NINE * k, THREE * np.uint64(indices[k])
        w_0, w_1, w_2 = w[j], w[j + ONE], w[j + TWO]
        r_0 -= data[block] * w_0 + data[block + ONE] * w_1 + data[block + TWO] * w_2
        r_1 -= data[block + THREE] * w_0 + data[block + FOUR] * w_1 + data[block + FIVE] * w_2
        r_2 -= data[block + SIX] * w_0 + data[block + SEVEN] * w_1 + data[block + EIGHT] * w_2
    return r_0, r_1, r_2


@njit(cache=True)
def _contact_solve(i, contact, diagonal, gap, reference, limit, friction, w, omega, r_0, r_1, r_2):
    """The new unknowns of a contact node from its residual."""
    at, block = THREE * i, NINE * i
    m_nn, m_n1, m_n2 = diagonal[block] / omega, diagonal[block + ONE] / omega, diagonal[block + TWO] / omega
    m_11, m_12 = diagonal[block + FOUR] / omega, diagonal[block + FIVE] / omega
    m_22 = diagonal[block + EIGHT] / omega
    w_n, w_1, w_2 = w[at], w[at + ONE], w[at + TWO]
    return solve_3d(m_nn, m_n1, m_n2, m_11, m_12, m_22,
                    r_0 + m_nn * w_n + m_n1 * w_1 + m_n2 * w_2, r_1 + m_n1 * w_n + m_11 * w_1 + m_12 * w_2,
                    r_2 + m_n2 * w_n + m_12 * w_1 + m_22 * w_2, gap[contact], reference[TWO * contact],
                    reference[TWO * contact + ONE], limit[contact], friction[contact])


@njit(cache=True)
def sweep(first, step, indptr, indices, data, diagonal, inverse, contact_of, gap, reference, limit, friction,
          load, w, omega):
    """One sweep over all nodes: ``first, step`` are 0, 1 (forward) or n_nodes - 1, -1 (backward); changes ``w``."""
    for k in range(len(contact_of)):
        i = np.uint64(first + k * step)
        r_0, r_1, r_2 = _residual_at(i, indptr, indices, data, load, w, step)
        at, block = THREE * i, NINE * i
        if contact_of[i] < 0:
            w[at] += omega * (inverse[block] * r_0 + inverse[block + ONE] * r_1 + inverse[block + TWO] * r_2)
            w[at + ONE] += omega * (inverse[block + THREE] * r_0 + inverse[block + FOUR] * r_1
                                    + inverse[block + FIVE] * r_2)
            w[at + TWO] += omega * (inverse[block + SIX] * r_0 + inverse[block + SEVEN] * r_1
                                    + inverse[block + EIGHT] * r_2)
        else:
            w[at], w[at + ONE], w[at + TWO] = _contact_solve(
                i, np.uint64(contact_of[i]), diagonal, gap, reference, limit, friction, w, omega, r_0, r_1, r_2)


@njit(cache=True)
def residual(indptr, indices, data, load, w, result):
    """b - A w into ``result`` (n_dofs,)."""
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        at = THREE * i
        result[at], result[at + ONE], result[at + TWO] = _residual_at(i, indptr, indices, data, load, w, 1)


@njit(cache=True)
def normal_residual(nodes, indptr, indices, data, load, w, result):
    """The normal component of b - A w at ``nodes`` into ``result`` (len(nodes),)."""
    for k in range(len(nodes)):
        result[k], _, _ = _residual_at(np.uint64(nodes[k]), indptr, indices, data, load, w, 1)


@njit(cache=True)
def _natural(i, contact, diagonal, gap, reference, limit, friction, w, r_0, r_1, r_2):
    """D (prox_D(w + D^-1 r) - w) at a contact node."""
    at, block = THREE * i, NINE * i
    d_nn, d_n1, d_n2 = diagonal[block], diagonal[block + ONE], diagonal[block + TWO]
    d_11, d_12, d_22 = diagonal[block + FOUR], diagonal[block + FIVE], diagonal[block + EIGHT]
    w_n, w_1, w_2 = w[at], w[at + ONE], w[at + TWO]
    new_n, new_1, new_2 = solve_3d(
        d_nn, d_n1, d_n2, d_11, d_12, d_22,
        r_0 + d_nn * w_n + d_n1 * w_1 + d_n2 * w_2, r_1 + d_n1 * w_n + d_11 * w_1 + d_12 * w_2,
        r_2 + d_n2 * w_n + d_12 * w_1 + d_22 * w_2, gap[contact], reference[TWO * contact],
        reference[TWO * contact + ONE], limit[contact] + friction[contact] * max(r_0, 0.0), 0.0)
    new_n, new_1, new_2 = new_n - w_n, new_1 - w_1, new_2 - w_2
    return (d_nn * new_n + d_n1 * new_1 + d_n2 * new_2, d_n1 * new_n + d_11 * new_1 + d_12 * new_2,
            d_n2 * new_n + d_12 * new_1 + d_22 * new_2)


@njit(cache=True)
def natural_residual(nodes, diagonal, gap, reference, limit, friction, w, result):
    """D (prox_D(w + D^-1 r) - w) at the contact nodes of ``result`` (n_dofs,), which comes as r = b - A w.

    The limit is frozen at s + mu p(w); away from contact r is the natural residual.
    """
    for k in range(len(nodes)):
        i = np.uint64(nodes[k])
        at = THREE * i
        r_0, r_1, r_2 = result[at], result[at + ONE], result[at + TWO]
        result[at], result[at + ONE], result[at + TWO] = _natural(i, np.uint64(k), diagonal, gap, reference, limit,
                                                                 friction, w, r_0, r_1, r_2)


@njit(cache=True)
def energy(indptr, indices, data, nodes, reference, limit, load, w):
    """1/2 w'Aw - b'w + sum of limit * |slip|."""
    total = 0.0
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        at = THREE * i
        r_0, r_1, r_2 = _residual_at(i, indptr, indices, data, load, w, 1)
        total -= 0.5 * (w[at] * (load[at] + r_0) + w[at + ONE] * (load[at + ONE] + r_1)
                        + w[at + TWO] * (load[at + TWO] + r_2))
    for k in range(len(nodes)):
        at = THREE * np.uint64(nodes[k])
        j = TWO * np.uint64(k)
        total += limit[k] * math.hypot(w[at + ONE] - reference[j], w[at + TWO] - reference[j + ONE])
    return total
