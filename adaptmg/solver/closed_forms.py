r"""A second opinion on matrix, load and result, which shares no product with the assembly.

A field that is affine in space, :math:`u = G x + c` with any G and c, has constant stresses
:math:`\sigma` and, where springs act, linear ones on the boundary. The stiffness matrix of any
mesh of linear elements must turn it into the nodal forces

.. math:: f_i = \int_\Gamma \varphi_i \,\sigma n + \int_\Gamma \varphi_i\,(k_n u_n n + k_t u_t)

and nothing inside: rigid motions are among these fields. Loads must have on each body the resultant
and the moment of what is posed. Both are integrated here in closed form from facets and elements;
isotropic bodies and springs that are constant in space are covered by the first, others are left
out. The boundary mass of a contact node must be that of its facets, or less where these have no
partner opposite. The certificate shows this as 'stiffness', 'loads' and 'measures'.

Of a displacement it shows the equilibrium of each body, 'bodies', where a body is what its elements
hang together. On it act the loads, the springs by their own integrals, the contact forces that are
claimed, what ties and periodic sides transmit, and the reactions of supports. What a pair or a tie
exerts on the one side it takes from the other: the opposite forces act on the master at the same
places, whatever the coupling makes of them, so that a force at a wrong node or of another size
unbalances it. Moments count, too, except on the master of surfaces that are not plane (there they
meet at chords) or are coupled node by node; in axisymmetry the axial force alone. Reactions and
what ties transmit are nodal forces of the matrix: these must be, at all nodes that supports, ties
or contact hold, those of the stresses of the linear elements there, 'stresses',

.. math:: f_i = \sum_e V_e\, \sigma_e \nabla\varphi_i .
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import cast

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.coordinates import Coupling
from adaptmg.discrete.elasticity import nodes_of_pieces
from adaptmg.discrete.loads import body_elements, load_vector, spring_elements
from adaptmg.discrete.moduli import (
    Moduli,
    as_tensors,
    moduli,
    strain_columns,
)
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.problem import DiscreteProblem, remembered
from adaptmg.discrete.supports import node_at
from adaptmg.mesh.arrays import MeshArrays, Surface, element_facets, mask_of, signed_measures
from adaptmg.problem.laws import Axisymmetric, Elastic
from adaptmg.problem.loads import (
    BodyForce,
    InitialStrain,
    PointForce,
    PointSpring,
    Preload,
    Pressure,
    Spring,
    Traction,
)
from adaptmg.problem.surfaces import ContactPair, Periodic
from adaptmg.solver.certificate import Condition, Evidence, any_component

#: share of its boundary mass that a contact node may miss by rounding, and that a facet may miss at
#: one corner while the others miss what rounding hides; 75 pairs of bodies miss at most 7e-16 with
#: a hundredth, a tenth, half, twice, ten and a hundred times these, too
_SLIVER = 1e-3

#: relative deviation above which matrix or load is wrong, whatever the tolerance: rounding leaves at most
#: 1.7e-13 on the default meshes of the 12 cases that are covered; one hundredth of one entry at a wrong place, on a
#: mesh of 72 nodes, leaves 8e-3
ALLOWED = 1e-7

Blocks = tuple[np.ndarray, np.ndarray]  # nodes (n, k), stiffness (n, k, k, dim, dim), N/m


def _condition(
    name: str, missed: np.ndarray, scale: float, rounding: float = 0.0, limit: float = ALLOWED
) -> Condition:
    """Return the line of a certificate on forces that are ``missed``, N, an array of any shape, over their
    scale, N (0: they are not divided); ``limit`` is the largest ratio that passes (0: the tolerance
    decides)."""
    total = float(np.linalg.norm(missed))
    largest = float(np.abs(missed).max(initial=0.0))
    scale = scale or 1.0
    return Condition(
        name,
        largest=largest,
        total=total,
        unit="N",
        relative=total / scale,
        rounding=float(rounding / scale),
        limit=limit,
    )


def _stiffness(
    posed: Posed, discrete: DiscreteProblem, points: np.ndarray
) -> tuple[Condition, ...]:
    """Return the line that compares the forces of an affine field with those of its stresses and of
    springs, nothing for problems that the closed forms do not cover. ``points`` (n_nodes, dim), m, count
    from the middle of the mesh."""
    problem = posed.problem
    mesh = posed.mesh
    materials = posed.materials
    springs = [support for support in problem.supports if isinstance(support, Spring)]
    # _stress takes isotropic materials whose Lame constant is finite; next to volumes the stored matrix lacks
    # a part of the stiffness; in axisymmetry an affine field has other stresses
    covered = (
        all(elastic.anisotropy is None and np.isfinite(elastic.lame) for elastic in materials)
        and not any(isinstance(support, PointSpring) for support in problem.supports)
        and all(_numbers(spring.normal, spring.tangential) is not None for spring in springs)
        and not len(discrete.volumes)
        and not isinstance(materials[0], Axisymmetric)
    )
    # None also where unlike materials share nodes
    kinds = _kinds_of_nodes(mesh, materials) if covered else None
    if kinds is None:
        return ()
    # the forces of the matrix for a random affine field
    rng = np.random.default_rng(0)
    gradient = rng.uniform(-1.0, 1.0, (mesh.dim, mesh.dim)) / mesh.sides.max()
    shift = rng.uniform(-1.0, 1.0, mesh.dim)
    field = points @ gradient.T + shift
    unknowns = np.asarray(discrete.relative(field)).reshape(-1)
    forces = discrete.physical_forces(discrete.rows.times(unknowns)).reshape(field.shape)
    # f_i: phi_i sigma n, a dim-th of each facet to a corner, and phi_i (k_n u_n n + k_t u_t)
    expected = np.zeros_like(field)
    strain = 0.5 * (gradient + gradient.T)
    stresses = np.stack([_stress(elastic, strain) for elastic in materials])[
        kinds[mesh.facets[:, 0]]
    ]
    vectors = Surface(mesh.points, mesh.facets).vectors
    share = np.einsum("fij,fj->fi", stresses, vectors) / mesh.dim
    _add_at(expected, mesh.facets, np.broadcast_to(share[:, None], (*mesh.facets.shape, mesh.dim)))
    for spring in springs:
        cells, blocks = _spring_blocks(mesh, spring, axisymmetric=False)
        _add_at(expected, cells, _spring_forces(cells, blocks, field))
    forces -= expected
    return (_condition("stiffness", forces, float(np.linalg.norm(expected))),)


def _add_at(result: np.ndarray, cells: np.ndarray, forces: np.ndarray) -> None:
    """Add forces (m, k, dim) at the nodes of cells (m, k) to ``result`` (n_nodes, dim): 60 000
    tetrahedra of 118 000 nodes take 1.9 ms, by numpy.add.at 17.5."""
    for direction, component in enumerate(result.T):
        component += np.bincount(cells.ravel(), forces[..., direction].ravel(), len(result))


def _kinds_of_nodes(mesh: MeshArrays, materials: tuple[Elastic, ...]) -> np.ndarray | None:
    """Return the material (n_nodes,) of the elements at each node, None if bodies of unlike
    materials share nodes: stresses jump there."""
    result = np.zeros(mesh.n_nodes, dtype=np.int64)
    if len(set(materials)) == 1:
        return result
    kinds = np.array([materials.index(elastic) for elastic in materials])[mesh.element_body, None]
    result[mesh.elements] = kinds
    return result if (result[mesh.elements] == kinds).all() else None


def _numbers(*values: checks.FieldLike) -> np.ndarray | None:
    """Return values that are constant in space; None if one of them is not."""
    constant = [value for value in values if not callable(value)]
    return np.array(constant, dtype=float) if len(constant) == len(values) else None


def _stress(material: Elastic, strain: np.ndarray) -> np.ndarray:
    """Return lambda tr(strain) I + 2 mu strain (dim, dim), Pa, of an isotropic material."""
    volume = np.trace(strain) * np.eye(len(strain))
    return material.lame * volume + 2 * material.shear_modulus * strain


def _spring_blocks(mesh: MeshArrays, spring: Spring | PointSpring, axisymmetric: bool) -> Blocks:
    """Return the nodes that springs join and their stiffness: where it is constant in space from
    the mass matrix of a facet with k corners, |F| (1 + delta_ab) / (k (k + 1)); at points, in
    axisymmetry and where it varies as :func:`spring_elements`."""
    if isinstance(spring, PointSpring) or axisymmetric:
        return spring_elements(mesh, spring, axisymmetric)
    stiffnesses = _numbers(spring.normal, spring.tangential)
    if stiffnesses is None:
        return spring_elements(mesh, spring, axisymmetric)
    normal, tangential = stiffnesses
    surface = mesh.surface(spring.place)
    corners = mesh.dim
    mass = (1 + np.eye(corners)) / (corners * (corners + 1))
    outer = surface.normals[:, :, None] * surface.normals[:, None, :]
    per_area = normal * outer + tangential * (np.eye(mesh.dim) - outer)
    per_area *= surface.measures[:, None, None]
    return surface.facets, mass[:, :, None, None] * per_area[:, None, None]


def _spring_forces(cells: np.ndarray, blocks: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """Return the forces (n, k, dim) that stretch springs by a displacement (n_nodes, dim), N."""
    return np.einsum("fabij,fbj->fai", blocks, displacement[cells])


def _acting(
    load: Pressure | Traction | BodyForce | PointForce,
    mesh: MeshArrays,
    materials: tuple[Elastic, ...],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return places (n, dim) and forces (n, dim), N, of a load, and a node of the body that each
    acts on: in closed form if it is constant in space, else at nodes, by the quadrature of the
    assembly."""
    if isinstance(load, PointForce):
        node = node_at(mesh, load.point, load.body)
        return np.array([load.point]), np.array([load.components]), np.array([node])
    pressed = isinstance(load, Pressure)
    values = _numbers(load.value) if pressed else _numbers(*load.components)
    if values is None or isinstance(materials[0], Axisymmetric):
        forces = load_vector(mesh, [load], materials).reshape(mesh.points.shape)
        return mesh.points, forces, np.arange(mesh.n_nodes)
    if isinstance(load, BodyForce):
        elements = slice(None) if load.body is None else body_elements(mesh, load.body)
        cells = mesh.elements[elements]
        measures = mesh.volumes[elements]
        density = values[None]
    else:
        surface = mesh.surface(load.boundary)
        cells = surface.facets
        measures = surface.measures
        density = -values * surface.normals if pressed else values[None]
    return mesh.points[cells].mean(axis=1), measures[:, None] * density, cells[:, 0]


