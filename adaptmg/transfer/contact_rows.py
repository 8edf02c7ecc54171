r"""Rows of contact nodes interpolated along the contact boundary.

On curved or non-nested contact boundaries a fine contact node lies inside or outside the coarse mesh, and a
prolongation between the volumes gives it weights of inner coarse nodes, on which there is no contact condition. Here it
is projected onto the nearest coarse contact facet and takes the weights there:

.. math:: P_{ik} \ge 0, \qquad \sum_k P_{ik} = 1, \qquad k \text{ coarse contact nodes only},

which is what the proof of the monotone correction needs (see :mod:`adaptmg.transfer.constraints`). Affine fields are
reproduced at the projected points, so on curved boundaries up to O(h_coarse^2).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.geometry.box_tree import BoxTree
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.runtime.compiled import kernel
from adaptmg.transfer.rows import csr_from_weights

__all__ = ["surface_interpolation", "with_contact_rows"]


def _indices(name: str, value: np.ndarray, ndim: int, limit: int) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.kind not in "iu":
        raise TypeError(f"{name} must be integers, got {array.dtype}")
    if array.ndim != ndim:
        raise ValueError(f"{name} must have {ndim} dimension(s), got shape {array.shape}")
    if array.size and (array.min() < 0 or array.max() >= limit):
        raise ValueError(f"{name} must lie in 0 .. {limit - 1}, got {array.min()} .. {array.max()}")
    return array


def surface_interpolation(coarse: MeshArrays, fine: MeshArrays, coarse_boundary_facets: np.ndarray,
                          fine_nodes: np.ndarray) -> sparse.csr_array:
    """Interpolate at fine contact nodes from the nearest coarse contact facet.

    Parameters
    ----------
    coarse, fine : MeshArrays
    coarse_boundary_facets : (n_facets, dim) array of int
        Coarse nodes of the contact facets (``coarse.boundary_facets(name)``): segments in 2D, triangles in 3D.
    fine_nodes : (n_fine_contact,) array of int
        Fine contact nodes.

    Returns
    -------
    (n_fine_contact, n_coarse_nodes) csr_array
        >= 0, row sums 1, at most dim entries a row. The nearest facet is exact (a search in a tree of boxes), on graded
        boundaries too.

    Raises
    ------
    TypeError, ValueError
        Indices of the wrong type, shape or range; no facets.
    """
    facets = _indices("coarse_boundary_facets", coarse_boundary_facets, 2, coarse.n_nodes)
    nodes = _indices("fine_nodes", fine_nodes, 1, fine.n_nodes)
    if coarse.dim != fine.dim:
        raise ValueError(f"coarse and fine must have the same dimension, got {coarse.dim} and {fine.dim}")
    if facets.shape[1] != coarse.dim or len(facets) == 0:
        raise ValueError(f"coarse_boundary_facets must have shape (n, {coarse.dim}) with n > 0, got {facets.shape}")
    tree = BoxTree(coarse.points, facets)
    facet, weights, _ = tree.nearest(fine.points[nodes])
    return csr_from_weights(facets[facet], weights, coarse.n_nodes)


@kernel
def _merge(row_of, p_indptr, p_indices, p, r_indptr, r_indices, r, indptr, indices, data):
    """Rows of P, or row ``row_of`` of R where that is not negative."""
    for i in range(len(row_of)):
        to = indptr[i]
        if row_of[i] < 0:
            for k in range(p_indptr[i], p_indptr[i + 1]):
                indices[to], data[to] = p_indices[k], p[k]
                to += 1
        else:
            for k in range(r_indptr[row_of[i]], r_indptr[row_of[i] + 1]):
                indices[to], data[to] = r_indices[k], r[k]
                to += 1


def with_contact_rows(P: sparse.csr_array, fine_nodes: np.ndarray, rows: sparse.csr_array) -> sparse.csr_array:
    """Replace the rows of contact nodes in a nodal prolongation.

    Parameters
    ----------
    P : (n_fine, n_coarse) sparse
    fine_nodes : (n_fine_contact,) array of int
        Rows to replace, each once.
    rows : (n_fine_contact, n_coarse) sparse
        Their replacements.

    Returns
    -------
    (n_fine, n_coarse) csr_array
        A new matrix.

    Raises
    ------
    TypeError, ValueError
        Indices or shapes do not fit.
    """
    nodes = _indices("fine_nodes", fine_nodes, 1, P.shape[0])
    if rows.shape != (len(nodes), P.shape[1]):
        raise ValueError(f"rows must have shape ({len(nodes)}, {P.shape[1]}), got {rows.shape}")
    if len(np.unique(nodes)) < len(nodes):
        raise ValueError("fine_nodes must be distinct")
    P, rows = sparse.csr_array(P), sparse.csr_array(rows)
    row_of = np.full(P.shape[0], -1)
    row_of[nodes] = np.arange(len(nodes))
    lengths = np.diff(P.indptr)
    lengths[nodes] = np.diff(rows.indptr)
    indptr = np.zeros_like(P.indptr)
    np.cumsum(lengths, out=indptr[1:])
    indices, data = np.empty(indptr[-1], dtype=P.indices.dtype), np.empty(indptr[-1])
    _merge(row_of, P.indptr, P.indices, P.data, rows.indptr, rows.indices, rows.data, indptr, indices, data)
    return sparse.csr_array((data, indices, indptr), shape=P.shape)
