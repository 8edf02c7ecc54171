"""Headers and cells of a report's tables: words and units for identifiers, digits alike, decimal points in one line.

A header that is an identifier, such as ``total_s``, is written as words with its unit: 'total [s]'. A format such as
``.4g`` drops zeros at the end; in a column of measured numbers they stay, so that .0534 is followed by .0150. What a
cell lacks of the widest fraction of its column is set beside it unseen, so that decimal points stand below each other.

Curves of a study: a numeric result against the parameter that varies most, a line for each value of another one.

Where several runs share a point (repeats, or parameters that are neither on the axis nor a line), the line is their
median and a band spans the least and the largest, or the middle half where they are many. Where no two runs share a
value of any parameter (a random design, of several parameters) the runs are points without a line.

Pictures of a report: drawings as SVG inside the page, dense ones (meshes, surfaces) as PNG of 256 colours.

The page of a report put together: first screen, contents, sections, how it was made.

How a report was made: versions, machine, time.

Report: one self-contained HTML page. It answers on its first screen; sections of tables and pictures follow.

Prose of a report as HTML: escaped, short in sight, the rest folded away.

A text is shown up to the sentence that passes a limit; what follows folds into ``<details>``.

study_report: the table of a parameter study as one HTML file, with what came out drawn against what varied.

SVG of matplotlib made fit to stand inside a page, small and without anything foreign.

Identifiers are those of the picture alone (two pictures of a page share none), coordinates are rounded to a hundredth
of a point, metadata, styles of the whole page and targets of links go, and fonts are named beside some that readers
have.

Tables of a report: they fold, sort, scroll in a box of their own, and keep their first column in sight.

What is the same in every row of a wide table is said once above it: a column less is one that need not be scrolled to.
Of a table with more than :data:`LONGEST` rows only the first so many are shown, and the table says so.
"""

from __future__ import annotations

import base64
import io
import os
import platform
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from itertools import islice
from pathlib import Path, PurePosixPath
from urllib.parse import quote
from xml.etree import ElementTree

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from pandas.api import types
from PIL import Image

from adaptmg import _checks as checks
from adaptmg._files import write_bytes
from adaptmg._text import in_html, printable
from adaptmg.export.report_page import POLICY, SCRIPT, STYLE
from adaptmg.plot.style import CYCLE, plain, styled
from adaptmg.solver.result import versions
from adaptmg.study.tables import shown_cells

__all__ = [
    "DENSE",
    "IN_SIGHT",
    "LONGEST",
    "Axis",
    "Card",
    "Column",
    "Picture",
    "Report",
    "Section",
    "Table",
    "axes_of_study",
    "caption",
    "columns_of",
    "count",
    "curves",
    "document",
    "folded",
    "given_text",
    "header",
    "inline_svg",
    "lead",
    "machine",
    "made",
    "marked_up",
    "numbers",
    "one_line",
    "paragraphs",
    "picture_of",
    "small_png",
    "study_report",
    "worded",
]

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)+")
_SYMBOL = re.compile(r"([A-Za-z])_([A-Za-z0-9])")
_UNITS = {"s": "s", "ms": "ms", "us": "µs", "min": "min", "m": "m", "mm": "mm", "pa": "Pa", "mpa": "MPa", "n": "N",
          "kn": "kN", "mb": "MB", "mib": "MiB", "gb": "GB", "percent": "%"}
#: how floats are shown where nothing is said, see :func:`adaptmg.study.as_text`
_DEFAULT = ".4g"
_GENERAL = re.compile(r"\.\d+g")
#: what stands left of the decimal point, or of an exponent where there is none
_WHOLE = re.compile(r"[^.e]*")
_TAG = re.compile(r"<[^>]*>")
_DIGIT = re.compile(r"\d")
_ZERO = re.compile(r"-?0(\.0*)?e\+00")


