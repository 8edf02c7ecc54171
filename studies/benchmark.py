"""The fast solver against linear solvers on the same mesh: cycles, work, seconds by phase, memory, scaling.

Both sides are stopped at a true relative energy error of 1e-8, each for its own problem: ours of the contact problem
with friction, the rivals of the linear problem in which all contact dofs are fixed ('glued'). Our seconds hold the
nested start; set-up (splitting and coarse matrices) and transfers are listed apart and in a ratio of their own. A first
run learns how many cycles or iterations that takes; timed runs then do exactly that many, in turns, medians are kept.
The exact solution of a contact problem is our own at an estimated error of 1e-13, on grids small enough checked against
the active set method with direct solves.

    python studies/benchmark.py [--quick | --full] [--out DIR]
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from statistics import median
from typing import Any

import benchmark_tables as shown
import common
import linear_rivals as rivals
import numpy as np
import pandas as pd
import waiting

import adaptmg as am
from adaptmg.multigrid.rigid_motions import RigidMotions
from adaptmg.multigrid.truncated_step import TruncatedStep
from adaptmg.solver.record import Outcome, Run
from adaptmg.solver.truncated import TruncatedRun

TOLERANCE = 1e-8

#: family -> sizes: divisions of the finest grid, or halvings of the coarsest mesh
SIZES = {"nested 2D": (128, 192, 256, 384, 512, 768, 1024), "nested 3D": (16, 32, 64), "independent 2D": (4, 5, 6),
         "independent 3D": (2, 3)}
QUICK = {"nested 2D": (32, 64), "nested 3D": (8,), "independent 2D": (2,), "independent 3D": (1,)}
#: nodes up to which each check or rival is run
ACTIVE_SET, CHOLESKY, ALL_SETTINGS, SINGLE_GRID = 20_000, 300_000, 70_000, 1_200
FRICTION, QUICK_FRICTION = (0.0, 0.1, 0.3, 0.6, 1.0, 1.5, 2.0), (0.3, 2.0)


@lru_cache(maxsize=1)
def grids(family: str, size: int, friction: float) -> am.Hierarchy:
    """A hierarchy of the GRECO bar or block."""
    law = am.Coulomb(friction) if friction > 0 else am.Frictionless()
    if family == "nested 2D":
        return am.Hierarchy.uniform(am.cases.greco_bar(law=law), _halved(size, 4))
    if family == "nested 3D":
        return am.Hierarchy.uniform(am.cases.greco_block(law=law, plane_strain=False), _halved(size, 2))
    if family == "independent 2D":
        return am.Hierarchy.graded(am.cases.greco_bar(law=law), [16e-3 / 2**k for k in range(size + 1)], 2.0)
    return am.Hierarchy.graded(am.cases.greco_block(law=law, plane_strain=False),
                               [16e-3 / 2**k for k in range(size + 1)], 2.0)


def _halved(size: int, smallest: int) -> list[int]:
    chain = [size]
    while chain[0] % 2 == 0 and chain[0] // 2 >= smallest:
        chain.insert(0, chain[0] // 2)
    return chain


def run_ours(hierarchy: am.Hierarchy, rtol: float, max_cycles: int = 100, reference: np.ndarray | None = None
             ) -> tuple[Run, Outcome, int]:
    """One run, without the checks around it; the record, the outcome, bytes of the solver's arrays."""
    solver = am.FullMultigrid(correction=am.Truncated(), rtol=rtol, max_cycles=max_cycles)
    run = Run(unit=hierarchy.finest.matrix.nnz, reference=reference)
    machine = _Measured(solver.truncated, hierarchy, run)
    outcome = machine.from_nested(solver.start)
    return run, outcome, machine.nbytes


class _Measured(TruncatedRun):
    """A run that notes the memory of its last step."""

    def _step(self, number: int, unknowns: np.ndarray) -> TruncatedStep:
        step = super()._step(number, unknowns)
        self.nbytes = _bytes(step, set())
        return step


def _bytes(thing: Any, seen: set[int]) -> int:
    """Memory of the arrays that a step, its matrices and transfers hold, bytes."""
    if id(thing) in seen or isinstance(thing, Run | RigidMotions):
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return thing.nbytes
    parts = thing if isinstance(thing, list | tuple) else thing.values() if isinstance(thing, dict) else vars(
        thing).values() if hasattr(thing, "__dict__") else ()
    return sum(_bytes(part, seen) for part in parts)


