r"""Tractions on a boundary: of the stress inside, and of contact.

They differ by what the mesh does not resolve: :math:`\sigma_h n`, constant on each facet, from the element behind it;
and :math:`t_h`, linear in between the nodes,

.. math:: t_{h,i} = F_i \Big/ \sum_F \int_F \varphi_i ,

the nodal contact force over the lumped mass of the surface. The second is one order more accurate as a mean, and obeys
the contact conditions at the nodes. Both act on the body whose boundary it is, n points out of it: pressure is
:math:`-t \cdot n`, positive in compression.

At a node on two contact boundaries the first one named has the force. Where the second goes on in the same direction
it has the same traction there; around a corner it has that of its neighbours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from adaptmg import _checks as checks
from adaptmg.discrete.facets import area_vectors, named_facets, shape_integrals
from adaptmg.discrete.mortar.interface import surface_normals
from adaptmg.estimate.stress_fields import element_stress, neighbours
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.solver.contact_result import ContactResult
from adaptmg.solver.result import Result

__all__ = ["BoundaryTractions", "SurfaceTraction", "boundary_tractions", "contact_tractions"]


@dataclass(frozen=True, eq=False)
class BoundaryTractions:
    """Tractions on one boundary: of the stress at the facets, of contact at the nodes; SI units, Cartesian components.

    ``contact`` is zero where nothing touches, and on boundaries without contact. Friction where a support holds the
    node tangentially is what the law says for its slip.
    """

    facets: np.ndarray  # (n, dim) int: nodes of the facets
    elements: np.ndarray  # (n,) int: the element behind each
    centres: np.ndarray  # (n, dim): their midpoints, m
    facet_normals: np.ndarray  # (n, dim): unit, out of the body
    stress: np.ndarray  # (n, dim): sigma n at the midpoints, on the body, Pa
    nodes: np.ndarray  # (m,) int: nodes of the boundary, ascending
    points: np.ndarray  # (m, dim), m
    normals: np.ndarray  # (m, dim): unit normals averaged at the nodes, out of the body
    contact: np.ndarray  # (m, dim): contact traction on the body, Pa

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

    TypeError or ValueError without a mesh or materials, or if there is no such boundary.
    """
    checks.instance("result", result, Result, "a Result")
    mesh, data = result.mesh, result.stress_data
    if data is None:
        raise ValueError("result has no materials (it comes from a bare DiscreteProblem): solve on a "
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


#: cosine of the angle up to which one surface is the continuation of another
_STRAIGHT = 0.8


@dataclass(frozen=True, eq=False)
class SurfaceTraction:
    """Contact traction on one boundary."""

    facets: np.ndarray  # (n, dim) int: nodes of the facets
    nodes: np.ndarray  # (m,) int: ascending
    values: np.ndarray  # (m, dim): on the body of this boundary, Cartesian, Pa

    @property
    def corners(self) -> np.ndarray:
        """Values (n, dim, dim) at the corners of the facets."""
        return self.values[np.searchsorted(self.nodes, self.facets)]


def contact_tractions(mesh: MeshArrays, contact: ContactResult, axisymmetric: bool) -> Mapping[str, SurfaceTraction]:
    """Contact tractions on all boundaries that may touch something, masters too, by name."""
    masters = contact.masters or ("",) * len(contact.names)
    on_slave = _on_slaves(mesh, contact)
    return {name: _on_surface(mesh, contact, masters, name, on_slave, axisymmetric)
            for name in dict.fromkeys([*contact.names, *filter(None, masters)])}


def _on_surface(mesh: MeshArrays, contact: ContactResult, masters: tuple[str, ...], name: str, on_slave: np.ndarray,
                axisymmetric: bool) -> SurfaceTraction:
    facets = named_facets(mesh, name)
    nodes, place = np.unique(facets, return_inverse=True)
    place, vectors = place.reshape(facets.shape), area_vectors(mesh.points, facets)
    share = np.linalg.norm(vectors, axis=1)[:, None] * shape_integrals(mesh.points, facets, axisymmetric)
    mass = np.bincount(place.ravel(), weights=share.ravel(), minlength=len(nodes))
    force, filled = np.zeros((len(nodes), mesh.dim)), np.zeros(len(nodes), dtype=bool)
    for k, (slave, master) in enumerate(zip(contact.names, masters, strict=True)):
        if slave == name:
            mine = contact.boundary == k
            at = np.searchsorted(nodes, contact.node[mine])
            force[at] += contact.force[mine]
            filled[at] = True
            if not master:  # an obstacle: the mass of a neighbouring contact boundary that goes on counts too
                mass[at] = np.maximum(mass[at], contact.weights[mine])
        if name in (slave, master):
            mine = (contact.master_boundary == k) & (on_slave if slave == name else ~on_slave)
            at = np.searchsorted(nodes, contact.master_node[mine])
            force[at] += contact.master_force[mine]
            filled[at] = True
    values = np.divide(force, mass[:, None], out=np.zeros_like(force), where=mass[:, None] > 0)
    if name in contact.names and not filled.all():
        _continue(contact, nodes, place, vectors, filled, values)
    return SurfaceTraction(facets, nodes, values)


def _continue(contact: ContactResult, nodes: np.ndarray, place: np.ndarray, vectors: np.ndarray, filled: np.ndarray,
              values: np.ndarray) -> None:
    """Fill ``values`` in at nodes that belong to another contact boundary; elsewhere nothing touches."""
    for i in np.flatnonzero(~filled & np.isin(nodes, contact.node)):
        here = (place == i).any(axis=1)
        normal = vectors[here].sum(axis=0)
        j = int(np.argmax(contact.node == nodes[i]))
        if normal @ contact.normal[j] > _STRAIGHT * np.linalg.norm(normal):
            values[i] = contact.force[j] / contact.weights[j]
        else:
            near = np.unique(place[here])
            near = near[filled[near]]
            if len(near):
                values[i] = values[near].mean(axis=0)


def _on_slaves(mesh: MeshArrays, contact: ContactResult) -> np.ndarray:
    """Which of ``contact.master_node`` (m,) lie on the slave of their pair."""
    result = np.zeros(len(contact.master_node), dtype=bool)
    for k, name in enumerate(contact.names):
        mine = contact.master_boundary == k
        if mine.any():
            result[mine] = np.isin(contact.master_node[mine], mesh.boundary_nodes(name))
    return result
