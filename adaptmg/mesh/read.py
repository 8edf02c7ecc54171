"""Meshes from files and from NGSolve: ``from_file``, ``as_mesh``.

Decks of Abaqus and CalculiX are read by :mod:`adaptmg.mesh.deck`, files of Kratos by
:mod:`adaptmg.mesh.kratos`: meshio loses their surfaces, sections and parts. Netgen reads its own
files (.vol, .vol.gz), and meshio all others, both in the process of
:mod:`adaptmg.mesh.netgen_guard` with limits of time and memory: damaged numbers may lead a reader
anywhere. What comes back is checked like every other mesh."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import file_size
from adaptmg._text import printable, shortened
from adaptmg.mesh.arrays import MeshArrays, normalised
from adaptmg.mesh.contents import Contents, mesh_of
from adaptmg.mesh.deck import read_deck
from adaptmg.mesh.kratos import read_mdpa
from adaptmg.mesh.netgen_guard import NetgenFails, netgen, read_s
from adaptmg.mesh.soundness import check_stranger

if TYPE_CHECKING:
    import ngsolve

    #: what stands for a mesh
    MeshLike = MeshArrays | ngsolve.Mesh | str | os.PathLike[str]

# Netgen's types of second order
_CURVED = (12, 13, 14, 21, 24)
# of which meshio reads sets of nodes
_EXODUS = (".e", ".exo", ".ex2")
# what a reader takes for each byte of a file
_BYTES_PER_BYTE = 100


def as_mesh(mesh: MeshLike) -> MeshArrays:
    """Convert to checked MeshArrays.

    Parameters
    ----------
    mesh : MeshArrays, ngsolve.Mesh, str or Path
        A mesh, or a file as of :func:`from_file`. Of an NGSolve mesh straight elements are taken:
        quadrilaterals, bricks, wedges and pyramids are cut into triangles or tetrahedra. Materials
        become bodies, those with the same name one body; boundaries inside the mesh (interfaces of
        glued materials) are left out.

    Returns
    -------
    MeshArrays
        The same object if it was checked before, or made by the package. Of an NGSolve mesh copies:
        refining it later changes nothing here. The nodes keep their numbers unless some belong to
        no element (these are dropped). ``source`` is another, straight mesh with the same node
        numbers.

    Raises
    ------
    TypeError, FileNotFoundError, ValueError
        If it is none of these, there is no such file, it cannot be read, or it is not sound
        (:func:`check_mesh`); on curved elements of NGSolve or those of second order, a deformation,
        periodic boundaries, and dimensions other than 2 and 3.

    Examples
    --------
    >>> mesh = am.mesh.graded(am.Rectangle(width=1, height=1), 0.5)
    >>> am.mesh.as_mesh(mesh) is mesh
    True
    >>> am.mesh.as_mesh(mesh.source).n_nodes == mesh.n_nodes
    True
    """
    if isinstance(mesh, MeshArrays):
        return mesh if mesh.sound and mesh.apart else check_stranger(mesh)
    if _is_ngsolve(mesh):
        return _from_ngsolve(mesh)
    if not isinstance(mesh, str | os.PathLike):
        raise TypeError(
            "mesh must be MeshArrays, an ngsolve.Mesh or the path of a mesh file, got "
            f"{type(mesh).__name__}"
        )
    return from_file(_file("mesh", mesh))


def _is_ngsolve(mesh: object) -> TypeGuard[ngsolve.Mesh]:
    """Return whether it is an ngsolve.Mesh; NGSolve is not loaded for the question."""
    module = sys.modules.get("ngsolve")
    return module is not None and isinstance(mesh, module.Mesh)


def _from_ngsolve(mesh: ngsolve.Mesh) -> MeshArrays:
    """Read an NGSolve mesh."""
    from adaptmg.mesh.netgen_worker import tables

    types = np.concatenate(
        [table.NumPy()["type"] for table in (mesh.ngmesh.Elements2D(), mesh.ngmesh.Elements3D())]
    )
    order = 2 if np.isin(types, _CURVED).any() else mesh.GetCurveOrder()
    if order > 1:
        raise ValueError(
            f"mesh has curved elements (order {order}), bodies are made of straight ones: give the mesh "
            "before SecondOrder() and Curve(), finer where its boundary is curved"
        )
    if mesh.deformation is not None:
        raise ValueError(
            "mesh has a deformation, which would be left out: call mesh.UnsetDeformation(), or move the "
            "nodes"
        )
    if mesh.ngmesh.GetIdentifications():
        raise ValueError(
            "mesh has identified nodes (periodic boundaries), which a contact problem does not know: make "
            "it without them"
        )
    return check_stranger(
        normalised(*tables(mesh.ngmesh, mesh.GetBoundaries(), mesh.GetMaterials()))
    )


def _file(name: str, path: str | os.PathLike[str]) -> Path:
    """Return the path of a file; errors, which call it ``name``, if there is none or it is too large to read."""
    path = checks.file_path(name, path)
    checks.fits(name, _BYTES_PER_BYTE * file_size(name, path), f"reading {str(path)!r}")
    return path


def _read(function: str, path: Path) -> Any:
    """Return the answer of a ``function`` of the Netgen process that reads a file."""
    with netgen() as worker:
        return worker(function, str(path.absolute()), seconds=read_s(path))


def from_file(
    path: str | os.PathLike[str],
    *,
    unit: float = 1.0,
    unnamed: str | None = None,
    split_bodies: bool = False,
    boundaries: Sequence[str] | None = None,
    body: str | None = None,
) -> MeshArrays:
    """Read a mesh file.

    Parameters
    ----------
    path : str or Path
        ``.msh`` of Gmsh (MSH 2 and 4.1), ``.inp`` of Abaqus or CalculiX, ``.mdpa`` of Kratos,
        ``.vol`` or ``.vol.gz`` of Netgen, or another file that meshio reads (``.vtk``, ``.vtu``,
        ``.bdf``, ``.med``, ...; of these, sets of cells and nodes). Files of MED and XDMF need
        h5py, those of Exodus netCDF4: ``pip install 'adaptmg[formats]'``.
    unit : float
        Length in m of one unit of the coordinates: 1e-3 for mm.
    unnamed : str, optional
        Name for the boundary facets that the file gives none; default "free", which a warning says.
    split_bodies : bool
        Give each body separate nodes, so that bodies touch only through contact. Boundaries are
        then called "body.boundary" (a "." in the name of a body becomes "_"); a named curve or
        surface between two bodies is a boundary of both. By default bodies stay glued where they
        share nodes, and boundaries keep their names.
    boundaries : sequence of str, optional
        Which names of the file become boundaries: a facet in several gets the first. Default: all,
        named faces (physical groups, ``*SURFACE``) before sets of nodes, small ones before large
        ones.
    body : str, optional
        Make one body with this name of all elements; default: the bodies of the file.

    Returns
    -------
    MeshArrays
        With ``notes``: how elements were cut, names that overlap, materials
        and friction that the file lists (they are not applied), and what was not read.
        Quadrilaterals are cut along the shorter diagonal, bricks, wedges and pyramids into
        tetrahedra, elements of second order through their middle nodes; no node of an element is
        dropped (but of second order in files of Netgen). A body is one piece: pieces of one name
        are called "name", "name_2", ...

    Raises
    ------
    FileNotFoundError, ValueError
        If there is no such file; if it cannot be read, has other elements, is not plane, or is not
        sound (:func:`adaptmg.mesh.check_mesh`). The message says what the file holds and what is
        expected.

    Notes
    -----
    Physical groups of Gmsh name boundaries and bodies, by their numbers where they have no name. In
    a deck, boundaries are surfaces, sets of nodes that hold whole facets of the boundary, and sets
    of surface elements; bodies are pieces that hang together and have one section, called after the
    smallest set of elements that holds all of it.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=40, height=10), 2)
    >>> am.export.mesh(mesh, "plate.inp")
    >>> plate = am.mesh.from_file("plate.inp", unit=1e-3)                # the file is in mm
    >>> plate.boundaries
    ('bottom', 'right', 'top', 'left')
    """
    path = _file("path", path)
    unit = checks.quantity("unit", unit, positive=True)
    for name, value in (("unnamed", unnamed), ("body", body)):
        if value is not None:
            checks.boundary_name(name, value)
    order = None if boundaries is None else checks.strings("boundaries", boundaries)
    suffix = path.suffix.lower()
    if suffix in (".step", ".stp"):
        raise ValueError(
            f"{str(path)!r} is a geometry, not a mesh: am.mesh.graded(am.StepFile(path), size) meshes it"
        )
    try:
        if path.name.lower().endswith((".vol", ".vol.gz")):
            if split_bodies or order is not None or body is not None:
                raise ValueError("split_bodies, boundaries and body are not for files of Netgen")
            points, elements, facets, label, names, material, bodies = _read("read_vol", path)
            for name in (*names, *bodies):
                checks.boundary_name("the name of a boundary or body", name)
            return check_stranger(
                normalised(unit * points, elements, facets, label, names, material, bodies)
            )
        if reader := {".inp": read_deck, ".mdpa": read_mdpa}.get(suffix):
            contents = reader(path)
        else:
            contents = Contents(*_read("read_meshio", path))
            if suffix in _EXODUS:
                contents.notes.append("not read: side sets, and names of blocks of elements")
        mesh, rest, strange = mesh_of(
            contents,
            unit=unit,
            unnamed=unnamed or "free",
            split_bodies=checks.flag("split_bodies", split_bodies),
            boundaries=order,
            body=body,
        )
    except (ValueError, OverflowError) as error:
        # meshio failed, or ended the process
        remedy = (
            f"; write it as MSH 2.2 (gmsh old{suffix} -save -format msh22 -o new.msh)"
            if isinstance(error, NetgenFails) and suffix not in (".vol", ".gz")
            else ""
        )
        raise ValueError(f"{str(path)!r}: {shortened(printable(str(error)))}{remedy}") from error
    for message in strange:
        warnings.warn(f"{str(path)!r}: {message}", stacklevel=2)
    if len(rest) and unnamed is None:
        place = ", ".join(f"{c:.6g}" for c in rest[0])
        warnings.warn(
            f"{str(path)!r}: {len(rest)} facets of the boundary, one of them at ({place}), have no name in "
            'the file and are called "free"; unnamed= gives them another name',
            stacklevel=2,
        )
    return mesh
