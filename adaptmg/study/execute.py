"""Execution of runs: the seam between a study and whatever computes its rows.

An executor takes the run function and the points to compute, and yields ``(point, outcome)`` as they finish, in any
order. The study stores each outcome when it comes, so what was yielded is never lost.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from adaptmg.study.record import Scalar, Value, plain_results

__all__ = ["Execute", "Finished", "compute", "in_turn"]

Point = dict[str, Value]
RunFunction = Callable[..., Any]


@dataclass(frozen=True)
class Finished:
    """What came of one run: results, or the exception; and the seconds it took."""

    results: dict[str, Scalar]
    error: Exception | None
    seconds: float


Execute = Callable[[RunFunction, Iterable[Point]], Iterator[tuple[Point, Finished]]]


def compute(function: RunFunction, point: Point) -> Finished:
    """One run. An exception of the function, or results that cannot be stored, are part of the outcome."""
    begin = time.perf_counter()
    try:
        results = plain_results(function(**point), point)
    except Exception as error:
        return Finished({}, error, time.perf_counter() - begin)
    return Finished(results, None, time.perf_counter() - begin)


def in_turn(function: RunFunction, points: Iterable[Point]) -> Iterator[tuple[Point, Finished]]:
    """Run after run, in this process."""
    for point in points:
        yield point, compute(function, point)
