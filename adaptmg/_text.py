"""Texts that every file format and terminal takes."""

from __future__ import annotations

import html
import re
import sys
import warnings
from dataclasses import MISSING, fields, is_dataclass
from inspect import isfunction
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    import numpy as np
    import pandas
    from _typeshed import DataclassInstance

#: characters of a repr
MOST = 400

#: what XML 1.0 or HTML do not allow in a text, or UTF-8 cannot encode
_UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff"
    + "".join(f"{chr(0x10000 * k - 2)}{chr(0x10000 * k - 1)}" for k in range(2, 18))
    + "]"
)


def printable(text: str) -> str:
    """Return a text that XML 1.0 and HTML take (but for markup): control characters, lone
    surrogates and noncharacters as codes; line breaks and tabs stay."""
    return _UNPRINTABLE.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


def say(text: str) -> None:
    """Write a line to standard error, if there is one."""
    if sys.stderr is not None:
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()


def warn_user(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the line that called the package; contextlib calls its context managers."""
    level = 1
    frame = sys._getframe()
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in (
        "adaptmg",
        "contextlib",
    ):
        level = level + 1
        frame = frame.f_back
    warnings.warn(text, category, stacklevel=level)


def in_html_lines(text: str) -> str:
    """Return a text in HTML, with its lines and columns; markup is escaped."""
    return f"<pre>{html.escape(printable(text))}</pre>\n"


def html_table(table: pandas.DataFrame) -> str:
    """Return a table in HTML for notebooks; the middle rows of a long one are left out."""
    import pandas

    with pandas.option_context("display.max_colwidth", MOST):
        # -0.0 + 0.0 is 0.0
        return table.to_html(
            index=False, max_rows=20, border=0, float_format=lambda x: f"{x + 0.0:.4g}"
        )


def html_fields(self: DataclassInstance) -> str:
    """Return the ``_repr_html_`` of a dataclass: its name, and a row for each value, or for each part
    of a tuple."""
    import pandas

    values = {item.name: vars(self).get(item.name) for item in fields(self) if item.repr}
    rows = [
        (name, _value(part, MOST))
        for name, value in values.items()
        for part in (value if isinstance(value, tuple) else (value,))
    ]
    title = in_html_lines(type(self).__name__)
    return title + html_table(pandas.DataFrame(rows, columns=["", "value"])) if rows else title


def shortened(text: str) -> str:
    """Return a text of at most 400 characters: lines in the middle are left out, then the end."""
    lines = text.split("\n")
    for count in range(len(lines) - 2, 0, -1) if len(text) > MOST else ():
        text = "\n".join([*lines[:count], f"... ({len(lines) - count - 1} more lines)", lines[-1]])
        if len(text) <= MOST:
            break
    return text if len(text) <= MOST else f"{text[: MOST - 3]}..."


def brief(self: DataclassInstance) -> str:
    """Return the ``__repr__`` of a dataclass without the fields that have their defaults.

    Arrays are shown by their shapes, and long values are shortened; values that are made on demand
    are not made for it."""
    if not is_dataclass(self):  # a user-defined domain need not be one
        return object.__repr__(self)
    values = [(item, vars(self).get(item.name)) for item in fields(self) if item.repr]
    defaults = [
        option.default_factory() if option.default_factory is not MISSING else option.default
        for option, _ in values
    ]
    changed = [
        (item.name, value)
        for (item, value), default in zip(values, defaults, strict=True)
        if repr(value) != repr(default)
    ]
    inside = ""
    for longest in (MOST, 100, 30):
        inside = ", ".join(f"{name}={_value(value, longest)}" for name, value in changed)
        if len(inside) < MOST - 40:
            break
    return shortened(f"{type(self).__name__}({inside})")


def _value(value: object, most: int) -> str:
    """Return a value as text of at most ``most`` characters, else the name of its type; large arrays
    and collections by their sizes."""
    name = type(value).__name__
    shape = cast("tuple[int, ...]", getattr(value, "shape", ()))
    if isinstance(shape, tuple) and shape:
        if shape[0] > 12 or len(shape) > 1:
            return f"<array {' x '.join(map(str, shape))}>"
        value = cast("np.ndarray", value).tolist()
    if isinstance(value, dict | tuple | list) and len(value) > 50:
        return f"<{name} of {len(value)}>"
    if isinstance(value, dict):
        result = f"{{{', '.join(f'{key!r}: {_value(part, most)}' for key, part in value.items())}}}"
    else:
        result = f"<{value.__qualname__}>" if isfunction(value) else repr(value)
    return result if len(result) <= most else f"{name}(...)"


def label(option: object) -> str:
    """Return the name of an option object with the fields that differ from their defaults, for
    tables and pictures."""
    if not is_dataclass(option) or isinstance(option, type):
        return repr(option)
    shown = []
    for item in fields(option):
        value = getattr(option, item.name)
        default = item.default_factory() if item.default_factory is not MISSING else item.default
        if item.repr and (default is MISSING or value != default):
            shown.append(f"{item.name}={label(value)}")
    return f"{type(option).__name__}({', '.join(shown)})"
