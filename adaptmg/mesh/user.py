"""as_mesh: whatever a user calls a mesh, checked and as MeshArrays."""

from __future__ import annotations

import gzip
from pathlib import Path

import ngsolve

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.build import from_ngsolve, with_source
from adaptmg.mesh.check import check_mesh
from adaptmg.mesh.gmsh import from_gmsh

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
        # looked up, not read: reading would build it
        return with_source(mesh) if vars(mesh)["source"] is None else check_mesh(mesh)
    if isinstance(mesh, ngsolve.Mesh):
        return from_ngsolve(mesh)
    if not isinstance(mesh, str | Path):
        raise TypeError("mesh must be MeshArrays, an ngsolve.Mesh or the path of a .msh, .vol or .vol.gz file, "
                        f"got {type(mesh).__name__}")
    path = Path(mesh)
    if not path.is_file():
        raise FileNotFoundError(f"mesh: there is no file {str(path)!r}")
    if path.suffix == ".msh":
        return from_gmsh(path)
    if path.name.endswith((".vol", ".vol.gz")):
        _check_netgen_file(path)
        return from_ngsolve(ngsolve.Mesh(str(path)))
    if path.suffix.lower() in (".step", ".stp"):
        raise ValueError(f"mesh: {str(path)!r} is a geometry, not a mesh: adaptmg.mesh.from_step(path, size) meshes it")
    raise ValueError(f"mesh: {str(path)!r} is not a .msh, .vol or .vol.gz file; other formats can be converted to .msh "
                     "by meshio")


def _check_netgen_file(path: Path) -> None:
    """Netgen reads half a file, or another one, without a word: look for its first and last keyword."""
    try:
        text = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    except (OSError, EOFError) as error:
        raise ValueError(f"{str(path)!r} cannot be unpacked: {error}") from error
    if not text.lstrip().startswith(b"mesh3d") and b"\nmesh3d" not in text[:1000]:
        raise ValueError(f"{str(path)!r} is not a Netgen mesh: it does not begin with 'mesh3d'")
    if b"endmesh" not in text:
        raise ValueError(f"{str(path)!r} is cut off: the keyword 'endmesh' is missing")
