"""From options to problem, grids, solver and files."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import adaptmg as am
from adaptmg.cli.choices import CorrectionName, LawName, LinearName, Shape, SolverName, TransferName
from adaptmg.problem import checks
from adaptmg.runtime.atomic import make_folder, write_bytes
from adaptmg.solver.run import Solver

__all__ = ["finite", "hierarchy_of", "out_folder", "problem_of", "save_picture", "solved", "solver_of", "summary",
           "write"]

#: options, beside rtol and most, that a method takes
_TAKES = {SolverName.FULL: ("correction", "cycle", "pre", "post", "omega"),
          SolverName.MULTIGRID: ("correction", "cycle", "pre", "post", "omega"),
          SolverName.SINGLE: ("omega",), SolverName.ACTIVE: ("linear",)}
_CORRECTIONS = {CorrectionName.TRUNCATED: am.Truncated, CorrectionName.MONOTONE: am.Monotone,
                CorrectionName.PAPER: am.PaperCorrection}
_DIVISIONS = {2: (4, 8, 16, 32), 3: (2, 4, 8)}


def problem_of(case: str, law: LawName | None, friction: float | None, limit: float | None) -> am.ContactProblem:
    """The case, with another law if one is asked for."""
    function = am.cases.get(case).function
    if law is None and friction is None and limit is None:
        return function()
    if law is None:
        law = LawName.TRESCA if friction is None else LawName.COULOMB
    for option, value, owner in (("friction", friction, LawName.COULOMB), ("limit", limit, LawName.TRESCA)):
        if law is owner and value is None:
            raise ValueError(f"--law {law} needs --{option}")
        if law is not owner and value is not None:
            raise ValueError(f"--{option} belongs to --law {owner}, not to {law}")
    if law is LawName.COULOMB:
        return function(law=am.Coulomb(friction))
    return function(law=am.Frictionless() if law is LawName.FRICTIONLESS else am.Tresca(limit))


def solver_of(name: SolverName, *, correction: CorrectionName | None, cycle: Shape | None, pre: int | None,
              post: int | None, omega: float | None, linear: LinearName | None, rtol: float | None,
              most: int | None) -> Solver:
    """The method with the options that are given; ValueError for one it has no use for."""
    given = {"correction": correction, "cycle": cycle, "pre": pre, "post": post, "omega": omega, "linear": linear}
    useless = [option for option, value in given.items() if value is not None and option not in _TAKES[name]]
    if useless:
        raise ValueError(f"--{useless[0]} has no meaning for --solver {name}; "
                         f"it takes {', '.join(f'--{option}' for option in _TAKES[name])}")
    if name is SolverName.SINGLE:
        return am.SingleGrid(**_only(omega=omega, rtol=rtol, max_sweeps=most))
    if name is SolverName.ACTIVE:
        method = am.AMG() if linear is LinearName.AMG else am.Direct()
        return am.ActiveSet(linear=method, **_only(rtol=rtol, max_steps=most))
    kind = am.FullMultigrid if name is SolverName.FULL else am.Multigrid
    return kind(cycle=am.Cycle(**_only(shape=None if cycle is None else cycle.value, pre=pre, post=post)),
                smoother=am.ProjectedGaussSeidel(**_only(omega=omega)),
                correction=None if correction is None else _CORRECTIONS[correction](),
                **_only(rtol=rtol, max_cycles=most))


def _only(**options: Any) -> dict[str, Any]:
    """Options that are given; the others keep the defaults of the class."""
    return {name: value for name, value in options.items() if value is not None}


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


def finite(value: Any) -> Any:
    """Plain values as JSON takes them: numbers that are not finite become None."""
    if isinstance(value, dict):
        return {key: finite(v) for key, v in value.items()}
    if isinstance(value, list):
        return [finite(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
