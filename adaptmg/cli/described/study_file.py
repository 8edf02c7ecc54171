"""Study files: TOML that says case, hierarchy, solver, load path, adaptation, what to measure and what to vary.

Every message about a file begins with its name and the line.
"""

from __future__ import annotations

import inspect
import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from adaptmg.cli.described.keys import KINDS, SECTIONS
from adaptmg.cli.described.measures import MEASURES
from adaptmg.problem import checks
from adaptmg.runtime.text import printable
from adaptmg.study.designs import Design, Grid, LatinHypercube, Random, Sobol, Zip

__all__ = ["StudyFile", "read"]

_TOP = ("name", "store")
_SAMPLES = {"random": Random, "latin-hypercube": LatinHypercube, "sobol": Sobol}
#: sections whose keys are parameters of a run
_SETTINGS = ("case", "hierarchy", "solver", "adapt", "load_path")


@dataclass(frozen=True, kw_only=True)
class StudyFile:
    """What a file says.

    Attributes
    ----------
    name : str
        Of the study.
    store : Path
    design : Design
        Of the settings that vary, as ``"section.key"``.
    fixed : dict
        The other settings, by the same names; ``measure.columns`` and ``measure.keep`` too.
    options : dict
        Of :meth:`adaptmg.study.Study.run`.
    """

    name: str
    store: Path
    design: Design
    fixed: dict[str, Any]
    options: dict[str, Any] = field(default_factory=dict)


def read(path: str | os.PathLike[str]) -> StudyFile:
    """Read a study file.

    Raises
    ------
    ValueError
        For what is wrong in it: the message says file, line, and what to write instead.
    OSError
        If it cannot be read.
    """
    file = checks.file_path("FILE", path)
    try:
        text = file.read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{printable(str(file))} is no text in UTF-8 ({error})") from None
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{printable(str(file))}: {error}") from None
    return _Reader(file, text, content).result()


