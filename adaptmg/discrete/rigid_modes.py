r"""Rigid-body motions, body by body: what strains no element.

Translations and, about the centroid of the nodes, rotations; bodies of revolution, which may neither move sideways nor
tilt, have the axial translation only.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from adaptmg._threads import one_blas_thread
from adaptmg.mesh.arrays import MeshArrays


def rigid_motions(mesh: MeshArrays, axisymmetric: bool = False) -> np.ndarray:
    """Return orthonormal rigid-body motions (n_dofs, k) of every body, as ``near_nullspace`` of an uncoupled problem.

    Per body 3 columns in 2D, 6 in 3D, 1 in axisymmetry (x = r, y = z), zero outside the body, in the order of
    ``mesh.bodies``. Bodies that share nodes (glued materials) move together and count as one.
    """
    columns = []
    for nodes in nodes_of_pieces(mesh):
        if axisymmetric:
            modes = np.zeros((len(nodes), 2, 1))
            modes[:, 1] = 1 / np.sqrt(len(nodes))
        elif len(nodes) == mesh.n_nodes:
            return rigid_body_modes(mesh.points)
        else:
            modes = rigid_body_modes(mesh.points[nodes]).reshape(len(nodes), mesh.dim, -1)
        column = np.zeros((mesh.n_nodes, mesh.dim, modes.shape[2]))
        column[nodes] = modes
        columns.append(column.reshape(mesh.points.size, -1))
    return np.hstack(columns)


def nodes_of_pieces(mesh: MeshArrays) -> list[np.ndarray]:
    """Return the ascending nodes of each set of bodies that hang together, in the order of their first bodies."""
    n_bodies = len(mesh.bodies)
    if n_bodies == 1:
        return [np.arange(mesh.n_nodes)]
    body = np.repeat(mesh.element_body, mesh.elements.shape[1])
    uses = sparse.coo_array((np.ones(len(body), dtype=np.int8), (body, n_bodies + mesh.elements.reshape(-1))),
                            shape=(n_bodies + mesh.n_nodes,) * 2)
    labels = connected_components(uses, directed=False)[1]
    pieces = list(dict.fromkeys(labels[np.unique(mesh.element_body)].tolist()))
    return [np.flatnonzero(labels[n_bodies:] == piece) for piece in pieces]


@one_blas_thread()
def rigid_body_modes(points: np.ndarray) -> np.ndarray:
    """Return the rigid-body modes about the centroid, orthonormal."""
    n, dim = points.shape
    # by coordinate, each in one piece: several times faster than point by point
    x = np.ascontiguousarray(points.T)
    x = x - x.mean(axis=1, keepdims=True)
    planes = ((0, 1),) if dim == 2 else ((0, 1), (1, 2), (2, 0))
    # about the centroid rotations are orthogonal to translations: only their Gram matrix is inverted
    triangle = _triangle(x @ x.T, planes)
    plain = triangle is None  # points on a line: by reflections
    if plain:
        triangle = np.eye(len(planes))
    modes = np.zeros((n, dim, dim + len(planes)))
    for k in range(dim):
        modes[:, k, k] = 1.0 if plain else 1 / np.sqrt(n)
    for k in range(len(planes)):
        for (a, b), share in zip(planes, triangle[:, k], strict=True):
            if share != 0.0:
                modes[:, a, dim + k] -= share * x[b]
                modes[:, b, dim + k] += share * x[a]
    modes = modes.reshape(-1, modes.shape[2])
    return np.linalg.qr(modes)[0] if plain else modes


def _triangle(moments: np.ndarray, planes: tuple[tuple[int, int], ...]) -> np.ndarray | None:
    """The upper triangle that makes rotations in the planes orthonormal; None where they are (nearly) dependent.
    ``moments`` (dim, dim) are the second moments of the points about their centroid."""
    same = np.eye(len(moments))
    gram = np.array([[same[a, c] * moments[b, d] - same[a, d] * moments[b, c] - same[b, c] * moments[a, d]
                      + same[b, d] * moments[a, c] for c, d in planes] for a, b in planes])
    size = np.sqrt(gram.diagonal())
    if not size.min() > 0:
        return None
    scaled = gram / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] <= 1e-6:
        return None
    return np.linalg.inv(np.linalg.cholesky(scaled)).T / size[:, None]
