r"""Mortar coupling of two triangulated surfaces in 3D with dual Lagrange multipliers.

Every slave triangle has an auxiliary plane through its centroid, normal to the average of its nodal normals. The
triangle and the master triangles that face it are projected on it along that normal, and clipped against each other.
On the common parts all shape functions and the gap are affine, so that the integrals follow from area, centroid and
covariance of each part, without quadrature. With :math:`A, c, S` area, centroid and covariance of what is covered of
the triangle, and :math:`x_j` its projected corners, the dual basis :math:`\psi = \mathrm{diag}(d)\,m^{-1}\phi` over
the covered part (:math:`d_j = \int\phi_j,\ m_{ij} = \int\phi_i\phi_j`) is

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

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.discretisation.facets import area_vectors
from adaptmg.discretisation.mortar.interface import MortarInterface, Surfaces, nothing_covered
from adaptmg.discretisation.mortar.kernels_3d import common_moments, find_opposite
from adaptmg.geometry.box_tree import BoxTree
from adaptmg.geometry.polygons import MOMENTS
from adaptmg.problem.checks import nonnegative, positive

__all__ = ["mortar_3d"]

_DEEPEST = 0.25  # of the size of the surfaces: overlap that is found without a given reach
_NEGLIGIBLE = 1e-13  # of the largest entry in a row of B, and of the area around a node
_STRIP = 1e-3  # S of a smaller ratio det(S) / trace(S)^2 is taken in its principal axes


def mortar_3d(points: np.ndarray, slave_facets: np.ndarray, master_facets: np.ndarray, normals: np.ndarray, *,
              excluded: Iterable[int] = (), reach: float | None = None, min_coverage: float = 1e-6) -> MortarInterface:
    r"""Couple the nodes of a slave surface to a master surface.

    Parameters
    ----------
    points : (n_nodes, 3) array
        m.
    slave_facets, master_facets : (n, 3) array of int
        Triangles, counter-clockwise seen from outside of their body. No common nodes.
    normals : (n_nodes, 3) array
        Unit normals out of the slave body; rows of slave nodes are read, see
        :func:`~adaptmg.discretisation.mortar.surface_normals.surface_normals`.
    excluded : iterable of int
        Nodes that carry no multiplier (of another pair, or held); those not on the slave surface are ignored.
    reach : float, optional
        Largest distance along the normal, forwards (gap) and backwards (overlap), at which the master is looked for,
        m; a common part of two triangles counts as a whole, by the distance at its centroid. Default: forwards the
        diagonal of the bounding box of both surfaces, backwards a quarter of it.
    min_coverage : float
        Slave triangles of which a smaller fraction has the master opposite are left out.

    Returns
    -------
    MortarInterface
        Slave nodes with the master opposite to a part, at least, of one of their triangles. The coupling may have
        negative entries, as dual functions change sign; they are large, of the order of one over its width, where
        only a small part in the middle of a triangle is covered. At nodes of triangles with excluded nodes the gap is
        that of :math:`u_a` and the excluded :math:`u_b` together: :math:`\int\psi_a g / D_{aa}` exceeds the mean of g
        by the factor :math:`1 + \sum_b D_{ab}/D_{aa}`.

    Raises
    ------
    ValueError
        If no part of the slave surface has the master surface opposite within reach, and on arrays that do not fit
        together (see :class:`~adaptmg.discretisation.mortar.interface.Surfaces`).

    Notes
    -----
    Of several master triangles on a line of sight the nearest counts, among those that face the slave (normals at
    more than 90.6 degrees). O(n log n).
    """
    if np.shape(points)[1:] != (3,):
        raise ValueError(f"points must have shape (n_nodes, 3), got {np.shape(points)}")
    surfaces = Surfaces(points, slave_facets, master_facets, normals, excluded)
    min_coverage = nonnegative("min_coverage", min_coverage)
    backward, forward = (_DEEPEST * surfaces.size, surfaces.size) if reach is None else (positive("reach", reach),) * 2
    parts = _common_parts(surfaces, backward, forward)
    covered = parts.covered()
    enough = (covered > 0) & (covered >= min_coverage * parts.areas())
    kept = (enough & surfaces.carries[surfaces.slave].any(axis=1))[parts.slave]
    if not kept.any():
        raise ValueError(nothing_covered(covered, reach, "triangle"))
    return _integrate(surfaces, parts.only(kept))


@dataclass(frozen=True, eq=False)
class _Parts:
    """Common parts of slave and master facets.

    Attributes
    ----------
    slave, master : (n,) array of int
        Facets.
    moments : (n, MOMENTS) array
        Area, centroid and covariance in the frame of the slave facet.
    frames : (n_slave, 3, 3) array
        Rows e1, e2, n.
    corners : (n_slave, 3, 3) array
        Slave corners in their frame, whose origin is the centroid.
    """

    slave: np.ndarray
    master: np.ndarray
    moments: np.ndarray
    frames: np.ndarray
    corners: np.ndarray

    def only(self, kept: np.ndarray) -> _Parts:
        """Some of the parts."""
        return _Parts(self.slave[kept], self.master[kept], self.moments[kept], self.frames, self.corners)

    def areas(self) -> np.ndarray:
        """Projected area of each slave facet."""
        return 0.5 * _cross(self.corners[:, 1, :2] - self.corners[:, 0, :2],
                            self.corners[:, 2, :2] - self.corners[:, 0, :2])

    def covered(self) -> np.ndarray:
        """Covered part of it."""
        return np.bincount(self.slave, self.moments[:, 0], minlength=len(self.frames))

    def means(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Centroid (n_slave, 2) and covariance (n_slave, 2, 2) of what is covered of slave facets, 0 and 1 if nothing
        is, and centroids of the parts (n, 2) relative to the first."""
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


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


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
    corners = surfaces.points[surfaces.master]
    tree = BoxTree(surfaces.points, surfaces.master)
    origins, local = _local(surfaces, frames)
    low, high = local.min(axis=1), local.max(axis=1)
    low[:, 2] -= backward
    high[:, 2] += forward
    start = np.zeros(len(frames) + 1, dtype=np.int64)
    arguments = (frames, origins, low, high, tree.boxes, tree.order, corners,
                 area_vectors(surfaces.points, surfaces.master), start)
    find_opposite(*arguments, False, np.empty(0, dtype=np.int64))
    np.cumsum(start, out=start)
    found = np.empty(start[-1], dtype=np.int64)
    find_opposite(*arguments, True, found)
    return start, found


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
    double = _cross(opposite[:, 0], opposite[:, 1])[:, None]
    values = _cross(opposite, at[:, None] - np.roll(corners, -1, axis=1)) / double
    return values, np.stack([-opposite[..., 1], opposite[..., 0]], axis=-1) / double[..., None]


