"""Does CONVERGED mean what it says? The true error of every method on random problems.

    python tests/campaigns/true_errors.py [--first SEED] [--count N] [--out DIR]

By turns bodies on obstacles and pairs of bodies (2D and 3D, nested and independent meshes,
prescribed displacements, friction up to 2, rtol from 1e-3 to 1e-10), slender and folded bodies
(rtol from .3 to 1e-8), bodies with gaps of 1e3 to 1e5 displacements, bodies that contact alone
holds, heated or not (rtol from .3 to 1e-8), and smoothed elements with Poisson's ratios from .4 to
.5. The true error is the A-norm of the difference to the exact discrete solution nearest to the
result (found by Newton steps from it, as there may be several) over the A-norm of that, without
what expands freely. A fault is a result that says CONVERGED with a true error above 1.5 times rtol.
Bodies that contact cannot hold are refused before any work."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pandas as pd
from campaign import main
from random_problems import random_floating, random_problem, random_rubber
from slender_bodies import random_gaps, random_slender

import adaptmg as am
from adaptmg.solver.examine import displacement_norm

#: random problem and range of the exponent of rtol, by family
FAMILIES = {
    "compact": (random_problem, (-10, -3)),
    "slender": (random_slender, (-8, -0.5)),
    "wide gaps": (random_gaps, (-8, -3)),
    "floating": (random_floating, (-8, -0.5)),
    "rubber": (random_rubber, (-9, -3)),
}
#: times rtol that the true error may be
ALLOWED = 1.5
#: nodes up to which sweeps on one grid, and the monotone correction in 3D, are tried
SWEPT = 1200


def methods(rtol: float, nodes: int, dim: int, levels: int) -> dict[str, Any]:
    """Every method, with a tolerance."""
    made = {
        "active set": am.ActiveSet(rtol=rtol),
        "active set, sparse": am.ActiveSet(rtol=rtol, condensed=False),
        "active set, AMG": am.ActiveSet(rtol=rtol, linear=am.AMG(), condensed=False),
    }
    if levels > 1:
        made |= {
            "default, nested": am.FullMultigrid(rtol=rtol),
            "default, from zero": am.Multigrid(rtol=rtol),
        }
    if levels > 1 and (dim == 2 or nodes <= SWEPT):
        made |= {
            "monotone, nested": am.FullMultigrid(rtol=rtol, correction=am.Monotone()),
            "monotone, from zero": am.Multigrid(rtol=rtol, correction=am.Monotone()),
        }
    if nodes <= SWEPT:
        made |= {
            "single grid, omega 1.8": am.SingleGrid(rtol=rtol, omega=1.8, max_sweeps=20_000),
            "single grid, condensed": am.SingleGrid(rtol=rtol, condensed=True, max_sweeps=20_000),
        }
    return made


def measure(seed: int) -> dict[str, Any]:
    """Statuses, and errors and certificates over rtol, of all methods on one problem, by method."""
    family = list(FAMILIES)[seed % len(FAMILIES)]
    make, exponents = FAMILIES[family]
    rtol = float(10 ** np.random.default_rng((seed, 8)).uniform(*exponents))
    row: dict[str, Any] = {"family": family, "rtol": rtol, "faults": ""}
    try:
        grids = make(seed)
    except ValueError as error:
        return row | {"why": str(error)[:200]}  # a random mesh may be too coarse for its contact
    problem, nodes = grids.problem, grids.finest.n_nodes
    row |= {"problem": problem.name, "law": type(problem.law).__name__, "nodes": nodes}
    exact: list[am.Result] = []
    for name, method in methods(rtol, nodes, grids.finest.discrete.dim, len(grids)).items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                result = am.solve(grids, method, throw=False)
            except (ValueError, np.linalg.LinAlgError) as error:
                row |= {f"{name}: status": "REFUSED", "why": str(error)[:200]}
                continue
            error = _error(grids, result, exact) / result.rtol if result.status.ok else np.nan
        row |= {
            f"{name}: status": result.status.name,
            f"{name}: error": error,
            f"{name}: cycles": result.cycles,
            f"{name}: certificate": result.certificate().energy_error / result.rtol,
        }
        if result.status.ok and not error <= ALLOWED:
            row["faults"] += f"{name}: error of {error:.2g} rtol; "
    return row


def _error(grids: am.Hierarchy, result: am.Result, known: list[am.Result]) -> float:
    """The error relative to the nearest exact solution; solutions found are added to ``known``."""
    least = min((_distance(grids, result, exact) for exact in known), default=np.inf)
    if least <= ALLOWED * result.rtol:
        return least
    # Newton steps may cycle, and multigrid go to another solution
    tight, methods = 1e-3 * result.rtol, [am.ActiveSet(rtol=1e-13, max_steps=25)]
    methods += [am.Multigrid(rtol=tight), am.SingleGrid(rtol=tight, condensed=True)]
    for method in methods[: None if len(result.displacement) <= SWEPT else 2]:
        try:
            exact = am.solve(grids, method, start=result, throw=False)
        except ValueError:
            continue  # a single level
        if exact.certificate(grids.finest.discrete, bound=True).energy_error <= 0.1 * result.rtol:
            known.append(exact)
            least = min(least, _distance(grids, result, exact))
            if least <= ALLOWED * result.rtol:
                break
    return least


def _distance(grids: am.Hierarchy, result: am.Result, exact: am.Result) -> float:
    discrete = grids.finest.discrete
    u, v = (discrete.relative(one.displacement).reshape(-1) for one in (exact, result))
    size, pressures = displacement_norm(discrete, u), 0.0
    if len(discrete.volumes):
        size = np.hypot(size, np.sqrt(discrete.volumes.energy(exact.pressures)))
        pressures = np.sqrt(discrete.volumes.energy(result.pressures - exact.pressures))
    # the A-norm of a rounding of the displacement, which no error can be below
    floor = 1e-16 * np.sqrt(np.abs(u) @ (abs(discrete.matrix) @ np.abs(u)))
    error = np.hypot(np.sqrt(max((v - u) @ (discrete.matrix @ (v - u)), 0.0)), pressures)
    return max(float(error) - 10 * floor, 0.0) / size if size else np.nan


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Counts by family and method; errors over rtol of what converged, the certificate's over the
    true ones."""
    lines = []
    for family, mine in rows.groupby("family", sort=False):
        for name in [
            column.removesuffix(": status") for column in rows if column.endswith(": status")
        ]:
            status = mine[f"{name}: status"].dropna()
            error = mine[f"{name}: error"].astype(float)
            ratio = (mine[f"{name}: certificate"].astype(float) / error)[error > 0.01]
            lines.append(
                {
                    "family": family,
                    "method": name,
                    "runs": len(status),
                    "refused": (status == "REFUSED").sum(),
                    "converged": (status == "CONVERGED").sum(),
                    "wrong": (error > ALLOWED).sum(),
                    "median error": error.median(),
                    "largest": error.max(),
                    "certificate, least": ratio.min(),
                    "most": ratio.max(),
                    "most cycles": mine[f"{name}: cycles"].max(),
                }
            )
    return pd.DataFrame(lines)


if __name__ == "__main__":
    main(measure, summary, range(50_000, 50_180))
