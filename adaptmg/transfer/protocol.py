r"""What a transfer is: an object that builds the prolongation between two meshes.

.. math:: u_f(x_i) \leftarrow \sum_j P_{ij}\, u_c(x_j), \qquad \sum_j P_{ij} = 1

P acts on nodal values (primal), component by component; its transpose restricts residuals (dual).
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from scipy import sparse

from adaptmg.mesh.arrays import MeshArrays

__all__ = ["Transfer"]


@runtime_checkable
class Transfer(Protocol):
    """Anything with this method can be given as ``transfer=``."""

    def build(self, coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array:
        """Nodal prolongation (n_fine, n_coarse); rows should sum to 1, or rigid translations are not reproduced."""
