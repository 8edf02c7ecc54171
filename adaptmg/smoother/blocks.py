"""Vectors of a node and blocks of a matrix in kernels: tuples, whose length is known when a kernel
is compiled.

One kernel serves all block sizes: it takes ``zero``, as many zeros as a node has components
(``ZERO[dim]``), and reads, multiplies and writes through the functions here. numba drops the
branches of other lengths and inlines the functions, so that what runs is the code written by hand
for one size.

Positions are np.uint64 (no wrap-around tests); ``at`` is that of the first entry, blocks are stored
row by row."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from adaptmg._numba import ZERO as ZERO
from adaptmg._numba import inner_kernel, prefetch
from adaptmg.discrete.block_rows import table_column

#: distance of a prefetch in bytes: rows are short and depend on one another, so that the processor does not hide the
#: latency of memory. Sweeps over 263k nodes in 2D take 29.0, 31.2, 26.3 ms of a solve, without it 32.1, 35.5, 29.1;
#: solves of 66k, 263k nodes and of 36k in space .96, .94, .96 of the time; 2048 and 8192 are as good
AHEAD = 4096

ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
FIVE, SIX, SEVEN, EIGHT = np.uint64(5), np.uint64(6), np.uint64(7), np.uint64(8)
#: steps of sweeps: kernels are compiled again for each number in the text of a call
FORWARD, BACKWARD = np.int64(1), np.int64(-1)
#: what columns count from in matrices whose nodes do not share rows
ORIGIN = np.int64(0)


def in_loop(function: Callable) -> Callable:
    """Let kernels call a function in their loops: its code is inlined. (Numba's
    ``register_jitable`` compiles a function again for callers with other options, up to five times
    in a first solve.)"""
    return inner_kernel(function, forceinline=True)


@in_loop
def read(array, at, like):
    """Return the vector at a position, as long as ``like``."""
    if len(like) == 1:
        return (array[at],)
    if len(like) == 2:
        return array[at], array[at + ONE]
    return array[at], array[at + ONE], array[at + TWO]


@in_loop
def write(array, at, v):
    """Put a vector at a position."""
    array[at] = v[0]
    if len(v) > 1:
        array[at + ONE] = v[1]
    if len(v) > 2:
        array[at + TWO] = v[2]


@in_loop
def nothing(like):
    """Return zeros, as many as ``like`` has entries."""
    if len(like) == 1:
        return (0.0,)
    if len(like) == 2:
        return 0.0, 0.0
    return 0.0, 0.0, 0.0


@in_loop
def add(v, w):
    """Return v + w."""
    if len(v) == 1:
        return (v[0] + w[0],)
    if len(v) == 2:
        return v[0] + w[0], v[1] + w[1]
    return v[0] + w[0], v[1] + w[1], v[2] + w[2]


@in_loop
def subtract(v, w):
    """Return v - w."""
    if len(v) == 1:
        return (v[0] - w[0],)
    if len(v) == 2:
        return v[0] - w[0], v[1] - w[1]
    return v[0] - w[0], v[1] - w[1], v[2] - w[2]


@in_loop
def increase(array, at, v):
    """Add v to the vector at a position."""
    write(array, at, add(read(array, at, v), v))


@in_loop
def scale(factor, v):
    """Return a number times v."""
    if len(v) == 1:
        return (factor * v[0],)
    if len(v) == 2:
        return factor * v[0], factor * v[1]
    return factor * v[0], factor * v[1], factor * v[2]


@in_loop
def negative(v):
    """Return -v."""
    if len(v) == 1:
        return (-v[0],)
    if len(v) == 2:
        return -v[0], -v[1]
    return -v[0], -v[1], -v[2]


@in_loop
def multiply(v, w):
    """Multiply component by component."""
    if len(v) == 2:
        return v[0] * w[0], v[1] * w[1]
    return v[0] * w[0], v[1] * w[1], v[2] * w[2]


@in_loop
def inner(v, w):
    """Return v'w."""
    if len(v) == 1:
        return v[0] * w[0]
    if len(v) == 2:
        return v[0] * w[0] + v[1] * w[1]
    return v[0] * w[0] + v[1] * w[1] + v[2] * w[2]


@in_loop
def times(blocks, at, v):
    """Return the block at a position times v."""
    if len(v) == 1:
        return (blocks[at] * v[0],)
    if len(v) == 2:
        return (
            blocks[at] * v[0] + blocks[at + ONE] * v[1],
            blocks[at + TWO] * v[0] + blocks[at + THREE] * v[1],
        )
    return (
        blocks[at] * v[0] + blocks[at + ONE] * v[1] + blocks[at + TWO] * v[2],
        blocks[at + THREE] * v[0] + blocks[at + FOUR] * v[1] + blocks[at + FIVE] * v[2],
        blocks[at + SIX] * v[0] + blocks[at + SEVEN] * v[1] + blocks[at + EIGHT] * v[2],
    )


@in_loop
def minus_times(r, blocks, at, v):
    """Return r minus the block at a position times v. In 2D each product is subtracted by itself, which
    rounds in another way than the sum of both."""
    if len(v) == 2:
        return (
            r[0] - blocks[at] * v[0] - blocks[at + ONE] * v[1],
            r[1] - blocks[at + TWO] * v[0] - blocks[at + THREE] * v[1],
        )
    return subtract(r, times(blocks, at, v))