@dataclass(frozen=True)
class Column:
    """A column as it is shown.

    Attributes
    ----------
    name : object
        As the table has it.
    head : str
        HTML.
    numeric : bool
    texts, pads : list of str
        What each cell reads (not escaped), and what is set right of it unseen.
    """

    name: object
    head: str
    numeric: bool
    texts: list[str]
    pads: list[str]

    @property
    def same(self) -> bool:
        """Whether all cells read the same."""
        return len(set(self.texts)) == 1

    @property
    def least_width(self) -> int:
        """Letters of its longest word, or number with what is set right of it."""
        words = {text + pad for text, pad in zip(self.texts, self.pads, strict=True)} | {_TAG.sub("", self.head)}
        return max(len(word) for text in words for word in text.split() or [""])


def columns_of(frame: pd.DataFrame, units: Mapping[str, str] | None,
               formats: Mapping[str, str] | None) -> list[Column]:
    """The columns of a table; ValueError where units or formats name others."""
    units, formats = dict(units or {}), dict(formats or {})
    even = {name: f"#{spec}" for name, spec in _general(frame, formats).items() if _measured(frame[name], spec)}
    cells, numeric = shown_cells(frame, units=units, formats=formats | even)
    result = []
    for name, texts, is_number in zip(frame.columns, cells, numeric, strict=True):
        texts = [one_line(text).removesuffix("." * (name in even)) for text in texts]
        texts = ["0" if is_number and _ZERO.fullmatch(text) else text for text in texts]
        pads = _padding(texts) if is_number else [""] * len(texts)
        result.append(Column(name, header(name, units.get(name)), is_number, texts, pads))
    return result


def worded(name: object, unit: str | None = None) -> tuple[str, str]:
    """A column's name as words, and its unit: ``total_s`` gives 'total' and 's'."""
    text, unit = one_line(name), one_line(unit or "")
    if _SYMBOL.fullmatch(text) or not _IDENTIFIER.fullmatch(text):
        return text, unit
    words = text.split("_")
    if not unit and words[-1].lower() in _UNITS:
        unit = _UNITS[words.pop().lower()]
    return " ".join(words), unit


def header(name: object, unit: str | None = None) -> str:
    """A column's name as HTML: words for an identifier, its unit in brackets."""
    text, unit = worded(name, unit)
    symbol = _SYMBOL.fullmatch(text)
    shown = f"{in_html(symbol[1])}<sub>{in_html(symbol[2])}</sub>" if symbol else in_html(text)
    return f'{shown} <span class="unit">[{in_html(unit)}]</span>' if unit else shown


def _general(frame: pd.DataFrame, formats: Mapping[str, str]) -> dict[str, str]:
    """Columns of floats whose format drops zeros at the end, and that format."""
    found = {name: formats.get(name) or _DEFAULT for name, kind in frame.dtypes.items() if kind.kind == "f"}
    return {name: spec for name, spec in found.items() if _GENERAL.fullmatch(spec)}


def _measured(column: pd.Series, spec: str) -> bool:
    """Whether a number has more digits than are shown; what was chosen, such as 0.1, has not."""
    values = column.dropna().to_numpy(float)
    return any(float(format(value, spec)) != value for value in values[np.isfinite(values)])


def _padding(texts: Sequence[str]) -> list[str]:
    """What each text lacks of the longest fraction (or exponent) among them."""
    tails = [_DIGIT.sub("0", text[_WHOLE.match(text).end():]) for text in texts]
    longest = max(tails, key=len, default="")
    if not longest:
        return tails
    # texts repeat: what is missing is found once each
    missing = {tail: "".join((Counter(longest) - Counter(tail)).elements()) for tail in set(tails)}
    return [missing[tail] for tail in tails]


#: lines in a picture at most; further values share one colour, without a legend
_LINES = 7
#: points that are marked in a line at most
_MARKED = 60
#: names along an axis at most
_NAMES = 40
#: letters of a name in a drawing at most
_LETTERS = 24
#: of so many runs at a point the least and the largest are chance
_MANY = 10
#: an axis is logarithmic where the largest value is so many times the least
_LOGARITHMIC = 30.0


@dataclass(frozen=True)
class Axis:
    """What a study's pictures have in common.

    Attributes
    ----------
    along, lines : str
        The parameter along the axis, and the one of the lines, "" for none.
    joined : bool
        Whether points are joined.
    """

    along: str
    lines: str
    joined: bool = True


