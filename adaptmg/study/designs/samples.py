"""Samples of ranges: independent, Latin hypercube, Sobol sequence (:mod:`scipy.stats.qmc`); repeats with seeds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptmg.problem import checks
from adaptmg.study.designs.design import Design, Grid, Point, Points, as_design, check_length
from adaptmg.study.record import Value, canonical

__all__ = ["LatinHypercube", "Random", "Repeated", "Sobol"]


@dataclass(frozen=True)
class _Range:
    """Where a parameter is sampled."""

    name: str
    low: float
    high: float
    whole: bool
    logarithmic: bool

    def at(self, u: np.ndarray) -> list[Value]:
        """From numbers in [0, 1)."""
        if self.whole:
            return [int(k) for k in np.minimum(self.low + np.floor(u * (self.high - self.low + 1)), self.high)]
        if self.logarithmic:
            return np.clip(self.low * (self.high / self.low)**u, self.low, self.high).tolist()
        return (self.low + u * (self.high - self.low)).tolist()


def _range(name: str, given: Any, logarithmic: bool) -> _Range:
    if not isinstance(name, str):
        raise TypeError(f"the names of parameters must be strings, got {checks.shown(name)}")
    ends = checks.listed(f"ranges[{name!r}]", given, "two numbers, (low, high)")
    if len(ends) != 2:
        raise ValueError(f"ranges[{name!r}] must be two numbers, (low, high), got {checks.shown(given)}")
    low, high = (checks.number(f"ranges[{name!r}]", end) for end in ends)
    whole = all(isinstance(end, int | np.integer) for end in ends)
    if not low < high:
        raise ValueError(f"ranges[{name!r}] must go up, got {checks.shown(given)}")
    if logarithmic and (whole or not low > 0):
        raise ValueError(f"ranges[{name!r}] must be two floats > 0 for a logarithmic scale, got {checks.shown(given)}")
    return _Range(name, low, high, whole, logarithmic)


class _Sample(Points):
    """Points that a generator in the unit cube gives."""

    def __init__(self, ranges: Mapping[str, Any], runs: int, *, seed: int = 0, log: Iterable[str] = ()) -> None:
        if not isinstance(ranges, Mapping) or not ranges:
            raise TypeError(f"ranges must be a mapping of names to (low, high), got {checks.shown(ranges)}")
        count = check_length(checks.integer("runs", runs, minimum=1))
        number = checks.integer("seed", seed)
        logarithmic = set(checks.strings("log", (log,) if isinstance(log, str) else log))
        unknown = sorted(logarithmic - set(ranges))
        if unknown:
            raise ValueError(f"log names {unknown}, but the ranges are {list(ranges)}")
        found = [_range(name, given, name in logarithmic) for name, given in ranges.items()]
        columns = self._unit_cube(count, len(found), number).T
        values = {item.name: item.at(column) for item, column in zip(found, columns, strict=True)}
        rows = [dict(zip(values, row, strict=True)) for row in zip(*values.values(), strict=True)]
        # whole numbers may meet
        super().__init__(list({canonical(point): point for point in rows}.values()))

    def _unit_cube(self, count: int, dim: int, seed: int) -> np.ndarray:
        raise NotImplementedError


class Random(_Sample):
    """Independent points, uniform in ranges.

    Parameters
    ----------
    ranges : mapping of str to (low, high)
        Two floats: numbers between them; two integers: whole numbers, both ends included.
    runs : int
        How many points; fewer where points of whole numbers meet.
    seed : int
        The same seed gives the same points, on every machine.
    log : sequence of str
        Names of ranges that are sampled on a logarithmic scale.
    """

    def _unit_cube(self, count: int, dim: int, seed: int) -> np.ndarray:
        return np.random.default_rng(seed).random((count, dim))


class LatinHypercube(_Sample):
    """A Latin hypercube: each of ``runs`` slices of each range holds one point. Parameters as :class:`Random`."""

    def _unit_cube(self, count: int, dim: int, seed: int) -> np.ndarray:
        from scipy.stats import qmc

        return qmc.LatinHypercube(dim, rng=np.random.default_rng(seed)).random(count)


class Sobol(_Sample):
    """The first points of a scrambled Sobol sequence. Parameters as :class:`Random`.

    More runs of the same seed keep the points there are and add to them; a power of 2 is balanced.
    """

    def _unit_cube(self, count: int, dim: int, seed: int) -> np.ndarray:
        from scipy.stats import qmc

        sequence = qmc.Sobol(dim, rng=np.random.default_rng(seed), bits=30)
        # the balance of a power of 2 is the user's choice: no warning
        return sequence.random_base2(math.ceil(math.log2(count)))[:count] if count > 1 else sequence.random(1)


class Repeated(Design):
    """Each point of a design several times, with seeds.

    Parameters
    ----------
    design : design, or what stands for one
    times : int
    name : str
        The parameter that takes the seed.
    first : int
        The first seed; the others follow.

    Examples
    --------
    >>> [p["seed"] for p in Repeated({"n": [1]}, 3, first=7).points()]
    [7, 8, 9]
    """

    def __init__(self, design: Any, times: int, *, name: str = "seed", first: int = 0) -> None:
        inner = as_design("design", design)
        start, count = checks.integer("first", first), checks.integer("times", times, minimum=1)
        check_length(count * len(inner))
        self._design = inner * Grid({checks.boundary_name("name", name): range(start, start + count)})
        self.names = self._design.names

    def __len__(self) -> int:
        return len(self._design)

    def points(self) -> Iterator[Point]:
        """The points, in order."""
        return self._design.points()
