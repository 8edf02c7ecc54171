"""Tables of a study as aligned text and as HTML: units in the headers, a caption above, a note below.

Rows of a study as a table, column by column, as tables may have 100 000 rows; pandas is loaded when asked for.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from adaptmg._text import in_html, printable
from adaptmg.study.record import DETAILS, RESERVED, Record, Value

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["as_html", "as_text", "cells", "columns", "frame", "from_columns", "numeric", "shown_cells"]

if TYPE_CHECKING:
    import pandas as pd

    Table = pd.DataFrame | Mapping[str, Sequence[Any]]



def as_text(table: Table, *, caption: str = "", note: str = "", units: Mapping[str, str] | None = None,
            formats: Mapping[str, str] | None = None) -> str:
    """A table as text in aligned columns.

    Parameters
    ----------
    table : pandas.DataFrame, or mapping of names to columns
        The index is not shown.
    caption : str
        What the table shows; say the grid and the tolerance.
    note : str
        Below it: norms, sources, what differs from a reference.
    units : mapping of column to str
        Shown in the header: ``{"seconds": "s"}`` gives 'seconds [s]'.
    formats : mapping of column to str
        Format of its numbers, as in ``format(x, ".2e")``; default ``.4g`` for floats.

    Returns
    -------
    str
        Lines without trailing blanks, no newline at the end.
    """
    headers, columns = cells(table, units, formats)
    widths = [max(map(len, (header, *cells)), default=0) for header, cells in zip(headers, columns, strict=True)]
    right = [numeric(column) for _, column in table.items()]

    def line(cells: list[str]) -> str:
        padded = (cell.rjust(width) if is_right else cell.ljust(width)
                  for cell, width, is_right in zip(cells, widths, right, strict=True))
        return "  ".join(padded).rstrip()

    rows = [line(list(row)) for row in zip(*columns, strict=True)]
    body = [line(headers), "  ".join("-" * width for width in widths), *rows]
    return printable("\n".join([caption] * bool(caption) + body + [note] * bool(note)))


def as_html(table: Table, *, caption: str = "", note: str = "", units: Mapping[str, str] | None = None,
            formats: Mapping[str, str] | None = None) -> str:
    """A table as an HTML ``<figure>``; everything escaped, numbers right-aligned by class ``n``.

    Parameters
    ----------
    table, caption, note, units, formats
        As in :func:`as_text`.
    """
    headers, columns = cells(table, units, formats)
    classes = [' class="n"' if numeric(column) else "" for _, column in table.items()]
    head = "".join(f"<th{c}>{in_html(h)}</th>" for h, c in zip(headers, classes, strict=True))
    rows = ("".join(f"<td{c}>{in_html(cell)}</td>" for cell, c in zip(row, classes, strict=True))
            for row in zip(*columns, strict=True))
    body = "\n".join(f"<tr>{row}</tr>" for row in rows)
    top = f"<figcaption>{in_html(caption)}</figcaption>\n" if caption else ""
    bottom = f'\n<p class="note">{in_html(note)}</p>' if note else ""
    return (f'<figure class="table">\n{top}<div class="scroll"><table>\n<thead><tr>{head}</tr></thead>\n'
            f"<tbody>\n{body}\n</tbody>\n</table></div>{bottom}\n</figure>")


def shown_cells(table: Table, *, units: Mapping[str, str] | None = None,
                formats: Mapping[str, str] | None = None) -> tuple[list[list[str]], list[bool]]:
    """The cells as text, column by column, and which columns hold numbers; arguments as of :func:`as_text`."""
    return cells(table, units, formats)[1], [numeric(column) for _, column in table.items()]


def cells(table: Table, units: Mapping[str, str] | None,
          formats: Mapping[str, str] | None) -> tuple[list[str], list[list[str]]]:
    """Headers, and the texts of each column."""
    units, formats = units or {}, formats or {}
    given = list(table.items())
    names = [name for name, _ in given]
    if len(set(names)) < len(names):
        raise ValueError(f"table has columns of the same name: {names}")
    for what, mapping in (("units", units), ("formats", formats)):
        unknown = sorted(set(mapping) - set(names))
        if unknown:
            raise ValueError(f"{what} names columns the table does not have: {unknown}; it has {names}")
    headers = [f"{_line(name)} [{_line(units[name])}]" if units.get(name) else _line(name) for name in names]
    columns = [[_cell(value, formats.get(name)) for value in column] for name, column in given]
    return headers, columns


def _cell(value: Any, spec: str | None) -> str:
    if value is None or type(value).__name__ == "NAType" or (isinstance(value, numbers.Real) and math.isnan(value)):
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


def _line(value: Any) -> str:
    """A text in one line, as wide as it is printed."""
    return printable(" ".join(str(value).split()))


def numeric(column: Iterable[Any]) -> bool:
    """Whether a column holds numbers, apart from what is not there."""
    values = [v for v in column if v is not None]
    return bool(values) and all(isinstance(v, numbers.Real) and not isinstance(v, bool) for v in values)


_NAN = float("nan")


def frame(names: Sequence[str], rows: Sequence[tuple[dict[str, Value], Record | None, str]],
          details: bool = False) -> pd.DataFrame:
    """A table of runs; arguments as of :func:`columns`."""
    return from_columns(columns(names, rows, details))


def from_columns(made: Mapping[str, Sequence[Any]]) -> pd.DataFrame:
    """A table of columns, whatever their texts are."""
    import pandas as pd

    try:
        return pd.DataFrame(made)
    except UnicodeEncodeError:
        # texts that are not UTF-8: pandas cannot hold them as its own kind where pyarrow is installed
        return pd.DataFrame({name: pd.Series(column, dtype=object if any(isinstance(v, str) for v in column) else None)
                             for name, column in made.items()})


def columns(names: Sequence[str], rows: Sequence[tuple[dict[str, Value], Record | None, str]],
            details: bool = False) -> dict[str, list[Any]]:
    """The columns of a table of runs."""
    results = dict.fromkeys(name for _, record, _ in rows if record is not None for name in record.results)
    made: dict[str, list[Any]] = {name: [point[name] for point, _, _ in rows] for name in names}
    found = [{} if record is None else record.results for _, record, _ in rows]
    # NaN where a row lacks a result, as a table of dicts has it
    made |= {name: [values.get(name, _NAN) for values in found] for name in results}
    made["status"] = [status for _, _, status in rows]
    made["seconds"] = [_NAN if record is None else record.seconds for _, record, _ in rows]
    made["error"] = ["" if record is None else record.error for _, record, _ in rows]
    if details:
        taken = [name for name in DETAILS if name in made]
        made |= {name: [None if record is None else getattr(record, name) for _, record, _ in rows]
                 for name in DETAILS if name not in taken}
    order = [*names, *results, *RESERVED, *(name for name in made if name in DETAILS and name not in results)]
    return {name: made[name] for name in order}
