"""Arrays and sparse matrices as arguments: shape, kind of numbers, finite, and indices that stay inside.

Index arrays of sparse matrices: 32 bits, one form that compiled kernels are made for; and closed to writing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from adaptmg._checks import shown

__all__ = ["array", "indices_frozen", "narrowed", "sparse_matrix", "square_blocks", "vector"]

def vector(name: str, value: Any, size: int | None = None) -> np.ndarray:
    """Return ``value`` as a read-only one-dimensional float64 array of finite numbers."""
    try:
        result = np.asarray(value)
    except (TypeError, ValueError):
        result = np.asarray(None)
    if result.dtype.kind not in "iuf":
        raise TypeError(f"{name} must be a sequence of numbers, got {shown(value)}")
    if result.ndim != 1 or (size is not None and result.size != size):
        wanted = "a vector" if size is None else f"a vector of {size} numbers"
        raise ValueError(f"{name} must be {wanted}, got shape {result.shape}")
    return array(name, value, (size,))


def array(name: str, value: Any, shape: tuple[int | None, ...], *, integer: bool = False) -> np.ndarray:
    """Return a read-only copy of ``value`` as a contiguous array of finite numbers."""
    wanted = "integers" if integer else "real numbers"
    if isinstance(value, np.ma.MaskedArray):
        raise TypeError(f"{name} must be an array of {wanted}, got a masked one: fill it first")
    try:
        given = np.asarray(value)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be an array of {wanted}, got {shown(value)}") from None
    if given.size == 0 and given.dtype.kind == "f" and not isinstance(value, np.ndarray):
        given = given.astype(np.int64)  # an empty list is as good as one of integers
    if given.dtype.kind not in ("iu" if integer else "iuf"):
        kind = shown(value) if given.dtype.kind in "OSU" else f"an array of {given.dtype}"
        raise TypeError(f"{name} must be an array of {wanted}, got {kind}")
    if not isinstance(value, np.ndarray) and _holds_bool(value):
        raise TypeError(f"{name} must be an array of {wanted}, got {shown(value)}")
    if given.ndim != len(shape) or any(w is not None and w != g for w, g in zip(shape, given.shape, strict=True)):
        sizes = ", ".join("n" if w is None else str(w) for w in shape) + ("," if len(shape) == 1 else "")
        raise ValueError(f"{name} must have shape ({sizes}), got {given.shape}")
    if integer and given.dtype.kind == "u" and given.size and int(given.max()) > np.iinfo(np.int64).max:
        raise ValueError(f"{name} must be below 2**63, got {int(given.max())}")
    with np.errstate(over="ignore"):
        result = np.array(given, dtype=np.int64 if integer else np.float64, order="C")
    if not integer and not np.isfinite(result).all():
        raise ValueError(f"{name} must be finite; {np.count_nonzero(~np.isfinite(result))} entries are not")
    result.flags.writeable = False
    return result


def _holds_bool(value: Any) -> bool:
    """Whether a bool is among the numbers of nested lists and tuples: numpy would make it a number."""
    if isinstance(value, (bool, np.bool_)):
        return True
    return isinstance(value, (list, tuple)) and any(map(_holds_bool, value))


def sparse_matrix(name: str, value: Any, shape: tuple[int | None, int | None] = (None, None)) -> Any:
    """Return a scipy sparse matrix of real, finite numbers, its index arrays read in full.

    Compiled code follows index arrays wherever they point, so that each must lie inside the matrix and the row
    pointers must rise from 0 to the number of entries. Bsr, csr and csc matrices stay what they are, with indices of 32
    bits where these suffice; others become csr.
    """
    if not sparse.issparse(value):
        raise TypeError(f"{name} must be a scipy sparse matrix, got {type(value).__name__}")
    if value.ndim != 2 or any(w is not None and w != g for w, g in zip(shape, value.shape, strict=True)):
        sizes = ", ".join("n" if w is None else str(w) for w in shape)
        raise ValueError(f"{name} must have shape ({sizes}), got {value.shape}")
    if value.dtype.kind not in "iuf":
        raise TypeError(f"{name} must hold real numbers, got {value.dtype}")
    if value.format == "coo":
        _check_indices(name, value.row, value.shape[0], "row")
        _check_indices(name, value.col, value.shape[1], "column")
    elif value.format in ("csr", "csc", "bsr"):
        _check_compressed(name, value)
    if value.format not in ("csr", "csc", "bsr"):
        value = value.tocsr()
        _check_compressed(name, value)
    if value.data.dtype.kind not in "iuf":
        raise TypeError(f"{name} must hold real numbers, got {value.data.dtype}")
    if not np.isfinite(value.data).all():
        raise ValueError(f"{name} must be finite; {np.count_nonzero(~np.isfinite(value.data))} entries are not")
    return narrowed(value)


def square_blocks(name: str, value: Any, size: int) -> sparse.bsr_array:
    """Return a square matrix, checked as by :func:`sparse_matrix`, as bsr with sorted blocks of float64."""
    value = sparse_matrix(name, value)
    rows, columns = value.shape
    if rows != columns or rows % size or not rows:
        raise ValueError(f"{name} must be square with a multiple of {size} rows, got {value.shape}")
    matrix = sparse.bsr_array(value, blocksize=(size, size))
    if matrix.dtype != np.float64:
        matrix = matrix.astype(np.float64)
    return matrix if matrix.has_sorted_indices else matrix.sorted_indices()


def _check_compressed(name: str, value: Any) -> None:
    """The index arrays of a csr, csc or bsr matrix."""
    across = value.format == "csc"
    height, width = value.blocksize if value.format == "bsr" else (1, 1)
    if value.shape[0] % height or value.shape[1] % width:
        raise ValueError(f"{name}: its shape {value.shape} is no multiple of its blocks ({height}, {width})")
    rows, columns = value.shape[0] // height, value.shape[1] // width
    if across:
        rows, columns = columns, rows
    indptr, indices = np.asarray(value.indptr), np.asarray(value.indices)
    if indptr.dtype.kind not in "iu" or indices.dtype.kind not in "iu":
        raise TypeError(f"{name}: indptr and indices must be integers, got {indptr.dtype} and {indices.dtype}")
    if indptr.shape != (rows + 1,) or indptr[0] != 0 or (np.diff(indptr) < 0).any():
        raise ValueError(f"{name}: indptr must be {rows + 1} numbers that rise from 0")
    if indices.ndim != 1 or len(indices) < indptr[-1] or len(value.data) < indptr[-1]:
        raise ValueError(f"{name}: indptr ends at {indptr[-1]}, but there are {len(indices)} indices and "
                         f"{len(value.data)} values")
    _check_indices(name, indices[:indptr[-1]], columns, "row" if across else "column")


def _check_indices(name: str, indices: np.ndarray, size: int, what: str) -> None:
    if len(indices) and (int(indices.min()) < 0 or int(indices.max()) >= size):
        wrong = int(indices.min()) if int(indices.min()) < 0 else int(indices.max())
        raise ValueError(f"{name}: {what} index {wrong} is outside the matrix (0 to {size - 1}, in blocks)")


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
