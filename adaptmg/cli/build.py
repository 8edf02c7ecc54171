"""From the settings of the command line, by ``"section.key"``, to a solved case: problem, grids, method, load path and
adaptive loop.

The keys are the arguments of the classes and functions: fields of the option classes, arguments of cases and of the
constructors of :class:`adaptmg.Hierarchy`. An object is chosen by the name of its class (``correction = "monotone"``),
and its fields stand next to it (``pre`` of the cycle, ``friction`` of the law); those of solvers inside a method are
written with a point (``coarse.rtol``). Types, defaults and checks are those of the signatures and classes.
"""

from __future__ import annotations

import dataclasses
import inspect
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.cases import CASES, get
from adaptmg.problem.contact_problem import ELEMENTS
from adaptmg.problem.load_path import names_in_path
from adaptmg.solver.record import Solver
from adaptmg.solver.result import Result
from adaptmg.study.record import Value

Settings = Mapping[str, Value]
#: keyword arguments of a class or function, and what makes an object or a problem from them
Arguments = dict[str, Any]
Maker = Callable[..., object]

METHODS = (am.FullMultigrid, am.Multigrid, am.SingleGrid, am.ActiveSet)
#: classes that an argument of this name takes, the default first
OBJECTS: dict[str, tuple[type, ...]] = {
    "law": (am.Frictionless, am.Coulomb, am.Tresca),
    "transfer": (am.Interpolation, am.L2, am.LumpedL2, am.PseudoL2, am.QuasiInterpolation),
    "cycle": (am.Cycle,), "smoother": (am.ProjectedGaussSeidel,),
    "correction": (am.Truncated, am.Monotone, am.PaperCorrection), "linear": (am.Direct, am.AMG),
    "indicator": (am.Residual, am.Recovery, am.Goal), "mark": (am.Doerfler, am.Maximum),
    "engine": (am.Bisect, am.Remesh),
    "quantity": (am.Displacement, am.MeanDisplacement, am.ContactForce, am.Opening),
    "coarse": (am.CoarseSolve,), "start": (am.NestedStart,)}
#: arguments whose fields are written with a point
_INNER = ("coarse", "start")
#: sections of settings, and their purposes
PURPOSE = {
    "case": "the problem: its name, its law, and its arguments, see 'adaptmg cases NAME'",
    "hierarchy": "grids; without it those that follow the size of the bodies and of the contact boundaries",
    "solver": "method; without it full multigrid, truncated, to 1e-8",
    "adapt": "meshes that follow the error, until one of the limits",
    "load_path": "load steps: factors by boundary or body, one a step",
}
#: grids of rectangles and boxes
_DIVISIONS = {2: (4, 8, 16, 32), 3: (2, 4, 8)}
#: nodes of an adaptive loop of the command line without a limit
_NODES = 3000
#: arguments that settings cannot give
_APART = ("self", "problem", "store", "depends", "progress", "scheduler", "solver", "load_path", "coarse_solve",
          "coarse_smoother", "flanges")


@dataclass(frozen=True)
class Key:
    """A key as the signature of its function or class describes it."""

    values: str  # type or choices
    default: str = ""  # empty where there is none

    @property
    def real(self) -> bool:
        """Whether integers stand for floats."""
        return self.values.startswith("float")


def section(settings: Settings, name: str) -> Arguments:
    """Return the settings of a section, by key."""
    return {key[len(name) + 1:]: value for key, value in settings.items() if key.startswith(f"{name}.")}


