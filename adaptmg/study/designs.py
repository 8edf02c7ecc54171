"""Designs: the points of a study, each a dictionary of parameters, and the text that identifies a
point.

A grid has every combination of values; other designs are an explicit list, and samples of ranges
(independent, Latin hypercube, Sobol sequence; :mod:`scipy.stats.qmc`).

A point is identified by the JSON of its parameters with sorted keys: the order of the parameters
does not matter. Values are equal where their texts are: 1, 1.0, True and "1" are four values
(``1``, ``1.0``, ``true``, ``"1"``), a number of numpy is Python's number of the same kind, NaN is
itself (``NaN``), and 0.0 is not -0.0."""

from __future__ import annotations

import itertools
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Union, cast

import numpy as np

from adaptmg import _checks as checks

if TYPE_CHECKING:
    import pandas as pd

Scalar = bool | int | float | str | None
Value = Scalar | tuple["Value", ...]
Point = dict[str, Value]

#: points of a design: some GB of rows
MOST = 2_000_000


def canonical(parameters: Mapping[str, Value]) -> str:
    """Return the text that identifies a point."""
    return json.dumps(parameters, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def plain(value: object) -> object:
    """Return a number of numpy as one of Python, anything else unchanged."""
    return value.item() if isinstance(value, np.generic | np.ndarray) and not value.ndim else value


def parameter_value(name: str, value: object) -> Value:
    """Return a number, string, bool, None or tuple of those; TypeError for anything else."""
    value = plain(value)
    if isinstance(value, tuple):
        return tuple(parameter_value(name, v) for v in value)
    if isinstance(value, str) and any("\ud800" <= c <= "\udfff" for c in value):
        raise ValueError(
            f"parameter {name!r} must be text that can be stored, got lone surrogates: {value!a}"
        )
    if value is None or type(value) in (bool, int, float, str):
        return cast(Value, value)
    raise TypeError(
        f"parameter {name!r} must be a number, string, bool, None or a tuple of those, got "
        f"{checks.shown(value)}; pass a name or a number and build the object in the run function"
    )


class Design:
    """Points of a study, all with the same names."""

    def __init__(self, points: list[Point]) -> None:
        self.names = tuple(points[0])
        self._points = points

    def __len__(self) -> int:
        return len(self._points)

    def points(self) -> Iterator[Point]:
        """Yield the points, in order."""
        return iter(self._points)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self.names)}: {len(self)} points)"


#: what stands for a design
DesignLike = Union[
    Design, Mapping[str, Sequence[Value]], Sequence[Mapping[str, Value]], "pd.DataFrame"
]


def as_design(design: DesignLike) -> Design:
    """Return a design unchanged, the points of a mapping of names to sequences, or of a list or
    table of points."""
    if isinstance(design, Design):
        return design
    if hasattr(design, "to_dict") and hasattr(design, "columns"):
        design = cast(
            Sequence[Mapping[str, Value]], cast("pd.DataFrame", design).to_dict("records")
        )
    if isinstance(design, Mapping) and design:
        return Design(_combinations(design))
    if isinstance(design, Sequence) and not isinstance(design, str) and design:
        return Design(_listed(design))
    raise TypeError(
        "parameters must be a mapping of names to sequences of values, a list or table of points, or a "
        f"sample (adaptmg.study.Random, Sobol ...), got {checks.described(design)}"
    )


def _check_length(length: int) -> int:
    """Return a number of points; ValueError above ``MOST``."""
    if length > MOST:
        raise ValueError(
            f"the design has {length} points, at most {MOST} are run in one study: take fewer values, "
            "or a sample (adaptmg.study.Sobol)"
        )
    return length


def _mapping(name: str, mapping: object, words: str) -> Mapping[str, object]:
    """Return a mapping of names of parameters, which is not empty, to what ``words`` call its values."""
    if not isinstance(mapping, Mapping) or not mapping:
        raise TypeError(
            f"{name} must be a mapping of names to {words}, got {checks.shown(mapping)}"
        )
    for key in mapping:
        checks.instance("the name of a parameter", key, str, "a string")
    return mapping


def _combinations(parameters: Mapping[str, Sequence[Value]]) -> list[Point]:
    """Return every combination of values, the last parameter changing fastest."""
    columns = {}
    for key, values in _mapping("parameters", parameters, "sequences of values").items():
        if isinstance(values, str | Mapping) or not hasattr(values, "__len__"):
            raise TypeError(
                f"parameters[{key!r}] must be a list of values, got {checks.shown(values)}: a value that "
                "all runs share stands in fixed={...}, and objects get names that the run function looks up"
            )
        values = cast(Sequence[Value], values)
        if not _check_length(len(values)):
            raise ValueError(f"parameters[{key!r}] is empty: give at least one value")
        columns[key] = [parameter_value(key, value) for value in values]
        if len(set(map(json.dumps, columns[key]))) < len(values):
            raise ValueError(f"parameters[{key!r}] holds a value twice: {checks.shown(values)}")
    _check_length(math.prod(map(len, columns.values())))
    return [dict(zip(columns, row, strict=True)) for row in itertools.product(*columns.values())]


