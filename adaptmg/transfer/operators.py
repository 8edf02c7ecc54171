r"""Operators made from a prolongation, and the injection of values.

With a nodal prolongation P (n_fine, n_coarse): the restriction :math:`R = P^T` takes residuals (dual) from fine to
coarse and satisfies :math:`\langle r, P v\rangle = \langle R r, v\rangle`; the injection takes values (primal) from
fine to coarse; :math:`P \otimes I` acts on all components, dof = dim * node + component.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.transfer.location import OUTSIDE_TOLERANCE, body_locators, locate_nodes
from adaptmg.transfer.rows import csr_from_weights

__all__ = ["expand", "injection", "mask", "mesh_ratio", "restriction"]


def _csr(name: str, matrix: sparse.sparray | sparse.spmatrix) -> sparse.csr_array:
    if not sparse.issparse(matrix):
        raise TypeError(f"{name} must be a scipy sparse matrix, got {type(matrix).__name__}")
    return sparse.csr_array(matrix)


def restriction(P: sparse.csr_array) -> sparse.csr_array:
    """The transpose of P (n_coarse, n_fine): for residuals and forces (dual), never for values."""
    return sparse.csr_array(_csr("P", P).T)


def injection(coarse: MeshArrays, fine: MeshArrays, *, outside_tolerance: float = OUTSIDE_TOLERANCE
              ) -> sparse.csr_array:
    """The fine function evaluated at the coarse nodes: for values (primal), never for residuals.

    Parameters
    ----------
    coarse, fine : MeshArrays
    outside_tolerance : float
        How far outside the fine mesh a coarse node may lie, over the longest edge of the nearest fine element.

    Returns
    -------
    (n_coarse, n_fine) csr_array
        >= 0, row sums 1; reproduces constants, and affine fields at coarse nodes in the fine mesh. A coarse node
        outside takes the value at the closest point of the fine mesh.

    Raises
    ------
    ValueError
        A coarse node lies outside by more than the tolerance.
    """
    checks.nonnegative("outside_tolerance", outside_tolerance)
    found = locate_nodes(fine, coarse, outside_tolerance, names=("fine", "coarse"))
    return csr_from_weights(fine.elements[found.element], found.weights, fine.n_nodes)


def expand(P: sparse.csr_array, dim: int) -> sparse.csr_array:
    """kron(P, I_dim): from nodes to dofs, component by component.

    Parameters
    ----------
    P : (n_fine, n_coarse) sparse
    dim : int
        Components a node.

    Returns
    -------
    (dim * n_fine, dim * n_coarse) csr_array
    """
    dim = checks.integer("dim", dim, minimum=1)
    P = _csr("P", P)
    n, counts = P.shape[0], np.diff(P.indptr)
    row_of = np.repeat(np.arange(n), counts)
    # row dim i + c starts after all rows of the nodes before i and the c components before it
    start = dim * P.indptr[:-1].astype(np.int64)
    offset = np.arange(len(P.indices)) - P.indptr[row_of]
    indices = np.empty(dim * len(P.indices), dtype=np.int32)
    data = np.empty(len(indices))
    for c in range(dim):
        at = start[row_of] + c * counts[row_of] + offset
        indices[at], data[at] = dim * P.indices + c, P.data
    indptr = np.concatenate([[0], np.cumsum(np.repeat(counts, dim))]).astype(np.int32)
    return sparse.csr_array((data, indices, indptr), shape=(dim * n, dim * P.shape[1]))


def mask(P_dofs: sparse.csr_array, fixed_fine: np.ndarray, fixed_coarse: np.ndarray) -> sparse.csr_array:
    """A prolongation of dofs without the rows and columns of fixed dofs.

    Parameters
    ----------
    P_dofs : (n_fine_dofs, n_coarse_dofs) sparse
    fixed_fine, fixed_coarse : (n_fine_dofs,), (n_coarse_dofs,) bool arrays

    Returns
    -------
    csr_array
        The same shape; those rows and columns are empty.
    """
    P = _csr("P_dofs", P_dofs)
    for name, fixed, size in (("fixed_fine", fixed_fine, P.shape[0]), ("fixed_coarse", fixed_coarse, P.shape[1])):
        if np.asarray(fixed).dtype != bool:
            raise TypeError(f"{name} must be a boolean mask over the dofs, got {np.asarray(fixed).dtype}")
        if np.shape(fixed) != (size,):
            raise ValueError(f"{name} must have shape ({size},), got {np.shape(fixed)}")
    kept = ~np.asarray(fixed_coarse)[P.indices] & ~np.repeat(np.asarray(fixed_fine), np.diff(P.indptr))
    indptr = np.concatenate([[0], np.cumsum(kept)])[P.indptr].astype(np.int32)
    return sparse.csr_array((P.data[kept], P.indices[kept], indptr), shape=P.shape)


def mesh_ratio(coarse: MeshArrays, fine: MeshArrays, *, quantile: float = 1.0) -> float:
    """Largest local ratio h_coarse / h_fine; two-level rates suffer above about 3.

    For each fine element: the longest edge of the coarse element that holds its centroid, over its own longest edge.
    (Centroids, as a fine node on an edge belongs to coarse elements of several sizes.)

    Parameters
    ----------
    coarse, fine : MeshArrays
    quantile : float
        1 takes the largest; .99 leaves out the hundredth of the fine elements with the largest ratios, in which a
        single flat element cannot hide what holds elsewhere.

    Returns
    -------
    float
    """
    if not 0 <= checks.number("quantile", quantile) <= 1:
        raise ValueError(f"quantile must lie in [0, 1], got {quantile!r}")
    locators = body_locators(coarse, fine)
    ratio = np.empty(len(fine.elements))
    for body, locator in locators:
        elements = slice(None) if body is None else np.flatnonzero(fine.element_body == body)
        found = locator.locate(fine.points[fine.elements[elements]].mean(axis=1))
        ratio[elements] = coarse.element_sizes[found.element] / fine.element_sizes[elements]
    return float(np.quantile(ratio, quantile))
