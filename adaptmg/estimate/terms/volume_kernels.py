"""Kernel for what axisymmetric stress leaves inside elements; see :mod:`adaptmg.estimate.terms.volume`."""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import kernel

__all__ = ["axisymmetric_residual"]


@kernel
def axisymmetric_residual(points, elements, u, body, lame, shear, initial, stress, force, rule, weights, squares):
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
