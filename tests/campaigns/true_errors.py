"""Does CONVERGED mean what it says? The true error of every method on random problems.

Bodies on obstacles and pairs of bodies, in 2D and 3D, nested and independent meshes, with and without prescribed
displacements, friction up to 2; every method with tolerances from 1e-3 to 1e-10. Slender and folded bodies (springs,
combs, rings, frames, beams) with tolerances from 1e-1 to 1e-8, and bodies with gaps of 1e3 to 1e5 displacements. The
true error is the A-norm of the difference to the exact discrete solution nearest to the result (found by Newton
steps from it, as there may be several) over the A-norm of that. A result is wrong if it says CONVERGED and the true
error exceeds three times rtol; failures that are said are counted as such.

    python studies/true_errors.py [--quick | --full] [--out DIR]
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from common import Context, Section, Table, main
from random_bodies import SIDE, random_pair
from robustness import random_grids
from slender_bodies import random_gaps, random_slender

import adaptmg as am

CASES, QUICK_CASES = 60, 6
#: random problem and range of the exponent of rtol, by family; the seeds of each are the same
FAMILIES = {"compact": (-10, -3), "slender": (-8, -1), "wide gaps": (-8, -3)}
#: seeds from here on were not looked at while the estimates of the error were made
FIRST_SEED = 50_000
#: times rtol that the true error may be
ALLOWED = 3.0
#: nodes up to which sweeps on one grid, and the monotone correction in 3D, are tried
SWEPT = 1200


def methods(rtol: float, nodes: int, dim: int, levels: int) -> dict[str, Any]:
    """Every method, with a tolerance."""
    made = {"active set": am.ActiveSet(rtol=rtol), "active set, sparse": am.ActiveSet(rtol=rtol, condensed=False),
            "active set, AMG": am.ActiveSet(rtol=rtol, linear=am.AMG(), condensed=False)}
    if levels > 1:
        made |= {"truncated, nested": am.FullMultigrid(rtol=rtol, correction=am.Truncated()),
                 "truncated, from zero": am.Multigrid(rtol=rtol, correction=am.Truncated())}
    if levels > 1 and (dim == 2 or nodes <= SWEPT):
        made |= {"monotone, nested": am.FullMultigrid(rtol=rtol, correction=am.Monotone()),
                 "monotone, from zero": am.Multigrid(rtol=rtol, correction=am.Monotone())}
    if nodes <= SWEPT:
        made |= {"single grid": am.SingleGrid(rtol=rtol, max_sweeps=20_000),
                 "single grid, omega 1.8": am.SingleGrid(rtol=rtol, omega=1.8, max_sweeps=20_000),
                 "single grid, condensed": am.SingleGrid(rtol=rtol, condensed=True, max_sweeps=20_000),
                 "single grid, fixed point": am.SingleGrid(rtol=rtol, condensed=True, friction="fixed point",
                                                           max_sweeps=20_000)}
    return made


def random_problem(seed: int) -> tuple[dict[str, Any], am.Hierarchy]:
    """A random problem on random meshes; in half of them displacements are prescribed."""
    rng = np.random.default_rng((seed, 7))
    kind = ["one body", "one body", "pair", "pair", "pair in 3D"][rng.integers(5)]
    prescribed = bool(rng.random() < 0.5)
    if kind == "one body":
        what, grids = random_grids(seed)
        if prescribed:
            grids = _again(grids, _lowered(grids.problem, rng, ("top",)))
    elif kind == "pair":
        what, grids = random_pair(seed)
        if prescribed:
            grids = _again(grids, _lowered(grids.problem, rng, ("upper.top",)))
    else:
        what, grids = _pair_in_3d(rng)
        if prescribed:
            grids = _again(grids, _lowered(grids.problem, rng, ("upper.top",)))
    return what | {"kind": kind, "prescribed": prescribed, "levels": len(grids)}, grids


def _lowered(problem: am.ContactProblem, rng: np.random.Generator, boundaries: tuple[str, ...]) -> am.ContactProblem:
    """The problem with a boundary moved in place of its pressure: through a gap and further, and sideways."""
    dim = problem.dim
    gap, press = float(rng.choice([0.0, 1e-5, 1e-3, 1e-2])), float(10 ** rng.uniform(-6, -4.5))
    drift = [float(rng.choice([0.0, 1.0, 10.0])) * press * float(rng.uniform(-1, 1)) for _ in range(dim - 1)]
    values = dict(zip("xyz", (*drift, -(gap + press)), strict=False))
    loads = tuple(load for load in problem.loads if load.boundary not in boundaries)
    contact = problem.contact[0]
    if isinstance(contact, am.ContactPair):
        contact = replace(contact, gap=gap)
    elif isinstance(contact.obstacle, am.GapFunction):
        inner = contact.obstacle.function
        contact = replace(contact, obstacle=am.GapFunction(lambda points: inner(points) + gap))
    else:
        contact = replace(contact, obstacle=am.GapFunction(lambda points: np.full(len(points), gap)))
    # a support that meets the moved boundary must want the same there
    sides = ("right", "left", "back", "front")
    supports = tuple(support for support in problem.supports
                     if support.boundary.rpartition(".")[2] not in sides or support.boundary.startswith("lower"))
    return replace(problem, loads=loads, contact=(contact,), reference={},
                   supports=(*supports, *(am.Support(name, **values) for name in boundaries)))


def _again(grids: am.Hierarchy, problem: am.ContactProblem) -> am.Hierarchy:
    """Another problem on the same meshes."""
    return am.Hierarchy.from_meshes(problem, [level.mesh for level in grids.levels])


def _pair_in_3d(rng: np.random.Generator) -> tuple[dict[str, Any], am.Hierarchy]:
    """A block on a wider one, meshes that do not match."""
    width = SIDE * float(rng.uniform(1.2, 1.8))
    parts = {"upper": am.Box(width=SIDE, depth=SIDE, height=0.6 * SIDE),
             "lower": am.Box(width=width, depth=width, height=0.6 * SIDE, origin=(-0.3 * (width - SIDE),
                                                                                 -0.6 * (width - SIDE), -0.6 * SIDE))}
    young = {name: float(10 ** rng.uniform(10, 11.5)) for name in parts}
    friction = float(rng.choice([0.0, 0.1, 0.3, 0.7]))
    slave = "upper" if rng.random() < 0.5 else "lower"
    faces = ("upper.bottom", "lower.top")
    problem = am.ContactProblem(
        name="two boxes", domain=am.Assembly(parts=parts),
        contact=am.ContactPair(*faces[::1 if slave == "upper" else -1]),
        material={name: am.Solid(young=value, poisson=0.3) for name, value in young.items()},
        law=am.Coulomb(friction) if friction else am.Frictionless(),
        loads=(am.Pressure("upper.top", float(rng.uniform(1e7, 1e8))),
               am.Pressure("upper.left", float(rng.uniform(-2e7, 5e7)))),
        supports=(am.Support("upper.right", x=0.0), am.Support("upper.front", y=0.0),
                  am.Support("lower.bottom", x=0.0, y=0.0, z=0.0)))
    cells = int(rng.integers(2, 4))
    other = max(1, cells + int(rng.integers(-1, 2)))
    grids = am.Hierarchy.uniform(problem, [{"upper": (cells * k, cells * k, cells * k),
                                            "lower": (other * k, other * k, other * k)} for k in (1, 2)])
    opposite = "lower" if slave == "upper" else "upper"
    return {"dim": 3, "nested": True, "floating": False, "law": type(problem.law).__name__, "friction": friction,
            "slave": slave, "stiffness": young[slave] / young[opposite], "nodes": grids.finest.n_nodes}, grids


def measure(seed: int, family: str) -> dict[str, Any]:
    """Statuses, errors and certificates over rtol of all methods on one problem, by method."""
    rng = np.random.default_rng((seed, 8))
    row: dict[str, Any] = {"rtol": float(10 ** rng.uniform(*FAMILIES[family]))}
    made = {"compact": random_problem, "slender": random_slender, "wide gaps": random_gaps}[family]
    try:
        what, grids = made(seed)
    except ValueError as error:
        return row | {"why": str(error)[:200]}  # a random mesh may be too coarse for its contact
    row |= what
    known: list[np.ndarray] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        for name, method in methods(row["rtol"], grids.finest.n_nodes, grids.finest.discrete.dim, len(grids)).items():
            try:
                result = am.solve(grids, method, throw=False)
            except (ValueError, np.linalg.LinAlgError) as error:
                row |= {f"{name}: status": "REFUSED", f"{name}: error": np.nan, "why": str(error)[:200]}
                continue
            row[f"{name}: status"] = result.status.name
            row[f"{name}: error"] = _error(grids, result, known) / row["rtol"] if result.status.ok else np.nan
            row[f"{name}: certificate"] = result.certificate().energy_error / row["rtol"]
    return row


def _error(grids: am.Hierarchy, result: am.Result, known: list[np.ndarray]) -> float:
    """The error relative to the nearest exact solution; solutions found are added to ``known``."""
    least = min((_distance(grids, result.displacement, exact) for exact in known), default=np.inf)
    if least <= ALLOWED * result.rtol:
        return least
    # Newton steps may cycle: then multigrid goes on from the result
    for method in (am.ActiveSet(rtol=1e-13, max_steps=25), am.Multigrid(rtol=1e-3 * result.rtol)):
        try:
            exact = am.solve(grids, method, start=result, throw=False)
        except ValueError:
            continue  # a single level
        if exact.certificate(grids.finest.discrete, bound=True).energy_error <= 0.1 * result.rtol:
            known.append(exact.displacement)
            return min(least, _distance(grids, result.displacement, exact.displacement))
    return least


def _distance(grids: am.Hierarchy, displacement: np.ndarray, exact: np.ndarray) -> float:
    discrete = grids.finest.discrete
    u, v = (discrete.relative(values).reshape(-1) for values in (exact, displacement))
    size = np.sqrt(max(u @ (discrete.matrix @ u), 0.0))
    # the A-norm of a rounding of the displacement, which no error can be below
    floor = 1e-16 * np.sqrt(np.abs(u) @ (abs(discrete.matrix) @ np.abs(u)))
    error = v - u
    return max(float(np.sqrt(max(error @ (discrete.matrix @ error), 0.0))) - 10 * floor, 0.0) / size if size else np.nan


def run(context: Context) -> Section:
    """The campaign."""
    cases = QUICK_CASES if context.quick else CASES
    rows = context.study(measure, {"family": list(FAMILIES), "seed": list(range(FIRST_SEED, FIRST_SEED + cases))})
    tables = [outcomes(rows[rows["family"] == family]).assign(bodies=family) for family in FAMILIES]
    table = pd.concat(tables, ignore_index=True)
    table.insert(0, "bodies", table.pop("bodies"))
    ratios = ("median error", "99 %", "largest error")
    note = (f"Wrong: CONVERGED with a true error above {ALLOWED:g} rtol; failed: the status says that the tolerance "
            "was not reached; refused: before any work. Errors: true error over rtol of what converged; 99 %: "
            "quantile. Certificate: its energy error over the true error, least and most, of true errors above .01 "
            f"rtol. Single grids, and the monotone correction in 3D, only up to {SWEPT} nodes.")
    return Section("True errors", __doc__.split("\n\n")[1],
                   [Table("true_errors", table, "Random problems, rtol from 1e-10 to 1e-3: outcomes by method", note,
                          dict.fromkeys(ratios, "rtol"),
                          dict.fromkeys((*ratios, "certificate, least", "certificate, most"), ".2g"))],
                   summary=summary(rows, table), seeds=f"{FIRST_SEED} to {FIRST_SEED + cases - 1}")


def summary(rows: pd.DataFrame, table: pd.DataFrame) -> str:
    """What was asked and what came out."""
    kinds = rows["kind"].notna().sum() if "kind" in rows else 0
    said = (f"Does CONVERGED mean what it says? Of {len(rows)} random problems {kinds} could be posed on their meshes; "
            f"of {table['runs'].sum()} runs {table['converged'].sum()} converged, with a true energy error of "
            f"{table['largest error'].max():.2f} rtol at most, {table['failed'].sum()} said that they did not, and "
            f"{table['refused'].sum()} were refused. ")
    wrong = table["wrong"].sum()
    return said + (f"{wrong} said so wrongly." if wrong else "None said so wrongly.")


def outcomes(rows: pd.DataFrame) -> pd.DataFrame:
    """Counts by method."""
    result = []
    for name in [column.removesuffix(": status") for column in rows if column.endswith(": status")]:
        status, error = rows[f"{name}: status"].dropna(), rows[f"{name}: error"].astype(float)
        good = error[rows[f"{name}: status"] == "CONVERGED"]
        ratio = (rows[f"{name}: certificate"].astype(float) / error)[error > 0.01]
        result.append({"method": name, "runs": len(status), "refused": int((status == "REFUSED").sum()),
                       "converged": len(good), "failed": int((~status.isin(["CONVERGED", "REFUSED"])).sum()),
                       "stalled": int((status == "STALLED").sum()), "wrong": int((~(good <= ALLOWED)).sum()),
                       "median error": float(good.median()),
                       "99 %": float(good.quantile(0.99)), "largest error": float(good.max()),
                       "certificate, least": float(ratio.min()), "certificate, most": float(ratio.max())})
    return pd.DataFrame(result)


if __name__ == "__main__":
    main(run, __doc__.split("\n")[0] + " Example: python studies/true_errors.py --quick --out /tmp/true_errors")
