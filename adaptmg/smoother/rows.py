"""Rows of a block matrix in kernels: times a vector, and transposed, in the direction in which a sweep goes.

``zero`` and ``r`` tell the block size; see :mod:`adaptmg.smoother.blocks`.
"""

from __future__ import annotations

import numpy as np

from adaptmg.smoother.blocks import in_loop, read, subtract, times, transposed_times, write
from adaptmg.smoother.hints import AHEAD, prefetch

__all__ = ["minus_row", "minus_transposed_row"]

ONE = np.uint64(1)


@in_loop
def minus_row(i, step, indptr, indices, data, w, r, lines):
    """R minus row i of a matrix (or half of one) times w.

    ``step``, 1 or -1, is the direction in which the matrix is read. ``lines`` is how many lines of the cache a row
    fills, about: in 1D and 2D they are asked for once a row, in 3D (whose blocks fill a line each) block by block.
    """
    dim = np.uint64(len(r))
    size = dim * dim
    begin, end = np.int64(indptr[i]), np.int64(indptr[i + ONE])
    if len(r) < 3:
        ahead = np.int64(size) * begin + step * AHEAD
        prefetch(data, ahead)
        if lines > 1:
            prefetch(data, ahead + np.int64(8))
        if lines > 2:
            prefetch(data, ahead + np.int64(16))
            prefetch(data, ahead + np.int64(24))
    first = begin if step > 0 else end - np.int64(1)
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        if len(r) == 3:
            prefetch(data, np.int64(size * k) + step * AHEAD)
        r = subtract(r, times(data, size * k, read(w, dim * np.uint64(indices[k]), r)))
    return r


@in_loop
def minus_transposed_row(i, step, indptr, indices, data, d, w):
    """W minus the transpose of row i of a half times d, in place."""
    dim = np.uint64(len(d))
    begin, end = np.int64(indptr[i]), np.int64(indptr[i + ONE])
    first = begin if step > 0 else end - np.int64(1)
    for entry in range(end - begin):
        k = np.uint64(first + step * entry)
        j = dim * np.uint64(indices[k])
        # all is read before anything is written: the compiler cannot know that w is none of the other arrays
        write(w, j, subtract(read(w, j, d), transposed_times(data, dim * dim * k, d)))
