"""from_gmsh: meshes of Gmsh (MSH 2.2 and 4.1), read through meshio; physical groups name boundaries and bodies.

Where bodies share the nodes of an interface they are glued, or split: then each body gets nodes of its own there, and
the interface is a boundary of both.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.build import with_source
from adaptmg.mesh.checks.overlap import check_overlap
from adaptmg.mesh.files.gmsh_check import check_gmsh_file
from adaptmg.mesh.files.normalise import normalised
from adaptmg.mesh.topology import facet_keys, facet_table
from adaptmg.problem import checks

__all__ = ["from_gmsh"]

# meshio's names of the cells of first and second order, by dimension
_LINES = ("line", "line3")
_TRIANGLES = ("triangle", "triangle6")
_TETRAHEDRA = ("tetra", "tetra10")
_POINTS = ("vertex",)


def from_gmsh(path: str | Path, *, unnamed: str | None = None, split_bodies: bool = False) -> MeshArrays:
    """Read a Gmsh mesh of triangles in the plane, or of tetrahedra.

    Parameters
    ----------
    path : str or Path
        An ``.msh`` file, MSH 2.2 or 4.1, coordinates in m. Physical curves (3D: surfaces) become boundaries, physical
        surfaces (3D: volumes) bodies; groups without a name are called by their number. Of second-order elements the
        corners are read. Points of no element (centres of circles) are dropped.
    unnamed : str, optional
        Name for the boundary facets that belong to no physical group. By default there must be none.
    split_bodies : bool
        Give each body nodes of its own, so that bodies touch only through contact. Boundaries are then called
        "body.boundary" (a "." in the name of a body becomes "_"); a physical curve or surface between two bodies is a
        boundary of both. By default bodies stay glued where they share nodes, and boundaries keep their names.

    Returns
    -------
    MeshArrays
        With its source. With ``split_bodies``, nodes, elements and facets come body by body.

    Raises
    ------
    ImportError
        Without meshio.
    FileNotFoundError
        If there is no such file.
    ValueError
        If it cannot be read, has other elements, is not plane, lacks physical groups, or is not sound
        (:func:`adaptmg.mesh.check_mesh`).
    """
    try:
        import meshio
    except ImportError as error:
        raise ImportError("reading Gmsh files needs meshio: pip install 'adaptmg[gmsh]'") from error
    path = checks.file_path("path", path)
    if unnamed is not None:
        checks.boundary_name("unnamed", unnamed)
    if not path.is_file():
        raise FileNotFoundError(f"path: there is no file {str(path)!r}")
    check_gmsh_file(path)
    try:
        raw = meshio.gmsh.read(path)
    except Exception as error:
        # meshio raises whatever its parser stumbles over (IndexError, KeyError, ...); partial groups fail in MSH 4.1
        raise ValueError(f"{str(path)!r} cannot be read as a Gmsh mesh ({type(error).__name__}: {error}); it must be "
                         "MSH 2.2 or 4.1, and in 4.1 all entities that are saved need a physical group: "
                         "set Mesh.SaveAll = 0 or Mesh.MshFileVersion = 2.2") from error
    kinds = {block.type for block in raw.cells}
    other = kinds.difference(_LINES, _TRIANGLES, _TETRAHEDRA, _POINTS)
    if other:
        raise ValueError(f"{str(path)!r} holds {', '.join(sorted(other))}; only triangles and tetrahedra can be used "
                         "(in Gmsh: no 'Recombine', Mesh.ElementOrder 1 or 2)")
    dim = 3 if kinds.intersection(_TETRAHEDRA) else 2
    tables = _tables(raw, dim, unnamed or "", path)
    if split_bodies:
        tables = _split(tables)
    rest, owner = _unnamed_facets(tables)
    if len(rest) and unnamed is None:
        what = "Physical Curve" if dim == 2 else "Physical Surface"
        place = ", ".join(f"{c:.6g}" for c in tables.points[rest[0]].mean(axis=0))
        raise ValueError(f"{str(path)!r}: {len(rest)} facets of the boundary, one of them at ({place}), belong to no "
                         f'physical group; name them in Gmsh, like {what}("contact") = {{1}};, '
                         'or here by unnamed="free"')
    # the first name, of each body if these are split, is the one of unnamed facets
    label = tables.body[owner] * (len(tables.boundaries) // len(tables.bodies)) * split_bodies
    facets, labels = np.concatenate([tables.facets, rest]), np.concatenate([tables.label, label])
    try:
        return check_overlap(with_source(normalised(tables.points, tables.elements, facets, labels, tables.boundaries,
                                                    tables.body, tables.bodies)))
    except ValueError as error:
        raise ValueError(f"{str(path)!r}: {error}") from error


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


def _tables(raw: Any, dim: int, unnamed: str, path: Path) -> _Tables:
    """The tables of a file, named facets only."""
    volumes, surfaces = (_TETRAHEDRA, _TRIANGLES) if dim == 3 else (_TRIANGLES, _LINES)
    elements, body, bodies = _cells(raw, volumes, dim, "body")
    facets, label, boundaries = _cells(raw, surfaces, dim - 1, unnamed)
    for name in (*bodies[1:], *boundaries[1:]):
        checks.boundary_name(f"{str(path)!r}: the name of a physical group", name)
    if len(elements) == 0:
        raise ValueError(f"{str(path)!r} has neither triangles nor tetrahedra (Gmsh saves only what is in a physical "
                         f"group: add a Physical {'Surface' if dim == 2 else 'Volume'})")
    if min(elements.min(), facets.min(initial=0)) < 0:
        raise ValueError(f"{str(path)!r} has elements with nodes that it does not hold")
    points = _plane(raw.points, elements, path) if dim == 2 else raw.points
    return _Tables(points, elements, body, bodies, facets[label > 0], label[label > 0], boundaries)


def _cells(raw: Any, kinds: tuple[str, ...], dim: int, unnamed: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Corners of all cells of some kinds, the index of the physical group of each, and names; index 0 means none."""
    tags = raw.cell_data.get("gmsh:physical", [np.zeros(len(block.data), dtype=np.int64) for block in raw.cells])
    chosen = [(block.data[:, :dim + 1], np.abs(tag)) for block, tag in zip(raw.cells, tags, strict=True)
              if block.type in kinds]
    cells = np.concatenate([np.empty((0, dim + 1), dtype=np.int64)] + [data for data, _ in chosen])
    tag = np.concatenate([np.empty(0, dtype=np.int64)] + [t for _, t in chosen])
    known = {int(number): name for name, (number, of_dim) in raw.field_data.items() if of_dim == dim}
    groups = np.union1d([0], tag).astype(np.int64)
    names = [unnamed] + [known.get(int(number), str(int(number))) for number in groups[1:]]
    return cells, np.searchsorted(groups, tag), names


def _plane(points: np.ndarray, elements: np.ndarray, path: Path) -> np.ndarray:
    """x and y of points whose elements lie in a plane z = constant."""
    used = points[np.unique(elements)]
    if np.ptp(used[:, 2]) > 1e-9 * np.ptp(used[:, :2], axis=0).max():
        raise ValueError(f"{str(path)!r} holds triangles only, but they are not in a plane z = constant: z runs from "
                         f"{used[:, 2].min():.6g} to {used[:, 2].max():.6g}; a body in space needs tetrahedra")
    return points[:, :2]


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


def _unnamed_facets(tables: _Tables) -> tuple[np.ndarray, np.ndarray]:
    """Facets of one element only that have no name, and that element."""
    n_nodes = len(tables.points)
    table = facet_table(tables.elements, n_nodes)
    outer = table.counts == 1
    row = table.find(facet_keys(tables.facets, n_nodes))
    outer[row[row >= 0]] = False
    return table.facets[outer], table.first[outer]
