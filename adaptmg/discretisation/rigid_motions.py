r"""Rigid-body motions, body by body: what strains no element.

Translations and, about the centroid of the nodes, rotations; bodies of revolution, which may neither move sideways nor
tilt, have the axial translation only.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from adaptmg.geometry.rigid_modes import rigid_body_modes
from adaptmg.mesh.arrays import MeshArrays

__all__ = ["rigid_motions"]


def rigid_motions(mesh: MeshArrays, axisymmetric: bool = False) -> np.ndarray:
    """Orthonormal rigid-body motions of every body.

    Parameters
    ----------
    mesh : MeshArrays
        Bodies that share nodes (glued materials) move together and count as one.
    axisymmetric : bool
        x = r, y = z: axial translations only.

    Returns
    -------
    (n_dofs, k) array
        Per body 3 columns in 2D, 6 in 3D, 1 in axisymmetry, zero outside the body, in the order of ``mesh.bodies``;
        dof = dim * node + component. As ``near_nullspace`` of a DiscreteProblem with no coupling.
    """
    if axisymmetric and mesh.dim != 2:
        raise ValueError(f"axisymmetric meshes are 2D (r, z), got a {mesh.dim}D mesh")
    columns = []
    for nodes in _nodes_of_pieces(mesh):
        if axisymmetric:
            modes = np.zeros((len(nodes), 2, 1))
            modes[:, 1] = 1 / np.sqrt(len(nodes))
        else:
            points = mesh.points if len(nodes) == mesh.n_nodes else mesh.points[nodes]
            modes = rigid_body_modes(points).reshape(len(nodes), mesh.dim, -1)
        if len(nodes) == mesh.n_nodes:
            return modes.reshape(mesh.points.size, -1)
        column = np.zeros((mesh.n_nodes, mesh.dim, modes.shape[2]))
        column[nodes] = modes
        columns.append(column.reshape(mesh.points.size, -1))
    return np.hstack(columns)


def _nodes_of_pieces(mesh: MeshArrays) -> list[np.ndarray]:
    """Ascending nodes of each set of bodies that hang together, in the order of their first bodies."""
    n_bodies = len(mesh.bodies)
    if n_bodies == 1:
        return [np.arange(mesh.n_nodes)]
    body = np.repeat(mesh.element_body, mesh.elements.shape[1])
    uses = sparse.coo_array((np.ones(len(body), dtype=np.int8), (body, n_bodies + mesh.elements.reshape(-1))),
                            shape=(n_bodies + mesh.n_nodes,) * 2)
    labels = connected_components(uses, directed=False)[1]
    pieces = list(dict.fromkeys(labels[np.unique(mesh.element_body)].tolist()))
    return [np.flatnonzero(labels[n_bodies:] == piece) for piece in pieces]
