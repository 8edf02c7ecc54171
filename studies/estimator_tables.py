"""Tables and figures of ``estimator_effectivity.py``."""

from __future__ import annotations

import common
import pandas as pd
from estimator_runs import EXACT, PAIRS, SHARE
from matplotlib import pyplot as plt
from paper_runs import span

from adaptmg.plot.style import CYCLE, GREY, styled

#: what is aimed at: largest over smallest effectivity, range of the recovered one
SPREAD, RECOVERED = 1.25, (0.75, 1.15)
#: cycles to a tenth of the estimate: one body; pairs and the flat punch
CYCLES = (1, 3)
#: asymptotic rate: one body, pairs
RATES = (0.5, 0.65)
#: loop over nested start alone: work, seconds without and with meshes (2D, bisected); work over the solve to 1e-8
WORK, WITHOUT, WITH, TIGHT = 1.3, 2.0, 2.5, 0.4
#: line styles of the engines
DASHES = {"bisected": "-", "remeshed": ":"}


def wanted_cycles(case: str) -> int:
    """Cycles that a step may need."""
    return CYCLES[case in (*PAIRS, "flat punch")]


def wanted_rate(case: str) -> float:
    """Asymptotic rate aimed at."""
    return RATES[case in PAIRS]


def summary_table(steps: pd.DataFrame) -> common.Table:
    """One line a case and engine, against what was aimed at."""
    rows = []
    for (case, engine), group in steps.groupby(["case", "engine"], sort=False):
        later = group.iloc[1:]
        spread = _spread(later["residual_effectivity"])
        row = {"case": case, "engine": engine, "steps": len(group), "nodes": group["nodes"].iloc[-1],
               "levels": group["levels"].iloc[-1], "size ratio": group["size_ratio"].max(),
               "least eta/error": later["residual_effectivity"].min(),
               "largest eta/error": later["residual_effectivity"].max(), "spread": spread,
               "with the start": _spread(group["residual_effectivity"]),
               "least ZZ/error": later["zz_effectivity"].min(), "largest ZZ/error": later["zz_effectivity"].max(),
               "cycles": later["cycles"].max(), "needed": later["needed"].max(), "left": later["left"].max(),
               "rate": group["rate"].iloc[-1], "largest rate": later["rate"].max()}
        rows.append(row | {"missed": _missed(row)})
    frame = pd.DataFrame(rows)
    missed = frame[frame["missed"] != ""]
    note = ("eta: residual estimate, ZZ: recovered one; eta/error, ZZ/error and spread (largest over least eta/error): "
            "of the steps after the start; with the start: of "
            "all steps. cycles: most that a step used, from the step before; needed: most until the algebraic error "
            f"is below {SHARE:g} estimates (0: the first smoothing does); left: the largest algebraic error that the "
            "loop left, in estimates. rate: asymptotic, on the last hierarchy; largest rate: of all steps. Aimed at: "
            f"spread <= {SPREAD:g}, ZZ/error in [{RECOVERED[0]:g}, {RECOVERED[1]:g}], needed <= {CYCLES[0]} (pairs, "
            f"punch {CYCLES[1]}), left <= {SHARE:g}, rate <= {RATES[0]:g} (pairs {RATES[1]:g}): met by "
            f"{len(frame) - len(missed)} of {len(frame)}.")
    return common.Table("estimator_summary", frame, "Effectivity and multigrid on adaptive meshes", note, {},
                        {"size ratio": ".2f", "least eta/error": ".2f", "largest eta/error": ".2f", "spread": ".2f",
                         "with the start": ".2f", "least ZZ/error": ".2f", "largest ZZ/error": ".2f", "needed": ".0f",
                         "left": ".3f", "rate": ".2f", "largest rate": ".2f"})


def _spread(values: pd.Series) -> float:
    return float(values.max() / values.min())


def _missed(row: dict) -> str:
    """What was aimed at and not reached, as text."""
    words = []
    if row["spread"] > SPREAD:
        words.append("spread")
    if row["least ZZ/error"] < RECOVERED[0] or row["largest ZZ/error"] > RECOVERED[1]:
        words.append("ZZ")
    if row["needed"] > wanted_cycles(row["case"]):
        words.append("cycles")
    if row["left"] > SHARE:
        words.append("left")
    if not row["rate"] <= wanted_rate(row["case"]):
        words.append("rate")
    return ", ".join(words)


