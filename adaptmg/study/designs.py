"""Designs: the points of a study.

A grid has every combination of values; other designs are an explicit list, and samples of ranges (independent, Latin
hypercube, Sobol sequence; :mod:`scipy.stats.qmc`). A design knows its length before it makes a point, so that one too
large is refused in time.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg.study.record import Value, canonical, parameter_value

if TYPE_CHECKING:
    import pandas as pd


#: points of a design: some GB of rows
MOST = 2_000_000

Point = dict[str, Value]


class Design:
    """Points of a study."""

    names: tuple[str, ...]  # of the parameters

    def __len__(self) -> int:
        raise NotImplementedError

    def points(self) -> Iterator[Point]:
        """Yield the points, in order."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self.names)}: {len(self)} points)"


#: what stands for a design
DesignLike = Design | Mapping[str, Sequence[Value]] | Sequence[Mapping[str, Value]]


def as_design(name: str, design: DesignLike) -> Design:
    """Return a design unchanged, a mapping of names to sequences as :class:`Grid`, a list as :class:`Points`."""
    if isinstance(design, Design):
        return design
    if isinstance(design, Mapping) and design:
        return Grid(design)
    if isinstance(design, Sequence) and not isinstance(design, str) and design \
            and all(isinstance(p, Mapping) for p in design[:10]):
        return Points(design)
    raise TypeError(f"{name} must be a mapping of names to sequences of values, a list of points, or a design "
                    f"(adaptmg.study.Grid, Points, Random ...), got {checks.described(design)}")


def _check_length(length: int) -> int:
    if length > MOST:
        # numbers of many thousand digits are not printed
        count = length if length < 10**15 else f"more than 10^{int(math.log2(length) * math.log10(2))}"
        raise ValueError(f"the design has {count} points, at most {MOST} are run in one study: take fewer values, or a "
                         "sample (adaptmg.study.Sobol)")
    return length


def _mapping(name: str, mapping: object, words: str) -> Mapping[str, object]:
    if not isinstance(mapping, Mapping) or not mapping:
        raise TypeError(f"{name} must be a mapping of names to {words}, got {checks.shown(mapping)}")
    for key in mapping:
        if not isinstance(key, str):
            raise TypeError(f"the names of parameters must be strings, got {checks.shown(key)}")
    return mapping


def _values(name: str, values: object) -> list[Value]:
    """Return the values of a parameter; a sequence too long, or without an end, is refused before they are made."""
    try:
        length = -1 if isinstance(values, str | Mapping) else len(cast(Sequence[Value], values))
    except OverflowError:
        length = 2**63
    except TypeError:  # a generator, an array without an axis
        length = -1
    if length < 0:
        raise TypeError(f"parameters[{name!r}] must be a sequence of values whose length is known, such as a list, got "
                        f"{checks.shown(values)}: others may have no end")
    if not _check_length(length):
        raise ValueError(f"parameters[{name!r}] is empty: give at least one value")
    return [parameter_value(name, value) for value in cast(Sequence[Value], values)]


class Grid(Design):
    """Every combination of values, the last parameter changing fastest.

    Parameters
    ----------
    parameters : mapping of str to sequence
        Numbers, strings, bools, None or tuples of those; no value twice.

    Examples
    --------
    >>> list(Grid({"n": [1, 2], "law": ["a", "b"]}).points())[1]
    {'n': 1, 'law': 'b'}
    """

    def __init__(self, parameters: Mapping[str, Sequence[Value]]) -> None:
        mapping = _mapping("parameters", parameters, "sequences of values")
        self.values = {name: _values(name, values) for name, values in mapping.items()}
        for name, plain in self.values.items():
            if len({canonical({name: value}) for value in plain}) < len(plain):
                raise ValueError(f"parameters[{name!r}] holds a value twice: {checks.shown(plain)}")
        self.names = tuple(self.values)
        _check_length(len(self))

    def __len__(self) -> int:
        return math.prod(len(values) for values in self.values.values())

    def points(self) -> Iterator[Point]:
        """Yield the points, in order."""
        for values in itertools.product(*self.values.values()):
            yield dict(zip(self.names, values, strict=True))


