"""``adaptmg solve`` and ``adaptmg adapt``: from options to problem, grids and solver, and from results to files."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg._files import make_folder, write_bytes
from adaptmg.cli import build
from adaptmg.cli.output import finite
from adaptmg.solver.record import Solver

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["hierarchy_of", "loop_summary", "method_of", "out_folder", "problem_of", "solved", "stepped", "summary",
           "write", "write_loop"]

Option = str | float | None
#: nodes of an adaptive loop without a limit
_NODES = 20_000


def problem_of(case: str, texts: Sequence[str], **law: Option) -> am.ContactProblem:
    """Return the case with the given law and its own arguments, ``NAME=VALUE``."""
    return build.problem_of({"case": case, **_given(law), **build.given_arguments(case, texts)}, "--")


def hierarchy_of(problem: am.ContactProblem, divisions: str | None, sizes: str | None, **options: Option
                 ) -> am.Hierarchy:
    """Return uniform grids, or graded ones if sizes are given."""
    lists = {"divisions": divisions if divisions is None else _numbers("divisions", divisions, int),
             "sizes": sizes if sizes is None else _numbers("sizes", sizes, float)}
    return build.grids(problem, _given(lists | options), "--")


def method_of(solver: str, **options: Option) -> Solver:
    """Return the method with the options that are given."""
    return build.solver_of({"method": solver, **_given(options)}, "--", "--solver")


def _given(options: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in options.items() if value is not None}


def _numbers(option: str, text: str, kind: type[int] | type[float]) -> tuple[float, ...]:
    try:
        return tuple(kind(part) for part in text.split(","))
    except ValueError:
        example = "4,8,16,32" if kind is int else "10e-3,5e-3,2.5e-3"
        raise ValueError(f"--{option} must be numbers between commas, such as {example}; "
                         f"got {checks.shown(text)}") from None


def solved(grids: am.Hierarchy, method: Solver, callback: Callable[[dict[str, float]], None] | None) -> am.Result:
    """Solve; the result says whether it converged."""
    return am.solve(grids, method, throw=False, callback=callback)


def summary(result: am.Result, files: list[Path]) -> dict[str, object]:
    """Return a result as JSON takes it."""
    states = np.bincount(np.asarray(result.contact.state, dtype=int), minlength=3).tolist()
    names = ("cycles", "work_units", "start_work_units", "residual", "error_estimate", "rate", "rtol", "seconds",
             "timings", "levels")
    row = {"problem": result.problem_name, "solver": result.method, "status": result.status.name,
           "advice": result.status.value, **{name: getattr(result, name) for name in names},
           "contact": dict(zip(("open", "slip", "stick"), states, strict=True)),
           "max_pressure": float(result.contact.pressure.max()),
           "max_displacement": float(np.linalg.norm(result.displacement, axis=1).max()),
           "versions": result.versions, "files": [str(file) for file in files]}
    return finite(row)


def out_folder(given: Path) -> Path:
    """Return the folder to write to; ValueError before any work if a file is in the way."""
    folder = checks.file_path("--out", given)
    there = next((path for path in (folder, *folder.parents) if os.path.lexists(path)), folder)
    if os.path.lexists(there) and not there.is_dir():
        raise ValueError(f"--out must be a folder, but {str(there)!r} is in the way")
    return folder


def write(directory: Path, problem: am.ContactProblem, grids: am.Hierarchy, result: am.Result) -> list[Path]:
    """Write result, pictures and VTK file into a directory; return the files."""
    import matplotlib

    matplotlib.use("Agg")
    make_folder("--out", directory)
    files = [directory / "result.npz", directory / "result.vtu"]
    result.save(files[0])
    am.export.vtk(result, files[1])
    pictures = {"problem": lambda: am.plot.problem(problem), "grids": lambda: am.plot.grids(grids),
                "deformed": lambda: am.plot.deformation(result, displacement=True),
                "contact": lambda: am.plot.contact(result),
                "stress": lambda: am.plot.deformation(result, stress=True, states=True)}
    if len(result.history.get("cycle", ())) > 1:
        pictures["history"] = lambda: am.plot.history(result)
    if result.path:
        pictures["path"] = lambda: am.plot.path(result)
    return files + [_picture(directory / f"{name}.png", draw()) for name, draw in pictures.items()]


def _picture(file: Path, figure: Figure) -> Path:
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=200, bbox_inches="tight")
    write_bytes(file, picture.getvalue())
    return file


def stepped(problem: am.ContactProblem, start: float | None, choices: dict[str, str | float],
            limits: dict[str, float | None], store: Path | None,
            progress: Callable[[dict[str, float]], None] | None, say: Callable[[str], None]) -> list[am.Step]:
    """Run the adaptive loop, and say each step."""
    chosen = build.arguments_of(am.adapt, choices, "--", "adapt")
    loop = am.adapt(problem, start, **chosen, store=store, progress=progress,
                    **(_given(limits) or {"max_nodes": _NODES}))
    say(am.Step.HEADER)
    steps = []
    for step in loop:
        steps.append(step)
        say(step.row)
    return steps


def loop_summary(steps: list[am.Step], files: list[Path]) -> dict[str, object]:
    """Return an adaptive loop as JSON takes it."""
    rows = [{"step": step.number, "nodes": step.nodes, "levels": [level.n_nodes for level in step.hierarchy.levels],
             "contact_nodes": len(step.result.contact), "estimate": step.estimate.relative,
             "estimate_total": step.estimate.total, "terms": dict(step.estimate.terms), "cycles": step.result.cycles,
             "rate": step.result.rate, "rtol": step.result.rtol, "work_units": step.work_units,
             "total_work_units": step.total_work_units, "seconds": step.seconds, "total_seconds": step.total_seconds,
             "timings": dict(step.timings)} for step in steps]
    last = steps[-1]
    return finite({"problem": last.result.problem_name, "indicator": last.estimate.indicator, "outcome": last.outcome,
                   "steps": rows, "result": summary(last.result, files)})


def write_loop(directory: Path, problem: am.ContactProblem, steps: list[am.Step]) -> list[Path]:
    """Write the last result, pictures and VTK file into a directory; return the files."""
    last = steps[-1]
    files = write(directory, problem, last.hierarchy, last.result)
    return [*files, _picture(directory / "adaptation.png", am.plot.adaptation(steps))]