def numbers(column: pd.Series) -> pd.Series | None:
    """A column as floats if all that is known of it are finite or infinite numbers, else None."""
    if isinstance(column.dtype, np.dtype) and column.dtype.kind in "iuf":
        return column.astype(float) if column.notna().any() else None
    known = column.dropna()
    if known.empty or types.is_bool_dtype(known) or known.map(lambda v: isinstance(v, bool | np.bool_ | str)).any():
        return None
    try:
        values = pd.to_numeric(column)
    except (TypeError, ValueError):
        return None
    return None if values.dtype.kind == "c" else values.astype(float)


def axes_of_study(table: pd.DataFrame, parameters: Sequence[str]) -> Axis | None:
    """Which parameter is along the axis: of those that vary the numeric one with most values; None if none varies.

    One that is different in every run (a seed) is taken only where all are.
    """
    counts = {name: _keys(table[name]).nunique() for name in parameters}
    varied = [name for name in parameters if counts[name] > 1]
    if not varied:
        return None
    shared = [name for name in varied if counts[name] < len(table)]
    numeric = [name for name in shared or varied if numbers(table[name]) is not None]
    along = max(numeric or shared or varied, key=lambda name: counts[name])
    others = [name for name in varied if name != along and counts[name] <= _LINES]
    return Axis(along, max(others, key=lambda name: counts[name]) if others else "", bool(shared) or len(varied) == 1)


@styled
def curves(table: pd.DataFrame, axis: Axis, result: str, unit: str = "", along_unit: str = "") -> Figure:
    """A numeric result against a parameter.

    Parameters
    ----------
    table : pandas.DataFrame
        Finished runs.
    axis : Axis
    result : str
        A column of numbers.
    unit, along_unit : str
        Of the result and of the parameter.
    """
    figure = Figure(figsize=(6.2, 3.9))
    ax = figure.subplots()
    position = numbers(table[axis.along])
    names = None if position is not None else list(dict.fromkeys(_keys(table[axis.along])))[:_NAMES]
    if position is None:
        position = _keys(table[axis.along]).map({name: float(k) for k, name in enumerate(names)})
    data = pd.DataFrame({"x": position.to_numpy(), "y": numbers(table[result]).to_numpy(),
                         "line": [""] * len(table) if not axis.lines else _keys(table[axis.lines]).to_numpy()})
    data = data[np.isfinite(data["x"]) & np.isfinite(data["y"])]
    many = _many(table, axis)
    for k, (line, part) in enumerate(data.groupby("line", sort=False)):
        _line(ax, part, CYCLE[k % len(CYCLE)], f"{plain(worded(axis.lines)[0])} = {_name(line)}",
              joined=axis.joined and names is None, band=(0.25, 0.75) if many else (0.0, 1.0))
    ax.set_xlabel(_label(axis.along, along_unit))
    ax.set_ylabel(_label(result, unit))
    ax.grid(True)
    if names is None:
        _scale(ax, "x", data["x"])
    else:
        ax.set_xticks(range(len(names)), [_name(name) for name in names], rotation=90 if len(names) > 6 else 0)
    _scale(ax, "y", data["y"])
    if axis.lines and len(data):
        # above the drawing, where nothing is drawn
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=min(4, data["line"].nunique()), borderpad=0.0)
    return figure


def caption(table: pd.DataFrame, axis: Axis, result: str) -> str:
    """What :func:`curves` shows."""
    lines = f", a line for each value of {worded(axis.lines)[0]}" if axis.lines else ""
    spread = "of their middle half" if _many(table, axis) else "from the least to the largest"
    return (f"{worded(result)[0]} against {worded(axis.along)[0]}{lines}; where runs share a point their median, and "
            f"the band {spread}")


def _many(table: pd.DataFrame, axis: Axis) -> bool:
    """Whether points are shared by many runs."""
    points = pd.concat([_keys(table[name]) for name in (axis.along, axis.lines) if name], axis=1)
    return bool(len(table)) and len(table) >= _MANY * len(points.drop_duplicates())


