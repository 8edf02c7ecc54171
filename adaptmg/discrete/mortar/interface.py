r"""What couples the contact nodes of a slave surface to the surface of another body: dual mortar multipliers.

The point opposite slave node j moves by :math:`\sum_k B_{jk} u_k`, a combination of the nodes of the master surface
with :math:`\sum_k B_{jk} = 1`. Non-penetration of the bodies is then nodal,
:math:`n_j\cdot(u_j - \sum_k B_{jk} u_k) \le g_j`, and a contact force on slave node j acts with the weights
:math:`-B_{jk}` on the master (B. Wohlmuth, Acta Numerica 20, 2011, doi:10.1017/S0962492911000079).

In the plane (:mod:`adaptmg.discrete.mortar.segments`) and in space (:mod:`adaptmg.discrete.mortar.triangles`) parts of
slave facets are found that have a part of a master facet opposite, at the distance g along the normal. With A, c and S,
measure, centroid and covariance of what is covered of a slave facet, and its corners :math:`x_j`, the dual basis
:math:`\psi = \mathrm{diag}(d)\,m^{-1}\phi` over the covered part (:math:`d_j = \int\phi_j`,
:math:`m_{ij} = \int\phi_i\phi_j`) is

.. math:: \psi_j(x) = \phi_j(c)\,\bigl(1 + (x_j - c)\cdot S^{-1}(x - c)\bigr),

which adds up to 1, is biorthogonal, and reproduces constants and linear functions however little is covered;

.. math:: D_{jj} = \int\phi_j = A\,\phi_j(c),\quad M_{jk} = \int\psi_j\,\phi_k^{\mathrm{master}},\quad B = D^{-1}M,
   \quad g_j = D_{jj}^{-1}\int\psi_j\,g .

In axisymmetry all integrals carry :math:`2\pi r`. Where corners b of a facet carry no multiplier, theirs are shared out
evenly among its r corners a that do (crosspoint modification): :math:`\psi_a + \frac1r\sum_b\psi_b` add up to 1 and
are biorthogonal on these corners, and :math:`D_{ab} = \frac1r\int\phi_b` makes b one of the nodes that a follows:
:math:`u_a - (\sum_k M_{ak} u_k - \sum_b D_{ab} u_b)/D_{aa}`.

Sources: B. Wohlmuth, SIAM J. Numer. Anal. 38, 2000, doi:10.1137/S0036142999350929 (dual multipliers); A. Popp,
M. Gitterle, M. Gee, W. Wall, Int. J. Numer. Meth. Engng 83, 2010, doi:10.1002/nme.2866 (in 3D); T. Cichosz,
M. Bischoff, Comput. Methods Appl. Mech. Engrg 200, 2011, doi:10.1016/j.cma.2010.11.004 (over the covered part).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse

from adaptmg.discrete.supports import HeldNodes
from adaptmg.mesh.arrays import Surface

NEVER_FACING = "the surfaces never face each other"
"""With these words the message begins when no part of the slave surface has the master surface opposite."""

_DEEPEST = 0.25  # of the size of the surfaces: overlap that is found without a given reach
_NEGLIGIBLE = 1e-13  # of the largest entry in a row of B, and of the measure around a node


@dataclass(frozen=True, eq=False)
class MortarInterface:
    """Contact nodes of a boundary (of a pair: slave nodes with a multiplier), and what they face."""

    nodes: np.ndarray  # (n,) int: slave nodes, ascending
    normals: np.ndarray  # (n, dim): unit normals, out of the slave body
    #: (n,): measure of the surface that belongs to each node, > 0: m in 2D, m^2 in 3D and in axisymmetry, over the full
    #: circumference
    weights: np.ndarray
    gaps: np.ndarray  # (n,): initial gap along the normal, m; negative where the bodies overlap
    #: (n, n_nodes): B, rows with sum 1, some entries negative; its columns are nodes of the master surface, and slave
    #: nodes without a multiplier
    coupling: sparse.csr_array | None = None  # in front of an obstacle
    #: (n,): smallest distance between the surfaces around each node, m, for the question whether they overlap: a dual
    #: function changes sign, so that its mean of a distance >= 0 may be negative
    closest: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.nodes)


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Two surfaces that are to be coupled."""

    slave_side: Surface
    master_side: Surface  # nodes on both, as at tips of a crack, are ordinary ones
    normals: np.ndarray  # (n_nodes, dim): unit normals at the nodes of the slave surface; other rows are not read
    excluded: np.ndarray = ()  # (n,) int: nodes of the slave surface without a multiplier; other nodes are ignored
    axisymmetric: bool = False  # x is a radius; 2D only
    points: np.ndarray = field(init=False, repr=False)  # (n_nodes, dim): those of the mesh, m
    slave: np.ndarray = field(init=False, repr=False)  # (n, dim) int64: facets
    master: np.ndarray = field(init=False, repr=False)  # (n, dim) int64: facets
    carries: np.ndarray = field(init=False, repr=False)  # (n_nodes,) bool
    size: float = field(init=False, repr=False)  # diagonal of the bounding box of both surfaces, m

    def __post_init__(self) -> None:
        points, slave_nodes, master_nodes = self.slave_side.points, self.slave_side.nodes, self.master_side.nodes
        carries = np.zeros(len(points), dtype=bool)
        carries[slave_nodes] = True
        carries[master_nodes] = carries[np.asarray(self.excluded, dtype=np.int64)] = False
        if not carries.any():
            raise ValueError("every node of the slave surface is excluded, or one of the master too, which leaves none "
                             "to carry contact; take the other surface as slave, or free some of its nodes")
        size = float(np.linalg.norm(np.ptp(points[np.r_[slave_nodes, master_nodes]], axis=0)))
        slave, master = (np.ascontiguousarray(one.facets, dtype=np.int64) for one in (self.slave_side,
                                                                                      self.master_side))
        for name, value in (("points", points), ("slave", slave), ("master", master), ("carries", carries),
                            ("size", size)):
            object.__setattr__(self, name, value)
        outward = np.einsum("fd,fkd->fk", self.slave_side.vectors, self.normals[slave])
        if not (outward > 0).all():
            i = slave[outward <= 0][0]
            raise ValueError(f"normals must point out of the slave body; that of node {i} {tuple(points[i].tolist())} "
                             "does not on one of its facets. Reverse the facets, or split the boundary where it has a "
                             "sharp corner")

    def depths(self, reach: float | None) -> tuple[float, float]:
        """Return how far behind and in front of the slave surface the master is looked for, m."""
        return (_DEEPEST * self.size, self.size) if reach is None else (reach, reach)


