"""from_step: STEP files of one or several solids, each meshed apart by Netgen; names of solids and faces are kept.

The solids share no nodes, even where their faces coincide: contact pairs join them. OCC turns every unit of length a
file may use into millimetres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import netgen.meshing
import numpy as np
from netgen.occ import OCCGeometry, Pnt, Solid, Vec

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.netgen_guard import check_step, interruptible
from adaptmg.mesh.netgen_solid import SolidSizes, shape_mesh
from adaptmg.mesh.ngsolve_bridge import with_source
from adaptmg.mesh.structured import boundaries_of, merged, per_body
from adaptmg.problem.solid_domains import StepFile

__all__ = ["from_step", "step_mesh", "step_names", "step_shapes"]

Sizes = float | Mapping[str, float]


def from_step(path: str | Path, size: Sizes, boundary_sizes: Mapping[str, float] | None = None, *,
              grading: float = 0.3, size_function: float | Callable[[np.ndarray], np.ndarray] | None = None,
              unit: float = 1e-3, names: Mapping[str, str] | None = None, curvature: float = 2.0) -> MeshArrays:
    """Read and mesh a STEP file.

    Parameters
    ----------
    path : str or Path
        A ``.step`` or ``.stp`` file with one or several solids.
    size, boundary_sizes, grading, size_function, curvature
        As of :func:`step_mesh`.
    unit, names
        As of :class:`adaptmg.problem.solid_domains.StepFile`.

    Returns
    -------
    MeshArrays
        As of :func:`step_mesh`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    TypeError, ValueError
        If it cannot be read, has no solids, on unknown names, bad sizes, or where Netgen fails.
    """
    domain = StepFile(path, unit, {} if names is None else names)
    return step_mesh(domain, size, boundary_sizes, grading, size_function, curvature=curvature)


def step_mesh(domain: StepFile, size: Sizes, boundary_sizes: Mapping[str, float] | None = None, grading: float = 0.3,
              size_function: float | Callable[[np.ndarray], np.ndarray] | None = None, *, curvature: float = 2.0
              ) -> MeshArrays:
    """Mesh the solids of a STEP file with straight tetrahedra, each solid apart."""
    if not isinstance(domain, StepFile):
        raise TypeError(f"domain must be a StepFile, got {domain!r}")
    solids, contents = _read(domain)
    known = [f"{body}.{face}" for body, faces in contents.items() for face in faces]
    for name in boundary_sizes or {}:
        if name not in known:
            raise ValueError(f"boundary_sizes: boundary {name!r} does not exist; the boundaries are "
                             f"{', '.join(dict.fromkeys(known))}")
    meshes = {}
    for (body, faces), solid, largest in zip(contents.items(), solids, per_body("size", size, list(contents)).values(),
                                             strict=True):
        own = {face: boundary_sizes[f"{body}.{face}"] for face in boundaries_of(body, list(boundary_sizes or {}))}
        shape, lower, scale = _unit_sized(solid)
        sizes = SolidSizes(largest, own, grading, size_function, curvature)
        mesh = shape_mesh(shape, list(faces), domain.unit * lower, domain.unit * scale, sizes, domain)
        meshes[body] = with_source(mesh)
    return merged(meshes)


def step_shapes(domain: StepFile) -> dict[str, tuple[Solid, list[str], np.ndarray, float]]:
    """By the name of each solid: its shape at unit size, the names of its faces, where its origin lies, its unit, m."""
    solids, contents = _read(domain)
    result = {}
    for (body, faces), solid in zip(contents.items(), solids, strict=True):
        shape, lower, scale = _unit_sized(solid)
        result[body] = (shape, list(faces), domain.unit * lower, domain.unit * scale)
    return result


def step_names(path: str | Path | StepFile) -> dict[str, tuple[str, ...]]:
    """What a STEP file holds: the names of the faces of each solid, as meshes will have them.

    Parameters
    ----------
    path : str, Path or StepFile
        A StepFile may rename them.

    Returns
    -------
    dict of str to tuple of str
        For each solid one name a face, in the order of the file; several faces may have the same one.
    """
    return _read(path if isinstance(path, StepFile) else StepFile(path))[1]


def _read(domain: StepFile) -> tuple[list[Solid], dict[str, tuple[str, ...]]]:
    """The solids of a file, and the names of their faces by those of the solids."""
    path = domain.path
    if not path.is_file():
        raise FileNotFoundError(f"path: there is no file {str(path)!r}")
    if path.suffix.lower() not in (".step", ".stp"):
        raise ValueError(f"path: {str(path)!r} is not a .step or .stp file")
    check_step(path)
    try:
        geometry = interruptible(OCCGeometry, str(path))
    except (netgen.meshing.NgException, RuntimeError) as error:
        raise ValueError(f"{str(path)!r} cannot be read as a STEP file ({error})") from error
    solids = list(geometry.solids)
    if not solids:
        raise ValueError(f"{str(path)!r} holds no solids; surfaces must be closed and sewn into solids before they are "
                         "written")
    bodies = [(solid.name or f"solid{i + 1}").replace(".", "_") for i, solid in enumerate(solids)]
    faces = [[(face.name or f"face{j + 1}").replace(".", "_") for j, face in enumerate(solid.faces)]
             for solid in solids]
    for name in (*bodies, *(name for own in faces for name in own)):
        checks.boundary_name(f"a name in {str(path)!r}", name)
    return solids, _renamed(domain, _distinct(bodies), faces)


def _distinct(names: list[str]) -> list[str]:
    """Names with "_2", "_3", ... added to those that come again."""
    result: list[str] = []
    for name in names:
        candidates = [name] + [f"{name}_{k}" for k in range(2, len(names) + 1)]
        result.append(next(c for c in candidates if c not in result))
    return result


def _renamed(domain: StepFile, bodies: list[str], faces: list[list[str]]) -> dict[str, tuple[str, ...]]:
    """Names after the mapping of the domain; every key of it must be used."""
    unused, result = set(domain.names), {}

    def new(keys: list[str], name: str) -> str:
        for key in keys:
            if key in domain.names:
                unused.discard(key)
                return domain.names[key]
        return name

    for i, (body, own) in enumerate(zip(bodies, faces, strict=True)):
        solid = (body, f"solid{i + 1}")
        name = new(list(solid), body)
        if name in result:
            raise ValueError(f"names: two solids are called {name!r}; each is a body with a name of its own")
        result[name] = tuple(new([f"{s}.{f}" for s in solid for f in (face, f"face{j + 1}")], face)
                             for j, face in enumerate(own))
    if unused:
        listed = "; ".join(f"{body}: {', '.join(dict.fromkeys(own))}" for body, own in zip(bodies, faces, strict=True))
        raise ValueError(f"names: {', '.join(map(repr, sorted(unused)))} is neither a solid nor a 'solid.face' of "
                         f"{str(domain.path)!r}; it holds {listed}")
    return result


def _unit_sized(solid: Solid) -> tuple[Solid, np.ndarray, float]:
    """A copy of about unit size at the origin; where its origin was and its unit, in the units of the file."""
    lower, upper = (np.array([p.x, p.y, p.z]) for p in solid.bounding_box)
    scale = float((upper - lower).max())
    shape = solid.Move(Vec(*(-lower))).Scale(Pnt(0, 0, 0), 1 / scale)
    return shape.solids[0], lower, scale
