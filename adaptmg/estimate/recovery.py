r"""Recovery: an estimate of the energy error by a smoother stress (Zienkiewicz and Zhu).

.. math:: \eta_E^2 = \int_E (\sigma^* - \sigma_h) : C^{-1} (\sigma^* - \sigma_h)

with a stress :math:`\sigma^*` that is continuous and piecewise linear in each body: it may jump where materials meet
and between bodies in contact (:mod:`adaptmg.discrete.stress`). Where the solution is smooth the estimate tends to the
error itself; it does not depend on loads and contact conditions. Of smoothed elements, the error is that of the stress
of :meth:`adaptmg.Result.stress`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg._numba import kernel
from adaptmg._threads import one_blas_thread
from adaptmg.discrete.stress import recovered
from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.stress_fields import ElementStress, posed
from adaptmg.geometry.quadrature import integration
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
        squares = recovered_energy(this.stress, *recovered(this.mesh, this.stress.values))
        by_body = np.bincount(this.mesh.element_body, weights=squares, minlength=len(this.mesh.bodies))
        return Estimate(squares=squares, norm=this.norm, indicator="recovered stress",
                        terms=dict(zip(this.mesh.bodies, by_body, strict=True)))


def recovered_energy(stress: ElementStress, cells: np.ndarray, nodal: np.ndarray) -> np.ndarray:
    """Return energies (n_elements,) of a recovered stress, linear between nodal values on cells, minus that of the
    elements, N m."""
    mesh, squares = stress.mesh, np.empty(len(cells))
    rule, _, weights = integration(mesh.points, mesh.elements, mesh.volumes, stress.axisymmetric)
    varies = stress.axisymmetric and not stress.data.smoothed
    rise = stress.rise(slice(None), mesh.elements, rule) if varies else np.zeros((0, 0))
    if stress.data.moduli is not None:
        difference = rule @ nodal[cells] - stress.values[:, None]
        if varies:
            difference -= rise[:, :, None] * stress.of_hoop[:, None]
        plane = mesh.dim == 2 and not stress.axisymmetric
        return np.einsum("eq,eq->e", weights, stress.data.moduli.work(difference, difference, plane))
    _energy(cells, stress.values, nodal, rise, rule, weights, 3 if stress.axisymmetric else mesh.dim, stress.lame,
            stress.shear, squares)
    return squares


@kernel
def _energy(cells, values, nodal, rise, rule, weights, normal, lame, shear, squares):
    """Write the integrals (n_elements,) of d : C^-1 d, where d is the difference of stresses, of ``normal`` normal
    stresses and shear stresses; ``rise`` (n_elements or 0, n_points): hoop strain less that of ``values``."""
    for e in range(len(cells)):
        squares[e] = 0.0
        for q in range(len(rule)):
            trace, size = 0.0, 0.0
            for c in range(values.shape[1]):
                difference = -values[e, c]
                for k in range(cells.shape[1]):
                    difference += rule[q, k] * nodal[cells[e, k], c]
                if len(rise) > 0 and c < normal:
                    difference -= (lame[e] + (2.0 * shear[e] if c == 2 else 0.0)) * rise[e, q]
                size += difference * difference * (1.0 if c < normal else 2.0)
                trace += difference if c < normal else 0.0
            size -= trace * trace / (normal + 2.0 * shear[e] / lame[e])  # lame is infinite of incompressible bodies
            squares[e] += weights[e, q] * size / (2.0 * shear[e])
