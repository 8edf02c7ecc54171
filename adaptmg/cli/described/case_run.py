"""The run function of a study file: from settings to what is measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import adaptmg as am
from adaptmg.cli.choices import CorrectionName, LawName, LinearName, Shape, SolverName, TransferName
from adaptmg.cli.described.measures import MEASURES, Solved
from adaptmg.cli.work import solver_of
from adaptmg.problem import checks
from adaptmg.problem.load_path import names_in_path

__all__ = ["case_run", "checked_parts"]

_DIVISIONS = {2: (4, 8, 16, 32), 3: (2, 4, 8)}
_TRANSFERS = {TransferName.INTERPOLATION: "Interpolation", TransferName.L2: "L2", TransferName.LUMPED: "LumpedL2",
              TransferName.PSEUDO: "PseudoL2", TransferName.QUASI: "QuasiInterpolation"}


def case_run(**settings: Any) -> dict[str, Any]:
    """One run.

    Parameters
    ----------
    settings
        By ``"section.key"`` of the study file.

    Returns
    -------
    dict
        The columns of ``measure.columns``, and the result if ``measure.keep`` is true.
    """
    columns = settings.get("measure.columns", ("outcome", "cycles", "work_units", "residual", "nodes"))
    solved = _solved(settings)
    measured = {name: MEASURES[name](solved) for name in columns}
    return measured | ({"result": solved.result} if settings.get("measure.keep") else {})


def checked_parts(settings: Mapping[str, Any]) -> None:
    """Problem, solver and load path of a run, made without meshing: ValueError or TypeError for what cannot be."""
    problem, path = _problem(settings), _path(settings)
    _check_grids(settings)
    _solver(settings)
    known = names_in_path(problem)
    for name in path.factors if path is not None else ():
        if name not in known:
            raise ValueError(f"load_path.{name}: the problem has no load there{checks.suggestion(name, known)}; it has "
                             f"loads on {', '.join(known)}")


def _of(settings: Mapping[str, Any], section: str) -> dict[str, Any]:
    """The settings of a section, by key."""
    return {name.partition(".")[2]: value for name, value in settings.items() if name.startswith(f"{section}.")}


def _problem(settings: Mapping[str, Any]) -> am.ContactProblem:
    given = _of(settings, "case")
    function = am.cases.get(given.pop("case")).function
    law = given.pop("law", None)
    friction, limit = given.pop("friction", None), given.pop("limit", None)
    if law is None and (friction is not None or limit is not None):
        law = LawName.TRESCA if friction is None else LawName.COULOMB
    for name, value, owner in (("friction", friction, LawName.COULOMB), ("limit", limit, LawName.TRESCA)):
        if law == owner and value is None:
            raise ValueError(f"case.law = \"{law}\" needs case.{name}")
        if value is not None and law != owner:
            raise ValueError(f"case.{name} belongs to case.law = \"{owner}\", not to \"{law}\"")
    if law is not None:
        given["law"] = am.Coulomb(friction) if law == LawName.COULOMB else am.Tresca(limit) \
            if law == LawName.TRESCA else am.Frictionless()
    return function(**given)


def _solver(settings: Mapping[str, Any]) -> Any:
    given = _of(settings, "solver")
    kinds = {"correction": CorrectionName, "cycle": Shape, "linear": LinearName}
    named = {name: kind(given[name]) if name in given else None for name, kind in kinds.items()}
    try:
        return solver_of(SolverName(given.get("method", SolverName.FULL)), **named, pre=given.get("pre"),
                         post=given.get("post"), omega=given.get("omega"), rtol=given.get("rtol"),
                         most=given.get("max_cycles"))
    except ValueError as error:
        # its words are those of the command line
        raise ValueError(str(error).replace("--solver", "method").replace("--", "")) from None


def _path(settings: Mapping[str, Any]) -> am.LoadPath | None:
    given = _of(settings, "load_path")
    default = given.pop("default", 1.0)
    return am.LoadPath(given, default) if "load_path.default" in settings or given else None


def _check_grids(settings: Mapping[str, Any]) -> None:
    given = _of(settings, "hierarchy")
    if given and _of(settings, "adapt"):
        raise ValueError("give [hierarchy] or [adapt], not both: adaptation makes its own meshes")
    if "sizes" in given and "divisions" in given:
        raise ValueError("give hierarchy.divisions or hierarchy.sizes, not both")
    if "sizes" not in given and (useless := sorted(set(given) - {"divisions"})):
        raise ValueError(f"hierarchy.{useless[0]} belongs to hierarchy.sizes (independent, non-nested meshes)")


def _grids(problem: am.ContactProblem, settings: Mapping[str, Any]) -> am.Hierarchy:
    _check_grids(settings)
    given = _of(settings, "hierarchy")
    if "sizes" not in given:
        return am.Hierarchy.uniform(problem, divisions=given.get("divisions", _DIVISIONS[problem.dim]))
    transfers = {name: getattr(am.transfer, kind) for name, kind in _TRANSFERS.items()}
    return am.Hierarchy.graded(problem, sizes=given["sizes"], contact_ratio=given.get("contact_ratio", 1.0),
                               transfer=transfers[given.get("transfer", TransferName.INTERPOLATION)]())


def _solved(settings: Mapping[str, Any]) -> Solved:
    problem, path = _problem(settings), _path(settings)
    if _of(settings, "adapt"):
        return _adapted(problem, path, settings)
    grids, solver = _grids(problem, settings), _solver(settings)
    if path is None:
        result = am.solve(grids, solver, throw=False)
        return Solved(result, 1, result.cycles, result.work_units)
    results = am.solve_path(grids, path, solver, throw=False)
    return Solved(results[-1], len(results), sum(r.cycles for r in results), sum(r.work_units for r in results))


def _adapted(problem: am.ContactProblem, path: am.LoadPath | None, settings: Mapping[str, Any]) -> Solved:
    given = _of(settings, "adapt")
    stops = {name: given[name] for name in ("tolerance", "max_nodes", "max_seconds") if name in given}
    if not stops:
        raise ValueError("[adapt] needs a limit: max_nodes, tolerance or max_seconds")
    indicator = am.Recovery() if given.get("indicator") == "recovery" else am.Residual()
    engine = am.Bisect() if given.get("engine") == "bisect" else am.Remesh()
    solver = _solver(settings) if _of(settings, "solver") else None
    steps = list(am.adapt(problem, given.get("start", 5e-3), indicator, am.Doerfler(given.get("theta", 0.5)), engine,
                          solver=solver, load_path=path, **stops))
    return Solved(steps[-1].result, len(steps), sum(step.result.cycles for step in steps),
                  float(steps[-1].total_work_units), steps[-1].estimate.relative)