def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the cross products (...,) of vectors (..., 2) in the plane."""
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


@dataclass(frozen=True, eq=False)
class Parts:
    """Covered parts of slave facets with points to integrate by. Places are coordinates along a slave facet, relative
    to any point of it: so those of small parts lose no digits."""

    slave: np.ndarray  # (n,) int: facets
    master: np.ndarray  # (n,) int: facets
    places: np.ndarray  # (n, n_points, dim - 1)
    weights: np.ndarray  # (n, n_points): their measure on the slave facet, in axisymmetry over the circumference
    shapes: np.ndarray  # (n, n_points, dim): the shape functions of the master's corners
    distances: np.ndarray  # (n, n_points): along the unit normal, m
    corners: np.ndarray  # (n_slave, dim, dim - 1): places of the corners of all slave facets

    def only(self, kept: np.ndarray) -> Parts:
        """Return some of the parts."""
        return replace(self, **{name: getattr(self, name)[kept] for name in (
            "slave", "master", "places", "weights", "shapes", "distances")})

    def means(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return measure (n_slave,), centroid (n_slave, dim - 1) and covariance of what is covered of slave facets, 0,
        0 and 1 if nothing is; before the last, places relative to the centroid."""
        n, k = self.corners.shape[:2]

        def sums(values: np.ndarray) -> np.ndarray:
            return np.stack([np.bincount(self.slave, column, minlength=n) for column in values.T], axis=1)

        measure = sums(self.weights.sum(axis=1, keepdims=True))[:, 0]
        share = self.weights / np.where(measure > 0, measure, 1.0)[self.slave, None]  # an edge may lie on the axis
        centroid = sums(np.einsum("pq,pqa->pa", share, self.places))
        off = self.places - centroid[self.slave, None]
        # the mean is now zero to the rounding of coordinates; across narrow parts, to that of their width is needed
        off -= sums(np.einsum("pq,pqa->pa", share, off))[self.slave, None]
        products = np.einsum("pq,pqa,pqb->pab", share, off, off).reshape(-1, (k - 1)**2)
        covariance = sums(products).reshape(n, k - 1, k - 1)
        covariance[measure == 0] = np.eye(k - 1)
        return measure, centroid, off, covariance


