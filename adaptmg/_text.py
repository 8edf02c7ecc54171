"""Texts that every file format and terminal takes."""

from __future__ import annotations

import html
import re
from dataclasses import MISSING, fields
from inspect import isfunction
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas

__all__ = ["MOST", "brief", "html_table", "in_html", "in_html_lines", "printable", "shortened"]

#: characters of a repr
MOST = 400

#: what XML 1.0 or HTML do not allow in a text, or UTF-8 cannot encode
_UNPRINTABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff"
                          + "".join(f"{chr(0x10000 * k - 2)}{chr(0x10000 * k - 1)}" for k in range(2, 18)) + "]")


def printable(text: str) -> str:
    """A text that every file format and terminal takes: control characters, lone surrogates and noncharacters as codes.

    Line breaks and tabs stay. Of XML 1.0 and HTML both, nothing else than this is refused (but for markup).
    """
    return _UNPRINTABLE.sub(lambda match: match[0].encode("ascii", "backslashreplace").decode()
                            if ord(match[0]) > 127 else f"\\x{ord(match[0]):02x}", text)


def in_html(text: str) -> str:
    """A text as HTML takes it: markup escaped, what it does not allow as codes."""
    return html.escape(printable(text))


def in_html_lines(text: str) -> str:
    """A text in HTML, with its lines and columns."""
    return f"<pre>{in_html(text)}</pre>\n"


def html_table(table: pandas.DataFrame) -> str:
    """A table in HTML for notebooks; the middle rows of a long one are left out."""
    return table.to_html(index=False, max_rows=20, border=0, float_format="{:.4g}".format)


def shortened(text: str) -> str:
    """A text of at most 400 characters: lines in the middle are left out, then the ends of lines."""
    lines = text.split("\n")
    if len(lines) > 3 and len(text) > MOST:
        head, tail = lines[:2], lines[-1:]
        room = MOST - 30 - sum(len(line) + 1 for line in (*head, *tail))
        for line in lines[2:-1]:
            room -= len(line) + 1
            if room < 0:
                break
            head.append(line)
        text = "\n".join([*head, f"... ({len(lines) - len(head) - 1} more lines)", *tail])
    return text if len(text) <= MOST else f"{text[:MOST - 3]}..."


def brief(self: Any) -> str:
    """The ``__repr__`` of a dataclass: as Python writes it where it is short, arrays by their shapes.

    Values on demand are not asked for. Where it is long, defaults, then what long values hold, are left out.
    """
    held = [(item, vars(self).get(item.name)) for item in fields(self) if item.repr]

    def text(shown: list[tuple[Any, object]], most: int) -> str:
        return f"{type(self).__name__}({', '.join(f'{item.name}={_value(value, most)}' for item, value in shown)})"

    changed = [(item, value) for item, value in held if not _same(item, value)]
    for shown, most in ((held, MOST), (changed, MOST), (changed, 100), (changed, 0)):
        if len(result := text(shown, most)) <= MOST:
            return result
    return f"{result[:MOST - 4]}...)"


def _same(item: Any, value: object) -> bool:
    """Whether a field holds its default."""
    default = item.default_factory() if item.default_factory is not MISSING else item.default
    return default is not MISSING and (value is default or repr(value) == repr(default))


def _value(value: Any, most: int) -> str:
    """A value in a repr: at most ``most`` characters (and 30), or its kind and size."""
    shape = getattr(value, "shape", ())
    if isinstance(shape, tuple) and shape:
        if len(shape) != 1 or shape[0] > 12:
            return f"<array {' x '.join(map(str, shape))}>"
        result = repr(value.tolist())
    elif isinstance(value, dict) and len(value) <= 50:
        result = f"{{{', '.join(f'{key!r}: {_value(part, most)}' for key, part in value.items())}}}"
    elif type(value) in (tuple, list) and len(value) <= 50:
        inside = ", ".join(_value(part, most) for part in value) + "," * (type(value) is tuple and len(value) == 1)
        result = f"({inside})" if isinstance(value, tuple) else f"[{inside}]"
    elif isinstance(value, dict | tuple | list):
        result = repr(value) if len(value) <= 50 else " " * MOST
    else:
        result = f"<{value.__qualname__}>" if isfunction(value) else repr(value)
    if len(result) <= max(most, 30):
        return result
    name = type(value).__name__
    return f"<{name} of {len(value)}>" if isinstance(value, dict | tuple | list | str) else f"{name}(...)"