def full_passes(run: Run, hierarchy: am.Hierarchy) -> float:
    """Every sweep, and every residual on a coarser level, as a whole pass over the discretised matrix of its level."""
    finest = len(hierarchy) - 1
    total = 0.0
    for level, action, times in run.path:
        passes = times if action == "smooth" else 1 if action == "restrict" and level < finest else 0
        total += passes * hierarchy[level].matrix.nnz
    return total / run.unit


@dataclass(frozen=True)
class Needed:
    """What the tolerance takes."""

    cycles: int
    start_error: float
    row: dict[str, float]
    run: Run
    nbytes: int
    status: str
    rate: float


def needed(hierarchy: am.Hierarchy) -> Needed:
    """Cycles to the true error of 1e-8."""
    _, exact, _ = run_ours(hierarchy, 1e-13)
    if hierarchy.finest.n_nodes <= ACTIVE_SET:
        checked = am.solve(hierarchy, am.ActiveSet(rtol=1e-12, nested_start=True)).displacement
        difference = np.abs(checked - exact.displacement).max() / np.abs(checked).max()
        if not difference <= 1e-9:
            raise RuntimeError(f"the active set solution differs by {difference:.1e}")
    run, outcome, nbytes = run_ours(hierarchy, 1e-10, reference=exact.displacement)
    below = [row for row in run.history if row["true_error"] <= TOLERANCE]
    if not below:
        raise RuntimeError(f"the error stays at {run.history[-1]['true_error']:.1e}: {outcome.status.name}")
    return Needed(int(below[0]["cycle"]), run.history[0]["true_error"], below[0], run, nbytes, outcome.status.name,
                  outcome.rate)


def measure(family: str, size: int, friction: float, repetitions: int, linear: bool) -> dict[str, Any]:
    """One row."""
    hierarchy = grids(family, size, friction)
    found = needed(hierarchy)
    n, dofs = hierarchy.finest.n_nodes, hierarchy.finest.matrix.shape[0]
    row: dict[str, Any] = {"nodes": n, "levels": len(hierarchy), "cycles": found.cycles, "rate": found.rate,
                           "work": found.row["work_units"], "start_work": found.run.start_work_units,
                           "start_error": found.start_error, "bytes_per_dof": found.nbytes / dofs}
    calls: dict[str, Any] = {"ours": lambda: _time_ours(hierarchy, max(found.cycles, 1))}
    problem = rivals.glued(hierarchy) if linear else None
    if problem is not None and family.startswith("nested"):
        iterations = rivals.iterations_needed(problem, rivals.geometric_preconditioner(problem)[0])
        calls["mgcg"] = lambda: _time_linear(problem, lambda: rivals.geometric_preconditioner(problem)[0], iterations)
        if n <= CHOLESKY:
            build = partial(rivals.geometric_pyamg_preconditioner, problem)
            count = rivals.iterations_needed(problem, build())
            calls["pyamg mgcg"] = partial(_time_linear, problem, build, count)
    if problem is not None:
        names = list(rivals.SETTINGS) if n <= ALL_SETTINGS else ["defaults"]
        for name in names:
            count = rivals.iterations_needed(problem, rivals.pyamg_preconditioner(problem, name))
            calls[f"sa {name}"] = partial(_time_linear, problem,
                                          partial(rivals.pyamg_preconditioner, problem, name), count)
    seconds: dict[str, list[dict[str, float]]] = {name: [] for name in calls}
    for _ in range(repetitions):
        for name, call in calls.items():
            seconds[name].append(call())
    times = {name: {key: median(one[key] for one in each) for key in each[0]} for name, each in seconds.items()}
    own = times["ours"]
    row |= {"full_passes": own["full_passes"], "solve_s": own["solve"], "setup_s": own["setup"]}
    row |= {f"{name}_s": hierarchy.timings[name] for name in ("mesh", "assembly", "transfer")}
    if problem is not None:
        row |= _ratios(times, row, hierarchy, problem)
    return row


def _time_ours(hierarchy: am.Hierarchy, cycles: int) -> dict[str, float]:
    # the tolerance is out of reach, so that exactly that many cycles are done
    run, _, _ = run_ours(hierarchy, 1e-300, cycles)
    return {"setup": run.timings["setup"], "solve": run.timings["start"] + run.timings["cycles"],
            "full_passes": full_passes(run, hierarchy)}


def _time_linear(problem: rivals.Glued, build: Any, iterations: int) -> dict[str, float]:
    timed = rivals.time_iterative(problem, build, iterations)
    return {"iterations": timed.iterations, "setup": timed.setup, "solve": timed.solve,
            "total": timed.setup + timed.solve}


