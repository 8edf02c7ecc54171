r"""Point interpolation: the coarse function evaluated at the fine nodes.

.. math:: P_{ij} = \varphi^c_j(x_i)

A fine node outside the coarse mesh takes the value at the closest point of the coarse mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

from scipy import sparse

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.transfer.location import OUTSIDE_TOLERANCE, locate_nodes
from adaptmg.transfer.rows import csr_from_weights

__all__ = ["Interpolation"]


@dataclass(frozen=True, kw_only=True)
class Interpolation:
    """Point interpolation: the cheapest transfer, and the default.

    Entries are >= 0 with row sums 1. Reproduces constants always, and affine fields at every fine node that lies in
    the coarse mesh. On nested meshes it is the canonical embedding. Bodies are matched by name and interpolated apart.

    Parameters
    ----------
    outside_tolerance : float
        How far outside the coarse mesh a fine node may lie, over the longest edge of the nearest coarse element.
    """

    outside_tolerance: float = OUTSIDE_TOLERANCE

    def __post_init__(self) -> None:
        checks.nonnegative("outside_tolerance", self.outside_tolerance)

    def build(self, coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array:
        """Nodal prolongation (n_fine, n_coarse), at most dim + 1 entries a row.

        Raises
        ------
        ValueError
            A fine node lies outside by more than the tolerance; bodies or dimensions do not match.
        """
        found = locate_nodes(coarse, fine, self.outside_tolerance)
        return csr_from_weights(coarse.elements[found.element], found.weights, coarse.n_nodes)
