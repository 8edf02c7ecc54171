"""Checks of arguments, called where a public dataclass is made or a public function is entered.

Each check returns the value in the type that the caller needs, or raises ``TypeError`` /
``ValueError`` with the name of the argument, the condition and the value. Comparisons are written
``not value >= 0`` so that NaN never passes. Compiled code follows the index arrays of a matrix
wherever they point. They are therefore checked in full, narrowed to 32 bits, the one form that
kernels are compiled for, and closed to writing."""

from __future__ import annotations

import operator
import os
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    SupportsIndex,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)

import numpy as np

from adaptmg._machine import memory
from adaptmg._text import brief

if TYPE_CHECKING:  # Netgen's process does without scipy
    from scipy import sparse

    Compressed = sparse.csr_array | sparse.csc_array | sparse.bsr_array
    _Compressed = TypeVar("_Compressed", bound=Compressed)

# the products of seven such quantities stay in the range of double precision, 1e308; half of it
# refuses none of 210 random meshes, pairs and adaptive loops (campaign constants)
VAST = 1e40
TINIEST = 1 / VAST
"""Physical quantities are smaller than ``VAST``, moduli and lengths larger than ``TINIEST``: energies, products of some
of them, are then in the range of double precision."""

#: by how much of their extent places that are computed may miss each other, and sums that vanish
#: their terms: 4096 roundings of double precision, which leave room for a point that comes from a few
#: intersections. A hundredth leaves one of 197 random meshes, pairs and adaptive loops (campaign
#: constants) to Netgen, a hundred times changes one outline
ROUNDING = 4096 * float(np.finfo(np.float64).eps)
#: by how much of their size or extent numbers differ that a user, a file or a library gives for the
#: same thing: places, directions, moduli. A hundredth and a hundred times change none of 197
ALIKE = 1e-9
#: the same of numbers that are often written with six digits: nodes, loads, axes. A hundredth
#: and a hundred times change none of 197, either
SIX_DIGITS = 1e-6

_LARGEST_INDEX = np.iinfo(np.int32).max

_T = TypeVar("_T")
_Key = TypeVar("_Key")
Types = type[_T] | tuple[type[_T], ...]


def number(name: str, value: object) -> float:
    """Return ``value`` as a finite float; bools, strings, complex numbers and arrays of several
    numbers are refused."""
    # most numbers are such; the checks below take time, and numpy has no integers beyond 64 bits
    if (type(value) is float or type(value) is int) and -VAST <= value <= VAST:
        return float(value)
    entries = real_array(value)
    if entries is None or entries.ndim:
        raise TypeError(f"{name} must be a number, got {shown(value)}")
    result = float(entries)
    if not np.isfinite(result):
        raise ValueError(f"{name} must be finite, got {shown(value)}")
    return result


def number_that(words: str, condition: Callable[[float], bool]) -> Callable[[str, object], float]:
    """Return a check for finite numbers with a condition, which ``words`` describe."""

    def check(name: str, value: object) -> float:
        result = number(name, value)
        if not condition(result):
            raise ValueError(f"{name} must be {words}, got {shown(value)}")
        return result

    return check


positive = _positive = number_that("> 0", lambda x: x > 0)
nonnegative = number_that(">= 0", lambda x: x >= 0)
tolerance = number_that("> 0 and < 1, a share of the solution", lambda x: 0 < x < 1)


def quantity(name: str, value: object, *, positive: bool = False) -> float:
    """Return ``value`` as a float of a size that physics may have, at most ``VAST``; ``positive``: >
    ``TINIEST`` too."""
    result = _positive(name, value) if positive else number(name, value)
    if not abs(result) <= VAST or (positive and not result >= TINIEST):
        bounds = f"between {TINIEST:g} and {VAST:g}" if positive else f"at most {VAST:g}"
        raise ValueError(
            f"{name} must be {bounds} in SI units, got {shown(value)}: otherwise energies leave the range "
            "of double precision"
        )
    return result


