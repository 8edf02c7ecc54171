"""How fast is it where people wait, against pyamg and the active set method?

    python studies/benchmark.py [--quick | --full] [--out DIR]
    python studies/benchmark.py --history FILE.csv

Processor seconds of one thread with warm kernels, the least of several runs, unless a row says
otherwise. A pass is the finest matrix read once at the speed of a triad (a = b + s c on long
arrays), so that passes compare machines. From problem to solution counts meshes, matrices,
transfers, set-up, nested start, cycles and the certificate; the linear rival is conjugate gradients
with smoothed aggregation of pyamg on the glued matrix of the same mesh, to a true error of 1e-8,
set-up counted.

--history appends one row for the commit to a table: cycles, work and passes of five problems, and
draws it next to the file. The tests compare these cycles with those stored."""

import argparse
import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterable
from datetime import date
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from common import Output, chain, cpu, drawing, main, processor_time, warm_up
from flexible import cantilever
from linear_rivals import glued, iterate, iterations_needed, pyamg_preconditioner
from plain_newton import plain_newton
from reproduce import commit
from threadpoolctl import threadpool_limits

import adaptmg as am

#: what a new process runs; the second number is the import
FIRST = """
import time
begin = time.perf_counter()
import adaptmg as am
imported = time.perf_counter() - begin
am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), (4, 8, 16, 32)), am.FullMultigrid())
print(time.perf_counter() - begin, imported)
"""


def triad() -> float:
    """Bytes a second of a = b + s c on arrays of 64 MB, three of which are touched."""
    a, b, c = (np.ones(2**23) for _ in range(3))

    def run() -> None:
        np.multiply(c, 3.0, out=a)
        np.add(a, b, out=a)

    return 5 * a.nbytes / cpu(run)


def bar(divisions: int, dim: int = 2) -> am.Hierarchy:
    """Uniform grids of the bar or the block."""
    make = am.cases.greco_bar if dim == 2 else am.cases.greco_block
    count = max(divisions.bit_length() - (2 if dim == 2 else 1), 1)
    return am.Hierarchy.uniform(make(), chain(divisions, count))


#: problems that --history and the tests watch
WATCHED: dict[str, Callable[[], am.Hierarchy]] = {
    "bar": lambda: bar(32),
    "block 3D": lambda: bar(8, dim=3),
    "dovetail": lambda: am.Hierarchy.graded(am.cases.dovetail(), (8e-3, 4e-3, 2e-3)),
    "bolted junction": lambda: am.Hierarchy.graded(
        am.cases.bolted_junction(), (12e-3, 7e-3, 4e-3), contact_ratio=2
    ),
    "cantilever 24 : 1": lambda: cantilever(24, 3),
}


def watched(name: str) -> tuple[am.Hierarchy, am.Result]:
    """Grids of a watched problem, and its solution by the default method to 1e-8."""
    grids = WATCHED[name]()
    return grids, am.solve(grids, am.FullMultigrid())


def history(file: Path, names: Iterable[str] = WATCHED, at: str | None = None) -> None:
    """Append a row for this commit (or ``at``) to a table, in place of an earlier one of the
    commit, and draw it."""
    row: dict[str, object] = {"commit": at or commit(), "date": str(date.today())}
    speed = triad()
    for name in names:
        grids, result = watched(name)
        matrix = grids.finest.matrix
        seconds = cpu(partial(am.solve, grids, am.FullMultigrid()))
        passes = seconds * speed / (matrix.data.nbytes + matrix.indices.nbytes)
        row |= {
            f"{name}: cycles": result.cycles,
            f"{name}: work": round(result.work_units, 1),
            f"{name}: passes": round(passes),
        }
    before = pd.read_csv(file) if file.exists() else pd.DataFrame(columns=["commit"])
    table = pd.concat([before[before["commit"] != row["commit"]], pd.DataFrame([row])])
    table.to_csv(file, index=False)
    figure, _ = drawing(6.0)
    figure.clear()
    for ax, what in zip(figure.subplots(2, sharex=True), ("cycles", "passes"), strict=True):
        for name in names:
            ax.plot(table["commit"], table[f"{name}: {what}"], "o-", label=name)
        ax.set(ylabel=what, ylim=(0, None))
    ax.tick_params(axis="x", rotation=90)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside right upper")
    figure.savefig(file.with_suffix(".png"))
    print(table.tail(2).T.to_string(header=False))