def step_table(steps: pd.DataFrame, engine: str) -> common.Table:
    """All steps with one engine."""
    mine = steps[steps["engine"] == engine]
    frame = pd.DataFrame({
        "case": mine["case"], "nodes": mine["nodes"], "contact nodes": mine["contact_nodes"], "levels": mine["levels"],
        "size ratio": mine["size_ratio"], "error": 100 * mine["error"], "reference": 100 * mine["allowance"],
        "eta/error": mine["residual_effectivity"], "ZZ/error": mine["zz_effectivity"], "cycles": mine["cycles"],
        "needed": mine["needed"], "to the error": mine["needed_zz"], "start": mine["start_left"], "left": mine["left"],
        "rate": mine["rate"], "work": mine["work"], "work in all": mine["work_in_all"]})
    note = ("error: relative, energy norm; reference: the reference's own. size ratio: largest 99 % quantile between "
            "neighbouring levels. needed: cycles from the step before to an algebraic error of a tenth of the "
            "estimate; to the error: to a tenth of the true error. start, left: algebraic error over the estimate, "
            "after the first smoothing of what the step before left, and where the loop stopped. Work of the step and "
            "of the loop so far, in passes over the matrix of the step. '-': nothing before it to start from.")
    return common.Table(f"estimator_steps_{engine}", frame, f"Adaptive loops step by step, {engine}", note,
                        {"error": "%", "reference": "%", "work": "WU", "work in all": "WU"},
                        {"size ratio": ".2f", "error": ".3f", "reference": ".2f", "eta/error": ".2f", "ZZ/error": ".2f",
                         "needed": ".0f", "to the error": ".0f", "start": ".2f", "left": ".3f", "rate": ".2f",
                         "work": ".1f", "work in all": ".1f"})


def goal_table(goals: pd.DataFrame) -> common.Table:
    """Signed estimates of goals over their true errors."""
    rows, words = [], []
    for case, group in goals.groupby("case", sort=False):
        # the reference is known to what its own estimate misses
        last = group[group["error"].abs() > 4 * group["reference_signed"].abs()].iloc[-4:]
        for _, step in last.iterrows():
            size = abs(step["exact"])
            rows.append({"case": case, "nodes": step["nodes"], "error": step["error"] / size,
                         "estimate": step["signed"] / size, "estimate/error": step["signed"] / step["error"],
                         "absolute/error": step["absolute"] / abs(step["error"])})
    frame = pd.DataFrame(rows, columns=["case", "nodes", "error", "estimate", "estimate/error", "absolute/error"])
    for case, group in frame.groupby("case", sort=False):
        words.append(f"{case} {span(group['estimate/error'], '.2f')}")
    last = goals.groupby("case", sort=False)[["nodes", "reference"]].max()
    finer = (last["reference"] / last["nodes"]).min()
    note = ("Goals (dual-weighted residuals) of the loops that follow them, bisected; error and estimate are signed, "
            "exact minus discrete, over the value. The exact value is the corrected one on the last mesh of the "
            f"loop, of at least {finer:.1f} times the nodes; steps whose error is less than four times the last "
            f"estimate are left out. estimate/error: {'; '.join(words)}. The sum of absolute values, by which elements "
            "are marked (absolute/error), is no estimate.")
    return common.Table("estimator_goals", frame, "Goals: signed estimate over true error", note,
                        {"error": "of the value", "estimate": "of the value"},
                        {"error": "+.2e", "estimate": "+.2e", "estimate/error": ".2f", "absolute/error": ".1f"})