def integer(name: str, value: object, minimum: int = 0, maximum: int = 2**63 - 1) -> int:
    """Return ``value`` as an int >= ``minimum`` (floats and bools are refused, numpy integers are
    fine)."""
    try:
        if isinstance(value, (bool, np.bool_, np.ma.MaskedArray)):
            raise TypeError
        result = operator.index(cast("SupportsIndex", value))
    except TypeError:
        raise TypeError(f"{name} must be an integer, got {shown(value)}") from None
    if not minimum <= result <= maximum:
        bound = f">= {minimum}" if result < minimum else f"<= {maximum}"
        raise ValueError(f"{name} must be {bound}, got {shown(value)}")
    return result


def flag(name: str, value: object) -> bool:
    """Return ``value`` if it is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name} must be True or False, got {shown(value)}")
    return bool(value)


def choice(name: str, value: _T, choices: Iterable[_T]) -> _T:
    """Return ``value`` if it is one of ``choices``."""
    choices = tuple(choices)
    # of the same type: True is equal to 1
    if not any(type(value) is type(allowed) and value == allowed for allowed in choices):
        raise ValueError(
            f"{name} must be one of {', '.join(map(repr, choices))}, got {shown(value)}"
        )
    return value


def instance(name: str, value: object, types: Types[_T], words: str = "") -> _T:
    """Return ``value`` if it is an instance of ``types``, described by ``words`` or else by their
    names."""
    if isinstance(value, types):
        return value
    raise TypeError(f"{name} must be {words or _names(types)}, got {described(value)}")


def offers(name: str, value: _T, method: str, words: str) -> _T:
    """Return ``value`` if it is an instance with a method of that name; ``words`` describe such
    objects."""
    if isinstance(value, type) or not callable(getattr(value, method, None)):
        raise TypeError(f"{name} must be {words}, got {described(value)}")
    return value


def optional_callable(name: str, value: _T, words: str) -> _T:
    """Return ``value`` if it is None or a function; ``words`` describe its arguments."""
    if value is not None and not callable(value):
        raise TypeError(f"{name} must be None or a function of {words}, got {shown(value)}")
    return value


def function_or(name: str, value: _T, check: Callable[[str, Any], object] = quantity) -> _T:
    """Return a function unchanged, anything else as ``check`` returns it; a class is not a
    function."""
    is_function = callable(value) and not isinstance(value, type)
    return cast("_T", value if is_function else check(name, value))


def items(name: str, value: object, types: Types[_T], words: str = "") -> tuple[_T, ...]:
    """Return a sequence of instances of ``types`` as a tuple; one instance alone stands for a
    sequence of one."""
    entries = (value,) if isinstance(value, types) else listed(name, value, words or _names(types))
    return tuple(instance(f"{name}[{i}]", item, types, words) for i, item in enumerate(entries))


def _names(types: Types[_T]) -> str:
    """Return the names of types as text."""
    return " or ".join(kind.__name__ for kind in (types if isinstance(types, tuple) else (types,)))


@overload
def listed(name: str, value: Iterable[_T], words: str) -> tuple[_T, ...]: ...
@overload
def listed(name: str, value: object, words: str) -> tuple[object, ...]: ...
def listed(name: str, value: object, words: str) -> tuple[object, ...]:
    """Return the items of a sequence, set or generator (not text, a mapping or a matrix) as a tuple;
    ``words`` describe them. An error of the user's generator passes unchanged."""
    try:
        # a sparse matrix, of scipy, which Netgen's process does without
        if isinstance(value, (str, bytes, Mapping, type)) or hasattr(value, "tocsr"):
            raise TypeError
        entries = iter(cast("Iterable[object]", value))
    except TypeError:
        raise TypeError(f"{name} must be a sequence of {words}, got {described(value)}") from None
    return tuple(entries)


def mapping(name: str, value: Mapping[_Key, _T], words: str) -> dict[_Key, _T]:
    """Return a mapping as a dictionary; ``words`` describe keys and values."""
    if not isinstance(value, Mapping):
        raise TypeError(f"{name} must map {words}, got {described(value)}")
    return dict(value)


def strings(name: str, value: object) -> tuple[str, ...]:
    """Return a sequence of names as a tuple; a string is not a sequence of names (it would be split
    into letters)."""
    words = (
        f"names such as ({value!r},)" if isinstance(value, str) and value.isprintable() else "names"
    )
    return tuple(
        boundary_name(f"{name}[{i}]", item) for i, item in enumerate(listed(name, value, words))
    )


