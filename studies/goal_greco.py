"""Goal-oriented meshes of the GRECO bar: nodes from which the displacements at A-E stay within .05 %.

    python studies/goal_greco.py [--quick | --full] [--out DIR]

Eight adaptive loops for each way to refine, from four starting meshes with two growths: meshes of one size, meshes
that follow the residual, and meshes that follow the dual-weighted residuals of the five displacements. Then the signed
estimate against the true error, for points of the bar on uniform grids and for other quantities and problems.
"""

from __future__ import annotations

import json
from typing import Any

import common
import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from paper_runs import span

import adaptmg as am
from adaptmg.mesh import graded
from adaptmg.plot.style import CYCLE, GREY, styled

SIZES, GROWTHS = (16e-3, 12e-3, 9e-3, 7e-3), (1.6, 2.2)
#: the way to refine -> nodes to which the loop goes
WAYS = {"uniform": 12_000, "residual": 5000, "goal": 2500, "goal, bisected": 2500}
QUICK_WAYS = {"residual": 600, "goal": 600}
#: of the displacement at all five points
TOLERANCE = 5e-4
#: quantities of other problems, and the unit and the factor to it
QUANTITIES = {"dovetail, lift": ("µm", 1e6), "dovetail, normal force": ("MN/m", 1e-6),
              "dovetail, mean opening": ("µm", 1e6), "block 3D, u_x at the corner": ("µm", 1e6),
              "junction, mean opening": ("µm", 1e6)}


def points() -> tuple[np.ndarray, np.ndarray]:
    """A-E (5, 2) in m, and the converged displacements (5,) in m."""
    reference = am.cases.greco_bar().reference
    return np.array(list(reference["points"].values())), np.array(list(reference["values"]["converged"].values()))


def loop_errors(way: str, size: float, growth: float, max_nodes: int) -> dict[str, Any]:
    """One loop: nodes and largest relative errors at A-E of all its meshes, as they are and with estimates added."""
    problem, (at, exact) = am.cases.greco_bar(), points()
    goal, rows = am.Goal(am.Displacement(at, "x")), []
    for hierarchy, result in solutions(problem, way, size, growth, max_nodes):
        estimate = goal.indicate(hierarchy, result)
        rows.append((result.mesh.n_nodes, np.abs(estimate.values / exact - 1).max(),
                     np.abs(estimate.corrected / exact - 1).max(), *(exact - estimate.values), *estimate.errors))
    table = np.array(rows).T
    return {"nodes": json.dumps(table[0].astype(int).tolist()), "errors": json.dumps(table[1].tolist()),
            "corrected": json.dumps(table[2].tolist()), "differences": json.dumps(table[3:8].tolist()),
            "estimates": json.dumps(table[8:].tolist())}


def solutions(problem: am.ContactProblem, way: str, size: float, growth: float, max_nodes: int) -> Any:
    """Hierarchies and results, mesh by mesh."""
    if way == "uniform":
        while True:
            hierarchy = am.Hierarchy.from_meshes(problem, [graded(problem.domain, size)])
            if hierarchy.finest.n_nodes > max_nodes:
                return
            yield hierarchy, am.solve(hierarchy, am.ActiveSet())
            size /= np.sqrt(growth)
    indicator = am.Residual() if way == "residual" else am.Goal(am.Displacement(points()[0], "x"))
    engine = am.Remesh(growth=growth, refinements=0)
    mark = None
    if way == "goal, bisected":
        engine, mark = am.Bisect(), am.Doerfler(0.3 if growth < 2 else 0.5)
    for step in am.adapt(problem, start=size, indicator=indicator, mark=mark, engine=engine, max_nodes=max_nodes):
        yield step.hierarchy, step.result


def effectivity(quantity: str, levels: int) -> dict[str, Any]:
    """Value and signed estimate of a quantity on one of a family of meshes."""
    hierarchy, wanted = posed(quantity, levels)
    result = am.solve(hierarchy, am.FullMultigrid(rtol=1e-8))
    estimate = am.Goal(wanted).indicate(hierarchy, result)
    return {"nodes": result.mesh.n_nodes, "value": estimate.value, "signed": estimate.signed,
            "absolute": float(estimate.squares.sum()), "iterations": estimate.iterations, "outcome": result.status.name}


def reference(quantity: str, max_nodes: int) -> dict[str, Any]:
    """Value and signed estimate of a quantity at the end of a loop by bisection."""
    hierarchy, wanted = posed(quantity, 1)
    *_, step = am.adapt(hierarchy.problem, start=hierarchy, indicator=am.Goal(wanted), engine=am.Bisect(),
                        max_nodes=max_nodes)
    return {"value": step.estimate.value, "signed": step.estimate.signed, "nodes": step.result.mesh.n_nodes}


