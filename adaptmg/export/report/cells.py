"""Headers and cells of a report's tables: words and units for identifiers, digits alike, decimal points in one line.

A header that is an identifier, such as ``total_s``, is written as words with its unit: 'total [s]'. A format such as
``.4g`` drops zeros at the end; in a column of measured numbers they stay, so that .0534 is followed by .0150. What a
cell lacks of the widest fraction of its column is set beside it unseen, so that decimal points stand below each other.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from adaptmg.export.report.prose import one_line
from adaptmg.runtime.text import in_html
from adaptmg.study.tables import shown_cells

__all__ = ["Column", "columns_of", "header", "worded"]

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