def meshing(case: str, levels: int) -> dict:
    """Graded hierarchies: microseconds a node of all levels' meshes, and hierarchy over solve."""
    warm_up(3 if case.endswith("3D") else 2)
    make, size, ratio = {
        "GRECO bar": (am.cases.greco_bar, 10e-3, 4),
        "dovetail": (am.cases.dovetail, 8e-3, 4),
        "GRECO block 3D": (am.cases.greco_block, 20e-3, 2),
    }[case]
    sizes = [size / 2**k if case != "GRECO bar" else size / 1.65**k for k in range(levels)]
    am.Hierarchy.graded(make(), sizes[:2], contact_ratio=ratio)
    begin = processor_time()
    grids = am.Hierarchy.graded(make(), sizes, contact_ratio=ratio)
    built = processor_time() - begin
    result = am.solve(grids, am.FullMultigrid(), throw=False)
    return {
        "nodes": grids.finest.n_nodes,
        "work": result.work_units,
        "cycles": result.cycles,
        "us a node": 1e6 * built / sum(level.n_nodes for level in grids.levels),
        "over solve": built / cpu(lambda: am.solve(grids, am.FullMultigrid(), throw=False)),
    }


def small(divisions: int) -> dict:
    """Milliseconds of solves in a friction sweep on the same meshes, hierarchy counted; the active
    set, which has factorised before, over ours, and over a plain script that gets the matrix,
    factorises and checks nothing (:mod:`plain_newton`)."""
    warm_up()
    grids, frictions = bar(divisions), np.linspace(0.1, 1.0, 10)

    def sweep() -> None:
        for friction in frictions:
            am.solve(
                grids.with_problem(am.cases.greco_bar(law=am.Coulomb(float(friction)))),
                am.FullMultigrid(),
            )

    def peer(rtol: float) -> float:
        return cpu(lambda: am.solve(grids, am.FullMultigrid(rtol=rtol)), 20)

    @threadpool_limits.wrap(limits=1)
    def plain() -> np.ndarray:
        return plain_newton(grids.finest.discrete, friction=1.0)

    sweep()
    exact = am.solve(grids, am.ActiveSet(rtol=1e-8)).displacement
    np.testing.assert_allclose(plain(), exact, rtol=0, atol=1e-6 * np.abs(exact).max())
    ours, active_set = peer(1e-8), cpu(lambda: am.solve(grids, am.ActiveSet(rtol=1e-8)), 20)
    return {
        "nodes": grids.finest.n_nodes,
        "sweep_ms": 1e3 * cpu(sweep) / len(frictions),
        "ours_ms": 1e3 * ours,
        "loose over tight": peer(1e-2) / ours,
        "active set over ours": active_set / ours,
        "active set over plain": active_set / cpu(plain, 20),
    }


def large(dim: int, divisions: int) -> dict:
    """From problem to solution in passes over the finest matrix; pyamg on the glued matrix;
    memory."""
    warm_up(dim)
    whole, solve = float("inf"), float("inf")
    for _ in range(
        2
    ):  # the first run pays for memory that the process never used, up to twice the time
        begin = time.process_time()
        grids = bar(divisions, dim=dim)
        built = time.process_time()
        result = am.solve(grids, am.FullMultigrid())
        whole, solve = (
            min(whole, time.process_time() - begin),
            min(solve, time.process_time() - built),
        )
    checked, matrix = result.timings["certificate"], grids.finest.matrix
    checked /= sum(grids.timings.values()) + result.seconds
    one_pass = (matrix.data.nbytes + matrix.indices.nbytes) / triad()
    problem = glued(grids)
    build = partial(pyamg_preconditioner, problem)
    count = iterations_needed(problem, build())
    rival = cpu(lambda: iterate(problem, build(), count))
    tracemalloc.start()
    am.solve(bar(divisions, dim=dim), am.FullMultigrid())
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return {
        "nodes": grids.finest.n_nodes,
        "work": result.work_units,
        "cycles": result.cycles,
        "checked": checked,
        "passes": whole / one_pass,
        "solve passes": solve / one_pass,
        "bytes": most / result.displacement.size,
        "over pyamg": whole / rival,
        "solve over pyamg": solve / rival,
    }


def independent(dim: int) -> dict:
    """Work units on independent meshes with size ratio 2."""
    make = am.cases.greco_bar if dim == 2 else am.cases.greco_block
    sizes = [16e-3 / 2**k for k in range(5 if dim == 2 else 3)]
    result = am.solve(am.Hierarchy.graded(make(), sizes, contact_ratio=2), am.FullMultigrid())
    return {"nodes": len(result.displacement), "work": result.work_units, "cycles": result.cycles}


def process(cache: str) -> dict:
    """Wall seconds of the first solve of a new process: compiled kernels in the cache, or an empty
    one. The sources are compiled before, as an installation leaves them, wherever Python is asked
    not to."""
    with tempfile.TemporaryDirectory() as empty:
        more = {"PYTHONDONTWRITEBYTECODE": ""} | (
            {"NUMBA_CACHE_DIR": empty} if cache == "empty" else {}
        )
        runs = [
            subprocess.run(
                [sys.executable, "-c", FIRST],
                capture_output=True,
                text=True,
                check=True,
                env=os.environ | more,
            ).stdout.split()
            for _ in range(1 if cache == "empty" else 3)
        ]
    return {
        "wall_s": min(float(run[0]) for run in runs),
        "import_s": min(float(run[1]) for run in runs),
    }


