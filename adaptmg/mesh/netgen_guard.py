r"""refuse_thin: is a domain too thin for the sizes asked? And how many nodes curved faces of solids will take.

Where a wall, slot or needle is thinner than about a thousandth of the edge length around it, Netgen fails, or never
ends; OCC, which compares lengths with 1e-7 of the extent, ends the process. Therefore elements may be at most 500 times
as long as the domain is thick, and solids no thinner than 1e-5 of their extent.

interruptible: Netgen and OCC in a thread of their own, so that Ctrl-C is heard while they work.

Python looks at signals between instructions of the main thread, but Netgen may be at work in C++ for hours, or forever.
It releases Python's lock meanwhile; the main thread therefore waits, and an interrupt ends the wait at once. The work
itself cannot be stopped: until it ends, another call is refused, as Netgen has state of its own.

check_step: a STEP file is first read in a process of its own, as OCC ends the process on some damaged ones.

The child reads it as we shall, asks each solid for what meshing needs, and meshes it coarsely where that is cheap. A
file is known by its contents: what has passed passes at once from then on.

How many nodes a mesh may have before it is refused.
"""

from __future__ import annotations

import hashlib
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from adaptmg.mesh.arrays import distance_of_segments
from adaptmg.problem.plane_domains import Box, Domain, Outline, Polygon, Rectangle
from adaptmg.problem.solid_domains import Ball, Combination, Cylinder, Extrusion, Moved, Revolution, SolidDomain

__all__ = ["MAX_NODES", "NetgenBusy", "NetgenEndless", "check_step", "curved_nodes", "interruptible", "refuse_thin",
           "refuse_thin_shape", "thickness"]

_MAX_RATIO = 500.0
_THINNEST = 1e-5
# cosine between the directions of two edges that face each other
_FACING = -0.5


def thickness(outline: Polygon | Outline, sizes: np.ndarray | None = None) -> float:
    """Smallest distance between two edges that face each other, across the body or a slot; arcs as their chords."""
    a, owner = outline.chords() if isinstance(outline, Outline) else (np.array(outline.vertices), None)
    edges = np.roll(a, -1, axis=0) - a
    length = np.linalg.norm(edges, axis=1)
    weight = np.ones(len(a)) if sizes is None else np.asarray(sizes)[slice(None) if owner is None else owner]
    i, j = np.triu_indices(len(a), 1)
    facing = (edges[i] * edges[j]).sum(axis=1) < _FACING * length[i] * length[j]
    i, j = i[facing], j[facing]
    if len(i) == 0:
        return math.inf
    touching = (j == i + 1) | ((i == 0) & (j == len(a) - 1))
    turn = np.abs(edges[i, 0] * edges[j, 1] - edges[i, 1] * edges[j, 0]) / np.maximum(length[i], length[j])
    apart = distance_of_segments(a, i, j)
    return float((np.where(touching, turn, apart) / np.minimum(weight[i], weight[j])).min())


def refuse_thin(domain: Domain, size: float, side_sizes: Mapping[str, float]) -> None:
    """Raise ValueError if a plane domain or solid is too thin for Netgen or OCC."""
    if not isinstance(domain, Box | SolidDomain):
        outline = domain if isinstance(domain, Outline) else domain.polygon
        sizes = np.array([min(size, side_sizes.get(name, size)) for name in outline.boundaries])
        extent = float((domain.upper - domain.lower).max())
        ratio = thickness(outline, np.minimum(sizes, extent))
        if ratio * _MAX_RATIO < 1:
            _refuse(domain, ratio * min(size, extent), min(size, extent))
        return
    extent = float((domain.upper - domain.lower).max())
    smallest = min([size, extent, *side_sizes.values()])
    for part, thick in _parts(domain):
        if thick < _THINNEST * extent:
            raise ValueError(f"{part!r} is {thick:.3g} m thin, less than {_THINNEST:.0e} of the extent of the whole "
                             f"({extent:.3g} m): OCC cannot tell its sides apart; make it thicker, or leave it out")
        if thick * _MAX_RATIO < smallest:
            _refuse(part, thick, smallest)


def _refuse(domain: Domain, thick: float, size: float) -> None:
    raise ValueError(f"size: edges of {size:.3g} m are more than {_MAX_RATIO:.0f} times as long as a wall, slot or "
                     f"needle of {domain!r} is thick (about {thick:.3g} m): Netgen would come to no end; ask for at "
                     f"most {_MAX_RATIO * thick:.3g} m there, or make it thicker")


