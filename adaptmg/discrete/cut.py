r"""The force that a cut across a body transmits.

With the nodal function :math:`\chi`, 1 beyond the cut and 0 before it, and the direction a of the axis,

.. math:: N = \int \sigma : \nabla (\chi a) ,

the virtual work of moving the part beyond the cut by a unit: what all forces on that part pull, to rounding.
"""

from __future__ import annotations

import numpy as np

from adaptmg.discrete.elasticity import Materials, body_materials, is_axisymmetric
from adaptmg.discrete.loads import body_elements
from adaptmg.discrete.smoothed import element_measures
from adaptmg.discrete.stress import StressData, displacement_gradient
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.loads import Preload


def cut_force(mesh: MeshArrays, data: StressData, displacement: np.ndarray, preload: Preload) -> float:
    """Return the tension across the cut of a preload, N; ValueError if no element of the body lies across it."""
    elements, axis = body_elements(mesh, preload.body), preload.direction
    nodes = np.unique(mesh.elements[elements])
    along = mesh.points[nodes, axis]
    at = 0.5 * (along.min() + along.max()) if preload.at is None else preload.at
    if not along.min() < at < along.max():
        raise ValueError(f"at of the preload of {preload.body!r} must be in ({along.min():g}, {along.max():g}), the "
                         f"extent of the body along {preload.axis}, got {at:g}")
    beyond = np.zeros(mesh.points.shape)
    beyond[nodes[along > at], axis] = 1.0
    slopes = displacement_gradient(mesh, beyond)[elements]
    stress = data.tensors(mesh, displacement)[elements, :mesh.dim, :mesh.dim]
    volumes = element_measures(mesh, data.axisymmetric)[elements]
    return float(np.einsum("n,nij,nij->", volumes, stress, slopes))


def cut_stiffness(mesh: MeshArrays, material: Materials, preload: Preload) -> float:
    """Return the force, N, that a strain of 1 makes in the mean section of the body, whose sides are free."""
    elements, young = body_elements(mesh, preload.body), body_materials(mesh, material)[
        mesh.bodies.index(preload.body)].young
    volume = element_measures(mesh, is_axisymmetric(material))[elements].sum()
    return float(young * volume / np.ptp(mesh.points[mesh.elements[elements], preload.direction]))
