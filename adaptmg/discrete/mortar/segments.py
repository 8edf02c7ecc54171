r"""Mortar coupling of two surfaces in 2D (plane or axisymmetric) with dual Lagrange multipliers.

The continuous normal field of the slave surface is n(s), linear on every edge between averaged nodal normals. On the
covered part of an edge, where the rays :math:`x(s) + \alpha\,n(s)` meet the master surface, the dual basis
:math:`\psi_j = \sum_i (d\,m^{-1})_{ji}\,\phi_i` with :math:`d_j = \int\phi_j,\ m_{ij} = \int\phi_i\phi_j` over that
part is biorthogonal to the shape functions and adds up to 1. With the weighted mean :math:`\bar s` and variance v of s
over the covered part it is, for ends a (s = 0) and b (s = 1),

.. math:: \psi_a = (1 - \bar s)\Big(1 - \bar s\,\frac{s - \bar s}{v}\Big),\qquad \psi_b = 1 - \psi_a .

.. math:: D_{jj} = \int\psi_j\phi_j,\quad M_{jk} = \int\psi_j\,\phi_k^{\mathrm{master}},\quad B = D^{-1}M,\quad
   g_j = D_{jj}^{-1}\int\psi_j\,\alpha|n| .

In axisymmetry all integrals carry :math:`2\pi r`. If end b of an edge may carry no multiplier, :math:`\psi_a = 1` there
(the crosspoint modification), and with :math:`D_{ab} = \int\psi_a\phi_b` node b is one of those that a follows:
:math:`u_a - (\sum_k M_{ak} u_k - D_{ab} u_b)/D_{aa}`.

Along slave edge (a, b) let :math:`x(s) = x_a + s\,(x_b - x_a)` and :math:`n(s) = n_a + s\,(n_b - n_a)`, 0 <= s <= 1.
The ray :math:`x(s) + \alpha\,n(s)` meets the line through the master edge :math:`(y_1, y_2)` at

.. math:: \alpha = \frac{(x - y_1)\times(y_2 - y_1)}{f},\qquad \eta = \frac{(x - y_1)\times n}{f},\qquad
   f = (y_2 - y_1)\times n,

and the edge faces the ray if f > 0. The rays do not cross between the surfaces as long as
:math:`(x_b - x_a)\times n - \alpha\; n\times(n_b - n_a) < 0`.

Sources: B. Wohlmuth, SIAM J. Numer. Anal. 38, 2000, doi:10.1137/S0036142999350929 (dual multipliers); B. Yang,
T. Laursen, X. Meng, Int. J. Numer. Meth. Engng 62, 2005, doi:10.1002/nme.1222 (normal field and segments);
T. Cichosz, M. Bischoff, Comput. Methods Appl. Mech. Engrg 200, 2011, doi:10.1016/j.cma.2010.11.004 (dual basis on
partly covered edges).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg._numba import kernel
from adaptmg.discrete.mortar.interface import MortarInterface, Surfaces, cross, nothing_covered
from adaptmg.geometry.search import BoxTree

_LEAST_COVERED = 1e-3  # of a facet: less is left out
_NEGLIGIBLE = 1e-13  # of the largest weight in a row of B
_GAUSS = np.polynomial.legendre.leggauss(4)


def mortar_2d(surfaces: Surfaces, reach: float | None = None) -> MortarInterface:
    """Couple the nodes of a slave surface to a master surface."""
    backward, forward = surfaces.depths(reach)
    edge, facet, ends = _pieces(surfaces, backward, forward)
    covered = np.bincount(edge, ends[:, 1] - ends[:, 0], minlength=len(surfaces.slave))
    kept = ((covered >= _LEAST_COVERED) & surfaces.carries[surfaces.slave].any(axis=1))[edge]
    if not kept.any():
        raise ValueError(nothing_covered(covered, reach, "edge"))
    return _integrate(surfaces, edge[kept], facet[kept], ends[kept])


def _pieces(surfaces: Surfaces, backward: float, forward: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slave edge, master edge and ends (n, 2) in s of the covered parts of all slave edges."""
    edge, facet = _candidates(surfaces, backward, forward)
    ends = _in_front(surfaces, edge, facet)
    real = ends[:, 1] - ends[:, 0] > SHORTEST
    edge, facet, ends = edge[real], facet[real], ends[real]
    order = np.lexsort((facet, ends[:, 0], edge))
    edge, facet, ends = edge[order], facet[order], ends[order]
    counts = np.bincount(edge, minlength=len(surfaces.slave))
    starts = np.r_[0, np.cumsum(counts)]
    breaks = ends.ravel()[np.lexsort((ends.ravel(), np.repeat(edge, 2)))]
    room = 2 * len(edge)
    found = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64), np.empty((room, 2))
    n = nearest_pieces(surfaces.points, surfaces.normals, surfaces.slave, surfaces.master, starts, facet,
                       np.ascontiguousarray(ends[:, 0]), np.ascontiguousarray(ends[:, 1]), breaks, backward, forward,
                       np.empty(counts.max(initial=0), dtype=np.int64), *found)
    return found[0][:n], found[1][:n], found[2][:n]