def _loads(
    posed: Posed, discrete: DiscreteProblem, body: np.ndarray, points: np.ndarray
) -> tuple[Condition, ...]:
    """Return the line that compares the loads on each body with what is posed, nothing without loads;
    initial strains and bolts have no resultants. ``body`` (n_nodes,) is the number of the body of each
    node; ``points`` (n_nodes, dim), m, count from the middle of the mesh."""
    problem = posed.problem
    mesh = posed.mesh
    loads = [
        _acting(load, mesh, posed.materials)
        for load in problem.loads
        if not isinstance(load, InitialStrain | Preload)
    ]
    if not loads:
        return ()
    places, forces, nodes = map(np.concatenate, zip(*loads, strict=True))
    arm = float(mesh.sides.max())
    places = places - mesh.box.mean(axis=0)
    count = int(body.max()) + 1
    load_forces = discrete.physical_forces(discrete.load).reshape(-1, mesh.dim)
    loaded = np.flatnonzero(any_component(load_forces))
    carried = _resultants(points[loaded], load_forces[loaded], arm, body[loaded], count)
    missed = carried - _resultants(places, forces, arm, body[nodes], count)
    if problem.axisymmetric:
        missed = missed[:, 1]  # the axial force alone: radial forces cancel round the axis
    return (_condition("loads", missed, float(np.abs(forces).sum())),)


