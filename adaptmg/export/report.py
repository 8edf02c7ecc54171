"""Reports: one self-contained HTML page of sections, tables and pictures.

:class:`Report` collects the parts of a page; ``report.html.j2`` and ``report.css`` are its layout. jinja2 escapes all
texts.
"""

from __future__ import annotations

import base64
import hashlib
import io
import os
import platform
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import NamedTuple
from urllib.parse import quote

import matplotlib
import matplotlib.pyplot as plt
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure
from PIL import Image

from adaptmg import _checks as checks
from adaptmg._files import write_bytes
from adaptmg._machine import memory, processor
from adaptmg._text import printable
from adaptmg.solver.result import versions
from adaptmg.study.tables import cells, numeric

_BLANK = re.compile(r"[ \t\n\v\f\r]+")
#: marks that override the direction of writing
_TURNS = re.compile("[\u202a-\u202e]")
#: words joined by underscores, but not a symbol with an index such as u_n
_IDENTIFIER = re.compile(r"(?![A-Za-z]_[A-Za-z0-9]$)[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)+")
_KEY = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_UNITS = {"s": "s", "ms": "ms", "us": "µs", "min": "min", "m": "m", "mm": "mm", "pa": "Pa", "mpa": "MPa", "n": "N",
          "kn": "kN", "mb": "MB", "mib": "MiB", "gb": "GB", "percent": "%"}


def _text(name: str, value: str, empty: bool = True) -> str:
    if not checks.instance(name, value, str, "a string").strip() and not empty:
        raise ValueError(f"{name} must not be empty")
    return value


def one_line(text: object) -> str:
    """Return a text in one line; control characters and marks that override the direction become codes."""
    return _TURNS.sub(lambda match: f"\\u{ord(match[0]):04x}", printable(_BLANK.sub(" ", str(text)).strip()))


def worded(name: object, unit: str | None = None) -> tuple[str, str]:
    """Return a column's name as words, and its unit: ``total_s`` gives 'total' and 's'."""
    text, unit = one_line(name), one_line(unit or "")
    if not _IDENTIFIER.fullmatch(text):
        return text, unit
    words = text.split("_")
    if not unit and words[-1].lower() in _UNITS:
        unit = _UNITS[words.pop().lower()]
    return " ".join(words), unit


def label(name: object, unit: str | None = None) -> str:
    """Return a column's name as words with its unit in brackets."""
    words, unit = worded(name, unit)
    return f"{words} [{unit}]" if unit else words


#: the largest number of rows that are shown
LONGEST = 200


class Column(NamedTuple):
    """A column of a table as texts: its name, its unit and its cells."""

    head: str
    unit: str
    numeric: bool
    texts: list[str]


def columns_of(frame: pd.DataFrame, units: Mapping[str, str] | None = None,
               formats: Mapping[str, str] | None = None) -> list[Column]:
    """Return the columns of a table; ValueError where units or formats name others."""
    return [Column(*worded(name, (units or {}).get(name)), numeric(column), texts)
            for (name, column), texts in zip(frame.items(), cells(frame, units, formats)[1], strict=True)]


def _table(frame: pd.DataFrame, caption: str, units: Mapping[str, str] | None, formats: Mapping[str, str] | None,
           note: str = "", open: bool = False, csv: str = "") -> dict[str, object]:
    checks.instance("table", frame, pd.DataFrame, "a pandas DataFrame")
    columns = columns_of(frame.head(LONGEST), units, formats)
    return {"caption": _text("caption", caption, empty=False), "columns": columns, "rows": len(frame),
            "cells": list(zip(*(column.texts for column in columns), strict=True)), "note": note, "open": open,
            "csv": csv}


#: a drawing of more bytes as SVG becomes a PNG
DENSE = 60_000
#: the largest width of a PNG in pixels
_ACROSS = 1200


class Picture(NamedTuple):
    """A picture: a data URI, its caption, and its preferred width in CSS pixels."""

    source: str
    caption: str
    width: int


def picture_of(figure: Figure | Picture, caption: str) -> Picture:
    """Return a figure in its present state as a picture; pyplot then drops it (an open figure costs memory)."""
    if isinstance(figure, Picture):
        return figure
    checks.instance("figure", figure, Figure, "a matplotlib Figure or a Picture")
    _text("caption", caption, empty=False)
    kind, data, across = "svg+xml", _svg(figure), figure.get_size_inches()[0]
    if len(data) > DENSE:
        kind, data = "png", small_png(figure, min(150.0, _ACROSS / across))
    plt.close(figure)
    return Picture(f"data:image/{kind};base64,{base64.b64encode(data).decode()}", caption, round(96 * across))


def _svg(figure: Figure) -> bytes:
    """A figure as SVG, the same bytes in each run."""
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "adaptmg"}):
        figure.savefig(buffer, format="svg", bbox_inches="tight", facecolor="white", metadata={"Date": None})
    return printable(buffer.getvalue().decode()).encode()


def small_png(figure: Figure, dpi: float = 130) -> bytes:
    """Return a figure as PNG with 256 colours."""
    buffer, small = io.BytesIO(), io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, bbox_inches="tight", facecolor="white")
    Image.open(buffer).convert("RGB").quantize(256).save(small, format="png", optimize=True)
    return small.getvalue()


@dataclass
class _Section:
    """A section; its parts are pairs of a kind ('text', 'summary', 'table', 'pictures') and the part."""

    title: str
    key: str
    parts: list[tuple[str, object]] = field(default_factory=list)


def _paragraphs(text: str) -> list[str]:
    return [part for part in text.split("\n\n") if part.strip()]


