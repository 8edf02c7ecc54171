r"""Numba kernels of local projected sweeps in 2D: Gauss-Seidel on a list of nodes, the residual kept up to date.

Where two bodies touch, the smoothing of the interface limits the rate: most of the error that is left lies within a few
elements of it. The change :math:`\delta_i` of node i alters the residual by :math:`-A_{ji}\delta_i = -A_{ij}^T\delta_i`
at its neighbours j, so that a sweep over the list costs the rows of the list, no more.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from adaptmg.multigrid.projected_sweeps_2d import _node

__all__ = ["local"]

ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)


@njit(cache=True)
def _spread(i, indptr, indices, blocks, d_0, d_1, defect):
    """Take the change of node i out of the residual of its neighbours in one half."""
    for entry in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        b, j = FOUR * entry, TWO * np.uint64(indices[entry])
        defect[j] -= blocks[b] * d_0 + blocks[b + TWO] * d_1
        defect[j + ONE] -= blocks[b + ONE] * d_0 + blocks[b + THREE] * d_1


@njit(cache=True)
def local(nodes, l_indptr, l_indices, lower, u_indptr, u_indices, upper, inverse, diagonal, contact_of, frames, blocks,
          gap, reference, limit, friction, values, u, defect):
    """Projected sweep over ``nodes`` in the order of the list; ``defect`` is f - A u before and after.

    ``diagonal`` (n_contact * 4,) are the Cartesian diagonal blocks of the contact nodes; for the rest see
    :mod:`adaptmg.multigrid.projected_sweeps_2d`.
    """
    for entry in range(len(nodes)):
        i = np.uint64(nodes[entry])
        at, block = TWO * i, FOUR * i
        r_0, r_1 = defect[at], defect[at + ONE]
        if contact_of[i] < 0:
            d_0 = inverse[block] * r_0 + inverse[block + ONE] * r_1
            d_1 = inverse[block + TWO] * r_0 + inverse[block + THREE] * r_1
            u[at] += d_0
            u[at + ONE] += d_1
            defect[at], defect[at + ONE] = 0.0, 0.0
        else:
            k = np.uint64(contact_of[i])
            d = FOUR * k
            c_0 = r_0 + diagonal[d] * u[at] + diagonal[d + ONE] * u[at + ONE]
            c_1 = r_1 + diagonal[d + TWO] * u[at] + diagonal[d + THREE] * u[at + ONE]
            new_0, new_1 = _node(k, frames, blocks, gap, reference, limit, friction, values, c_0, c_1)
            d_0, d_1 = new_0 - u[at], new_1 - u[at + ONE]
            u[at], u[at + ONE] = new_0, new_1
            defect[at] = c_0 - diagonal[d] * new_0 - diagonal[d + ONE] * new_1
            defect[at + ONE] = c_1 - diagonal[d + TWO] * new_0 - diagonal[d + THREE] * new_1
        _spread(i, l_indptr, l_indices, lower, d_0, d_1, defect)
        _spread(i, u_indptr, u_indices, upper, d_0, d_1, defect)
