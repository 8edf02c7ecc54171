"""MeshArrays: a simplicial mesh as frozen arrays, the form in which every other layer sees a mesh.

Facets of a simplicial mesh: who shares them, which lie on the boundary. Arrays only.

A facet (edge of a triangle, face of a tetrahedron) belongs to two elements inside a mesh and to one on its boundary. It
is identified by its sorted nodes :math:`a < b (< c)`, packed into one integer :math:`(a N + b) N + c`.

Geometry of domains: sides of a box, distance to named boundaries, whether an outline crosses itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from adaptmg._runtime import OnDemand, made_on_demand
from adaptmg.problem.plane_domains import Box, Outline, Polygon, Rectangle

if TYPE_CHECKING:
    import ngsolve

__all__ = [
    "BOX_SIDES",
    "MOST_NODES",
    "FacetTable",
    "MeshArrays",
    "components",
    "distance_of_segments",
    "distance_to_boundaries",
    "element_facets",
    "facet_keys",
    "facet_table",
    "longest_edges",
    "require_simple",
    "same_orientation",
    "sound_by_construction",
    "trusted",
]

# of these, masks and floats that are whole numbers are taken too: np.zeros(n) or x > 0 is what one writes
_LABELS = ("facet_labels", "element_body")


def _frozen(name: str, array: np.ndarray, dtype: type) -> np.ndarray:
    """A read-only copy; node numbers are not rounded from floats, nor wrapped from more than 32 bits."""
    if (type(array) is np.ndarray and array.dtype == dtype and array.base is None and array.flags.c_contiguous
            and not array.flags.writeable):
        return array
    given = np.asarray(array)
    whole = name in _LABELS and (given.dtype.kind == "b" or (given.dtype.kind == "f" and (given == given // 1).all()))
    if given.dtype.kind not in ("iuf" if dtype is np.float64 else "iu") and given.size and not whole:
        what = "real numbers" if dtype is np.float64 else "integers"
        raise TypeError(f"{name} must be an array of {what}, got an array of {given.dtype}")
    if dtype is np.int32 and given.size and not (given.min() >= -2**31 and given.max() < 2**31):
        raise ValueError(f"{name} must be below 2**31, got {given.min()} to {given.max()}")
    result = np.array(given, dtype=dtype, order="C")
    result.flags.writeable = False
    return result


@dataclass(frozen=True, eq=False)
class MeshArrays:
    """A mesh of triangles or tetrahedra with named boundaries.

    Parameters
    ----------
    points : (n_nodes, dim) array
        m.
    elements : (n_elements, dim + 1) array
        Node numbers, positively oriented.
    facets : (n_facets, dim) array
        Boundary edges (triangles in 3D), oriented so that the normal points out of the body: in 2D the outward
        normal of the edge (a, b) is its direction turned by -90 degrees; in 3D of (a, b, c) it is (b - a) x (c - a).
    facet_labels : (n_facets,) array
        Index into ``boundaries``.
    boundaries : tuple of str
        Distinct boundary names.
    element_body : (n_elements,) array, optional
        Index into ``bodies``; all zero by default.
    bodies : tuple of str
        Names of the bodies.
    source : ngsolve.Mesh, optional
        A straight ngsolve.Mesh of these arrays, with the same node and element numbers, for work in
        NGSolve. Meshes made by adaptmg build it when it is first read. Neither saved nor pickled:
        :func:`adaptmg.mesh.ngsolve_bridge.with_source` makes one anew. Copies share it.

    Attributes
    ----------
    sound : bool
        Whether :func:`adaptmg.mesh.check_mesh` has passed this mesh, or it is so by construction: the arrays are
        frozen, so that it need not be checked again.
    refinement : Refinement or None
        Of a bisected mesh its history, see :class:`adaptmg.mesh.bisection.children.Refinement`: further bisection
        goes on from it, coarsening takes it back. Pickled, but not saved in a result; a mesh made by
        ``dataclasses.replace`` has none, and is an initial mesh.
    """

    points: np.ndarray
    elements: np.ndarray
    facets: np.ndarray
    facet_labels: np.ndarray
    boundaries: tuple[str, ...]
    element_body: np.ndarray | None = None
    bodies: tuple[str, ...] = ("body",)
    source: Any = field(default=None, repr=False)
    sound: bool = field(default=False, init=False, repr=False)
    refinement: Any = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        for name, dtype in (("points", np.float64), ("elements", np.int32), ("facets", np.int32),
                            ("facet_labels", np.int32)):
            object.__setattr__(self, name, _frozen(name, getattr(self, name), dtype))
        body = np.zeros(len(self.elements), dtype=np.int32) if self.element_body is None else self.element_body
        object.__setattr__(self, "element_body", _frozen("element_body", body, np.int32))
        object.__setattr__(self, "boundaries", tuple(self.boundaries))
        object.__setattr__(self, "bodies", tuple(self.bodies))

    def __reduce__(self) -> tuple[Any, ...]:
        # by way of __init__, so that the arrays are frozen again; a worker need not load NGSolve to hand a mesh back
        return type(self), (self.points, self.elements, self.facets, self.facet_labels, self.boundaries,
                            self.element_body, self.bodies), {"sound": self.sound, "refinement": self.refinement}

    def __copy__(self) -> MeshArrays:
        # what is frozen needs no second copy, and a source that nobody has asked for yet is built once
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> MeshArrays:
        return self

    @property
    def dim(self) -> int:
        """Space dimension, 2 or 3."""
        return self.points.shape[1]

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.points)

    def boundary_facets(self, boundary: str) -> np.ndarray:
        """Facets (n, dim) of a named boundary; ValueError if there is no such boundary."""
        if boundary not in self.boundaries:
            raise ValueError(f"boundary {boundary!r} does not exist; the boundaries are {', '.join(self.boundaries)}")
        return self.facets[self.facet_labels == self.boundaries.index(boundary)]

    def boundary_nodes(self, boundary: str) -> np.ndarray:
        """Sorted node numbers of a named boundary."""
        return np.unique(self.boundary_facets(boundary))

    @cached_property
    def element_sizes(self) -> np.ndarray:
        """Longest edge of each element (n_elements,), m."""
        return longest_edges(self.points[self.elements])

    @cached_property
    def volumes(self) -> np.ndarray:
        """Signed area (m^2) or volume (m^3) of each element (n_elements,); positive in a valid mesh."""
        corners = self.points[self.elements]
        edges = corners[:, 1:] - corners[:, :1]
        return np.linalg.det(edges) / (2 if self.dim == 2 else 6)


def longest_edges(corners: np.ndarray) -> np.ndarray:
    """Longest edge (n,) of each of some simplices, given by their corners (n, dim + 1, dim)."""
    k = corners.shape[1]
    return np.max([np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i in range(k) for j in range(i)], axis=0)


def trusted(mesh: MeshArrays, source: Any, sound: bool = True) -> MeshArrays:
    """The same arrays, not copied, as a mesh that is known to be sound, with another source."""
    result = object.__new__(MeshArrays)
    result.__dict__.update(mesh.__dict__)
    result.__dict__.update(source=source, sound=sound)
    return result


def sound_by_construction(mesh: MeshArrays) -> MeshArrays:
    """The mesh, not checked (it was written down as it must be), with a source on demand."""
    return trusted(mesh, OnDemand(_ngsolve_mesh))


def _ngsolve_mesh(mesh: MeshArrays) -> ngsolve.Mesh:
    from adaptmg.mesh.ngsolve_bridge import ngsolve_mesh

    return ngsolve_mesh(mesh)


MeshArrays.source = made_on_demand("source", "A straight ngsolve.Mesh of these arrays, or None.")


#: by dimension: node numbers are of 32 bits, and the three of a facet must fit into 63
MOST_NODES = {2: 2**31 - 1, 3: 2**21 - 1}

# facet k lies opposite node k; of a positively oriented element its normal (see MeshArrays.facets) points outwards
_LOCAL = {2: np.array([[1, 2], [2, 0], [0, 1]]), 3: np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])}


@dataclass(frozen=True, eq=False)
class FacetTable:
    """The distinct facets of a mesh, sorted by key."""

    keys: np.ndarray  # (n,) int64: ascending, see facet_keys
    counts: np.ndarray  # (n,) int: how many elements share the facet
    first: np.ndarray  # (n,) int: two of those elements; second is -1 on the boundary
    second: np.ndarray  # (n,) int: two of those elements; second is -1 on the boundary
    facets: np.ndarray  # (n, dim) int: nodes, oriented outwards as seen from first
    folded: np.ndarray  # (n,) bool

    def find(self, keys: np.ndarray) -> np.ndarray:
        """Rows of this table that hold ``keys``, -1 where there is no such facet."""
        row = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[row] == keys, row, -1)


def element_facets(elements: np.ndarray) -> np.ndarray:
    """Facets (n_elements, dim + 1, dim) of positively oriented elements, outward, facet k opposite node k."""
    return elements[:, _LOCAL[elements.shape[1] - 1]]


def facet_keys(facets: np.ndarray, n_nodes: int) -> np.ndarray:
    """One integer a facet, the same for every order of its nodes."""
    dim = facets.shape[1]
    if n_nodes > MOST_NODES[dim]:
        raise ValueError(f"a {dim}D mesh may have at most {MOST_NODES[dim]} nodes, got {n_nodes}")
    nodes = np.sort(facets.astype(np.int64), axis=1)
    key = nodes[:, 0]
    for column in nodes.T[1:]:
        key = key * n_nodes + column
    return key


def facet_table(elements: np.ndarray, n_nodes: int) -> FacetTable:
    """All distinct facets of a mesh."""
    dim = elements.shape[1] - 1
    facets = element_facets(elements).reshape(-1, dim)
    keys = facet_keys(facets, n_nodes)
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    start = np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]])
    counts = np.diff(np.r_[start, len(keys)])
    second = np.full(len(start), -1, dtype=np.int64)
    shared = counts > 1
    other = order[start[shared] + 1]
    second[shared] = other // (dim + 1)
    first = facets[order[start]]
    folded = np.zeros(len(start), dtype=bool)
    folded[shared] = same_orientation(first[shared], facets[other])
    return FacetTable(keys[start], counts, order[start] // (dim + 1), second, first, folded)


def same_orientation(facets: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Whether facets with the same nodes also have the same orientation, (n,) bool."""
    if facets.shape[1] == 2:
        return (facets == others).all(axis=1)
    return np.any([(facets == np.roll(others, k, axis=1)).all(axis=1) for k in range(3)], axis=0)


