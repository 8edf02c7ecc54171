"""From the options of the command line to a solved case: problem, grids, method and adaptive loop.

The keys are the arguments of the classes and functions: fields of the option classes, arguments of
cases and of the constructors of :class:`adaptmg.Hierarchy`. An object is chosen by the name of its
class (``correction = "monotone"``), and its fields stand next to it (``pre`` of the cycle,
``friction`` of the law). Types, defaults and checks are those of the signatures and classes."""

from __future__ import annotations

import dataclasses
import inspect
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise
from typing import Any, cast

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.cases import get
from adaptmg.problem.contact_problem import ELEMENTS
from adaptmg.problem.load_path import names_in_path
from adaptmg.solver.record import Solver
from adaptmg.solver.result import Result

#: keyword arguments of a class or function, and what makes an object or a problem from them
Arguments = dict[str, Any]
Maker = Callable[..., Any]

METHODS = (am.FullMultigrid, am.Multigrid, am.SingleGrid, am.ActiveSet)
#: classes that an argument of this name takes, the default first
OBJECTS: dict[str, tuple[type, ...]] = {
    "law": (am.Frictionless, am.Coulomb, am.Tresca),
    "transfer": (am.Interpolation, am.L2, am.LumpedL2, am.PseudoL2, am.QuasiInterpolation),
    "cycle": (am.Cycle,),
    "smoother": (am.ProjectedGaussSeidel,),
    "correction": (am.Truncated, am.Monotone, am.PaperCorrection),
    "linear": (am.Direct, am.AMG),
    "indicator": (am.Residual, am.Recovery, am.Goal),
    "mark": (am.Doerfler, am.Maximum),
    "engine": (am.Bisect, am.Remesh),
    "quantity": (
        am.Displacement,
        am.MeanDisplacement,
        am.ContactForce,
        am.Opening,
        am.PeakPressure,
        am.Dissipation,
    ),
}
#: sections of settings, and their purposes
PURPOSE = {
    "case": "the problem: its name, its law, and its arguments, see 'adaptmg cases NAME'",
    "hierarchy": "grids; without it those that follow the size of the bodies and of the contact boundaries",
    "solver": "method; without it full multigrid, truncated, to 1e-8",
    "adapt": "meshes that follow the error, until one of the limits",
}
#: grids of rectangles and boxes
_DIVISIONS = {2: (4, 8, 16, 32), 3: (2, 4, 8)}
#: nodes of an adaptive loop of the command line without a limit
_NODES = 3000
#: what types are called on the command line; arguments of other types are left to Python, but for OBJECTS
_WORDS = {
    "str": "name",
    "checks.Name": "name",
    "int": "whole number",
    "checks.Whole": "whole number",
    "checks.Count": "whole number",
    "PastIterates": "whole number",
    "Component": "whole number or name",
    "float": "number",
    "checks.Positive": "number",
    "checks.Nonnegative": "number",
    "checks.Tolerance": "number",
    "ToleranceOrName": "number or {discretisation}",
    "Growth": "number",
    "Omega": "number",
    "Share": "number",
    "FieldLike": "number",
    "FieldLikeOrArray": "number",
    "bool": "{true, false}",
    "checks.Flag": "{true, false}",
    "MeshLike": "file",
    "Sequence": "list of numbers",
}


@dataclass(frozen=True)
class Key:
    """A key as the signature of its function or class describes it."""

    values: str  # words for its type, or its choices in braces
    default: str = ""  # empty where there is none


