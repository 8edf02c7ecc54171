r"""The load vector: tractions, body forces and initial strains tested with the P1 shape functions.

.. math:: b_{i} = \int_\Omega f\,\varphi_i + \int_{\Gamma} g\,\varphi_i
   + \int_\Omega C \varepsilon_0 : \varepsilon(\varphi_i), \qquad \sigma = C (\varepsilon - \varepsilon_0)

by quadrature of degree 2 on each element and facet, in axisymmetry, where all is weighted with :math:`2 \pi r`, of
degree 5: exact for data that are linear in position. Initial (stress-free) strains have principal components along the
axes; the third one in two dimensions is through the thickness or, in axisymmetry, the hoop strain. It matters in plane
strain, where the total strain through the thickness is zero, and in axisymmetry; in plane stress the sheet follows it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg import _checks as checks
from adaptmg.discrete.elasticity import Materials, body_materials, is_axisymmetric, lame_constants
from adaptmg.discrete.facets import area_vectors, named_facets
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, PLAIN_DEGREE, quadrature_points, quadrature_rule
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.loads import BodyForce, InitialStrain, Load, Pressure, Traction
from adaptmg.problem.materials import Elastic, PlaneStress


def load_vector(mesh: MeshArrays, loads: Sequence[Load], material: Materials | None = None) -> np.ndarray:
    """Nodal forces (n_dofs,) of all loads; dual, dof = dim * node + component.

    N (plane: per metre of thickness; axisymmetric: of the full circumference). Functions of position are called once
    each, with all quadrature points (n, dim). Axisymmetric materials weight all with 2 pi r; initial strains need the
    elastic constants. ValueError for a boundary or body the mesh does not have, components of the wrong number, data
    that are not finite, or an initial strain without ``material``.
    """
    materials = None if material is None else body_materials(mesh, material)
    axisymmetric = materials is not None and is_axisymmetric(materials)
    result = np.zeros((mesh.n_nodes, mesh.dim))
    for load in loads:
        if isinstance(load, InitialStrain):
            if materials is None:
                raise ValueError(f"the load of {load!r} depends on the elastic constants: give material")
            result += initial_strain_load(mesh, load, materials)
        elif isinstance(load, BodyForce):
            here = slice(None) if load.body is None else body_elements(mesh, load.body)
            _add(result, mesh, mesh.elements[here], mesh.volumes[here], load, axisymmetric)
        else:
            cells = named_facets(mesh, load.boundary)
            vectors = area_vectors(mesh.points, cells)
            measures = np.linalg.norm(vectors, axis=1)
            _add(result, mesh, cells, measures, load, axisymmetric, vectors / measures[:, None])
    return result.reshape(-1)


def _add(result: np.ndarray, mesh: MeshArrays, cells: np.ndarray, measures: np.ndarray,
         load: BodyForce | Pressure | Traction, axisymmetric: bool, normals: np.ndarray | None = None) -> None:
    """Add the nodal forces of one load on ``cells`` to ``result`` (n_nodes, dim)."""
    rule, weights = quadrature_rule(cells.shape[1], AXISYMMETRIC_DEGREE if axisymmetric else PLAIN_DEGREE)
    points = quadrature_points(mesh.points, cells, rule)
    weights = measures[:, None] * weights
    if axisymmetric:
        weights = weights * (2 * np.pi * points[:, :, 0])
    nodal = np.einsum("cq,qk,cqd->ckd", weights, rule, load_density(load, points, normals), optimize=True)
    for d in range(mesh.dim):
        result[:, d] += np.bincount(cells.reshape(-1), weights=nodal[:, :, d].reshape(-1), minlength=len(result))


def load_density(load: BodyForce | Pressure | Traction, points: np.ndarray, normals: np.ndarray | None) -> np.ndarray:
    """Force per volume or area at points (n_cells, n_quadrature, dim), in the same shape."""
    shape, dim = points.shape[:2], points.shape[2]
    flat = points.reshape(-1, dim)
    if isinstance(load, Pressure):
        value = checks.field(f"pressure on {load.boundary!r}", load.value, flat).reshape(shape)
        return -value[:, :, None] * normals[:, None, :]
    if len(load.components) != dim:
        raise ValueError(f"{load!r} has {len(load.components)} components on a {dim}D mesh")
    return np.stack([checks.field(f"component {'xyz'[k]} of {type(load).__name__}", component, flat).reshape(shape)
                     for k, component in enumerate(load.components)], axis=-1)


def body_elements(mesh: MeshArrays, body: str) -> np.ndarray:
    """Ascending element numbers of a body; ValueError if it does not exist."""
    if body not in mesh.bodies:
        raise ValueError(f"body {body!r} does not exist; the bodies are {', '.join(mesh.bodies)}")
    return np.flatnonzero(mesh.element_body == mesh.bodies.index(body))


def mean_initial_strain(mesh: MeshArrays, loads: Sequence[Load], *, axisymmetric: bool = False) -> np.ndarray:
    """Mean of all initial strains on each element."""
    result = np.zeros((len(mesh.elements), 3))
    for load in loads:
        if isinstance(load, InitialStrain) and not any(map(callable, load.components)):
            _check_components(mesh, load)
            result[body_elements(mesh, load.body), :len(load.components)] += load.components
        elif isinstance(load, InitialStrain):
            elements, strain, weights, _ = _at_quadrature_points(mesh, load, axisymmetric)
            result[elements] += np.einsum("eq,eqd->ed", weights, strain) / weights.sum(axis=1)[:, None]
    return result


def initial_strain_load(mesh: MeshArrays, load: InitialStrain, materials: tuple[Elastic, ...]) -> np.ndarray:
    """Nodal forces (n_nodes, dim) of an initial strain."""
    axisymmetric = is_axisymmetric(materials)
    elements, strain, weights, rule = _at_quadrature_points(mesh, load, axisymmetric)
    k = mesh.bodies.index(load.body)
    if isinstance(materials[k], PlaneStress):
        strain[:, :, 2] = 0.0
    lame, shear = (constants[k] for constants in lame_constants(materials))
    stress = lame * strain.sum(axis=2)[:, :, None] + 2 * shear * strain
    cells, dim = mesh.elements[elements], mesh.dim
    corners = mesh.points[cells]
    gradients = np.linalg.inv(corners[:, 1:] - corners[:, :1])
    gradients = np.concatenate([-gradients.sum(axis=2, keepdims=True), gradients], axis=2)
    forces = np.einsum("edc,ed->ecd", gradients, np.einsum("eq,eqd->ed", weights, stress[:, :, :dim]))
    if axisymmetric:
        r = quadrature_points(mesh.points, cells, rule)[:, :, 0]
        forces[:, :, 0] += np.einsum("eq,qc->ec", weights * stress[:, :, 2] / r, rule)
    result = np.zeros(mesh.points.shape)
    for d in range(dim):
        result[:, d] = np.bincount(cells.reshape(-1), weights=forces[:, :, d].reshape(-1), minlength=mesh.n_nodes)
    return result


def _check_components(mesh: MeshArrays, load: InitialStrain) -> None:
    n = len(load.components)
    if n not in (mesh.dim, 3):
        raise ValueError(f"{load!r} has {n} components on a {mesh.dim}D mesh: "
                         + ("give 3" if mesh.dim == 3 else "give 2, or 3 with the one out of the plane"))


def _at_quadrature_points(mesh: MeshArrays, load: InitialStrain, axisymmetric: bool
                          ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Elements (n,), strain (n, n_quadrature, 3), quadrature weights (n, n_quadrature), barycentric points."""
    _check_components(mesh, load)
    elements = body_elements(mesh, load.body)
    rule, weights = quadrature_rule(mesh.dim + 1, AXISYMMETRIC_DEGREE if axisymmetric else PLAIN_DEGREE)
    points = quadrature_points(mesh.points, mesh.elements[elements], rule)
    strain = np.zeros((*points.shape[:2], 3))
    for d, component in enumerate(load.components):
        name = f"component {d + 1} of InitialStrain on {load.body!r}"
        strain[:, :, d] = checks.field(name, component, points.reshape(-1, mesh.dim)).reshape(points.shape[:2])
    measure = mesh.volumes[elements, None] * weights
    return elements, strain, 2 * np.pi * points[:, :, 0] * measure if axisymmetric else measure, rule
