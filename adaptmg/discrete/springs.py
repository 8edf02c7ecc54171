r"""Springs between boundaries or nodes and the ground: what they add to the stiffness matrix, and their forces.

.. math:: a_s(u, v) = \int_\Gamma k_n\, u_n v_n + k_t\, u_t \cdot v_t \quad\text{or}\quad \sum_i k_i\, u_i v_i
   \text{ at a node}, \qquad t = -k_n u_n n - k_t u_t ,

with the facets' normals n, by the quadrature of loads; in axisymmetry weighted with :math:`2 \pi r`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.elasticity import Materials, is_axisymmetric, stiffness
from adaptmg.discrete.facets import area_vectors, named_facets, node_at
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, PLAIN_DEGREE, quadrature_points, quadrature_rule
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.loads import AnySupport, PointSpring, Spring


def foundation(spring: Spring, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Stiffness per area (n_facets, n_points, dim, dim), N/m^3, at points of facets with these unit normals."""
    flat = points.reshape(-1, points.shape[2])
    normal, tangential = (checks.field(f"{name} of the spring on {spring.boundary!r}", getattr(spring, name), flat)
                          .reshape(points.shape[:2]) for name in ("normal", "tangential"))
    for name, values in (("normal", normal), ("tangential", tangential)):
        if values.min(initial=0.0) < 0:
            raise ValueError(f"{name} of the spring on {spring.boundary!r} must be >= 0, got {values.min():g} N/m^3")
    outer = np.einsum("fi,fj->fij", normals, normals)[:, None]
    return normal[:, :, None, None] * outer + tangential[:, :, None, None] * (np.eye(normals.shape[1]) - outer)


def _elements(mesh: MeshArrays, spring: Spring | PointSpring, axisymmetric: bool) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, k) that springs join, and their stiffness (n, k, k, dim, dim), N/m."""
    if isinstance(spring, PointSpring):
        own = np.diag([spring.x, spring.y, spring.z][:mesh.dim])
        return np.array([[node_at(mesh, spring.point, spring.body)]]), own[None, None, None]
    facets = named_facets(mesh, spring.boundary)
    vectors = area_vectors(mesh.points, facets)
    measures = np.linalg.norm(vectors, axis=1)
    rule, weights = quadrature_rule(mesh.dim, AXISYMMETRIC_DEGREE if axisymmetric else PLAIN_DEGREE)
    points = quadrature_points(mesh.points, facets, rule)
    weights = measures[:, None] * weights
    if axisymmetric:
        weights = weights * (2 * np.pi * points[:, :, 0])
    per_area = weights[:, :, None, None] * foundation(spring, points, vectors / measures[:, None])
    # the products of shape functions are symmetric to the last bit, and so is the matrix
    return facets, np.einsum("qab,fqij->fabij", rule[:, :, None] * rule[:, None, :], per_area)


def supported_stiffness(mesh: MeshArrays, material: Materials, supports: Sequence[AnySupport]) -> sparse.bsr_array:
    """The stiffness of the bodies and of the springs that hold them, as :func:`adaptmg.discrete.stiffness`."""
    matrix = stiffness(mesh, material)
    springs = [support for support in supports if isinstance(support, Spring | PointSpring)]
    if springs:
        rows = np.repeat(np.arange(mesh.n_nodes), np.diff(matrix.indptr))
        keys = rows * mesh.n_nodes + matrix.indices
    for spring in springs:
        cells, blocks = _elements(mesh, spring, is_axisymmetric(material))
        wanted = cells[:, :, None] * mesh.n_nodes + cells[:, None, :]
        np.add.at(matrix.data, np.searchsorted(keys, wanted.ravel()), blocks.reshape(-1, mesh.dim, mesh.dim))
    return matrix


def spring_resultants(mesh: MeshArrays, supports: Sequence[AnySupport], displacement: np.ndarray, axisymmetric: bool
                      ) -> dict[str, list[float]]:
    """By place the force that springs exert on the bodies, N, and its moment about the origin, N m."""
    result: dict[str, list[float]] = {}
    for spring in (one for one in supports if isinstance(one, Spring | PointSpring)):
        cells, blocks = _elements(mesh, spring, axisymmetric)
        forces = -np.einsum("fabij,fbj->fai", blocks, displacement[cells]).reshape(-1, mesh.dim)
        own = [*forces.sum(axis=0), *moment(mesh.points[cells].reshape(forces.shape), forces)]
        result[spring.place] = (np.array(own) + result.get(spring.place, 0.0)).tolist()
    return result


def moment(arms: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """The sum of the moments of forces (n, dim) with arms (n, dim): 2D (1,), 3D (3,)."""
    every = np.cross(arms, forces) if arms.shape[1] == 3 else arms[:, :1] * forces[:, 1:] - arms[:, 1:] * forces[:, :1]
    return every.sum(axis=0)
