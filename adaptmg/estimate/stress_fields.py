r"""A discrete solution as estimates see it: its stress on each element, and who its neighbours are.

The stress is constant on each element but for the parts of the hoop strain :math:`\varepsilon_\theta = u_r / r` of
axisymmetric bodies, which are evaluated where they are needed. With the initial strain :math:`\varepsilon_0`,

.. math:: \sigma = \lambda\,\mathrm{tr}(\varepsilon - \varepsilon_0) I + 2\mu (\varepsilon - \varepsilon_0).

Tractions on a boundary are of the stress inside, :math:`\sigma_h n`, constant on each facet, from the element behind
it; and of contact, :math:`t_h`, linear in between the nodes,

.. math:: t_{h,i} = F_i \Big/ \sum_F \int_F \varphi_i ,

the nodal contact force over the lumped mass of the surface. They differ by what the mesh does not resolve: the second
is one order more accurate as a mean, and obeys the contact conditions at the nodes. Both act on the body whose boundary
it is, n points out of it: pressure is :math:`-t \cdot n`, positive in compression. At a node on two contact boundaries
the first one named has the force. Where the second goes on in the same direction it has the same traction there; around
a corner it has that of its neighbours.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from adaptmg import _checks as checks
from adaptmg._numba import inner_kernel, kernel
from adaptmg.discrete.elasticity import body_materials
from adaptmg.discrete.loads import load_vector
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import StressData
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays, Surface
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.solver.contact_result import ContactResult
from adaptmg.solver.examine import energy_norm, euclidean_norm
from adaptmg.solver.result import Result

_THIN = 1


@kernel
def _plane(points, elements, body, u, lame, shear, thin, initial, stress):
    """Write xx, yy, xy (n_elements, 3). ``thin`` (n_bodies,): plane stress; ``initial`` (n_elements or 0, 3)."""
    strained = len(initial) > 0
    for e in range(len(elements)):
        a, b, c = elements[e, 0], elements[e, 1], elements[e, 2]
        x1, y1 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        x2, y2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
        det = x1 * y2 - y1 * x2
        u1, v1 = u[b, 0] - u[a, 0], u[b, 1] - u[a, 1]
        u2, v2 = u[c, 0] - u[a, 0], u[c, 1] - u[a, 1]
        xx, yy = (u1 * y2 - u2 * y1) / det, (v2 * x1 - v1 * x2) / det
        twice_xy = (u2 * x1 - u1 * x2 + v1 * y2 - v2 * y1) / det
        out, k = 0.0, body[e]
        if strained:
            xx, yy = xx - initial[e, 0], yy - initial[e, 1]
            if not thin[k]:
                out = -initial[e, 2]
        pressure = lame[k] * (xx + yy + out)
        stress[e, 0] = pressure + 2.0 * shear[k] * xx
        stress[e, 1] = pressure + 2.0 * shear[k] * yy
        stress[e, 2] = shear[k] * twice_xy


@kernel
def _solid(points, elements, body, u, lame, shear, initial, stress):
    """Write xx, yy, zz, xy, yz, xz (n_elements, 6). ``initial`` (n_elements or 0, 3)."""
    strained = len(initial) > 0
    for e in range(len(elements)):
        a, b, c, d = elements[e, 0], elements[e, 1], elements[e, 2], elements[e, 3]
        x1, y1, z1 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        x2, y2, z2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
        x3, y3, z3 = points[d, 0] - points[a, 0], points[d, 1] - points[a, 1], points[d, 2] - points[a, 2]
        gx1, gy1, gz1 = y2 * z3 - z2 * y3, z2 * x3 - x2 * z3, x2 * y3 - y2 * x3
        gx2, gy2, gz2 = y3 * z1 - z3 * y1, z3 * x1 - x3 * z1, x3 * y1 - y3 * x1
        gx3, gy3, gz3 = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
        det = x1 * gx1 + y1 * gy1 + z1 * gz1
        u1, v1, w1 = u[b, 0] - u[a, 0], u[b, 1] - u[a, 1], u[b, 2] - u[a, 2]
        u2, v2, w2 = u[c, 0] - u[a, 0], u[c, 1] - u[a, 1], u[c, 2] - u[a, 2]
        u3, v3, w3 = u[d, 0] - u[a, 0], u[d, 1] - u[a, 1], u[d, 2] - u[a, 2]
        xx = (u1 * gx1 + u2 * gx2 + u3 * gx3) / det
        yy = (v1 * gy1 + v2 * gy2 + v3 * gy3) / det
        zz = (w1 * gz1 + w2 * gz2 + w3 * gz3) / det
        xy = (u1 * gy1 + u2 * gy2 + u3 * gy3 + v1 * gx1 + v2 * gx2 + v3 * gx3) / det
        yz = (v1 * gz1 + v2 * gz2 + v3 * gz3 + w1 * gy1 + w2 * gy2 + w3 * gy3) / det
        xz = (u1 * gz1 + u2 * gz2 + u3 * gz3 + w1 * gx1 + w2 * gx2 + w3 * gx3) / det
        if strained:
            xx, yy, zz = xx - initial[e, 0], yy - initial[e, 1], zz - initial[e, 2]
        k = body[e]
        pressure = lame[k] * (xx + yy + zz)
        stress[e, 0] = pressure + 2.0 * shear[k] * xx
        stress[e, 1] = pressure + 2.0 * shear[k] * yy
        stress[e, 2] = pressure + 2.0 * shear[k] * zz
        stress[e, 3], stress[e, 4], stress[e, 5] = shear[k] * xy, shear[k] * yz, shear[k] * xz


@dataclass(frozen=True, eq=False)
class ElementStress:
    """Stress in a mesh."""

    mesh: MeshArrays
    displacement: np.ndarray  # (n_nodes, dim): m
    data: StressData
    values: np.ndarray  # (n_elements, 3 or 6)

    @property
    def axisymmetric(self) -> bool:
        """Whether integrals are weighted with 2 pi r."""
        return self.data.axisymmetric

    def hoop(self, cells: np.ndarray, rule: np.ndarray) -> np.ndarray:
        """Hoop strain u_r / r (n, n_points) at barycentric points (n_points, k) of cells (n, k); 0 on the axis."""
        radius = self.mesh.points[cells, 0] @ rule.T
        moved = self.displacement[cells, 0] @ rule.T
        return np.divide(moved, radius, out=np.zeros_like(radius), where=radius > 0)

    def tractions(self, elements: np.ndarray, normals: np.ndarray, facets: np.ndarray, rule: np.ndarray
                  ) -> np.ndarray:
        """Sigma n (n, n_points, dim) at points of facets."""
        order = [[0, 2], [2, 1]] if self.mesh.dim == 2 else [[0, 3, 5], [3, 1, 4], [5, 4, 2]]
        plain = np.einsum("nij,nj->ni", self.values[elements][:, order], normals)
        result = np.repeat(plain[:, None, :], len(rule), axis=1)
        if self.axisymmetric:
            lame = self.data.lame[self.mesh.element_body[elements]]
            result += (lame[:, None] * self.hoop(facets, rule))[:, :, None] * normals[:, None, :]
        return result


def element_stress(mesh: MeshArrays, displacement: np.ndarray, data: StressData) -> ElementStress:
    """The stress of a displacement (n_nodes, dim), m."""
    if len(data.kind) != len(mesh.bodies) or len(data.initial_strain) not in (0, len(mesh.elements)):
        raise ValueError(f"stress data of {len(data.kind)} bodies and {len(data.initial_strain)} elements do not "
                         f"belong to a mesh of {len(mesh.bodies)} and {len(mesh.elements)}")
    u = np.ascontiguousarray(displacement, dtype=np.float64)
    values = np.empty((len(mesh.elements), 3 if mesh.dim == 2 else 6))
    initial = np.ascontiguousarray(data.initial_strain, dtype=np.float64)
    lame, shear = (np.ascontiguousarray(part, dtype=np.float64) for part in (data.lame, data.shear))
    if mesh.dim == 2:
        _plane(mesh.points, mesh.elements, mesh.element_body, u, lame, shear, data.kind == _THIN, initial, values)
    else:
        _solid(mesh.points, mesh.elements, mesh.element_body, u, lame, shear, initial, values)
    return ElementStress(mesh, u, data, values)


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Which element lies across each facet of an element, and which one a boundary facet belongs to."""

    across: np.ndarray  # (n_elements, dim + 1) int32: the element opposite each corner, -1 on the boundary
    owner: np.ndarray  # (n_facets,) int32
    corner: np.ndarray  # (n_facets,) int32: the corner of the owner which lies opposite


