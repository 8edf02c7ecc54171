"""Random rounded shapes, graded towards all or part of their rims: no fans, no long edges, exact
rims.

Discs, ovals, ellipses, rounded polygons, rings, plates with a hole and lenses; contact on all or
part of the rim, ratios from 1 to 64; turned, scaled from 1e-5 to 1e3 m, up to 1000 diameters from
the origin. Sizes are measured against points laid along the rim, areas against the polygon through
these, both without the mesher. `python tests/campaigns/rounded_shapes.py [--count N]`"""

from __future__ import annotations

import math
import time
import warnings
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from campaign import main
from scipy.spatial import cKDTree

import adaptmg as am

#: longest edge over the size, but for a hundredth of the edges; edges at a node at most: a disc whose
#: size is near its radius is one node and the 17 chords around it
LONG, EDGES = 2.0, 18
#: points along each contact edge, in sizes at contact; chords along each arc of areas
FINE, CHORDS = 8, 4000
#: area between an arc of 35 degrees, the most that an edge spans, and its chord, over its square
CUT_OFF = 0.055


class Shape:
    """Loops of edges in a plane, to be turned, scaled and shifted."""

    def __init__(self) -> None:
        self.vertices: list[np.ndarray] = []
        self.names: list[str] = []
        self.centres: dict[int, np.ndarray] = {}
        self.starts: list[int] = []

    def add(self, loop: list[tuple[np.ndarray, np.ndarray | None, str]]) -> Shape:
        """Append a loop of vertices, the centres of the arcs that begin there and their names."""
        self.starts.append(len(self.vertices))
        for vertex, centre, name in loop:
            if centre is not None:
                self.centres[len(self.vertices)] = np.asarray(centre)
            self.vertices.append(np.asarray(vertex))
            self.names.append(name)
        return self

    def placed(self, turn: np.ndarray, offset: np.ndarray) -> am.Outline:
        """The outline after a linear map and a shift."""
        centres = {i: tuple(turn @ c + offset) for i, c in self.centres.items()}
        return am.Outline(
            vertices=[tuple(turn @ v + offset) for v in self.vertices],
            boundaries=tuple(self.names),
            arcs=centres,
            holes=tuple(self.starts[1:]),
        )


def at(radius: float, angle: float) -> np.ndarray:
    """A point by its polar coordinates."""
    return radius * np.array([math.cos(angle), math.sin(angle)])


def circle(
    rng: np.random.Generator, centre: np.ndarray, radius: float, way: int, part: bool
) -> list:
    """A loop of arcs of random lengths, of which one bears the contact if it is a part of it."""
    n = int(rng.integers(3, 9))
    shares = rng.uniform(0.5, 1.0, n)
    angles = rng.uniform(0, 7) + way * 2 * np.pi * np.cumsum(shares) / shares.sum()
    return [
        (centre + at(radius, angle), centre, "rim" if i == 0 or not part else "free")
        for i, angle in enumerate(angles)
    ]


def disc(rng: np.random.Generator, part: bool) -> Shape:
    return Shape().add(circle(rng, np.zeros(2), 1.0, 1, part))


def ring(rng: np.random.Generator, part: bool) -> Shape:
    """Eccentric, its wall as thin as a tenth of the radius."""
    inner = float(rng.uniform(0.1, 0.85))
    centre = at(rng.uniform(0, 0.9) * (1 - inner - 0.1) if inner < 0.9 else 0.0, 1.0)
    outer = circle(rng, np.zeros(2), 1.0, 1, part)
    if rng.random() < 0.5:
        outer = [(vertex, about, "free") for vertex, about, _ in outer]
    return Shape().add(outer).add(circle(rng, centre, inner, -1, part))


