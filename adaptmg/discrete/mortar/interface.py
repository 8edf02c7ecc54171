r"""MortarInterface: what couples the contact nodes of a slave surface to the surface of another body.

The point opposite slave node j moves by :math:`\sum_k B_{jk} u_k`, a combination of the nodes of the master surface
with :math:`\sum_k B_{jk} = 1`. Non-penetration of the bodies is then nodal,
:math:`n_j\cdot(u_j - \sum_k B_{jk} u_k) \le g_j`, and a contact force on slave node j acts with the weights
:math:`-B_{jk}` on the master (B. Wohlmuth, Acta Numerica 20, 2011, doi:10.1017/S0962492911000079).

Averaged nodal normals of a surface.

With the area vectors :math:`a_F` (length times normal in 2D, area times normal in 3D) of the facets F at node i,

.. math:: n_i = \sum_F a_F \Big/ \Big|\sum_F a_F\Big| .
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from adaptmg.discrete.facets import area_vectors

__all__ = ["NEVER_FACING", "MortarInterface", "Surfaces", "nothing_covered", "surface_normals"]

NEVER_FACING = "the surfaces never face each other"
"""With these words the message begins when no part of the slave surface has the master surface opposite."""


@dataclass(frozen=True, eq=False)
class MortarInterface:
    """Slave nodes with a multiplier, and what they face.

    Parameters
    ----------
    nodes : (n,) array of int
        Slave nodes, ascending.
    normals : (n, dim) array
        Unit normals, out of the slave body.
    weights : (n,) array
        Measure of the surface that belongs to each node, > 0: m in 2D, m^2 in 3D and in axisymmetry, where it is the
        area over the full circumference. A nodal force divided by it is a traction.
    gaps : (n,) array
        Initial gap along the normal, m; negative where the bodies overlap.
    coupling : (n, n_nodes) sparse
        B, rows with sum 1: its columns are nodes of the master surface, and slave nodes without a multiplier. Single
        entries may be negative.
    closest : (n,) array, optional
        Smallest distance between the surfaces around each node, m, for the question whether they overlap: a dual
        function changes sign, so that its mean of a distance >= 0 may be negative. Default: ``gaps``.

    Raises
    ------
    TypeError, ValueError
        On wrong types or shapes, normals without length 1, weights that are not positive, rows whose sum is not 1, or
        a node that follows a node of ``nodes``.
    """

    nodes: np.ndarray
    normals: np.ndarray
    weights: np.ndarray
    gaps: np.ndarray
    coupling: sparse.csr_array
    closest: np.ndarray | None = None

    def __post_init__(self) -> None:
        nodes = np.asarray(self.nodes)
        if nodes.dtype.kind not in "iu":
            raise TypeError(f"nodes must be integers, got {nodes.dtype}")
        if not sparse.issparse(self.coupling):
            raise TypeError(f"coupling must be a scipy sparse matrix, got {type(self.coupling).__name__}")
        nodes, n = nodes.astype(np.int64), nodes.size
        coupling = sparse.csr_array(self.coupling, dtype=np.float64, copy=True)
        if nodes.ndim != 1 or n == 0 or nodes[0] < 0 or not (np.diff(nodes) > 0).all():
            raise ValueError(f"nodes must be ascending node numbers >= 0, at least one, got {self.nodes!r}")
        if coupling.shape[0] != n or coupling.shape[1] <= nodes[-1]:
            raise ValueError(f"coupling must have {n} rows and a column for every node, more than {nodes[-1]}, got "
                             f"{coupling.shape}")
        normals, weights, gaps = (_finite(name, getattr(self, name)) for name in ("normals", "weights", "gaps"))
        if normals.shape not in ((n, 2), (n, 3)) or weights.shape != (n,) or gaps.shape != (n,):
            raise ValueError(f"normals, weights and gaps must have a row for each of {n} nodes, got {normals.shape}, "
                             f"{weights.shape} and {gaps.shape}")
        _require(np.abs(np.linalg.norm(normals, axis=1) - 1) <= 1e-6, nodes, "normals must have length 1")
        _require(weights > 0, nodes, "weights must be > 0")
        _require(np.abs(np.asarray(coupling.sum(axis=1)).ravel() - 1) <= 1e-8, nodes,
                 "rows of coupling must have the sum 1")
        if coupling[:, nodes].count_nonzero():
            raise ValueError("coupling must have no entries in the columns of nodes: a node of the slave surface "
                             "cannot be one of the master surface")
        for array in (nodes, normals, weights, gaps):
            array.flags.writeable = False
        closest = gaps if self.closest is None else self.closest
        for name, value in (("nodes", nodes), ("normals", normals), ("weights", weights), ("gaps", gaps),
                            ("coupling", coupling), ("closest", closest)):
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def dim(self) -> int:
        """Space dimension."""
        return self.normals.shape[1]


def _finite(name: str, value: object) -> np.ndarray:
    result = np.array(value, dtype=np.float64)
    if not np.isfinite(result).all():
        raise ValueError(f"{name} must be finite; {np.count_nonzero(~np.isfinite(result))} entries are not")
    return result


def _require(good: np.ndarray, nodes: np.ndarray, message: str) -> None:
    if not good.all():
        raise ValueError(f"{message}; not so at node {nodes[int(np.argmin(good))]}")


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Two surfaces that are to be coupled, checked."""

    points: np.ndarray  # (n_nodes, dim): m
    slave: np.ndarray  # (n, dim) int: facets, oriented outwards as in MeshArrays; the surfaces share no node
    master: np.ndarray  # (n, dim) int: facets, oriented outwards as in MeshArrays; the surfaces share no node
    normals: np.ndarray  # (n_nodes, dim): unit normals at the nodes of the slave surface; other rows are not read
    excluded: Iterable[int] = ()  # nodes of the slave surface without a multiplier; other nodes are ignored
    axisymmetric: bool = False  # x is a radius; 2D only
    slave_nodes: np.ndarray = field(init=False, repr=False)  # (n,): ascending
    master_nodes: np.ndarray = field(init=False, repr=False)  # (n,): ascending
    carries: np.ndarray = field(init=False, repr=False)  # (n_nodes,) bool
    size: float = field(init=False, repr=False)  # diagonal of the bounding box of both surfaces, m

    def __post_init__(self) -> None:
        points, normals = (np.ascontiguousarray(value, dtype=np.float64) for value in (self.points, self.normals))
        if points.ndim != 2 or points.shape[1] not in (2, 3) or normals.shape != points.shape:
            raise ValueError("points must have shape (n_nodes, 2) or (n_nodes, 3) and normals the same, got "
                             f"{points.shape} and {normals.shape}")
        if self.axisymmetric and points.shape[1] != 2:
            raise ValueError("axisymmetric needs points in 2D (radius, axial position), got 3D")
        slave, master = (_facets(name, getattr(self, name), points) for name in ("slave", "master"))
        slave_nodes, master_nodes = np.unique(slave), np.unique(master)
        common = np.intersect1d(slave_nodes, master_nodes)
        if len(common):
            raise ValueError(f"slave and master surface share node {common[0]} {_place(points, common[0])}; they must "
                             "belong to bodies with nodes of their own")
        carries = np.zeros(len(points), dtype=bool)
        carries[slave_nodes] = True
        excluded = np.array([*self.excluded], dtype=np.int64)
        if ((excluded < 0) | (excluded >= len(points))).any():
            raise ValueError(f"excluded must hold node numbers from 0 to {len(points) - 1}, got {excluded.tolist()}")
        carries[excluded] = False
        if not carries.any():
            raise ValueError("excluded holds every node of the slave surface, which leaves none to carry contact; "
                             "take the other surface as slave, or free some of its nodes")
        for name, value in (("points", points), ("normals", normals), ("slave", slave), ("master", master),
                            ("slave_nodes", slave_nodes), ("master_nodes", master_nodes), ("carries", carries)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "size", float(np.linalg.norm(np.ptp(points[np.r_[slave_nodes, master_nodes]],
                                                                     axis=0))))
        self._check_normals()
        if self.axisymmetric and points[slave_nodes, 0].min() < -1e-12 * self.size:
            i = slave_nodes[np.argmin(points[slave_nodes, 0])]
            raise ValueError(f"axisymmetric: the slave surface must lie at radii >= 0, got node {i} "
                             f"{_place(points, i)}")

    def _check_normals(self) -> None:
        mine = self.normals[self.slave_nodes]
        good = np.abs(np.linalg.norm(mine, axis=1) - 1) <= 1e-6  # false for NaN
        if not good.all():
            i = self.slave_nodes[int(np.argmin(good))]
            raise ValueError(f"normals must have length 1 at the nodes of the slave surface, got {self.normals[i]} at "
                             f"node {i}")
        outward = np.einsum("fd,fkd->fk", area_vectors(self.points, self.slave), self.normals[self.slave])
        if not (outward > 0).all():
            i = self.slave[outward <= 0][0]
            raise ValueError(f"normals must point out of the slave body; that of node {i} {_place(self.points, i)} "
                             "does not on one of its facets. Turn the facets round, or split the boundary where it "
                             "has a sharp corner")


