"""The report of a parameter study: the number of runs, pictures of the results, all runs, those that failed.

A numeric result is drawn against the parameter that varies most, one line for each value of another parameter. Where
several runs share a point, the line is their median and a band spans them all. Where no two runs share a value of any
parameter (a random design), they are points.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pandas.api import types

from adaptmg import _checks as checks
from adaptmg.export.report import LONGEST, Report, label, worded
from adaptmg.plot.style import CYCLE, label_plainly, plain, styled

#: the largest number of characters of a text in a table, lines in a picture, and marks in a line
_LETTERS, _LINES, _MARKED = 300, 7, 60
#: an axis is logarithmic where the largest value is at least this multiple of the least
_LOGARITHMIC = 30.0


def study_report(table: pd.DataFrame, path: str | os.PathLike[str], *, parameters: Sequence[str],
                 results: Sequence[str] | None = None, summary: str = "", units: Mapping[str, str] | None = None,
                 csv: str = "", made: Mapping[str, str] | None = None) -> Path:
    """Write a report of a study: the number of runs, pictures of the results, all runs, those that failed.

    Parameters
    ----------
    table : pandas.DataFrame
        A row for each run, as :meth:`adaptmg.Study.run` returns it. Only runs with the ``status`` 'done' are drawn; a
        column ``error`` is shown for the others.
    path : path
        The HTML file; it appears complete or not at all.
    parameters : sequence of str
        Columns that were varied.
    results : sequence of str, optional
        Columns to draw, a picture each; default: the first two numeric columns that vary and are not parameters.
    summary : str
        Stands below the title, which is the name of the study (``table.attrs["study"]``).
    units : mapping of column to str, optional
    csv : str
        Name of a CSV file of the table next to the report, for a link.
    made : mapping of str to str, optional
        Facts on the origin of the runs: machine, commit, seeds.

    Examples
    --------
    >>> import pandas as pd
    >>> table = pd.DataFrame({"sweeps": [1, 2], "cycles": [14, 9]})
    >>> am.export.study_report(table, "study.html", parameters=["sweeps"]).name
    'study.html'
    """
    checks.instance("table", table, pd.DataFrame, "a pandas DataFrame")
    parameters = _columns("parameters", parameters, table)
    units = {"seconds": "s"} | dict(units or {})
    done = table[table["status"] == "done"] if "status" in table else table
    varied = [name for name in done if name not in (*parameters, "status", "error")
              and (values := numbers(done[name])) is not None and values.nunique() > 1]
    drawn = varied[:2] if results is None else _columns("results", results, table)
    for name in drawn:
        if len(done) and numbers(done[name]) is None:
            raise ValueError(f"results: column {name!r} holds no numbers to draw, got "
                             f"{checks.shown(done[name].iloc[0])} in its first row")
    counts = table["status"].value_counts() if "status" in table else {}
    counted = ", ".join([f"{len(table):,} runs", *(f"{n:,} {status}" for status, n in counts.items())])
    page = Report(str(table.attrs.get("study") or "Study"), f"{counted}. {summary}".strip())

    def add(frame: pd.DataFrame, caption: str, **options: str | bool) -> None:
        frame = frame.copy()
        for name in frame.select_dtypes(exclude="number"):
            frame[name] = pd.Series([f"{value[:_LETTERS]} ..." if isinstance(value, str) and len(value) > _LETTERS else
                                     value for value in frame[name]], frame.index, dtype=object)
        page.table(frame, caption, units={k: v for k, v in units.items() if k in frame}, **options)

    page.section("Results")
    axis = axes_of_study(done, parameters) if len(done) else None
    for result in drawn if axis else ():
        page.figure(curves(done, axis, result, units.get(result, ""), units.get(axis.along, "")),
                    caption(axis, result))
    add(table.drop(columns="error", errors="ignore"), "All runs", csv=csv, open=True)
    failed = table[table["error"].fillna("").astype(str) != ""] if "error" in table else table.head(0)
    if len(failed):
        page.section("Runs that failed")
        add(failed[[*parameters, "error"]], "Errors", csv=csv if len(failed) > LONGEST else "")
    if fixed := table.attrs.get("fixed"):
        page.made(fixed_parameters=", ".join(f"{key} = {value}" for key, value in fixed.items()))
    page.made(**{str(key): str(value) or "-" for key, value in (made or {}).items()})
    return page.write(path)


def _columns(name: str, columns: Sequence[str], table: pd.DataFrame) -> list[str]:
    if isinstance(columns, str):
        raise TypeError(f"{name} must be a sequence of column names, got {columns!r}: write [{columns!r}]")
    missing = [column for column in columns if column not in table.columns]
    if missing:
        raise ValueError(f"{name} names columns the table does not have: {missing}; it has {list(table.columns)}")
    return list(columns)


@dataclass(frozen=True)
class Axis:
    """The parameter along the axis, the one of the lines ("" for none), and whether points are joined."""

    along: str
    lines: str
    joined: bool = True


def numbers(column: pd.Series) -> pd.Series | None:
    """Return a column as floats if all its values that are not missing are numbers, else None."""
    present = column.dropna()
    plain_numbers = (isinstance(v, Real) and not isinstance(v, bool | np.bool_) for v in present)
    return None if present.empty or not all(plain_numbers) else column.astype(float)


def axes_of_study(table: pd.DataFrame, parameters: Sequence[str]) -> Axis | None:
    """Return the axis, the numeric parameter with most values; None if none varies. A parameter that is different in
    every run (a seed) is chosen only where all are."""
    counts = {name: _keys(table[name]).nunique() for name in parameters}
    varied = [name for name in parameters if counts[name] > 1]
    if not varied:
        return None
    shared = [name for name in varied if counts[name] < len(table)]
    numeric = [name for name in shared or varied if numbers(table[name]) is not None]
    along = max(numeric or shared or varied, key=counts.get)
    others = [name for name in varied if name != along and counts[name] <= _LINES]
    return Axis(along, max(others, key=counts.get, default=""), bool(shared) or len(varied) == 1)


@styled
def curves(table: pd.DataFrame, axis: Axis, result: str, unit: str = "", along_unit: str = "") -> Figure:
    """Return a picture of a numeric result of finished runs against a parameter."""
    figure = Figure(figsize=(6.2, 3.9))
    ax = figure.subplots()
    position = numbers(table[axis.along])
    named = position is None
    if named:
        position = _keys(table[axis.along]).map(_name)
    data = pd.DataFrame({"x": position.to_numpy(), "y": numbers(table[result]).to_numpy(),
                         "line": _keys(table[axis.lines]).to_numpy() if axis.lines else ""})
    data = data.replace([np.inf, -np.inf], np.nan).dropna()
    joined = axis.joined and not named
    for k, (line, part) in enumerate(data.groupby("line", sort=False)):
        color, values = CYCLE[k % len(CYCLE)], part.groupby("x", sort=not named)["y"]
        median, low, high = values.median(), values.min(), values.max()
        ax.plot(median.index, median, color=color, linestyle="-" if joined else "",
                label=f"{plain(worded(axis.lines)[0])} = {_name(line)}",
                marker="o" if len(median) <= _MARKED else "" if joined else ".")
        if len(part) > len(median) and joined:
            ax.fill_between(median.index, low, high, color=color, alpha=0.18, linewidth=0)
        elif len(part) > len(median):
            ax.vlines(median.index, low, high, color=color, alpha=0.5)
    ax.set(xlabel=plain(label(axis.along, along_unit)), ylabel=plain(label(result, unit)))
    ax.grid(True)
    if named:
        ax.tick_params(axis="x", rotation=90 if data["x"].nunique() > 6 else 0)
    else:
        _scale(ax, "x", data["x"])
    _scale(ax, "y", data["y"])
    if axis.lines and len(data):
        # above the drawing, where nothing is drawn
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=min(4, data["line"].nunique()), borderpad=0.0)
    return figure


def caption(axis: Axis, result: str) -> str:
    """Return what :func:`curves` shows."""
    lines = f", a line for each value of {worded(axis.lines)[0]}" if axis.lines else ""
    return (f"{worded(result)[0]} against {worded(axis.along)[0]}{lines}; where runs share a point their median, and "
            "the band from the least to the largest")


def _scale(ax: Axes, name: str, values: pd.Series) -> None:
    """Choose a logarithmic scale where values span much; on x, ticks at the values where these are few integers."""
    axis, single = getattr(ax, f"{name}axis"), np.unique(values)
    if len(single) and single[0] > 0 and single[-1] >= _LOGARITHMIC * single[0]:
        ax.set(**{f"{name}scale": "log"})
        label_plainly(axis)
    elif name == "x" and 0 < len(single) <= 12 and (single == np.round(single)).all():
        axis.set_ticks(single, [f"{value:g}" for value in single])


def _name(value: str) -> str:
    """A value as a short name in the drawing."""
    return plain(value if len(value) <= 24 else f"{value[:22]} …")


def _keys(column: pd.Series) -> pd.Series:
    """Values as texts, floats in few digits where these differ."""
    texts = column.map(lambda value: f"{value:g}" if isinstance(value, float) else str(value)).astype(object)
    if types.is_numeric_dtype(column) and texts.nunique() < column.nunique():
        texts = column.map(repr).astype(object)
    return texts
