r"""What a discrete problem must contain, by closed forms: a second opinion on matrix and load.

A field that is affine in space, :math:`u = G x + c` with any G and c, has constant stresses
:math:`\sigma` and, where springs act, linear ones on the boundary. The stiffness matrix of any
mesh of linear elements must turn it into the nodal forces

.. math:: f_i = \int_\Gamma \varphi_i \,\sigma n + \int_\Gamma \varphi_i\,(k_n u_n n + k_t u_t)

and nothing inside: rigid motions are among these fields. Loads must have the resultant and the
moment of what is posed. Both are integrated here in closed form from facets and elements, without
the assembly; isotropic bodies, springs and loads that are constant in space are covered, others
are left out. The certificate shows them as 'stiffness' and 'loads'.
"""

from __future__ import annotations

import numpy as np

from adaptmg._on_demand import remembered
from adaptmg.discrete.moduli import body_materials
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.mesh.arrays import MeshArrays, Surface
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.laws import Axisymmetric, Elastic
from adaptmg.problem.loads import (
    BodyForce,
    InitialStrain,
    PointForce,
    PointSpring,
    Pressure,
    Spring,
    Traction,
)
from adaptmg.problem.surfaces import Periodic
from adaptmg.solver.certificate import Condition

#: relative deviation above which matrix or load is wrong, whatever the tolerance: rounding leaves at most
#: 1.7e-13 on the default meshes of the 12 cases that are covered; one hundredth of one entry at a wrong place, on a
#: mesh of 72 nodes, leaves 8e-3
ALLOWED = 1e-7

Posed = tuple[ContactProblem, MeshArrays, DiscreteProblem]


def posed_conditions(
    problem: ContactProblem | None, mesh: MeshArrays | None, discrete: DiscreteProblem
) -> tuple[Condition, ...]:
    """Return 'stiffness' and 'loads' of a discretised problem, as far as closed forms cover it."""
    return () if problem is None or mesh is None else _conditions((problem, mesh, discrete))


def _both(posed: Posed) -> tuple[Condition, ...]:
    return (*_stiffness(*posed), *_loads(*posed))


#: once for each discrete problem
_conditions = remembered(_both, of=lambda posed: posed[2])


def _condition(name: str, missed: np.ndarray, size: float) -> Condition:
    total = float(np.linalg.norm(missed))
    largest = float(np.abs(missed).max(initial=0.0))
    return Condition(name, largest, total, "N", total / size if size > 0 else total, 0.0, ALLOWED)


def _stiffness(
    problem: ContactProblem, mesh: MeshArrays, discrete: DiscreteProblem
) -> tuple[Condition, ...]:
    materials = body_materials(mesh, problem.material)
    springs = [one for one in problem.supports if isinstance(one, Spring)]
    covered = (
        all(_is_isotropic(one) for one in materials)
        and not any(isinstance(one, PointSpring) for one in problem.supports)
        and all(_constant(one.normal, one.tangential) for one in springs)
        and not len(discrete.volumes)
        and discrete.inclined is None
        and not any(isinstance(one, Periodic) for one in problem.ties)
        and not isinstance(materials[0], Axisymmetric)
    )
    kinds = _kinds_of_nodes(mesh, materials) if covered else None
    if kinds is None:
        return ()
    rng = np.random.default_rng(0)
    gradient = rng.uniform(-1.0, 1.0, (mesh.dim, mesh.dim)) / mesh.sides.max()
    shift = rng.uniform(-1.0, 1.0, mesh.dim)
    field = (mesh.points - mesh.box.mean(axis=0)) @ gradient.T + shift
    unknowns = np.asarray(discrete.relative(field)).reshape(-1)
    forces = discrete.physical_forces(discrete.matrix @ unknowns).reshape(field.shape)
    expected = np.zeros_like(field)
    strain = 0.5 * (gradient + gradient.T)
    stresses = np.stack([_stress(one, strain) for one in materials])[kinds[mesh.facets[:, 0]]]
    vectors = Surface(mesh.points, mesh.facets).vectors
    share = np.einsum("fij,fj->fi", stresses, vectors) / mesh.dim
    for corner in mesh.facets.T:
        np.add.at(expected, corner, share)
    for spring in springs:
        _add_springs(expected, mesh, spring, field)
    return (_condition("stiffness", forces - expected, float(np.linalg.norm(expected))),)


