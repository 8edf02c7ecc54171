"""The bolted junction of vessels, Example 3 of the paper: its Tables 1 to 3, sweeps, pressure until it leaks, 3D.

    python studies/bolted_junction.py [--quick | --full] [--out DIR]

Dimensions and loads are ours (:func:`adaptmg.cases.bolted_junction`); the paper shows one picture of Example 3 and
reports the rest in a talk. Independent meshes throughout. Loads up to the leak are in :mod:`bolted_pressure`, the
sector with real bolts, which a quick run leaves out, in :mod:`bolted_sector`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import bolted_pressure
import bolted_sector
import common
import numpy as np
import pandas as pd
from assembly_tables import compile_coupled, counts_table, counts_text, grid_counts, smoothing_table, start_table
from bolted_grids import chain, exact, nodes_of
from common import Context, Figure, Section, Table, main
from paper_runs import TARGET, measured, repeats, table

import adaptmg as am
from adaptmg.plot.style import styled

NAME = "bolted junction"
FRICTIONS = (0.0, 0.1, 0.2, 0.4, 0.8)
QUICK_FRICTIONS = (0.0, 0.2, 0.8)
OMEGAS = (1.9, 1.95, 1.98)
CONDENSED_OMEGAS = (1.5, 1.7, 1.8)
MOST_SWEEPS = 20_000
#: sweeps before and after the correction
QUICK_SMOOTHINGS = ((1, 0), (2, 0), (4, 0), (1, 1))
SMOOTHINGS = ((1, 0), (2, 0), (3, 0), (4, 0), (1, 1), (2, 1), (2, 2))
CYCLES = 300
FINE = 1e-10


def one_grid(finest: int, condensed: bool, omega: float, max_sweeps: int, rtol: float, target: float, times: int
             ) -> dict[str, Any]:
    """The paper's regular resolution."""
    return on_chain(finest, 1, am.SingleGrid(omega=omega, condensed=condensed, max_sweeps=max_sweeps, rtol=rtol),
                    target, times)


def several_grids(finest: int, levels: int, method: str, rtol: float, target: float, times: int) -> dict[str, Any]:
    """A full multigrid start and cycles; ``method`` is "truncated" or "monotone"."""
    correction = am.Truncated() if method == "truncated" else am.Monotone()
    return on_chain(finest, levels, am.FullMultigrid(correction=correction, rtol=rtol, max_cycles=CYCLES), target,
                    times)


def smoothing(finest: int, counts: tuple[int, int], stop: str, rtol: float, target: float, times: int
              ) -> dict[str, Any]:
    """Two grids in the monotone mode, n sweeps before and after the correction; full start."""
    pre, post = counts
    solver = am.FullMultigrid(correction=am.Monotone(), cycle=am.Cycle(pre=pre, post=post), stop=stop, rtol=rtol,
                              max_cycles=CYCLES)
    return on_chain(finest, 2, solver, target, times)


def start(finest: int, levels: int, correction: str, full: bool, rtol: float, target: float, times: int
          ) -> dict[str, Any]:
    """With and without the full multigrid start."""
    kind = am.Truncated() if correction == "truncated" else am.Monotone()
    method = am.FullMultigrid if full else am.Multigrid
    return on_chain(finest, levels, method(correction=kind, rtol=rtol, max_cycles=CYCLES), target, times)


def on_chain(finest: int, levels: int, solver: Any, target: float, times: int) -> dict[str, Any]:
    """One row, see :func:`paper_runs.measured`."""
    warm_up()
    grids = chain("ring", finest, levels)
    return measured(grids, solver, exact("ring", finest), target, times) | {"grids": nodes_of(grids)}


def compared(finest: int, case: str, friction: float, rtol: float, times: int) -> dict[str, Any]:
    """The default solver compared with the active set method on the finest grid: work, and how far they differ."""
    warm_up()
    grids, reference = chain(case, finest, finest + 1, friction), exact(case, finest, friction)
    result = common.quickest(grids, am.FullMultigrid(rtol=rtol), times=times)
    tight = am.solve(grids, am.FullMultigrid(rtol=FINE), throw=False)
    row = {"grids": nodes_of(grids), "start_work": result.start_work_units, "cycles": result.cycles,
           "work": result.work_units, "rate": result.rate, "run_seconds": result.seconds,
           "active_seconds": reference.seconds, "residual": result.residual, "outcome": result.status.name,
           "difference": common.energy_error(tight, reference, grids),
           "same states": bool((tight.contact.state == reference.contact.state).all())}
    if case == "bar":
        return row | dict.fromkeys(("opening", "open_to", "slip_to", "bolt_force"), float("nan"))
    c = reference.contact
    slips = c.x[(c.boundary == 0) & (c.state == am.SLIP), 0]
    return row | {"opening": am.cases.joint_opening(reference), "open_to": am.cases.open_to(reference),
                  "slip_to": slips.max() if slips.size else float("nan"),
                  "bolt_force": am.cases.bolt_force(reference) if case == "ring" else float("nan")}


@lru_cache(maxsize=1)
def warm_up() -> None:
    """Compile what coupled bodies need beyond :func:`common.warm_up`."""
    compile_coupled(chain("ring", 1, 2))


