r"""Numba kernels of local projected sweeps in 2D: Gauss-Seidel near an interface, the residual kept up to date.

Where two bodies touch, the smoothing of the interface limits the rate: most of the error that is left lies within a few
elements of it. The change :math:`\delta_i` of node i alters the residual by :math:`-A_{ji}\delta_i = -A_{ij}^T\delta_i`
at its neighbours j, so that a sweep over the list costs the rows of the list, no more.

In relative coordinates a master node carries its followers along. That is what contact wants; but where the contact is
open and the slave body much stiffer there (a soft tip before a solid wall) such sweeps hardly move the master. Masters
whose followers are all open are therefore moved alone, the followers staying where they are,
:math:`w_j \leftarrow w_j - W_{ji}\delta_i`, unless that would close one of them.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from adaptmg.multigrid.projected_sweeps_2d import _node

__all__ = ["local"]

ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)


@njit(cache=True)
def _changed(p, i, d_0, d_1, indptr, indices, blocks, diagonal, defect):
    """Take a change of node i, at position p, out of the residual: its own and that of its neighbours."""
    at, b = TWO * i, FOUR * p
    defect[at] -= diagonal[b] * d_0 + diagonal[b + ONE] * d_1
    defect[at + ONE] -= diagonal[b + TWO] * d_0 + diagonal[b + THREE] * d_1
    for entry in range(np.uint64(indptr[p]), np.uint64(indptr[p + ONE])):
        b, j = FOUR * entry, TWO * np.uint64(indices[entry])
        defect[j] -= blocks[b] * d_0 + blocks[b + TWO] * d_1
        defect[j + ONE] -= blocks[b + ONE] * d_0 + blocks[b + THREE] * d_1


@njit(cache=True)
def _alone(p, i, nodes, indptr, indices, blocks, diagonal, follow_indptr, followers, weights, alone, contact_of, frames,
           gap, limit, values, u, defect):
    """Move a master without its followers, if all are open and stay so; whether it was done."""
    begin, end = np.uint64(follow_indptr[p]), np.uint64(follow_indptr[p + ONE])
    r_0, r_1 = defect[TWO * i], defect[TWO * i + ONE]
    for s in range(begin, end):
        j = np.uint64(nodes[followers[s]])
        if contact_of[j] < 0:
            return False
        k = np.uint64(contact_of[j])
        if values[TWO * k] >= gap[k] or limit[k] > 0.0:
            return False
        r_0 -= weights[TWO * s] * defect[TWO * j]
        r_1 -= weights[TWO * s + ONE] * defect[TWO * j + ONE]
    b = FOUR * p
    d_0, d_1 = alone[b] * r_0 + alone[b + ONE] * r_1, alone[b + TWO] * r_0 + alone[b + THREE] * r_1
    for s in range(begin, end):
        k = np.uint64(contact_of[nodes[followers[s]]])
        closing = frames[FOUR * k] * weights[TWO * s] * d_0 + frames[FOUR * k + ONE] * weights[TWO * s + ONE] * d_1
        if values[TWO * k] - closing >= gap[k]:
            return False
    u[TWO * i] += d_0
    u[TWO * i + ONE] += d_1
    _changed(p, i, d_0, d_1, indptr, indices, blocks, diagonal, defect)
    for s in range(begin, end):
        q = np.uint64(followers[s])
        j = np.uint64(nodes[q])
        k = np.uint64(contact_of[j])
        e_0, e_1 = -weights[TWO * s] * d_0, -weights[TWO * s + ONE] * d_1
        u[TWO * j] += e_0
        u[TWO * j + ONE] += e_1
        values[TWO * k] += frames[FOUR * k] * e_0 + frames[FOUR * k + ONE] * e_1
        values[TWO * k + ONE] += frames[FOUR * k + TWO] * e_0 + frames[FOUR * k + THREE] * e_1
        _changed(q, j, e_0, e_1, indptr, indices, blocks, diagonal, defect)
    return True


@njit(cache=True)
def local(order, nodes, indptr, indices, blocks, diagonal, follow_indptr, followers, weights, alone, inverse,
          contact_of, frames, own_blocks, gap, reference, limit, friction, values, u, defect):
    """Projected sweep over positions ``order`` of an :class:`~adaptmg.multigrid.interface.Interface`.

    ``defect`` is f - A u before and after; for the contact data see :mod:`adaptmg.multigrid.projected_sweeps_2d`.
    """
    for entry in range(len(order)):
        p = np.uint64(order[entry])
        i = np.uint64(nodes[p])
        at, b = TWO * i, FOUR * p
        if contact_of[i] >= 0:
            c_0 = defect[at] + diagonal[b] * u[at] + diagonal[b + ONE] * u[at + ONE]
            c_1 = defect[at + ONE] + diagonal[b + TWO] * u[at] + diagonal[b + THREE] * u[at + ONE]
            new_0, new_1 = _node(np.uint64(contact_of[i]), frames, own_blocks, gap, reference, limit, friction, values,
                                 c_0, c_1)
            d_0, d_1 = new_0 - u[at], new_1 - u[at + ONE]
            u[at], u[at + ONE] = new_0, new_1
            _changed(p, i, d_0, d_1, indptr, indices, blocks, diagonal, defect)
            continue
        if follow_indptr[p + ONE] > follow_indptr[p] and _alone(
                p, i, nodes, indptr, indices, blocks, diagonal, follow_indptr, followers, weights, alone, contact_of,
                frames, gap, limit, values, u, defect):
            continue
        block = FOUR * i
        d_0 = inverse[block] * defect[at] + inverse[block + ONE] * defect[at + ONE]
        d_1 = inverse[block + TWO] * defect[at] + inverse[block + THREE] * defect[at + ONE]
        u[at] += d_0
        u[at + ONE] += d_1
        _changed(p, i, d_0, d_1, indptr, indices, blocks, diagonal, defect)
