r"""The coupling of the contact nodes of a slave surface to the surface of another body by dual mortar
multipliers.

The point opposite slave node j moves by :math:`\sum_k B_{jk} u_k`, a combination of the nodes of
the master surface with :math:`\sum_k B_{jk} = 1`. Non-penetration of the bodies is then nodal,
:math:`n_j\cdot(u_j - \sum_k B_{jk} u_k) \le g_j`, and a contact force on slave node j acts with the weights
:math:`-B_{jk}` on the master (B. Wohlmuth, Acta Numerica 20, 2011, doi:10.1017/S0962492911000079).

Parts of slave facets are found that have a part of a master facet opposite
(:mod:`adaptmg.discrete.mortar_parts`), at the distance g along the normal. With A, c and S,
measure, centroid and covariance of what is covered of a slave facet, and its corners :math:`x_j`,
the dual basis :math:`\psi = \mathrm{diag}(d)\,m^{-1}\phi` over the covered part (:math:`d_j =
\int\phi_j`, :math:`m_{ij} = \int\phi_i\phi_j`) is

.. math:: \psi_j(x) = \phi_j(c)\,\bigl(1 + (x_j - c)\cdot S^{-1}(x - c)\bigr),

which adds up to 1, is biorthogonal, and reproduces constants and linear functions however little is
covered;

.. math:: D_{jj} = \int\phi_j = A\,\phi_j(c),\quad M_{jk} = \int\psi_j\,\phi_k^{\mathrm{master}},\quad B = D^{-1}M,
   \quad g_j = D_{jj}^{-1}\int\psi_j\,g .

In axisymmetry all integrals carry :math:`2\pi r`. Where corners b of a facet carry no multiplier,
theirs are shared out evenly among its r corners a that do (crosspoint modification): :math:`\psi_a
+ \frac1r\sum_b\psi_b` add up to 1 and are biorthogonal on these corners, and :math:`D_{ab} =
\frac1r\int\phi_b` makes b one of the nodes that a follows:
:math:`u_a - (\sum_k M_{ak} u_k - \sum_b D_{ab} u_b)/D_{aa}`. Where no corner of a facet carries one,
at corners of a surface in space, those of the facets around it take over.

Surfaces are made of facets. Where the domain knows the surfaces that both are chords of
(:mod:`adaptmg.mesh.exact`), g is the distance between these; weights and couplings stay those of
the facets. Elsewhere facets of curved surfaces that fit each other overlap by up to
the heights of both facets under the arcs, about :math:`\tfrac14 h\,|n_i - n_F|` with the averaged
normal :math:`n_i` at a corner of facet F: negative gaps above minus that are the discretisation,
not interference, and are taken as zero.

A slave node of whose part less than a quarter has the master opposite (where the slave hangs over)
carries no multiplier: its dual function would be large, of the order of one over the covered
fraction, and with it the entries of the coupling, which spoils the smoothing. The multipliers next
to it take over, so that constant pressures stay exact.

Where the meshes match, node j may face the one master node k(j) nearest to it
(:func:`node_to_node`); nodes without a multiplier are taken over as in front of an obstacle:
:math:`B_{jk} = \delta_{k,k(j)}`, with

.. math:: g_j = (x_{k(j)} - x_j)\cdot n_j, \qquad w_j = \int\phi_j

over the slave surface (in axisymmetry with :math:`2\pi r`).

Sources: B. Wohlmuth, SIAM J. Numer. Anal. 38, 2000, doi:10.1137/S0036142999350929 (dual
multipliers); A. Popp, M. Gitterle, M. Gee, W. Wall, Int. J. Numer. Meth. Engng 83, 2010,
doi:10.1002/nme.2866 (in 3D); T. Cichosz, M. Bischoff, Comput. Methods Appl. Mech. Engrg 200, 2011,
doi:10.1016/j.cma.2010.11.004 (over the covered part).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, cast

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.supports import Boundaries
from adaptmg.mesh.arrays import MeshArrays, Surface, mask_of
from adaptmg.mesh.surfaces import Curved, Revolved
from adaptmg.problem.surfaces import ContactPair

if TYPE_CHECKING:
    from adaptmg.discrete.mortar_parts import CoveredParts, Surfaces

NEVER_FACING = "the surfaces never face each other"
"""With these words the message begins when no part of the slave surface has the master surface opposite."""

# a slave node of which the master covers a smaller share does not carry contact; half gives 21 of 160
# random pairs more contact nodes, twice 32 fewer
_LEAST_COVERED = 0.25
# distance, over the shortest edge of facets at a slave node, at which its partner may lie off its
# normal: half changes none of these pairs, twice takes one more of 40 whose nodes lie up to 3 % of an
# edge apart
_OFFSET = 1e-2


@dataclass(frozen=True, eq=False)
class MortarInterface:
    """Contact nodes of a boundary (of a pair the slave nodes with a multiplier), and their coupling to
    the nodes that they face."""

    nodes: np.ndarray  # (n,) int: slave nodes, ascending
    #: (n, dim): unit normals n, out of the slave body; in front of an obstacle n / |P n| of adaptmg.discrete.obstacles
    normals: np.ndarray
    #: (n,): measure of the surface that belongs to each node, > 0: m in 2D, m^2 in 3D and in axisymmetry, over the full
    #: circumference
    weights: np.ndarray
    gaps: np.ndarray  # (n,): initial gap along the normal, m; negative where the bodies overlap
    #: (n, n_nodes): B, rows with sum 1, some entries negative; its columns are nodes of the master surface, and slave
    #: nodes without a multiplier. In front of an obstacle minus the shares of nodes that each node takes over; None if
    #: there are none
    coupling: sparse.csr_array | None = None
    #: (n,): smallest distance between the surfaces around each node, m, by which overlaps are recognised: a dual
    #: function changes sign, so that its mean of a distance >= 0 may be negative
    closest: np.ndarray | None = None
    #: (n, n_nodes): measures that each node takes over from nodes of its surface without a
    #: multiplier, over its own weight
    taken_over: sparse.csr_array | None = None

    def __len__(self) -> int:
        return len(self.nodes)


def spread(
    parts: Sequence[tuple[np.ndarray, sparse.csr_array | None]], n_nodes: int
) -> sparse.csr_array | None:
    """Return the matrix (n_nodes, n_nodes) of ``parts``, each of which has nodes (n,) and their rows (n,
    n_nodes), or None in place of rows; None if there are no rows."""
    present = [(nodes, rows) for nodes, rows in parts if rows is not None]
    if not present:
        return None
    rows = np.concatenate([np.repeat(nodes, np.diff(rows.indptr)) for nodes, rows in present])
    columns = np.concatenate([rows.indices for _, rows in present])
    values = np.concatenate([rows.data for _, rows in present])
    return sparse.csr_array((values, (rows, columns)), shape=(n_nodes, n_nodes))


def with_images(
    interface: MortarInterface, images: np.ndarray, originals: np.ndarray
) -> MortarInterface:
    """Return an interface in which nodes j take over their ``images`` i (m,) on periodic sides: the
    condition of j is the sum of its own and of w_i/w_j times that of each image, where w are the
    weights. ``originals`` (n_nodes,) are the nodes that others are images of; they keep their normals."""
    is_image = np.isin(interface.nodes, images)
    kept = ~is_image
    nodes = interface.nodes[kept]
    weights = interface.weights[kept]
    image_nodes = interface.nodes[is_image]
    rows = np.searchsorted(nodes, originals[image_nodes])
    shares = interface.weights[is_image] / weights[rows]
    image_rows = np.arange(len(image_nodes))
    of_images = sparse.csr_array((shares, (rows, image_rows)), shape=(len(nodes), len(image_nodes)))
    V = sparse.csr_array((shares, (rows, image_nodes)), shape=(len(nodes), len(originals)))

    def summed(values: sparse.csr_array | None) -> sparse.csr_array:
        """Return the rows of the nodes that are kept, with those of their images added."""
        return (
            sparse.csr_array(V.shape)
            if values is None
            else sparse.csr_array(values[kept] + of_images @ values[is_image])
        )

    return MortarInterface(
        nodes=nodes,
        normals=interface.normals[kept],
        weights=weights,
        gaps=interface.gaps[kept] + of_images @ interface.gaps[is_image],
        coupling=sparse.csr_array(summed(interface.coupling) - V),
        taken_over=sparse.csr_array(summed(interface.taken_over) + V),
    )


def curved(
    mesh: MeshArrays, sides: tuple[Surface, Surface], exact: Sequence[Sequence[Revolved] | None]
) -> tuple[Surface, Surface]:
    """Return slave and master with their ``exact`` surfaces, those of the slave and of the master, None
    where they are not known; unchanged unless both are known and not all plane: where chords of both
    sides match, their heights cancel, so that exact distances to one side alone would be gaps."""
    slave, master = exact
    if not slave or not master or all(surface.plane for surface in (*slave, *master)):
        return sides
    slave_surface, master_surface = (
        Curved(mesh.points, side.facets, surfaces, bisected=mesh.refinement is not None)
        for surfaces, side in zip((slave, master), sides, strict=True)
    )
    # a mesh that was moved away from the domain lies far from its surfaces, where ``nearest`` is -1
    known = all(np.median(side.nearest) >= 0 for side in (slave_surface, master_surface))
    return (slave_surface, master_surface) if known else sides


def pair_interface(
    boundaries: Boundaries, pair: ContactPair, sides: tuple[Surface, Surface], excluded: np.ndarray
) -> MortarInterface:
    """Return the interface of a pair with these sides; ``excluded`` nodes carry no multiplier."""
    mesh = boundaries.mesh
    axisymmetric = boundaries.problem.axisymmetric
    slave, master = sides
    if np.isin(slave.nodes, excluded).all():  # a coarse mesh may have no other
        return MortarInterface(
            nodes=slave.nodes[:0],
            normals=np.empty((0, mesh.dim)),
            weights=np.empty(0),
            gaps=np.empty(0),
            coupling=sparse.csr_array((0, mesh.n_nodes)),
            closest=np.empty(0),
        )
    named_pair = f"contact pair {pair.slave!r} on {pair.master!r}"
    from adaptmg.discrete.mortar_parts import Surfaces  # problems without pairs start sooner

    try:
        normals = boundaries.averaged_normals(slave)
        surfaces = Surfaces(slave, master, normals, excluded, axisymmetric)
        couple = node_to_node if pair.coupling == "nodes" else partial(mortar, reach=pair.reach)
        interface = couple(surfaces)
        # slave nodes of which the master covers too little, none with the coupling "nodes", which has the
        # weights of whole facets. If all hang over they stay: there would be no contact
        hanging = interface.nodes[
            interface.weights < _LEAST_COVERED * slave.lumped(axisymmetric)[interface.nodes]
        ]
        if 0 < len(hanging) < len(interface):
            interface = couple(replace(surfaces, excluded=np.union1d(excluded, hanging)))
    except ValueError as error:
        raise ValueError(f"{named_pair}: {error}") from error
    if pair.gap is not None:
        gaps = checks.field(f"gap of {named_pair}", pair.gap, mesh.points[interface.nodes])
        # a row takes over slave nodes b without a multiplier: its condition is u_a - ... + sum_b V_ab u_b, so
        # that its gap is g_a + sum_b V_ab g_b, with V_ab = -B_ab. A node that both surfaces share, as the
        # tip of a crack, has B_ab = 0 where facets match: nothing opens there, and the gap given there does
        # not count
        without_multiplier = np.setdiff1d(slave.nodes, interface.nodes)
        if len(without_multiplier):
            gaps = gaps - cast("sparse.csr_array", interface.coupling)[
                :, without_multiplier
            ] @ checks.field(f"gap of {named_pair}", pair.gap, mesh.points[without_multiplier])
        interface = replace(interface, gaps=gaps)
    if not pair.allow_interference:
        _check_overlap(interface, surfaces, named_pair, with_heights=pair.gap is None)
        interface = replace(interface, gaps=np.maximum(interface.gaps, 0.0))
    return interface


def _check_overlap(
    interface: MortarInterface, surfaces: Surfaces, named_pair: str, with_heights: bool
) -> None:
    """Raise ValueError if bodies overlap at the start: by more than rounding, and, ``with_heights``, by
    more than the heights of facets under the arcs that they are chords of."""
    slave = surfaces.slave_side
    gaps = interface.gaps
    # nodes lie on exact surfaces as well as a mesher or a file puts them there
    rounding = checks.ALIKE if isinstance(slave, Curved) else checks.ROUNDING
    tolerance = np.full(len(gaps), rounding * surfaces.size)
    if with_heights:
        heights_of_master = _facet_heights(surfaces.master_side)
        tolerance += _facet_heights(slave)[interface.nodes] + heights_of_master.max()
        # the surfaces themselves must overlap, not only a mean of their distance with weights of both
        # signs
        tolerance[interface.closest >= -tolerance] = np.inf
    overlapping = np.flatnonzero(gaps < -tolerance)
    if len(overlapping):
        deepest = overlapping[np.argmin(gaps[overlapping])]
        place = surfaces.points[interface.nodes[deepest]]
        raise ValueError(
            f"{named_pair}: the bodies overlap by up to {-gaps[deepest]:.6g} m at the start, at "
            f"{tuple(place.tolist())}: move one of them apart, or say allow_interference=True for an "
            "interference fit"
        )


def _shares(surface: Surface, carries: np.ndarray, axisymmetric: bool) -> sparse.csr_array:
    """Return the shares (n_nodes, n_nodes), rows with sum 1, with which nodes that carry multipliers,
    columns, stand for each node of a surface: a node that carries one for itself, the nearest ones
    for others. ``carries`` is a mask (n_nodes,)."""
    n = len(surface.points)
    corners = surface.facets.shape[1]
    integrals = np.repeat(surface.shape_integrals(axisymmetric), corners, axis=1)
    mass = _assembled(integrals, surface.facets, surface.facets, n)
    shares = sparse.diags_array(carries.astype(float), format="csr")
    is_reached = carries.copy()
    while True:  # each pass reaches further nodes, or is the last
        reached_mass = mass @ is_reached
        newly_reached = (reached_mass > 0) & ~is_reached
        if not newly_reached.any():
            break
        scale = np.divide(1.0, reached_mass, out=np.zeros(n), where=newly_reached)
        new_shares = sparse.diags_array(scale) @ mass @ sparse.diags_array(is_reached.astype(float))
        # the shares of a new node are proportional to its entries of the mass matrix
        shares = sparse.csr_array(shares + new_shares @ shares)
        is_reached |= newly_reached
    return shares


def taken_over(
    surface: Surface, carries: np.ndarray, axisymmetric: bool, giving: np.ndarray | None = None
) -> sparse.csr_array:
    """Return the measures E_ji w_i (n_nodes, n_nodes) that nodes j with multipliers, rows, take over
    from nodes i without one, columns, of which each gives away its boundary measure w_i by the shares
    E_ji. ``carries`` is the mask (n_nodes,) of nodes with multipliers; with a mask ``giving`` only
    nodes in it give their measure away."""
    if carries[surface.nodes].all():  # as of most boundaries
        return sparse.csr_array((len(carries), len(carries)))
    shares = _shares(surface, carries, axisymmetric)  # E'
    gives = ~carries if giving is None else giving & ~carries
    measures = np.where(gives, surface.lumped(axisymmetric), 0.0)
    result = sparse.csr_array(shares.T @ sparse.diags_array(measures, format="csr"))
    result.eliminate_zeros()
    return result


def _edge_lengths(surface: Surface) -> np.ndarray:
    """Return the lengths (n, dim) of the edges of facets; in 2D each twice."""
    corners = surface.points[surface.facets]
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)


def chord_heights(surface: Surface) -> np.ndarray:
    """Return approximate heights of facets under the arcs that they are chords of, 0 where the arcs are
    known, and the longest edges of the facets: (2, n), m."""
    length = _edge_lengths(surface).max(axis=1)
    turns = surface.node_normals[surface.facets] - surface.normals[:, None]
    # h |n_i - n_F| / 4
    heights = 0.25 * length * np.linalg.norm(turns, axis=2).max(axis=1)
    known = isinstance(surface, Curved) and surface.behind >= 0
    return np.stack([np.where(known, 0.0, heights), length])


def _facet_heights(surface: Surface) -> np.ndarray:
    """Return the largest height of a facet at each node (n_nodes,) of a surface; zero elsewhere."""
    result = np.zeros(len(surface.points))
    np.maximum.at(result, surface.facets, chord_heights(surface)[0][:, None])
    return result


def node_to_node(surfaces: Surfaces) -> MortarInterface:
    """Couple each node j of a slave surface to the nearest node k(j) of a master surface.

    A node next to nodes i without a multiplier that have a partner takes them over: it carries the
    condition u_j - u_k(j) + sum_i E_ji w_i/w_j (u_i - u_k(i)), and so for the gaps. Nodes without a
    multiplier and without a partner, where the slave hangs over, give nothing away."""
    points = surfaces.points
    nodes = surfaces.slave_side.nodes
    from scipy.spatial import cKDTree  # a first solve without it starts sooner

    master_nodes = surfaces.master_side.nodes
    partner = master_nodes[cKDTree(points[master_nodes]).query(points[nodes])[1]]
    to_partner = points[partner] - points[nodes]
    normal = surfaces.normals[nodes]
    gaps = np.einsum("nd,nd->n", to_partner, normal)
    offset = np.linalg.norm(to_partner - gaps[:, None] * normal, axis=1)
    has_partner = _with_partners(surfaces, nodes, partner, offset)
    n = len(points)
    weights = surfaces.slave_side.lumped(surfaces.axisymmetric)
    # E_ji w_i / w_j; w is 0 at nodes off the surface, which take over nothing
    taken = sparse.diags_array(1 / np.where(weights > 0, weights, 1.0)) @ taken_over(
        surfaces.slave_side,
        surfaces.carries,
        surfaces.axisymmetric,
        giving=mask_of(nodes[has_partner], n),
    )
    partners = sparse.csr_array((np.ones(len(nodes)), (nodes, partner)), shape=(n, n))
    coupling = sparse.csr_array(partners + taken @ (partners - sparse.eye_array(n, format="csr")))
    taken_gaps = taken @ np.bincount(nodes, gaps, minlength=n)
    carries = surfaces.carries[nodes]
    carrying = nodes[carries]
    if not weights[carrying].min() > 0:
        raise ValueError(
            f"slave node {carrying[int(np.argmin(weights[carrying]))]} has no area: its facets lie on the "
            "axis of symmetry; end the boundary there"
        )
    return MortarInterface(
        nodes=carrying,
        normals=normal[carries],
        weights=weights[carrying],
        gaps=gaps[carries] + taken_gaps[carrying],
        coupling=_without_rounding(sparse.csr_array(coupling[carrying])),
        closest=gaps[carries],
        taken_over=sparse.csr_array(taken)[carrying],
    )


def _with_partners(
    surfaces: Surfaces, nodes: np.ndarray, partner: np.ndarray, offset: np.ndarray
) -> np.ndarray:
    """Return which slave nodes (n,) face their partners (n,), whose ``offset`` (n,) from the normal
    is small, m; ValueError if one with a multiplier does not."""
    points = surfaces.points
    # the shortest edge of the facets at each slave node
    shortest = np.full(len(surfaces.points), np.inf)
    np.minimum.at(shortest, surfaces.slave, _edge_lengths(surfaces.slave_side).min(axis=1)[:, None])
    allowed = _OFFSET * shortest[nodes]
    # sums of the area vectors of the master's facets at its nodes
    vectors = np.zeros(points.shape)
    for corner in surfaces.master.T:
        np.add.at(vectors, corner, surfaces.master_side.vectors)
    facing = np.einsum("nd,nd->n", vectors[partner], surfaces.normals[nodes]) < 0
    if not facing.any():
        raise ValueError(
            f"{NEVER_FACING}: the normals of slave nodes and of their partners point the same way. Check "
            "the orientation of the facets"
        )
    without_partner = (offset > allowed) | ~facing
    missing = np.flatnonzero(without_partner & surfaces.carries[nodes])
    if len(missing):
        i = missing[0]
        raise ValueError(
            f"slave node {nodes[i]} {tuple(points[nodes[i]].tolist())} has no partner: the nearest master "
            f"node {partner[i]} {tuple(points[partner[i]].tolist())} lies {offset[i]:.3g} m off its "
            f"normal, {allowed[i]:.3g} m are allowed{'' if facing[i] else ', and faces the same way'} "
            f"({len(missing)} such nodes of {len(nodes)}). Use matching meshes or a mortar coupling"
        )
    return ~without_partner


def mortar(surfaces: Surfaces, reach: float | None = None) -> MortarInterface:
    """Couple the nodes of a slave surface to a master surface by dual mortar functions: the matrices D
    and M of the module, and the gaps. The master is sought within ``reach``, m, on both sides of the
    slave; None: as :meth:`Surfaces.depths` says."""
    n_nodes = len(surfaces.points)
    carries = surfaces.carries[surfaces.slave]  # (n_slave, k): corners that have a multiplier
    parts = _covered_enough(surfaces, reach)
    measure, shape, dual = _dual_functions(parts)
    shape_integrals = measure[:, None] * shape  # of phi_j over the covered parts
    shares = _shares_in_facets(carries)
    # the test functions of corners at the points of parts, times the quadrature weights
    tests = parts.weights[:, None] * np.einsum("pij,pqj->piq", shares[parts.slave], dual)
    slave = surfaces.slave[parts.slave]
    M = _assembled(
        np.einsum("piq,pqk->pik", tests, parts.shapes),
        slave,
        surfaces.master[parts.master],
        n_nodes,
    )
    gap_integrals = np.bincount(
        slave.ravel(), np.einsum("piq,pq->pi", tests, parts.distances).ravel(), minlength=n_nodes
    )
    # D_aa at nodes a with a multiplier, and D_ab that they take over from nodes b without one
    D = np.bincount(
        surfaces.slave.ravel(), np.where(carries, shape_integrals, 0.0).ravel(), minlength=n_nodes
    )
    D_taken = None
    taken_in_facets = shares * np.where(carries, 0.0, shape_integrals)[:, None, :]
    if taken_in_facets.any():
        D_taken = _assembled(taken_in_facets, surfaces.slave, surfaces.slave, n_nodes)
    # nodes of which more than rounding is covered
    is_tested = checks.ROUNDING * surfaces.slave_side.lumped(surfaces.axisymmetric) < D
    nodes = np.flatnonzero(is_tested)
    if D_taken is not None and not np.any(carries, axis=1)[parts.slave].all():
        # facets of which no corner carries a multiplier are tested by the nodes around them
        node_shares = _shares(surfaces.slave_side, is_tested, surfaces.axisymmetric).T
        M = sparse.csr_array(node_shares @ M)
        D_taken = sparse.csr_array(node_shares @ D_taken)
        gap_integrals = node_shares @ gap_integrals
    # M_ak / D_aa, minus D_ab / D_aa
    over_D = sparse.diags_array(1 / D[nodes], format="csr")
    coupling = over_D @ M[nodes]
    if D_taken is not None:
        D_taken = sparse.csr_array(over_D @ D_taken[nodes])
        D_taken.eliminate_zeros()
        coupling = coupling - D_taken
    closest = np.full(n_nodes, np.inf)
    np.minimum.at(closest, slave, parts.distances.min(axis=1)[:, None])
    return MortarInterface(
        nodes=nodes,
        normals=surfaces.normals[nodes],
        weights=D[nodes],
        gaps=gap_integrals[nodes] / D[nodes],
        coupling=_without_rounding(sparse.csr_array(coupling)),
        closest=closest[nodes],
        taken_over=D_taken,
    )


def _covered_enough(surfaces: Surfaces, reach: float | None) -> CoveredParts:
    """Return the parts, covered within ``reach`` as in :func:`mortar`, of the slave facets of which more
    than a sliver is covered; ValueError if none of these facets has a corner with a multiplier."""
    from adaptmg.discrete.mortar_parts import covered_parts

    covered = covered_parts(surfaces, reach)
    parts = covered.only(covered.enough[covered.slave])
    if surfaces.carries[surfaces.slave[parts.slave]].any():
        return parts
    if len(covered.slave):
        raise ValueError(
            "the surfaces face each other only where slave nodes are excluded, or on a sliver of each "
            "facet; take the other surface as slave"
        )
    within_reach = "" if reach is None else f" within a reach of {reach:.6g} m"
    raise ValueError(
        f"{NEVER_FACING}{within_reach}: no ray along a normal of the slave surface meets the outer side of "
        "the master surface. Check their positions and the orientation of their facets, or give a "
        "larger reach"
    )


def _shares_in_facets(carries: np.ndarray) -> np.ndarray:
    """Return the shares (n, k, k) with which corner a of a facet, rows, tests with the dual function
    psi_b of corner b, columns, by the mask (n, k) of corners that carry a multiplier. Such a corner
    tests with all of psi_a and with an equal part of psi_b for each corner b without a multiplier.
    Where no corner of a facet carries a multiplier, each tests with its psi_a."""
    taken = carries[:, :, None] * ~carries[:, None, :]
    n_carrying = np.maximum(carries.sum(axis=1), 1)[:, None, None]
    tests = carries | ~np.any(carries, axis=1)[:, None]
    return taken / n_carrying + np.eye(carries.shape[1]) * tests[:, :, None]


def _assembled(
    values: np.ndarray, rows: np.ndarray, columns: np.ndarray, n_nodes: int
) -> sparse.csr_array:
    """Return the matrix (n_nodes, n_nodes) to which pairs of facets give the blocks ``values`` (n, k, k),
    in the rows of the nodes ``rows`` (n, k) and the columns of the nodes ``columns`` (n, k)."""
    k = rows.shape[1]
    ends = np.repeat(rows, k, axis=1).ravel(), np.tile(columns, (1, k)).ravel()
    return sparse.csr_array((values.ravel(), ends), shape=(n_nodes, n_nodes))


def _dual_functions(parts: CoveredParts) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the measures (n_slave,) of the covered parts of slave facets, shape functions (n_slave,
    dim) at their centroids, and dual functions (n, n_points, dim) at the points of the parts."""
    measure, centroid, from_centroid, covariance = parts.means()
    corners = np.swapaxes(parts.corners - centroid[:, None], 1, 2)
    n, k = corners.shape[::2]
    # phi(c): sum phi_j = 1 and sum phi_j (x_j - c) = 0
    shape = np.linalg.solve(np.concatenate([np.ones((n, 1, k)), corners], axis=1), np.eye(k)[0])
    # psi_j = phi_j(c) (1 + (x - c) . S^-1 (x_j - c))
    weighted_corners = np.linalg.solve(covariance, corners)
    return (
        measure,
        shape,
        shape[parts.slave, None]
        * (1 + np.einsum("pqa,paj->pqj", from_centroid, weighted_corners[parts.slave])),
    )


def _without_rounding(coupling: sparse.csr_array) -> sparse.csr_array:
    """Return a coupling (n, n_nodes) without entries that are zero to rounding, its rows, none of them
    empty, scaled to the sum 1."""
    row = np.repeat(np.arange(coupling.shape[0]), np.diff(coupling.indptr))
    size = np.abs(coupling.data)
    coupling.data[
        size <= checks.ROUNDING * np.maximum.reduceat(size, coupling.indptr[:-1])[row]
    ] = 0.0
    coupling.eliminate_zeros()
    coupling = sparse.csr_array(sparse.diags_array(1 / coupling.sum(axis=1)) @ coupling)
    coupling.sort_indices()
    return coupling
