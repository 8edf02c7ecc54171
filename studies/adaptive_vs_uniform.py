"""Adaptive against uniform meshes: nodes, work and seconds for a given accuracy of the solution.

1. The GRECO bar with friction 1, on uniform nested grids, on independent Netgen meshes (refined near contact or not),
   and on meshes bisected along the contact line: error of the displacement at the points A-E, of the contact force,
   and of the ends of the contact zones.
2. The upset block, whose foot is singular: the energy error against nodes, where uniform meshes lose their rate.

    python studies/adaptive_vs_uniform.py [--quick] [--out DIR]
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import common
import numpy as np
import pandas as pd
from adaptive_upset import upset_items
from matplotlib import pyplot as plt
from mesh_families import RTOL, costs, grids_of, study_families

import adaptmg as am
from adaptmg.plot.style import CYCLE, GREY, styled

#: family -> fineness: divisions of the finest grid, or how often 20 mm were halved, or bisections of the contact line
BAR: Mapping[str, tuple[int, ...]] = {
    "uniform": (4, 8, 16, 32, 64, 128, 256), "Netgen, not graded": (1, 2, 3, 4, 5, 6),
    "Netgen, contact 4x finer": (1, 2, 3, 4, 5), "Netgen, contact 16x finer": (1, 2, 3, 4, 5),
    "8 cells, contact line bisected": (1, 2, 3, 4), "halved, contact line bisected 3x": (4, 8, 16, 32, 64)}
QUICK_BAR: Mapping[str, tuple[int, ...]] = {
    "uniform": (4, 8, 16, 32, 64), "Netgen, not graded": (1, 2, 3), "Netgen, contact 4x finer": (1, 2, 3, 4),
    "8 cells, contact line bisected": (1, 2, 3), "halved, contact line bisected 3x": (4, 8, 16)}
TOLERANCES = (0.3, 0.1, 0.05, 0.025)


def zone_end(result: am.Result, state: int) -> float:
    """Half way between the last node in a state and the next one along the line, m; NaN where there is none."""
    x = result.contact.x[:, 0]
    order = np.argsort(x)
    inside = np.flatnonzero(result.contact.state[order] == state)
    if not inside.size or inside[-1] + 1 == len(x):
        return float("nan")
    return float(x[order][inside[-1]:inside[-1] + 2].mean())


def bar(family: str, fineness: int, rtol: float) -> dict[str, Any]:
    """The GRECO bar on one mesh: errors at A-E against the converged values, contact force, zones, cost."""
    common.warm_up()
    problem = am.cases.greco_bar(law=am.Coulomb(1.0))
    hierarchy = grids_of(problem, family, fineness)
    result = common.quickest(hierarchy, am.FullMultigrid(correction=am.Monotone(), rtol=rtol))
    reference = problem.reference
    values = np.array(list(reference["values"]["converged"].values()))
    errors = np.abs(result.probe(list(reference["points"].values()))[:, 0] / values - 1)
    force = result.resultant("contact").force
    return {**{f"error_{name}": error for name, error in zip(reference["points"], errors, strict=True)},
            "max_error": float(errors.max()), "force_t": force[0], "force_n": force[1],
            "open_end": zone_end(result, am.OPEN), "slip_end": zone_end(result, am.SLIP), **costs(hierarchy, result)}


def limit(values: np.ndarray) -> float:
    """Limit of a sequence whose last three values converge geometrically (Aitken)."""
    a, b, c = values[-3:]
    return float(c - (c - b)**2 / ((c - b) - (b - a)))


def run(context: common.Context) -> common.Section:
    """Both problems."""
    bars = study_families(context, bar, QUICK_BAR if context.quick else BAR)
    bars["force_error"] = np.abs(bars["force_t"] / limit(bars.loc[bars["family"] == "uniform", "force_t"].values) - 1)
    text = ("Meshes refined where the contact is, against uniform ones. Every mesh is solved on a hierarchy of its "
            "own by FullMultigrid with the monotone correction, V(2,0), nested start, to an estimated relative energy "
            f"error of {RTOL:g}. Seconds are the best of up to three solves on one thread; those of the meshes and "
            "matrices of all levels are counted.")
    return common.Section("Adaptive against uniform meshes", text, [
        accuracy_table(bars), cost_table(bars), needed_table(bars), *bar_figures(bars, context.quick),
        *upset_items(context)])


def gain(bars: pd.DataFrame, column: str) -> pd.Series:
    """Error of the uniform grids at the same number of nodes (interpolated between logarithms) over each error."""
    uniform = bars[bars["family"] == "uniform"]
    there = np.interp(np.log(bars["nodes"]), np.log(uniform["nodes"]), np.log(uniform[column]), np.nan, np.nan)
    return np.exp(there) / bars[column]


def accuracy_table(bars: pd.DataFrame) -> common.Table:
    """Errors by family and nodes."""
    frame = pd.DataFrame({
        "grid": bars["family"], "nodes": bars["nodes"], "contact nodes": bars["contact_nodes"],
        "contact h": 1e3 * bars["contact_h"], "max error A-E": 100 * bars["max_error"], "at A": 100 * bars["error_A"],
        "at E": 100 * bars["error_E"], "gain A-E": gain(bars, "max_error"), "T error": 100 * bars["force_error"],
        "gain T": gain(bars, "force_error"), "open to": 1e3 * bars["open_end"], "slip to": 1e3 * bars["slip_end"]})
    return common.Table("adaptive_bar_accuracy", frame, f"GRECO bar, friction 1: accuracy (rtol {RTOL:g})",
                        accuracy_note(bars, frame),
                        {"contact h": "mm", "max error A-E": "%", "at A": "%", "at E": "%", "T error": "%",
                         "open to": "mm", "slip to": "mm"},
                        {"contact h": ".3f", "max error A-E": ".4f", "at A": ".4f", "at E": ".4f", "T error": ".4f",
                         "open to": ".2f", "slip to": ".2f", "gain A-E": ".1f", "gain T": ".1f"})


def accuracy_note(bars: pd.DataFrame, frame: pd.DataFrame) -> str:
    """What the errors are measured against, and what they say."""
    zones = am.cases.greco_bar().reference["zones"]
    balance = np.abs(bars["force_n"] / bars["force_n"].iloc[0] - 1).max()
    line = bars[bars["family"] == "8 cells, contact line bisected"].iloc[2]
    graded, plain = (frame[frame["grid"] == name] for name in ("Netgen, contact 4x finer", "Netgen, not graded"))

    def span(values: pd.Series) -> str:
        return f"{values.min():.1f} to {values.max():.1f}"

    return (
        "max error A-E: of u_x against the converged P2 values. T: tangential contact force, against the value "
        "extrapolated from the three finest uniform grids (the normal force is given by equilibrium and the same to "
        f"{balance:.0e}). gain: error of the uniform grids at the same number of nodes, interpolated, over this one: "
        f"at A-E {span(graded['gain A-E'])} on Netgen meshes four times finer at contact, of which an unstructured "
        f"mesh that is not graded has {span(plain['gain A-E'])}; in T, a quantity of the whole body, "
        f"{graded['gain T'].median():.1f} and {plain['gain T'].median():.1f} in the median. Zones: half way between "
        f"two nodes of different state, so to half of contact h; converged {1e3 * zones['open'][1]:.2f} and "
        f"{1e3 * zones['slip'][1]:.2f} mm. A mesh of 8 cells refined along the contact line alone, 64 cells there, was "
        "measured elsewhere with 247 nodes and .05 %; bisection of all elements that touch the line needs "
        f"{line['nodes']} nodes for the same 64 cells and has {100 * line['max_error']:.2f} %. The contact force of "
        f"such meshes stays {100 * line['force_error']:.1f} % off however fine the line is: what is left is the error "
        "of the bulk, and at single points it may cancel.")


def cost_table(bars: pd.DataFrame) -> common.Table:
    """Work and seconds by phase."""
    phases = ["mesh_s", "assembly_s", "transfer_s", "setup_s", "solve_s", "total_s"]
    names = {name: name.removesuffix("_s") for name in phases}
    frame = bars[["family", "nodes", "levels", "mesh_ratio", "cycles", "rate", "work_units", *phases, "residual",
                  "outcome"]].rename(columns={"family": "grid", "mesh_ratio": "h ratio", "work_units": "WU",
                                              "outcome": "status", **names})
    largest = {name: bars[bars["family"] == name].iloc[-1] for name in bars["family"].unique()}
    netgen, uniform = largest["Netgen, contact 4x finer"], largest["uniform"]
    line = largest["8 cells, contact line bisected"]
    share = {name: 100 * row["mesh_s"] / row["total_s"] for name, row in largest.items()}
    cycle = (bars["work_units"] - bars["start_work_units"]) / (bars["cycles"] + 1)
    note = (
        "h ratio: largest local ratio of mesh sizes between two levels. WU: passes over the finest matrix, nested "
        "start included; factorisations of the coarsest grid are in set-up. Meshing takes "
        f"{share[netgen['family']]:.0f} % of the seconds with Netgen at {netgen['nodes']} nodes, "
        f"{share['uniform']:.0f} % on structured grids at {uniform['nodes']}. The rate on the largest meshes is "
        f"{netgen['rate']:.2f} with non-nested levels ({netgen['family']}) and {uniform['rate']:.2f} with nested "
        f"uniform ones. A cycle costs {cycle[uniform.name]:.1f} WU on the largest uniform grids, "
        f"{cycle[netgen.name]:.1f} WU on those Netgen meshes, whose Galerkin matrices are denser, and "
        f"{cycle[line.name]:.1f} WU with bisection of the contact line alone, which adds few nodes a level.")
    return common.Table("adaptive_bar_cost", frame, f"GRECO bar, friction 1: work and seconds (rtol {RTOL:g})", note,
                        {name: "s" for name in names.values()},
                        {"rate": ".2f", "WU": ".0f", "h ratio": ".2f", "residual": ".1e"}
                        | dict.fromkeys(names.values(), ".3f"))


def needed(rows: pd.DataFrame, tolerance: float) -> pd.Series | None:
    """The first mesh of a family from which on the error stays below a tolerance."""
    rows = rows.sort_values("nodes")
    above = np.flatnonzero(rows["max_error"].values > tolerance)
    first = above[-1] + 1 if above.size else 0
    return rows.iloc[first] if first < len(rows) else None


def needed_table(bars: pd.DataFrame) -> common.Table:
    """Nodes and seconds for a given accuracy."""
    rows = []
    for name, group in bars.groupby("family", sort=False):
        row: dict[str, Any] = {"grid": name}
        for percent in TOLERANCES:
            found = needed(group, percent / 100)
            row[f"nodes, {percent:g} %"] = float("nan") if found is None else found["nodes"]
            row[f"s, {percent:g} %"] = float("nan") if found is None else found["total_s"]
        rows.append(row)
    frame = pd.DataFrame(rows)
    uniform, graded = (needed(bars[bars["family"] == name], 1e-3) for name in ("uniform", "Netgen, contact 4x finer"))
    note = ("The first mesh of each family from which on the largest error at A-E stays below the tolerance; - where "
            "none computed here does.")
    if uniform is not None and graded is not None:
        note += (f" For .1 % the graded mesh has {graded['nodes']} nodes, the uniform one {uniform['nodes']} "
                 f"({uniform['nodes'] / graded['nodes']:.1f} times as many); in seconds, meshing included, "
                 f"{graded['total_s']:.2f} and {uniform['total_s']:.2f}, without meshing "
                 f"{graded['total_s'] - graded['mesh_s']:.2f} and {uniform['total_s'] - uniform['mesh_s']:.2f}.")
    formats = {name: ".0f" if name.startswith("nodes") else ".2f" for name in frame.columns[1:]}
    return common.Table("adaptive_bar_needed", frame, "GRECO bar: nodes and total seconds for a given error at A-E",
                        note, formats=formats)


@styled
def bar_figures(bars: pd.DataFrame, quick: bool) -> list[common.Figure]:
    """Error against nodes and seconds; a graded hierarchy, its contact line, its deformed body."""
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 4.2), sharey=True)
    for ax, column, label in zip(axes, ("nodes", "total_s"), ("nodes", "time, meshing to solution [s]"), strict=True):
        for k, (name, rows) in enumerate(bars.groupby("family", sort=False)):
            ax.loglog(rows[column], 100 * rows["max_error"], marker="os^Dvp"[k], color=CYCLE[k], label=name)
        ax.set_xlabel(label)
        ax.grid(True)
    nodes = np.array([100.0, 5e4])
    axes[0].loglog(nodes, 2.0 * nodes[0] / nodes, color=GREY, linestyle=(0, (4, 3)), linewidth=1.0, zorder=1)
    axes[0].annotate("$N^{-1}$", (nodes[1], 2.0 * nodes[0] / nodes[1]), color=GREY, ha="right", va="top")
    axes[0].set_ylabel("largest error of $u_x$ at A-E [%]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    hierarchy = grids_of(am.cases.greco_bar(law=am.Coulomb(1.0)), "Netgen, contact 4x finer", 2 if quick else 3)
    result = am.solve(hierarchy, am.FullMultigrid(correction=am.Monotone(), rtol=RTOL))
    count = hierarchy.finest.discrete.n_nodes
    return [
        common.Figure("adaptive_bar_error", figure, "GRECO bar: error at the points A-E against nodes and seconds"),
        common.Figure("adaptive_bar_grids", am.plot.grids(hierarchy),
                      "Independent Netgen meshes, four times finer at the contact boundary (marked)"),
        common.Figure("adaptive_bar_contact", am.plot.contact(result),
                      f"GRECO bar, friction 1, graded mesh of {count} nodes: pressure, friction, gap and slip"),
        common.Figure("adaptive_bar_deformed", am.plot.deformation(result, displacement=True),
                      f"The deformed bar on the graded mesh of {count} nodes, over its outline before")]


if __name__ == "__main__":
    common.main(run, "Adaptive against uniform meshes: nodes, work and seconds for a given accuracy.")
