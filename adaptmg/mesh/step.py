"""STEP files of one or several solids, each meshed apart by Netgen; names of solids and faces are kept.

The solids share no nodes, even where their faces coincide: contact pairs join them. OCC turns every unit of length a
file may use into millimetres, and reads the file in the process of :mod:`adaptmg.mesh.netgen_guard`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

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
# of products without a name, as OCC writes them
_NO_PRODUCT = "Open CASCADE STEP translator"
# nodes on round faces, whose number is not known: for the time limit
_CURVED = 1e4


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
    """Yield the name and the shape of each solid in turn: the process holds one of them at a time."""
    for k, (body, faces) in enumerate(contents.items()):
        try:
            (_, *tables), lower, scale = worker("step_shape", k, seconds=_START_S)
        except NetgenFails as error:
            raise ValueError(f"{str(domain.path)!r} cannot be read as a STEP file: {error}") from error
        yield body, Shape(list(faces), *tables, domain.unit * lower, domain.unit * scale)


def step_contents(worker: Netgen, domain: StepFile) -> dict[str, tuple[str, ...]]:
    """Return the names of the faces of a file by those of its solids, which the process holds then."""
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
    named = [_plain((product if not product.startswith(_NO_PRODUCT) else "") or own or f"solid{i + 1}")
             for i, (product, own, _) in enumerate(solids)]
    faces = [[_plain(name or f"face{j + 1}") for j, name in enumerate(own)] for *_, own in solids]
    for name in (*named, *(name for own in faces for name in own)):
        checks.boundary_name(f"a name in {str(path)!r}", name)
    contents = _renamed(domain, _distinct(named), faces)
    if domain.solids is None:
        return contents
    chosen = _chosen(domain, named, list(contents))
    worker("choose_solids", chosen, seconds=_START_S)
    bodies = list(contents.items())
    return dict(bodies[k] for k in chosen)


def _plain(name: str) -> str:
    return name.replace(".", "_")


def _chosen(domain: StepFile, named: Sequence[str], bodies: Sequence[str]) -> list[int]:
    """The numbers of the solids that a domain chooses, by their names in the file or those of its bodies."""
    chosen: list[int] = []
    for entry in domain.solids:
        same = [k for k, name in enumerate(named) if name == _plain(entry)]
        same = same or [k for k, name in enumerate(bodies) if name == _plain(entry)]
        base, _, number = entry.rpartition(".")
        if not same and number.isdecimal():
            instances = [k for k, name in enumerate(named) if name == _plain(base)]
            same = instances[int(number) - 1:int(number)] if int(number) else []
        if not same:
            raise ValueError(f"solids: there is no solid {entry!r}{checks.suggestion(entry, bodies)}; "
                             f"{str(domain.path)!r} holds {', '.join(bodies)}")
        chosen += [k for k in same if k not in chosen]
    return chosen


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
