r"""Averaged nodal normals of a surface.

With the area vectors :math:`a_F` (length times normal in 2D, area times normal in 3D) of the facets F at node i,

.. math:: n_i = \sum_F a_F \Big/ \Big|\sum_F a_F\Big| .
"""

from __future__ import annotations

import numpy as np

from adaptmg.discretisation.facets import area_vectors

__all__ = ["surface_normals"]

_SYMMETRY_TILT = np.cos(np.pi / 6)


def surface_normals(points: np.ndarray, facets: np.ndarray, *, fixed: np.ndarray | None = None) -> np.ndarray:
    """Unit normals at the nodes of a surface.

    Parameters
    ----------
    points : (n_nodes, dim) array
        m.
    facets : (n, dim) array of int
        Oriented outwards as in :class:`~adaptmg.mesh.arrays.MeshArrays`.
    fixed : (n_nodes, dim) bool array, optional
        Components that are held. Where a curved surface ends on a plane of symmetry, the normal averaged from one
        side is off by about half the angle of a facet; components along held directions are therefore taken out of
        normals that are within 30 degrees of tangential to them.

    Returns
    -------
    (n_nodes, dim) array
        Zero at nodes that are not of the surface.

    Raises
    ------
    ValueError
        If the facets at a node cancel, or ``fixed`` has another shape than ``points``.
    """
    points, facets = np.asarray(points, dtype=np.float64), np.asarray(facets)
    vectors = area_vectors(points, facets)
    measures = np.linalg.norm(vectors, axis=1)
    total, measure = np.zeros(points.shape), np.zeros(len(points))
    for corner in facets.T:
        np.add.at(total, corner, vectors)
        np.add.at(measure, corner, measures)
    nodes = np.unique(facets)
    lengths = np.linalg.norm(total[nodes], axis=1)
    if not (lengths > 1e-8 * measure[nodes]).all():
        i = nodes[int(np.argmin(lengths / measure[nodes]))]
        raise ValueError(f"the surface has no normal at node {i} {tuple(points[i].tolist())}: its facets there "
                         "cancel; split the boundary")
    total[nodes] /= lengths[:, None]
    return total if fixed is None else _along_symmetry_planes(total, nodes, fixed)


def _along_symmetry_planes(normals: np.ndarray, nodes: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Normals without their components along fixed directions, where these are small; changed in place."""
    fixed = np.asarray(fixed)
    if fixed.shape != normals.shape or fixed.dtype != bool:
        raise ValueError(f"fixed must be a boolean mask of shape {normals.shape}, got {fixed.dtype} {fixed.shape}")
    inside = np.where(fixed[nodes], 0.0, normals[nodes])
    lengths = np.linalg.norm(inside, axis=1)
    tilted = lengths > _SYMMETRY_TILT
    normals[nodes[tilted]] = inside[tilted] / lengths[tilted, None]
    return normals
