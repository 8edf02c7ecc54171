"""From the settings of a run to problem, load path, method and adaptive loop.

From options to the problem of a case with another law: the same for the command line and for study files.

From options to a method: the same for the command line and for study files.

The arguments of a case in a study file: checked by the types of its function, explained by its docstring.

What a user reads of study files: all keys, the arguments of a case, a file to begin with.

The keys of a study file: what their values must be, what they mean, and what holds where they are left out.

The run function of a study file: from settings to what is measured.

Grids of a run: uniform, independent, or bisected at contact; what cannot be meshed is refused before.

What a run of a study file measures, by name.

Settings of a run, by ``"section.key"``.
"""

from __future__ import annotations

import ast
import inspect
import re
import shutil
import textwrap
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.cases import get
from adaptmg.cli.choices import (
    CorrectionName,
    EngineName,
    GoalName,
    IndicatorName,
    LawName,
    LinearName,
    MarkName,
    Shape,
    SolverName,
    Sweeping,
    TransferName,
)
from adaptmg.cli.output import MEANINGS
from adaptmg.problem.load_path import names_in_path
from adaptmg.solver.record import Solver

if TYPE_CHECKING:
    from adaptmg.solver.result import Result

__all__ = [
    "MEASURES",
    "OPEN",
    "SECTIONS",
    "SETTINGS",
    "WORDS",
    "Check",
    "Key",
    "Settings",
    "Solved",
    "WrongSetting",
    "about_case",
    "adaptation",
    "at_boundaries",
    "at_points",
    "case_facts",
    "case_keys",
    "case_run",
    "check",
    "check_grids",
    "check_size",
    "given_arguments",
    "grids",
    "key_facts",
    "keys",
    "load_path",
    "method_of",
    "plain",
    "posed",
    "problem_of",
    "section",
    "solver_of",
    "takes_law",
    "template",
]

_LIMITS = ("tolerance", "max_nodes", "max_seconds")
_NAMED = {"correction": CorrectionName, "cycle": Shape, "order": Sweeping, "linear": LinearName}


class WrongSetting(ValueError):
    """Settings of which a part cannot be made.

    Parameters
    ----------
    text : str
    section : str
        In which the settings are.
    """

    def __init__(self, text: str, section: str) -> None:
        super().__init__(text)
        self.section = section


def check(settings: Settings) -> None:
    """Make what can be made without meshing.

    Raises
    ------
    WrongSetting
        For what cannot be.
    """
    made: am.ContactProblem | None = None

    def of_problem(part: Callable[..., Any]) -> Callable[[Settings], Any]:
        return lambda settings: part(made, settings)

    parts: dict[str, Callable[[Settings], Any]] = {
        "case": problem_of, "load_path": of_problem(_check_path), "hierarchy": of_problem(check_grids),
        "solver": solver_of,
        "adapt": of_problem(_check_adaptation), "measure": of_problem(_check_measures)}
    for name, part in parts.items():
        try:
            found = part(settings)
        except (ValueError, TypeError) as error:
            raise WrongSetting(str(error), name) from error
        made = found if name == "case" else made


def problem_of(settings: Settings) -> am.ContactProblem:
    """The case, with the law that is asked for."""
    given = section(settings, "case")
    function, law = get(given.pop("case")).function, given.pop("law", None)
    return posed(function, None if law is None else LawName(law), given.pop("friction", None), given.pop("limit", None),
                 "case.", **given)


def load_path(settings: Settings) -> am.LoadPath | None:
    """The load path, if there is one."""
    given = section(settings, "load_path")
    default = given.pop("default", 1.0)
    return am.LoadPath(given, default) if "load_path.default" in settings or given else None


def _check_path(task: am.ContactProblem, settings: Settings) -> None:
    path, known = load_path(settings), names_in_path(task)
    for name in path.factors if path is not None else ():
        if name not in known:
            raise ValueError(f"load_path.{name}: the problem has no load there{checks.suggestion(name, known)}; it has "
                             f"loads on {', '.join(known)}")


def solver_of(settings: Settings) -> Solver:
    """The method."""
    given = section(settings, "solver")
    name = SolverName(given.pop("method", SolverName.FULL))
    given["most"] = given.pop("max_cycles", None)
    named = {key: _NAMED[key](value) if key in _NAMED else value for key, value in given.items()}
    return method_of(name, **named, flag="solver.", flag_of_name="solver.method")


