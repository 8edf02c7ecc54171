"""Index arrays of sparse matrices: 32 bits, one form that compiled kernels are made for; and closed to writing."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["indices_frozen", "narrowed"]

_MOST = np.iinfo(np.int32).max


def narrowed(matrix: Any) -> Any:
    """A csr, csc or bsr matrix with indices of 32 bits, where these suffice; values are shared, not copied."""
    if matrix.indices.dtype == matrix.indptr.dtype == np.int32 or max(*matrix.shape, matrix.nnz) > _MOST:
        return matrix
    return _with_indices(matrix, matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32))


def indices_frozen(matrix: Any) -> Any:
    """The matrix with read-only copies of its index arrays, which compiled code follows wherever they point."""
    if not (matrix.indices.flags.writeable or matrix.indptr.flags.writeable):
        return matrix
    arrays = matrix.indices.copy(), matrix.indptr.copy()
    for array in arrays:
        array.flags.writeable = False
    return _with_indices(matrix, *arrays)


def _with_indices(matrix: Any, indices: np.ndarray, indptr: np.ndarray) -> Any:
    result = type(matrix)((matrix.data, indices, indptr), shape=matrix.shape)
    # known of the same entries in the same order
    for name in ("_has_sorted_indices", "_has_canonical_format"):
        if name in matrix.__dict__:
            setattr(result, name, matrix.__dict__[name])
    return result
