"""A strict reader of HTML pages."""

import base64
import re
from html.parser import HTMLParser
from xml.etree import ElementTree

VOID = {
    "area",
    "base",
    "br",
    "col",
    "embed",
    "hr",
    "img",
    "input",
    "link",
    "meta",
    "source",
    "track",
    "wbr",
}
#: may not stand inside a paragraph
BLOCKS = {
    "p",
    "div",
    "table",
    "figure",
    "details",
    "section",
    "nav",
    "ol",
    "ul",
    "dl",
    "h1",
    "h2",
    "h3",
    "main",
}
_FOREIGN = re.compile(r"(?i)(https?:)?//[a-z0-9]|@import|javascript:|expression\(")


class Page(HTMLParser):
    """Start tags with their attributes, texts with the innermost open element, and the texts of
    each SVG."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.drawings: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert not self._open, f"never closed: {self._open}"
        self._check_names()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._take(tag, attrs)
        assert not (tag in BLOCKS and "p" in self._open), f"<{tag}> inside a paragraph"
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag in VOID, f"<{tag}/> closes itself"
        self._take(tag, attrs)

    def handle_endtag(self, tag: str) -> None:
        assert self._open and self._open.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append((self._open[-1] if self._open else "", data))

    def _take(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        assert len(found) == len(attrs), f"<{tag}> has an attribute twice: {attrs}"
        for name, value in found.items():
            assert not name.startswith("on"), f"<{tag}> has a handler {name}"
            if (
                name in ("href", "src", "style", "action")
                and value
                and not value.startswith("data:image/")
            ):
                assert not _FOREIGN.search(value), f"<{tag} {name}> leads out of the page: {value}"
        if tag == "img":
            kind, data = re.fullmatch(
                r"data:image/(png|svg\+xml);base64,(.*)", found.get("src") or ""
            ).groups()
            assert found.get("alt")
            if kind != "png":
                self.drawings.append(
                    " ".join(
                        ElementTree.fromstring(base64.b64decode(data, validate=True)).itertext()
                    )
                )
        self.tags.append((tag, found))

    def _check_names(self) -> None:
        ids = [attributes["id"] for _, attributes in self.tags if "id" in attributes]
        assert len(ids) == len(set(ids)), "an id twice"
        for tag, attributes in self.tags:
            for value in attributes.values():
                for name in re.findall(r"url\(#([^)]+)\)", value or ""):
                    assert name in ids, f"<{tag}> refers to #{name}, which is not there"
            target = attributes.get("href") or ""
            assert not target.startswith("#") or target[1:] in ids, (
                f"a link to {target} leads nowhere"
            )

    def all(self, tag: str, kind: str | None = None) -> list[dict[str, str | None]]:
        """Attributes of every such element, of a class if one is named."""
        return [
            found
            for name, found in self.tags
            if name == tag and (kind is None or kind in (found.get("class") or "").split())
        ]

    def text(self, *tags: str) -> str:
        """All text, or that directly inside these elements."""
        return " ".join(text for tag, text in self.texts if not tags or tag in tags)
