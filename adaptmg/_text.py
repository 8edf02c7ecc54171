"""Texts that every file format and terminal takes."""

from __future__ import annotations

import html
import re

__all__ = ["in_html", "printable"]

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
