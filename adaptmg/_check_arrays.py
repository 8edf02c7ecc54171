"""Arrays and sparse matrices as arguments: shape, kind of numbers, finite, and indices that stay inside.

Compiled code follows the index arrays of a matrix wherever they point. They are therefore checked in full, narrowed to
32 bits, the one form that kernels are compiled for, and closed to writing.
"""

from __future__ import annotations

from typing import TypeVar, cast

import numpy as np
from scipy import sparse

from adaptmg._checks import shown

_COMPRESSED = ("csr", "csc", "bsr")
Compressed = sparse.csr_array | sparse.csc_array | sparse.bsr_array
_Compressed = TypeVar("_Compressed", bound=Compressed)
_LARGEST_INDEX = np.iinfo(np.int32).max


def vector(name: str, value: object, size: int | None = None) -> np.ndarray:
    """Return ``value`` as a read-only one-dimensional float64 array of finite numbers."""
    return array(name, value, (size,))


def direction(name: str, value: object, n: int) -> np.ndarray:
    """Return the unit vector of a vector of ``n`` numbers and any length > 0, read-only."""
    result = vector(name, value, n)
    length = np.linalg.norm(result)
    if not length > 0:
        raise ValueError(f"{name} must not be zero, got {shown(value)}")
    result = result / length
    result.flags.writeable = False
    return result


def array(name: str, value: object, shape: tuple[int | None, ...], *, integer: bool = False) -> np.ndarray:
    """Return ``value`` as a read-only contiguous array of finite numbers: a copy, unless it is one that nobody writes.
    """
    kind = "integers" if integer else "real numbers"
    if isinstance(value, np.ma.MaskedArray):
        raise TypeError(f"{name} must be an array of {kind}, got a masked one: fill it first")
    try:
        entries = np.asarray(value)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be an array of {kind}, got {shown(value)}") from None
    if not isinstance(value, np.ndarray) and entries.size == 0 and entries.dtype.kind == "f":
        entries = entries.astype(np.int64)  # an empty list may stand for integers
    if entries.dtype.kind not in ("iu" if integer else "iuf") or _holds_bool(value):
        actual = f"an array of {entries.dtype}" if isinstance(value, np.ndarray) else shown(value)
        raise TypeError(f"{name} must be an array of {kind}, got {actual}")
    _check_shape(name, entries.shape, shape)
    if integer and entries.dtype.kind == "u" and entries.size and int(entries.max()) > np.iinfo(np.int64).max:
        raise ValueError(f"{name} must be below 2**63, got {int(entries.max())}")
    dtype = np.int64 if integer else np.float64
    if (type(value) is np.ndarray and value.dtype == dtype and value.base is None and value.flags.c_contiguous
            and not value.flags.writeable):
        _check_finite(name, value)
        return value
    with np.errstate(over="ignore"):
        result = np.array(entries, dtype=dtype, order="C")
    _check_finite(name, result)
    result.flags.writeable = False
    return result


def _check_shape(name: str, shape: tuple[int, ...], expected: tuple[int | None, ...]) -> None:
    """ValueError unless ``shape`` is ``expected``, where None stands for any size."""
    if len(shape) != len(expected) or any(e is not None and e != s for e, s in zip(expected, shape, strict=True)):
        sizes = ", ".join("n" if e is None else str(e) for e in expected) + ("," if len(expected) == 1 else "")
        raise ValueError(f"{name} must have shape ({sizes}), got {shape}")


def _check_finite(name: str, values: np.ndarray) -> None:
    bad = np.count_nonzero(~np.isfinite(values))
    if bad:
        raise ValueError(f"{name} must be finite; {bad} entries are not")


def _holds_bool(value: object) -> bool:
    """Whether a bool is among the numbers of nested lists and tuples: numpy would make it a number."""
    if isinstance(value, (bool, np.bool_)):
        return True
    return isinstance(value, (list, tuple)) and any(map(_holds_bool, value))


def sparse_matrix(name: str, value: object, shape: tuple[int | None, int | None] = (None, None)) -> Compressed:
    """Return a sparse matrix of real, finite numbers with checked indices of 32 bits where these suffice. Bsr, csr and
    csc matrices keep their format, others become csr."""
    if not sparse.issparse(value):
        raise TypeError(f"{name} must be a scipy sparse matrix, got {type(value).__name__}")
    _check_shape(name, value.shape, shape)
    if value.dtype.kind not in "iuf":
        raise TypeError(f"{name} must hold real numbers, got {value.dtype}")
    try:
        if value.format == "coo":  # whose constructor looks at the indices
            type(value)((value.data, value.coords), shape=value.shape)
        value = value if value.format in _COMPRESSED else value.tocsr()
        _check_format(value)
    except (TypeError, ValueError) as error:
        raise type(error)(f"{name}: {error}") from None
    if value.data.dtype.kind not in "iuf":
        raise TypeError(f"{name} must hold real numbers, got {value.data.dtype}")
    _check_finite(name, value.data)
    return narrowed(value)


def square_blocks(name: str, value: object, size: int) -> sparse.bsr_array:
    """Return a square matrix, checked as by :func:`sparse_matrix`, as bsr with sorted blocks of float64."""
    value = sparse_matrix(name, value)
    rows, columns = value.shape
    if rows != columns or rows % size or not rows:
        raise ValueError(f"{name} must be square with a multiple of {size} rows, got {value.shape}")
    matrix = sparse.bsr_array(value, blocksize=(size, size)).astype(np.float64, copy=False)
    return matrix if matrix.has_sorted_indices else matrix.sorted_indices()


def _check_format(value: Compressed) -> None:
    """TypeError or ValueError where arrays of a matrix were changed after it was made, so that they do not fit."""
    if value.indptr.dtype.kind + value.indices.dtype.kind != "ii":
        raise TypeError(f"indptr and indices must be integers, got {value.indptr.dtype} and {value.indices.dtype}")
    # what scipy's check leaves out: indptr that ends with 0, and rows outside the blocks
    if (np.diff(value.indptr) < 0).any():
        raise ValueError("indptr must not fall")
    if np.mod(value.shape, getattr(value, "blocksize", 1)).any():
        raise ValueError(f"its shape {value.shape} is not a multiple of its blocks {value.blocksize}")
    type(value)(value).check_format()  # which may shorten arrays: not those of the argument


def shape_of(matrix: sparse.sparray) -> tuple[int, int]:
    """Return the shape of a matrix as type checkers take it: of scipy's arrays it may be None to them."""
    return cast(tuple[int, int], matrix.shape)


def narrowed(matrix: _Compressed) -> _Compressed:
    """Return a csr, csc or bsr matrix with indices of 32 bits, where these suffice; values are shared, not copied."""
    if matrix.indices.dtype == matrix.indptr.dtype == np.int32 or max(*matrix.shape, matrix.nnz) > _LARGEST_INDEX:
        return matrix
    arrays = matrix.data, matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)
    return type(matrix)(arrays, shape=matrix.shape)


def indices_frozen(matrix: _Compressed) -> _Compressed:
    """Return the matrix with read-only copies of its index arrays."""
    if not (matrix.indices.flags.writeable or matrix.indptr.flags.writeable):
        return matrix
    arrays = matrix.indices.copy(), matrix.indptr.copy()
    for array in arrays:
        array.flags.writeable = False
    return type(matrix)((matrix.data, *arrays), shape=matrix.shape)