def rows_of(out: Output) -> list[tuple[str, float, str]]:
    """Every measure with its value and unit."""
    quick = out.quick
    rows: list[tuple[str, float, str]] = []

    def study(run: Callable[..., dict], points: list[dict]) -> list[dict]:
        return (
            am.Study(run, points, out.store, name=run.__name__).run(throw=True).to_dict("records")
        )

    for row in study(
        meshing,
        [
            {"case": case, "levels": n}
            for case, n in (
                [("GRECO bar", 4)]
                if quick
                else [("GRECO bar", 8), ("dovetail", 5), ("GRECO block 3D", 4)]
            )
        ],
    ):
        name = f"{row['case']}, {row['levels']} graded levels to {row['nodes']} nodes"
        rows += [
            (f"{name}: hierarchy", row["us a node"], "us a node"),
            (f"{name}: hierarchy over solve", row["over solve"], ""),
            (f"{name}: work", row["work"], "WU"),
        ]
    for row in study(small, [{"divisions": n} for n in ((8, 16) if quick else (8, 16, 32))]):
        name = f"bar of {row['nodes']} nodes"
        rows += [
            (f"{name}: a solve in a friction sweep", row["sweep_ms"], "ms"),
            (f"{name}: seconds of the active set over ours", row["active set over ours"], ""),
            (
                f"{name}: seconds of the active set over a plain script",
                row["active set over plain"],
                "",
            ),
            (f"{name}: seconds to 1e-2 over those to 1e-8", row["loose over tight"], ""),
        ]
    sizes = (
        [(2, 64), (3, 8)]
        if quick
        else [(2, 256), (2, 512), (3, 32)] + [(2, 1024), (3, 64)] * out.full
    )
    for row in study(large, [{"dim": dim, "divisions": n} for dim, n in sizes]):
        name = f"{row['dim']}D, {row['nodes']} nodes"
        rows += [
            (f"{name}: work", row["work"], "WU"),
            (f"{name}: problem to solution", row["passes"], "passes"),
            (f"{name}: am.solve alone", row["solve passes"], "passes"),
            (f"{name}: certificate over hierarchy and solve (wall)", row["checked"], ""),
            (f"{name}: memory from problem to solution", row["bytes"], "B/dof"),
            (f"{name}: am.solve over a linear solve by pyamg", row["solve over pyamg"], ""),
            (f"{name}: problem to solution over pyamg", row["over pyamg"], ""),
        ]
    for row in study(independent, [{"dim": 2}] if quick else [{"dim": 2}, {"dim": 3}]):
        rows.append(
            (f"{row['dim']}D independent meshes, {row['nodes']} nodes: work", row["work"], "WU")
        )
    for row in study(
        process, [{"cache": "warm"}] if quick else [{"cache": "warm"}, {"cache": "empty"}]
    ):
        rows += [
            (f"new process, {row['cache']} kernel cache: first solve (wall)", row["wall_s"], "s"),
            (f"new process, {row['cache']} kernel cache: import (wall)", row["import_s"], "s"),
        ]
    gains = out.folder.parent / "adaptive_vs_uniform" / "gains.csv"
    for row in pd.read_csv(gains).to_dict("records") if gains.exists() else ():
        rows.append(
            (
                f"{row['problem']} at {row['error']:.2g} %: uniform over remeshed",
                float(row["remeshed"].split(" / ")[1]),
                "seconds",
            )
        )
    return rows


def study(out: Output) -> None:
    """Print every measure; the numbers of the large problems are drawn."""
    table = pd.DataFrame(rows_of(out), columns=["measure", "value", "unit"])
    out.table(
        "measures",
        table,
        "Speed: every measure with its value and unit",
        "Passes: of the finest matrix at triad speed. Over: a ratio of processor seconds.",
        formats={"value": ".3g"},
    )
    passes = table[table["unit"] == "passes"]
    figure, ax = drawing(0.3 * len(passes) + 1)
    ax.barh(passes["measure"], passes["value"])
    ax.set(xlabel="passes over the finest matrix at triad speed")
    ax.invert_yaxis()
    out.figure(
        "passes",
        figure,
        "From problem to solution, and the solve alone, in passes over the finest matrix",
    )
    for row in table.to_dict("records"):
        if out.full and row["measure"].endswith(
            (": work", "problem to solution", "hierarchy", "by pyamg")
        ):
            out.number(
                row["measure"][0].upper() + row["measure"][1:],
                f"{row['value']:.3g} {row['unit']}".strip(),
            )
    over = table[table["measure"].str.match("2D.*am.solve over")]
    out.check(
        "am.solve of the contact problem over a linear solve by pyamg, largest 2D problem",
        float(over["value"].iloc[-1]),
        high=1.0,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--history", type=Path, metavar="FILE.csv")
    asked, others = parser.parse_known_args()
    if asked.history is not None:
        history(asked.history)
    else:
        main(study)
