"""Study files: TOML that describes case, grids, solver, load path, adaptation, what to measure and what to vary.

Every message about a file begins with its name and, where it is known, the line. The values are checked by the classes
and functions that take them (:mod:`adaptmg.cli.build`), before anything runs.
"""

from __future__ import annotations

import itertools
import os
import re
import socket
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import adaptmg as am
from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._text import printable
from adaptmg.cli import build
from adaptmg.cli.explain import PURPOSE, SETTINGS, case_keys, sections
from adaptmg.cli.measure import MEASURES, case_run
from adaptmg.cli.output import printed, rows
from adaptmg.study import Study
from adaptmg.study.designs import Design, Grid, LatinHypercube, Random, Repeated, Sobol, Zip

__all__ = ["StudyFile", "check_options", "check_scheduler", "checked", "plan", "read", "summary", "unsolved", "warm"]

#: bytes of a study file at most
_MOST = 1_000_000
_TOP = ("name", "store")


@dataclass(frozen=True, kw_only=True)
class StudyFile:
    """What a file says."""

    name: str  # of the study
    store: Path
    design: Design  # of the settings that vary, as "section.key"
    fixed: dict[str, Any]  # the other settings, by the same names; measure.columns and the like too
    options: dict[str, Any]  # of run
    path: Path  # of the file
    text: str  # its content

    def wrong(self, words: str, *place: str) -> ValueError:
        """Return an error that names the file and the line of a section, or of a key in it."""
        return _wrong(self.path, self.text, words, *place)


def _wrong(path: Path, text: str, words: str, *place: str) -> ValueError:
    line = _line(text, *place) if place else 0
    return ValueError(f"{printable(str(path))}{f', line {line}' if line else ''}: {words}")


def _line(text: str, *place: str) -> int:
    """The line of a key, else of what it stands in, else 0; lines that begin strings or lists over lines count too."""
    target, here, best = ".".join(place), "", (0, 0)
    for number, line in enumerate(text.splitlines(), 1):
        header, key = re.match(r"\s*\[+([^\[\]]+)\]", line), re.match(r"\s*([^\s=#\[][^=#]*?)\s*=", line)
        here = re.sub("[\"'\\s]", "", header[1]) if header else here
        name = here if header else ".".join(filter(None, (here, re.sub("[\"'\\s]", "", key[1])))) if key else ""
        if name and f"{target}.".startswith(f"{name}.") and len(name) > best[0]:
            best = len(name), number
    return best[1]


def read(path: str | os.PathLike[str]) -> StudyFile:
    """Read a study file."""
    file = checks.file_path("FILE", path)
    text = _text(file)
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        where = re.search(r"\(at line (\d+)", str(error))
        raise ValueError(f"{printable(str(file))}{f', line {where[1]}' if where else ''}: not TOML: "
                         f"{error}") from None
    except (ValueError, RecursionError) as error:
        words = "nested too deeply" if isinstance(error, RecursionError) else "a number has too many digits"
        raise _wrong(file, text, f"not TOML: {words}") from None
    return _Reader(file, text, content).result()


def _text(path: Path) -> str:
    called = printable(str(path))
    if not path.exists():
        raise FileNotFoundError(2, "there is no such file", str(path))
    if not path.is_file():
        raise ValueError(f"{called} is a folder or a device: give a TOML file")
    with path.open("rb") as stream:
        content = stream.read(_MOST + 1)
    if len(content) > _MOST:
        raise ValueError(f"{called} has more than {_MOST} bytes: is it another file?")
    if not content.strip():
        raise ValueError(f"{called} is empty: 'adaptmg study --template greco_bar' prints one to begin with")
    try:
        # Windows begins texts with a mark
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ValueError(f"{called}, line {line}: this is not text in UTF-8: "
                         "save the file as UTF-8, or give another one") from None