def _listed(points: Sequence[Mapping[str, Value]]) -> list[Point]:
    """Return points of a list, each different and with the same names; runs with other random
    numbers have a parameter such as ``seed``."""
    _check_length(len(points))
    rows: dict[str, Point] = {}
    for k, point in enumerate(points):
        row = {
            key: parameter_value(key, value)
            for key, value in _mapping(f"parameters[{k}]", point, "values").items()
        }
        if set(row) != set(points[0]):
            raise ValueError(
                f"parameters[{k}] has the parameters {', '.join(row)}, the first {', '.join(points[0])}: "
                "give all points the same"
            )
        if canonical(row) in rows:
            raise ValueError(f"parameters[{k}] is the same as one before it: {checks.shown(row)}")
        rows[canonical(row)] = row
    return list(rows.values())


class _Sample(Design, ABC):
    """Points from numbers in the unit cube."""

    def __init__(
        self,
        ranges: Mapping[str, Sequence[float]],
        runs: int,
        *,
        seed: int = 0,
        log: str | Iterable[str] = (),
    ) -> None:
        mapping = _mapping("ranges", ranges, "(low, high)")
        count = _check_length(checks.integer("runs", runs, minimum=1))
        logarithmic = set(checks.strings("log", (log,) if isinstance(log, str) else log))
        if unknown := sorted(logarithmic - set(mapping)):
            raise ValueError(f"log names {unknown}, but the ranges are {list(mapping)}")
        cube = self._unit_cube(
            count, len(mapping), np.random.default_rng(checks.integer("seed", seed))
        )
        columns = [
            _scaled(u, f"ranges[{name!r}]", ends, name in logarithmic)
            for u, (name, ends) in zip(cube.T, mapping.items(), strict=True)
        ]
        rows = [dict(zip(mapping, row, strict=True)) for row in zip(*columns, strict=True)]
        # points of whole numbers may coincide
        super().__init__(list({canonical(row): row for row in rows}.values()))

    @abstractmethod
    def _unit_cube(self, count: int, dim: int, rng: np.random.Generator) -> np.ndarray:
        """Return points (count, dim) of the unit cube."""


def _scaled(u: np.ndarray, name: str, ends: object, logarithmic: bool) -> list[Value]:
    """Return numbers between 0 and 1 as numbers of a range, whole ones between whole ends."""
    pair = checks.listed(name, cast(Iterable[float], ends), "two numbers, (low, high)")
    if len(pair) != 2 or not checks.number(name, pair[0]) < checks.number(name, pair[1]):
        raise ValueError(
            f"{name} must be two numbers that go up, (low, high), got {checks.shown(ends)}"
        )
    low, high = pair
    whole = all(isinstance(end, int | np.integer) for end in pair)
    if logarithmic and (whole or not low > 0):
        raise ValueError(
            f"{name} must be two floats > 0 for a logarithmic scale, got {checks.shown(ends)}"
        )
    if whole:
        return cast(
            list[Value], np.minimum(low + np.floor(u * (high - low + 1)), high).astype(int).tolist()
        )
    return cast(
        list[Value],
        np.clip(
            low * (high / low) ** u if logarithmic else low + u * (high - low), low, high
        ).tolist(),
    )


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

    def _unit_cube(self, count: int, dim: int, rng: np.random.Generator) -> np.ndarray:
        return rng.random((count, dim))


class LatinHypercube(_Sample):
    """A Latin hypercube: each of ``runs`` slices of each range holds one point. Parameters as
    :class:`Random`.

    Examples
    --------
    >>> design = am.study.LatinHypercube({"friction": (0.1, 1.0)}, runs=4)
    >>> len(list(design.points()))
    4
    """

    def _unit_cube(self, count: int, dim: int, rng: np.random.Generator) -> np.ndarray:
        from scipy.stats import qmc

        return qmc.LatinHypercube(dim, rng=rng).random(count)


class Sobol(_Sample):
    """The first points of a scrambled Sobol sequence. Parameters as :class:`Random`.

    More runs of the same seed extend the sequence; a power of 2 is balanced.

    Examples
    --------
    >>> design = am.study.Sobol({"young": (1e9, 1e11)}, runs=4, log="young")
    >>> len(list(design.points()))
    4
    """

    def _unit_cube(self, count: int, dim: int, rng: np.random.Generator) -> np.ndarray:
        from scipy.stats import qmc

        # a power of 2, without which it warns
        return qmc.Sobol(dim, rng=rng, bits=30).random(2 ** math.ceil(math.log2(count)))[:count]
