"""Figures of ``adaptive_vs_uniform.py``: errors against nodes and seconds, adaptive meshes with their contact zones."""

from __future__ import annotations

from collections.abc import Sequence

import adaptive_runs as runs
import common
import numpy as np
import pandas as pd
from adaptive_cases import CASES, EXPONENTS
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

import adaptmg as am
from adaptmg.plot.style import CYCLE, GREY, styled

MARKERS = "osD^vP"
#: adaptive loops that are drawn, with their nodes; the last in a quick run too
DRAWN = {"GRECO bar": 1500, "dovetail": 4000}
QUICK_DRAWN = ("dovetail", 700)


def figures(rows: pd.DataFrame, quick: bool) -> list[common.Figure]:
    """Errors against cost, and meshes."""
    both = [against(rows, "nodes"), against(rows, "cpu")]
    if quick:
        return [*both, loop_figure(*QUICK_DRAWN)]
    return [*both, pressure_figure(rows), *(loop_figure(*drawn) for drawn in DRAWN.items())]


def curves(ax: Axes, of_case: pd.DataFrame, x: str, y: str = "energy_error") -> None:
    """Error of every family of a case, per cent."""
    for k, (family, group) in enumerate(of_case.groupby("family", sort=False)):
        group = group[group[y] > 0]
        ax.loglog(group[x], 100 * group[y], marker=MARKERS[k], color=CYCLE[k], markersize=3.5, linewidth=1.2,
                  label=family)
    ax.grid(True)


def panels(rows: pd.DataFrame) -> tuple[Figure, list[Axes], Axes]:
    """A figure with a place for each case, and one more for the legend, that has nothing else."""
    count = rows["case"].nunique() + 1
    across = (count + 1) // 2
    figure, axes = plt.subplots(2, across, figsize=(3.4 * across, 6.8))
    for ax in axes.flat[count - 1:]:
        ax.set_axis_off()
    return figure, list(axes.flat[:count - 1]), axes.flat[count - 1]


def finished(figure: Figure, axes: Sequence[Axes], last: Axes) -> None:
    """Ticks, for limits as they are now, and the legend."""
    for ax in axes:
        low, high = ax.get_ylim()
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 120 * low else (1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_minor_formatter(NullFormatter())
    last.legend(*axes[0].get_legend_handles_labels(), loc="center", fontsize=10)


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
    figure, axes, last = panels(rows)
    for ax, (case, of_case) in zip(axes, rows.groupby("case", sort=False), strict=True):
        curves(ax, of_case, x)
        ax.set_title(case, fontsize=10)
        ax.set_ylabel("energy error [%]")
        ax.set_xlabel("nodes" if x == "nodes" else "processor time [s]")
        if x == "nodes":
            dim, exponent = CASES[case].dim, EXPONENTS[case] / CASES[case].dim
            slope_line(ax, of_case, 1 / dim, "residual, bisected", f"$N^{{-1/{dim}}}$")
            # unknown where NaN
            if exponent < 1 / dim:
                slope_line(ax, of_case, exponent, "uniform", f"$N^{{-{exponent:.2f}}}$")
    finished(figure, axes, last)
    words = ("nodes; dashed: rates of theory" if x == "nodes" else
             "processor time of one thread, everything counted; of a loop that of all steps so far")
    return common.Figure(f"adaptive_energy_{x}", figure, f"Relative energy error against {words}")


@styled
def pressure_figure(rows: pd.DataFrame) -> common.Figure:
    """Pressure error of all cases against nodes."""
    figure, axes, last = panels(rows)
    for ax, (case, of_case) in zip(axes, rows.groupby("case", sort=False), strict=True):
        curves(ax, of_case, "nodes", "pressure_error")
        ax.set_title(case, fontsize=10)
        ax.set_ylabel("pressure error, $L^2$ [%]")
        ax.set_xlabel("nodes")
    finished(figure, axes, last)
    return common.Figure("adaptive_pressure", figure, "Relative L2 error of the contact pressure against nodes, "
                         "singular edges left out; where it levels off it is the reference's own")


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
        common.plain_ticks(ax.yaxis)
    axes[2].legend(fontsize=8)
    return figure