def cost_table(costs: pd.DataFrame) -> common.Table:
    """What the whole loop costs over a nested start on its last meshes."""
    without = costs["assembly_s"] + costs["solve_s"] + costs["estimate_s"]
    alone = costs["build_s"] + costs["alone_s"]
    frame = pd.DataFrame({
        "case": costs["case"], "engine": costs["engine"], "theta": costs["theta"], "nodes": costs["nodes"],
        "levels": costs["levels"], "rate": costs["rate"],
        "loop": costs["loop_work"], "nested start": costs["nested_work"],
        "work": costs["loop_work"] / costs["nested_work"], "over 1e-8": costs["loop_work"] / costs["tight_work"],
        "meshes": costs["mesh_s"], "assembly": costs["assembly_s"], "solves": costs["solve_s"],
        "estimates": costs["estimate_s"], "nested": costs["alone_s"], "its levels": costs["build_s"],
        "without meshes": without / alone, "with meshes": (without + costs["mesh_s"]) / alone,
        "solves alone": costs["solve_s"] / costs["alone_s"], "all/nested": without / costs["alone_s"]})
    plane = frame[(frame["engine"] == "bisected") & (costs["dim"] == 2)]
    note = ("loop: work of all its solves, nested start: of FullMultigrid(rtol='discretisation') on the last "
            f"hierarchy, in passes over its finest matrix; work: their ratio (aimed at <= {WORK:g}: "
            f"{span(frame['work'], '.2f')}); over 1e-8: loop over FullMultigrid(rtol=1e-8) (<= {TIGHT:g}: "
            f"{span(frame['over 1e-8'], '.2f')}). Processor seconds, medians in turns in one process: of the loop "
            "meshes, assembly (with transfers and the choice of levels), solves, estimates; of the last meshes alone "
            "the nested start and its levels (assembly, transfers). without meshes: assembly, solves and estimates "
            f"of the loop over both (<= {WITHOUT:g}: {span(frame['without meshes'], '.2f')}); with meshes, in 2D "
            f"bisected, <= {WITH:g}: {span(plane['with meshes'], '.2f')}. solves alone: solves over the nested start. "
            "all/nested: the same as without meshes over the nested start only, as if levels came for nothing. Ratios "
            "follow the growth of the meshes: where the limit of nodes cuts the last one short, the one before it is "
            "nearly as large. rate: asymptotic, to 1e-10 on the last hierarchy.")
    return common.Table("estimator_costs", frame, "The whole loop over a nested start on its last meshes", note,
                        {name: "s" for name in ("meshes", "assembly", "solves", "estimates", "nested", "its levels")}
                        | {"loop": "WU", "nested start": "WU"},
                        {"theta": ".1f", "rate": ".2f", "loop": ".1f", "nested start": ".1f", "work": ".2f",
                         "over 1e-8": ".2f", "meshes": ".3f", "assembly": ".3f", "solves": ".3f", "estimates": ".3f",
                         "nested": ".3f", "its levels": ".3f", "without meshes": ".2f", "with meshes": ".2f",
                         "solves alone": ".2f", "all/nested": ".2f"})


@styled
def effectivity_figure(steps: pd.DataFrame) -> common.Figure:
    """Both effectivities against the true error, one panel each."""
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 4.2))
    cases = list(steps["case"].unique())
    for ax, column, title in zip(axes, ("residual_effectivity", "zz_effectivity"), ("residual", "recovery (ZZ)"),
                                 strict=True):
        for k, case in enumerate(cases):
            for engine, dash in DASHES.items():
                mine = steps[(steps["case"] == case) & (steps["engine"] == engine)]
                ax.semilogx(100 * mine["error"], mine[column], dash, **_style(case, engine, k))
        ax.invert_xaxis()
        ax.set_xlabel("true energy error [%]")
        ax.set_title(title)
        ax.grid(True)
        common.plain_ticks(ax.xaxis)
    axes[0].set_ylim(bottom=0.0)
    axes[0].set_ylabel("estimate / true error")
    axes[1].axhspan(*RECOVERED, color=GREY, alpha=0.12, linewidth=0)
    _legend(figure, axes[0])
    return common.Figure("estimator_effectivity", figure,
                         "Estimate over true error on adaptive meshes; bisected solid, remeshed dotted; shaded: "
                         "aimed at.")


@styled
def rate_figure(steps: pd.DataFrame) -> common.Figure:
    """Asymptotic rate and algebraic error left against nodes."""
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 4.2))
    for k, case in enumerate(steps["case"].unique()):
        for engine, dash in DASHES.items():
            mine = steps[(steps["case"] == case) & (steps["engine"] == engine) & (steps["step"] > 0)]
            axes[0].semilogx(mine["nodes"], mine["rate"], dash, **_style(case, engine, k))
            axes[1].loglog(mine["nodes"], mine["left"].clip(lower=1e-3), dash, **_style(case, engine, k))
    for ax, title in zip(axes, ("asymptotic rate", "algebraic error left / estimate"), strict=True):
        ax.set_xlabel("nodes")
        ax.set_title(title)
        ax.grid(True)
    axes[0].set_ylim(0.0, 1.0)
    axes[1].axhline(SHARE, color=GREY, linewidth=0.8)
    common.plain_ticks(axes[1].yaxis)
    _legend(figure, axes[0])
    return common.Figure("estimator_rates", figure,
                         "Multigrid on the levels that adaptivity leaves; bisected solid, remeshed dotted; grey line: "
                         "aimed at.")


def _style(case: str, engine: str, k: int) -> dict[str, object]:
    """Of one line; the exact transitions look alike."""
    exact = case in EXACT
    label = ("exact transitions" if exact else case) if engine == "bisected" else None
    return {"color": GREY if exact else CYCLE[k % len(CYCLE)], "marker": "" if exact else "osv^D*P"[k % 7],
            "markersize": 4, "linewidth": 1.2, "label": label}


def _legend(figure: plt.Figure, ax: plt.Axes) -> None:
    """One entry a label, below the panels."""
    handles = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4)