@in_loop
def transposed_times(blocks, at, v):
    """Return the transpose of the block at a position times v."""
    if len(v) == 1:
        return (blocks[at] * v[0],)
    if len(v) == 2:
        return (
            blocks[at] * v[0] + blocks[at + TWO] * v[1],
            blocks[at + ONE] * v[0] + blocks[at + THREE] * v[1],
        )
    return (
        blocks[at] * v[0] + blocks[at + THREE] * v[1] + blocks[at + SIX] * v[2],
        blocks[at + ONE] * v[0] + blocks[at + FOUR] * v[1] + blocks[at + SEVEN] * v[2],
        blocks[at + TWO] * v[0] + blocks[at + FIVE] * v[1] + blocks[at + EIGHT] * v[2],
    )


@in_loop
def upper(blocks, at, like):
    """Return the upper triangle, row by row, of the block at a position."""
    if len(like) == 1:
        return (blocks[at],)
    if len(like) == 2:
        return blocks[at], blocks[at + ONE], blocks[at + THREE]
    return (
        blocks[at],
        blocks[at + ONE],
        blocks[at + TWO],
        blocks[at + FOUR],
        blocks[at + FIVE],
        blocks[at + EIGHT],
    )


@in_loop
def read_upper(triangles, k, like):
    """Return the k-th of the upper triangles of symmetric blocks, stored row by row."""
    if len(like) == 1:
        return (triangles[k],)
    if len(like) == 2:
        at = THREE * k
        return triangles[at], triangles[at + ONE], triangles[at + TWO]
    at = SIX * k
    return (
        triangles[at],
        triangles[at + ONE],
        triangles[at + TWO],
        triangles[at + THREE],
        triangles[at + FOUR],
        triangles[at + FIVE],
    )


@in_loop
def over(m, divisor):
    """Return an upper triangle divided by a number."""
    if len(m) == 1:
        return (m[0] / divisor,)
    if len(m) == 3:
        return m[0] / divisor, m[1] / divisor, m[2] / divisor
    return (
        m[0] / divisor,
        m[1] / divisor,
        m[2] / divisor,
        m[3] / divisor,
        m[4] / divisor,
        m[5] / divisor,
    )


@in_loop
def plus_symmetric(v, m, w):
    """Return v + M w, M symmetric, given by its upper triangle."""
    if len(v) == 1:
        return (v[0] + m[0] * w[0],)
    if len(v) == 2:
        return v[0] + m[0] * w[0] + m[1] * w[1], v[1] + m[1] * w[0] + m[2] * w[1]
    return (
        v[0] + m[0] * w[0] + m[1] * w[1] + m[2] * w[2],
        v[1] + m[1] * w[0] + m[3] * w[1] + m[4] * w[2],
        v[2] + m[2] * w[0] + m[4] * w[1] + m[5] * w[2],
    )


@in_loop
def inverse_square(blocks, at, v):
    """Return v' B^-1 v for the symmetric block B at a position."""
    m = upper(blocks, at, v)
    if len(v) == 1:
        return v[0] * v[0] / m[0]
    if len(v) == 2:
        return (m[2] * v[0] * v[0] - 2.0 * m[1] * v[0] * v[1] + m[0] * v[1] * v[1]) / (
            m[0] * m[2] - m[1] * m[1]
        )
    # cofactors
    c_00 = m[3] * m[5] - m[4] * m[4]
    c_01 = m[2] * m[4] - m[1] * m[5]
    c_02 = m[1] * m[4] - m[2] * m[3]
    c_11 = m[0] * m[5] - m[2] * m[2]
    c_12 = m[1] * m[2] - m[0] * m[4]
    c_22 = m[0] * m[3] - m[1] * m[1]
    determinant = m[0] * c_00 + m[1] * c_01 + m[2] * c_02
    return (
        c_00 * v[0] * v[0]
        + c_11 * v[1] * v[1]
        + c_22 * v[2] * v[2]
        + 2.0 * (c_01 * v[0] * v[1] + c_02 * v[0] * v[2] + c_12 * v[1] * v[2])
    ) / determinant


@in_loop
def minus_row(i, origin, step, indptr, indices, data, w, r):
    """Return r minus row i of a matrix (or half of one) times w. Columns count from ``origin``: ORIGIN, or
    the node where nodes share rows. ``step``, FORWARD or BACKWARD, says how the blocks of the row are
    read."""
    dim = np.uint64(len(r))
    begin = np.int64(indptr[i])
    end = np.int64(indptr[i + ONE])
    first = begin if step > 0 else end - np.int64(1)
    # address of the data that is fetched before it is read
    ahead = np.int64(data.ctypes.data) + step * AHEAD
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        prefetch(np.uintp(ahead + np.int64(8 * dim * dim * k)))  # 8 bytes a number
        r = subtract(
            r, times(data, dim * dim * k, read(w, dim * table_column(origin, indices, k), r))
        )
    return r


@in_loop
def minus_transposed_row(i, origin, step, indptr, indices, data, d, w):
    """Subtract the transpose of row i of a half times d from w, in place; see :func:`minus_row`."""
    dim = np.uint64(len(d))
    begin = np.int64(indptr[i])
    end = np.int64(indptr[i + ONE])
    first = begin if step > 0 else end - np.int64(1)
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        j = dim * table_column(origin, indices, k)
        # all is read before anything is written: the compiler cannot know that w is none of the
        # other arrays
        write(w, j, subtract(read(w, j, d), transposed_times(data, dim * dim * k, d)))
