r"""Element residuals: body forces that the stress inside an element does not balance.

.. math:: \frac{h_E^2}{E} \int_E |f + \mathrm{div}\,\sigma_h|^2, \qquad h_E \text{ the longest edge of E}.

The stress of linear displacements is constant, its divergence 0; but in axisymmetry

.. math:: (\mathrm{div}\,\sigma)_r = \partial_r \sigma_{rr} + \frac{\sigma_{rr} - \sigma_{\theta\theta}}{r},\qquad
   (\mathrm{div}\,\sigma)_z = \partial_z \sigma_{zz} + \frac{\sigma_{rz}}{r},

where :math:`\sigma_{rr}` and :math:`\sigma_{zz}` vary by :math:`\lambda\,\varepsilon_\theta`, of which
:math:`\partial_r \varepsilon_\theta = (\varepsilon_{rr} - \varepsilon_\theta)/r` and
:math:`\partial_z \varepsilon_\theta = \partial_z u_r / r`. Integrals are weighted with :math:`2 \pi r`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg.discretisation.initial_strain import body_elements
from adaptmg.discretisation.loads import load_density
from adaptmg.estimate.fields.element_stress import ElementStress
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, PLAIN_DEGREE, quadrature_points, quadrature_rule
from adaptmg.problem.loads import BodyForce, Load
from adaptmg.runtime.compiled import kernel

__all__ = ["volume_squares"]


@kernel
def _axisymmetric(points, elements, u, body, lame, shear, initial, stress, force, rule, weights, squares):
    """Write the integrals (n_elements,) of |f + div sigma|^2 over the full circumference.

    ``initial`` (n_elements or 0, 3): initial strains; ``stress`` (n_elements, 3): its last column is rz; ``force``
    (n_elements or 0, n_points, 2): f at the points of ``rule`` (n_points, 3), which lie inside.
    """
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
    """Squares (n_elements,), N m; None where there is neither a body force nor axisymmetry.

    Parameters
    ----------
    stress : ElementStress
    loads : sequence of Load
    young : (n_elements,) array
        Pa.
    """
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
        _axisymmetric(mesh.points, mesh.elements, stress.displacement, mesh.element_body, data.lame, data.shear,
                      data.initial_strain, stress.values, density, rule, weights, squares)
    else:
        squares = mesh.volumes * np.einsum("eqd,eqd,q->e", density, density, weights)
    return mesh.element_sizes**2 / young * squares
