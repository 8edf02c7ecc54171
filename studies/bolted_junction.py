"""Example 3, the bolted junction: what do several grids gain, and at which pressure does it leak?

    python studies/bolted_junction.py [--quick | --full] [--out DIR]

The paper prints a picture of this example (its Fig. 4) and no numbers; dimensions and loads are
ours (axisymmetric, a shortened bolt ring, friction .2). Every method runs to a true error of 1e-6;
direct factorisations are in the seconds, not in the work. Then the bolts are tightened and the
pressure rises. The joint leaks when no circle between bore and bolt holes is left on which the
contact pressure exceeds the fluid's, interpolated between load steps on two meshes, whose
difference says how many digits count. The fluid is not followed into the joint, where it would push
the flanges apart: a real joint leaks earlier."""

from functools import lru_cache

import numpy as np
import pandas as pd
from common import Output, compare, drawing, main, measured

import adaptmg as am

SIZES = (12e-3, 7e-3, 4e-3, 2.4e-3)  # away from contact, m; at contact half
TARGET = 1e-6
PRESSURES = (1e6, 2e6, 3e6, 4e6, 4.1e6, 4.2e6, 4.3e6, 4.4e6, 4.5e6, 5e6, 6e6, 8e6, 10e6)
METHODS = {
    "one grid, omega 1.95": am.SingleGrid(omega=1.95, rtol=TARGET / 2, max_sweeps=20_000),
    "one grid, condensed, omega 1.7": am.SingleGrid(
        omega=1.7, condensed=True, rtol=TARGET / 2, max_sweeps=20_000
    ),
    "active set, direct": am.ActiveSet(rtol=TARGET / 2),
    "monotone, V": am.FullMultigrid(correction=am.Monotone(), rtol=TARGET / 2, max_cycles=300),
    "default (truncated)": am.FullMultigrid(rtol=TARGET / 2),
}


@lru_cache(maxsize=8)
def chain(finest: int, levels: int) -> am.Hierarchy:
    """``levels`` grids, the finest of which is that of ``SIZES[finest]``."""
    grids = am.Hierarchy.graded(am.cases.bolted_junction(), SIZES[: finest + 1], contact_ratio=2)
    return grids.truncated(coarsest=finest + 1 - levels)


@lru_cache(maxsize=2)
def exact(finest: int) -> am.Result:
    """The exact discrete solution by semismooth Newton with direct solves."""
    return am.solve(chain(finest, 1), am.ActiveSet(rtol=1e-12))


def run(method: str, levels: int, finest: int) -> dict:
    """One method."""
    return measured(chain(finest, levels), METHODS[method], exact(finest), TARGET)


def joint(step: am.Result) -> pd.DataFrame:
    """The contact nodes of the joint, from the bore outwards."""
    rows = step.contact.table()
    return rows[rows["pair"].str.startswith("upper.joint")].sort_values("x [m]")


def open_to(step: am.Result) -> float:
    """Radius up to which the joint is open, m: half-way between the first node that touches and the
    one before."""
    rows = joint(step)
    first = int(np.argmax(rows["state"] != "open"))
    return float(rows["x [m]"].iloc[max(first - 1, 0) : first + 1].mean())


def rising(finest: int) -> tuple[am.PathResult, np.ndarray, float]:
    """The steps of the rising pressure, the sealing pressures, and the pressure at which the joint
    leaks, MPa."""
    grids, flanges = chain(finest, finest + 1), am.cases.Flanges()
    pressures = np.array([0.0, *PRESSURES]) / 1e6
    factors = 1e6 * pressures / grids.problem.reference["pressure"]
    steps = am.solve_path(
        grids, am.LoadPath(dict.fromkeys(("upper.bore", "lower.bore", "upper.pipe"), factors))
    )
    sealing = np.array(
        [
            joint(step)["pressure [Pa]"][joint(step)["x [m]"] <= flanges.inside_bolts].max() / 1e6
            for step in steps
        ]
    )
    margin = sealing - pressures
    at = [int(np.flatnonzero(margin <= 0)[0]) - back for back in (0, 1)]
    return steps, sealing, float(np.interp(0.0, margin[at], pressures[at]))


