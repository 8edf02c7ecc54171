"""SVG of matplotlib made fit to stand inside a page, small and without anything foreign.

Identifiers are those of the picture alone (two pictures of a page share none), coordinates are rounded to a hundredth
of a point, metadata, styles of the whole page and targets of links go, and fonts are named beside some that readers
have.
"""

from __future__ import annotations

import re
from xml.etree import ElementTree

__all__ = ["inline_svg"]

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
