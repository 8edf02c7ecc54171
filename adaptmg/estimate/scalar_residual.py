r"""Residual estimate of scalar problems between obstacles.

With the contact force :math:`\lambda_h` per area, linear between nodal forces over lumped masses,

.. math:: \eta_T^2 = \frac1k \Big\{ h_T^2 \|f + \nabla\cdot(k \nabla u_h) + \lambda_h\|^2 +
   \frac12 \sum_{\mathrm{interior}} h_F \|[k\,\partial_n u_h]\|^2 +
   \sum_{\mathrm{free}} h_F \|k\,\partial_n u_h\|^2 \Big\}
   + \int |\lambda_h|\, g_h + k \sum_e d_e^2 \|\nabla b_e\|^2

in the notation of :class:`adaptmg.Residual`; k is constant on an element, :math:`g_h` the linear
interpolant of the distances to the obstacle.

An element is in full contact if all its nodes lie on the same obstacle. The obstacle bears all that
presses on it: of f, and of the jumps of fluxes on facets between such elements, only the part that
pulls off the obstacle counts (A. Veeser, SIAM J. Numer. Anal. 39, 2001,
doi:10.1137/S0036142900370812). Otherwise an obstacle with a fold, whose contact force is a line
load, would have an estimate that falls too slowly.

The last term is the error of the obstacle: at the middle of edge e, :math:`d_e` is the distance
between solution and obstacle in full contact, elsewhere the depth by which the solution penetrates
the obstacle; :math:`b_e = 4 \varphi_i \varphi_j` is the quadratic bubble of the edge. Prescribed
values are those that the mesh interpolates.

D. Braess, C. Carstensen, R. H. W. Hoppe, Numer. Math. 107, 2007, doi:10.1007/s00211-007-0098-1,
prove convergence of an adaptive loop with such an estimate for affine obstacles."""

from __future__ import annotations

import numpy as np

from adaptmg import _checks as checks
from adaptmg.discrete.elasticity import shape_gradients
from adaptmg.discrete.scalar import ScalarProblem
from adaptmg.estimate.stress_fields import check_result, neighbours
from adaptmg.geometry.quadrature import integration
from adaptmg.level import Level
from adaptmg.mesh.arrays import MeshArrays, Surface, need_mesh
from adaptmg.solver.examine import energy_norm
from adaptmg.solver.result import Result

#: directions in which the lower and the upper obstacle press; arrays (2, ...) have these two rows
_PRESSING = np.array([[1.0], [-1.0]])


def scalar_squares(
    problem: ScalarProblem, level: Level, result: Result
) -> tuple[dict[str, np.ndarray], float]:
    """Return the parts of the squares (n_elements,) by name, and the energy norm of a result."""
    mesh = need_mesh(level)
    check_result(mesh, result)
    values = result.displacement[:, 0]
    forces = level.discrete.matrix @ values
    contact = result.contact
    # from the limits (2, n_nodes)
    distances = _PRESSING * (values - problem.limits_at(mesh.points))
    load = forces - result.reaction[:, 0]  # A u minus the forces of held nodes and of obstacles
    _check_same("loads", load - level.discrete.load, (forces, result.reaction))
    nearest = distances.min(axis=0)[contact.node]
    _check_same("limits", nearest - contact.gap, (values, contact.gap))
    # normals point into the obstacle, against its pressure
    pressures = np.zeros(distances.shape)
    pressures[:, contact.node] = contact.pressure * (contact.normal[:, 0] == -_PRESSING)
    # held nodes have no contact, but may lie on an obstacle. All of a body may lie on one at zero: then
    # the load gives the size of values
    discrete = level.discrete
    size = max(np.abs(values).max(), np.abs(discrete.load).sum() / discrete.matrix.diagonal().max())
    on_limit = discrete.fixed & (distances <= checks.ROUNDING * size)
    lower, upper = ((pressures > 0) | on_limit)[:, mesh.elements].all(axis=2).astype(int)
    full_contact = lower - upper  # 1 with the lower obstacle, -1 with the upper one, else 0
    equation, complementarity = _integrals(problem, mesh, distances, pressures, full_contact)
    slopes, _ = shape_gradients(mesh)
    k = problem.conductivity_on(mesh)
    flux = k[:, None] * np.einsum("ekd,ek->ed", slopes, values[mesh.elements])
    return {
        "element residual": mesh.element_sizes**2 / k * equation,
        "flux jumps": _flux_squares(mesh, flux, level.discrete.fixed, full_contact) / k,
        "complementarity": complementarity,
        "obstacle": k * _obstacle_squares(problem, mesh, values, slopes, full_contact),
    }, energy_norm(values, forces)


