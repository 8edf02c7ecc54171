r"""Prolongations between two levels of a contact problem: rows of contact nodes, and relative coordinates of bodies.

On curved or non-nested contact boundaries a fine contact node lies inside or outside the coarse mesh, and a
prolongation between the volumes gives it weights of inner coarse nodes, without contact conditions. Here it
is projected onto the nearest coarse contact facet and takes the weights there:

.. math:: P_{ik} \ge 0, \qquad \sum_k P_{ik} = 1, \qquad k \text{ coarse contact nodes only},

which is what the proof of the monotone correction needs (see :mod:`adaptmg.transfer.constraints`). Affine fields are
reproduced at the projected points, so on curved boundaries up to O(h_coarse^2).

With the nodal prolongation P of displacements and the couplings W_f, W_c of the two levels there are two forms for
relative values w: :math:`P_w = (I - W_f)\,P\,(I - W_c)^{-1}`, which spans the same space as P, rigid motions of all
bodies included; and the same with the rows of the slave nodes replaced by interpolation of relative values along the
coarse slave surface, weights >= 0 with sums 1 over the coarse slave nodes of the pair, for the monotone correction.
Other coarse nodes of the surface (where it hangs over, or belongs to another pair) have no values relative to this
master: those next to them take over their weights.

The two faces of a crack lie at one place. Nodes on a face are interpolated along the coarse one, whatever the transfer
does elsewhere and whether they are in contact; so are inner nodes between the meshes of a curved face, which lie inside
the fine one and outside the coarse one, that is on the other side of the coarse crack.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from adaptmg import _checks as checks
from adaptmg.discrete.contact_nodes import ContactNodes, largest_entry
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.geometry.search import BoxTree
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.transfer.interpolation import Transfer, csr_from_weights, nodes_of_bodies


def surface_interpolation(coarse: MeshArrays, fine: MeshArrays, coarse_boundary_facets: np.ndarray,
                          fine_nodes: np.ndarray) -> sparse.csr_array:
    """Interpolate at fine contact nodes (n,) from the nearest coarse contact facet.

    Entries are >= 0, with row sums 1, at most dim in a row. The facets (n_facets, dim) hold coarse nodes, as
    ``coarse.boundary_facets(name)`` does; the nearest is exact, on graded boundaries too.
    """
    facets = coarse_boundary_facets
    if facets.ndim != 2 or not len(facets) or not 0 <= facets.min() <= facets.max() < coarse.n_nodes:
        raise ValueError(f"coarse_boundary_facets must hold nodes of coarse, a row a facet, got shape {facets.shape}")
    facet, weights, _ = BoxTree(coarse.points, facets).nearest(fine.points[fine_nodes])
    return csr_from_weights(facets[facet], weights, coarse.n_nodes)


def with_contact_rows(P: sparse.csr_array, fine_nodes: np.ndarray, rows: sparse.csr_array) -> sparse.csr_array:
    """Return a nodal prolongation (n_fine, n_coarse) with other rows (n, n_coarse) for distinct fine nodes (n,)."""
    nodes = checks.array("fine_nodes", fine_nodes, (None,), integer=True)
    if rows.shape != (len(nodes), P.shape[1]) or len(np.unique(nodes)) < len(nodes):
        raise ValueError(f"rows must have shape ({len(nodes)}, {P.shape[1]}), one for each of distinct fine_nodes, got "
                         f"{rows.shape}")
    row_of = np.arange(P.shape[0])
    row_of[nodes] = P.shape[0] + np.arange(len(nodes))
    return checks.narrowed(sparse.csr_array(sparse.vstack([P, rows], format="csr")[row_of]))


@dataclass(frozen=True, eq=False)
class LevelTransfer:
    """Nodal prolongations from a level to the next finer."""

    prolongation: sparse.csr_array  # (n_nodes, n_nodes coarse) csr_array: of relative values where there is a coupling
    surface: sparse.csr_array | None = None


def between_levels(transfer: Transfer, coarse: MeshArrays, fine: MeshArrays, coarse_problem: DiscreteProblem,
                   fine_problem: DiscreteProblem, contact_rows: bool = True) -> LevelTransfer:
    """Return prolongations between the discretisations of one problem on two meshes."""
    nodal = _built(transfer, coarse, fine)
    contact, coupling = fine_problem.contact, fine_problem.coupling
    if coupling is not None:
        _check_bodies(nodal, coarse, fine, transfer)
    slave_rows = [_along(coarse, fine, name, contact.nodes[contact.boundary == k])
                  for k, name in enumerate(contact.names)]
    for face, other in _crack_faces(fine, contact):
        nodal = with_contact_rows(nodal, *_along(coarse, fine, face, _on_side(nodal, coarse, fine, face, other)))
    if contact_rows:
        master_rows = [_along(coarse, fine, name, fine.boundary_nodes(name)) for name in contact.masters if name]
        for nodes, rows in (*master_rows, *slave_rows):
            nodal = with_contact_rows(nodal, nodes, rows)
    relative = nodal if coupling is None else coupling.prolongation(nodal, coarse_problem.coupling)
    surface, above = relative, coarse_problem.contact
    # others are held: no coarse bound limits what they would pass to fine contact nodes
    passes = np.isin(np.arange(coarse.n_nodes), above.nodes) | coarse_problem.fixed.reshape(-1, coarse.dim).all(axis=1)
    for k, (nodes, rows) in enumerate(slave_rows):
        known = above.nodes[above.boundary == k]
        if contact.masters[k]:
            surface = with_contact_rows(surface, nodes, _among(known, rows, fine.points[nodes], coarse.points))
        elif contact_rows and not passes[rows.indices].all():
            data = np.where(passes[rows.indices], rows.data, 0.0)
            rows = sparse.csr_array((data, rows.indices, rows.indptr), shape=rows.shape)
            surface = with_contact_rows(surface, nodes, rows)
    return LevelTransfer(relative, None if surface is nodal else surface)


def _crack_faces(mesh: MeshArrays, contact: ContactNodes) -> list[tuple[str, str]]:
    """Each face of a crack, and the other one: pairs, or called left and right, that share nodes."""
    pairs = [*zip(contact.names, contact.masters, strict=True),
             *((name, name.removesuffix("left") + "right") for name in mesh.boundaries if name.endswith(".left"))]
    shared = [pair for pair in dict.fromkeys(pairs) if set(pair) <= set(mesh.boundaries)
              and len(np.intersect1d(*map(mesh.boundary_nodes, pair)))]
    return [faces for pair in shared for faces in (pair, pair[::-1])]


def _on_side(nodal: sparse.csr_array, coarse: MeshArrays, fine: MeshArrays, face: str, other: str) -> np.ndarray:
    """Fine nodes on a face, and inner ones between it and the coarse one, of those that follow the other coarse one."""
    near = np.flatnonzero(abs(nodal) @ np.isin(np.arange(coarse.n_nodes), coarse.boundary_nodes(other)))
    between = np.ones(len(near), dtype=bool)
    for mesh, sign in ((coarse, 1), (fine, -1)):
        surface = mesh.surface(face)
        facet, weights, _ = BoxTree(mesh.points, surface.facets).nearest(fine.points[near])
        foot = np.einsum("nk,nkd->nd", weights, mesh.points[surface.facets[facet]])
        between &= sign * np.einsum("nd,nd->n", fine.points[near] - foot, surface.normals[facet]) > 0
        # a node ahead of a tip is on neither side
        between &= (weights * np.isin(surface.facets[facet], mesh.boundary_nodes(other))).sum(axis=1) < 1
    return np.union1d(fine.boundary_nodes(face), near[between])


def _built(transfer: Transfer, coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array:
    returned, wanted = transfer.build(coarse, fine), (fine.n_nodes, coarse.n_nodes)
    if sparse.issparse(returned) and returned.shape != wanted:
        raise ValueError(f"transfer.build must return a matrix of shape {wanted} (fine, coarse nodes), "
                         f"got {returned.shape}")
    nodal = checks.sparse_matrix(f"what transfer.build of {checks.shown(transfer)} returns", returned)
    nodal = sparse.csr_array(nodal, dtype=np.float64)
    if not nodal.has_sorted_indices:  # products sort in place, and prolongations are read-only
        nodal = nodal.sorted_indices()
    largest = largest_entry(nodal.data)
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
    return nodes, surface_interpolation(coarse, fine, coarse.boundary_facets(boundary), nodes)


def _among(known: np.ndarray, rows: sparse.csr_array, points: np.ndarray, coarse_points: np.ndarray
           ) -> sparse.csr_array:
    """Rows with sum 1 over the columns ``known`` alone: scaled, or 1 at the nearest; zero without any."""
    if not len(known):
        return sparse.csr_array(rows.shape)
    kept = sparse.csr_array(rows @ sparse.diags_array(np.isin(np.arange(rows.shape[1]), known).astype(float)))
    sums = np.asarray(kept.sum(axis=1)).ravel()
    lost = np.flatnonzero(sums <= 1e-10)
    from scipy.spatial import cKDTree  # a first solve without it starts sooner

    nearest = known[cKDTree(coarse_points[known]).query(points[lost])[1]]
    filled = sparse.csr_array((np.ones(len(lost)), (lost, nearest)), shape=rows.shape)
    scale = np.divide(1.0, sums, out=np.zeros_like(sums), where=sums > 1e-10)
    result = sparse.csr_array(sparse.diags_array(scale) @ kept + filled)
    result.eliminate_zeros()
    return result
