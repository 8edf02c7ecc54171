"""Random outlines, three meshes each: none hangs, none is unsound, none takes more than two
seconds.

Polygons of 3 to 12 edges, turned, some of them arcs, with holes, slits, tiny edges; stretched, from
1e-6 to 1e6 m, up to 1e8 diameters from the origin. `python tests/campaigns/random_outlines.py
[--count N]`"""

from __future__ import annotations

import faulthandler
import time
import warnings
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
from campaign import main

import adaptmg as am

LIMIT_S, HANG_S = 2.0, 120.0
RATIOS = (1.0, 1.0, 4.0, 50.0)


def cut_corner(places: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A corner replaced by a tiny edge."""
    i, part = int(rng.integers(len(places))), 10 ** rng.uniform(-6, -1)
    before, after = places[i - 1], places[(i + 1) % len(places)]
    return np.insert(
        np.delete(places, i, axis=0),
        i,
        [(1 - part) * places[i] + part * end for end in (before, after)],
        axis=0,
    )


def slit(places: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A slit from the middle of an edge towards the centre."""
    i, width = int(rng.integers(len(places))), 10 ** rng.uniform(-6, -1)
    a, b = places[i], places[(i + 1) % len(places)]
    mouth = [a + t * (b - a) for t in (0.5 - width, 0.5 + width)]
    depth = rng.uniform(0.2, 0.8)
    return np.insert(
        places, i + 1, [mouth[0], mouth[0] * (1 - depth), mouth[1] * (1 - depth), mouth[1]], axis=0
    )


def loop_of(
    places: np.ndarray, rng: np.random.Generator, straight: bool
) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Vertices and centres of arcs."""
    arcs = {}
    for i, (a, b) in enumerate(pairwise([*places, places[0]])):
        if not straight and rng.random() < 0.4:
            chord = b - a
            arcs[i] = 0.5 * (a + b) + rng.choice([-1, 1]) * 10 ** rng.uniform(-0.9, 1) * np.array(
                [-chord[1], chord[0]]
            )
    return places, arcs


def attempt(rng: np.random.Generator) -> tuple[am.Outline, str]:
    """An outline, perhaps one that crosses itself, and its features."""
    n, features = int(rng.integers(3, 13)), []
    angles, radii = np.sort(rng.uniform(0, 2 * np.pi, n)), rng.uniform(0.3, 1, n)
    places = radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    if n < 7 and rng.random() < 0.3:
        places = rng.uniform(-1, 1, (n, 2))
    for change in (cut_corner, slit):
        if rng.random() < 0.25:
            places = change(places, rng)
            features.append(change.__name__)
    far = rng.random() < 0.3
    loops = [loop_of(places, rng, straight=far or rng.random() < 0.5)]
    if rng.random() < 0.3:
        m, radius = int(rng.integers(3, 7)), rng.uniform(0.01, 0.3)
        directions = -2 * np.pi * np.arange(m) / m + rng.uniform(0, 6)
        hole = rng.uniform(-0.2, 0.2, 2) + radius * np.column_stack(
            [np.cos(directions), np.sin(directions)]
        )
        loops.append(loop_of(hole, rng, straight=far or rng.random() < 0.5))
        features.append("hole")
    vertices, arcs, starts = [], {}, []
    for points, centres in loops:
        arcs |= {len(vertices) + i: centre for i, centre in centres.items()}
        starts.append(len(vertices))
        vertices.extend(points)
    places = np.array(vertices)
    features += ["arcs"] * bool(arcs)
    if not arcs and rng.random() < 0.2:
        turn = rng.uniform(0, 6)
        stretch = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        places = places @ stretch * (1, 10 ** rng.uniform(-3, 0)) @ stretch.T
        features.append("stretched")
    scale = 10 ** rng.uniform(-6, 6)
    offset = (
        scale * 10 ** rng.uniform(0, 8) * rng.normal(size=2)
        if far
        else rng.uniform(-1, 1, 2) * scale
    )
    features += ["far"] * far
    outline = am.Outline(
        vertices=[tuple(scale * p + offset) for p in places],
        boundaries=tuple(f"e{i}" for i in range(len(places))),
        arcs={i: tuple(scale * c + offset) for i, c in arcs.items()},
        holes=tuple(starts[1:]),
    )
    return outline, " ".join(features) or "plain"


def random_outline(rng: np.random.Generator) -> tuple[am.Outline, str]:
    """An outline that does not cross itself."""
    while True:
        try:
            return attempt(rng)
        except ValueError:
            continue


def faults_of(mesh: am.MeshArrays, outline: am.Outline) -> str:
    """What is wrong with a mesh."""
    try:
        am.mesh.check_mesh(replace(mesh), outline.boundaries)
    except ValueError as error:
        return str(error)
    held = set(map(tuple, mesh.points[np.unique(mesh.facets)].tolist()))
    return "vertices have moved" if set(outline.vertices) - held else ""


def measure(seed: int) -> dict[str, object]:
    """One outline, three sizes."""
    rng = np.random.default_rng(seed)
    outline, features = random_outline(rng)
    extent = float((outline.upper - outline.lower).max())
    row = {
        "features": features,
        "faults": "",
        "refused": 0,
        "slowest": 0.0,
        "angle": 180.0,
        "nodes": 0,
    }
    for size in extent * 10 ** rng.uniform([-0.5, -1.2, -1.7], [0, -0.5, -1.2]):
        ratio, name = float(rng.choice(RATIOS)), str(rng.choice(outline.boundaries))
        faulthandler.dump_traceback_later(HANG_S, exit=True)
        start = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # thin parts
            try:
                mesh = am.mesh.graded(outline, size, [name] if ratio > 1 else [], ratio)
            except ValueError as error:
                # edges below the resolution of the coordinates are refused, rightly
                if "move it nearer to the origin" in str(error):
                    row["refused"] += 1
                else:
                    row["faults"] = f"size {size:.6g}, ratio {ratio:g}: {error}"
                continue
            finally:
                faulthandler.cancel_dump_traceback_later()
        seconds = time.process_time() - start
        row |= {
            "slowest": max(row["slowest"], seconds),
            "nodes": max(row["nodes"], mesh.n_nodes),
            "angle": min(row["angle"], am.mesh.quality(mesh).min_angle),
        }
        wrong = faults_of(mesh, outline) or (f"{seconds:.1f} s" if seconds > LIMIT_S else "")
        if wrong:
            row["faults"] = f"size {size:.6g}, ratio {ratio:g}: {wrong}"
    return row


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """One row a kind of outline."""
    table = table.assign(faulty=table["faults"] != "")
    return (
        table.groupby("features")
        .agg(
            outlines=("seed", "size"),
            faulty=("faulty", "sum"),
            refused=("refused", "sum"),
            slowest=("slowest", "max"),
            angle=("angle", "min"),
            nodes=("nodes", "max"),
        )
        .reset_index()
    )


if __name__ == "__main__":
    main(measure, summary, range(20_000))
