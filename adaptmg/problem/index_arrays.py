"""Index arrays of sparse matrices in 32 bits: less to read, and one form that compiled kernels are made for."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["narrowed"]

_MOST = np.iinfo(np.int32).max


def narrowed(matrix: Any) -> Any:
    """A csr, csc or bsr matrix with indices of 32 bits, where these suffice; values are shared, not copied."""
    if matrix.indices.dtype == matrix.indptr.dtype == np.int32 or max(*matrix.shape, matrix.nnz) > _MOST:
        return matrix
    parts = matrix.data, matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)
    result = type(matrix)(parts, shape=matrix.shape)
    # known of the same entries in the same order
    for name in ("_has_sorted_indices", "_has_canonical_format"):
        if name in matrix.__dict__:
            setattr(result, name, matrix.__dict__[name])
    return result
