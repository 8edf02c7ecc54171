r"""What of a slave surface is covered: parts of its facets with a part of a master facet opposite.

In the plane, also for solids of revolution, the continuous normal field of the slave surface is
n(s), linear on every edge between averaged nodal normals: along slave edge (a, b) let :math:`x(s) =
x_a + s\,(x_b - x_a)` and :math:`n(s) = n_a + s\,(n_b - n_a)`, 0 <= s <= 1. The ray :math:`x(s) +
\alpha\,n(s)` meets the line through the master edge
:math:`(y_1, y_2)` at

.. math:: \alpha = \frac{(x - y_1)\times(y_2 - y_1)}{f},\qquad \eta = \frac{(x - y_1)\times n}{f},\qquad
   f = (y_2 - y_1)\times n,

and the edge faces the ray if f > 0. The rays do not cross between the surfaces as long as
:math:`(x_b - x_a)\times n - \alpha\; n\times(n_b - n_a) < 0`. Integrals are sums over Gauss points of the covered parts
(B. Yang, T. Laursen, X. Meng, Int. J. Numer. Meth. Engng 62, 2005, doi:10.1002/nme.1222).

In space every slave triangle has a frame (e1, e2, n) with its origin at the centroid, n being the
average of its nodal normals; coordinates in it are called local, and e1 and e2 span the auxiliary
plane (M. Puso, T. Laursen, Comput. Methods Appl. Mech. Engrg 193, 2004,
doi:10.1016/j.cma.2003.06.010). The triangle and the master triangles that face it are projected on
it along that normal, and clipped against each other. On the common parts all shape functions and
the gap are affine: three points with the area, centroid and covariance of a part integrate products
of two of them exactly. Areas are those on the slave triangle."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._numba import inner_kernel, kernel
from adaptmg.geometry.clipping import MOMENTS, ROOM, add_visible, clip, polygon_moments, separated
from adaptmg.geometry.search import BoxTree
from adaptmg.mesh.arrays import Surface, mask_of

# overlap, over the size of the surfaces, up to which masters are found without a reach. Half, twice and
# four times change none of 160 random pairs
_DEEPEST = 0.25


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Two surfaces that are to be coupled."""

    slave_side: Surface
    master_side: Surface  # nodes on both, as at tips of a crack, are ordinary ones
    # (n_nodes, dim): unit normals at the nodes of the slave surface; other rows are not read
    normals: np.ndarray
    # (n,) int: nodes of the slave surface without a multiplier; other nodes are ignored
    excluded: ArrayLike = ()
    axisymmetric: bool = False  # x is a radius; 2D only
    points: np.ndarray = field(init=False, repr=False)  # (n_nodes, dim): those of the mesh, m
    slave: np.ndarray = field(init=False, repr=False)  # (n, dim) int64: facets
    master: np.ndarray = field(init=False, repr=False)  # (n, dim) int64: facets
    carries: np.ndarray = field(init=False, repr=False)  # (n_nodes,) bool: nodes with a multiplier
    size: float = field(init=False, repr=False)  # diagonal of the bounding box of both surfaces, m

    def __post_init__(self) -> None:
        """Find which nodes carry multipliers, and check that the normals point outward."""
        points = self.slave_side.points
        slave_nodes = self.slave_side.nodes
        master_nodes = self.master_side.nodes
        carries = mask_of(slave_nodes, len(points))
        carries[master_nodes] = False
        carries[np.asarray(self.excluded, dtype=np.int64)] = False
        if not carries.any():
            raise ValueError(
                "every node of the slave surface is excluded, or one of the master too, which leaves none "
                "to carry contact; take the other surface as slave, or free some of its nodes"
            )
        size = float(np.linalg.norm(np.ptp(points[np.r_[slave_nodes, master_nodes]], axis=0)))
        slave, master = (
            np.ascontiguousarray(side.facets, dtype=np.int64)
            for side in (self.slave_side, self.master_side)
        )
        self.__dict__.update(points=points, slave=slave, master=master, carries=carries, size=size)
        outward = np.einsum("fd,fkd->fk", self.slave_side.vectors, self.normals[slave])
        if not (outward > 0).all():
            i = slave[outward <= 0][0]
            raise ValueError(
                f"normals must point out of the slave body; that of node {i} {tuple(points[i].tolist())} "
                "does not on one of its facets. Reverse the facets, or split the boundary where it has a "
                "sharp corner"
            )

    def depths(self, reach: float | None) -> tuple[float, float]:
        """Return the distances behind and in front of the slave surface within which the master is
        sought, m."""
        return (_DEEPEST * self.size, self.size) if reach is None else (reach, reach)

    def exact_distances(
        self,
        slave: np.ndarray,
        master: np.ndarray,
        places: np.ndarray,
        normals: np.ndarray,
        distances: np.ndarray,
    ) -> np.ndarray:
        """Return the distances (n, n_points) between the exact surfaces, along unit normals at places
        (n, n_points, dim) on slave facets (n,), from the ``distances`` to the master facets (n,)."""
        opposite = places + distances[..., None] * normals
        return (
            distances
            + self.master_side.rises(master, opposite, normals)
            - self.slave_side.rises(slave, places, normals)
        )


