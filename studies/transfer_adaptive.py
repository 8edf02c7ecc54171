"""Transfers and size ratios on the levels that adaptivity leaves. Part of ``transfer_operators.py``.

The levels are those of an adaptive loop with interpolation; on the same meshes other transfers are tried, and levels
are left out, so that the sizes of neighbours lie further and further apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import common
import estimator_runs as runs
import pandas as pd
from adaptive_cases import CASES
from matplotlib import pyplot as plt
from paper_runs import span

import adaptmg as am
from adaptmg.plot.style import CYCLE, styled
from adaptmg.transfer import size_ratio

TRANSFERS = {"Interpolation": am.Interpolation(), "L2": am.L2(), "PseudoL2": am.PseudoL2(),
             "LumpedL2": am.LumpedL2(), "QuasiInterpolation": am.QuasiInterpolation()}
METHODS = {"default": am.Truncated(), "monotone": am.Monotone()}
#: case, engine, nodes of the loop
LOOPS = (("upset block", "remeshed", 10_000), ("upset block", "bisected", 10_000), ("flat punch", "remeshed", 10_000),
         ("dovetail", "remeshed", 10_000), ("upset block 3D", "remeshed", 3000))
QUICK_LOOPS = (("dovetail", "remeshed", 300),)
#: levels of these bisected loops are left out: nodes
RATIO_LOOPS = {"flat punch": 12_000, "upset block": 12_000, "dovetail": 8000, "upset block 3D": 6000}
QUICK_RATIO_LOOPS = {"flat punch": 700}
#: every so-manieth level is kept, counted from the finest
STRIDES = (1, 2, 3, 4)
RTOL, MAX_CYCLES = 1e-8, 200


@lru_cache(maxsize=1)
def levels_of(case: str, engine: str, most: int) -> tuple[am.ContactProblem, tuple[am.MeshArrays, ...]]:
    """Problem and meshes, coarse to fine, that a loop with the residual indicator leaves."""
    problem, start = runs.posed(case)
    for step in am.adapt(problem, start, engine=runs.ENGINES[engine], max_nodes=most):
        last = step
    return problem, tuple(level.mesh for level in last.hierarchy.levels)


def solved(problem: am.ContactProblem, meshes: Sequence[am.MeshArrays], transfer: str, method: str) -> dict[str, Any]:
    """Cycles, rate and work with the nested start."""
    grids = am.Hierarchy.from_meshes(problem, list(meshes), TRANSFERS[transfer])
    result = am.solve(grids, am.FullMultigrid(correction=METHODS[method], rtol=RTOL, max_cycles=MAX_CYCLES),
                      throw=False)
    took_over = bool(result.fallback)
    return {"nodes": grids.finest.n_nodes, "levels": len(grids), "contact_nodes": len(result.contact),
            "size_ratio": max(size_ratio(coarse, fine) for coarse, fine in pairwise(meshes)),
            "cycles": result.cycles, "rate": runs.asymptotic_rate(result), "work": result.work_units,
            "outcome": "TOOK OVER" if took_over else result.status.name}


def on_levels(case: str, engine: str, most: int, transfer: str, method: str) -> dict[str, Any]:
    """A transfer on the levels of a loop."""
    problem, meshes = levels_of(case, engine, most)
    return solved(problem, meshes, transfer, method)


def left_out(case: str, most: int, stride: int, method: str) -> dict[str, Any]:
    """Interpolation on every so-manieth level of a bisected loop."""
    problem, meshes = levels_of(case, "bisected", most)
    return solved(problem, meshes[::-stride][::-1], "Interpolation", method)


def adaptive_items(context: common.Context) -> list[common.Table | common.Figure]:
    """Two tables and a figure."""
    found = [context.study(on_levels, {"transfer": list(TRANSFERS), "method": list(METHODS)}, case=case, engine=engine,
                           most=most).assign(case=case, engine=engine)
             for case, engine, most in (QUICK_LOOPS if context.quick else LOOPS)]
    loops = QUICK_RATIO_LOOPS if context.quick else RATIO_LOOPS
    ratios = [context.study(left_out, {"stride": list(STRIDES), "method": list(METHODS)}, case=case, most=most)
              .assign(case=case) for case, most in loops.items()]
    ratios = pd.concat(ratios, ignore_index=True)
    return [transfer_table(pd.concat(found, ignore_index=True)), ratio_table(ratios), ratio_figure(ratios)]


def compared(rows: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """The default method's cycles, rate and work, and the monotone one's next to them."""
    default, monotone = (rows[rows["method"] == name].set_index(keys) for name in METHODS)
    frame = default[["nodes", "levels", "size_ratio", "cycles", "rate", "work", "outcome"]].join(
        monotone[["cycles", "rate", "work", "outcome"]].add_suffix(", monotone"))
    return frame.rename(columns={"size_ratio": "size ratio", "outcome": "status",
                                 "outcome, monotone": "status, monotone"}).reset_index().rename(
                                     columns={"case": "problem"})


UNITS = {"size ratio": "coarse/fine", "work": "WU", "work, monotone": "WU"}
FORMATS = {"size ratio": ".2f"} | {name + mode: spec for name, spec in (("rate", ".2f"), ("work", ".0f"))
                                   for mode in ("", ", monotone")}


def transfer_table(rows: pd.DataFrame) -> common.Table:
    """Each transfer on the same levels."""
    frame = compared(rows, ["case", "engine", "transfer"])
    key = ["problem", "engine"]
    base = frame[frame["transfer"] == "Interpolation"].set_index(key)["work"]
    words = [f"{name} {span(group.set_index(key)['work'] / base, '.2f')}"
             for name, group in frame.groupby("transfer", sort=False) if name != "Interpolation"]
    note = ("Levels of a loop with the residual indicator, nested start, contact rows. Work of the default method over "
            f"that with interpolation: {'; '.join(words)}.")
    return common.Table("transfer_adaptive", frame, f"Transfers on the levels that adaptivity leaves (rtol {RTOL:g})",
                        note, UNITS, FORMATS)


def ratio_table(rows: pd.DataFrame) -> common.Table:
    """Levels left out, and what becomes of the rate."""
    frame = compared(rows, ["case", "stride"])
    words = []
    for case, group in frame.groupby("problem", sort=False):
        first, last = group.iloc[0], group.iloc[-1]
        words.append(f"{case} {first['rate']:.2f} at {first['size ratio']:.1f}, {last['rate']:.2f} at "
                     f"{last['size ratio']:.1f}")
    took = (frame[["status", "status, monotone"]] == "TOOK OVER").any(axis=None)
    note = ("Every level, every second and so on of a bisected loop, counted from the finest (stride). Size ratio: the "
            "99 % quantile over elements, largest of all neighbours. Rates of the default method: "
            f"{'; '.join(words)}." + " TOOK OVER: the cycles were too slow, and the active set method finished; the "
            "rate is that of the cycles." * bool(took))
    return common.Table("transfer_size_ratio", frame, f"Levels left out: size ratio against rate (rtol {RTOL:g})",
                        note, UNITS, FORMATS)


@styled
def ratio_figure(rows: pd.DataFrame) -> common.Figure:
    """Rate against size ratio."""
    figure, ax = plt.subplots(figsize=(5.8, 4.0))
    for k, (case, group) in enumerate(rows.groupby("case", sort=False)):
        for method, dash in zip(METHODS, ("-", ":"), strict=True):
            mine = group[group["method"] == method]
            ax.semilogx(mine["size_ratio"], mine["rate"], dash, marker="osv^"[k % 4], color=CYCLE[k],
                        label=f"{case}, {CASES[case].dim}D".replace("3D, 3D", "3D") if method == "default" else None)
    ax.set_xlabel("local size ratio of neighbouring levels")
    ax.set_ylabel("rate a cycle")
    ax.set_ylim(0.0, 1.0)
    ax.grid(True)
    common.plain_ticks(ax.xaxis)
    ax.legend(loc="lower right")
    return common.Figure("transfer_size_ratio", figure,
                         "Rate against the size ratio of neighbours; default method solid, monotone dotted")
