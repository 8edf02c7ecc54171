"""Tables: the runs of a study as a table of pandas, and tables as aligned text with units in the
headers."""

from __future__ import annotations

import math
import numbers
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg._text import printable
from adaptmg.study.designs import Value

if TYPE_CHECKING:
    import pandas as pd

    from adaptmg.study.store import Record

    Table = pd.DataFrame | Mapping[str, Sequence[object]]

#: columns that :meth:`adaptmg.study.Study.table` adds to parameters and results, and as details
RESERVED = ("status", "seconds", "error")
DETAILS = ("peak_memory", "started", "finished", "machine", "commit", "traceback")


def own_columns(taken: Collection[str]) -> dict[str, str]:
    """Return the names of the columns that a study adds: ``run_`` goes before one that a parameter
    or a result has."""
    columns = {}
    for name in (*RESERVED, *DETAILS):
        columns[name] = name
        while columns[name] in taken:
            columns[name] = f"run_{columns[name]}"
    return columns


def frame(
    names: Sequence[str],
    rows: Sequence[tuple[Mapping[str, Value], Record | None, str]],
    details: bool = False,
) -> pd.DataFrame:
    """Return a table of runs, of which ``rows`` have the point, the record and the status: parameters by
    ``names``, results, status, seconds, error, and details. ``attrs["columns"]`` has the names of those
    after the results, see :func:`own_columns`."""
    import pandas as pd

    records = [record for _, record, _ in rows if record is not None]
    given = dict.fromkeys((*names, *(name for record in records for name in record.results)))
    column_of = own_columns(given)
    lines = []
    shown = [column_of[name] for name in (*RESERVED, *(DETAILS if details else ()))]
    for point, record, status in rows:
        line = {name: point.get(name) for name in names} | {column_of["error"]: ""}
        if record is not None:
            line |= record.results
            line |= {column: getattr(record, name) for name, column in column_of.items()}
        lines.append(line | {column_of["status"]: status})
    columns = {name: [line.get(name, math.nan) for line in lines] for name in (*given, *shown)}
    # texts that are not UTF-8 are refused by the text columns of pandas with pyarrow
    table = pd.DataFrame(
        {
            name: pd.Series(
                column, dtype=object if any(isinstance(v, str) for v in column) else None
            )
            for name, column in columns.items()
        }
    )
    table.attrs["columns"] = column_of
    return table


def as_text(
    table: Table,
    *,
    caption: str = "",
    note: str = "",
    units: Mapping[str, str] | None = None,
    formats: Mapping[str, str] | None = None,
) -> str:
    """Return a table as text in aligned columns.

    Parameters
    ----------
    table : pandas.DataFrame, or mapping of names to columns
        The index is not shown.
    caption, note : str
        Above and below the table.
    units : mapping of column to str
        Shown in the header: ``{"seconds": "s"}`` gives 'seconds [s]'.
    formats : mapping of column to str
        Format of numbers, as in ``format(x, ".2e")``; default ``.4g`` for floats.

    Examples
    --------
    >>> import pandas as pd
    >>> text = am.study.as_text(pd.DataFrame({"cycles": [14, 9]}), caption="Cycles")
    >>> "14" in text
    True
    """
    for name, text in (("caption", caption), ("note", note)):
        checks.instance(name, text, str, "a text")
    headers, columns = cells(table, units, formats)
    widths = [
        max(map(len, (header, *column)), default=0)
        for header, column in zip(headers, columns, strict=True)
    ]
    right = [numeric(column) for _, column in table.items()]

    def line(row: Sequence[str]) -> str:
        padded = (
            cell.rjust(width) if is_right else cell.ljust(width)
            for cell, width, is_right in zip(row, widths, right, strict=True)
        )
        return "  ".join(padded).rstrip()

    rows = [line(row) for row in zip(*columns, strict=True)]
    body = [line(headers), "  ".join("-" * width for width in widths), *rows]
    return printable("\n".join([caption] * bool(caption) + body + [note] * bool(note)))


def cells(
    table: Table, units: Mapping[str, str] | None = None, formats: Mapping[str, str] | None = None
) -> tuple[list[str], list[list[str]]]:
    """Return headers, and the texts of each column."""
    checks.offers("table", table, "items", "a pandas.DataFrame or a mapping of names to columns")
    columns = list(table.items())
    units = checks.mapping("units", {} if units is None else units, "columns to units")
    formats = checks.mapping("formats", {} if formats is None else formats, "columns to formats")
    names = [cast("str", name) for name, _ in columns]
    if len(set(names)) < len(names):
        raise ValueError(f"table has columns of the same name: {names}")
    for what, mapping in (("units", units), ("formats", formats)):
        if unknown := sorted(set(mapping) - set(names)):
            raise ValueError(
                f"{what} names columns the table does not have: {unknown}; it has {names}"
            )
        for name, text in mapping.items():
            checks.instance(f"{what}[{name!r}]", text, str, "a text")
    headers = [
        f"{_line(name)} [{_line(units[name])}]" if units.get(name) else _line(name)
        for name in names
    ]
    return headers, [
        [_cell(value, formats.get(name)) for value in column]
        for name, (_, column) in zip(names, columns, strict=True)
    ]


def _cell(value: object, spec: str | None) -> str:
    """Return a value as text, numbers in a format; "-" for None and NaN."""
    if (
        value is None
        or type(value).__name__ == "NAType"
        or (isinstance(value, numbers.Real) and math.isnan(value))
    ):
        return "-"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, numbers.Integral):
        return format(int(value), spec or "d")
    if isinstance(value, numbers.Real):
        return format(float(value), spec or ".4g")
    if isinstance(value, tuple):
        return ", ".join(_cell(v, spec) for v in value)
    return _line(value)


def _line(value: object) -> str:
    """Return a value as text in one line, without characters that terminals do not print."""
    return printable(" ".join(str(value).split()))


def numeric(column: Iterable[object]) -> bool:
    """Return whether a column holds numbers, apart from missing values."""
    values = [v for v in column if v is not None]
    return bool(values) and all(
        isinstance(v, numbers.Real) and not isinstance(v, bool) for v in values
    )
