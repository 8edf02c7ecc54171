r"""Tractions on a boundary: of the stress inside, and of contact.

Two answers to the same question, which differ by what the mesh does not resolve: :math:`\sigma_h n`, constant on each
facet, from the element behind it; and :math:`t_h`, the nodal contact forces over the lumped mass of the surface. The
second is one order more accurate as a mean, and obeys the contact conditions at the nodes. Both are tractions that act
on the body whose boundary it is, n points out of it: pressure is :math:`-t \cdot n`, positive in compression.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.discretisation.facets import area_vectors
from adaptmg.discretisation.mortar.surface_normals import surface_normals
from adaptmg.estimate.fields.contact_tractions import contact_tractions
from adaptmg.estimate.fields.element_stress import element_stress
from adaptmg.estimate.fields.neighbours import neighbours
from adaptmg.problem import checks
from adaptmg.solver.result import Result

__all__ = ["BoundaryTractions", "boundary_tractions"]


@dataclass(frozen=True, eq=False)
class BoundaryTractions:
    """Tractions on one boundary; SI units, Cartesian components.

    Attributes
    ----------
    facets : (n, dim) int array
        Nodes of the facets.
    elements : (n,) int array
        The element behind each.
    centres : (n, dim) array
        Their midpoints, m.
    facet_normals : (n, dim) array
        Unit, out of the body.
    stress : (n, dim) array
        Sigma n at the midpoints, on the body, Pa.
    nodes : (m,) int array
        Nodes of the boundary, ascending.
    points : (m, dim) array
        m.
    normals : (m, dim) array
        Unit normals averaged at the nodes, out of the body.
    contact : (m, dim) array
        Contact traction on the body, Pa; zero where nothing touches, and on boundaries without contact. Friction where
        a support holds the node tangentially is what the law says for its slip.
    """

    facets: np.ndarray
    elements: np.ndarray
    centres: np.ndarray
    facet_normals: np.ndarray
    stress: np.ndarray
    nodes: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    contact: np.ndarray

    @property
    def stress_pressure(self) -> np.ndarray:
        """Pressure -n . sigma n (n,) of the stress inside, positive in compression, Pa."""
        return -np.sum(self.stress * self.facet_normals, axis=1)

    @property
    def pressure(self) -> np.ndarray:
        """Contact pressure -t . n (m,) at the nodes, positive in compression, Pa."""
        return -np.sum(self.contact * self.normals, axis=1)

    @property
    def tangential(self) -> np.ndarray:
        """Tangential part (m, dim) of the contact traction on the body, Pa."""
        return self.contact + self.pressure[:, None] * self.normals


def boundary_tractions(result: Result, boundary: str) -> BoundaryTractions:
    """Tractions on a boundary of a result; on both sides of a pair, each by its name.

    Parameters
    ----------
    result : Result
        With mesh and materials.
    boundary : str

    Returns
    -------
    BoundaryTractions

    Raises
    ------
    TypeError, ValueError
        Without a mesh or materials, or if there is no such boundary.
    """
    checks.instance("result", result, Result, "a Result")
    mesh, data = result.mesh, result.stress_data
    if mesh is None or data is None:
        raise ValueError("result knows no mesh or no materials (it comes from a bare DiscreteProblem): solve on a "
                         "Hierarchy of a ContactProblem")
    facets = mesh.boundary_facets(boundary)
    here = mesh.facet_labels == mesh.boundaries.index(boundary)
    elements = neighbours(mesh).owner[here]
    vectors = area_vectors(mesh.points, facets)
    facet_normals = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    middle = np.full((1, mesh.dim), 1 / mesh.dim)
    stress = element_stress(mesh, result.displacement, data).tractions(elements, facet_normals, facets, middle)[:, 0]
    nodes = np.unique(facets)
    touching = contact_tractions(mesh, result.contact, data.axisymmetric).get(boundary)
    contact = np.zeros((len(nodes), mesh.dim)) if touching is None else touching.values
    return BoundaryTractions(facets=facets, elements=elements, centres=mesh.points[facets].mean(axis=1),
                             facet_normals=facet_normals, stress=stress, nodes=nodes, points=mesh.points[nodes],
                             normals=surface_normals(mesh.points, facets)[nodes], contact=contact)