def _resultants(
    places: np.ndarray, forces: np.ndarray, arm: float, body: np.ndarray, count: int
) -> np.ndarray:
    """Return the forces and the moments over ``arm`` (count, k), N, of forces (n, dim) at places (n, dim),
    m, on each of ``count`` bodies, whose numbers ``body`` (n,) holds: in space the moments about z, -y
    and x, in this order."""
    # x_i f_j - x_j f_i for i < j, over the arm
    arms = places.T / arm
    axes = combinations(range(len(arms)), 2)
    moments = [arms[i] * forces[:, j] - arms[j] * forces[:, i] for i, j in axes]
    columns = [*forces.T, *moments]
    return np.stack([np.bincount(body, column, minlength=count) for column in columns], axis=1)


@dataclass(frozen=True, eq=False)
class FreeBodies:
    """Properties of the bodies of a problem that are known before it is solved."""

    points: np.ndarray  # (n_nodes, dim): m
    middle: np.ndarray  # (dim,): of the mesh, m
    arm: float  # that moments are divided by, m
    body: np.ndarray  # (n_nodes,) int
    springs: list[Blocks]
    #: for each contact boundary, then each tie, the body of the master, -1 without one, and the
    #: vector (dim,) from places on the slave to those on the master, m, where it is known
    masters: list[tuple[int, np.ndarray | None]]
    #: (n_bodies, k) bool: which resultants are compared, the dim forces and then the moments. The
    #: number of a piece that is joined to another body has no nodes
    compared: np.ndarray
    axisymmetric: bool
    near: Elements | None  # linear elements at nodes that supports, ties or contact hold
    known: tuple[Condition, ...]  # that do not depend on the displacement

    @classmethod
    def of(cls, posed: Posed, discrete: DiscreteProblem) -> FreeBodies:
        """Return those of a discretised problem."""
        problem = posed.problem
        mesh = posed.mesh
        # contacts, then ties, as in the lists of the problem
        contact = discrete.contact
        slaves_and_masters = [
            *zip(contact.names, contact.masters, strict=True),
            *((slave, master) for slave, master, *_ in discrete.ties),
        ]
        body = _joined_pieces(mesh, [master for _, master in slaves_and_masters if master])
        n_bodies = int(body.max()) + 1
        compared = np.ones((n_bodies, mesh.dim * (mesh.dim + 1) // 2), dtype=bool)
        if problem.axisymmetric:
            compared[:] = np.arange(3) == 1  # the axial force alone
        masters: list[tuple[int, np.ndarray | None]] = []
        for condition, (slave, master) in zip(
            (*problem.contact, *problem.ties), slaves_and_masters, strict=True
        ):
            if not master:
                masters.append((-1, None))
                continue
            number = int(body[mesh.boundary_nodes(master)[0]])
            shift = _shift(condition, mesh, slave, master)
            masters.append((number, shift))
            if shift is None:
                compared[number, mesh.dim :] = False  # no moments
        springs = [
            support for support in problem.supports if isinstance(support, Spring | PointSpring)
        ]
        middle = mesh.box.mean(axis=0)
        points = mesh.points - middle
        return cls(
            points=mesh.points,
            middle=middle,
            arm=float(mesh.sides.max()),
            body=body,
            springs=[_spring_blocks(mesh, spring, problem.axisymmetric) for spring in springs],
            masters=masters,
            compared=compared,
            axisymmetric=problem.axisymmetric,
            near=_near(posed, discrete) if problem.elements == "linear" else None,
            known=(
                *_stiffness(posed, discrete, points),
                *_loads(posed, discrete, body, points),
                _measures(posed, discrete),
            ),
        )

    def __call__(self, evidence: Evidence) -> tuple[Condition, ...]:
        """Return 'stiffness', 'loads', 'measures', 'bodies' and 'stresses' of a displacement, as far
        as they cover the problem."""
        spring_forces = np.zeros(self.points.shape)
        for cells, blocks in self.springs:
            _add_at(spring_forces, cells, _spring_forces(cells, blocks, evidence.u))
        missed = self._missed(evidence, spring_forces)
        # resultants, over the sum of all forces; over infinity where all forces are rounding
        scale = np.inf if evidence.idle else evidence.total
        # |sum of n numbers| <= sqrt(n) times their Euclidean norm
        rounding = evidence.rounding * np.sqrt(len(self.points))
        bodies = _condition("bodies", missed, scale, rounding, limit=0.0)
        if self.near is None:
            return *self.known, bodies
        missed = self._missed_stresses(evidence, spring_forces, self.near)
        scale = np.inf if evidence.idle else evidence.force
        return *self.known, bodies, _condition("stresses", missed, scale, evidence.rounding)

    def _missed_stresses(
        self, evidence: Evidence, spring_forces: np.ndarray, near: Elements
    ) -> np.ndarray:
        """Return the forces of stresses and springs (``spring_forces`` (n_nodes, dim)) minus those of the
        matrix at the n nodes that are held, (n, dim) or in axisymmetry (n,), N. Those of the matrix, A u,
        are the load minus what the equations leave."""
        discrete = evidence.problem
        # V sigma grad phi_i of the elements
        internal = spring_forces.copy()
        _add_at(internal, near.cells, near.forces(evidence.u))
        of_matrix = discrete.physical_forces(discrete.load - evidence.residual)
        missed = internal[near.nodes] - of_matrix.reshape(internal.shape)[near.nodes]
        # in axisymmetry only axial forces agree: radial ones contain the hoop stress, which varies within
        # elements, while ``near`` has that of the centroid
        return missed[:, 1] if self.axisymmetric else missed

    def _missed(self, evidence: Evidence, spring_forces: np.ndarray) -> np.ndarray:
        """Return the forces and moments (n_bodies, k), N, that do not balance: on each body the load,
        minus the forces of springs, plus those of supports, plus those of contacts and ties on its
        slave surfaces, minus those on slaves whose master lies on the body."""
        discrete = evidence.problem
        shape = self.points.shape
        # contact forces on slave nodes, without the friction along directions that supports hold there: it
        # stays in ``borne``, and so does the opposite friction, which loads master nodes that are held along
        # the same directions, not the places opposite to the slave nodes
        claimed = np.zeros(shape)
        claimed[discrete.contact.nodes] = evidence.claimed
        claimed = discrete.free_part(claimed)
        # supports bear A u - b without ties and contact, whose forces in relative coordinates act on slave
        # nodes alone; ``borne`` (n_dofs,) acts on the bodies
        borne = discrete.physical_forces(-evidence.residual - evidence.tying - claimed)
        held = discrete.supported_part(borne.reshape(shape))
        on_slaves = [
            *_contact_forces(discrete, claimed.reshape(shape)),
            *_tie_forces(discrete, evidence.tying.reshape(shape)),
        ]
        load = discrete.physical_forces(discrete.load).reshape(shape)
        total = self._resultants(sum(on_slaves, load + held - spring_forces), self.body)
        # a master takes the opposite forces, at the same places
        for forces, (master, shift) in zip(on_slaves, self.masters, strict=True):
            if master >= 0:
                total -= self._resultants(forces, np.full(len(self.body), master), shift)
        return np.where(self.compared, total, 0.0)

    def _resultants(
        self, forces: np.ndarray, body: np.ndarray, shift: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the resultants and moments (n_bodies, k), N, of nodal forces (n_nodes, dim), which
        act at the nodes moved by ``shift`` (dim,), m."""
        loaded = np.flatnonzero(any_component(forces))
        places = (self.points[loaded] - self.middle) + (0.0 if shift is None else shift)
        return _resultants(places, forces[loaded], self.arm, body[loaded], len(self.compared))


def _joined_pieces(mesh: MeshArrays, masters: list[str]) -> np.ndarray:
    """Return the number of the body of each node (n_nodes,): connected pieces of the mesh, but one body
    of those that a master joins, since what it transmits is not known piece by piece."""
    body = np.zeros(mesh.n_nodes, dtype=np.int64)
    for number, piece in enumerate(nodes_of_pieces(mesh)):
        body[piece] = number
    for master in masters:
        touched = np.unique(body[mesh.boundary_nodes(master)])
        body[np.isin(body, touched)] = touched[0]
    return body


def _contact_forces(discrete: DiscreteProblem, claimed: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the forces (n_nodes, dim) on the slave of each contact boundary: ``claimed`` (n_nodes,
    dim) at its contact nodes, with their shares at nodes of which these take over a part."""
    contact = discrete.contact
    for k in range(len(contact.names)):
        on_boundary = contact.boundary == k
        nodes = contact.nodes[on_boundary]
        forces = np.zeros(claimed.shape)
        forces[nodes] = claimed[nodes]
        if contact.taken_over.shape[1]:
            forces += contact.taken_over[on_boundary].T @ claimed[nodes]
        yield forces


def _tie_forces(discrete: DiscreteProblem, tying: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the forces (n_nodes, dim), N, on the slave of each tie: ``tying`` (n_nodes, dim) at its tied
    nodes, with their shares at other nodes of the slave boundary, of which they take over a part. W, the
    weights of :class:`Coupling`, is minus the share there; its columns on the master are left out, as
    the opposite force acts there."""
    for _, _, nodes, slave_nodes in discrete.ties:
        weights = sparse.csr_array(cast("Coupling", discrete.coupling).weights[nodes])
        forces = np.zeros(tying.shape)
        forces[nodes] = tying[nodes]
        forces[slave_nodes] -= weights[:, slave_nodes].T @ tying[nodes]
        yield forces


def free_bodies(posed: Posed | None, discrete: DiscreteProblem) -> FreeBodies | None:
    """Return the bodies of a discretised problem, None of one without a mesh."""
    return None if posed is None else _free_bodies(discrete, posed)


@remembered
def _free_bodies(discrete: DiscreteProblem, posed: Posed) -> FreeBodies:
    return FreeBodies.of(posed, discrete)


def _shift(condition: object, mesh: MeshArrays, slave: str, master: str) -> np.ndarray | None:
    """Return the vector (dim,), m, from a plane slave surface to its master in a contact or tie
    ``condition``, of periodic sides between their middles; None where the opposite forces do not act along
    the normals from the slave nodes: at surfaces that are not plane, or coupled node by node."""
    slave_points, master_points = (
        mesh.points[mesh.boundary_nodes(name)] for name in (slave, master)
    )
    if isinstance(condition, Periodic):
        return 0.5 * (
            master_points.max(axis=0)
            + master_points.min(axis=0)
            - slave_points.max(axis=0)
            - slave_points.min(axis=0)
        )
    normal = mesh.surface(slave).normals[0]
    heights = max(np.ptp(side @ normal) for side in (slave_points, master_points))
    by_node = isinstance(condition, ContactPair) and condition.coupling == "nodes"
    if by_node or heights > checks.ALIKE * mesh.sides.max():
        return None
    return ((master_points[0] - slave_points[0]) @ normal) * normal


@dataclass(frozen=True, eq=False)
class Elements:
    """Linear elements, by their facets."""

    nodes: np.ndarray  # int: all elements around them are here
    cells: np.ndarray  # (n, dim + 1) int
    sides: np.ndarray  # (n, dim + 1, dim): measure times gradient of each shape function
    measures: np.ndarray  # (n,): m^2 or m^3
    moduli: Moduli  # of the elements: a tensor for each would take 288 bytes in space
    radii: np.ndarray | None  # (n,): in axisymmetry, m

    def forces(self, displacement: np.ndarray) -> np.ndarray:
        """Return the forces (n, dim + 1, dim) of the stresses of a displacement (n_nodes, dim), N."""
        moved = displacement[self.cells]
        dim = moved.shape[2]
        gradient = np.swapaxes(moved, 1, 2) @ self.sides / self.measures[:, None, None]
        strain = strain_columns(gradient)
        if self.radii is not None:
            # u_r / r at the centroid
            strain[:, 2] = moved[:, :, 0].mean(axis=1) / self.radii
        stress = as_tensors(self.moduli.stress(strain))
        forces = self.sides @ stress[:, :dim, :dim]
        if self.radii is not None:
            # the hoop stress works on u_r / r, a third of it at each corner; 2 pi r of the ring
            forces[:, :, 0] += (self.measures * stress[:, 2, 2] / (3 * self.radii))[:, None]
            forces *= 2 * np.pi * self.radii[:, None, None]
        return forces


def _near(posed: Posed, discrete: DiscreteProblem) -> Elements:
    """Return the linear elements at nodes that supports, ties or contact hold."""
    mesh = posed.mesh
    held = mask_of(discrete.fixed_nodes(), mesh.n_nodes)
    held[discrete.contact.nodes] = True
    # by corner: 26 us at 8192 triangles in place of 145
    elements = np.flatnonzero(held.take(mesh.elements.T).any(axis=0))
    cells = mesh.elements[elements]
    # measure times gradient of a shape function: minus the area vector of the facet opposite the
    # corner, over dim: 6 ms at 36k nodes in space, where blocks B'CB took 52
    facets = element_facets(cells).reshape(-1, mesh.dim)
    outward = Surface(mesh.points, facets).vectors.reshape(*cells.shape, mesh.dim)
    radii = mesh.points[cells, 0].mean(axis=1) if posed.problem.axisymmetric else None
    body_moduli = moduli(mesh, posed.materials)
    element_moduli = replace(body_moduli, rows=body_moduli.rows[elements])
    nodes = np.flatnonzero(held)
    return Elements(
        nodes=nodes,
        cells=cells,
        sides=-outward / mesh.dim,
        measures=signed_measures(mesh.points, cells),
        moduli=element_moduli,
        radii=radii,
    )


def _measures(posed: Posed, discrete: DiscreteProblem) -> Condition:
    """Return by how much boundary masses of contact nodes differ from those of their facets."""
    mesh = posed.mesh
    contact = discrete.contact
    deviation = np.zeros(len(contact))  # |1 - weight / mass of the facets|
    for k, (name, master) in enumerate(zip(contact.names, contact.masters, strict=True)):
        on_boundary = contact.boundary == k
        nodes = contact.nodes[on_boundary]
        surface = mesh.surface(name)
        shares = np.repeat(surface.measures[:, None] / mesh.dim, mesh.dim, axis=1)
        if posed.problem.axisymmetric:
            # 2 pi times the mean of r over the linear shape function: (2 r_i + r_j) / 3
            radii = mesh.points[surface.facets, 0]
            shares *= 2 * np.pi * (radii + radii.sum(axis=1, keepdims=True)) / 3
        mass = np.bincount(surface.facets.ravel(), shares.ravel(), mesh.n_nodes)
        lacking = 1 - contact.weights[on_boundary] / mass[nodes]
        deviation[on_boundary] = np.abs(lacking)
        if master:
            # all corners of a facet without a partner opposite lack mass, which is right there. A
            # mass that is too large, or too small elsewhere by more than a sliver, counts
            full = mask_of(nodes[np.abs(lacking) <= ALLOWED], mesh.n_nodes)
            corners_without_partner = surface.facets[~full[surface.facets].any(axis=1)]
            too_light = (lacking > _SLIVER) & ~np.isin(nodes, corners_without_partner)
            deviation[on_boundary] *= (lacking < 0) | too_light
    largest = float(deviation.max(initial=0.0))
    return Condition(
        "measures",
        largest=largest,
        total=float(np.linalg.norm(deviation)),
        unit="",
        relative=largest,
        limit=ALLOWED,
    )
