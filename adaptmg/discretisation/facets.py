r"""Boundary facets: area vectors by name of the boundary.

The area vector of a facet is its measure (m, in 3D m^2) times its outward unit normal: in 2D the edge (a, b) turned by
-90 degrees, in 3D :math:`\tfrac12 (b - a) \times (c - a)`.
"""

from __future__ import annotations

import numpy as np

from adaptmg.mesh.arrays import MeshArrays

__all__ = ["area_vectors", "named_facets", "shape_integrals"]


def named_facets(mesh: MeshArrays, boundary: str) -> np.ndarray:
    """Facets (n, dim) of a boundary; ValueError if the mesh has no such boundary, or no facets on it."""
    facets = mesh.boundary_facets(boundary)
    if not len(facets):
        raise ValueError(f"boundary {boundary!r} has a name in the mesh but no facets: was its label lost in meshing?")
    return facets


def area_vectors(points: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Area vectors of facets.

    Parameters
    ----------
    points : (n_nodes, dim) array
        m.
    facets : (n, dim) array of int
        Node numbers, oriented as in :class:`~adaptmg.mesh.arrays.MeshArrays`.

    Returns
    -------
    (n, dim) array
        Outward, with the length (m) or area (m^2) of the facet as norm.
    """
    corners = points[facets]
    first = corners[:, 1] - corners[:, 0]
    if points.shape[1] == 2:
        return np.column_stack([first[:, 1], -first[:, 0]])
    return 0.5 * np.cross(first, corners[:, 2] - corners[:, 0])


def shape_integrals(points: np.ndarray, facets: np.ndarray, axisymmetric: bool = False) -> np.ndarray:
    r"""Integral of the shape function of each corner over the measure of its facet.

    Parameters
    ----------
    points : (n_nodes, dim) array
        m.
    facets : (n, dim) array of int
    axisymmetric : bool
        x is a radius, and integrals are weighted with 2 pi r.

    Returns
    -------
    (n, dim) array
        1 / dim; in axisymmetry :math:`2\pi\,(2 r_i + r_j)/6`, m.
    """
    if not axisymmetric:
        return np.full(facets.shape, 1.0 / points.shape[1])
    r = points[facets, 0]
    return 2 * np.pi * (r + r.sum(axis=1, keepdims=True)) / 6
