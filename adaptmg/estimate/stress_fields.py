r"""A discrete solution as estimates see it: its stress on each element, and who its neighbours are.

The stress (:mod:`adaptmg.discrete.stress`) is constant on each element but for what the hoop strain
:math:`\varepsilon_\theta = u_r / r` of axisymmetric bodies adds to that at the centroid; of smoothed elements constant.

Tractions on a boundary are of the stress inside, :math:`\sigma_h n`, constant on each facet, from
the element behind it; and of contact, :math:`t_h`, linear in between the nodes,

.. math:: t_{h,i} = F_i \Big/ \sum_F \int_F \varphi_i ,

the nodal contact force over the lumped mass of the surface. They differ by what the mesh does not
resolve: the second is one order more accurate as a mean, and obeys the contact conditions at the
nodes. Both act on the body whose boundary it is, n points out of it: pressure is :math:`-t \cdot
n`, positive in compression. At a node on two contact boundaries the first one named has the force.
Where the second goes on in the same direction it has the same traction there; around a corner it
has that of its neighbours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from adaptmg import _checks as checks
from adaptmg.discrete.loads import load_vector
from adaptmg.discrete.moduli import Moduli, isotropic
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import StressData, hoop_strain
from adaptmg.discrete.supports import node_at
from adaptmg.discrete.ties import TieForces
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import (
    MeshArrays,
    Surface,
    element_facets,
    facet_keys,
    mask_of,
    need_mesh,
    sorted_facet_keys,
)
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.loads import PointForce
from adaptmg.solver.advice import CORNER
from adaptmg.solver.examine import ContactResult, energy_norm, euclidean_norm
from adaptmg.solver.result import Result

#: by the number of stored components of a stress, the one at each place of the tensor
_STORED = {
    3: np.array([[0, 2], [2, 1]]),
    4: np.array([[0, 3], [3, 1]]),
    6: np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]]),
}


@dataclass(frozen=True, eq=False)
class ElementStress:
    """The stress of a displacement on each element of a mesh."""

    mesh: MeshArrays
    displacement: np.ndarray  # (n_nodes, dim): m
    data: StressData
    #: (n_elements, n_components) at centroids: xx, yy, xy; rr, zz, hoop, rz; xx, yy, zz, xy, yz, xz
    values: np.ndarray

    @property
    def axisymmetric(self) -> bool:
        """Return whether integrals are weighted with 2 pi r."""
        return self.data.axisymmetric

    @property
    def columns(self) -> np.ndarray:
        """Return the column of ``values`` that holds each component (dim, dim) of the tensor, in
        axisymmetry of its part in the section."""
        return _STORED[self.values.shape[1]]

    @cached_property
    def invertible_moduli(self) -> Moduli:
        """Return the moduli C whose inverses make energies of stresses. Lame's first constant may be
        infinite: it is at most mu / ALIKE, beyond which its inverse changes nothing. Sheets enter as
        solids with the Lame constant of plane stress: the inverse of the block (xx, yy, xy) of C is then
        their compliance, while the whole C of a sheet is singular."""
        if self.data.moduli is not None:
            return self.data.moduli
        return isotropic(
            self.data.lame,
            self.data.shear,
            thin=np.zeros(len(self.data.lame), dtype=bool),
            mesh=self.mesh,
            most=1 / checks.ALIKE,
        )

    @cached_property
    def of_hoop(self) -> np.ndarray:
        """Return the stresses rr, zz, hoop, rz (n_elements, 4), Pa, of a hoop strain of 1, which varies
        within linear elements."""
        if self.data.smoothed:
            return np.zeros((len(self.mesh.elements), 4))
        return self.data.of_elements(self.mesh).of_hoop()

    def tractions(
        self, elements: np.ndarray, normals: np.ndarray, facets: np.ndarray, rule: np.ndarray
    ) -> np.ndarray:
        """Return sigma n (n, n_points, dim), Pa, at the points of a ``rule`` (n_points, dim) on facets
        (n, dim) with these normals (n, dim), in their elements (n,)."""
        plain = np.einsum("nij,nj->ni", self.values[elements][:, self.columns], normals)
        result = np.repeat(plain[:, None, :], len(rule), axis=1)
        if self.axisymmetric:
            per_hoop_strain = np.einsum(
                "nij,nj->ni", self.of_hoop[elements][:, self.columns], normals
            )
            # the difference of the hoop strains at a point and at the centroid
            result += (
                self.hoop_variation(elements, facets, rule)[:, :, None]
                * per_hoop_strain[:, None, :]
            )
        return result

    @cached_property
    def hoop(self) -> np.ndarray:
        """Return the hoop strain (n_elements,) at the centroids of axisymmetric elements, else empty."""
        return hoop_strain(self.mesh, self.displacement) if self.axisymmetric else np.empty(0)

    def hoop_variation(
        self, elements: np.ndarray | slice, cells: np.ndarray, rule: np.ndarray
    ) -> np.ndarray:
        """Return the hoop strain (n, n_points) at the points of a ``rule`` (n_points, k) on cells
        (n, k), elements or facets, minus that at the centroids of their elements (n,); 0 where
        elements are smoothed. At points on the axis, whose weights are 0, the hoop strain is taken as 0."""
        if self.data.smoothed:
            return np.zeros((len(cells), len(rule)))
        radius = self.mesh.points[cells, 0] @ rule.T
        moved = self.displacement[cells, 0] @ rule.T
        hoop = np.divide(moved, radius, out=np.zeros_like(radius), where=radius > 0)
        return hoop - self.hoop[elements, None]


def element_stress(mesh: MeshArrays, displacement: np.ndarray, data: StressData) -> ElementStress:
    """Return the stress of a displacement (n_nodes, dim), m."""
    values = data.columns(mesh, displacement)
    if mesh.dim == 2 and not data.axisymmetric:
        values = values[:, [0, 1, 3]]  # without zz
    return ElementStress(mesh, displacement, data, values)


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The elements that share each facet inside, and the one that each boundary facet belongs
    to."""

    pairs: np.ndarray  # (2, n): both elements
    # (n, dim): the facet between them; its normal points out of the first one
    facets: np.ndarray
    owner: np.ndarray  # (n_facets,)
    outer: np.ndarray  # (n_facets,) bool: no element lies on the other side


