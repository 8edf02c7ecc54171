"""Checks of what a study is given: names, function, and the order in which runs are computed."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from adaptmg.problem import checks
from adaptmg.study.execute import Point, RunFunction
from adaptmg.study.record import DETAILS, RESERVED, Record, canonical

__all__ = ["check_names", "check_run_function", "in_order"]

Cost = Callable[[Point], float] | str


def check_run_function(run: Any) -> None:
    """TypeError for what is no plain function: of other callables one cannot tell what they depend on."""
    if not inspect.isfunction(run):
        raise TypeError(f"run must be a plain function (def), got {run!r}; give constants with fixed={{...}}")
    if inspect.iscoroutinefunction(run) or inspect.isgeneratorfunction(run) or inspect.isasyncgenfunction(run):
        raise TypeError(f"run must return a dict, but {run.__name__} is a generator or a coroutine")


def check_names(run: RunFunction, names: Sequence[str], fixed: Mapping[str, Any]) -> None:
    """Names that are taken twice, or that the function does not take."""
    for name in (*fixed, *names):
        if not isinstance(name, str):
            raise TypeError(f"the names of parameters must be strings, got {checks.shown(name)}")
        if name in RESERVED or name in DETAILS:
            raise ValueError(f"parameter {name!r} has the name of a column of the study: rename it")
    if set(names) & set(fixed):
        raise ValueError(f"{sorted(set(names) & set(fixed))} are both in parameters and in fixed")
    given = [*fixed, *names]
    try:
        inspect.signature(run).bind(**dict.fromkeys(given))
    except TypeError as error:
        raise TypeError(f"the run function {run.__name__}{inspect.signature(run)} does not take the parameters "
                        f"{', '.join(given)}: {error}") from None


def in_order(points: list[Point], cost: Cost | None, stored: Mapping[str, Record]) -> list[Point]:
    """The most expensive runs first, so that none of them is started when the others are done.

    Parameters
    ----------
    points : list of dict
    cost : callable, str or None
        A function of the point; the name of a parameter; or that of a result or ``"seconds"``, taken from what is
        stored. None: as they come.
    stored : mapping
        Records by :func:`canonical` parameters.
    """
    if cost is None or not points:
        return points
    if not (callable(cost) or isinstance(cost, str)):
        raise TypeError(f"cost must be a function of a point, or the name of a column, got {checks.described(cost)}")

    def of(point: Point) -> float:
        if callable(cost):
            return checks.number("cost", cost(dict(point)))
        if cost in point:
            return checks.number(f"cost: parameter {cost!r}", point[cost])
        record = stored.get(canonical(point))
        value = None if record is None else record.seconds if cost == "seconds" else record.results.get(cost)
        # what is not known may be long
        return float(value) if isinstance(value, int | float) and not math.isnan(value) else math.inf

    return sorted(points, key=of, reverse=True)
