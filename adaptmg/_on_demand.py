"""Values of objects that are computed when they are first read, and remembered as long as the
object lives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any, TypeVar
from weakref import WeakKeyDictionary


@dataclass(frozen=True)
class OnDemand:
    """What a field is given in place of its value."""

    make: Callable[[Any], object]  # of the object that has the field; returns the value


#: the default of a field that reading turns into a value or an error, or that ``__post_init__`` fills
ABSENT: Any = None


def made_on_demand(name: str, doc: str, absent: str = "") -> Any:
    """Return a property to put in the place of the field ``name`` of a dataclass, after its class
    statement.

    The field keeps its default and its place in ``__init__``, and takes a value or an
    :class:`OnDemand`. ``dataclasses.replace`` reads it: say what the new value is, where it depends
    on what is replaced. With ``absent``, the field may be None, and reading it raises ValueError
    with this text."""

    def read(owner: object) -> Any:
        value = owner.__dict__[name]
        if isinstance(value, OnDemand):
            value = owner.__dict__[name] = value.make(owner)
        if value is None and absent:
            raise ValueError(absent)
        return value

    return property(read, lambda owner, value: owner.__dict__.__setitem__(name, value), doc=doc)


class Token:
    """Stands for what an object and its copies have in common."""


Owner = TypeVar("Owner")
Value = TypeVar("Value")


def remembered(
    function: Callable[[Owner], Value], of: Callable[[Owner], object] = lambda owner: owner
) -> Callable[[Owner], Value]:
    """Return a function that computes once for each object, or for ``of`` it; exceptions are not
    remembered. For objects that are the same only if they are identical, and never change: levels
    of hierarchies that grow."""
    values: WeakKeyDictionary[object, Value] = WeakKeyDictionary()

    @wraps(function)
    def remembering(owner: Owner) -> Value:
        key = of(owner)
        if key not in values:
            values[key] = function(owner)
        return values[key]

    return remembering
