"""The search for the least energy along a proposed step."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["line_minimum"]

#: halvings of the interval
_HALVINGS = 30


def line_minimum(slope: Callable[[float], float]) -> float:
    """The part of a step, at most all of it (1), up to which a convex energy falls; ``slope`` is its derivative."""
    if slope(1.0) <= 0.0:
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if slope(middle) > 0.0 else (middle, high)
    return low
