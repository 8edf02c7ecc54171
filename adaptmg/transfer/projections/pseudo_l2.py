r"""Pseudo-L2 projection: tested with the dual basis, so that no mass matrix is solved for.

.. math:: P = D^{-1} B^\psi, \qquad B^\psi_{ij} = \int \psi_i\, \varphi^c_j, \qquad
          \int_e \psi_i\, \varphi^f_k = \delta_{ik} \int_e \varphi^f_i \;\text{ on every element } e,

which on a simplex in d dimensions gives :math:`\psi_i = (d + 2)\,\varphi^f_i - 1`. Dickopf and Krause, Evaluating local
approximations of the L2-orthogonal projection between non-nested finite element spaces, Numer. Math. Theory Methods
Appl. 7 (2014) 288-316; dual basis: Wohlmuth, SIAM J. Numer. Anal. 38 (2000) 989-1012.
"""

from __future__ import annotations

from dataclasses import dataclass

from scipy import sparse

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.transfer.location import OUTSIDE_TOLERANCE
from adaptmg.transfer.projections.mixed_mass import mixed_mass
from adaptmg.transfer.rows import clipped_rows

__all__ = ["PseudoL2"]


@dataclass(frozen=True, kw_only=True)
class PseudoL2:
    """The local projection closest to the true L2 projection.

    Row sums 1; entries may be negative, so that it proves nothing for the monotone correction (interpolate the contact
    rows there: :func:`adaptmg.transfer.with_contact_rows`). Reproduces constants always, and affine fields at fine
    nodes whose elements the coarse mesh covers. On nested meshes it is the canonical embedding. Integrals are exact
    where the coarse mesh covers the fine element: :mod:`adaptmg.transfer.projections.mixed_mass`.

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
        coefficients = (fine.dim + 2) * integrals.shape_coefficients() - 1.0
        coefficients /= integrals.lumped_mass[integrals.patches.nodes][:, None]
        return clipped_rows(integrals.assemble(coefficients), coarse.points, fine.points)