def name_of(kind: type) -> str:
    """Return the name of a class in settings: ``PseudoL2`` is pseudo-l2, ``PaperCorrection`` paper."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", kind.__name__).lower().removesuffix("-correction")


def _class_of(argument: str, name: Value, kinds: Sequence[type]) -> type:
    by_name = {name_of(kind): kind for kind in kinds}
    if not isinstance(name, str) or name not in by_name:
        raise ValueError(f"{argument} must be one of {', '.join(by_name)}, got {checks.shown(name)}"
                         f"{checks.suggestion(str(name).lower(), by_name)}")
    return by_name[name]


@cache
def _parameters(function: Maker) -> dict[str, tuple[inspect.Parameter, tuple[type, ...]]]:
    """The arguments that settings can give, each with the classes that it may be."""
    return {name: (item, () if str(item.annotation).startswith(("str", "float")) else OBJECTS.get(name, ()))
            for name, item in inspect.signature(function).parameters.items() if name not in _APART}


def _default_class(name: str, item: inspect.Parameter, kinds: Sequence[type]) -> type | None:
    """The class of an object that is not named; None for a required one, and where the default depends on others."""
    if item.default is item.empty or name == "correction":
        return None
    return next((kind for kind in kinds if type(item.default) is kind), kinds[0])


@cache
def keys_of(function: Maker) -> dict[str, Key]:
    """Return the keys of a class or function: its arguments, and those of the objects that these may be."""
    own, nested = {}, {}
    for name, (item, kinds) in _parameters(function).items():
        if kinds[1:]:
            default = _default_class(name, item, kinds)
            own[name] = Key(" | ".join(map(name_of, kinds)), name_of(default) if default else "")
        elif not kinds:
            own[name] = Key(str(item.annotation).removesuffix(" | None"), _default(item.default))
        for kind in kinds:
            for key, value in keys_of(kind).items():
                if type(item.default) is kind and hasattr(item.default, key):
                    value = Key(value.values, _default(getattr(item.default, key)))
                nested.setdefault(f"{name}.{key}" if name in _INNER else key, value)
    return nested | own


def _default(value: object) -> str:
    if isinstance(value, bool | str):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, int | float) else ""


def arguments_of(function: Maker, values: Arguments, before: str, what: str) -> Arguments:
    """Return keyword arguments of a class or function, and remove them from ``values``. In messages keys begin with
    ``before``, such as "solver.", and ``what`` names the function."""
    arguments: Arguments = {}
    for name, (_, kinds) in _parameters(function).items():
        # objects take the rest
        if not kinds and (table := _taken(values, name)):
            arguments[name] = _by_level(before + name, table)
        elif not kinds and name in values:
            arguments[name] = values.pop(name)
    for name, (item, kinds) in _parameters(function).items():
        if name in _INNER and kinds and (table := _taken(values, name)):
            arguments[name] = _made(kinds[0], table, f"{before}{name}.", name)
        elif kinds and name not in _INNER:
            word = values.pop(name, None)
            kind = _default_class(name, item, kinds) if word is None else _class_of(before + name, word, kinds)
            if kind is not None and (word is not None or set(keys_of(kind)) & set(values)):
                arguments[name] = kind(**arguments_of(kind, values, before, f"{before}{name} {name_of(kind)}"))
        if item.default is item.empty and name not in arguments:
            raise ValueError(f"{what} needs {before}{name}")
    return arguments


def _taken(values: Arguments, name: str) -> Arguments:
    """Remove the settings of a table from ``values``, and return them."""
    table = section(values, name)
    for key in table:
        del values[f"{name}.{key}"]
    return table


def _made(function: Maker, values: Arguments, before: str, what: str,
         others: Sequence[type] = ()) -> Any:
    """Call a class or function with settings; ValueError for settings that it does not take."""
    arguments = arguments_of(function, values, before, what)
    _check_used(values, before, what, keys_of(function), others)
    return function(**arguments)


def _check_used(values: Settings, before: str, what: str, keys: Mapping[str, Key],
                others: Sequence[type] = ()) -> None:
    for key in values:
        owners = [f"{before}{name} {name_of(kind)}" for name, kinds in OBJECTS.items() for kind in kinds
                  if name in keys and key in _parameters(kind)] or [
                  name_of(kind) for kind in others if key in keys_of(kind)]
        raise ValueError(f"{before}{key} has no meaning for {what}" + (
            f": it belongs to {' or '.join(owners)}" if owners else f"; it takes {', '.join(keys)}"))


def _by_level(name: str, table: Arguments) -> Arguments | list[Arguments]:
    """Values by name of body; lists of them, coarse to fine, become one such table a level."""
    lists = [value for value in table.values() if isinstance(value, tuple)]
    if not lists:
        return table
    if len(lists) < len(table) or len(set(map(len, lists))) > 1:
        raise ValueError(f"{name} must have lists of one length, got {checks.shown(table)}")
    return [dict(zip(table, row, strict=True)) for row in zip(*lists, strict=True)]


def problem_of(values: Arguments) -> am.ContactProblem:
    """Return the problem of a case with its arguments and elements; friction or limit alone choose the law."""
    name, elements = values.pop("case"), values.pop("elements", ELEMENTS[0])
    function = get(name).function
    if "law" not in values and "law" in _parameters(function) and {"friction", "limit"} & set(values):
        values["law"] = "coulomb" if "friction" in values else "tresca"
    return dataclasses.replace(_made(function, values, "case.", f"the case {name}"), elements=elements)


@cache
def sections() -> dict[str, dict[str, Key]]:
    """Return all sections with their keys; of the case those of all cases."""
    return {
        "case": {"case": Key("name"), "elements": Key(" | ".join(ELEMENTS), ELEMENTS[0]),
                 "law": Key(" | ".join(map(name_of, OBJECTS["law"])), "that of the case"),
                 **{key: value for kind in OBJECTS["law"] for key, value in keys_of(kind).items()}},
        "hierarchy": {**keys_of(am.Hierarchy.uniform), **keys_of(am.Hierarchy.graded)},
        "solver": {"method": Key(" | ".join(map(name_of, METHODS)), name_of(METHODS[0])),
                   **{name: key for kind in reversed(METHODS) for name, key in keys_of(kind).items()}},
        "adapt": keys_of(am.adapt),
        "load_path": {"default": keys_of(am.LoadPath)["default"]}}


def case_keys(name: str) -> dict[str, Key]:
    """Return the keys of [case] for a case."""
    return {key: sections()["case"][key] for key in ("case", "elements")} | keys_of(get(name).function)


def from_texts(case: str, texts: Mapping[str, str], adaptive: bool = False) -> dict[str, Value]:
    """Return the settings that the options of a command give as texts; lists have commas, and whole numbers are floats
    where an argument is one."""
    tables, settings = sections() | {"case": case_keys(case) | sections()["case"]}, {"case.case": case}
    del tables["hierarchy" if adaptive else "adapt"]
    for name, text in texts.items():
        part, _, key = name.partition(".")
        keys = tables.get(part, {})
        # values by name, such as hierarchy.sizes.upper, have a key after the argument
        head = keys.get(key.partition(".")[0], Key(""))
        if not (key in keys or ("." in key and "Mapping" in head.values) or (part == "load_path" and key)):
            raise ValueError(f"there is no argument {name!r}{checks.suggestion(key, keys)}; there are "
                             f"{', '.join(keys)}")
        value, about = _value_of(text), keys.get(key, Key(""))
        if about.values.startswith("Sequence") and not isinstance(value, tuple):
            value = (value,)
        settings[name] = float(value) if type(value) is int and about.real and abs(value) < 1e300 else value
    if adaptive and not {"adapt.tolerance", "adapt.max_nodes", "adapt.max_seconds"} & set(settings):
        settings["adapt.max_nodes"] = _NODES
    return settings


def _value_of(text: str) -> Value:
    if "," in text:
        return tuple(_value_of(part.strip()) for part in text.split(","))
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def load_path(settings: Settings) -> am.LoadPath | None:
    """Return the load path, if there is one."""
    factors = section(settings, "load_path")
    return am.LoadPath({key: value for key, value in factors.items() if key != "default"},
                       factors.get("default", 1.0)) if factors else None


def solver_of(values: Arguments) -> Solver:
    """Return the method; ``max_cycles`` stands for the limit of each."""
    name = values.pop("method", name_of(am.FullMultigrid))
    kind = _class_of("solver.method", name, METHODS)
    if "max_cycles" in values:
        values[next(key for key in _parameters(kind) if key.startswith("max_"))] = values.pop("max_cycles")
    return _made(kind, values, "solver.", f"solver.method {name}", METHODS)


def adaptation(settings: Settings) -> Arguments:
    """Return the arguments of :func:`adaptmg.adapt` after the problem."""
    values = section(settings, "adapt")
    arguments = arguments_of(am.adapt, values, "adapt.", "[adapt]")
    _check_used(values, "adapt.", "this loop", keys_of(am.adapt))
    solver = section(settings, "solver")
    return {**arguments, "load_path": load_path(settings), "solver": solver_of(solver) if solver else None}


def grids(task: am.ContactProblem, values: Arguments) -> am.Hierarchy:
    """Return uniform grids, or independent ones where sizes are given."""
    sized, divided = (any(key.split(".")[0] == name for key in values) for name in ("sizes", "divisions"))
    if sized and divided:
        raise ValueError("give hierarchy.divisions or hierarchy.sizes, not both")
    blocks = all(isinstance(part, am.Rectangle | am.Box) for part in getattr(task.domain, "parts",
                                                                             {"": task.domain}).values())
    if blocks and not (sized or divided):
        values = {"divisions": _DIVISIONS[task.dim]} | values
    uniform = divided or (blocks and not sized)
    constructor = am.Hierarchy.uniform if uniform else am.Hierarchy.graded
    what = "uniform grids (without hierarchy.sizes)" if uniform else "hierarchy.sizes"
    arguments = arguments_of(constructor, values, "hierarchy.", what)
    _check_used(values, "hierarchy.", what, keys_of(constructor))
    return constructor(task, **arguments)


@dataclass(frozen=True)
class Solved:
    """What the settings of a run give."""

    result: Result  # of the last step
    grids: am.Hierarchy  # of the last step
    steps: list[am.Step]  # of an adaptive loop


def solved(settings: Settings, callback: Callable[[dict[str, float]], None] | None = None,
           each: Callable[[am.Step], None] | None = None, store: str | os.PathLike[str] | None = None) -> Solved:
    """Solve once, along a load path, or on meshes that follow the error. ``callback`` is given the progress, ``each``
    of every step of an adaptive loop, which ``store`` keeps."""
    problem, path = problem_of(section(settings, "case")), load_path(settings)
    if section(settings, "adapt"):
        steps = []
        for step in am.adapt(problem, **adaptation(settings), progress=callback, store=store):
            steps.append(step)
            if each is not None:
                each(step)
        return Solved(steps[-1].result, steps[-1].hierarchy, steps)
    # the method first: what is refused is refused before anything is meshed
    solver, levels = solver_of(section(settings, "solver")), grids(problem, section(settings, "hierarchy"))
    result = (am.solve(levels, solver, throw=False, callback=callback) if path is None else
              am.solve_path(levels, path, solver, throw=False)[-1])
    return Solved(result, levels, [])


def case_facts(name: str) -> dict[str, object]:
    """Return arguments, boundaries and loads of a case as JSON takes them."""
    posed = get(name).function()
    return {"name": name, "description": CASES[name].description, "dimension": posed.dim,
            "arguments": {key: dataclasses.asdict(item) for key, item in case_keys(name).items()},
            "boundaries": list(posed.domain.boundaries), "contact": list(posed.pair_boundaries),
            "loads": list(names_in_path(posed))}


def about_case(name: str) -> str:
    """Return arguments, boundaries and loads of a case as text, and what its function says of itself."""
    facts = case_facts(name)
    arguments = [f"  {key:<15} {item.values}{f', default {item.default}' if item.default else ''}"
                 for key, item in case_keys(name).items()]
    lists = [f"  {key:<15} {', '.join(facts[key])}" for key in ("boundaries", "contact", "loads")]
    return "\n".join([f"{name}: {facts['description']}", "", "Arguments (--set NAME=VALUE):", *arguments, "", *lists,
                      "", inspect.getdoc(get(name).function) or ""]).rstrip()
