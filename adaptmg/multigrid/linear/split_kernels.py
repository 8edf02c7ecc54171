"""Numba kernels that split a block matrix into its lower and upper parts and invert its diagonal blocks."""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import inner_kernel, kernel

__all__ = ["count", "decouple", "distribute", "invert_all", "invert_block", "mask"]


@kernel
def count(indptr, indices, lower_indptr, upper_indptr):
    """Row pointers of both halves."""
    lower_indptr[0] = upper_indptr[0] = 0
    for i in range(len(indptr) - 1):
        below = 0
        above = 0
        for k in range(indptr[i], indptr[i + 1]):
            # no branches: half of them would be mispredicted
            below += indices[k] < i
            above += indices[k] > i
        lower_indptr[i + 1] = lower_indptr[i] + below
        upper_indptr[i + 1] = upper_indptr[i] + above


@inner_kernel
def _copy(size, count, begin, to, indices, data, own_indices, own):
    """A run of ``count`` blocks from place ``begin`` to place ``to``."""
    for k in range(count):
        own_indices[to + k] = indices[begin + k]
    for c in range(size * count):
        own[size * to + c] = data[size * begin + c]


@kernel
def distribute(dim, indptr, indices, data, lower_indptr, lower_indices, lower, upper_indptr, upper_indices, upper,
                diagonal):
    """Blocks into L, U (unless it is empty) and D; blocks of a duplicate or missing diagonal are summed or zero."""
    size = dim * dim
    both = len(upper_indptr) > 0
    diagonal[:] = 0.0
    for i in range(len(indptr) - 1):
        # the columns are sorted, so that the row is one run for each part
        begin, to = np.int64(indptr[i]), np.int64(lower_indptr[i])
        count = lower_indptr[i + 1] - to
        _copy(size, count, begin, to, indices, data, lower_indices, lower)
        begin += count
        while begin < indptr[i + 1] and indices[begin] == i:
            for c in range(size):
                diagonal[size * i + c] += data[size * begin + c]
            begin += 1
        if both:
            _copy(size, indptr[i + 1] - begin, begin, np.int64(upper_indptr[i]), indices, data, upper_indices, upper)


@kernel
def mask(dim, indptr, indices, data, free, held):
    """Zero rows and columns of fixed dofs in a half; ``held`` tells the nodes that have some."""
    for i in range(len(indptr) - 1):
        for k in range(indptr[i], indptr[i + 1]):
            j = np.int64(indices[k])
            if not (held[i] or held[j]):
                continue
            for a in range(dim):
                for b in range(dim):
                    if not (free[dim * i + a] and free[dim * j + b]):
                        data[(k * dim + a) * dim + b] = 0.0


@kernel
def decouple(dim, diagonal, fixed):
    """Zero the couplings of fixed dofs inside their diagonal blocks; the entry itself stays."""
    for at in fixed:
        i, a = at // dim, at % dim
        for b in range(dim):
            if b != a:
                diagonal[(i * dim + a) * dim + b] = 0.0
                diagonal[(i * dim + b) * dim + a] = 0.0


@inner_kernel
def invert_block(dim, block, scale, result, at):
    """The inverse of a block (dim * dim,) with diagonal scale, zero in rows and columns of vanishing diagonal entries.

    ``scale`` (dim,) is what the entry was before truncation; Gauss-Jordan elimination on the rest. Written to
    ``result`` from position ``at``; ``block`` is destroyed.
    """
    for c in range(dim * dim):
        result[at + c] = 0.0
    for a in range(dim):
        result[at + a * dim + a] = 1.0
    for a in range(dim):
        pivot = block[a * dim + a]
        if abs(pivot) <= 1e-10 * scale[a]:
            for b in range(dim):
                block[a * dim + b] = 0.0
                block[b * dim + a] = 0.0
                result[at + a * dim + b] = 0.0
                result[at + b * dim + a] = 0.0
            continue
        for b in range(dim):
            block[a * dim + b] /= pivot
            result[at + a * dim + b] /= pivot
        for row in range(dim):
            factor = block[row * dim + a]
            if row != a and factor != 0.0:
                for b in range(dim):
                    block[row * dim + b] -= factor * block[a * dim + b]
                    result[at + row * dim + b] -= factor * result[at + a * dim + b]


@inner_kernel
def _invert_2d(blocks, result, at):
    """The same in 2D in a few operations, where no diagonal entry vanishes; whether it was done."""
    a, b, c, d = blocks[at], blocks[at + 1], blocks[at + 2], blocks[at + 3]
    if a == 0.0 or abs(d - c * (b / a)) <= 1e-10 * abs(d):
        return False
    scale = 1.0 / (d - c * (b / a))
    result[at + 1], result[at + 2], result[at + 3] = -(b / a) * scale, -(c / a) * scale, scale
    result[at] = 1.0 / a + (b / a) * scale * (c / a)
    return True


@kernel
def invert_all(dim, diagonal, inverse):
    """Inverses of all diagonal blocks; see :func:`invert_block`."""
    size = dim * dim
    block = np.empty(size)
    scale = np.empty(dim)
    for i in range(len(diagonal) // size):
        if dim == 2 and _invert_2d(diagonal, inverse, 4 * i):
            continue
        for c in range(size):
            block[c] = diagonal[size * i + c]
        for a in range(dim):
            scale[a] = abs(block[a * dim + a])
        invert_block(dim, block, scale, inverse, size * i)