def _line(ax: Axes, part: pd.DataFrame, color: str, label: str, joined: bool, band: tuple[float, float]) -> None:
    values = part.groupby("x")["y"]
    points = pd.DataFrame({"median": values.median(), "low": values.quantile(band[0]),
                           "high": values.quantile(band[1]), "size": values.size()})
    style = {"linestyle": "-" if joined else "", "marker": "o" if len(points) <= _MARKED else "" if joined else "."}
    ax.plot(points.index, points["median"], color=color, label=label, **style)
    if (points["size"] > 1).any():
        if joined:
            ax.fill_between(points.index, points["low"], points["high"], color=color, alpha=0.18, linewidth=0)
        else:
            ax.vlines(points.index, points["low"], points["high"], color=color, alpha=0.5)


def _scale(ax: Axes, name: str, values: pd.Series) -> None:
    """Logarithmic where values span much, with plain numbers; on x a tick a value where these are few whole numbers."""
    if not len(values):
        return
    axis, single = getattr(ax, f"{name}axis"), np.unique(values)
    if single[0] > 0 and single[-1] >= _LOGARITHMIC * single[0]:
        ax.set(**{f"{name}scale": "log"})
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    elif name == "x" and len(single) <= 12 and (single == np.round(single)).all():
        axis.set_ticks(single, [f"{value:g}" for value in single])


def _name(value: str) -> str:
    """A value as a name in the drawing: not longer than there is room for."""
    return plain(value if len(value) <= _LETTERS else f"{value[:_LETTERS - 2]} …")


def _label(name: str, unit: str) -> str:
    words, unit = worded(name, unit)
    return plain(f"{words} [{unit}]" if unit else words)


def _keys(column: pd.Series) -> pd.Series:
    """Values as texts, floats in few digits where that keeps them apart."""
    if not (isinstance(column.dtype, np.dtype) and column.dtype.kind in "iuf"):
        return column.map(lambda value: f"{value:g}" if isinstance(value, float) else str(value))
    # values repeat: each is written once
    codes, found = pd.factorize(column, use_na_sentinel=False)
    texts = [f"{value:g}" if isinstance(value, float) else str(value) for value in found.tolist()]
    if len(set(texts)) < len(texts):
        texts = [repr(value) for value in found.tolist()]
    return pd.Series(np.array(texts, dtype=object)[codes], index=column.index)


#: an SVG of more characters becomes a PNG, unless that is larger
DENSE = 60_000
#: bytes of an SVG that is not looked at further
_HOPELESS = 12 * DENSE
#: pixels of a PNG across at most
_ACROSS = 1200


@dataclass(frozen=True)
class Picture:
    """A picture as HTML, its caption, and the width in CSS pixels that it takes where there is room."""

    html: str
    caption: str
    width: int

    def block(self) -> str:
        """As ``<figure>`` with its caption."""
        return (f'<figure style="--w:{self.width}px">\n<div class="paper">{self.html}</div>\n'
                f"<figcaption>{marked_up(self.caption)}</figcaption>\n</figure>")


def picture_of(figure: Figure, caption: str, prefix: str) -> Picture:
    """A figure as it is now; pyplot then forgets it (an open figure costs memory).

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    caption : str
        What it shows; also read out to who cannot see it.
    prefix : str
        Of all identifiers in it, other than that of any other picture of the page.
    """
    if not isinstance(figure, Figure):
        raise TypeError(f"figure must be a matplotlib Figure, got {type(figure).__name__}")
    label = one_line(given_text("caption", caption))
    width = round(96 * figure.get_size_inches()[0])
    _lay_out_once(figure)
    drawn = _drawing(figure, prefix, label)
    if drawn is None or len(drawn) > DENSE:
        png = small_png(figure, min(150.0, _ACROSS / figure.get_size_inches()[0]))
        if drawn is None or 4 * len(png) / 3 < len(drawn):
            data = base64.b64encode(png).decode("ascii")
            drawn = f'<img src="data:image/png;base64,{data}" alt="{in_html(label)}">'
    plt.close(figure)
    return Picture(drawn, caption, width)


def _lay_out_once(figure: Figure) -> None:
    """Fix where axes stand: a layout engine would find that anew each of the several times a figure is drawn."""
    if figure.get_layout_engine() is not None:
        figure.draw_without_rendering()
        figure.set_layout_engine("none")


