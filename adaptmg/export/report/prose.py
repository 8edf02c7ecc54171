"""Prose and headers of a report as HTML: escaped, short in sight, the rest folded away.

A text is shown up to the sentence that passes a limit; what follows folds into ``<details>``. A header that is an
identifier, such as ``total_s``, is written as words with its unit: 'total [s]'.
"""

from __future__ import annotations

import re

from adaptmg.problem import checks
from adaptmg.runtime.text import in_html

__all__ = ["folded", "given_text", "header", "lead", "one_line", "paragraphs"]

#: characters of a text that are in sight
IN_SIGHT = 420

#: a text of more characters stands in two columns where there is room
_IN_COLUMNS = 240

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)+")
_SYMBOL = re.compile(r"([A-Za-z])_([A-Za-z0-9])")
_UNITS = {"s": "s", "ms": "ms", "us": "µs", "min": "min", "m": "m", "mm": "mm", "pa": "Pa", "mpa": "MPa", "n": "N",
          "kn": "kN", "mb": "MB", "mib": "MiB", "gb": "GB", "percent": "%"}
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
    """A text in one line."""
    return " ".join(str(text).split())


def paragraphs(text: str, kind: str = "") -> list[str]:
    """``<p>`` elements; a blank line parts them."""
    opening = f'<p class="{kind}">' if kind else "<p>"
    return [f"{opening}{in_html(one_line(part))}</p>" for part in text.split("\n\n") if part.strip()]


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


def header(name: object, unit: str | None = None) -> str:
    """A column's name as HTML: words for an identifier, its unit in brackets."""
    text, unit = one_line(name), one_line(unit or "")
    symbol = _SYMBOL.fullmatch(text)
    if symbol:
        shown = f"{in_html(symbol[1])}<sub>{in_html(symbol[2])}</sub>"
    elif _IDENTIFIER.fullmatch(text):
        words = text.split("_")
        if not unit and words[-1].lower() in _UNITS:
            unit = _UNITS[words.pop().lower()]
        shown = in_html(" ".join(words))
    else:
        shown = in_html(text)
    return f'{shown} <span class="unit">[{in_html(unit)}]</span>' if unit else shown
