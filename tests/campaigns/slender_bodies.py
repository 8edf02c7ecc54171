"""Random slender and folded bodies for the campaign, cut out of a lattice: springs, combs, rings,
frames, beams.

Where a body is folded, what is near in space is far along it. Also bodies of which a part of the
contact boundary stays thousands of displacements away from its obstacle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import adaptmg as am
from adaptmg.mesh.arrays import facet_table

KINDS = ("spring", "comb", "ring", "frame", "beam")
PLANE, SOLID = {"young": 2.1e11, "poisson": 0.3}, am.Solid(young=2.1e11, poisson=0.3)


def cut_out(
    cells: np.ndarray, side: float, divisions: int, origin: tuple[float, ...]
) -> am.MeshArrays:
    """Triangulate the cells (True) of a lattice, each divided; 'bottom' and 'top' are the lowest
    and highest sides."""
    dim, shape = cells.ndim, np.array(cells.shape)
    lengths = dict(
        zip(
            ("width", "height") if dim == 2 else ("width", "depth", "height"),
            side * shape,
            strict=True,
        )
    )
    whole = am.mesh.structured(
        (am.Rectangle if dim == 2 else am.Box)(**lengths), [int(n) for n in divisions * shape]
    )
    centres = whole.points[whole.elements].mean(axis=1)
    elements = whole.elements[cells[tuple(np.floor(centres / side).astype(int).T)]]
    used, elements = np.unique(elements, return_inverse=True)
    elements, points = elements.reshape(-1, dim + 1).astype(np.int32), whole.points[used]
    table = facet_table(elements, len(points))
    facets = table.facets[table.counts == 1]
    middle = points[facets].mean(axis=1)[:, -1]
    low, high = (
        middle < points[:, -1].min() + 1e-9 * side,
        middle > points[:, -1].max() - 1e-9 * side,
    )
    return am.MeshArrays(
        points + np.asarray(origin),
        elements,
        facets,
        np.where(low, 0, np.where(high, 1, 2)),
        ("bottom", "top", "rest"),
    )


def spring(arms: int = 8, length: int = 40) -> np.ndarray:
    """The cells of a serpentine on a foot: arms one cell thick, a cell apart, joined at alternating
    ends."""
    cells = np.zeros((length, 2 * arms), dtype=bool)
    cells[:, 1::2] = True
    cells[-1, 2::4] = cells[0, 4::4] = cells[:4, 0] = True
    return cells


def random_cells(rng: np.random.Generator, kind: str) -> np.ndarray:
    """Cells of a plane body; its foot is the lowest row."""
    length = int(rng.integers(20, 41))
    if kind == "spring":
        return spring(int(rng.integers(2, 8)), length)
    if kind == "beam":
        # supported at one end above, its foot at the other
        cells = np.zeros((int(rng.integers(20, 201)), 3), dtype=bool)
        cells[:, 1], cells[0, 2], cells[-1, 0] = True, True, True
        return cells
    teeth = int(rng.integers(2, 7))
    if kind == "comb":
        cells = np.zeros((4 * teeth - 1, length), dtype=bool)
        cells[::4], cells[:, -1] = True, True
        return cells
    width = int(rng.integers(8, 25))
    cells = np.zeros((width, length), dtype=bool)
    cells[[0, -1]] = cells[:, [0, -1]] = True
    if kind == "frame":
        cells[:, rng.integers(2, length - 2, 2)] = True
    return cells


@dataclass(frozen=True)
class Steps:
    """A gap of zero below one part of the foot, and wide below the rest."""

    where: float
    gap: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Gaps (n,), m."""
        return np.where(points[:, 0] <= self.where, 0.0, self.gap)


def _law(rng: np.random.Generator) -> Any:
    friction = float(rng.choice([0.1, 0.3, 0.7, 1.0]))
    return [
        am.Coulomb(friction),
        am.Coulomb(friction),
        am.Frictionless(),
        am.Tresca(float(10 ** rng.uniform(2, 5))),
    ][rng.integers(4)]


def random_slender(seed: int) -> am.Hierarchy:
    """A random slender body on a plane, its top pressed down and moved aside; or on an elastic
    block."""
    rng = np.random.default_rng((seed, 16))
    kind, space = (
        str(rng.choice(KINDS)),
        str(rng.choice(["plane", "plane", "axisymmetric", "3D", "pair"])),
    )
    cells, side = random_cells(rng, kind), float(10 ** rng.uniform(-4, -2))
    law, dim = _law(rng), 3 if space == "3D" else 2
    if dim == 3:
        cells = np.repeat(cells[:, None, :], int(rng.integers(1, 3)), axis=1)
    press = side * float(10 ** rng.uniform(-2, -0.5))
    moved = {
        "x": 0.0 if space == "axisymmetric" else press * float(rng.uniform(-0.5, 0.5)),
        "zy"[dim == 2]: -press,
    }
    moved |= {"y": 0.0} if dim == 3 else {}
    material = (
        SOLID
        if dim == 3
        else (am.Axisymmetric if space == "axisymmetric" else am.PlaneStrain)(**PLANE)
    )
    origin = (side * float(rng.uniform(1, 100)) if space == "axisymmetric" else 0.0,) + (0.0,) * (
        dim - 1
    )
    divisions = (1, 2) if dim == 3 else (1, 2, 4)
    meshes = [cut_out(cells, side, k, origin) for k in divisions]
    flat = am.Plane(point=(0.0,) * dim, normal=(0.0,) * (dim - 1) + (1.0,))
    if space != "pair":
        problem = am.ContactProblem(
            name=kind,
            material=material,
            law=law,
            contact=am.Contact("bottom", flat),
            supports=(am.Support("top", **moved),),
        )
    else:
        block = np.ones((cells.shape[0] + 4, 3), dtype=bool)
        low = [
            cut_out(block, side, max(k, 1), (-2 * side + 0.1 * side, -3 * side)) for k in divisions
        ]
        meshes = [
            am.mesh.merged({"upper": up, "lower": down})
            for up, down in zip(meshes, low, strict=True)
        ]
        problem = am.ContactProblem(
            name=f"{kind} on a block",
            law=law,
            contact=am.ContactPair("upper.bottom", "lower.top"),
            material={"upper": material, "lower": material},
            supports=(am.Support("upper.top", **moved), am.Support("lower.bottom", x=0.0, y=0.0)),
        )
    return am.Hierarchy.from_meshes(problem, meshes)


def random_gaps(seed: int) -> am.Hierarchy:
    """A random plane body, most of its foot a thousand to a hundred thousand displacements above
    the obstacle."""
    rng = np.random.default_rng((seed, 17))
    law, side, n = _law(rng), 40e-3, int(rng.integers(2, 6))
    pressure = float(10 ** rng.uniform(5, 8))
    moves = pressure * side / PLANE["young"]
    loads = [am.Pressure("top", pressure)]
    if rng.random() < 0.7:
        loads.append(am.Pressure("left", pressure * float(rng.uniform(-0.5, 1))))
    gap = Steps(side * float(rng.uniform(0.3, 0.7)), moves * float(10 ** rng.uniform(3, 5)))
    problem = am.ContactProblem(
        name="step",
        domain=am.Rectangle(width=side, height=side),
        material=am.PlaneStrain(**PLANE),
        law=law,
        contact=am.Contact("bottom", am.GapFunction(gap)),
        loads=tuple(loads),
        supports=(am.Support("right", x=0.0),),
    )
    return am.Hierarchy.uniform(problem, [n * 2**k for k in range(4)])
