"""Meshes from files and from NGSolve: ``from_gmsh``, ``as_mesh``.

meshio reads files of Gmsh (MSH 2.2 and 4.1), Netgen its own (.vol, .vol.gz), both in the process of
:mod:`adaptmg.mesh.netgen_guard` with limits of time and memory: damaged numbers may lead a reader anywhere. What comes
back is checked like every other mesh. Physical groups of Gmsh name boundaries and bodies; bodies that share the nodes
of an interface are glued there, or split: then each has separate nodes, and the interface is a boundary of both.
"""

from __future__ import annotations

import gzip
import io
import re
import sys
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import file_size, read_bytes, waiting_folder
from adaptmg._on_demand import OnDemand
from adaptmg.mesh.arrays import MeshArrays, facet_keys, facet_table, normalised
from adaptmg.mesh.netgen_guard import NetgenFails, netgen
from adaptmg.mesh.soundness import check_mesh, check_stranger

if TYPE_CHECKING:
    import ngsolve

# meshio's names of the cells of first and second order, by dimension
_CELLS = {0: ("vertex",), 1: ("line", "line3"), 2: ("triangle", "triangle6"), 3: ("tetra", "tetra10")}
# unpacked over packed size: meshes reach about 30
_MAX_PACKING = 200
# Netgen's types of triangles and tetrahedra of second order
_CURVED = (12, 21)
# what a reader may take for each byte of a file
_START_S, _S_PER_BYTE = 60.0, 1e-5
_START_BYTES, _BYTES_PER_BYTE = 3e9, 100


def as_mesh(mesh: MeshArrays | ngsolve.Mesh | str | Path) -> MeshArrays:
    """Convert to checked MeshArrays.

    Parameters
    ----------
    mesh : MeshArrays, ngsolve.Mesh, str or Path
        A mesh, or a file of Gmsh (``.msh``) or Netgen (``.vol``, ``.vol.gz``).

    Returns
    -------
    MeshArrays
        With its source; the same object if it was MeshArrays with a source already.

    Raises
    ------
    TypeError, FileNotFoundError, ValueError
        If it is none of these, there is no such file, it cannot be read, or it is not sound (:func:`check_mesh`).

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> am.mesh.as_mesh(mesh) is mesh
    True
    """
    if isinstance(mesh, MeshArrays):
        return check_mesh(mesh) if _fits(mesh) else check_stranger(mesh)
    if _is_ngsolve(mesh):
        return from_ngsolve(mesh)
    if not isinstance(mesh, str | Path):
        raise TypeError("mesh must be MeshArrays, an ngsolve.Mesh or the path of a .msh, .vol or .vol.gz file, "
                        f"got {type(mesh).__name__}")
    path = _file("mesh", mesh)
    if path.suffix == ".msh":
        return from_gmsh(path)
    if path.name.endswith((".vol", ".vol.gz")):
        return _from_netgen_file(path)
    if path.suffix.lower() in (".step", ".stp"):
        raise ValueError(f"mesh: {str(path)!r} is a geometry, not a mesh: adaptmg.mesh.from_step(path, size) meshes it")
    raise ValueError(f"mesh: {str(path)!r} is not a .msh, .vol or .vol.gz file; other formats can be converted to .msh "
                     "by meshio")


def _is_ngsolve(mesh: object) -> bool:
    """Whether it is an ngsolve.Mesh; NGSolve is not loaded for the question."""
    module = sys.modules.get("ngsolve")
    return module is not None and isinstance(mesh, module.Mesh)


def _fits(mesh: MeshArrays) -> bool:
    """Whether the source is still that of the arrays: dataclasses.replace keeps it with new ones."""
    if isinstance(vars(mesh)["source"], OnDemand):
        return mesh.sound
    if not _is_ngsolve(mesh.source) or mesh.points.ndim != 2:
        return False
    ngmesh = mesh.source.ngmesh
    points = np.array(ngmesh.Coordinates(), dtype=np.float64)
    volume = ngmesh.Elements2D() if mesh.dim == 2 else ngmesh.Elements3D()
    return (mesh.source.dim == mesh.dim and len(volume) == len(mesh.elements)
            and np.array_equal(points[:, :mesh.dim], mesh.points))


