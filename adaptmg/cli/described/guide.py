"""What a user reads of study files: all keys, the arguments of a case, a file to begin with."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Mapping
from typing import Any

from adaptmg.cli.described.arguments import case_keys, takes_law
from adaptmg.cli.described.keys import SECTIONS, WORDS, Key
from adaptmg.cli.described.meanings import MEANINGS

__all__ = ["about_case", "case_facts", "key_facts", "keys", "template"]

_WIDEST = 110
#: how much finer meshes are at contact that is small beside the bodies
_RATIOS = {"cattaneo": 120, "flat_punch": 40, "hertz_cylinder": 60, "hertz_sphere": 60}


def keys() -> str:
    """All sections, keys and measures of a study file."""
    lines = ["Keys of a study file (TOML, SI units; a key that is left out keeps its default).", "",
             *_entry("name", "of the study. Default: that of the file."),
             *_entry("store", "SQLite file of the runs, from the working directory. Default: results/NAME.sqlite.")]
    for section, known in SECTIONS.items():
        lines += ["", *textwrap.wrap(f"[{section}]  {WORDS[section]}", _width(), subsequent_indent="    ")]
        lines += _listed(known)
    lines += ["", "Measures (measure.columns):"]
    for name, (meaning, unit) in MEANINGS.items():
        lines += _entry(name, f"{meaning}{f', {unit}' if unit else ''}")
    lines += ["", "A file to begin with: adaptmg study --template greco_bar > my.toml",
              "The arguments of a case: adaptmg cases greco_bar"]
    return "\n".join(lines)


def key_facts() -> dict[str, Any]:
    """The same as JSON takes it."""
    return {"sections": {section: _facts(known) for section, known in SECTIONS.items()},
            "measures": {name: {"meaning": meaning, "unit": unit} for name, (meaning, unit) in MEANINGS.items()}}


def _facts(known: Mapping[str, Key]) -> dict[str, dict[str, str]]:
    return {name: {"values": key.values, "meaning": key.meaning, "default": key.default} for name, key in known.items()}


def case_facts(name: str) -> dict[str, Any]:
    """What a case is, as JSON takes it."""
    from adaptmg.cases import CASES, get
    from adaptmg.problem.load_path import names_in_path

    posed = get(name).function()
    return {"name": name, "description": CASES[name].description, "dimension": posed.dim,
            "arguments": _facts(case_keys(name)), "boundaries": list(posed.domain.boundaries),
            "contact": list(posed.pair_boundaries), "loads": list(names_in_path(posed))}


def about_case(name: str) -> str:
    """What a case is, its arguments, and the boundaries that can be named."""
    facts = case_facts(name)
    return "\n".join([f"{name}: {facts['description']}", "", "Arguments ([case] of a study file):",
                      *_listed(case_keys(name)), "", *_entry("boundaries", ", ".join(facts["boundaries"])),
                      *_entry("contact", ", ".join(facts["contact"])),
                      *_entry("loads", f"{', '.join(facts['loads'])} (names for [load_path])")])


def _listed(known: Mapping[str, Key]) -> list[str]:
    lines: list[str] = []
    for name, key in known.items():
        default = f" Default: {key.default}." if key.default else ""
        lines += _entry(f"{name}.NAME" if key.named else name, f"{key.meaning.rstrip('.')} ({key.values}).{default}")
    return lines


def _entry(name: str, text: str) -> list[str]:
    return textwrap.wrap(f"  {name:<15} {text}", _width(), subsequent_indent=" " * 18)


def _width() -> int:
    return max(40, min(shutil.get_terminal_size().columns, _WIDEST))


def template(name: str) -> str:
    """A study file for a case that runs as it is; what may be changed stands in comments."""
    from adaptmg.cases import CASES
    from adaptmg.problem import Box, Coulomb, Rectangle

    own = case_keys(name)
    function = CASES[name].function
    posed = function()
    apart = list(getattr(posed.domain, "parts", {"": posed.domain}).values())
    friction = posed.law.friction if isinstance(posed.law, Coulomb) and isinstance(posed.law.friction, float) else None
    arguments = [f"# {key} = {item.default}" + _comment(item) for key, item in own.items()
                 if item.default and item.default != "that of the case"]
    if all(isinstance(part, Rectangle | Box) for part in apart):
        divisions = [4, 8, 16, 32] if posed.dim == 2 else [2, 4, 8]
        grids = f"divisions = {divisions}      # cells a side, coarse to fine"
    else:
        size = min(float((part.upper - part.lower).max()) for part in apart)
        sizes = ", ".join(f"{size / parts:.2g}" for parts in (4, 7, 12))
        grids = f"sizes = [{sizes}]      # element sizes in m, coarse to fine\n" \
                f"contact_ratio = {_RATIOS.get(name, 4)}      # finer at contact by this factor"
    values = [0.1, 0.3] if friction is None else [round(factor * friction, 4) for factor in (0.8, 1.0, 1.2)]
    law = '# law = "tresca"      # frictionless, coulomb (with friction), tresca (with limit, Pa)\n' \
        if takes_law(function) else ""
    return _TEMPLATE.format(name=name, description=CASES[name].description, law=law, arguments="\n".join(arguments),
                            grids=grids, values=values)


def _comment(item: Key) -> str:
    text = f"      # {item.meaning.rstrip('.')}" if item.meaning else ""
    return text if len(text) < 90 else f"{text[:textwrap.wrap(text[:88], 88)[0].rfind(' ')]} ..."


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
