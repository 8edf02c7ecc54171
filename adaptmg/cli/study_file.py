"""Whether a dask scheduler answers at an address: dask itself takes half a minute to say that none does.

Both sides of a connection of dask begin with a short message, its length first (8 bytes, little-endian).

The points that [vary] and [design] of a study file say.

Options of ``adaptmg study`` that are looked at before a solver is loaded or a store is made.

Where keys and sections stand in a TOML file, for messages; its grammar is left to :mod:`tomllib`.

Study files: TOML that says case, hierarchy, solver, load path, adaptation, what to measure and what to vary.

Every message about a file begins with its name and the line.

A TOML file as nested dictionaries, and as the place that messages name.

From a study file to a study, and to what the command prints of it.
"""

from __future__ import annotations

import itertools
import os
import re
import socket
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg._text import printable
from adaptmg.cli import build
from adaptmg.cli.build import OPEN, SECTIONS, SETTINGS, Check, Key, case_keys, case_run
from adaptmg.cli.output import MEANINGS, printed, rows
from adaptmg.study import Study
from adaptmg.study.designs import Design, Grid, LatinHypercube, Random, Repeated, Sobol, Zip

__all__ = ["StudyFile", "TomlFile", "check_options", "check_scheduler", "checked", "design_of", "path_of", "plan",
           "positions", "read", "summary", "unsolved", "warm"]

_PATIENCE_S = 3.0
#: bytes of a greeting
_LONGEST = 1_000_000
_ADDRESS = re.compile(r"(tcp|tls|ws|wss|ucx)://(\[[^\]]+\]|[^:/\[\]\s]+):(\d+)/?")


def check_scheduler(address: str) -> None:
    """Connect once.

    Raises
    ------
    ValueError
        If it is no address.
    OSError
        If nobody, or somebody else, answers there.
    """
    found = _ADDRESS.fullmatch(address)
    if not found or not 0 < int(found[3]) < 65536:
        raise ValueError(f"--scheduler must be an address such as tcp://host:8786, got {checks.shown(address)}")
    start = "start one with 'dask scheduler', which prints its address"
    try:
        with socket.create_connection((found[2].strip("[]"), int(found[3])), _PATIENCE_S) as connection:
            if found[1] != "tcp":
                return
            connection.settimeout(_PATIENCE_S)
            length = int.from_bytes(connection.recv(8), "little")
    except TimeoutError:
        length = 0
    except OSError as error:
        raise OSError(f"--scheduler: nobody answers at {address} ({error.strerror or error}): {start}") from None
    if not 0 < length <= _LONGEST:
        raise OSError(f"--scheduler: what answers at {address}, if anything does, is no dask scheduler: {start}")


_SAMPLES = {"random": Random, "latin-hypercube": LatinHypercube, "sobol": Sobol}


def design_of(values: dict[str, list[Any]], kind: str = "grid", repeats: int = 1, **options: Any) -> Design:
    """A design; ValueError or TypeError for what does not fit together.

    Parameters
    ----------
    values : dict of str to list
        Of the settings that vary: their values, or for samples their ranges.
    kind, repeats
        See :mod:`adaptmg.cli.build`.
    options
        The other keys of [design].
    """
    if kind in _SAMPLES:
        if "runs" not in options:
            raise ValueError(f"a {kind} design needs runs = NUMBER, and [low, high] of each setting in [vary]")
        # whole numbers where the setting is one: ends of floats that are written as integers are not
        made: Design = _SAMPLES[kind](values, options.pop("runs"), **options)
    elif options:
        raise ValueError(f"a {kind} design takes no {next(iter(options))}: that belongs to samples, such as kind = "
                         "\"sobol\"")
    else:
        made = Zip(values) if kind == "zip" else Grid(values)
    return made if repeats == 1 else Repeated(made, repeats, name="repeat")


def check_options(said: StudyFile, options: Mapping[str, Any]) -> None:
    """ValueError or OSError for options of a run that cannot be, before a store is made."""
    here = options.get("workers") is None and options.get("scheduler") is None
    limits = [key for key in ("limit_s", "memory_limit") if options.get(key) is not None]
    if here and limits:
        raise said.file.wrong(f"run.{limits[0]} needs workers, in the file or as --workers 1 or more: a run in this "
                              "process cannot be stopped", "run", limits[0])
    if options.get("workers") is not None and options.get("scheduler") is not None:
        raise ValueError("give --workers (processes of this machine) or --scheduler (a cluster), not both")
    if options.get("scheduler") is not None:
        check_scheduler(options["scheduler"])
    most = max(64, 4 * (os.cpu_count() or 1))
    if (options.get("workers") or 0) > most:
        raise ValueError(f"workers must be at most {most} on this machine, got {options['workers']}: several machines "
                         "need a scheduler (--scheduler)")