def from_ngsolve(mesh: ngsolve.Mesh) -> MeshArrays:
    """Read an NGSolve mesh.

    Parameters
    ----------
    mesh : ngsolve.Mesh
        Straight triangles or tetrahedra. Materials become bodies, those with the same name one body; boundaries inside
        the mesh (interfaces of glued materials) are left out.

    Returns
    -------
    MeshArrays
        Copies: refining ``mesh`` later changes nothing here. The nodes keep their numbers unless some belong to no
        element (these are dropped). ``source`` is another, straight mesh with the same node numbers.

    Raises
    ------
    TypeError, ValueError
        If it is not an NGSolve mesh; on other elements, curved or of second order, a deformation, periodic boundaries,
        dimensions other than 2 and 3, or a mesh that is not sound (:func:`adaptmg.mesh.check_mesh`).

    Examples
    --------
    >>> mesh = am.mesh.graded(am.Rectangle(width=1, height=1), 0.5)
    >>> am.mesh.from_ngsolve(mesh.source).n_nodes == mesh.n_nodes
    True
    """
    import ngsolve

    from adaptmg.mesh.netgen_worker import tables

    if not isinstance(mesh, ngsolve.Mesh):
        raise TypeError(f"mesh must be an ngsolve.Mesh, got {type(mesh).__name__}")
    types = np.concatenate([table.NumPy()["type"] for table in (mesh.ngmesh.Elements2D(), mesh.ngmesh.Elements3D())])
    order = 2 if np.isin(types, _CURVED).any() else mesh.GetCurveOrder()
    if order > 1:
        raise ValueError(f"mesh has curved elements (order {order}), bodies are made of straight ones: give the mesh "
                         "before SecondOrder() and Curve(), finer where its boundary is curved")
    if mesh.deformation is not None:
        raise ValueError("mesh has a deformation, which would be left out: call mesh.UnsetDeformation(), or move the "
                         "nodes")
    if mesh.ngmesh.GetIdentifications():
        raise ValueError("mesh has identified nodes (periodic boundaries), which a contact problem does not know: make "
                         "it without them")
    return check_stranger(normalised(*tables(mesh.ngmesh, mesh.GetBoundaries(), mesh.GetMaterials())))


def _file(name: str, path: str | Path) -> Path:
    path = checks.file_path(name, path)
    checks.fits(name, _BYTES_PER_BYTE * file_size(name, path), f"reading {str(path)!r}")
    return path


def _read(function: str, path: Path) -> Any:
    """What a reader of the other process makes of a file."""
    size = path.stat().st_size
    with netgen() as worker:
        return worker(function, str(path.absolute()), seconds=_START_S + _S_PER_BYTE * size,
                      memory=_START_BYTES + _BYTES_PER_BYTE * size)


