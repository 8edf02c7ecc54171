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
from adaptmg.estimate.terms.volume_kernels import axisymmetric_residual
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, PLAIN_DEGREE, quadrature_points, quadrature_rule
from adaptmg.problem.loads import BodyForce, Load

__all__ = ["volume_squares"]


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
        axisymmetric_residual(mesh.points, mesh.elements, stress.displacement, mesh.element_body, data.lame, data.shear,
                              data.initial_strain, stress.values, density, rule, weights, squares)
    else:
        squares = mesh.volumes * np.einsum("eqd,eqd,q->e", density, density, weights)
    return mesh.element_sizes**2 / young * squares