def small_png(figure: Figure, dpi: float = 130) -> bytes:
    """A figure as PNG with 256 colours."""
    buffer, small = io.BytesIO(), io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, bbox_inches="tight", facecolor="white")
    Image.open(buffer).convert("RGB").quantize(256).save(small, format="png", optimize=True)
    return small.getvalue()


def _drawing(figure: Figure, prefix: str, label: str) -> str | None:
    """As SVG; None where that is far too large."""
    buffer = io.BytesIO()
    # letters stay letters; the salt makes identifiers the same from run to run
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "adaptmg", "path.simplify": True,
                                "path.simplify_threshold": 0.25}):
        figure.savefig(buffer, format="svg", bbox_inches="tight", facecolor="white",
                       metadata={"Date": None, "Creator": None})
    if buffer.tell() > _HOPELESS:
        return None
    return inline_svg(printable(buffer.getvalue().decode()), prefix, printable(label))


#: characters of a card's text that are in sight
_CARD = 220
_UP = '<a class="up" href="#contents">Contents</a>'


@dataclass(frozen=True)
class Card:
    """An answer of the first screen; ``to`` is the key of a section."""

    title: str
    text: str
    to: str
    shown: Table | Picture | None


@dataclass
class Section:
    """A section; parts that are strings are HTML already."""

    title: str
    key: str
    parts: list[str | Table | Picture] = field(default_factory=list)


def document(title: str, summary: str, terms: str, cards: Sequence[Card], sections: Sequence[Section],
             facts: Mapping[str, str], max_open: int) -> str:
    """The whole page. The first section has no title: what was added before any."""
    keys = {section.key for section in sections if section.key}
    first, *rest = sections
    opened = _opened(sections, max_open - sum(isinstance(card.shown, Table) for card in cards))
    body = [f"<h1>{in_html(one_line(title))}</h1>", *paragraphs(summary)]
    if cards:
        body.append('<div class="front">\n' + "\n".join(_card(card, keys) for card in cards) + "\n</div>")
    if terms.strip():
        body.append(f'<details class="more"><summary>What the words mean</summary>\n<div class="columns">'
                    f'{"".join(paragraphs(terms))}</div></details>')
    body.append(_contents(rest))
    body += _parts(first, opened)
    for number, section in enumerate(rest, start=1):
        body.append(f'<section id="{section.key}">\n<h2>{number}. {in_html(one_line(section.title))} {_UP}</h2>')
        body += [*_parts(section, opened), "</section>"]
    made = "\n".join(f"<dt>{in_html(name)}</dt><dd>{in_html(one_line(fact))}</dd>" for name, fact in facts.items())
    body.append(f'<section id="made">\n<h2>How this was made {_UP}</h2>\n<dl>\n{made}\n</dl>\n</section>')
    return (f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
            f"<title>{in_html(one_line(title))}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n"
            + "\n".join(body) + f"\n</main>\n<script>\n{SCRIPT}</script>\n</body>\n</html>\n")


def _opened(sections: Sequence[Section], room: int) -> set[int]:
    """Identities of the tables that stand open: first those that ask for it, then the first of each section."""
    tables = [[part for part in section.parts if isinstance(part, Table)] for section in sections]
    asked = [table for each in tables for table in each if table.open]
    firsts = [each[0] for each in tables if each and each[0].open is None and not any(t.open for t in each)]
    return {id(table) for table in [*asked, *firsts][:max(room, 0)]}


def _card(card: Card, keys: set[str]) -> str:
    kind = "card wide" if isinstance(card.shown, Picture) else "card" if card.shown is not None else "card absent"
    link = in_html(card.to)
    title = in_html(one_line(card.title))
    title = f'<a href="#{link}">{title}</a>' if card.to in keys else title
    shown = ""
    if isinstance(card.shown, Table):
        shown = card.shown.plain()
    elif isinstance(card.shown, Picture):
        shown = f'<div class="paper">{card.shown.html}</div>'
    return f'<div class="{kind}">\n<h2>{title}</h2>\n{shown}\n{folded(card.text, limit=_CARD)}\n</div>'


