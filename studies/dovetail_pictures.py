"""Pictures of the dovetail: what is posed, deformed, its flank, convergence, friction, load history."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from common import Figure
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from paper_runs import RTOL, TARGET, draw_error

import adaptmg as am
from adaptmg.plot.style import BLUE, GREEN, GREY, INK, ORANGE, STATE_COLORS, STATE_NAMES, styled

#: of the paper's Fig. 3
AMPLIFY = 20
FLANK_MM = 13.0


def posed() -> Figure:
    """What is posed."""
    return Figure("dovetail_problem", am.plot.problem(am.cases.dovetail()), "The dovetail as posed (reconstruction): "
                  "one half, the tongue pulled, the block clamped from the side.")


@lru_cache(maxsize=2)
def solved(quick: bool) -> am.Result:
    """The default case on a grid that can be drawn."""
    sizes = (6e-3, 3.6e-3, 2.2e-3) if quick else (6e-3, 3.6e-3, 2.2e-3, 1.3e-3, 0.8e-3)
    return am.solve(am.Hierarchy.graded(am.cases.dovetail(), sizes, contact_ratio=4), am.FullMultigrid())


def solution(quick: bool) -> list[Figure]:
    """Deformed bodies, von Mises stress, and the flank."""
    result = solved(quick)
    nodes = len(result.displacement)
    return [Figure("dovetail_deformed", am.plot.deformation(result, AMPLIFY, states=True), f"Displacement amplified "
                   f"{AMPLIFY} times, as in Fig. 3 of the paper ({nodes} nodes). Dots: states of the contact nodes."),
            Figure("dovetail_stress", am.plot.deformation(result, AMPLIFY, stress=True, lines=False),
                   f"Von Mises stress on the deformed joint ({nodes} nodes, constant on each element); it is singular "
                   "at the lower end of the tongue's flank and at the root of the notch, so that the largest values "
                   "grow with refinement."),
            Figure("dovetail_flank", am.plot.contact(result, boundary="tongue.flank"), "The flank from the chamfer "
                   "(arc length 0) to the mouth: contact pressure, friction within its bound, gap and slip; colours "
                   "are the states.")]


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
    return Figure("dovetail_error", canvas, f"True error against work on {frame['grids'].iloc[-1].split('/')[0]} "
                  "nodes: one grid, and several in the monotone and the truncated mode; a cross where a run stops "
                  f"before {TARGET:g}.")


@styled
def friction_figure(frame: pd.DataFrame) -> Figure:
    """Lift, zones and cost against friction."""
    canvas, axes = plt.subplots(1, 3, figsize=(11, 3.9))
    mu = frame["friction"].to_numpy()
    axes[0].plot(mu, 1e6 * frame["lift"], marker="o", color=BLUE)
    axes[0].set(ylabel="lift of the neck [µm]", ylim=(0, 1.1e6 * frame["lift"].max()))
    draw_zones(axes[1], mu, *(1e3 * frame[name].to_numpy() for name in ("open_to", "stick_from", "stick_to")))
    axes[2].plot(mu, frame["work"], marker="o", color=BLUE)
    axes[2].set(ylabel="work units to an estimated error of 1e-8", ylim=(0, 1.1 * frame["work"].max()))
    for ax in axes:
        ax.set_xlabel("friction coefficient")
        ax.grid(ax is not axes[1])
    return Figure("dovetail_friction_zones", canvas, f"Lift, zones on the flank and cost against friction, "
                  f"{frame['nodes'].iloc[0]} nodes, all loads in one step; {frame['cycles'].min()} to "
                  f"{frame['cycles'].max()} cycles.")


def draw_zones(ax: Axes, mu: np.ndarray, opened: np.ndarray, first: np.ndarray, last: np.ndarray) -> None:
    """States along the flank, depth in mm; where nothing sticks (NaN) the zone of sticking has shrunk to a point."""
    sticks = np.isfinite(first)
    meet = 0.5 * (first[sticks][0] + last[sticks][0]) if sticks.any() else FLANK_MM
    low, high = np.where(sticks, first, meet), np.where(sticks, last, meet)
    bands = ((0 * mu, opened, am.OPEN), (opened, low, am.SLIP), (low, high, am.STICK),
             (high, 0 * mu + FLANK_MM, am.SLIP))
    for lower, upper, state in bands:
        ax.fill_between(mu, lower, upper, color=STATE_COLORS[state], linewidth=0)
    for values in (opened, first, last):
        ax.plot(mu, values, color=INK, marker="o", markersize=3, linewidth=0.8)
    ax.set(ylabel="depth below the mouth [mm]", ylim=(FLANK_MM, 0), xlim=(0, mu.max()))
    handles = [Patch(facecolor=STATE_COLORS[state], edgecolor=GREY, label=name) for state, name in STATE_NAMES.items()]
    ax.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)


def history_figure(results: Sequence[am.Result], pulls: np.ndarray, steps: int) -> Figure:
    """Hysteresis and contact pressure."""
    def lift(result: am.Result) -> float:
        return 1e6 * float(result.probe([(0.0, 24e-3)])[0, 1])

    def mobilised(result: am.Result) -> float:
        c, on = result.contact, on_flank(result)
        return float(np.abs(c.force_t[on, 0]).sum() / c.limit[on].sum())

    def normal(result: am.Result) -> float:
        return 1e-6 * float(result.contact.force_n[on_flank(result)].sum())

    quantities: dict[str, Any] = {"lift of the neck [µm]": lift, "normal force on the flank [MN/m]": normal,
                                  "friction over its bound, flank [-]": mobilised}
    figure = am.plot.load_history(list(results), pulls, quantities, against="pull [MPa]", pair="tongue.flank",
                                  steps=steps)
    return Figure("dovetail_hysteresis", figure, "The clamped joint pulled in ten steps and let go: hysteresis of "
                  "the lift; normal force on the flank, and sum of the friction forces over what they may be at most; "
                  "contact pressure from the chamfer (arc length 0) to the mouth.")


def on_flank(result: am.Result) -> np.ndarray:
    """Contact nodes of the flank (n,) bool."""
    return result.contact.boundary == result.contact.names.index("tongue.flank")
