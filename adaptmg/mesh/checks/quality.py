r"""quality: how well shaped the elements of a mesh are.

Angles are those of triangles and the dihedral angles of tetrahedra. The aspect ratio is the longest edge h over the
inradius r, :math:`h / (2\sqrt{3}\, r)` in 2D and :math:`h / (2\sqrt{6}\, r)` in 3D with r = dim volume / surface: 1 for
an equilateral element.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.topology import element_facets

__all__ = ["MeshQuality", "quality"]


@dataclass(frozen=True, kw_only=True)
class MeshQuality:
    """Shape and size of the elements of a mesh.

    Parameters
    ----------
    min_angle, max_angle : float
        Smallest and largest angle (3D: dihedral angle), degrees.
    h_min, h_max : float
        Shortest and longest edge, m.
    aspect_ratio : float
        Of the worst element, 1 for an equilateral one.
    """

    min_angle: float
    max_angle: float
    h_min: float
    h_max: float
    aspect_ratio: float


def quality(mesh: MeshArrays) -> MeshQuality:
    """Measure the elements of a mesh.

    Parameters
    ----------
    mesh : MeshArrays
        A sound mesh, see :func:`adaptmg.mesh.check_mesh`.

    Returns
    -------
    MeshQuality
    """
    dim = mesh.dim
    corners = mesh.points[mesh.elements]
    edges = np.stack([np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i in range(dim + 1) for j in range(i)])
    sides = mesh.points[element_facets(mesh.elements)]
    first = sides[:, :, 1] - sides[:, :, 0]
    if dim == 2:
        normals = np.stack([first[..., 1], -first[..., 0]], axis=-1)
        measures = np.linalg.norm(normals, axis=-1)
    else:
        normals = np.cross(first, sides[:, :, 2] - sides[:, :, 0])
        measures = 0.5 * np.linalg.norm(normals, axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    # between two facets the angle inside is pi minus the one between the outward normals
    cosines = np.stack([-(normals[:, i] * normals[:, j]).sum(axis=1) for i in range(dim + 1) for j in range(i)])
    angles = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    inradius = dim * mesh.volumes / measures.sum(axis=1)
    equilateral = 2 * np.sqrt(3.0) if dim == 2 else 2 * np.sqrt(6.0)
    return MeshQuality(min_angle=float(angles.min()), max_angle=float(angles.max()), h_min=float(edges.min()),
                       h_max=float(edges.max()), aspect_ratio=float((edges.max(axis=0) / inradius).max() / equilateral))