def _facets(name: str, value: object, points: np.ndarray) -> np.ndarray:
    result = np.asarray(value)
    dim = points.shape[1]
    if result.dtype.kind not in "iu":
        raise TypeError(f"{name} must hold integer node numbers, got {result.dtype}")
    if result.ndim != 2 or result.shape[1] != dim or not len(result):
        raise ValueError(f"{name} must have shape (n, {dim}) with n >= 1, got {result.shape}")
    if result.min() < 0 or result.max() >= len(points):
        raise ValueError(f"{name} must hold node numbers from 0 to {len(points) - 1}, got {result.min()} to "
                         f"{result.max()}")
    if not np.isfinite(points[result]).all():
        raise ValueError(f"points must be finite at the nodes of {name}")
    if not (np.linalg.norm(area_vectors(points, result), axis=1) > 0).all():
        raise ValueError(f"{name} has a facet without extent")
    return np.ascontiguousarray(result, dtype=np.int64)


def _place(points: np.ndarray, node: int) -> tuple[float, ...]:
    return tuple(points[node].tolist())


def nothing_covered(covered: np.ndarray, reach: float | None, facet: str) -> str:
    """Why no slave facet is kept, in words; ``covered`` is how much of each has the master opposite."""
    if covered.any():
        return ("the surfaces face each other only where slave nodes are excluded, or on less than min_coverage of "
                f"each {facet}; take the other surface as slave")
    within = "" if reach is None else f" within a reach of {reach:.6g} m"
    return (f"{NEVER_FACING}{within}: no ray along a normal of the slave surface meets the outer side of the master "
            "surface. Check their positions and the orientation of their facets, or give a larger reach")