def from_gmsh(path: str | Path, *, unnamed: str | None = None, split_bodies: bool = False) -> MeshArrays:
    """Read a Gmsh mesh of triangles in the plane, or of tetrahedra.

    Parameters
    ----------
    path : str or Path
        An ``.msh`` file, MSH 2.2 or 4.1, coordinates in m. Physical curves (3D: surfaces) become boundaries, physical
        surfaces (3D: volumes) bodies; groups without a name are called by their number. Of second-order elements the
        corners are read. Points of no element (centres of circles) are dropped.
    unnamed : str, optional
        Name for the boundary facets that belong to no physical group; default "free", which a warning says.
    split_bodies : bool
        Give each body separate nodes, so that bodies touch only through contact. Boundaries are then called
        "body.boundary" (a "." in the name of a body becomes "_"); a physical curve or surface between two bodies is a
        boundary of both. By default bodies stay glued where they share nodes, and boundaries keep their names.

    Returns
    -------
    MeshArrays
        With its source. With ``split_bodies``, nodes, elements and facets come body by body.

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such file; if it cannot be read, has other elements, is not plane, has no physical surfaces (3D:
        volumes), or is not sound (:func:`adaptmg.mesh.check_mesh`).

    Examples
    --------
    A Gmsh script names what a problem speaks of. Curves become boundaries, the surface a body::

        SetFactory("OpenCASCADE");
        Rectangle(1) = {0, 0, 0, 0.2, 0.1};
        Disk(2) = {0.1, 0.05, 0, 0.02};
        BooleanDifference(3) = { Surface{1}; Delete; }{ Surface{2}; Delete; };
        Physical Curve("hole") = {5};
        Physical Curve("bottom") = {6};     // Tools > Visibility shows the numbers
        Physical Curve("left") = {7};
        Physical Curve("top") = {8};
        Physical Curve("right") = {9};
        Physical Surface("plate") = {3};

    ``gmsh -2 -clmax 0.01 plate.geo -o fine.msh`` meshes it. Then the names are those of the problem, which needs no
    domain: ``am.Contact("bottom", ...)``, ``am.Pressure("top", ...)``, ``material={"plate": ...}`` or one for all;

    >>> problem = am.ContactProblem(material=am.PlaneStrain(young=2e11, poisson=0.3), law=am.Coulomb(0.3),
    ...                             contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
    ...                             loads=[am.Pressure("top", 5e7)], supports=[am.Symmetry("left")])
    >>> grids = am.Hierarchy.from_meshes(problem, ["coarse.msh", "fine.msh"])      # doctest: +SKIP
    >>> am.plot.problem(problem, mesh=grids.finest.mesh)                           # doctest: +SKIP
    """
    path = _file("path", path)
    if unnamed is not None:
        checks.boundary_name("unnamed", unnamed)
    try:
        points, blocks, groups = _read("read_gmsh", path)
    except NetgenFails as error:
        # partial groups fail in MSH 4.1
        raise ValueError(f"{str(path)!r} cannot be read as a Gmsh mesh ({error}); it must be MSH 2.2 or 4.1, and in "
                         "4.1 all entities that are saved need a physical group: set Mesh.SaveAll = 0 or "
                         "Mesh.MshFileVersion = 2.2") from error
    try:
        tables = _tables(points, blocks, groups, unnamed or "free")
        mesh, rest = _named(_split(tables) if split_bodies else tables, split_bodies)
    except ValueError as error:
        raise ValueError(f"{str(path)!r}: {error}") from error
    if len(rest) and unnamed is None:
        place = ", ".join(f"{c:.6g}" for c in rest[0])
        warnings.warn(f"{str(path)!r}: {len(rest)} facets of the boundary, one of them at ({place}), belong to no "
                      'physical group and are called "free"; unnamed= gives them another name', stacklevel=2)
    return mesh


@dataclass(frozen=True, eq=False)
class _Tables:
    """What a file holds: ``body`` and ``label`` index ``bodies`` and ``boundaries``; facets may lie between bodies."""

    points: np.ndarray
    elements: np.ndarray
    body: np.ndarray
    bodies: list[str]
    facets: np.ndarray
    label: np.ndarray
    boundaries: list[str]


_Blocks = list[tuple[str, np.ndarray, np.ndarray]]


def _tables(points: np.ndarray, blocks: _Blocks, groups: dict[tuple[int, int], str], unnamed: str) -> _Tables:
    """The tables of a file, named facets only."""
    kinds = {kind for kind, _, _ in blocks}
    other = kinds.difference(*_CELLS.values())
    if other:
        raise ValueError(f"it holds {', '.join(sorted(other))}; only triangles and tetrahedra can be used (in Gmsh: no "
                         "'Recombine', Mesh.ElementOrder 1 or 2)")
    dim = 3 if kinds.intersection(_CELLS[3]) else 2
    elements, body, bodies = _cells(blocks, groups, dim, "body")
    facets, label, boundaries = _cells(blocks, groups, dim - 1, unnamed)
    for name in (*bodies[1:], *boundaries[1:]):
        checks.boundary_name("the name of a physical group", name)
    if len(elements) == 0:
        raise ValueError("it has neither triangles nor tetrahedra (Gmsh saves only what is in a physical group: add a "
                         f"Physical {'Surface' if dim == 2 else 'Volume'})")
    if min(elements.min(), facets.min(initial=0)) < 0:
        raise ValueError("elements name nodes that it does not hold")
    used = points[np.unique(elements)]
    if dim == 2 and np.ptp(used[:, 2]) > 1e-9 * np.ptp(used[:, :2], axis=0).max():
        raise ValueError("it holds triangles only, but they are not in a plane z = constant: z runs from "
                         f"{used[:, 2].min():.6g} to {used[:, 2].max():.6g}; a body in space needs tetrahedra")
    return _Tables(points[:, :dim], elements, body, bodies, facets[label > 0], label[label > 0], boundaries)


