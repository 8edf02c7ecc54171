r"""Node-to-node coupling of two surfaces with matching meshes, in 2D and 3D.

Slave node j faces the one master node k(j) nearest to it: :math:`B_{jk} = \delta_{k,k(j)}`, with

.. math:: g_j = (x_{k(j)} - x_j)\cdot n_j, \qquad w_j = \int\phi_j

over the slave surface (in axisymmetry with :math:`2\pi r`).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from adaptmg.discretisation.facets import area_vectors
from adaptmg.discretisation.mortar.interface import NEVER_FACING, MortarInterface, Surfaces
from adaptmg.problem.checks import positive

__all__ = ["node_to_node"]


def node_to_node(points: np.ndarray, slave_facets: np.ndarray, master_facets: np.ndarray, normals: np.ndarray, *,
                 excluded: Iterable[int] = (), axisymmetric: bool = False, tolerance: float = 1e-2) -> MortarInterface:
    """Couple each node of a slave surface to the nearest node of a master surface.

    Parameters
    ----------
    points : (n_nodes, dim) array
        m; in axisymmetry (radius, axial position).
    slave_facets, master_facets : (n, dim) array of int
        Oriented outwards as in :class:`~adaptmg.mesh.arrays.MeshArrays`. No common nodes.
    normals : (n_nodes, dim) array
        Unit normals out of the slave body; rows of slave nodes are read.
    excluded : iterable of int
        Nodes that carry no multiplier (of another pair, or held); those not on the slave surface are ignored.
    axisymmetric : bool
        2D only: weights are areas over the full circumference.
    tolerance : float
        How far beside the normal of a slave node its partner may lie, as a fraction of the shortest edge of the
        facets at the slave node.

    Returns
    -------
    MortarInterface
        All slave nodes that are not excluded. The distance along the normal, positive (gap) or negative (overlap),
        is not limited.

    Raises
    ------
    ValueError
        If a slave node has no partner within the tolerance (the first one is named), two have the same, or partners
        face the same way; and on arrays that do not fit together (see
        :class:`~adaptmg.discretisation.mortar.interface.Surfaces`).
    """
    surfaces = Surfaces(points, slave_facets, master_facets, normals, excluded, axisymmetric)
    tolerance = positive("tolerance", tolerance)
    points, normals = surfaces.points, surfaces.normals
    nodes = np.flatnonzero(surfaces.carries)
    partner = surfaces.master_nodes[cKDTree(points[surfaces.master_nodes]).query(points[nodes])[1]]
    apart, normal = points[partner] - points[nodes], normals[nodes]
    gaps = np.einsum("nd,nd->n", apart, normal)
    beside = np.linalg.norm(apart - gaps[:, None] * normal, axis=1)
    _check_partners(surfaces, nodes, partner, beside, tolerance * _shortest_edges(surfaces)[nodes])
    weights = _lumped(surfaces)[nodes]
    if not weights.min() > 0:
        raise ValueError(f"slave node {nodes[int(np.argmin(weights))]} has no area: its facets lie on the axis of "
                         "symmetry; end the boundary there")
    coupling = sparse.csr_array((np.ones(len(nodes)), (np.arange(len(nodes)), partner)),
                                shape=(len(nodes), len(points)))
    return MortarInterface(nodes=nodes, normals=normal, weights=weights, gaps=gaps, coupling=coupling)


def _check_partners(surfaces: Surfaces, nodes: np.ndarray, partner: np.ndarray, beside: np.ndarray,
                    allowed: np.ndarray) -> None:
    points = surfaces.points
    vectors = np.zeros(points.shape)
    for corner in surfaces.master.T:
        np.add.at(vectors, corner, area_vectors(points, surfaces.master))
    facing = np.einsum("nd,nd->n", vectors[partner], surfaces.normals[nodes]) < 0
    if not facing.any():
        raise ValueError(f"{NEVER_FACING}: the normals of slave nodes and of their partners point the same way. Check "
                         "the orientation of the facets")
    missing = np.flatnonzero((beside > allowed) | ~facing)
    if len(missing):
        i = missing[0]
        raise ValueError(f"slave node {nodes[i]} {tuple(points[nodes[i]].tolist())} has no partner: the nearest master "
                         f"node {partner[i]} {tuple(points[partner[i]].tolist())} lies {beside[i]:.3g} m beside its "
                         f"normal, {allowed[i]:.3g} m are allowed{'' if facing[i] else ', and faces the same way'} "
                         f"({len(missing)} such nodes of {len(nodes)}). Use matching meshes, a mortar coupling, or a "
                         "larger tolerance")
    order = np.argsort(partner, kind="stable")
    twice = np.flatnonzero(np.diff(partner[order]) == 0)
    if len(twice):
        a, b = nodes[order[twice[0]]], nodes[order[twice[0] + 1]]
        raise ValueError(f"slave nodes {a} {tuple(points[a].tolist())} and {b} {tuple(points[b].tolist())} have the "
                         f"same partner {partner[order[twice[0]]]}: the meshes do not match; use a mortar coupling")


def _shortest_edges(surfaces: Surfaces) -> np.ndarray:
    """Shortest edge (n_nodes,) of the slave facets at each node, m; infinite elsewhere."""
    result = np.full(len(surfaces.points), np.inf)
    corners = surfaces.slave.T
    for i in range(len(corners)):
        for j in range(i):
            length = np.linalg.norm(surfaces.points[corners[i]] - surfaces.points[corners[j]], axis=1)
            np.minimum.at(result, corners[i], length)
            np.minimum.at(result, corners[j], length)
    return result


def _lumped(surfaces: Surfaces) -> np.ndarray:
    """Integrals (n_nodes,) of the shape functions over the slave surface."""
    points, slave = surfaces.points, surfaces.slave
    area = np.linalg.norm(area_vectors(points, slave), axis=1)
    result = np.zeros(len(points))
    radii = np.maximum(points[slave, 0], 0.0) if surfaces.axisymmetric else None
    for k, corner in enumerate(slave.T):
        factor = 1.0 if radii is None else 2 * np.pi * (radii[:, k] + radii.sum(axis=1)) / 3
        np.add.at(result, corner, area * factor / points.shape[1])
    return result
