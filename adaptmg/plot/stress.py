r"""Von Mises stress of a P1 displacement, constant on each element.

.. math:: \sigma_M^2 = \tfrac32\, s : s, \qquad s = \sigma - \tfrac13 \mathrm{tr}(\sigma) I,

with all three normal stresses: in plane strain :math:`\sigma_{zz} = \nu (\sigma_{xx} + \sigma_{yy})`.
"""

from __future__ import annotations

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import Elastic, PlaneStrain

__all__ = ["von_mises"]


def von_mises(mesh: MeshArrays, displacement: np.ndarray, material: Elastic) -> np.ndarray:
    """Von Mises stress on each element.

    Parameters
    ----------
    mesh : MeshArrays
    displacement : (n_nodes, dim) array
        m.
    material : PlaneStrain, PlaneStress or Solid

    Returns
    -------
    (n_elements,) array
        Pa.
    """
    x, u = mesh.points[mesh.elements], displacement[mesh.elements]
    # rows are edges from the first corner: (x_k - x_0) grad u = u_k - u_0
    gradient = np.linalg.solve(x[:, 1:] - x[:, :1], u[:, 1:] - u[:, :1])
    strain = 0.5 * (gradient + np.swapaxes(gradient, 1, 2))
    trace = np.trace(strain, axis1=1, axis2=2)
    dim = mesh.dim
    stress = np.zeros((len(strain), 3, 3))
    stress[:, :dim, :dim] = 2 * material.shear_modulus * strain
    stress[:, range(dim), range(dim)] += material.lame * trace[:, None]
    if isinstance(material, PlaneStrain):
        stress[:, 2, 2] = material.lame * trace
    mean = np.trace(stress, axis1=1, axis2=2) / 3
    stress[:, range(3), range(3)] -= mean[:, None]
    return np.sqrt(1.5 * np.einsum("nij,nij->n", stress, stress))
