r"""Coupling: relative coordinates, in which contact between elastic bodies looks like contact of one body.

A slave node j faces the combination :math:`\sum_k W_{jk} u_k` of the nodes of the other surface (mortar weights, rows
with sum 1). In place of its displacement the unknown is the displacement relative to that,

.. math:: w = (I - \Pi W)\,u,\qquad u = T w,\qquad T = (I - \Pi W)^{-1} = I + \Pi W + (\Pi W)^2 + \dots

where :math:`\Pi` drops the fixed components of slave nodes. The series ends, as no node follows itself: two powers
where no slave node is a master node, one more for each body that is both (B. Wohlmuth, Acta Numerica 20, 2011,
doi:10.1017/S0962492911000079, for the two-body case). With :math:`\hat A = T^T A T,\ \hat b = T^T b` the conditions of
contact are on the slave nodes alone, and :math:`\hat A w - \hat b = T^T (A u - b)` is there the contact force on the
slave; the master carries :math:`-W^T` of it, so that the forces balance.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from adaptmg.problem import check_arrays
from adaptmg.problem.index_arrays import narrowed

__all__ = ["Coupling"]

_ROUNDING = 1e-13
_MOST_LINKS = 16  # bodies in a row of which each is the slave of the next


@dataclass(frozen=True, eq=False)
class Coupling:
    """The transformation between displacements and relative coordinates.

    Parameters
    ----------
    weights : (n_nodes, n_nodes) sparse
        W: in the row of a slave node the weights of the nodes it follows, else empty. Row sums 1.
    fixed : (n_dofs,) bool array
        Fixed dofs; those of slave nodes are not relative.

    Attributes
    ----------
    upward : (n_nodes, n_nodes) csr_array
        I + W + W^2 + ..., the inverse of I - W.

    Raises
    ------
    TypeError, ValueError
        On wrong shapes, rows whose sum is not 1, or nodes that follow each other in a circle.
    """

    weights: sparse.csr_array
    fixed: np.ndarray
    upward: sparse.csr_array = field(init=False, repr=False)
    _by_dof: sparse.csr_array = field(init=False, repr=False)
    _series: sparse.csr_array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        weights = sparse.csr_array(check_arrays.sparse_matrix("weights", self.weights), dtype=np.float64)
        fixed = np.asarray(self.fixed)
        n = weights.shape[0]
        if weights.shape != (n, n) or fixed.dtype != bool or fixed.ndim != 1 or n == 0 or len(fixed) not in (2 * n,
                                                                                                            3 * n):
            raise ValueError(f"weights must be square with a row a node and fixed a boolean mask over their dofs, got "
                             f"{weights.shape} and {fixed.dtype} {fixed.shape}")
        followers = np.flatnonzero(np.diff(weights.indptr))
        sums = np.asarray(weights.sum(axis=1)).ravel()[followers]
        if not np.abs(sums - 1).max(initial=0.0) <= 1e-8:
            i = int(np.argmax(np.abs(sums - 1)))
            raise ValueError(f"weights must have rows with sum 1, got {sums[i]:.6g} at node {followers[i]}")
        dim = len(fixed) // n
        by_dof = sparse.csr_array(sparse.diags_array((~fixed).astype(float))
                                  @ sparse.kron(weights, sparse.eye_array(dim), format="csr"))
        by_dof.eliminate_zeros()
        object.__setattr__(self, "weights", weights)
        object.__setattr__(self, "fixed", fixed)
        upward = sparse.csr_array(sparse.eye_array(n, format="csr") + _series(weights))
        object.__setattr__(self, "upward", narrowed(upward))
        object.__setattr__(self, "_by_dof", narrowed(by_dof))
        object.__setattr__(self, "_series", narrowed(_series(by_dof)))

    @property
    def dim(self) -> int:
        """Components a node."""
        return len(self.fixed) // self.weights.shape[0]

    def physical(self, relative: np.ndarray) -> np.ndarray:
        """u = T w for values (n_dofs,) or (n_dofs, k); primal."""
        return relative + self._series @ relative

    def relative(self, displacement: np.ndarray) -> np.ndarray:
        """w = T^-1 u for values (n_dofs,) or (n_dofs, k); primal."""
        return displacement - self._by_dof @ displacement

    def relative_forces(self, forces: np.ndarray) -> np.ndarray:
        """T' f for nodal forces (n_dofs,); dual."""
        return forces + self._series.T @ forces

    def physical_forces(self, forces: np.ndarray) -> np.ndarray:
        """T^-T f for forces (n_dofs,) in relative coordinates; dual."""
        return forces - self._by_dof.T @ forces

    def transformed(self, matrix: sparse.bsr_array) -> sparse.bsr_array:
        """T' A T in blocks, exactly symmetric, for a symmetric A (n_dofs, n_dofs)."""
        dim = self.dim
        series = sparse.bsr_array(self._series, blocksize=(dim, dim))
        right = sparse.bsr_array(matrix @ series)
        change = right + sparse.bsr_array(right.T) + sparse.bsr_array(series.T @ right)
        change = 0.5 * (change + sparse.bsr_array(change.T))
        return narrowed(sparse.bsr_array(matrix + change, blocksize=(dim, dim)).sorted_indices())

    def prolongation(self, nodal: sparse.csr_array, coarse: Coupling) -> sparse.csr_array:
        r"""A nodal prolongation P in relative coordinates on both levels, :math:`(I - W_f)\,P\,(I - W_c)^{-1}`.

        It spans the space that P spans: rigid motions of both bodies and all else that P reproduces.

        Parameters
        ----------
        nodal : (n_nodes, n_nodes coarse) csr_array
            For displacements.
        coarse : Coupling
            On the coarse level.

        Returns
        -------
        (n_nodes, n_nodes coarse) csr_array
            Weights that are zero to rounding are left out.
        """
        inner = sparse.csr_array(nodal @ coarse.upward)
        result = sparse.csr_array(inner - self.weights @ inner)
        result.data[np.abs(result.data) < _ROUNDING] = 0.0
        result.eliminate_zeros()
        result.sort_indices()
        return narrowed(result)


def _series(step: sparse.csr_array) -> sparse.csr_array:
    """step + step^2 + ... until it ends."""
    total, power = step, step
    for _ in range(_MOST_LINKS):
        power = sparse.csr_array(power @ step)
        if not power.nnz:
            return sparse.csr_array(total)
        total = total + power
    raise ValueError("weights: nodes follow each other in a circle, each the slave of the next; exchange slave and "
                     "master in one of the contact pairs")