def plate(rng: np.random.Generator, part: bool) -> Shape:
    """A square with a round hole, as around a pin."""
    half = float(rng.uniform(1.3, 5))
    corners = [(half * np.array(c), None, "free") for c in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return Shape().add(corners).add(circle(rng, np.zeros(2), 1.0, -1, part))


def lens(rng: np.random.Generator, part: bool) -> Shape:
    """Two arcs between two points."""
    tips = np.array([-1.0, 0.0]), np.array([1.0, 0.0])
    low, high = rng.uniform(0.15, 3.0, 2)
    return Shape().add(
        [
            (tips[0], np.array([0.0, low]), "rim"),
            (tips[1], np.array([0.0, -high]), "free" if part else "rim"),
        ]
    )


def oval(rng: np.random.Generator, part: bool) -> Shape:
    """Four arcs that meet with the same tangent."""
    small = float(rng.uniform(0.15, 0.9))  # radius at both ends
    apart = float(rng.uniform(0.1, 2.0))  # of their centres from the middle
    angle = float(rng.uniform(0.2, 1.3))  # half of that of the arcs at the ends
    height = apart * math.tan(angle)
    right, left = np.array([apart, 0.0]), np.array([-apart, 0.0])
    below, above = np.array([0.0, -height]), np.array([0.0, height])
    loop = [
        (right + at(small, -angle), right, "rim"),
        (right + at(small, angle), below, "rim"),
        (left + at(small, np.pi - angle), left, "rim"),
        (left + at(small, np.pi + angle), above, "rim"),
    ]
    return Shape().add(
        [(v, c, "free" if part and i else name) for i, (v, c, name) in enumerate(loop)]
    )


def rounded(rng: np.random.Generator, part: bool) -> Shape:
    """A convex polygon whose corners are arcs."""
    n = int(rng.integers(3, 8))
    shares = rng.uniform(0.6, 1.0, n)
    angles = 2 * np.pi * np.cumsum(shares) / shares.sum()
    corners = [at(1.0, angle) for angle in angles]
    sides = [np.linalg.norm(b - a) for a, b in pairwise([*corners, corners[0]])]
    loop = []
    cut = float(rng.uniform(0.05, 0.45)) * min(sides)
    for i, corner in enumerate(corners):
        before, after = corners[i - 1] - corner, corners[(i + 1) % n] - corner
        first, last = cut * before / np.linalg.norm(before), cut * after / np.linalg.norm(after)
        # the centre lies on the bisector, at right angles to both sides at the ends
        centre = corner + (first + last) * cut**2 / (cut**2 + first @ last)
        round_name = "rim" if not part or i % 2 else "free"
        loop += [(corner + first, centre, round_name), (corner + last, None, "rim")]
    return Shape().add(loop)


def ellipse(rng: np.random.Generator, part: bool) -> Shape:
    """Up to ten times as long as wide, of straight edges, many of them shorter than the sizes."""
    n = int(rng.integers(12, 120))
    angles = rng.uniform(0, 7) + 2 * np.pi * np.arange(n) / n
    width = 10 ** rng.uniform(-1, 0)
    return Shape().add(
        [
            (at(1.0, angle) * (1, width), None, "rim" if not part or i < n / 3 else "free")
            for i, angle in enumerate(angles)
        ]
    )


SHAPES = (disc, ring, plate, lens, oval, rounded, ellipse)


def points_along(outline: am.Outline, edge: int, n: int) -> np.ndarray:
    """Points of an edge, from its ends and its centre."""
    a = np.array(outline.vertices[edge])
    b = np.array(outline.vertices[outline.following[edge]])
    t = np.linspace(0, 1, n + 1)[:, None]
    if edge not in outline.arcs:
        return a + t * (b - a)
    centre = np.array(outline.arcs[edge])
    u, v = a - centre, b - centre
    angle = math.atan2(u[0] * v[1] - u[1] * v[0], u @ v)
    across = np.array([-u[1], u[0]])
    return centre + np.cos(angle * t) * u + np.sin(angle * t) * across


def distance_to_line(outline: am.Outline, edge: int, points: np.ndarray) -> np.ndarray:
    """The distance of points to the line or circle of an edge."""
    a = np.array(outline.vertices[edge])
    if edge in outline.arcs:
        centre = np.array(outline.arcs[edge])
        radius = np.linalg.norm(a - centre)
        return np.abs(np.linalg.norm(points - centre, axis=1) - radius)
    along = np.array(outline.vertices[outline.following[edge]]) - a
    normal = np.array([along[1], -along[0]]) / np.linalg.norm(along)
    return np.abs((points - a) @ normal)


def faults_of(
    mesh: am.MeshArrays, outline: am.Outline, size: float, ratio: float, row: dict[str, Any]
) -> str:
    """What is wrong with a mesh, and its figures."""
    near = size / ratio
    edges = range(len(outline.vertices))
    coarse = [points_along(outline, i, CHORDS) for i in edges]
    rim = []
    for i in edges:
        length = np.linalg.norm(np.diff(coarse[i], axis=0), axis=1).sum()
        if outline.boundaries[i] == "rim":
            rim.append(points_along(outline, i, math.ceil(FINE * length / near)))
    tree = cKDTree(np.concatenate(rim))
    ends = np.unique(np.sort(mesh.elements[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0)
    a, b = mesh.points[ends[:, 0]], mesh.points[ends[:, 1]]
    sizes = np.full(len(ends), size)
    if ratio > 1:
        sizes = np.minimum(size, near + 0.3 * tree.query(0.5 * (a + b))[0])
    relative = np.linalg.norm(b - a, axis=1) / sizes
    origin = mesh.points[0]
    loops = np.concatenate([points[:-1] for points in coarse]) - origin
    following = np.concatenate([points[1:] for points in coarse]) - origin
    area = 0.5 * float(np.sum(loops[:, 0] * following[:, 1] - loops[:, 1] * following[:, 0]))
    most = int(np.bincount(ends.ravel()).max())
    long = float((relative > LONG).mean())
    row["edges"] = max(row["edges"], most)
    row["long"] = max(row["long"], long)
    row["median"] = float(np.median(relative))
    chords = np.linalg.norm(mesh.points[mesh.facets[:, 1]] - mesh.points[mesh.facets[:, 0]], axis=1)
    row["area"] = abs(float(mesh.volumes.sum()) - area) / float(CUT_OFF * chords @ chords)
    held = mesh.points[np.unique(mesh.facets)]
    off = np.min([distance_to_line(outline, i, held) for i in edges], axis=0)
    row["off"] = float(off.max() / np.ptp(held, axis=0).max())
    if long > 0.01:
        worst = np.argmax(relative)
        return (
            f"an edge is {relative[worst]:.3g} times as long as asked for at {0.5 * (a + b)[worst]}"
        )
    if most > EDGES:
        return f"{most} edges at a node"
    if row["off"] > 1e-9:
        return f"nodes of the boundary lie {row['off']:.2g} extents off it"
    return f"the area is off by {row['area']:.2g} of what chords explain" if row["area"] > 1 else ""


def measure(seed: int) -> dict[str, Any]:
    """One shape, three sizes and ratios."""
    rng = np.random.default_rng((seed, 39))
    make = SHAPES[seed % len(SHAPES)]
    shape = make(rng, bool(rng.random() < 0.4))
    scale = 10 ** rng.uniform(-5, 3)
    angle = rng.uniform(0, 7)
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    offset = scale * rng.choice([0.0, 1.0, 10 ** rng.uniform(0, 3)]) * rng.normal(size=2)
    outline = shape.placed(turn, offset)
    extent = float((outline.upper - outline.lower).max())
    row: dict[str, Any] = {
        "shape": make.__name__,
        "faults": "",
        "edges": 0,
        "long": 0.0,
        "median": 1.0,
        "area": 0.0,
        "off": 0.0,
        "nodes": 0,
        "seconds": 0.0,
    }
    for size in extent * 10 ** rng.uniform(-1.8, -0.4, 3):
        ratio = float(rng.choice([1.0, 2.0 ** rng.uniform(0, 6)]))
        start = time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # thin parts
                mesh = am.mesh.graded(outline, size, ["rim"] if ratio > 1 else [], ratio)
        except ValueError as error:
            row["faults"] = f"size {size:.6g}, ratio {ratio:.3g}: {error}"
            continue
        row["seconds"] = max(row["seconds"], time.process_time() - start)
        row["nodes"] = max(row["nodes"], mesh.n_nodes)
        wrong = faults_of(mesh, outline, size, ratio, row)
        if wrong:
            row["faults"] = f"size {size:.6g}, ratio {ratio:.3g}: {wrong}"
    return row


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """One row a kind of shape."""
    table = table.assign(faulty=table["faults"] != "")
    return (
        table.groupby("shape")
        .agg(
            shapes=("seed", "size"),
            faulty=("faulty", "sum"),
            edges=("edges", "max"),
            long=("long", "max"),
            nodes=("nodes", "max"),
            slowest=("seconds", "max"),
        )
        .reset_index()
    )


if __name__ == "__main__":
    main(measure, summary, range(2000))
