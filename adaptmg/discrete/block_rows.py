"""The rows of a matrix in blocks; those that repeat one another are stored once.

The rows of a stored matrix are those of its table. The table of a lattice in one material has a row
for each kind of node, at most 9 in the plane and 27 in space (of smoothed elements 25 and 125), whose
columns count from the node: row i of the matrix has the blocks of row ``kinds[i]`` of the table, in
columns i + ``indices``. It stays in the cache of the processor, and the matrix, of 112 bytes a dof in
the plane and 360 in space, is made only for who asks for it. Kernels read both kinds of tables by
:func:`table_row` and :func:`table_column`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from adaptmg._numba import ZERO, inner_kernel, kernel, read_only
from adaptmg._threads import in_parts


@dataclass(frozen=True, eq=False)
class BlockRows:
    """The rows of a matrix of ``dim`` x ``dim`` blocks; columns are sorted."""

    dim: int
    #: (n_nodes,) uint8: the row of the table that each row repeats; (0,): row i is row i
    kinds: np.ndarray
    #: (n_rows + 1,) int: row r of the table has the blocks indptr[r], ..., indptr[r + 1] - 1
    indptr: np.ndarray
    indices: np.ndarray  # int: block columns in the table; with ``kinds`` they count from the row
    data: np.ndarray  # blocks of the table, row by row, flat

    @classmethod
    def of(cls, matrix: sparse.bsr_array | BlockRows) -> BlockRows:
        """Return the rows of a stored matrix, which share its arrays; rows unchanged."""
        if isinstance(matrix, BlockRows):
            return matrix
        result = cls(
            dim=matrix.blocksize[0],
            kinds=np.empty(0, dtype=np.uint8),
            indptr=matrix.indptr,
            indices=matrix.indices,
            data=matrix.data.reshape(-1),
        )
        # in place of what the property of this name would make
        result.__dict__["matrix"] = matrix
        return result

    @cached_property
    def matrix(self) -> sparse.bsr_array:
        """Return the matrix, which is made of a table when it is first read."""
        indptr = np.zeros(self.n_nodes + 1, dtype=np.int64)
        np.cumsum(np.diff(self.indptr)[self.kinds], out=indptr[1:])
        indices = np.empty(indptr[-1], dtype=np.int32)
        data = np.empty((len(indices), self.dim, self.dim))
        in_parts(
            _repeat,
            self.n_nodes,
            data.size,
            ZERO[self.dim],
            *self.arrays,
            indptr,
            indices,
            data.reshape(-1),
        )
        return frozen_matrix(data, indices, indptr)

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return what kernels read: kinds, row pointers, columns and blocks."""
        return read_only(self.kinds), read_only(self.indptr), read_only(self.indices), self.data

    @property
    def n_nodes(self) -> int:
        return len(self.kinds) or len(self.indptr) - 1

    @cached_property
    def nonzeros(self) -> int:
        """Return the number of stored entries of the matrix."""
        blocks = np.diff(self.indptr)
        if len(self.kinds):
            blocks = blocks * np.bincount(self.kinds, minlength=len(blocks))
        return int(blocks.sum()) * self.dim**2

    @cached_property
    def diagonal_places(self) -> np.ndarray:
        """Return the places (n_nodes,) of the diagonal blocks in the table."""
        if len(self.kinds):
            # each row of the table has one diagonal block, whose column minus row is 0
            return np.flatnonzero(self.indices == 0).astype(np.int32)[self.kinds]
        return diagonal_places(self.matrix)

    def diagonal_blocks(self, nodes: np.ndarray) -> np.ndarray:
        """Return the diagonal blocks (n, dim, dim) of nodes."""
        blocks = self.data.reshape(-1, self.dim, self.dim)
        return blocks.take(self.diagonal_places[nodes], axis=0)

    def diagonal(self) -> np.ndarray:
        """Return the diagonal (n_dofs,)."""
        # blocks first: to take from a strided view copies all of it, with a stored matrix of 11 000 nodes
        # .5 ms, not .13
        blocks = self.data.reshape(-1, self.dim**2).take(self.diagonal_places, axis=0)
        return blocks[:, :: self.dim + 1].reshape(-1)

    def last_columns(self) -> np.ndarray:
        """Return the last block column (n_nodes,) of each row."""
        columns = self.indices[self.indptr[1:] - 1]
        if len(self.kinds):
            return np.arange(self.n_nodes, dtype=np.int32) + columns[self.kinds]
        return columns

    def entries(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the blocks in the rows of nodes (n,): their places in the table, their columns, and the
        places of their rows among the nodes."""
        table_rows = self.kinds[nodes] if len(self.kinds) else nodes
        starts = self.indptr[table_rows]
        # kinds have 8 bits, in which 255 + 1 would be 0: an intp widens the sum
        counts = self.indptr[table_rows + np.intp(1)] - starts
        rows = np.repeat(np.arange(len(nodes)), counts)
        # from each start on, as many as the row has
        places = np.arange(len(rows)) + (starts - np.append(0, np.cumsum(counts)[:-1]))[rows]
        columns = self.indices[places]
        return places, columns + nodes[rows] if len(self.kinds) else columns, rows

    def at_nodes(self, nodes: np.ndarray) -> sparse.bsr_array:
        """Return the rows (n * dim, n_dofs) of nodes (n,)."""
        places, columns, rows = self.entries(nodes)
        blocks = self.data.reshape(-1, self.dim, self.dim)[places]
        starts = np.searchsorted(rows, np.arange(len(nodes) + 1))
        shape = (self.dim * len(nodes), self.dim * self.n_nodes)
        return sparse.bsr_array((blocks, columns, starts), shape=shape)

    def times(self, vector: np.ndarray) -> np.ndarray:
        """Return the product (n_dofs,) with a vector, summed as scipy does."""
        result = np.empty(self.dim * self.n_nodes)
        data = read_only(self.data)
        in_parts(
            _multiply,
            self.n_nodes,
            self.nonzeros,
            ZERO[self.dim],
            *self.arrays[:3],
            data,
            vector,
            result,
        )
        return result


def frozen_matrix(data: np.ndarray, indices: np.ndarray, indptr: np.ndarray) -> sparse.bsr_array:
    """Return the matrix of blocks (n, dim, dim) in sorted block columns ``indices`` (n,), whose pattern
    is frozen."""
    # row pointers of the type of the columns: of two types scipy would make copies, which are not frozen
    if len(indices) < 2**31:
        indptr = indptr.astype(np.int32)
    for array in (indices, indptr):
        array.flags.writeable = False
    n_dofs = data.shape[1] * (len(indptr) - 1)
    matrix = sparse.bsr_array((data, indices, indptr), shape=(n_dofs, n_dofs), copy=False)
    matrix.has_sorted_indices = True
    return matrix


def diagonal_places(matrix: sparse.bsr_array) -> np.ndarray:
    """Return the places (n_nodes,) of the diagonal blocks of a matrix, which has them all."""
    nodes = np.arange(len(matrix.indptr) - 1, dtype=np.int32)
    rows = np.repeat(nodes, np.diff(matrix.indptr))
    return np.flatnonzero(matrix.indices == rows).astype(np.int32)


@inner_kernel(forceinline=True)
def table_row(kinds, i):
    """Return the row of the table that row i repeats, and what its columns count from."""
    if len(kinds) > 0:
        return np.uint64(kinds[i]), np.int64(i)
    return i, np.int64(0)


@inner_kernel(forceinline=True)
def table_column(origin, indices, p):
    """Return the column of block p of the table in a row whose columns count from ``origin``."""
    return np.uint64(origin + indices[p])


@kernel
def _repeat(first, last, zero, kinds, starts, columns, blocks, indptr, indices, data):
    """Write the rows ``first``, ..., ``last`` - 1 of a matrix (indptr, indices, data) that repeat those of
    a table (starts, columns, blocks): row i its row ``kinds[i]``. ``zero`` is ZERO[dim]."""
    one = np.uint64(1)
    size = np.uint64(len(zero) ** 2)
    for i in range(np.uint64(first), np.uint64(last)):
        row, origin = table_row(kinds, i)
        at = np.uint64(indptr[i])
        for p in range(np.uint64(starts[row]), np.uint64(starts[row + one])):
            indices[at] = table_column(origin, columns, p)
            for a in range(size):
                data[size * at + a] = blocks[size * p + a]
            at += one


@kernel
def _multiply(first, last, zero, kinds, indptr, indices, data, v, result):
    """Write the rows of nodes first, ..., last - 1 of A v to ``result``, for the matrix A with the table
    (kinds, indptr, indices, data) of :class:`BlockRows`; ``zero`` is ZERO[dim]."""
    dim = np.uint64(len(zero))
    one = np.uint64(1)
    for i in range(np.uint64(first), np.uint64(last)):
        row, origin = table_row(kinds, i)
        for a in range(dim):
            total = 0.0
            for k in range(np.uint64(indptr[row]), np.uint64(indptr[row + one])):
                j = table_column(origin, indices, k)
                for b in range(dim):
                    total += data[dim * (dim * k + a) + b] * v[dim * j + b]
            result[dim * i + a] = total
