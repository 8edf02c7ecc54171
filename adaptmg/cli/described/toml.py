"""A TOML file as nested dictionaries, and as the place that messages name."""

from __future__ import annotations

import os
import re
import tomllib
from typing import Any

from adaptmg.cli.described.positions import positions
from adaptmg.problem import checks
from adaptmg.runtime.text import printable

__all__ = ["TomlFile"]

#: bytes of a study file
_MOST = 1_000_000
#: what is often written wrong, as the line has it, and what to write
_HINTS = (
    (re.compile("[\u2018-\u201f]"), "quotes must be straight ones"),
    (re.compile("[\u00a0\u2007\u202f\ufeff]"), "there is a character that only looks like a space, or like none"),
    (re.compile(r"=\s*(True|False|TRUE|FALSE|yes|no|on|off)\b"), "write true or false"),
    (re.compile(r"=\s*(None|null|nil)\b"), "leave the line out where there is no value"),
    (re.compile(r"=\s*[+-]?\d*\.(?!\d)|=\s*[+-]?\.\d"), "numbers have digits before and after the point: 0.5, 2.0"),
    (re.compile(r"=\s*\d+,\d"), "numbers have a point, lists brackets: 0.5, [1, 2]"),
    (re.compile(r"=\s*[+-]?\d[\d.eE+-]*\s*[A-Za-z%]"), "give numbers in SI units, without the unit"),
    (re.compile(r"=\s*[A-Za-z]"), "texts stand between quotes: method = \"multigrid\""),
    (re.compile(r"=\s*$|=\s*#"), "give a value, or leave the line out"),
    (re.compile(r"^[^=\[#]*$"), "a line is KEY = VALUE or [SECTION]"),
)


class TomlFile:
    """A file that was read.

    Parameters
    ----------
    path : path

    Raises
    ------
    ValueError
        If it is no text, or no TOML; the message says in which line.
    OSError
        If it cannot be read.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = checks.file_path("FILE", path)
        self._called = printable(str(self.path))
        text = self._read()
        try:
            self.content: dict[str, Any] = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise self._not_toml(text, str(error)) from None
        except (ValueError, RecursionError) as error:
            what = "brackets stand in brackets too deep" if isinstance(error, RecursionError) else \
                "a number has too many digits"
            raise ValueError(f"{self._called} cannot be read as TOML: {what}") from None
        self._lines = positions(text)

    def _read(self) -> str:
        if not self.path.exists():
            raise FileNotFoundError(2, "there is no such file", str(self.path))
        if not self.path.is_file():
            raise ValueError(f"{self._called} is a folder or a device: give a TOML file")
        with self.path.open("rb") as stream:
            content = stream.read(_MOST + 1)
        if len(content) > _MOST:
            raise ValueError(f"{self._called} has more than {_MOST} bytes, which no study file needs: is it another "
                             "file?")
        if not content.strip():
            raise ValueError(f"{self._called} is empty: 'adaptmg study --template greco_bar' prints one to begin with")
        try:
            # Windows begins texts with a mark
            return content.decode("utf-8-sig").replace("\r\n", "\n")
        except UnicodeDecodeError as error:
            line = content.count(b"\n", 0, error.start) + 1
            raise ValueError(f"{self._called}, line {line}: this is no text in UTF-8: save the file as UTF-8, or give "
                             "another one") from None

    def _not_toml(self, text: str, words: str) -> ValueError:
        where = re.search(r"\s*\(at line (\d+), column (\d+)\)$", words)
        lines = text.split("\n")
        number = int(where[1]) if where else next((k for k in range(len(lines), 0, -1) if lines[k - 1].strip()), 1)
        line = lines[min(number, len(lines)) - 1]
        hint = next((told for pattern, told in _HINTS if pattern.search(line)), "")
        if "overwrite" in words or "declare" in words or "twice" in words:
            hint = "a key or section may stand there once"
        words = re.sub(r"\s*\(at [^)]*\)$", "", words)
        return ValueError(f"{self._called}, line {number}: no TOML: {words}{f' ({hint})' if hint else ''}: "
                          f"{checks.shown(line.strip())}")

    def wrong(self, text: str, *path: str) -> ValueError:
        """An error that names the file and the line of a key, or of the nearest section around it."""
        lines = (self._lines.get(path[:length]) for length in range(len(path), 0, -1))
        line = next((found for found in lines if found), 0)
        return ValueError(f"{self._called}{f', line {line}' if line else ''}: {text}")