def name_of(kind: type) -> str:
    """Return the name of a class in settings: ``PseudoL2`` is pseudo-l2, ``PaperCorrection``
    paper."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", kind.__name__).lower().removesuffix("-correction")


def _class_of(argument: str, name: object, kinds: Sequence[type]) -> type:
    """Return the class of a name in settings; ValueError if it is none of ``kinds``."""
    by_name = {name_of(kind): kind for kind in kinds}
    if name not in by_name:
        raise ValueError(
            f"{argument} must be one of {', '.join(by_name)}, got {checks.shown(name)}"
            f"{checks.suggestion(str(name).lower(), by_name)}"
        )
    return by_name[cast("str", name)]


@cache
def _parameters(function: Maker) -> dict[str, tuple[inspect.Parameter, tuple[type, ...]]]:
    """Return the arguments that settings can give, each with the classes that it may be an object of:
    () for numbers and texts."""
    result = {}
    for name, item in inspect.signature(function).parameters.items():
        if name == "store":  # a folder, which is an option of its own
            continue
        if str(item.annotation).startswith(("Literal", *_WORDS)):
            result[name] = (item, ())
        elif name in OBJECTS:
            result[name] = (item, OBJECTS[name])
    return result


def _default_class(name: str, item: inspect.Parameter, kinds: Sequence[type]) -> type | None:
    """Return the class of an object that settings do not name; None for a required argument, and
    where the default depends on other arguments."""
    if item.default is item.empty or name == "correction":
        return None
    return next((kind for kind in kinds if type(item.default) is kind), kinds[0])


@cache
def keys_of(function: Maker) -> dict[str, Key]:
    """Return the keys of a class or function: its arguments, and those of the objects that these
    may be."""
    keys = {}
    keys_of_objects = {}
    for name, (item, kinds) in _parameters(function).items():
        if not kinds:
            keys[name] = Key(_words(item), _default(item.default))
        elif len(kinds) > 1:  # an object of a single class is given by its arguments alone
            default = _default_class(name, item, kinds)
            keys[name] = Key(_choices(map(name_of, kinds)), name_of(default) if default else "")
        for kind in kinds:
            for key, value in keys_of(kind).items():
                if type(item.default) is kind and hasattr(item.default, key):
                    value = Key(value.values, _default(getattr(item.default, key)))
                keys_of_objects.setdefault(key, value)
    return keys_of_objects | keys


def _choices(names: Iterable[str]) -> str:
    return f"{{{', '.join(names)}}}"


def _words(item: inspect.Parameter) -> str:
    """Return the choices of an argument, or words for its types."""
    words = []
    for kind in str(item.annotation).split(" | "):
        name, _, values = kind.partition("[")
        choices = _choices(re.findall(r"'(.*?)'", values))
        words.append(choices if name == "Literal" else _WORDS.get(name))
    return " or ".join(dict.fromkeys(filter(None, words)))


def _default(value: object) -> str:
    """Return a default as text, numbers to six digits, which hold every default; "" for objects and
    None."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return f"{value:g}"
    return value if isinstance(value, str) else ""


def arguments_of(function: Maker, values: Arguments, prefix: str, what: str) -> Arguments:
    """Return keyword arguments of a class or function, and remove them from ``values``; objects
    take the keys that it does not take itself. In messages keys begin with ``prefix``, such as
    "solver.", and ``what`` names the function."""
    parameters = _parameters(function)
    arguments = {
        name: values.pop(name)
        for name, (_, kinds) in parameters.items()
        if not kinds and name in values
    }
    for name, (item, kinds) in parameters.items():
        if kinds:
            class_name = values.pop(name, None)
            if class_name is None:
                kind = _default_class(name, item, kinds)
                # by default only an object of which a field is given
                kind = kind if kind and set(keys_of(kind)) & set(values) else None
            else:
                kind = _class_of(prefix + name, class_name, kinds)
            if kind is not None:
                named = f"{prefix}{name} {name_of(kind)}"
                arguments[name] = kind(**arguments_of(kind, values, prefix, named))
        if item.default is item.empty and name not in arguments:
            raise ValueError(f"{what} needs {prefix}{name}")
    return arguments


def _made_with_settings(function: Maker, values: Arguments, prefix: str, what: str) -> Any:
    """Call a class or function with settings, which are removed from ``values``; ValueError for one that
    it does not take. ``prefix`` and ``what`` are words of messages, as in :func:`arguments_of`."""
    arguments = arguments_of(function, values, prefix, what)
    for unknown in values:  # all that arguments_of has left
        owners = [
            f"{prefix}{name} {name_of(kind)}"
            for name, (_, kinds) in _parameters(function).items()
            for kind in kinds
            if unknown in keys_of(kind)
        ]
        remedy = (
            f": it belongs to {' or '.join(owners)}"
            if owners
            else f"; it takes {', '.join(keys_of(function))}"
        )
        raise ValueError(f"{prefix}{unknown} has no meaning for {what}{remedy}")
    return function(**arguments)


