"""The bolted junction in three dimensions: a sector with real bolts. Part of ``bolted_junction.py``, not when quick.

Eight bolts of the same section as the ring's sixteen; the sector of 90 degrees between two planes of symmetry holds
two. The bolts are tightened first, then the pressure rises.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import common
import numpy as np
import pandas as pd
from bolted_grids import MM, nodes_of
from common import Figure, Table
from matplotlib import pyplot as plt

import adaptmg as am
from adaptmg.cases import Flanges, bolt_force, joint_opening, junction_path
from adaptmg.plot.style import BLUE, GREY, ORANGE, styled

MPA, MN = 1e6, 1e6
#: edge lengths, m: coarsest first, each mesh independent of the others
SIZES = (20 * MM, 13 * MM, 8.5 * MM)
PRESSURES = (2 * MPA, 4 * MPA, 6 * MPA, 8 * MPA)
#: coarsest and finest grid of the hierarchies on which multigrid runs
CHAINS = ((0, 1), (0, 2))


@lru_cache(maxsize=2)
def meshes() -> am.Hierarchy:
    """All grids of the sector."""
    return am.Hierarchy.graded(am.cases.bolted_junction(dim=3), SIZES)


@lru_cache(maxsize=8)
def grids(first: int, last: int) -> am.Hierarchy:
    """Those from ``first`` to ``last``."""
    return am.Hierarchy.from_meshes(meshes().problem, [level.mesh for level in meshes().levels[first:last + 1]])


@lru_cache(maxsize=4)
def history(number: int) -> am.PathResult:
    """Tightened, then one result a pressure, on one grid with those below it."""
    solver = am.FullMultigrid(rtol=1e-7) if number else am.ActiveSet()
    return am.solve_path(grids(0, number), junction_path(meshes().problem, PRESSURES), solver)


def on_grid(number: int) -> dict[str, Any]:
    """What the sector does on one grid."""
    path = history(number)
    return {"nodes": grids(number, number).finest.n_nodes, "contact_nodes": len(path[0].contact),
            "force": bolt_force(path[0]), "opening": joint_opening(path[2]), "steps": path[2].cycles,
            **{f"force at {p / MPA:g}": bolt_force(r) for p, r in zip(PRESSURES, path[1:], strict=True)}}


def cost(first: int, last: int, rtol: float) -> dict[str, Any]:
    """Full multigrid against the active set method on the finest grid, tightened and under pressure in one step."""
    chain = grids(first, last)
    reference = am.solve(chain.finest.discrete, am.ActiveSet(rtol=1e-11))
    result = am.solve(chain, am.FullMultigrid(rtol=rtol), throw=False)
    tight = am.solve(chain, am.FullMultigrid(rtol=1e-10), throw=False)
    return {"grids": nodes_of(chain), "start_work": result.start_work_units, "cycles": result.cycles,
            "work": result.work_units, "rate": result.rate, "run_seconds": result.seconds, "method": result.method,
            "active_seconds": reference.seconds, "residual": result.residual, "outcome": result.status.name,
            "difference": common.energy_error(tight, reference, chain)}


def items(context: common.Context, ring: pd.DataFrame) -> list[Table | Figure]:
    """Tables and figures; ``ring`` has the steps of the axisymmetric path, see :func:`bolted_pressure.read_off`."""
    rows = context.study(on_grid, {"number": tuple(range(len(SIZES)))})
    costs = pd.concat([context.study(cost, {"first": (first,), "last": (last,)}, rtol=1e-8)
                       for first, last in CHAINS], ignore_index=True)
    last = len(SIZES) - 1
    return [grid_table(rows, ring), cost_table(costs), force_figure(rows, ring), *pictures(history(last))]


def grid_table(rows: pd.DataFrame, ring: pd.DataFrame) -> Table:
    """The sector on its grids compared with the ring."""
    at = {p: ring.loc[np.isclose(ring["pressure"], p)].iloc[0] for p in (0.0, 4 * MPA, 8 * MPA)}
    shown = pd.DataFrame({"model": [f"sector, {1e3 * SIZES[k]:g} mm" for k in rows["number"]] + ["ring, axisymmetric"],
                          "nodes": [*rows["nodes"], np.nan], "bolt force": [*(rows["force"] / MN),
                                                                            at[0.0]["bolts"] / MN],
                          "at 4 MPa": [*(rows["force at 4"] / MN), at[4 * MPA]["bolts"] / MN],
                          "at 8 MPa": [*(rows["force at 8"] / MN), at[8 * MPA]["bolts"] / MN],
                          "opening at 4 MPa": [*(1e6 * rows["opening"]), 1e6 * at[4 * MPA]["opening"]]})
    note = ("Force of all bolts without pressure, at 4 and at 8 MPa; mean opening at the bore; the ring on the grids "
            "of the table above. P1 tetrahedra as large as the wall are too stiff in bending, and shortened bolts "
            f"carry more on coarse meshes: from {1e3 * SIZES[0]:g} to {1e3 * SIZES[-1]:g} mm the force falls by "
            f"{1 - rows['force'].iloc[-1] / rows['force'].iloc[0]:.0%}, the opening at 4 MPa grows by "
            f"{rows['opening'].iloc[-1] / rows['opening'].iloc[0] - 1:.0%}. "
            "The eight bolts stand 188 mm apart, so that the joint opens between them first; the ring, "
            "which presses evenly, does not know that.")
    return Table("bolted_sector", shown, "The sector with real bolts compared with the ring", note,
                 {"bolt force": "MN", "at 4 MPa": "MN", "at 8 MPa": "MN", "opening at 4 MPa": "µm"},
                 {"nodes": ".0f", "bolt force": ".3f", "at 4 MPa": ".3f", "at 8 MPa": ".3f",
                  "opening at 4 MPa": ".2f"})


def cost_table(costs: pd.DataFrame) -> Table:
    """What multigrid costs in 3D."""
    taken = costs["method"].map(lambda name: name.partition(", then ")[2].partition("(")[0] or "-")
    shown = costs.assign(method=taken)[["grids", "start_work", "cycles", "work", "rate", "run_seconds",
                                        "active_seconds", "difference", "residual", "method", "outcome"]].rename(
        columns={"start_work": "start work", "run_seconds": "seconds", "active_seconds": "active set",
                 "method": "taken over by", "residual": "natural residual", "outcome": "status"})
    note = ("Full multigrid to an estimated error of 1e-8; difference: to the active set method, relative A-norm, with "
            "1e-10. Tightened and under 4 MPa in one step. Seconds of the active set method: finest grid alone, direct "
            "factorisation.")
    return Table("bolted_sector_cost", shown, "Multigrid on the sector, friction .2", note,
                 {"start work": "WU", "work": "WU", "seconds": "s", "active set": "s"},
                 {"start work": ".1f", "work": ".1f", "rate": ".2f", "seconds": ".1f", "active set": ".1f",
                  "difference": ".1e", "natural residual": ".1e"})


@styled
def force_figure(rows: pd.DataFrame, ring: pd.DataFrame) -> Figure:
    """Bolt force over that without pressure, sector and ring."""
    figure, ax = plt.subplots(figsize=(6.4, 4.2))
    last = rows.iloc[-1]
    p = np.array([0.0, *PRESSURES]) / MPA
    forces = np.array([last["force"], *(last[f"force at {value:g}"] for value in p[1:])])
    inside = ring[ring["pressure"] <= PRESSURES[-1] * 1.001]
    ax.plot(inside["pressure"] / MPA, 100 * (inside["bolts"] / inside["bolts"].iloc[0] - 1), "o-", color=BLUE,
            label="axisymmetric, equivalent ring")
    ax.plot(p, 100 * (forces / forces[0] - 1), "s-", color=ORANGE, label=f"sector with bolts, {last['nodes']} nodes")
    share = Flanges().thrust(1.0) * MPA * p / MN / 2.5
    ax.plot(p, 100 * share, color=GREY, linestyle=(0, (4, 3)), label="all of the thrust")
    ax.set_ylim(min(-5.0, 100 * (forces / forces[0] - 1).min()), 25.0)
    ax.set_xlabel("internal pressure [MPa]")
    ax.set_ylabel("change of the bolt force [%]")
    ax.grid(True)
    ax.legend(loc="upper left")
    ax.set_title("Bolted junction: what the bolts feel of the pressure")
    return Figure("bolted_sector_forces", figure, "Change of the bolt force under pressure, with real bolts and with "
                  "the equivalent ring.")


def pictures(path: am.PathResult) -> list[Figure]:
    """The deformed sector, its stress, and the joint."""
    half, full = path[2], path[4]
    return [
        Figure("bolted_sector_deformed",
               am.plot.deformation(full, 100, bodies=("upper", "lower"), view=(20, 225)),
               "The sector at 8 MPa seen from inside the vessel, displacement amplified 100 times: the joint opens at "
               "the bore, most between the bolts."),
        Figure("bolted_sector_stress", am.plot.deformation(full, 100, stress=True, view=(24, 45)),
               "Von Mises stress of the sector at 8 MPa, seen from outside."),
        Figure("bolted_sector_joint", am.plot.contact(half, boundary="upper.joint"),
               "The joint of the sector at 4 MPa, seen along the axis: the flanges are pressed together around the "
               "bolt holes and part between the bolts."),
    ]