class _Reader:
    """Checks one file: sections, keys, and what is not checked where it is used."""

    def __init__(self, path: Path, text: str, content: dict[str, Any]) -> None:
        self._path, self._text, self._content = path, text, content

    def _wrong(self, words: str, *place: str) -> ValueError:
        return _wrong(self._path, self._text, words, *place)

    def result(self) -> StudyFile:
        """The file, checked."""
        self._check_sections()
        name = self._content.get("name", self._path.stem)
        store = checks.file_path("store", self._content.get("store", f"results/{name}.sqlite"))
        varied = self._flat("vary", self._content["vary"])
        fixed = {f"{section}.{key}": value for section in (*SETTINGS, "measure")
                 for key, value in self._flat(section, self._content.get(section, {})).items()}
        cases = varied.get("case.case", [fixed.get("case.case")])
        for case in cases if isinstance(cases, list) else [cases]:
            known = self._known(case, "vary" if "case.case" in varied else "case")
            fixed = {key: self._value(known, key, value, key) for key, value in fixed.items()}
            for setting in varied:
                if setting.partition(".")[0] not in SETTINGS or not setting.partition(".")[2]:
                    names = [f"{section}.{key}" for section in SETTINGS for key in known[section]]
                    raise self._wrong(f"{setting!r} cannot be varied{checks.suggestion(setting, names)}: name a "
                                      "setting as \"section.key\"", "vary", setting)
                if not isinstance(varied[setting], list) or not varied[setting]:
                    raise self._wrong(f"{setting} must be a list of values, got {checks.shown(varied[setting])}",
                                      "vary", setting)
                varied[setting] = [self._value(known, setting, value, f"vary.{setting}") for value in varied[setting]]
        design = self._design(varied)
        fixed = {key: value for key, value in fixed.items() if key not in varied}
        self._check_measures(fixed)
        return StudyFile(name=name, store=store, design=design, fixed=fixed, options=self._options([*fixed, *varied]),
                         path=self._path, text=self._text)

    def _check_sections(self) -> None:
        for name, value in self._content.items():
            if name in _TOP:
                if not isinstance(value, str) or not value.strip() or not value.isprintable():
                    raise self._wrong(f"{name} must be text, got {checks.shown(value)}", name)
                if name == "name" and (set(value) & set("/\\") or value.startswith(".") or len(value) > 100):
                    raise self._wrong(f"name becomes that of files, got {checks.shown(value)}", name)
            elif name not in PURPOSE:
                owners = [f" (it belongs below [{section}])" for section, known in sections().items() if name in known]
                hint = owners[0] if owners else checks.suggestion(name, [*PURPOSE, *_TOP])
                raise self._wrong(f"there is no section {name!r}{hint}; there are {', '.join(PURPOSE)}, and before "
                                  f"them {' and '.join(_TOP)}", name)
            elif not isinstance(value, dict):
                raise self._wrong(f"{name} must be one section, [{name}], got {checks.shown(value)}", name)
        for name in ("case", "vary"):
            if not self._content.get(name):
                raise self._wrong(f"there is no section [{name}] ({PURPOSE[name]}), or it is empty; 'adaptmg study "
                                  "--template greco_bar' prints a file to begin with", name)

    def _flat(self, section: str, table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
        """Keys of tables in each other, with points between: ``case.friction`` is the same as ``"case.friction"``."""
        found: dict[str, Any] = {}
        for key, value in table.items():
            inner = self._flat(section, value, f"{before}{key}.") if isinstance(value, dict) and value else \
                {f"{before}{key}": value}
            if twice := set(inner) & set(found):
                name = twice.pop()
                raise self._wrong(f"[{section}] names {name} twice", section, name)
            found |= inner
        return found

    def _known(self, case: Any, place: str) -> dict[str, dict[str, build.Key]]:
        """The keys of all sections, those of [case] for one case."""
        try:
            return sections() | {"case": case_keys(checks.boundary_name("case", case))}
        except (TypeError, ValueError) as error:
            raise self._wrong(str(error), place, "case" if place == "case" else "case.case") from None

    def _value(self, known: Mapping[str, Mapping[str, build.Key]], setting: str, value: Any, place: str) -> Any:
        section, _, key = setting.partition(".")
        if not _knows(known, setting):
            command = "cases NAME" if section == "case" else "study --keys"
            raise self._wrong(f"[{section}] has no key {key!r}{checks.suggestion(key, known[section])}: 'adaptmg "
                              f"{command}' lists the keys", place)
        try:
            value = _plain(setting, value)
        except TypeError as error:
            raise self._wrong(str(error), place) from None
        whole = type(value) is int and key in known[section] and known[section][key].real
        return float(value) if whole and abs(value) < 1e300 else value

    def _design(self, values: dict[str, list[Any]]) -> Design:
        given = {key: self._value(sections(), f"design.{key}", value, f"design.{key}")
                 for key, value in self._content.get("design", {}).items()}
        repeats, kind = given.pop("repeats", 1), given.pop("kind", "grid")
        kinds = {"grid": Grid, "zip": Zip, "random": Random, "latin-hypercube": LatinHypercube, "sobol": Sobol}
        try:
            checks.choice("design.kind", kind, kinds)
            if kind in ("grid", "zip") and given:
                raise ValueError(f"design.{next(iter(given))} belongs to samples, such as kind = \"sobol\"")
            if kind not in ("grid", "zip") and "runs" not in given:
                raise ValueError(f"design.kind {kind} needs runs = NUMBER, and [low, high] of each setting in [vary]")
            made = kinds[kind](values, **given)
            checks.integer("design.repeats", repeats, 1, 10**9)
            return made if repeats == 1 else Repeated(made, repeats, name="repeat")
        except (TypeError, ValueError) as error:
            words = re.sub(r"(?:parameters|ranges)\['([^']*)'\]", r"\1", str(error))
            named = next((f"vary.{name}" for name in values if f"'{name}'" in str(error)), "")
            section = "design" if "design" in self._content else "vary"
            key = re.match(r"(?:design\.)?(\w+)\b", words)
            place = f"design.{key[1]}" if key and key[1] in self._content.get("design", {}) else named or section
            raise self._wrong(words, place) from None

    def _check_measures(self, fixed: Mapping[str, Any]) -> None:
        for key in ("columns", "forces_on"):
            given = fixed.get(f"measure.{key}", ())
            if not isinstance(given, tuple) or not all(isinstance(name, str) for name in given):
                raise self._wrong(f"measure.{key} must be a list of names, got {checks.shown(given)}", "measure", key)
        for column in fixed.get("measure.columns", ()):
            if column not in MEASURES:
                raise self._wrong(f"nothing measures {column!r}{checks.suggestion(column, MEASURES)}; there are "
                                  f"{', '.join(MEASURES)}", "measure", "columns")
        if not isinstance(fixed.get("measure.keep", False), bool):
            raise self._wrong(f"measure.keep must be true or false, got {fixed['measure.keep']!r}", "measure", "keep")
        for key, point in build.section(fixed, "measure.points").items():
            try:
                check_arrays.vector(f"measure.points.{key}", point)
            except (TypeError, ValueError) as error:
                raise self._wrong(str(error), "measure", f"points.{key}") from None
        if "measure.points" in fixed:
            raise self._wrong("measure.points must be values by name, points = {A = [0.0, 0.0]}", "measure", "points")

    def _options(self, settings: list[str]) -> dict[str, Any]:
        tests = {"workers": lambda name, value: checks.integer(name, value, 1), "limit_s": checks.positive,
                 "memory_limit": checks.positive, "cost": checks.boundary_name}
        found = {}
        for key, value in self._content.get("run", {}).items():
            self._value(sections(), f"run.{key}", value, f"run.{key}")
            try:
                found[key] = tests[key](f"run.{key}", value)
            except (TypeError, ValueError) as error:
                raise self._wrong(str(error), "run", key) from None
        known = [*settings, *MEASURES, "seconds"]
        if found.get("cost", "seconds") not in known:
            raise self._wrong(f"run.cost: there is no setting or measure {found['cost']!r}"
                              f"{checks.suggestion(found['cost'], known)}", "run", "cost")
        return found


def _knows(known: Mapping[str, Mapping[str, build.Key]], setting: str) -> bool:
    """Whether there is such a setting; values by name, such as ``measure.points.A``, have a key of their own."""
    section, _, key = setting.partition(".")
    keys = known[section]
    if section == "load_path" or key in keys:
        return bool(key)
    head = keys.get(key.partition(".")[0])
    return "." in key and head is not None and ("mapping" in head.values or "{" in head.values)


def _plain(name: str, value: Any) -> Any:
    """A value that can be a parameter; lists become tuples."""
    if isinstance(value, list):
        return tuple(_plain(f"{name}[{k}]", item) for k, item in enumerate(value))
    if isinstance(value, bool | int | float | str | tuple):
        return value
    raise TypeError(f"{name} must be a number, text, true, false, or a list of those, got {checks.shown(value)}")


#: points whose problem and solver are made before anything runs: of the first, of those with new values; and points
#: that are looked at for such
_FIRST, _NEW, _SEEN = 100, 1000, 50_000
#: points that a plan shows, and of how many it says what is stored of each
_SHOWN, _TOLD = 20, 20_000


def checked(said: StudyFile, store: Path | None) -> Study:
    """Return the study, after making problem and solver of the first points and of those that bring a new value."""
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
            raise said.wrong(f"with {checks.shown(varied)[1:-1]}: {error}", _place(said, error)) from None
    return Study(case_run, said.design, store, name=said.name, fixed=said.fixed)


def _place(said: StudyFile, error: build.WrongSetting) -> str:
    """Where the setting stands that a message names, or else the section it is about."""
    places = {name: f"vary.{name}" if name in said.design.names else name for name in (*said.design.names, *said.fixed)
              if name.startswith(f"{error.section}.")}
    for part in (0, 1, -1):
        words = {name: ".".join(name.split(".")[part:]) for name in places}
        found = {name: re.search(rf"(?<![\w.-]){re.escape(words[name])}(?![\w-])", str(error)) for name in places}
        named = {name: match.start() for name, match in found.items() if match}
        if named:
            # a message may name the case too
            return places[min(named, key=lambda name: (name == "case.case", named[name]))]
    return error.section


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


_PATIENCE_S = 3.0
#: bytes of a greeting
_LONGEST = 1_000_000
_ADDRESS = re.compile(r"(tcp|tls|ws|wss|ucx)://(\[[^\]]+\]|[^:/\[\]\s]+):(\d+)/?")


def check_scheduler(address: str) -> None:
    """Connect once."""
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


def check_options(said: StudyFile, options: Mapping[str, Any]) -> None:
    """ValueError or OSError for options of a run that cannot be, before a store is made."""
    here = options.get("workers") is None and options.get("scheduler") is None
    limits = [key for key in ("limit_s", "memory_limit") if options.get(key) is not None]
    if here and limits:
        raise said.wrong(f"run.{limits[0]} needs workers, in the file or as --workers 1 or more: a run in this "
                              "process cannot be stopped", "run", limits[0])
    if options.get("workers") is not None and options.get("scheduler") is not None:
        raise ValueError("give --workers (processes of this machine) or --scheduler (a cluster), not both")
    if options.get("scheduler") is not None:
        check_scheduler(options["scheduler"])
    most = max(64, 4 * (os.cpu_count() or 1))
    if (options.get("workers") or 0) > most:
        raise ValueError(f"workers must be at most {most} on this machine, got {options['workers']}: several machines "
                         "need a scheduler (--scheduler)")
