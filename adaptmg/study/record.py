"""Record: one run of a study as plain values, and the canonical text by which a run is known.

A run is known by the JSON of its parameters with sorted keys, so the order in which parameters are given does not
matter; 1 and 1.0 are different values. NaN and the infinities are written as ``NaN`` and ``Infinity``, which Python
reads back.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

__all__ = ["Record", "Scalar", "Value", "canonical", "parameter_value", "plain_results", "restored"]

Scalar = bool | int | float | str | None
Value = Scalar | tuple["Value", ...]

#: columns that :meth:`adaptmg.study.Study.run` adds to parameters and results
RESERVED = ("status", "seconds", "error")


@dataclass(frozen=True, kw_only=True)
class Record:
    """What is known of one run.

    Attributes
    ----------
    parameters : dict
        All of them, the fixed ones too.
    status : {"done", "failed"}
    results : dict of str to bool, int, float, str or None
        Empty where the run failed.
    error : str
        Type and text of the exception of a failed run, else empty.
    seconds : float
        Wall time of the run.
    code : str
        Hash of the source the results depend on, see :mod:`adaptmg.study.fingerprint`.
    versions : dict of str to str
        Of Python and of the packages the results depend on.
    finished : str
        When, UTC, ISO 8601.
    """

    parameters: dict[str, Value]
    status: str
    results: dict[str, Scalar] = field(default_factory=dict)
    error: str = ""
    seconds: float = 0.0
    code: str = ""
    versions: dict[str, str] = field(default_factory=dict)
    finished: str = ""


def _scalar(value: Any) -> Any:
    """Numpy scalars, and arrays without an axis, as Python's own."""
    return value.item() if isinstance(value, np.generic | np.ndarray) and not value.ndim else value


def parameter_value(name: str, value: Any) -> Value:
    """``value`` as a plain number, string, bool, None or tuple of those; TypeError for anything else."""
    value = _scalar(value)
    if isinstance(value, tuple):
        return tuple(parameter_value(name, v) for v in value)
    if isinstance(value, str) and any("\ud800" <= c <= "\udfff" for c in value):
        raise ValueError(f"parameter {name!r} must be text that can be stored, got lone surrogates: {value!a}")
    if value is None or type(value) in (bool, int, float, str):
        return value
    raise TypeError(f"parameter {name!r} must be a number, string, bool, None or a tuple of those, got {value!r}; "
                    "pass a name or a number and build the object in the run function")


def plain_results(results: Any, parameters: Mapping[str, Value]) -> dict[str, Scalar]:
    """What a run function returned, checked: a flat mapping of names to numbers, strings, bools or None."""
    if not isinstance(results, Mapping):
        raise TypeError(f"the run function must return a dict of numbers, strings and bools, got {results!r}")
    plain = {}
    for name, value in results.items():
        if not isinstance(name, str):
            raise TypeError(f"the names of results must be strings, got {name!r}")
        if name in parameters or name in RESERVED:
            taken = "a parameter" if name in parameters else "a column of the study"
            raise ValueError(f"result {name!r} has the name of {taken}: rename it (e.g. 'solver_{name}')")
        value = _scalar(value)
        if value is not None and type(value) not in (bool, int, float, str):
            raise TypeError(f"result {name!r} must be a number, string, bool or None, got {value!r}; "
                            "reduce arrays to numbers, or save them to a file and return its name")
        plain[name] = value
    return plain


def canonical(parameters: Mapping[str, Value]) -> str:
    """The text by which a run is known."""
    return json.dumps(parameters, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def restored(value: Any) -> Any:
    """Undo what JSON does to tuples."""
    if isinstance(value, list):
        return tuple(restored(v) for v in value)
    return value