def _candidates(surfaces: Surfaces, backward: float, forward: float) -> tuple[np.ndarray, np.ndarray]:
    n, x = surfaces.normals[surfaces.slave], surfaces.points[surfaces.slave]
    mean = n.mean(axis=1)
    shortest = np.linalg.norm(mean, axis=1)[:, None, None]  # of n(s), for unit normals at the ends
    corners = np.concatenate([x - backward / shortest * n, x + forward / shortest * n], axis=1)
    frames = np.stack([np.column_stack([mean[:, 1], -mean[:, 0]]), mean], axis=1) / shortest
    local = np.einsum("ead,ekd->eka", frames, corners - x[:, :1])
    pad = 1e-12 * surfaces.size
    return BoxTree(surfaces.points, surfaces.master).meeting(
        frames, np.ascontiguousarray(x[:, 0]), local.min(axis=1) - pad, local.max(axis=1) + pad)


def _in_front(surfaces: Surfaces, edge: np.ndarray, facet: np.ndarray) -> np.ndarray:
    """Part (n, 2) of each slave edge in front of which its master edge lies, without regard to the distance."""
    start, end = surfaces.master[facet].T
    slave = surfaces.slave[edge]
    # the surfaces run in opposite directions, so that the master's end comes first; small parts at the ends of a slave
    # edge are rounding
    parts = np.column_stack([_projection(surfaces, slave, end), _projection(surfaces, slave, start)])
    parts[parts < 1e-12] = 0.0
    parts[parts > 1 - 1e-12] = 1.0
    return parts


