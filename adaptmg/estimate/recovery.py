r"""Recovery: an estimate of the energy error by a smoother stress (Zienkiewicz and Zhu).

.. math:: \eta_E^2 = \int_E (\sigma^* - \sigma_h) : C^{-1} (\sigma^* - \sigma_h)

with a stress :math:`\sigma^*` that is continuous and piecewise linear in each body: it may jump where materials meet
and between bodies in contact (:mod:`adaptmg.discrete.recovery`). Where the solution is smooth the estimate tends to the
error itself; it does not depend on loads and contact conditions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg._blas import one_blas_thread
from adaptmg._numba import inner_kernel, kernel
from adaptmg.discrete.recovery import recovered
from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.stress_fields import ElementStress, posed
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_rule
from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.result import Result


@dataclass(frozen=True)
class Recovery:
    """The recovery indicator; it has no parameters.

    Examples
    --------
    >>> problem = am.cases.greco_bar()
    >>> step = next(am.adapt(problem, am.mesh.structured(problem.domain, 2), indicator=am.Recovery(), max_nodes=30))
    >>> 0 < step.estimate.relative < 1
    True
    """

    @one_blas_thread()
    def indicate(self, hierarchy: Hierarchy, result: Result) -> Estimate:
        """Estimate the error on the finest mesh of a hierarchy, of a result of :func:`adaptmg.solve` on it.

        The terms of the estimate are the bodies by name; TypeError and ValueError as of
        :meth:`adaptmg.Residual.indicate`.
        """
        this = posed(hierarchy, result)
        squares = recovered_energy(this.stress, recovered_stress(this.stress))
        by_body = np.bincount(this.mesh.element_body, weights=squares, minlength=len(this.mesh.bodies))
        return Estimate(squares=squares, norm=this.norm, indicator="recovered stress",
                        terms=dict(zip(this.mesh.bodies, by_body, strict=True)))


@dataclass(frozen=True, eq=False)
class RecoveredStress:
    """A stress that is continuous in each body."""

    cells: np.ndarray  # (n_elements, dim + 1) int32: elements on nodes that no two bodies share
    nodal: np.ndarray  # (n, n_values), Pa
    sampled: np.ndarray  # (n_elements, n_values): the stress at the centroids, Pa


def recovered_stress(stress: ElementStress) -> RecoveredStress:
    """Fit a stress that is continuous in each body."""
    sampled = _sampled(stress)
    return RecoveredStress(*recovered(stress.mesh, sampled), sampled)


def _sampled(stress: ElementStress) -> np.ndarray:
    mesh, data, values, sampled = stress.mesh, stress.data, stress.values, np.empty((len(stress.values), 4))
    if not stress.axisymmetric:
        return values
    axisymmetric_stresses(mesh.points, mesh.elements, stress.displacement, mesh.element_body, data.lame, data.shear,
                          data.initial_strain, values, sampled)
    return sampled


def recovered_energy(stress: ElementStress, found: RecoveredStress) -> np.ndarray:
    """Energies (n_elements,) of the recovered stress minus that of the elements, N m."""
    mesh, data, squares = stress.mesh, stress.data, np.empty(len(found.cells))
    if stress.axisymmetric:
        rule, weights = quadrature_rule(3, AXISYMMETRIC_DEGREE)
        axisymmetric_energy(mesh.points, mesh.elements, found.cells, stress.displacement, mesh.volumes,
                            mesh.element_body, data.lame, data.shear, data.initial_strain, stress.values, found.nodal,
                            rule, weights, squares)
    else:
        difference_energy(found.cells, mesh.volumes, mesh.element_body, data.lame, data.shear, found.sampled,
                          found.nodal, squares)
    return squares


@inner_kernel
def _complementary(stress, dim, lame, shear):
    """sigma : C^-1 sigma of normal stresses, then shear stresses."""
    trace, total = 0.0, 0.0
    for d in range(dim):
        trace += stress[d]
        total += stress[d] * stress[d]
    for d in range(dim, len(stress)):
        total += 2.0 * stress[d] * stress[d]
    return (total - lame / (dim * lame + 2.0 * shear) * trace * trace) / (2.0 * shear)


@kernel
def difference_energy(elements, volumes, body, lame, shear, values, nodal, squares):
    """Write the energies (n_elements,) of recovered minus constant stresses, exact for the linear difference."""
    k, n_values = elements.shape[1], values.shape[1]
    one, whole = np.empty(n_values), np.empty(n_values)
    for e in range(len(elements)):
        whole[:] = 0.0
        total = 0.0
        for v in elements[e]:
            for c in range(n_values):
                one[c] = nodal[v, c] - values[e, c]
                whole[c] += one[c]
            total += _complementary(one, k - 1, lame[body[e]], shear[body[e]])
        total += _complementary(whole, k - 1, lame[body[e]], shear[body[e]])
        squares[e] = volumes[e] / (k * (k + 1)) * total


@inner_kernel
def _with_hoop(values, hoop, initial, lame, shear, stress):
    """Write rr, zz, hoop, rz of an axisymmetric element from rr, zz, rz without hoop strain, and that strain."""
    in_plane = (values[0] + values[1] + 2.0 * lame * initial) / (2.0 * lame + 2.0 * shear)
    stress[0], stress[1], stress[3] = values[0] + lame * hoop, values[1] + lame * hoop, values[2]
    stress[2] = lame * (in_plane - initial) - 2.0 * shear * initial + (lame + 2.0 * shear) * hoop


@kernel
def axisymmetric_stresses(points, elements, u, body, lame, shear, initial, values, sampled):
    """Write rr, zz, hoop, rz (n_elements, 4) at the centroids. ``initial`` (n_elements or 0, 3): initial strains."""
    for e in range(len(elements)):
        a, b, c = elements[e, 0], elements[e, 1], elements[e, 2]
        hoop = (u[a, 0] + u[b, 0] + u[c, 0]) / (points[a, 0] + points[b, 0] + points[c, 0])
        strain = initial[e, 2] if len(initial) > 0 else 0.0
        _with_hoop(values[e], hoop, strain, lame[body[e]], shear[body[e]], sampled[e])


@kernel
def axisymmetric_energy(points, elements, cells, u, volumes, body, lame, shear, initial, values, nodal, rule, weights,
                        squares):
    """Write the energies (n_elements,) of recovered minus element stresses over the full circumference. ``rule``
    (n_points, 3) and ``weights`` (n_points,): points inside the element; there the element has the hoop strain u_r /
    r."""
    stress = np.empty(4)
    for e in range(len(elements)):
        k = body[e]
        strain = initial[e, 2] if len(initial) > 0 else 0.0
        total = 0.0
        for q in range(len(weights)):
            radius, moved = 0.0, 0.0
            for j in range(3):
                radius += rule[q, j] * points[elements[e, j], 0]
                moved += rule[q, j] * u[elements[e, j], 0]
            _with_hoop(values[e], moved / radius, strain, lame[k], shear[k], stress)
            for c in range(4):
                stress[c] = -stress[c]
                for j in range(3):
                    stress[c] += rule[q, j] * nodal[cells[e, j], c]
            total += weights[q] * radius * _complementary(stress, 3, lame[k], shear[k])
        squares[e] = 2.0 * np.pi * volumes[e] * total
