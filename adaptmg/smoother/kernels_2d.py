r"""Numba kernels of the projected block Gauss-Seidel method in 2D: arrays in, arrays changed in place, no checks.

A sweep visits the nodes in order; with the residual :math:`r_i = b_i - \sum_j A_{ij} w_j` and D the diagonal block

.. math:: w_i \leftarrow w_i + \omega D^{-1} r_i

away from contact, and at a contact node w_i becomes the solution of :func:`adaptmg.smoother.node_solve.solve_2d` with
:math:`M = D/\omega`, :math:`c = r_i + M w_i`. For Tresca's law and :math:`0 < \omega < 2` no step can raise the energy.

All arrays are flat and the loop variables unsigned (no wrap-around tests), which is what lets a sweep run at the
speed of memory. Arguments common to the kernels, with the sizes of a :class:`~adaptmg.smoother.system.LocalSystem`:
``indptr, indices, data, diagonal, inverse, contact_of``; of a NodalContact: ``gap, reference`` (slip_reference, flat),
``limit, friction``; ``load`` and ``w`` (n_dofs,).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from adaptmg.smoother.node_solve import solve_2d
from adaptmg.smoother.prefetch import AHEAD, prefetch

__all__ = ["energy", "natural_residual", "normal_residual", "residual", "sweep"]

ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)


@njit(cache=True, inline="always")
def _residual_at(i, indptr, indices, data, load, w, step):
    """The residual (b - A w) at node i; ``step``, 1 or -1, the direction in which the matrix is read."""
    begin, end = np.int64(indptr[i]), np.int64(indptr[i + ONE])
    ahead = np.int64(4) * begin + step * AHEAD
    prefetch(data, ahead)
    prefetch(data, ahead + np.int64(8))
    prefetch(data, ahead + np.int64(16))
    prefetch(data, ahead + np.int64(24))
    first = begin if step > 0 else end - np.int64(1)
    at = TWO * i
    r_0, r_1 = load[at], load[at + ONE]
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        block, j = FOUR * k, TWO * np.uint64(indices[k])
        w_0, w_1 = w[j], w[j + ONE]
        r_0 -= data[block] * w_0 + data[block + ONE] * w_1
        r_1 -= data[block + TWO] * w_0 + data[block + THREE] * w_1
    return r_0, r_1


@njit(cache=True)
def _contact_solve(i, contact, diagonal, gap, reference, limit, friction, w, omega, r_0, r_1):
    """The new unknowns of a contact node from its residual."""
    at, block = TWO * i, FOUR * i
    m_nn, m_nt, m_tt = diagonal[block] / omega, diagonal[block + ONE] / omega, diagonal[block + THREE] / omega
    w_n, w_t = w[at], w[at + ONE]
    return solve_2d(m_nn, m_nt, m_tt, r_0 + m_nn * w_n + m_nt * w_t, r_1 + m_nt * w_n + m_tt * w_t,
                    gap[contact], reference[contact], limit[contact], friction[contact])


@njit(cache=True)
def sweep(first, step, indptr, indices, data, diagonal, inverse, contact_of, gap, reference, limit, friction,
          load, w, omega):
    """One sweep over all nodes: ``first, step`` are 0, 1 (forward) or n_nodes - 1, -1 (backward); changes ``w``."""
    for k in range(len(contact_of)):
        i = np.uint64(first + k * step)
        r_0, r_1 = _residual_at(i, indptr, indices, data, load, w, step)
        at, block = TWO * i, FOUR * i
        if contact_of[i] < 0:
            w[at] += omega * (inverse[block] * r_0 + inverse[block + ONE] * r_1)
            w[at + ONE] += omega * (inverse[block + TWO] * r_0 + inverse[block + THREE] * r_1)
        else:
            w[at], w[at + ONE] = _contact_solve(i, np.uint64(contact_of[i]), diagonal, gap, reference, limit,
                                                friction, w, omega, r_0, r_1)


@njit(cache=True)
def residual(indptr, indices, data, load, w, result):
    """b - A w into ``result`` (n_dofs,)."""
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        at = TWO * i
        result[at], result[at + ONE] = _residual_at(i, indptr, indices, data, load, w, 1)


@njit(cache=True)
def normal_residual(nodes, indptr, indices, data, load, w, result):
    """The normal component of b - A w at ``nodes`` into ``result`` (len(nodes),)."""
    for k in range(len(nodes)):
        result[k], _ = _residual_at(np.uint64(nodes[k]), indptr, indices, data, load, w, 1)


@njit(cache=True)
def _natural(i, contact, diagonal, gap, reference, limit, friction, w, r_0, r_1):
    """D (prox_D(w + D^-1 r) - w) at a contact node."""
    at, block = TWO * i, FOUR * i
    d_nn, d_nt, d_tt = diagonal[block], diagonal[block + ONE], diagonal[block + THREE]
    w_n, w_t = w[at], w[at + ONE]
    new_n, new_t = solve_2d(d_nn, d_nt, d_tt, r_0 + d_nn * w_n + d_nt * w_t, r_1 + d_nt * w_n + d_tt * w_t,
                            gap[contact], reference[contact], limit[contact] + friction[contact] * max(r_0, 0.0), 0.0)
    new_n, new_t = new_n - w_n, new_t - w_t
    return d_nn * new_n + d_nt * new_t, d_nt * new_n + d_tt * new_t


@njit(cache=True)
def natural_residual(nodes, diagonal, gap, reference, limit, friction, w, result):
    """D (prox_D(w + D^-1 r) - w) at the contact nodes of ``result`` (n_dofs,), which comes as r = b - A w.

    The limit is frozen at s + mu p(w); away from contact r is the natural residual.
    """
    for k in range(len(nodes)):
        i = np.uint64(nodes[k])
        at = TWO * i
        result[at], result[at + ONE] = _natural(i, np.uint64(k), diagonal, gap, reference, limit, friction, w,
                                               result[at], result[at + ONE])


@njit(cache=True)
def energy(indptr, indices, data, nodes, reference, limit, load, w):
    """1/2 w'Aw - b'w + sum of limit * |slip|."""
    total = 0.0
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        at = TWO * i
        r_0, r_1 = _residual_at(i, indptr, indices, data, load, w, 1)
        total -= 0.5 * (w[at] * (load[at] + r_0) + w[at + ONE] * (load[at + ONE] + r_1))
    for k in range(len(nodes)):
        total += limit[k] * abs(w[TWO * np.uint64(nodes[k]) + ONE] - reference[k])
    return total