_SYMMETRY_TILT = np.cos(np.pi / 6)


def surface_normals(points: np.ndarray, facets: np.ndarray, *, fixed: np.ndarray | None = None) -> np.ndarray:
    """Unit normals at the nodes of a surface."""
    points, facets = np.asarray(points, dtype=np.float64), np.asarray(facets)
    vectors = area_vectors(points, facets)
    measures = np.linalg.norm(vectors, axis=1)
    total, measure = np.zeros(points.shape), np.zeros(len(points))
    for corner in facets.T:
        np.add.at(total, corner, vectors)
        np.add.at(measure, corner, measures)
    nodes = np.unique(facets)
    lengths = np.linalg.norm(total[nodes], axis=1)
    if not (lengths > 1e-8 * measure[nodes]).all():
        i = nodes[int(np.argmin(lengths / measure[nodes]))]
        raise ValueError(f"the surface has no normal at node {i} {tuple(points[i].tolist())}: its facets there "
                         "cancel; split the boundary")
    total[nodes] /= lengths[:, None]
    return total if fixed is None else _along_symmetry_planes(total, nodes, fixed)


def _along_symmetry_planes(normals: np.ndarray, nodes: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Normals without their components along fixed directions, where these are small; changed in place."""
    fixed = np.asarray(fixed)
    if fixed.shape != normals.shape or fixed.dtype != bool:
        raise ValueError(f"fixed must be a boolean mask of shape {normals.shape}, got {fixed.dtype} {fixed.shape}")
    inside = np.where(fixed[nodes], 0.0, normals[nodes])
    lengths = np.linalg.norm(inside, axis=1)
    tilted = lengths > _SYMMETRY_TILT
    normals[nodes[tilted]] = inside[tilted] / lengths[tilted, None]
    return normals