def _check_same(name: str, difference: np.ndarray, sizes: tuple[np.ndarray, np.ndarray]) -> None:
    """Raise ValueError unless a difference (n,) of ``name`` between result and problem is rounding, of
    two quantities with these ``sizes``, arrays."""
    allowed = checks.SIX_DIGITS * max(np.abs(part).max(initial=0.0) for part in sizes)
    if not (np.abs(difference) <= allowed).all():
        raise ValueError(
            f"result has other {name} than the problem of hierarchy: give the hierarchy it was solved on"
        )


def _integrals(
    problem: ScalarProblem,
    mesh: MeshArrays,
    distances: np.ndarray,
    pressures: np.ndarray,
    full_contact: np.ndarray,
) -> np.ndarray:
    """Return the integrals (2, n_elements) of the square of the residual of the equation, and those of
    contact force times distance, from the distances (2, n_nodes) to both obstacles and their
    pressures (2, n_nodes); ``full_contact`` (n_elements,) is 1 in full contact with the lower
    obstacle, -1 with the upper one, else 0."""
    rule, points, weights = integration(
        mesh.points, mesh.elements, mesh.volumes, axisymmetric=False
    )
    load = checks.field("load", problem.load, points.reshape(-1, mesh.dim)).reshape(weights.shape)
    force = pressures[:, mesh.elements] @ rule.T
    contact = full_contact[:, None]
    # f + lambda; in full contact the part of f that pulls off the obstacle
    residual = np.where(contact == 0, load + force[0] - force[1], np.maximum(contact * load, 0.0))
    # at each node one of pressure and distance is taken as zero: the error of the solver is not one of
    # the mesh
    is_apart = (pressures == 0) & np.isfinite(distances)
    gaps = np.where(is_apart, np.maximum(distances, 0.0), 0.0)[:, mesh.elements] @ rule.T
    return np.einsum("eq,neq->ne", weights, np.stack([residual**2, (force * gaps).sum(axis=0)]))


def _flux_squares(
    mesh: MeshArrays, flux: np.ndarray, fixed: np.ndarray, full_contact: np.ndarray
) -> np.ndarray:
    """Return h_F times the integrals (n_elements,) of the squares of the jumps of fluxes, half of each
    facet for each of its elements, and of the squares of fluxes through boundaries that are not
    ``fixed`` (n_nodes,); ``flux`` (n_elements, dim) is k grad u, ``full_contact`` as of
    :func:`_integrals`."""
    near = neighbours(mesh)
    free = near.outer & ~fixed[mesh.facets].all(axis=1)
    # the facets of free boundaries have the same element on both sides
    sides = np.hstack([near.pairs, np.tile(near.owner[free], (2, 1))])
    surface = Surface(mesh.points, np.vstack([near.facets, mesh.facets[free]]))
    leaving = np.vstack([flux[near.pairs[0]] - flux[near.pairs[1]], flux[near.owner[free]]])
    jump = np.einsum("fd,fd->f", surface.normals, leaving)
    # f + div(k grad u) has on a facet the part -jump; in full contact what of it pulls off the obstacle,
    # at free facets, too
    first, second = full_contact[sides]
    contact = np.where(first == second, first, 0)
    jump = np.where(contact == 0, jump, np.maximum(-contact * jump, 0.0))
    # h_F/2 |[k d_n u]|^2
    halves = 0.5 * surface.sizes * surface.measures * jump**2
    return np.bincount(sides.ravel(), np.tile(halves, 2), len(mesh.elements))


def _obstacle_squares(
    problem: ScalarProblem,
    mesh: MeshArrays,
    values: np.ndarray,
    slopes: np.ndarray,
    full_contact: np.ndarray,
) -> np.ndarray:
    """Return the sums (n_elements,) over edges of the squares of distances from the obstacle, times
    the integral of the square of the gradient of the edge's bubble; ``values`` (n_nodes,) are those of
    the solution, ``slopes`` (n_elements, dim + 1, dim) the gradients of the shape functions,
    ``full_contact`` as of :func:`_integrals`."""
    start, end = np.triu_indices(mesh.dim + 1, 1)
    edges = mesh.elements[:, np.stack([start, end])]
    middles = mesh.points[edges].mean(axis=1)
    limits = problem.limits_at(middles.reshape(-1, mesh.dim)).reshape(2, *middles.shape[:2])
    lower, upper = limits - values[edges].mean(axis=1)
    contact = full_contact[:, None]
    # in full contact with the lower or the upper obstacle its distance, elsewhere the depth in either
    depth = np.maximum(lower, 0.0) + np.minimum(upper, 0.0)
    distance = np.select([contact == 1, contact == -1], [lower, upper], depth)
    # int |grad b|^2 of b = 4 phi_i phi_j: 32 / ((d + 1) (d + 2)) |T| (s_i.s_i + s_j.s_j + s_i.s_j)
    products = slopes @ slopes.swapaxes(1, 2)
    integrals = products[:, start, start] + products[:, end, end] + products[:, start, end]
    factor = 32 / ((mesh.dim + 1) * (mesh.dim + 2)) * mesh.volumes
    return factor * np.einsum("em,em->e", integrals, distance**2)
