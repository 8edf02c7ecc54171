r"""Edge bubbles: the quadratic functions :math:`b_E = 4 \lambda_a \lambda_b` that a P1 space lacks, edge by edge.

The error of a field that solves :math:`a(v, z) = J(v)` is sought among them, one edge at a time,

.. math:: a(b_E v, b_E d_E) = J(b_E v) - a(b_E v, z_h) \quad\text{for all vectors } v

(hierarchical basis, R. Bank, R. K. Smith, SIAM J. Numer. Anal. 30, 1993, doi:10.1137/0730048). In 2D without body
forces the right-hand side is :math:`-\tfrac23 |E|\,[\sigma(z_h) n]\cdot v`. In 3D the edge has all its tetrahedra as
support, which is where quadratic functions live: a bubble of the faces, :math:`27 \lambda_a \lambda_b \lambda_c` with
the integral :math:`\tfrac{9}{20}|F|`, is a cubic and misses most of the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.discretisation.body_materials import body_materials, is_axisymmetric, lame_constants
from adaptmg.discretisation.facets import area_vectors, named_facets
from adaptmg.discretisation.initial_strain import mean_initial_strain
from adaptmg.estimate.goals.bubbles import bubble_kernels as kernels
from adaptmg.geometry.quadrature import (
    AXISYMMETRIC_DEGREE,
    PLAIN_DEGREE,
    quadrature_points,
    quadrature_rule,
    simplex_rule,
)
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.loads import BodyForce, InitialStrain, Pressure, Traction
from adaptmg.problem.materials import PlaneStress

__all__ = ["EdgeBubbles", "edge_bubbles"]

_LOCAL = {2: np.array([[1, 2], [2, 0], [0, 1]]), 3: np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])}


@dataclass(frozen=True, eq=False)
class EdgeBubbles:
    """The edges of a mesh and the bubbles on them.

    Attributes
    ----------
    mesh : MeshArrays
    axisymmetric : bool
    edges : (n_edges, 2) array of int
        Nodes, ascending.
    element_edges : (n_elements, k) array of int
        Edges of each element, k = 3 or 6.
    """

    mesh: MeshArrays
    axisymmetric: bool
    edges: np.ndarray
    element_edges: np.ndarray

    @property
    def shares(self) -> np.ndarray:
        """How many elements have each edge (n_edges,)."""
        return np.bincount(self.element_edges.reshape(-1), minlength=len(self.edges))

    def find(self, pairs: np.ndarray) -> np.ndarray:
        """Numbers (n,) of the edges between pairs of nodes (n, 2)."""
        n = self.mesh.n_nodes
        low, high = pairs.min(axis=1).astype(np.int64), pairs.max(axis=1)
        return np.searchsorted(self.edges[:, 0].astype(np.int64) * n + self.edges[:, 1], low * n + high)

    def of_facets(self, facets: np.ndarray) -> np.ndarray:
        """Edges (n, 1) or (n, 3) of boundary facets (n, dim): in 3D the edge from corner k to the next one."""
        if self.mesh.dim == 2:
            return self.find(facets)[:, None]
        return np.column_stack([self.find(facets[:, [k, (k + 1) % 3]]) for k in range(3)])

    def values_at(self, weights: np.ndarray) -> np.ndarray:
        """Values (k,) of the bubbles of an element at a point with these barycentric weights (dim + 1,)."""
        first, second = _LOCAL[self.mesh.dim].T
        return 4 * weights[first] * weights[second]

    def on_elements(self, values: np.ndarray) -> np.ndarray:
        """Values (n_edges,) shared out evenly among the elements (n_elements,) of each edge."""
        return (values / self.shares)[self.element_edges].sum(axis=1)

    def actions(self, problem: ContactProblem, fields: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness of the bubbles, and of fields against them.

        Parameters
        ----------
        problem : ContactProblem
        fields : (n_fields, n_nodes, dim) array
            Displacements, m.

        Returns
        -------
        blocks : (n_edges, dim, dim) array
            a(b e_i, b e_j), N/m.
        actions : (n_fields, n_edges, dim) array
            a(field, b e_i), N.
        """
        mesh, dim = self.mesh, self.mesh.dim
        lame, shear = lame_constants(body_materials(mesh, problem.material))
        rule, weights = self._rule
        blocks = np.zeros((len(self.edges), dim, dim))
        actions = np.zeros((len(fields), len(self.edges), dim))
        kernels.add_bubbles(mesh.points, mesh.elements, mesh.element_body, lame, shear, _LOCAL[dim],
                            self.element_edges, self.axisymmetric, rule, weights, np.ascontiguousarray(fields), blocks,
                            actions)
        return blocks, actions

    def stiffness(self, problem: ContactProblem, values: np.ndarray) -> np.ndarray:
        """a(sum of bubbles times values, b e_i) for values (n_edges, dim), (n_edges, dim)."""
        mesh, dim = self.mesh, self.mesh.dim
        lame, shear = lame_constants(body_materials(mesh, problem.material))
        result = np.zeros((len(self.edges), dim))
        kernels.apply_bubbles(mesh.points, mesh.elements, mesh.element_body, lame, shear, _LOCAL[dim],
                              self.element_edges, self.axisymmetric, *self._rule,
                              np.ascontiguousarray(values), result)
        return result

    def load(self, problem: ContactProblem) -> np.ndarray:
        """Work (n_edges, dim) of all loads on the bubbles, N."""
        result = np.zeros((len(self.edges), self.mesh.dim))
        for load in problem.loads:
            if isinstance(load, InitialStrain):
                continue
            if isinstance(load, BodyForce):
                self._add_body_force(result, load)
            else:
                self._add_traction(result, load)
        strain = [load for load in problem.loads if isinstance(load, InitialStrain)]
        if strain:
            self._add_strain(result, problem, strain)
        return result

    @property
    def _rule(self) -> tuple[np.ndarray, np.ndarray]:
        """For products of two gradients of bubbles: exact but for what is divided by r."""
        return quadrature_rule(self.mesh.dim + 1, AXISYMMETRIC_DEGREE if self.axisymmetric else PLAIN_DEGREE)

    def boundary_work(self, facets: np.ndarray, traction: np.ndarray) -> np.ndarray:
        """Work (n_edges, dim) on the bubbles of a traction that is linear on facets.

        Parameters
        ----------
        facets : (n, dim) array of int
        traction : (n, dim, m) array
            At the corners of each facet, Pa; m components.

        Returns
        -------
        (n_edges, m) array
            N.
        """
        rule, weights = simplex_rule(self.mesh.dim - 1, 3)
        values = np.einsum("qc,ncm->nqm", rule, traction)
        result = np.zeros((len(self.edges), traction.shape[2]))
        self._add(result, facets, self.of_facets(facets), self._facet_pairs, rule, weights, values,
                  np.linalg.norm(area_vectors(self.mesh.points, facets), axis=1))
        return result

    @property
    def _facet_pairs(self) -> np.ndarray:
        return np.array([[0, 1]]) if self.mesh.dim == 2 else np.array([[0, 1], [1, 2], [2, 0]])

    def _add(self, result: np.ndarray, cells: np.ndarray, edges: np.ndarray, pairs: np.ndarray, rule: np.ndarray,
             weights: np.ndarray, values: np.ndarray, measures: np.ndarray) -> None:
        """Add the integrals of values (n, n_quadrature, m) times bubbles over cells, in place."""
        factor = measures[:, None] * weights
        if self.axisymmetric:
            factor = factor * 2 * np.pi * quadrature_points(self.mesh.points, cells, rule)[:, :, 0]
        for k, (a, b) in enumerate(pairs):
            bubble = 4 * rule[:, a] * rule[:, b]
            np.add.at(result, edges[:, k], np.einsum("nq,q,nqm->nm", factor, bubble, values))

    def _add_traction(self, result: np.ndarray, load: Pressure | Traction) -> None:
        mesh = self.mesh
        facets = named_facets(mesh, load.boundary)
        vectors = area_vectors(mesh.points, facets)
        measures = np.linalg.norm(vectors, axis=1)
        rule, weights = simplex_rule(mesh.dim - 1, 3)
        points = quadrature_points(mesh.points, facets, rule)
        flat = points.reshape(-1, mesh.dim)
        if isinstance(load, Pressure):
            value = checks.field(f"pressure on {load.boundary!r}", load.value, flat).reshape(points.shape[:2])
            values = -value[:, :, None] * (vectors / measures[:, None])[:, None, :]
        else:
            values = _components(load, flat).reshape(points.shape)
        self._add(result, facets, self.of_facets(facets), self._facet_pairs, rule, weights, values, measures)

    def _add_body_force(self, result: np.ndarray, load: BodyForce) -> None:
        mesh = self.mesh
        here = np.ones(len(mesh.elements), dtype=bool)
        if load.body is not None:
            here = mesh.element_body == mesh.bodies.index(load.body)
        rule, weights = simplex_rule(mesh.dim, 3)
        points = quadrature_points(mesh.points, mesh.elements[here], rule)
        values = _components(load, points.reshape(-1, mesh.dim)).reshape(points.shape)
        self._add(result, mesh.elements[here], self.element_edges[here], _LOCAL[mesh.dim], rule, weights, values,
                  mesh.volumes[here])

    def _add_strain(self, result: np.ndarray, problem: ContactProblem, loads: list[InitialStrain]) -> None:
        """Initial strains, by their means on the elements."""
        mesh, dim = self.mesh, self.mesh.dim
        materials = body_materials(mesh, problem.material)
        strain = mean_initial_strain(mesh, loads, axisymmetric=self.axisymmetric)
        thin = np.array([isinstance(one, PlaneStress) for one in materials])[mesh.element_body]
        strain[thin, 2] = 0.0
        lame, shear = (constants[mesh.element_body] for constants in lame_constants(materials))
        stress = lame[:, None] * strain.sum(axis=1)[:, None] + 2 * shear[:, None] * strain
        corners = mesh.points[mesh.elements]
        g = np.linalg.inv(corners[:, 1:] - corners[:, :1])
        g = np.concatenate([-g.sum(axis=2, keepdims=True), g], axis=2)
        rule, weights = simplex_rule(dim, 3)
        factor = mesh.volumes[:, None] * weights
        if self.axisymmetric:
            r = quadrature_points(mesh.points, mesh.elements, rule)[:, :, 0]
            factor = factor * 2 * np.pi * r
        for k, (a, b) in enumerate(_LOCAL[dim]):
            slope = 4 * (np.einsum("eq,q,ed->ed", factor, rule[:, a], g[:, :, b])
                         + np.einsum("eq,q,ed->ed", factor, rule[:, b], g[:, :, a]))
            value = stress[:, :dim] * slope
            if self.axisymmetric:
                value[:, 0] += stress[:, 2] * np.einsum("eq,q->e", factor / r, 4 * rule[:, a] * rule[:, b])
            np.add.at(result, self.element_edges[:, k], value)


def _components(load: BodyForce | Traction, points: np.ndarray) -> np.ndarray:
    """Force (n, dim) per volume or area at points."""
    return np.column_stack([checks.field(f"component {'xyz'[k]} of {type(load).__name__}", component, points)
                            for k, component in enumerate(load.components)])


def edge_bubbles(mesh: MeshArrays, problem: ContactProblem) -> EdgeBubbles:
    """The bubbles on the edges of a mesh."""
    local, n = _LOCAL[mesh.dim], mesh.n_nodes
    pairs = np.sort(mesh.elements[:, local].reshape(-1, 2), axis=1).astype(np.int64)
    keys, numbers = np.unique(pairs[:, 0] * n + pairs[:, 1], return_inverse=True)
    edges = np.column_stack([keys // n, keys % n])
    return EdgeBubbles(mesh, is_axisymmetric(body_materials(mesh, problem.material)), edges,
                       numbers.reshape(len(mesh.elements), len(local)))
