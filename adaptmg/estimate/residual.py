r"""Residual: an estimate of the energy error from what the discrete solution leaves of the equations.

.. math:: \eta_T^2 = \frac1E \Big\{ h_T^2 \|f + \mathrm{div}\,\sigma_h\|^2 + \frac12 \sum_{\mathrm{interior}} h_F
   \|[\sigma_h n]\|^2 + \sum_{\mathrm{boundary}} h_F \|g + t_h - \sigma_h n\|^2 \Big\}
   + \int p_h (g_0 - u_n) + \int (\mu p_h |d_t| + t_h \cdot d_t)

:math:`L^2` norms over element or facet, E Young's modulus of the element, so that all terms are energies; :math:`h_T`
the longest edge, :math:`h_F = |F|`, in space :math:`\sqrt{2|F|}`; :math:`t_h` the contact traction on slave and master,
nodal forces over lumped masses; springs add :math:`-k_n u_n n - k_t u_t` to g. In axisymmetry integrals are weighted
with :math:`2 \pi r`. The last two terms, on slaves alone, have linear interpolants of nodal pressures, gaps, limits and
slips: they vanish where the conditions hold all along an edge.

Measured, the estimate is 2 to 5 times the error, by problem and pattern of the mesh (the GRECO bar: 2.7 with
alternating diagonals and on bisected meshes, 3.0 to 3.2 on Netgen meshes, 3.3 to 3.7 with all diagonals alike), and
nearly constant on the meshes of one family; it is not proven to bound the error. Where body forces, or the hoop stress
of smooth axisymmetric fields, rule the error it is 5.7 to 8.8 times the error; where a contact zone between curved
bodies has one or two nodes up to 30 times, nearly all of it complementarity, until meshes resolve the zone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptmg._blas import one_blas_thread
from adaptmg._numba import kernel
from adaptmg.discrete.coordinates import from_frames
from adaptmg.discrete.loads import body_elements, foundation, load_density
from adaptmg.discrete.supports import boundary_supports
from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.stress_fields import ElementStress, Posed, contact_tractions, posed
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, PLAIN_DEGREE, quadrature_points, quadrature_rule
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import Surface
from adaptmg.problem.loads import BodyForce, Load, Pressure, Spring, Traction
from adaptmg.smoother.system import ContactState as State
from adaptmg.solver.result import Result


@dataclass(frozen=True)
class Residual:
    """The residual indicator; it has no parameters.

    Examples
    --------
    >>> problem = am.cases.greco_bar()
    >>> step = next(am.adapt(problem, am.mesh.structured(problem.domain, 2), indicator=am.Residual(), max_nodes=30))
    >>> step.estimate.squares.shape == (len(step.hierarchy.finest.mesh.elements),)
    True
    """

    @one_blas_thread()
    def indicate(self, hierarchy: Hierarchy, result: Result) -> Estimate:
        """Estimate the error on the finest mesh of a hierarchy, of a result of :func:`adaptmg.solve` on it.

        The terms of the estimate are "element residual", "jumps inside", "traction on boundaries", "traction in
        contact", "complementarity" and "friction"; squares of energies, N m (plane: per metre of thickness). TypeError
        or ValueError without problem, mesh or materials, for a result of another mesh, other loads, or not finite.
        """
        this = posed(hierarchy, result)
        volume = volume_squares(this.stress, this.problem.loads, this.young)
        free, touching = boundary_squares(this)
        complementarity, friction = condition_squares(this)
        jumps = jump_squares(this.stress, this.neighbours.across, this.young)
        parts = {"element residual": volume, "jumps inside": jumps, "traction on boundaries": free,
                 "traction in contact": touching, "complementarity": complementarity, "friction": friction}
        parts = {name: part for name, part in parts.items() if part is not None}
        return Estimate(squares=sum(parts.values()), norm=this.norm, indicator="residuals",
                        terms={name: part.sum() for name, part in parts.items()})


def _facet_weights(surface: Surface, axisymmetric: bool) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points (n_points, dim) and weights (n, n_points), m or m^2, exact for products of linear functions.
    In axisymmetry these products times 2 pi r."""
    rule, weights = quadrature_rule(surface.facets.shape[1], PLAIN_DEGREE)
    result = surface.measures[:, None] * weights
    if axisymmetric:
        result = result * (2 * np.pi * (surface.points[surface.facets, 0] @ rule.T))
    return rule, result


