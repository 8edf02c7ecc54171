"""Pictures of the dovetail: what is posed, deformed, its flank, convergence, friction, load history."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from common import Figure
from paper_runs import RTOL, TARGET, draw_error

import adaptmg as am
from adaptmg.plot.style import BLUE, GREEN, GREY, INK, ORANGE, SKY, styled

#: of the paper's Fig. 3
AMPLIFY = 20
FLANK_MM = 13.0


def posed() -> Figure:
    """What is posed."""
    return Figure("dovetail_problem", am.plot.problem(am.cases.dovetail()), "The dovetail as posed (reconstruction): one "
                  "half, the tongue pulled, the block clamped from the side.")


@lru_cache(maxsize=2)
def solved(quick: bool) -> am.Result:
    """The default case on a grid that can be drawn."""
    sizes = (6e-3, 3.6e-3, 2.2e-3) if quick else (6e-3, 3.6e-3, 2.2e-3, 1.3e-3, 0.8e-3)
    return am.solve(am.Hierarchy.graded(am.cases.dovetail(), sizes, contact_ratio=4), am.FullMultigrid())


def solution(quick: bool) -> list[Figure]:
    """Deformed bodies, von Mises stress, and the flank."""
    result, problem = solved(quick), am.cases.dovetail()
    nodes = len(result.displacement)
    return [Figure("dovetail_deformed", am.plot.deformation(result, AMPLIFY, states=True), f"Displacement amplified "
                   f"{AMPLIFY} times, as in Fig. 3 of the paper ({nodes} nodes). Dots: states of the contact nodes."),
            Figure("dovetail_stress", am.plot.deformation(result, AMPLIFY, stress=True, problem=problem),
                   f"Von Mises stress on the deformed joint ({nodes} nodes, constant on each element); it is singular at "
                   "the lower end of the tongue's flank and at the root of the notch, so that the largest values grow "
                   "with refinement."),
            Figure("dovetail_flank", am.plot.interface(result, "tongue.flank"), "The flank from the mouth to the "
                   "chamfer: contact pressure, friction within its bound, gap; colours are the states.")]


@styled
def error_figure(frame: pd.DataFrame) -> Figure:
    """True error against work."""
    canvas, ax = plt.subplots(figsize=(7.6, 4.2))
    colors = iter((INK, GREY, "#b0568f", "#d9a3c6", BLUE, ORANGE, GREEN))
    kinds = {"monotone V": "--", "monotone W": ":", "truncated": "-"}
    used: dict[str, str] = {}
    for _, row in frame.iterrows():
        grids, _, kind = row["label"].partition(", ")
        style = {"color": next(colors), "linestyle": "-.", "marker": ""} if grids == "one grid" else {
            "color": used.setdefault(grids, "") or next(colors), "linestyle": kinds[kind]}
        if grids != "one grid":
            used[grids] = style["color"]
        draw_error(ax, row, row["label"], **style)
    ax.set(xlabel="work units", ylabel="true error (relative A-norm)", ylim=(RTOL / 2, 1.5))
    ax.axhline(TARGET, color=GREY, linewidth=0.8)
    ax.grid(True)
    canvas.legend(loc="outside right upper", fontsize=8.5)
    return Figure("dovetail_error", canvas, f"True error against work on {frame['grids'].iloc[-1].split('/')[0]} nodes: "
                  "one grid, and several in the monotone and the truncated mode; a cross where a run stops before "
                  f"{TARGET:g}.")


@styled
def friction_figure(frame: pd.DataFrame) -> Figure:
    """Lift, zones and cost against friction."""
    canvas, axes = plt.subplots(1, 3, figsize=(11, 3.5))
    mu = frame["friction"].to_numpy()
    axes[0].plot(mu, 1e6 * frame["lift"], marker="o", color=BLUE)
    axes[0].set(ylabel="lift of the neck [µm]", ylim=(0, None))
    ends = {name: 1e3 * frame[name].to_numpy() for name in ("open_to", "stick_from", "stick_to")}
    # where nothing sticks the two ends of the stick zone meet
    meet = np.nanmean([ends["stick_from"][1], ends["stick_to"][1]]) if len(mu) > 1 else np.nan
    low, high = (np.where(np.isnan(ends[name]), meet, ends[name]) for name in ("stick_from", "stick_to"))
    ax = axes[1]
    for lower, upper, color, name in ((0 * mu, ends["open_to"], "#eceef1", "open"), (ends["open_to"], low, ORANGE, "slip"),
                                      (low, high, GREEN, "stick"), (high, 0 * mu + FLANK_MM, ORANGE, None)):
        ax.fill_between(mu, lower, upper, color=color, alpha=0.55, linewidth=0, label=name)
    for values in (ends["open_to"], ends["stick_from"], ends["stick_to"]):
        ax.plot(mu, values, color=INK, marker="o", markersize=3, linewidth=0.8)
    ax.set(ylabel="depth below the mouth [mm]", ylim=(FLANK_MM, 0), xlim=(0, mu.max()))
    ax.legend(loc="center right", frameon=True, framealpha=0.9, edgecolor="none")
    axes[2].plot(mu, frame["work"], marker="o", color=BLUE, label="work units")
    axes[2].plot(mu, frame["cycles"], marker="s", color=SKY, label="cycles")
    axes[2].set(ylabel="work units, cycles", ylim=(0, None))
    axes[2].legend()
    for ax in axes:
        ax.set_xlabel("friction coefficient")
        ax.grid(ax is not axes[1])
    return Figure("dovetail_friction", canvas, f"Lift, zones on the flank and cost against friction, "
                  f"{frame['nodes'].iloc[0]} nodes, all loads in one step.")


def history_figure(results: Sequence[am.Result], pulls: np.ndarray) -> Figure:
    """Hysteresis and contact pressure."""
    def lift(result: am.Result) -> float:
        return 1e6 * float(result.probe([(0.0, 24e-3)])[0, 1])

    def share(result: am.Result) -> float:
        on = on_flank(result)
        return float(np.abs(result.contact.force_t[on, 0]).sum() / (0.2 * result.contact.force_n[on].sum()))

    def largest(result: am.Result) -> float:
        return 1e-6 * float(result.contact.pressure[on_flank(result)].max())

    quantities: dict[str, Any] = {"lift of the neck [µm]": lift, "friction on the flank over its bound": share,
                                  "largest pressure on the flank [MPa]": largest}
    figure = am.plot.load_history(list(results), pulls, quantities, against="pull [MPa]", pair="tongue.flank", steps=8)
    return Figure("dovetail_history", figure, "The clamped joint pulled in ten steps and let go again: hysteresis of the "
                  "lift, and contact pressure along the flank.")


def on_flank(result: am.Result) -> np.ndarray:
    """Contact nodes of the flank (n,) bool."""
    return result.contact.boundary == result.contact.names.index("tongue.flank")