def problem_of(values: Arguments) -> am.ContactProblem:
    """Return the problem of a case with its arguments and elements. Where no law is named, friction
    means Coulomb's and limit Tresca's."""
    name = values.pop("case")
    elements = values.pop("elements", ELEMENTS[0])
    case = get(name)
    function = case.function
    if case.call:
        raise ValueError(
            f"the command line does not solve the case {name!r}: in Python, "
            f"problem = am.cases.{name}() is solved by {case.call}"
        )
    has_law = "law" in _parameters(function)
    if has_law and "law" not in values and {"friction", "limit"} & set(values):
        values["law"] = "coulomb" if "friction" in values else "tresca"
    return dataclasses.replace(
        _made_with_settings(function, values, "case.", f"the case {name}"), elements=elements
    )


@cache
def sections() -> dict[str, dict[str, Key]]:
    """Return all sections with their keys; of the case those of all cases."""
    return {
        "case": {
            "case": Key("name"),
            "elements": Key(_choices(ELEMENTS), ELEMENTS[0]),
            "law": Key(_choices(map(name_of, OBJECTS["law"])), "that of the case"),
            **{key: value for kind in OBJECTS["law"] for key, value in keys_of(kind).items()},
        },
        "hierarchy": {**keys_of(am.Hierarchy.uniform), **keys_of(am.Hierarchy.graded)},
        "solver": {
            "method": Key(_choices(map(name_of, METHODS)), name_of(METHODS[0])),
            **{name: key for kind in reversed(METHODS) for name, key in keys_of(kind).items()},
        },
        "adapt": keys_of(am.adapt),
    }


def case_keys(name: str) -> dict[str, Key]:
    """Return the keys of a case."""
    return {key: sections()["case"][key] for key in ("case", "elements")} | keys_of(
        get(name).function
    )


def from_texts(case: str, texts: Mapping[str, str], adaptive: bool = False) -> dict[str, Arguments]:
    """Return the settings that the options of a command give as texts, by section; lists have
    commas, and whole numbers are floats where an argument is one."""
    tables = sections() | {"case": case_keys(case) | sections()["case"]}
    settings: dict[str, Arguments] = {name: {} for name in tables} | {"case": {"case": case}}
    for name, text in texts.items():
        part, _, key = name.partition(".")
        if key not in tables[part]:
            raise ValueError(
                f"there is no argument {name!r}{checks.suggestion(key, tables[part])}; there are "
                f"{', '.join(tables[part])}"
            )
        value = _value_of(text)
        kind = tables[part][key].values
        if kind.startswith("list") and not isinstance(value, tuple):
            value = (value,)
        if type(value) is int and kind.startswith("number"):
            value = float(value)
        settings[part][key] = value
    if adaptive and not {"tolerance", "max_nodes", "max_seconds"} & set(settings["adapt"]):
        settings["adapt"]["max_nodes"] = _NODES
    return settings


def _value_of(text: str) -> object:
    """Return a number, truth value or tuple of these that a text stands for, else the text."""
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


def solver_of(values: Arguments) -> Solver:
    """Return the method; ``max_cycles`` stands for the limit of each."""
    name = values.pop("method", name_of(am.FullMultigrid))
    kind = _class_of("solver.method", name, METHODS)
    if "max_cycles" in values:
        limit = next(key for key in _parameters(kind) if key.startswith("max_"))
        values[limit] = values.pop("max_cycles")
    return _made_with_settings(kind, values, "solver.", f"solver.method {name}")


def grids(task: am.ContactProblem, values: Arguments) -> am.Hierarchy:
    """Return uniform grids, or independent ones where sizes are given."""
    refinement_of(values)
    parts = getattr(task.domain, "parts", {"": task.domain}).values()
    if "sizes" not in values and all(isinstance(part, am.Rectangle | am.Box) for part in parts):
        values = {"divisions": _DIVISIONS[task.dim]} | values
    if "divisions" in values:
        make = am.Hierarchy.uniform
        what = "uniform grids (without hierarchy.sizes)"
    else:
        make = am.Hierarchy.graded
        what = "hierarchy.sizes"
    return _made_with_settings(partial(make, task), values, "hierarchy.", what)


