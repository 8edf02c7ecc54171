r"""Strain and stress, element by element, from a P1 displacement.

.. math:: \varepsilon = \tfrac12(\nabla u + \nabla u^T), \qquad
   \sigma = \lambda\,\mathrm{tr}(\varepsilon) I + 2\mu\varepsilon

with the Lame constants as they enter the plane problem; both are constant on an element.
"""

from __future__ import annotations

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.materials import Elastic, PlaneStrain

__all__ = ["element_strain", "element_stress", "von_mises"]


def element_strain(mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
    """Small-strain tensors.

    Parameters
    ----------
    mesh : MeshArrays
    displacement : (n_nodes, dim) or (n_dofs,) array
        m.

    Returns
    -------
    (n_elements, dim, dim) array
        Symmetric.
    """
    u = np.asarray(displacement, dtype=np.float64)
    if u.shape not in (mesh.points.shape, (mesh.points.size,)):
        raise ValueError(f"displacement must have shape {mesh.points.shape}, got {u.shape}")
    u = u.reshape(mesh.points.shape)
    corners, values = mesh.points[mesh.elements], u[mesh.elements]
    # with edge vectors as rows, du_edge = edge . grad(u), grad(u)[j, i] = d u_i / d x_j
    gradient = np.linalg.solve(corners[:, 1:] - corners[:, :1], values[:, 1:] - values[:, :1])
    return 0.5 * (gradient + np.swapaxes(gradient, 1, 2))


def element_stress(mesh: MeshArrays, material: Elastic, displacement: np.ndarray) -> np.ndarray:
    """In-plane (3D: full) Cauchy stress tensors.

    Parameters
    ----------
    mesh : MeshArrays
    material : Elastic
        Of the mesh's dimension.
    displacement : (n_nodes, dim) or (n_dofs,) array
        m.

    Returns
    -------
    (n_elements, dim, dim) array
        Pa; tension positive.
    """
    if material.dim != mesh.dim:
        raise ValueError(f"the material is {material.dim}D, the mesh {mesh.dim}D")
    strain = element_strain(mesh, displacement)
    trace = np.trace(strain, axis1=1, axis2=2)
    return material.lame * trace[:, None, None] * np.eye(mesh.dim) + 2 * material.shear_modulus * strain


def von_mises(stress: np.ndarray, material: Elastic) -> np.ndarray:
    r"""Equivalent stress :math:`\sqrt{\tfrac32\, s : s}` of the full deviator s.

    Parameters
    ----------
    stress : (n, dim, dim) array
        Pa, from :func:`element_stress`.
    material : Elastic
        Plane strain adds sigma_zz = nu (sigma_xx + sigma_yy); plane stress has none.

    Returns
    -------
    (n,) array
        Pa.
    """
    full = np.zeros((len(stress), 3, 3))
    dim = stress.shape[1]
    if dim != material.dim:
        raise ValueError(f"stress is {dim}D, the material {material.dim}D")
    full[:, :dim, :dim] = stress
    if isinstance(material, PlaneStrain):
        full[:, 2, 2] = material.poisson * (stress[:, 0, 0] + stress[:, 1, 1])
    deviator = full - np.trace(full, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * np.sum(deviator**2, axis=(1, 2)))