class Points(Design):
    """An explicit list.

    Parameters
    ----------
    points : sequence of mappings, or pandas.DataFrame
        All with the same names. A point may stand there once: runs with other random numbers have a parameter ``seed``.

    Examples
    --------
    >>> len(list(am.study.Points([{"n": 1}, {"n": 4}]).points()))
    2
    """

    def __init__(self, points: Sequence[Mapping[str, Value]] | pd.DataFrame) -> None:
        if hasattr(points, "to_dict") and hasattr(points, "columns"):
            points = cast(Sequence[Mapping[str, Value]], cast("pd.DataFrame", points).to_dict("records"))
        if isinstance(points, str | Mapping) or not isinstance(points, Sequence) or not points:
            raise TypeError(f"points must be a list of mappings of names to values, got {checks.shown(points)}")
        _check_length(len(points))
        self._points: list[Point] = []
        seen: dict[str, int] = {}
        for k, point in enumerate(points):
            mapping = _mapping(f"points[{k}]", point, "values")
            plain = {name: parameter_value(name, value) for name, value in mapping.items()}
            if self._points and set(plain) != set(self._points[0]):
                raise ValueError(f"points[{k}] has the parameters {', '.join(plain)}, the first "
                                 f"{', '.join(self._points[0])}: give all points the same")
            first = seen.setdefault(canonical(plain), k)
            if first != k:
                raise ValueError(f"points {first} and {k} are the same: {checks.shown(plain)}")
            self._points.append(plain)
        self.names = tuple(self._points[0])

    def __len__(self) -> int:
        return len(self._points)

    def points(self) -> Iterator[Point]:
        """Yield the points, in order."""
        return iter(self._points)


class _Sample(Points):
    """Points from numbers in the unit cube."""

    def __init__(self, ranges: Mapping[str, Sequence[float]], runs: int, *, seed: int = 0,
                 log: str | Iterable[str] = ()) -> None:
        mapping = _mapping("ranges", ranges, "(low, high)")
        count = _check_length(checks.integer("runs", runs, minimum=1))
        logarithmic = set(checks.strings("log", (log,) if isinstance(log, str) else log))
        if unknown := sorted(logarithmic - set(mapping)):
            raise ValueError(f"log names {unknown}, but the ranges are {list(mapping)}")
        ends = {name: _ends(name, pair, name in logarithmic) for name, pair in mapping.items()}
        cube = self._unit_cube(count, len(ends), checks.integer("seed", seed))
        values = [_scaled(u, *pair, name in logarithmic) for u, (name, pair) in zip(cube.T, ends.items(), strict=True)]
        rows = [dict(zip(ends, row, strict=True)) for row in zip(*values, strict=True)]
        # points of whole numbers may coincide
        super().__init__(list({canonical(point): point for point in rows}.values()))

    def _unit_cube(self, count: int, dim: int, seed: int) -> np.ndarray:
        raise NotImplementedError


def _ends(name: str, pair: object, logarithmic: bool) -> tuple[float, float]:
    ends = checks.listed(f"ranges[{name!r}]", cast(Iterable[float], pair), "two numbers, (low, high)")
    if len(ends) != 2:
        raise ValueError(f"ranges[{name!r}] must be two numbers, (low, high), got {checks.shown(pair)}")
    whole = all(isinstance(end, int | np.integer) for end in ends)
    low, high = (checks.number(f"ranges[{name!r}]", end) for end in ends)
    if not low < high:
        raise ValueError(f"ranges[{name!r}] must go up, got {checks.shown(pair)}")
    if logarithmic and (whole or not low > 0):
        raise ValueError(f"ranges[{name!r}] must be two floats > 0 for a logarithmic scale, got {checks.shown(pair)}")
    return (int(low), int(high)) if whole else (low, high)


def _scaled(u: np.ndarray, low: float, high: float, logarithmic: bool) -> list[Value]:
    if isinstance(low, int):
        return [int(k) for k in np.minimum(low + np.floor(u * (high - low + 1)), high)]
    if logarithmic:
        return cast(list[Value], np.clip(low * (high / low)**u, low, high).tolist())
    return cast(list[Value], (low + u * (high - low)).tolist())


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

    Examples
    --------
    >>> design = am.study.Random({"friction": (0.1, 1.0)}, runs=3, seed=1)
    >>> len(list(design.points()))
    3
    """

    def _unit_cube(self, count: int, dim: int, seed: int) -> np.ndarray:
        return np.random.default_rng(seed).random((count, dim))


class LatinHypercube(_Sample):
    """A Latin hypercube: each of ``runs`` slices of each range holds one point. Parameters as :class:`Random`.

    Examples
    --------
    >>> design = am.study.LatinHypercube({"friction": (0.1, 1.0)}, runs=4)
    >>> len(list(design.points()))
    4
    """

    def _unit_cube(self, count: int, dim: int, seed: int) -> np.ndarray:
        from scipy.stats import qmc

        return qmc.LatinHypercube(dim, rng=np.random.default_rng(seed)).random(count)


class Sobol(_Sample):
    """The first points of a scrambled Sobol sequence. Parameters as :class:`Random`.

    More runs of the same seed extend the sequence; a power of 2 is balanced.

    Examples
    --------
    >>> design = am.study.Sobol({"young": (1e9, 1e11)}, runs=4, log="young")
    >>> len(list(design.points()))
    4
    """

    def _unit_cube(self, count: int, dim: int, seed: int) -> np.ndarray:
        from scipy.stats import qmc

        sequence = qmc.Sobol(dim, rng=np.random.default_rng(seed), bits=30)
        # the balance of a power of 2 is the user's choice: no warning
        return sequence.random_base2(math.ceil(math.log2(count)))[:count] if count > 1 else sequence.random(1)