def refuse_thin_shape(domain: Domain, lengths: np.ndarray, size: float) -> None:
    """The same for what a combination left, or a STEP file holds: by its bounding box (3,), m."""
    thick, extent = float(lengths.min()), float(lengths.max())
    if thick < _THINNEST * extent or thick * _MAX_RATIO < min(size, extent):
        _refuse(domain, thick, min(size, extent))


def _parts(domain: Box | SolidDomain) -> Iterator[tuple[Domain, float]]:
    """The primitives a solid is made of, and how thick they are, m."""
    if isinstance(domain, Combination):
        yield from _parts(domain.a)
        yield from _parts(domain.b)
    elif isinstance(domain, Moved):
        yield from _parts(domain.solid)
    elif isinstance(domain, Box):
        yield domain, min(domain.width, domain.depth, domain.height)
    elif isinstance(domain, Cylinder):
        yield domain, min(2 * domain.radius, domain.height)
    elif isinstance(domain, Ball):
        yield domain, 2 * domain.radius
    elif isinstance(domain, Extrusion):
        yield domain, min(domain.height, _profile(domain.polygon))
    elif isinstance(domain, Revolution):
        turned = math.radians(domain.angle) * float(domain.polygon.upper[0])
        yield domain, min(turned, _profile(domain.polygon))


def _profile(polygon: Rectangle | Polygon | Outline) -> float:
    return thickness(polygon if isinstance(polygon, Outline) else polygon.polygon)


def curved_nodes(domain: Domain, size: float, curvature: float) -> float:
    """Nodes that round faces ask for, whose edges are at most their radius over ``curvature``."""
    if isinstance(domain, Combination):
        return curved_nodes(domain.a, size, curvature) + curved_nodes(domain.b, size, curvature)
    if isinstance(domain, Moved):
        return curved_nodes(domain.solid, size, curvature)
    if isinstance(domain, Cylinder):
        area = 2 * math.pi * domain.radius * domain.height
    elif isinstance(domain, Ball):
        area = 4 * math.pi * domain.radius**2
    else:
        return 0.0
    h = domain.radius / curvature
    # at least the nodes of the surface itself; cut by other parts it may be smaller: half is counted
    return 0.5 * 1.15 * area / h**2 if h < size else 0.0


Value = TypeVar("Value")

# seconds between two looks at signals, and what an abandoned call is given to end
_LOOK, _PATIENCE = 0.2, 1.0
# five times what the largest meshes take: 2 million nodes in 3D at 7 ms
_LIMIT_S = 70_000.0
# Netgen's recursions need more than the half megabyte that threads get on some systems
_STACK = 64 * 2**20
_starting = threading.Lock()
_abandoned: list[threading.Event] = []


class NetgenBusy(Exception):
    """Netgen is still at work on an earlier call."""


class NetgenEndless(ValueError):
    """Netgen came to no end in the time given."""


def interruptible(function: Callable[..., Value], *args: Any, limit: float | None = None, **options: Any) -> Value:
    """Call a function of Netgen or OCC."""
    for ended in _abandoned[:]:
        if not ended.wait(_PATIENCE):
            raise NetgenBusy("Netgen is still at work on what was interrupted before, and cannot be stopped: wait, or "
                               "restart Python")
        _abandoned.remove(ended)
    if threading.current_thread() is not threading.main_thread():
        return function(*args, **options)  # signals go to the main thread only
    outcome: dict[str, Any] = {}
    # not Thread.join: interrupted, that of Python 3.11 takes the thread for ended
    ended = threading.Event()

    def work() -> None:
        try:
            outcome["value"] = function(*args, **options)
        except BaseException as error:  # whatever it is, it belongs to the caller
            outcome["error"] = error
        finally:
            ended.set()

    with _starting:
        before = threading.stack_size(_STACK)
        try:
            threading.Thread(target=work, daemon=True, name="netgen").start()
        finally:
            threading.stack_size(before)
    try:
        end = time.monotonic() + (_LIMIT_S if limit is None else limit)
        while not ended.wait(_LOOK):
            if time.monotonic() > end:
                raise NetgenEndless(f"Netgen came to no end in {limit or _LIMIT_S:.0f} s; it often does so where parts "
                                    "are much thinner than the sizes asked for")
    except BaseException:
        _abandoned.append(ended)
        raise
    if "error" in outcome:
        raise outcome["error"]
    return outcome["value"]


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
    """Raise ValueError unless OCC reads a STEP file in a process of its own."""
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


#: by dimension: what Netgen makes in about a quarter of an hour (0.2 ms a node in 2D, 0.7 ms in 3D)
MAX_NODES = {2: 5_000_000, 3: 2_000_000}