def neighbours(mesh: MeshArrays) -> Neighbours:
    """Neighbours in a mesh. Facets are kept in buckets by their lowest node; two are the same if their lowest and
    highest nodes and the sums of their nodes agree. A bucket holds about a dozen of them (3D: some dozens), so that no
    table has to be sorted."""
    n, k = mesh.elements.shape
    across = np.full((n, k), -1, dtype=np.int32)
    owner, corner = (np.full(len(mesh.facets), -1, dtype=np.int32) for _ in range(2))
    start = np.zeros(mesh.n_nodes + 1, dtype=np.int64)
    codes, highs, sums = np.empty(n * k, np.int32), np.empty(n * k, np.int32), np.empty(n * k, np.int64)
    find_neighbours(mesh.elements, mesh.facets, start, codes, highs, sums, across, owner, corner)
    if len(owner) and owner.min() < 0:
        i = int(np.argmin(owner))
        raise ValueError(f"mesh: boundary facet {i} of nodes {mesh.facets[i].tolist()} belongs to no element")
    return Neighbours(across, owner, corner)


@inner_kernel
def _keys(nodes, left_out):
    """Lowest and highest node and the sum of nodes, the corner ``left_out`` (-1: none) apart."""
    low, high, total = 2**62, -1, 0
    for k in range(len(nodes)):
        if k != left_out:
            v = nodes[k]
            low, high, total = min(low, v), max(high, v), total + v
    return low, high, total


