"""A campaign of random problems through the adaptive loop: is what :func:`adaptmg.adapt` says of its steps true?

One body and pairs, stacks of several pairs, in the plane, in space and axisymmetric, re-entrant corners, arcs and round
faces, interference, laws, friction up to 1.5; from coarse meshes, with every engine, marking and indicator and every
quantity of goals, to 1500 to 5000 nodes. Of every step: the status and the certificate, the estimate against the error
to a solution on a mesh up to 8 times finer, and against that of the exact discrete solution of its mesh, the algebraic
error against this solution by another method, and the mesh, in plain numpy. On 60 more problems most of the contact
boundary stays far from what it faces: balls, cylinders, feet and steps at .01 to 100 mm, bodies that slide. Every loop
runs again, broken off at a random step and gone on from its store: the bits must be the same.

    python studies/adaptive_campaign.py [--quick] [--out DIR]
"""

from __future__ import annotations

import json
import re
import tempfile
import time
import traceback
import warnings
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from adaptive_checks import (
    SHARE,
    a_norm,
    bits,
    direct_error,
    exact_discrete,
    fine_solution,
    is_curved,
    mesh_faults,
    reference_of,
    smallest_angle,
    value_of,
)
from adaptive_problems import REMOTE, Loop, random_loop
from common import Context, Section, Table, main, slope

import adaptmg as am
from adaptmg.estimate import energy_error

CASES, QUICK_CASES = 120, 3
REMOTE_CASES, QUICK_REMOTE_CASES = 60, 1
#: seeds from here on were not looked at while the checks were made
FIRST_SEED = 1000
#: bands of estimate over true error, as the README has them
BANDS = {"Residual": (1.9, 3.5), "Recovery": (0.67, 1.03)}
#: by which the estimate in the loop may miss that of the discrete solution; largest spread of estimate over true error
#: where contact is remote, on meshes after the second with n nodes in contact
MISSED, SPREAD, TOUCHING = 0.15, 1.35, 5
#: of a quantity: errors below this part of it are rounding and what the reference is not sure of
SMALL = 1e-6


def measure(seed: int) -> dict[str, Any]:
    """One loop and all that is checked of it."""
    begin = time.perf_counter()
    try:
        loop = random_loop(seed)
    except ValueError as error:  # the meshes of the other campaigns may be too coarse for their contact
        return {"kind": "block", "indicator": "", "faults": "[]", "steps": "[]", "refused": str(error)[:300]}
    row: dict[str, Any] = {"kind": loop.kind, "problem": loop.problem.name, "dim": loop.problem.dim,
                           "law": type(loop.problem.law).__name__, "indicator": type(loop.indicator).__name__,
                           "quantity": _quantity(loop), "engine": repr(loop.engine), "mark": repr(loop.mark),
                           "start": loop.start if isinstance(loop.start, float) else np.nan,
                           "max_nodes": loop.max_nodes, "outcome": "", "refused": "", "faults": "[]", "steps": "[]"}
    with warnings.catch_warnings():
        # friction so large that the solution may not be unique is what the campaign is about
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            steps = list(loop.steps())
        except (ValueError, am.NotConverged, np.linalg.LinAlgError) as error:
            return row | {"refused": f"{type(error).__name__}: {str(error)[:300]}"}
        except Exception:
            return row | {"faults": json.dumps([traceback.format_exc()[-1500:]])}
        row["loop_s"] = time.perf_counter() - begin
        try:
            rows, faults = _checked(loop, steps)
        except ValueError as error:
            return row | {"faults": json.dumps([f"reference: {str(error)[:300]}"])}
        faults += _again(loop, steps, seed)
    return row | _aggregate(rows) | {"outcome": steps[-1].outcome, "faults": json.dumps(faults),
                                     "steps": json.dumps(rows), "checked_s": time.perf_counter() - begin,
                                     "peak_mb": _peak_mb()}


def _quantity(loop: Loop) -> str:
    return repr(loop.indicator.quantity) if isinstance(loop.indicator, am.Goal) else ""


def _peak_mb() -> float:
    """Most memory this process has had, MB."""
    with open("/proc/self/status") as file:
        return int(re.search(r"VmHWM:\s+(\d+)", file.read())[1]) / 1024


