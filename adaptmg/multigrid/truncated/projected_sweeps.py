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

Where two bodies touch, the smoothing of the interface limits the rate: most of the error that is left lies within a few
elements of it. In local sweeps there the change :math:`\delta_i` of node i alters the residual by
:math:`-A_{ji}\delta_i = -A_{ij}^T\delta_i` at its neighbours j, so that they cost the rows of their nodes, no more.
In relative coordinates a master node carries its followers along. That is what contact wants; but where the contact is
open and the slave body much stiffer there (a soft tip before a solid wall) such sweeps hardly move the master. Masters
whose followers are all open are therefore moved alone, the followers staying where they are,
:math:`w_j \leftarrow w_j - W_{ji}\delta_i`, unless that would close one of them.
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
    multiply,
    negative,
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

__all__ = ["backward", "energy_product", "forward", "local", "solve_at"]


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


@inner_kernel
def _changed(p, i, d, indptr, indices, blocks, diagonal, defect):
    """Take a change d of node i, at position p, out of the residual: its own and that of its neighbours."""
    dim = np.uint64(len(d))
    size, at = dim * dim, dim * i
    write(defect, at, subtract(read(defect, at, d), times(diagonal, size * p, d)))
    for entry in range(np.uint64(indptr[p]), np.uint64(indptr[p + ONE])):
        j = dim * np.uint64(indices[entry])
        write(defect, j, subtract(read(defect, j, d), transposed_times(blocks, size * entry, d)))


@inner_kernel
def _alone(zero, p, i, nodes, indptr, indices, blocks, diagonal, follow_indptr, followers, weights, alone, contact_of,
           frames, gap, limit, values, u, defect):
    """Move a master without its followers, if all are open and stay so; whether it was done."""
    dim = np.uint64(len(zero))
    size = dim * dim
    begin, end = np.uint64(follow_indptr[p]), np.uint64(follow_indptr[p + ONE])
    r = read(defect, dim * i, zero)
    for s in range(begin, end):
        j = np.uint64(nodes[followers[s]])
        if contact_of[j] < 0:
            return False
        k = np.uint64(contact_of[j])
        if values[dim * k] >= gap[k] or limit[k] > 0.0:
            return False
        r = subtract(r, multiply(read(weights, dim * s, zero), read(defect, dim * j, zero)))
    d = times(alone, size * p, r)
    for s in range(begin, end):
        k = np.uint64(contact_of[nodes[followers[s]]])
        behind = negative(multiply(read(weights, dim * s, zero), d))
        if values[dim * k] + times(frames, size * k, behind)[0] >= gap[k]:
            return False
    write(u, dim * i, add(read(u, dim * i, zero), d))
    _changed(p, i, d, indptr, indices, blocks, diagonal, defect)
    for s in range(begin, end):
        q = np.uint64(followers[s])
        j = np.uint64(nodes[q])
        k = np.uint64(contact_of[j])
        behind = negative(multiply(read(weights, dim * s, zero), d))
        write(u, dim * j, add(read(u, dim * j, zero), behind))
        write(values, dim * k, add(read(values, dim * k, zero), times(frames, size * k, behind)))
        _changed(q, j, behind, indptr, indices, blocks, diagonal, defect)
    return True


@kernel
def local(zero, order, nodes, indptr, indices, blocks, diagonal, follow_indptr, followers, weights, alone, inverse,
          contact_of, frames, own_blocks, gap, reference, limit, friction, values, u, defect):
    """Projected sweep over positions ``order`` of an :class:`~adaptmg.multigrid.truncated.interface.Interface`.

    ``defect`` is f - A u before and after.
    """
    dim = np.uint64(len(zero))
    for entry in range(len(order)):
        p = np.uint64(order[entry])
        i = np.uint64(nodes[p])
        at = dim * i
        now = read(u, at, zero)
        if contact_of[i] >= 0:
            force = minus_times(read(defect, at, zero), diagonal, dim * dim * p, negative(now))
            new = solve_at(np.uint64(contact_of[i]), frames, own_blocks, gap, reference, limit, friction, values,
                           force)
            change = subtract(new, now)
        elif follow_indptr[p + ONE] > follow_indptr[p] and _alone(
                zero, p, i, nodes, indptr, indices, blocks, diagonal, follow_indptr, followers, weights, alone,
                contact_of, frames, gap, limit, values, u, defect):
            continue
        else:
            change = times(inverse, dim * at, read(defect, at, zero))
            new = add(now, change)
        write(u, at, new)
        _changed(p, i, change, indptr, indices, blocks, diagonal, defect)