@dataclass(frozen=True, eq=False)
class CoveredParts:
    """Covered parts of slave facets, with quadrature points. Places are coordinates along a slave facet,
    relative to a point that is chosen for each facet, so that those of small parts lose no digits."""

    slave: np.ndarray  # (n,) int: facets
    master: np.ndarray  # (n,) int: facets
    places: np.ndarray  # (n, n_points, dim - 1)
    # (n, n_points): measure of each point on the slave facet, in axisymmetry over the circumference
    weights: np.ndarray
    shapes: np.ndarray  # (n, n_points, dim): the shape functions of the master's corners
    distances: np.ndarray  # (n, n_points): along the unit normal, m
    corners: np.ndarray  # (n_slave, dim, dim - 1): places of the corners of all slave facets
    enough: np.ndarray  # (n_slave,) bool: more than a sliver of the slave facet is covered

    def only(self, chosen: np.ndarray) -> CoveredParts:
        """Return the parts of a mask ``chosen`` (n,)."""
        return replace(
            self,
            **{
                name: getattr(self, name)[chosen]
                for name in ("slave", "master", "places", "weights", "shapes", "distances")
            },
        )

    def means(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the measures (n_slave,) of the covered parts of slave facets, their centroids
        (n_slave, dim - 1), the places (n, n_points, dim - 1) from these, and the covariances
        (n_slave, dim - 1, dim - 1). Where nothing is covered: 0, 0 and the identity, as callers solve
        with the covariances."""
        n_slave, dim = self.corners.shape[:2]

        def sums(values: np.ndarray) -> np.ndarray:
            return np.stack(
                [np.bincount(self.slave, column, minlength=n_slave) for column in values.T], axis=1
            )

        measure = sums(self.weights.sum(axis=1, keepdims=True))[:, 0]
        # an edge on the axis of symmetry has no measure
        shares = self.weights / np.where(measure > 0, measure, 1.0)[self.slave, None]
        centroid = sums(np.einsum("pq,pqa->pa", shares, self.places))
        from_centroid = self.places - centroid[self.slave, None]
        products = np.einsum("pq,pqa,pqb->pab", shares, from_centroid, from_centroid).reshape(
            -1, (dim - 1) ** 2
        )
        covariance = sums(products).reshape(n_slave, dim - 1, dim - 1)
        covariance[measure == 0] = np.eye(dim - 1)
        return measure, centroid, from_centroid, covariance


def covered_parts(surfaces: Surfaces, reach: float | None) -> CoveredParts:
    """Return the parts of a slave surface with the master surface opposite."""
    return (_parts_of_edges if surfaces.points.shape[1] == 2 else _parts_of_triangles)(
        surfaces, reach
    )


def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the cross products (...,) of vectors (..., 2) in the plane."""
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


# a master facet faces a slave facet if it leans towards its normal by more than this angle (rad). Walls that
# are upright but for the digits of a file have large gaps, by which nodes next to them would lose contact: the
# displacement of a block that overhangs a wall with a lean of 1e-5 is 15 % larger if it counts
_GRAZING = 1e-2

# -- in the plane ---------------------------------------------------------------------------------------------------

_GAUSS = np.polynomial.legendre.leggauss(4)


def _parts_of_edges(surfaces: Surfaces, reach: float | None) -> CoveredParts:
    """Return the covered parts of slave edges, with Gauss points; s runs from 0 to 1 along an edge."""
    edge, facet, ends = _pieces(surfaces, *surfaces.depths(reach))
    covered = np.bincount(edge, ends[:, 1] - ends[:, 0], minlength=len(surfaces.slave))
    # places along an edge are relative to the first covered one: those of small parts lose no digits
    origin = np.where(covered > 0, np.inf, 0.0)
    np.minimum.at(origin, edge, ends[:, 0])
    slave = surfaces.slave[edge]
    master = surfaces.master[facet]
    offset = (ends[:, :1] - origin[edge][:, None]) + np.diff(ends) * 0.5 * (1 + _GAUSS[0])
    s = origin[edge][:, None] + offset
    begin = surfaces.points[slave[:, 0]]
    edge_vector = np.diff(surfaces.points[slave], axis=1)[:, 0]
    weights = np.linalg.norm(edge_vector, axis=1)[:, None] * np.diff(ends) * 0.5 * _GAUSS[1]
    if surfaces.axisymmetric:
        weights = weights * (2 * np.pi * np.maximum(begin[:, :1] + s * edge_vector[:, :1], 0.0))
    eta, distance = _opposite(surfaces, slave, master, s)
    places = begin[:, None] + s[..., None] * edge_vector[:, None]
    begin_normal, end_normal = np.moveaxis(surfaces.normals[slave], 1, 0)
    normals = begin_normal[:, None] + s[..., None] * (end_normal - begin_normal)[:, None]
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    distance = surfaces.exact_distances(edge, facet, places, normals, distance)
    corners = np.stack([-origin, 1 - origin], axis=1)[..., None]
    return CoveredParts(
        slave=edge,
        master=facet,
        places=offset[..., None],
        weights=weights,
        shapes=np.stack([1 - eta, eta], axis=2),
        distances=distance,
        corners=corners,
        enough=covered >= checks.SIX_DIGITS,
    )


def _pieces(
    surfaces: Surfaces, backward: float, forward: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return slave edge, master edge and ends (n, 2) in s of the covered parts of slave edges: each has
    the nearest of the masters that lie at most ``backward`` behind and ``forward`` in front of it, m."""
    edge, facet = _edges_near(surfaces, backward, forward)
    ends = _in_front(surfaces, edge, facet)
    # parts longer than rounding, in the order of edges, and along each edge
    long = np.flatnonzero(ends[:, 1] - ends[:, 0] > SHORTEST)
    order = long[np.lexsort((facet[long], ends[long, 0], edge[long]))]
    edge = edge[order]
    facet = facet[order]
    ends = ends[order]
    counts = np.bincount(edge, minlength=len(surfaces.slave))
    starts = np.r_[0, np.cumsum(counts)]
    # begins and ends of all parts, ascending along each slave edge: between two the nearest master is the same
    breaks = ends.ravel()[np.lexsort((ends.ravel(), np.repeat(edge, 2)))]
    room = 2 * len(edge)
    pieces = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64), np.empty((room, 2))
    n = nearest_pieces(
        surfaces.points,
        surfaces.normals,
        surfaces.slave,
        surfaces.master,
        starts,
        facet,
        np.ascontiguousarray(ends[:, 0]),
        np.ascontiguousarray(ends[:, 1]),
        breaks,
        backward,
        forward,
        np.empty(counts.max(initial=0), dtype=np.int64),  # overwritten
        *pieces,
    )
    return pieces[0][:n], pieces[1][:n], pieces[2][:n]


def _edges_near(
    surfaces: Surfaces, backward: float, forward: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return slave and master edges (n,) that may lie opposite: boxes around the rays of slave
    edges, by ``backward`` and ``forward`` along the unit normals, meet master edges, which face them."""
    end_normals = surfaces.normals[surfaces.slave]
    ends = surfaces.points[surfaces.slave]
    mean = end_normals.mean(axis=1)
    # n(s) between two unit normals is shortest in the middle: a distance d along the unit normal is at
    # most d / |mean| times n(s), so that the rays lie between those at the ends with this factor
    shortest = np.linalg.norm(mean, axis=1)[:, None, None]
    corners = np.concatenate(
        [ends - backward / shortest * end_normals, ends + forward / shortest * end_normals], axis=1
    )
    # axes of the box of each edge by row: across the mean normal, and along it
    frames = np.stack([np.column_stack([mean[:, 1], -mean[:, 0]]), mean], axis=1) / shortest
    local = np.einsum("ead,ekd->eka", frames, corners - ends[:, :1])
    rounding = 1e-12 * surfaces.size  # of the coordinates of box and edges
    edge, facet = BoxTree(surfaces.points, surfaces.master).meeting(
        frames,
        np.ascontiguousarray(ends[:, 0]),
        local.min(axis=1) - rounding,
        local.max(axis=1) + rounding,
    )
    leaning = np.einsum("pd,pkd->pk", surfaces.master_side.vectors[facet], end_normals[edge]).min(
        axis=1
    )
    facing = leaning < -_GRAZING * surfaces.master_side.measures[facet]
    return edge[facing], facet[facing]


def _in_front(surfaces: Surfaces, edge: np.ndarray, facet: np.ndarray) -> np.ndarray:
    """Return the part (n, 2), begin and end in s, of each slave edge (n,) that has its master edge
    ``facet`` (n,) in front, at whatever distance."""
    start, end = surfaces.master[facet].T
    slave = surfaces.slave[edge]
    # the surfaces run in opposite directions, so that the master's end comes first; a begin or end beyond
    # an end of the slave edge, or within rounding of it, is put there
    parts = np.column_stack(
        [_projection(surfaces, slave, end), _projection(surfaces, slave, start)]
    )
    parts[parts < 1e-12] = 0.0
    parts[parts > 1 - 1e-12] = 1.0
    return parts


def _projection(surfaces: Surfaces, slave: np.ndarray, node: np.ndarray) -> np.ndarray:
    r"""Return the places s on slave edges where the normal field points at nodes y: :math:`q(s) = (x(s) - y)\times
    n(s) = 0`. Of the two roots of this quadratic equation the one where q falls: there the node is
    before the centre of curvature. If there is none, 1 where q > 0 and 0 where q < 0: the node is
    next to all of the edge. ``slave`` (n, 2) are the nodes of the edges, ``node`` (n,) the nodes y."""
    ends = surfaces.points[slave]
    end_normals = surfaces.normals[slave]
    edge = ends[:, 1] - ends[:, 0]
    turn = end_normals[:, 1] - end_normals[:, 0]
    from_node = ends[:, 0] - surfaces.points[node]
    # q(s) = a s^2 + b s + c
    a = cross(edge, turn)
    b = cross(from_node, turn) + cross(edge, end_normals[:, 0])
    c = cross(from_node, end_normals[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        # where q falls 2 a s + b = -root; of the two forms of this s the one without cancellation
        root = np.sqrt(b * b - 4 * a * c)
        s = np.where(b <= 0, 2 * c / (root - b), -(b + root) / (2 * a))
    no_root = ~np.isfinite(s)
    # by the sign of q in the middle
    s[no_root] = np.where((0.25 * a + 0.5 * b + c)[no_root] > 0, 1.0, 0.0)
    return s


def _opposite(
    surfaces: Surfaces, slave: np.ndarray, master: np.ndarray, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the places eta (n, n_points), 0 to 1 on the master edge, that lie opposite to places s
    (n, n_points) on the slave edge, and their distances (n, n_points) along the unit normal, m."""
    slave_ends = surfaces.points[slave]
    slave_normals = surfaces.normals[slave]
    master_ends = surfaces.points[master]
    s = s[:, :, None]
    from_master = (
        slave_ends[:, :1] + s * (slave_ends[:, 1:] - slave_ends[:, :1]) - master_ends[:, :1]
    )
    normal = slave_normals[:, :1] + s * (slave_normals[:, 1:] - slave_normals[:, :1])
    master_edge = master_ends[:, 1:] - master_ends[:, :1]
    # eta = (x - y_1) x n / f, and alpha = (x - y_1) x (y_2 - y_1) / f times |n|
    leaning = cross(master_edge, normal)
    return cross(from_master, normal) / leaning, cross(
        from_master, master_edge
    ) / leaning * np.linalg.norm(normal, axis=2)


SHORTEST = checks.ROUNDING
"""Parts of a slave edge shorter than this fraction of it are joined to the next part."""

_BESIDE = checks.ALIKE  # how far outside a master edge, as a fraction of it, a ray may pass


@kernel
def distance_along_normal(points, normals, a, b, y1, y2, s):
    """Return the distance from x(s) of slave edge (a, b) along the unit normal to master edge (y1,
    y2), all by their nodes, by the formulas of the module; ``points`` and ``normals`` (n_nodes, 2) are
    those of :class:`Surfaces`. Infinite if the ray misses the edge, the edge faces away, or
    rays cross before they reach it."""
    edge_x = points[b, 0] - points[a, 0]
    edge_y = points[b, 1] - points[a, 1]
    turn_x = normals[b, 0] - normals[a, 0]
    turn_y = normals[b, 1] - normals[a, 1]
    normal_x = normals[a, 0] + s * turn_x
    normal_y = normals[a, 1] + s * turn_y
    master_x = points[y2, 0] - points[y1, 0]
    master_y = points[y2, 1] - points[y1, 1]
    from_master_x = points[a, 0] + s * edge_x - points[y1, 0]
    from_master_y = points[a, 1] + s * edge_y - points[y1, 1]
    f = master_x * normal_y - master_y * normal_x
    eta_f = from_master_x * normal_y - from_master_y * normal_x
    if f <= 0.0 or eta_f < -_BESIDE * f or eta_f > (1.0 + _BESIDE) * f:
        return np.inf
    alpha = (from_master_x * master_y - from_master_y * master_x) / f
    if (edge_x * normal_y - edge_y * normal_x) - alpha * (
        normal_x * turn_y - normal_y * turn_x
    ) >= 0.0:
        return np.inf
    return alpha * np.hypot(normal_x, normal_y)


@kernel
def nearest_pieces(
    points,
    normals,
    slave,
    master,
    starts,
    facets,
    lows,
    highs,
    breaks,
    backward,
    forward,
    active,
    piece_edge,
    piece_facet,
    piece_ends,
):
    """Cut each slave edge where a master edge begins or ends (``breaks``, ascending in each edge), and
    give each part the nearest master edge in front of it, at most ``backward`` behind and ``forward``
    in front, m; return the number of parts, of which slave edge, master edge and ends in s are written
    to the last three arguments. The pairs starts[e], ..., starts[e + 1] - 1 of slave edge e have the
    master edges ``facets``, opposite to s from ``lows``, ascending, to ``highs``. ``active`` is
    overwritten: the pairs that reach the part."""
    n_pieces = 0
    for e in range(len(slave)):
        a = slave[e, 0]
        b = slave[e, 1]
        next_pair = starts[e]
        n_active = 0
        for k_break in range(2 * starts[e], 2 * starts[e + 1]):
            end = breaks[k_break]
            if k_break == 2 * starts[e]:
                begin = end
            if end - begin <= SHORTEST:
                continue
            middle = 0.5 * (begin + end)
            while next_pair < starts[e + 1] and lows[next_pair] < middle:  # one further each time
                active[n_active] = next_pair
                next_pair += 1
                n_active += 1
            n_remaining = 0
            nearest = -1
            least_distance = np.inf
            for k in range(n_active):
                pair = active[k]
                if highs[pair] <= middle:
                    continue
                active[n_remaining] = pair
                n_remaining += 1
                distance = distance_along_normal(
                    points, normals, a, b, master[facets[pair], 0], master[facets[pair], 1], middle
                )
                if -backward <= distance <= forward and abs(distance) < least_distance:
                    nearest = pair
                    least_distance = abs(distance)
            n_active = n_remaining
            if nearest >= 0:
                piece_edge[n_pieces], piece_facet[n_pieces] = e, facets[nearest]
                piece_ends[n_pieces, 0] = begin
                piece_ends[n_pieces, 1] = end
                n_pieces += 1
            begin = end
    return n_pieces


# -- in space -------------------------------------------------------------------------------------------------------

# three points of unit covariance, coordinate by coordinate
_POINTS = np.sqrt(2) * np.array(
    [np.cos([0, 2 * np.pi / 3, 4 * np.pi / 3]), np.sin([0, 2 * np.pi / 3, 4 * np.pi / 3])]
)


def _parts_of_triangles(surfaces: Surfaces, reach: float | None) -> CoveredParts:
    """Return the visible common parts of slave and master triangles."""
    depths = surfaces.depths(reach)
    frames = _frames(surfaces)
    start, near = _triangles_near(surfaces, frames, *depths)
    parts = _common_parts(surfaces, frames, start, near, *depths)
    _, _, _, covariance = parts.means()
    # facets of which a narrow strip is covered
    strips = np.flatnonzero(
        np.linalg.det(covariance) < checks.SIX_DIGITS * np.trace(covariance, axis1=1, axis2=2) ** 2
    )
    if len(strips):
        # again in the axes of the strip: in others its covariance has no digits across it
        axes = np.linalg.eigh(covariance[strips])[1]
        # proper rotations: the corners must stay counter-clockwise
        axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
        frames[strips, :2] = np.einsum("fba,fbd->fad", axes, frames[strips, :2])
        parts = _common_parts(surfaces, frames, start, near, *depths)
    return parts


def _frames(surfaces: Surfaces) -> np.ndarray:
    """Return the frames (n_slave, 3, 3) of slave triangles by row: two tangents, then the
    normal."""
    corners = surfaces.points[surfaces.slave]
    normal = surfaces.normals[surfaces.slave].sum(axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    tangent = corners[:, 1] - corners[:, 0]
    tangent -= np.sum(tangent * normal, axis=1)[:, None] * normal
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    return np.stack([tangent, np.cross(normal, tangent), normal], axis=1)


def _local(surfaces: Surfaces, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centroids (n_slave, 3) of slave facets, and their corners relative to it in their frames."""
    corners = surfaces.points[surfaces.slave]
    origins = corners.mean(axis=1)
    return origins, np.einsum("fad,fkd->fka", frames, corners - origins[:, None])


def _triangles_near(
    surfaces: Surfaces, frames: np.ndarray, backward: float, forward: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return master facets that may be opposite to a slave facet with the axes ``frames`` (n_slave, 3, 3):
    where those of each begin (n_slave + 1,), and their numbers."""
    origins, local = _local(surfaces, frames)
    low = local.min(axis=1)
    high = local.max(axis=1)
    low[:, 2] -= backward
    high[:, 2] += forward
    slave, near = BoxTree(surfaces.points, surfaces.master).meeting(frames, origins, low, high)
    leaning = np.einsum("pd,pd->p", surfaces.master_side.vectors[near], frames[slave, 2])
    facing = leaning < -_GRAZING * surfaces.master_side.measures[near]
    start = np.cumsum(np.bincount(slave[facing] + 1, minlength=len(frames) + 1))
    return start, near[facing]


def _common_parts(
    surfaces: Surfaces,
    frames: np.ndarray,
    start: np.ndarray,
    near: np.ndarray,
    backward: float,
    forward: float,
) -> CoveredParts:
    """Return the visible common parts in ``frames`` (n_slave, 3, 3), with three points each; slave facet s
    has the master facets ``near[start[s]:start[s + 1]]``."""
    origins, local = _local(surfaces, frames)
    slave = np.repeat(np.arange(len(frames)), np.diff(start))
    # a facing facet runs clockwise as seen from the slave: its corners in reverse order
    master_corners = np.einsum(
        "pad,pkd->pka",
        frames[slave],
        surfaces.points[surfaces.master[near, ::-1]] - origins[slave][:, None],
    )
    moments = np.empty((len(near), MOMENTS))
    common_moments(local, master_corners, start, backward, forward, moments)
    has_part = moments[:, 0] > 0
    slave = slave[has_part]
    master = near[has_part]
    master_corners = master_corners[has_part, ::-1]  # in the order of ``surfaces.master`` again
    moments = moments[has_part]
    area = moments[:, 0]
    centroid = moments[:, 1:3]
    steps = _steps_to_points(*moments[:, 3:].T)
    # shape functions are affine: their values at the centroid plus slopes times the steps
    at_centroid, master_slope = _barycentric(master_corners[..., :2], centroid)
    slave_at_centroid, slave_slope = _barycentric(local[slave, :, :2], centroid)
    shapes = at_centroid[:, None] + np.einsum("pqa,pka->pqk", steps, master_slope)
    slave_shapes = slave_at_centroid[:, None] + np.einsum("pqa,pka->pqk", steps, slave_slope)
    # the height of the master minus that of the slave, along the normal of the frame
    distances = np.einsum("pqk,pk->pq", shapes, master_corners[..., 2]) - np.einsum(
        "pqk,pk->pq", slave_shapes, local[slave, :, 2]
    )
    places = np.einsum("pqk,pkd->pqd", slave_shapes, surfaces.points[surfaces.slave[slave]])
    normals = np.broadcast_to(frames[slave, None, 2], places.shape)
    distances = surfaces.exact_distances(slave, master, places, normals, distances)
    # areas on the slave triangle over those in the auxiliary plane
    stretch = surfaces.slave_side.measures / np.einsum(
        "fd,fd->f", surfaces.slave_side.vectors, frames[:, 2]
    )
    weights = np.repeat((area * stretch[slave] / 3)[:, None], 3, axis=1)
    # places are relative to the centroid of one part of the facet, the last: any of them will do
    origin = np.zeros((len(frames), 2))
    origin[slave] = centroid
    covered = np.bincount(slave, weights.sum(axis=1), minlength=len(frames))
    return CoveredParts(
        slave=slave,
        master=master,
        places=(centroid - origin[slave])[:, None] + steps,
        weights=weights,
        shapes=shapes,
        distances=distances,
        corners=local[..., :2] - origin[:, None],
        enough=covered >= checks.SIX_DIGITS * surfaces.slave_side.measures,
    )


def _steps_to_points(xx: np.ndarray, xy: np.ndarray, yy: np.ndarray) -> np.ndarray:
    """Return the steps (n, 3, 2) from the centroids of parts with these covariances (n,) to their three
    points: the corners of an equilateral triangle times the Cholesky factor of the covariance."""
    factor_xx = np.sqrt(xx)
    factor_yx = xy / factor_xx
    factor_yy = np.sqrt(np.maximum(yy - factor_yx**2, 0.0))
    x = factor_xx[:, None] * _POINTS[0]
    y = factor_yx[:, None] * _POINTS[0] + factor_yy[:, None] * _POINTS[1]
    return np.stack([x, y], axis=2)


def _barycentric(corners: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the shape functions (n, 3) of plane triangles (n, 3, 2) at points (n, 2), and their gradients (n,
    3, 2)."""
    opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    double = cross(opposite[:, 0], opposite[:, 1])[:, None]
    values = cross(opposite, at[:, None] - np.roll(corners, -1, axis=1)) / double
    return values, np.stack([-opposite[..., 1], opposite[..., 0]], axis=-1) / double[..., None]


SLIVER = checks.ROUNDING
"""Common parts smaller than this share of the slave facet are rounding."""

THIN = checks.ALIKE
"""Overlaps of master facets thinner than this share of the slave facet's size are rounding."""


@kernel
def common_moments(slave, masters, start, below, above, moments):
    """Write the moments of the visible common parts of slave facets and the master facets found for them
    into ``moments`` (n, MOMENTS), from the local corners ``slave`` (n_slave, 3, 3) and ``masters`` (n, 3,
    3). A part is dropped if its gap, at its centroid, is outside [-below,
    above]. Where parts overlap, the one with the gap of smaller magnitude, at the centroid of the
    overlap, hides the other. Slave facet s has the facets ``masters[start[s]:start[s + 1]]``."""
    most_masters = 1
    for s in range(len(slave)):
        most_masters = max(most_masters, start[s + 1] - start[s])
    # of each master facet of one slave facet: the part, its corners, its box, and the gap, as a plane
    parts = np.empty((most_masters, ROOM, 2))
    sizes = np.empty(most_masters, dtype=np.int64)
    boxes = np.empty((most_masters, 4))
    gaps = np.empty((most_masters, 3))
    slave_plane = np.empty(3)
    hiding = np.empty(most_masters, dtype=np.int64)
    # overwritten by the clipping
    spare = np.empty((2, 2 * ROOM, 2))
    piece = np.empty((2, ROOM, 2))
    # triangles of a part that wait while what is hidden is cut off: at most ROOM make the part, and each
    # of the three edges of a master that hides it leaves three more waiting, 9 < ROOM
    stack = np.empty((ROOM * (1 + most_masters), 3, 2))
    states = np.empty((ROOM * (1 + most_masters), 2), dtype=np.int64)
    for s in range(len(slave)):
        area = 0.5 * _plane(slave[s], slave_plane)
        first = start[s]
        n = start[s + 1] - start[s]
        n_parts = 0
        facing = masters[first : first + n]
        # first the whole common part with each master facet, and its gap
        for i in range(n):
            _plane(facing[i], gaps[i])
            for k in range(3):
                gaps[i, k] -= slave_plane[k]
            sizes[i] = clip(facing[i], 3, slave[s], 3, parts[i], piece[0])
            polygon_moments(parts[i], sizes[i], moments[first + i])
            gap = _gap(gaps[i], moments[first + i])
            if not moments[first + i, 0] > SLIVER * area or gap > above or gap < -below:
                moments[first + i, 0] = 0.0
                sizes[i] = 0
            _write_box(parts[i], sizes[i], boxes[i])
            if sizes[i] > 0:
                n_parts += 1
        tolerance = THIN * np.sqrt(area)
        # then the moments of parts that nearer ones hide in part: again, of what these leave visible
        for i in range(n if n_parts > 1 else 0):
            n_hiding = 0
            for j in range(n):
                if (
                    j != i
                    and _overlap(boxes[i], boxes[j], tolerance)
                    and _nearer(parts, sizes, facing, gaps, i, j, tolerance, spare) == j
                ):
                    hiding[n_hiding] = j
                    n_hiding += 1
            if n_hiding > 0:
                add_visible(
                    parts[i],
                    sizes[i],
                    facing,
                    hiding,
                    n_hiding,
                    tolerance,
                    stack,
                    states,
                    piece,
                    moments[first + i],
                )
                if not moments[first + i, 0] > tolerance * tolerance:
                    moments[first + i, 0] = 0.0


@inner_kernel
def _write_box(polygon, size, box):
    """Write the box around the first ``size`` corners of a polygon: lowest x and y, highest x and y."""
    for c in range(2):
        box[c] = np.inf
        box[2 + c] = -np.inf
        for k in range(size):
            box[c] = min(box[c], polygon[k, c])
            box[2 + c] = max(box[2 + c], polygon[k, c])


@inner_kernel
def _overlap(box, other, tolerance):
    """Return whether two boxes (4,) of :func:`_write_box` overlap by more than a tolerance."""
    return (
        other[0] < box[2] - tolerance
        and other[2] > box[0] + tolerance
        and other[1] < box[3] - tolerance
        and other[3] > box[1] + tolerance
    )


@kernel
def _plane(corners, plane):
    """Write the height at the origin and the slopes (x, y) of the plane through three local points
    into ``plane`` (3,); return twice the area of their triangle."""
    x1 = corners[1, 0] - corners[0, 0]
    y1 = corners[1, 1] - corners[0, 1]
    z1 = corners[1, 2] - corners[0, 2]
    x2 = corners[2, 0] - corners[0, 0]
    y2 = corners[2, 1] - corners[0, 1]
    z2 = corners[2, 2] - corners[0, 2]
    double_area = x1 * y2 - x2 * y1
    plane[1] = (z1 * y2 - z2 * y1) / double_area
    plane[2] = (z2 * x1 - z1 * x2) / double_area
    plane[0] = corners[0, 2] - plane[1] * corners[0, 0] - plane[2] * corners[0, 1]
    return double_area


@inner_kernel
def _gap(plane, moments):
    """Return the value of a plane at the centroid of a part, from its moments."""
    return plane[0] + plane[1] * moments[1] + plane[2] * moments[2]


@inner_kernel
def _nearer(parts, sizes, masters, gaps, i, j, tolerance, spare):
    """Return which of the parts i and j of one slave facet, as :func:`common_moments` has them, is nearer
    where they overlap, -1 if they do not; the same for (i, j) and (j, i)."""
    a = min(i, j)
    b = max(i, j)
    if separated(parts[a], sizes[a], masters[b], 3, tolerance):
        return -1
    common = np.empty(MOMENTS)
    polygon_moments(spare[0], clip(parts[a], sizes[a], masters[b], 3, spare[0], spare[1]), common)
    if not common[0] > tolerance * tolerance:
        return -1
    return a if abs(_gap(gaps[a], common)) <= abs(_gap(gaps[b], common)) else b
