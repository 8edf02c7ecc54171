"""Tables, figure and summary of ``benchmark.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import common
import numpy as np
import pandas as pd
from common import Table
from matplotlib import pyplot as plt
from paper_runs import span

from adaptmg.plot.style import CYCLE, GREY, styled

#: smallest meshes whose seconds and work enter a fit
LARGE = 10_000
#: stored results and how they are printed: column, unit, format
_WORK = {
    "family": ("meshes", "", ""), "nodes": ("nodes", "", ""), "levels": ("levels", "", ""),
    "cycles": ("cycles", "", ""), "rate": ("rate", "", ".2f"), "work": ("work", "WU", ".1f"),
    "full_passes": ("full passes", "WU", ".1f"), "start_work": ("start work", "WU", ".2f"),
    "start_error": ("error after start", "", ".1e"), "bytes_per_dof": ("memory", "B/dof", ".0f")}
_SECONDS = {
    "family": ("meshes", "", ""), "nodes": ("nodes", "", ""), "mesh_s": ("meshing", "s", ".3g"),
    "assembly_s": ("assembly", "s", ".3g"), "transfer_s": ("transfers", "s", ".3g"),
    "setup_s": ("set-up", "s", ".3g"), "solve_s": ("solve", "s", ".3g"),
    "pyamg_iterations": ("SA-CG iterations", "", ".0f"), "pyamg_setup_s": ("SA-CG set-up", "s", ".3g"),
    "pyamg_solve_s": ("SA-CG solve", "s", ".3g"), "over_pyamg": ("over SA-CG", "", ".3f"),
    "with_setup_over_pyamg": ("with our set-up", "", ".3f"), "best_setting": ("best SA-CG", "", ""),
    "over_best_pyamg": ("over the best", "", ".3f"), "over_pyamg_mgcg": ("over MG-CG, pyamg's sweeps", "", ".3f"),
    "over_mgcg": ("over MG-CG, our sweeps", "", ".2f"), "over_cholesky": ("over Cholesky", "", ".3f")}
_FRICTION = {"family": ("meshes", "", ""), "nodes": ("nodes", "", ""), "friction": ("friction", "", "g"),
             "cycles": ("cycles", "", ""), "rate": ("rate", "", ".2f"), "work": ("work", "WU", ".1f")}
_METHODS = {"nodes": ("nodes", "", ""), "method": ("method", "", ""), "cycles": ("cycles", "", ".0f"),
            "work": ("work", "WU", ".1f"), "s": ("seconds", "s", ".3g"),
            "residual": ("natural residual", "", ".1e"), "outcome": ("status", "", "")}


def printed(name: str, rows: pd.DataFrame, shown: Mapping[str, tuple[str, str, str]], caption: str, note: str = ""
            ) -> Table:
    """The columns of ``shown`` that are there and not empty, with their printed names, units and formats."""
    there = {key: value for key, value in shown.items() if key in rows and rows[key].notna().any()}
    frame = rows[list(there)].rename(columns={key: title for key, (title, _, _) in there.items()})
    return Table(name, frame.reset_index(drop=True), caption, note,
                 {title: unit for title, unit, _ in there.values() if unit},
                 {title: spec for title, _, spec in there.values() if spec})


def work_table(rows: pd.DataFrame) -> Table:
    """Cycles, work and memory."""
    note = ("Work: passes by nonzeros touched over those of the finest matrix (a sweep that reads one triangle is "
            "half a pass); full passes: every sweep and residual as a whole pass. Rate: of the last cycles. Memory: of "
            "the solver's arrays.")
    return printed("benchmark_work", rows, _WORK, "GRECO bar (2D) and block (3D), friction 1: default solver, work to "
                   "a true energy error of 1e-8, nested start included", note)


def seconds_table(rows: pd.DataFrame) -> Table:
    """Seconds, and those of linear solvers."""
    note = ("One thread, medians in turns. Solve: nested start and cycles. Ratios: our solve over a rival's seconds "
            "for the linear problem with all contact nodes fixed, to the same true error. SA-CG: pyamg's smoothed "
            "aggregation, set-up and solve, with its defaults and with the best of some settings; with our set-up: our "
            "transfers and set-up too. MG-CG: conjugate gradients with geometric multigrid on our levels, solve alone. "
            "Cholesky: factorisation and solve.")
    return printed("benchmark_seconds", rows, _SECONDS, "The same, in seconds, compared with linear solvers", note)


def exponent(nodes: Sequence[float], values: Sequence[float]) -> tuple[float, float]:
    """Exponent of values ~ nodes^e with its standard error; NaN with fewer than three."""
    if len(nodes) < 3:
        return np.nan, np.nan
    x, y = np.log(np.asarray(nodes, float)), np.log(np.asarray(values, float))
    slope, offset = np.polyfit(x, y, 1)
    spread = np.sum((y - slope * x - offset) ** 2) / (len(x) - 2) / np.sum((x - x.mean()) ** 2)
    return float(slope), float(np.sqrt(spread))


def scaling_table(rows: pd.DataFrame) -> list[Table]:
    """How work and seconds grow with the nodes, where there are three meshes that are large enough."""
    found = []
    for family, part in rows[rows["nodes"] >= LARGE].groupby("family", sort=False):
        # work units are passes over the matrix: their product with the nodes is the work
        for name, total in (("work", part["work"] * part["nodes"]), ("seconds of the solve", part["solve_s"])):
            slope, error = exponent(part["nodes"], total)
            found.append({"meshes": family, "sizes": len(part), "quantity": name, "exponent": slope,
                          "standard error": error})
    frame = pd.DataFrame(found, columns=["meshes", "sizes", "quantity", "exponent", "standard error"])
    frame = frame.dropna(subset="exponent")
    if frame.empty:
        return []
    return [Table("benchmark_scaling", frame, "Exponents e of quantity ~ nodes^e", "Fitted to all meshes of "
                  f"{LARGE} nodes and more, three of them at least; 1 is optimal.",
                  formats={"exponent": ".3f", "standard error": ".3f"})]


def friction_table(rows: pd.DataFrame) -> Table:
    """Cycles against friction."""
    return printed("benchmark_friction", rows, _FRICTION, "Friction coefficients: cycles and work to a true energy "
                   "error of 1e-8")


def methods_table(rows: pd.DataFrame) -> Table:
    """All methods for contact."""
    return printed("benchmark_methods", rows, _METHODS, "Methods for the contact problem (GRECO bar, nested grids, "
                   "friction 1), each to its own estimated error of 1e-8", "Seconds: the better of two runs. Cycles: "
                   "of active set methods their steps, of single grids their sweeps. Factorisations are in the "
                   "seconds, not in the work.")


def summary(rows: pd.DataFrame) -> str:
    """What was asked and what came out."""
    large = rows[rows["nodes"] == rows.groupby("family")["nodes"].transform("max")]
    parts = [f"{row['family']} ({row['nodes']} nodes) {row['over_pyamg']:.2g}" for _, row in large.iterrows()]
    return ("What does contact with friction cost compared with one linear solve on the same mesh, both to a true "
            f"energy error of 1e-8? The default solver takes {span(rows['cycles'], 'd')} cycles and "
            f"{span(rows['work'], '.0f')} passes over the matrix on all meshes. Its seconds over those of "
            "pyamg's smoothed aggregation (defaults) "
            f"with contact nodes fixed, on the largest meshes: {', '.join(parts)}.")


@styled
def figure(rows: pd.DataFrame) -> common.Figure:
    """Work and seconds against nodes."""
    canvas, (left, right) = plt.subplots(1, 2, figsize=(9.6, 3.8))
    for k, (family, part) in enumerate(rows.groupby("family", sort=False)):
        style = {"marker": "osv^"[k % 4], "color": CYCLE[k]}
        left.semilogx(part["nodes"], part["work"], label=family, **style)
        right.loglog(part["nodes"], part["solve_s"], label=family, **style)
        right.loglog(part["nodes"], part["pyamg_setup_s"] + part["pyamg_solve_s"], linestyle="--", color=GREY,
                     marker=style["marker"], markerfacecolor="none",
                     label="pyamg SA-CG, contact nodes fixed" * (k == 0))
    left.set(xlabel="nodes", ylabel="work units to a true error of 1e-8", ylim=(0, 1.1 * rows["work"].max()))
    right.set(xlabel="nodes", ylabel="seconds [s]")
    for ax in (left, right):
        ax.grid(True)
        common.plain_ticks(ax.xaxis)
    common.plain_ticks(right.yaxis)
    handles, labels = right.get_legend_handles_labels()
    kept = [k for k, label in enumerate(labels) if label]
    canvas.legend([handles[k] for k in kept], [labels[k] for k in kept], loc="outside lower center", ncols=3)
    return common.Figure("benchmark", canvas, "Work units of the contact problem, and its seconds (nested start and "
                         "cycles) compared with those of pyamg, set-up and solve, for one linear solve on the same "
                         "mesh (grey, same marker).")
