"""check_step: a STEP file is first read in a process of its own, as OCC ends the process on some damaged ones.

The child reads it as we shall, asks each solid for what meshing needs, and meshes it coarsely where that is cheap. A
file is known by its contents: what has passed passes at once from then on.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

__all__ = ["check_step"]

# seconds: reading takes about one a megabyte
_START_S, _PER_MEGABYTE_S = 60, 20
_MEGABYTE = 2**20
_WRONG = 3
_known: dict[bytes, str] = {}

_CHILD = """
import sys
from math import isfinite
from netgen.meshing import NgException
from netgen.occ import OCCGeometry, Pnt, Vec
try:
    solids = list(OCCGeometry(sys.argv[1]).solids)
    for i, solid in enumerate(solids):
        corners = [c for p in solid.bounding_box for c in (p.x, p.y, p.z)]
        size = max(b - a for a, b in zip(corners[:3], corners[3:]))
        if not all(map(isfinite, corners)) or not size > 0:
            raise ValueError(f"solid {i + 1} has no finite size")
        if not (isfinite(solid.mass) and solid.mass > 0):
            raise ValueError(f"solid {i + 1} has a volume of {solid.mass:.3g}")
        unit = solid.Move(Vec(*(-c for c in corners[:3]))).Scale(Pnt(0, 0, 0), 1 / size).solids[0]
        faces = list(unit.faces)
        if not all(isfinite(face.mass) and face.mass > 0 for face in faces):
            raise ValueError(f"solid {i + 1} has a face without an area")
        for face in faces:
            face.name
        # what cannot be meshed at any size may end the process at another one
        for h in (1.0, 0.5, 0.25, 0.1, 0.05) if len(faces) <= 200 else ():
            try:
                OCCGeometry(unit).GenerateMesh(maxh=h, parallel_meshing=False)
                break
            except NgException as error:
                why = error
        else:
            if len(faces) <= 200:
                raise ValueError(f"solid {i + 1} cannot be meshed, whatever the size ({why}); its faces do not fit")
except Exception as error:
    print(f"{type(error).__name__}: {error}".replace("\\n", " ")[:500], file=sys.stderr)
    sys.stderr.flush()
    import os
    os._exit(3)
"""


def check_step(path: Path) -> None:
    """Raise ValueError unless OCC reads a STEP file in a process of its own.

    Parameters
    ----------
    path : Path
        An existing file.

    Raises
    ------
    ValueError
        If the process ends early, finds solids without a size, or takes longer than a minute and 20 s a megabyte.
    """
    data = path.read_bytes()
    key = hashlib.sha256(data).digest()
    if key not in _known:
        limit = _START_S + _PER_MEGABYTE_S * len(data) / _MEGABYTE
        _known[key] = _tried(path, limit)
    if _known[key]:
        raise ValueError(f"{str(path)!r} cannot be read as a STEP file: {_known[key]}")


def _tried(path: Path, limit: float) -> str:
    """What is wrong with a file, "" if nothing."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        child = subprocess.run([sys.executable, "-c", _CHILD, str(path.absolute())], capture_output=True, text=True,
                               errors="replace", timeout=limit, env=environment, stdin=subprocess.DEVNULL)
    except subprocess.TimeoutExpired:
        return f"OCC comes to no end in {limit:.0f} s; the file is damaged, or needs healing in a CAD program"
    if child.returncode == 0:
        return ""
    if child.returncode == _WRONG:
        return (child.stderr.strip().splitlines() or ["OCC refuses it"])[-1]
    return f"OCC breaks down on it (exit code {child.returncode}); the file is damaged"
