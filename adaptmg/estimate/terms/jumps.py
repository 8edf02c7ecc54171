r"""Jumps: parts of the residual from tractions that differ on the two sides of facets inside the mesh.

With the area vector :math:`a_F = |F| n` the part of facet F in each element E beside it is

.. math:: \frac{1}{2E} h_F \int_F |[\sigma n]|^2 = \frac{h_F}{2 E |F|}\,|[\sigma]\,a_F|^2 ,

:math:`h_F = |F|` in the plane and :math:`\sqrt{2 |F|}` in space. In axisymmetry the weight is :math:`2 \pi r`, and the
jump varies along F where materials meet: two Gauss points.
"""

from __future__ import annotations

import math

import numpy as np

from adaptmg.estimate.fields.element_stress import ElementStress
from adaptmg.runtime.compiled import kernel

__all__ = ["jump_squares"]

_GAUSS = 0.5 - 0.5 / math.sqrt(3.0)


@kernel
def _plane(points, elements, across, stress, weight, squares):
    """Add to ``squares``; ``weight`` (n_elements,) is 1 / (2 E)."""
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
def _axisymmetric(points, elements, across, radial, lame, stress, weight, squares):
    """As :func:`plane_jumps`; ``radial`` (n_nodes,) is u_r, ``lame`` (n_elements,)."""
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
    """As :func:`plane_jumps`, in space."""
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
    """Squares (n_elements,), N m; half of each facet to each of its elements, with that element's modulus.

    Parameters
    ----------
    stress : ElementStress
    across : (n_elements, dim + 1) int32 array
        See :class:`~adaptmg.estimate.fields.neighbours.Neighbours`. Bodies that are glued share nodes and so facets:
        tractions must agree there too.
    young : (n_elements,) array
        Pa.
    """
    mesh, squares, weight = stress.mesh, np.zeros(len(stress.values)), 0.5 / young
    if stress.axisymmetric:
        radial = np.ascontiguousarray(stress.displacement[:, 0])
        _axisymmetric(mesh.points, mesh.elements, across, radial, stress.data.lame[mesh.element_body], stress.values,
                      weight, squares)
    else:
        jumps = _plane if mesh.dim == 2 else _solid
        jumps(mesh.points, mesh.elements, across, stress.values, weight, squares)
    return squares
