"""A campaign of random contact problems: does the default solver solve them, and does it say so when it does not?

Bar and block with random pressures and shear, laws, friction up to 2, gap shapes, nested and independent meshes, some
held by contact alone; and pairs of bodies of unequal moduli and meshes, either of them as slave. Each from the nested
start and from zero. A body that contact cannot hold is refused. Solved means: status CONVERGED and natural residual
below 1e-8 of the forces.

    python studies/robustness.py [--quick | --full] [--out DIR]
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from common import Context, Section, Table, main
from random_bodies import random_pair

import adaptmg as am
from adaptmg.solver.statics import check_statics

CASES, QUICK_CASES = 160, 8
PAIRS, QUICK_PAIRS = 40, 3
#: seeds from here on were not looked at while the safeguards of the solver were made
FIRST_SEED = 1000
RTOL = 1e-9
RESIDUAL = 1e-8


@dataclass(frozen=True)
class Wave:
    """A gap that undulates; a class, so that problems can be pickled."""

    amplitude: float
    waves: float
    phase: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Gaps (n,), m."""
        angle = 2 * np.pi * self.waves * points / 40e-3
        height = np.sin(angle[:, 0] + self.phase)
        if points.shape[1] == 3:
            height = height * np.cos(angle[:, 1])
        return self.amplitude * (1 + height)


def random_grids(seed: int) -> tuple[dict[str, Any], am.Hierarchy]:
    """A random problem on random meshes, and what it is."""
    rng = np.random.default_rng(seed)
    dim = 3 if rng.random() < 0.35 else 2
    friction = float(rng.choice([0.1, 0.3, 0.7, 1.0, 1.5, 2.0]))
    coulomb = am.Coulomb(friction)
    law = [coulomb, coulomb, coulomb, am.Tresca(float(10 ** rng.uniform(6.5, 8))), am.Frictionless()][rng.integers(5)]
    loads = {"top_pressure": float(rng.uniform(1e7, 1e8)), "side_pressure": float(rng.uniform(-1e8, 4e8))}
    if dim == 2:
        problem = am.cases.greco_bar(law=law, **loads)
    else:
        problem = am.cases.greco_block(law=law, plane_strain=bool(rng.random() < 0.3), **loads)
    amplitude = float(rng.choice([0, 0, 1e-6, 1e-5, 5e-5]))
    if amplitude > 0:
        wave = Wave(amplitude, float(rng.uniform(0.5, 3)), float(rng.uniform(0, 2 * np.pi)))
        problem = replace(problem, contact=am.Contact("bottom", am.GapFunction(wave)), reference={})
    if rng.random() < 0.5:
        shear = am.Traction("top", (*(float(t) for t in rng.uniform(-5e7, 5e7, dim - 1)), 0.0))
        problem = replace(problem, loads=(*problem.loads, shear), reference={})
    nested = bool(rng.random() < 2 / 3)
    floating = bool(rng.random() < 0.15)
    if floating:
        # held by contact alone: the side pressure acts on both sides, up to a part that friction can take
        balance = am.Pressure("right", loads["side_pressure"] - float(rng.uniform(0, 0.05)) * loads["top_pressure"])
        problem = replace(problem, supports=(), loads=(*problem.loads, balance), reference={})
    if nested:
        chains = ([(4, 8, 16, 32), (4, 8, 16, 32, 64), (3, 6, 12, 24, 48)] if dim == 2
                  else [(2, 4, 8), (2, 4, 8, 16), (3, 6, 12)])
        hierarchy = am.Hierarchy.uniform(problem, chains[rng.integers(3)])
    else:
        sizes = (16e-3, 8e-3, 4e-3, 2e-3) if dim == 2 else (20e-3, 10e-3, 5e-3)
        hierarchy = am.Hierarchy.graded(problem, sizes, float(rng.choice([1, 2, 4])))
    what = {"dim": dim, "nested": nested, "floating": floating, "law": type(law).__name__, "friction": friction,
            "amplitude": amplitude, "nodes": hierarchy.finest.n_nodes, **loads}
    return what, hierarchy


def solve_case(seed: int) -> dict[str, Any]:
    """One body from both starts."""
    return _from_both_starts(*random_grids(seed))


def solve_pair(seed: int) -> dict[str, Any]:
    """Two bodies from both starts."""
    return _from_both_starts(*random_pair(seed))


def _from_both_starts(row: dict[str, Any], hierarchy: am.Hierarchy) -> dict[str, Any]:
    try:
        # the load may push the body off its contact: refused before any work, which is a right answer
        check_statics(hierarchy.finest.discrete)
    except ValueError as error:
        for name in ("nested", "cold"):
            row |= {f"{name}_status": "REFUSED", f"{name}_cycles": 0, f"{name}_residual": np.nan,
                    f"{name}_fallback": ""}
        return row | {"why": str(error)[:80]}
    solvers = {"nested": am.FullMultigrid(correction=am.Truncated(), rtol=RTOL),
               "cold": am.Multigrid(correction=am.Truncated(), rtol=RTOL)}
    for name, solver in solvers.items():
        with warnings.catch_warnings():
            # friction so large that the solution may not be unique is what the campaign is about
            warnings.simplefilter("ignore", RuntimeWarning)
            result = am.solve(hierarchy, solver, throw=False)
        row |= {f"{name}_status": result.status.name, f"{name}_cycles": result.cycles,
                f"{name}_residual": result.residual, f"{name}_fallback": result.fallback}
    return row


