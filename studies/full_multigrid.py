"""Table 3 of the paper: what the full multigrid start gains over a start from zero.

    python studies/full_multigrid.py [--quick] [--out DIR]

The paper's two grids (289/81) first; then what the start costs on deeper hierarchies, and how far it gets: its error
against the exact discrete solution beside the discretisation error.
"""

from __future__ import annotations

import itertools
from typing import Any

import common
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from common import Context, Figure, Section, Table, exact, grids, main
from paper_runs import (
    CHANGE,
    RTOL,
    TARGET,
    chain,
    discretisation_error,
    draw_error,
    measured,
    nodes_text,
    repeats,
    table,
)

import adaptmg as am
from adaptmg.plot.style import BLUE, GREEN, GREY, INK, ORANGE, styled

DIVISIONS = (8, 16)
METHODS = ("regular resolution", "two grids, zero start", "two grids, full start")
STARTS = ("zero", "full, 1 cycle a level", "full, 2 cycles a level")
BAR = "Coulomb bar"


def method(problem: str, name: str, correction: str, stop: str, coarse_condensed: bool, start_rtol: float,
           rtol: float, target: float, times: int) -> dict[str, Any]:
    """One of :data:`METHODS` with two smoothings; coarse problems to 1e-2, the first one to ``start_rtol``."""
    if name == METHODS[0]:
        solver = am.SingleGrid(stop=stop, rtol=rtol)
    else:
        options = {"correction": am.PaperCorrection() if correction == "paper" else am.Monotone(), "stop": stop,
                   "rtol": rtol, "coarse": am.CoarseSolve(condensed=coarse_condensed)}
        solver = (am.FullMultigrid(start=am.NestedStart(rtol=start_rtol), **options) if name == METHODS[2]
                  else am.Multigrid(**options))
    return measured(grids(problem, DIVISIONS), solver, exact(problem, DIVISIONS[-1]), target, times)


def deeper(problem: str, divisions: int, levels: int, start: str, cycle: str, rtol: float, target: float,
           times: int) -> dict[str, Any]:
    """Monotone mode on a deeper hierarchy from zero, or from a start with one or two cycles a level."""
    options = {"correction": am.Monotone(), "cycle": am.Cycle(shape=cycle),
               "coarse": am.CoarseSolve(condensed=False), "rtol": rtol}
    solver = (am.Multigrid(**options) if start == "zero"
              else am.FullMultigrid(start=am.NestedStart(cycles=int(start.split()[1])), **options))
    return measured(grids(problem, chain(divisions, levels)), solver, exact(problem, divisions), target, times)


def run(context: Context) -> Section:
    """Tables and figures; see the module."""
    pairs = methods(context)
    levels = (3, 4, 5, 6) if context.full and not context.quick else (3, 4, 5)
    rows = [context.study(deeper, {"start": STARTS, "cycle": ("V", "W")}, problem=problem, levels=count,
                          divisions=4 * 2**(count - 1), rtol=RTOL, target=TARGET, times=repeats(context)
                          ).assign(problem=problem, levels=count, divisions=4 * 2**(count - 1))
            for problem in (BAR, "curved obstacle") for count in levels]
    nested = pd.concat(rows, ignore_index=True)
    nested["fem"] = [discretisation_error(problem, divisions) if divisions <= 64 else np.nan
                     for problem, divisions in zip(nested["problem"], nested["divisions"], strict=True)]
    items = [pairs_table(pairs), nested_table(nested), start_figure(pairs, nested)]
    return Section("Table 3: full multigrid start", "", items, summary=summary(pairs, nested))


def methods(context: Context) -> pd.DataFrame:
    """The three methods on all problems, at both tests; each group of three has its number."""
    kinds = (("change", "paper", False, 1e-8), ("change", "monotone", False, 1e-8), ("error", "monotone", False, 1e-8),
             ("error", "monotone", False, 1e-3), ("error", "monotone", True, 1e-8))
    frames = []
    for problem, (stop, correction, condensed, first) in itertools.product(common.PROBLEMS, kinds):
        fixed = {"problem": problem, "stop": stop, "rtol": CHANGE if stop == "change" else RTOL, "target": TARGET,
                 "times": repeats(context)}
        alone = context.study(method, {"name": METHODS[:1], "correction": ("none",)}, coarse_condensed=False,
                              start_rtol=1e-8, **fixed)
        two = context.study(method, {"name": METHODS[1:], "correction": (correction,)}, coarse_condensed=condensed,
                            start_rtol=first, **fixed)
        both = pd.concat([alone, two], ignore_index=True)
        at = ("cycles", "work", "run_seconds") if stop == "change" else ("cycles_at", "work_at", "seconds_at")
        values = {new: both[old].astype(float) for new, old in zip(("count", "units", "time"), at, strict=True)}
        mode = correction + (", coarsest condensed" if condensed else "") + (", start to 1e-3" if first > 1e-8 else "")
        frames.append(both.assign(problem=problem, stop=stop, mode=mode, **values,
                                  **{"work ratio": values["units"] / values["units"].iloc[-1],
                                     "ratio in s": values["time"] / values["time"].iloc[-1]}))
    return pd.concat(frames, ignore_index=True)


