r"""Numba kernels of the nonlinear smoothing in 2D: projected Gauss-Seidel in half passes, on a symmetric matrix.

Unknowns are Cartesian; the exact node solve of :mod:`adaptmg.smoother.node_solve` works in the frame of the contact
node. Both sweeps read L only, each row for two purposes, as :math:`U = L^T`. The backward sweep scatters
:math:`-L_i^T u_i` to the nodes before, so that :math:`t = f - U u` is complete when its node is reached, and keeps t.
The forward sweep scatters :math:`-L_i^T \delta_i`, :math:`\delta_i` the change of node i: what t has become at the end
is the residual f - A u.

Arguments of a contact: ``contact_of`` (n_nodes,) index or -1; ``frames`` (n_contact * 4,) rows normal, tangent;
``blocks`` (n_contact * 3,) the local diagonal block nn, nt, tt; ``gap, reference, limit, friction``; ``values``
(n_contact * 2,) the local unknowns, which hold gap and reference exactly where the node touches and sticks.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from adaptmg.multigrid.half_sweeps_2d import minus_row, minus_transposed_row
from adaptmg.smoother.node_solve import solve_2d

__all__ = ["backward", "energy_product", "forward"]

ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)


@njit(cache=True)
def _node(k, frames, blocks, gap, reference, limit, friction, values, c_0, c_1):
    """Solve a contact node; ``c`` is the Cartesian force without the diagonal block."""
    frame, block, at = FOUR * k, THREE * k, TWO * k
    n_0, n_1, t_0, t_1 = frames[frame], frames[frame + ONE], frames[frame + TWO], frames[frame + THREE]
    c_n, c_t = n_0 * c_0 + n_1 * c_1, t_0 * c_0 + t_1 * c_1
    w_n, w_t = solve_2d(blocks[block], blocks[block + ONE], blocks[block + TWO], c_n, c_t, gap[k], reference[k],
                        limit[k], friction[k])
    values[at], values[at + ONE] = w_n, w_t
    return n_0 * w_n + t_0 * w_t, n_1 * w_n + t_1 * w_t


@njit(cache=True)
def backward(l_indptr, l_indices, lower, inverse, load, contact_of, frames, blocks, gap, reference, limit, friction,
             values, u, kept):
    """Backward projected sweep, kept = f - U u."""
    for at in range(len(load)):
        kept[at] = load[at]
    for node in range(len(l_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at, block = TWO * i, FOUR * i
        # kept comes last: it is the one to wait for, as the node before has just written to it
        r_0, r_1 = minus_row(i, -1, l_indptr, l_indices, lower, u, 0.0, 0.0)
        r_0, r_1 = kept[at] + r_0, kept[at + ONE] + r_1
        if contact_of[i] < 0:
            new_0 = inverse[block] * r_0 + inverse[block + ONE] * r_1
            new_1 = inverse[block + TWO] * r_0 + inverse[block + THREE] * r_1
        else:
            new_0, new_1 = _node(np.uint64(contact_of[i]), frames, blocks, gap, reference, limit, friction, values,
                                 r_0, r_1)
        u[at], u[at + ONE] = new_0, new_1
        minus_transposed_row(i, -1, l_indptr, l_indices, lower, new_0, new_1, kept)


@njit(cache=True, fastmath={"contract"})
def forward(l_indptr, l_indices, lower, inverse, diagonal, contact_of, frames, blocks, gap, reference, limit, friction,
            values, u, kept):
    """Forward projected sweep after :func:`backward`; ``kept`` becomes f - A u.

    ``diagonal`` (n_contact * 4,) are the Cartesian diagonal blocks of the contact nodes.
    """
    for node in range(len(l_indptr) - 1):
        i = np.uint64(node)
        at, block = TWO * i, FOUR * i
        r_0, r_1 = minus_row(i, 1, l_indptr, l_indices, lower, u, kept[at], kept[at + ONE])
        if contact_of[i] < 0:
            new_0 = inverse[block] * r_0 + inverse[block + ONE] * r_1
            new_1 = inverse[block + TWO] * r_0 + inverse[block + THREE] * r_1
            kept[at], kept[at + ONE] = 0.0, 0.0
        else:
            k = np.uint64(contact_of[i])
            new_0, new_1 = _node(k, frames, blocks, gap, reference, limit, friction, values, r_0, r_1)
            d = FOUR * k
            kept[at] = r_0 - diagonal[d] * new_0 - diagonal[d + ONE] * new_1
            kept[at + ONE] = r_1 - diagonal[d + TWO] * new_0 - diagonal[d + THREE] * new_1
        d_0, d_1 = new_0 - u[at], new_1 - u[at + ONE]
        u[at], u[at + ONE] = new_0, new_1
        minus_transposed_row(i, 1, l_indptr, l_indices, lower, d_0, d_1, kept)


@njit(cache=True)
def energy_product(l_indptr, l_indices, lower, inverse, new, old):
    """(new - old)' A (new - old) from L and the inverse diagonal blocks: half a pass."""
    total = 0.0
    for node in range(len(l_indptr) - 1):
        i = np.uint64(node)
        at, block = TWO * i, FOUR * i
        d_0, d_1 = new[at] - old[at], new[at + ONE] - old[at + ONE]
        a, b, c = inverse[block], inverse[block + ONE], inverse[block + THREE]
        determinant = a * c - b * b
        total += (c * d_0 * d_0 - 2.0 * b * d_0 * d_1 + a * d_1 * d_1) / determinant
        for entry in range(np.uint64(l_indptr[i]), np.uint64(l_indptr[i + ONE])):
            k, j = FOUR * entry, TWO * np.uint64(l_indices[entry])
            e_0, e_1 = new[j] - old[j], new[j + ONE] - old[j + ONE]
            total += 2.0 * (d_0 * (lower[k] * e_0 + lower[k + ONE] * e_1)
                            + d_1 * (lower[k + TWO] * e_0 + lower[k + THREE] * e_1))
    return total