def _checked(loop: Loop, steps: list[am.Step]) -> tuple[list[dict[str, float]], list[str]]:
    """Figures of every step, and what is wrong."""
    fine = fine_solution(steps[-1])
    faults = [] if fine[1].status.ok else [f"reference: {fine[1].status.name}"]
    reference, first = reference_of(fine), steps[0].hierarchy.finest.mesh
    rows = []
    for step in steps:
        row = {"nodes": step.nodes, "levels": len(step.hierarchy), "cycles": step.result.cycles,
               "estimate": step.estimate.total, "angle": smallest_angle(step.hierarchy.finest.mesh),
               "rtol": step.result.rtol}
        label = f"step {step.number}: "
        found = mesh_faults(step.hierarchy.finest.mesh, first, loop.problem.domain)
        if not step.result.status.ok:
            found.append(f"status {step.result.status.name}")
        wrong = step.result.certificate().contradictions(step.result.rtol)
        if wrong:
            found.append(f"certificate contradicts: {', '.join(wrong)}")
        # an opening of zero has no relative error
        finite = np.isfinite(step.estimate.total) and (np.isfinite(step.estimate.relative) or step.estimate.value == 0)
        if not (np.isfinite(step.estimate.squares).all() and finite):
            found.append(f"estimate {step.estimate.relative}")
        row |= _errors(loop, step, fine, reference, found)
        rows.append(row)
        faults += [label + fault for fault in found]
    faults += _end_faults(loop, steps)
    spread = _aggregate(rows).get("spread", np.nan)
    if loop.kind == "remote" and spread > SPREAD:
        faults.append(f"effectivity varies by a factor {spread:.2f}")
    if not is_curved(loop.problem.domain) and np.isfinite(rows[-1]["error"]):
        # the last mesh is nested in that of the reference, so that interpolation is exact
        direct = direct_error(steps[-1].result, fine[1], fine[0])
        squares = direct**2, rows[-1]["error"] ** 2 - reference.own_error**2
        rows[-1]["direct"] = direct
        if not abs(squares[0] - squares[1]) <= 0.02 * squares[0] + 1e-9 * reference.energy:
            faults.append(f"energy_error {squares[1]:.4g}, by interpolation {squares[0]:.4g} (squares)")
    return rows, faults


def _errors(loop: Loop, step: am.Step, fine: Any, reference: Any, found: list[str]) -> dict[str, float]:
    """True errors of a step: energy, algebraic, and of the quantity."""
    row: dict[str, float] = {"norm": step.estimate.norm, "touching": int(np.sum(step.result.contact.state != am.OPEN))}
    try:
        row["error"], row["own"] = energy_error(reference, step.result).absolute, reference.own_error
    except ValueError as error:
        found.append(f"energy_error: {str(error)[:120]}")
        row["error"] = np.nan
    exact = exact_discrete(step)
    if exact.residual > 1e-9:
        found.append(f"active set: {exact.status.name}, residual {exact.residual:.1e}")
    left = a_norm(step, exact.displacement - step.result.displacement)
    row["algebraic"] = left / a_norm(step, exact.displacement)
    row["share"] = row["algebraic"] / step.estimate.relative_energy if step.estimate.relative_energy > 0 else 0.0
    row["over_rtol"] = row["algebraic"] / step.result.rtol
    row["same_state"] = float(np.mean(exact.contact.state == step.result.contact.state))
    if isinstance(loop.indicator, am.Goal):
        quantity = loop.indicator.quantity
        value, best, right = (value_of(quantity, result) for result in (step.result, exact, fine[1]))
        row |= {"value": value, "signed": step.estimate.signed, "true": right - value,
                "algebraic_value": best - value, "algebraic_said": float(step.estimate.algebraic[0]), "right": right}
        # forces of a result obey the contact conditions, those of a goal are residuals: apart by the solver's error
        if not abs(value - step.estimate.value) <= max(1e-9, step.result.rtol) * max(abs(value), abs(right)):
            found.append(f"the goal's value is {step.estimate.value:.12g}, read from the result {value:.12g}")
        if not step.estimate.converged:
            found.append(f"adjoint residual {step.estimate.residuals.max():.1e}")
    else:
        of_exact = loop.indicator.indicate(step.hierarchy, exact).total
        row["in_loop"] = step.estimate.total / of_exact if of_exact > 0 else 1.0
        if not abs(row["in_loop"] - 1) <= MISSED:
            found.append(f"estimate {row['in_loop']:.3f} of that of the discrete solution")
    return row


