"""Reports: one self-contained HTML page of sections, tables and pictures, and the report of a
parameter study.

:class:`Report` collects the parts of a page; ``report.html.j2`` and ``report.css`` are its layout. jinja2 escapes all
texts.

:func:`study_report` draws numeric results against the parameter that varies most, one line for each value of another
parameter. Where several runs share a point, the line is their median and a band spans them all.
Where no two runs share a value of any parameter (a random design), they are points."""

from __future__ import annotations

import base64
import hashlib
import io
import os
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pandas.api import types
from PIL import Image

from adaptmg import _checks as checks
from adaptmg._files import write_bytes
from adaptmg._machine import memory, processor
from adaptmg._text import printable
from adaptmg._units import with_units
from adaptmg.plot.style import cycled, label_plainly, plain, styled
from adaptmg.solver.result import versions
from adaptmg.study.tables import cells, numeric

_BLANK = re.compile(r"[ \t\n\v\f\r]+")
#: marks that override the direction of writing
_TURNS = re.compile("[\u202a-\u202e]")
#: words joined by underscores, but not a symbol with an index such as u_n
_IDENTIFIER = re.compile(r"(?![A-Za-z]_[A-Za-z0-9]$)[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)+")
_KEY = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_UNITS = {
    "s": "s",
    "ms": "ms",
    "us": "µs",
    "min": "min",
    "m": "m",
    "mm": "mm",
    "pa": "Pa",
    "mpa": "MPa",
    "n": "N",
    "kn": "kN",
    "mb": "MB",
    "mib": "MiB",
    "gb": "GB",
    "percent": "%",
}


def _text(name: str, value: str, empty: bool = True) -> str:
    """Return a text, checked; ValueError if it is blank, unless it may be ``empty``."""
    if not checks.instance(name, value, str, "a string").strip() and not empty:
        raise ValueError(f"{name} must not be empty")
    return value


def one_line(text: object) -> str:
    """Return a text in one line; control characters and marks that override the direction become
    codes."""
    return _TURNS.sub(
        lambda match: f"\\u{ord(match[0]):04x}", printable(_BLANK.sub(" ", str(text)).strip())
    )


def worded(name: object, unit: str | None = None) -> tuple[str, str]:
    """Return a column's name as words, and its unit: ``total_s`` gives 'total' and 's'."""
    text = one_line(name)
    unit = one_line(unit or "")
    if not _IDENTIFIER.fullmatch(text):
        return text, unit
    words = text.split("_")
    last = _UNITS.get(words[-1].lower())
    if last and unit in ("", last):
        unit = last
        words.pop()
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


def columns_of(
    frame: pd.DataFrame,
    units: Mapping[str, str] | None = None,
    formats: Mapping[str, str] | None = None,
) -> list[Column]:
    """Return the columns of a table in the units that are set; ValueError where units or formats
    name others."""
    if set(units or {}) <= set(frame.columns):  # else cells() below says which it does not have
        frame, units = with_units(frame, units or {})
    return [
        Column(*worded(str(name), (units or {}).get(str(name))), numeric(column), texts)
        for (name, column), texts in zip(
            frame.items(), cells(frame, units, formats)[1], strict=True
        )
    ]


def _table(
    frame: pd.DataFrame,
    caption: str,
    units: Mapping[str, str] | None,
    formats: Mapping[str, str] | None,
    note: str = "",
    open: bool = False,
    csv: str = "",
) -> dict[str, object]:
    """Return a table as the page's template reads it, with its first ``LONGEST`` rows and the number
    of all; ``open``: not folded; ``csv``: the name of a file for a link, "" for none."""
    checks.instance("table", frame, pd.DataFrame, "a pandas DataFrame")
    columns = columns_of(frame.head(LONGEST), units, formats)
    return {
        "caption": _text("caption", caption, empty=False),
        "columns": columns,
        "rows": len(frame),
        "cells": list(zip(*(column.texts for column in columns), strict=True)),
        "note": note,
        "open": open,
        "csv": csv,
    }


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
    """Return a figure in its present state as a picture; pyplot then drops it (an open figure costs
    memory)."""
    if isinstance(figure, Picture):
        return figure
    checks.instance("figure", figure, Figure, "a matplotlib Figure or a Picture")
    _text("caption", caption, empty=False)
    kind = "svg+xml"
    data = _svg(figure)
    across = figure.get_size_inches()[0]
    if len(data) > DENSE:
        kind = "png"
        data = small_png(figure, min(150.0, _ACROSS / across))
    plt.close(figure)
    # CSS has 96 pixels an inch
    return Picture(
        f"data:image/{kind};base64,{base64.b64encode(data).decode()}", caption, round(96 * across)
    )


