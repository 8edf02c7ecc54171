"""Designs: a grid (every combination), an explicit list, and several lists walked side by side.

``a * b`` is every point of ``a`` with every point of ``b``, ``a + b`` first the ones, then the others. A design knows
its length before it makes a point, so that one too large is refused in time.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from typing import Any

from adaptmg.problem import checks
from adaptmg.study.record import Value, canonical, parameter_value

__all__ = ["MOST", "Design", "Grid", "Points", "Zip", "as_design", "check_length"]

#: points of a design: some GB of rows
MOST = 2_000_000

Point = dict[str, Value]


class Design:
    """Points of a study.

    Attributes
    ----------
    names : tuple of str
        Of the parameters.
    """

    names: tuple[str, ...]

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
