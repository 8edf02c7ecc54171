"""Tables of a report: they fold, sort, scroll in a box of their own, and keep their first column in sight.

What is the same in every row of a wide table is said once above it: a column less is one that need not be scrolled to.
Of a table with more than :data:`LONGEST` rows only the first so many are shown, and the table says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from urllib.parse import quote

import pandas as pd

from adaptmg.export.report.cells import Column, columns_of
from adaptmg.export.report.prose import count, folded, given_text, marked_up, one_line
from adaptmg.problem import checks
from adaptmg.runtime.text import in_html

__all__ = ["LONGEST", "Table"]

#: rows that are shown at most
LONGEST = 200
#: a table with more columns says once what is the same in every row; one with fewer need not be as wide as the page
_WIDE = 6
#: letters across that a paper has room for, two between columns included; wider tables stand on it in parts
_ON_PAPER = 180
#: longer words are broken
_WORD = 24
#: a table with more rows scrolls up and down too
_TALL = 24
#: characters of a note that are in sight
_NOTE = 240


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table and how it is shown.

    Attributes
    ----------
    frame : pandas.DataFrame
        Its index is not shown.
    caption, note : str
    units, formats : mapping of column to str, optional
        See :func:`adaptmg.study.as_text`.
    open : bool, optional
        Whether it stands open; None leaves that to the page.
    csv : str
        Name of a file beside the page that holds it, "" for none.
    """

    frame: pd.DataFrame
    caption: str
    note: str = ""
    units: Mapping[str, str] | None = None
    formats: Mapping[str, str] | None = None
    open: bool | None = None
    csv: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.frame, pd.DataFrame):
            raise TypeError(f"table must be a pandas DataFrame, got {type(self.frame).__name__}")
        given_text("caption", self.caption)
        given_text("note", self.note, empty=True)
        if self.open is not None:
            checks.flag("open", self.open)
        given_text("csv", self.csv, empty=True)
        file = PurePosixPath(self.csv)
        if file.is_absolute() or ".." in file.parts or ":" in self.csv or "\\" in self.csv:
            raise ValueError(f"csv must name a file beside the page, got {checks.shown(self.csv)}")
        # what cannot be shown is refused when it is given, not when the page is written
        columns_of(self.frame.head(0), self.units, self.formats)

    def folding(self, is_open: bool) -> str:
        """The table as ``<details>``."""
        rows = len(self.frame)
        size = f'<span class="count">{count(rows)} row{"" if rows == 1 else "s"}</span>'
        tall = " long" * (rows > _TALL)
        return (f'<details class="table{tall}"{" open" * is_open}>\n<summary>{marked_up(self.caption)} {size}'
                f"</summary>\n{self._body()}</details>")

    def plain(self) -> str:
        """The table alone, for the first screen: too small to be sorted."""
        return self._box(self._columns())

    def _columns(self) -> list[Column]:
        return columns_of(self.frame.head(LONGEST), self.units, self.formats)

    def _body(self) -> str:
        columns, above = self._columns(), ""
        if len(columns) > _WIDE and 3 <= len(self.frame) <= LONGEST:
            same = [column for column in columns[1:] if column.same]
            columns = [column for column in columns if column not in same]
            if same:
                said = "; ".join(f"{column.head} {marked_up(column.texts[0])}" for column in same)
                above = f'<p class="same">In every row: {said}.</p>\n'
        parts = _parts(columns)
        box = self._box(columns, "sort", *["wide"] * bool(parts))
        return f"{above}{box}{parts}\n{folded(self.note, 'note', _NOTE)}{self._whole()}\n"

    def _whole(self) -> str:
        """Where all rows are."""
        rows = len(self.frame)
        cut = f"The first {LONGEST} of {count(rows)} rows are shown. " * (rows > LONGEST)
        link = f'<a href="{in_html(quote(self.csv))}">{"All rows" if cut else "Table"} as CSV</a>' * bool(self.csv)
        return f'<p class="note{"" if cut else " file"}">{cut}{link}</p>' if cut or link else ""

    def _box(self, columns: Sequence[Column], *kinds: str) -> str:
        """These columns in a box that scrolls."""
        kinds = [*kinds, *["narrow"] * (len(columns) < _WIDE)]
        tall = " tall" * (len(self.frame) > _TALL)
        return (f'<div class="scroll{tall}" tabindex="0" role="region" aria-label="{in_html(one_line(self.caption))}">'
                f"{_drawn(columns, kinds)}</div>")


def _parts(columns: Sequence[Column]) -> str:
    """A table that no paper is wide enough for, in parts; nothing for others."""
    if _width(columns) <= _ON_PAPER:
        return ""
    first, *others = columns
    parts = [[first]]
    for column in others:
        if len(parts[-1]) > 1 and _width([*parts[-1], column]) > _ON_PAPER:
            parts.append([first])
        parts[-1].append(column)
    return '\n<div class="parts">' + "\n".join(_drawn(part, ()) for part in parts) + "</div>"


def _width(columns: Sequence[Column]) -> int:
    """Letters across that columns need at least."""
    return sum(min(column.least_width, _WORD) + 2 for column in columns)


def _drawn(columns: Sequence[Column], kinds: Sequence[str]) -> str:
    """Columns as ``<table>``."""
    head = "".join(f'<th scope="col"{_kind(column)}>{column.head}</th>' for column in columns)
    cells = [_cells(column, "td" if k else 'th scope="row"') for k, column in enumerate(columns)]
    rows = "\n".join(f"<tr>{''.join(row)}</tr>" for row in zip(*cells, strict=True))
    kind = f' class="{" ".join(kinds)}"' if kinds else ""
    return f"<table{kind}>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody></table>"


def _kind(column: Column) -> str:
    """Class of the cells of a column: of numbers, or of words that are longer than a column is wide."""
    return ' class="n"' if column.numeric else ' class="l"' if column.least_width > _WORD else ""


def _cells(column: Column, opening: str) -> list[str]:
    """The cells of a column as HTML elements."""
    shown = in_html if column.numeric else marked_up
    begin, end = f"<{opening}{_kind(column)}", f"</{opening.split()[0]}>"
    return [begin + (f' data-pad="{pad}"' if pad else "") + f">{shown(text)}{end}"
            for text, pad in zip(column.texts, column.pads, strict=True)]
