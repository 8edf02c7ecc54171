r"""The load vector: surface tractions and body forces tested with the P1 shape functions.

.. math:: b_{i} = \int_\Omega f\,\varphi_i + \int_{\Gamma} g\,\varphi_i

by quadrature of degree 2 on each element and facet: exact for data that are linear in position.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg.discretisation.facets import area_vectors, named_facets
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.problem.loads import BodyForce, Load, Pressure

__all__ = ["load_vector"]

# barycentric coordinates of one point of the degree-2 rule by number of corners; the other points are its rotations,
# all with equal weight (Gauss; Strang and Fix 1973; Keast 1986)
_FIRST_POINT = {
    2: (0.5 + 0.5 / np.sqrt(3), 0.5 - 0.5 / np.sqrt(3)),
    3: (2 / 3, 1 / 6, 1 / 6),
    4: ((5 + 3 * np.sqrt(5)) / 20, (5 - np.sqrt(5)) / 20, (5 - np.sqrt(5)) / 20, (5 - np.sqrt(5)) / 20),
}


def load_vector(mesh: MeshArrays, loads: Sequence[Load]) -> np.ndarray:
    """Nodal forces of all loads.

    Parameters
    ----------
    mesh : MeshArrays
    loads : sequence of Pressure, Traction, BodyForce
        Their functions of position are called once each, with all quadrature points (n, dim).

    Returns
    -------
    (n_dofs,) array
        N (2D: per metre of thickness); dual, dof = dim * node + component.

    Raises
    ------
    ValueError
        For a boundary the mesh does not have, components of the wrong number, or data that are not finite.
    """
    result = np.zeros((mesh.n_nodes, mesh.dim))
    for load in loads:
        if isinstance(load, BodyForce):
            cells, measures = mesh.elements, mesh.volumes
        else:
            cells = named_facets(mesh, load.boundary)
            vectors = area_vectors(mesh.points, cells)
            measures = np.linalg.norm(vectors, axis=1)
        points = _quadrature_points(mesh.points, cells)
        if isinstance(load, Pressure):
            value = checks.field(f"pressure on {load.boundary!r}", load.value, points.reshape(-1, mesh.dim))
            normals = vectors / measures[:, None]
            density = -value.reshape(points.shape[:2])[:, :, None] * normals[:, None, :]
        else:
            if len(load.components) != mesh.dim:
                raise ValueError(f"{load!r} has {len(load.components)} components on a {mesh.dim}D mesh")
            density = np.stack([checks.field(f"component {'xyz'[k]} of {type(load).__name__}", component,
                                             points.reshape(-1, mesh.dim)).reshape(points.shape[:2])
                                for k, component in enumerate(load.components)], axis=-1)
        _add(result, cells, measures, density)
    return result.reshape(-1)


def _rule(corners: int) -> np.ndarray:
    """Barycentric coordinates (corners, corners) of the rule's points."""
    first = np.array(_FIRST_POINT[corners])
    return np.stack([np.roll(first, k) for k in range(corners)])


def _quadrature_points(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Positions (n_cells, n_quadrature, dim) of the quadrature points."""
    return np.einsum("qk,ckd->cqd", _rule(cells.shape[1]), points[cells])


def _add(result: np.ndarray, cells: np.ndarray, measures: np.ndarray, density: np.ndarray) -> None:
    """Add the nodal forces of a density (n_cells, n_quadrature, dim) to ``result`` (n_nodes, dim)."""
    corners = cells.shape[1]
    nodal = np.einsum("c,qk,cqd->ckd", measures / corners, _rule(corners), density)
    for d in range(result.shape[1]):
        result[:, d] += np.bincount(cells.reshape(-1), weights=nodal[:, :, d].reshape(-1), minlength=len(result))