def run(context: Context) -> Section:
    """The campaign."""
    cases, pairs = (QUICK_CASES, QUICK_PAIRS) if context.quick else (CASES, PAIRS)
    rows = context.study(solve_case, {"seed": list(range(FIRST_SEED, FIRST_SEED + cases))})
    bodies = context.study(solve_pair, {"seed": list(range(FIRST_SEED, FIRST_SEED + pairs))})
    parts = {"one body on an obstacle": rows, "two bodies": bodies,
             "two, the slave softer": bodies[bodies["stiffness"] < 1],
             "two, the slave more than 3 times stiffer": bodies[bodies["stiffness"] > 3]}
    outcomes = pd.concat([_outcomes(frame).assign(bodies=name) for name, frame in parts.items() if len(frame)],
                         ignore_index=True)
    outcomes.insert(0, "bodies", outcomes.pop("bodies"))
    note = (f"Solved: CONVERGED with a natural residual of at most {RESIDUAL:g}, relative to the forces; reported: "
            "another status; silent: CONVERGED with a larger residual; by active set: solved ones that it took over. "
            "Refused: bodies that contact cannot hold, before any work.")
    what = {"seed": "seed", "dim": "dim", "nested": "nested meshes", "floating": "held by contact alone", "law": "law",
            "friction": "friction", "nodes": "nodes"}
    pair = {"seed": "seed", "nested": "nested meshes", "law": "law", "friction": "friction", "slave": "slave",
            "stiffness": "slave / master", "nodes": "nodes"}
    return Section("Random contact problems", __doc__.split("\n\n")[1], [
        Table("robustness", outcomes, f"Random problems by the default method, rtol {RTOL:g}: outcomes", note,
              formats={"median cycles": ".0f"}),
        _cases("robustness_cases", rows, what, "Every problem of one body", ""),
        _cases("robustness_pair_cases", bodies, pair, "Every problem of two bodies",
               " Slave / master: ratio of the moduli.")],
        summary=summary(outcomes), seeds=f"{FIRST_SEED} to {FIRST_SEED + max(cases, pairs) - 1}")


#: start -> what the first part of its columns is called
STARTS = {"nested": "nested start", "cold": "from zero"}


def summary(outcomes: pd.DataFrame) -> str:
    """What was asked and what came out."""
    said = []
    # the others are parts of the second
    kinds = [part for _, part in outcomes.groupby("bodies", sort=False)][:2]
    for part in kinds:
        bodies = part["bodies"].iloc[0]
        nested, zero = part.iloc[0], part.iloc[1]
        posed = nested["problems"] - nested["refused"]
        said.append(f"{bodies.capitalize()}: of {nested['problems']} problems {nested['refused']} were refused; of the "
                    f"other {posed} the nested start solved {nested['solved']} ({nested['median cycles']:.0f} cycles "
                    f"at the median, {nested['most cycles']} at most), zero {zero['solved']} "
                    f"({zero['median cycles']:.0f} and {zero['most cycles']}).")
    return ("Does the default method solve random problems, and does it say so when it does not? " + " ".join(said)
            + f" Silent failures: {sum(part['silent failures'].sum() for part in kinds)}.")


def _cases(name: str, rows: pd.DataFrame, what: dict[str, str], caption: str, remark: str) -> Table:
    """Every problem, with what came out from both starts."""
    # the coefficient is drawn for all, and used by Coulomb's law alone
    frame, names = rows.assign(friction=rows["friction"].where(rows["law"] == "Coulomb")), dict(what)
    for key, title in STARTS.items():
        names |= {f"{key}_{part}": f"{word}, {title}" for part, word in
                  (("status", "status"), ("cycles", "cycles"), ("residual", "residual"), ("fallback", "taken over by"))}
        taken = rows[f"{key}_fallback"].map(lambda text: text.partition("(")[0] or "-")
        frame = frame.assign(**{f"{key}_fallback": taken, f"{key}_cycles": rows[f"{key}_cycles"].where(
            rows[f"{key}_status"] != "REFUSED")})
    frame = frame[list(names)].rename(columns=names)
    formats = {title: ".1e" for title in frame if title.startswith("residual")}
    formats |= {title: ".0f" for title in frame if title.startswith("cycles")} | {"slave / master": ".2g"}
    note = "Residual: natural, relative to the forces. Friction: of Coulomb's law." + remark
    return Table(name, frame, caption, note,
                 formats={title: value for title, value in formats.items() if title in frame})


def _outcomes(rows: pd.DataFrame) -> pd.DataFrame:
    """Counts of outcomes by start."""
    found = []
    for name, title in STARTS.items():
        status, cycles, residual, fallback = (rows[f"{name}_{what}"]
                                              for what in ("status", "cycles", "residual", "fallback"))
        converged = status == "CONVERGED"
        found.append({"start": title, "problems": len(rows), "refused": int((status == "REFUSED").sum()),
                      "solved": int((converged & (residual <= RESIDUAL)).sum()),
                      "reported failures": int((~converged & (status != "REFUSED")).sum()),
                      "silent failures": int((converged & ~(residual <= RESIDUAL)).sum()),
                      "by active set": int((converged & (fallback != "")).sum()),
                      "median cycles": float(cycles[converged].median()), "most cycles": int(cycles.max())})
    return pd.DataFrame(found)


if __name__ == "__main__":
    main(run, __doc__.split("\n")[0] + " Example: python studies/robustness.py --quick --out /tmp/robustness")
