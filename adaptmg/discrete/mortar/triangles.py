r"""Mortar coupling of two triangulated surfaces in 3D with dual Lagrange multipliers.

Every slave triangle has a frame (e1, e2, n) with its origin at the centroid, n being the average of its nodal normals;
coordinates in it are called local, and e1 and e2 span the auxiliary plane. The triangle and the master triangles that
face it are projected on it along that normal, and clipped against each other. On the common parts all shape functions
and the gap are affine, so that the integrals follow from area, centroid and covariance of each part, without
quadrature. With :math:`A, c, S` area, centroid and covariance of what is covered of the triangle, and :math:`x_j` its
projected corners, the dual basis :math:`\psi = \mathrm{diag}(d)\,m^{-1}\phi` over the covered part (:math:`d_j =
\int\phi_j,\ m_{ij} = \int\phi_i\phi_j`) is

.. math:: \psi_j(x) = \phi_j(c)\,\bigl(1 + (x_j - c)\cdot S^{-1}(x - c)\bigr),

which adds up to 1, is biorthogonal, and reproduces constants and linear functions however little is covered. A part
of area a, centroid :math:`\bar x` and covariance s, and a function f affine on it, contribute

.. math:: \int\psi_j f = a\,\phi_j(c)\,\bigl(f(\bar x) + (x_j - c)\cdot S^{-1}
          [(\bar x - c)\,f(\bar x) + s\,\nabla f]\bigr)

to :math:`M_{jk} = \int\psi_j\phi_k^{\mathrm{master}}` and :math:`\int\psi_j g`; :math:`D_{jj} = \int\phi_j`,
:math:`B = D^{-1}M`. Areas are those on the slave triangle. Where corners b of a triangle carry no multiplier, theirs
are shared out evenly among its r corners a that do (crosspoint modification):
:math:`\psi_a + \frac1r\sum_b\psi_b` add up to 1 and are biorthogonal on these corners, and
:math:`D_{ab} = \frac1r\int\phi_b` makes b one of the nodes that a follows:
:math:`u_a - (\sum_k M_{ak} u_k - \sum_b D_{ab} u_b)/D_{aa}`.

Sources: M. Puso, T. Laursen, Comput. Methods Appl. Mech. Engrg 193, 2004, doi:10.1016/j.cma.2003.06.010 (auxiliary
planes); A. Popp, M. Gitterle, M. Gee, W. Wall, Int. J. Numer. Meth. Engng 83, 2010, doi:10.1002/nme.2866 (dual
multipliers in 3D); T. Cichosz, M. Bischoff, Comput. Methods Appl. Mech. Engrg 200, 2011,
doi:10.1016/j.cma.2010.11.004 (dual basis over the covered part).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg._numba import inner_kernel, kernel
from adaptmg.discrete.mortar.interface import MortarInterface, Surfaces, cross, nothing_covered
from adaptmg.geometry.clipping import MOMENTS, ROOM, add_visible, clip, polygon_moments, separated
from adaptmg.geometry.search import BoxTree

_LEAST_COVERED = 1e-6  # of a facet: less is left out
_NEGLIGIBLE = 1e-13  # of the largest entry in a row of B, and of the area around a node
_GRAZING = 1e-2  # a master facet faces a slave facet if it leans towards its normal by more than this angle (rad)
_STRIP = 1e-3  # S of a smaller ratio det(S) / trace(S)^2 is taken in its principal axes


def mortar_3d(surfaces: Surfaces, reach: float | None = None) -> MortarInterface:
    """Couple the nodes of a slave surface to a master surface."""
    backward, forward = surfaces.depths(reach)
    parts = _common_parts(surfaces, backward, forward)
    covered = parts.covered()
    enough = (covered > 0) & (covered >= _LEAST_COVERED * parts.areas())
    kept = (enough & surfaces.carries[surfaces.slave].any(axis=1))[parts.slave]
    if not kept.any():
        raise ValueError(nothing_covered(covered, reach, "triangle"))
    return _integrate(surfaces, parts.only(kept))


@dataclass(frozen=True, eq=False)
class _Parts:
    """Common parts of slave and master facets."""

    slave: np.ndarray  # (n,) int: facets
    master: np.ndarray  # (n,) int: facets
    moments: np.ndarray  # (n, MOMENTS): area, centroid and covariance in the frame of the slave facet
    frames: np.ndarray  # (n_slave, 3, 3): rows e1, e2, n
    corners: np.ndarray  # (n_slave, 3, 3): slave corners in their frame, whose origin is the centroid

    def only(self, kept: np.ndarray) -> _Parts:
        """Return some of the parts."""
        return _Parts(self.slave[kept], self.master[kept], self.moments[kept], self.frames, self.corners)

    def areas(self) -> np.ndarray:
        """Return the projected area of each slave facet."""
        return 0.5 * cross(self.corners[:, 1, :2] - self.corners[:, 0, :2],
                            self.corners[:, 2, :2] - self.corners[:, 0, :2])

    def covered(self) -> np.ndarray:
        """Return the covered part of each slave facet."""
        return np.bincount(self.slave, self.moments[:, 0], minlength=len(self.frames))

    def means(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the centroid (n_slave, 2) and covariance (n_slave, 2, 2) of what is covered of slave facets, 0 and 1
        if nothing is, and centroids of the parts (n, 2) relative to the first."""
        share = self.moments[:, 0] / self.covered()[self.slave]
        centroid = self._sum(share[:, None] * self.moments[:, 1:3])
        off = self.moments[:, 1:3] - centroid[self.slave]
        # the mean is now zero to the rounding of coordinates; across narrow parts, to that of their width is needed
        off -= self._sum(share[:, None] * off)[self.slave]
        spread = off[:, [0, 0, 1]] * off[:, [0, 1, 1]] + self.moments[:, 3:]
        covariance = self._sum(share[:, None] * spread)[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
        covariance[self.covered() == 0] = np.eye(2)
        return centroid, covariance, off

    def _sum(self, values: np.ndarray) -> np.ndarray:
        """Sums (n_slave, m) over the parts of each slave facet."""
        return np.stack([np.bincount(self.slave, column, minlength=len(self.frames)) for column in values.T], axis=1)


def _common_parts(surfaces: Surfaces, backward: float, forward: float) -> _Parts:
    """Visible common parts; those of slave facets of which a strip is covered in the strip's axes, else S has no digits
    left across it."""
    frames = _frames(surfaces)
    start, found = _candidates(surfaces, frames, backward, forward)
    parts = _clipped(surfaces, frames, start, found, backward, forward)
    covariance = parts.means()[1]
    trace = np.trace(covariance, axis1=1, axis2=2)
    strips = np.flatnonzero(np.linalg.det(covariance) < _STRIP * trace**2)
    if not len(strips):
        return parts
    axes = np.linalg.eigh(covariance[strips])[1]
    # proper rotations: the corners must stay counter-clockwise
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    frames[strips, :2] = np.einsum("fba,fbd->fad", axes, frames[strips, :2])
    return _clipped(surfaces, frames, start, found, backward, forward)


def _frames(surfaces: Surfaces) -> np.ndarray:
    corners = surfaces.points[surfaces.slave]
    normal = surfaces.normals[surfaces.slave].sum(axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    first = corners[:, 1] - corners[:, 0]
    first -= np.sum(first * normal, axis=1)[:, None] * normal
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normal, first), normal], axis=1)


