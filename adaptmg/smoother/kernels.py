r"""Numba kernels of the projected block Gauss-Seidel method: arrays in, arrays changed in place, no checks.

A sweep visits the nodes in order; with the residual :math:`r_i = b_i - \sum_j A_{ij} w_j` and D the diagonal block

.. math:: w_i \leftarrow w_i + \omega D^{-1} r_i

away from contact, and at a contact node w_i becomes the solution of :mod:`adaptmg.smoother.node_solve` with
:math:`M = D/\omega`, :math:`c = r_i + M w_i`. For Tresca's law and :math:`0 < \omega < 2` no step can raise the energy.

All arrays are flat and the loop variables unsigned (no wrap-around tests): a sweep runs at the speed of memory.
Arguments common to the kernels: ``zero``, dim zeros (see :mod:`adaptmg.smoother.blocks`); the arrays of a LocalSystem
and of a NodalContact (slip_reference flat); ``load`` and ``w`` (n_dofs,).
"""

from __future__ import annotations

import numpy as np

from adaptmg._numba import inner_kernel, kernel
from adaptmg.smoother.blocks import (
    add,
    in_loop,
    over,
    plus_symmetric,
    read,
    scale,
    subtract,
    times,
    transposed_times,
    upper,
    write,
)
from adaptmg.smoother.node_solve import natural_at, read_reference, solve

ONE = np.uint64(1)


@in_loop
def minus_row(i, step, indptr, indices, data, w, r):
    """Return r minus row i of a matrix (or half of one) times w. ``step``, 1 or -1, is the direction in which the
    matrix is read."""
    dim = np.uint64(len(r))
    begin, end = np.int64(indptr[i]), np.int64(indptr[i + ONE])
    first = begin if step > 0 else end - np.int64(1)
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        r = subtract(r, times(data, dim * dim * k, read(w, dim * np.uint64(indices[k]), r)))
    return r


@in_loop
def minus_transposed_row(i, step, indptr, indices, data, d, w):
    """Subtract the transpose of row i of a half times d from w, in place."""
    dim = np.uint64(len(d))
    begin, end = np.int64(indptr[i]), np.int64(indptr[i + ONE])
    first = begin if step > 0 else end - np.int64(1)
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        j = dim * np.uint64(indices[k])
        # all is read before anything is written: the compiler cannot know that w is none of the other arrays
        write(w, j, subtract(read(w, j, d), transposed_times(data, dim * dim * k, d)))


@in_loop
def _residual_at(i, indptr, indices, data, load, w, zero, step):
    """The residual (b - A w) at node i; ``step``, 1 or -1, the direction in which the matrix is read."""
    return minus_row(i, step, indptr, indices, data, w, read(load, np.uint64(len(zero)) * i, zero))


@inner_kernel(forceinline=True)
def _contact_solve(i, contact, diagonal, gap, reference, limit, friction, w, omega, r):
    """The new unknowns of a contact node from its residual."""
    dim = np.uint64(len(r))
    m = over(upper(diagonal, dim * dim * i, r), omega)
    return solve(m, plus_symmetric(r, m, read(w, dim * i, r)), gap[contact], read_reference(reference, contact, r),
                 limit[contact], friction[contact])


@kernel
def sweep(zero, first, step, indptr, indices, data, diagonal, inverse, contact_of, gap, reference, limit, friction,
          load, w, omega):
    """Sweep over all nodes, changing ``w``: ``first, step`` are 0, 1 (forward) or n_nodes - 1, -1 (backward)."""
    dim = np.uint64(len(zero))
    for k in range(len(contact_of)):
        i = np.uint64(first + k * step)
        r = _residual_at(i, indptr, indices, data, load, w, zero, step)
        at = dim * i
        if contact_of[i] < 0:
            write(w, at, add(read(w, at, zero), scale(omega, times(inverse, dim * at, r))))
        else:
            write(w, at, _contact_solve(i, np.uint64(contact_of[i]), diagonal, gap, reference, limit, friction, w,
                                        omega, r))


@kernel
def residual(zero, indptr, indices, data, load, w, result):
    """Write b - A w into ``result`` (n_dofs,)."""
    dim = np.uint64(len(zero))
    for node in range(len(indptr) - 1):
        i = np.uint64(node)
        write(result, dim * i, _residual_at(i, indptr, indices, data, load, w, zero, 1))


@kernel
def natural_residual(zero, nodes, diagonal, gap, reference, limit, friction, w, result):
    """Write D (prox_D(w + D^-1 r) - w) at the contact nodes of ``result`` (n_dofs,), which comes as r = b - A w.

    The limit is frozen at s + mu p(w); away from contact r is the natural residual.
    """
    dim = np.uint64(len(zero))
    for node in range(len(nodes)):
        k = np.uint64(node)
        at = dim * np.uint64(nodes[k])
        r = read(result, at, zero)
        write(result, at, natural_at(upper(diagonal, dim * at, zero), r, read(w, at, zero), gap[k],
                                     read_reference(reference, k, zero), limit[k] + friction[k] * max(r[0], 0.0)))