def components(table: FacetTable, element_body: np.ndarray) -> np.ndarray:
    """Connected parts of a mesh: elements of one body that hang together through facets."""
    inner = table.second >= 0
    a, b = table.first[inner], table.second[inner]
    same = element_body[a] == element_body[b]
    n = len(element_body)
    graph = sparse.coo_array((np.ones(same.sum(), dtype=np.int8), (a[same], b[same])), shape=(n, n))
    return connected_components(graph, directed=False)[1]


# which side of a box a boundary is: axis, and lower (0) or upper (1) end; a rectangle's vertical axis is its last one
BOX_SIDES = {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1), "bottom": (2, 0), "top": (2, 1)}


def distance_to_boundaries(domain: Rectangle | Polygon | Outline | Box, boundaries: Sequence[str],
                           points: np.ndarray) -> np.ndarray:
    """Distance of points to the nearest of some boundaries of a domain."""
    distance = np.full(len(points), np.inf)
    if isinstance(domain, Box):
        for name in boundaries:
            axis, end = BOX_SIDES[name]
            distance = np.minimum(distance, np.abs(points[:, axis] - (domain.lower, domain.upper)[end][axis]))
        return distance
    curved = isinstance(domain, Outline)
    start = np.array(domain.vertices if curved else domain.polygon.vertices)
    end = np.roll(start, -1, axis=0)
    for i, (name, a, b) in enumerate(zip(domain.boundaries, start, end, strict=True)):
        if name in boundaries and curved and i in domain.arcs:
            distance = np.minimum(distance, domain.arc(i).distance(points))
        elif name in boundaries:
            along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            distance = np.minimum(distance, np.linalg.norm(points - a - along[:, None] * (b - a), axis=1))
    return distance


