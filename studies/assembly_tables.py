"""Tables 1 to 3 of the paper for its assemblies: what one grid does, smoothings, and zero against full start."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from common import Context, Table
from paper_runs import CHANGE, COUNT, RTOL, TARGET, listed, span, table

import adaptmg as am

#: what the columns of Table 1 mean
TRUE_ERROR = ("Sweeps or cycles, work and seconds when the true error (relative A-norm, against the active set method) "
              "is reached; over best one grid: its work over that of the row.")


def best_of(frame: pd.DataFrame) -> pd.DataFrame:
    """The row over-relaxed with the least work to the target, labelled so; the last one if none gets there."""
    over = frame.iloc[1:]
    if over["work_at"].isna().all():
        return over.iloc[-1:]
    best = over.loc[[over["work_at"].idxmin()]]
    return best.assign(label=best["label"] + " (best tried)" * (len(over) > 1))


def single_grids(frame: pd.DataFrame) -> str:
    """How far runs on one grid got that did not reach the target, in a sentence."""
    lost = frame[frame["label"].str.startswith("one grid") & frame["work_at"].isna()]
    if lost.empty:
        return ""
    names = [f"{row['label']} ({row['true_error']:.0e} after {row['cycles']} sweeps)" for _, row in lost.iterrows()]
    return f"'-': the error is not reached: {listed(names)}. "


def compile_coupled(grids: am.Hierarchy) -> None:
    """Compile what coupled bodies need beyond :func:`common.warm_up`."""
    for solver in (am.FullMultigrid(), am.FullMultigrid(correction=am.Monotone()), am.SingleGrid(max_sweeps=20),
                   am.SingleGrid(condensed=True, max_sweeps=20)):
        am.solve(grids, solver, throw=False)


def grid_counts(context: Context, fixed: dict[str, Any], one_grid: Callable[..., dict[str, Any]],
                several_grids: Callable[..., dict[str, Any]], omegas: Mapping[bool, tuple[float, ...]], sweeps: int,
                methods: Callable[[int], tuple[str, ...]]) -> pd.DataFrame:
    """Table 1: one grid, plain and with the best of some factors (by condensed or not), and more grids."""
    parts = []
    for condensed, factors in omegas.items():
        factors = factors[-1:] if context.quick else factors
        frame = context.study(one_grid, {"omega": (1.0, *factors)}, condensed=condensed, rtol=RTOL, max_sweeps=sweeps,
                              **fixed)
        frame["label"] = [f"one grid, {'condensed, ' if condensed else ''}omega {omega:g}" for omega in frame["omega"]]
        parts += [frame.iloc[:1], best_of(frame)]
    for levels in range(2, fixed["finest"] + 2):
        frame = context.study(several_grids, {"method": methods(levels)}, levels=levels, rtol=RTOL, **fixed)
        parts.append(frame.assign(label=[f"{COUNT[levels]}, {method}" for method in frame["method"]], levels=levels))
    return pd.concat(parts, ignore_index=True)


def counts_table(key: str, name: str, frame: pd.DataFrame, remark: str = "") -> Table:
    """Work at equal true error, and gains."""
    best = frame[frame["label"].str.startswith("one grid")]["work_at"].min()
    frame = frame.assign(method=frame["label"], test=f"error {RTOL:g}",
                         **{"over best one grid": best / frame["work_at"]})
    note = (f"{TRUE_ERROR} {single_grids(frame)}{remark}Monotone: two smoothings before the correction, coarsest "
            "problems condensed, to 1e-2; truncated: the default. Factorisations (condensed grids, coarsest level) are "
            "in seconds only.")
    columns = ["method", "grids", "cycles_at", "work_at", "over best one grid", "seconds_at", "rate", "test",
               "true_error", "residual", "outcome"]
    return table(key, frame, columns, f"Table 1 on the {name}: work and seconds to a true error of {TARGET:g}", note,
                 {"over best one grid": ".2f"})


def counts_text(frame: pd.DataFrame) -> str:
    """Work of the default, of the monotone mode and of the best run on one grid, for a summary."""
    default, monotone = (frame[frame["label"].str.contains(name)]["work_at"] for name in ("truncated", "monotone"))
    singles = frame[frame["label"].str.startswith("one grid")]
    best = singles.loc[singles["work_at"].idxmin()]
    counts = listed([COUNT[n].split()[0] for n in sorted(set(frame["levels"].dropna().astype(int)) - {1})])
    return (f"{counts.capitalize()} grids need {span(default, '.0f')} work units to a true error of {TARGET:g} by "
            f"default (truncated, coarsest level factorised; its passes use each entry twice, "
            f"others once), {span(monotone, '.0f')} in the monotone mode, the best "
            f"run on one grid ({best['label'].removeprefix('one grid, ').removesuffix(' (best tried)')}) "
            f"{best['work_at']:.0f}.")


def smoothing_table(context: Context, run: Callable[..., dict[str, Any]], counts: Sequence[tuple[int, int]],
                    name: str, fixed: dict[str, Any]) -> Table:
    """Table 2: how many smoothings; ``run`` takes counts, stop and rtol with what is fixed."""
    frame = context.study(run, {"counts": counts}, stop="error", rtol=RTOL, **fixed)
    own = context.study(run, {"counts": counts}, stop="change", rtol=CHANGE, **fixed)
    pre, post = zip(*counts, strict=True)
    frame = frame.assign(pre=pre, post=post, test=f"error {RTOL:g}", **{"cycles, paper's test": own["cycles"],
                                                                        "its error": own["true_error"]})
    reached = frame.dropna(subset="work_at")
    note = (f"The paper's test, as we read it: a change over a cycle, relative, of at most {CHANGE:g}; 'its error' is "
            "the true error where it stops.")
    if len(reached):
        least = reached.loc[reached["work_at"].idxmin()]
        note = f"Least work, of the numbers tried, at {least['pre']} + {least['post']} smoothings. " + note
    return table(f"{name.split()[0]}_smoothing", frame,
                 ["pre", "post", "grids", "cycles_at", "work_at", "seconds_at", "rate", "cycles, paper's test",
                  "its error", "test", "true_error", "residual", "outcome"],
                 f"Table 2 on the {name}: smoothings before and after the correction, to a true error of {TARGET:g}",
                 f"Two grids, monotone mode, full start. {note}",
                 {"pre": "d", "post": "d", "cycles, paper's test": "d", "its error": ".1e"})


def start_table(context: Context, run: Callable[..., dict[str, Any]], name: str, fixed: dict[str, Any],
                remark: str = "") -> Table:
    """Table 3: the full start; ``run`` takes correction, full, levels and rtol with what is fixed."""
    frames = []
    for levels in (3,) if context.quick else (2, 4):
        frame = context.study(run, {"correction": ("monotone", "truncated"), "full": (False, True)}, levels=levels,
                              rtol=RTOL, **fixed)
        frames.append(frame.assign(mode=[f"{COUNT[levels]}, {kind}" for kind in frame["correction"]]))
    frame = pd.concat(frames, ignore_index=True)
    zero = frame[~frame["full"]].set_index("mode")["work_at"]
    frame = frame.assign(start=np.where(frame["full"], "full", "zero"), test=f"error {RTOL:g}",
                         start_work=frame["start_work"].where(frame["full"]),
                         **{"zero over full": np.where(frame["full"], frame["mode"].map(zero) / frame["work_at"],
                                                       np.nan),
                            "taken over by": frame["fallback"].map(lambda name: name.partition("(")[0] or "-")})
    gains = frame[frame["full"]].dropna(subset="zero over full")
    note = ("What a start from zero costs over the full start, in work: "
            + listed([f"{value:.2f} ({mode})" for mode, value in zip(gains["mode"], gains["zero over full"],
                                                                     strict=True)])
            + "; the paper: 2.1 in CPU time for two grids on the bar." + f" {remark}" * bool(remark)
            + " In the truncated mode the coarsest level is factorised again when states change: in the seconds, not "
            "in the work.")
    if (frame["taken over by"] != "-").any():
        note += (" Where the truncated cycles from zero were too slow the active set method took over; it is also what "
                 "the exact solution was found by, so that the true error there says nothing.")
    if (gains["zero over full"] < 0.995).any():
        note += (" Below 1 the first coarse solution, solved totally by sweeps, costs more than it saves.")
    return table(f"{name.split()[0]}_start", frame, ["mode", "start", "grids", "start_work", "cycles_at", "work_at",
                                                     "zero over full", "seconds_at", "taken over by", "test",
                                                     "true_error", "residual", "outcome"],
                 f"Table 3 on the {name}: zero and full start, work to a true error of {TARGET:g}", note,
                 {"zero over full": ".2f"})
