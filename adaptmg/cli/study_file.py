"""Study files: TOML that describes case, grids, solver, load path, adaptation, measures, and the settings that vary.

The keys are the arguments of the classes and functions that take them (:mod:`adaptmg.cli.build`), which check the
values before anything runs. A message about a file begins with its name and, where it is known, the line. Texts about
study files follow: all keys and measures, the arguments of a case, a file to begin with.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import textwrap
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import pandas as pd

from adaptmg import _checks as checks
from adaptmg._text import printable
from adaptmg.cases import CASES, get
from adaptmg.cli.build import PURPOSE, SETTINGS, Key, WrongSetting, case_keys, sections, sensible_grids, setting
from adaptmg.cli.case_run import MEASURES, case_run, check, units_of
from adaptmg.cli.output import printed, rows
from adaptmg.problem.load_path import names_in_path
from adaptmg.study import Grid, LatinHypercube, Random, Repeated, Sobol, Study, Zip, execute
from adaptmg.study.designs import Design
from adaptmg.study.record import Value

#: bytes of a study file at most
_MOST = 1_000_000
_DESIGNS = {"grid": Grid, "zip": Zip, "random": Random, "latin-hypercube": LatinHypercube, "sobol": Sobol}


@dataclass(frozen=True, kw_only=True)
class StudyFile:
    """The content of a file, checked."""

    name: str  # of the study
    store: Path
    design: Design  # of the settings that vary, as "section.key"
    fixed: dict[str, Value]  # the other settings, by the same names, and those of [measure]
    options: dict[str, Value]  # of Study.run
    path: Path
    text: str

    def error(self, words: str, cause: WrongSetting) -> ValueError:
        """Return an error that names the file and the line of what caused it."""
        return _error(self.path, _line(self.text, cause.place, str(cause)), words)


def _error(path: Path, line: int, words: object) -> ValueError:
    return ValueError(f"{printable(str(path))}{f', line {line}' if line else ''}: {words}")


def _line(text: str, place: str, words: str) -> int:
    """Return the line of a key, else of a key in that section which a message names, else of the section, else 0."""
    here, found = "", {}
    for number, line in enumerate(text.splitlines(), 1):
        header, key = re.match(r"\s*\[+([^\[\]]+)\]", line), re.match(r"\s*([^\s=#\[][^=#]*?)\s*=", line)
        here = re.sub("[\"'\\s]", "", header[1]) if header else here
        name = here if header else ".".join(filter(None, (here, re.sub("[\"'\\s]", "", key[1])))) if key else ""
        found = {name.removeprefix("vary."): number, name: number} | found
    inside = [name for name in found if name.startswith(f"{place}.")] if place not in found or "." not in place else ()
    for part in (0, 1, -1):
        shown = {name: re.search(rf"(?<![\w.-]){re.escape('.'.join(name.split('.')[part:]))}(?![\w-])", words)
                 for name in inside}
        if named := {name: match.start() for name, match in shown.items() if match}:
            # a message may name the case too
            return found[min(named, key=lambda name: (name.endswith("case.case"), named[name]))]
    while place and place not in found:
        place = place.rpartition(".")[0]
    return found.get(place, 0)


def read(path: str | os.PathLike[str]) -> StudyFile:
    """Read and check a study file."""
    file = checks.file_path("FILE", path)
    with file.open("rb") as stream:
        content = stream.read(_MOST + 1)
    try:
        if len(content) > _MOST:
            raise ValueError(f"it has more than {_MOST} bytes")
        # Windows begins texts with a mark
        text = content.decode("utf-8-sig")
        parsed = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        where = re.search(r"at line (\d+)", str(error))
        line = int(where[1]) if where else 0
        if isinstance(error, UnicodeDecodeError):
            line, error = content.count(b"\n", 0, error.start) + 1, "save it as text in UTF-8"
        raise _error(file, line, f"not TOML: {error}") from None
    try:
        return _checked(file, text, parsed)
    except WrongSetting as error:
        raise _error(file, _line(text, error.place, str(error)), error) from None


def _checked(path: Path, text: str, content: dict[str, object]) -> StudyFile:
    """Check sections, keys, and values that nothing else checks."""
    _check_sections(content)
    name = content.get("name", path.stem)
    varied = _flat("vary", content["vary"])
    fixed = {f"{section}.{key}": value for section in (*SETTINGS, "measure")
             for key, value in _flat(section, content.get(section, {})).items()}
    cases = varied.get("case.case", [fixed.get("case.case")])
    for case in cases if isinstance(cases, list) else [cases]:
        try:
            known = sections() | {"case": case_keys(checks.boundary_name("case", case))}
        except (TypeError, ValueError) as error:
            raise WrongSetting(error, "vary.case.case" if "case.case" in varied else "case.case") from None
        fixed = {key: setting(known, key, value, key) for key, value in fixed.items()}
        varied = {key: _varied(known, key, values) for key, values in varied.items()}
    design = _design(content, varied)
    fixed = {key: value for key, value in fixed.items() if key not in varied}
    return StudyFile(name=name, store=checks.file_path("store", content.get("store", f"results/{name}.sqlite")),
                     design=design, fixed=fixed, options=_options(content.get("run", {}), [*fixed, *varied]),
                     path=path, text=text)


def _check_sections(content: Mapping[str, object]) -> None:
    for name, value in content.items():
        if name in ("name", "store"):
            if not isinstance(value, str) or not value.strip() or not value.isprintable():
                raise WrongSetting(f"{name} must be text, got {checks.shown(value)}", name)
            if name == "name" and (set(value) & set("/\\") or value.startswith(".") or len(value) > 100):
                raise WrongSetting(f"name becomes that of files, got {checks.shown(value)}", name)
        elif name not in PURPOSE:
            owners = [f" (it belongs below [{section}])" for section, known in sections().items() if name in known]
            hint = owners[0] if owners else checks.suggestion(name, [*PURPOSE, "name", "store"])
            raise WrongSetting(f"there is no section {name!r}{hint}; there are {', '.join(PURPOSE)}, and before them "
                               "name and store", f"{name}.")
        elif not isinstance(value, dict):
            raise WrongSetting(f"{name} must be one section, [{name}], got {checks.shown(value)}", name)
    for name in ("case", "vary"):
        if not content.get(name):
            raise WrongSetting(f"there is no section [{name}] ({PURPOSE[name]}), or it is empty; 'adaptmg study "
                               "--template greco_bar' prints a file to begin with", name)


def _flat(section: str, table: Mapping[str, object], before: str = "") -> dict[str, object]:
    """Return the keys of nested tables with points between: ``case.friction`` is the same as ``"case.friction"``."""
    found: dict[str, object] = {}
    for key, value in table.items():
        inner = _flat(section, value, f"{before}{key}.") if isinstance(value, dict) and value else \
            {f"{before}{key}": value}
        if twice := sorted(set(inner) & set(found)):
            raise WrongSetting(f"[{section}] names {twice[0]} twice", f"{section}.{twice[0]}")
        found |= inner
    return found


def _varied(known: Mapping[str, Mapping[str, Key]], name: str, values: object) -> list[Value]:
    part, _, key = name.partition(".")
    if part not in SETTINGS or not key:
        names = [f"{part}.{key}" for part in SETTINGS for key in known[part]]
        raise WrongSetting(f"{name!r} cannot be varied{checks.suggestion(name, names)}: name a setting as "
                           "\"section.key\"", f"vary.{name}")
    if not isinstance(values, list) or not values:
        raise WrongSetting(f"{name} must be a list of values, got {checks.shown(values)}", f"vary.{name}")
    return [setting(known, name, value, f"vary.{name}") for value in values]


def _design(content: Mapping[str, object], values: dict[str, list[Value]]) -> Design:
    given = {key: setting(sections(), f"design.{key}", value, f"design.{key}")
             for key, value in content.get("design", {}).items()}
    repeats, kind = given.pop("repeats", 1), given.pop("kind", "grid")
    try:
        checks.choice("design.kind", kind, _DESIGNS)
        if kind in ("grid", "zip") and given:
            raise ValueError(f"design.{next(iter(given))} belongs to samples, such as kind = \"sobol\"")
        if kind not in ("grid", "zip") and "runs" not in given:
            raise ValueError(f"design.kind {kind} needs runs = NUMBER, and [low, high] of each setting in [vary]")
        made = _DESIGNS[kind](values, **given)
        checks.integer("design.repeats", repeats, 1, 10**9)
        return made if repeats == 1 else Repeated(made, repeats, name="repeat")
    except (TypeError, ValueError) as error:
        words = re.sub(r"(?:parameters|ranges)\['([^']*)'\]", r"\1", str(error))
        of_design = any(re.search(rf"\b{key}\b", words) for key in content.get("design", {}))
        raise WrongSetting(words, "design" if of_design else "vary") from None


def _options(given: Mapping[str, object], settings: list[str]) -> dict[str, Value]:
    tests = {"workers": lambda name, value: checks.integer(name, value, 1), "limit_s": checks.positive,
             "memory_limit": checks.positive, "cost": checks.boundary_name}
    found = {}
    for key, value in given.items():
        setting(sections(), f"run.{key}", value, f"run.{key}")
        try:
            found[key] = tests[key](f"run.{key}", value)
        except (TypeError, ValueError) as error:
            raise WrongSetting(error, f"run.{key}") from None
    known = [*settings, *MEASURES, "seconds"]
    if found.get("cost", "seconds") not in known:
        raise WrongSetting(f"run.cost: there is no setting or measure {found['cost']!r}"
                           f"{checks.suggestion(found['cost'], known)}", "run.cost")
    return found


#: points whose problem and solver are made before anything runs: the first ones, those with a new value among the
#: first points that are examined
_FIRST, _NEW, _EXAMINED = 100, 1000, 50_000
#: points that a plan shows, and the largest study of which it reads the status
_SHOWN, _STATUS = 20, 20_000


def checked(file: StudyFile, store: Path | None) -> Study:
    """Return the study, after making problem and solver of the first points and of those with a new value."""
    seen: set[tuple[str, Value]] = set()
    count = 0
    for point in itertools.islice(file.design.points(), _EXAMINED):
        new = set(point.items()) - seen
        if count >= _FIRST and (not new or count == _FIRST + _NEW):
            continue
        seen |= new
        count += 1
        try:
            check({**file.fixed, **point})
        except WrongSetting as error:
            varied = ", ".join(f"{name} = {value!r}" for name, value in point.items())
            raise file.error(f"with {checks.shown(varied)[1:-1]}: {error}", error) from None
    return Study(case_run, file.design, store, name=file.name, fixed=file.fixed)


def check_options(file: StudyFile, options: Mapping[str, Value]) -> None:
    """Raise ValueError for limits that need workers, before a store is made."""
    for key in ("limit_s", "memory_limit"):
        if options.get(key) is not None and options.get("workers") is None and options.get("scheduler") is None:
            words = (f"run.{key} needs workers, in the file or as --workers 1 or more: a run in this process cannot be "
                     "stopped")
            raise file.error(words, WrongSetting(words, f"run.{key}"))


def unsolved(table: pd.DataFrame) -> int:
    """Return the number of runs that ended without reaching their tolerance."""
    return int(((table["status"] == "done") & (table["outcome"] != "CONVERGED")).sum()) if "outcome" in table else 0


def table(study: Study, found: pd.DataFrame) -> str:
    """Return the table of a study as text, with units."""
    return printed(found.drop(columns=["error"]), study.parameters, units=units_of(found))


def warm(study: Study) -> None:
    """Compile the kernels of the default method before the clock of the first run, if anything is to be run."""
    status = study.status()
    if status.done + status.failed < status.total:
        execute.warm()


def plan(study: Study) -> str:
    """Return the first points of a study, their status, and the number of points."""
    points = list(itertools.islice(study.design.points(), _SHOWN))
    shown = {name: [point[name] for point in points] for name in study.parameters}
    if len(study) <= _STATUS:
        shown["status"] = list(study.table()["status"].head(_SHOWN))
    rest = len(study) - _SHOWN
    return "\n".join([printed(shown, study.parameters, units={}, note=f"... {rest} more" if rest > 0 else ""), "",
                      repr(study), repr(study.status())])


def summary(study: Study, with_rows: bool) -> dict[str, object]:
    """Return a study as JSON takes it."""
    status = study.status()
    head = {"study": study.name, "runs": status.total, "done": status.done, "failed": status.failed,
            "stale": status.stale, "missing": status.missing, "why_stale": status.reasons, "errors": status.errors}
    return head | ({"rows": rows(study.table(details=True))} if with_rows else {})


def keys() -> str:
    """Return all sections, keys and measures of a study file as text."""
    lines = ["Keys of a study file (TOML, SI units; a key that is left out keeps its default).", "",
             *_entry("name", "of the study. Default: that of the file."),
             *_entry("store", "SQLite file of the runs, from the working directory. Default: results/NAME.sqlite.")]
    for section, known in sections().items():
        lines += ["", *textwrap.wrap(f"[{section}]  {PURPOSE[section]}", _width(), subsequent_indent="    "),
                  *_listed(known)]
    lines += ["", "Measures (measure.columns):"]
    for name, (_, meaning, unit) in MEASURES.items():
        lines += _entry(name, f"{meaning}{f', {unit}' if unit else ''}")
    return "\n".join([*lines, "", "A file to begin with: adaptmg study --template greco_bar > my.toml",
                      "The arguments of a case: adaptmg cases greco_bar"])


def key_facts() -> dict[str, object]:
    """Return all sections, keys and measures as JSON takes them."""
    return {"sections": {section: {name: asdict(key) for name, key in known.items()}
                         for section, known in sections().items()},
            "measures": {name: {"meaning": meaning, "unit": unit} for name, (_, meaning, unit) in MEASURES.items()}}


def case_facts(name: str) -> dict[str, object]:
    """Return arguments, boundaries and loads of a case as JSON takes them."""
    posed = get(name).function()
    return {"name": name, "description": CASES[name].description, "dimension": posed.dim,
            "arguments": {key: asdict(item) for key, item in case_keys(name).items()},
            "boundaries": list(posed.domain.boundaries), "contact": list(posed.pair_boundaries),
            "loads": list(names_in_path(posed))}


def about_case(name: str) -> str:
    """Return arguments, boundaries and loads of a case as text."""
    facts = case_facts(name)
    lines = [line for key in ("boundaries", "contact") for line in _entry(key, ", ".join(facts[key]))]
    return "\n".join([f"{name}: {facts['description']}", "", "Arguments ([case] of a study file):",
                      *_listed(case_keys(name)), "", *lines,
                      *_entry("loads", f"{', '.join(facts['loads'])} (names for [load_path])")])


def _listed(known: Mapping[str, Key]) -> list[str]:
    return [line for name, key in known.items() for line in _entry(
        name, f"{key.meaning} ({key.values}).{f' Default: {key.default}.' if key.default else ''}".lstrip())]


def _entry(name: str, text: str) -> list[str]:
    return textwrap.wrap(f"  {name:<15} {text}", _width(), subsequent_indent=" " * 18)


def _width() -> int:
    return max(40, min(shutil.get_terminal_size().columns, 110))


def template(name: str) -> str:
    """Return a study file for a case that can be run; other settings stand in comments."""
    posed, own = get(name).function(), case_keys(name)
    friction = getattr(posed.law, "friction", None)
    arguments = [f"# {key} = {item.default}{f'      # {item.meaning}' if 0 < len(item.meaning) < 80 else ''}"
                 for key, item in own.items() if item.default and key not in ("law", "friction")]
    grids = "\n".join(f"{key} = {list(value) if isinstance(value, tuple) else value}{_GRIDS[key]}"
                      for key, value in sensible_grids(posed).items())
    values = [round(factor * friction, 4) for factor in (0.8, 1.0, 1.2)] if isinstance(friction, float) else [0.1, 0.3]
    law = '# law = "tresca"      # frictionless, coulomb (with friction), tresca (with limit, Pa)\n' * ("law" in own)
    return _TEMPLATE.format(name=name, description=CASES[name].description, law=law, arguments="\n".join(arguments),
                            grids=grids, values=values)


_GRIDS = {"divisions": "      # cells a side, coarse to fine", "sizes": "      # element sizes in m, coarse to fine",
          "contact_ratio": "      # finer at contact by this factor"}
_TEMPLATE = """# {description}
#     adaptmg study my.toml --workers 2
# All keys and measures: adaptmg study --keys

name = "{name}"
store = "results/{name}.sqlite"

[case]
case = "{name}"
{law}{arguments}

[hierarchy]
{grids}

[solver]
# method = "multigrid"      # full-multigrid, multigrid, single-grid, active-set
# rtol = 1e-8

[measure]
columns = ["cycles", "work_units", "nodes", "slip", "stick", "max_pressure", "max_displacement"]

[vary]
"case.friction" = {values}
"""