def boundary_squares(this: Posed) -> tuple[np.ndarray, np.ndarray]:
    """Squares (n_elements,) on boundaries without and on those with contact, N m."""
    mesh, stress, near = this.mesh, this.stress, this.neighbours
    touching = contact_tractions(mesh, this.result.contact, stress.axisymmetric)
    plain, contact = np.zeros(len(mesh.elements)), np.zeros(len(mesh.elements))
    outer = near.across[near.owner, near.corner] < 0
    supports = boundary_supports(mesh, this.problem.supports)
    for k, name in enumerate(mesh.boundaries):
        here = mesh.facet_labels == k
        outside = outer[here]
        if not outside.any():
            continue
        surface, elements = mesh.surface(name), near.owner[here]
        facets, normals = surface.facets, surface.normals
        rule, weights = _facet_weights(surface, stress.axisymmetric)
        residual = -stress.tractions(elements, normals, facets, rule)
        for load in this.problem.loads:
            if isinstance(load, Pressure | Traction) and load.boundary == name:
                residual += load_density(load, quadrature_points(mesh.points, facets, rule), normals)
        if name in touching:
            residual += np.einsum("qk,fkd->fqd", rule, touching[name].corners)
        # there a support bears any traction
        for spring in this.problem.supports:
            if isinstance(spring, Spring) and spring.boundary == name:
                stiffness = foundation(spring, quadrature_points(mesh.points, facets, rule), normals)
                residual -= np.einsum("fqij,qk,fkj->fqi", stiffness, rule, this.result.displacement[facets])
        for support in supports:
            if support.boundary == name:
                residual[:, :, [part is not None for part in support.components(mesh.dim)]] = 0.0
        sizes = surface.measures if mesh.dim == 2 else np.sqrt(2 * surface.measures)
        squares = sizes / this.young[elements] * np.einsum("fqd,fqd,fq->f", residual, residual, weights)
        into = contact if name in touching else plain
        into += np.bincount(elements, weights=np.where(outside, squares, 0.0), minlength=len(into))
    return plain, contact


#: slips up to this part of the largest displacement are rounding
_STILL = 1e-12


def condition_squares(this: Posed) -> tuple[np.ndarray, np.ndarray]:
    """Squares (n_elements,) from complementarity and from friction, N m. At the nodes the conditions are taken as met:
    no pressure where a node is OPEN, no gap elsewhere, friction at its limit against the slip where there is one. What
    a solver leaves of them is algebraic error; multiplied by a gap, or by a slip, far larger than the deformation it
    would exceed all that the mesh has left."""
    mesh, contact, near = this.mesh, this.result.contact, this.neighbours
    complementarity, friction = np.zeros(len(mesh.elements)), np.zeros(len(mesh.elements))
    opens = contact.state == State.OPEN
    pressures, gaps = contact.pressure, np.where(opens, np.maximum(contact.gap, 0.0), 0.0)
    limits, tractions = _friction(this, opens)
    slips = from_frames(contact.frames[:, 1:], contact.slip)
    for k, name in enumerate(contact.names):
        surface = mesh.surface(name)
        mine = np.flatnonzero(contact.boundary == k)
        # a node without a condition of this boundary adds nothing: the last entries
        index = np.full(mesh.n_nodes, len(mine))
        index[contact.node[mine]] = np.arange(len(mine))
        pressure, gap, limit, traction, slip = (
            _padded(values[mine])[index[surface.facets]] for values in (pressures, gaps, limits, tractions, slips))
        rule, weights = _facet_weights(surface, this.stress.axisymmetric)
        mass = np.einsum("fq,qi,qj->fij", weights, rule, rule)
        open_part = np.einsum("fij,fi,fj->f", mass, pressure, gap)
        slip_part = (np.einsum("fij,fi,fj->f", mass, limit, np.linalg.norm(slip, axis=2))
                     + np.einsum("fij,fid,fjd->f", mass, traction, slip))
        elements = near.owner[mesh.facet_labels == mesh.boundaries.index(name)]
        complementarity += np.bincount(elements, weights=open_part, minlength=len(complementarity))
        # below zero by rounding
        friction += np.bincount(elements, weights=np.maximum(slip_part, 0.0), minlength=len(friction))
    return complementarity, friction


