"""Curves of a study: a numeric result against the parameter that varies most, a line for each value of another one.

Where several runs share a point (repeats, or parameters that are neither on the axis nor a line), the line is their
median and a band spans the least and the largest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from pandas.api import types

from adaptmg.plot.style import CYCLE, plain, styled

__all__ = ["Axis", "axes_of_study", "curves", "numbers"]

#: lines in a picture at most; further values share one colour, without a legend
_LINES = 7
#: names along an axis at most
_NAMES = 40
#: an axis is logarithmic where the largest value is so many times the least
_LOGARITHMIC = 30.0


@dataclass(frozen=True)
class Axis:
    """What a study's pictures have in common: the parameter along the axis, and the one of the lines ("" for none)."""

    along: str
    lines: str


def numbers(column: pd.Series) -> pd.Series | None:
    """A column as floats if all that is known of it are finite or infinite numbers, else None."""
    known = column.dropna()
    if known.empty or types.is_bool_dtype(known) or known.map(lambda v: isinstance(v, bool | np.bool_ | str)).any():
        return None
    try:
        values = pd.to_numeric(column)
    except (TypeError, ValueError):
        return None
    return None if values.dtype.kind == "c" else values.astype(float)


def axes_of_study(table: pd.DataFrame, parameters: Sequence[str]) -> Axis | None:
    """Which parameter is along the axis: of those that vary the numeric one with most values; None if none varies."""
    counts = {name: table[name].map(_key).nunique() for name in parameters}
    varied = [name for name in parameters if counts[name] > 1]
    if not varied:
        return None
    numeric = [name for name in varied if numbers(table[name]) is not None]
    along = max(numeric or varied, key=lambda name: counts[name])
    others = [name for name in varied if name != along and counts[name] <= _LINES]
    return Axis(along, max(others, key=lambda name: counts[name]) if others else "")


@styled
def curves(table: pd.DataFrame, axis: Axis, result: str, unit: str = "", along_unit: str = "") -> Figure:
    """A numeric result against a parameter.

    Parameters
    ----------
    table : pandas.DataFrame
        Finished runs.
    axis : Axis
    result : str
        A column of numbers.
    unit, along_unit : str
        Of the result and of the parameter.
    """
    figure = Figure(figsize=(6.4, 4.0))
    ax = figure.subplots()
    position = numbers(table[axis.along])
    names = None if position is not None else list(dict.fromkeys(map(_key, table[axis.along])))[:_NAMES]
    if position is None:
        position = table[axis.along].map(_key).map({name: float(k) for k, name in enumerate(names)})
    data = pd.DataFrame({"x": position.to_numpy(), "y": numbers(table[result]).to_numpy(),
                         "line": [""] * len(table) if not axis.lines else table[axis.lines].map(_key).to_numpy()})
    data = data[np.isfinite(data["x"]) & np.isfinite(data["y"])]
    for k, (line, part) in enumerate(data.groupby("line", sort=False)):
        _line(ax, part, CYCLE[k % len(CYCLE)], f"{plain(axis.lines)} = {plain(line)}", joined=names is None)
    ax.set_xlabel(_name(axis.along, along_unit))
    ax.set_ylabel(_name(result, unit))
    ax.grid(True)
    if names is None:
        _scale(ax, "x", data["x"])
    else:
        ax.set_xticks(range(len(names)), [plain(name[:24]) for name in names], rotation=90 if len(names) > 6 else 0)
    _scale(ax, "y", data["y"])
    if axis.lines and len(data):
        ax.legend()
    return figure


def _line(ax: Axes, part: pd.DataFrame, color: str, label: str, joined: bool) -> None:
    points = part.groupby("x")["y"].agg(["median", "min", "max", "size"])
    style = {"linestyle": "-" if joined else "", "marker": "o" if len(points) <= 60 else ""}
    ax.plot(points.index, points["median"], color=color, label=label, **style)
    if (points["size"] > 1).any():
        if joined:
            ax.fill_between(points.index, points["min"], points["max"], color=color, alpha=0.18, linewidth=0)
        else:
            ax.vlines(points.index, points["min"], points["max"], color=color, alpha=0.5)


def _scale(ax: Axes, name: str, values: pd.Series) -> None:
    """Logarithmic where values span much, with plain numbers; on x a tick a value where these are few whole numbers."""
    if not len(values):
        return
    axis, single = getattr(ax, f"{name}axis"), np.unique(values)
    if single[0] > 0 and single[-1] >= _LOGARITHMIC * single[0]:
        ax.set(**{f"{name}scale": "log"})
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    elif name == "x" and len(single) <= 12 and (single == np.round(single)).all():
        axis.set_ticks(single, [f"{value:g}" for value in single])


def _name(name: str, unit: str) -> str:
    words = name.replace("_", " ")
    return plain(f"{words} [{unit}]" if unit else words)


def _key(value: object) -> str:
    """A value as text; 1 and 1.0 are one, 1 and True and '1' are not one on an axis of numbers anyway."""
    return f"{value:g}" if isinstance(value, float) else str(value)