def run(context: Context) -> Section:
    """Tables and figures; see the module."""
    finest = 2 if context.quick else 3
    fixed = {"finest": finest, "target": TARGET, "times": repeats(context)}
    smoothings = QUICK_SMOOTHINGS if context.quick else SMOOTHINGS
    counts = grid_counts(context, fixed, one_grid, several_grids, {False: OMEGAS, True: CONDENSED_OMEGAS},
                         MOST_SWEEPS // 10 if context.quick else MOST_SWEEPS, lambda n: ("monotone", "truncated"))
    rows = comparisons(context, finest)
    items: list[Table | Figure] = [
        posed(), counts_table("bolted_grids", NAME, counts),
        smoothing_table(context, smoothing, smoothings, NAME, fixed),
        start_table(context, start, NAME, fixed), cost_table(rows), friction_table(rows)]
    said = summary(counts, rows)
    if context.full:
        pressure, found, steps = bolted_pressure.items(context)
        items += pressure
        said += leak_text(found)
        if not context.quick:
            items += bolted_sector.items(context, steps)
    return Section("Example 3: the bolted junction", "", items, summary=said)


@styled
def posed() -> Figure:
    """What is posed."""
    return Figure("bolted_problem", am.plot.problem(am.cases.bolted_junction()),
                  "The junction in axisymmetry: supports, loads and contact pairs; the bolts are a ring that only "
                  "touches the flanges under its heads.")


def comparisons(context: Context, finest: int) -> pd.DataFrame:
    """The default solver over friction, bolts and the one-body bar."""
    fixed = {"finest": finest, "rtol": 1e-8, "times": repeats(context)}
    frictions = QUICK_FRICTIONS if context.quick else FRICTIONS
    ring = context.study(compared, {"friction": frictions}, case="ring", **fixed).assign(case="ring")
    rest = [context.study(compared, {"friction": (0.2,)}, case=case, **fixed).assign(case=case)
            for case in ("traction", "bar")]
    return pd.concat([ring, *rest], ignore_index=True)


def cost_table(rows: pd.DataFrame) -> Table:
    """Two and three bodies against one."""
    frame = rows[rows["friction"] == 0.2].copy()
    bar = frame[frame["case"] == "bar"]["work"].iloc[0]
    names = {"ring": "junction, bolt ring (3 bodies)", "traction": "junction, bolts as traction (2 bodies)",
             "bar": "GRECO bar (1 body)"}
    frame = frame.assign(problem=frame["case"].map(names), **{"over one body": frame["work"] / bar})
    note = (f"Work units to an estimated error of 1e-8, the nested start included. Difference: to the active set "
            f"method, relative A-norm, with rtol {FINE:g}; the states of all contact nodes are "
            f"{'the same' if frame['same states'].all() else 'not all the same'}. Active set: seconds of that method "
            "on the finest grid alone, by direct factorisation.")
    return table("bolted_cost", frame, ["problem", "grids", "start_work", "cycles", "work", "over one body", "rate",
                                        "run_seconds", "active_seconds", "difference", "residual", "outcome"],
                 "The default solver on the junction and on one body of about as many nodes, the same grading and "
                 "friction .2", note, {"over one body": ".2f", "difference": ".1e"})


def friction_table(rows: pd.DataFrame) -> Table:
    """What friction in the joint does."""
    frame = rows[rows["case"] == "ring"].copy()
    frame["opening"], frame["bolt force"] = 1e6 * frame["opening"], 1e-6 * frame["bolt_force"]
    frame["open to"], frame["slip to"] = 1e3 * frame["open_to"], 1e3 * frame["slip_to"]
    opening, force = (np.ptp(frame[name]) / frame[name].max() for name in ("opening", "bolt force"))
    note = (f"Pressure 4 MPa. Opening at the bore; radii of the ends of the open and the slipping zone (270 mm: the "
            f"rim). From friction {frame['friction'].min():g} to {frame['friction'].max():g} the opening changes by "
            f"{opening:.1%}, the bolt force by {force:.2%}: the flanges turn rather than slide. Difference: to the "
            f"active set method, relative A-norm, with rtol {FINE:g}.")
    made = table("bolted_friction", frame, ["friction", "opening", "open to", "slip to", "bolt force", "cycles", "work",
                                            "rate", "difference", "residual", "outcome"],
                 "Friction between the flanges: what opens and slips, and what it costs (grids of "
                 f"{frame['grids'].iloc[0]} nodes, full multigrid, rtol 1e-8)",
                 note, {"friction": "g", "opening": ".2f", "open to": ".1f", "slip to": ".1f", "bolt force": ".4f",
                        "difference": ".1e"})
    made.units = dict(made.units) | {"opening": "µm", "open to": "mm", "slip to": "mm", "bolt force": "MN"}
    return made


def summary(counts: pd.DataFrame, rows: pd.DataFrame) -> str:
    """What was asked and what came out."""
    at = rows[rows["friction"] == 0.2].set_index("case")
    return ("Tables 1 to 3 on the paper's Example 3, of which it prints no figures; dimensions and loads are ours: two "
            "flanged vessels under internal pressure, held by an equivalent ring of bolts, axisymmetric, Coulomb "
            f"friction .2, {counts['grids'].iloc[0]} nodes. {counts_text(counts)} These three bodies take "
            f"{at.loc['ring', 'work'] / at.loc['bar', 'work']:.2f} times the work of one on about as many nodes "
            f"({at.loc['bar', 'grids'].split('/')[0]}), two bodies "
            f"{at.loc['traction', 'work'] / at.loc['bar', 'work']:.2f} times.")


def leak_text(found: dict[str, float]) -> str:
    """What the rising pressure adds."""
    return (f" The joint leaks at {found['leak']:.2f} MPa and is open as far as the bolt circle at "
            f"{found['open']:.2f} MPa.")


if __name__ == "__main__":
    main(run, "The bolted junction: Tables 1 to 3, friction; with --full preload, pressure until it leaks, and 3D. "
              "Example: python studies/bolted_junction.py --quick --out /tmp/bolted")
