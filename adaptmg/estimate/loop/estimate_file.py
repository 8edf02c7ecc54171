"""Estimates as plain values: what a store keeps of them beside their squares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.goals.goal_estimate import GoalEstimate

__all__ = ["estimate_from", "plain_estimate"]

#: kinds that come back as they were; others, one's own, as Estimate
_KINDS = {kind.__name__: kind for kind in (Estimate, GoalEstimate)}
_ARRAYS = ("values", "errors", "residuals")


def plain_estimate(estimate: Estimate) -> dict[str, Any]:
    """Everything but ``squares``, as JSON has it."""
    name = type(estimate).__name__
    kind = name if _KINDS.get(name) is type(estimate) else "Estimate"
    names = [part.name for part in fields(_KINDS[kind]) if part.name != "squares"]
    return {"kind": kind} | {name: _plain(getattr(estimate, name)) for name in names}


def estimate_from(squares: np.ndarray, said: Mapping[str, Any]) -> Estimate:
    """The inverse of :func:`plain_estimate`; KeyError, TypeError or ValueError where it says something else."""
    values = dict(said)
    kind = _KINDS[values.pop("kind")]
    for name, value in values.items():
        if isinstance(value, list):
            values[name] = np.array(value, dtype=np.float64) if name in _ARRAYS else tuple(value)
    return kind(squares=squares, **values)


def _plain(value: Any) -> Any:
    """Of numpy's numbers and arrays, tuples and mappings."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {name: _plain(part) for name, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, tuple | list) else value
