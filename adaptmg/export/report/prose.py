"""Prose of a report as HTML: escaped, short in sight, the rest folded away.

A text is shown up to the sentence that passes a limit; what follows folds into ``<details>``.
"""

from __future__ import annotations

import re

from adaptmg.problem import checks
from adaptmg.runtime.text import in_html

__all__ = ["IN_SIGHT", "count", "folded", "given_text", "lead", "marked_up", "one_line", "paragraphs"]

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