def pairs_table(frame: pd.DataFrame) -> Table:
    """Table 3 beside the paper's."""
    printed = common.paper("table3_full_start")
    last = printed["seconds"].iloc[-1]
    theirs = dict(zip(METHODS, zip(printed["printed"], printed["seconds"] / last, strict=True), strict=True))
    tests = {"change": f"change {CHANGE:g}", "error": f"true error {TARGET:g}"}
    frame = frame.assign(
        grids=["289" if name == METHODS[0] else "289/81" for name in frame["name"]], method=frame["name"],
        test=frame["stop"].map(tests), **{
            "start [WU]": frame["start_work"].where(frame["name"] == METHODS[2]),
            "sweeps or cycles": frame["count"], "work [WU]": frame["units"], "seconds [s]": frame["time"],
            "paper CPU": [theirs[name][0] for name in frame["name"]],
            "paper ratio": [theirs[name][1] for name in frame["name"]]})
    columns = ["problem", "test", "mode", "method", "grids", "sweeps or cycles", "start [WU]", "work [WU]",
               "work ratio", "seconds [s]", "ratio in s", "paper CPU", "paper ratio", "true_error", "residual",
               "outcome"]
    return table("full_multigrid", frame, columns, "Regular resolution (omega 1), two grids from zero and two grids "
                 "with the full start, 289/81 nodes, two smoothings, coarse solves to 1e-2; ratios over the full start",
                 pairs_note(frame, theirs),
                 {"sweeps or cycles": ".1f", "start [WU]": ".1f", "work [WU]": ".1f", "work ratio": ".1f",
                  "seconds [s]": ".3g", "ratio in s": ".1f", "paper ratio": ".1f"})


def pairs_note(frame: pd.DataFrame, theirs: dict[str, tuple[str, float]]) -> str:
    """How the ratios compare, and why."""
    def ratios(problem: str, stop: str, mode: str, column: str = "work ratio") -> str:
        part = frame[(frame["problem"] == problem) & (frame["stop"] == stop) & (frame["mode"] == mode)]
        return " : ".join(f"{value:.1f}" for value in part[column])

    first = frame[frame["name"] == METHODS[0]]
    change = first[first["stop"] == "change"]["true_error"]
    full = frame[(frame["problem"] == "frictionless bar") & (frame["name"] == METHODS[2])
                 & (frame["mode"] != "monotone, start to 1e-3")]
    start = frame[(frame["problem"] == BAR) & (frame["name"] == METHODS[2]) & (frame["mode"] == "monotone")].iloc[-1]
    return (f"The paper: {' : '.join(f'{ratio:.1f}' for _, ratio in theirs.values())} in CPU time, for what it calls "
            "the frictionless case. Ours in work, by its test and in its mode: frictionless bar "
            f"{ratios('frictionless bar', 'change', 'paper')}, curved obstacle "
            f"{ratios('curved obstacle', 'change', 'paper')}, {BAR} {ratios(BAR, 'change', 'paper')}. At equal true "
            f"error, monotone mode: curved obstacle {ratios('curved obstacle', 'error', 'monotone')}, {BAR} "
            f"{ratios(BAR, 'error', 'monotone')}, and with a first coarse solution to 1e-3 only "
            f"{ratios('curved obstacle', 'error', 'monotone, start to 1e-3')} and "
            f"{ratios(BAR, 'error', 'monotone, start to 1e-3')}: solved totally (to 1e-8) by sweeps it takes "
            f"{start['start_work']:.0f} of the {start['units']:.0f} units of the {BAR}; the coarse problems "
            "of the cycles are solved to 1e-2. The frictionless bar is a patch test: the interpolated "
            f"coarse solution is exact (true error {full['true_error'].max():.0e} at the end), so that no cycles are "
            "needed after a full start, and its ratios say only what a coarse solve costs. The test on the change "
            f"favours the regular resolution, which stops with a true error of {change.min():.0e} to "
            f"{change.max():.0e}. A start from zero in the paper's mode pays for the first coarse solution too, whose "
            "sliding limit it keeps. With the coarsest problem condensed the work counts no factorisation, only the "
            "seconds do.")


