r"""Numba kernels of local projected sweeps: Gauss-Seidel near an interface, the residual kept up to date.

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

from adaptmg.multigrid.truncated.projected_sweeps import solve_at
from adaptmg.runtime.compiled import inner_kernel, kernel
from adaptmg.smoother.blocks import (
    add,
    minus_times,
    multiply,
    negative,
    read,
    subtract,
    times,
    transposed_times,
    write,
)

__all__ = ["local"]

ONE = np.uint64(1)


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

    ``defect`` is f - A u before and after; for ``zero`` and the contact data see
    :mod:`adaptmg.multigrid.truncated.projected_sweeps`.
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
