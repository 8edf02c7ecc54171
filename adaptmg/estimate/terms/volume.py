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
    mesh = stress.mesh
    rule, weights = quadrature_rule(mesh.dim + 1, AXISYMMETRIC_DEGREE if stress.axisymmetric else PLAIN_DEGREE)
    points = quadrature_points(mesh.points, mesh.elements, rule)
    density = _divergence(stress, rule, points) if stress.axisymmetric else np.zeros(points.shape)
    for load in forces:
        here = slice(None) if load.body is None else body_elements(mesh, load.body)
        density[here] += load_density(load, points[here], None)
    squares = np.einsum("eqd,eqd->eq", density, density)
    if stress.axisymmetric:
        squares *= 2 * np.pi * points[:, :, 0]
    return mesh.element_sizes**2 / young * mesh.volumes * (squares @ weights)


def _divergence(stress: ElementStress, rule: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Div sigma (n_elements, n_points, 2) of axisymmetric bodies."""
    mesh, u, data = stress.mesh, stress.displacement, stress.data
    corners, values = mesh.points[mesh.elements], u[mesh.elements, 0]
    x, du = corners[:, 1:] - corners[:, :1], values[:, 1:] - values[:, :1]
    twice = x[:, 0, 0] * x[:, 1, 1] - x[:, 0, 1] * x[:, 1, 0]
    along_r = ((du[:, 0] * x[:, 1, 1] - du[:, 1] * x[:, 0, 1]) / twice)[:, None]
    along_z = ((du[:, 1] * x[:, 0, 0] - du[:, 0] * x[:, 1, 0]) / twice)[:, None]
    hoop, r = stress.hoop(mesh.elements, rule), points[:, :, 0]
    lame, shear = (part[mesh.element_body][:, None] for part in (data.lame, data.shear))
    # sigma_rr - sigma_tt = 2 mu times the difference of the elastic strains
    apart = along_r - hoop
    if len(data.initial_strain):
        initial = data.initial_strain
        apart = apart - (initial[:, 0] - initial[:, 2])[:, None]
    radial = (lame * (along_r - hoop) + 2 * shear * apart) / r
    axial = (lame * along_z + stress.values[:, 2][:, None]) / r
    return np.stack([radial, axial], axis=-1)