def refinement_of(values: Arguments) -> float:
    """Return the element size of the first grid over that of the last; ValueError or TypeError for
    sizes or divisions that do not go from coarse to fine."""
    if "sizes" in values and "divisions" in values:
        raise ValueError("give hierarchy.divisions or hierarchy.sizes, not both")
    sizes = [checks.positive("sizes", size) for size in values.get("sizes", ())]
    sizes += [1 / checks.integer("divisions", n, 1) for n in values.get("divisions", ())]
    if any(coarse <= fine for coarse, fine in pairwise(sizes)):
        name = "sizes" if "sizes" in values else "divisions"
        raise ValueError(
            f"hierarchy.{name} must go from coarse to fine, got {', '.join(map(str, values[name]))}"
        )
    return sizes[0] / sizes[-1] if sizes else 1.0


def forecast(settings: Mapping[str, Arguments]) -> am.Forecast:
    """Return the time and memory that a solve will take; of several sizes or divisions only the
    coarsest grid is made."""
    problem = problem_of(settings["case"])
    solver_of(settings["solver"])
    values = dict(settings["hierarchy"])
    finer = refinement_of(values)
    for name in {"sizes", "divisions"} & set(values):
        values[name] = values[name][:1]
    return grids(problem, values).forecast(finer)


def solved(
    settings: Mapping[str, Arguments],
    callback: Callable[[dict], None] | None = None,
    on_step: Callable[[am.Step], None] | None = None,
    store: str | os.PathLike[str] | None = None,
) -> tuple[Result, am.Hierarchy, list[am.Step]]:
    """Solve once, or on meshes that follow the error; return the last result, its grids, and the
    steps of the loop. ``callback`` is called with the progress, ``on_step`` with every step;
    ``store`` keeps the steps. The loop has its own solver in the settings ``adapt``; callers report
    a solve that has not converged."""
    problem = problem_of(settings["case"])
    if not settings["adapt"]:
        # the method first: what is refused is refused before anything is meshed
        solver = solver_of(settings["solver"])
        levels = grids(problem, settings["hierarchy"])
        return am.solve(levels, solver, throw=False, callback=callback), levels, []
    steps = []
    loop = partial(am.adapt, problem, progress=callback, store=store)
    for step in _made_with_settings(loop, settings["adapt"], "adapt.", "this loop"):
        steps.append(step)
        if on_step is not None:
            on_step(step)
    return steps[-1].result, steps[-1].hierarchy, steps


def case_facts(name: str) -> dict[str, Any]:
    """Return arguments, boundaries and loads of a case as JSON takes them; of a case from Python
    the call that solves it."""
    case = get(name)
    described = {"name": name, "description": case.description}
    if case.call:
        return described | {"call": case.call}
    posed = case.function()
    return described | {
        "dimension": posed.dim,
        "arguments": {key: dataclasses.asdict(item) for key, item in case_keys(name).items()},
        "boundaries": list(posed.domain.boundaries or ()),
        "contact": list(posed.pair_boundaries),
        "loads": list(names_in_path(posed)),
    }


def about_case(name: str) -> str:
    """Return arguments, boundaries and loads of a case, and the docstring of its function, as text."""
    facts = case_facts(name)
    words = inspect.getdoc(get(name).function) or ""
    if "call" in facts:
        return "\n".join(
            [
                f"{name}: {facts['description']}",
                "",
                "From Python:",
                "  import adaptmg as am",
                f"  problem = am.cases.{name}()",
                f"  solved = {facts['call']}",
                "",
                words,
            ]
        )
    arguments = [
        f"  {key:<15} {item.values}{f', default {item.default}' if item.default else ''}"
        for key, item in case_keys(name).items()
    ]
    lists = [f"  {key:<15} {', '.join(facts[key])}" for key in ("boundaries", "contact", "loads")]
    return "\n".join(
        [
            f"{name}: {facts['description']}",
            "",
            "Arguments (--set NAME=VALUE):",
            *arguments,
            "",
            *lists,
            "",
            words,
        ]
    ).rstrip()