def adaptation(task: am.ContactProblem, settings: Settings) -> dict[str, Any]:
    """Arguments of :func:`adaptmg.adapt` after the problem."""
    given = section(settings, "adapt")
    stops = {name: given[name] for name in _LIMITS if name in given}
    if not stops:
        raise ValueError("[adapt] needs a limit: max_nodes, tolerance or max_seconds")
    bisect = given.get("engine") == "bisect"
    if "coarsen" in given and not bisect:
        raise ValueError("adapt.coarsen belongs to adapt.engine = \"bisect\"; remeshing makes elements coarser anyway")
    if given.get("indicator") != "goal" and (useless := [key for key in given if key.startswith("goal")]):
        raise ValueError(f"adapt.{useless[0]} belongs to adapt.indicator = \"goal\"")
    goal = am.Goal(_goal(given)) if given.get("indicator") == "goal" else None
    indicator = goal or (am.Recovery() if given.get("indicator") == "recovery" else am.Residual())
    kind = am.Maximum if given.get("mark") == MarkName.MAXIMUM else am.Doerfler
    # errors of single quantities scatter less on Netgen's own meshes
    engine = am.Bisect(coarsen=given.get("coarsen", False)) if bisect else am.Remesh(refinements=0) if goal else \
        am.Remesh()
    return {"start": given.get("start"), "indicator": indicator, "mark": kind(given.get("theta", 0.5)),
            "engine": engine, "solver": solver_of(settings) if section(settings, "solver") else None,
            "load_path": load_path(settings), **stops}


def _goal(given: Mapping[str, Any]) -> Any:
    """The quantity whose error is followed; its class says what is wrong."""
    kind = given.get("goal")
    boundary, point, component = (given.get(f"goal_{key}") for key in ("boundary", "point", "component"))
    needs = {GoalName.DISPLACEMENT: {"point": point, "component": component}, GoalName.CONTACT_FORCE: {},
             GoalName.MEAN_DISPLACEMENT: {"boundary": boundary, "component": component}, GoalName.OPENING: {}}
    if kind is None:
        raise ValueError(f"adapt.indicator = \"goal\" needs adapt.goal, one of {', '.join(GoalName)}")
    for key, value in needs[kind].items():
        if value is None:
            raise ValueError(f"adapt.goal = \"{kind}\" needs adapt.goal_{key}")
    if kind == GoalName.DISPLACEMENT:
        return am.Displacement(point, component)
    if kind == GoalName.MEAN_DISPLACEMENT:
        return am.MeanDisplacement(boundary, component)
    if kind == GoalName.CONTACT_FORCE:
        return am.ContactForce(boundary or "contact", component or "normal")
    return am.Opening(boundary or "contact", point)


def _check_adaptation(task: am.ContactProblem, settings: Settings) -> None:
    if section(settings, "adapt"):
        check_size(task, "adapt.start", adaptation(task, settings)["start"])


def _check_measures(task: am.ContactProblem, settings: Settings) -> None:
    for name, point in section(settings, "measure.points").items():
        if len(point) != task.dim:
            raise ValueError(f"measure.points.{name} must have {task.dim} coordinates, got {checks.shown(point)}")
    known = ("contact", *task.domain.boundaries)
    for name in settings.get("measure.forces_on", ()):
        if name not in known:
            raise ValueError(f"measure.forces_on: there is no boundary {name!r}{checks.suggestion(name, known)}; there "
                             f"are {', '.join(known)}")


def posed(function: Callable[..., am.ContactProblem], law: LawName | None, friction: float | None,
          limit: float | None, flag: str = "--", **own: Any) -> am.ContactProblem:
    """The problem of a case; ValueError for options that do not belong together.

    Parameters
    ----------
    function : callable
        Of a case.
    law, friction, limit : optional
        Coefficient of friction; Tresca limit, Pa. None: that of the case.
    flag : str
        What options begin with in messages.
    own
        The case's own arguments.
    """
    if law is None and friction is None and limit is None:
        return function(**own)
    takes = function.__kwdefaults__ or {}
    if "law" not in takes:
        # a case whose bodies differ in friction: it takes coefficients
        if law not in (None, LawName.COULOMB) or friction is None or "friction" not in takes:
            raise ValueError(f"this case has Coulomb friction, its law cannot be changed: give {flag}friction alone")
        return function(friction=friction, **own)
    if law is None:
        law = LawName.TRESCA if friction is None else LawName.COULOMB
    for name, value, owner in (("friction", friction, LawName.COULOMB), ("limit", limit, LawName.TRESCA)):
        if law is owner and value is None:
            raise ValueError(f"{flag}law {law} needs {flag}{name}")
        if law is not owner and value is not None:
            raise ValueError(f"{flag}{name} belongs to {flag}law {owner}, not to {law}")
    made = {LawName.COULOMB: lambda: am.Coulomb(friction), LawName.TRESCA: lambda: am.Tresca(limit),
            LawName.FRICTIONLESS: am.Frictionless}
    return function(law=made[law](), **own)


#: options, beside rtol and most, that a method takes
_MULTIGRID = ("correction", "cycle", "pre", "post", "omega", "order")
_TAKES = {SolverName.FULL: _MULTIGRID, SolverName.MULTIGRID: _MULTIGRID, SolverName.SINGLE: ("omega", "condensed"),
          SolverName.ACTIVE: ("linear", "strength", "lag")}
_PAPER = ("gap", "slip", "sliding_limit")


