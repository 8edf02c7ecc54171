"""From the settings of a run to problem, load path, method and adaptive loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import adaptmg as am
from adaptmg.cases import get
from adaptmg.cli.choices import (
    CorrectionName,
    GoalName,
    LawName,
    LinearName,
    MarkName,
    Shape,
    SolverName,
    Sweeping,
)
from adaptmg.cli.laws import posed
from adaptmg.cli.methods import method_of
from adaptmg.cli.single_run.grids import check_grids, check_size
from adaptmg.cli.single_run.settings import Settings, section
from adaptmg.problem import checks
from adaptmg.problem.load_path import names_in_path
from adaptmg.solver.run import Solver

__all__ = ["WrongSetting", "adaptation", "check", "load_path", "problem", "solver"]

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
        "case": problem, "load_path": of_problem(_check_path), "hierarchy": of_problem(check_grids), "solver": solver,
        "adapt": of_problem(_check_adaptation), "measure": of_problem(_check_measures)}
    for name, part in parts.items():
        try:
            found = part(settings)
        except (ValueError, TypeError) as error:
            raise WrongSetting(str(error), name) from error
        made = found if name == "case" else made


def problem(settings: Settings) -> am.ContactProblem:
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


def solver(settings: Settings) -> Solver:
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
            "engine": engine, "solver": solver(settings) if section(settings, "solver") else None,
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
