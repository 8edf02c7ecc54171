"""Tables of a report: they fold, sort, scroll in a box of their own, and keep their first column in sight.

What is the same in every row of a wide table is said once above it: a column less is one that need not be scrolled to.
Of a table with more than :data:`LONGEST` rows only the first so many are shown, and the table says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from urllib.parse import quote

import pandas as pd

from adaptmg.export.report.prose import folded, given_text, header, one_line
from adaptmg.problem import checks
from adaptmg.runtime.text import in_html
from adaptmg.study.tables import shown_cells

__all__ = ["LONGEST", "Table"]

#: rows that are shown at most
LONGEST = 200
#: a table with more columns says once what is the same in every row; one with fewer need not be as wide as the page
_WIDE = 6
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
        shown_cells(self.frame.head(0), units=self.units, formats=self.formats)

    def folding(self, is_open: bool) -> str:
        """The table as ``<details>``."""
        rows = len(self.frame)
        count = f'<span class="count">{rows} row{"" if rows == 1 else "s"}</span>'
        return (f'<details class="table"{" open" * is_open}>\n<summary>{in_html(one_line(self.caption))} {count}'
                f"</summary>\n{self._body()}</details>")

    def plain(self) -> str:
        """The table alone, for the first screen."""
        return self._box(list(self.frame.columns))

    def _body(self) -> str:
        same = self._same_everywhere()
        above = ""
        if same:
            said = "; ".join(f"{header(name, (self.units or {}).get(name))} {in_html(value)}"
                             for name, value in same.items())
            above = f'<p class="same">In every row: {said}.</p>\n'
        below = folded(self.note, "note", _NOTE)
        if len(self.frame) > LONGEST:
            below += f'<p class="note">The first {LONGEST} of {len(self.frame)} rows are shown.</p>'
        if self.csv:
            below += f'<p class="note"><a href="{in_html(quote(self.csv))}">Table as CSV</a></p>'
        return f"{above}{self._box([name for name in self.frame.columns if name not in same])}\n{below}\n"

    def _same_everywhere(self) -> dict[str, str]:
        """Columns whose cells all read the same, and what they read; none of a narrow or short table."""
        shown = self.frame.head(LONGEST)
        if len(shown.columns) <= _WIDE or not 3 <= len(self.frame) <= LONGEST:
            return {}
        cells, _ = shown_cells(shown, units=self.units, formats=self.formats)
        return {name: column[0] for name, column in list(zip(shown.columns, cells, strict=True))[1:]
                if len(set(column)) == 1}

    def _box(self, names: list[str]) -> str:
        """The table with these columns in a box that scrolls."""
        shown = self.frame.head(LONGEST)
        columns, numeric = shown_cells(shown, units=self.units, formats=self.formats)
        kept = [k for k, name in enumerate(shown.columns) if name in names]
        classes = [' class="n"' if is_number else "" for is_number in numeric]
        headers = [header(name, (self.units or {}).get(name)) for name in shown.columns]
        head = "".join(f'<th scope="col"{classes[k]}>{headers[k]}</th>' for k in kept)
        rows = []
        for row in zip(*(columns[k] for k in kept), strict=True):
            cells = [in_html(cell) for cell in row]
            first = f'<th scope="row"{classes[kept[0]]}>{cells[0]}</th>'
            rest = "".join(f"<td{classes[k]}>{cell}</td>" for k, cell in zip(kept[1:], cells[1:], strict=True))
            rows.append(f"<tr>{first}{rest}</tr>")
        tall = " tall" * (len(rows) > _TALL)
        label = in_html(one_line(self.caption))
        narrow = " narrow" * (len(kept) < _WIDE)
        return (f'<div class="scroll{tall}" tabindex="0" role="region" aria-label="{label}">'
                f'<table class="sort{narrow}">\n'
                f"<thead><tr>{head}</tr></thead>\n<tbody>\n" + "\n".join(rows) + "\n</tbody></table></div>")
