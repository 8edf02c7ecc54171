"""Algebraic multigrid (pyamg) on the same matrices: the glued problem, the steps of the active set method, and ours.

1. The glued problem (all contact dofs fixed, hence linear): conjugate gradients with smoothed aggregation, with and
   without rigid-body modes, compared with the contact problem solved by FullMultigrid on the same grid, by default
   (truncated mode) and in the monotone mode.
2. The contact problem: FullMultigrid against the active set method with direct and with algebraic linear solves, cold
   and from coarser grids.

Algebraic multigrid is smoothed aggregation of pyamg with its default options, block Gauss-Seidel. A compiled block
sweep is quicker than pyamg's, so that seconds favour ours more than work units do.

    python studies/amg_comparison.py [--quick | --full] [--out DIR]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from statistics import median
from time import perf_counter
from typing import Any

import common
import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from paper_runs import span
from scipy import sparse

import adaptmg as am
from adaptmg.plot.style import CYCLE, styled
from adaptmg.solver.active_set import glued_system
from adaptmg.solver.linear import LinearSolution, Prepared

RTOL = 1e-8
MAX_CYCLES = 400

#: grids -> finest divisions, or halvings of 20 mm
LINEAR: Mapping[str, tuple[int, ...]] = {"uniform": (32, 64, 128), "graded": (5,), "3D block": (8,)}
FULL_LINEAR: Mapping[str, tuple[int, ...]] = {"uniform": (32, 64, 128, 256), "graded": (5,), "3D block": (8, 16)}
CONTACT: Mapping[str, tuple[int, ...]] = {"uniform": (32, 64, 128), "graded": (5,), "3D block": (8,)}
QUICK_LINEAR: Mapping[str, tuple[int, ...]] = {"uniform": (16, 32, 64), "graded": (3,)}
QUICK_CONTACT: Mapping[str, tuple[int, ...]] = {"uniform": (16, 32), "graded": (3,)}
REPETITIONS = 3
#: seconds of a call that is not repeated
LONG_S = 0.5
NEWTON = "ActiveSet, direct, nested"
MODES, DEFAULT, MONOTONE = "AMG-CG, rigid-body modes", "contact, FullMultigrid", "contact, monotone mode"


@lru_cache(maxsize=8)
def grids_of(grid: str, size: int) -> am.Hierarchy:
    """The hierarchy of a row."""
    if grid == "graded":
        return am.Hierarchy.graded(am.cases.greco_bar(law=am.Coulomb(1.0)), [20e-3 / 2**k for k in range(size + 1)],
                                   contact_ratio=4)
    case = am.cases.greco_bar if grid == "uniform" else am.cases.greco_block
    chain = [size]
    while chain[0] % 2 == 0 and chain[0] > (4 if grid == "uniform" else 2):
        chain.insert(0, chain[0] // 2)
    return am.Hierarchy.uniform(case(law=am.Coulomb(1.0)), chain)


@dataclass
class Counted:
    """A linear solver for :class:`adaptmg.ActiveSet` that counts the iterations of another."""

    linear: am.AMG
    iterations: int = 0

    def setup(self, matrix: sparse.bsr_array, near_nullspace: np.ndarray | None = None, *, symmetric: bool = True,
              preconditioner: sparse.bsr_array | None = None, previous: Prepared | None = None) -> CountedPrepared:
        """As the solver inside."""
        inner = previous.inner if isinstance(previous, CountedPrepared) else previous
        return CountedPrepared(self.linear.setup(matrix, near_nullspace, symmetric=symmetric,
                                                 preconditioner=preconditioner, previous=inner), self)


@dataclass
class CountedPrepared:
    """What :class:`Counted` prepares."""

    inner: Prepared
    counter: Counted = field(repr=False)

    def solve(self, rhs: np.ndarray, start: np.ndarray | None = None, rtol: float = 1e-10) -> LinearSolution:
        """As the one inside, counted."""
        solution = self.inner.solve(rhs, start, rtol)
        self.counter.iterations += solution.iterations
        return solution


def glued(discrete: am.DiscreteProblem) -> tuple[sparse.bsr_array, np.ndarray, np.ndarray, np.ndarray]:
    """Matrix, load, rigid-body modes and constant vectors of the problem with all contact dofs fixed at zero."""
    matrix, load, modes = glued_system(discrete)
    free = np.abs(modes).sum(axis=1) > 0
    constants = np.tile(np.eye(discrete.dim), (len(load) // discrete.dim, 1))
    return matrix, load, modes, constants * free[:, None]


def medians(calls: Mapping[str, Callable[[], dict[str, Any]]], repetitions: int) -> dict[str, Any]:
    """Run all calls in turns; results of the last turn, with medians of what ends in ``_s``; keys 'name: result'."""
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in calls}
    long = set()
    for _ in range(repetitions):
        for name in [name for name in calls if name not in long]:
            begin = perf_counter()
            rows[name].append(calls[name]())
            if perf_counter() - begin > LONG_S:
                long.add(name)
    return {f"{name}: {key}": median(row[key] for row in found) if key.endswith("_s") else value
            for name, found in rows.items() for key, value in found[-1].items()}


def linear(grid: str, size: int, rtol: float, max_cycles: int, repetitions: int) -> dict[str, Any]:
    """The glued problem by pyamg, and in the same turns the contact problem by FullMultigrid."""
    common.warm_up(3 if grid == "3D block" else 2)
    hierarchy = grids_of(grid, size)
    discrete = hierarchy.finest.discrete
    matrix, load, modes, constants = glued(discrete)
    solution = am.AMG().setup(matrix, modes).solve(load, rtol=1e-11)
    if not solution.converged:
        raise RuntimeError(f"the glued problem is solved to a residual of {solution.residual:.1e} only, wanted 1e-11")
    exact = solution.unknowns

    def by_amg(near_nullspace: np.ndarray) -> dict[str, Any]:
        begin = perf_counter()
        prepared = am.AMG().setup(matrix, near_nullspace)
        middle = perf_counter()
        solution = prepared.solve(load, rtol=rtol)
        seconds = perf_counter() - middle
        error = solution.unknowns - exact
        return {"setup_s": middle - begin, "solve_s": seconds, "total_s": middle - begin + seconds,
                "iterations": solution.iterations, "work": solution.passes,
                "complexity": prepared.hierarchy.operator_complexity(),
                "energy_error": float(np.sqrt(error @ (matrix @ error) / (exact @ (matrix @ exact)))),
                "residual": solution.residual, "outcome": "CONVERGED" if solution.converged else "LIMIT"}

    def by_multigrid(correction: Any) -> dict[str, Any]:
        result = am.solve(hierarchy, am.FullMultigrid(correction=correction, rtol=rtol, max_cycles=max_cycles),
                          throw=False)
        phases = common.seconds_by_phase(hierarchy, result)
        return {"setup_s": phases["setup_s"], "solve_s": phases["solve_s"], "total_s": result.seconds,
                "iterations": result.cycles, "work": result.work_units, "complexity": hierarchy.operator_complexity,
                "energy_error": result.error_estimate, "residual": result.residual, "outcome": result.status.name}

    calls = {DEFAULT: lambda: by_multigrid(am.Truncated()), MODES: lambda: by_amg(modes),
             "AMG-CG, constants": lambda: by_amg(constants), MONOTONE: lambda: by_multigrid(am.Monotone())}
    return {"nodes": discrete.n_nodes, "transfer_s": hierarchy.timings["transfer"], **medians(calls, repetitions)}


def contact(grid: str, size: int, rtol: float, max_cycles: int, repetitions: int) -> dict[str, Any]:
    """The contact problem by every method, in turns."""
    common.warm_up(3 if grid == "3D block" else 2)
    hierarchy = grids_of(grid, size)
    exact = am.solve(hierarchy, am.ActiveSet(rtol=1e-12, nested_start=True))

    def by(make: Callable[[Counted], Any]) -> dict[str, Any]:
        counter = Counted(am.AMG())
        result = am.solve(hierarchy, make(counter), reference=exact, throw=False)
        first = common.first_below(result, rtol)
        return {"iterations": result.cycles, "inner": counter.iterations, "work": result.work_units,
                "total_s": float(result.history["seconds"][-1]), "target_work": first["work_units"],
                "target_s": first["seconds"], "energy_error": float(result.history["true_error"][-1]),
                "residual": result.residual, "outcome": result.status.name}

    calls = {"FullMultigrid": lambda: by(lambda _: am.FullMultigrid(rtol=rtol, max_cycles=max_cycles)),
             "ActiveSet, direct, cold": lambda: by(lambda _: am.ActiveSet(rtol=rtol)),
             NEWTON: lambda: by(lambda _: am.ActiveSet(rtol=rtol, nested_start=True)),
             "ActiveSet, AMG, cold": lambda: by(lambda counted: am.ActiveSet(linear=counted, rtol=rtol)),
             "ActiveSet, AMG, nested": lambda: by(lambda counted: am.ActiveSet(linear=counted, rtol=rtol,
                                                                               nested_start=True)),
             "monotone mode": lambda: by(lambda _: am.FullMultigrid(correction=am.Monotone(), rtol=rtol,
                                                                    max_cycles=max_cycles))}
    return {"nodes": hierarchy.finest.discrete.n_nodes, **medians(calls, repetitions)}


def long_form(table: pd.DataFrame) -> pd.DataFrame:
    """One row a method, from columns 'method: result'."""
    methods = dict.fromkeys(name.split(": ")[0] for name in table.columns if ": " in name)
    common_columns = [name for name in table.columns if ": " not in name]
    parts = []
    for method in methods:
        own = {name: name.split(": ")[1] for name in table.columns if name.startswith(f"{method}: ")}
        parts.append(table[[*common_columns, *own]].rename(columns=own).assign(method=method))
    return pd.concat(parts).sort_index(kind="stable").reset_index(drop=True)


def run(context: common.Context) -> common.Section:
    """Both parts."""
    fixed = {"rtol": RTOL, "max_cycles": MAX_CYCLES, "repetitions": REPETITIONS}

    def rows(function: Callable[..., dict[str, Any]], families: Mapping[str, tuple[int, ...]]) -> pd.DataFrame:
        tables = [context.study(function, {"grid": [grid], "size": sizes}, timed=True, **fixed)
                  for grid, sizes in families.items()]
        return long_form(pd.concat(tables, ignore_index=True))

    glued_rows = rows(linear, QUICK_LINEAR if context.quick else FULL_LINEAR if context.full else LINEAR)
    contact_rows = rows(contact, QUICK_CONTACT if context.quick else CONTACT)
    block = ", the block with friction 1 in 3D" if (glued_rows["grid"] == "3D block").any() else ""
    text = ("The GRECO bar with friction 1 on uniform grids and on a graded Netgen mesh (four times finer at "
            f"contact){block}. Algebraic multigrid: smoothed aggregation of pyamg, its defaults, block Gauss-Seidel; "
            "with rigid-body modes, or with constant vectors, as pyamg takes by default. "
            f"Seconds are medians of {REPETITIONS} runs in turns (parts need not add up; above {LONG_S:g} s one run), "
            "alone on one thread, without meshing and assembly, which all methods share (the coarse grids' share "
            "apart), and without transfers. Our block sweeps are quicker than pyamg's, so that seconds favour ours "
            "more than work units do.")
    return common.Section("Algebraic multigrid on the same matrices", text, [
        linear_table(glued_rows), contact_table(contact_rows), seconds_figure(glued_rows, contact_rows)],
        summary=summary(glued_rows, contact_rows))


def summary(glued_rows: pd.DataFrame, contact_rows: pd.DataFrame) -> str:
    """What was asked and what came out."""
    own, amg, monotone = (by_method(glued_rows, name) for name in (DEFAULT, MODES, MONOTONE))
    ratio, other = own["total_s"] / amg["total_s"], monotone["total_s"] / amg["total_s"]
    uniform = ratio.loc["uniform"].sort_index()
    by = {name: group.set_index(["grid", "size"])["target_s"] for name, group in contact_rows.groupby("method")}
    newton = (by[NEWTON] / by["FullMultigrid"]).dropna()
    return ("Does the contact problem cost more than the linear one on the same matrix? FullMultigrid (the default) "
            f"takes {span(ratio, '.2g')} times the seconds of AMG-CG on the glued problem, "
            f"{uniform.iloc[-1]:.2g} times on the finest uniform grid here, and "
            f"{span(own['work'] / amg['work'], '.2g')} times the work units; the monotone mode "
            f"{span(other, '.2g')} times the seconds."
            + (f" The active set method with direct solves and a nested start takes {span(newton, '.2g')} times the "
               "seconds of FullMultigrid to the same true error." if len(newton) else ""))


def by_method(rows: pd.DataFrame, name: str) -> pd.DataFrame:
    """The rows of a method, by grid and size."""
    return rows[rows["method"] == name].set_index(["grid", "size"])


def linear_table(rows: pd.DataFrame) -> common.Table:
    """The glued problem compared with the contact problem."""
    modes, constants, ours = (by_method(rows, name) for name in (MODES, "AMG-CG, constants", DEFAULT))
    ratio = rows.apply(lambda row: row["total_s"] / modes.loc[(row["grid"], row["size"]), "total_s"], axis=1)
    frame = pd.DataFrame({
        "grid": rows["grid"], "nodes": rows["nodes"], "method": rows["method"], "iterations": rows["iterations"],
        "set-up": rows["setup_s"], "solve": rows["solve_s"], "total": rows["total_s"], "over AMG-CG": ratio,
        "work": rows["work"], "energy error": rows["energy_error"], "residual": rows["residual"],
        "status": rows["outcome"]})
    plain = constants["iterations"] / modes["iterations"]
    largest = ours.loc["uniform"].index.max()
    note = (
        f"AMG-CG solves the glued (linear) problem to a residual of {RTOL:g}, FullMultigrid the contact problem to an "
        "estimated error of as much. Iterations: CG steps, cycles on the finest grid; constant vectors in place of "
        f"rigid-body modes cost {span(plain, '.2f')} times as many. Over AMG-CG: total seconds over those with modes. "
        f"Transfers, not counted, take {ours.loc[('uniform', largest), 'transfer_s']:.2f} s on the finest uniform "
        "grid. Energy error: relative, of CG against a solution to 1e-11, of FullMultigrid as estimated.")
    caption = f"The glued problem by AMG-CG, the contact problem by multigrid (rtol {RTOL:g})"
    return common.Table("amg_glued", frame, caption, note,
                        dict.fromkeys(["set-up", "solve", "total"], "s") | {"over AMG-CG": "ratio", "work": "WU"},
                        {"set-up": ".3f", "solve": ".3f", "total": ".3f", "over AMG-CG": ".2f", "work": ".0f",
                         "energy error": ".1e", "residual": ".1e"})


def contact_table(rows: pd.DataFrame) -> common.Table:
    """All methods on the contact problem."""
    inner = rows["inner"].where(rows["method"].str.contains("AMG"))
    fastest = rows.groupby(["grid", "size"])["target_s"].transform("min")
    frame = pd.DataFrame({
        "grid": rows["grid"], "nodes": rows["nodes"], "method": rows["method"], "steps": rows["iterations"],
        "inner iterations": inner, "work": rows["work"], "total": rows["total_s"], "work to 1e-8": rows["target_work"],
        "time to 1e-8": rows["target_s"], "over fastest": rows["target_s"] / fastest,
        "true error": rows["energy_error"], "natural residual": rows["residual"], "status": rows["outcome"]})
    by = {name: group.set_index(["grid", "size"]) for name, group in rows.groupby("method")}
    words = []
    for name in (NEWTON, "ActiveSet, AMG, cold", "ActiveSet, AMG, nested"):
        ratio = (by[name]["target_s"] / by["FullMultigrid"]["target_s"]).dropna()
        if len(ratio):
            words.append(f"{name} {span(ratio, '.1f')}")
    missing = rows[rows["target_s"].isna()]
    failed = "".join(f" {row.method} did not reach it on {row.grid}, {row.nodes} nodes ({row.outcome}, true error "
                     f"{row.energy_error:.0e})." for row in missing.itertuples())
    note = (
        "Steps: Newton steps or cycles on the finest grid; inner iterations: of the linear solver, in all steps and on "
        "all levels. To 1e-8: when the true relative energy error first fell below it, interpolated between steps. "
        f"Direct factorisations are seconds, not work; the reference of the true error is itself found by {NEWTON}. "
        f"Seconds over those of FullMultigrid: {'; '.join(words)}.{failed}")
    return common.Table("amg_contact", frame, f"The contact problem: active set and multigrid (rtol {RTOL:g})", note,
                        dict.fromkeys(["total", "time to 1e-8"], "s") | {"over fastest": "ratio"}
                        | dict.fromkeys(["work", "work to 1e-8"], "WU"),
                        {"inner iterations": ".0f", "work": ".0f", "total": ".3f", "work to 1e-8": ".0f",
                         "time to 1e-8": ".3f", "over fastest": ".1f", "true error": ".1e",
                         "natural residual": ".1e"})


@styled
def seconds_figure(glued_rows: pd.DataFrame, contact_rows: pd.DataFrame) -> common.Figure:
    """Seconds against nodes on uniform grids: the contact problem to a true error, the glued one to a residual."""
    figure, ax = plt.subplots(figsize=(7.4, 4.4))
    own = contact_rows[contact_rows["grid"] == "uniform"]
    names = {"FullMultigrid": "FullMultigrid", "monotone mode": "FullMultigrid, monotone mode"}
    names |= {name: name for name in own["method"] if name.startswith("ActiveSet")}
    for k, (name, label) in enumerate(names.items()):
        rows = own[own["method"] == name]
        ax.loglog(rows["nodes"], rows["target_s"], marker="os^Dv<"[k], color=CYCLE[k], label=label)
    rows = by_method(glued_rows, MODES).loc["uniform"]
    ax.loglog(rows["nodes"], rows["total_s"], marker="P", color=CYCLE[6], linestyle=(0, (4, 3)),
              label="glued (linear) problem, AMG-CG")
    ax.set_xlabel("nodes")
    ax.set_ylabel("set-up and solve [s]")
    ax.grid(True)
    common.plain_ticks(ax.xaxis, ax.yaxis)
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return common.Figure("amg_seconds", figure, "GRECO bar on uniform grids: seconds of set-up and solve, of the "
                         "contact problem to a true error of 1e-8, of the linear one to a residual of 1e-8")


if __name__ == "__main__":
    common.main(run, "Algebraic multigrid (pyamg) on the same matrices.")
