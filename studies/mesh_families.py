"""Families of meshes that the studies compare, by name, and what every row says of its grid and its solve."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import common
import numpy as np
import pandas as pd

import adaptmg as am
from adaptmg.mesh import MeshArrays, refine_near, sized, structured

SIDE = 40e-3
RTOL = 1e-8


def halvings(count: int) -> tuple[float, ...]:
    """20 mm, 10 mm, ... (count + 1 sizes), m."""
    return tuple(0.5 * SIDE / 2**k for k in range(count + 1))


def powers(first: int, last: int) -> tuple[int, ...]:
    """first, 2 first, ... last, at least two of them."""
    return tuple(first * 2**k for k in range(round(math.log2(last / first)) + 1))


def to_the_corner(problem: am.ContactProblem, size: float) -> MeshArrays:
    """A Netgen mesh with h = size sqrt(r / a), r the distance from the foot (0, 0), for r > size^2 / a."""
    def wanted(x: np.ndarray) -> np.ndarray:
        return size * np.sqrt(np.maximum(np.hypot(x[:, 0], x[:, 1]) / SIDE, (size / SIDE)**2))

    return sized(problem.domain, wanted, size, 1)


def grids_of(problem: am.ContactProblem, family: str, fineness: int) -> am.Hierarchy:
    """The hierarchy of a row; every mesh has its own coarser ones."""
    if family == "uniform":
        return am.Hierarchy.uniform(problem, powers(2 if fineness == 4 else 4, fineness))
    if family == "8 cells, contact line bisected":
        with warnings.catch_warnings():
            # that the last levels hardly help is what its rows show
            warnings.filterwarnings("ignore", "bisected, levels=", UserWarning)
            return am.Hierarchy.bisected(problem, structured(problem.domain, 8), fineness)
    if family in ("halved, contact line bisected 3x", "Netgen, to the corner"):
        begin = time.perf_counter()
        if family == "Netgen, to the corner":
            meshes = [to_the_corner(problem, size) for size in halvings(fineness)]
        else:
            meshes = [structured(problem.domain, n) for n in powers(4, fineness)]
            meshes += refine_near(meshes[-1], problem.contact_boundaries, 3)[1:]
        seconds = time.perf_counter() - begin
        hierarchy = am.Hierarchy.from_meshes(problem, meshes)
        return replace(hierarchy, timings=hierarchy.timings | {"mesh": seconds + hierarchy.timings["mesh"]})
    ratio = 1 if family == "Netgen, not graded" else int(family.split()[-2].removesuffix("x"))
    return am.Hierarchy.graded(problem, halvings(fineness), contact_ratio=ratio)


def costs(hierarchy: am.Hierarchy, result: am.Result) -> dict[str, Any]:
    """What every row says of its grid and its solve."""
    spacing = np.diff(np.sort(result.contact.x[:, 0]))
    ratios = [level.mesh_ratio for level in hierarchy.levels[1:]]
    return {"nodes": hierarchy.finest.discrete.n_nodes, "contact_nodes": len(result.contact), "levels": len(hierarchy),
            "contact_h": float(np.median(spacing)), "mesh_ratio": max(ratios, default=float("nan")),
            "cycles": result.cycles, "rate": result.rate, "work_units": result.work_units,
            "start_work_units": result.start_work_units, **common.seconds_by_phase(hierarchy, result),
            "residual": result.residual, "outcome": result.status.name}


def study_families(context: common.Context, function: Any, families: Mapping[str, tuple[int, ...]]) -> pd.DataFrame:
    """One table of all families, which differ in what fineness means."""
    return pd.concat([context.study(function, {"family": [name], "fineness": values}, rtol=RTOL)
                      for name, values in families.items()], ignore_index=True)
