"""as_mesh: whatever a user calls a mesh, checked and as MeshArrays."""

from __future__ import annotations

from pathlib import Path

import ngsolve
import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.build import from_ngsolve, with_source
from adaptmg.mesh.checks.check import check_mesh
from adaptmg.mesh.checks.overlap import check_overlap
from adaptmg.mesh.files.gmsh import from_gmsh
from adaptmg.mesh.files.netgen_file import from_netgen_file
from adaptmg.problem import checks
from adaptmg.runtime.on_demand import OnDemand

__all__ = ["as_mesh"]


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
    TypeError
        If it is none of these.
    FileNotFoundError
        If there is no such file.
    ValueError
        On another file type, a file that cannot be read, or a mesh that is not sound
        (:func:`adaptmg.mesh.check_mesh`).
    """
    if isinstance(mesh, MeshArrays):
        return check_mesh(mesh) if _fits(mesh) else check_overlap(with_source(mesh))
    if isinstance(mesh, ngsolve.Mesh):
        return from_ngsolve(mesh)
    if not isinstance(mesh, str | Path):
        raise TypeError("mesh must be MeshArrays, an ngsolve.Mesh or the path of a .msh, .vol or .vol.gz file, "
                        f"got {type(mesh).__name__}")
    path = checks.file_path("mesh", mesh)
    if not path.is_file():
        raise FileNotFoundError(f"mesh: there is no file {str(path)!r}")
    if path.suffix == ".msh":
        return from_gmsh(path)
    if path.name.endswith((".vol", ".vol.gz")):
        return from_netgen_file(path)
    if path.suffix.lower() in (".step", ".stp"):
        raise ValueError(f"mesh: {str(path)!r} is a geometry, not a mesh: adaptmg.mesh.from_step(path, size) meshes it")
    raise ValueError(f"mesh: {str(path)!r} is not a .msh, .vol or .vol.gz file; other formats can be converted to .msh "
                     "by meshio")


def _fits(mesh: MeshArrays) -> bool:
    """Whether the source is still that of the arrays: dataclasses.replace keeps it beside new ones."""
    if isinstance(vars(mesh)["source"], OnDemand):
        return mesh.sound
    if not isinstance(mesh.source, ngsolve.Mesh) or mesh.points.ndim != 2:
        return False
    ngmesh = mesh.source.ngmesh
    points = np.array(ngmesh.Coordinates(), dtype=np.float64)
    volume = (ngmesh.Elements2D() if mesh.dim == 2 else ngmesh.Elements3D()).NumPy()
    return (mesh.source.dim == mesh.dim and len(volume) == len(mesh.elements)
            and np.array_equal(points[:, :mesh.dim], mesh.points))
