"""The runs of ``estimator_effectivity.py``: adaptive loops, measured step by step.

Every run is one row of a :class:`adaptmg.Study`; what holds one entry a step is kept there as JSON. Seconds are
processor time of one thread, which other programs on the machine hardly change.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
from statistics import median
from typing import Any

import common  # noqa: F401  (one BLAS thread)
import numpy as np
from adaptive_cases import CASES
from adaptive_runs import first_mesh, known

import adaptmg as am
from adaptmg.estimate import energy_error
from adaptmg.estimate.loop import carried
from adaptmg.solver.multigrid import WarmMultigrid
from adaptmg.transfer import size_ratio

ENGINES = {"remeshed": am.Remesh(), "bisected": am.Bisect()}
#: exact Coulomb transitions: name -> (kind, sign)
EXACT = {f"slip and {kind}, {sign}": (kind, sign) for kind in ("open", "stick") for sign in "+-"}
#: their first element size, m
EXACT_START = 0.5
#: with several bodies
PAIRS = ("dovetail", "bolted junction", "two blocks 3D")
#: single quantities in place of those of the cases
GOALS = {"GRECO bar": am.Displacement(am.cases.greco_bar().reference["points"]["C"], "x")}
#: of the estimate, that the algebraic error may have
SHARE = 0.1
#: tolerance to which discrete solutions count as exact, and that of the rate
EXACT_RTOL = 1e-10
#: cycles over which a rate is taken
RATE_CYCLES = 8


def posed(case: str) -> tuple[am.ContactProblem, float | am.MeshArrays]:
    """A problem by name, and what its loops start from: an element size, m, or a mesh."""
    if case in EXACT:
        kind, sign = EXACT[case]
        return am.cases.coulomb_transition(kind=kind, sign=sign), EXACT_START
    problem = CASES[case].problem()
    start = first_mesh(CASES[case], problem)
    return problem, start.finest.mesh if isinstance(start, am.Hierarchy) else start


def error_of(case: str, result: am.Result, reference_nodes: int) -> Any:
    """The energy error of a result: exact where the field is known, else against a fine reference."""
    if case in EXACT:
        return posed(case)[0].reference["field"].energy_error(result)
    return energy_error(known(case, reference_nodes).energy, result)


@lru_cache(maxsize=1)
def steps_of(case: str, engine: str, most: int) -> tuple[am.Step, ...]:
    """The adaptive loop with the residual indicator."""
    problem, start = posed(case)
    return tuple(am.adapt(problem, start, engine=ENGINES[engine], max_nodes=most))


def loop(case: str, engine: str, most: int, reference_nodes: int) -> dict[str, Any]:
    """What each step of a loop shows: JSON, a list of one mapping a step."""
    steps = steps_of(case, engine, most)
    rows = []
    for before, step in zip((None, *steps), steps, strict=False):
        error = error_of(case, step.result, reference_nodes)
        ratios = [size_ratio(coarse.mesh, fine.mesh) for coarse, fine in pairwise(step.hierarchy.levels)]
        zz = am.Recovery().indicate(step.hierarchy, step.result)
        rows.append({"step": step.number, "nodes": step.nodes, "contact_nodes": len(step.result.contact),
                     "levels": len(step.hierarchy), "size_ratio": max(ratios, default=np.nan),
                     "error": error.relative, "allowance": error.allowance / error.norm,
                     "estimate": step.estimate.relative, "residual_effectivity": step.estimate.total / error.absolute,
                     "zz_effectivity": zz.total / error.absolute, "cycles": step.result.cycles,
                     "work": step.work_units, "work_in_all": step.total_work_units}
                    | algebraic(before, step, error.absolute / step.estimate.norm))
    return {"steps": json.dumps(rows), "ended": steps[-1].outcome}


def algebraic(before: am.Step | None, step: am.Step, error: float) -> dict[str, Any]:
    """Cycles that are needed, algebraic error left by the loop, and the asymptotic rate."""
    if before is None or len(step.hierarchy) < 2:
        return dict.fromkeys(("needed", "needed_zz", "start_left", "left", "rate", "exact_cycles"), np.nan)
    h = step.hierarchy
    exact = am.solve(h, am.FullMultigrid(rtol=EXACT_RTOL, max_cycles=300), throw=False)
    start = warm_start(before, h)
    wanted = SHARE * step.estimate.relative
    run = am.solve(h, WarmMultigrid(rtol=max(1e-3 * wanted, 1e-8)), start=start, reference=exact, throw=False)
    ran = am.solve(h, WarmMultigrid(rtol=0.5, max_cycles=1), start=step.result, reference=exact, throw=False)
    cycle, left = run.history["cycle"], run.history["true_error"]
    return {"needed": first(cycle, left <= wanted), "needed_zz": first(cycle, left <= SHARE * error),
            "start_left": float(left[0]) / step.estimate.relative,
            "left": float(ran.history["true_error"][0]) / step.estimate.relative,
            "rate": asymptotic_rate(exact), "exact_cycles": exact.cycles, "exact_status": exact.status.name}


def asymptotic_rate(result: am.Result) -> float:
    """Mean rate of the last cycles of multigrid; with fewer it wavers, as past iterates are recombined."""
    changes = result.history["change"]
    if "status_changes" in result.history:
        # rows of the method that took over, if one did, have none
        changes = changes[np.isfinite(result.history["status_changes"])]
    changes = changes[np.isfinite(changes) & (changes > 0)]
    count = min(RATE_CYCLES, len(changes) - 1)
    return float((changes[-1] / changes[-1 - count]) ** (1 / count)) if count > 0 else np.nan


def first(cycle: np.ndarray, reached: np.ndarray) -> float:
    """The first cycle from which on it is reached; NaN if never."""
    return float(cycle[np.argmax(reached)]) if reached.any() else np.nan


def warm_start(before: am.Step, hierarchy: am.Hierarchy) -> np.ndarray:
    """The displacement of a step carried to the finest mesh of the next, as the loop does."""
    mesh = before.hierarchy.finest.mesh
    below = [k for k, level in enumerate(hierarchy.levels) if level.mesh is mesh]
    if not below:
        # the loop did without the level later
        hierarchy = before.hierarchy.append(hierarchy.finest.mesh)
        below = [len(hierarchy) - 2]
    return carried(hierarchy, below[0], before.result.displacement)


def cost(case: str, engine: str, theta: float, most: int, turns: int) -> dict[str, Any]:
    """Work and seconds of a loop over those of nested starts on its last meshes alone; medians of turns."""
    warm_up()
    problem, start = posed(case)
    found: dict[str, list[float]] = {}
    for _ in range(turns):
        phases, last = timed_loop(problem, start, ENGINES[engine], am.Doerfler(theta), most)
        meshes = [level.mesh for level in last.hierarchy.levels]
        build, grids = cpu(lambda meshes=meshes: am.Hierarchy.from_meshes(problem, meshes))
        alone, nested = cpu(lambda grids=grids: am.solve(grids, am.FullMultigrid(rtol="discretisation"), throw=False))
        tight, full = cpu(lambda grids=grids: am.solve(grids, am.FullMultigrid(rtol=1e-8, max_cycles=300), throw=False))
        for name, value in {**phases, "build": build, "alone": alone, "tight": tight}.items():
            found.setdefault(name, []).append(value)
    dim = last.result.dim
    exact = am.solve(last.hierarchy, am.FullMultigrid(rtol=EXACT_RTOL, max_cycles=300), throw=False)
    return {f"{name}_s": median(values) for name, values in found.items()} | {
        "nodes": last.nodes, "levels": len(last.hierarchy), "steps": last.number + 1, "dim": dim,
        "rate": asymptotic_rate(exact), "loop_work": last.total_work_units, "nested_work": nested.work_units,
        "nested_cycles": nested.cycles, "tight_work": full.work_units, "tight_cycles": full.cycles,
        "tight_status": full.status.name}


def timed_loop(problem: am.ContactProblem, start: Any, engine: Any, mark: Any, most: int
               ) -> tuple[dict[str, float], am.Step]:
    """Processor seconds by phase (mesh, assembly, solve, estimate), without the first mesh, and the last step."""
    seconds = dict.fromkeys(("mesh", "assembly", "solve", "estimate"), 0.0)
    now, phase = [0.0], [""]

    def heard(said: dict[str, Any]) -> None:
        if phase[0] in seconds:
            seconds[phase[0]] += time.process_time() - now[0]
        now[0], phase[0] = time.process_time(), said["phase"]

    for step in am.adapt(problem, start, engine=engine, mark=mark, max_nodes=most, progress=heard):
        last = step
    return seconds, last


def cpu(run: Callable[[], Any]) -> tuple[float, Any]:
    """Processor seconds of a call, and what it returns."""
    begin = time.process_time()
    value = run()
    return time.process_time() - begin, value


def goal_loop(case: str, most: int, reference_nodes: int) -> dict[str, Any]:
    """Signed estimates of a goal on meshes that follow it, against the corrected value on the last, finer mesh."""
    problem, start = posed(case)
    goal = am.Goal(GOALS.get(case, CASES[case].goal))
    steps = list(am.adapt(problem, start, goal, engine=am.Bisect(), max_nodes=reference_nodes))
    last = steps[-1].estimate
    values, errors = (np.array([getattr(step.estimate, name) for step in steps]) for name in ("value", "signed"))
    exact = last.value + last.signed
    rows = [{"step": step.number, "nodes": step.nodes, "value": value, "error": exact - value, "signed": signed,
             "absolute": float(step.estimate.squares.sum())}
            for step, value, signed in zip(steps, values, errors, strict=True) if step.nodes <= most]
    return {"steps": json.dumps(rows), "exact": exact, "reference": steps[-1].nodes, "reference_signed": last.signed}


@lru_cache(maxsize=1)
def warm_up() -> None:
    """Compile and load what the loops need, so that no measured second is one of the compiler."""
    for case in ("upset block", "dovetail", "bolted junction", "upset block 3D", "two blocks 3D"):
        problem, start = posed(case)
        for engine in ENGINES.values():
            for step in am.adapt(problem, start, engine=engine, max_nodes=300):
                last = step
        if len(last.hierarchy) > 1:
            am.solve(last.hierarchy, am.FullMultigrid(rtol="discretisation"), throw=False)


def rows_of(table: Any, keys: Sequence[str]) -> list[dict[str, Any]]:
    """The steps of stored loops, with the parameters named in ``keys``."""
    return [{**{key: row[key] for key in keys}, **step} for _, row in table.iterrows()
            for step in json.loads(row["steps"])]
