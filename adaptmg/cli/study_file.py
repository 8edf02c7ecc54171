"""Study files: TOML that describes case, grids, solver, load path, adaptation, measures, and the settings that vary.

The keys are the arguments of the classes and functions that take them (:mod:`adaptmg.cli.build`), which check the
values before anything runs. A message about a file begins with its name. Texts about study files follow: all keys and
measures, the arguments of a case, a file to begin with.
"""

from __future__ import annotations

import itertools
import os
import shutil
import textwrap
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from adaptmg import _checks as checks
from adaptmg._files import read_bytes
from adaptmg._text import printable
from adaptmg.cases import CASES, get
from adaptmg.cli.build import PURPOSE, SETTINGS, Key, case_keys, sections, sensible_grids, setting
from adaptmg.cli.case_run import MEASURES, case_run, check
from adaptmg.cli.output import printed, rows
from adaptmg.problem.load_path import names_in_path
from adaptmg.study import Grid, LatinHypercube, Random, Repeated, Sobol, Study, Zip
from adaptmg.study.designs import Design
from adaptmg.study.record import Value

#: bytes of a study file at most, points that are checked before anything runs, points that a plan shows
_MOST, _EXAMINED, _SHOWN = 1_000_000, 5000, 20
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


def read(path: str | os.PathLike[str]) -> StudyFile:
    """Read and check a study file."""
    file = checks.file_path("FILE", path)
    content = read_bytes(file, _MOST)
    with _named(file):
        # Windows begins texts with a mark
        return _checked(file, tomllib.loads(content.decode("utf-8-sig")))


@contextmanager
def _named(file: Path, words: str = "") -> Iterator[None]:
    """Let messages begin with the name of a file, and words."""
    try:
        yield
    except (ValueError, TypeError, RecursionError) as error:
        raise ValueError(f"{printable(str(file))}: {words}{error}") from None


def _checked(path: Path, content: dict[str, object]) -> StudyFile:
    """Check sections, keys, and values that nothing else checks."""
    _check_sections(content)
    name = content.get("name", path.stem)
    varied = _flat("vary", content["vary"])
    fixed = {f"{section}.{key}": value for section in (*SETTINGS, "measure")
             for key, value in _flat(section, content.get(section, {})).items()}
    cases = varied.get("case.case", [fixed.get("case.case")])
    for case in cases if isinstance(cases, list) else [cases]:
        known = sections() | {"case": case_keys(checks.boundary_name("case.case", case))}
        fixed = {key: setting(known, key, value) for key, value in fixed.items()}
        varied = {key: _varied(known, key, values) for key, values in varied.items()}
    design = _design(content, varied)
    fixed = {key: value for key, value in fixed.items() if key not in varied}
    return StudyFile(name=name, store=checks.file_path("store", content.get("store", f"results/{name}.sqlite")),
                     design=design, fixed=fixed, options=_options(content.get("run", {}), [*fixed, *varied]), path=path)


def _check_sections(content: Mapping[str, object]) -> None:
    for name, value in content.items():
        if name in ("name", "store"):
            checks.boundary_name(name, value)
            if name == "name" and (set(value) & set("/\\") or value.startswith(".") or len(value) > 100):
                raise ValueError(f"name becomes that of files, got {checks.shown(value)}")
        elif name not in PURPOSE:
            owners = [f" (it belongs below [{section}])" for section, known in sections().items() if name in known]
            hint = owners[0] if owners else checks.suggestion(name, [*PURPOSE, "name", "store"])
            raise ValueError(f"there is no section {name!r}{hint}; there are {', '.join(PURPOSE)}, and before them "
                             "name and store")
        elif not isinstance(value, dict):
            raise ValueError(f"{name} must be one section, [{name}], got {checks.shown(value)}")
    for name in ("case", "vary"):
        if not content.get(name):
            raise ValueError(f"there is no section [{name}] ({PURPOSE[name]}), or it is empty; 'adaptmg study "
                             "--template greco_bar' prints a file to begin with")


def _flat(section: str, table: Mapping[str, object], before: str = "") -> dict[str, object]:
    """Return the keys of nested tables with points between: ``case.friction`` is the same as ``"case.friction"``."""
    found: dict[str, object] = {}
    for key, value in table.items():
        inner = _flat(section, value, f"{before}{key}.") if isinstance(value, dict) and value else \
            {f"{before}{key}": value}
        if twice := sorted(set(inner) & set(found)):
            raise ValueError(f"[{section}] names {twice[0]} twice")
        found |= inner
    return found


def _varied(known: Mapping[str, Mapping[str, Key]], name: str, values: object) -> list[Value]:
    part, _, key = name.partition(".")
    if part not in SETTINGS or not key:
        names = [f"{part}.{key}" for part in SETTINGS for key in known[part]]
        raise ValueError(f"{name!r} cannot be varied{checks.suggestion(name, names)}: name a setting as "
                         "\"section.key\"")
    if not isinstance(values, list) or not values:
        raise ValueError(f"{name} must be a list of values, got {checks.shown(values)}")
    return [setting(known, name, value) for value in values]


def _design(content: Mapping[str, object], values: dict[str, list[Value]]) -> Design:
    given = {key: setting(sections(), f"design.{key}", value) for key, value in content.get("design", {}).items()}
    repeats, kind = given.pop("repeats", 1), given.pop("kind", "grid")
    checks.choice("design.kind", kind, _DESIGNS)
    if kind in ("grid", "zip") and given:
        raise ValueError(f"design.{next(iter(given))} belongs to samples, such as kind = \"sobol\"")
    if kind not in ("grid", "zip") and "runs" not in given:
        raise ValueError(f"design.kind {kind} needs runs = NUMBER, and [low, high] of each setting in [vary]")
    made = _DESIGNS[kind](values, **given)
    return made if repeats == 1 else Repeated(made, repeats, name="repeat")


def _options(given: Mapping[str, object], settings: list[str]) -> dict[str, Value]:
    """Return the options of :meth:`adaptmg.study.Study.run`, which checks their values."""
    found = {key: setting(sections(), f"run.{key}", value) for key, value in given.items()}
    known = [*settings, *MEASURES, "seconds"]
    if "cost" in found and checks.boundary_name("run.cost", found["cost"]) not in known:
        raise ValueError(f"run.cost: there is no setting or measure {found['cost']!r}"
                         f"{checks.suggestion(found['cost'], known)}")
    return found


def checked(file: StudyFile, store: Path | None) -> Study:
    """Return the study, after making problem and solver of its first points with a new value."""
    seen: set[tuple[str, Value]] = set()
    for point in itertools.islice(file.design.points(), _EXAMINED):
        if not seen.issuperset(point.items()):
            seen |= set(point.items())
            varied = ", ".join(f"{name} = {value!r}" for name, value in point.items())
            with _named(file.path, f"with {checks.shown(varied)[1:-1]}: "):
                check({**file.fixed, **point})
    return Study(case_run, file.design, store, name=file.name, fixed=file.fixed)


def plan(study: Study) -> str:
    """Return the first points of a study, their status, and the number of points."""
    points = list(itertools.islice(study.design.points(), _SHOWN))
    shown = {name: [point[name] for point in points] for name in study.parameters}
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
