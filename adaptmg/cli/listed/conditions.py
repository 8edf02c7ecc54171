"""Conditions on runs, ``NAME=VALUE``: parameters, results and what a store adds, compared as numbers or as text."""

from __future__ import annotations

import json
import math
import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from adaptmg.problem import checks
from adaptmg.study.record import DETAILS, RESERVED, Record

__all__ = ["RowFilter", "matching", "parsed"]

_ORDERED: dict[str, Callable[[Any, Any], bool]] = {"<": operator.lt, "<=": operator.le, ">": operator.gt,
                                                   ">=": operator.ge}
_ABSENT = object()


@dataclass(frozen=True)
class RowFilter:
    """A condition on one column.

    Attributes
    ----------
    name : str
        Of the column.
    sign : str
        One of ``= != < <= > >=``.
    text : str
        The value as it was written.
    """

    name: str
    sign: str
    text: str

    def holds(self, value: Any) -> bool:
        """Whether a value meets it; ``<`` and the like hold for numbers only."""
        if self.sign in _ORDERED:
            return type(value) in (int, float) and _ORDERED[self.sign](value, float(self.text))
        return _is(value, self.text) == (self.sign == "=")


def parsed(text: str) -> RowFilter:
    """The condition that a text says."""
    found = re.fullmatch(r"([^=<>!]+)(=|!=|<=|>=|<|>)(.*)", text, re.DOTALL)
    if not found:
        raise ValueError(f"--where must be NAME=VALUE, or with !=, <, <=, > or >=, got {checks.shown(text)}")
    made = RowFilter(found[1].strip(), found[2], found[3].strip())
    if made.sign in _ORDERED and _number(made.text) is None:
        raise ValueError(f"--where {made.name}{made.sign} must be followed by a number, got {checks.shown(made.text)}")
    return made


def matching(records: Sequence[Record], conditions: Sequence[RowFilter]) -> list[Record]:
    """The runs for which all conditions hold; ValueError for a column that no run has."""
    names = dict.fromkeys([*(name for record in records for name in (*record.parameters, *record.results)),
                           *RESERVED, *DETAILS])
    for condition in conditions:
        if condition.name not in names:
            raise ValueError(f"there is no column {condition.name!r}{checks.suggestion(condition.name, names)}; there "
                             f"are {', '.join(names)}")
        records = [record for record in records if condition.holds(_value(record, condition.name))]
    return list(records)


def _value(record: Record, name: str) -> Any:
    for values in (record.parameters, record.results):
        if name in values:
            return values[name]
    return getattr(record, name) if name in RESERVED or name in DETAILS else _ABSENT


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return None if math.isnan(number) else number


def _is(value: Any, text: str) -> bool:
    """Whether a value is the one that a text says: as text, as a number, or as JSON (true, null, lists)."""
    if value is _ABSENT:
        return False
    if str(value) == text:
        return True
    if type(value) in (int, float):
        return value == _number(text)
    try:
        given = json.loads(text)
    except ValueError:
        return False
    if isinstance(given, list):
        return isinstance(value, tuple) and json.loads(json.dumps(value)) == given
    return type(value) is type(given) and value == given
