"""Random problems behind 47 000 nodes of another body: equal to those of the body alone.

Products of such numbers leave 32 bits. By turns bodies on obstacles and pairs of bodies (2D and 3D),
nearly incompressible ones of smoothed elements, bodies that contact alone holds, stacks with all
features (pairs, ties, cracks, springs, supports, moving obstacles, forces at points, body forces,
initial strains, linear and smoothed elements, plane and solid), turned and scaled, and periodic
cells. Both are solved by the active set method to 1e-10. A fault is a displacement or a reaction
that differs by more than 1e-9 of the largest one.

    python tests/campaigns/embedded.py [--first SEED] [--count N] [--out DIR]
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from campaign import main
from random_problems import random_floating, random_problem, random_rubber

import adaptmg as am

sys.path.append(str(Path(__file__).parents[1] / "helpers"))
from behind import mesh_behind, problem_behind

#: nodes of a body alone at most, and difference that counts as none
MOST, ALLOWED = 1500, 1e-9
SOLVER = am.ActiveSet(rtol=1e-10)
Posed = tuple[am.ContactProblem, am.MeshArrays]


def coarse(grids: am.Hierarchy) -> Posed:
    """The problem on the finest mesh that is small enough."""
    meshes = [level.mesh for level in grids.levels if level.n_nodes <= MOST]
    return grids.problem, meshes[-1] if meshes else grids.levels[0].mesh


def material(rng: np.random.Generator, dim: int, smoothed: bool) -> am.Solid | am.PlaneStrain:
    """Nearly incompressible ones only where elements are smoothed."""
    poisson = float(rng.choice([0.2, 0.3, 0.45, 0.4999]) if smoothed else rng.uniform(0.0, 0.4))
    return (am.Solid if dim == 3 else am.PlaneStrain)(
        young=float(10 ** rng.uniform(9, 11.5)), poisson=poisson
    )


def stack(rng: np.random.Generator) -> Posed:
    """Three blocks on each other, pressed by a wall that comes down."""
    dim = 3 if rng.random() < 0.35 else 2
    smoothed = bool(rng.random() < 0.3)
    kind, depth = (am.Rectangle, {}) if dim == 2 else (am.Box, {"depth": 1.0})
    parts = {
        name: kind(width=1.0, height=0.5, origin=(*[0.0] * (dim - 1), low), **depth)
        for name, low in (("upper", 1.0), ("middle", 0.5), ("lower", 0.0))
    }
    cells = {name: int(rng.integers(2, 5 if dim == 3 else 9)) for name in parts}
    pairs = [am.ContactPair("upper.bottom", "middle.top")]
    cracked = dim == 2 and rng.random() < 0.5
    if cracked:
        cells["middle"] = 2 * int(rng.integers(2, 5))
    mesh = am.mesh.structured(am.Assembly(parts=parts), cells)
    if cracked:
        length = np.arange(1, cells["middle"]) / cells["middle"]
        at = np.column_stack([length, np.full(len(length), 0.75)])
        row = [int(np.argmin(np.linalg.norm(mesh.points - x, axis=1))) for x in at]
        mesh = am.mesh.split(mesh, np.column_stack([row[:-1], row[1:]]))
        pairs.append(am.ContactPair("crack.left", "crack.right"))
    size = float(10 ** rng.uniform(-3, 1))
    turn = np.linalg.qr(rng.standard_normal((dim, dim)))[0]
    turn[0] *= np.linalg.det(turn)
    mesh = replace(mesh, points=size * (mesh.points @ turn.T + rng.normal(size=dim)))
    top = mesh.surface("upper.top")
    motion = size * (turn @ np.append(rng.uniform(-2e-5, 2e-5, dim - 1), -1e-4))
    wall = am.Plane(top.points[top.facets[0, 0]], -turn[:, -1])
    pressed = am.Contact("upper.top", am.Moving(wall, displacement=tuple(motion)))
    below = ("middle.bottom", "lower.top")
    tied = rng.random() < 0.6
    normal = float(10 ** rng.uniform(10, 12)) / size
    if rng.random() < 0.5:
        foot = am.Spring("lower.bottom", normal=normal, tangential=0.5 * normal)
    else:
        foot = am.Support("lower.bottom", **dict.fromkeys("xyz"[:dim], 0.0))
    sides = [
        am.Spring(f"{name}.right", normal=1e-2 * normal, tangential=1e-2 * normal)
        for name in ("upper", "middle")
    ]
    corner = mesh.points[mesh.boundary_nodes("upper.top")[0]]
    loads = [
        am.Pressure("middle.left", float(rng.uniform(0, 2e6))),
        am.BodyForce(tuple(rng.uniform(-1e5, 1e5, dim) / size), body="lower"),
        am.PointForce(tuple(corner), tuple(1e4 * size ** (dim - 1) * turn[:, 0])),
        am.InitialStrain("middle", (float(rng.uniform(-1e-5, 1e-5)),) * 3),
    ]
    return am.ContactProblem(
        material={name: material(rng, dim, smoothed) for name in parts},
        law=am.Coulomb(float(rng.uniform(0.05, 0.5))),
        elements="smoothed" if smoothed else "linear",
        contact=[*pairs, pressed, *([] if tied else [am.ContactPair(*below)])],
        ties=[am.Tied(*below)] if tied else [],
        loads=[load for load in loads if rng.random() < 0.6],
        supports=[foot, *sides],
    ), mesh


def cell(rng: np.random.Generator) -> Posed:
    """A skewed periodic cell with a prescribed jump, on springs or in front of a plane."""
    dim = 3 if rng.random() < 0.35 else 2
    block = am.Rectangle(width=1, height=1) if dim == 2 else am.Box(width=1, depth=1, height=1)
    mesh = am.mesh.structured(block, int(rng.integers(3, 6 if dim == 3 else 12)))
    skew = np.eye(dim) + 0.3 * np.tril(rng.uniform(-1, 1, (dim, dim)), -1)
    size = float(10 ** rng.uniform(-3, 1))
    mesh = replace(mesh, points=size * mesh.points @ skew)
    floor = am.Plane((0.0,) * dim, (*[0.0] * (dim - 1), 1.0))
    stiff = float(10 ** rng.uniform(10, 12)) / size
    return am.ContactProblem(
        material=material(rng, dim, False),
        law=am.Coulomb(0.3),
        contact=[am.Contact("bottom", floor)] if dim == 3 or rng.random() < 0.5 else [],
        ties=am.Periodic("left", "right", jump=tuple(size * rng.uniform(-1e-4, 1e-4, dim))),
        loads=am.Pressure("top", float(rng.uniform(1e6, 1e7))),
        supports=am.Spring("top", normal=stiff, tangential=stiff),
    ), mesh


FAMILIES = {
    "body or pair": lambda seed: coarse(random_problem(seed)),
    "rubber": lambda seed: coarse(random_rubber(seed)),
    "floating": lambda seed: coarse(random_floating(seed)),
    "stack": lambda seed: stack(np.random.default_rng((seed, 63))),
    "stack again": lambda seed: stack(np.random.default_rng((seed, 64))),
    "periodic cell": lambda seed: cell(np.random.default_rng((seed, 65))),
}


def solved(problem: am.ContactProblem, mesh: am.MeshArrays) -> am.Result | str:
    """The result, or why there is none."""
    try:
        return am.solve(am.Hierarchy.from_meshes(problem, [mesh]), SOLVER, throw=False)
    except ValueError as error:
        return str(error)[:60]


def measure(seed: int) -> dict[str, Any]:
    """One problem, alone and behind the other body."""
    family = list(FAMILIES)[seed % len(FAMILIES)]
    row: dict[str, Any] = {"family": family, "faults": "", "why": "", "difference": 0.0, "nodes": 0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        problem, mesh = FAMILIES[family](seed)
        row["nodes"] = mesh.n_nodes
        alone = solved(replace(problem, domain=None, reference={}), mesh)
        whole, n = mesh_behind(mesh)
        behind = solved(problem_behind(problem, whole), whole)
    if isinstance(alone, str) or isinstance(behind, str):
        row["why"] = f"refused: {alone}" if isinstance(alone, str) else ""
        if isinstance(alone, str) != isinstance(behind, str):
            row["faults"] = f"one is refused, the other is not: {alone} {behind}"
        return row
    row["why"] = alone.status.name
    for name in ("displacement", "reaction"):
        own, other = getattr(alone, name), getattr(behind, name)[n:]
        difference = float(np.abs(own - other).max() / np.abs(own).max())
        row["difference"] = max(row["difference"], difference)
    if alone.status is not behind.status:
        row["faults"] = f"{alone.status.name} alone, {behind.status.name} behind"
    elif not row["difference"] <= ALLOWED:
        row["faults"] = f"differs by {row['difference']:.2g}"
    return row


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """One row a family."""
    table = table.assign(
        faulty=table["faults"] != "", refused=table["why"].str.startswith("refused")
    )
    return (
        table.groupby("family")
        .agg(
            problems=("seed", "size"),
            refused=("refused", "sum"),
            faulty=("faulty", "sum"),
            difference=("difference", "max"),
            nodes=("nodes", "max"),
        )
        .reset_index()
    )


if __name__ == "__main__":
    main(measure, summary, range(300))
