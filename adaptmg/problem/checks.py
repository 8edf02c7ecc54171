"""Argument checks shared by every layer: one line where used, one clear message when they fail.

Each check returns the value in the type the caller wants, or raises ``TypeError`` / ``ValueError`` with the
name of the argument, what was given and what is wanted. Comparisons are written ``not value >= 0`` so that NaN
never passes.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from typing import Any

import numpy as np

__all__ = ["boundary_name", "choice", "field", "integer", "nonnegative", "number", "positive",
           "suggestion", "vector"]


def number(name: str, value: Any) -> float:
    """Return ``value`` as a finite float."""
    try:
        result = float(value)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be a number, got {value!r}") from None
    if not np.isfinite(result):
        raise ValueError(f"{name} must be finite, got {value!r}")
    return result


def positive(name: str, value: Any) -> float:
    """Return ``value`` as a finite float > 0."""
    result = number(name, value)
    if not result > 0:
        raise ValueError(f"{name} must be > 0, got {value!r}")
    return result


def nonnegative(name: str, value: Any) -> float:
    """Return ``value`` as a finite float >= 0."""
    result = number(name, value)
    if not result >= 0:
        raise ValueError(f"{name} must be >= 0, got {value!r}")
    return result


def integer(name: str, value: Any, minimum: int = 0) -> int:
    """Return ``value`` as an int >= ``minimum`` (floats are refused, numpy integers are fine)."""
    try:
        result = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} must be an integer, got {value!r}") from None
    if result < minimum:
        raise ValueError(f"{name} must be >= {minimum}, got {value!r}")
    return result


def choice(name: str, value: Any, choices: Iterable[str]) -> str:
    """Return ``value`` if it is one of ``choices``."""
    choices = tuple(choices)
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, choices))}, got {value!r}")
    return value


def vector(name: str, value: Any, size: int | None = None) -> np.ndarray:
    """Return ``value`` as a read-only one-dimensional float64 array of finite numbers."""
    try:
        result = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"{name} must be a sequence of numbers, got {value!r}") from None
    if result.ndim != 1 or (size is not None and result.size != size):
        wanted = "a vector" if size is None else f"a vector of {size} numbers"
        raise ValueError(f"{name} must be {wanted}, got shape {result.shape}")
    if not np.isfinite(result).all():
        raise ValueError(f"{name} must be finite, got {value!r}")
    result.flags.writeable = False
    return result


def boundary_name(name: str, value: Any) -> str:
    """Return ``value`` if it can be the name of a boundary: a non-empty string."""
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, got {value!r}")
    if not value:
        raise ValueError(f"{name} must not be empty")
    return value


def field(name: str, value: float | Callable[[np.ndarray], np.ndarray], points: np.ndarray,
          *, minimum: float | None = None) -> np.ndarray:
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

    Returns
    -------
    (n,) float64 array
    """
    n = len(points)
    if callable(value):
        result = np.asarray(value(points), dtype=np.float64)
        if result.shape not in ((), (n,)):
            raise ValueError(f"{name}: the function must return shape ({n},) for points of shape {points.shape}, "
                             f"got {result.shape}")
        result = np.broadcast_to(result, (n,)).copy()
    else:
        result = np.full(n, number(name, value))
    bad = ~np.isfinite(result)
    if minimum is not None:
        bad |= ~(result >= minimum)
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        wanted = "finite" if minimum is None else f"finite and >= {minimum}"
        raise ValueError(f"{name} must be {wanted}, got {result[i]} at {tuple(float(c) for c in points[i])}")
    return result


def suggestion(name: str, known: Iterable[str]) -> str:
    """The most similar of ``known`` in words, to follow "does not exist"; "" if none is similar."""
    close = get_close_matches(name, list(known), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""
