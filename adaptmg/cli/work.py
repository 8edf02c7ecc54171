"""From options to problem, grids, solver and files."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import adaptmg as am
from adaptmg.cli.choices import LawName, TransferName
from adaptmg.cli.described.arguments import given_arguments
from adaptmg.cli.laws import posed
from adaptmg.cli.plain import finite
from adaptmg.problem import checks
from adaptmg.runtime.atomic import make_folder, write_bytes
from adaptmg.solver.run import Solver

__all__ = ["hierarchy_of", "out_folder", "problem_of", "save_picture", "solved", "summary", "write"]

_DIVISIONS = {2: (4, 8, 16, 32), 3: (2, 4, 8)}


def problem_of(case: str, law: LawName | None, friction: float | None, limit: float | None,
               texts: Sequence[str] = ()) -> am.ContactProblem:
    """The case, with another law if one is asked for, and with its own arguments, ``NAME=VALUE``."""
    return posed(am.cases.get(case).function, law, friction, limit, **given_arguments(case, texts))


def hierarchy_of(problem: am.ContactProblem, divisions: str | None, sizes: str | None, contact_ratio: float | None,
                 transfer: TransferName | None) -> am.Hierarchy:
    """Uniform grids, or graded ones if sizes are given."""
    if sizes is None:
        if contact_ratio is not None or transfer is not None:
            raise ValueError("--contact-ratio and --transfer belong to --sizes (independent, non-nested meshes)")
        numbers = _DIVISIONS[problem.dim] if divisions is None else _numbers("divisions", divisions, int)
        return am.Hierarchy.uniform(problem, divisions=numbers)
    if divisions is not None:
        raise ValueError("give --divisions or --sizes, not both")
    kinds = {TransferName.L2: am.L2, TransferName.LUMPED: am.LumpedL2, TransferName.PSEUDO: am.PseudoL2,
             TransferName.QUASI: am.QuasiInterpolation}
    return am.Hierarchy.graded(problem, sizes=_numbers("sizes", sizes, float),
                               contact_ratio=1.0 if contact_ratio is None else contact_ratio,
                               transfer=kinds.get(transfer, am.Interpolation)())


def _numbers(option: str, text: str, kind: Callable[[str], Any]) -> tuple[Any, ...]:
    try:
        return tuple(kind(part) for part in text.split(","))
    except ValueError:
        example = "4,8,16,32" if kind is int else "10e-3,5e-3,2.5e-3"
        raise ValueError(f"--{option} must be numbers between commas, such as {example}; "
                         f"got {checks.shown(text)}") from None


def solved(grids: am.Hierarchy, method: Solver, callback: Callable[[dict[str, float]], None] | None) -> am.Result:
    """Solve; the result says whether it converged."""
    return am.solve(grids, method, throw=False, callback=callback)


def summary(result: am.Result, files: list[Path]) -> dict[str, Any]:
    """What the command prints as JSON; numbers that are not finite become null."""
    states = np.bincount(np.asarray(result.contact.state, dtype=int), minlength=3).tolist()
    row = {"problem": result.problem_name, "solver": result.solver_name, "status": result.status.name,
           "advice": result.status.value, "cycles": result.cycles, "work_units": result.work_units,
           "start_work_units": result.start_work_units, "residual": result.residual,
           "error_estimate": result.error_estimate, "rate": result.rate, "rtol": result.rtol,
           "seconds": result.seconds, "timings": result.timings, "levels": result.levels,
           "contact": dict(zip(("open", "slip", "stick"), states, strict=True)),
           "max_pressure": float(result.contact.pressure.max()),
           "max_displacement": float(np.linalg.norm(result.displacement, axis=1).max()),
           "versions": result.versions, "files": [str(file) for file in files]}
    return finite(row)


def out_folder(given: Path) -> Path:
    """The folder to write to, told before any work if a file is in the way; it is made when there is something."""
    folder = checks.file_path("--out", given)
    there = next((path for path in (folder, *folder.parents) if os.path.lexists(path)), folder)
    if os.path.lexists(there) and not there.is_dir():
        raise ValueError(f"--out must be a folder, but {str(there)!r} is in the way")
    return folder


def write(directory: Path, problem: am.ContactProblem, grids: am.Hierarchy, result: am.Result) -> list[Path]:
    """Result, pictures and VTK file into a directory, made where missing; returns what was written."""
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
    for name, draw in pictures.items():
        files.append(save_picture(directory / f"{name}.png", draw()))
    return files


def save_picture(file: Path, figure: Any) -> Path:
    """Write a figure of matplotlib as PNG, whole or not at all; returns the file."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=200, bbox_inches="tight")
    write_bytes(file, picture.getvalue())
    return file
