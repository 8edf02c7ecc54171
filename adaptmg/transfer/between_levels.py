r"""Prolongations between two levels of a contact problem: contact rows, and relative coordinates of coupled bodies.

With the nodal prolongation P of displacements and the couplings W_f, W_c of the two levels there are two forms for
relative values w:

.. math:: P_w = (I - W_f)\,P\,(I - W_c)^{-1},

which spans the same space as P, rigid motions of all bodies included; and the same with the rows of the slave nodes
replaced by interpolation of relative values along the coarse slave surface, weights >= 0 with sums 1 over the coarse
slave nodes of the pair, as the monotone correction wants them. Other coarse nodes of the surface (where it hangs over,
or belongs to another pair) have no values relative to this master: those beside them take over their weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from adaptmg.discrete import DiscreteProblem
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import check_arrays, checks
from adaptmg.transfer.contact_rows import surface_interpolation, with_contact_rows
from adaptmg.transfer.location import nodes_of_bodies
from adaptmg.transfer.protocol import Transfer

__all__ = ["LevelTransfer", "between_levels"]


@dataclass(frozen=True, eq=False)
class LevelTransfer:
    """Nodal prolongations from a level to the next finer.

    Attributes
    ----------
    prolongation : (n_nodes, n_nodes coarse) csr_array
        Of relative values where there is a coupling.
    surface : csr_array or None
        With a coupling the form whose slave rows interpolate along the slave surface.
    """

    prolongation: sparse.csr_array
    surface: sparse.csr_array | None = None


def between_levels(transfer: Transfer, coarse: MeshArrays, fine: MeshArrays, coarse_problem: DiscreteProblem,
                   fine_problem: DiscreteProblem, contact_rows: bool = True) -> LevelTransfer:
    """Prolongations between the discretisations of one problem on two meshes.

    Parameters
    ----------
    transfer : Transfer
    coarse, fine : MeshArrays
    coarse_problem, fine_problem : DiscreteProblem
        Of them.
    contact_rows : bool
        Interpolate the nodes of contact surfaces (of pairs: both) along the coarse surface.

    Raises
    ------
    ValueError
        If the transfer returns a matrix of another shape, entries that are not finite, or rows that mix bodies.
    """
    nodal = _built(transfer, coarse, fine)
    contact, coupling = fine_problem.contact, fine_problem.coupling
    if coupling is not None:
        _check_bodies(nodal, coarse, fine, transfer)
    slave_rows = [_along(coarse, fine, name, contact.nodes[contact.boundary == k])
                  for k, name in enumerate(contact.names)]
    if contact_rows:
        master_rows = [_along(coarse, fine, name, fine.boundary_nodes(name)) for name in contact.masters if name]
        for nodes, rows in (*master_rows, *slave_rows):
            nodal = with_contact_rows(nodal, nodes, rows)
    if coupling is None:
        return LevelTransfer(nodal)
    relative = coupling.prolongation(nodal, coarse_problem.coupling)
    surface, above = relative, coarse_problem.contact
    for k, (nodes, rows) in enumerate(slave_rows):
        known = above.nodes[above.boundary == k]
        if contact.masters[k] and len(known):
            surface = with_contact_rows(surface, nodes, _among(known, rows, fine.points[nodes], coarse.points))
    return LevelTransfer(relative, surface)


def _built(transfer: Transfer, coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array:
    """What the transfer returns, checked: kernels follow its indices."""
    returned, wanted = transfer.build(coarse, fine), (fine.n_nodes, coarse.n_nodes)
    if sparse.issparse(returned) and returned.shape != wanted:
        raise ValueError(f"transfer.build must return a matrix of shape {wanted} (fine, coarse nodes), "
                         f"got {returned.shape}")
    nodal = check_arrays.sparse_matrix(f"what transfer.build of {checks.shown(transfer)} returns", returned)
    nodal = sparse.csr_array(nodal, dtype=np.float64)
    largest = np.abs(nodal.data).max(initial=0.0)
    if not 1 / checks.VAST <= largest <= checks.VAST:
        raise ValueError(f"transfer.build of {checks.shown(transfer)} must return weights of about 1, the largest is "
                         f"{largest:.3g}")
    return nodal


def _check_bodies(nodal: sparse.csr_array, coarse: MeshArrays, fine: MeshArrays, transfer: Transfer) -> None:
    """No fine node may follow coarse nodes of a body that its own does not hang together with."""
    body = np.repeat(coarse.element_body, coarse.elements.shape[1])
    incidence = sparse.csr_array((np.ones(coarse.elements.size), (coarse.elements.ravel(), body)),
                                 shape=(coarse.n_nodes, len(coarse.bodies)))
    _, part = connected_components(incidence.T @ incidence, directed=False)
    rows = np.repeat(np.arange(fine.n_nodes), np.diff(nodal.indptr))
    below, above = nodes_of_bodies(fine)[rows], nodes_of_bodies(coarse, "coarse")[nodal.indices]
    wrong = np.flatnonzero((part[below] != part[above]) & (nodal.data != 0.0))
    if wrong.size:
        node, own, other = rows[wrong[0]], fine.bodies[below[wrong[0]]], coarse.bodies[above[wrong[0]]]
        raise ValueError(f"transfer.build of {transfer!r} lets node {node} of body {own!r} follow body {other!r}: "
                         "build the rows of each body from its own nodes (mesh.element_body tells which they are)")


def _along(coarse: MeshArrays, fine: MeshArrays, boundary: str, nodes: np.ndarray
           ) -> tuple[np.ndarray, sparse.csr_array]:
    """Nodes and their rows of interpolation along a boundary."""
    return nodes, surface_interpolation(coarse, fine, coarse.boundary_facets(boundary), nodes)


def _among(known: np.ndarray, rows: sparse.csr_array, points: np.ndarray, coarse_points: np.ndarray
           ) -> sparse.csr_array:
    """Rows with sum 1 over the columns ``known`` alone: scaled, or 1 at the nearest."""
    kept = sparse.csr_array(rows @ sparse.diags_array(np.isin(np.arange(rows.shape[1]), known).astype(float)))
    sums = np.asarray(kept.sum(axis=1)).ravel()
    lost = np.flatnonzero(sums <= 1e-10)
    nearest = known[cKDTree(coarse_points[known]).query(points[lost])[1]]
    filled = sparse.csr_array((np.ones(len(lost)), (lost, nearest)), shape=rows.shape)
    scale = np.divide(1.0, sums, out=np.zeros_like(sums), where=sums > 1e-10)
    result = sparse.csr_array(sparse.diags_array(scale) @ kept + filled)
    result.eliminate_zeros()
    return result
