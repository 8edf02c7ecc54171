"""mesh: a mesh with the names of its boundaries and bodies as a file of Gmsh, or as a deck of Abaqus or CalculiX."""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import waiting_folder, write_bytes
from adaptmg.mesh.arrays import MeshArrays, element_facets, facet_keys
from adaptmg.mesh.soundness import check_mesh

#: by dimension: Abaqus' type of element, and its number of the facet opposite each node
_ELEMENTS = {2: ("CPE3", np.array([2, 3, 1])), 3: ("C3D4", np.array([3, 4, 2, 1]))}


def mesh(mesh: MeshArrays, path: str | os.PathLike[str], *, unit: float = 1.0) -> None:
    """Write a mesh to a ``.msh`` or ``.inp`` file, which appears complete or not at all.

    :func:`adaptmg.mesh.from_file` reads it back with its names. Boundaries become physical groups, or surfaces and sets
    of nodes with the same names; bodies become physical groups, or sets of elements.

    Parameters
    ----------
    mesh : MeshArrays
        For instance ``result.mesh``.
    path : path
        ``.msh`` (MSH 2.2, text, by meshio) or ``.inp``.
    unit : float
        Length in m of one unit of the file: 1e-3 writes mm.

    Raises
    ------
    TypeError, ValueError
        On a mesh that is not sound, another kind of file, or names that it cannot hold: with quotation marks, in a deck
        also with commas and equals signs, or that differ in capitals only.

    Examples
    --------
    >>> square = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> am.export.mesh(square, "square.msh")
    >>> am.mesh.from_file("square.msh").boundaries == square.boundaries
    True
    """
    check_mesh(mesh)
    target, unit = checks.file_path("path", path), checks.quantity("unit", unit, positive=True)
    if target.suffix not in (".msh", ".inp"):
        raise ValueError(f"path must end in .msh or .inp, got {os.fspath(path)!r}")
    deck = target.suffix == ".inp"
    for names in (mesh.boundaries, mesh.bodies):
        for name in names:
            if any(sign in name for sign in ('",=' if deck else '"')) or name != name.strip():
                raise ValueError(f"{target.suffix} files cannot hold the name {name!r}: rename it")
        if deck and len({name.upper() for name in names}) < len(names):
            raise ValueError(f"names of a deck must differ in more than capitals, got {', '.join(names)}")
    write_bytes(target, (_deck if deck else _gmsh)(mesh, mesh.points / unit))


def _gmsh(mesh: MeshArrays, points: np.ndarray) -> bytes:
    import meshio

    dim = mesh.dim
    solid, face = (("triangle", "line"), ("tetra", "triangle"))[dim - 2]
    tags = [mesh.element_body.astype(np.int32) + 1, mesh.facet_labels.astype(np.int32) + 1]
    names = {name: np.array([k + 1, dim - 1]) for k, name in enumerate(mesh.boundaries)}
    if common := sorted(set(names).intersection(mesh.bodies)):
        raise ValueError(f"a boundary and a body are both called {', '.join(common)}: rename one")
    names |= {name: np.array([k + 1, dim]) for k, name in enumerate(mesh.bodies)}
    raw = meshio.Mesh(np.pad(points, ((0, 0), (0, 3 - dim))), [(solid, mesh.elements), (face, mesh.facets)],
                      cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags}, field_data=names)
    with waiting_folder() as folder:
        meshio.write(Path(folder, "mesh.msh"), raw, "gmsh22", binary=False)
        return Path(folder, "mesh.msh").read_bytes()


def _deck(mesh: MeshArrays, points: np.ndarray) -> bytes:
    out = io.StringIO()
    kind, numbers = _ELEMENTS[mesh.dim]

    def rows(table: np.ndarray, form: str = "%d") -> None:
        np.savetxt(out, table, fmt=form, delimiter=", ")

    out.write("*NODE\n")
    rows(np.column_stack([np.arange(1, len(points) + 1), points]), ", ".join(["%d"] + ["%.17g"] * mesh.dim))
    for k, body in enumerate(mesh.bodies):
        mine = np.flatnonzero(mesh.element_body == k)
        out.write(f"*ELEMENT, TYPE={kind}, ELSET={body}\n")
        rows(np.column_stack([mine, mesh.elements[mine]]) + 1)
    keys = facet_keys(element_facets(mesh.elements).reshape(-1, mesh.dim), mesh.n_nodes)
    order = np.argsort(keys)
    at = order[np.searchsorted(keys[order], facet_keys(mesh.facets, mesh.n_nodes))]
    for k, name in enumerate(mesh.boundaries):
        element, opposite = np.divmod(at[mesh.facet_labels == k], mesh.dim + 1)
        out.write(f"*NSET, NSET={name}\n")
        rows(mesh.boundary_nodes(name) + 1)
        out.write(f"*SURFACE, NAME={name}, TYPE=ELEMENT\n")
        rows(np.column_stack([element + 1, numbers[opposite]]), "%d, S%d")
    return out.getvalue().encode()
