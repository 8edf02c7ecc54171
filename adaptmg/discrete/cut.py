r"""The force that a cut across a body transmits.

With the nodal function :math:`\chi`, 1 beyond the cut and 0 before it, and the direction a of the axis,

.. math:: N = \int \sigma : \nabla (\chi a) ,

the virtual work of moving the part beyond the cut by a unit: what all forces on that part pull, to rounding.
"""

from __future__ import annotations

import numpy as np

from adaptmg.discrete.elasticity import Materials
from adaptmg.discrete.loads import body_elements
from adaptmg.discrete.stress import StressData, displacement_gradient
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.loads import Preload


def cut_force(mesh: MeshArrays, data: StressData, displacement: np.ndarray, preload: Preload) -> float:
    """Tension across the cut of a preload, N; ValueError if no element of the body lies across it."""
    elements, axis, volumes = _of_body(mesh, data, preload)
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
    return float(np.einsum("n,nij,nij->", volumes, stress, slopes))


def cut_stiffness(mesh: MeshArrays, material: Materials, preload: Preload) -> float:
    """Force, N, that a strain of 1 makes in the mean section of the body, held at both ends."""
    data = StressData.of(mesh, material)
    elements, axis, volumes = _of_body(mesh, data, preload)
    k, along = mesh.bodies.index(preload.body), mesh.points[mesh.elements[elements], axis]
    return float((data.lame[k] + 2 * data.shear[k]) * volumes.sum() / np.ptp(along))


def _of_body(mesh: MeshArrays, data: StressData, preload: Preload) -> tuple[np.ndarray, int, np.ndarray]:
    """Elements of the body, the number of the axis, and volumes of the elements, in axisymmetry of the whole ring."""
    elements, volumes = body_elements(mesh, preload.body), mesh.volumes
    if data.axisymmetric:
        volumes = 2 * np.pi * mesh.points[mesh.elements, 0].mean(axis=1) * volumes
    return elements, preload.direction, volumes[elements]
