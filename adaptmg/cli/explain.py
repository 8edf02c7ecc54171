"""Texts about study files: all keys and measures, the arguments of a case, a file to begin with."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Mapping
from dataclasses import asdict

from adaptmg.cases import CASES, get
from adaptmg.cli.build import PURPOSE, Key, case_keys, sections, sensible_grids
from adaptmg.cli.case_run import MEASURES
from adaptmg.problem.load_path import names_in_path


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