def _cells(blocks: _Blocks, groups: dict[tuple[int, int], str], dim: int, unnamed: str
           ) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Corners of all cells of a dimension, the index of the physical group of each, and names; index 0 means none."""
    chosen = [(data[:, :dim + 1], tag) for kind, data, tag in blocks if kind in _CELLS[dim]]
    cells = np.concatenate([np.empty((0, dim + 1), dtype=np.int64)] + [data for data, _ in chosen])
    tag = np.concatenate([np.empty(0, dtype=np.int64)] + [t for _, t in chosen])
    numbers = np.union1d([0], tag).astype(np.int64)
    names = [unnamed] + [groups.get((dim, number), str(number)) for number in numbers[1:].tolist()]
    return cells, np.searchsorted(numbers, tag), names


def _split(tables: _Tables) -> _Tables:
    """The same body by body, with nodes of their own; facets are given to every body that has their nodes."""
    called = [name.replace(".", "_") for name in tables.bodies]
    bodies = list(dict.fromkeys(called[i] for i in np.unique(tables.body)))
    body = np.array([bodies.index(name) if name in bodies else -1 for name in called])[tables.body]
    order = np.argsort(body, kind="stable")
    elements, body, n = tables.elements[order], body[order], len(tables.points)
    # a node of a body is the pair (body, node) as one integer
    pairs = np.unique(elements + n * body[:, None])
    every = np.arange(len(bodies))
    facets = (tables.facets[None] + n * every[:, None, None]).reshape(-1, tables.facets.shape[1])
    row = np.minimum(np.searchsorted(pairs, facets), len(pairs) - 1)
    there = (pairs[row] == facets).all(axis=1)
    label = (tables.label[None] + len(tables.boundaries) * every[:, None]).reshape(-1)
    boundaries = [f"{name}.{boundary}" for name in bodies for boundary in tables.boundaries]
    return _Tables(tables.points[pairs % n], np.searchsorted(pairs, elements + n * body[:, None]), body, bodies,
                   row[there], label[there], boundaries)


def _named(tables: _Tables, split: bool) -> tuple[MeshArrays, np.ndarray]:
    """The checked mesh, and midpoints of the facets of one element only that got the first name, of each body if split.
    """
    n_nodes = len(tables.points)
    table = facet_table(tables.elements, n_nodes)
    outer = table.counts == 1
    row = table.find(facet_keys(tables.facets, n_nodes))
    outer[row[row >= 0]] = False
    rest, owner = table.facets[outer], table.first[outer]
    label = tables.body[owner] * (len(tables.boundaries) // len(tables.bodies)) * split
    facets, labels = np.concatenate([tables.facets, rest]), np.concatenate([tables.label, label])
    mesh = check_stranger(normalised(tables.points, tables.elements, facets, labels, tables.boundaries, tables.body,
                                     tables.bodies))
    return mesh, tables.points[rest].mean(axis=1)


def _from_netgen_file(path: Path) -> MeshArrays:
    """Read a mesh of Netgen."""
    try:
        text = _unpacked(path)
        with waiting_folder() as folder:
            # unpacked, and with nothing behind its end: geometry may follow there
            plain = Path(folder, "mesh.vol")
            plain.write_bytes(text)
            points, elements, facets, label, boundaries, body, bodies = _read("read_vol", plain)
        for name in (*boundaries, *bodies):
            checks.boundary_name("the name of a boundary or body", name)
        return check_stranger(normalised(points, elements, facets, label, boundaries, body, bodies))
    except ValueError as error:
        raise ValueError(f"{str(path)!r} cannot be read as a Netgen mesh: {error}") from error


def _unpacked(path: Path) -> bytes:
    """The bytes of a file up to the end of its mesh."""
    data = read_bytes(path)
    if path.suffix == ".gz":
        limit = _MAX_PACKING * len(data) + 2**20
        try:
            with gzip.open(io.BytesIO(data)) as stream:
                data = stream.read(limit + 1)
        except (OSError, EOFError, zlib.error) as error:
            raise ValueError(f"it cannot be unpacked: {error}") from error
        if len(data) > limit:
            raise ValueError(f"it unpacks to more than {_MAX_PACKING} times its size")
    mesh, end, _ = data.replace(b"\r\n", b"\n").partition(b"\nendmesh")
    if not re.match(rb"(\s|#[^\n]*\n)*mesh3d\s", mesh):
        raise ValueError("it does not begin with 'mesh3d'")
    if not end:
        raise ValueError("it is cut off: the keyword 'endmesh' is missing")
    counts = map(int, re.findall(rb"^[a-z]\w*\s*\n\s*(\d+)\s*$", mesh, re.MULTILINE))
    if max(counts, default=0) > mesh.count(b"\n"):
        raise ValueError("a section says more lines than the file has")
    return mesh + end + b"\n"