def boundary_name(name: str, value: object) -> str:
    """Return ``value`` if it can be a name of a boundary, body or case: printable text, not
    empty."""
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, got {shown(value)}")
    if not value:
        raise ValueError(f"{name} must not be empty")
    if not value.isprintable():
        raise ValueError(
            f"{name} must be printable text without control characters, got {shown(value)}"
        )
    return value


def file_path(name: str, value: object) -> Path:
    """Return a path with ``~`` expanded; TypeError if it is not a path, ValueError if empty or with
    a zero byte."""
    text = os.fspath(value) if isinstance(value, (str, os.PathLike)) else None
    if not isinstance(text, str):
        raise TypeError(f"{name} must be a path (str or pathlib.Path), got {described(value)}")
    if not text or "\0" in text:
        raise ValueError(f"{name} must be a path, got {text!r}")
    try:
        return Path(text).expanduser()
    except RuntimeError as error:
        raise ValueError(f"{name}: {text!r} has no home directory: {error}") from None


def fits(name: str, size: float, words: str) -> None:
    """Raise ValueError if ``size`` bytes are more than the main memory of the machine; ``words``
    name their content."""
    if size > memory():
        raise ValueError(
            f"{name}: {words} would take {size / 1e9:.3g} GB, this machine has {memory() / 1e9:.3g} GB"
        )


def field(
    name: str,
    value: float | Callable[[np.ndarray], np.ndarray],
    points: np.ndarray,
    *,
    minimum: float = -VAST,
) -> np.ndarray:
    """Return the values (n,) of a number or a function of position at points (n, dim)."""
    n = len(points)
    if callable(value):
        try:
            result = value(points)
        except Exception as error:
            error.add_note(f"in the function that {name} is, at points of shape {points.shape}")
            raise
        array = real_array(result)
        if array is None:
            raise TypeError(f"{name}: the function must return real numbers, got {shown(result)}")
        if array.shape not in ((), (n,)):
            raise ValueError(
                f"{name}: the function must return shape ({n},) for points of shape {points.shape}, "
                f"got {array.shape}"
            )
    else:
        array = np.asarray(number(name, value))
    values = np.full(n, array, dtype=np.float64)
    bad = ~((values >= minimum) & (values <= VAST))
    if bad.any():
        i = int(np.argmax(bad))
        bounds = "finite" if minimum == -VAST else f"finite and >= {minimum}"
        if VAST < abs(values[i]) < np.inf:
            bounds = f"at most {VAST:g} in SI units"
        raise ValueError(
            f"{name} must be {bounds}, got {values[i]} at {tuple(float(c) for c in points[i])}"
        )
    return values


