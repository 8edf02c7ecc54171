"""step_table, touching: what the solids and faces of a STEP file are like, and which faces lie on each other.

Names of faces in a file from a CAD program say little; their places, sizes and radii find them. The outward normal of a
plane face comes from a surface mesh of Netgen; OCC gives areas and centres, and the distance of a point from a face.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.netgen_guard import Netgen, NetgenFails, netgen
from adaptmg.mesh.netgen_solid import Shape
from adaptmg.mesh.step import step_contents, step_shapes
from adaptmg.mesh.surfaces import candidates
from adaptmg.problem.solid_domains import StepFile
from adaptmg.problem.surfaces import ContactPair

if TYPE_CHECKING:
    import pandas

#: edges of the surface meshes by which faces are compared, of the extent of a solid
_EDGE = 0.125
#: cosine between outward normals of faces that lie on each other
_OPPOSITE = -0.5
#: seconds that a surface or the distances from a face may take, of which .01 to 1 are usual
_LIMIT_S = 20.0
#: of the extent of all solids
_TOLERANCE = 1e-5


@dataclass(frozen=True, eq=False)
class _Face:
    """A face, m: triangles (n, 3, 3) that are oriented outwards, none where Netgen cannot mesh it."""

    number: int
    name: str
    kind: str
    area: float
    centre: np.ndarray
    radius: float
    triangles: np.ndarray

    @property
    def normals(self) -> np.ndarray:
        """Area vectors (n, 3) of the triangles."""
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        return 0.5 * np.cross(b - a, c - a)


def step_table(path: str | Path | StepFile) -> pandas.DataFrame:
    """List the solids and faces of a STEP file, so that "the upper face of the nut" is found.

    Parameters
    ----------
    path : str, Path or StepFile
        A StepFile may rename them and choose solids.

    Returns
    -------
    pandas.DataFrame
        One row a solid (its ``face`` is "") and one a face: ``solid``, ``face``, ``kind`` ("solid", "plane",
        "cylinder", "sphere", "cone or torus", "other"), centre ``x, y, z``, size of the bounding box ``dx, dy, dz`` (of
        chords on round faces), ``area``, ``volume``, outward normal ``nx, ny, nz`` of plane faces, ``radius`` of
        cylinders and spheres; m, m^2, m^3. What a row does not have is NaN.

    Raises
    ------
    FileNotFoundError, TypeError, ValueError
        As :class:`adaptmg.StepFile`; if the file cannot be read.

    Examples
    --------
    >>> faces = am.mesh.step_table("assembly.step")                    # doctest: +SKIP
    >>> faces[(faces.solid == "nut") & (faces.nz > 0.99)]              # doctest: +SKIP
    """
    import pandas

    rows = []
    with netgen() as worker:
        for body, shape, faces in _solids(worker, _domain(path)):
            box = shape.lower + shape.scale * shape.corners
            rows.append([body, "", "solid", *box.mean(axis=0), *np.ptp(box, axis=0), sum(face.area for face in faces),
                         shape.volume * shape.scale**3, *[np.nan] * 4])
            for face in faces:
                places = face.triangles.reshape(-1, 3)
                total = face.normals.sum(axis=0)
                plane = face.kind == "plane" and len(places)
                rows.append([body, face.name, face.kind, *face.centre,
                             *(np.ptp(places, axis=0) if len(places) else [np.nan] * 3), face.area, np.nan,
                             *(total / np.linalg.norm(total) + 0.0 if plane else [np.nan] * 3), face.radius])
    return pandas.DataFrame(rows, columns=["solid", "face", "kind", "x", "y", "z", "dx", "dy", "dz", "area", "volume",
                                           "nx", "ny", "nz", "radius"])


def touching(path: str | Path | StepFile, tolerance: float | None = None) -> tuple[ContactPair, ...]:
    """Find the faces of different solids that lie on each other.

    Parameters
    ----------
    path : str, Path or StepFile
        A StepFile may rename solids and faces and choose solids.
    tolerance : float, optional
        Largest distance, m; default 1e-5 of the extent of all solids. Clearances need the size of the clearance.

    Returns
    -------
    tuple of ContactPair
        One for each pair of names "solid.face"; the smaller face is the slave. A part where faces overlap that is much
        smaller than an eighth of both solids may be missed.

    Raises
    ------
    FileNotFoundError, TypeError, ValueError
        As :class:`adaptmg.StepFile`; if the file cannot be read, or Netgen cannot mesh the surface of a solid.

    Examples
    --------
    >>> pairs = am.mesh.touching("assembly.step", tolerance=5e-5)      # doctest: +SKIP
    >>> problem = am.ContactProblem(domain=am.StepFile("assembly.step"), contact=pairs, ...)    # doctest: +SKIP
    """
    domain = _domain(path)
    tolerance = None if tolerance is None else checks.positive("tolerance", tolerance)
    with netgen() as worker:
        solids = [(body, faces) for body, _, faces in _solids(worker, domain)]
        for body, faces in solids:
            if not all(len(face.triangles) for face in faces):
                raise ValueError(f"Netgen cannot mesh the surface of solid {body!r} of {str(domain.path)!r}")
        boxes = {(k, face.number): np.array([face.triangles.min(axis=(0, 1)), face.triangles.max(axis=(0, 1))])
                 for k, (_, faces) in enumerate(solids) for face in faces}
        corners = np.array(list(boxes.values()))
        reach = tolerance or _TOLERANCE * float(np.ptp(corners, axis=(0, 1)).max())
        pairs: dict[tuple[str, str], ContactPair] = {}
        for (i, (one, own)), (j, (other, its)) in combinations(enumerate(solids), 2):
            for a in own:
                for b in its:
                    first, second = boxes[i, a.number], boxes[j, b.number]
                    # chords of round faces stay behind them
                    slack = reach + 0.05 * min(np.ptp(first, axis=0).max(), np.ptp(second, axis=0).max())
                    if (first[0] > second[1] + slack).any() or (second[0] > first[1] + slack).any():
                        continue
                    if _on(worker, a, b, j, domain, reach) or _on(worker, b, a, i, domain, reach):
                        names = [f"{one}.{a.name}", f"{other}.{b.name}"]
                        slave, master = names if a.area <= b.area else names[::-1]
                        pairs.setdefault((slave, master), ContactPair(slave, master))
    return tuple(pairs.values())


def _domain(path: str | Path | StepFile) -> StepFile:
    return path if isinstance(path, StepFile) else StepFile(path)


def _solids(worker: Netgen, domain: StepFile) -> Iterator[tuple[str, Shape, list[_Face]]]:
    """The name, the shape and the faces of each solid in turn."""
    contents = step_contents(worker, domain)
    for body, shape in step_shapes(worker, domain, contents):
        size = _EDGE * float(np.ptp(shape.corners, axis=0).max())
        points, triangles, owner = np.empty((0, 3)), np.empty((0, 3), dtype=int), np.empty(0, dtype=int)
        try:
            points, triangles, owner = worker("step_surface", size, seconds=_LIMIT_S)
        except NetgenFails as error:
            # the other solids are gone with the process
            if not worker.alive:
                raise ValueError(f"{str(domain.path)!r}: the surface of {body!r} cannot be meshed: {error}") from error
        places = shape.lower + shape.scale * points[triangles].reshape(-1, 3, 3)
        yield body, shape, [_face(shape, k, name, places[owner == k]) for k, name in enumerate(contents[body])]


def _face(shape: Shape, number: int, name: str, triangles: np.ndarray) -> _Face:
    kind, radius = "other", np.nan
    if found := candidates(shape.samples[number:number + 1]):
        surface = found[0][0]
        kind = "cone or torus"
        if surface.straight and not surface.profile[0]:
            kind = "plane"
        elif surface.straight and not surface.profile[1]:
            kind, radius = "cylinder", surface.extent * shape.scale
        elif not surface.straight and not surface.profile.any():
            kind, radius = "sphere", surface.extent * shape.scale
    return _Face(number, name, kind, shape.areas[number] * shape.scale**2,
                 shape.lower + shape.scale * shape.centres[number], radius, triangles)


def _on(worker: Netgen, face: _Face, other: _Face, solid: int, domain: StepFile, reach: float) -> bool:
    """Whether a triangle of a face lies on another face, which looks the other way there."""
    from scipy.spatial import cKDTree  # a first solve without it starts sooner

    # corners lie on round faces, centroids of their triangles do not; plane faces may have all corners on their rims
    places = face.triangles.mean(axis=1)[:, None] if face.kind == "plane" else face.triangles
    try:
        near = worker("face_distances", solid, other.number, places.reshape(-1, 3) / domain.unit, seconds=_LIMIT_S)
    except NetgenFails as error:
        raise ValueError(f"{str(domain.path)!r}: OCC cannot tell how far {other.name!r} is: {error}") from error
    close = np.flatnonzero((near.reshape(len(places), -1) * domain.unit <= reach).all(axis=1))
    if not len(close):
        return False
    nearest = cKDTree(other.triangles.mean(axis=1)).query(face.triangles[close].mean(axis=1))[1]
    own, its = face.normals[close], other.normals[nearest]
    cosine = (own * its).sum(axis=1) / (np.linalg.norm(own, axis=1) * np.linalg.norm(its, axis=1))
    return bool((cosine < _OPPOSITE).any())
