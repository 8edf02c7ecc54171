"""Argument checks shared by every layer: one line where used, one clear message when they fail.

Each check returns the value in the type the caller wants, or raises ``TypeError`` / ``ValueError`` with the
name of the argument, what was given and what is wanted. Comparisons are written ``not value >= 0`` so that NaN
never passes.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

__all__ = ["TINIEST", "VAST", "array", "boundary_name", "choice", "described", "field", "file_path", "fits", "flag",
           "instance", "integer", "items", "listed", "nonnegative", "number", "offers", "optional_callable", "positive",
           "quantity", "shown", "sparse_matrix", "square_blocks", "strings", "suggestion", "tolerance", "vector"]

VAST, TINIEST = 1e40, 1e-40
"""Physical quantities are smaller than the one, moduli and lengths larger than the other: energies, products of some of
them, are then in the range of double precision."""


def number(name: str, value: Any) -> float:
    """Return ``value`` as a finite float; bools, strings, complex numbers and arrays of several numbers are refused."""
    plain = hasattr(value, "__float__") and not isinstance(value, (bool, np.bool_, str, bytes, np.ma.MaskedArray))
    if not plain or np.iscomplexobj(value):
        raise TypeError(f"{name} must be a number, got {shown(value)}")
    try:
        result = float(value)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(f"{name} must be a number, got {shown(value)}") from None
    if not np.isfinite(result):
        raise ValueError(f"{name} must be finite, got {shown(value)}")
    return result


def positive(name: str, value: Any) -> float:
    """Return ``value`` as a finite float > 0."""
    result = number(name, value)
    if not result > 0:
        raise ValueError(f"{name} must be > 0, got {shown(value)}")
    return result


def nonnegative(name: str, value: Any) -> float:
    """Return ``value`` as a finite float >= 0."""
    result = number(name, value)
    if not result >= 0:
        raise ValueError(f"{name} must be >= 0, got {shown(value)}")
    return result


def quantity(name: str, value: Any, *, positive: bool = False) -> float:
    """Return ``value`` as a float of a size that physics may have, below ``VAST``; ``positive``: > ``TINIEST`` too."""
    result = number(name, value)
    if positive and not result > 0:
        raise ValueError(f"{name} must be > 0, got {shown(value)}")
    if not abs(result) <= VAST or (positive and not result >= TINIEST):
        bounds = f"between {TINIEST:g} and {VAST:g}" if positive else f"at most {VAST:g}"
        raise ValueError(f"{name} must be {bounds} in SI units, got {shown(value)}: beyond that energies leave the "
                         "range of double precision")
    return result


def tolerance(name: str, value: Any) -> float:
    """Return ``value`` as a float between 0 and 1, both excluded: what a relative tolerance is."""
    result = number(name, value)
    if not 0 < result < 1:
        raise ValueError(f"{name} must be > 0 and < 1, a share of the solution, got {shown(value)}")
    return result


def flag(name: str, value: Any) -> bool:
    """Return ``value`` if it is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} must be True or False, got {shown(value)}")
    return bool(value)


def optional_callable(name: str, value: Any, words: str) -> Any:
    """Return ``value`` if it is None or can be called; ``words`` say with what."""
    if value is not None and not callable(value):
        raise TypeError(f"{name} must be None or a function of {words}, got {shown(value)}")
    return value


def integer(name: str, value: Any, minimum: int = 0, maximum: int = 2**63 - 1) -> int:
    """Return ``value`` as an int >= ``minimum`` (floats and bools are refused, numpy integers are fine)."""
    if isinstance(value, (bool, np.bool_, np.ma.MaskedArray)):
        raise TypeError(f"{name} must be an integer, got {shown(value)}")
    try:
        result = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be an integer, got {shown(value)}") from None
    if result < minimum:
        raise ValueError(f"{name} must be >= {minimum}, got {shown(value)}")
    if result > maximum:
        raise ValueError(f"{name} must be <= {maximum}, got {shown(value)}")
    return result


def choice(name: str, value: Any, choices: Iterable[Any]) -> Any:
    """Return ``value`` if it is one of ``choices``."""
    choices = tuple(choices)
    if not any(type(value) is type(known) and value == known for known in choices):
        raise ValueError(f"{name} must be one of {', '.join(map(repr, choices))}, got {shown(value)}")
    return value


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
    """Return a read-only copy of ``value`` as a contiguous array of finite numbers.

    Parameters
    ----------
    name : str
        For messages.
    value : array-like
        Of real numbers; bools, strings, objects and complex numbers are refused, and floats where ``integer``.
    shape : tuple
        Wanted, None for any length.
    integer : bool
        Whole numbers, as int64; otherwise float64.
    """
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
    pointers must rise from 0 to the number of entries. Bsr, csr and csc matrices stay what they are; others become csr.

    Parameters
    ----------
    name : str
        For messages.
    value : scipy sparse matrix
    shape : tuple
        Wanted, None for any.
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
    return value


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


def instance(name: str, value: Any, wanted: type | tuple[type, ...], words: str = "") -> Any:
    """Return ``value`` if it is an instance of ``wanted``; a class in place of an instance is named.

    ``words`` say what is wanted, in place of the names of the types.
    """
    if isinstance(value, wanted):
        return value
    kinds = wanted if isinstance(wanted, tuple) else (wanted,)
    words = words or " or ".join(kind.__name__ for kind in kinds)
    raise TypeError(f"{name} must be {words}, got {described(value)}")


