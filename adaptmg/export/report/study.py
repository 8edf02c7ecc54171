"""study_report: the table of a parameter study as one HTML file, with what came out drawn against what varied."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from adaptmg.export.report.curves import Axis, axes_of_study, curves, numbers
from adaptmg.export.report.page import Report
from adaptmg.problem import checks

__all__ = ["study_report"]

#: what a study says of its runs, beside parameters and results
_STATUS, _ERROR = "status", "error"
_DONE = "done"
_ERROR_TEXT = 400


def study_report(table: pd.DataFrame, path: str | os.PathLike[str], *, parameters: Sequence[str],
                 results: Sequence[str] | None = None, title: str = "", summary: str = "",
                 units: Mapping[str, str] | None = None, formats: Mapping[str, str] | None = None,
                 hidden: Sequence[str] = (), csv: str = "", made: Mapping[str, str] | None = None) -> Path:
    """Write a report of a study: how many runs there are, pictures of the results, all runs, those that failed.

    Parameters
    ----------
    table : pandas.DataFrame
        A row a run, as :meth:`adaptmg.Study.run` returns it. A column ``status`` is counted, and only runs that are
        'done' are drawn; a column ``error`` is shown for the others alone.
    path : path
        The HTML file; it appears complete or not at all.
    parameters : sequence of str
        Columns that were varied. The pictures have the numeric one with most values along their axis, and a line for
        each value of another one.
    results : sequence of str, optional
        Columns to draw, a picture each; default: the first two columns of numbers that vary and are no parameters.
    title, summary : str
        Default title: the name of the study (``table.attrs["study"]``).
    units, formats : mapping of column to str, optional
        See :func:`adaptmg.study.as_text`.
    hidden : sequence of str
        Columns that are neither drawn nor shown (they may be in the CSV file).
    csv : str
        Name of a CSV file of the table beside the report, for a link.
    made : mapping of str to str, optional
        More to say of how the runs were made: machine, commit, seeds.

    Returns
    -------
    pathlib.Path
        Where it is.
    """
    if not isinstance(table, pd.DataFrame):
        raise TypeError(f"table must be a pandas DataFrame, got {type(table).__name__}")
    parameters, hidden = (_columns(name, given, table) for name, given in
                          (("parameters", parameters), ("hidden", hidden)))
    units, formats = {"seconds": "s"} | dict(units or {}), dict(formats or {})
    done = table[table[_STATUS] == _DONE] if _STATUS in table else table
    drawn = _drawable(done, [*parameters, *hidden]) if results is None else _columns("results", results, table)
    if results is not None:
        _check_numbers(done, drawn)
    name = title or str(table.attrs.get("study") or "") or "Study"
    page = Report(name, " ".join([_counted(table), summary.strip()]).strip())
    page.section("Results")
    axis = axes_of_study(done, parameters) if len(done) else None
    for result in drawn if axis else ():
        page.figure(curves(done, axis, result, units.get(result, ""), units.get(axis.along, "")),
                    _caption(axis, result))
    shown = table.drop(columns=[c for c in {_ERROR, *hidden} if c in table])
    _add(page, shown, "All runs", units, formats, csv=csv, open=True)
    _add_failed(page, table, done, parameters, units, formats)
    fixed = table.attrs.get("fixed") or {}
    if fixed:
        page.made(fixed_parameters=", ".join(f"{key} = {value}" for key, value in fixed.items()))
    page.made(**{str(key): str(value) or "-" for key, value in (made or {}).items()})
    return page.write(path)


def _columns(name: str, given: Sequence[str], table: pd.DataFrame) -> list[str]:
    if isinstance(given, str):
        raise TypeError(f"{name} must be a sequence of column names, got {given!r}: write [{given!r}]")
    missing = [column for column in given if column not in table.columns]
    if missing:
        raise ValueError(f"{name} names columns the table does not have: {missing}; it has {list(table.columns)}")
    return list(given)


def _drawable(done: pd.DataFrame, others: Sequence[str]) -> list[str]:
    """The first two columns of numbers that vary."""
    found = []
    for name in done.columns:
        if name not in (*others, _STATUS, _ERROR):
            values = numbers(done[name])
            if values is not None and values.nunique() > 1:
                found.append(name)
        if len(found) == 2:
            break
    return found


def _check_numbers(done: pd.DataFrame, drawn: Sequence[str]) -> None:
    for name in drawn:
        if len(done) and numbers(done[name]) is None:
            raise ValueError(f"results: column {name!r} holds no numbers to draw, got "
                             f"{checks.shown(done[name].iloc[0])} in its first row")


def _counted(table: pd.DataFrame) -> str:
    """How many runs, by status."""
    if _STATUS not in table:
        return f"{len(table)} runs."
    counts = table[_STATUS].astype(str).value_counts()
    return f"{len(table)} runs: " + ", ".join(f"{count} {status}" for status, count in counts.items()) + "." \
        if len(table) else "No runs."


def _caption(axis: Axis, result: str) -> str:
    lines = f", a line for each {axis.lines.replace('_', ' ')}" if axis.lines else ""
    return (f"{result.replace('_', ' ')} against {axis.along.replace('_', ' ')}{lines}; where runs share a point their "
            "median, and the band from the least to the largest")


def _add(page: Report, frame: pd.DataFrame, caption: str, units: Mapping[str, str], formats: Mapping[str, str],
         **options: object) -> None:
    """A table, with the units and formats of the columns that it has."""
    page.table(frame, caption, units={k: v for k, v in units.items() if k in frame},
               formats={k: v for k, v in formats.items() if k in frame}, **options)


def _add_failed(page: Report, table: pd.DataFrame, done: pd.DataFrame, parameters: Sequence[str],
                units: Mapping[str, str], formats: Mapping[str, str]) -> None:
    if _ERROR not in table:
        return
    failed = table.loc[table.index.difference(done.index, sort=False), [*parameters, _ERROR]]
    failed = failed[failed[_ERROR].fillna("").astype(str) != ""]
    if len(failed):
        cut = [text if len(text) <= _ERROR_TEXT else f"{text[:_ERROR_TEXT]} ..." for text in failed[_ERROR].astype(str)]
        page.section("Runs that failed")
        _add(page, failed.assign(**{_ERROR: cut}), "Errors", units, formats)