def _svg(figure: Figure) -> bytes:
    """Return a figure as SVG, the same bytes in each run."""
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "adaptmg"}):
        figure.savefig(
            buffer, format="svg", bbox_inches="tight", facecolor="white", metadata={"Date": None}
        )
    return printable(buffer.getvalue().decode()).encode()


def small_png(figure: Figure, dpi: float = 130) -> bytes:
    """Return a figure as PNG with 256 colours."""
    buffer = io.BytesIO()
    small = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, bbox_inches="tight", facecolor="white")
    Image.open(buffer).convert("RGB").quantize(256).save(small, format="png", optimize=True)
    return small.getvalue()


@dataclass
class _Section:
    """A section; its parts are pairs of a kind ('text', 'summary', 'table', 'pictures') and the
    part."""

    title: str
    key: str
    parts: list[tuple[str, object]] = field(default_factory=list)


def _paragraphs(text: str) -> list[str]:
    return [part for part in text.split("\n\n") if part.strip()]


def _hash(script: str) -> str:
    """Return the hash of a script by which the page's policy knows it."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


_PAGES = Environment(
    loader=FileSystemLoader(Path(__file__).parent),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    finalize=lambda value: value if isinstance(value, Markup) else one_line(value),
)
_PAGES.filters |= {"paragraphs": _paragraphs, "quote": quote, "hash": _hash}
_PAGES.globals |= {"LONGEST": LONGEST}


def _made() -> dict[str, str]:
    """Return the facts that every report states: when and with which versions it was written."""
    packages = {"Python": platform.python_version(), **versions()}
    return {
        "Written": f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z}",
        "Versions": ", ".join(f"{name} {version}" for name, version in packages.items()),
        "Machine": f"{processor()}, {os.cpu_count()} cores, {memory() / 2**30:.0f} GiB, {platform.system()} "
        f"{platform.release()}",
    }


class Report:
    """An HTML page; what is added appears in order.

    All text is escaped; a blank line in a text begins a new paragraph, and all but the first fold.
    Tables sort by their headers, where the reader's browser runs scripts.

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
        self.title = _text("title", title, empty=False)
        self.summary = _text("summary", summary)
        self.terms = _text("terms", terms)
        self._cards: list[dict[str, object]] = []
        self._sections = [_Section("", "")]  # the first holds what stands before all headings
        self._facts: dict[str, str] = {}  # of the caller, besides those of _made()

    def card(
        self,
        title: str,
        text: str = "",
        *,
        to: str = "",
        table: pd.DataFrame | None = None,
        figure: Figure | Picture | None = None,
        units: Mapping[str, str] | None = None,
        formats: Mapping[str, str] | None = None,
    ) -> None:
        """Add a small table or a picture with a sentence to the first screen, and a link to the
        section of key ``to``.

        For ``units`` and ``formats`` see :func:`adaptmg.study.as_text`. A card with neither table
        nor figure says that there is no result: ``text`` should say how to get it."""
        _text("title", title, empty=False)
        if table is not None and figure is not None:
            raise ValueError("card takes a table or a figure, not both: make two cards")
        if table is None and (units is not None or formats is not None):
            raise ValueError("units and formats are those of a table, and the card has none")
        self._cards.append(
            {
                "title": title,
                "text": _text("text", text),
                "to": _text("to", to),
                "picture": None if figure is None else picture_of(figure, title),
                "table": None if table is None else _table(table, title, units, formats),
            }
        )

    def section(self, title: str, text: str = "", *, summary: str = "", key: str = "") -> None:
        """Begin a section with a summary, which is not folded, and a text.

        ``key`` is its name in links (letters, digits, - and _); default ``section-1`` and so on.
        """
        _text("title", title, empty=False)
        key = _text("key", key) or f"section-{len(self._sections)}"
        if not _KEY.fullmatch(key):
            raise ValueError(
                f"key must begin with a letter and have letters, digits, - and _, got {checks.shown(key)}"
            )
        if key in ("contents", "made", *(section.key for section in self._sections)):
            raise ValueError(f"key {key!r} is that of another section")
        self._sections.append(_Section(title, key))
        self._add("summary", _text("summary", summary))
        self.text(text)

    def text(self, text: str) -> None:
        """Add paragraphs, of which all but the first fold."""
        self._add("text", _text("text", text))

    def table(
        self,
        table: pd.DataFrame,
        caption: str,
        note: str = "",
        *,
        units: Mapping[str, str] | None = None,
        formats: Mapping[str, str] | None = None,
        open: bool = False,
        csv: str = "",
    ) -> None:
        """Add a table without its index, a caption above and a note below.

        For ``units`` and ``formats`` by column see :func:`adaptmg.study.as_text`; a column named as
        an identifier is written as words with a unit, 'total_s' as 'total [s]'. ``open``: whether
        it stands open, as the first table of a section does. ``csv`` names a CSV file of the table
        next to the page, for a link."""
        first = all(kind != "table" for kind, _ in self._sections[-1].parts)
        self._add(
            "table",
            _table(
                table,
                caption,
                units,
                formats,
                _text("note", note),
                checks.flag("open", open) or first,
                csv,
            ),
        )

    def figure(self, figure: Figure | Picture, caption: str) -> None:
        """Add a figure in its present state; pyplot then drops it (an open figure costs memory).

        Drawings become SVG, dense ones (meshes) PNG, both inside the page. A picture of
        :func:`adaptmg.export.report.picture_of` is taken unchanged.
        """
        parts = self._sections[-1].parts
        picture = picture_of(figure, caption)
        # pictures one after the other are one part of the page: a list
        pictures = parts[-1][1] if parts else None
        if isinstance(pictures, list):
            pictures.append(picture)
        else:
            parts.append(("pictures", [picture]))

    def made(self, **facts: str) -> None:
        """Add facts on the origin of the page (seeds, command) next to versions, machine and
        time."""
        for name, fact in facts.items():
            self._facts[name.replace("_", " ").capitalize()] = _text(name, fact, empty=False)

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the page and return its path; the file appears complete or not at all."""
        target = checks.file_path("path", path)
        write_bytes(target, self.page().encode())
        return target

    def page(self) -> str:
        """Return the whole page as text."""
        return _PAGES.get_template("report.html.j2").render(
            title=self.title,
            summary=self.summary,
            terms=self.terms,
            cards=self._cards,
            sections=self._sections,
            keys={section.key for section in self._sections[1:]},
            facts=_made() | self._facts,
        )

    def _add(self, kind: str, part: object) -> None:
        if not isinstance(part, str) or part.strip():
            self._sections[-1].parts.append((kind, part))


#: the largest number of characters of a text in a table, lines in a picture, and marks in a line
_LETTERS, _LINES, _MARKED = 300, 7, 60
#: an axis is logarithmic where the largest value is at least this multiple of the least: of 10 columns
#: of numbers in data/measured none does with it or twice, two with half of it
_LOGARITHMIC = 30.0


def study_report(
    table: pd.DataFrame,
    path: str | os.PathLike[str],
    *,
    parameters: Sequence[str],
    results: Sequence[str] | None = None,
    summary: str = "",
    units: Mapping[str, str] | None = None,
    csv: str = "",
    made: Mapping[str, str] | None = None,
) -> Path:
    """Write a report of a study: the number of runs, pictures of the results, all runs, those that
    failed.

    Parameters
    ----------
    table : pandas.DataFrame
        A row for each run, as :meth:`adaptmg.Study.run` returns it. Only runs with the ``status``
        'done' are drawn; a column ``error`` is shown for the others.
    path : path
        The HTML file; it appears complete or not at all.
    parameters : sequence of str
        Columns that were varied.
    results : sequence of str, optional
        Columns to draw, a picture each; default: the first two numeric columns that vary and are
        not parameters.
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
    units = checks.mapping("units", {} if units is None else units, "names to texts")
    checks.mapping("made", {} if made is None else made, "names to texts")
    for name, columns in (
        ("parameters", parameters),
        ("results", results or ()),
        ("units", list(units)),
    ):
        if missing := [column for column in checks.strings(name, columns) if column not in table]:
            raise ValueError(
                f"{name} names columns the table does not have: {missing}; it has {list(table.columns)}"
            )
    column_names = table.attrs.get(
        "columns", {"status": "status", "seconds": "seconds", "error": "error"}
    )
    for name, text in (("summary", summary), ("csv", csv)):
        checks.instance(name, text, str, "a text")
    units = {column_names["seconds"]: "s"} | units
    status = column_names["status"]
    error = column_names["error"]
    done = table[table[status] == "done"] if status in table else table
    # draw numeric results that vary, unless the caller names others
    varied = [
        name
        for name in done
        if name not in (*parameters, status, error)
        and (values := numbers(done[name])) is not None
        and values.nunique() > 1
    ]
    drawn = varied[:2] if results is None else results
    for name in drawn:
        if len(done) and numbers(done[name]) is None:
            raise ValueError(
                f"results: column {name!r} holds no numbers to draw, got "
                f"{checks.shown(done[name].iloc[0])} in its first row"
            )
    counts = table[status].value_counts() if status in table else {}
    counted = ", ".join(
        [f"{len(table):,} runs", *(f"{n:,} {state}" for state, n in counts.items())]
    )
    page = Report(str(table.attrs.get("study") or "Study"), f"{counted}. {summary}".strip())

    def add(frame: pd.DataFrame, caption: str, csv: str, open: bool = False) -> None:
        """Add a table to the page, with long texts cut short."""
        frame = frame.copy()
        for name in frame.select_dtypes(exclude="number"):
            frame[name] = pd.Series(
                [
                    f"{value[:_LETTERS]} ..."
                    if isinstance(value, str) and len(value) > _LETTERS
                    else value
                    for value in frame[name]
                ],
                frame.index,
                dtype=object,
            )
        known = {name: unit for name, unit in units.items() if name in frame}
        page.table(frame, caption, units=known, csv=csv, open=open)

    page.section("Results")
    axis = axes_of_study(done, parameters) if len(done) else None
    shown, names = with_units(done, {name: units[name] for name in units if name in done})
    for result in map(str, drawn):
        if axis is not None:
            drawing = curves(shown, axis, result, names.get(result, ""), names.get(axis.along, ""))
            page.figure(drawing, caption(axis, result))
    add(table.drop(columns=error, errors="ignore"), "All runs", csv=csv, open=True)
    failed = table[table[error].fillna("").astype(str) != ""] if error in table else table.head(0)
    if len(failed):
        page.section("Runs that failed")
        add(failed[[*parameters, error]], "Errors", csv=csv if len(failed) > LONGEST else "")
    if fixed := table.attrs.get("fixed"):
        page.made(fixed_parameters=", ".join(f"{key} = {value}" for key, value in fixed.items()))
    page.made(**{str(key): str(value) or "-" for key, value in (made or {}).items()})
    return page.write(path)


