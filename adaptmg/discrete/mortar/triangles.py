r"""Mortar coupling of two triangulated surfaces in space: what of slave triangles is covered.

Every slave triangle has a frame (e1, e2, n) with its origin at the centroid, n being the average of its nodal normals;
coordinates in it are called local, and e1 and e2 span the auxiliary plane (M. Puso, T. Laursen, Comput. Methods Appl.
Mech. Engrg 193, 2004, doi:10.1016/j.cma.2003.06.010). The triangle and the master triangles that face it are projected
on it along that normal, and clipped against each other. On the common parts all shape functions and the gap are affine:
three points with the area, centroid and covariance of a part integrate products of two of them exactly. Areas are those
on the slave triangle.
"""

from __future__ import annotations

import numpy as np

from adaptmg._numba import inner_kernel, kernel
from adaptmg.discrete.mortar.interface import MortarInterface, Parts, Surfaces, cross, integrated
from adaptmg.geometry.clipping import MOMENTS, ROOM, add_visible, clip, polygon_moments, separated
from adaptmg.geometry.search import BoxTree

_LEAST_COVERED = 1e-6  # of a facet: less is left out
_GRAZING = 1e-2  # a master facet faces a slave facet if it leans towards its normal by more than this angle (rad)
_STRIP = 1e-3  # a covariance S of a smaller ratio det(S) / trace(S)^2 is taken in its principal axes
# three points of unit covariance, coordinate by coordinate
_POINTS = np.sqrt(2) * np.array([np.cos([0, 2 * np.pi / 3, 4 * np.pi / 3]), np.sin([0, 2 * np.pi / 3, 4 * np.pi / 3])])


def mortar_3d(surfaces: Surfaces, reach: float | None = None) -> MortarInterface:
    """Couple the nodes of a slave surface to a master surface."""
    depths, frames = surfaces.depths(reach), _frames(surfaces)
    start, found = _candidates(surfaces, frames, *depths)
    parts = _common_parts(surfaces, frames, start, found, *depths)
    covariance = parts.means()[-1]
    strips = np.flatnonzero(np.linalg.det(covariance) < _STRIP * np.trace(covariance, axis1=1, axis2=2)**2)
    if len(strips):
        # in the strip's axes, else the covariance has no digits left across it
        axes = np.linalg.eigh(covariance[strips])[1]
        # proper rotations: the corners must stay counter-clockwise
        axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
        frames[strips, :2] = np.einsum("fba,fbd->fad", axes, frames[strips, :2])
        parts = _common_parts(surfaces, frames, start, found, *depths)
    covered = np.bincount(parts.slave, parts.weights.sum(axis=1), minlength=len(frames)) / surfaces.slave_side.measures
    return integrated(surfaces, parts, covered, _LEAST_COVERED, reach)


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


def _common_parts(surfaces: Surfaces, frames: np.ndarray, start: np.ndarray, found: np.ndarray, backward: float,
                  forward: float) -> Parts:
    """The visible common parts."""
    origins, local = _local(surfaces, frames)
    slave = np.repeat(np.arange(len(frames)), np.diff(start))
    # seen from the slave a facing facet runs clockwise: turned round
    other = np.einsum("pad,pkd->pka", frames[slave],
                      surfaces.points[surfaces.master[found, ::-1]] - origins[slave][:, None])
    moments = np.empty((len(found), MOMENTS))
    common_moments(local, other, start, backward, forward, moments)
    real = moments[:, 0] > 0
    slave, master, other, moments = slave[real], found[real], other[real, ::-1], moments[real]
    area, at, (xx, xy, yy) = moments[:, 0], moments[:, 1:3], moments[:, 3:].T
    # the points are the corners of an equilateral triangle times the square root of the covariance
    wide = np.sqrt(xx)
    tilt = xy / wide
    high = np.sqrt(np.maximum(yy - tilt**2, 0.0))
    steps = np.stack([wide[:, None] * _POINTS[0], tilt[:, None] * _POINTS[0] + high[:, None] * _POINTS[1]], axis=2)
    value, slope = _barycentric(other[..., :2], at)
    base, base_slope = _barycentric(local[slave, :, :2], at)
    shapes = value[:, None] + np.einsum("pqa,pka->pqk", steps, slope)
    own_shapes = base[:, None] + np.einsum("pqa,pka->pqk", steps, base_slope)
    distances = np.einsum("pqk,pk->pq", shapes, other[..., 2]) - np.einsum("pqk,pk->pq", own_shapes, local[slave, :, 2])
    stretch = surfaces.slave_side.measures / np.einsum("fd,fd->f", surfaces.slave_side.vectors, frames[:, 2])
    weights = np.repeat((area * stretch[slave] / 3)[:, None], 3, axis=1)
    origin = np.zeros((len(frames), 2))
    origin[slave] = at
    return Parts(slave, master, (at - origin[slave])[:, None] + steps, weights, shapes, distances,
                 local[..., :2] - origin[:, None])


