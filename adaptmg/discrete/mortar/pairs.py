r"""Contact between two surfaces of the mesh: which slave nodes face what, at which gap.

Surfaces are made of facets. Where two curved surfaces fit each other, their facets overlap by up to the heights of
both facets under the arcs, about :math:`\tfrac14 h\,|n_i - n_F|` with the averaged normal :math:`n_i` at a corner of
facet F: negative gaps above minus that are the discretisation, not interference, and are taken as zero.

A slave node of whose part less than a quarter has the master opposite (where the slave hangs over) carries no
multiplier: its dual function would be large, of the order of one over the covered fraction, and with it the entries of
the coupling, which spoils the smoothing. The multipliers next to it take over, so that constant pressures stay exact.

Where the meshes match, node j may face the one master node k(j) nearest to it (:func:`node_to_node`):
:math:`B_{jk} = \delta_{k,k(j)}`, with

.. math:: g_j = (x_{k(j)} - x_j)\cdot n_j, \qquad w_j = \int\phi_j

over the slave surface (in axisymmetry with :math:`2\pi r`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.mortar.interface import NEVER_FACING, MortarInterface, Surfaces, slave_normals
from adaptmg.discrete.mortar.segments import mortar_2d
from adaptmg.discrete.mortar.triangles import mortar_3d
from adaptmg.discrete.supports import HeldNodes
from adaptmg.mesh.arrays import MeshArrays, Surface
from adaptmg.problem.surfaces import ContactPair

_ROUNDING = 1e-12  # of the bodies' size
_LEAST_COVERED = 0.25  # of the part of a slave node
_OFFSET = 1e-2  # of the shortest edge of facets at a slave node: how far off its normal its partner may lie


def pair_interface(mesh: MeshArrays, pair: ContactPair, *, held: HeldNodes, excluded: np.ndarray,
                   axisymmetric: bool) -> MortarInterface:
    """Return the interface of a pair."""
    slave, master = mesh.surface(pair.slave), mesh.surface(pair.master)
    if np.isin(slave.nodes, excluded).all():  # a coarse mesh may have no other
        nothing = sparse.csr_array((0, mesh.n_nodes))
        return MortarInterface(slave.nodes[:0], np.empty((0, mesh.dim)), np.empty(0), np.empty(0), nothing, np.empty(0))
    what = f"contact pair {pair.slave!r} on {pair.master!r}"
    try:
        surfaces = Surfaces(slave, master, slave_normals(slave, held), excluded, axisymmetric)
        found = _coupled(pair, surfaces)
        # slave nodes of which the master covers too little
        hanging = found.nodes[found.weights < _LEAST_COVERED * slave.lumped(axisymmetric)[found.nodes]]
        if 0 < len(hanging) < len(found) and pair.coupling == "mortar":
            found = _coupled(pair, replace(surfaces, excluded=np.union1d(excluded, hanging)))
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error
    gaps = found.gaps.copy()
    if pair.gap is not None:
        gaps = checks.field(f"gap of {what}", pair.gap, mesh.points[found.nodes])
        # a row that slave nodes without a multiplier take part in measures their gaps with its own
        silent = np.setdiff1d(slave.nodes, found.nodes)
        if len(silent):
            gaps = gaps - found.coupling[:, silent] @ checks.field(f"gap of {what}", pair.gap, mesh.points[silent])
    if not pair.allow_interference:
        tolerance = np.full(len(gaps), _ROUNDING * surfaces.size)
        if pair.gap is None:
            tolerance += _facet_heights(slave)[found.nodes] + _facet_heights(master).max()
            # the surfaces themselves must overlap, and not only a mean of their distance with weights of both signs
            tolerance[found.closest >= -tolerance] = np.inf
        wrong = np.flatnonzero(gaps < -tolerance)
        if len(wrong):
            deepest = wrong[np.argmin(gaps[wrong])]
            raise ValueError(f"{what}: the bodies overlap by up to {-gaps[deepest]:.6g} m at the start, at "
                             f"{tuple(mesh.points[found.nodes[deepest]].tolist())}: move one of them apart, or "
                             "say allow_interference=True for an interference fit")
        gaps = np.maximum(gaps, 0.0)
    return replace(found, gaps=gaps)


def _coupled(pair: ContactPair, surfaces: Surfaces) -> MortarInterface:
    if pair.coupling == "nodes":
        return node_to_node(surfaces)
    return (mortar_2d if surfaces.points.shape[1] == 2 else mortar_3d)(surfaces, pair.reach)


def _edge_lengths(surface: Surface) -> np.ndarray:
    """Lengths (n, dim) of the edges of facets; in 2D each twice."""
    corners = surface.points[surface.facets]
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)


def _facet_heights(surface: Surface) -> np.ndarray:
    """At nodes (n_nodes,) of a surface the largest height of a facet there under the arc, about, m; zero elsewhere."""
    length = _edge_lengths(surface).max(axis=1)
    result = np.zeros(len(surface.points))
    for corner in surface.facets.T:
        turn = np.linalg.norm(surface.node_normals[corner] - surface.normals, axis=1)
        np.maximum.at(result, corner, 0.25 * length * turn)
    return result


def node_to_node(surfaces: Surfaces) -> MortarInterface:
    """Couple each node of a slave surface to the nearest node of a master surface."""
    points, normals = surfaces.points, surfaces.normals
    nodes = np.flatnonzero(surfaces.carries)
    from scipy.spatial import cKDTree  # a first solve without it starts sooner

    facing = surfaces.master_side.nodes
    partner = facing[cKDTree(points[facing]).query(points[nodes])[1]]
    apart, normal = points[partner] - points[nodes], normals[nodes]
    gaps = np.einsum("nd,nd->n", apart, normal)
    offset = np.linalg.norm(apart - gaps[:, None] * normal, axis=1)
    _check_partners(surfaces, nodes, partner, offset)
    weights = surfaces.slave_side.lumped(surfaces.axisymmetric)[nodes]
    if not weights.min() > 0:
        raise ValueError(f"slave node {nodes[int(np.argmin(weights))]} has no area: its facets lie on the axis of "
                         "symmetry; end the boundary there")
    coupling = sparse.csr_array((np.ones(len(nodes)), (np.arange(len(nodes)), partner)),
                                shape=(len(nodes), len(points)))
    return MortarInterface(nodes=nodes, normals=normal, weights=weights, gaps=gaps, coupling=coupling, closest=gaps)


def _check_partners(surfaces: Surfaces, nodes: np.ndarray, partner: np.ndarray, offset: np.ndarray) -> None:
    points, shortest = surfaces.points, np.full(len(surfaces.points), np.inf)
    np.minimum.at(shortest, surfaces.slave, _edge_lengths(surfaces.slave_side).min(axis=1)[:, None])
    allowed, vectors = _OFFSET * shortest[nodes], np.zeros(points.shape)
    for corner in surfaces.master.T:
        np.add.at(vectors, corner, surfaces.master_side.vectors)
    facing = np.einsum("nd,nd->n", vectors[partner], surfaces.normals[nodes]) < 0
    if not facing.any():
        raise ValueError(f"{NEVER_FACING}: the normals of slave nodes and of their partners point the same way. Check "
                         "the orientation of the facets")
    missing = np.flatnonzero((offset > allowed) | ~facing)
    if len(missing):
        i = missing[0]
        raise ValueError(f"slave node {nodes[i]} {tuple(points[nodes[i]].tolist())} has no partner: the nearest master "
                         f"node {partner[i]} {tuple(points[partner[i]].tolist())} lies {offset[i]:.3g} m off its "
                         f"normal, {allowed[i]:.3g} m are allowed{'' if facing[i] else ', and faces the same way'} "
                         f"({len(missing)} such nodes of {len(nodes)}). Use matching meshes or a mortar coupling")
    taken, index = np.unique(partner, return_index=True)
    if len(taken) < len(partner):
        i = np.setdiff1d(np.arange(len(partner)), index)[0]
        raise ValueError(f"slave node {nodes[i]} {tuple(points[nodes[i]].tolist())} has the same partner {partner[i]} "
                         "as another one: the meshes do not match; use a mortar coupling")
