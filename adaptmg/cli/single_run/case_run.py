"""The run function of a study file: from settings to what is measured."""

from __future__ import annotations

from typing import Any

import adaptmg as am
from adaptmg.cli.single_run import parts
from adaptmg.cli.single_run.grids import grids
from adaptmg.cli.single_run.measures import MEASURES, Solved, at_boundaries, at_points
from adaptmg.cli.single_run.settings import Settings, section

__all__ = ["case_run"]


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
    problem, path = parts.problem(settings), parts.load_path(settings)
    if section(settings, "adapt"):
        steps = list(am.adapt(problem, **parts.adaptation(problem, settings)))
        return Solved(steps[-1].result, len(steps), sum(step.result.cycles for step in steps),
                      float(steps[-1].total_work_units), steps[-1].estimate.relative)
    levels, solver = grids(problem, settings), parts.solver(settings)
    if path is None:
        result = am.solve(levels, solver, throw=False)
        return Solved(result, 1, result.cycles, result.work_units)
    results = am.solve_path(levels, path, solver, throw=False)
    return Solved(results[-1], len(results), sum(r.cycles for r in results), sum(r.work_units for r in results))
