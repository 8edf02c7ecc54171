"""Damaged mesh files and STEP files: each row writes its own, and every message names the file."""

import gzip
import os
from pathlib import Path

from hostile_table import Hostile

import adaptmg as am

# as written by Netgen before 2025: twelve columns, the first the number of the boundary
VOL = """mesh3d
dimension
2
geomtype
0
surfaceelements
2
 1 1 1 0 3 1 2 3
 1 1 1 0 3 1 3 4
volumeelements
0
edgesegmentsgi2
4
 1 0 1 2 -1 -1 1 0 1 0 1 1
 2 0 2 3 -1 -1 1 0 2 0 2 1
 3 0 3 4 -1 -1 1 0 3 0 3 1
 1 0 4 1 -1 -1 1 0 4 0 4 1
points
4
 0 0 0
 2 0 0
 2 1 0
 0 1 0
materials
1
1 steel
bcnames
3
1 side
2 right
3 top
endmesh
"""
# what is replaced, and by what: Netgen breaks down, or reads it without a word
VOL_DAMAGE = {
    "node negative": (" 3 1 2 3", " 3 1 2 -1"),
    "node too large": (" 3 1 2 3", " 3 1 2 9"),
    "quadrilateral": (" 3 1 2 3", " 4 1 2 3"),
    "elements fewer": ("surfaceelements\n2", "surfaceelements\n1"),
    "coordinate nan": (" 2 1 0", " nan 1 0"),
    "dimension 3": ("dimension\n2", "dimension\n3"),
    "boundary 0": (" 2 0 2 3", " 0 0 2 3"),
    "boundary huge": (" 2 0 2 3", " 999999 0 2 3"),
    "no end": ("endmesh", ""),
    "name with control character": ("2 right", "2 ri\x1b[31mght"),
}

MSH = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
2
1 5 "rim"
2 3 "steel"
$EndPhysicalNames
$Entities
0 1 1 0
1 0 0 0 2 1 0 1 5 0
1 0 0 0 2 1 0 1 3 0
$EndEntities
$Nodes
1 4 1 4
2 1 0 4
1
2
3
4
0 0 0
2 0 0
2 1 0
0 1 0
$EndNodes
$Elements
2 6 1 6
1 1 1 4
3 1 2
4 2 3
5 3 4
6 4 1
2 1 2 2
1 1 2 3
2 1 3 4
$EndElements
"""
MSH_DAMAGE = {
    "node too large": ("1 1 2 3\n", "1 1 2 9\n"),
    "10**9 nodes": ("2 1 0 4\n", "2 1 0 1000000000\n"),
    "node 0": ("1 1 2 3\n", "1 1 2 0\n"),
    "unknown type": ("2 1 2 2\n", "2 1 99 2\n"),
    "no nodes": ("$Nodes", "$Nods"),
    "name with control character": ('"rim"', '"ri\x07m"'),
}


def _read(name: str, text: str | bytes) -> None:
    Path(name).write_bytes(text.encode() if isinstance(text, str) else text)
    am.mesh.as_mesh(name)


def _damaged(kind: str, text: str, damage: dict[str, tuple[str, str]]):
    for label, (old, new) in damage.items():
        assert old in text, label
        changed = text.replace(old, new, 1)
        yield Hostile(
            f"{kind} {label}",
            lambda t=changed: _read(f"bad.{kind}", t),
            f"bad.{kind}",
            ValueError,
            writes=True,
        )


def _step(change, run=am.mesh.step_table) -> None:
    from netgen.occ import Box, Pnt

    Box(Pnt(0, 0, 0), Pnt(1, 2, 3)).WriteStep("bad.step")
    Path("bad.step").write_text(change(Path("bad.step").read_text()))
    run("bad.step")


def _other_files():
    for kind in ("vol", "msh", "inp", "bdf"):
        for label, data in {
            "empty": b"",
            "noise": bytes(range(256)) * 20,
            "zeros": bytes(1000),
        }.items():
            yield Hostile(
                f"{kind} {label}",
                lambda k=kind, d=data: _read(f"bad.{k}", d),
                f"bad.{kind}",
                ValueError,
                writes=True,
            )
    packed = gzip.compress(VOL.encode())
    for label, data in {
        "not packed": VOL.encode(),
        "cut": packed[:60],
        "damaged": packed[:40] + b"xx" + packed[42:],
        "bomb": gzip.compress(b"mesh3d\n" + b"0" * 50_000_000, compresslevel=1),
    }.items():
        yield Hostile(
            f"vol.gz {label}",
            lambda d=data: _read("bad.vol.gz", d),
            "bad.vol.gz",
            ValueError,
            writes=True,
        )
    for name in ("pipe.msh", "pipe.vol", "pipe.vol.gz", "pipe.step"):
        yield Hostile(
            name,
            lambda n=name: (
                os.mkfifo(n),
                (am.mesh.step_table if n.endswith("step") else am.mesh.as_mesh)(n),
            ),
            name,
            ValueError,
            writes=True,
        )


def _step_files():
    changes = {
        "empty": lambda t: "",
        "half": lambda t: t[: len(t) // 2],
        "text": lambda t: "not a step file\n" * 50,
        "crash in OCC": lambda t: t.replace("FACE_BOUND('',#", "FACE_BOUND('',#9"),
        "points are directions": lambda t: t.replace("CARTESIAN_POINT", "DIRECTION"),
        "no solids": lambda t: t.replace("MANIFOLD_SOLID_BREP", "MANIFOLD_SOLID_BRAP"),
    }
    for label, change in changes.items():
        yield Hostile(
            f"step {label}", lambda c=change: _step(c), "bad.step", ValueError, writes=True
        )
    yield Hostile(
        "step size of 1e-9",
        lambda: _step(str, lambda p: am.mesh.graded(am.StepFile(p), 1e-9)),
        "nodes",
        ValueError,
        writes=True,
    )


INPUTS = (
    *_damaged("vol", VOL, VOL_DAMAGE),
    *_damaged("msh", MSH, MSH_DAMAGE),
    *_other_files(),
    *_step_files(),
)
