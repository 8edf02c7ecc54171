"""Report: one self-contained HTML page. It answers on its first screen; sections of tables and pictures follow."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from adaptmg.export.report.figures import Picture, picture_of
from adaptmg.export.report.layout import Card, Section, document
from adaptmg.export.report.made import made
from adaptmg.export.report.prose import folded, given_text
from adaptmg.export.report.tables import Table
from adaptmg.problem import checks
from adaptmg.runtime.atomic import write_bytes

__all__ = ["Report"]

_KEY = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


class Report:
    """An HTML page in the making; what is added appears in order.

    All text is escaped; a blank line in a text begins a new paragraph, and a text of many sentences folds behind its
    first ones. Tables sort by their headers, where the reader's browser runs scripts.

    Parameters
    ----------
    title : str
    summary : str
        Below the title, in sight.
    terms : str
        What words mean throughout; folded, below the first screen.
    max_open : int
        So many tables stand open at most, those of the first screen included; the rest folds. Of tables that do not
        say themselves whether they are open, the first of each section is, as long as there is room.

    Examples
    --------
    >>> page = Report("Smoothing")
    >>> page.section("Sweeps", "Two sweeps a cycle are best.")
    >>> page.table(pd.DataFrame({"sweeps": [1, 2]}), caption="Table 2. GRECO bar, rtol 1e-8.")
    """

    def __init__(self, title: str, summary: str = "", *, terms: str = "", max_open: int = 15) -> None:
        self.title, self.summary = given_text("title", title), given_text("summary", summary, empty=True)
        self.terms = given_text("terms", terms, empty=True)
        self.max_open = checks.integer("max_open", max_open)
        self._pictures = 0
        self._cards: list[Card] = []
        self._sections: list[Section] = [Section("", "")]
        self._made: dict[str, str] = {}

    def card(self, title: str, text: str = "", *, to: str = "", table: pd.DataFrame | None = None,
             figure: Figure | None = None, units: Mapping[str, str] | None = None,
             formats: Mapping[str, str] | None = None) -> None:
        """Add an answer to the first screen: a small table, or a picture (twice as wide), with a sentence.

        Parameters
        ----------
        title, text : str
        to : str
            Key of the section that has more.
        table : pandas.DataFrame, optional
        figure : matplotlib.figure.Figure, optional
        units, formats : mapping of column to str, optional
            Of the table; see :func:`adaptmg.study.as_text`.

        Notes
        -----
        With neither table nor figure the card says that there is nothing: ``text`` should say how to get it.
        """
        given_text("title", title)
        given_text("text", text, empty=True)
        if table is not None and figure is not None:
            raise ValueError("card takes a table or a figure, not both: make two cards")
        shown = None
        if table is not None:
            shown = Table(frame=table, caption=title, units=units, formats=formats)
        elif figure is not None:
            shown = self._picture(figure, title)
        self._cards.append(Card(title, text, given_text("to", to, empty=True), shown))

    def section(self, title: str, text: str = "", *, summary: str = "", key: str = "") -> None:
        """Begin a section; it is listed in the table of contents.

        Parameters
        ----------
        title : str
        text : str
            What folds behind its first sentences.
        summary : str
            What was asked and what came out, in sight.
        key : str
            Its name in links (letters, digits, - and _); default ``section-1`` and so on.
        """
        given_text("title", title)
        key = given_text("key", key, empty=True) or f"section-{len(self._sections)}"
        if not _KEY.fullmatch(key) or key in ("contents", "made"):
            raise ValueError("key must begin with a letter, have only letters, digits, - and _, and not be 'contents' "
                             f"or 'made', got {checks.shown(key)}")
        if any(key == section.key for section in self._sections):
            raise ValueError(f"key {key!r} is that of another section")
        self._sections.append(Section(title, key))
        summary = given_text("summary", summary, empty=True)
        if summary.strip():
            self._sections[-1].parts.append(folded(summary, "summary"))
        self.text(text)

    def text(self, text: str) -> None:
        """Add paragraphs; what goes beyond some sentences is folded."""
        given_text("text", text, empty=True)
        if text.strip():
            self._sections[-1].parts.append(folded(text))

    def table(self, table: pd.DataFrame, caption: str, note: str = "", *, units: Mapping[str, str] | None = None,
              formats: Mapping[str, str] | None = None, open: bool | None = None, csv: str = "") -> None:
        """Add a table.

        Parameters
        ----------
        table : pandas.DataFrame
        caption : str
            What it shows; say the grid, the norm and the tolerance.
        note : str
            Below it: sources, what differs from a reference. Folds behind its first sentences.
        units, formats : mapping of column to str
            See :func:`adaptmg.study.as_text`. A column named as an identifier is written in words, with the unit that
            it ends in: 'total_s' as 'total [s]'.
        open : bool, optional
            Whether it stands open; default: the first table of a section does.
        csv : str
            Name of a CSV file of it beside the page, for a link.
        """
        self._sections[-1].parts.append(Table(frame=table, caption=caption, note=note, units=units, formats=formats,
                                              open=open, csv=csv))

    def figure(self, figure: Figure | Picture, caption: str) -> None:
        """Add a picture as it is now; pyplot then forgets it (an open figure costs memory).

        Drawings become SVG, dense ones (meshes) PNG, both inside the page. One that was made elsewhere, in another
        process, is taken as it is: :func:`adaptmg.export.report.figures.picture_of`.
        """
        self._sections[-1].parts.append(figure if isinstance(figure, Picture) else self._picture(figure, caption))

    def made(self, **facts: str) -> None:
        """Say more of how the page was made (seeds, command), beside versions, machine and time."""
        for name, fact in facts.items():
            self._made[name.replace("_", " ").capitalize()] = given_text(name, fact)

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the page; the file appears complete or not at all.

        Returns
        -------
        pathlib.Path
            Where it is.
        """
        target = checks.file_path("path", path)
        write_bytes(target, self.page().encode())
        return target

    def page(self) -> str:
        """The whole page as text."""
        return document(self.title, self.summary, self.terms, self._cards, self._sections, made() | self._made,
                        self.max_open)

    def _picture(self, figure: Figure, caption: str) -> Picture:
        self._pictures += 1
        return picture_of(figure, caption, f"p{self._pictures}")