def _hash(script: str) -> str:
    """The hash of a script by which the page's policy knows it."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


_PAGES = Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined,
                     trim_blocks=True, lstrip_blocks=True,
                     finalize=lambda value: value if isinstance(value, Markup) else one_line(value))
_PAGES.filters |= {"paragraphs": _paragraphs, "quote": quote, "hash": _hash}
_PAGES.globals |= {"LONGEST": LONGEST}


def _made() -> dict[str, str]:
    """Facts of every report."""
    packages = {"Python": platform.python_version(), **versions()}
    return {"Written": f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z}",
            "Versions": ", ".join(f"{name} {version}" for name, version in packages.items()),
            "Machine": f"{processor()}, {os.cpu_count()} cores, {memory() / 2**30:.0f} GiB, {platform.system()} "
                       f"{platform.release()}"}


class Report:
    """An HTML page; what is added appears in order.

    All text is escaped; a blank line in a text begins a new paragraph, and all but the first fold. Tables sort by
    their headers, where the reader's browser runs scripts.

    Parameters
    ----------
    title, summary : str
        The summary stands below the title.
    terms : str
        Definitions of words; folded, below the first screen.

    Examples
    --------
    >>> report = am.export.Report("A bar on a plane", "What was computed, and how.")
    """

    def __init__(self, title: str, summary: str = "", *, terms: str = "") -> None:
        self.title, self.summary = _text("title", title, empty=False), _text("summary", summary)
        self.terms = _text("terms", terms)
        self._cards: list[dict[str, object]] = []
        self._sections = [_Section("", "")]
        self._made: dict[str, str] = {}

    def card(self, title: str, text: str = "", *, to: str = "", table: pd.DataFrame | None = None,
             figure: Figure | Picture | None = None, units: Mapping[str, str] | None = None,
             formats: Mapping[str, str] | None = None) -> None:
        """Add a small table or a picture with a sentence to the first screen, and a link to the section of key ``to``.

        For ``units`` and ``formats`` see :func:`adaptmg.study.as_text`. A card with neither table nor figure says that
        there is no result: ``text`` should say how to get it.
        """
        _text("title", title, empty=False)
        if table is not None and figure is not None:
            raise ValueError("card takes a table or a figure, not both: make two cards")
        self._cards.append({"title": title, "text": _text("text", text), "to": _text("to", to),
                            "picture": None if figure is None else picture_of(figure, title),
                            "table": None if table is None else _table(table, title, units, formats)})

    def section(self, title: str, text: str = "", *, summary: str = "", key: str = "") -> None:
        """Begin a section with a summary, which is not folded, and a text.

        ``key`` is its name in links (letters, digits, - and _); default ``section-1`` and so on.
        """
        _text("title", title, empty=False)
        key = _text("key", key) or f"section-{len(self._sections)}"
        if not _KEY.fullmatch(key):
            raise ValueError(f"key must begin with a letter and have letters, digits, - and _, got {checks.shown(key)}")
        if key in ("contents", "made", *(section.key for section in self._sections)):
            raise ValueError(f"key {key!r} is that of another section")
        self._sections.append(_Section(title, key))
        self._add("summary", _text("summary", summary))
        self.text(text)

    def text(self, text: str) -> None:
        """Add paragraphs, of which all but the first fold."""
        self._add("text", _text("text", text))

    def table(self, table: pd.DataFrame, caption: str, note: str = "", *, units: Mapping[str, str] | None = None,
              formats: Mapping[str, str] | None = None, open: bool = False, csv: str = "") -> None:
        """Add a table without its index, a caption above and a note below.

        For ``units`` and ``formats`` by column see :func:`adaptmg.study.as_text`; a column named as an identifier is
        written as words with a unit, 'total_s' as 'total [s]'. ``open``: whether it stands open, as the first table of
        a section does. ``csv`` names a CSV file of the table next to the page, for a link.
        """
        first = all(kind != "table" for kind, _ in self._sections[-1].parts)
        file = PurePosixPath(_text("csv", csv))
        if file.is_absolute() or ".." in file.parts or ":" in csv or "\\" in csv:
            raise ValueError(f"csv must name a file next to the page, got {checks.shown(csv)}")
        self._add("table", _table(table, caption, units, formats, _text("note", note),
                                  checks.flag("open", open) or first, csv))

    def figure(self, figure: Figure | Picture, caption: str) -> None:
        """Add a figure in its present state; pyplot then drops it (an open figure costs memory).

        Drawings become SVG, dense ones (meshes) PNG, both inside the page. A picture of
        :func:`adaptmg.export.report.picture_of` is taken unchanged.
        """
        parts = self._sections[-1].parts
        if not parts or parts[-1][0] != "pictures":
            parts.append(("pictures", []))
        parts[-1][1].append(picture_of(figure, caption))

    def made(self, **facts: str) -> None:
        """Add facts on the origin of the page (seeds, command) next to versions, machine and time."""
        for name, fact in facts.items():
            self._made[name.replace("_", " ").capitalize()] = _text(name, fact, empty=False)

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the page and return its path; the file appears complete or not at all."""
        target = checks.file_path("path", path)
        write_bytes(target, self.page().encode())
        return target

    def page(self) -> str:
        """Return the whole page as text."""
        return _PAGES.get_template("report.html.j2").render(
            title=self.title, summary=self.summary, terms=self.terms, cards=self._cards, sections=self._sections,
            keys={section.key for section in self._sections[1:]}, facts=_made() | self._made)

    def _add(self, kind: str, part: object) -> None:
        if not isinstance(part, str) or part.strip():
            self._sections[-1].parts.append((kind, part))