def neighbours(mesh: MeshArrays) -> Neighbours:
    """Return the neighbours in a mesh.

    The sides of all elements are numbered element by element; two sides with the same nodes follow
    each other when sorted by their keys."""
    n_sides = mesh.dim + 1
    n = mesh.n_nodes
    facets = element_facets(mesh.elements).reshape(-1, mesh.dim)
    keys, order = sorted_facet_keys(facets, n)
    same = np.flatnonzero(keys[1:] == keys[:-1])
    inside = np.stack([order.take(same), order.take(same + 1)])
    boundary_keys = facet_keys(mesh.facets, n)
    place = np.searchsorted(keys, boundary_keys)
    n_elements = np.searchsorted(keys, boundary_keys, side="right") - place
    without_element = np.flatnonzero(n_elements == 0)
    if len(without_element):
        facet = without_element[0]
        raise ValueError(
            f"mesh: boundary facet {facet} of nodes {mesh.facets[facet].tolist()} belongs to no element"
        )
    # the number of a side over the number of sides of an element is that of the element
    return Neighbours(
        pairs=inside // n_sides,
        facets=facets.take(inside[0], axis=0),
        owner=order.take(place) // n_sides,
        outer=n_elements == 1,
    )


_OTHER_STEP = (
    "of a load step, or where forces are prescribed, give hierarchy.with_problem("
    "adaptmg.problem.step_problem(problem, factors, result.motions))"
)


