r"""Numba kernels of the linear cycle: Gauss-Seidel in half passes, on a matrix that is stored in parts.

For :math:`(L + D + U)\,u = f`, stored as :class:`~adaptmg.multigrid.linear.split_matrix.SplitMatrix`, not necessarily
symmetric. From zero: forward (L), keeping :math:`s = f - L u`; backward (U), keeping the change :math:`\delta`; then
the residual is :math:`-L\delta` (L). After the coarse correction: forward (L and U), keeping s; backward (U). Two
symmetric sweeps and a residual in three passes.
Arguments in the order of the function: ``zero`` (dim zeros, see :mod:`adaptmg.smoother.blocks`; one for coarse spaces
that know no nodes); indptr, indices, data of a half; ``inverse`` of the diagonal blocks.
"""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import kernel
from adaptmg.smoother.blocks import read, subtract, times, write
from adaptmg.smoother.rows import minus_row

__all__ = ["LINES", "backward_change", "backward_full", "backward_kept", "forward_from_zero", "forward_full",
           "forward_residual", "residual"]

#: lines of the cache that a row of a half fills (2D)
LINES = 2


@kernel
def forward_from_zero(zero, l_indptr, l_indices, lower, inverse, load, u, kept):
    """u = (L + D)^-1 f, kept = f - L u."""
    dim = np.uint64(len(zero))
    for node in range(len(l_indptr) - 1):
        i = np.uint64(node)
        at = dim * i
        r = minus_row(i, 1, l_indptr, l_indices, lower, u, read(load, at, zero), LINES)
        write(kept, at, r)
        write(u, at, times(inverse, dim * at, r))


@kernel
def forward_residual(zero, u_indptr, u_indices, upper, u, result):
    """The residual after :func:`forward_from_zero`: minus U times u."""
    dim = np.uint64(len(zero))
    for node in range(len(u_indptr) - 1):
        i = np.uint64(node)
        write(result, dim * i, minus_row(i, 1, u_indptr, u_indices, upper, u, zero, LINES))


@kernel
def backward_change(zero, u_indptr, u_indices, upper, inverse, u, kept):
    """Backward sweep that takes f - L u from ``kept`` and leaves the change of u there."""
    dim = np.uint64(len(zero))
    for node in range(len(u_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at = dim * i
        r = minus_row(i, -1, u_indptr, u_indices, upper, u, read(kept, at, zero), LINES)
        new = times(inverse, dim * at, r)
        write(kept, at, subtract(new, read(u, at, zero)))
        write(u, at, new)


@kernel
def residual(zero, l_indptr, l_indices, lower, kept):
    """The residual after :func:`backward_change`, minus L times the change, in place of the change."""
    dim = np.uint64(len(zero))
    for node in range(len(l_indptr) - 2, -1, -1):
        i = np.uint64(node)
        write(kept, dim * i, minus_row(i, -1, l_indptr, l_indices, lower, kept, zero, LINES))


@kernel
def forward_full(zero, l_indptr, l_indices, lower, u_indptr, u_indices, upper, inverse, load, u, kept):
    """Forward sweep from any u, kept = f - L u."""
    dim = np.uint64(len(zero))
    for node in range(len(l_indptr) - 1):
        i = np.uint64(node)
        at = dim * i
        r = minus_row(i, 1, l_indptr, l_indices, lower, u, read(load, at, zero), LINES)
        write(kept, at, r)
        r = minus_row(i, 1, u_indptr, u_indices, upper, u, r, LINES)
        write(u, at, times(inverse, dim * at, r))


@kernel
def backward_kept(zero, u_indptr, u_indices, upper, inverse, u, kept):
    """Backward sweep that takes f - L u from ``kept``."""
    dim = np.uint64(len(zero))
    for node in range(len(u_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at = dim * i
        r = minus_row(i, -1, u_indptr, u_indices, upper, u, read(kept, at, zero), LINES)
        write(u, at, times(inverse, dim * at, r))


@kernel
def backward_full(zero, l_indptr, l_indices, lower, u_indptr, u_indices, upper, inverse, load, u):
    """Backward sweep from any u."""
    dim = np.uint64(len(zero))
    for node in range(len(l_indptr) - 2, -1, -1):
        i = np.uint64(node)
        at = dim * i
        r = minus_row(i, -1, u_indptr, u_indices, upper, u, read(load, at, zero), LINES)
        r = minus_row(i, -1, l_indptr, l_indices, lower, u, r, LINES)
        write(u, at, times(inverse, dim * at, r))
