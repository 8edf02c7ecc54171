"""The keys of a study file, and what their values must be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from adaptmg.cli.choices import CorrectionName, LawName, LinearName, Shape, SolverName, TransferName
from adaptmg.problem import checks

__all__ = ["KINDS", "SECTIONS", "Check", "plain"]

Check = Callable[[str, Any], Any]


def _text(name: str, value: Any) -> str:
    return checks.boundary_name(name, value)


def _one_of(*names: str) -> Check:
    choices = tuple(map(str, names))

    def check(name: str, value: Any) -> str:
        if not isinstance(value, str) or value not in choices:
            near = checks.suggestion(value, choices) if isinstance(value, str) else ""
            raise ValueError(f"{name} must be one of {', '.join(choices)}, got {checks.shown(value)}{near}")
        return value

    return check


def _list_of(check: Check, words: str) -> Check:
    def checked(name: str, value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple) or not value:
            raise TypeError(f"{name} must be a list of {words}, got {checks.shown(value)}")
        return tuple(check(f"{name}[{k}]", item) for k, item in enumerate(value))

    return checked


def _whole(name: str, value: Any) -> int:
    return checks.integer(name, value, minimum=1)


def _count(name: str, value: Any) -> int:
    return checks.integer(name, value)


def _factors(name: str, value: Any) -> Any:
    return _list_of(checks.number, "factors, one a step")(name, value) if isinstance(value, list | tuple) else \
        checks.number(name, value)


def plain(name: str, value: Any) -> Any:
    """Any value that can be a parameter; lists become tuples."""
    if isinstance(value, list | tuple):
        return tuple(plain(f"{name}[{k}]", item) for k, item in enumerate(value))
    if isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{name} must be a number, text, true, false, or a list of those, got {checks.shown(value)}")


#: by section and key: the check of a value; a section that is None takes any keys of its own
SECTIONS: dict[str, dict[str, Check]] = {
    "case": {"case": _text, "law": _one_of(*LawName), "friction": checks.nonnegative, "limit": checks.nonnegative},
    "hierarchy": {"divisions": _list_of(_whole, "whole numbers"), "sizes": _list_of(checks.positive, "sizes in m"),
                  "contact_ratio": checks.positive, "transfer": _one_of(*TransferName)},
    "solver": {"method": _one_of(*SolverName), "correction": _one_of(*CorrectionName), "cycle": _one_of(*Shape),
               "pre": _count, "post": _count, "omega": checks.positive, "linear": _one_of(*LinearName),
               "rtol": checks.tolerance, "max_cycles": _whole},
    "adapt": {"start": checks.positive, "indicator": _one_of("residual", "recovery"),
              "engine": _one_of("remesh", "bisect"), "theta": checks.tolerance, "tolerance": checks.tolerance,
              "max_nodes": _whole, "max_seconds": checks.positive},
    "load_path": {"default": _factors},
    "measure": {"columns": _list_of(_text, "names"), "keep": checks.flag},
    "run": {"workers": _whole, "limit_s": checks.positive, "memory_limit": checks.positive, "cost": _text},
    "design": {"kind": _one_of("grid", "zip", "random", "latin-hypercube", "sobol"), "runs": _whole, "seed": _count,
               "log": _list_of(_text, "names")},
    "vary": {},
}
#: sections that take keys beside those, with the check of their values
KINDS: dict[str, Check] = {"case": plain, "load_path": _factors}