def require_simple(outline: Polygon | Outline) -> None:
    """Raise ValueError if edges of an outline cross, touch, or have no length (Netgen would not end, or err).

    Arcs are taken as chords of at most 3 degrees.
    """
    a, owner = outline.chords() if isinstance(outline, Outline) else (np.array(outline.vertices), None)
    b = np.roll(a, -1, axis=0)
    n = len(a)
    owner = np.arange(n) if owner is None else owner
    what = type(outline).__name__.lower()

    def edge_name(k: int) -> str:
        return f"{owner[k]} ({outline.boundaries[owner[k]]!r})"

    lengths = np.linalg.norm(b - a, axis=1)
    tiny = 1e-12 * np.ptp(a, axis=0).max()
    if not lengths.min() > tiny:
        raise ValueError(f"vertices: edge {edge_name(int(np.argmin(lengths)))} of the {what} has no length")
    edge, following = b - a, np.roll(b - a, -1, axis=0)
    turn = edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0]
    folded = (np.abs(turn) <= 1e-12 * lengths * np.roll(lengths, -1)) & ((edge * following).sum(axis=1) < 0)
    if folded.any():
        i = int(np.argmax(folded))
        raise ValueError(f"vertices: edge {edge_name(i)} of the {what} folds back on itself at "
                         f"{tuple(b[i].tolist())}")
    i, j = np.triu_indices(n, 2)
    apart = (i != 0) | (j != n - 1)
    i, j = i[apart], j[apart]
    distance = distance_of_segments(a, i, j)
    crossing = (_side(a[i], b[i], a[j]) * _side(a[i], b[i], b[j]) < 0) & (
        _side(a[j], b[j], a[i]) * _side(a[j], b[j], b[i]) < 0)
    bad = crossing | (distance <= tiny) if len(i) else np.zeros(0, dtype=bool)
    if bad.any():
        k = int(np.argmax(bad))
        raise ValueError(f"vertices: edges {edge_name(i[k])} and {edge_name(j[k])} of the {what} meet; its boundary "
                         "must not cross itself")


def distance_of_segments(a: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Distance between edges i and j (m,) of a closed polygon of corners a (n, 2); they must not cross."""
    b = np.roll(a, -1, axis=0)
    # it is reached at an end of one of them
    return np.min([_to_segment(a[j], a[i], b[i]), _to_segment(b[j], a[i], b[i]), _to_segment(a[i], a[j], b[j]),
                   _to_segment(b[i], a[j], b[j])], axis=0)


def _side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Positive where c lies to the left of the line from a to b."""
    u, v = b - a, c - a
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def _to_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance of points to segments, pair by pair."""
    u = b - a
    along = np.clip(np.sum((p - a) * u, axis=1) / np.sum(u * u, axis=1), 0.0, 1.0)
    return np.linalg.norm(p - a - along[:, None] * u, axis=1)