@dataclass(frozen=True, eq=False)
class Solved:
    """A result with what was posed and the matrix it belongs to."""

    posed: Posed
    discrete: DiscreteProblem  # of the finest level
    result: Result

    @property
    def problem(self) -> ContactProblem:
        """Return the problem."""
        return self.posed.problem

    @property
    def mesh(self) -> MeshArrays:
        """Return the mesh."""
        return self.posed.mesh

    @cached_property
    def stress(self) -> ElementStress:
        """Return the stress on each element."""
        data = self.result.stress_data
        if data is None:
            data = StressData.of(
                self.mesh, self.posed.materials, self.problem.loads, self.problem.elements
            )
        return element_stress(self.mesh, self.result.displacement, data)

    @cached_property
    def neighbours(self) -> Neighbours:
        """Return the neighbours in the mesh."""
        return neighbours(self.mesh)

    @cached_property
    def young(self) -> np.ndarray:
        """Return Young's modulus of each element (n_elements,), Pa."""
        of_bodies = np.array([elastic.young for elastic in self.posed.materials])
        return of_bodies[self.mesh.element_body]

    @cached_property
    def regular(self) -> np.ndarray:
        """Return the mask (n_elements,) of elements at which no point force, whose energy is infinite,
        acts."""
        nodes = [
            node_at(self.mesh, load.point, load.body)
            for load in self.problem.loads
            if isinstance(load, PointForce)
        ]
        loaded = mask_of(np.array(nodes, dtype=np.int64), self.mesh.n_nodes)
        # by corner: .1 ms for 38 000 triangles, by isin .5
        return ~np.any(loaded.take(self.mesh.elements.T), axis=0)

    @cached_property
    def norm(self) -> float:
        """Return ||u_h||_A, sqrt(N m), of the displacement with prescribed values."""
        return energy_norm(*self._unknowns_and_forces)

    @cached_property
    def _unknowns_and_forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the unknowns and the forces A u (n_dofs,), those of the pressures of volumes
        included, in relative coordinates."""
        unknowns = self.discrete.relative(self.result.displacement).reshape(-1)
        forces = self.discrete.rows.times(unknowns)
        return unknowns, forces + self.discrete.volumes.forces(self.result.pressures)

    def check_loads(self) -> None:
        """Raise ValueError unless the result is of the loads of the problem: its load is b = A u -
        ``result.reaction``, the forces of supports and of contact. It must be the load of the discrete
        problem, or that of the posed one, as a hierarchy may have the problem of a load step without its
        discretisation."""
        unknowns, forces = self._unknowns_and_forces
        exerted = np.asarray(self.result.reaction, dtype=np.float64).reshape(-1)
        if exerted.shape != forces.shape:
            raise ValueError(
                f"result.reaction must have {forces.size} components, got {exerted.shape}"
            )
        of_result = forces - self.discrete.relative_forces(exerted)
        allowed = checks.SIX_DIGITS * max(euclidean_norm(forces), euclidean_norm(of_result))
        missed = euclidean_norm(of_result - self.discrete.load)
        if missed <= allowed:
            return
        # A u, of which the load is a part, is a difference of terms of this size
        rounding = checks.ROUNDING * euclidean_norm(self.discrete.rows.diagonal() * unknowns)
        nodal_forces = load_vector(
            self.mesh, self.problem.loads, self.problem.material, self.problem.elements
        )
        missed_of_posed = euclidean_norm(of_result - self.discrete.relative_forces(nodal_forces))
        if not min(missed, missed_of_posed) <= max(allowed, rounding):
            raise ValueError(
                "result has other loads than those of hierarchy.problem: " + _OTHER_STEP
            )

    def check_obstacles(self) -> None:
        """Raise ValueError unless the obstacles of the result are in the places of the problem."""
        contact = self.result.contact
        # the discrete problem may have supports in other places than the result
        unknowns, _ = self._unknowns_and_forces
        prescribed = unknowns - self.discrete.free_part(unknowns)
        prescribed_change = prescribed - self.discrete.fixed_values
        # where supports hold a part of a normal, the gaps are what the prescribed values leave of them
        gaps = self.discrete.contact.gaps - self.posed.approached(
            prescribed_change.reshape(self.mesh.points.shape)
        )
        # the condition of a node that takes over the shares V of others (ContactNodes.taken_over) is a sum
        # with weights of sum 1 + sum(V) = measures / weights; contact results are the means
        gaps *= contact.weights / contact.measures
        # the gap of the result before it moved by u_n, minus that of the problem
        difference = contact.gap + contact.u_n - gaps
        length = np.abs([contact.gap, contact.u_n]).max(initial=0.0)
        if np.abs(difference).max(initial=0.0) > checks.SIX_DIGITS * length:
            raise ValueError(
                "result has its obstacles in other places than hierarchy.problem: " + _OTHER_STEP
            )


def solved(hierarchy: Hierarchy, result: Result, plastic: bool = False) -> Solved:
    """Return a result on the finest mesh of a hierarchy, checked to belong to it; ``plastic``: also
    one of plastic bodies, with the stress that the whole strain would have."""
    checks.instance("hierarchy", hierarchy, Hierarchy, "a Hierarchy")
    posed = hierarchy.posed
    if posed is None:
        raise ValueError(
            "hierarchy must have meshes and a ContactProblem (am.Residual() also estimates a "
            "ScalarProblem): make it by Hierarchy.uniform, graded or from_meshes"
        )
    check_result(posed.mesh, result)
    data = result.stress_data
    if plastic and data is not None and data.plastic is not None:
        # loads are not checked: the elastic matrix does not hold the forces of these bodies
        result = replace(result, stress_data=replace(data, plastic=None))
        return Solved(posed, hierarchy.finest.discrete, result)
    state = Solved(posed, hierarchy.finest.discrete, result)
    state.check_loads()
    state.check_obstacles()
    return state


def check_result(mesh: MeshArrays, result: Result) -> None:
    """Raise ValueError unless a result is one on the finest mesh of a hierarchy, and finite."""
    checks.instance("result", result, Result, "a Result")
    result_mesh = need_mesh(result)
    if result_mesh is not mesh and not (
        np.array_equal(result_mesh.elements, mesh.elements)
        and np.array_equal(result_mesh.points, mesh.points)
    ):
        raise ValueError(
            f"result is of another mesh ({result_mesh.n_nodes} nodes) than the finest of hierarchy "
            f"({mesh.n_nodes} nodes): give the hierarchy it was solved on, or hierarchy.truncated(...)"
        )
    if not np.isfinite(result.displacement).all():
        i = int(np.argmin(np.isfinite(result.displacement).all(axis=1)))
        raise ValueError(
            f"result.displacement must be finite, got {result.displacement[i]} at node {i}: the solver "
            f"ended with {result.status.name}"
        )


@dataclass(frozen=True, eq=False)
class SurfaceTraction:
    """Contact traction on one boundary."""

    facets: np.ndarray  # (n, dim) int: nodes of the facets
    nodes: np.ndarray  # (m,) int: ascending
    values: np.ndarray  # (m, dim): on the body of this boundary, Cartesian, Pa

    @property
    def corners(self) -> np.ndarray:
        """Return the tractions (n, dim, dim) at the corners of the facets."""
        return self.values[np.searchsorted(self.nodes, self.facets)]


def contact_tractions(
    mesh: MeshArrays, result: Result, axisymmetric: bool
) -> Mapping[str, SurfaceTraction]:
    """Return tractions of contact and ties on all boundaries that touch something, masters too, by
    name."""
    contact = result.contact
    ties = result.ties
    tractions = {
        name: _on_surface(mesh, contact, name, axisymmetric)
        for name in dict.fromkeys([*contact.names, *filter(None, contact.masters)])
    }
    if ties is None:
        return tractions
    # in how many tied boundaries a node lies: its force is not divided among several, and so it gets the
    # traction of its neighbours on each
    n_sides = np.zeros(mesh.n_nodes, dtype=np.int64)
    for name in set(ties.names):  # of a boundary in several ties once
        n_sides[mesh.surface(name).nodes] += 1
    # slave and master of each tie, in turn: the tractions of ties on one boundary add up
    for k, name in enumerate(ties.names):
        surface = mesh.surface(name)
        values = _tie_traction(surface, ties, k, n_sides[surface.nodes], axisymmetric)
        of_contact = tractions[name].values if name in tractions else 0.0
        tractions[name] = SurfaceTraction(surface.facets, surface.nodes, of_contact + values)
    return tractions


def _tie_traction(
    surface: Surface, ties: TieForces, k: int, n_sides: np.ndarray, axisymmetric: bool
) -> np.ndarray:
    """Return the traction (m, dim) of side k of the ties at the nodes of its boundary: nodal forces
    over nodal masses. Nodes that several tied boundaries share (``n_sides`` (m,) > 1), and those of a
    slave that are not tied, get the traction of their neighbours."""
    on_side = ties.boundary == k
    forces = np.zeros((len(surface.nodes), ties.force.shape[1]))
    forces[np.searchsorted(surface.nodes, ties.node[on_side])] = ties.force[on_side]
    mass = surface.lumped(axisymmetric)[surface.nodes, None]
    values = np.divide(forces, mass, out=np.zeros_like(forces), where=mass > 0)
    has_traction = n_sides == 1
    is_slave = k % 2 == 0  # sides come in pairs of slave and master
    if is_slave:
        has_traction &= np.isin(surface.nodes, ties.node[on_side])
    _fill(surface, has_traction, values)
    return values


def _fill(surface: Surface, filled: np.ndarray, values: np.ndarray) -> None:
    """Overwrite ``values`` (n_nodes of the surface, dim) at nodes outside the mask ``filled`` by the
    mean of their filled neighbours. A second pass fills corners from the nodes of the first."""
    place = np.searchsorted(surface.nodes, surface.facets)
    filled = filled.copy()
    for _ in range(2):
        before = filled.copy()
        for i in np.flatnonzero(~before):
            near = np.unique(place[(place == i).any(axis=1)])
            if before[near].any():
                values[i] = values[near[before[near]]].mean(axis=0)
                filled[i] = True


def _on_surface(
    mesh: MeshArrays, contact: ContactResult, name: str, axisymmetric: bool
) -> SurfaceTraction:
    """Return the contact traction on a boundary: nodal forces over nodal masses.

    Of the nodes of a slave that have no force of this boundary, those of another contact boundary that
    goes straight on get its traction, others that of their neighbours; those without any contact
    condition keep none."""
    surface = mesh.surface(name)
    nodes = surface.nodes
    force, mass, has_force = _contact_forces(mesh, contact, surface, name, axisymmetric)
    values = np.divide(force, mass[:, None], out=np.zeros_like(force), where=mass[:, None] > 0)
    # nodes of a master without a force face nothing: they have no traction
    if name in contact.names and not has_force.all():
        normals = np.zeros(mesh.points.shape)
        normals[contact.node] = contact.normal
        normals = normals[nodes]
        tractions = np.zeros(mesh.points.shape)
        tractions[contact.node] = contact.force / contact.weights[:, None]
        straight = ~has_force & (
            np.einsum("nd,nd->n", normals, surface.node_normals[nodes]) > np.cos(CORNER)
        )
        values[straight] = tractions[nodes[straight]]
        without_condition = ~normals.any(axis=1)
        _fill(surface, has_force | straight | without_condition, values)
    return SurfaceTraction(surface.facets, nodes, values)


def _contact_forces(
    mesh: MeshArrays, contact: ContactResult, surface: Surface, name: str, axisymmetric: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the contact forces (m, dim) of a boundary ``name`` at the nodes of its ``surface``, as
    slave and as master, their masses (m,), and the mask (m,) of nodes that have forces."""
    nodes = surface.nodes
    mass = surface.lumped(axisymmetric)[nodes]
    force = np.zeros((len(nodes), mesh.dim))
    has_force = np.zeros(len(nodes), dtype=bool)
    for k, (slave, master) in enumerate(zip(contact.names, contact.masters, strict=True)):
        if slave == name:
            rows = contact.boundary == k
            at = np.searchsorted(nodes, contact.node[rows])
            force[at] += contact.force[rows]
            has_force[at] = True
        if name in (slave, master):
            # forces on nodes without a condition: of the master, or of the slave where ``name`` is that
            rows = (contact.master_boundary == k) & (contact.master_is_slave == (slave == name))
            at = np.searchsorted(nodes, contact.master_node[rows])
            force[at] += contact.master_force[rows]
            has_force[at] = True
    return force, mass, has_force