@dataclass(frozen=True)
class Axis:
    """The parameter along the axis, the one of the lines ("" for none), and whether points are
    joined."""

    along: str
    lines: str
    joined: bool = True


def numbers(column: pd.Series) -> pd.Series | None:
    """Return a column as floats if all its values that are not missing are numbers, else None."""
    return column.astype(float) if numeric(column.dropna()) else None


def axes_of_study(table: pd.DataFrame, parameters: Sequence[str]) -> Axis | None:
    """Return the parameters of a drawing: along the axis the numeric one with most values, for the
    lines the one with most of the others that have few; None if none varies. A parameter that is
    different in every run (a seed) has no lines, as each would be a point, and is along the axis only
    where all are; then runs are separate points, unless it is the only one that varies."""
    counts = {name: _keys(table[name]).nunique() for name in parameters}
    varied = [name for name in parameters if counts[name] > 1]
    if not varied:
        return None
    repeated = [name for name in varied if counts[name] < len(table)]
    candidates = repeated or varied
    numeric_names = [name for name in candidates if numbers(table[name]) is not None]
    along = max(numeric_names or candidates, key=counts.__getitem__)
    few = [name for name in repeated if name != along and counts[name] <= _LINES]
    lines = max(few, key=counts.__getitem__, default="")
    return Axis(along, lines, joined=bool(repeated) or len(varied) == 1)


