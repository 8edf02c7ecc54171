"""Figures of ``adaptive_vs_uniform.py``: errors against nodes and seconds, adaptive meshes with their contact zones."""

from __future__ import annotations

from collections.abc import Sequence

import adaptive_runs as runs
import common
import numpy as np
import pandas as pd
from adaptive_cases import CASES
from adaptive_tables import EXPONENTS
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import adaptmg as am
from adaptmg.plot.style import CYCLE, GREY, styled

MARKERS = "osD^vP"
#: adaptive loops that are drawn, with their nodes (quick, full)
DRAWN = {"GRECO bar": (500, 1500), "dovetail": (700, 4000)}


def figures(rows: pd.DataFrame, quick: bool) -> list[common.Figure]:
    """All of them."""
    return [against(rows, "nodes"), against(rows, "cpu"), pressure_figure(rows),
            *(loop_figure(case, sizes[not quick]) for case, sizes in DRAWN.items())]


def curves(ax: Axes, of_case: pd.DataFrame, x: str, y: str = "energy_error") -> None:
    """Error of every family of a case, per cent."""
    for k, (family, group) in enumerate(of_case.groupby("family", sort=False)):
        group = group[group[y] > 0]
        ax.loglog(group[x], 100 * group[y], marker=MARKERS[k], color=CYCLE[k], markersize=3.5, linewidth=1.2,
                  label=family)
    ax.grid(True)
    common.plain_ticks(ax.yaxis)


def slope_line(ax: Axes, of_case: pd.DataFrame, exponent: float, family: str, text: str) -> None:
    """The rate of theory through the last mesh of a family."""
    group = of_case[of_case["family"] == family]
    n, e = float(group["nodes"].iloc[-1]), 100 * float(group["energy_error"].iloc[-1])
    ends = np.array([n / 12, n])
    ax.plot(ends, 0.78 * e * (ends / n) ** -exponent, color=GREY, linewidth=1.0, linestyle=(0, (4, 3)))
    # room for what is said of it
    ax.set_ylim(bottom=min(ax.get_ylim()[0], 0.58 * e))
    ax.annotate(text, (n, 0.78 * e), xytext=(0, -2), textcoords="offset points", color=GREY, fontsize=8, ha="center",
                va="top")


@styled
def against(rows: pd.DataFrame, x: str) -> common.Figure:
    """Energy error of all cases against nodes, or seconds."""
    figure, axes = plt.subplots(2, 4, figsize=(13.5, 6.8))
    for ax, (case, of_case) in zip(axes.flat, rows.groupby("case", sort=False), strict=False):
        curves(ax, of_case, x)
        ax.set_title(case, fontsize=10)
        ax.set_ylabel("energy error [%]")
        ax.set_xlabel("nodes" if x == "nodes" else "processor time, everything [s]")
        if x == "nodes":
            dim, exponent = CASES[case].dim, EXPONENTS[case] / CASES[case].dim
            slope_line(ax, of_case, 1 / dim, "residual, bisected", f"$N^{{-1/{dim}}}$")
            # unknown where NaN
            if exponent < 1 / dim:
                slope_line(ax, of_case, exponent, "uniform", f"$N^{{-{exponent:.2f}}}$")
    handles, labels = axes.flat[0].get_legend_handles_labels()
    axes.flat[-1].set_axis_off()
    axes.flat[-1].legend(handles, labels, loc="center", fontsize=10)
    words = "nodes; dashed: rates of theory" if x == "nodes" else "processor time of one thread, everything counted"
    return common.Figure(f"adaptive_energy_{x}", figure, f"Relative energy error against {words}")


@styled
def pressure_figure(rows: pd.DataFrame) -> common.Figure:
    """Pressure error of all cases against nodes."""
    figure, axes = plt.subplots(2, 4, figsize=(13.5, 6.8))
    for ax, (case, of_case) in zip(axes.flat, rows.groupby("case", sort=False), strict=False):
        curves(ax, of_case, "nodes", "pressure_error")
        ax.set_title(case, fontsize=10)
        ax.set_ylabel("pressure error, $L^2$ [%]")
        ax.set_xlabel("nodes")
    handles, labels = axes.flat[0].get_legend_handles_labels()
    axes.flat[-1].set_axis_off()
    axes.flat[-1].legend(handles, labels, loc="center", fontsize=10)
    return common.Figure("adaptive_pressure", figure, "Relative L2 error of the contact pressure against nodes, "
                         "singular edges left out; it levels off at the reference's own (upset block, plane and 3D)")


def steps_of(case: str, nodes: int) -> list[am.Step]:
    """An adaptive loop with the defaults."""
    this, problem = CASES[case], CASES[case].problem()
    return list(am.adapt(problem, runs.first_mesh(this, problem), max_nodes=nodes))


def loop_figure(case: str, nodes: int) -> common.Figure:
    """Meshes with zones, and where the error lies."""
    name = f"adaptive_meshes_{case.split()[0].lower()}"
    return common.Figure(name, am.plot.adaptation(steps_of(case, nodes)),
                         f"{case}: adaptive meshes with their contact states, indicator, estimate")


@styled
def picture(rows: pd.DataFrame, case: str, steps: Sequence[am.Step]) -> Figure:
    """For the README: two adaptive meshes with contact states, and the errors of a case against nodes and seconds."""
    figure, axes = plt.subplots(1, 4, figsize=(14.6, 4.4), layout="constrained", width_ratios=(0.72, 0.72, 1.0, 1.0))
    for ax, step in zip(axes[:2], steps, strict=True):
        am.plot.deformation(step.result, amplify=1, states=True, ax=ax)
        ax.set_title(f"{case}, {step.nodes} nodes", fontsize=10)
        ax.set_axis_off()
    of_case = rows[rows["case"] == case]
    for ax, x in zip(axes[2:], ("nodes", "cpu"), strict=True):
        curves(ax, of_case, x)
        ax.set_ylabel("energy error [%]")
        ax.set_xlabel("nodes" if x == "nodes" else "processor time, everything counted [s]")
    axes[2].legend(fontsize=8)
    return figure