def _contents(sections: Sequence[Section]) -> str:
    entries = "\n".join(f'<li><a href="#{section.key}">{in_html(one_line(section.title))}</a></li>'
                        for section in sections)
    return (f'<nav id="contents" class="contents" aria-label="Contents">\n<ol>\n{entries}\n'
            '<li class="last"><a href="#made">How this was made</a></li>\n</ol>\n</nav>')


def _parts(section: Section, opened: set[int]) -> list[str]:
    """HTML of the parts; pictures that follow each other stand side by side where there is room."""
    result: list[str] = []
    row: list[str] = []
    for part in [*section.parts, ""]:
        if isinstance(part, Picture):
            row.append(part.block())
            continue
        if row:
            result.append('<div class="pictures">\n' + "\n".join(row) + "\n</div>")
            row = []
        result.append(part.folding(id(part) in opened) if isinstance(part, Table) else part)
    return [text for text in result if text]


def machine() -> str:
    """Processor, cores, memory and system in a line."""
    name, memory = platform.processor() or platform.machine(), ""
    try:
        found = [line.split(":", 1)[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines()
                 if line.startswith("model name")]
        name = found[0] if found else name
        memory = f", {os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30:.0f} GiB"
    except (OSError, ValueError, AttributeError):
        pass
    return f"{name}, {os.cpu_count()} cores{memory}, {platform.system()} {platform.release()}"


def made() -> dict[str, str]:
    """What is said of every report."""
    packages = {"Python": platform.python_version(), **versions()}
    return {"Written": f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z}",
            "Versions": ", ".join(f"{name} {version}" for name, version in packages.items()), "Machine": machine()}


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
        process, is taken as it is: :func:`adaptmg.export.report.picture_of`.
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


#: characters of a text that are in sight
IN_SIGHT = 420

#: a text of more characters stands in two columns where there is room
_IN_COLUMNS = 240

_BLANK = re.compile(r"[ \t\n\v\f\r]+")
# a number that a line would be broken in, after its minus
_SMALL = re.compile(r"[\d.]+e-\d+")
# embeddings and overrides of the direction of writing
_TURNS = re.compile("[\u202a-\u202e]")
# the end of a sentence: a full stop after a word or bracket of two characters or more, and a capital after the blank
_SENTENCE = re.compile(r"(?<=[\w)%'\"]{2}[.!?])\s+(?=[A-Z'\"])")


def given_text(name: str, value: str, empty: bool = False) -> str:
    """A text that was given, checked."""
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, got {checks.shown(value)}")
    if not value.strip() and not empty:
        raise ValueError(f"{name} must not be empty")
    return value


def one_line(text: object) -> str:
    """A text in one line, marks that would turn what follows it around as codes; spaces that hold stay."""
    return _TURNS.sub(lambda match: f"\\u{ord(match[0]):04x}", _BLANK.sub(" ", str(text)).strip())


def marked_up(text: object) -> str:
    """A text in one line as HTML, small numbers such as 1e-6 whole."""
    return _SMALL.sub(r'<span class="whole">\g<0></span>', in_html(one_line(text)))


def count(number: int) -> str:
    """A whole number, its thousands apart."""
    return str(number) if abs(number) < 10_000 else f"{number:,}".replace(",", "\u202f")


def paragraphs(text: str, kind: str = "") -> list[str]:
    """``<p>`` elements; a blank line parts them."""
    opening = f'<p class="{kind}">' if kind else "<p>"
    return [f"{opening}{marked_up(part)}</p>" for part in text.split("\n\n") if part.strip()]


def lead(text: str, limit: int = IN_SIGHT) -> tuple[str, str]:
    """Whole sentences of some ``limit`` characters, and the rest; a little that would be left over is not parted."""
    if len(text) <= limit * 1.3:
        return text, ""
    for match in _SENTENCE.finditer(text):
        if match.start() >= 0.5 * limit:
            return (text, "") if len(text) - match.end() < 0.3 * limit else (text[:match.start()], text[match.end():])
    return text, ""