def offers(name: str, value: Any, method: str, words: str) -> Any:
    """Return ``value`` if it is an instance with a method of that name; ``words`` say what is wanted."""
    if isinstance(value, type) or not callable(getattr(value, method, None)):
        raise TypeError(f"{name} must be {words}, got {described(value)}")
    return value


def items(name: str, value: Any, wanted: type | tuple[type, ...], words: str = "") -> tuple[Any, ...]:
    """Return a sequence of instances of ``wanted`` as a tuple; one instance alone stands for a sequence of one."""
    if isinstance(value, wanted):
        return (value,)
    kinds = wanted if isinstance(wanted, tuple) else (wanted,)
    found = listed(name, value, words or " or ".join(kind.__name__ for kind in kinds))
    return tuple(instance(f"{name}[{i}]", item, wanted, words) for i, item in enumerate(found))


def listed(name: str, value: Any, words: str) -> tuple[Any, ...]:
    """Return a sequence as a tuple; ``words`` say of what. Text, mappings, single numbers and matrices are none."""
    try:
        if not isinstance(value, (str, bytes, Mapping, type)) and not sparse.issparse(value):
            return tuple(value)
    except TypeError:
        pass
    raise TypeError(f"{name} must be a sequence of {words}, got {described(value)}")


def strings(name: str, value: Any) -> tuple[str, ...]:
    """Return a sequence of names as a tuple; a string is no sequence of names (it would be split into letters)."""
    words = f"names such as ({value!r},)" if isinstance(value, str) and value.isprintable() else "names"
    return tuple(boundary_name(f"{name}[{i}]", item) for i, item in enumerate(listed(name, value, words)))


def file_path(name: str, value: Any) -> Path:
    """Return a path with ``~`` expanded; TypeError if it is none, ValueError for one with a zero byte or empty."""
    if not isinstance(value, (str, os.PathLike)):
        raise TypeError(f"{name} must be a path (str or pathlib.Path), got {described(value)}")
    text = os.fspath(value)
    if not isinstance(text, str):
        raise TypeError(f"{name} must be a path of text, got {text!r}")
    if not text or "\0" in text:
        raise ValueError(f"{name} must be a path, got {text!r}")
    try:
        return Path(text).expanduser()
    except RuntimeError as error:
        raise ValueError(f"{name}: {text!r} has no home directory: {error}") from None


def fits(name: str, size: float, words: str) -> None:
    """ValueError if ``size`` bytes are more than the main memory of the machine; ``words`` say of what."""
    try:
        memory = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return  # the system does not say
    if size > memory:
        raise ValueError(f"{name}: {words} would take {size / 1e9:.3g} GB, this machine has {memory / 1e9:.3g} GB")


def shown(value: Any) -> str:
    """A short representation of a value for a message, safe to print: at most 80 characters, no lone surrogates."""
    try:
        text = repr(value)
    except Exception as error:  # a representation that fails must not hide the message it belongs to
        text = f"<{type(value).__name__} whose repr fails: {type(error).__name__}>"
    text = text.encode("utf-8", "backslashreplace").decode()
    return text if len(text) <= 80 else f"{text[:77]}..."


def described(value: Any) -> str:
    """A value in a message: a class is called one, with what to write instead."""
    if isinstance(value, type):
        return f"the class {value.__name__}: write {value.__name__}(...) for an instance"
    return shown(value)


def boundary_name(name: str, value: Any) -> str:
    """Return ``value`` if it can be a name of a boundary, body or case: printable text, not empty."""
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, got {shown(value)}")
    if not value:
        raise ValueError(f"{name} must not be empty")
    if not value.isprintable():
        raise ValueError(f"{name} must be printable text without control characters, got {shown(value)}")
    return value


def field(name: str, value: float | Callable[[np.ndarray], np.ndarray], points: np.ndarray,
          *, minimum: float | None = None, maximum: float = VAST) -> np.ndarray:
    """Evaluate a number or a function of position at points.

    Parameters
    ----------
    name : str
        For messages.
    value : float or callable
        A constant, or a vectorised function: points (n, dim) in m -> (n,) values.
    points : (n, dim) array
        Where it is wanted, m.
    minimum : float, optional
        Smallest value allowed.
    maximum : float
        Largest absolute value allowed.

    Returns
    -------
    (n,) float64 array
    """
    n = len(points)
    if callable(value):
        returned = value(points)
        try:
            result = np.asarray(returned)
        except (TypeError, ValueError):
            result = np.asarray(None)
        if result.dtype.kind not in "iuf":
            raise TypeError(f"{name}: the function must return real numbers, got {shown(returned)}")
        if result.shape not in ((), (n,)):
            raise ValueError(f"{name}: the function must return shape ({n},) for points of shape {points.shape}, "
                             f"got {result.shape}")
        result = result.astype(np.float64)
        result = np.broadcast_to(result, (n,)).copy()
    else:
        result = np.full(n, number(name, value))
    bad = ~(np.abs(result) <= maximum)
    if minimum is not None:
        bad |= ~(result >= minimum)
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        wanted = "finite" if minimum is None else f"finite and >= {minimum}"
        if np.isfinite(result[i]) and abs(result[i]) > maximum:
            wanted = f"at most {maximum:g} in SI units"
        raise ValueError(f"{name} must be {wanted}, got {result[i]} at {tuple(float(c) for c in points[i])}")
    return result


def suggestion(name: str, known: Iterable[str]) -> str:
    """The most similar of ``known`` in words, to follow "does not exist"; "" if none is similar."""
    close = get_close_matches(name, list(known), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""
