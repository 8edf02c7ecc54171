"""The dovetail against friction, clearance and angle, compared with one body, and compared with the active set method.

Part of ``dovetail.py``.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import common
import dovetail_pictures
import numpy as np
import pandas as pd
from common import Context, Figure, Table
from paper_runs import listed, repeats, span, table

import adaptmg as am

#: sizes fall by this from level to level in the sweeps
STEP = 1.6
FRICTIONS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
CLEARANCES = (0.0, 10e-6, 20e-6, 50e-6)
ANGLES = (45.0, 50.0, 60.0, 70.0)
#: ratio of sizes and number of levels of the grids on which two bodies are compared with one
FAMILIES = ((1.4, 6), (1.6, 5), (2.0, 4), (2.4, 3))
RTOL = 1e-8
#: tolerance at which two methods are compared
TIGHT = 1e-10
TOP = (0.0, 24e-3)


def sizes(finest: float, step: float, levels: int) -> tuple[float, ...]:
    """Coarse to fine, m."""
    return tuple(finest * step**k for k in reversed(range(levels)))


@lru_cache(maxsize=4)
def meshed(clearance: float, angle: float, finest: float, step: float, levels: int) -> am.Hierarchy:
    """Graded grids of a joint, 4 times finer at contact."""
    problem = am.cases.dovetail(clearance=clearance, angle=angle)
    return am.Hierarchy.graded(problem, sizes(finest, step, levels), contact_ratio=4)


@lru_cache(maxsize=4)
def grids_of(friction: float, clearance: float, angle: float, finest: float, step: float, levels: int) -> am.Hierarchy:
    """The same grids for every friction."""
    problem = am.cases.dovetail(law=am.Coulomb(friction), clearance=clearance, angle=angle)
    return meshed(clearance, angle, finest, step, levels).with_problem(problem)


def joint(friction: float, clearance: float, angle: float, finest: float, levels: int, rtol: float) -> dict[str, Any]:
    """One joint in the default mode: lift, zones on the flank, cost, and the difference to the active set method."""
    grids = grids_of(friction, clearance, angle, finest, STEP, levels)
    tight = am.solve(grids, am.FullMultigrid(rtol=TIGHT), throw=False)
    result = am.solve(grids, am.FullMultigrid(rtol=rtol), throw=False)
    other = am.solve(grids.finest.discrete, am.ActiveSet(rtol=1e-12), throw=False)
    slave, master = (result.resultant(name).force for name in ("tongue.flank", "block.flank"))
    pull = 100e6 * 12e-3
    return {"nodes": grids.finest.n_nodes, "lift": float(result.probe([TOP])[0, 1]), **zones(result),
            "cycles": result.cycles, "work": result.work_units, "start_work": result.start_work_units,
            "rate": result.rate, "run_seconds": result.seconds, "residual": result.residual,
            "outcome": result.status.name, "other_outcome": other.status.name,
            "true_error": common.energy_error(result, other, grids), "tight_outcome": tight.status.name,
            "difference": common.energy_error(tight, other, grids),
            "states_differ": int((tight.contact.state != other.contact.state).sum()),
            "force_error": abs(float(result.resultant("contact").force[1]) / pull + 1),
            "balance": float(np.abs(slave + master).max() / pull)}


def zones(result: am.Result) -> dict[str, float]:
    """Ends of the zones on the flank, depth below the mouth in m: half-way between nodes; NaN without such a zone."""
    c = result.contact
    mine = c.boundary == c.names.index("tongue.flank")
    order = np.argsort(-c.x[mine, 1])
    depth, state = -c.x[mine, 1][order], c.state[mine][order]
    middle = np.r_[0.0, 0.5 * (depth[1:] + depth[:-1]), depth[-1]]
    stick, closed = np.flatnonzero(state == am.STICK), np.flatnonzero(state != am.OPEN)
    return {"open_to": float(middle[closed[0]]) if closed.size else float("nan"), "stick_from": float(middle[stick[0]])
            if stick.size else float("nan"), "stick_to": float(middle[stick[-1] + 1]) if stick.size else float("nan")}


def beside_one_body(body: str, family: tuple[float, int], finest: float, rtol: float, times: int) -> dict[str, Any]:
    """The joint or the GRECO bar on graded grids of the same sizes, friction .2."""
    problem = am.cases.dovetail() if body == "dovetail" else am.cases.greco_bar(law=am.Coulomb(0.2))
    grids = am.Hierarchy.graded(problem, sizes(finest, *family), contact_ratio=4)
    am.solve(grids, am.FullMultigrid(rtol=rtol), throw=False)
    result = common.quickest(grids, am.FullMultigrid(rtol=rtol), times=times)
    return {"nodes": grids.finest.n_nodes, "coarsest": grids[0].n_nodes, "cycles": result.cycles,
            "work": result.work_units, "start_work": result.start_work_units, "rate": result.rate,
            "run_seconds": result.seconds, "residual": result.residual, "outcome": result.status.name,
            "mesh_ratio": max(level.mesh_ratio for level in grids.levels[1:])}


def items(context: Context) -> tuple[list[Table | Figure], pd.DataFrame]:
    """Tables and figures, and the ratios to one body."""
    fixed = {"finest": 2.4e-3 if context.quick else 0.9e-3, "levels": 3 if context.quick else 5, "rtol": RTOL}
    few = slice(None, None, 3 if context.quick else 1)
    frictions = context.study(joint, {"friction": FRICTIONS[few]}, clearance=0.0, angle=50.0, **fixed)
    both = (0.0,) if context.quick else (0.0, 0.2)
    clearances = context.study(joint, {"clearance": CLEARANCES[few], "friction": both}, angle=50.0,
                               **fixed).assign(angle=50.0)
    angles = context.study(joint, {"angle": ANGLES[2:3] if context.quick else ANGLES}, friction=0.2, clearance=0.0,
                           **fixed).assign(friction=0.2, clearance=0.0)
    ratios = ratios_of(context)
    drawn = [] if context.quick else [dovetail_pictures.friction_figure(frictions)]
    made = [friction_table(frictions), *drawn, shape_table(clearances, angles),
            agreement_table(pd.concat([frictions, clearances, angles], ignore_index=True)), ratio_table(ratios)]
    return made, ratios


_MM = {"open_to": "open to", "stick_from": "stick from", "stick_to": "stick to"}
_SHAPE = {"friction": ".2f", "open to": ".2f", "stick from": ".2f", "stick to": ".2f", "lift": ".2f"}
_UNITS = {"open to": "mm", "stick from": "mm", "stick to": "mm", "lift": "µm"}


def in_units(frame: pd.DataFrame) -> pd.DataFrame:
    """Lift in µm, zones in mm."""
    return frame.assign(lift=1e6 * frame["lift"], test=f"error {RTOL:g}",
                        **{name: 1e3 * frame[key] for key, name in _MM.items()})


def with_units(made: Table, **units: str) -> Table:
    """Units of the columns that :func:`paper_runs.table` does not know."""
    made.units = dict(made.units) | {name: unit for name, unit in (_UNITS | units).items() if name in made.frame}
    return made


def friction_table(frame: pd.DataFrame) -> Table:
    """Lift, zones and cost against friction."""
    note = (f"{span(frame['cycles'], 'd')} cycles for all coefficients. Zones along the flank from the mouth (depth 0) "
            "to its lower end (13 mm): open, slip, stick, slip; ends half-way between nodes. Nothing sticks ('-') at "
            f"{listed(frame[frame['stick_from'].isna()]['friction'], 'g')}. All loads are applied in one step; in "
            "several, friction gives another answer (see the load history).")
    columns = ["friction", "nodes", "lift", *_MM.values(), "cycles", "work", "rate", "run_seconds", "test", "residual",
               "outcome"]
    return with_units(table("dovetail_friction", in_units(frame), columns, "Dovetail: friction, full start in the "
                            "truncated mode", note, _SHAPE))


def shape_table(clearances: pd.DataFrame, angles: pd.DataFrame) -> Table:
    """Clearance and angle."""
    frame = in_units(pd.concat([clearances, angles], ignore_index=True))
    tight = clearances[clearances["clearance"] == 0].set_index("friction")["lift"]
    rise = clearances["lift"] - clearances["friction"].map(tight)
    loose = clearances["clearance"] > 0
    share = (rise / clearances["clearance"] * np.cos(np.radians(50)))[loose]
    frame["clearance"] = 1e6 * frame["clearance"]
    parts = [f"with friction {friction:g} by {span(share[clearances['friction'] == friction], '.2f')}"
             for friction in sorted(set(clearances["friction"]))]
    note = ("A clearance c lets the tongue rise by c / cos(angle) before the flank carries. Over the joint without "
            f"clearance the lift grows {listed(parts)} times that"
            + ": part of a tight flank may stick, and clearance loosens it first" * bool(clearances["friction"].any())
            + ". '-': nothing sticks.")
    columns = ["clearance", "angle", "friction", "nodes", "lift", *_MM.values(), "cycles", "work", "rate", "test",
               "residual", "outcome"]
    made = table("dovetail_shape", frame, columns, "Dovetail: clearance, and angle of the flanks from the horizontal",
                 note, _SHAPE | {"clearance": ".0f", "angle": ".0f"})
    return with_units(made, clearance="µm", angle="deg")


def agreement_table(frame: pd.DataFrame) -> Table:
    """Multigrid compared with the active set method, and equilibrium."""
    worst = pd.DataFrame([{"joints": len(frame), "converged": int((frame["outcome"] == "CONVERGED").sum()),
                           "active set converged": int((frame["other_outcome"] == "CONVERGED").sum()),
                           "true error": frame["true_error"].max(), "difference": frame["difference"].max(),
                           "states that differ": int(frame["states_differ"].sum()),
                           "force error": frame["force_error"].max(), "slave + master": frame["balance"].max()}])
    note = (f"Largest over all joints of these sweeps, relative A-norm, against the active set method to 1e-12: true "
            f"error of multigrid to an estimated error of {RTOL:g}; difference, and nodes whose states differ, of "
            f"multigrid to {TIGHT:g}. Force error: contact force over the pull, minus 1 (of the former). Slave + "
            "master: sum of the forces of the flank on both sides, over the pull.")
    nodes = span(frame["nodes"], "d")
    return Table("dovetail_agreement", worst, "Dovetail: two independent methods, and the balance of forces "
                 f"({nodes} nodes)", note,
                 formats={"true error": ".1e", "difference": ".1e", "force error": ".1e", "slave + master": ".1e"})


def ratios_of(context: Context) -> pd.DataFrame:
    """Two bodies compared with one."""
    families = ((1.6, 3),) if context.quick else FAMILIES
    parts = [context.study(beside_one_body, {"family": families, "body": ("GRECO bar", "dovetail")}, finest=finest,
                           rtol=RTOL, times=repeats(context))
             .assign(finest=finest) for finest in ((2e-3,) if context.quick else (1e-3, 0.5e-3))]
    frame = pd.concat(parts, ignore_index=True)
    frame["step"], frame["levels"] = zip(*frame["family"], strict=True)
    keys = list(zip(frame["finest"], frame["step"], strict=True))
    one = frame[frame["body"] == "GRECO bar"].set_index(["finest", "step"])["work"]
    frame["ratio"] = np.where(frame["body"] == "dovetail", frame["work"] / one.loc[keys].to_numpy(), np.nan)
    return frame


def ratio_table(frame: pd.DataFrame) -> Table:
    """The cost of the second body."""
    two = frame[frame["body"] == "dovetail"]
    within, beyond = two[two["ratio"] <= 2], two[two["ratio"] > 2]
    counted = (f"In {len(within)} of {len(two)} cases two bodies take at most twice the work units of one"
               if len(two) > 1 else f"Two bodies take {two['ratio'].iloc[0]:.2f} times the work units of one")
    note = f"Friction .2, sizes four times finer at contact, full start to an estimated error of {RTOL:g}. {counted}"
    if len(beyond) and len(two) > 1:
        note += f", in the others {span(beyond['ratio'], '.2f')} times"
    note += ". h ratio: largest local ratio of mesh sizes between two levels."
    if two["step"].nunique() > 1:
        small, large = (two[two["step"] == step]["cycles"] for step in (two["step"].min(), two["step"].max()))
        note += (f" Where sizes fall by {two['step'].max():g} instead of {two['step'].min():g} from level to level, "
                 f"the dovetail takes {span(large, 'd')} cycles instead of {span(small, 'd')}: only the edge of the "
                 "block at the mouth gives way, and coarse meshes know it less well.")
    frame = frame.assign(test=f"error {RTOL:g}", **{
        "sizes fall by": frame["step"], "h ratio": frame["mesh_ratio"], "finest size": 1e3 * frame["finest"],
        "over one body": frame["ratio"]})
    made = table("dovetail_one_body", frame, ["body", "finest size", "sizes fall by", "levels", "coarsest", "nodes",
                                              "h ratio", "cycles", "start_work", "work", "over one body", "rate",
                                              "run_seconds", "test", "residual", "outcome"],
                 "Two bodies compared with one (GRECO bar) on grids of equal sizes and grading", note,
                 {"finest size": ".2f", "sizes fall by": ".1f", "h ratio": ".2f", "over one body": ".2f"})
    made.units = dict(made.units) | {"finest size": "mm"}
    return made