def folded(text: str, kind: str = "", limit: int = IN_SIGHT) -> str:
    """A text as HTML, what goes beyond ``limit`` characters folded away."""
    first, *others = [part for part in text.split("\n\n") if part.strip()] or [""]
    if not first:
        return ""
    seen, rest = lead(one_line(first), limit)
    rest = "\n\n".join([rest] * bool(rest) + others)
    shown = paragraphs(seen, kind)
    if len(seen) > _IN_COLUMNS:
        shown = [f'<div class="columns">{shown[0]}</div>']
    if rest:
        shown.append(f'<details class="more"><summary>More</summary>\n<div class="columns">'
                     f'{"".join(paragraphs(rest, kind))}</div></details>')
    return "\n".join(shown)


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


_SVG, _LINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_FONT = re.compile(r"(font(?:-family)?:[^;'\"]*?)('DejaVu Sans'[^;]*|DejaVu Sans[^;]*)")
_SPACE = re.compile(r"\s*:\s*")
_ROUNDED = ("d", "x", "y", "points", "x1", "x2", "y1", "y2")


def inline_svg(source: str, prefix: str, label: str) -> str:
    """An ``<svg>`` element for a page of HTML.

    Parameters
    ----------
    source : str
        As matplotlib writes it.
    prefix : str
        Begins every identifier in it.
    label : str
        What the picture shows, for those who cannot see it.
    """
    root = ElementTree.fromstring(source)
    used = _used(root)
    _simplify(root, used)
    for element in root.iter():
        element.tag = element.tag.removeprefix(f"{{{_SVG}}}")
        _clean(element, prefix, used)
    view = root.get("viewBox")
    root.attrib.clear()
    root.attrib.update({"viewBox": view, "role": "img", "aria-label": label})
    # HTML knows the namespace of <svg>; it has no element that closes itself, but those in foreign content do
    return re.sub(r"\s*\n\s*", "\n", ElementTree.tostring(root, encoding="unicode"))


def _simplify(element: ElementTree.Element, used: set[str]) -> None:
    """Take out metadata and styles; of groups that only carry a name keep what they hold."""
    kept = []
    for child in list(element):
        name = child.tag.removeprefix(f"{{{_SVG}}}") if isinstance(child.tag, str) else ""
        if name in ("", "metadata", "style", "script", "foreignObject") or "}" in name:
            continue
        _simplify(child, used)
        if name in ("defs", "g") and not len(child):
            continue
        bare = name == "g" and not set(child.attrib) - {"id"} and child.get("id") not in used
        kept.extend(child if bare else [child])
    for child in list(element):
        element.remove(child)
    element.extend(kept)


def _used(root: ElementTree.Element) -> set[str]:
    """Identifiers to which something in the picture refers."""
    found = set()
    for element in root.iter():
        for name, value in element.attrib.items():
            if name.endswith("href") and value.startswith("#"):
                found.add(value[1:])
            found.update(_REFERENCE.findall(value))
    return found


def _clean(element: ElementTree.Element, prefix: str, used: set[str]) -> None:
    attributes = {}
    for name, value in element.attrib.items():
        name = name.removeprefix(f"{{{_LINK}}}")
        if name == "id":
            if value not in used:
                continue
            value = f"{prefix}-{value}"
        elif name == "href":
            if not value.startswith(("#", "data:image/png;base64,")):
                continue
            value = f"#{prefix}-{value[1:]}" if value.startswith("#") else value
        elif name in _ROUNDED:
            value = _NUMBER.sub(lambda match: f"{float(match[0]):.2f}".rstrip("0").rstrip("."), value)
        elif name.startswith("on") or "}" in name:
            continue
        value = _REFERENCE.sub(lambda match: f"url(#{prefix}-{match[1]})", value)
        if name == "style":
            value = _FONT.sub(r"\1'DejaVu Sans',Verdana,sans-serif", value)
            value = ";".join(_SPACE.sub(":", part.strip(), count=1) for part in value.split(";") if part.strip())
        attributes[name] = " ".join(value.split())
    element.attrib.clear()
    element.attrib.update(attributes)


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
        parts = _header_parts(columns)
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


def _header_parts(columns: Sequence[Column]) -> str:
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