def posed(quantity: str, levels: int) -> tuple[am.Hierarchy, Any]:
    """The hierarchy and the quantity behind a name."""
    if quantity.startswith("block"):
        problem = am.cases.greco_block()
        return am.Hierarchy.uniform(problem, (2, 4, 8, 16)[:levels]), am.Displacement((0.0, 0.0, 0.0), "x")
    if quantity.startswith("junction"):
        problem = am.cases.bolted_junction()
        return am.Hierarchy.graded(problem, (16e-3, 8e-3, 4e-3, 2e-3)[:levels]), am.Opening()
    problem = am.cases.dovetail()
    hierarchy = am.Hierarchy.graded(problem, (8e-3, 4e-3, 2e-3, 1e-3)[:levels], contact_ratio=2)
    what = {"lift": am.Displacement((0.0, 24e-3), "y"), "normal force": am.ContactForce(), "mean opening": am.Opening()}
    return hierarchy, what[quantity.split(", ")[1]]


def run(context: common.Context) -> common.Section:
    """Tables and figure; see the module."""
    ways = QUICK_WAYS if context.quick else WAYS
    loops = pd.concat([context.study(loop_errors, {"size": SIZES[1:2] if context.quick else SIZES, "growth": GROWTHS},
                                     way=way, max_nodes=most).assign(way=way) for way, most in ways.items()],
                      ignore_index=True)
    for column in ("nodes", "errors", "corrected", "differences", "estimates"):
        loops[column] = [np.array(json.loads(text)) for text in loops[column]]
    text = ("A loop ends when its next mesh would be too large. The number in the tables is that of nodes from which "
            "on all meshes of the loop have errors below .05 % at all five points, against the converged P2 values. "
            "Meshes are by Netgen, whole, without uniform refinement of coarser ones, or bisected.")
    totals = summary_table(loops)
    return common.Section("Goal-oriented meshes of the GRECO bar", text, [
        totals, needed_table(loops), signed_table(loops), quantity_table(context), figure(loops)],
        summary=summary(totals.frame, loops))


def summary(totals: pd.DataFrame, loops: pd.DataFrame) -> str:
    """What was asked and what came out."""
    found = [f"{row['meshes']} {row['median']:.0f} ({row['largest']:.0f})" if np.isfinite(row["median"]) else
             f"{row['meshes']} never" for _, row in totals.iterrows()]
    count = len(loops) // loops["way"].nunique()
    return ("How many nodes do the displacements at A-E need to stay within .05 % (Coulomb friction 1)? Median of "
            f"{count} loops from different starting meshes (largest): {', '.join(found)}. Goal: meshes follow the "
            "dual-weighted residuals of the five displacements; corrected: the same, with the signed estimate added.")


def needed(nodes: np.ndarray, errors: np.ndarray, tolerance: float = TOLERANCE) -> float:
    """Nodes from which on errors stay below the tolerance; NaN if the last one does not."""
    above = np.flatnonzero(errors > tolerance)
    first = 0 if not len(above) else above[-1] + 1
    return float(nodes[first]) if first < len(nodes) else float("nan")


def needed_table(loops: pd.DataFrame) -> common.Table:
    """Nodes needed, loop by loop."""
    rows = []
    for (size, growth), group in loops.groupby(["size", "growth"], sort=False):
        row = {"start": 1e3 * size, "growth": growth, "first mesh": int(group["nodes"].iloc[0][0])}
        for _, loop in group.iterrows():
            row[loop["way"]] = needed(loop["nodes"], loop["errors"])
            if loop["way"] == "goal":
                row["goal, corrected"] = needed(loop["nodes"], loop["corrected"])
        rows.append(row)
    note = ("corrected: the same meshes, with the signed estimates added to the displacements. Of the bisected loops "
            "the growth is that of theta = .3 and .5.")
    return common.Table("goal_greco_needed", pd.DataFrame(rows), "Nodes to .05 % at A-E, by starting mesh", note,
                        {"start": "mm"}, {"start": ".0f", "growth": ".1f"})


