r"""PETSc's binary format: matrices, vectors and index sets as bytes.

All numbers are big-endian, integers of 32 bits, reals of 64, as PETSc reads and writes them where it was configured
without 64-bit indices and with real scalars in double precision (its default; PETSc manual, MatLoad, VecLoad, ISLoad):

==========  ==========================================================================================================
matrix      1211216, rows, columns, nonzeros; nonzeros of each row; column of each nonzero, row by row; value of each
vector      1211214, length; values
index set   1211218, length; indices
==========  ==========================================================================================================

Entries of a matrix that are stored are written, zeros too: blocks stay whole, so that the file can also be loaded as
BAIJ, with its block size from the ``.info`` file beside it.
"""

from __future__ import annotations

import struct

import numpy as np
from scipy import sparse

__all__ = ["LARGEST", "index_set", "matrix", "options", "vector"]

MATRIX, VECTOR, INDEX_SET = 1211216, 1211214, 1211218
#: the largest integer of a PETSc with 32-bit indices
LARGEST = 2**31 - 1


def matrix(name: str, values: sparse.sparray) -> bytes:
    """A sparse matrix, BSR or CSR, in the rows of its dofs; columns of a row in increasing order."""
    rows, columns = values.shape
    _check(name, "nonzeros", values.nnz)
    _check(name, "rows or columns", max(rows, columns))
    counts, indices, data = _rows(values)
    head = struct.pack(">4i", MATRIX, rows, columns, len(data))
    return b"".join((head, counts.astype(">i4").tobytes(), indices.astype(">i4").tobytes(),
                     data.astype(">f8").tobytes()))


def vector(name: str, values: np.ndarray) -> bytes:
    """An array of reals, flattened row by row."""
    flat = np.asarray(values, dtype=np.float64).reshape(-1)
    _check(name, "values", len(flat))
    return struct.pack(">2i", VECTOR, len(flat)) + flat.astype(">f8").tobytes()


def index_set(name: str, values: np.ndarray) -> bytes:
    """An array of integers."""
    flat = np.asarray(values).reshape(-1)
    _check(name, "indices", len(flat))
    if len(flat):
        _check(name, "as an index", int(flat.max()))
    return struct.pack(">2i", INDEX_SET, len(flat)) + flat.astype(">i4").tobytes()


def options(kind: str, block: int) -> bytes:
    """The ``.info`` file: options that PETSc reads before it loads; ``kind`` is "mat" or "vec"."""
    return f"-{kind}load_block_size {block}\n".encode()


def _rows(values: sparse.sparray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nonzeros of each row, columns and values row by row, columns sorted."""
    if values.format != "bsr":
        # a copy, as sorting and summing change the matrix in place
        found = sparse.csr_array(values, dtype=np.float64, copy=True)
        found.sum_duplicates()
        return np.diff(found.indptr), found.indices, found.data
    found = values.copy() if not values.has_canonical_format else values
    found.sum_duplicates()
    high, wide = found.blocksize
    per_block_row = np.diff(found.indptr)
    columns = (wide * found.indices[:, None] + np.arange(wide)).reshape(-1)
    # the rows of the blocks of a block row, one after another: (row in the block, block, column in the block)
    order = _row_by_row(found.indptr, high)
    return (np.repeat(per_block_row * wide, high), columns.reshape(-1, wide)[order // high].reshape(-1),
            found.data.reshape(-1, wide)[order].reshape(-1))


def _row_by_row(indptr: np.ndarray, high: int) -> np.ndarray:
    """Rows of blocks, numbered block by block (``high * block + row``), in the order of the rows of the matrix."""
    counts = np.diff(indptr)
    block = np.arange(indptr[-1], dtype=np.int64)
    # within its block row a block stands at position ``at``; row r of it comes after r times the blocks of the row
    at, start, width = block - np.repeat(indptr[:-1], counts), np.repeat(indptr[:-1], counts), np.repeat(counts, counts)
    place = high * start[:, None] + np.arange(high) * width[:, None] + at[:, None]
    order = np.empty(high * len(block), dtype=np.int64)
    order[place.reshape(-1)] = (high * block[:, None] + np.arange(high)).reshape(-1)
    return order


def _check(name: str, what: str, size: int) -> None:
    if size > LARGEST:
        raise ValueError(f"{name} has {size} {what}, more than the {LARGEST} that PETSc counts with its default "
                         "32-bit indices: export a coarser hierarchy, or a single level of it")