@styled
def curves(
    table: pd.DataFrame, axis: Axis, result: str, unit: str = "", along_unit: str = ""
) -> Figure:
    """Return a picture of a numeric result of finished runs against a parameter."""
    figure = Figure(figsize=(6.2, 3.9))
    ax = figure.subplots()
    position = numbers(table[axis.along])
    named = position is None
    if position is None:
        position = _keys(table[axis.along]).map(_name)
    data = pd.DataFrame(
        {
            "x": position.to_numpy(),
            "y": table[result].astype(float).to_numpy(),
            "line": _keys(table[axis.lines]).to_numpy() if axis.lines else "",
        }
    )
    data = data.replace([np.inf, -np.inf], np.nan).dropna()
    joined = axis.joined and not named
    for k, (line, part) in enumerate(data.groupby("line", sort=False)):
        color = cycled(k)
        values = part.groupby("x", sort=not named)["y"]
        median = values.median()
        low = values.min()
        high = values.max()
        ax.plot(
            median.index,
            median,
            color=color,
            linestyle="-" if joined else "",
            label=f"{plain(worded(axis.lines)[0])} = {_name(str(line))}",
            # of many points the line alone, or dots where they are not joined
            marker="o" if len(median) <= _MARKED else "" if joined else ".",
        )
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
        ax.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=min(4, data["line"].nunique()),
            borderpad=0.0,
        )
    return figure