def _is_isotropic(material: Elastic) -> bool:
    return material.anisotropy is None and np.isfinite(material.lame)


def _kinds_of_nodes(mesh: MeshArrays, materials: tuple[Elastic, ...]) -> np.ndarray | None:
    """Return the material (n_nodes,) of the elements at each node, None if bodies of unlike
    materials share nodes: stresses jump there."""
    result = np.zeros(mesh.n_nodes, dtype=np.int64)
    if len(set(materials)) == 1:
        return result
    kinds = np.array([materials.index(one) for one in materials])[mesh.element_body, None]
    result[mesh.elements] = kinds
    return result if (result[mesh.elements] == kinds).all() else None


def _constant(*values: object) -> bool:
    return not any(callable(value) for value in values)


def _stress(material: Elastic, strain: np.ndarray) -> np.ndarray:
    volume = np.trace(strain) * np.eye(len(strain))
    return material.lame * volume + 2 * material.shear_modulus * strain


def _add_springs(forces: np.ndarray, mesh: MeshArrays, spring: Spring, field: np.ndarray) -> None:
    """Add the nodal forces (n_nodes, dim) that springs exert on an affine field of displacement."""
    surface = mesh.surface(spring.boundary)
    corners = mesh.dim
    values = field[surface.facets]
    normals = surface.normals[:, None, :]
    along = np.einsum("fcd,fcd->fc", values, np.broadcast_to(normals, values.shape))
    normal = along[:, :, None] * normals
    tractions = spring.normal * normal + spring.tangential * (values - normal)
    # the mass matrix of a facet: |F| (1 + delta_ab) / (d (d + 1))
    mass = surface.measures / (corners * (corners + 1))
    nodal = mass[:, None, None] * (tractions + tractions.sum(axis=1, keepdims=True))
    np.add.at(forces, surface.facets, nodal)


def _loads(
    problem: ContactProblem, mesh: MeshArrays, discrete: DiscreteProblem
) -> tuple[Condition, ...]:
    loads = [one for one in problem.loads if not isinstance(one, InitialStrain)]
    acting = all(
        (isinstance(one, Pressure) and _constant(one.value))
        or (isinstance(one, Traction | BodyForce) and _constant(*one.components))
        or isinstance(one, PointForce)
        for one in loads
    )
    axisymmetric = isinstance(body_materials(mesh, problem.material)[0], Axisymmetric)
    if not acting or axisymmetric or len(discrete.volumes) or discrete.inclined is not None:
        return ()
    if not loads:
        return ()
    centre = mesh.box.mean(axis=0)
    arm = float(mesh.sides.max())
    places = []
    forces = []
    for load in loads:
        if isinstance(load, PointForce):
            places.append(np.array([load.point], dtype=float))
            forces.append(np.array([load.components], dtype=float))
            continue
        if isinstance(load, BodyForce):
            mine = np.arange(len(mesh.elements))
            if load.body is not None:
                mine = np.flatnonzero(mesh.element_body == mesh.bodies.index(load.body))
            places.append(mesh.points[mesh.elements[mine]].mean(axis=1))
            forces.append(mesh.volumes[mine, None] * np.array(load.components, dtype=float))
            continue
        surface = mesh.surface(load.boundary)
        places.append(mesh.points[surface.facets].mean(axis=1))
        if isinstance(load, Pressure):
            forces.append(-float(load.value) * surface.measures[:, None] * surface.normals)
        else:
            forces.append(surface.measures[:, None] * np.array(load.components, dtype=float))
    own = discrete.physical_forces(discrete.load).reshape(-1, mesh.dim)
    posed = _resultants(np.concatenate(places) - centre, np.concatenate(forces), arm)
    found = _resultants(mesh.points - centre, own, arm)
    size = float(np.abs(np.concatenate(forces)).sum())
    return (_condition("loads", found - posed, size),)


def _resultants(places: np.ndarray, forces: np.ndarray, arm: float) -> np.ndarray:
    """Return the force and the moment over ``arm``, N."""
    moments = places.T @ forces
    upper = np.triu_indices(places.shape[1], 1)
    total = np.ones(len(forces)) @ forces  # a tenth of the time of sum(axis=0)
    return np.concatenate([total, (moments - moments.T)[upper] / arm])
