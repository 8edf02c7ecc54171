"""STEP files: their solids as bodies with the names of the file; step_table, touching: what they
are like, and touch.

The solids share no nodes, even where their faces coincide: contact pairs join them. OCC turns every
unit of length a file may use into millimetres. Names of faces in a file from a CAD program say
little; their places, sizes and radii find them. The outward normal of a plane face comes from a
surface mesh of Netgen; OCC gives areas and centres, and the distance of a point from a face."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain, combinations, product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import file_size
from adaptmg.mesh.exact import surfaces_of
from adaptmg.mesh.netgen_guard import Netgen, NetgenFails, netgen, read_s
from adaptmg.mesh.netgen_meshes import Shape, StepSolid, built_shape
from adaptmg.mesh.surfaces import Revolved, surfaces_through
from adaptmg.problem.plane_domains import Domain
from adaptmg.problem.solid_domains import StepFile
from adaptmg.problem.surfaces import ContactPair

if TYPE_CHECKING:
    import pandas

_LOG = logging.getLogger(__name__)

#: memory that reading takes for each byte of a file
_BYTES_PER_BYTE = 50
# of products without a name, as OCC writes them
_NO_PRODUCT = "Open CASCADE STEP translator"
#: edges of the surface meshes by which faces are compared, of the extent of a solid: half and twice find the same
#: pairs in 10 small assemblies
_EDGE = 0.125
#: cosine between outward normals of faces that lie on each other: measured, half, 0 and -.99 find the same
#: pairs there
_OPPOSITE = -0.5
#: seconds of the processor for a surface or the distances from a face, where .01 to 1 are usual; for
#: each face and each point: a plate with 1024 holes took 60 s, .025 s a point of its upper face
_LIMIT_S, _FACE_S, _POINT_S = 20.0, 0.5, 0.25
#: of the extent of all solids: measured there, half finds the same pairs, a hundredth misses a pin with a
#: clearance of 1e-4 mm in a plate of 20 mm, twice finds blocks of 10 mm that are 2e-4 mm apart
_TOLERANCE = 1e-5
_NONE = np.empty((0, 3, 3))


def step_solids(domain: StepFile) -> dict[str, StepSolid]:
    """Return the chosen solids of a file by their names."""
    path = Path(domain.path)
    checks.fits("path", _BYTES_PER_BYTE * file_size("path", path), f"reading {str(path)!r}")
    if path.suffix.lower() not in (".step", ".stp"):
        raise ValueError(f"path: {str(path)!r} is not a .step or .stp file")
    try:
        with netgen() as worker:
            solids = worker("read_step", str(path.absolute()), seconds=read_s(path))
    except NetgenFails as error:
        raise ValueError(f"{str(path)!r} cannot be read as a STEP file: {error}") from error
    if not solids:
        raise ValueError(
            f"{str(path)!r} holds no solids; surfaces must be closed and sewn into solids before they are "
            "written"
        )
    named = [
        _without_dots(
            (product if not product.startswith(_NO_PRODUCT) else "")
            or solid_name
            or f"solid{i + 1}"
        )
        for i, (product, solid_name, _) in enumerate(solids)
    ]
    faces = [
        [_without_dots(name or f"face{j + 1}") for j, name in enumerate(face_names)]
        for *_, face_names in solids
    ]
    for name in (*named, *(name for face_names in faces for name in face_names)):
        checks.boundary_name(f"a name in {str(path)!r}", name)
    contents = _renamed(domain, _distinct(named), faces)
    entries = domain.solids
    chosen = (
        range(len(named)) if entries is None else _chosen(domain, entries, named, list(contents))
    )
    bodies = list(contents.items())
    return {bodies[k][0]: StepSolid(domain, k, bodies[k][1]) for k in chosen}


def _without_dots(name: str) -> str:
    """Return a name without dots, which separate bodies from boundaries."""
    return name.replace(".", "_")


def _chosen(
    domain: StepFile, entries: Sequence[str], named: Sequence[str], bodies: Sequence[str]
) -> list[int]:
    """Return the numbers of the solids that the ``entries`` of a domain choose: by their names in the file
    (``named``), by the names of its ``bodies``, or as "name.2", the second of one name."""
    chosen: list[int] = []
    for entry in entries:
        same = [k for k, name in enumerate(named) if name == _without_dots(entry)]
        same = same or [k for k, name in enumerate(bodies) if name == _without_dots(entry)]
        base, _, number = entry.rpartition(".")
        if not same and number.isdecimal():
            instances = [k for k, name in enumerate(named) if name == _without_dots(base)]
            same = instances[int(number) - 1 : int(number)]  # none for 0: [-1:0] is empty
        if not same:
            raise ValueError(
                f"solids: there is no solid {entry!r}{checks.suggestion(entry, bodies)}; "
                f"{str(domain.path)!r} holds {', '.join(bodies)}"
            )
        chosen += [k for k in same if k not in chosen]
    return chosen


def _distinct(names: list[str]) -> list[str]:
    """Return names with "_2", "_3", ... added to those that come again."""
    result: list[str] = []
    for name in names:
        candidates = [name] + [f"{name}_{k}" for k in range(2, len(names) + 1)]
        result.append(next(c for c in candidates if c not in result))
    return result


def _renamed(
    domain: StepFile, bodies: list[str], faces: list[list[str]]
) -> dict[str, tuple[str, ...]]:
    """Return the names of the faces of each body; bodies and faces are renamed by the mapping of the
    domain. ValueError if a key of it is not used."""
    unused = set(domain.names)
    result = {}

    def new(keys: list[str], name: str) -> str:
        """Return the new name of a body or face, which the mapping may have under any of ``keys``."""
        for key in keys:
            if key in domain.names:
                unused.discard(key)
                return domain.names[key]
        return name

    for i, (body, face_names) in enumerate(zip(bodies, faces, strict=True)):
        solid = (body, f"solid{i + 1}")
        name = new(list(solid), body)
        if name in result:
            raise ValueError(
                f"names: two solids are called {name!r}; each is a body and needs another name"
            )
        result[name] = tuple(
            new([f"{s}.{f}" for s in solid for f in (face, f"face{j + 1}")], face)
            for j, face in enumerate(face_names)
        )
    if unused:
        listed = "; ".join(
            f"{body}: {', '.join(dict.fromkeys(face_names))}"
            for body, face_names in zip(bodies, faces, strict=True)
        )
        raise ValueError(
            f"names: {', '.join(map(repr, sorted(unused)))} is neither a solid nor a 'solid.face' of "
            f"{str(domain.path)!r}; it holds {listed}"
        )
    return result


@dataclass(frozen=True, eq=False)
class _Face:
    """A face, m: triangles (n, 3, 3) that are oriented outwards, none where Netgen cannot mesh
    it."""

    number: int  # among the faces of its solid
    name: str
    kind: str  # as of :func:`step_table`
    area: float
    centre: np.ndarray  # (3,)
    radius: float  # of cylinders and spheres, else NaN
    triangles: np.ndarray

    @cached_property
    def box(self) -> np.ndarray:
        """Return the lowest and the highest corner (2, 3) of the bounding box of the triangles."""
        return np.array([self.triangles.min(axis=(0, 1)), self.triangles.max(axis=(0, 1))])

    @property
    def normals(self) -> np.ndarray:
        """Return the area vectors (n, 3) of the triangles."""
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
        One row a solid (its ``face`` is "") and one a face: ``solid``, ``face``, ``kind`` ("solid",
        "plane", "cylinder", "sphere", "cone or torus", "other"), centre ``x, y, z``, size of the
        bounding box ``dx, dy, dz`` (free-form faces may be smaller), ``area``, ``volume``, outward
        normal ``nx, ny, nz`` of plane faces, ``radius`` of cylinders and spheres; m, m^2, m^3. What a row
        does not have is NaN.

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
    domain = _domain(path)
    with netgen() as worker:
        for body, solid in step_solids(domain).items():
            shape = built_shape(worker, solid)
            try:
                boxes, normals = worker("face_sides", seconds=_LIMIT_S + _FACE_S * len(solid.faces))
            except NetgenFails as error:
                raise ValueError(f"{str(domain.path)!r}: {body!r}: {error}") from error
            faces = [_face(shape, k, name) for k, name in enumerate(solid.faces)]
            area = sum(face.area for face in faces)
            box = shape.lower + shape.scale * shape.corners
            sides = [*box.mean(axis=0), *np.ptp(box, axis=0), area]
            volume = shape.volume * shape.scale**3
            rows.append([body, "", "solid", *sides, volume, *[np.nan] * 4])
            for face, box, normal in zip(faces, boxes, normals, strict=True):
                sides = [*face.centre, *np.ptp(shape.scale * box, axis=0), face.area]
                row = [*sides, np.nan, *(normal + 0.0), face.radius]  # + 0.0: no -0.0
                rows.append([body, face.name, face.kind, *row])
    return pandas.DataFrame(
        rows,
        columns=[
            "solid",
            "face",
            "kind",
            "x",
            "y",
            "z",
            "dx",
            "dy",
            "dz",
            "area",
            "volume",
            "nx",
            "ny",
            "nz",
            "radius",
        ],
    )


def touching(
    path: str | Path | StepFile, tolerance: float | None = None
) -> tuple[ContactPair, ...]:
    """Find the faces of different solids that lie on each other.

    Parameters
    ----------
    path : str, Path or StepFile
        A StepFile may rename solids and faces and choose solids.
    tolerance : float, optional
        Largest distance, m; default 1e-5 of the extent of all solids. Clearances need the size of
        the clearance.

    Returns
    -------
    tuple of ContactPair
        One for each pair of names "solid.face"; the smaller face is the slave. A part where faces
        overlap that is much smaller than an eighth of both solids may be missed.

    Raises
    ------
    FileNotFoundError, TypeError, ValueError
        As :class:`adaptmg.StepFile`; if the file cannot be read, or Netgen cannot mesh the surface
        of a solid.

    Examples
    --------
    >>> pairs = am.mesh.touching("assembly.step", tolerance=5e-5)      # doctest: +SKIP
    >>> domain = am.StepFile("assembly.step")  # doctest: +SKIP
    >>> problem = am.ContactProblem(domain=domain, contact=pairs, ...)  # doctest: +SKIP
    """
    domain = _domain(path)
    tolerance = None if tolerance is None else checks.positive("tolerance", tolerance)
    solids = step_solids(domain)
    with netgen() as worker:
        faces_of = dict(_faces_of(worker, solids))
        for body, faces in faces_of.items():
            if not all(len(face.triangles) for face in faces):
                raise ValueError(
                    f"Netgen cannot mesh the surface of solid {body!r} of {str(domain.path)!r}"
                )
        corners = np.array([face.box for faces in faces_of.values() for face in faces])
        reach = tolerance or _TOLERANCE * float(np.ptp(corners, axis=(0, 1)).max())
        pairs: dict[tuple[str, str], ContactPair] = {}
        for solid, other in combinations(solids, 2):
            for a, b in product(faces_of[solid], faces_of[other]):
                # chords of round faces stay behind them: boxes may be apart by a twentieth of
                # the extent of the smaller one
                slack = reach + 0.05 * min(np.ptp(a.box, axis=0).max(), np.ptp(b.box, axis=0).max())
                if (a.box[0] > b.box[1] + slack).any() or (b.box[0] > a.box[1] + slack).any():
                    continue
                if _touches(worker, a, b, solids[other], reach) or _touches(
                    worker, b, a, solids[solid], reach
                ):
                    names = [f"{solid}.{a.name}", f"{other}.{b.name}"]
                    slave, master = names if a.area <= b.area else names[::-1]
                    pairs.setdefault((slave, master), ContactPair(slave, master))
    return tuple(pairs.values())


def _domain(path: str | Path | StepFile) -> StepFile:
    """Return a StepFile, that of a path with all solids."""
    return path if isinstance(path, StepFile) else StepFile(path)


def _faces_of(worker: Netgen, solids: Mapping[str, StepSolid]) -> Iterator[tuple[str, list[_Face]]]:
    """Yield the name of each solid, and its faces with their triangles."""
    for body, solid in solids.items():
        shape = built_shape(worker, solid)
        size = _EDGE * float(np.ptp(shape.corners, axis=0).max())
        try:
            limit = _LIMIT_S + _FACE_S * len(solid.faces)
            points, triangles, owner = worker("step_surface", size, seconds=limit)
        except NetgenFails as error:
            raise ValueError(
                f"{str(solid.file.path)!r}: the surface of {body!r} cannot be meshed: {error}"
            ) from error
        places = shape.lower + shape.scale * points[triangles].reshape(-1, 3, 3)
        faces = [_face(shape, k, name, places[owner == k]) for k, name in enumerate(solid.faces)]
        yield body, faces


def _face(shape: Shape, number: int, name: str, triangles: np.ndarray = _NONE) -> _Face:
    """Return a face of a shape in m, with the corners (n, 3, 3) of the triangles of its surface mesh, if
    there is one; its kind is that of the surface through its samples."""
    kind = "other"
    radius = np.nan
    if surfaces := surfaces_through(shape.samples[number]):
        surface = surfaces[0]  # the patches of a face have one surface
        kind = "cone or torus"
        if surface.plane:
            kind = "plane"
        elif surface.cylinder or surface.sphere:
            kind = "cylinder" if surface.cylinder else "sphere"
            radius = surface.extent * shape.scale
    return _Face(
        number,
        name,
        kind,
        shape.areas[number] * shape.scale**2,
        shape.lower + shape.scale * shape.centres[number],
        radius,
        triangles,
    )


def _touches(worker: Netgen, face: _Face, other: _Face, solid: StepSolid, reach: float) -> bool:
    """Return whether a triangle of a face lies within ``reach``, m, of another face, of a solid, which
    looks the other way there."""
    from scipy.spatial import cKDTree  # a first solve without it starts sooner

    # corners lie on round faces, centroids of their triangles do not; plane faces may have all
    # corners on their rims
    places = face.triangles.mean(axis=1)[:, None] if face.kind == "plane" else face.triangles
    path = Path(solid.file.path)
    unit = solid.file.unit
    try:
        near = worker(
            "face_distances",
            str(path.absolute()),
            solid.number,
            other.number,
            places.reshape(-1, 3) / unit,
            seconds=_LIMIT_S + _POINT_S * places.size / 3,
        )
    except NetgenFails as error:
        raise ValueError(
            f"{str(path)!r}: OCC cannot tell how far {other.name!r} is: {error}"
        ) from error
    close = np.flatnonzero((near.reshape(len(places), -1) * unit <= reach).all(axis=1))
    if not len(close):
        return False
    nearest = cKDTree(other.triangles.mean(axis=1)).query(face.triangles[close].mean(axis=1))[1]
    face_normals = face.normals[close]
    other_normals = other.normals[nearest]
    cosine = (face_normals * other_normals).sum(axis=1) / (
        np.linalg.norm(face_normals, axis=1) * np.linalg.norm(other_normals, axis=1)
    )
    return bool((cosine < _OPPOSITE).any())


def exact_surfaces(domain: Domain | None, names: Sequence[str]) -> dict[str, list[Revolved]]:
    """Return the surfaces that the faces of some boundaries of a domain lie on, m, in no order;
    boundaries with faces of other kinds (splines) are left out."""
    if isinstance(domain, StepFile):
        return _surfaces_of_file(domain, names)
    surfaces = surfaces_of(domain)
    return {name: surfaces[name] for name in names if name in surfaces}


def _surfaces_of_file(domain: StepFile, names: Sequence[str]) -> dict[str, list[Revolved]]:
    """Return the surfaces of a file by name; none where it is gone, for a mesh may outlive it."""
    bodies = frozenset(name.partition(".")[0] for name in names)
    try:
        return _read_surfaces(domain, Path(domain.path).stat().st_mtime_ns, bodies)
    except (OSError, ValueError) as error:
        _LOG.info("gaps are measured between chords: %s", error)
        return {}


@lru_cache(maxsize=8)
def _read_surfaces(
    domain: StepFile, _changed: int, bodies: frozenset[str]
) -> dict[str, list[Revolved]]:
    """Return the surfaces of the faces "body.face" of some bodies, without faces of which a part lies
    on no known surface; those of a file are read once as long as it does not change."""
    faces: dict[str, list[list[Revolved]]] = {}
    solids = {body: solid for body, solid in step_solids(domain).items() if body in bodies}
    with netgen() as worker:
        for body, solid in solids.items():
            shape = built_shape(worker, solid)
            for face, samples in zip(shape.names, shape.samples, strict=True):
                moved = [
                    surface.moved(np.eye(3), shape.lower, shape.scale)
                    for surface in surfaces_through(samples)
                ]
                faces.setdefault(f"{body}.{face}", []).append(moved)
    return {name: list(chain(*patches)) for name, patches in faces.items() if all(patches)}
