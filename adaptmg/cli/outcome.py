"""Outcomes of ``adaptmg solve`` and ``adaptmg adapt``: as JSON takes them, and as files with pictures."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg._files import make_folder, write_bytes
from adaptmg.cli.case_run import Solved
from adaptmg.cli.output import finite

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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


def folder(given: Path | None) -> Path | None:
    """Return the folder to write to, if any; ValueError before any work if a file is in the way."""
    if given is None:
        return None
    folder = checks.file_path("--out", given)
    there = next((path for path in (folder, *folder.parents) if os.path.lexists(path)), folder)
    if os.path.lexists(there) and not there.is_dir():
        raise ValueError(f"--out must be a folder, but {str(there)!r} is in the way")
    return folder


def write(directory: Path | None, solved: Solved) -> list[Path]:
    """Write result, pictures and VTK file into a directory, if there is one; return the files."""
    if directory is None:
        return []
    import matplotlib

    matplotlib.use("Agg")
    make_folder("--out", directory)
    result = solved.result
    files = [directory / "result.npz", directory / "result.vtu"]
    result.save(files[0])
    am.export.vtk(result, files[1])
    pictures = {"problem": lambda: am.plot.problem(solved.grids.problem), "grids": lambda: am.plot.grids(solved.grids),
                "deformed": lambda: am.plot.deformation(result, displacement=True),
                "contact": lambda: am.plot.contact(result),
                "stress": lambda: am.plot.deformation(result, stress=True, states=True)}
    if len(result.history.get("cycle", ())) > 1:
        pictures["history"] = lambda: am.plot.history(result)
    if solved.steps:
        pictures["adaptation"] = lambda: am.plot.adaptation(solved.steps)
    if result.path:
        pictures["path"] = lambda: am.plot.path(result)
    return files + [_picture(directory / f"{name}.png", draw()) for name, draw in pictures.items()]


def _picture(file: Path, figure: Figure) -> Path:
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=200, bbox_inches="tight")
    write_bytes(file, picture.getvalue())
    return file


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
