"""study_report: the table of a parameter study as one HTML file, with what came out drawn against what varied."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path

import pandas as pd

from adaptmg.export.report.cells import worded
from adaptmg.export.report.curves import axes_of_study, caption, curves, numbers
from adaptmg.export.report.page import Report
from adaptmg.export.report.prose import count
from adaptmg.export.report.tables import LONGEST
from adaptmg.problem import checks

__all__ = ["study_report"]

#: what a study says of its runs, beside parameters and results
_STATUS, _ERROR = "status", "error"
_DONE = "done"
#: letters of a text and of an error that are shown at most
_TEXT, _ERROR_TEXT = 200, 400


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
    drawn = [name for name, _ in islice(_varied(done, [*parameters, *hidden]), 2)] if results is None else \
        _columns("results", results, table)
    if results is not None:
        _check_numbers(done, drawn)
    name = title or str(table.attrs.get("study") or "") or "Study"
    page = Report(name, " ".join([_counted(table), summary.strip()]).strip())
    page.section("Results")
    axis = axes_of_study(done, parameters) if len(done) else None
    for result in drawn if axis else ():
        page.figure(curves(done, axis, result, units.get(result, ""), units.get(axis.along, "")),
                    caption(done, axis, result))
    if len(table) > LONGEST:
        _add_ranges(page, done, [*parameters, *hidden], units)
    shown = table.drop(columns=[c for c in {_ERROR, *hidden} if c in table])
    _add(page, shown, "All runs", units, formats, csv=csv, open=True)
    _add_failed(page, table, done, parameters, units, formats, csv)
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


def _varied(done: pd.DataFrame, others: Sequence[str]) -> Iterator[tuple[str, pd.Series]]:
    """Columns of numbers that vary."""
    for name in done.columns:
        if name not in (*others, _STATUS, _ERROR):
            values = numbers(done[name])
            if values is not None and values.nunique() > 1:
                yield name, values


def _check_numbers(done: pd.DataFrame, drawn: Sequence[str]) -> None:
    for name in drawn:
        if len(done) and numbers(done[name]) is None:
            raise ValueError(f"results: column {name!r} holds no numbers to draw, got "
                             f"{checks.shown(done[name].iloc[0])} in its first row")


def _counted(table: pd.DataFrame) -> str:
    """How many runs, by status."""
    if _STATUS not in table:
        return f"{count(len(table))} runs."
    found = table[_STATUS].astype(str).value_counts()
    return f"{count(len(table))} runs: " + ", ".join(f"{count(n)} {status}" for status, n in found.items()) + "." \
        if len(table) else "No runs."


def _add(page: Report, frame: pd.DataFrame, caption: str, units: Mapping[str, str], formats: Mapping[str, str],
         **options: object) -> None:
    """A table, with the units and formats of the columns that it has, and long texts cut."""
    for name in frame.columns:
        most = _ERROR_TEXT if name == _ERROR else _TEXT
        if any(isinstance(value, str) and len(value) > most for value in frame[name].head(LONGEST)):
            frame = frame.assign(**{name: [_cut(value, most) for value in frame[name]]})
    page.table(frame, caption, units={k: v for k, v in units.items() if k in frame},
               formats={k: v for k, v in formats.items() if k in frame}, **options)


def _cut(value: object, most: int) -> object:
    return f"{value[:most]} ..." if isinstance(value, str) and len(value) > most else value


def _add_ranges(page: Report, done: pd.DataFrame, others: Sequence[str], units: Mapping[str, str]) -> None:
    """What the results of all runs are, where not all can be shown."""
    rows = []
    for name, values in _varied(done, others):
        words, unit = worded(name, units.get(name))
        marks = [int(x) if x.is_integer() else x for x in values.quantile([0.0, 0.25, 0.5, 0.75, 1.0])]
        rows.append((f"{words} [{unit}]" if unit else words, values.count(), *marks))
    if rows:
        columns = ["result", "runs", "least", "lower quarter", "median", "upper quarter", "largest"]
        page.table(pd.DataFrame(rows, columns=columns, dtype=object), "Results of all runs that are done", open=True)


def _add_failed(page: Report, table: pd.DataFrame, done: pd.DataFrame, parameters: Sequence[str],
                units: Mapping[str, str], formats: Mapping[str, str], csv: str) -> None:
    if _ERROR not in table:
        return
    failed = table.loc[table.index.difference(done.index, sort=False), [*parameters, _ERROR]]
    failed = failed[failed[_ERROR].fillna("").astype(str) != ""]
    if len(failed):
        page.section("Runs that failed")
        _add(page, failed, "Errors", units, formats, csv=csv if len(failed) > LONGEST else "")
