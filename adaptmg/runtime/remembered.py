"""remembered: what a function of one immutable object returned is kept as long as the object lives."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

__all__ = ["remembered"]

Owner = TypeVar("Owner")
Value = TypeVar("Value")


def remembered(function: Callable[[Owner], Value]) -> Callable[[Owner], Value]:
    """A function that computes once for each object; exceptions are not remembered.

    For objects that are the same only if they are identical, and never change: hierarchies that grow keep their coarse
    levels from solve to solve.
    """
    known: WeakKeyDictionary[Owner, Value] = WeakKeyDictionary()

    @wraps(function)
    def asked(owner: Owner) -> Value:
        try:
            return known[owner]
        except KeyError:
            value = known[owner] = function(owner)
            return value

    return asked