class _Reader:
    """Checks one file."""

    def __init__(self, file: Path, text: str, content: dict[str, Any]) -> None:
        self._file, self._lines, self._content = file, text.splitlines(), content

    def result(self) -> StudyFile:
        """The file, checked."""
        self._check_names()
        for section in ("case", "measure", "vary"):
            if section not in self._content:
                raise self._wrong(f"there is no section [{section}]", "")
        settings = {f"{section}.{key}": self._checked(section, key, value) for section in _SETTINGS
                    for key, value in self._content.get(section, {}).items()}
        if "case.case" not in settings:
            raise self._wrong("[case] needs case = \"NAME\", see 'adaptmg cases'", "case")
        self._check_case(settings)
        design = self._design(settings)
        self._check_measures()
        fixed = {name: value for name, value in settings.items() if name not in design.names}
        for key, value in self._content["measure"].items():
            fixed[f"measure.{key}"] = self._checked("measure", key, value)
        options = {key: self._checked("run", key, value) for key, value in self._content.get("run", {}).items()}
        name = self._content.get("name", self._file.stem)
        store = Path(self._content.get("store", f"results/{name}.sqlite"))
        return StudyFile(name=name, store=store, design=design, fixed=fixed, options=options)

    def _check_names(self) -> None:
        for name, value in self._content.items():
            if name in _TOP:
                if not isinstance(value, str) or not value or not value.isprintable():
                    raise self._wrong(f"{name} must be text, got {checks.shown(value)}", name)
                continue
            if name not in SECTIONS:
                raise self._wrong(f"there is no section {name!r}{checks.suggestion(name, [*SECTIONS, *_TOP])}; there "
                                  f"are {', '.join(SECTIONS)}", name)
            if not isinstance(value, dict):
                raise self._wrong(f"{name} must be a section, [{name}], got {checks.shown(value)}", name)
            for key in value:
                if name not in KINDS and name != "vary" and key not in SECTIONS[name]:
                    raise self._wrong(f"[{name}] has no key {key!r}{checks.suggestion(key, SECTIONS[name])}; it has "
                                      f"{', '.join(SECTIONS[name])}", name, key)

    def _checked(self, section: str, key: str, value: Any, where: tuple[str, str] | None = None) -> Any:
        check = SECTIONS[section].get(key) or KINDS[section]
        try:
            return check(f"{section}.{key}", value)
        except (TypeError, ValueError) as error:
            raise self._wrong(str(error), *(where or (section, key))) from None

    def _check_case(self, settings: Mapping[str, Any]) -> None:
        """The case, and arguments that its function takes."""
        from adaptmg import cases

        varied = self._content["vary"]
        names = varied.get("case.case", [settings["case.case"]]) if isinstance(varied, dict) else []
        for name in [settings["case.case"], *(names if isinstance(names, list) else [])]:
            try:
                takes = inspect.signature(cases.get(name).function).parameters
            except ValueError as error:
                raise self._wrong(str(error), "case", "case") from None
            given = [("case", key) for key in self._content["case"]]
            given += [("vary", key) for key in varied if key.startswith("case.")]
            for section, key in given:
                bare = key.removeprefix("case.")
                if bare not in SECTIONS["case"] and bare not in takes:
                    known = [*SECTIONS["case"], *takes]
                    raise self._wrong(f"the case {name} takes no {bare!r}{checks.suggestion(bare, known)}; it takes "
                                      f"{', '.join(dict.fromkeys(known))}", section, key)

    def _check_measures(self) -> None:
        columns = self._content["measure"].get("columns", [])
        for column in columns if isinstance(columns, list) else []:
            if column not in MEASURES:
                raise self._wrong(f"nothing measures {column!r}{checks.suggestion(str(column), MEASURES)}; there are "
                                  f"{', '.join(MEASURES)}", "measure", "columns")

    def _design(self, settings: Mapping[str, Any]) -> Design:
        vary = self._content["vary"]
        if not vary:
            raise self._wrong("[vary] is empty: name a setting and its values, such as \"solver.pre\" = [1, 2]", "vary")
        kind = self._content.get("design", {}).get("kind", "grid")
        values = {}
        for name, given in vary.items():
            section, _, key = name.partition(".")
            known = [f"{s}.{k}" for s in _SETTINGS for k in SECTIONS[s]]
            if section not in _SETTINGS or not key or (key not in SECTIONS[section] and section not in KINDS):
                raise self._wrong(f"{name!r} cannot be varied{checks.suggestion(name, known)}: name a setting as "
                                  "\"section.key\"", "vary", name)
            if not isinstance(given, list) or not given:
                raise self._wrong(f"{name} must be a list of values" + (", got an empty one" if given == [] else
                                  f", got {checks.shown(given)}"), "vary", name)
            values[name] = [self._checked(section, key, value, ("vary", name)) for value in given]
        try:
            return self._made(kind, values)
        except (TypeError, ValueError) as error:
            raise self._wrong(str(error), "design" if "design" in self._content else "vary") from None

    def _made(self, kind: str, values: dict[str, list[Any]]) -> Design:
        given = {key: self._checked("design", key, value) for key, value in self._content.get("design", {}).items()}
        kind = given.pop("kind", "grid")
        if kind in _SAMPLES:
            if "runs" not in given:
                raise ValueError(f"a {kind} design needs runs = NUMBER, and (low, high) of each setting in [vary]")
            # whole numbers where the setting is one: ends of floats that are written as integers are not
            return _SAMPLES[kind](values, given.pop("runs"), **given)
        if given:
            raise ValueError(f"a {kind} design takes no {next(iter(given))}")
        return Zip(values) if kind == "zip" else Grid(values)

    def _wrong(self, text: str, section: str, key: str = "") -> ValueError:
        """An error that names file and line."""
        line = self._line(section, key)
        return ValueError(f"{printable(str(self._file))}{f', line {line}' if line else ''}: {text}")

    def _line(self, section: str, key: str) -> int:
        """Where a key stands (or its section); 0 if it cannot be told."""
        inside, found = "", 0
        for number, line in enumerate(self._lines, start=1):
            header = re.fullmatch(r"\s*\[\s*([^\[\]]+?)\s*\]\s*(#.*)?", line)
            if header:
                inside = header[1].strip("\"'")
                found = number if inside == section else found
            word = re.match(r"\s*(\"[^\"]*\"|'[^']*'|[\w.-]+)\s*=", line)
            if word and ((inside == section and word[1].strip("\"'") == key)
                         or (not inside and word[1] == (section if not key else f"{section}.{key}"))):
                return number
        return found
