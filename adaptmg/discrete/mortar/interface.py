r"""What couples the contact nodes of a slave surface to the surface of another body.

The point opposite slave node j moves by :math:`\sum_k B_{jk} u_k`, a combination of the nodes of the master surface
with :math:`\sum_k B_{jk} = 1`. Non-penetration of the bodies is then nodal,
:math:`n_j\cdot(u_j - \sum_k B_{jk} u_k) \le g_j`, and a contact force on slave node j acts with the weights
:math:`-B_{jk}` on the master (B. Wohlmuth, Acta Numerica 20, 2011, doi:10.1017/S0962492911000079).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from adaptmg.discrete.inclined import HeldNodes
from adaptmg.mesh.arrays import Surface

NEVER_FACING = "the surfaces never face each other"
"""With these words the message begins when no part of the slave surface has the master surface opposite."""

_DEEPEST = 0.25  # of the size of the surfaces: overlap that is found without a given reach


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
            raise ValueError(f"normals must point out of the slave body; that of node {i} {_place(points, i)} does not "
                             "on one of its facets. Reverse the facets, or split the boundary where it has a sharp "
                             "corner")

    def depths(self, reach: float | None) -> tuple[float, float]:
        """Return how far behind and in front of the slave surface the master is looked for, m."""
        return (_DEEPEST * self.size, self.size) if reach is None else (reach, reach)


def _place(points: np.ndarray, node: int) -> tuple[float, ...]:
    return tuple(points[node].tolist())


def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the cross products (...,) of vectors (..., 2) in the plane."""
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def nothing_covered(covered: np.ndarray, reach: float | None, facet: str) -> str:
    """Return why no slave facet is kept, as text; ``covered`` is how much of each has the master opposite."""
    if covered.any():
        return (f"the surfaces face each other only where slave nodes are excluded, or on a sliver of each {facet}; "
                "take the other surface as slave")
    within = "" if reach is None else f" within a reach of {reach:.6g} m"
    return (f"{NEVER_FACING}{within}: no ray along a normal of the slave surface meets the outer side of the master "
            "surface. Check their positions and the orientation of their facets, or give a larger reach")


_SYMMETRY_TILT = np.cos(np.pi / 6)  # normals within 30 degrees of a plane of symmetry are put into it


def slave_normals(slave: Surface, held: HeldNodes) -> np.ndarray:
    """Return average normals (n_nodes, dim) without components along what supports hold, where these are small."""
    normals, nodes = slave.node_normals.copy(), slave.nodes
    inside = held.free_part(nodes, normals[nodes])
    lengths = np.linalg.norm(inside, axis=1)
    tilted = lengths > _SYMMETRY_TILT
    normals[nodes[tilted]] = inside[tilted] / lengths[tilted, None]
    return normals
