"""Jumps: parts of the residual from tractions that differ on the two sides of facets inside the mesh."""

from __future__ import annotations

import numpy as np

from adaptmg.estimate.fields.element_stress import ElementStress
from adaptmg.estimate.terms.jump_kernels import axisymmetric_jumps, plane_jumps, solid_jumps

__all__ = ["jump_squares"]


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
        axisymmetric_jumps(mesh.points, mesh.elements, across, radial, stress.data.lame[mesh.element_body],
                           stress.values, weight, squares)
    else:
        jumps = plane_jumps if mesh.dim == 2 else solid_jumps
        jumps(mesh.points, mesh.elements, across, stress.values, weight, squares)
    return squares
