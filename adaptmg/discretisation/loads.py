r"""The load vector: surface tractions, body forces and initial strains tested with the P1 shape functions.

.. math:: b_{i} = \int_\Omega f\,\varphi_i + \int_{\Gamma} g\,\varphi_i
   + \int_\Omega C \varepsilon_0 : \varepsilon(\varphi_i)

by quadrature of degree 2 on each element and facet, in axisymmetry, where all is weighted with :math:`2 \pi r`, of
degree 5: exact for data that are linear in position.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg.discretisation.body_materials import Materials, body_materials, is_axisymmetric
from adaptmg.discretisation.facets import area_vectors, named_facets
from adaptmg.discretisation.initial_strain import body_elements, initial_strain_load
from adaptmg.geometry.quadrature import (
    AXISYMMETRIC_DEGREE,
    PLAIN_DEGREE,
    quadrature_points,
    quadrature_rule,
)
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.problem.loads import BodyForce, InitialStrain, Load, Pressure, Traction

__all__ = ["load_density", "load_vector"]


def load_vector(mesh: MeshArrays, loads: Sequence[Load], material: Materials | None = None) -> np.ndarray:
    """Nodal forces of all loads.

    Parameters
    ----------
    mesh : MeshArrays
    loads : sequence of Pressure, Traction, BodyForce, InitialStrain
        Their functions of position are called once each, with all quadrature points (n, dim).
    material : Elastic or mapping, optional
        The same in all bodies, or body name -> Elastic. Axisymmetric materials weight all with 2 pi r; initial
        strains need the elastic constants. Without it the loads are Cartesian.

    Returns
    -------
    (n_dofs,) array
        N (plane: per metre of thickness; axisymmetric: of the full circumference); dual, dof = dim * node + component.

    Raises
    ------
    ValueError
        For a boundary or body the mesh does not have, components of the wrong number, data that are not finite, or an
        initial strain without ``material``.
    """
    axisymmetric = material is not None and is_axisymmetric(body_materials(mesh, material))
    result = np.zeros((mesh.n_nodes, mesh.dim))
    for load in loads:
        if isinstance(load, InitialStrain):
            if material is None:
                raise ValueError(f"the load of {load!r} depends on the elastic constants: give material")
            result += initial_strain_load(mesh, load, material)
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
