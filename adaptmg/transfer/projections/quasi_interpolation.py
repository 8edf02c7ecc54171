r"""Quasi-interpolation of Clement type: local L2 projections on the patches of fine nodes.

On the patch :math:`\omega_i` of fine elements around the node :math:`x_i`, the coarse function u is projected onto
affine functions, and the projection is evaluated at the node. With :math:`q(x) = (1, (x - x_i)/h_i)`

.. math:: (Pu)_i = c_i\cdot\int_{\omega_i} q\, u, \qquad G_i c_i = (1, 0, \dots, 0), \qquad
          G_i = \int_{\omega_i} q\, q^T .

Clement, RAIRO Anal. Numer. 9 (1975) 77-84; as a transfer: Dickopf and Krause (2014), see
:mod:`adaptmg.transfer.projections.l2`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.transfer.location import OUTSIDE_TOLERANCE
from adaptmg.transfer.projections.mixed_mass import Patches, mixed_mass
from adaptmg.transfer.rows import clipped_rows

__all__ = ["QuasiInterpolation"]


@dataclass(frozen=True, kw_only=True)
class QuasiInterpolation:
    """Clement quasi-interpolation on fine patches.

    Row sums 1; entries may be negative. Reproduces constants always, and affine fields at fine nodes whose patch the
    coarse mesh covers. Unlike the other affine transfers it is no projection: on nested meshes it smooths the kinks of
    the coarse function. Integrals: :mod:`adaptmg.transfer.projections.mixed_mass`.

    Parameters
    ----------
    outside_tolerance : float
        How far outside the coarse mesh a fine node may lie, over the longest edge of the nearest coarse element.
    """

    outside_tolerance: float = OUTSIDE_TOLERANCE

    def __post_init__(self) -> None:
        checks.nonnegative("outside_tolerance", self.outside_tolerance)

    def build(self, coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array:
        """Nodal prolongation (n_fine, n_coarse); errors as :meth:`adaptmg.transfer.Interpolation.build`."""
        integrals = mixed_mass(coarse, fine, self.outside_tolerance)
        coefficients = _patch_coefficients(fine, integrals.patches)
        return clipped_rows(integrals.assemble(coefficients), coarse.points, fine.points)


def _patch_coefficients(fine: MeshArrays, patches: Patches) -> np.ndarray:
    """c_i . q(x_k) at the corners k of every element of the patch of i (n_incidences, dim + 1)."""
    k = fine.dim + 1
    node, first = patches.nodes, patches.indptr[:-1]
    relative = fine.points[fine.elements[patches.elements]] - fine.points[node][:, None, :]
    size = np.maximum.reduceat(np.abs(relative).max(axis=(1, 2)), first)
    q = np.concatenate([np.ones((len(node), k, 1)), relative / size[node][:, None, None]], axis=2)
    # integral of q q' over an element, from the values of q at its corners
    total = q.sum(axis=1)
    gram = np.einsum("pka,pkb->pab", q, q) + total[:, :, None] * total[:, None, :]
    gram *= (fine.volumes[patches.elements] / (k * (k + 1)))[:, None, None]
    right = np.zeros((fine.n_nodes, k, 1))
    right[:, 0] = 1.0
    c = np.linalg.solve(np.add.reduceat(gram, first, axis=0), right)[:, :, 0]
    return np.einsum("pka,pa->pk", q, c[node])
