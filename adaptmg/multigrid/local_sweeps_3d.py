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
def _spread(i, indptr, indices, blocks, d_0, d_1, d_2, defect):
    """Take the change of node i out of the residual of its neighbours in one half."""
    for entry in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        b, j = NINE * entry, THREE * np.uint64(indices[entry])
        defect[j] -= blocks[b] * d_0 + blocks[b + THREE] * d_1 + blocks[b + SIX] * d_2
        defect[j + ONE] -= blocks[b + ONE] * d_0 + blocks[b + FOUR] * d_1 + blocks[b + SEVEN] * d_2
        defect[j + TWO] -= blocks[b + TWO] * d_0 + blocks[b + FIVE] * d_1 + blocks[b + EIGHT] * d_2


@njit(cache=True)
def local(nodes, l_indptr, l_indices, lower, u_indptr, u_indices, upper, inverse, diagonal, contact_of, frames, blocks,
          gap, reference, limit, friction, values, u, defect):
    """Projected sweep over ``nodes`` in the order of the list; ``defect`` is f - A u before and after."""
    for entry in range(len(nodes)):
        i = np.uint64(nodes[entry])
        at = THREE * i
        r_0, r_1, r_2 = defect[at], defect[at + ONE], defect[at + TWO]
        if contact_of[i] < 0:
            d_0, d_1, d_2 = times_block(i, inverse, r_0, r_1, r_2)
            u[at] += d_0
            u[at + ONE] += d_1
            u[at + TWO] += d_2
            defect[at], defect[at + ONE], defect[at + TWO] = 0.0, 0.0, 0.0
        else:
            k = np.uint64(contact_of[i])
            f_0, f_1, f_2 = times_block(k, diagonal, u[at], u[at + ONE], u[at + TWO])
            c_0, c_1, c_2 = r_0 + f_0, r_1 + f_1, r_2 + f_2
            new_0, new_1, new_2 = _node(k, frames, blocks, gap, reference, limit, friction, values, c_0, c_1, c_2)
            f_0, f_1, f_2 = times_block(k, diagonal, new_0, new_1, new_2)
            d_0, d_1, d_2 = new_0 - u[at], new_1 - u[at + ONE], new_2 - u[at + TWO]
            u[at], u[at + ONE], u[at + TWO] = new_0, new_1, new_2
            defect[at], defect[at + ONE], defect[at + TWO] = c_0 - f_0, c_1 - f_1, c_2 - f_2
        _spread(i, l_indptr, l_indices, lower, d_0, d_1, d_2, defect)
        _spread(i, u_indptr, u_indices, upper, d_0, d_1, d_2, defect)