_TOKEN = re.compile(r'"""(?:\\.|[^\\])*?"""(?:"{0,2})|\'\'\'.*?\'\'\'(?:\'{0,2})|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|'
                    r'#[^\n]*|\n|[\[\]{}]|[^"\'#\n\[\]{}]+|.', re.DOTALL)
_KEY = re.compile(r'((?:"(?:\\.|[^"\\])*"|\'[^\']*\'|[^="\'])+)=')

KeyPath = tuple[str, ...]


def positions(text: str) -> dict[KeyPath, int]:
    """Lines, from 1, of all sections and keys of a valid TOML file, by their path from the top.

    Keys of inline tables stand where the table begins, and are left out.
    """
    found: dict[KeyPath, int] = {}
    table: KeyPath = ()
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


def path_of(nested: Any) -> KeyPath:
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


#: keys outside sections
_TOP = ("name", "store")
#: what keys are called elsewhere
_ALIASES = {"mu": "friction", "coefficient": "friction", "E": "young", "youngs_modulus": "young", "nu": "poisson",
            "poisson_ratio": "poisson", "tol": "rtol", "tolerance": "rtol", "maxit": "max_cycles",
            "max_iterations": "max_cycles", "presweeps": "pre", "postsweeps": "post", "levels": "divisions",
            "cells": "divisions", "h": "sizes", "name": "case", "type": "method", "solver": "method",
            "quantities": "columns"}


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
        The other settings, by the same names; ``measure.columns`` and the like too.
    options : dict
        Of :meth:`adaptmg.study.Study.run`.
    file : TomlFile
    places : dict
        By setting the path of its key in the file.
    """

    name: str
    store: Path
    design: Design
    fixed: dict[str, Any]
    options: dict[str, Any] = field(default_factory=dict)
    file: TomlFile
    places: dict[str, tuple[str, ...]]


def read(path: str | os.PathLike[str]) -> StudyFile:
    """Read a study file.

    Raises
    ------
    ValueError
        For what is wrong in it: the message says file, line, and what to write instead.
    OSError
        If it cannot be read.
    """
    return _Reader(TomlFile(path)).result()


class _Reader:
    """Checks one file."""

    def __init__(self, file: TomlFile) -> None:
        self._file, self._content = file, file.content
        #: by setting the path of its key in its section, and in [vary]
        self._places: dict[str, tuple[str, ...]] = {}
        self._varied: dict[str, tuple[str, ...]] = {}

    def result(self) -> StudyFile:
        """The file, checked."""
        self._check_sections()
        varied = self._flat("vary", ("vary",), self._content["vary"])
        keys = {section: dict(SECTIONS[section]) for section in SECTIONS}
        keys["case"] = self._case_keys(varied)
        fixed = {f"{section}.{key}": self._checked(keys, section, key, value, self._places[f"{section}.{key}"])
                 for section in SETTINGS for key, value in self._given(section).items()}
        design = self._design(keys, varied)
        fixed = {name: value for name, value in fixed.items() if name not in design.names} | self._measures(keys)
        options = {key: self._checked(keys, "run", key, value, ("run", key))
                   for key, value in self._given("run").items()}
        self._check_options(options, [*fixed, *design.names])
        name = self._content.get("name", self._file.path.stem)
        store = checks.file_path("store", self._content.get("store", f"results/{name}.sqlite"))
        return StudyFile(name=name, store=store, design=design, fixed=fixed, options=options, file=self._file,
                         places=self._places | self._varied)

    def _check_sections(self) -> None:
        for name, value in self._content.items():
            if name in _TOP:
                self._check_text(name, value)
            elif name not in SECTIONS:
                owners = [section for section in SECTIONS if name in SECTIONS[section]]
                hint = f" (it belongs below [{owners[0]}])" if owners else checks.suggestion(name, [*SECTIONS, *_TOP])
                raise self._file.wrong(f"there is no section {name!r}{hint}; there are {', '.join(SECTIONS)}, and "
                                       f"before them {' and '.join(_TOP)}", name)
            elif not isinstance(value, dict):
                raise self._file.wrong(f"{name} must be one section, [{name}], got {checks.shown(value)}", name)
        for section in ("case", "measure", "vary"):
            if section not in self._content:
                raise self._file.wrong(f"there is no section [{section}] ({_PURPOSE[section]}); 'adaptmg study "
                                       "--template greco_bar' prints a file to begin with")
        if not self._content["vary"]:
            raise self._file.wrong("[vary] is empty: name a setting and its values, such as \"solver.pre\" = [1, 2]",
                                   "vary")

    def _check_text(self, name: str, value: Any) -> None:
        if not isinstance(value, str) or not value.strip() or not value.isprintable():
            raise self._file.wrong(f"{name} must be text, got {checks.shown(value)}", name)
        if name == "name" and (set(value) & set("/\\") or value.startswith(".") or len(value) > 100):
            raise self._file.wrong(f"name must be a name, which becomes that of files, got {checks.shown(value)}", name)

    def _flat(self, top: str, place: tuple[str, ...], table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
        """Keys of tables in each other, with dots between: ``case.friction`` is the same as ``"case.friction"``."""
        found: dict[str, Any] = {}
        for key, value in table.items():
            name, path = f"{before}{key}", (*place, key)
            inner = self._flat(top, path, value, f"{name}.") if isinstance(value, dict) and value else {name: value}
            for twice in set(inner) & set(found):
                raise self._file.wrong(f"[{top}] names {twice} twice", *path)
            found |= inner
            if name in inner:
                if top == "vary":
                    self._varied[name] = path
                else:
                    self._places[f"{top}.{name}"] = path
        return found

    def _given(self, section: str) -> dict[str, Any]:
        """The keys of a section; those of open ones may have dots, and values by name are a key each."""
        table = self._content.get(section, {})
        if section in OPEN:
            return self._flat(section, (section,), table)
        found: dict[str, Any] = {}
        for key, value in table.items():
            inner = {key: value}
            known = SECTIONS[section].get(key)
            if known is not None and known.named:
                if not isinstance(value, dict):
                    raise self._file.wrong(f"{section}.{key} must be values by name, {key} = {{NAME = {known.values}}}"
                                           f", got {checks.shown(value)}", section, key)
                inner = {f"{key}.{name}": item for name, item in value.items()}
                self._places |= {f"{section}.{key}.{name}": (section, key, name) for name in value}
            self._places[f"{section}.{key}"] = (section, key)
            found |= inner
        return found

    def _case_keys(self, varied: Mapping[str, Any]) -> dict[str, Key]:
        """The keys that all cases take which are named."""
        said = self._content["case"].get("case")
        several = varied.get("case.case")
        if said is None and several is None:
            raise self._file.wrong("[case] needs case = \"NAME\", see 'adaptmg cases'", "case")
        found: list[dict[str, Key]] = []
        for name in [said] if several is None else several if isinstance(several, list) else []:
            try:
                found.append(case_keys(checks.boundary_name("case", name)))
            except (ValueError, TypeError) as error:
                raise self._file.wrong(str(error), *(("case", "case") if several is None else
                                                     self._varied["case.case"])) from None
            known = found[-1]
            given = [(f"case.{key}", self._places) for key in self._given("case")]
            for setting, places in [*given, *((setting, self._varied) for setting in varied)]:
                key = setting.removeprefix("case.")
                if setting.startswith("case.") and key not in known:
                    raise self._file.wrong(f"the case {name} takes no {key!r}{_near(key, known)}; it takes "
                                           f"{', '.join(known)}", *places[setting])
        return found[0] if found else SECTIONS["case"]

    def _checked(self, keys: Mapping[str, Mapping[str, Key]], section: str, key: str, value: Any,
                 place: Iterable[str]) -> Any:
        known = keys[section]
        found = _of_name(known, key)
        if found is None and section not in OPEN:
            raise self._file.wrong(f"[{section}] has no key {key!r}{_near(key, known)}; it has "
                                   f"{', '.join(known)}", *place)
        check: Check = OPEN[section] if found is None else found.check
        try:
            return check(f"{section}.{key}", value)
        except (TypeError, ValueError) as error:
            raise self._file.wrong(str(error), *place) from None

    def _measures(self, keys: Mapping[str, Mapping[str, Key]]) -> dict[str, Any]:
        """The settings of [measure]."""
        found = {f"measure.{key}": self._checked(keys, "measure", key, value, self._places[f"measure.{key}"])
                 for key, value in self._given("measure").items()}
        for column in found.get("measure.columns", ()):
            if column not in MEANINGS:
                raise self._file.wrong(f"nothing measures {column!r}{checks.suggestion(column, MEANINGS)}; there are "
                                       f"{', '.join(MEANINGS)}", "measure", "columns")
        return found

    def _design(self, keys: Mapping[str, Mapping[str, Key]], varied: Mapping[str, Any]) -> Design:
        values: dict[str, list[Any]] = {}
        for name, given in varied.items():
            section, _, key = name.partition(".")
            if section not in SETTINGS or not key or (_of_name(keys[section], key) is None and section not in OPEN):
                known = [f"{s}.{k}" for s in SETTINGS for k in keys[s]]
                raise self._file.wrong(f"{name!r} cannot be varied{checks.suggestion(name, known)}: name a setting as "
                                       "\"section.key\"", *self._varied.get(name, ("vary",)))
            place = self._varied[name]
            if not isinstance(given, list) or not given:
                raise self._file.wrong(f"{name} must be a list of values" + (", got an empty one" if given == [] else
                                       f", got {checks.shown(given)}"), *place)
            values[name] = [self._checked(keys, section, key, value, place) for value in given]
        options = {key: self._checked(keys, "design", key, value, ("design", key))
                   for key, value in self._given("design").items()}
        try:
            return design_of(values, **options)
        except (TypeError, ValueError) as error:
            named = [name for name in values if f"'{name}'" in str(error)]
            place = self._varied[named[0]] if named else ("design",) if "design" in self._content else ("vary",)
            words = re.sub(r"(?:parameters|ranges)\['([^']*)'\]", r"\1", str(error))
            raise self._file.wrong(words, *place) from None

    def _check_options(self, options: Mapping[str, Any], settings: list[str]) -> None:
        cost, known = options.get("cost"), [*settings, *MEANINGS, "seconds"]
        if cost is not None and cost not in known:
            raise self._file.wrong(f"run.cost: there is no setting or measure {cost!r}{checks.suggestion(cost, known)}",
                                   "run", "cost")


def _of_name(known: Mapping[str, Key], name: str) -> Key | None:
    """The key of this name, which may be one of values by name: ``points`` for ``points.A``."""
    head, _, rest = name.partition(".")
    if name in known:
        return None if known[name].named else known[name]
    return known[head] if rest and head in known and known[head].named else None


def _near(key: str, known: Iterable[str]) -> str:
    """What may be meant by a key that is none of those known."""
    alias = _ALIASES.get(key)
    return f" (did you mean {alias!r}?)" if alias in known else checks.suggestion(key, known)


_PURPOSE = {"case": "which problem", "measure": "what the table shows; it may be empty", "vary": "what varies"}


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


#: points whose problem and solver are made before anything runs: of the first, of those with new values; and points
#: that are looked at for such
_FIRST, _NEW, _SEEN = 100, 1000, 50_000
#: points that a plan shows, and of how many it says what is stored of each
_SHOWN, _TOLD = 20, 20_000


def checked(said: StudyFile, store: Path | None) -> Study:
    """The study, after a look at what its points are made of: the first ones, and those that bring a new value.

    Raises
    ------
    ValueError
        If a problem or a solver cannot be made; the message says for which values, and in which line.
    """
    seen: set[tuple[str, Any]] = set()
    count = 0
    for point in itertools.islice(said.design.points(), _SEEN):
        new = set(point.items()) - seen
        if count >= _FIRST and (not new or count == _FIRST + _NEW):
            continue
        seen |= new
        count += 1
        try:
            build.check({**said.fixed, **point})
        except build.WrongSetting as error:
            varied = ", ".join(f"{name} = {value!r}" for name, value in point.items())
            raise said.file.wrong(f"with {checks.shown(varied)[1:-1]}: {error}", *_place(said, error)) from None
    return Study(case_run, said.design, store, name=said.name, fixed=said.fixed)


def _place(said: StudyFile, error: build.WrongSetting) -> tuple[str, ...]:
    """Where the setting stands that a message names, or the section it is about."""
    mine = [name for name in [*said.design.names, *said.fixed] if name.startswith(f"{error.section}.")]
    found = {name: re.search(rf"(?<![\w-]){re.escape(name.removeprefix(f'{error.section}.'))}(?![\w.-])", str(error))
             for name in mine if name in said.places}
    named = {name: match.start() for name, match in found.items() if match}
    if named:
        return said.places[min(named, key=named.__getitem__)]
    return said.places.get(mine[0], (error.section,)) if len(mine) == 1 else (error.section,)


def unsolved(table: Any) -> int:
    """How many runs are done, but did not reach their tolerance."""
    if "outcome" not in table:
        return 0
    return int(((table["status"] == "done") & (table["outcome"] != "CONVERGED")).sum())


def warm(study: Study) -> None:
    """Compile the kernels of the default method before the clock of the first run, if anything is to be run."""
    status = study.status()
    if status.done + status.failed < status.total:
        am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)), throw=False)


def plan(study: Study) -> str:
    """What a study would run: its first points, what is stored of them, and how many there are."""
    points = list(itertools.islice(study.design.points(), _SHOWN))
    shown = {name: [point[name] for point in points] for name in study.parameters}
    if len(study) <= _TOLD:
        shown["status"] = list(study.table()["status"].head(_SHOWN))
    rest = len(study) - _SHOWN
    return "\n".join([printed(shown, study.parameters, units={}, note=f"... {rest} more" if rest > 0 else ""), "",
                      repr(study), repr(study.status())])


def summary(study: Study, with_rows: bool) -> dict[str, Any]:
    """What the command prints as JSON."""
    status = study.status()
    head = {"study": study.name, "runs": status.total, "done": status.done, "failed": status.failed,
            "stale": status.stale, "missing": status.missing, "why_stale": status.reasons, "errors": status.errors}
    return head | ({"rows": rows(study.table(details=True))} if with_rows else {})
