"""OnDemand: a field of a frozen dataclass whose value is made when it is first read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

__all__ = ["OnDemand", "made_on_demand"]


@dataclass(frozen=True)
class OnDemand:
    """What a field is given in place of its value.

    Parameters
    ----------
    make : callable
        Of the object that has the field; returns the value. A function of a module, or a ``functools.partial`` of one,
        so that objects which nobody has asked yet can be pickled.
    """

    make: Callable[[Any], Any]


def made_on_demand(name: str, doc: str) -> property:
    """A property to put in the place of the field ``name`` of a dataclass, after its class statement.

    The field keeps its default and its place in ``__init__``, and may be given a value or an :class:`OnDemand`.
    ``dataclasses.replace`` reads it: say what the new value is, where it depends on what is replaced.
    """
    def value(owner: Any) -> Any:
        held = owner.__dict__[name]
        if isinstance(held, OnDemand):
            held = owner.__dict__[name] = held.make(owner)
        return held

    def keep(owner: Any, given: Any) -> None:
        owner.__dict__[name] = given

    return property(value, keep, doc=doc)
