"""Output of the commands: values and outcomes as JSON, files with pictures, tables in blocks on a narrow terminal, log
and progress on standard error."""

from __future__ import annotations

import io
import json
import logging
import math
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg._files import make_folder, write_bytes
from adaptmg.study.tables import as_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from adaptmg.cli.build import Solved


def finite(value: object) -> object:
    """Return plain values for JSON: numbers that are not finite become None, tuples lists."""
    if isinstance(value, dict):
        return {key: finite(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [finite(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def rows(table: Mapping[str, Sequence[object]]) -> list[dict[str, object]]:
    """Return the rows of a table as JSON takes them."""
    given = {name: [finite(value) for value in column] for name, column in table.items()}
    return [dict(zip(given, row, strict=True)) for row in zip(*given.values(), strict=True)]


def lines(rows: Sequence[dict[str, object]]) -> str:
    """Return rows as JSON, one a line."""
    return "[" + ",".join(f"\n  {json.dumps(row, allow_nan=False)}" for row in rows) + "\n]"


def printed(table: Mapping[str, Sequence[object]], parameters: Sequence[str], *, units: Mapping[str, str],
            note: str = "") -> str:
    """Return a table as text, in blocks of columns where it is wider than the terminal, each with the parameters."""
    def text(names: Sequence[str]) -> str:
        return as_text({name: table[name] for name in names},
                       units={name: unit for name, unit in units.items() if name in names})

    head, names = [name for name in parameters if name in table], list(table.keys())
    blocks = [head] if sys.stdout.isatty() else [names]
    for name in (name for name in names if name not in blocks[0]):
        if blocks[-1] != head and len(text([*blocks[-1], name]).splitlines()[1]) > shutil.get_terminal_size().columns:
            blocks.append(head)
        blocks[-1] = [*blocks[-1], name]
    return "\n\n".join(map(text, blocks)) + f"\n{note}" * bool(note)


Row = dict[str, float]
_Callback = AbstractContextManager[Callable[[Row], None] | None]


def watched(rtol: float = 1e-8) -> _Callback:
    """Show log and progress of a solve inside: the bar fills by decades of the error."""
    first: list[float] = []

    def state(row: Row) -> dict[str, object]:
        for error in (row.get("error_estimate", math.nan), row.get("residual", math.nan)):
            if math.isfinite(error) and error > 0:
                first.append(error)
                total = math.log10(max(first[0] / rtol, 10.0))
                return {"total": total, "completed": min(max(math.log10(first[0] / error), 0.0), total),
                        "description": f"cycle {row['cycle']}, error {error:.1e}"}
        return {}

    return _bar("grids and set-up", state)


def watched_loop() -> _Callback:
    """Show log and progress of an adaptive loop inside: nodes, estimate, and when it should end."""
    def state(row: Row) -> dict[str, object]:
        words = f"step {row['step']}: {row['phase']}, {row['nodes']} nodes"
        if math.isfinite(row["estimate"]):
            words += f", estimate {row['estimate']:.2%}"
        expected = row["expected_seconds"]
        if not (math.isfinite(expected) and expected > 0):
            return {"description": words}
        return {"description": words, "total": expected, "completed": min(row["seconds"], expected),
                "end": f"about {max(expected - row['seconds'], 0.0):.0f} s more"}

    return _bar("first mesh", state)


@contextmanager
def _bar(begin: str, state: Callable[[Row], dict[str, object]]) -> Iterator[Callable[[Row], None] | None]:
    """Send adaptmg's log from INFO on to standard error; on a terminal also yield a callback that updates a bar."""
    from rich.console import Console
    from rich.logging import RichHandler
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    handler = RichHandler(console=console, show_time=False, show_level=False, show_path=False)
    handler.addFilter(lambda record: record.name != "adaptmg.solver.solve")  # the command prints the result
    with logged("adaptmg", logging.INFO, handler):
        if not console.is_terminal:
            yield None
            return
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("{task.fields[end]}"))
        with Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task(begin, total=None, end="")
            yield lambda row: bar.update(task, **state(row))


@contextmanager
def logged(name: str, level: int, handler: logging.Handler) -> Iterator[None]:
    """Send a log to a handler inside."""
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
    """Return the folder to write to, if any, made before any work."""
    if given is not None:
        make_folder("--out", checks.file_path("--out", given))
    return given and given.expanduser()


def write(directory: Path | None, solved: Solved) -> list[Path]:
    """Write result, pictures and VTK file into a directory, if there is one; return the files."""
    if directory is None:
        return []
    import matplotlib

    matplotlib.use("Agg")
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
        pictures["cycles"] = lambda: am.plot.path(result)
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
