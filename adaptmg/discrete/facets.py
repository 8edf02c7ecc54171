r"""Boundary facets by name, their area vectors, and the dofs that supports on them fix.

The area vector of a facet is its measure (m, in 3D m^2) times its outward unit normal: in 2D the edge (a, b) turned by
-90 degrees, in 3D :math:`\tfrac12 (b - a) \times (c - a)`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.loads import Support

__all__ = ["area_vectors", "fixed_dofs", "named_facets", "shape_integrals"]


def named_facets(mesh: MeshArrays, boundary: str) -> np.ndarray:
    """Facets (n, dim) of a boundary; ValueError if the mesh has no such boundary, or no facets on it."""
    facets = mesh.boundary_facets(boundary)
    if not len(facets):
        raise ValueError(f"boundary {boundary!r} has a name in the mesh but no facets: was its label lost in meshing?")
    return facets


def area_vectors(points: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Area vectors of facets."""
    corners = points[facets]
    first = corners[:, 1] - corners[:, 0]
    if points.shape[1] == 2:
        return np.column_stack([first[:, 1], -first[:, 0]])
    return 0.5 * np.cross(first, corners[:, 2] - corners[:, 0])


def shape_integrals(points: np.ndarray, facets: np.ndarray, axisymmetric: bool = False) -> np.ndarray:
    r"""Integral of the shape function of each corner over the measure of its facet."""
    if not axisymmetric:
        return np.full(facets.shape, 1.0 / points.shape[1])
    r = points[facets, 0]
    return 2 * np.pi * (r + r.sum(axis=1, keepdims=True)) / 6


def fixed_dofs(mesh: MeshArrays, supports: Sequence[Support]) -> tuple[np.ndarray, np.ndarray]:
    """Mask (n_dofs,) and values (n_dofs,), m, zero where free, of the prescribed dofs.

    Where two supports meet, they must agree or prescribe different components. ValueError for a boundary the mesh does
    not have, a z component in 2D, two values for one dof, or functions of position with values that are not finite.
    """
    fixed = np.zeros((mesh.n_nodes, mesh.dim), dtype=bool)
    values = np.zeros((mesh.n_nodes, mesh.dim))
    origin = np.full((mesh.n_nodes, mesh.dim), -1)
    for k, support in enumerate(supports):
        nodes = np.unique(named_facets(mesh, support.boundary))
        for d, value in enumerate(support.components(mesh.dim)):
            if value is None:
                continue
            prescribed = checks.field(f"{'xyz'[d]} of the support on {support.boundary!r}", value, mesh.points[nodes])
            clash = fixed[nodes, d] & (values[nodes, d] != prescribed)
            if clash.any():
                node, here = int(nodes[np.argmax(clash)]), prescribed[np.argmax(clash)]
                other = supports[origin[node, d]].boundary
                raise ValueError(f"supports on {other!r} and {support.boundary!r} prescribe different {'xyz'[d]} "
                                 f"displacements, {values[node, d]:g} and {here:g} m, at their common node {node} "
                                 f"{tuple(mesh.points[node].tolist())}: give both the same value or free one")
            fixed[nodes, d], values[nodes, d], origin[nodes, d] = True, prescribed, k
    return fixed.reshape(-1), values.reshape(-1)