@kernel
def find_neighbours(elements, facets, start, codes, highs, sums, across, owner, corner):
    """Fill ``across``, ``owner`` and ``corner``, which come as -1; ``start`` comes as 0, the others uninitialised."""
    n, k = elements.shape
    # facets, as element * corners + corner, by lowest node: those of node i in start[i] .. start[i + 1]
    for e in range(n):
        for c in range(k):
            low, high, total = _keys(elements[e], c)
            start[low + 1] += 1
    for i in range(len(start) - 1):
        start[i + 1] += start[i]
    for e in range(n):
        for c in range(k):
            low, high, total = _keys(elements[e], c)
            at = start[low]
            codes[at], highs[at], sums[at] = e * k + c, high, total
            start[low] = at + 1
    for i in range(len(start) - 1, 0, -1):
        start[i] = start[i - 1]
    start[0] = 0
    for i in range(len(start) - 1):
        for a in range(start[i], start[i + 1]):
            for b in range(a + 1, start[i + 1]):
                if highs[a] == highs[b] and sums[a] == sums[b]:
                    across[codes[a] // k, codes[a] % k] = codes[b] // k
                    across[codes[b] // k, codes[b] % k] = codes[a] // k
    for f in range(len(facets)):
        low, high, total = _keys(facets[f], -1)
        for a in range(start[low], start[low + 1]):
            if owner[f] < 0 and highs[a] == high and sums[a] == total:
                owner[f] = codes[a] // k
                corner[f] = codes[a] % k


#: relative difference of loads that agree; those of the result are exact to rounding
_LOADS_AGREE = 1e-6
#: of A u, over the diagonal times u: bodies that their supports move strain no element
_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class Posed:
    """A result with the problem, mesh and matrix it belongs to."""

    problem: ContactProblem
    mesh: MeshArrays
    discrete: DiscreteProblem
    result: Result

    @cached_property
    def stress(self) -> ElementStress:
        """Stress on each element."""
        data = self.result.stress_data
        if data is None:
            data = StressData.of(self.mesh, self.problem.material, self.problem.loads)
        return element_stress(self.mesh, self.result.displacement, data)

    @cached_property
    def neighbours(self) -> Neighbours:
        """Neighbours in the mesh."""
        return neighbours(self.mesh)

    @cached_property
    def young(self) -> np.ndarray:
        """Young's modulus of each element (n_elements,), Pa."""
        of_bodies = np.array([one.young for one in body_materials(self.mesh, self.problem.material)])
        return of_bodies[self.mesh.element_body]

    @cached_property
    def norm(self) -> float:
        """||u_h||_A, sqrt(N m): of displacements, prescribed ones included."""
        return energy_norm(*self._moved)

    @cached_property
    def _moved(self) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns and the forces A u (n_dofs,), between bodies relative."""
        unknowns = self.discrete.relative(self.result.displacement).reshape(-1)
        return unknowns, self.discrete.matrix @ unknowns

    def check_loads(self) -> None:
        """ValueError unless the loads of the problem are those of the result, b = A u - reactions - contact forces."""
        unknowns, forces = self._moved
        exerted = np.asarray(self.result.reaction, dtype=np.float64).reshape(-1)
        if exerted.shape != forces.shape:
            raise ValueError(f"result.reaction must have {forces.size} components, got {exerted.shape}")
        load = forces - self.discrete.relative_forces(exerted)
        rounding = _ROUNDING * euclidean_norm(self.discrete.matrix.diagonal() * unknowns)
        allowed = max(_LOADS_AGREE * max(euclidean_norm(forces), euclidean_norm(load)), rounding)
        if euclidean_norm(load - self.discrete.load) <= allowed:
            return
        posed = self.discrete.relative_forces(load_vector(self.mesh, self.problem.loads, self.problem.material))
        if not euclidean_norm(load - posed) <= allowed:
            raise ValueError("result has other loads than those of hierarchy.problem: for step k of a load path give "
                             "dataclasses.replace(hierarchy, problem=adaptmg.problem.step_problem(problem, factors))")


def posed(hierarchy: Hierarchy, result: Result) -> Posed:
    """A result on the finest mesh of a hierarchy, checked to belong to it."""
    checks.instance("hierarchy", hierarchy, Hierarchy, "a Hierarchy")
    checks.instance("result", result, Result, "a Result")
    if hierarchy.problem is None or not hasattr(hierarchy.finest, "mesh"):
        raise ValueError("hierarchy has no ContactProblem or no mesh (it comes from matrices): make it by "
                         "Hierarchy.uniform, graded or from_meshes")
    mesh, discrete, own = hierarchy.finest.mesh, hierarchy.finest.discrete, result.mesh
    if own is not mesh and not (np.array_equal(own.elements, mesh.elements)
                                and np.array_equal(own.points, mesh.points)):
        raise ValueError(f"result is of another mesh ({own.n_nodes} nodes) than the finest of hierarchy "
                         f"({mesh.n_nodes} nodes): give the hierarchy it was solved on, or hierarchy.truncated(...)")
    if not np.isfinite(result.displacement).all():
        i = int(np.argmin(np.isfinite(result.displacement).all(axis=1)))
        raise ValueError(f"result.displacement must be finite, got {result.displacement[i]} at node {i}: the solver "
                         f"ended with {result.status.name}")
    this = Posed(hierarchy.problem, mesh, discrete, result)
    this.check_loads()
    return this


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
    on_slave = contact.on_slaves(mesh)
    return {name: _on_surface(mesh, contact, name, on_slave, axisymmetric)
            for name in dict.fromkeys([*contact.names, *filter(None, contact.masters)])}


def _on_surface(mesh: MeshArrays, contact: ContactResult, name: str, on_slave: np.ndarray, axisymmetric: bool
                ) -> SurfaceTraction:
    surface = mesh.surface(name)
    nodes, mass = surface.nodes, surface.lumped(axisymmetric)[surface.nodes]
    force, filled = np.zeros((len(nodes), mesh.dim)), np.zeros(len(nodes), dtype=bool)
    for k, (slave, master) in enumerate(zip(contact.names, contact.masters, strict=True)):
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
        _continue(contact, surface, filled, values)
    return SurfaceTraction(surface.facets, nodes, values)


def _continue(contact: ContactResult, surface: Surface, filled: np.ndarray, values: np.ndarray) -> None:
    """Fill ``values`` in at nodes that belong to another contact boundary; elsewhere nothing touches."""
    nodes, place = surface.nodes, np.searchsorted(surface.nodes, surface.facets)
    for i in np.flatnonzero(~filled & np.isin(nodes, contact.node)):
        here = (place == i).any(axis=1)
        normal = surface.vectors[here].sum(axis=0)
        j = int(np.argmax(contact.node == nodes[i]))
        if normal @ contact.normal[j] > _STRAIGHT * np.linalg.norm(normal):
            values[i] = contact.force[j] / contact.weights[j]
        else:
            near = np.unique(place[here])
            near = near[filled[near]]
            if len(near):
                values[i] = values[near].mean(axis=0)
