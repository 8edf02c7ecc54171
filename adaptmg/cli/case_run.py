"""From settings to a solution: one solve, a load path or an adaptive loop; the check of settings before anything is
meshed."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.cli import build
from adaptmg.cli.build import Arguments, Settings, parts, problem_of, section, solver_of
from adaptmg.estimate.step import Limits
from adaptmg.mesh.structured import lattice_nodes
from adaptmg.problem.load_path import names_in_path

if TYPE_CHECKING:
    from adaptmg.solver.result import Result

@dataclass(frozen=True)
class Solved:
    """What the settings of a run give."""

    results: list[Result]  # of each load step (of the last mesh alone in an adaptive loop), or of one solve
    grids: am.Hierarchy  # of the last one
    steps: list[am.Step]  # of an adaptive loop

    @property
    def result(self) -> Result:
        """The last one."""
        return self.results[-1]


def solved(settings: Settings, callback: Callable[[dict[str, float]], None] | None = None,
           each: Callable[[am.Step], None] | None = None, store: str | os.PathLike[str] | None = None) -> Solved:
    """Solve once, along a load path, or on meshes that follow the error. ``callback`` is given the progress, ``each``
    of every step of an adaptive loop, which ``store`` keeps."""
    problem, path = problem_of(section(settings, "case")), build.load_path(settings)
    if section(settings, "adapt"):
        steps = []
        for step in am.adapt(problem, **build.adaptation(settings), progress=callback, store=store):
            steps.append(step)
            if each is not None:
                each(step)
        return Solved([steps[-1].result], steps[-1].hierarchy, steps)
    levels, solver = build.grids(problem, section(settings, "hierarchy")), solver_of(section(settings, "solver"))
    if path is None:
        return Solved([am.solve(levels, solver, throw=False, callback=callback)], levels, [])
    return Solved(list(am.solve_path(levels, path, solver, throw=False)), levels, [])


def check(settings: Settings) -> None:
    """Make problem, path, method and arguments without meshing; ValueError or TypeError for what is refused."""
    task, path = problem_of(section(settings, "case")), build.load_path(settings)
    known = names_in_path(task)
    for name in path.factors if path is not None else ():
        if name not in known:
            raise ValueError(f"load_path.{name}: the problem has no load there{checks.suggestion(name, known)}; it has "
                             f"loads on {', '.join(known)}")
    if section(settings, "adapt"):
        if section(settings, "hierarchy"):
            raise ValueError("give grids or an adaptive loop, not both: adaptation makes its own meshes")
        found = build.adaptation(settings)
        Limits(**{limit: found[limit] for limit in ("tolerance", "max_nodes", "max_seconds") if limit in found})
        _check_sizes(task, "adapt.start", [found["start"]] if "start" in found else [])
    else:
        _check_grids(task, build.grid_arguments(task, section(settings, "hierarchy"))[1])
    solver_of(section(settings, "solver"))


def _check_grids(task: am.ContactProblem, arguments: Arguments) -> None:
    """Raise ValueError for grids that are not from coarse to fine; making them checks the rest."""
    if "divisions" in arguments:
        rows = checks.listed("hierarchy.divisions", arguments["divisions"], "whole numbers")
        fineness = [lattice_nodes(task.domain, row) for row in rows]
    else:
        rows = checks.listed("hierarchy.sizes", arguments["sizes"], "sizes in m")
        _check_sizes(task, "hierarchy.sizes", rows)
        fineness = [-min(row.values()) if isinstance(row, dict) else -row for row in rows]
    if any(a >= b for a, b in pairwise(fineness)):
        raise ValueError(f"hierarchy: grids must go from coarse to fine, got {checks.shown(rows)}")


def _check_sizes(task: am.ContactProblem, name: str, rows: Sequence[float | dict[str, float]]) -> None:
    """Most sizes that are too large are in millimetres."""
    for body, part in parts(task).items():
        longest = float((part.upper - part.lower).max())
        for row in rows:
            size = checks.quantity(name, row.get(body, longest) if isinstance(row, dict) else row, positive=True)
            if size > longest:
                raise ValueError(f"{name}: {size:g} m is more than the body is long ({longest:g} m): sizes are in m, "
                                 f"such as {longest / 4:g}")
