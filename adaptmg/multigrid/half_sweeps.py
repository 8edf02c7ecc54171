r"""Numba kernels of the linear cycle: Gauss-Seidel in half passes on a matrix stored in parts, and transfers.

For :math:`(L + D + U)\,u = f`, stored as :class:`~adaptmg.multigrid.split_matrix.SplitMatrix`, not necessarily
symmetric. From zero: forward (L), keeping :math:`s = f - L u`; backward (U), keeping the change :math:`\delta`; then
the residual is :math:`-L\delta` (L). After the coarse correction: forward (L and U), keeping s; backward (U). Two
symmetric sweeps and a residual in three passes. The sweeps go over places ``first`` to ``last`` of ``order``, see
:class:`~adaptmg.smoother.strips.Strips`, in which the rows of halves are stored, the other kernels over nodes.

Restriction scatters, prolongation is fused with what follows it, both from the same arrays. A nodal prolongation P acts
on every component, one of dofs as of nodes with one component: the length of ``zero`` (see
:mod:`adaptmg.smoother.blocks`) says which. Arguments then come in the order ``zero``; indptr, indices, data of a half;
``inverse`` of the diagonal blocks.
"""

from __future__ import annotations

import numpy as np

from adaptmg._numba import kernel
from adaptmg.smoother.blocks import add, in_loop, inner, minus_row, read, scale, subtract, times, write


@kernel
def forward_from_zero(first, last, order, zero, l_indptr, l_indices, lower, inverse, load, u, kept):
    """Compute u = (L + D)^-1 f, kept = f - L u."""
    dim = np.uint64(len(zero))
    for place in range(first, last):
        row, i = np.uint64(place), np.uint64(order[place])
        at = dim * i
        r = minus_row(row, 1, l_indptr, l_indices, lower, u, read(load, at, zero))
        write(kept, at, r)
        write(u, at, times(inverse, dim * at, r))


@kernel
def forward_residual(first, last, order, zero, u_indptr, u_indices, upper, u, result):
    """Write the residual after :func:`forward_from_zero`: minus U times u."""
    dim = np.uint64(len(zero))
    for place in range(first, last):
        row, i = np.uint64(place), np.uint64(order[place])
        write(result, dim * i, minus_row(row, 1, u_indptr, u_indices, upper, u, zero))


@kernel
def backward_change(first, last, order, zero, u_indptr, u_indices, upper, inverse, u, kept):
    """Sweep backward with f - L u from ``kept`` and leave the change of u there."""
    dim = np.uint64(len(zero))
    for place in range(last - 1, first - 1, -1):
        row, i = np.uint64(place), np.uint64(order[place])
        at = dim * i
        r = minus_row(row, -1, u_indptr, u_indices, upper, u, read(kept, at, zero))
        new = times(inverse, dim * at, r)
        write(kept, at, subtract(new, read(u, at, zero)))
        write(u, at, new)


@kernel
def residual(first, last, order, zero, l_indptr, l_indices, lower, kept):
    """Write the residual after :func:`backward_change`, minus L times the change, in place of the change."""
    dim = np.uint64(len(zero))
    for place in range(last - 1, first - 1, -1):
        row, i = np.uint64(place), np.uint64(order[place])
        write(kept, dim * i, minus_row(row, -1, l_indptr, l_indices, lower, kept, zero))


@kernel
def forward_full(first, last, order, zero, l_indptr, l_indices, lower, u_indptr, u_indices, upper, inverse, load, u,
                 kept):
    """Sweep forward from any u, kept = f - L u."""
    dim = np.uint64(len(zero))
    for place in range(first, last):
        row, i = np.uint64(place), np.uint64(order[place])
        at = dim * i
        r = minus_row(row, 1, l_indptr, l_indices, lower, u, read(load, at, zero))
        write(kept, at, r)
        r = minus_row(row, 1, u_indptr, u_indices, upper, u, r)
        write(u, at, times(inverse, dim * at, r))


@kernel
def backward_kept(first, last, order, zero, u_indptr, u_indices, upper, inverse, u, kept):
    """Sweep backward with f - L u from ``kept``."""
    dim = np.uint64(len(zero))
    for place in range(last - 1, first - 1, -1):
        row, i = np.uint64(place), np.uint64(order[place])
        at = dim * i
        r = minus_row(row, -1, u_indptr, u_indices, upper, u, read(kept, at, zero))
        write(u, at, times(inverse, dim * at, r))


@kernel
def backward_full(first, last, order, zero, l_indptr, l_indices, lower, u_indptr, u_indices, upper, inverse, load, u):
    """Sweep backward from any u."""
    dim = np.uint64(len(zero))
    for place in range(last - 1, first - 1, -1):
        row, i = np.uint64(place), np.uint64(order[place])
        at = dim * i
        r = minus_row(row, -1, u_indptr, u_indices, upper, u, read(load, at, zero))
        r = minus_row(row, -1, l_indptr, l_indices, lower, u, r)
        write(u, at, times(inverse, dim * at, r))


ONE = np.uint64(1)


@kernel
def restrict(first, last, zero, indptr, indices, weights, r, coarse):
    """Add P' r to ``coarse``; return r'r."""
    dim = np.uint64(len(zero))
    squares = 0.0
    for node in range(first, last):
        i = np.uint64(node)
        own = read(r, dim * i, zero)
        squares += inner(own, own)
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = dim * np.uint64(indices[k])
            write(coarse, j, add(read(coarse, j, zero), scale(weights[k], own)))
    return squares


@in_loop
def _plus_prolonged(i, indptr, indices, weights, coarse, e):
    """E plus P coarse at node i."""
    for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        e = add(e, scale(weights[k], read(coarse, np.uint64(len(e)) * np.uint64(indices[k]), e)))
    return e


@kernel
def add_prolonged(first, last, zero, indptr, indices, weights, coarse, u):
    """Add P times ``coarse`` to u."""
    for node in range(first, last):
        i = np.uint64(node)
        at = np.uint64(len(zero)) * i
        write(u, at, add(read(u, at, zero), _plus_prolonged(i, indptr, indices, weights, coarse, zero)))
