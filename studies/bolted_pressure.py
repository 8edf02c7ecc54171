"""The bolted junction under rising pressure, until it leaks and beyond. Part of ``bolted_junction.py``.

The bolts are tightened in a first step, then the pressure rises (:func:`adaptmg.cases.junction_path`). The joint
*leaks* at the pressure p at which no circle between the bore and the bolt holes is left on which the contact pressure
exceeds p; it is *open to the bolts* at the pressure at which the open zone reaches the bolt circle, which comes later.
Both are interpolated linearly between the steps. The fluid is not followed into the joint, which
would open it earlier.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import common
import numpy as np
import pandas as pd
from bolted_grids import chain, nodes_of
from common import Figure, Table
from matplotlib import pyplot as plt
from matplotlib.lines import Line2D

import adaptmg as am
from adaptmg.cases import Flanges, bolt_force, joint_opening, junction_path, open_to, sealing_pressure
from adaptmg.plot.style import BLUE, GREEN, GREY, INK, ORANGE, styled

MPA, MN = 1e6, 1e6
PRELOAD = 2.5e6
#: pressures of the steps for PRELOAD, Pa; for other preloads in proportion
STEPS = tuple(MPA * p for p in (1.0, 2.0, 3.0, 3.5, 4.0, 4.25, 4.5, 4.75, 5.0, 5.5, 6.0, 6.5, 7.0, 8.0, 9.0, 10.0,
                                12.0))
QUICK_STEPS = tuple(MPA * p for p in (2.0, 4.0, 4.5, 6.0, 8.0, 12.0))
CURVES = (0.0, 2 * MPA, 4 * MPA, 6 * MPA, 8 * MPA)
SWEEP = {"bolt": ("ring", "traction"), "preload": (1.5e6, 2.5e6, 4e6), "friction": (0.0, 0.1, 0.2, 0.4)}
QUICK_SWEEP = {"bolt": ("ring", "traction"), "preload": (2.5e6, 4e6)}


@lru_cache(maxsize=16)
def history(bolt: str, finest: int, steps: tuple[float, ...], preload: float = PRELOAD, friction: float = 0.2
            ) -> am.PathResult:
    """Tightened, then one result a pressure."""
    grids = chain(bolt, finest, finest + 1, friction, preload)
    return am.solve_path(grids, junction_path(grids.problem, steps), am.FullMultigrid(rtol=1e-8))


def read_off(path: am.PathResult, steps: tuple[float, ...], flanges: Flanges, given: float | None = None
             ) -> pd.DataFrame:
    """One row a step, SI units; ``given`` is the bolt force where no bolt has one."""
    return pd.DataFrame([{"pressure": p, "thrust": flanges.thrust(p), "bolts": bolt_force(r)
                          if given is None else given, "joint": r.resultant("upper.joint").force[1],
                          "opening": joint_opening(r), "open_to": open_to(r), "seal": sealing_pressure(r, flanges),
                          "cycles": r.cycles, "work": r.work_units} for p, r in zip((0.0, *steps), path, strict=True)])


def falls_below_zero(x: np.ndarray, y: np.ndarray) -> float:
    """Where y, linear between its points, first falls to zero; NaN where it does not."""
    below = np.flatnonzero(np.asarray(y) <= 0)
    if not below.size or below[0] == 0:
        return float("nan")
    k = int(below[0])
    return float(np.interp(0.0, [y[k], y[k - 1]], [x[k], x[k - 1]]))


def limits(rows: pd.DataFrame, flanges: Flanges) -> dict[str, float]:
    """Pressures, Pa: the joint leaks, is open to the bolts; and what is found at the leak."""
    p = rows["pressure"].to_numpy()
    leak = falls_below_zero(p, rows["seal"].to_numpy() - p)
    to_bolts = falls_below_zero(p, flanges.bolt_circle - rows["open_to"].to_numpy())
    return {"leak": leak, "open": to_bolts,
            **{f"{name} at leak": float(np.interp(leak, p, rows[name])) for name in ("bolts", "opening", "open_to")}}


def until_leak(bolt: str, preload: float, friction: float, finest: int, steps: tuple[float, ...]) -> dict[str, Any]:
    """One path; see :func:`limits`."""
    flanges = Flanges()
    steps = tuple(p * preload / PRELOAD for p in steps)
    path = history(bolt, finest, steps, preload, friction)
    rows = read_off(path, steps, flanges, preload if bolt == "traction" else None)
    return limits(rows, flanges) | {"tightened": rows["bolts"].iloc[0], "steps_work": rows["work"].iloc[1:].mean(),
                                    "grids": nodes_of(chain(bolt, finest, finest + 1))}


def items(context: common.Context) -> tuple[list[Table | Figure], dict[str, float], pd.DataFrame]:
    """Tables and figures; the pressures, MPa, at which the default junction leaks and opens; its steps."""
    finest, steps = (2, QUICK_STEPS) if context.quick else (3, STEPS)
    default = {"preload": (PRELOAD,), "friction": (0.2,), "bolt": ("ring",)}
    parts = [context.study(until_leak, default | {name: values}, finest=finest, steps=steps)
             for name, values in (QUICK_SWEEP if context.quick else SWEEP).items()]
    leaks = pd.concat(parts, ignore_index=True).drop_duplicates(["bolt", "preload", "friction"])
    first = leaks.iloc[0]
    flanges, path = Flanges(), history("ring", finest, steps)
    rows = read_off(path, steps, flanges)
    found = {name: first[name] / MPA for name in ("leak", "open")}
    figures = [force_figure(rows, found, flanges), joint_figure(path, steps, flanges), *section_figures(path, steps)]
    return [leak_table(leaks), step_table(rows, first["grids"]), *figures], found, rows


def leak_table(frame: pd.DataFrame) -> Table:
    """Leak and opening for preloads, frictions and models of the bolts."""
    shown = pd.DataFrame({
        "bolts as": frame["bolt"], "preload": frame["preload"] / MN, "friction": frame["friction"],
        "tightened to": frame["tightened"] / MN, "leaks at": frame["leak"] / MPA,
        "open to bolts at": frame["open"] / MPA, "leaks at / preload": frame["leak"] / frame["preload"],
        "bolt force at leak": frame["bolts at leak"] / MN, "opening at leak": 1e6 * frame["opening at leak"],
        "work a step": frame["steps_work"]})
    note = ("Leaks: no circle between bore and bolt holes is left on which the contact pressure exceeds the fluid's. "
            "Open to bolts: the open zone reaches the bolt circle, r = 240 mm. Interpolated between load steps. "
            "There is no initial gap: all forces scale together, both pressures are proportional to the preload. The "
            "fluid is not followed into the joint, where it would push the flanges apart: a real joint leaks earlier. "
            "Preload: as asked for; tightened to: what the shortened ring then carries on this mesh.")
    grids = "; ".join(f"{bolt} {part['grids'].iloc[0]}" for bolt, part in frame.groupby("bolt", sort=False))
    return Table("bolted_leak", shown, f"The pressure at which the joint leaks (nodes of the grids: {grids}; full "
                 "multigrid, every step to rtol 1e-8)", note,
                 {"preload": "MN", "tightened to": "MN", "leaks at": "MPa", "open to bolts at": "MPa",
                  "leaks at / preload": "1/m²", "bolt force at leak": "MN", "opening at leak": "µm",
                  "work a step": "WU"},
                 {"preload": ".1f", "friction": "g", "tightened to": ".3f", "leaks at": ".2f",
                  "open to bolts at": ".2f", "leaks at / preload": ".3f", "bolt force at leak": ".3f",
                  "opening at leak": ".1f", "work a step": ".0f"})


def step_table(rows: pd.DataFrame, grids: str) -> Table:
    """The steps of the default path."""
    shown = pd.DataFrame({
        "pressure": rows["pressure"] / MPA, "thrust": rows["thrust"] / MN, "bolt force": rows["bolts"] / MN,
        "joint force": rows["joint"] / MN, "opening": 1e6 * rows["opening"], "open to": 1e3 * rows["open_to"],
        "sealing pressure": rows["seal"] / MPA, "cycles": rows["cycles"], "work": rows["work"]})
    worst = float(np.abs(rows["joint"] + rows["thrust"] - rows["bolts"]).max() / PRELOAD)
    note = (f"Joint force = bolt force - thrust, to {worst:.0e} of the preload. Sealing pressure: the largest contact "
            "pressure between bore and bolt holes. Opening: at the bore.")
    return Table("bolted_steps", shown, f"The bolt ring under rising pressure (friction .2, grids of {grids} nodes, "
                 "every step to rtol 1e-8)", note,
                 {"pressure": "MPa", "thrust": "MN", "bolt force": "MN", "joint force": "MN", "opening": "µm",
                  "open to": "mm", "sealing pressure": "MPa", "work": "WU"},
                 {"pressure": ".2f", "thrust": ".3f", "bolt force": ".4f", "joint force": ".4f", "opening": ".2f",
                  "open to": ".1f", "sealing pressure": ".2f", "work": ".0f"})


@styled
def force_figure(rows: pd.DataFrame, found: dict[str, float], flanges: Flanges) -> Figure:
    """Bolt force, joint force and opening against pressure."""
    figure, (forces, opening, radius) = plt.subplots(3, 1, figsize=(6.4, 8.2), sharex=True, height_ratios=(1.5, 1, 1))
    p = rows["pressure"] / MPA
    forces.plot(p, rows["bolts"] / MN, "o-", color=BLUE, label="bolts F")
    forces.plot(p, rows["joint"] / MN, "s-", color=ORANGE, label="joint N = F - thrust")
    forces.plot(p, rows["thrust"] / MN, color=GREY, linestyle=(0, (4, 3)), label="thrust of the ends")
    forces.set_ylabel("force [MN]")
    forces.set_ylim(0.0)
    opening.plot(p, 1e6 * rows["opening"], "o-", color=GREEN)
    opening.set_ylabel("opening at the bore [µm]")
    radius.plot(p, 1e3 * rows["open_to"], "o-", color=GREEN)
    radius.set_ylabel("open to radius [mm]")
    radius.set_ylim(1e3 * flanges.bore, 1e3 * flanges.outer)
    for r, what in ((flanges.inside_bolts, "bolt holes"), (flanges.bolt_circle, "bolt circle"), (flanges.outer, "rim")):
        radius.axhline(1e3 * r, color=GREY, linewidth=0.8)
        radius.text(float(p.iloc[-1]), 1e3 * r, what, ha="right", va="top" if what == "rim" else "bottom", fontsize=8.5,
                    color="#5b626b")
    for ax in (forces, opening, radius):
        ax.grid(True)
        for value, style in ((found["open"], (0, (1, 1.5))), (found["leak"], (0, (5, 2)))):
            ax.axvline(value, color=INK, linewidth=1.0, linestyle=style)
    marks = [Line2D([], [], color=INK, linewidth=1.0, linestyle=(0, (1, 1.5)),
                    label=f"open to the bolt circle, {found['open']:.2f} MPa"),
             Line2D([], [], color=INK, linewidth=1.0, linestyle=(0, (5, 2)), label=f"leaks, {found['leak']:.2f} MPa")]
    forces.legend(handles=[*forces.get_lines()[:3], *marks], loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    radius.set_xlabel("internal pressure [MPa]")
    figure.suptitle("Bolted junction: forces and opening under pressure", fontsize=10.5)
    return Figure("bolted_forces", figure, "Until the joint opens as far as the bolts the thrust unloads the joint and "
                  "the bolts hardly feel the pressure; beyond, the flanges turn about their rims and the bolts take "
                  "more than the further thrust (prying).")


@styled
def joint_figure(path: am.PathResult, steps: tuple[float, ...], flanges: Flanges) -> Figure:
    """Contact pressure along the joint compared with that of the fluid."""
    figure, ax = plt.subplots(figsize=(7.0, 4.4))
    colors = plt.get_cmap("viridis")(np.linspace(0.0, 0.88, len(CURVES)))
    for pressure, color in zip(CURVES, colors, strict=True):
        c = path[(0.0, *steps).index(pressure)].contact
        at = np.flatnonzero(c.boundary == 0)
        at = at[np.argsort(c.x[at, 0])]
        ax.plot(1e3 * c.x[at, 0], c.pressure[at] / MPA, color=color, marker=".", label=f"{pressure / MPA:g} MPa")
        if pressure:
            ax.axhline(pressure / MPA, color=color, linewidth=0.9, linestyle=(0, (4, 3)))
    edges = (1e3 * flanges.inside_bolts, 1e3 * (2 * flanges.bolt_circle - flanges.inside_bolts))
    ax.axvspan(*edges, color="#eceef1", zorder=0)
    ax.text(sum(edges) / 2, 0.985, "bolt holes", transform=ax.get_xaxis_transform(), ha="center", va="top",
            color="#5b626b", fontsize=9)
    ax.set_xlim(1e3 * flanges.bore, 1e3 * flanges.outer)
    ax.set_ylim(0.0)
    ax.set_xlabel("radius [mm]")
    ax.set_ylabel("contact pressure [MPa]")
    ax.grid(True)
    ax.legend(title="fluid (dashed)", loc="upper left")
    ax.set_title("Bolted junction: contact pressure along the joint")
    return Figure("bolted_joint", figure, "Contact pressure along the joint for five pressures of the fluid (dashed "
                  "in the same colour): the joint is tight while a curve exceeds its dashed line left of the holes.")


def section_figures(path: am.PathResult, steps: tuple[float, ...]) -> list[Figure]:
    """The deformed section, as Fig. 4 of the paper."""
    result = path[1 + steps.index(4 * MPA)]
    bodies = am.plot.deformation(result, 100, states=True)
    stress = am.plot.deformation(result, 100, stress=True, lines=False)
    return [Figure("bolted_deformed", bodies, "The junction at 4 MPa, displacement amplified 100 times as in Fig. 4 of "
                   "the paper; the bolt ring lies over the flanges and shares no nodes with them."),
            Figure("bolted_stress", stress, "Von Mises stress at 4 MPa, displacement amplified 100 times.")]
