"""Sound files of all formats, and damage done to them by a seed: cut off, lines dropped or doubled,
bytes changed."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

import gmsh_file
import numpy as np
import step_assembly
from netgen.occ import Box, Cylinder, Pnt, Z

import adaptmg as am

NUMBERS = (b"0", b"-1", b"nan", b"1e300", b"999999999999", b"1000000000", b"", b"2.5", b"$", b"*")


def _of_kratos(mesh: am.MeshArrays) -> str:
    """A plane mesh as a file of Kratos, with one boundary."""

    def block(name: str, rows: Iterable[Sequence]) -> str:
        lines = "\n".join(" ".join(map(str, row)) for row in rows)
        return f"Begin {name}\n{lines}\nEnd {name.split()[0]}\n"

    number = range(1, mesh.n_nodes + 1)
    low = mesh.boundary_facets("bottom") + 1
    part = block("SubModelPartConditions", [(k + 1,) for k in range(len(low))])
    return (
        block("Nodes", [(k, *x, 0.0) for k, x in zip(number, mesh.points, strict=True)])
        + block(
            "Elements Element2D3N", [(k + 1, 0, *row) for k, row in enumerate(mesh.elements + 1)]
        )
        + block("Conditions LineCondition2D2N", [(k + 1, 0, *row) for k, row in enumerate(low)])
        + f"Begin SubModelPart low\n{part}End SubModelPart\n"
    )


@cache
def sound() -> tuple[tuple[str, bytes], ...]:
    """Names and contents of sound files."""
    bodies = {
        "lower": am.Box(width=2, depth=1, height=1),
        "upper": am.Box(width=1, depth=1, height=1, origin=(0, 0, 1)),
    }
    solid = am.mesh.structured(am.Assembly(parts=bodies), 2)
    flat = am.mesh.structured(am.Rectangle(width=2, height=1), 3)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for name, one in (("solid.inp", solid), ("flat.inp", flat), ("solid.msh", solid)):
            am.export.mesh(one, folder / name)
        gmsh_file.write(folder / "four.msh", flat, version="gmsh")
        (folder / "parts.mdpa").write_text(_of_kratos(flat))
        shapes = {"plate": Box(Pnt(0, 0, 0), Pnt(9, 9, 2)), "pin": Cylinder(Pnt(0, 0, 0), Z, 2, 9)}
        step_assembly.write(
            folder / "parts.step",
            shapes,
            [("plate", "plate:1", (0, 0, 0)), ("pin", "a", (2, 2, 2)), ("pin", "b", (7, 7, 2))],
        )
        return tuple((path.name, path.read_bytes()) for path in sorted(folder.iterdir()))


def damaged(seed: int) -> tuple[str, bytes]:
    """Name and content of a damaged file."""
    rng = np.random.default_rng(seed)
    name, data = sound()[seed % len(sound())]
    how = ("cut", "bytes", "drop", "double", "number", "swap")[int(rng.integers(6))]
    lines = data.split(b"\n")
    some = np.sort(rng.integers(0, len(lines), int(rng.integers(1, 4)))).tolist()
    if how == "cut":
        return name, data[: int(rng.integers(0, len(data)))]
    if how == "bytes":
        array = np.frombuffer(data, dtype=np.uint8).copy()
        array[rng.integers(0, len(array), int(rng.integers(1, 8)))] = rng.integers(0, 256)
        return name, array.tobytes()
    if how == "drop":
        lines = [line for k, line in enumerate(lines) if k not in some]
    elif how == "double":
        lines = [part for k, line in enumerate(lines) for part in [line] * (1 + (k in some))]
    elif how == "swap":
        lines[some[0]], lines[some[-1] - 1] = lines[some[-1] - 1], lines[some[0]]
    for k in some if how == "number" else ():
        words = lines[k].replace(b",", b" , ").split()
        if words:
            words[int(rng.integers(len(words)))] = NUMBERS[int(rng.integers(len(NUMBERS)))]
            lines[k] = b" ".join(words)
    return name, b"\n".join(lines)