def nested_table(frame: pd.DataFrame) -> Table:
    """What the start costs and gives on deeper hierarchies."""
    zero = frame[frame["start"] == "zero"].set_index(["problem", "levels", "cycle"])["work_at"]
    keys = list(zip(frame["problem"], frame["levels"], frame["cycle"], strict=True))
    full = frame["start"] != "zero"
    frame = frame.assign(
        grids=[nodes_text(chain(n, levels)) for n, levels in zip(frame["divisions"], frame["levels"], strict=True)],
        test=f"error {RTOL:g}", **{
            "cycle": frame["cycle"] + "(2,0)", "error after start": frame["error_0"].where(full),
            "after one cycle more": frame["error_1"].where(full), "its work": frame["work_1"].where(full),
            "discretisation": frame["fem"], "zero over this": zero.loc[keys].to_numpy() / frame["work_at"]})
    frame["start_work"] = frame["start_work"].where(full)
    columns = ["problem", "grids", "cycle", "start", "start_work", "error after start", "after one cycle more",
               "its work", "discretisation", "cycles_at", "work_at", "zero over this", "seconds_at", "test",
               "true_error", "residual", "outcome"]
    return table("nested_start", frame, columns, "Nested start on deeper hierarchies, monotone mode, two smoothings: "
                 "work of the start below the finest level; true error after it and the first smoothing, and one cycle "
                 f"later; cycles, work and seconds to a true error of {TARGET:g}. Discretisation: relative A-norm "
                 "difference to the solution on the next finer grid", nested_note(frame),
                 {"error after start": ".1e", "after one cycle more": ".1e", "its work": ".1f", "discretisation": ".1e",
                  "zero over this": ".2f"})


def nested_note(frame: pd.DataFrame) -> str:
    """What was measured, in sentences."""
    full = frame[frame["start"] != "zero"]
    known = full[full["fem"].notna()]
    below = (known["error_1"] < known["fem"]).sum()
    deepest = full[full["levels"] == full["levels"].max()]
    return (f"On the deepest hierarchies the start costs {deepest['start_work'].min():.1f} to "
            f"{deepest['start_work'].max():.1f} work units; with one cycle on the finest grid after it (and the "
            f"smoothing of the next) the error lies below the discretisation error in {below} of {len(known)} cases, "
            f"for {known['work_1'].min():.0f} to {known['work_1'].max():.0f} units in all. To {TARGET:g}, far below "
            f"the discretisation error, the start saves {1 - 1 / full['zero over this'].min():.0%} to "
            f"{1 - 1 / full['zero over this'].max():.0%} of the work from zero: it replaces the first cycles, in which "
            "the contact zones are found, and cannot change the rate of the others.")


@styled
def start_figure(pairs: pd.DataFrame, nested: pd.DataFrame) -> Figure:
    """True error against work, from zero and from the full start."""
    canvas, axes = plt.subplots(1, 2, figsize=(10, 4), sharey=True)
    rows = pairs[(pairs["problem"] == BAR) & (pairs["stop"] == "error") & (pairs["mode"] == "monotone")]
    for (_, row), color in zip(rows.iterrows(), (INK, ORANGE, BLUE), strict=True):
        draw_error(axes[0], row, row["name"], color=color)
    axes[0].set(title=f"{BAR}, 289/81 nodes", ylabel="true error (relative A-norm)")
    deep = nested[(nested["problem"] == BAR) & (nested["divisions"] == 64) & (nested["cycle"] == "W")]
    for (_, row), color in zip(deep.iterrows(), (ORANGE, BLUE, GREEN), strict=True):
        draw_error(axes[1], row, f"start: {row['start']}", color=color)
    axes[1].axhline(deep["fem"].iloc[0], color=GREY, linestyle="--", label="discretisation error")
    axes[1].set(title=f"{BAR}, {nodes_text(chain(64, 5))} nodes, W-cycles")
    for ax in axes:
        ax.set(xlabel="work units", ylim=(RTOL / 2, 1.5))
        ax.grid(True)
        ax.legend(loc="lower left", fontsize=8.5)
    return Figure("full_multigrid_error", canvas, "True error against work from zero and from the full multigrid "
                  "start, on the paper's two grids (left) and on five (right; there the start reaches the "
                  "discretisation error).")


def summary(pairs: pd.DataFrame, nested: pd.DataFrame) -> str:
    """What was asked, what came out, and why it differs from the paper."""
    part = pairs[(pairs["problem"] == BAR) & (pairs["stop"] == "error") & (pairs["mode"] == "monotone")]
    printed = common.paper("table3_full_start")["seconds"]
    full = nested[(nested["start"] == STARTS[1]) & (nested["problem"] == BAR)]
    return ("What does a start from the coarse solution gain? One grid, two grids from zero and two from the full "
            f"start need work as {' : '.join(f'{value:.1f}' for value in part['work ratio'])} to the same true error "
            f"of {TARGET:g} ({BAR}, 289/81 nodes); the paper prints CPU times as "
            f"{' : '.join(f'{value:.1f}' for value in printed / printed.iloc[-1])}, for a bar without friction, which "
            "is a patch test: there the start is exact. On deeper hierarchies the start with one cycle a level costs "
            f"{full['start_work'].min():.1f} to {full['start_work'].max():.1f} work units.")


if __name__ == "__main__":
    main(run, "Table 3: full multigrid start.")