def _end_faults(loop: Loop, steps: list[am.Step]) -> list[str]:
    """Whether what the loop says of its end is true."""
    last, words, faults = steps[-1], steps[-1].outcome, []
    if any(step.outcome for step in steps[:-1]):
        faults.append("an outcome before the last step")
    if any(a.nodes >= b.nodes for a, b in pairwise(steps)):
        faults.append("meshes do not grow")
    if len(steps) > 1 and last.nodes > loop.max_nodes:
        faults.append(f"{last.nodes} nodes, {loop.max_nodes} allowed")
    if "max_nodes" in words:
        if last.nodes < loop.max_nodes / 1.6:
            faults.append(f"outcome {words!r} at {last.nodes} of {loop.max_nodes} nodes")
    elif "rounding" in words:
        if last.estimate.relative_energy > 1e-7:
            faults.append(f"outcome {words!r} at {last.estimate.relative_energy:.1e}")
    else:
        faults.append(f"outcome {words!r}")
    return faults


def _again(loop: Loop, steps: list[am.Step], seed: int) -> list[str]:
    """The loop with a store, broken off at a random step, and gone on: the same bits."""
    stop = int(np.random.default_rng((seed, 12)).integers(1, len(steps) + 1))
    with tempfile.TemporaryDirectory() as folder:
        broken = loop.steps(store=folder)
        for _ in range(stop):
            next(broken)
        broken.close()
        again = list(loop.steps(store=folder))
    if len(again) != len(steps):
        return [f"again after step {stop - 1}: {len(again)} steps, not {len(steps)}"]
    differ = [k for k, (one, other) in enumerate(zip(steps, again, strict=True)) if bits(one) != bits(other)]
    if again[-1].outcome != steps[-1].outcome:
        return [f"again: outcome {again[-1].outcome!r}"]
    return [f"again after step {stop - 1}: steps {differ} have other bits"] if differ else []


def _aggregate(rows: list[dict[str, float]]) -> dict[str, float]:
    """One figure each for a loop; of meshes after the first, where there are some."""
    later = rows[1:] or rows
    nodes = np.array([row["nodes"] for row in rows], dtype=float)
    error = np.array([row["error"] for row in rows])
    last = slice(-3, None)
    made = {"n_steps": len(rows), "nodes": int(nodes[-1]), "energy_error": error[-1] / rows[-1]["norm"],
            "own": rows[-1].get("own", np.nan) / error[-1] if error[-1] else np.nan,
            "rate": -slope(nodes[last], error[last]) if error[last].all() else np.nan,
            "angle": min(row["angle"] for row in rows), "first_angle": rows[0]["angle"],
            "share": max(row["share"] for row in later), "over_rtol": max(row["over_rtol"] for row in later),
            "cycles": max(row["cycles"] for row in later), "state": min(row["same_state"] for row in later)}
    if "value" not in rows[0]:
        estimate, wrong = (np.array([row[name] for row in later]) for name in ("estimate", "error"))
        # a patch test is solved without error
        found = estimate[wrong > 0] / wrong[wrong > 0] if (wrong > 0).any() else np.array([np.nan])
        resolved = [row["estimate"] / row["error"] for row in rows[2:]
                    if row["touching"] >= TOUCHING and row["error"] > 0]
        return made | {"effectivity": float(found[-1]), "least": float(found.min()), "most": float(found.max()),
                       "spread": max(resolved) / min(resolved) if resolved else np.nan,
                       "in_loop": max((row["in_loop"] for row in later), key=lambda ratio: abs(ratio - 1))}
    true, signed = (np.array([row[name] for row in rows]) for name in ("true", "signed"))
    size = abs(rows[-1]["right"])
    clear = np.abs(true) > SMALL * size
    return made | {"goal_error": float(abs(true[-1]) / size) if size else np.nan,
                   "goal_effectivity": float(signed[-1] / true[-1]) if clear[-1] else np.nan,
                   "goal_gain": float(np.median(np.abs(true - signed)[clear] / np.abs(true)[clear]))
                   if clear.any() else np.nan}


#: column of a row -> head of the table
HEADS = {"seed": "seed", "problem": "problem", "dim": "dim", "law": "law", "indicator": "indicator",
         "made by": "made by", "n_steps": "meshes", "nodes": "nodes", "energy_error": "energy error", "rate": "rate",
         "effectivity": "effectivity", "spread": "spread", "in_loop": "over that of the discrete solution",
         "goal_effectivity": "effectivity, goal", "share": "left by the solver",
         "cycles": "most cycles", "angle": "least angle", "outcome": "why it ended", "refused": "refused",
         "faults": "faults"}