def _integrate(surfaces: Surfaces, parts: _Parts) -> MortarInterface:
    """MortarInterface from the common parts."""
    slave, n_nodes = surfaces.slave, len(surfaces.points)
    centroid, covariance, off = parts.means()
    normal = area_vectors(surfaces.points, slave)
    size = np.linalg.norm(normal, axis=1)
    # areas on the slave facet instead of the plane
    stretch = size / np.einsum("fd,fd->f", normal, parts.frames[:, 2])
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

    Then the gap at the centroids (n_parts,).

    From :math:`\phi_j(c)` (n_slave, 3), :math:`S^{-1}(x_j - c)` (n_slave, 2, 3) and :math:`\bar x - c` (n_parts, 2).
    """
    slave, moments = parts.slave, parts.moments
    frames, own = parts.frames[slave], parts.corners[slave]
    origins = surfaces.points[surfaces.slave].mean(axis=1)[slave]
    other = np.einsum("pad,pkd->pka", frames, surfaces.points[surfaces.master[parts.master]] - origins[:, None])
    at, s = moments[:, 1:3], moments[:, [3, 4, 4, 5]].reshape(-1, 2, 2)
    value, slope = _barycentric(other[..., :2], at)
    base, base_slope = _barycentric(own[..., :2], at)
    # the gap as a fourth function beside the master's shape functions
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
