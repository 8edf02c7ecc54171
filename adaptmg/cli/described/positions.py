"""Where keys and sections stand in a TOML file, for messages; its grammar is left to :mod:`tomllib`."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from typing import Any

__all__ = ["path_of", "positions"]

_TOKEN = re.compile(r'"""(?:\\.|[^\\])*?"""(?:"{0,2})|\'\'\'.*?\'\'\'(?:\'{0,2})|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|'
                    r'#[^\n]*|\n|[\[\]{}]|[^"\'#\n\[\]{}]+|.', re.DOTALL)
_KEY = re.compile(r'((?:"(?:\\.|[^"\\])*"|\'[^\']*\'|[^="\'])+)=')

Path = tuple[str, ...]


def positions(text: str) -> dict[Path, int]:
    """Lines, from 1, of all sections and keys of a valid TOML file, by their path from the top.

    Keys of inline tables stand where the table begins, and are left out.
    """
    found: dict[Path, int] = {}
    table: Path = ()
    for line, statement in _statements(text):
        if statement.startswith("["):
            table = path_of(tomllib.loads(statement))
            found.setdefault(table, line)
            continue
        key = _KEY.match(statement)
        if key:
            path = (*table, *path_of(tomllib.loads(f"{key[1]}=0")))
            for length in range(len(table) + 1, len(path) + 1):
                found.setdefault(path[:length], line)
    return found


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Headers and assignments without comments, with the lines where they begin."""
    line, depth, begin, parts = 1, 0, 1, []
    for token in _TOKEN.findall(f"{text}\n"):
        if token == "\n" and depth == 0:
            if statement := "".join(parts).strip():
                yield begin, statement
            parts = []
        elif not token.startswith("#"):
            if not any(map(str.strip, parts)):
                begin = line
            parts.append(token)
            depth += (token in "[{") - (token in "]}")
        line += token.count("\n")


def path_of(nested: Any) -> Path:
    """The keys of tables in each other, the first of each."""
    path = []
    while isinstance(nested, dict | list) and nested:
        if isinstance(nested, list):
            nested = nested[0]
            continue
        key = next(iter(nested))
        path.append(key)
        nested = nested[key]
    return tuple(path)