def summary_table(loops: pd.DataFrame) -> common.Table:
    """Median and largest number of nodes, and the error over nodes."""
    rows = []
    for way, group in loops.groupby("way", sort=False):
        for column, name in (("errors", way), ("corrected", f"{way}, corrected")):
            if column == "corrected" and way != "goal":
                continue
            counts = np.array([needed(a, b) for a, b in zip(group["nodes"], group[column], strict=True)])
            counts = np.where(np.isnan(counts), np.inf, counts)
            scaled = np.concatenate([n[n > 150] * e[n > 150] for n, e in zip(group["nodes"], group[column],
                                                                             strict=True)])
            rows.append({"meshes": name, "median": float(np.median(counts)), "smallest": counts.min(),
                         "largest": counts.max(), "error times nodes": float(np.exp(np.log(scaled).mean()))})
    note = ("error times nodes: largest error at A-E (a number, not %) times nodes, geometric mean over all meshes "
            "with more than 150 nodes. inf: not within the nodes of the loop.")
    return common.Table("goal_greco_summary", pd.DataFrame(rows), "Nodes to .05 % at A-E, all starting meshes", note,
                        {}, {"median": ".0f", "smallest": ".0f", "largest": ".0f", "error times nodes": ".3f"})


def signed_table(loops: pd.DataFrame) -> common.Table:
    """The signed estimate against the error, in the first loop by goals."""
    loop = loops[loops["way"] == "goal"].iloc[-1]
    exact = points()[1]
    found, wanted = loop["estimates"] / exact[:, None], loop["differences"] / exact[:, None]
    frame = pd.DataFrame({"nodes": loop["nodes"], "largest error": 100 * loop["errors"],
                          "corrected": 100 * loop["corrected"]})
    for k in (0, 4):
        name = "AE"[k > 0]
        frame[f"error at {name}"], frame[f"estimate at {name}"] = 100 * wanted[k], 100 * found[k]
    note = (f"The loop by goals from {1e3 * loop['size']:.0f} mm with growth {loop['growth']:g}; errors and estimates "
            "are exact minus discrete, over the converged value; largest error: of all five points, corrected: with "
            "the estimates added.")
    columns = list(frame)[1:]
    return common.Table("goal_greco_signed", frame, "Signed estimates and errors at A and E", note,
                        dict.fromkeys(columns, "%"), dict.fromkeys(columns, ".4f"))


def quantity_table(context: common.Context) -> common.Table:
    """Effectivity of the signed estimate for other quantities."""
    wanted = tuple(QUANTITIES)[:2 if context.quick else None]
    rows = context.study(effectivity, {"quantity": wanted, "levels": (2, 3) if context.quick else (2, 3, 4)})
    exact = context.study(reference, {"quantity": wanted}, max_nodes=3000 if context.quick else 20_000)
    exact = (exact["value"] + exact["signed"]).set_axis(exact["quantity"])
    parts = []
    for name, group in rows.groupby("quantity", sort=False):
        error = exact[name] - group["value"]
        unit, factor = QUANTITIES[name]
        parts.append(pd.DataFrame({
            "quantity": f"{name} [{unit}]", "nodes": group["nodes"], "value": factor * group["value"],
            "error": factor * error, "estimate": factor * group["signed"], "effectivity": group["signed"] / error,
            "sum of marks / error": group["absolute"] / error.abs(), "GMRES steps": group["iterations"]}))
    frame = pd.concat(parts, ignore_index=True)
    note = ("Value, error (against the value, with its estimate added, at the end of an adaptive loop for this "
            "quantity) and signed estimate in the unit of the quantity. Effectivity: estimate over error, here "
            f"{span(frame['effectivity'], '.2f')}; below 1 where solutions are singular, which the quadratic functions "
            "of the estimate cannot follow. GMRES steps: with one multigrid cycle each, to a residual of 1e-4, for the "
            "dual problem; 0: solved directly. Solutions to an estimated error of 1e-8.")
    return common.Table("goal_greco_quantities", frame, "Signed estimates of other quantities", note, {},
                        {"value": ".6g", "error": "+.2g", "estimate": "+.2g", "effectivity": ".2f",
                         "sum of marks / error": ".1f"})


@styled
def figure(loops: pd.DataFrame) -> common.Figure:
    """Largest error at A-E against nodes, all loops."""
    canvas, ax = plt.subplots(figsize=(6.4, 4.6))
    for k, (way, group) in enumerate(loops.groupby("way", sort=False)):
        for j, (_, loop) in enumerate(group.iterrows()):
            ax.loglog(loop["nodes"], 100 * loop["errors"], color=CYCLE[k], alpha=0.6, marker=".",
                      label=way if j == 0 else None)
    ax.axhline(100 * TOLERANCE, color=GREY, linewidth=0.8)
    ax.set(xlabel="nodes", ylabel="largest error at A-E [%]")
    ax.grid(True)
    common.plain_ticks(ax.xaxis, ax.yaxis)
    ax.legend()
    return common.Figure("goal_greco_errors", canvas, "GRECO bar: largest error at A-E on the meshes of all loops.")


if __name__ == "__main__":
    common.main(run, __doc__.split("\n")[0] + " Example: python studies/goal_greco.py --quick --out /tmp/goal_greco")