def method_of(name: SolverName, *, correction: CorrectionName | None = None, cycle: Shape | None = None,
              pre: int | None = None, post: int | None = None, omega: float | None = None,
              order: Sweeping | None = None, gap: str | None = None, slip: str | None = None,
              sliding_limit: str | None = None, condensed: bool | None = None, linear: LinearName | None = None,
              strength: float | None = None, lag: int | None = None, rtol: float | None = None, most: int | None = None,
              flag: str = "--", flag_of_name: str = "--solver") -> Solver:
    """The method with the options that are given; ValueError for one it has no use for.

    Parameters
    ----------
    name, correction, ..., most
        See :mod:`adaptmg.cli.build`; None: the default of the method.
    flag, flag_of_name : str
        What options begin with in messages, and the option that names the method.
    """
    given = {"correction": correction, "cycle": cycle, "pre": pre, "post": post, "omega": omega, "order": order,
             "condensed": condensed, "linear": linear, "strength": strength, "lag": lag}
    useless = [option for option, value in given.items() if value is not None and option not in _TAKES[name]]
    if useless:
        raise ValueError(f"{flag}{useless[0]} has no meaning for {flag_of_name} {name}; "
                         f"it takes {', '.join(f'{flag}{option}' for option in _TAKES[name])}")
    choices = _only(gap=gap, slip=slip, limit=sliding_limit)
    if choices and correction is not CorrectionName.PAPER:
        first = next(option for option, value in zip(_PAPER, (gap, slip, sliding_limit), strict=True) if value)
        raise ValueError(f"{flag}{first} belongs to {flag}correction paper")
    if name is SolverName.SINGLE:
        return am.SingleGrid(**_only(omega=omega, condensed=condensed, rtol=rtol, max_sweeps=most))
    if name is SolverName.ACTIVE:
        options = _only(strength=strength, lag=lag)
        if options and linear is not LinearName.AMG:
            raise ValueError(f"{flag}{next(iter(options))} belongs to {flag}linear amg")
        method = am.AMG(**options) if linear is LinearName.AMG else am.Direct()
        return am.ActiveSet(linear=method, **_only(rtol=rtol, max_steps=most))
    made = {None: None, CorrectionName.TRUNCATED: am.Truncated(), CorrectionName.MONOTONE: am.Monotone(),
            CorrectionName.PAPER: am.PaperCorrection(**choices)}
    kind = am.FullMultigrid if name is SolverName.FULL else am.Multigrid
    return kind(cycle=am.Cycle(**_only(shape=cycle and cycle.value, pre=pre, post=post)),
                smoother=am.ProjectedGaussSeidel(**_only(omega=omega, order=order and order.value)),
                correction=made[correction], **_only(rtol=rtol, max_cycles=most))


def _only(**options: Any) -> dict[str, Any]:
    """Options that are given; the others keep the defaults of the class."""
    return {name: value for name, value in options.items() if value is not None}


#: arguments that are not numbers or texts
_OBJECTS = ("law", "flanges")
_SEE = re.compile(r"(?:[Aa]s in|see) :func:`~?adaptmg\.cases\.\w+\.(\w+)`")


def takes_law(function: Callable[..., Any]) -> bool:
    """Whether a case takes a law; others take a coefficient of friction alone."""
    return "law" in inspect.signature(function).parameters


def case_keys(name: str) -> dict[str, Key]:
    """The keys of [case] for a case: those of all cases, then its own.

    Raises
    ------
    ValueError
        If there is no such case.
    """
    from adaptmg.cases import get

    function = get(name).function
    own, words = inspect.signature(function).parameters, _meanings(function)
    common = dict(SECTIONS["case"])
    if not takes_law(function):
        del common["law"], common["limit"]
    return common | {key: Key(*_kind(str(item.annotation), words.get(key, ("", ""))[0]), words.get(key, ("", ""))[1],
                              _default(item.default)) for key, item in own.items() if key not in _OBJECTS}


