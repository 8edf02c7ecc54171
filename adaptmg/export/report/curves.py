"""Curves of a study: a numeric result against the parameter that varies most, a line for each value of another one.

Where several runs share a point (repeats, or parameters that are neither on the axis nor a line), the line is their
median and a band spans the least and the largest. Where no two runs share a value of any parameter (a random design, of
several parameters) the runs are points without a line.
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
#: points that are marked in a line at most
_MARKED = 60
#: names along an axis at most
_NAMES = 40
#: an axis is logarithmic where the largest value is so many times the least
_LOGARITHMIC = 30.0


@dataclass(frozen=True)
class Axis:
    """What a study's pictures have in common.

    Attributes
    ----------
    along, lines : str
        The parameter along the axis, and the one of the lines, "" for none.
    joined : bool
        Whether points are joined.
    """

    along: str
    lines: str
    joined: bool = True


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
    """Which parameter is along the axis: of those that vary the numeric one with most values; None if none varies.

    One that is different in every run (a seed) is taken only where all are.
    """
    counts = {name: _keys(table[name]).nunique() for name in parameters}
    varied = [name for name in parameters if counts[name] > 1]
    if not varied:
        return None
    shared = [name for name in varied if counts[name] < len(table)]
    numeric = [name for name in shared or varied if numbers(table[name]) is not None]
    along = max(numeric or shared or varied, key=lambda name: counts[name])
    others = [name for name in varied if name != along and counts[name] <= _LINES]
    return Axis(along, max(others, key=lambda name: counts[name]) if others else "", bool(shared) or len(varied) == 1)


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
    names = None if position is not None else list(dict.fromkeys(_keys(table[axis.along])))[:_NAMES]
    if position is None:
        position = _keys(table[axis.along]).map({name: float(k) for k, name in enumerate(names)})
    data = pd.DataFrame({"x": position.to_numpy(), "y": numbers(table[result]).to_numpy(),
                         "line": [""] * len(table) if not axis.lines else _keys(table[axis.lines]).to_numpy()})
    data = data[np.isfinite(data["x"]) & np.isfinite(data["y"])]
    for k, (line, part) in enumerate(data.groupby("line", sort=False)):
        _line(ax, part, CYCLE[k % len(CYCLE)], f"{plain(axis.lines)} = {plain(line)}",
              joined=axis.joined and names is None)
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
    style = {"linestyle": "-" if joined else "", "marker": "o" if len(points) <= _MARKED else "" if joined else "."}
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


def _keys(column: pd.Series) -> pd.Series:
    """Values as texts, floats in few digits where that keeps them apart."""
    if types.is_float_dtype(column):
        short = column.map("{:g}".format)
        return short if short.nunique() == column.nunique(dropna=False) else column.map(repr)
    return column.map(lambda value: f"{value:g}" if isinstance(value, float) else str(value))
