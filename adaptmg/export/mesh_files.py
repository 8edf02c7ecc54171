"""Meshes, and results on them, as files of other programs.

:func:`mesh` writes a mesh with the names of its boundaries and bodies as a file of Gmsh, or as a deck of Abaqus or
CalculiX. :func:`vtk` and :func:`vtk_series` write results as VTK unstructured grids (.vtu), for
ParaView and others. meshio writes the formats that it knows.

SI units; vectors have three components, z = 0 in 2D. No value is NaN.

Point data: ``displacement`` m, ``reaction`` N (2D: N/m), of time steps ``velocity`` m/s; at contact
nodes ``contact_pressure`` Pa, ``contact_traction`` Pa (the tangential traction on the body),
``contact_gap`` m, ``contact_slip`` m, 0 elsewhere; ``contact_mask`` is 1 at contact nodes, where
``contact_state`` (0 open, 1 slip, 2 stick) and ``contact_pair`` are not -1. Between two bodies the
contact nodes are those of the slave surface, gap and slip relative to the master.

Cell data: ``body``, and with materials ``stress`` (xx, yy, zz, xy, yz, xz; axisymmetric: x = r, y
axial, zz the hoop stress) and ``von_mises``, Pa, constant in each cell.

Bodies and contact boundaries are numbered in the order of ``result.mesh.bodies`` and
``result.contact.names``."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._files import make_folder, read_bytes, waiting_folder, write_bytes
from adaptmg._text import printable
from adaptmg.discrete.coordinates import from_frames
from adaptmg.mesh.arrays import MeshArrays, element_facets, facet_keys, need_mesh
from adaptmg.mesh.soundness import check_mesh
from adaptmg.solver.result import Result

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
        On a mesh that is not sound, another kind of file, or names that it cannot hold: with
        quotation marks, in a deck also with commas and equals signs, or that differ in capitals
        only.

    Examples
    --------
    >>> square = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> am.export.mesh(square, "square.msh")
    >>> am.mesh.from_file("square.msh").boundaries == square.boundaries
    True
    """
    check_mesh(mesh)
    target = _file(path, ".msh", ".inp")
    unit = checks.quantity("unit", unit, positive=True)
    deck = target.suffix == ".inp"
    for names in (mesh.boundaries, mesh.bodies):
        for name in names:
            if any(sign in name for sign in ('",=' if deck else '"')) or name != name.strip():
                raise ValueError(f"{target.suffix} files cannot hold the name {name!r}: rename it")
        if deck and len({name.upper() for name in names}) < len(names):
            raise ValueError(
                f"names of a deck must differ in more than capitals, got {', '.join(names)}"
            )
    write_bytes(target, (_deck if deck else _gmsh)(mesh, mesh.points / unit))


def _file(path: str | os.PathLike[str], *suffixes: str) -> Path:
    """Return the path of a file to write; ValueError unless it ends in one of ``suffixes``."""
    target = checks.file_path("path", path)
    if target.suffix not in suffixes:
        raise ValueError(f"path must end in {' or '.join(suffixes)}, got {os.fspath(path)!r}")
    return target


