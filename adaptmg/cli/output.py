"""Output of the commands: results as JSON, files with pictures, log and progress on standard
error."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg._files import make_folder, write_bytes


def finite(value: object) -> Any:
    """Return plain values for JSON: numbers that are not finite become None, tuples lists."""
    if isinstance(value, dict):
        return {key: finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [finite(part) for part in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextmanager
def watched() -> Iterator[Callable[[dict], None] | None]:
    """Send adaptmg's log from INFO on to standard error; on a terminal also yield a callback that
    takes the progress of a solve or of an adaptive loop, and updates a bar."""
    from rich.console import Console
    from rich.logging import RichHandler
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    handler = RichHandler(console=console, show_time=False, show_level=False, show_path=False)
    handler.addFilter(
        lambda record: record.name != "adaptmg.solver.solve"
    )  # the command prints the result
    with logged("adaptmg", logging.INFO, handler):
        if not console.is_terminal:
            yield None
            return
        with Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TimeElapsedColumn(),
            console=console,
            transient=True,
        ) as bar:
            task = bar.add_task("meshes and set-up", total=None)
            yield lambda row: bar.update(task, description=_described(row))


def _described(row: dict) -> str:
    """Return a row of progress, of a solve or of an adaptive loop, as text."""
    if "phase" not in row:
        return f"cycle {row['cycle']}, error {row.get('error_estimate', row.get('residual', math.nan)):.1e}"
    text = f"step {row['step']}: {row['phase']}, {row['nodes']} nodes"
    if math.isfinite(row["estimate"]):
        text += f", estimate {row['estimate']:.2%}"
    return text


@contextmanager
def logged(name: str, level: int, handler: logging.Handler) -> Iterator[None]:
    """Send a log, from a level on, to a handler, inside a with statement."""
    logger = logging.getLogger(name)
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(level)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)


def summary(result: am.Result, files: list[Path]) -> dict[str, object]:
    """Return a result as JSON takes it."""
    states = np.bincount(np.asarray(result.contact.state, dtype=int), minlength=3).tolist()
    names = (
        "cycles",
        "work_units",
        "start_work_units",
        "residual",
        "error_estimate",
        "rate",
        "rtol",
        "seconds",
        "timings",
        "levels",
    )
    row = {
        "problem": result.problem_name,
        "solver": result.method,
        "status": result.status.name,
        "advice": result.status.value,
        **{name: getattr(result, name) for name in names},
        "contact": dict(zip(("open", "slip", "stick"), states, strict=True)),
        "max_pressure": result.max_pressure,
        "max_displacement": float(np.linalg.norm(result.displacement, axis=1).max()),
        "versions": result.versions,
        "files": [str(file) for file in files],
    }
    return finite(row)


def folder(given: Path | None) -> Path | None:
    """Return the folder to write to, if any, made before any work."""
    if given is not None:
        make_folder("--out", checks.file_path("--out", given))
    return given and given.expanduser()


def write(
    directory: Path | None, result: am.Result, grids: am.Hierarchy, steps: list[am.Step]
) -> list[Path]:
    """Write result, pictures and VTK file into a directory, if there is one; return the files."""
    if directory is None:
        return []
    import matplotlib

    matplotlib.use("Agg")
    from adaptmg.export.report import small_png

    files = [directory / "result.npz", directory / "result.vtu"]
    result.save(files[0])
    am.export.vtk(result, files[1])
    pictures = {
        "problem": lambda: am.plot.problem(grids.problem),
        "grids": lambda: am.plot.grids(grids),
        "deformed": lambda: am.plot.deformation(result, displacement=True),
        "contact": lambda: am.plot.contact(result),
        "stress": lambda: am.plot.deformation(result, stress=True, states=True),
    }
    if len(result.history.get("cycle", ())) > 1:
        pictures["history"] = lambda: am.plot.history(result)
    if steps:
        pictures["adaptation"] = lambda: am.plot.adaptation(steps)
    if result.path:
        pictures["cycles"] = lambda: am.plot.path(result)
    for name, draw in pictures.items():
        files.append(directory / f"{name}.png")
        write_bytes(files[-1], small_png(draw(), 200))
    return files


def loop_summary(steps: list[am.Step], files: list[Path]) -> dict[str, object]:
    """Return an adaptive loop as JSON takes it."""
    last = steps[-1]
    return finite(
        {
            "problem": last.result.problem_name,
            "indicator": last.estimate.indicator,
            "outcome": last.outcome,
            "steps": am.Step.table(steps).to_dict("records"),
            "result": summary(last.result, files),
        }
    )
