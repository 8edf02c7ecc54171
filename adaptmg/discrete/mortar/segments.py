r"""Mortar coupling of two surfaces in the plane, also of solids of revolution: what of slave edges is covered.

The continuous normal field of the slave surface is n(s), linear on every edge between averaged nodal normals: along
slave edge (a, b) let :math:`x(s) = x_a + s\,(x_b - x_a)` and :math:`n(s) = n_a + s\,(n_b - n_a)`, 0 <= s <= 1. The ray
:math:`x(s) + \alpha\,n(s)` meets the line through the master edge :math:`(y_1, y_2)` at

.. math:: \alpha = \frac{(x - y_1)\times(y_2 - y_1)}{f},\qquad \eta = \frac{(x - y_1)\times n}{f},\qquad
   f = (y_2 - y_1)\times n,

and the edge faces the ray if f > 0. The rays do not cross between the surfaces as long as
:math:`(x_b - x_a)\times n - \alpha\; n\times(n_b - n_a) < 0`. Integrals are sums over Gauss points of the covered parts
(B. Yang, T. Laursen, X. Meng, Int. J. Numer. Meth. Engng 62, 2005, doi:10.1002/nme.1222).
"""

from __future__ import annotations

import numpy as np

from adaptmg._numba import kernel
from adaptmg.discrete.mortar.interface import MortarInterface, Parts, Surfaces, cross, integrated
from adaptmg.geometry.search import BoxTree

_LEAST_COVERED = 1e-3  # of a facet: less is left out
_GAUSS = np.polynomial.legendre.leggauss(4)


def mortar_2d(surfaces: Surfaces, reach: float | None = None) -> MortarInterface:
    """Couple the nodes of a slave surface to a master surface."""
    edge, facet, ends = _pieces(surfaces, *surfaces.depths(reach))
    covered = np.bincount(edge, ends[:, 1] - ends[:, 0], minlength=len(surfaces.slave))
    origin = np.where(covered > 0, np.inf, 0.0)
    np.minimum.at(origin, edge, ends[:, 0])
    slave, master = surfaces.slave[edge], surfaces.master[facet]
    offset = (ends[:, :1] - origin[edge][:, None]) + np.diff(ends) * 0.5 * (1 + _GAUSS[0])
    s = origin[edge][:, None] + offset
    x, e = surfaces.points[slave[:, 0]], np.diff(surfaces.points[slave], axis=1)[:, 0]
    measure = np.linalg.norm(e, axis=1)[:, None] * np.diff(ends) * 0.5 * _GAUSS[1]
    if surfaces.axisymmetric:
        measure = measure * (2 * np.pi * np.maximum(x[:, :1] + s * e[:, :1], 0.0))
    eta, distance = _opposite(surfaces, slave, master, s)
    corners = np.stack([-origin, 1 - origin], axis=1)[..., None]
    parts = Parts(edge, facet, offset[..., None], measure, np.stack([1 - eta, eta], axis=2), distance, corners)
    return integrated(surfaces, parts, covered, _LEAST_COVERED, reach)


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