def _ratios(times: dict[str, dict[str, float]], row: dict[str, Any], hierarchy: am.Hierarchy, problem: rivals.Glued
            ) -> dict[str, float]:
    """Our seconds over those of the rivals."""
    own, whole = row["solve_s"], row["solve_s"] + row["setup_s"] + row["transfer_s"]
    settings = {name: one for name, one in times.items() if name.startswith("sa ")}
    best = min(settings, key=lambda name: settings[name]["total"])
    default = settings["sa defaults"]
    result: dict[str, Any] = {
        "pyamg_iterations": default["iterations"], "pyamg_setup_s": default["setup"], "pyamg_solve_s": default["solve"],
        "over_pyamg": own / default["total"], "with_setup_over_pyamg": whole / default["total"],
        "best_setting": best.removeprefix("sa "), "over_best_pyamg": own / settings[best]["total"]}
    if "mgcg" in times:
        result |= {"mgcg_iterations": times["mgcg"]["iterations"], "mgcg_solve_s": times["mgcg"]["solve"],
                   "over_mgcg": own / times["mgcg"]["solve"]}
    if "pyamg mgcg" in times:
        result["over_pyamg_mgcg"] = own / times["pyamg mgcg"]["solve"]
    limit = CHOLESKY if problem.hierarchy.finest.discrete.dim == 2 else CHOLESKY // 6
    if row["nodes"] <= limit and hierarchy.finest.mesh.source is not None:
        factorised = rivals.time_cholesky(hierarchy, problem.fixed[-1])
        result |= {"cholesky_s": factorised.setup + factorised.solve,
                   "over_cholesky": own / (factorised.setup + factorised.solve)}
    return result


METHODS = {
    "truncated": lambda: am.FullMultigrid(correction=am.Truncated()),
    "monotone": lambda: am.FullMultigrid(correction=am.Monotone()),
    "active set, direct": lambda: am.ActiveSet(rtol=TOLERANCE),
    "active set, direct, nested start": lambda: am.ActiveSet(rtol=TOLERANCE, nested_start=True),
    "active set, pyamg, nested start": lambda: am.ActiveSet(linear=am.AMG(), rtol=TOLERANCE, nested_start=True),
    "single grid, omega 1": lambda: am.SingleGrid(),
    "single grid, omega 1.9": lambda: am.SingleGrid(omega=1.9),
    "single grid, omega 1.5, condensed": lambda: am.SingleGrid(omega=1.5, condensed=True),
}


def contact_method(size: int, method: str) -> dict[str, Any]:
    """A method for the same contact problem, to an estimated error of 1e-8; the better of two runs."""
    hierarchy = grids("nested 2D", size, 1.0)
    if "single" in method and hierarchy.finest.n_nodes > SINGLE_GRID:
        return {"nodes": hierarchy.finest.n_nodes, "outcome": "not run"}
    results = [am.solve(hierarchy, METHODS[method](), throw=False) for _ in range(2)]
    last = results[-1]
    return {"nodes": hierarchy.finest.n_nodes, "cycles": last.cycles, "work": last.work_units,
            "s": min(sum(r.timings.values()) for r in results), "residual": last.residual, "outcome": last.status.name}


def run(context: common.Context) -> common.Section:
    """All tables."""
    run_ours(grids("nested 2D", 16, 1.0), TOLERANCE)
    run_ours(grids("nested 3D", 4, 1.0), TOLERANCE)
    sizes, repetitions = (QUICK, 2) if context.quick else (SIZES, 5)
    parts, friction = [], []
    for family, each in sizes.items():
        parts.append(context.study(measure, {"family": [family], "size": list(each), "friction": [1.0]},
                                   repetitions=repetitions, linear=True, timed=True))
        middle = each[0] if context.quick else each[min(1, len(each) - 1)]
        coefficients = QUICK_FRICTION if context.quick else FRICTION
        friction.append(context.study(measure, {"family": [family], "size": [middle], "friction": list(coefficients)},
                                      repetitions=1, linear=False, timed=True))
    rows = pd.concat(parts, ignore_index=True)
    against = context.study(contact_method, {"size": [16, 32] if context.quick else [32, 64, 128],
                                             "method": list(METHODS)}, timed=True)
    items: list[common.Table | common.Figure] = [
        shown.work_table(rows), shown.seconds_table(rows), *shown.scaling_table(rows),
        shown.friction_table(pd.concat(friction, ignore_index=True)), shown.methods_table(against),
        waiting.table(context), shown.figure(rows)]
    return common.Section("The fast solver", __doc__.split("\n\n")[1], items, summary=shown.summary(rows))


if __name__ == "__main__":
    common.main(run, __doc__.split("\n")[0] + " Example: python studies/benchmark.py --quick --out /tmp/benchmark")
