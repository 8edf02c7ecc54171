"""From settings to a solution: one solve, a load path or an adaptive loop; the run function of study files, what it
measures, and the check of settings before anything is meshed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

import adaptmg as am
from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg.cli import build
from adaptmg.cli.build import Arguments, Settings, parts, problem_of, section, solver_of
from adaptmg.estimate.step import Limits
from adaptmg.mesh.structured import lattice_nodes
from adaptmg.problem.load_path import names_in_path
from adaptmg.study.record import Scalar, Value

if TYPE_CHECKING:
    from adaptmg.solver.result import Result

#: the measures of a file without [measure]
COLUMNS = ("cycles", "work_units", "residual", "nodes")


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

    def total(self, name: str) -> float:
        """Return the sum of an attribute of the results of all load steps or meshes."""
        return sum(getattr(result, name) for result in ([step.result for step in self.steps] or self.results))


def _states(solved: Solved, code: int) -> int:
    return int((solved.result.contact.state == code).sum())


def _along(solved: Solved, boundary: str = "contact") -> dict[str, float | None]:
    force = solved.result.resultant(boundary).force
    return {axis: float(force[k]) if k < len(force) else None for k, axis in enumerate("xyz")}


def _largest(values: np.ndarray) -> float:
    sizes = np.linalg.norm(values, axis=1) if values.ndim > 1 else np.abs(values)
    return float(sizes.max(initial=0.0))


def _in_contact(solved: Solved, name: str) -> np.ndarray:
    contact = solved.result.contact
    return getattr(contact, name)[contact.state != am.OPEN]


#: by name: function of a run, meaning, unit
MEASURES: dict[str, tuple[Callable[[Solved], Scalar], str, str]] = {
    "outcome": (lambda s: s.result.status.name, "how the (last) solve ended: CONVERGED, LIMIT, STALLED, CYCLING or "
                "DIVERGED; always in the table", ""),
    "cycles": (lambda s: s.total("cycles"), "cycles, sweeps or Newton steps, of all load steps or meshes", ""),
    "work_units": (lambda s: float(s.steps[-1].total_work_units) if s.steps else s.total("work_units"),
                   "passes over the finest matrix, of all load steps or meshes", ""),
    "start_work_units": (lambda s: s.result.start_work_units, "of these, in the nested start of the last solve", ""),
    "solve_seconds": (lambda s: s.result.seconds, "wall time of the last solve, without meshes", "s"),
    "residual": (lambda s: s.result.residual, "natural residual of the contact conditions, relative", ""),
    "error_estimate": (lambda s: s.result.error_estimate, "estimated algebraic error, relative, energy norm", ""),
    "energy_error": (lambda s: s.result.certificate().energy_error,
                     "the same by the certificate, which is computed from the raw matrices", ""),
    "violation": (lambda s: s.result.certificate().worst.relative,
                  "the certificate's largest violation of a condition of the problem, relative", ""),
    "estimate": (lambda s: s.steps[-1].estimate.relative if s.steps else None,
                 "estimated discretisation error, relative, energy norm (with [adapt])", ""),
    "rate": (lambda s: s.result.rate, "asymptotic convergence rate of a cycle", ""),
    "steps": (lambda s: len(s.steps or s.results), "load steps, or meshes of an adaptive loop; else 1", ""),
    "levels": (lambda s: len(s.result.levels), "number of grids", ""),
    "nodes": (lambda s: len(s.result.displacement), "nodes of the finest mesh", ""),
    "contact_nodes": (lambda s: len(s.result.contact), "of these, nodes that may come into contact", ""),
    "open": (lambda s: _states(s, am.OPEN), "contact nodes that are open", ""),
    "slip": (lambda s: _states(s, am.SLIP), "contact nodes that slip", ""),
    "stick": (lambda s: _states(s, am.STICK), "contact nodes that stick", ""),
    "contact_area": (lambda s: float(_in_contact(s, "weights").sum()), "area in contact (plane problems: length)",
                     "m^2 or m"),
    "max_pressure": (lambda s: float(s.result.contact.pressure.max()), "largest contact pressure", "Pa"),
    "max_traction": (lambda s: _largest(s.result.contact.traction), "largest friction traction", "Pa"),
    "max_slip": (lambda s: _largest(_in_contact(s, "slip")), "largest slip of the last step in contact", "m"),
    "max_gap": (lambda s: float(s.result.contact.gap.max()), "largest gap of a contact node", "m"),
    "max_displacement": (lambda s: _largest(s.result.displacement), "largest displacement of a node", "m"),
    "max_von_mises": (lambda s: float(s.result.von_mises().max()), "largest von Mises stress of an element", "Pa"),
    "force_x": (lambda s: _along(s)["x"], "x component of the contact force on the body (of pairs: on the slaves); "
                "plane problems: per metre", "N or N/m"),
    "force_y": (lambda s: _along(s)["y"], "y component of the contact force", "N or N/m"),
    "force_z": (lambda s: _along(s)["z"], "z component of the contact force (3D only)", "N or N/m"),
}


def units_of(columns: Iterable[str]) -> dict[str, str]:
    """Return units of the columns of a table of a study file."""
    known = {"seconds": "s", "peak_memory": "bytes",
             **{name: unit for name, (_, _, unit) in MEASURES.items() if unit}}
    return {name: known.get(name, "N or N/m") for name in columns if name in known or name.startswith("force_")}


def case_run(**settings: Value) -> dict[str, object]:
    """Compute one run: its outcome, the columns, forces and displacements of [measure], and the kept result."""
    found = solved(settings)
    measured = {name: MEASURES[name][0](found)
                for name in dict.fromkeys(("outcome", *settings.get("measure.columns", COLUMNS)))}
    measured |= {f"force_{axis}({name})": value for name in settings.get("measure.forces_on", ())
                 for axis, value in _along(found, name).items() if value is not None}
    if points := section(settings, "measure.points"):
        rows = found.result.probe(list(points.values()))
        measured |= {f"{name}.{axis}": float(value) for name, row in zip(points, rows, strict=True)
                     for axis, value in zip("xyz", row, strict=False)}
    return measured | ({"result": found.result} if settings.get("measure.keep") else {})


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
            raise ValueError("give [hierarchy] or [adapt], not both: adaptation makes its own meshes")
        found = build.adaptation(settings)
        Limits(**{limit: found[limit] for limit in ("tolerance", "max_nodes", "max_seconds") if limit in found})
        _check_sizes(task, "adapt.start", [found["start"]] if "start" in found else [])
    else:
        _check_grids(task, build.grid_arguments(task, section(settings, "hierarchy"))[1])
    solver_of(section(settings, "solver"))
    _check_measures(task, section(settings, "measure"))


def _check_measures(task: am.ContactProblem, given: Arguments) -> None:
    for key, known in (("columns", MEASURES), ("forces_on", ("contact", *task.domain.boundaries))):
        names = given.get(key, ())
        if not isinstance(names, tuple):
            raise TypeError(f"measure.{key} must be a list of names, got {checks.shown(names)}")
        for name in names:
            if name not in known:
                raise ValueError(f"measure.{key}: there is no {checks.shown(name)}"
                                 f"{checks.suggestion(str(name), known)}; there are {', '.join(known)}")
    checks.flag("measure.keep", given.get("keep", False))
    if "points" in given:
        raise TypeError("measure.points must be values by name, points = {A = [0.0, 0.0]}")
    for name, point in section(given, "points").items():
        check_arrays.vector(f"measure.points.{name}", point, task.dim)


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
