"""Argument checks shared by every layer: one line where used, one clear message when they fail.

Each check returns the value in the type the caller wants, or raises ``TypeError`` / ``ValueError`` with the
name of the argument, what was given and what is wanted. Comparisons are written ``not value >= 0`` so that NaN
never passes. Arrays and matrices: :mod:`adaptmg._check_arrays`.
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

__all__ = ["TINIEST", "VAST", "boundary_name", "choice", "described", "field", "file_path", "fits", "flag", "instance",
           "integer", "items", "listed", "nonnegative", "number", "offers", "optional_callable", "positive", "quantity",
           "shown", "strings", "suggestion", "tolerance"]

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
    """Evaluate a number or a function of position at points."""
    n = len(points)
    if callable(value):
        returned = value(points)
        if isinstance(returned, np.ma.MaskedArray):
            raise TypeError(f"{name}: the function must return real numbers, got a masked array: fill it first")
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
