"""from_step: STEP files of one or several solids, each meshed apart by Netgen; names of solids and faces are kept.

The solids share no nodes, even where their faces coincide: contact pairs join them. OCC turns every unit of length a
file may use into millimetres, and reads the file in the process of :mod:`adaptmg.mesh.netgen_guard`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import file_size
from adaptmg.mesh.arrays import MeshArrays, swept
from adaptmg.mesh.netgen_guard import Netgen, NetgenFails, netgen
from adaptmg.mesh.netgen_solid import Shape, SolidSizes, shape_mesh
from adaptmg.mesh.soundness import check_mesh
from adaptmg.mesh.structured import boundaries_of, merged, per_body
from adaptmg.problem.solid_domains import StepFile

Sizes = float | Mapping[str, float]
SizeFunction = float | Callable[[np.ndarray], np.ndarray]
# reading takes about a second a megabyte; twenty times that is the limit
_START_S, _S_PER_BYTE, _BYTES_PER_BYTE = 60.0, 2e-5, 50
# nodes on round faces, whose number is not known: for the time limit
_CURVED = 1e4


def from_step(path: str | Path, size: Sizes, boundary_sizes: Mapping[str, float] | None = None, *,
              grading: float = 0.3, size_function: SizeFunction | None = None,
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
    FileNotFoundError, TypeError, ValueError
        If it is not there, cannot be read, has no solids, on unknown names, bad sizes, or where Netgen fails.
    """
    domain = StepFile(path, unit, {} if names is None else names)
    return step_mesh(domain, size, boundary_sizes, grading, size_function, curvature=curvature)


def step_mesh(domain: StepFile, size: Sizes, boundary_sizes: Mapping[str, float] | None = None, grading: Sizes = 0.3,
              size_function: SizeFunction | Mapping[str, SizeFunction] | None = None, *, curvature: float = 2.0,
              mesher: str = "own") -> MeshArrays:
    """Mesh the solids of a STEP file with straight tetrahedra, each solid apart."""
    if not isinstance(domain, StepFile):
        raise TypeError(f"domain must be a StepFile, got {domain!r}")
    with netgen() as worker:
        contents = step_contents(worker, domain)
        known = [f"{body}.{face}" for body, faces in contents.items() for face in faces]
        for name in boundary_sizes or {}:
            if name not in known:
                raise ValueError(f"boundary_sizes: boundary {name!r} does not exist; the boundaries are "
                                 f"{', '.join(dict.fromkeys(known))}")
        largest, meshes = per_body("size", size, list(contents)), {}
        functions = per_body("size_function", size_function, list(contents))
        gradings = per_body("grading", grading, list(contents))
        for body, shape in step_shapes(worker, domain, contents):
            own = {face: boundary_sizes[f"{body}.{face}"] for face in boundaries_of(body, list(boundary_sizes or {}))}
            sizes = SolidSizes(largest[body], own, gradings[body], functions[body], curvature)
            meshes[body] = check_mesh(shape_mesh(worker, shape, sizes, domain, _CURVED, mesher))
    return swept(merged(meshes))


def step_shapes(worker: Netgen, domain: StepFile, contents: Mapping[str, tuple[str, ...]]
                ) -> Iterator[tuple[str, Shape]]:
    """The name and the shape of each solid in turn: the process holds one of them at a time."""
    for k, (body, faces) in enumerate(contents.items()):
        try:
            (_, *tables), lower, scale = worker("step_shape", k, seconds=_START_S)
        except NetgenFails as error:
            raise ValueError(f"{str(domain.path)!r} cannot be read as a STEP file: {error}") from error
        yield body, Shape(list(faces), *tables, domain.unit * lower, domain.unit * scale)


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
    with netgen() as worker:
        return step_contents(worker, path if isinstance(path, StepFile) else StepFile(path))


def step_contents(worker: Netgen, domain: StepFile) -> dict[str, tuple[str, ...]]:
    """The names of the faces of a file by those of its solids, which the process holds then."""
    path = domain.path
    size = file_size("path", path)
    if path.suffix.lower() not in (".step", ".stp"):
        raise ValueError(f"path: {str(path)!r} is not a .step or .stp file")
    checks.fits("path", _BYTES_PER_BYTE * size, f"reading {str(path)!r}")
    try:
        solids = worker("read_step", str(path.absolute()), seconds=_START_S + _S_PER_BYTE * size)
    except NetgenFails as error:
        raise ValueError(f"{str(path)!r} cannot be read as a STEP file: {error}") from error
    if not solids:
        raise ValueError(f"{str(path)!r} holds no solids; surfaces must be closed and sewn into solids before they are "
                         "written")
    bodies = [(name or f"solid{i + 1}").replace(".", "_") for i, (name, _) in enumerate(solids)]
    faces = [[(name or f"face{j + 1}").replace(".", "_") for j, name in enumerate(own)] for _, own in solids]
    for name in (*bodies, *(name for own in faces for name in own)):
        checks.boundary_name(f"a name in {str(path)!r}", name)
    return _renamed(domain, _distinct(bodies), faces)


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
            raise ValueError(f"names: two solids are called {name!r}; each is a body and needs another name")
        result[name] = tuple(new([f"{s}.{f}" for s in solid for f in (face, f"face{j + 1}")], face)
                             for j, face in enumerate(own))
    if unused:
        listed = "; ".join(f"{body}: {', '.join(dict.fromkeys(own))}" for body, own in zip(bodies, faces, strict=True))
        raise ValueError(f"names: {', '.join(map(repr, sorted(unused)))} is neither a solid nor a 'solid.face' of "
                         f"{str(domain.path)!r}; it holds {listed}")
    return result
