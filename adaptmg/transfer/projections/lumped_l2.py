r"""L2 projection with a lumped mass matrix.

.. math:: P = D^{-1} B, \qquad B_{ij} = \int \varphi^f_i \varphi^c_j, \qquad D_{ii} = \int \varphi^f_i
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.transfer.location import OUTSIDE_TOLERANCE
from adaptmg.transfer.projections.mixed_mass import mixed_mass
from adaptmg.transfer.rows import CLIP, dropped, normalised

__all__ = ["LumpedL2"]


@dataclass(frozen=True, kw_only=True)
class LumpedL2:
    """Averages of the coarse function, weighted by the fine shape functions.

    Entries are >= 0 with row sums 1. Reproduces constants only: an affine field is evaluated at the centre of gravity
    of the shape function, which is not the node unless the patch is symmetric, and never is on the boundary. For
    comparison; :class:`adaptmg.transfer.PseudoL2` costs the same and does better. Integrals:
    :mod:`adaptmg.transfer.projections.mixed_mass`.

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
        weighted = integrals.assemble(integrals.shape_coefficients())
        data = weighted.data / np.repeat(integrals.lumped_mass, np.diff(weighted.indptr))
        result = sparse.csr_array((data, weighted.indices, weighted.indptr), shape=weighted.shape)
        return normalised(dropped(result, CLIP))
