"""Designs: a grid (every combination), an explicit list, and several lists walked side by side.

``a * b`` is every point of ``a`` with every point of ``b``, ``a + b`` first the ones, then the others. A design knows
its length before it makes a point, so that one too large is refused in time.

Samples of ranges: independent, Latin hypercube, Sobol sequence (:mod:`scipy.stats.qmc`); repeats with seeds.

The points that a store has, as a design.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptmg import _checks as checks
from adaptmg.study.record import Value, canonical, parameter_value, restored
from adaptmg.study.store import Store

__all__ = [
    "MOST",
    "Design",
    "Grid",
    "LatinHypercube",
    "Points",
    "Random",
    "Repeated",
    "Sobol",
    "Zip",
    "as_design",
    "check_length",
    "stored_design",
]

#: points of a design: some GB of rows
MOST = 2_000_000

Point = dict[str, Value]


class Design:
    """Points of a study."""

    names: tuple[str, ...]  # of the parameters

    def __len__(self) -> int:
        raise NotImplementedError

    def points(self) -> Iterator[Point]:
        """The points, in order."""
        raise NotImplementedError

    def __mul__(self, other: Design) -> Design:
        return _Product(self, as_design("the second factor", other))

    def __add__(self, other: Design) -> Design:
        return _Sum(self, as_design("the second part", other))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self.names)}: {len(self)} points)"


def as_design(name: str, given: Any) -> Design:
    """A design as it is, a mapping of names to sequences as :class:`Grid`, a sequence of points as :class:`Points`."""
    if isinstance(given, Design):
        return given
    if isinstance(given, Mapping) and given:
        return Grid(given)
    if isinstance(given, Sequence) and not isinstance(given, str) and given \
            and all(isinstance(p, Mapping) for p in given[:10]):
        return Points(given)
    raise TypeError(f"{name} must be a mapping of names to sequences of values, a list of points, or a design "
                    f"(adaptmg.study.Grid, Zip, Random ...), got {checks.described(given)}")


def check_length(length: int) -> int:
    """``length``, if so many points can be run."""
    if length > MOST:
        raise ValueError(f"the design has {_count(length)} points, at most {MOST} are run in one study: take fewer "
                         "values, or a sample (adaptmg.study.Sobol)")
    return length


def _count(length: int) -> str:
    # numbers of many thousand digits are not printed
    return str(length) if length < 10**15 else f"more than 10^{int(math.log2(length) * math.log10(2))}"


def _values(name: str, values: Any, twice: bool = False) -> list[Value]:
    """The values of a parameter; refused before they are made where they are too many, or have no end."""
    if not isinstance(name, str):
        raise TypeError(f"the names of parameters must be strings, got {checks.shown(name)}")
    if isinstance(values, str | Mapping) or not isinstance(values, Iterable):
        raise TypeError(f"parameters[{name!r}] must be a sequence of values, got {checks.shown(values)}")
    if not isinstance(values, Sized):
        raise TypeError(f"parameters[{name!r}] must be a sequence of values whose length is known, such as a list, got "
                        f"{checks.shown(values)}: it may have no end")
    try:
        length = len(values)
    except OverflowError:
        length = 2**63
    except TypeError:  # an array without an axis
        raise TypeError(f"parameters[{name!r}] must be a sequence of values, got {checks.shown(values)}") from None
    if not check_length(length):
        raise ValueError(f"parameters[{name!r}] is empty: give at least one value")
    plain = [parameter_value(name, value) for value in values]
    if not twice and len({canonical({name: value}) for value in plain}) < len(plain):
        raise ValueError(f"parameters[{name!r}] holds a value twice: {checks.shown(plain)}")
    return plain


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
        if not isinstance(parameters, Mapping) or not parameters:
            raise TypeError(f"parameters must be a mapping of names to sequences of values, got "
                            f"{checks.shown(parameters)}")
        self.values = {name: _values(name, values) for name, values in parameters.items()}
        self.names = tuple(self.values)
        check_length(len(self))

    def __len__(self) -> int:
        return math.prod(len(values) for values in self.values.values())

    def points(self) -> Iterator[Point]:
        """The points, in order."""
        for values in itertools.product(*self.values.values()):
            yield dict(zip(self.names, values, strict=True))


class Points(Design):
    """An explicit list.

    Parameters
    ----------
    points : sequence of mappings, or pandas.DataFrame
        All with the same names. A point may stand there once.
    """

    def __init__(self, points: Sequence[Mapping[str, Value]]) -> None:
        if hasattr(points, "to_dict") and hasattr(points, "columns"):
            points = points.to_dict("records")
        if isinstance(points, str | Mapping) or not isinstance(points, Sequence) or not points:
            raise TypeError(f"points must be a list of mappings of names to values, got {checks.shown(points)}")
        check_length(len(points))
        self._points = []
        for k, point in enumerate(points):
            if not isinstance(point, Mapping) or not point:
                raise TypeError(f"points[{k}] must be a mapping of names to values, got {checks.shown(point)}")
            self._points.append({name: parameter_value(name, value) for name, value in point.items()})
        self.names = tuple(self._points[0])
        for k, point in enumerate(self._points):
            if set(point) != set(self.names):
                raise ValueError(f"points[{k}] has the parameters {', '.join(point)}, the first "
                                 f"{', '.join(self.names)}: give all points the same")
        _check_once(self._points)

    def __len__(self) -> int:
        return len(self._points)

    def points(self) -> Iterator[Point]:
        """The points, in order."""
        return iter(self._points)


def _check_once(points: list[Point]) -> None:
    seen: dict[str, int] = {}
    for k, point in enumerate(points):
        first = seen.setdefault(canonical(point), k)
        if first != k:
            raise ValueError(f"points {first} and {k} are the same: {checks.shown(point)}")


class Zip(Points):
    """Lists walked side by side: the first values, the second ones, and so on.

    Parameters
    ----------
    parameters : mapping of str to sequence
        All of one length; values may repeat, points may not.

    Examples
    --------
    >>> list(Zip({"h": [0.1, 0.05], "rtol": [1e-4, 1e-5]}).points())[1]
    {'h': 0.05, 'rtol': 1e-05}
    """

    def __init__(self, parameters: Mapping[str, Sequence[Value]]) -> None:
        if not isinstance(parameters, Mapping) or not parameters:
            raise TypeError(f"parameters must be a mapping of names to sequences of values, got "
                            f"{checks.shown(parameters)}")
        values = {name: _values(name, items, twice=True) for name, items in parameters.items()}
        lengths = {name: len(items) for name, items in values.items()}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"the lists of Zip must have one length, got {lengths}")
        super().__init__([dict(zip(values, row, strict=True)) for row in zip(*values.values(), strict=True)])


class _Product(Design):
    """Every point of one with every point of another."""

    def __init__(self, first: Design, second: Design) -> None:
        both = sorted(set(first.names) & set(second.names))
        if both:
            raise ValueError(f"both designs have the parameters {', '.join(both)}")
        self._first, self._second = first, second
        self.names = (*first.names, *second.names)
        check_length(len(self))

    def __len__(self) -> int:
        return len(self._first) * len(self._second)

    def points(self) -> Iterator[Point]:
        """The points, in order."""
        second = list(self._second.points())
        for point in self._first.points():
            for more in second:
                yield {**point, **more}


class _Sum(Design):
    """The points of one, then those of another that are not among them."""

    def __init__(self, first: Design, second: Design) -> None:
        if set(first.names) != set(second.names):
            raise ValueError(f"the designs must have the same parameters, got {', '.join(first.names)} and "
                             f"{', '.join(second.names)}")
        self.names = first.names
        check_length(len(first) + len(second))
        self._points = {canonical(point): point for part in (first, second) for point in part.points()}

    def __len__(self) -> int:
        return len(self._points)

    def points(self) -> Iterator[Point]:
        """The points, in order."""
        return iter(self._points.values())


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


def stored_design(store: Store, study: str, fixed: Mapping[str, Any]) -> Points:
    """The points of a study with these fixed parameters, computed or not; without the fixed ones."""
    keys = dict.fromkeys([*store.get(study), *store.points(study)])
    points = [{name: restored(value) for name, value in json.loads(key).items()} for key in keys]
    texts = {name: canonical({name: value}) for name, value in fixed.items()}
    mine = [{name: value for name, value in point.items() if name not in texts} for point in points
            if all(name in point and canonical({name: point[name]}) == text for name, text in texts.items())]
    check_length(len(mine))
    if not mine:
        raise ValueError(f"the store has no points of a study {study!r} with these fixed parameters: give parameters")
    return Points(mine)
