"""The choices of the paper's correction: how fine the coarsest grid must be, and which variant stalls or cycles."""

from __future__ import annotations

from typing import Any

import pandas as pd
from common import Context, Table, exact, grids
from paper_runs import TARGET, chain, discretisation_error, listed, measured, nodes_text, table

import adaptmg as am

PROBLEM = "Coulomb bar"
#: far below the paper's test: what the iteration can reach at all
CHANGE = 1e-10
CYCLES = 150
EXACT = 1e-8


def coarsest(problem: str, divisions: int, levels: int, correction: str, tolerance: float, target: float
             ) -> dict[str, Any]:
    """W-cycles on a chain of nested grids until nothing changes any more."""
    kind = am.PaperCorrection() if correction == "paper" else am.Monotone()
    solver = am.FullMultigrid(cycle=am.Cycle(shape="W"), correction=kind, stop="change", rtol=tolerance, max_cycles=150)
    return measured(grids(problem, chain(divisions, levels)), solver, exact(problem, divisions), target, times=1)


def variant(problem: str, divisions: int, gap: str, slip: str, limit: str, tolerance: float, max_cycles: int,
            target: float) -> dict[str, Any]:
    """Two grids with coarse problems solved to 1e-4, from the full start."""
    solver = am.FullMultigrid(correction=am.PaperCorrection(gap=gap, slip=slip, limit=limit), stop="change",
                              coarse=am.CoarseSolve(rtol=1e-4), rtol=tolerance, max_cycles=max_cycles)
    return measured(grids(problem, chain(divisions, 2)), solver, exact(problem, divisions), target, times=1)


def tables(context: Context) -> list[Table]:
    """Two tables."""
    return [coarsest_table(context), variants_table(context)]


def coarsest_table(context: Context) -> Table:
    """The paper: 'the coarse grid has to be enough fine because of the use of the initial solution'."""
    frame = context.study(coarsest, {"levels": (2, 3, 4, 5), "correction": ("paper", "monotone")}, problem=PROBLEM,
                          divisions=32, tolerance=CHANGE, target=TARGET)
    fem = discretisation_error(PROBLEM, 32)
    frame = frame.assign(grids=[nodes_text(chain(32, n)) for n in frame["levels"]], test=f"change {CHANGE:g}",
                         **{"coarsest cells": [f"{32 // 2**(n - 1)} x {32 // 2**(n - 1)}" for n in frame["levels"]],
                            "over discretisation": frame["true_error"] / fem})
    stalls = frame[frame["correction"] == "paper"]
    mono = frame[frame["correction"] == "monotone"]
    note = (f"In the paper's mode the error that remains grows from {stalls['true_error'].min():.1e} to "
            f"{stalls['true_error'].max():.1e} as the coarsest grid goes from {stalls['coarsest cells'].iloc[0]} to "
            f"{stalls['coarsest cells'].iloc[-1]} cells, although the change falls to {stalls['change'].max():.0e} or "
            "below: this confirms the paper's remark that the coarse grid must be fine enough. The solution on 33 x 33 "
            f"nodes differs from that on 65 x 65 by {fem:.1e} (relative A-norm), so that with the coarsest grid of "
            f"{listed(list(stalls[stalls['true_error'] < fem]['coarsest cells']))} cells the stall lies below the "
            "discretisation error; with coarser ones it spoils the result. The monotone "
            f"mode takes gap, slip and limit from the current iterate and reaches {mono['true_error'].max():.0e} with "
            "every coarsest grid.")
    columns = ["grids", "levels", "coarsest cells", "correction", "cycles", "work", "run_seconds", "test", "change",
               "true_error", "over discretisation", "residual", "outcome"]
    return table("coarsest_grid", frame, columns, f"{PROBLEM}, 33 x 33 nodes: where the iteration ends, against the "
                 "coarsest grid", f"W(2,0), full multigrid start, coarsest problems condensed, to 1e-2. {note}",
                 {"over discretisation": ".1e"})


def variants_table(context: Context) -> Table:
    """All choices of gap, slip and limit."""
    divisions = 16 if context.quick else 32
    slips = ("initial", "minmod") if context.quick else ("initial", "injected", "minmod")
    frame = context.study(variant, {"gap": ("smallest", "largest", "injected"), "slip": slips,
                                    "limit": ("initial", "injected", "summed")},
                          problem=PROBLEM, divisions=divisions, tolerance=CHANGE, max_cycles=CYCLES, target=TARGET)
    frame = frame.assign(grids=nodes_text(chain(divisions, 2)), test=f"change {CHANGE:g}",
                         verdict=[verdict(row) for _, row in frame.iterrows()])
    good = frame[frame["verdict"] == "converges"]
    names = [f"{gap}/{slip}/{limit}" for gap, slip, limit in zip(good["gap"], good["slip"], good["limit"], strict=True)]
    counts = frame["verdict"].value_counts()
    widest = frame[(frame["gap"] == "largest") & (frame["slip"] == "initial")].set_index("limit")
    literal, freed = widest.loc["initial"], widest.loc["summed"]
    rests = frame[frame["verdict"] != "does not settle"]
    spread = rests.groupby(["gap", "limit"])["true_error"].agg(lambda e: e.max() / e.min())
    note = (f"Of {len(frame)} variants {counts.get('converges', 0)} converge to the solution, "
            f"{counts.get('stalls', 0)} come to rest elsewhere and {counts.get('does not settle', 0)} do not settle in "
            f"{CYCLES} cycles. Those that converge (gap/slip/limit): {listed(names)}. Read literally ('the smallest "
            f"value of u', which is the largest opening) the paper's choice {literal['verdict']}, with a true error of "
            f"{literal['true_error']:.0e}; with the summed limit that gap {freed['verdict']} "
            f"({freed['true_error']:.0e}): coarse corrections may then penetrate, and the sweeps push them back. A "
            "sliding limit is a nodal force: injected instead of summed it is too small on the coarse grid, and the "
            "correction slips where the fine grid sticks. Among runs that come to rest, with equal gap and limit, the "
            f"choice of the slip changes the true error by a factor of at most {spread.max():.2f}: all nodes of this "
            "problem slip the same way, and only a slip that turns round would meet its bound. LIMIT: stopped there.")
    columns = ["gap", "slip", "limit", "verdict", "cycles", "work", "run_seconds", "grids", "test", "change",
               "true_error", "residual", "outcome"]
    return table("correction_variants", frame, columns, f"{PROBLEM}, two grids, full start: the choices of the paper's "
                 "correction, and where each ends", "The paper's own: smallest, initial, initial; the monotone mode's: "
                 f"smallest, minmod, summed. Coarse problems condensed and solved to 1e-4. {note}")


def verdict(row: pd.Series) -> str:
    """Where a run ended: at rest at the solution, at rest elsewhere, or still moving."""
    if row["true_error"] <= EXACT:
        return "converges"
    return "stalls" if row["change"] <= CHANGE else "does not settle"