def _barycentric(corners: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shape functions (n, 3) of plane triangles (n, 3, 2) at points (n, 2), and their gradients (n, 3, 2)."""
    opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    double = cross(opposite[:, 0], opposite[:, 1])[:, None]
    values = cross(opposite, at[:, None] - np.roll(corners, -1, axis=1)) / double
    return values, np.stack([-opposite[..., 1], opposite[..., 0]], axis=-1) / double[..., None]


SLIVER = 1e-14
"""Common parts smaller than this share of the slave facet are rounding."""

THIN = 1e-10
"""Overlaps of master facets thinner than this share of the slave facet's size are rounding."""


@kernel
def common_moments(slave, masters, start, below, above, moments):
    """Compute the moments of the visible common parts of slave facets and the master facets found for them, by local
    corners. A part is dropped if its gap, at its centroid, is outside [-below, above]. Where parts overlap, the one
    with the gap of smaller magnitude, at the centroid of the overlap, hides the other."""
    room = 1
    for s in range(len(slave)):
        room = max(room, start[s + 1] - start[s])
    parts, sizes, boxes = np.empty((room, ROOM, 2)), np.empty(room, dtype=np.int64), np.empty((room, 4))
    gaps, base, hiding = np.empty((room, 3)), np.empty(3), np.empty(room, dtype=np.int64)
    spare, piece = np.empty((2, 2 * ROOM, 2)), np.empty((2, ROOM, 2))
    stack, states = np.empty((ROOM * (1 + room), 3, 2)), np.empty((ROOM * (1 + room), 2), dtype=np.int64)
    for s in range(len(slave)):
        area = 0.5 * _plane(slave[s], base)
        first, n, many = start[s], start[s + 1] - start[s], 0
        here = masters[first:first + n]
        for i in range(n):
            _plane(here[i], gaps[i])
            for k in range(3):
                gaps[i, k] -= base[k]
            sizes[i] = clip(here[i], 3, slave[s], 3, parts[i], piece[0])
            polygon_moments(parts[i], sizes[i], moments[first + i])
            gap = _gap(gaps[i], moments[first + i])
            if not moments[first + i, 0] > SLIVER * area or gap > above or gap < -below:
                moments[first + i, 0] = 0.0
                sizes[i] = 0
            for c in range(2):
                boxes[i, c], boxes[i, 2 + c] = np.inf, -np.inf
                for k in range(sizes[i]):
                    boxes[i, c] = min(boxes[i, c], parts[i, k, c])
                    boxes[i, 2 + c] = max(boxes[i, 2 + c], parts[i, k, c])
            if sizes[i] > 0:
                many += 1
        tolerance = THIN * np.sqrt(area)
        for i in range(n if many > 1 else 0):
            n_hiding = 0
            for j in range(n):
                if (j != i and boxes[j, 0] < boxes[i, 2] - tolerance and boxes[j, 2] > boxes[i, 0] + tolerance
                        and boxes[j, 1] < boxes[i, 3] - tolerance and boxes[j, 3] > boxes[i, 1] + tolerance
                        and _nearer(parts, sizes, here, gaps, i, j, tolerance, spare) == j):
                    hiding[n_hiding] = j
                    n_hiding += 1
            if n_hiding > 0:
                add_visible(parts[i], sizes[i], here, hiding, n_hiding, tolerance, stack, states, piece,
                            moments[first + i])
                if not moments[first + i, 0] > tolerance * tolerance:
                    moments[first + i, 0] = 0.0


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
