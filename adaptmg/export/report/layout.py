"""The page of a report put together: first screen, contents, sections, how it was made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from adaptmg.export.report.figures import Picture
from adaptmg.export.report.prose import folded, one_line, paragraphs
from adaptmg.export.report.script import POLICY, SCRIPT
from adaptmg.export.report.style import STYLE
from adaptmg.export.report.tables import Table
from adaptmg.runtime.text import in_html

__all__ = ["Card", "Section", "document"]

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