def _gmsh(mesh: MeshArrays, points: np.ndarray) -> bytes:
    """Return a mesh as a file of Gmsh, with the points in the unit of the file."""
    import meshio

    dim = mesh.dim
    solid, face = (("triangle", "line"), ("tetra", "triangle"))[dim - 2]
    # numbers of bodies and of boundaries: physical groups, whose names stand in ``names``. A file of
    # this version needs geometrical numbers, too
    tags: list[ArrayLike] = [
        mesh.element_body.astype(np.int32) + 1,
        mesh.facet_labels.astype(np.int32) + 1,
    ]
    names = {name: np.array([k + 1, dim - 1]) for k, name in enumerate(mesh.boundaries)}
    if common := sorted(set(names).intersection(mesh.bodies)):
        raise ValueError(f"a boundary and a body are both called {', '.join(common)}: rename one")
    names |= {name: np.array([k + 1, dim]) for k, name in enumerate(mesh.bodies)}
    raw = meshio.Mesh(
        np.pad(points, ((0, 0), (0, 3 - dim))),
        [(solid, mesh.elements), (face, mesh.facets)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data=names,
    )
    with waiting_folder() as folder:
        meshio.write(Path(folder, "mesh.msh"), raw, "gmsh22", binary=False)
        return Path(folder, "mesh.msh").read_bytes()


def _deck(mesh: MeshArrays, points: np.ndarray) -> bytes:
    """Return a mesh as a deck, with the points in the unit of the file."""
    out = io.StringIO()
    kind, numbers = _ELEMENTS[mesh.dim]

    def rows(table: np.ndarray, form: str = "%d") -> None:
        np.savetxt(out, table, fmt=form, delimiter=", ")

    out.write("*NODE\n")
    rows(
        np.column_stack([np.arange(1, len(points) + 1), points]),
        ", ".join(["%d"] + ["%.17g"] * mesh.dim),
    )
    for k, body in enumerate(mesh.bodies):
        elements = np.flatnonzero(mesh.element_body == k)
        out.write(f"*ELEMENT, TYPE={kind}, ELSET={body}\n")
        rows(np.column_stack([elements, mesh.elements[elements]]) + 1)
    # a surface is given by elements and the numbers of their facets
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


def vtk(result: Result, path: str | os.PathLike[str]) -> None:
    """Write a result with a mesh to a ``.vtu`` file, which appears complete or not at all; see the
    module.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> am.export.vtk(result, "bar.vtu")                               # opens in ParaView
    """
    target = _file(path, ".vtu")
    with waiting_folder() as folder:
        _write(result, folder / "result.vtu")
        write_bytes(target, (folder / "result.vtu").read_bytes())


def vtk_series(
    results: Sequence[Result], path: str | os.PathLike[str], times: Sequence[float] | None = None
) -> Path:
    """Write a sequence of results as a ParaView collection: a .vtu file a step and a .pvd file that
    lists them.

    Parameters
    ----------
    results : sequence of Result
        With meshes, one a step.
    path : path
        The ``.pvd`` file, which is returned. Its folder is made where it is missing. The steps lie
        next to it (``run_0000.vtu``, ...), in place of all that it listed, but of no other files.
        It is written last.
    times : sequence of float, optional
        Strictly increasing; default 0, 1, 2, ...

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> steps = am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0]}))
    >>> am.export.vtk_series(list(steps), "bar.pvd").name
    'bar.pvd'
    """
    results = checks.items("results", results, Result)
    if not results:
        raise ValueError("results is empty: a series needs at least one step")
    moments = np.arange(len(results)) if times is None else checks.vector("times", times)
    if len(moments) != len(results):
        raise ValueError(
            f"times must have one value a result: {len(results)} results, {len(moments)} times"
        )
    if (np.diff(moments) <= 0).any():
        raise ValueError(
            f"times must increase strictly, got {moments.tolist()}: give pseudo-times, or leave times out"
        )
    target = _file(path, ".pvd")
    old = read_bytes(target).decode("utf-8", "replace") if target.exists() else ""
    # files of the steps: ``names`` will be written, ``listed`` are those of an older series
    steps = [f"{target.stem}_{k:04d}.vtu" for k in range(max(len(results), old.count("<DataSet")))]
    names = steps[: len(results)]
    listed = [name for name in steps if f" file={quoteattr(printable(name))}/" in old]
    for name in names:
        if os.path.lexists(target.parent / name) and name not in listed:
            raise FileExistsError(
                f"path: {str(target.parent / name)!r} is not a step of an older series: move it, or "
                "give another name"
            )
    make_folder("path", target.parent)
    with waiting_folder(target.parent) as waiting:
        for name, result in zip(names, results, strict=True):
            _write(result, waiting / name)
        for name in names:
            os.replace(waiting / name, target.parent / name)
    write_bytes(target, _collection(names, moments))
    for name in set(listed).difference(names):
        (target.parent / name).unlink(missing_ok=True)
    return target


def _collection(names: Sequence[str], times: np.ndarray) -> bytes:
    """Return a ParaView collection (.pvd) of files at times, s."""
    lines = [
        f'<DataSet timestep="{float(time)!r}" part="0" file={quoteattr(printable(name))}/>'
        for name, time in zip(names, times, strict=True)
    ]
    return "\n".join(
        [
            '<?xml version="1.0"?>',
            '<VTKFile type="Collection" version="1.0">',
            "<Collection>",
            *lines,
            "</Collection>",
            "</VTKFile>",
            "",
        ]
    ).encode()


def _write(result: Result, path: Path) -> None:
    """Write the fields of a result to a file of VTK; vectors get three components."""
    import meshio

    mesh = need_mesh(checks.instance("result", result, Result))
    cells: dict[str, list[ArrayLike]] = {"body": [mesh.element_body]}
    if result.stress_data is not None:
        cells |= {"stress": [result.stress()], "von_mises": [result.von_mises()]}
    points: dict[str, ArrayLike] = {
        "displacement": _in_space(result.displacement),
        "reaction": _in_space(result.reaction),
        **_contact_data(result),
    }
    if result.velocity.size:
        points["velocity"] = _in_space(result.velocity)
    raw = meshio.Mesh(
        _in_space(mesh.points),
        [("triangle" if mesh.dim == 2 else "tetra", mesh.elements)],
        points,
        cells,
    )
    meshio.write(path, raw, "vtu", compression=None, header_type="UInt64")


def _contact_data(result: Result) -> dict[str, np.ndarray]:
    """Return the contact fields at all nodes, 0 (codes -1) at nodes without contact."""
    contact = result.contact
    n = len(result.displacement)

    def spread(values: np.ndarray, elsewhere: float = 0.0) -> np.ndarray:
        full = np.full((n, *values.shape[1:]), elsewhere, dtype=values.dtype)
        full[contact.node] = values
        return full

    def tangential(values: np.ndarray) -> np.ndarray:
        return spread(_in_space(from_frames(contact.frames[:, 1:], values)))

    return {
        "contact_pressure": spread(contact.pressure),
        "contact_traction": tangential(contact.traction),
        "contact_gap": spread(contact.gap),
        "contact_slip": tangential(contact.slip),
        "contact_state": spread(np.asarray(contact.state, dtype=np.int8), -1),
        "contact_pair": spread(np.asarray(contact.boundary, dtype=np.int32), -1),
        "contact_mask": spread(np.ones(len(contact), dtype=np.uint8)),
    }


def _in_space(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (n, 2) or (n, 3) with three components, the third one 0 in the plane."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
