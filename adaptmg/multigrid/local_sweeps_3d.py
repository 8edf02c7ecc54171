"""Numba kernels of local projected sweeps in 3D; see :mod:`adaptmg.multigrid.local_sweeps_2d`."""

from __future__ import annotations

import numpy as np
from numba import njit

from adaptmg.multigrid.half_sweeps_3d import times_block
from adaptmg.multigrid.projected_sweeps_3d import _node

__all__ = ["local"]

ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
FIVE, SIX, SEVEN, EIGHT, NINE = np.uint64(5), np.uint64(6), np.uint64(7), np.uint64(8), np.uint64(9)


@njit(cache=True)
def _changed(p, i, d_0, d_1, d_2, indptr, indices, blocks, diagonal, defect):
    """Take a change of node i, at position p, out of the residual: its own and that of its neighbours."""
    at = THREE * i
    f_0, f_1, f_2 = times_block(p, diagonal, d_0, d_1, d_2)
    defect[at] -= f_0
    defect[at + ONE] -= f_1
    defect[at + TWO] -= f_2
    for entry in range(np.uint64(indptr[p]), np.uint64(indptr[p + ONE])):
        b, j = NINE * entry, THREE * np.uint64(indices[entry])
        defect[j] -= blocks[b] * d_0 + blocks[b + THREE] * d_1 + blocks[b + SIX] * d_2
        defect[j + ONE] -= blocks[b + ONE] * d_0 + blocks[b + FOUR] * d_1 + blocks[b + SEVEN] * d_2
        defect[j + TWO] -= blocks[b + TWO] * d_0 + blocks[b + FIVE] * d_1 + blocks[b + EIGHT] * d_2


@njit(cache=True)
def _alone(p, i, nodes, indptr, indices, blocks, diagonal, follow_indptr, followers, weights, alone, contact_of, frames,
           gap, limit, values, u, defect):
    """Move a master without its followers, if all are open and stay so; whether it was done."""
    begin, end = np.uint64(follow_indptr[p]), np.uint64(follow_indptr[p + ONE])
    r_0, r_1, r_2 = defect[THREE * i], defect[THREE * i + ONE], defect[THREE * i + TWO]
    for s in range(begin, end):
        j = np.uint64(nodes[followers[s]])
        if contact_of[j] < 0:
            return False
        k = np.uint64(contact_of[j])
        if values[THREE * k] >= gap[k] or limit[k] > 0.0:
            return False
        r_0 -= weights[THREE * s] * defect[THREE * j]
        r_1 -= weights[THREE * s + ONE] * defect[THREE * j + ONE]
        r_2 -= weights[THREE * s + TWO] * defect[THREE * j + TWO]
    d_0, d_1, d_2 = times_block(p, alone, r_0, r_1, r_2)
    for s in range(begin, end):
        k = np.uint64(contact_of[nodes[followers[s]]])
        f = NINE * k
        closing = (frames[f] * weights[THREE * s] * d_0 + frames[f + ONE] * weights[THREE * s + ONE] * d_1
                   + frames[f + TWO] * weights[THREE * s + TWO] * d_2)
        if values[THREE * k] - closing >= gap[k]:
            return False
    u[THREE * i] += d_0
    u[THREE * i + ONE] += d_1
    u[THREE * i + TWO] += d_2
    _changed(p, i, d_0, d_1, d_2, indptr, indices, blocks, diagonal, defect)
    for s in range(begin, end):
        q = np.uint64(followers[s])
        j = np.uint64(nodes[q])
        k = np.uint64(contact_of[j])
        e_0, e_1, e_2 = (-weights[THREE * s] * d_0, -weights[THREE * s + ONE] * d_1, -weights[THREE * s + TWO] * d_2)
        u[THREE * j] += e_0
        u[THREE * j + ONE] += e_1
        u[THREE * j + TWO] += e_2
        w_0, w_1, w_2 = times_block(k, frames, e_0, e_1, e_2)
        values[THREE * k] += w_0
        values[THREE * k + ONE] += w_1
        values[THREE * k + TWO] += w_2
        _changed(q, j, e_0, e_1, e_2, indptr, indices, blocks, diagonal, defect)
    return True


@njit(cache=True)
def local(order, nodes, indptr, indices, blocks, diagonal, follow_indptr, followers, weights, alone, inverse,
          contact_of, frames, own_blocks, gap, reference, limit, friction, values, u, defect):
    """Projected sweep over positions ``order`` of an :class:`~adaptmg.multigrid.interface.Interface`."""
    for entry in range(len(order)):
        p = np.uint64(order[entry])
        i = np.uint64(nodes[p])
        at = THREE * i
        if contact_of[i] >= 0:
            f_0, f_1, f_2 = times_block(p, diagonal, u[at], u[at + ONE], u[at + TWO])
            new_0, new_1, new_2 = _node(np.uint64(contact_of[i]), frames, own_blocks, gap, reference, limit, friction,
                                        values, defect[at] + f_0, defect[at + ONE] + f_1, defect[at + TWO] + f_2)
            d_0, d_1, d_2 = new_0 - u[at], new_1 - u[at + ONE], new_2 - u[at + TWO]
            u[at], u[at + ONE], u[at + TWO] = new_0, new_1, new_2
            _changed(p, i, d_0, d_1, d_2, indptr, indices, blocks, diagonal, defect)
            continue
        if follow_indptr[p + ONE] > follow_indptr[p] and _alone(
                p, i, nodes, indptr, indices, blocks, diagonal, follow_indptr, followers, weights, alone, contact_of,
                frames, gap, limit, values, u, defect):
            continue
        d_0, d_1, d_2 = times_block(i, inverse, defect[at], defect[at + ONE], defect[at + TWO])
        u[at] += d_0
        u[at + ONE] += d_1
        u[at + TWO] += d_2
        _changed(p, i, d_0, d_1, d_2, indptr, indices, blocks, diagonal, defect)
