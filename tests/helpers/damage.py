"""Sound files of all formats, and damage done to them by a seed: cut off, lines dropped or doubled, bytes changed."""

from __future__ import annotations

import tempfile
import time
import warnings
from functools import cache
from pathlib import Path

import gmsh_file
import numpy as np
import step_assembly
from netgen.occ import Box, Cylinder, Pnt, Z

import adaptmg as am

NUMBERS = (b"0", b"-1", b"nan", b"1e300", b"999999999999", b"1000000000", b"", b"2.5", b"$", b"*")


@cache
def sound() -> tuple[tuple[str, bytes], ...]:
    """Names and contents of sound files."""
    bodies = {"lower": am.Box(width=2, depth=1, height=1),
              "upper": am.Box(width=1, depth=1, height=1, origin=(0, 0, 1))}
    mesh = am.mesh.structured(am.Assembly(parts=bodies), 2)
    flat = am.mesh.structured(am.Rectangle(width=2, height=1), 3)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name, one in (("solid.inp", mesh), ("flat.inp", flat), ("solid.msh", mesh)):
            am.export.mesh(one, Path(folder, name))
            found.append((name, Path(folder, name).read_bytes()))
        found.append(("four.msh", gmsh_file.write(Path(folder, "four.msh"), flat, version="gmsh").read_bytes()))
        shapes = {"plate": Box(Pnt(0, 0, 0), Pnt(9, 9, 2)), "pin": Cylinder(Pnt(0, 0, 0), Z, 2, 9)}
        path = step_assembly.write(Path(folder, "parts.step"), shapes,
                                   [("plate", "plate:1", (0, 0, 0)), ("pin", "a", (2, 2, 2)), ("pin", "b", (7, 7, 2))])
        found.append((path.name, path.read_bytes()))
    return tuple(found)


def damaged(seed: int) -> tuple[str, bytes, str]:
    """Name and content of a damaged file, and what was done to it."""
    rng = np.random.default_rng(seed)
    name, data = sound()[seed % len(sound())]
    how = ("cut", "bytes", "drop", "double", "number", "swap")[int(rng.integers(6))]
    lines = data.split(b"\n")
    some = np.sort(rng.integers(0, len(lines), int(rng.integers(1, 4))))
    if how == "cut":
        data = data[:int(rng.integers(0, len(data)))]
    elif how == "bytes":
        array = np.frombuffer(data, dtype=np.uint8).copy()
        array[rng.integers(0, len(array), int(rng.integers(1, 8)))] = rng.integers(0, 256)
        data = array.tobytes()
    elif how == "drop":
        data = b"\n".join(line for k, line in enumerate(lines) if k not in some)
    elif how == "double":
        data = b"\n".join(part for k, line in enumerate(lines) for part in [line] * (1 + (k in some)))
    elif how == "swap":
        lines[some[0]], lines[some[-1] - 1] = lines[some[-1] - 1], lines[some[0]]
        data = b"\n".join(lines)
    else:
        for k in some:
            words = lines[k].replace(b",", b" , ").split()
            if words:
                words[int(rng.integers(len(words)))] = NUMBERS[int(rng.integers(len(NUMBERS)))]
                lines[k] = b" ".join(words)
        data = b"\n".join(lines)
    return name, data, how


def outcome(seed: int, folder: Path) -> dict:
    """What reading a damaged file leads to: a sound mesh, or a refusal that names the file; ``faults`` if neither."""
    name, data, how = damaged(seed)
    path, start, fault, why = folder / f"{seed}-{name}", time.perf_counter(), "", "read"
    path.write_bytes(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if path.suffix == ".step":
                am.mesh.touching(path)
            else:
                am.mesh.check_mesh(am.mesh.from_file(path))
    except ValueError as error:
        why = str(error).replace(str(path), "FILE")
        fault = "" if path.name in str(error) else "the message does not name the file"
    except BaseException as error:
        why = fault = f"{type(error).__name__}: {error}"
    return {"name": name, "how": how, "faults": fault, "why": why, "seconds": time.perf_counter() - start}