def study(out: Output) -> None:
    """Compute the methods on one to four grids, then the junction under rising pressure."""
    finest = 2 if out.quick else 3
    counts = [2, 3] if out.quick else [2, 3, 4]
    best = (
        compare(
            out,
            run,
            list(METHODS),
            counts,
            "Bolted junction: cycles, work and seconds to a true error of 1e-6",
            finest=finest,
        )
        .groupby("method")
        .last()
    )
    ours, direct = best.loc["default (truncated)"], best.loc["active set, direct"]
    out.number(
        f"Bolted junction, {ours['nodes']} nodes, to a true error of 1e-6; active set with direct solves",
        f"{ours['seconds']:.2f} s ({ours['cycles']} cycles, {ours['work']:.0f} WU); {direct['seconds']:.2f} s",
    )

    (*_, coarser), (steps, sealing, leak) = rising(finest - 1), rising(finest)
    flanges, pressures = am.cases.Flanges(), np.array([0.0, *PRESSURES])
    scatter = f"{leak:.2g} MPa ({coarser:.2f} and {leak:.2f} on meshes of {1e3 * SIZES[finest - 1]:g} and "
    scatter += f"{1e3 * SIZES[finest]:g} mm)"
    rows = pd.DataFrame(
        {
            "pressure": pressures / 1e6,
            "bolt force": [step.resultant("upper.seat").force[1] / -1e6 for step in steps],
            "joint force": [step.resultant("upper.joint").force[1] / 1e6 for step in steps],
            "thrust": [flanges.thrust(p) / 1e6 for p in pressures],
            "opening": [1e6 * joint(step)["gap [m]"].iloc[0] for step in steps],
            "open to": [1e3 * open_to(step) for step in steps],
            "sealing pressure": sealing,
            "cycles": [step.cycles for step in steps],
        }
    )
    out.table(
        "pressure",
        rows,
        "Bolted junction under rising pressure",
        f"It leaks at {scatter}. Joint force = bolt force - thrust of the ends.",
        formats={
            "pressure": ".2f",
            "opening": ".2f",
            "open to": ".1f",
            "sealing pressure": ".2f",
            "bolt force": ".3f",
            "joint force": ".3f",
            "thrust": ".3f",
        },
        units={
            "pressure": "MPa",
            "bolt force": "MN",
            "joint force": "MN",
            "thrust": "MN",
            "opening": "µm",
            "open to": "mm",
            "sealing pressure": "MPa",
        },
    )
    out.number("Bolted junction: pressure at which it leaks", scatter)
    figure, ax = drawing(4.2, 7.2)
    for name in ("bolt force", "joint force", "thrust"):
        ax.plot(rows["pressure"], rows[name], "o-", label=name)
    ax.axvline(leak, color="k", linestyle="--", label=f"leaks, {leak:.2g} MPa")
    ax.set(xlabel="internal pressure [MPa]", ylabel="force [MN]", ylim=(0, None))
    figure.legend(loc="outside right upper")
    out.figure(
        "forces",
        figure,
        "Forces under rising pressure: the joint force is the bolt force less the thrust of "
        "the ends; once the joint opens, the bolts carry the thrust",
    )
    at_four = steps[1 + PRESSURES.index(4e6)]
    out.figure(
        "deformed",
        am.plot.deformation(at_four, 100, states=True),
        "The junction at 4 MPa, displacement "
        "amplified 100 times as in Fig. 4 of the paper; colours show the contact states",
    )
    balance = float(np.abs(rows["joint force"] + rows["thrust"] - rows["bolt force"]).max() / 2.5)
    out.check("balance of bolt force, joint force and thrust, of the preload", balance, high=1e-6)


if __name__ == "__main__":
    main(study)