def run(context: Context) -> Section:
    """The campaign."""
    cases, remote = (QUICK_CASES, QUICK_REMOTE_CASES) if context.quick else (CASES, REMOTE_CASES)
    rows = context.study(measure, {"seed": [*range(FIRST_SEED, FIRST_SEED + cases), *range(REMOTE, REMOTE + remote)]})
    table = outcomes(rows)
    bands = " and ".join(f"{low:g} to {high:g} ({name})" for name, (low, high) in BANDS.items())
    note = ("Effectivity: estimate over true energy error on the last mesh, of goals signed estimate over error; "
            f"outside: loops beyond {bands}. Spread: largest over smallest effectivity of a loop's meshes after the "
            f"second with {TOUCHING} nodes in contact. Over that of the discrete solution: the estimate in the loop, "
            "where it misses most. Rate: of the energy error over the last three meshes, median. Left by the "
            f"solver: algebraic error over the estimate, largest of a loop's steps (aim {SHARE:g}; goals have another "
            "measure). Faults: whatever was found wrong of a status, certificate, mesh, outcome, or of the bits of the "
            "same loop gone on from its store.")
    spec = {"energy error": ".2f", "rate": ".2f", "effectivity": ".2f", "effectivity, goal": ".2f", "spread": ".2f",
            "over that of the discrete solution": ".3f", "left by the solver": ".3f", "least angle": ".1f"}
    return Section("Random adaptive loops", __doc__.split("\n\n")[1],
                   [Table("adaptive_campaign", table, "Random adaptive loops: outcomes by indicator", note,
                          formats={name: ".2f" for name in table if table[name].dtype == float}),
                    Table("adaptive_campaign_loops", every(rows), "Every loop", "Columns as above.", open=False,
                          units={"energy error": "%", "least angle": "degrees"},
                          formats=spec)],
                   summary=summary(table),
                   seeds=f"{FIRST_SEED} to {FIRST_SEED + cases - 1}, {REMOTE} to {REMOTE + remote - 1}")


def summary(table: pd.DataFrame) -> str:
    """What was asked and what came out."""
    faults = table["with faults"].sum()
    return (f"Is what adaptive loops say of their steps true? Of {table['loops'].sum()} random loops "
            f"({table['meshes'].sum()} meshes) {table['refused'].sum()} were refused with a reason; in "
            f"{faults or 'none'} of the others something was wrong.")


def every(rows: pd.DataFrame) -> pd.DataFrame:
    """A line a loop, in words."""
    goals = rows["indicator"] == "Goal"
    rows = rows.assign(**{"made by": rows["engine"].str.partition("(")[0].str.lower(),
                          "energy_error": 100 * rows["energy_error"], "share": rows["share"].mask(goals),
                          "faults": rows["faults"].replace("[]", "")})
    return rows.reindex(columns=list(HEADS)).rename(columns=HEADS)


def outcomes(rows: pd.DataFrame) -> pd.DataFrame:
    """Counts and ranges by indicator."""
    result = []
    remote = rows["kind"].eq("remote").map({True: ", remote contact", False: ""})
    for label, mine in rows.groupby(rows["indicator"] + remote):
        name = label.partition(",")[0]
        ran = mine[mine["refused"] == ""]
        effectivity = ran.get("goal_effectivity" if name == "Goal" else "effectivity", pd.Series(dtype=float)).dropna()
        low, high = BANDS.get(name, (-np.inf, np.inf))
        rate, share = ran["rate"].dropna(), ran["share"].dropna()
        spread, in_loop = (ran.get(key, pd.Series(dtype=float)).dropna() for key in ("spread", "in_loop"))
        result.append({"indicator": label, "loops": len(mine), "refused": len(mine) - len(ran),
                       "with faults": int((ran["faults"] != "[]").sum()), "meshes": int(ran["n_steps"].sum()),
                       "effectivity, median": float(effectivity.median()), "5 %": float(effectivity.quantile(0.05)),
                       "95 %": float(effectivity.quantile(0.95)), "outside": int((~effectivity.between(low,
                                                                                                       high)).sum()),
                       "largest spread": float(spread.max()),
                       "over that of the discrete solution, least": float(in_loop.min()), "most": float(in_loop.max()),
                       "rate 2D": float(rate[ran["dim"] == 2].median()),
                       "rate 3D": float(rate[ran["dim"] == 3].median()), "left by the solver": float("nan")
                       if name == "Goal" else float(share.max())})
    return pd.DataFrame(result)


if __name__ == "__main__":
    main(run, __doc__.split("\n")[0] + " Example: python studies/adaptive_campaign.py --quick --out /tmp/loops")