def caption(axis: Axis, result: str) -> str:
    """Return the caption of the figure that :func:`curves` draws."""
    lines = f", a line for each value of {worded(axis.lines)[0]}" if axis.lines else ""
    return (
        f"{worded(result)[0]} against {worded(axis.along)[0]}{lines}; where runs share a point their median, and "
        "the band from the least to the largest"
    )


def _scale(ax: Axes, name: str, values: pd.Series) -> None:
    """Choose a logarithmic scale where values span much; few integers on x become the ticks."""
    axis = getattr(ax, f"{name}axis")
    single = np.unique(values)
    if len(single) and single[0] > 0 and single[-1] >= _LOGARITHMIC * single[0]:
        ax.set(**{f"{name}scale": "log"})
        label_plainly(axis)
    elif name == "x" and 0 < len(single) <= 12 and (single == np.round(single)).all():
        axis.set_ticks(single, [f"{value:g}" for value in single])


def _name(value: str) -> str:
    """Return a value as a short name in the drawing."""
    return plain(value if len(value) <= 24 else f"{value[:22]} …")


def _keys(column: pd.Series) -> pd.Series:
    """Return values as texts, floats in few digits if these still differ; as objects, since columns of
    texts have another type in newer versions of pandas."""
    texts = column.map(
        lambda value: f"{value:g}" if isinstance(value, float) else str(value)
    ).astype(object)
    if types.is_numeric_dtype(column) and texts.nunique() < column.nunique(dropna=False):
        texts = column.map(repr).astype(object)
    return texts
