r"""Numba kernels of the nonlinear smoothing: projected Gauss-Seidel in half passes, on a symmetric matrix.

Unknowns are Cartesian; the exact node solve of :mod:`adaptmg.smoother.node_solve` works in the frame of the contact
node. Both sweeps read L only, each row for two purposes, as :math:`U = L^T`. The backward sweep scatters
:math:`-L_i^T u_i` to the nodes before, so that :math:`t = f - U u` is complete when its node is reached, and keeps t.
The forward sweep scatters :math:`-L_i^T \delta_i`, :math:`\delta_i` the change of node i: what t has become at the end
is the residual f - A u.

Arguments: ``zero``, dim zeros (see :mod:`adaptmg.smoother.blocks`), and of a contact ``contact_of`` (n_nodes,) index
or -1; ``frames`` (n_contact * dim^2,) rows normal, tangents; ``blocks`` (n_contact * dim (dim + 1) / 2,) upper
triangles of the local diagonal blocks; ``gap, reference, limit, friction``; ``values`` (n_contact * dim,) the local
unknowns, which hold gap and reference exactly where the node touches and sticks.
"""

from __future__ import annotations

import numpy as np

from adaptmg.multigrid.linear.half_sweeps import LINES
from adaptmg.runtime.compiled import inner_kernel, kernel
from adaptmg.smoother.blocks import (
    add,
    inner,
    inverse_square,
    minus_times,
    read,
    read_upper,
    subtract,
    times,
    transposed_times,
    write,
)
from adaptmg.smoother.hints import likely
from adaptmg.smoother.node_solve import read_reference, solve
from adaptmg.smoother.rows import minus_row, minus_transposed_row

__all__ = ["backward", "energy_product", "forward", "solve_at"]

ONE = np.uint64(1)


# fastmath said, so that it does not depend on which of the sweeps is compiled first
@inner_kernel(fastmath=False)
def solve_at(k, frames, blocks, gap, reference, limit, friction, values, c):
    """Solve contact node k; ``c`` is the Cartesian force without the diagonal block."""
    dim = np.uint64(len(c))
    frame = dim * dim * k
    w = solve(read_upper(blocks, k, c), times(frames, frame, c), gap[k], read_reference(reference, k, c), limit[k],
              friction[k])
    write(values, dim * k, w)
    return transposed_times(frames, frame, w)


@kernel
def backward(zero, l_indptr, l_indices, lower, inverse, load, contact_of, frames, blocks, gap, reference, limit,
             friction, values, u, kept):
    """Backward projected sweep, kept = f - U u."""
    dim = np.uint64(len(zero))
    for at in range(len(load)):
        kept[at] = load[at]
    for node in range(len(l_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at = dim * i
        # kept comes last: it is the one to wait for, as the node before has just written to it
        r = minus_row(i, -1, l_indptr, l_indices, lower, u, zero, LINES)
        r = add(read(kept, at, zero), r)
        if likely(contact_of[i] < 0):
            new = times(inverse, dim * at, r)
        else:
            new = solve_at(np.uint64(contact_of[i]), frames, blocks, gap, reference, limit, friction, values, r)
        write(u, at, new)
        minus_transposed_row(i, -1, l_indptr, l_indices, lower, new, kept)


@kernel(fastmath={"contract"})
def forward(zero, l_indptr, l_indices, lower, inverse, diagonal, contact_of, frames, blocks, gap, reference, limit,
            friction, values, u, kept):
    """Forward projected sweep after :func:`backward`; ``kept`` becomes f - A u.

    ``diagonal`` (n_contact * dim^2,) are the Cartesian diagonal blocks of the contact nodes.
    """
    dim = np.uint64(len(zero))
    for node in range(len(l_indptr) - 1):
        i = np.uint64(node)
        at = dim * i
        r = minus_row(i, 1, l_indptr, l_indices, lower, u, read(kept, at, zero), LINES)
        if likely(contact_of[i] < 0):
            new = times(inverse, dim * at, r)
            write(kept, at, zero)
        else:
            k = np.uint64(contact_of[i])
            new = solve_at(k, frames, blocks, gap, reference, limit, friction, values, r)
            write(kept, at, minus_times(r, diagonal, dim * dim * k, new))
        change = subtract(new, read(u, at, zero))
        write(u, at, new)
        minus_transposed_row(i, 1, l_indptr, l_indices, lower, change, kept)


@kernel
def energy_product(zero, l_indptr, l_indices, lower, inverse, new, old):
    """(new - old)' A (new - old) from L and the inverse diagonal blocks: half a pass."""
    dim = np.uint64(len(zero))
    total = 0.0
    for node in range(len(l_indptr) - 1):
        i = np.uint64(node)
        at = dim * i
        change = subtract(read(new, at, zero), read(old, at, zero))
        total += inverse_square(inverse, dim * at, change)
        for entry in range(np.uint64(l_indptr[i]), np.uint64(l_indptr[i + ONE])):
            j = dim * np.uint64(l_indices[entry])
            other = subtract(read(new, j, zero), read(old, j, zero))
            total += 2.0 * inner(change, times(lower, dim * dim * entry, other))
    return total
