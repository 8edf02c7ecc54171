"""The keys of a study file: what their values must be, what they mean, and what holds where they are left out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

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
from adaptmg.problem import checks

__all__ = ["OPEN", "SECTIONS", "SETTINGS", "WORDS", "Check", "Key", "plain"]

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