def real_array(value: object) -> np.ndarray | None:
    """Return ``value`` as an array of integers or floats; None if it is anything else, or
    masked."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        return None
    return array if array.dtype.kind in "iuf" and not isinstance(value, np.ma.MaskedArray) else None


def vector(name: str, value: object, size: int | None = None) -> np.ndarray:
    """Return ``value`` as a read-only one-dimensional float64 array of finite numbers."""
    return array(name, value, (size,))


def direction(name: str, value: object, n: int) -> np.ndarray:
    """Return the unit vector of a vector of ``n`` numbers and any length > 0, read-only."""
    result = vector(name, value, n)
    length = np.linalg.norm(result)
    if not length > 0:
        raise ValueError(f"{name} must not be zero, got {shown(value)}")
    return vector(name, result / length)


def array(
    name: str, value: object, shape: tuple[int | None, ...], *, integer: bool = False
) -> np.ndarray:
    """Return ``value`` as a read-only contiguous array of finite numbers: a copy, unless it is one
    that nobody writes."""
    entries = real_array(value)
    # an empty list may stand for integers
    if entries is None or (integer and entries.dtype.kind == "f" and entries.size):
        raise TypeError(
            f"{name} must be an array of {'integers' if integer else 'real numbers'}, got {shown(value)}"
        )
    _check_shape(name, entries.shape, shape)
    dtype = np.int64 if integer else np.float64
    if (
        type(value) is np.ndarray
        and value.dtype == dtype
        and value.base is None
        and value.flags.c_contiguous
        and not value.flags.writeable
    ):
        _check_finite(name, value)
        return value
    # numbers too large for the type become infinite, which the check below refuses
    with np.errstate(over="ignore"):
        result = np.array(entries, dtype=dtype, order="C")
    _check_finite(name, result)
    result.flags.writeable = False
    return result


def _check_shape(name: str, shape: tuple[int, ...], expected: tuple[int | None, ...]) -> None:
    """Raise ValueError unless ``shape`` is ``expected``, where None stands for any size."""
    if shape == expected:  # the loop takes 4 us
        return
    if len(shape) != len(expected) or any(
        size is not None and size != n for size, n in zip(expected, shape, strict=True)
    ):
        sizes = ", ".join("n" if size is None else str(size) for size in expected)
        if len(expected) == 1:
            sizes += ","
        raise ValueError(f"{name} must have shape ({sizes}), got {shape}")


def _check_finite(name: str, values: np.ndarray) -> None:
    """Raise ValueError unless all values are finite."""
    bad = np.count_nonzero(~np.isfinite(values))
    if bad:
        raise ValueError(f"{name} must be finite; {bad} entries are not")


def sparse_matrix(
    name: str, value: object, shape: tuple[int | None, int | None] = (None, None)
) -> Compressed:
    """Return a sparse matrix of real, finite numbers with checked indices of 32 bits where these
    suffice. Bsr, csr and csc matrices keep their format, others become csr."""
    from scipy import sparse

    if not sparse.issparse(value):
        raise TypeError(f"{name} must be a scipy sparse matrix, got {type(value).__name__}")
    matrix = cast("sparse.coo_array | Compressed", value)  # or another that offers tocsr
    _check_shape(name, matrix.shape, shape)
    if matrix.dtype.kind not in "iuf":
        raise TypeError(f"{name} must hold real numbers, got {matrix.dtype}")
    try:
        if matrix.format == "coo":  # whose constructor looks at the indices
            type(matrix)((matrix.data, matrix.coords), shape=matrix.shape)
        as_given = matrix.format in ("csr", "csc", "bsr")
        compressed = cast("Compressed", matrix if as_given else matrix.tocsr())
        _check_format(compressed)
    except (TypeError, ValueError) as error:
        raise type(error)(f"{name}: {error}") from None
    if compressed.data.dtype.kind not in "iuf":
        raise TypeError(f"{name} must hold real numbers, got {compressed.data.dtype}")
    _check_finite(name, compressed.data)
    return narrowed(compressed)


def square_blocks(name: str, value: object, size: int) -> sparse.bsr_array:
    """Return a square matrix, checked as by :func:`sparse_matrix`, as bsr with sorted blocks of
    float64."""
    from scipy import sparse

    value = sparse_matrix(name, value)
    rows, columns = value.shape
    if rows != columns or rows % size or not rows:
        raise ValueError(f"{name} must be square with a multiple of {size} rows, got {value.shape}")
    matrix = sparse.bsr_array(value, blocksize=(size, size)).astype(np.float64, copy=False)
    return matrix if matrix.has_sorted_indices else matrix.sorted_indices()


def _check_format(value: Compressed) -> None:
    """Raise TypeError or ValueError if the arrays of a matrix do not fit together, as where they were
    changed after it was made."""
    if value.indptr.dtype.kind + value.indices.dtype.kind != "ii":
        raise TypeError(
            f"indptr and indices must be integers, got {value.indptr.dtype} and {value.indices.dtype}"
        )
    # what scipy's check leaves out: indptr that ends with 0, and rows outside the blocks
    if (np.diff(value.indptr) < 0).any():
        raise ValueError("indptr must not fall")
    blocks = getattr(value, "blocksize", 1)
    if np.mod(value.shape, blocks).any():
        raise ValueError(f"its shape {value.shape} is not a multiple of its blocks {blocks}")
    type(value)(value).check_format()  # which may shorten arrays: not those of the argument


def shape_of(matrix: Compressed) -> tuple[int, int]:
    """Return the shape of a matrix, for type checkers: to them that of scipy's arrays may be
    None."""
    return cast("tuple[int, int]", matrix.shape)


def narrowed(matrix: _Compressed) -> _Compressed:
    """Return a csr, csc or bsr matrix with indices of 32 bits, where these suffice; values are
    shared, not copied."""
    if (
        matrix.indices.dtype == matrix.indptr.dtype == np.int32
        or max(*matrix.shape, matrix.nnz) > _LARGEST_INDEX
    ):
        return matrix
    arrays = matrix.data, matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)
    return type(matrix)(arrays, shape=matrix.shape)


@lru_cache(maxsize=100)
def no_entries(shape: tuple[int, int]) -> sparse.csr_array:
    """Return a matrix of a shape without entries, made once: scipy takes 20 us to make one."""
    from scipy import sparse

    return sparse.csr_array(shape)


def freeze(*values: object) -> None:
    """Make the arrays among some values read-only."""
    for value in values:
        if isinstance(value, np.ndarray):
            value.flags.writeable = False


def indices_frozen(matrix: _Compressed) -> _Compressed:
    """Return the matrix with read-only copies of its index arrays."""
    if not (matrix.indices.flags.writeable or matrix.indptr.flags.writeable):
        return matrix
    arrays = matrix.indices.copy(), matrix.indptr.copy()
    freeze(*arrays)
    return type(matrix)((matrix.data, *arrays), shape=matrix.shape)


def shown(value: object) -> str:
    """Return a representation of at most 80 characters for a message, without lone surrogates."""
    try:
        text = repr(value)
    except (
        Exception
    ) as error:  # a representation that fails must not hide the message it belongs to
        text = f"<{type(value).__name__} whose repr fails: {type(error).__name__}>"
    text = text.encode("utf-8", "backslashreplace").decode()
    return text if len(text) <= 80 else f"{text[:77]}..."


def described(value: object) -> str:
    """Return a value for a message; a class is called one, with the instance to write instead."""
    if isinstance(value, type):
        return f"the class {value.__name__}: write {value.__name__}(...) for an instance"
    return shown(value)


def suggestion(name: str, names: Iterable[str]) -> str:
    """Return the most similar of ``names`` as text to follow "does not exist"; "" if none is
    similar."""
    close = get_close_matches(name, list(names), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


class Checked:
    """A frozen dataclass whose annotations say how its fields are checked.

    A field ``Annotated[T, check]`` becomes what ``check(name, value)`` returns, and a field
    ``Literal[...]`` must be one of these values; with ``| None`` it may be None too. A class made
    with ``repr=False`` prints the fields that differ from their defaults."""

    __repr__ = brief

    def __post_init__(self) -> None:
        for name, check, optional in _field_checks(type(self)):
            value = getattr(self, name)
            if value is not None or not optional:
                object.__setattr__(self, name, check(name, value))


@cache
def _field_checks(kind: type) -> list[tuple[str, Callable[[str, object], object], bool]]:
    """Return for each check of a field its name, the check, and whether the field may be None."""
    # annotations of a user's subclass may be names that only type checkers know
    owner = next(base for base in kind.__mro__ if base.__module__.startswith("adaptmg."))
    result = []
    for name, hint in get_type_hints(owner, include_extras=True).items():
        alternatives = (hint, *get_args(hint))
        optional = type(None) in alternatives
        for alternative in alternatives:
            found = getattr(alternative, "__metadata__", ())
            if get_origin(alternative) is Literal:
                found = (partial(choice, choices=get_args(alternative)),)
            result += [(name, check, optional) for check in found if callable(check)]
    return result


FieldLike = (
    float | Callable[[np.ndarray], np.ndarray]
)  # a number, or a function of position (n, dim) -> (n,)
Name = Annotated[str, boundary_name]
Flag = Annotated[bool, flag]
Quantity = Annotated[float, quantity]
Size = Annotated[float, partial(quantity, positive=True)]
Value = Annotated[FieldLike, function_or]
Positive = Annotated[float, positive]
Nonnegative = Annotated[float, nonnegative]
Tolerance = Annotated[float, tolerance]
Whole = Annotated[int, integer]  # >= 0
Count = Annotated[int, partial(integer, minimum=1)]