def _projection(surfaces: Surfaces, slave: np.ndarray, node: np.ndarray) -> np.ndarray:
    r"""Where on slave edges the normal field points at nodes y: :math:`q(s) = (x(s) - y)\times n(s) = 0`. Of the two
    roots of this quadratic equation the one where q falls: there the node is before the centre of curvature. If there
    is none, 1 where q > 0 and 0 where q < 0: the node is next to all of the edge."""
    x, n = surfaces.points[slave], surfaces.normals[slave]
    e, turn, r = x[:, 1] - x[:, 0], n[:, 1] - n[:, 0], x[:, 0] - surfaces.points[node]
    a, b, c = cross(e, turn), cross(r, turn) + cross(e, n[:, 0]), cross(r, n[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(b * b - 4 * a * c)
        s = np.where(b <= 0, 2 * c / (root - b), -(b + root) / (2 * a))
    none = ~np.isfinite(s)
    s[none] = np.where((0.25 * a + 0.5 * b + c)[none] > 0, 1.0, 0.0)
    return s


def _integrate(surfaces: Surfaces, edge: np.ndarray, facet: np.ndarray, ends: np.ndarray) -> MortarInterface:
    """MortarInterface from the covered parts ``ends`` of slave edges, and the master edges in front of them."""
    slave, master = surfaces.slave[edge], surfaces.master[facet]
    origin = np.full(len(surfaces.slave), np.inf)
    np.minimum.at(origin, edge, ends[:, 0])
    # positions relative to where the covered part begins: a small part must not suffer from cancellation
    offset = (ends[:, :1] - origin[edge][:, None]) + np.diff(ends) * 0.5 * (1 + _GAUSS[0])
    s = origin[edge][:, None] + offset
    x, e = surfaces.points[slave[:, 0]], np.diff(surfaces.points[slave], axis=1)[:, 0]
    measure = np.linalg.norm(e, axis=1)[:, None] * np.diff(ends) * 0.5 * _GAUSS[1]
    if surfaces.axisymmetric:
        measure = measure * (2 * np.pi * np.maximum(x[:, :1] + s * e[:, :1], 0.0))
    psi, phi = _bases(surfaces, edge, origin, offset, measure)
    eta, distance = _opposite(surfaces, slave, master, s)

    n_nodes = len(surfaces.points)
    diagonal, gap, closest = np.zeros(n_nodes), np.zeros(n_nodes), np.full(n_nodes, np.inf)
    rows, columns, values = [], [], []
    for j in (0, 1):
        weighted = measure * psi[j]
        own = surfaces.carries[slave[:, j]]
        np.add.at(diagonal, slave[own, j], (measure * phi[j]).sum(axis=1)[own])
        np.add.at(gap, slave[own, j], (weighted * distance).sum(axis=1)[own])
        np.minimum.at(closest, slave[own, j], distance.min(axis=1)[own])
        other = own & ~surfaces.carries[slave[:, 1 - j]]
        for k, shape, used, sign in ((master[:, 0], 1 - eta, own, 1.0), (master[:, 1], eta, own, 1.0),
                                     (slave[:, 1 - j], phi[1 - j], other, -1.0)):
            rows.append(slave[used, j])
            columns.append(k[used])
            values.append(sign * (weighted * shape).sum(axis=1)[used])
    nodes = np.flatnonzero(diagonal > 0)
    total = sparse.csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
                             shape=(n_nodes, n_nodes))
    coupling = sparse.csr_array(sparse.diags_array(1 / diagonal[nodes]) @ total[nodes])
    return MortarInterface(nodes=nodes, normals=surfaces.normals[nodes], weights=diagonal[nodes],
                           gaps=gap[nodes] / diagonal[nodes], coupling=_without_rounding(coupling),
                           closest=closest[nodes])


def _bases(surfaces: Surfaces, edge: np.ndarray, origin: np.ndarray, offset: np.ndarray, measure: np.ndarray
           ) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Dual and shape functions of both ends at the integration points ``origin`` + ``offset`` of slave edges."""
    n = len(surfaces.slave)
    total = np.bincount(edge, measure.sum(axis=1), minlength=n)
    total[total == 0] = 1.0  # an edge on the axis of symmetry
    mean = np.bincount(edge, (measure * offset).sum(axis=1), minlength=n) / total
    around = offset - mean[edge][:, None]
    variance = np.bincount(edge, (measure * around**2).sum(axis=1), minlength=n) / total
    variance[variance == 0] = 1.0
    at_a, at_b = ((1 - origin) - mean)[edge][:, None], (origin + mean)[edge][:, None]  # means of the shape functions
    slope = at_a * at_b * around / variance[edge][:, None]
    first, second = at_a - slope, at_b + slope
    carries = surfaces.carries[surfaces.slave[edge]]
    first[~carries[:, 1]], second[~carries[:, 0]] = 1.0, 1.0
    return (first, second), ((1 - origin)[edge][:, None] - offset, origin[edge][:, None] + offset)


def _opposite(surfaces: Surfaces, slave: np.ndarray, master: np.ndarray, s: np.ndarray
              ) -> tuple[np.ndarray, np.ndarray]:
    """Position 0 .. 1 on the master edge, and distance along the unit normal, at points s (n, n_points)."""
    x, n, y = surfaces.points[slave], surfaces.normals[slave], surfaces.points[master]
    s = s[:, :, None]
    at = x[:, :1] + s * (x[:, 1:] - x[:, :1]) - y[:, :1]
    normal = n[:, :1] + s * (n[:, 1:] - n[:, :1])
    along = y[:, 1:] - y[:, :1]
    facing = cross(along, normal)
    return cross(at, normal) / facing, cross(at, along) / facing * np.linalg.norm(normal, axis=2)


def _without_rounding(coupling: sparse.csr_array) -> sparse.csr_array:
    """A matrix without entries that are zero to rounding; what they add up to goes to the largest of their row."""
    coupling.sum_duplicates()
    row = np.repeat(np.arange(coupling.shape[0]), np.diff(coupling.indptr))
    size = np.abs(coupling.data)
    largest = np.maximum.reduceat(size, coupling.indptr[:-1])
    small = size <= _NEGLIGIBLE * largest[row]
    left_out = np.bincount(row[small], coupling.data[small], minlength=coupling.shape[0])
    coupling.data[small] = 0.0
    first = np.lexsort((-size, row))[coupling.indptr[:-1]]
    coupling.data[first] += left_out
    coupling.eliminate_zeros()
    coupling.sort_indices()
    return coupling


SHORTEST = 1e-13
"""Parts of a slave edge shorter than this fraction of it are joined to the next part."""

_BESIDE = 1e-9  # how far outside a master edge, as a fraction of it, a ray may pass


@kernel
def distance_along_normal(points, normals, a, b, y1, y2, s):
    """Return the distance from x(s) of slave edge (a, b) along the unit normal to master edge (y1, y2). Infinite if the
    ray misses the edge, the edge faces away, or rays cross before they reach it."""
    ex, ey = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    dx, dy = normals[b, 0] - normals[a, 0], normals[b, 1] - normals[a, 1]
    nx, ny = normals[a, 0] + s * dx, normals[a, 1] + s * dy
    mx, my = points[y2, 0] - points[y1, 0], points[y2, 1] - points[y1, 1]
    rx, ry = points[a, 0] + s * ex - points[y1, 0], points[a, 1] + s * ey - points[y1, 1]
    facing = mx * ny - my * nx
    across = rx * ny - ry * nx
    if facing <= 0.0 or across < -_BESIDE * facing or across > (1.0 + _BESIDE) * facing:
        return np.inf
    distance = (rx * my - ry * mx) / facing
    if (ex * ny - ey * nx) - distance * (nx * dy - ny * dx) >= 0.0:
        return np.inf
    return distance * np.hypot(nx, ny)


@kernel
def nearest_pieces(points, normals, slave, master, starts, facets, lows, highs, breaks, backward, forward, active,
                   piece_edge, piece_facet, piece_ends):
    """Cut each slave edge where a master edge begins or ends; give each part the nearest master edge in front of it."""
    n_pieces = 0
    for e in range(len(slave)):
        a, b = slave[e, 0], slave[e, 1]
        following, n_active = starts[e], 0
        for at in range(2 * starts[e], 2 * starts[e + 1]):
            high = breaks[at]
            if at == 2 * starts[e]:
                low = high
            if high - low <= SHORTEST:
                continue
            middle = 0.5 * (low + high)
            while following < starts[e + 1] and lows[following] < middle:  # one further each time
                active[n_active] = following
                following += 1
                n_active += 1
            kept, best, best_distance = 0, -1, np.inf
            for k in range(n_active):
                pair = active[k]
                if highs[pair] <= middle:
                    continue
                active[kept] = pair
                kept += 1
                distance = distance_along_normal(points, normals, a, b, master[facets[pair], 0],
                                                 master[facets[pair], 1], middle)
                if -backward <= distance <= forward and abs(distance) < best_distance:
                    best, best_distance = pair, abs(distance)
            n_active = kept
            if best >= 0:
                piece_edge[n_pieces], piece_facet[n_pieces] = e, facets[best]
                piece_ends[n_pieces, 0], piece_ends[n_pieces, 1] = low, high
                n_pieces += 1
            low = high
    return n_pieces
