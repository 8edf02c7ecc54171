"""The upset block: what graded meshes gain where the solution is singular. Part of ``adaptive_vs_uniform.py``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import common
import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from mesh_families import RTOL, SIDE, costs, grids_of, study_families

import adaptmg as am
from adaptmg.mesh import bisect, structured
from adaptmg.plot.style import CYCLE, styled

UPSET: Mapping[str, tuple[int, ...]] = {
    "uniform": (8, 16, 32, 64, 128), "Netgen, contact 8x finer": (1, 2, 3, 4, 5), "Netgen, to the corner": (1, 2, 3, 4)}
QUICK_UPSET: Mapping[str, tuple[int, ...]] = {
    "uniform": (8, 16, 32), "Netgen, contact 8x finer": (1, 2, 3), "Netgen, to the corner": (1, 2, 3)}


def energy(hierarchy: am.Hierarchy, result: am.Result) -> float:
    """1/2 u'Au - b'u, J/m."""
    discrete, u = hierarchy.finest.discrete, result.displacement.reshape(-1)
    return float(u @ (0.5 * (discrete.matrix @ u) - discrete.load))


def upset(family: str, fineness: int, rtol: float) -> dict[str, Any]:
    """The upset block on one mesh: its energy, and the cost."""
    common.warm_up()
    hierarchy = grids_of(am.cases.upset_block(), family, fineness)
    result = common.quickest(hierarchy, am.FullMultigrid(correction=am.Monotone(), rtol=rtol))
    return {"energy": energy(hierarchy, result), "stick": bool((result.contact.state == am.STICK).all()),
            **costs(hierarchy, result)}


def upset_reference(divisions: int) -> dict[str, Any]:
    """The energy on a structured mesh bisected towards the foot to h ~ sqrt(r), by the active set method."""
    problem = am.cases.upset_block()
    mesh, size = structured(problem.domain, divisions), SIDE / divisions
    while True:
        centre = mesh.points[mesh.elements].mean(axis=1)
        r = np.maximum(np.hypot(*centre.T) / SIDE, (size / SIDE)**2)
        large = np.sqrt(2 * mesh.volumes) > 1.2 * size * np.sqrt(r)
        if not large.any():
            break
        mesh = bisect(mesh, large)[0]
    hierarchy = am.Hierarchy.from_meshes(problem, [mesh])
    result = am.solve(hierarchy, am.ActiveSet(rtol=1e-10))
    return {"nodes": mesh.n_nodes, "energy": energy(hierarchy, result), "residual": result.residual,
            "outcome": result.status.name}


def upset_items(context: common.Context) -> list[common.Table | common.Figure]:
    """Tables and figure of the upset block."""
    rows = study_families(context, upset, QUICK_UPSET if context.quick else UPSET)
    reference = context.study(upset_reference, {"divisions": (32, 64) if context.quick else (64, 128)})
    coarse, fine = reference.iloc[0], reference.iloc[1]
    # on meshes graded like sqrt(r) the energy converges like 1 / nodes
    exact = fine["energy"] + (fine["energy"] - coarse["energy"]) / (fine["nodes"] / coarse["nodes"] - 1)
    rows["energy_error"] = np.sqrt((rows["energy"] - exact) / abs(exact))
    return [upset_table(rows, exact, fine), rate_table(rows), upset_figure(rows)]


def upset_table(upsets: pd.DataFrame, exact: float, fine: pd.Series) -> common.Table:
    """Energy errors of the upset block."""
    frame = pd.DataFrame({
        "grid": upsets["family"], "nodes": upsets["nodes"], "contact nodes": upsets["contact_nodes"],
        "energy": upsets["energy"], "energy error": 100 * upsets["energy_error"], "h ratio": upsets["mesh_ratio"],
        "cycles": upsets["cycles"], "rate": upsets["rate"], "WU": upsets["work_units"], "total": upsets["total_s"],
        "residual": upsets["residual"], "status": upsets["outcome"]})
    sticks = "All contact nodes stick" if upsets["stick"].all() else "Not all contact nodes stick"
    note = (f"Energy error: sqrt((E_h - E) / |E|), E = {exact:.6f} J/m, extrapolated from two meshes bisected towards "
            f"the foot, h ~ sqrt(r) ({fine['nodes']} nodes: {fine['energy']:.6f}). {sticks} on every mesh; where all "
            "do, the problem is linear and this is the relative error in the energy norm, otherwise an estimate of "
            "it.")
    return common.Table("adaptive_upset", frame, f"Upset block, friction .5: energy error (rtol {RTOL:g})", note,
                        {"energy": "J/m", "energy error": "%", "total": "s"},
                        {"energy": ".6f", "energy error": ".3f", "h ratio": ".2f", "rate": ".2f", "WU": ".0f",
                         "total": ".2f", "residual": ".1e"})


def rate_table(upsets: pd.DataFrame) -> common.Table:
    """Fitted exponents beside the theory."""
    theory = {"uniform": -am.cases.upset_block().reference["uniform_rate"], "Netgen, to the corner": -0.5}
    rows = []
    for name, group in upsets.groupby("family", sort=False):
        last = group.iloc[-3:]
        rows.append({"grid": name, "fitted, all": common.slope(group["nodes"], group["energy_error"]),
                     "fitted, last 3": common.slope(last["nodes"], last["energy_error"]),
                     "theory": theory.get(name, theory["uniform"]), "nodes": int(last["nodes"].iloc[-1]),
                     "energy error": 100 * last["energy_error"].iloc[-1]})
    frame = pd.DataFrame(rows)
    uniform, line, corner = (row for _, row in frame.iterrows())
    note = ("Exponent of the energy error over nodes. Theory for u ~ r^.781: uniform N^-.39; a fixed ratio at contact "
            "has the same exponent in the end and only a better constant; h ~ sqrt(r) restores N^-.5. Measured over "
            f"the last three meshes: {uniform['fitted, last 3']:.2f} uniform, {line['fitted, last 3']:.2f} with a "
            f"fixed ratio, {corner['fitted, last 3']:.2f} towards the corner.")
    return common.Table("adaptive_upset_rates", frame, "Upset block: convergence rates", note, {"energy error": "%"},
                        {"fitted, all": ".3f", "fitted, last 3": ".3f", "theory": ".3f", "energy error": ".3f"})


@styled
def upset_figure(upsets: pd.DataFrame) -> common.Figure:
    """Energy error against nodes."""
    figure, ax = plt.subplots(figsize=(6.0, 4.4))
    for k, (name, rows) in enumerate(upsets.groupby("family", sort=False)):
        rate = common.slope(rows["nodes"].iloc[-3:], rows["energy_error"].iloc[-3:])
        ax.loglog(rows["nodes"], 100 * rows["energy_error"], marker="os^"[k], color=CYCLE[k],
                  label=f"{name}: $N^{{{rate:.2f}}}$")
    ax.set_xlabel("nodes N")
    ax.set_ylabel("energy error [%]")
    ax.grid(True)
    common.plain_ticks(ax.yaxis)
    ax.legend(title="rate over the last three")
    return common.Figure("adaptive_upset_energy", figure, "Upset block: relative energy error against nodes")
