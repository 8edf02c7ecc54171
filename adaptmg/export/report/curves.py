"""Curves of a study: a numeric result against the parameter that varies most, a line for each value of another one.

Where several runs share a point (repeats, or parameters that are neither on the axis nor a line), the line is their
median and a band spans the least and the largest, or the middle half where they are many. Where no two runs share a
value of any parameter (a random design, of several parameters) the runs are points without a line.
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

from adaptmg.export.report.cells import worded
from adaptmg.plot.style import CYCLE, plain, styled

__all__ = ["Axis", "axes_of_study", "caption", "curves", "numbers"]

#: lines in a picture at most; further values share one colour, without a legend
_LINES = 7
#: points that are marked in a line at most
_MARKED = 60
#: names along an axis at most
_NAMES = 40
#: letters of a name in a drawing at most
_LETTERS = 24
#: of so many runs at a point the least and the largest are chance
_MANY = 10
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
    if isinstance(column.dtype, np.dtype) and column.dtype.kind in "iuf":
        return column.astype(float) if column.notna().any() else None
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
    figure = Figure(figsize=(6.2, 3.9))
    ax = figure.subplots()
    position = numbers(table[axis.along])
    names = None if position is not None else list(dict.fromkeys(_keys(table[axis.along])))[:_NAMES]
    if position is None:
        position = _keys(table[axis.along]).map({name: float(k) for k, name in enumerate(names)})
    data = pd.DataFrame({"x": position.to_numpy(), "y": numbers(table[result]).to_numpy(),
                         "line": [""] * len(table) if not axis.lines else _keys(table[axis.lines]).to_numpy()})
    data = data[np.isfinite(data["x"]) & np.isfinite(data["y"])]
    many = _many(table, axis)
    for k, (line, part) in enumerate(data.groupby("line", sort=False)):
        _line(ax, part, CYCLE[k % len(CYCLE)], f"{plain(worded(axis.lines)[0])} = {_name(line)}",
              joined=axis.joined and names is None, band=(0.25, 0.75) if many else (0.0, 1.0))
    ax.set_xlabel(_label(axis.along, along_unit))
    ax.set_ylabel(_label(result, unit))
    ax.grid(True)
    if names is None:
        _scale(ax, "x", data["x"])
    else:
        ax.set_xticks(range(len(names)), [_name(name) for name in names], rotation=90 if len(names) > 6 else 0)
    _scale(ax, "y", data["y"])
    if axis.lines and len(data):
        # above the drawing, where nothing is drawn
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=min(4, data["line"].nunique()), borderpad=0.0)
    return figure


def caption(table: pd.DataFrame, axis: Axis, result: str) -> str:
    """What :func:`curves` shows."""
    lines = f", a line for each value of {worded(axis.lines)[0]}" if axis.lines else ""
    spread = "of their middle half" if _many(table, axis) else "from the least to the largest"
    return (f"{worded(result)[0]} against {worded(axis.along)[0]}{lines}; where runs share a point their median, and "
            f"the band {spread}")


def _many(table: pd.DataFrame, axis: Axis) -> bool:
    """Whether points are shared by many runs."""
    points = pd.concat([_keys(table[name]) for name in (axis.along, axis.lines) if name], axis=1)
    return bool(len(table)) and len(table) >= _MANY * len(points.drop_duplicates())


def _line(ax: Axes, part: pd.DataFrame, color: str, label: str, joined: bool, band: tuple[float, float]) -> None:
    values = part.groupby("x")["y"]
    points = pd.DataFrame({"median": values.median(), "low": values.quantile(band[0]),
                           "high": values.quantile(band[1]), "size": values.size()})
    style = {"linestyle": "-" if joined else "", "marker": "o" if len(points) <= _MARKED else "" if joined else "."}
    ax.plot(points.index, points["median"], color=color, label=label, **style)
    if (points["size"] > 1).any():
        if joined:
            ax.fill_between(points.index, points["low"], points["high"], color=color, alpha=0.18, linewidth=0)
        else:
            ax.vlines(points.index, points["low"], points["high"], color=color, alpha=0.5)


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


def _name(value: str) -> str:
    """A value as a name in the drawing: not longer than there is room for."""
    return plain(value if len(value) <= _LETTERS else f"{value[:_LETTERS - 2]} …")


def _label(name: str, unit: str) -> str:
    words, unit = worded(name, unit)
    return plain(f"{words} [{unit}]" if unit else words)


def _keys(column: pd.Series) -> pd.Series:
    """Values as texts, floats in few digits where that keeps them apart."""
    if not (isinstance(column.dtype, np.dtype) and column.dtype.kind in "iuf"):
        return column.map(lambda value: f"{value:g}" if isinstance(value, float) else str(value))
    # values repeat: each is written once
    codes, found = pd.factorize(column, use_na_sentinel=False)
    texts = [f"{value:g}" if isinstance(value, float) else str(value) for value in found.tolist()]
    if len(set(texts)) < len(texts):
        texts = [repr(value) for value in found.tolist()]
    return pd.Series(np.array(texts, dtype=object)[codes], index=column.index)