def integrated(surfaces: Surfaces, parts: Parts, covered: np.ndarray, least: float, reach: float | None
               ) -> MortarInterface:
    """Return the coupling by the parts of those slave facets of which the share ``covered`` (n_slave,) is at least
    ``least``; ValueError if there are none."""
    carries, n_nodes = surfaces.carries[surfaces.slave], len(surfaces.points)
    parts = parts.only(((covered >= least) & carries.any(axis=1))[parts.slave])
    if not len(parts.slave):
        if covered.any():
            raise ValueError("the surfaces face each other only where slave nodes are excluded, or on a sliver of each "
                             "facet; take the other surface as slave")
        within = "" if reach is None else f" within a reach of {reach:.6g} m"
        raise ValueError(f"{NEVER_FACING}{within}: no ray along a normal of the slave surface meets the outer side of "
                         "the master surface. Check their positions and the orientation of their facets, or give a "
                         "larger reach")
    measure, shape, dual = _dual_functions(parts)
    own = measure[:, None] * shape
    # how the dual functions of corners without multiplier go to the others
    share = carries[:, :, None] * ~carries[:, None, :] / np.maximum(carries.sum(axis=1), 1)[:, None, None]
    share = share + np.eye(carries.shape[1]) * carries[:, :, None]
    tests = parts.weights[:, None] * np.einsum("pij,pqj->piq", share[parts.slave], dual)
    followed = share * np.where(carries, 0.0, own)[:, None, :]
    slave, k = surfaces.slave[parts.slave], carries.shape[1]
    rows = np.repeat(np.concatenate([slave, surfaces.slave]), k)
    columns = np.tile(np.concatenate([surfaces.master[parts.master], surfaces.slave]), (1, k)).ravel()
    values = np.concatenate([np.einsum("piq,pqk->pik", tests, parts.shapes), -followed]).ravel()
    total = sparse.csr_array((values, (rows, columns)), shape=(n_nodes, n_nodes))
    diagonal = np.bincount(surfaces.slave.ravel(), np.where(carries, own, 0.0).ravel(), minlength=n_nodes)
    gaps = np.bincount(slave.ravel(), np.einsum("piq,pq->pi", tests, parts.distances).ravel(), minlength=n_nodes)
    closest = np.full(n_nodes, np.inf)
    np.minimum.at(closest, slave, parts.distances.min(axis=1)[:, None])
    nodes = np.flatnonzero(diagonal > _NEGLIGIBLE * surfaces.slave_side.lumped(surfaces.axisymmetric))
    coupling = sparse.csr_array(sparse.diags_array(1 / diagonal[nodes]) @ total[nodes])
    return MortarInterface(nodes=nodes, normals=surfaces.normals[nodes], weights=diagonal[nodes],
                           gaps=gaps[nodes] / diagonal[nodes], coupling=_without_rounding(coupling),
                           closest=closest[nodes])


def _dual_functions(parts: Parts) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measures (n_slave,) of what is covered of slave facets, shape functions (n_slave, dim) at the centroids of that,
    and dual functions (n, n_points, dim)."""
    measure, centroid, off, covariance = parts.means()
    corners = np.swapaxes(parts.corners - centroid[:, None], 1, 2)
    n, k = corners.shape[::2]
    shape = np.linalg.solve(np.concatenate([np.ones((n, 1, k)), corners], axis=1), np.eye(k)[:, :1])[..., 0]
    towards = np.linalg.solve(covariance, corners)
    return measure, shape, shape[parts.slave, None] * (1 + np.einsum("pqa,paj->pqj", off, towards[parts.slave]))


def _without_rounding(coupling: sparse.csr_array) -> sparse.csr_array:
    """A matrix without entries that are zero to rounding, its rows scaled to the sum 1."""
    row = np.repeat(np.arange(coupling.shape[0]), np.diff(coupling.indptr))
    size = np.abs(coupling.data)
    coupling.data[size <= _NEGLIGIBLE * np.maximum.reduceat(size, coupling.indptr[:-1])[row]] = 0.0
    coupling.eliminate_zeros()
    coupling = sparse.csr_array(sparse.diags_array(1 / coupling.sum(axis=1)) @ coupling)
    coupling.sort_indices()
    return coupling


_SYMMETRY_TILT = np.cos(np.pi / 6)  # normals within 30 degrees of a plane of symmetry are put into it


def slave_normals(slave: Surface, held: HeldNodes) -> np.ndarray:
    """Return average normals (n_nodes, dim) without components along what supports hold, where these are small."""
    normals, nodes = slave.node_normals.copy(), slave.nodes
    inside = held.free_part(nodes, normals[nodes])
    lengths = np.linalg.norm(inside, axis=1)
    tilted = lengths > _SYMMETRY_TILT
    normals[nodes[tilted]] = inside[tilted] / lengths[tilted, None]
    return normals
