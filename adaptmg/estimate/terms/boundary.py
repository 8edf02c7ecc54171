r"""Traction defects on the boundary: what loads and contact exert, and the stress inside does not bear.

.. math:: \frac{h_F}{E} \int_F |g + t_h - \sigma_h n|^2, \qquad h_F = |F|,\ \text{in space } \sqrt{2 |F|}

with the load g, a function of position, and the contact traction :math:`t_h`
(:mod:`adaptmg.estimate.fields.contact_tractions`). Components that a support prescribes on the boundary of F are left
out: there the support bears whatever comes. Products of linear functions are integrated exactly, in axisymmetry with
the weight :math:`2 \pi r`.
"""

from __future__ import annotations

import numpy as np

from adaptmg.discretisation.facets import area_vectors
from adaptmg.discretisation.loads import load_density
from adaptmg.estimate.fields.contact_tractions import contact_tractions
from adaptmg.estimate.fields.posed import Posed
from adaptmg.geometry.quadrature import PLAIN_DEGREE, quadrature_points, quadrature_rule
from adaptmg.problem.loads import Pressure, Traction

__all__ = ["boundary_squares", "facet_weights"]


def facet_weights(points: np.ndarray, facets: np.ndarray, axisymmetric: bool) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points (n_points, dim) and weights (n, n_points), m or m^2, exact for products of linear functions.

    In axisymmetry these products times 2 pi r.
    """
    rule, weights = quadrature_rule(facets.shape[1], PLAIN_DEGREE)
    measure = np.linalg.norm(area_vectors(points, facets), axis=1)
    result = measure[:, None] * weights
    if axisymmetric:
        result = result * (2 * np.pi * (points[facets, 0] @ rule.T))
    return rule, result


def boundary_squares(this: Posed) -> tuple[np.ndarray, np.ndarray]:
    """Squares (n_elements,) on boundaries without and on those with contact, N m."""
    mesh, stress, beside = this.mesh, this.stress, this.neighbours
    touching = contact_tractions(mesh, this.result.contact, stress.axisymmetric)
    plain, contact = np.zeros(len(mesh.elements)), np.zeros(len(mesh.elements))
    outer = beside.across[beside.owner, beside.corner] < 0
    for k, name in enumerate(mesh.boundaries):
        here = mesh.facet_labels == k
        outside = outer[here]
        if not outside.any():
            continue
        facets, elements = mesh.facets[here], beside.owner[here]
        vectors = area_vectors(mesh.points, facets)
        measure = np.linalg.norm(vectors, axis=1)
        normals = vectors / measure[:, None]
        rule, weights = facet_weights(mesh.points, facets, stress.axisymmetric)
        defect = -stress.tractions(elements, normals, facets, rule)
        for load in this.problem.loads:
            if isinstance(load, Pressure | Traction) and load.boundary == name:
                defect += load_density(load, quadrature_points(mesh.points, facets, rule), normals)
        if name in touching:
            defect += np.einsum("qk,fkd->fqd", rule, touching[name].corners)
        defect[:, :, _held(this, name)] = 0.0
        sizes = measure if mesh.dim == 2 else np.sqrt(2 * measure)
        squares = sizes / this.young[elements] * np.einsum("fqd,fqd,fq->f", defect, defect, weights)
        into = contact if name in touching else plain
        into += np.bincount(elements, weights=np.where(outside, squares, 0.0), minlength=len(into))
    return plain, contact


def _held(this: Posed, boundary: str) -> np.ndarray:
    """Components (dim,), bool, that supports prescribe on a boundary."""
    held = np.zeros(this.mesh.dim, dtype=bool)
    for support in this.problem.supports:
        if support.boundary == boundary:
            held |= [component is not None for component in support.components(this.mesh.dim)]
    return held
