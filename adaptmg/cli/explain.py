"""What a user reads of study files: all keys and measures, the arguments of a case, a file to begin with."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import adaptmg as am
from adaptmg.cases import CASES, get
from adaptmg.cli.build import DIVISIONS, METHODS, OBJECTS, Key, keys_of, name_of
from adaptmg.cli.measure import COLUMNS, MEASURES
from adaptmg.problem.load_path import names_in_path
from adaptmg.study.designs import Random

__all__ = ["PURPOSE", "RUN", "SETTINGS", "about_case", "case_facts", "case_keys", "key_facts", "keys", "sections",
           "template"]

#: sections whose keys are settings of a run, which [vary] can name
SETTINGS = ("case", "hierarchy", "solver", "adapt", "load_path")
#: options of :meth:`adaptmg.Study.run` in a file
RUN = ("workers", "limit_s", "memory_limit", "cost")
#: what sections are for
PURPOSE = {
    "case": "the problem: its name, its law, and its own arguments, see 'adaptmg cases NAME'",
    "hierarchy": "grids; without it the default divisions",
    "solver": "method; without it full multigrid, truncated, to 1e-8",
    "adapt": "instead of [hierarchy]: meshes that follow the error, until one of the limits",
    "load_path": "load steps: factors by boundary or body, NAME = [0.5, 1.0], one a step",
    "measure": "what the table shows next to the outcome; it may be empty",
    "run": "how runs are computed",
    "design": "which points",
    "vary": "settings and their values, \"solver.pre\" = [1, 2, 4]; samples: their ranges [low, high]",
}


def _laws() -> dict[str, Key]:
    return {key: value for kind in OBJECTS["law"] for key, value in keys_of(kind).items()}


def case_keys(name: str) -> dict[str, Key]:
    """Return the keys of [case] for a case."""
    return {"case": sections()["case"]["case"], **keys_of(get(name).function)}


@cache
def sections() -> dict[str, dict[str, Key]]:
    """Return all sections with their keys; of [case] those of all cases."""
    samples, run, uniform = keys_of(Random), keys_of(am.Study.run), keys_of(am.Hierarchy.uniform)
    return {
        "case": {"case": Key("name", "the problem, see 'adaptmg cases'"),
                 "law": Key(" | ".join(map(name_of, OBJECTS["law"])), "contact law", "that of the case"), **_laws()},
        "hierarchy": {**uniform, "divisions": replace(uniform["divisions"], default=", in 3D ".join(
                          str(list(values)) for values in DIVISIONS.values())), **keys_of(am.Hierarchy.graded),
                      "levels": Key("int", "How often the elements at contact of a single grid are bisected")},
        "solver": {"method": Key(" | ".join(map(name_of, METHODS)), "the solver", f'"{name_of(METHODS[0])}"'),
                   **{name: key for kind in reversed(METHODS) for name, key in keys_of(kind).items()}},
        "adapt": keys_of(am.adapt),
        "load_path": {"default": keys_of(am.LoadPath)["default"]},
        "measure": {"columns": Key("list of names", "measures in the table", str(list(COLUMNS)).replace("'", '"')),
                    "forces_on": Key("list of names", "boundaries: resultant force on each, columns 'force_x(NAME)'"),
                    "points": Key("{NAME = [x, y]}, m", "displacement at named points, columns 'NAME.x', m"),
                    "keep": Key("bool", "keep the result of the last step in the folder STORE.files", "false")},
        "run": {name: run[name] for name in RUN},
        "design": {"kind": Key("grid | zip | random | latin-hypercube | sobol", "every combination of values; lists "
                               "side by side; samples of ranges [low, high]", '"grid"'),
                   **{name: samples[name] for name in ("runs", "seed")},
                   "log": Key("list of names", "Settings that are sampled on a logarithmic scale"),
                   "repeats": Key("int", "How often each point is run: a parameter 'repeat' counts them", "1")},
        "vary": {}}


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


def key_facts() -> dict[str, Any]:
    """Return the same as JSON takes it."""
    return {"sections": {section: _facts(known) for section, known in sections().items()},
            "measures": {name: {"meaning": meaning, "unit": unit} for name, (_, meaning, unit) in MEASURES.items()}}


def _facts(known: Mapping[str, Key]) -> dict[str, dict[str, str]]:
    return {name: {"values": key.values, "meaning": key.meaning, "default": key.default} for name, key in known.items()}


def case_facts(name: str) -> dict[str, Any]:
    """Return what a case is, as JSON takes it."""
    posed = get(name).function()
    return {"name": name, "description": CASES[name].description, "dimension": posed.dim,
            "arguments": _facts(case_keys(name)), "boundaries": list(posed.domain.boundaries),
            "contact": list(posed.pair_boundaries), "loads": list(names_in_path(posed))}


def about_case(name: str) -> str:
    """Return what a case is, its arguments, and the boundaries that can be named, as text."""
    facts = case_facts(name)
    return "\n".join([f"{name}: {facts['description']}", "", "Arguments ([case] of a study file):",
                      *_listed(case_keys(name)), "", *_entry("boundaries", ", ".join(facts["boundaries"])),
                      *_entry("contact", ", ".join(facts["contact"])),
                      *_entry("loads", f"{', '.join(facts['loads'])} (names for [load_path])")])


def _listed(known: Mapping[str, Key]) -> list[str]:
    return [line for name, key in known.items() for line in _entry(
        name, f"{key.meaning} ({key.values}).{f' Default: {key.default}.' if key.default else ''}".lstrip())]


def _entry(name: str, text: str) -> list[str]:
    return textwrap.wrap(f"  {name:<15} {text}", _width(), subsequent_indent=" " * 18)


def _width() -> int:
    return max(40, min(shutil.get_terminal_size().columns, 110))


#: how much finer meshes are at contact that is small compared with the bodies
_RATIOS = {"cattaneo": 120, "flat_punch": 40, "hertz_cylinder": 60, "hertz_sphere": 60}


def template(name: str) -> str:
    """Return a study file for a case that can be run; what may be changed stands in comments."""
    posed, own = get(name).function(), case_keys(name)
    parts = list(getattr(posed.domain, "parts", {"": posed.domain}).values())
    friction = getattr(posed.law, "friction", None)
    arguments = [f"# {key} = {item.default}{f'      # {item.meaning}' if 0 < len(item.meaning) < 80 else ''}"
                 for key, item in own.items() if item.default and key not in ("law", "friction")]
    if all(isinstance(part, am.Rectangle | am.Box) for part in parts):
        grids = f"divisions = {list(DIVISIONS[posed.dim])}      # cells a side, coarse to fine"
    else:
        size = min(float((part.upper - part.lower).max()) for part in parts)
        grids = f"sizes = [{', '.join(f'{size / n:.2g}' for n in (4, 7, 12))}]      # element sizes in m, coarse to " \
                f"fine\ncontact_ratio = {_RATIOS.get(name, 4)}      # finer at contact by this factor"
    values = [round(factor * friction, 4) for factor in (0.8, 1.0, 1.2)] if isinstance(friction, float) else [0.1, 0.3]
    law = '# law = "tresca"      # frictionless, coulomb (with friction), tresca (with limit, Pa)\n' * ("law" in own)
    return _TEMPLATE.format(name=name, description=CASES[name].description, law=law, arguments="\n".join(arguments),
                            grids=grids, values=values)


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