def given_arguments(case: str, texts: Sequence[str]) -> dict[str, Any]:
    """Arguments of a case that the command line gives as NAME=VALUE; ValueError or TypeError for what is none."""
    known, common, found = case_keys(case), SECTIONS["case"], {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not value:
            raise ValueError(f"--set must be NAME=VALUE, got {checks.shown(text)}")
        if name in common:
            raise ValueError(f"--set {name}: that is an option of its own" if name != "case" else
                             "--set case: the case is named before the options")
        if name not in known:
            raise ValueError(f"the case {case} takes no {name!r}{checks.suggestion(name, known)}; it takes "
                             f"{', '.join(key for key in known if key not in common)}")
        found[name] = known[name].check(name, _read(value))
    return found


def _read(text: str) -> Any:
    """A number, true or false as in a study file; anything else is text."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _kind(annotation: str, choices: str) -> tuple[Check, str]:
    """Check and words for an annotation, and choices in braces; arguments that may be None are left out instead."""
    if "{" in choices:
        known = tuple(map(ast.literal_eval, re.findall(r'"[^"]*"|\d+', choices)))
        return lambda name, value: checks.choice(name, value, known), " | ".join(map(str, known))
    kinds: dict[str, tuple[Check, str]] = {
        "float": (checks.quantity, "number"), "int": (checks.integer, "whole number"),
        "bool": (SECTIONS["measure"]["keep"].check, "true | false"), "str": (checks.boundary_name, "text")}
    return kinds.get(annotation.removesuffix(" | None"), (plain, "number, text or list"))


def _default(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    return f"{value:g}" if isinstance(value, int | float) else ""


def _meanings(function: Callable[..., Any]) -> dict[str, tuple[str, str]]:
    """What the section 'Parameters' of a docstring says, by argument: its type, and the words."""
    lines = inspect.getdoc(function).splitlines()
    found: dict[str, tuple[str, str]] = {}
    names: list[str] = []
    for line in lines[lines.index("Parameters") + 2:]:
        if line.startswith("Returns"):
            break
        if line and not line.startswith(" "):
            head, _, kind = line.partition(" : ")
            names = head.split(", ")
            found |= dict.fromkeys(names, (kind, kind if kind.startswith("see") else ""))
        else:
            found |= {name: (found[name][0], f"{found[name][1]} {line.strip()}".strip()) for name in names}
    return {name: (kind, _looked_up(name, text)) for name, (kind, text) in found.items()}


def _looked_up(name: str, text: str) -> str:
    """With the words of another case where the docstring refers to it, without markup, and with what is well known."""
    from adaptmg.cases import get

    refers = _SEE.search(text)
    if refers:
        text = _meanings(get(refers[1]).function).get(name, ("", ""))[1]
    known = {"young": "Young's modulus, Pa", "poisson": "Poisson's ratio"}
    return text.replace("Pa, and a number", known.get(name, "Pa, and a number")).replace("``", "").replace("`", "")


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


Check = Callable[[str, Any], Any]


@dataclass(frozen=True)
class Key:
    """A key of a section.

    Attributes
    ----------
    check : callable
        Of name and value -> the value, or TypeError or ValueError.
    values : str
        What it takes, in words, with the unit.
    meaning : str
    default : str
        What holds where it is left out; empty where it must be given, or where nothing then happens.
    named : bool
        Whether it is a table of such values, ``KEY = {NAME = value}``; each is a setting ``"section.KEY.NAME"``.
    """

    check: Check
    values: str
    meaning: str
    default: str = ""
    named: bool = False


def _one_of(names: Iterable[str]) -> Check:
    choices = tuple(map(str, names))

    def check(name: str, value: Any) -> str:
        if not isinstance(value, str) or value not in choices:
            same = {choice.casefold(): choice for choice in choices}
            near = checks.suggestion(same.get(value.casefold(), value), choices) if isinstance(value, str) else ""
            raise ValueError(f"{name} must be one of {', '.join(choices)}, got {checks.shown(value)}{near}")
        return value

    return check


def _list_of(check: Check, words: str) -> Check:
    def checked(name: str, value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list | tuple) or not value:
            raise TypeError(f"{name} must be a list of {words}, got {checks.shown(value)}")
        return tuple(check(f"{name}[{k}]", item) for k, item in enumerate(value))

    return checked


def _ordered(check: Check, words: str, sign: int) -> Check:
    """Lists that rise, or fall: grids from coarse to fine."""
    listed = _list_of(check, words)

    def checked(name: str, value: Any) -> tuple[Any, ...]:
        found = listed(name, value)
        if any(sign * a >= sign * b for a, b in pairwise(found)):
            raise ValueError(f"{name} must go from coarse to fine, got {checks.shown(list(value))}")
        return found

    return checked


def _whole(name: str, value: Any) -> int:
    return checks.integer(name, value, minimum=1, maximum=10**9)


def _factor(name: str, value: Any) -> float:
    return checks.quantity(name, value, positive=True)


def _count(name: str, value: Any) -> int:
    return checks.integer(name, value, maximum=10**9)


def _seed(name: str, value: Any) -> int:
    return checks.integer(name, value)


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"{name} must be true or false, got {checks.shown(value)}")
    return value


def _length(name: str, value: Any) -> float:
    return checks.quantity(name, value, positive=True)


def _omega(name: str, value: Any) -> float:
    omega = checks.number(name, value)
    if not 0 < omega < 2:
        raise ValueError(f"{name} must lie between 0 and 2 (both excluded), got {checks.shown(value)}")
    return omega


def _share(name: str, value: Any) -> float:
    share = checks.number(name, value)
    if not 0 < share < 1:
        raise ValueError(f"{name} must be > 0 and < 1, got {checks.shown(value)}")
    return share


def _strength(name: str, value: Any) -> float:
    strength = checks.nonnegative(name, value)
    if not strength < 1:
        raise ValueError(f"{name} must be >= 0 and < 1, got {checks.shown(value)}")
    return strength


def _lag(name: str, value: Any) -> int:
    return checks.integer(name, value, minimum=-1, maximum=10**9)


def _ratio(name: str, value: Any) -> float:
    ratio = checks.quantity(name, value)
    if not ratio >= 1:
        raise ValueError(f"{name} must be >= 1, got {checks.shown(value)}")
    return ratio


def _factors(name: str, value: Any) -> Any:
    return _list_of(checks.quantity, "factors, one a step")(name, value) if isinstance(value, list | tuple) else \
        checks.quantity(name, value)


def plain(name: str, value: Any) -> Any:
    """Any value that can be a parameter; lists become tuples."""
    if isinstance(value, list | tuple):
        return tuple(plain(f"{name}[{k}]", item) for k, item in enumerate(value))
    if isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{name} must be a number, text, true, false, or a list of those, got {checks.shown(value)}")


_point = _list_of(checks.quantity, "coordinates in m")
_points = _list_of(_point, "points")


def _point_or_points(name: str, value: Any) -> Any:
    several = isinstance(value, list | tuple) and value and isinstance(value[0], list | tuple)
    return (_points if several else _point)(name, value)


_names = _list_of(checks.boundary_name, "names")


def _named(names: Iterable[str], meaning: str, default: str) -> Key:
    return Key(_one_of(names), " | ".join(map(str, names)), meaning, default)


SECTIONS: dict[str, dict[str, Key]] = {
    "case": {
        "case": Key(checks.boundary_name, "name", "the problem, see 'adaptmg cases'"),
        "law": _named(LawName, "contact law", "that of the case"),
        "friction": Key(checks.nonnegative, ">= 0", "coefficient of Coulomb friction", "that of the case"),
        "limit": Key(checks.nonnegative, "Pa", "Tresca limit"),
    },
    "hierarchy": {
        "divisions": Key(_ordered(_whole, "whole numbers", 1), "list",
                         "uniform nested grids of rectangles and boxes: cells a side, coarse to fine",
                         "[4, 8, 16, 32], in 3D [2, 4, 8]"),
        "sizes": Key(_ordered(_length, "sizes in m", -1), "list, m",
                     "independent, non-nested meshes of any shape instead: element sizes, coarse to fine"),
        "contact_ratio": Key(_ratio, ">= 1", "with sizes: size away from contact over size at contact", "1"),
        "size_of": Key(_factor, "factor", "with sizes, several bodies, such as size_of = {block = 2}: sizes of this "
                       "body over those", "1", named=True),
        "bisections": Key(_whole, "whole number", "how often elements at contact are bisected: nested grids on a "
                          "single one of divisions or sizes"),
        "transfer": _named(TransferName, "with sizes: transfer between the meshes", "interpolation"),
    },
    "solver": {
        "method": _named(SolverName, "full-multigrid has a nested start, multigrid starts from zero", "full-multigrid"),
        "correction": _named(CorrectionName, "multigrid: truncated is the fast one, monotone is proven, paper is that "
                             "of the paper", "truncated; monotone with cycle, pre, post, omega or order"),
        "cycle": _named(Shape, "multigrid: shape of the cycle of the monotone and the paper's correction", "V"),
        "pre": Key(_count, "whole number", "multigrid: sweeps before the correction", "2"),
        "post": Key(_count, "whole number", "multigrid: sweeps after the correction", "0"),
        "omega": Key(_omega, "0 to 2", "relaxation of the sweeps", "1"),
        "order": _named(Sweeping, "order of the nodes in a sweep (multigrid)", "forward"),
        "gap": _named(("smallest", "largest", "injected"), "correction paper: opening of coarse nodes", "smallest"),
        "slip": _named(("initial", "injected", "minmod"), "correction paper: slip of coarse nodes", "initial"),
        "sliding_limit": _named(("initial", "injected", "summed"), "correction paper: limit of coarse ones", "initial"),
        "condensed": Key(_flag, "true | false", "single-grid: sweep on the contact line alone, the rest eliminated",
                         "false"),
        "linear": _named(LinearName, "active-set: linear solver", "direct"),
        "strength": Key(_strength, "0 to 1", "linear amg: drop tolerance of the strength of connection", "0"),
        "lag": Key(_lag, "whole number, or -1", "linear amg: the hierarchy is kept while at most so many dofs have "
                   "come or gone; -1: never", "8"),
        "rtol": Key(checks.tolerance, "0 to 1", "tolerance: estimated relative algebraic error in the energy "
                    "norm", "1e-8; active-set 1e-10"),
        "max_cycles": Key(_whole, "whole number", "cycles, sweeps or Newton steps at most",
                          "100; single-grid 200000, active-set 60"),
    },
    "adapt": {
        "start": Key(_length, "m", "element size of the first mesh", "an eighth of a body"),
        "indicator": _named((*IndicatorName, "goal"), "what estimates the error; goal: of one quantity", "residual"),
        "engine": _named(EngineName, "meshes made anew by sizes, or marked elements bisected", "remesh"),
        "mark": _named(MarkName, "which elements are marked", "doerfler"),
        "theta": Key(_share, "0 to 1", "doerfler: share of the squared estimate that is marked; "
                     "maximum: share of the largest above which an element is", "0.5"),
        "coarsen": Key(_share, "0 to 1", "bisect: elements become coarser that hold this share of what "
                       "the marked ones hold", "none do"),
        "goal": _named(GoalName, "indicator goal: the quantity", ""),
        "goal_boundary": Key(checks.boundary_name, "name", "where, for mean-displacement, contact-force and opening",
                             "contact"),
        "goal_point": Key(_point_or_points, "[x, y], m", "where, for displacement, which also takes a list of points, "
                          "and opening", "opening: its mean"),
        "goal_component": _named(("x", "y", "z", "normal", "tangential"), "of displacement, mean-displacement, "
                                 "contact-force", "contact-force: normal"),
        "tolerance": Key(checks.tolerance, "0 to 1", "stop when the estimate is so small, relative"),
        "max_nodes": Key(_whole, "whole number", "stop before a mesh has more nodes"),
        "max_seconds": Key(checks.positive, "s", "begin no step after so long"),
    },
    "load_path": {
        "default": Key(_factors, "factor, or list", "factor of what is not named", "1"),
    },
    "measure": {
        "columns": Key(_names, "list", "measures in the table", '["cycles", "work_units", "residual", '
                       '"nodes"]'),
        "forces_on": Key(_names, "list", "boundaries: resultant force on each, N or N/m, columns 'force_x(NAME)'"),
        "points": Key(_point, "[x, y], m", "named points, such as points = {A = [0.0, 0.0]}: displacement "
                      "there, m, columns 'A.x' and so on", named=True),
        "keep": Key(_flag, "true | false", "keep the result of the last step in the folder "
                    "STORE.files (am.Result.load)", "false"),
    },
    "run": {
        "workers": Key(_whole, "whole number", "processes on this machine", "this process"),
        "limit_s": Key(checks.positive, "s", "with workers: a run that takes longer is stopped and recorded as failed"),
        "memory_limit": Key(checks.positive, "bytes", "with workers: the same for memory"),
        "cost": Key(checks.boundary_name, "setting, measure, or \"seconds\"", "runs where it is largest go first"),
    },
    "design": {
        "kind": _named(("grid", "zip", "random", "latin-hypercube", "sobol"), "every combination of values; lists side "
                       "by side; samples of ranges [low, high]", "grid"),
        "runs": Key(_whole, "whole number", "samples: how many points"),
        "seed": Key(_seed, "whole number", "samples: the same seed gives the same points", "0"),
        "log": Key(_names, "list", "samples: settings on a logarithmic scale"),
        "repeats": Key(_whole, "whole number", "how often each point is run: a parameter 'repeat' counts them", "1"),
    },
    "vary": {},
}
#: sections whose keys are settings of a run, which [vary] can name
SETTINGS = ("case", "hierarchy", "solver", "adapt", "load_path")
#: what sections are for
WORDS = {
    "case": "which problem; beside these keys its own arguments, see 'adaptmg cases NAME'",
    "hierarchy": "grids; without it the default divisions",
    "solver": "method; without it full multigrid, truncated, to 1e-8",
    "adapt": "instead of [hierarchy]: meshes that follow the error, until one of the limits",
    "load_path": "load steps: factors by boundary or body, NAME = [0.5, 1.0], one a step",
    "measure": "what the table shows, beside the outcome; it may be empty",
    "run": "how runs are computed",
    "design": "which points",
    "vary": "settings and their values, \"solver.pre\" = [1, 2, 4]; samples: their ranges [low, high]",
}
#: sections that take keys beside those, with the check of their values; those of [case] by its arguments
OPEN: dict[str, Check] = {"case": plain, "load_path": _factors}


def case_run(**settings: Any) -> dict[str, Any]:
    """One run.

    Parameters
    ----------
    settings
        By ``"section.key"`` of the study file.

    Returns
    -------
    dict
        How it ended, the columns of ``measure.columns``, forces and displacements that are asked for, and the result
        if ``measure.keep`` is true.
    """
    columns = settings.get("measure.columns", ("cycles", "work_units", "residual", "nodes"))
    solved = _solved(settings)
    measured = {name: MEASURES[name](solved) for name in dict.fromkeys(("outcome", *columns))}
    measured |= at_boundaries(solved, settings.get("measure.forces_on", ()))
    measured |= at_points(solved, section(settings, "measure.points"))
    return measured | ({"result": solved.result} if settings.get("measure.keep") else {})


def _solved(settings: Settings) -> Solved:
    problem, path = problem_of(settings), load_path(settings)
    if section(settings, "adapt"):
        steps = list(am.adapt(problem, **adaptation(problem, settings)))
        return Solved(steps[-1].result, len(steps), sum(step.result.cycles for step in steps),
                      float(steps[-1].total_work_units), steps[-1].estimate.relative)
    levels, solver = grids(problem, settings), solver_of(settings)
    if path is None:
        result = am.solve(levels, solver, throw=False)
        return Solved(result, 1, result.cycles, result.work_units)
    results = am.solve_path(levels, path, solver, throw=False)
    return Solved(results[-1], len(results), sum(r.cycles for r in results), sum(r.work_units for r in results))


_DIVISIONS = {2: (4, 8, 16, 32), 3: (2, 4, 8)}
#: nodes of uniform grids that are refused before anything runs
_MOST_NODES = {2: 5e6, 3: 2e6}
#: the same of graded ones, whose domains fill a part of their boxes; elements along contact
_MOST_ROUGHLY, _MOST_ALONG = 10.0, 1e5
#: times that the elements at contact can be bisected
_MOST_BISECTIONS = 30
_TRANSFERS = {TransferName.INTERPOLATION: am.Interpolation, TransferName.L2: am.L2, TransferName.LUMPED: am.LumpedL2,
              TransferName.PSEUDO: am.PseudoL2, TransferName.QUASI: am.QuasiInterpolation}


def check_grids(task: am.ContactProblem, settings: Settings) -> None:
    """ValueError for grids that cannot be made, or that would take hours."""
    given = section(settings, "hierarchy")
    if section(settings, "adapt"):
        if given:
            raise ValueError("give [hierarchy] or [adapt], not both: adaptation makes its own meshes")
        return
    _check_bisections(given)
    if "sizes" not in given:
        _check_divisions(task, given)
        return
    if "divisions" in given:
        raise ValueError("give hierarchy.divisions or hierarchy.sizes, not both")
    check_size(task, "hierarchy.sizes", max(given["sizes"]))
    factors = _size_factors(given)
    for name in factors:
        if name not in _bodies(task):
            known = ", ".join(filter(None, _bodies(task)))
            raise ValueError(f"hierarchy.size_of.{name}: the case has no such body" + (
                f"{checks.suggestion(name, _bodies(task))}; it has {known}" if known else ", it has one alone"))
    for name, part in _bodies(task).items():
        _check_finest(task.dim, part, min(given["sizes"]) * factors.get(name, 1.0), given.get("contact_ratio", 1.0))


def _check_bisections(given: dict[str, Any]) -> None:
    if "bisections" not in given:
        return
    if given["bisections"] > _MOST_BISECTIONS:
        raise ValueError(f"hierarchy.bisections must be at most {_MOST_BISECTIONS}, got {given['bisections']}")
    if "transfer" in given:
        raise ValueError("hierarchy.transfer belongs to meshes that are not nested; those of hierarchy.bisections are")
    for key in ("divisions", "sizes"):
        if len(given.get(key, (1,))) > 1:
            raise ValueError(f"hierarchy.bisections make the finer grids: give one of hierarchy.{key}, got "
                             f"{len(given[key])}")
    if "divisions" not in given and "sizes" not in given:
        raise ValueError("hierarchy.bisections need a grid to begin with: hierarchy.divisions = [8], or "
                         "hierarchy.sizes = [5e-3]")


def _check_divisions(task: am.ContactProblem, given: dict[str, Any]) -> None:
    if useless := sorted(set(given) - {"divisions", "bisections"}):
        raise ValueError(f"hierarchy.{useless[0]} belongs to hierarchy.sizes (independent, non-nested meshes)")
    parts = _bodies(task).values()
    if not all(isinstance(part, am.Rectangle | am.Box) for part in parts):
        raise ValueError("hierarchy.divisions are for rectangles and boxes, which this case is not: give "
                         "hierarchy.sizes = [10e-3, 5e-3] (element sizes in m, coarse to fine)")
    finest = max(given.get("divisions", (1,)))
    nodes = len(parts) * (finest + 1.0)**task.dim
    if nodes > _MOST_NODES[task.dim]:
        raise ValueError(f"hierarchy.divisions: {finest} cells a side make {nodes:.2g} nodes, at most "
                         f"{_MOST_NODES[task.dim]:.2g} are run in a study: take fewer")


def check_size(task: am.ContactProblem, name: str, size: float) -> None:
    """Most sizes that are too large are in millimetres."""
    longest = max(float((part.upper - part.lower).max()) for part in _bodies(task).values())
    if size > longest:
        raise ValueError(f"{name} = {size:g} m is more than the body is long ({longest:g} m): sizes are in m, such as "
                         f"{longest / 4:g}")


def _check_finest(dim: int, part: Any, size: float, ratio: float) -> None:
    """Sizes of which Netgen would make elements for hours."""
    nodes = float(np.prod((part.upper - part.lower) / size))
    along = float((part.upper - part.lower).max()) / size * ratio
    if nodes > _MOST_ROUGHLY * _MOST_NODES[dim] or along > _MOST_ALONG:
        at_contact = f" ({size / ratio:g} m at contact)" if ratio > 1 else ""
        raise ValueError(f"hierarchy.sizes, down to {size:g} m{at_contact}, make "
                         f"some {max(nodes, along):.0e} nodes: at most {_MOST_NODES[dim]:.0e} are run in a study")


def grids(task: am.ContactProblem, settings: Settings) -> am.Hierarchy:
    """Uniform grids; independent ones where sizes are given; or one of either, bisected at contact."""
    check_grids(task, settings)
    given = section(settings, "hierarchy")
    if "sizes" in given:
        factors = _size_factors(given)
        sizes = [{name: size * factors.get(name, 1.0) for name in _bodies(task)} if factors else size
                 for size in given["sizes"]]
        made = am.Hierarchy.graded(task, sizes, given.get("contact_ratio", 1.0),
                                   transfer=_TRANSFERS[given.get("transfer", TransferName.INTERPOLATION)]())
    else:
        made = am.Hierarchy.uniform(task, divisions=given.get("divisions", _DIVISIONS[task.dim]))
    if "bisections" in given:
        return am.Hierarchy.bisected(task, made.levels[0].mesh, given["bisections"])
    return made


def _size_factors(given: dict[str, Any]) -> dict[str, float]:
    """What the sizes of bodies are taken times."""
    return section(given, "size_of")


def _bodies(task: am.ContactProblem) -> dict[str, Any]:
    """Domains by name of body; of one alone the name is empty."""
    return getattr(task.domain, "parts", {"": task.domain})


@dataclass(frozen=True)
class Solved:
    """What there is to measure.

    Attributes
    ----------
    result : Result
        Of the last load step, on the last mesh.
    steps : int
        Load steps, or meshes of an adaptive solve; 1 otherwise.
    cycles, work_units : float
        Of all of them.
    estimate : float or None
        Relative, of the last mesh of an adaptive solve.

    Notes
    -----
    A load path ends with the first step that does not converge, so that the last result says it.
    """

    result: Result
    steps: int
    cycles: int
    work_units: float
    estimate: float | None = None

    @property
    def outcome(self) -> str:
        """The name of the status."""
        return self.result.status.name


def _states(solved: Solved, name: str) -> int:
    from adaptmg.smoother import system

    return int((solved.result.contact.state == getattr(system, name)).sum())


def _along(solved: Solved, boundary: str = "contact") -> dict[str, float | None]:
    """Components of the force on a boundary; None for the third in 2D."""
    force = solved.result.resultant(boundary).force
    return {axis: float(force[k]) if k < len(force) else None for k, axis in enumerate("xyz")}


def _largest(values: Any) -> float:
    """The largest size of a number or vector, 0 of none."""
    import numpy as np

    sizes = np.linalg.norm(values, axis=1) if values.ndim > 1 else np.abs(values)
    return float(sizes.max(initial=0.0))


def _in_contact(solved: Solved, name: str) -> Any:
    """A contact quantity at the nodes that are not open."""
    from adaptmg.smoother.system import OPEN

    contact = solved.result.contact
    return getattr(contact, name)[contact.state != OPEN]


#: name -> function of :class:`Solved`; SI units; :mod:`adaptmg.cli.output` says what they are
MEASURES: dict[str, Callable[[Solved], Any]] = {
    "outcome": lambda s: s.outcome,
    "cycles": lambda s: s.cycles,
    "work_units": lambda s: s.work_units,
    "start_work_units": lambda s: s.result.start_work_units,
    "solve_seconds": lambda s: s.result.seconds,
    "residual": lambda s: s.result.residual,
    "error_estimate": lambda s: s.result.error_estimate,
    "energy_error": lambda s: s.result.certificate().energy_error,
    "violation": lambda s: s.result.certificate().worst.relative,
    "estimate": lambda s: s.estimate,
    "rate": lambda s: s.result.rate,
    "steps": lambda s: s.steps,
    "levels": lambda s: len(s.result.levels),
    "nodes": lambda s: len(s.result.displacement),
    "contact_nodes": lambda s: len(s.result.contact),
    "open": lambda s: _states(s, "OPEN"),
    "slip": lambda s: _states(s, "SLIP"),
    "stick": lambda s: _states(s, "STICK"),
    "contact_area": lambda s: float(_in_contact(s, "weights").sum()),
    "max_pressure": lambda s: float(s.result.contact.pressure.max()),
    "max_traction": lambda s: _largest(s.result.contact.traction),
    "max_slip": lambda s: _largest(_in_contact(s, "slip")),
    "max_gap": lambda s: float(s.result.contact.gap.max()),
    "max_displacement": lambda s: _largest(s.result.displacement),
    "max_von_mises": lambda s: float(s.result.von_mises().max()),
    "force_x": lambda s: _along(s)["x"],
    "force_y": lambda s: _along(s)["y"],
    "force_z": lambda s: _along(s)["z"],
}


def at_boundaries(solved: Solved, names: tuple[str, ...]) -> dict[str, float]:
    """Resultant forces on boundaries: columns ``force_x(NAME)``, N (2D: N/m)."""
    return {f"force_{axis}({name})": value for name in names for axis, value in _along(solved, name).items()
            if value is not None}


def at_points(solved: Solved, points: dict[str, tuple[float, ...]]) -> dict[str, float]:
    """Displacements at points: columns ``NAME.x``, m."""
    if not points:
        return {}
    found = solved.result.probe(list(points.values()))
    return {f"{name}.{axis}": float(value) for name, row in zip(points, found, strict=True)
            for axis, value in zip("xyz", row, strict=False)}


Settings = Mapping[str, Any]


def section(settings: Settings, name: str) -> dict[str, Any]:
    """The settings of a section, by key."""
    return {key[len(name) + 1:]: value for key, value in settings.items() if key.startswith(f"{name}.")}
