"""What ``adaptmg adapt`` does: the loop with a line a step, its summary, and its files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import adaptmg as am
from adaptmg.cli import work
from adaptmg.cli.choices import EngineName, IndicatorName
from adaptmg.cli.plain import finite

__all__ = ["limits", "stepped", "summary", "write"]

_NODES = 20_000
_ENGINES = {EngineName.REMESH: "Remesh", EngineName.BISECT: "Bisect"}
_INDICATORS = {IndicatorName.RESIDUAL: "Residual", IndicatorName.RECOVERY: "Recovery"}


def limits(tolerance: float | None, max_nodes: int | None, max_seconds: float | None) -> dict[str, Any]:
    """The limits that are given; a number of nodes where none is."""
    given = {"tolerance": tolerance, "max_nodes": max_nodes, "max_seconds": max_seconds}
    given = {name: value for name, value in given.items() if value is not None}
    return given or {"max_nodes": _NODES}


def stepped(problem: am.ContactProblem, start: float | None, indicator: IndicatorName, engine: EngineName, theta: float,
            stops: dict[str, Any], store: Path | None, progress: Callable[[dict[str, Any]], None] | None,
            say: Callable[[str], None]) -> list[am.Step]:
    """Go through the loop and say each step."""
    loop = am.adapt(problem, start, getattr(am, _INDICATORS[indicator])(), am.Doerfler(theta),
                    getattr(am, _ENGINES[engine])(), store=store, progress=progress, **stops)
    say(am.Step.HEADER)
    steps = []
    for step in loop:
        steps.append(step)
        say(repr(step))
    return steps


def summary(steps: list[am.Step], files: list[Path]) -> dict[str, Any]:
    """What the command prints as JSON; numbers that are not finite become null."""
    rows = [{"step": step.number, "nodes": step.nodes, "levels": [level.n_nodes for level in step.hierarchy.levels],
             "contact_nodes": len(step.result.contact), "estimate": step.estimate.relative,
             "estimate_total": step.estimate.total, "terms": dict(step.estimate.terms), "cycles": step.result.cycles,
             "rate": step.result.rate, "rtol": step.result.rtol, "work_units": step.work_units,
             "total_work_units": step.total_work_units, "seconds": step.seconds, "total_seconds": step.total_seconds,
             "timings": dict(step.timings)} for step in steps]
    last = steps[-1]
    return finite({"problem": last.result.problem_name, "indicator": last.estimate.indicator,
                        "outcome": last.outcome, "steps": rows, "result": work.summary(last.result, files)})


def write(directory: Path, problem: am.ContactProblem, steps: list[am.Step]) -> list[Path]:
    """Last result, pictures and VTK file into a directory, made where missing; returns what was written."""
    last = steps[-1]
    files = work.write(directory, problem, last.hierarchy, last.result)
    return [*files, work.save_picture(directory / "adaptation.png", am.plot.adaptation(steps))]