def _friction(this: Posed, opens: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Limits (n,) of the friction and its tractions (n, dim), Cartesian, which obey the law for the slip, Pa."""
    contact, exchange = this.result.contact, this.discrete.exchange
    fixed, _ = this.discrete.law.bounds(len(contact))
    if exchange is not None:
        fixed = fixed / np.abs(exchange.sigma)
    limit, length = np.where(opens, fixed, contact.limit), np.linalg.norm(contact.slip, axis=1)
    moves = (contact.state != State.STICK) & (length > _STILL * np.abs(this.result.displacement).max(initial=0.0))
    along = np.where(moves[:, None], -contact.slip, contact.force_t)
    size = np.linalg.norm(along, axis=1)
    factor = np.divide(limit, size, out=np.zeros_like(size), where=size > 0)
    factor = np.where(moves, factor, np.minimum(factor, 1.0)) / contact.weights
    return limit / contact.weights, from_frames(contact.frames[:, 1:], factor[:, None] * along)


def _padded(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values, np.zeros((1, *values.shape[1:]))])


_GAUSS = 0.5 - 0.5 / math.sqrt(3.0)


@kernel
def _plane(points, elements, across, stress, weight, squares):
    """Add the jumps of the traction over facets in the plane to ``squares``; ``weight`` (n_elements,) is 1 / (2 E)."""
    for e in range(len(elements)):
        for k in range(3):
            f = across[e, k]
            if f > e:
                a, b = elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
                nx, ny = points[b, 1] - points[a, 1], points[a, 0] - points[b, 0]
                xx, yy, xy = (stress[e, 0] - stress[f, 0], stress[e, 1] - stress[f, 1], stress[e, 2] - stress[f, 2])
                tx, ty = xx * nx + xy * ny, xy * nx + yy * ny
                size = tx * tx + ty * ty
                squares[e] += weight[e] * size
                squares[f] += weight[f] * size


@kernel
def _jumps_axisymmetric(points, elements, across, radial, lame, stress, weight, squares):
    """As :func:`_plane`, with two Gauss points; ``radial`` (n_nodes,) is u_r, ``lame`` (n_elements,)."""
    for e in range(len(elements)):
        for k in range(3):
            f = across[e, k]
            if f > e:
                a, b = elements[e, (k + 1) % 3], elements[e, (k + 2) % 3]
                nx, ny = points[b, 1] - points[a, 1], points[a, 0] - points[b, 0]
                xx, yy, xy = (stress[e, 0] - stress[f, 0], stress[e, 1] - stress[f, 1], stress[e, 2] - stress[f, 2])
                tx, ty, change = xx * nx + xy * ny, xy * nx + yy * ny, lame[e] - lame[f]
                for share in (_GAUSS, 1.0 - _GAUSS):
                    r = share * points[a, 0] + (1.0 - share) * points[b, 0]
                    if r > 0.0:
                        more = change * (share * radial[a] + (1.0 - share) * radial[b]) / r
                        size = math.pi * r * ((tx + more * nx)**2 + (ty + more * ny)**2)
                        squares[e] += weight[e] * size
                        squares[f] += weight[f] * size


@kernel
def _solid(points, elements, across, stress, weight, squares):
    """As :func:`_plane`, in space."""
    local = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
    for e in range(len(elements)):
        for k in range(4):
            f = across[e, k]
            if f > e:
                a, b, c = elements[e, local[k, 0]], elements[e, local[k, 1]], elements[e, local[k, 2]]
                x1, y1, z1 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
                x2, y2, z2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
                nx, ny, nz = 0.5 * (y1 * z2 - z1 * y2), 0.5 * (z1 * x2 - x1 * z2), 0.5 * (x1 * y2 - y1 * x2)
                xx, yy, zz = (stress[e, 0] - stress[f, 0], stress[e, 1] - stress[f, 1], stress[e, 2] - stress[f, 2])
                xy, yz, xz = (stress[e, 3] - stress[f, 3], stress[e, 4] - stress[f, 4], stress[e, 5] - stress[f, 5])
                tx, ty, tz = (xx * nx + xy * ny + xz * nz, xy * nx + yy * ny + yz * nz, xz * nx + yz * ny + zz * nz)
                area = math.sqrt(nx * nx + ny * ny + nz * nz)
                size = math.sqrt(2.0 / area) * (tx * tx + ty * ty + tz * tz)
                squares[e] += weight[e] * size
                squares[f] += weight[f] * size


def jump_squares(stress: ElementStress, across: np.ndarray, young: np.ndarray) -> np.ndarray:
    """Squares (n_elements,), N m; half of each facet to each of its elements, with that element's modulus."""
    mesh, squares, weight = stress.mesh, np.zeros(len(stress.values)), 0.5 / young
    if stress.axisymmetric:
        radial = np.ascontiguousarray(stress.displacement[:, 0])
        _jumps_axisymmetric(mesh.points, mesh.elements, across, radial, stress.data.lame[mesh.element_body],
                            stress.values, weight, squares)
    else:
        jumps = _plane if mesh.dim == 2 else _solid
        jumps(mesh.points, mesh.elements, across, stress.values, weight, squares)
    return squares


@kernel
def _volume_axisymmetric(points, elements, u, body, lame, shear, initial, stress, force, rule, weights, squares):
    """Write the integrals (n_elements,) of |f + div sigma|^2 over the full circumference. The divergence is (d_r
    sigma_rr + (sigma_rr - sigma_tt) / r, d_z sigma_zz + sigma_rz / r), where sigma_rr and sigma_zz vary by lame times
    the hoop strain u_r / r. ``initial`` (n_elements or 0, 3): initial strains; ``stress`` (n_elements, 3): its last
    column is rz; ``force`` (n_elements or 0, n_points, 2): f at the points of ``rule``."""
    for e in range(len(elements)):
        a, b, c = elements[e, 0], elements[e, 1], elements[e, 2]
        x1, y1 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        x2, y2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
        det = x1 * y2 - y1 * x2
        first, second = u[b, 0] - u[a, 0], u[c, 0] - u[a, 0]
        along_r, along_z = (first * y2 - second * y1) / det, (second * x1 - first * x2) / det
        k = body[e]
        apart = initial[e, 0] - initial[e, 2] if len(initial) > 0 else 0.0
        axial = lame[k] * along_z + stress[e, 2]
        total = 0.0
        for q in range(len(weights)):
            r = rule[q, 0] * points[a, 0] + rule[q, 1] * points[b, 0] + rule[q, 2] * points[c, 0]
            hoop = (rule[q, 0] * u[a, 0] + rule[q, 1] * u[b, 0] + rule[q, 2] * u[c, 0]) / r
            # sigma_rr - sigma_tt = 2 mu times the difference of the elastic strains
            fr = (lame[k] * (along_r - hoop) + 2.0 * shear[k] * (along_r - hoop - apart)) / r
            fz = axial / r
            if len(force) > 0:
                fr += force[e, q, 0]
                fz += force[e, q, 1]
            total += weights[q] * r * (fr * fr + fz * fz)
        squares[e] = np.pi * det * total


def volume_squares(stress: ElementStress, loads: Sequence[Load], young: np.ndarray) -> np.ndarray | None:
    """Squares (n_elements,), N m; None where there is neither a body force nor axisymmetry."""
    forces = [load for load in loads if isinstance(load, BodyForce)]
    if not forces and not stress.axisymmetric:
        return None
    mesh, data = stress.mesh, stress.data
    rule, weights = quadrature_rule(mesh.dim + 1, AXISYMMETRIC_DEGREE if stress.axisymmetric else PLAIN_DEGREE)
    density = np.zeros((len(mesh.elements) if forces else 0, len(weights), mesh.dim))
    for load in forces:
        here = slice(None) if load.body is None else body_elements(mesh, load.body)
        density[here] += load_density(load, quadrature_points(mesh.points, mesh.elements[here], rule), None)
    if stress.axisymmetric:
        squares = np.empty(len(mesh.elements))
        _volume_axisymmetric(mesh.points, mesh.elements, stress.displacement, mesh.element_body, data.lame, data.shear,
                             data.initial_strain, stress.values, density, rule, weights, squares)
    else:
        squares = mesh.volumes * np.einsum("eqd,eqd,q->e", density, density, weights)
    return mesh.element_sizes**2 / young * squares
