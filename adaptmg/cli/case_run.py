"""From settings to a solution: one solve, a load path or an adaptive loop; the run function of study files, what it
measures, and the check of settings before anything is meshed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

import adaptmg as am
from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg.cli import build
from adaptmg.cli.build import Arguments, Settings, WrongSetting, parts, problem_of, section, solver_of
from adaptmg.estimate.step import Limits
from adaptmg.problem.load_path import names_in_path
from adaptmg.problem.plane_domains import Domain
from adaptmg.study.record import Scalar, Value

if TYPE_CHECKING:
    from adaptmg.solver.result import Result

#: nodes of grids that are refused before anything runs
_MOST_NODES = {2: 5e6, 3: 2e6}
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
    """Make problem, path, method and arguments without meshing; WrongSetting for settings that are refused."""
    def in_section(name: str, make: Callable[[Arguments], object]) -> Any:
        try:
            return make(section(settings, name))
        except (ValueError, TypeError) as error:
            raise WrongSetting(error, name) from error

    task = in_section("case", problem_of)
    in_section("load_path", lambda given: _check_path(task, build.load_path(settings)))
    in_section("hierarchy", lambda given: _check_hierarchy(task, given, bool(section(settings, "adapt"))))
    in_section("solver", solver_of)
    in_section("adapt", lambda given: given and _check_adaptation(task, build.adaptation(settings)))
    in_section("measure", lambda given: _check_measures(task, given))


def _check_path(task: am.ContactProblem, path: am.LoadPath | None) -> None:
    known = names_in_path(task)
    for name in path.factors if path is not None else ():
        if name not in known:
            raise ValueError(f"load_path.{name}: the problem has no load there{checks.suggestion(name, known)}; it has "
                             f"loads on {', '.join(known)}")


def _check_adaptation(task: am.ContactProblem, found: Arguments) -> None:
    Limits(**{limit: found[limit] for limit in ("tolerance", "max_nodes", "max_seconds") if limit in found})
    for part in parts(task).values() if "start" in found else ():
        _check_size("adapt.start", checks.quantity("start", found["start"], positive=True), part)


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


def _check_hierarchy(task: am.ContactProblem, given: Arguments, adaptive: bool) -> None:
    """ValueError for grids of which some are not from coarse to fine, or would take hours."""
    if adaptive and given:
        raise ValueError("give [hierarchy] or [adapt], not both: adaptation makes its own meshes")
    if adaptive:
        return
    arguments = build.grid_arguments(task, given)[1]
    sized = "sizes" in arguments
    rows, name = arguments["sizes" if sized else "divisions"], f"hierarchy.{'sizes' if sized else 'divisions'}"
    if not sized and not build.are_blocks(task):
        raise ValueError(f"{name} are for rectangles and boxes, which this case is not: give hierarchy.sizes = [10e-3, "
                         "5e-3] (element sizes in m, coarse to fine)")
    if not isinstance(rows, tuple | list) or not rows:
        raise TypeError(f"{name} must be a list of {'sizes in m' if sized else 'whole numbers'}, got "
                        f"{checks.shown(rows)}")
    for body, part in parts(task).items():
        values = [row.get(body, 1) if isinstance(row, dict) else row for row in rows]
        if any(isinstance(value, tuple) for value in values):
            continue
        values = [checks.quantity(name, v, positive=True) if sized else checks.integer(name, v, 1, 10**9)
                  for v in values]
        if any(a <= b if sized else a >= b for a, b in pairwise(values)):
            raise ValueError(f"{name} must go from coarse to fine, got {checks.shown(values)}")
        if sized:
            _check_size(name, values[0], part)
        ratio = arguments.get("contact_ratio", 1.0)
        ratio = checks.quantity("hierarchy.contact_ratio", ratio.get(body, 1.0) if isinstance(ratio, dict) else ratio)
        # the bodies fill a part of their boxes; elements along contact are counted, not in the plane
        cells = (part.upper - part.lower) / values[-1]
        nodes = max(float(np.prod(cells)) / 10, float(cells.max()) * ratio * 50) if sized else \
            len(parts(task)) * (values[-1] + 1.0)**task.dim
        if nodes > _MOST_NODES[task.dim]:
            raise ValueError(f"{name}: {values[-1]:g} makes about {nodes:.0e} nodes, at most "
                             f"{_MOST_NODES[task.dim]:.0e} are run")


def _check_size(name: str, size: float, part: Domain) -> None:
    """Most sizes that are too large are in millimetres."""
    longest = float((part.upper - part.lower).max())
    if size > longest:
        raise ValueError(f"{name}: {size:g} m is more than the body is long ({longest:g} m): sizes are in m, such as "
                         f"{longest / 4:g}")