def _local(surfaces: Surfaces, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centroids (n_slave, 3) of slave facets, and their corners relative to it in their frames."""
    corners = surfaces.points[surfaces.slave]
    origins = corners.mean(axis=1)
    return origins, np.einsum("fad,fkd->fka", frames, corners - origins[:, None])


def _candidates(surfaces: Surfaces, frames: np.ndarray, backward: float, forward: float
                ) -> tuple[np.ndarray, np.ndarray]:
    """Master facets that may be opposite to a slave facet: where those of each begin, and their numbers."""
    origins, local = _local(surfaces, frames)
    low, high = local.min(axis=1), local.max(axis=1)
    low[:, 2] -= backward
    high[:, 2] += forward
    slave, found = BoxTree(surfaces.points, surfaces.master).meeting(frames, origins, low, high)
    leaning = np.einsum("pd,pd->p", surfaces.master_side.vectors[found], frames[slave, 2])
    facing = leaning < -_GRAZING * surfaces.master_side.measures[found]
    start = np.cumsum(np.bincount(slave[facing] + 1, minlength=len(frames) + 1))
    return start, found[facing]


def _clipped(surfaces: Surfaces, frames: np.ndarray, start: np.ndarray, found: np.ndarray, backward: float,
             forward: float) -> _Parts:
    origins, local = _local(surfaces, frames)
    corners, slave = surfaces.points[surfaces.master], np.repeat(np.arange(len(frames)), np.diff(start))
    along = np.einsum("pkd,pd->pk", corners[found] - origins[slave][:, None], frames[slave, 0])
    found = found[np.lexsort((found, along.min(axis=1), slave))]
    moments = np.zeros((len(found), MOMENTS))
    common_moments(local, frames, origins, corners, start, found, backward, forward, moments)
    real = moments[:, 0] > 0
    return _Parts(slave[real], found[real], moments[real], frames, local)


def _barycentric(corners: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shape functions (n, 3) of plane triangles (n, 3, 2) at points (n, 2), and their gradients (n, 3, 2)."""
    opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    double = cross(opposite[:, 0], opposite[:, 1])[:, None]
    values = cross(opposite, at[:, None] - np.roll(corners, -1, axis=1)) / double
    return values, np.stack([-opposite[..., 1], opposite[..., 0]], axis=-1) / double[..., None]


def _integrate(surfaces: Surfaces, parts: _Parts) -> MortarInterface:
    """MortarInterface from the common parts."""
    slave, n_nodes = surfaces.slave, len(surfaces.points)
    centroid, covariance, off = parts.means()
    size = surfaces.slave_side.measures
    # areas on the slave facet instead of the plane
    stretch = size / np.einsum("fd,fd->f", surfaces.slave_side.vectors, parts.frames[:, 2])
    shape = _barycentric(parts.corners[..., :2], centroid)[0] * stretch[:, None]
    own = shape * parts.covered()[:, None]
    towards = np.linalg.solve(covariance, np.swapaxes(parts.corners[..., :2] - centroid[:, None], 1, 2))
    master, gap, distance = _dual_moments(surfaces, parts, shape, towards, off)

    carries = surfaces.carries[slave]
    share = _shared_out(carries)
    master = np.einsum("pij,pjk->pik", share[parts.slave], master)
    gap = np.einsum("pij,pj->pi", share[parts.slave], gap)
    followed = share * np.where(carries, 0.0, own)[:, None, :]
    rows = np.repeat(np.concatenate([slave[parts.slave], slave]), 3)
    columns = np.tile(np.concatenate([surfaces.master[parts.master], slave]), (1, 3)).ravel()
    values = np.concatenate([master, -followed]).ravel()
    total = sparse.csr_array((values, (rows, columns)), shape=(n_nodes, n_nodes))

    diagonal = np.bincount(slave.ravel(), np.where(carries, own, 0.0).ravel(), minlength=n_nodes)
    gaps = np.bincount(slave[parts.slave].ravel(), gap.ravel(), minlength=n_nodes)
    closest = np.full(n_nodes, np.inf)
    np.minimum.at(closest, slave[parts.slave], distance[:, None])
    around = np.bincount(slave.ravel(), np.repeat(size / 3, 3), minlength=n_nodes)
    nodes = np.flatnonzero(diagonal > _NEGLIGIBLE * around)
    coupling = sparse.csr_array(sparse.diags_array(1 / diagonal[nodes]) @ total[nodes])
    return MortarInterface(nodes=nodes, normals=surfaces.normals[nodes], weights=diagonal[nodes],
                           gaps=gaps[nodes] / diagonal[nodes], coupling=_without_rounding(coupling),
                           closest=closest[nodes])


def _dual_moments(surfaces: Surfaces, parts: _Parts, shape: np.ndarray, towards: np.ndarray, off: np.ndarray
                  ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Integrals (n_parts, 3, 3) of dual times master shape functions and (n_parts, 3) of dual functions times gap.
    Then the gap at the centroids (n_parts,). From :math:`\phi_j(c)` (n_slave, 3), :math:`S^{-1}(x_j - c)` (n_slave, 2,
    3) and :math:`\bar x - c` (n_parts, 2)."""
    slave, moments = parts.slave, parts.moments
    frames, own = parts.frames[slave], parts.corners[slave]
    origins = surfaces.points[surfaces.slave].mean(axis=1)[slave]
    other = np.einsum("pad,pkd->pka", frames, surfaces.points[surfaces.master[parts.master]] - origins[:, None])
    at, s = moments[:, 1:3], moments[:, [3, 4, 4, 5]].reshape(-1, 2, 2)
    value, slope = _barycentric(other[..., :2], at)
    base, base_slope = _barycentric(own[..., :2], at)
    # the gap as a fourth function next to the master's shape functions
    gap = np.sum(value * other[..., 2], axis=1) - np.sum(base * own[..., 2], axis=1)
    gap_slope = np.sum(slope * other[..., 2:], axis=1) - np.sum(base_slope * own[..., 2:], axis=1)
    value = np.column_stack([value, gap])
    slope = np.concatenate([slope, gap_slope[:, None]], axis=1)

    first = value[..., None] * off[:, None] + np.einsum("pab,pkb->pka", s, slope)
    result = value[:, None] + np.einsum("paj,pka->pjk", towards[slave], first)
    result *= (moments[:, :1] * shape[slave])[..., None]
    return result[..., :3], result[..., 3], gap


def _shared_out(carries: np.ndarray) -> np.ndarray:
    """How the dual functions of corners without multiplier go to the others: (n, 3, 3), zero where there are none."""
    left = np.maximum(np.count_nonzero(carries, axis=1), 1)
    share = carries[:, :, None] * ~carries[:, None, :] / left[:, None, None]
    return share + np.eye(3) * carries[:, :, None]


def _without_rounding(coupling: sparse.csr_array) -> sparse.csr_array:
    """A matrix without entries that are zero to rounding, its rows scaled to the sum 1."""
    row = np.repeat(np.arange(coupling.shape[0]), np.diff(coupling.indptr))
    size = np.abs(coupling.data)
    coupling.data[size <= _NEGLIGIBLE * np.maximum.reduceat(size, coupling.indptr[:-1])[row]] = 0.0
    coupling.eliminate_zeros()
    coupling = sparse.csr_array(sparse.diags_array(1 / coupling.sum(axis=1)) @ coupling)
    coupling.sort_indices()
    return coupling


SLIVER = 1e-14
"""Common parts smaller than this share of the slave facet are rounding."""

THIN = 1e-10
"""Overlaps of master facets thinner than this share of the slave facet's size are rounding."""


@kernel
def _local_coordinate(point, frame, origin, a):
    result = 0.0
    for c in range(3):
        result += frame[a, c] * (point[c] - origin[c])
    return result


@kernel
def common_moments(slave, frames, origins, corners, start, found, below, above, moments):
    """Compute the moments of the visible common parts of slave facets and the master facets found for them. A part is
    dropped if its gap, at its centroid, is outside [-below, above]. Where parts overlap, the one with the gap of
    smaller magnitude, at the centroid of the overlap, hides the other."""
    room = 1
    for s in range(len(slave)):
        room = max(room, start[s + 1] - start[s])
    masters, parts, sizes = np.empty((room, 3, 2)), np.empty((room, ROOM, 2)), np.empty(room, dtype=np.int64)
    gaps, base, corner = np.empty((room, 3)), np.empty(3), np.empty((3, 3))
    spare, piece = np.empty((2, 2 * ROOM, 2)), np.empty((2, ROOM, 2))
    boxes, hiding = np.empty((room, 5)), np.empty(room, dtype=np.int64)
    stack, states = np.empty((ROOM * (1 + room), 3, 2)), np.empty((ROOM * (1 + room), 2), dtype=np.int64)
    for s in range(len(slave)):
        area = 0.5 * _plane(slave[s], base)
        first, n, many = start[s], start[s + 1] - start[s], 0
        for i in range(n):
            # seen from the slave a facing facet runs clockwise: turned round
            for k in range(3):
                for a in range(3):
                    corner[2 - k, a] = _local_coordinate(corners[found[first + i], k], frames[s], origins[s], a)
            _plane(corner, gaps[i])
            for k in range(3):
                gaps[i, k] -= base[k]
                masters[i, k, 0], masters[i, k, 1] = corner[k, 0], corner[k, 1]
            sizes[i] = clip(masters[i], 3, slave[s], 3, parts[i], piece[0])
            polygon_moments(parts[i], sizes[i], moments[first + i])
            gap = _gap(gaps[i], moments[first + i])
            if not moments[first + i, 0] > SLIVER * area or gap > above or gap < -below:
                moments[first + i, 0] = 0.0
                sizes[i] = 0
            if sizes[i] > 0:
                many += 1
        if many > 1:
            tolerance = THIN * np.sqrt(area)
            widest = _bound(parts, sizes, masters, n, boxes)
            for i in range(n):
                n_hiding = _hiding(parts, sizes, masters, gaps, n, i, boxes, widest, tolerance, spare, hiding)
                if n_hiding > 0:
                    add_visible(parts[i], sizes[i], masters, hiding, n_hiding, tolerance, stack, states, piece,
                                moments[first + i])
                    if not moments[first + i, 0] > tolerance * tolerance:
                        moments[first + i, 0] = 0.0


@kernel
def _bound(parts, sizes, masters, n, boxes):
    """Write low x, low y, high x, high y of the parts, and low x of their masters; returns the largest width of one."""
    widest = 0.0
    for i in range(n):
        boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = np.inf, np.inf, -np.inf, -np.inf
        for k in range(sizes[i]):
            for c in range(2):
                boxes[i, c] = min(boxes[i, c], parts[i, k, c])
                boxes[i, 2 + c] = max(boxes[i, 2 + c], parts[i, k, c])
        boxes[i, 4] = min(masters[i, 0, 0], masters[i, 1, 0], masters[i, 2, 0])
        widest = max(widest, max(masters[i, 0, 0], masters[i, 1, 0], masters[i, 2, 0]) - boxes[i, 4])
    return widest


@inner_kernel
def _hiding(parts, sizes, masters, gaps, n, i, boxes, widest, tolerance, spare, hiding):
    """Write those that hide something of part i to ``hiding``; returns their number."""
    count = 0
    if sizes[i] == 0:
        return count
    for step in (-1, 1):
        j = i + step
        # j leaves the range after n steps
        while 0 <= j < n and boxes[i, 0] - widest <= boxes[j, 4] < boxes[i, 2]:
            if (sizes[j] > 0 and boxes[j, 0] < boxes[i, 2] - tolerance and boxes[j, 2] > boxes[i, 0] + tolerance
                    and boxes[j, 1] < boxes[i, 3] - tolerance and boxes[j, 3] > boxes[i, 1] + tolerance
                    and _nearer(parts, sizes, masters, gaps, i, j, tolerance, spare) == j):
                hiding[count] = j
                count += 1
            j += step
    return count


@kernel
def _plane(corners, plane):
    """Write height at the origin and slope of the plane through three local points; returns twice their area."""
    x1, y1, z1 = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
    x2, y2, z2 = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
    double = x1 * y2 - x2 * y1
    plane[1] = (z1 * y2 - z2 * y1) / double
    plane[2] = (z2 * x1 - z1 * x2) / double
    plane[0] = corners[0, 2] - plane[1] * corners[0, 0] - plane[2] * corners[0, 1]
    return double


@inner_kernel
def _gap(plane, moments):
    """Value at the centroid."""
    return plane[0] + plane[1] * moments[1] + plane[2] * moments[2]


@inner_kernel
def _nearer(parts, sizes, masters, gaps, i, j, tolerance, spare):
    """Which of two parts is nearer where they overlap, -1 if they do not; the same for (i, j) and (j, i)."""
    a, b = min(i, j), max(i, j)
    if separated(parts[a], sizes[a], masters[b], 3, tolerance):
        return -1
    common = np.empty(MOMENTS)
    polygon_moments(spare[0], clip(parts[a], sizes[a], masters[b], 3, spare[0], spare[1]), common)
    if not common[0] > tolerance * tolerance:
        return -1
    return a if abs(_gap(gaps[a], common)) <= abs(_gap(gaps[b], common)) else b
