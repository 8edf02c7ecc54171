"""MeshArrays: a simplicial mesh as frozen arrays, the form in which every other layer sees a mesh;
its facets.

A facet (edge of a triangle, face of a tetrahedron) belongs to two elements inside a mesh and to one
on its boundary. It is identified by its sorted nodes :math:`a < b (< c)`, packed into one integer
:math:`(a N + b) N + c`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, DTypeLike
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from adaptmg import _checks as checks
from adaptmg._numba import kernel, read_only
from adaptmg._text import shortened

if TYPE_CHECKING:
    import ngsolve

# of these, masks and floats that are whole numbers are taken too: np.zeros(n) or x > 0 is what one
# writes
_LABELS = ("facet_labels", "element_body")
# pictures: pixels of the longer side and of the margin, elements beyond which only the boundary is
# drawn, the view from above and right
_SIZE = 480
_MARGIN = 4
_MANY = 20_000
_VIEW = np.array([[0.87, -0.25], [-0.5, -0.43], [0.0, -0.87]])


def _frozen(name: str, array: ArrayLike, dtype: type) -> np.ndarray:
    """Return the array of the field ``name`` of MeshArrays as a read-only copy, or itself if it is one
    already (a view is not: what it shows may be writable); TypeError for floats in place of integers,
    ValueError for integers beyond 32 bits."""
    if (
        type(array) is np.ndarray
        and array.dtype == dtype
        and array.base is None
        and array.flags.c_contiguous
        and not array.flags.writeable
    ):
        return array
    data = np.asarray(array)
    # of labels also masks and whole floats
    whole = name in _LABELS and (
        data.dtype.kind == "b" or (data.dtype.kind == "f" and (data == data // 1).all())
    )
    if data.dtype.kind not in ("iuf" if dtype is np.float64 else "iu") and data.size and not whole:
        what = "real numbers" if dtype is np.float64 else "integers"
        raise TypeError(f"{name} must be an array of {what}, got an array of {data.dtype}")
    may_overflow = dtype is np.int32 and data.dtype != np.int32 and data.size
    if may_overflow and not (data.min() >= -(2**31) and data.max() < 2**31):
        raise ValueError(f"{name} must be below 2**31, got {data.min()} to {data.max()}")
    result = np.array(data, dtype=dtype, order="C")
    result.flags.writeable = False
    return result


@dataclass(frozen=True, eq=False)
class Refinement:
    """The history of a bisected mesh. The corners of such a mesh's elements are in the order of
    bisection: the edge between the first two is halved next."""

    parents: np.ndarray  # (n_nodes, 2) int32: a new node is halfway between them
    marks: np.ndarray  # (n_elements,) int8: marked edges of tetrahedra; 0 of triangles
    generation: np.ndarray  # (n_elements,) int16: how many bisections lead to the element
    initial: np.ndarray  # the elements of the initial mesh, whose nodes come first


@dataclass(frozen=True, eq=False, init=False)
class MeshArrays:
    """A mesh of triangles or tetrahedra with named boundaries.

    Parameters
    ----------
    points : (n_nodes, dim) array
        m.
    elements : (n_elements, dim + 1) array
        Node numbers, positively oriented.
    facets : (n_facets, dim) array
        Boundary edges (triangles in 3D), oriented so that the normal points out of the body: in 2D
        the outward normal of the edge (a, b) is its direction turned by -90 degrees; in 3D of (a,
        b, c) it is (b - a) x (c - a).
    facet_labels : (n_facets,) array
        Index into ``boundaries``.
    boundaries : tuple of str
        Distinct boundary names.
    element_body : (n_elements,) array, optional
        Index into ``bodies``; all zero by default.
    bodies : tuple of str
        Names of the bodies.

    Raises
    ------
    TypeError, ValueError
        On wrong shapes and types, points that are not finite, no elements, numbers of nodes,
        boundaries or bodies that do not exist. :func:`adaptmg.mesh.check_mesh` checks the rest.

    Attributes
    ----------
    sound : bool
        Whether :func:`adaptmg.mesh.check_mesh` has passed this mesh, or it is so by construction.
    apart : bool
        Whether no body lies over itself: it was checked, or the package made the mesh.
    refinement : Refinement or None
        The history of a bisected mesh, which further bisection needs. Pickled, but not saved in a
        result; a mesh made by ``dataclasses.replace`` has none, and is an initial mesh.
    lattices : tuple of tuple of int
        Cells along each axis of each body of a structured mesh, between which interpolation needs
        no search; empty for others.
    notes : tuple of str
        What :func:`adaptmg.mesh.from_file` says of the file: elements that were cut, materials,
        what was not read.

    Examples
    --------
    >>> triangle = am.MeshArrays(
    ...     points=[[0, 0], [1, 0], [0, 1]], elements=[[0, 1, 2]],
    ...     facets=[[0, 1], [1, 2], [2, 0]], facet_labels=[0, 1, 1], boundaries=("bottom", "rest"))
    >>> triangle.n_nodes, triangle.dim
    (3, 2)
    """

    points: np.ndarray
    elements: np.ndarray
    facets: np.ndarray
    facet_labels: np.ndarray
    boundaries: tuple[str, ...]
    element_body: np.ndarray
    bodies: tuple[str, ...]
    sound: bool = field(default=False, init=False, repr=False)
    apart: bool = field(default=False, init=False, repr=False)
    refinement: Refinement | None = field(default=None, init=False, repr=False)
    lattices: tuple[tuple[int, ...], ...] = field(default=(), init=False, repr=False)
    notes: tuple[str, ...] = field(default=(), init=False, repr=False)

    def __init__(
        self,
        points: ArrayLike,
        elements: ArrayLike,
        facets: ArrayLike,
        facet_labels: ArrayLike,
        boundaries: tuple[str, ...],
        element_body: ArrayLike | None = None,
        bodies: tuple[str, ...] = ("body",),
    ) -> None:
        cells = _frozen("elements", elements, np.int32)
        if element_body is None:
            element_body = np.zeros(len(cells), dtype=np.int32)
        self.__dict__.update(
            points=_frozen("points", points, np.float64),
            elements=cells,
            facets=_frozen("facets", facets, np.int32),
            facet_labels=_frozen("facet_labels", facet_labels, np.int32),
            boundaries=tuple(boundaries),
            element_body=_frozen("element_body", element_body, np.int32),
            bodies=tuple(bodies),
        )
        _check_numbers(self.points, self.elements, self.facets)
        _check_labels(self)

    @classmethod
    def written(cls, **parts: Any) -> MeshArrays:
        """Return the mesh of read-only arrays that the package has written down as they must be: they
        are neither copied nor checked."""
        result = object.__new__(cls)
        result.__dict__.update(parts)
        return result

    def __repr__(self) -> str:
        kind = "triangles" if self.dim == 2 else "tetrahedra"
        return shortened(
            f"MeshArrays: {self.n_nodes} nodes, {len(self.elements)} {kind}; bodies "
            f"{', '.join(self.bodies)}; boundaries {', '.join(self.boundaries)}"
            + "; see its notes"
            * bool(self.notes)
        )

    def _repr_svg_(self) -> str | None:
        """Draw the edges of a plane mesh, or those of the boundary if the mesh is large or solid. Returns
        None if these are too many."""
        cells = self.elements if self.dim == 2 and len(self.elements) <= _MANY else self.facets
        # every pair of corners of a cell is an edge
        ends = np.concatenate([cells[:, [a, b]] for a in range(cells.shape[1]) for b in range(a)])
        edges = np.unique(np.sort(ends, axis=1), axis=0)
        # at most a picture of 5 MB: an edge takes about 25 characters
        if not 0 < len(edges) <= 10 * _MANY:
            return None
        # in the plane of the picture, whose second axis points down
        seen = self.points[edges] @ (np.diag([1.0, -1.0]) if self.dim == 2 else _VIEW)
        seen -= seen.min(axis=(0, 1))
        # the largest coordinate is 0 if all nodes of an unsound mesh coincide
        at = seen * (_SIZE / (seen.max() or 1.0)) + _MARGIN
        width, height = np.ceil(at.max(axis=(0, 1)) + _MARGIN).astype(int)
        path = "".join(f"M{x:.1f} {y:.1f}L{u:.1f} {v:.1f}" for (x, y), (u, v) in at.tolist())
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}">'
            f'<path d="{path}" fill="none" stroke="#3f454d" stroke-width="0.6"/></svg>'
        )

    def __reduce__(self) -> tuple:
        # by way of __init__, so that the arrays are frozen again, and without what is computed when it is
        # first read (surfaces, sizes, ...): among this ``source`` is a mesh of NGSolve, which whoever reads
        # the pickle would have to import
        return (
            type(self),
            (
                self.points,
                self.elements,
                self.facets,
                self.facet_labels,
                self.boundaries,
                self.element_body,
                self.bodies,
            ),
            {
                name: getattr(self, name)
                for name in ("sound", "apart", "refinement", "lattices", "notes")
            },
        )

    def __copy__(self) -> MeshArrays:
        # arrays that are frozen need no second copy, and the source is built once
        return self

    def __deepcopy__(self, memo: dict[int, object]) -> MeshArrays:
        return self

    @cached_property
    def source(self) -> ngsolve.Mesh:
        """Return a straight ngsolve.Mesh with the same node and element numbers, built when it is
        first read, neither saved nor pickled."""
        from adaptmg.mesh.netgen_worker import ngsolve_mesh

        return ngsolve_mesh(
            self.points,
            self.elements,
            self.facets,
            self.element_body,
            self.facet_labels,
            self.bodies,
            self.boundaries,
        )

    @property
    def dim(self) -> int:
        """Return the space dimension, 2 or 3."""
        return self.points.shape[1]

    @property
    def n_nodes(self) -> int:
        """Return the number of nodes."""
        return len(self.points)

    def boundary_facets(self, boundary: str) -> np.ndarray:
        """Return the facets (n, dim) of a named boundary; ValueError if there is no such
        boundary."""
        if checks.boundary_name("boundary", boundary) not in self.boundaries:
            raise ValueError(
                f"boundary {boundary!r} does not exist; the boundaries are {', '.join(self.boundaries)}"
            )
        return self.facets[self.facet_labels == self.boundaries.index(boundary)]

    def boundary_nodes(self, boundary: str) -> np.ndarray:
        """Return the sorted node numbers of a named boundary."""
        return np.unique(self.boundary_facets(boundary))

    def surface(self, boundary: str) -> Surface:
        """Return a named boundary with its measures and normals; ValueError if it does not exist,
        or has no facets."""
        if checks.boundary_name("boundary", boundary) not in self._surfaces:
            facets = self.boundary_facets(boundary)
            if not len(facets):
                raise ValueError(
                    f"boundary {boundary!r} has a name in the mesh but no facets: was its label lost in "
                    "meshing?"
                )
            self._surfaces[boundary] = Surface(self.points, facets)
        return self._surfaces[boundary]

    @cached_property
    def _surfaces(self) -> dict[str, Surface]:
        return {}

    @cached_property
    def box(self) -> np.ndarray:
        """Return the lowest and the highest corner (2, dim) of the bounding box, m."""
        # 20 times as fast as reductions along the first axis
        return np.array([[x.min(), x.max()] for x in self.points.T]).T

    @cached_property
    def sides(self) -> np.ndarray:
        """Return the sides (dim,) of the bounding box, m."""
        return self.box[1] - self.box[0]

    @cached_property
    def element_sizes(self) -> np.ndarray:
        """Return the longest edge of each element (n_elements,), m."""
        result = np.empty(len(self.elements))
        _longest(read_only(self.points), read_only(self.elements), result)
        return np.sqrt(result)

    @cached_property
    def volumes(self) -> np.ndarray:
        """Return the signed area (m^2) or volume (m^3) of each element (n_elements,); positive in a
        valid mesh."""
        return signed_measures(self.points, self.elements)


@dataclass(frozen=True, eq=False)
class Surface:
    r"""Facets, and what follows from where they lie, computed when it is first read.

    The area vector of a facet is its measure times its outward unit normal: in 2D the edge (a, b)
    turned by -90 degrees, in 3D :math:`\tfrac12 (b - a) \times (c - a)`. A node has the average
    normal
    :math:`n_i = \sum_F a_F \big/ \big|\sum_F a_F\big|` of the area vectors of the facets there.

    Attributes
    ----------
    points : (n_nodes, dim) array
        Those of the whole mesh, m.
    facets : (n, dim) int array
        Nodes of each facet, oriented as in MeshArrays.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> mesh.surface("top").normals.tolist()
    [[0.0, 1.0], [0.0, 1.0]]
    """

    points: np.ndarray
    facets: np.ndarray

    @cached_property
    def nodes(self) -> np.ndarray:
        """Return the nodes of the facets, ascending."""
        return np.unique(self.facets)

    @cached_property
    def vectors(self) -> np.ndarray:
        """Return the area vectors (n, dim)."""
        start, *ends = [self.points.take(corners, axis=0) for corners in self.facets.T]
        if self.points.shape[1] == 2:
            return (ends[0] - start)[:, ::-1] * (1.0, -1.0)  # (y, -x)
        a, b = [(end - start).T for end in ends]
        # the cross product, by numpy.cross 3 to 5 times as slow for 94k facets
        components = [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]
        return 0.5 * np.stack(components, axis=1)

    @cached_property
    def measures(self) -> np.ndarray:
        """Return the lengths (n,), m, or areas, m^2."""
        # .4 ms for 57 000 facets, by norm(axis=1) 1.0
        return np.sqrt(np.einsum("nd,nd->n", self.vectors, self.vectors))

    @property
    def sizes(self) -> np.ndarray:
        """Return the sizes (n,), m: lengths of edges, or roots of twice the areas of triangles."""
        return self.measures if self.points.shape[1] == 2 else np.sqrt(2 * self.measures)

    @cached_property
    def normals(self) -> np.ndarray:
        """Return the unit normals (n, dim) of the facets."""
        return self.vectors / self.measures[:, None]

    @property
    def node_normals(self) -> np.ndarray:
        """Return the mean unit normals (n_nodes, dim), 0 at other nodes; ValueError where facets at
        a node cancel."""
        return self.mean_normals()

    def mean_normals(self, originals: np.ndarray | None = None) -> np.ndarray:
        """Return :attr:`node_normals`; nodes with the same number in ``originals`` (n_nodes,) have one
        normal, the mean over the facets of all of them."""
        total = np.zeros(self.points.shape)
        measure = np.zeros(len(self.points))
        nodes = self.nodes
        for k, corner in enumerate(self.facets.T):
            node = corner if originals is None else originals[corner]
            np.add.at(total, node, self.corner_vectors(k))
            np.add.at(measure, node, self.measures)
        if originals is not None:
            total[nodes] = total[originals[nodes]]
            measure[nodes] = measure[originals[nodes]]
        lengths = np.linalg.norm(total[nodes], axis=1)
        # what is left of vectors that cancel is rounding
        if not (lengths > 1e-8 * measure[nodes]).all():
            i = nodes[int(np.argmin(lengths / measure[nodes]))]
            raise ValueError(
                f"the surface has no normal at node {i} {tuple(self.points[i].tolist())}: its facets "
                "there cancel; split the boundary"
            )
        total[nodes] /= lengths[:, None]
        return total

    def corner_vectors(self, k: int) -> np.ndarray:
        """Return the area vectors (n, dim) that corners k take for their normals."""
        return self.vectors

    def rises(self, facets: np.ndarray, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return how far (n, n_points) the surface of the meshed body is from points (n, n_points, dim)
        of some facets (n,), along unit vectors: 0 where only the facets are known."""
        return np.zeros(points.shape[:2])

    def shares(self, axisymmetric: bool) -> np.ndarray:
        """Return the means (n, dim) over each facet of the shape functions N_i of its corners i; in
        axisymmetry those of 2 pi r N_i: along the edge from i to j they are 2 pi (2 r_i + r_j) / 6."""
        if not axisymmetric:
            return np.full(self.facets.shape, 1.0 / self.points.shape[1])
        r = self.points[self.facets, 0]
        sum_of_ends = r.sum(axis=1, keepdims=True)
        return 2 * np.pi * (r + sum_of_ends) / 6

    def shape_integrals(self, axisymmetric: bool) -> np.ndarray:
        """Return the integrals (n, dim) of the shape functions of the corners over each facet."""
        return self.measures[:, None] * self.shares(axisymmetric)

    def lumped(self, axisymmetric: bool) -> np.ndarray:
        """Return the integrals (n_nodes,) of the shape functions of all nodes."""
        return np.bincount(
            self.facets.ravel(),
            weights=self.shape_integrals(axisymmetric).ravel(),
            minlength=len(self.points),
        )


def _check_numbers(points: np.ndarray, elements: np.ndarray, facets: np.ndarray) -> None:
    """Raise ValueError unless shapes fit, points are finite and all node numbers exist: compiled
    code follows them without a check."""
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise ValueError(f"points must have shape (n, 2) or (n, 3), got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(
            f"points must be finite, node {int(np.argmin(np.isfinite(points).all(axis=1)))} is not"
        )
    if not elements.size:
        raise ValueError("the mesh has no elements")
    n, dim = points.shape
    for name, array, width in (("elements", elements, dim + 1), ("facets", facets, dim)):
        if array.ndim != 2 or array.shape[1] != width:
            raise ValueError(f"{name} must have shape (n, {width}) in {dim}D, got {array.shape}")
        if len(array) and not 0 <= array.min() <= array.max() < n:
            bad = int(np.argmax(((array < 0) | (array >= n)).any(axis=1)))
            raise ValueError(
                f"{name}[{bad}] = {array[bad].tolist()} names a node that does not exist; "
                f"there are {n} nodes, counted from 0"
            )


def _check_labels(mesh: MeshArrays) -> None:
    """Raise ValueError unless there is a label for each facet and element, all of them index names,
    and names are distinct."""
    for name, count, what in (
        ("facet_labels", len(mesh.facets), "boundaries"),
        ("element_body", len(mesh.elements), "bodies"),
    ):
        index = getattr(mesh, name)
        names = getattr(mesh, what)
        if index.shape != (count,):
            raise ValueError(f"{name} must have shape ({count},), got {index.shape}")
        if count and not 0 <= index.min() <= index.max() < len(names):
            raise ValueError(
                f"{name} must index {what} ({len(names)} names), got {index.min()} to {index.max()}"
            )
        if len(set(names)) < len(names):
            raise ValueError(f"{what} must be distinct, got {names}")


def signed_measures(points: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """Return the signed areas or volumes (n,), m^2 or m^3, of the simplices ``elements`` (n, dim + 1)
    between ``points`` (n_nodes, dim)."""
    result = np.empty(len(elements))
    arrays = np.ascontiguousarray(points, np.float64), np.ascontiguousarray(elements, np.int32)
    _measure(*map(read_only, arrays), result)
    return result


@kernel
def _measure(points, elements, result):
    """Write the signed area or volume of each element into ``result`` (n_elements,): 196 608
    tetrahedra take .7 ms, by numpy 16 with 15 temporaries."""
    for e in range(len(elements)):
        i = elements[e, 0]
        j = elements[e, 1]
        k = elements[e, 2]
        # det [[a, b, c], [d, f, g], [p, q, r]] / dim! of the edges from corner i (2D: [[a, b], [d, f]]);
        # scalars take a quarter of the time of an array of edges
        a = points[j, 0] - points[i, 0]
        b = points[j, 1] - points[i, 1]
        d = points[k, 0] - points[i, 0]
        f = points[k, 1] - points[i, 1]
        if points.shape[1] == 2:
            result[e] = 0.5 * (a * f - b * d)
            continue
        m = elements[e, 3]
        c = points[j, 2] - points[i, 2]
        g = points[k, 2] - points[i, 2]
        p = points[m, 0] - points[i, 0]
        q = points[m, 1] - points[i, 1]
        r = points[m, 2] - points[i, 2]
        result[e] = (a * (f * r - g * q) - b * (d * r - g * p) + c * (d * q - f * p)) / 6


def positive(points: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """Return the simplices ``elements`` (n, dim + 1) between ``points`` (n_nodes, dim) with their last two
    corners exchanged where they are turned over."""
    negative = signed_measures(points, elements) < 0
    elements = np.array(elements)
    elements[negative, -2:] = elements[negative, :-3:-1]  # the last corner, then the one before it
    return elements


def edge_lengths(corners: np.ndarray) -> np.ndarray:
    """Return the edge lengths (n_edges, n) of some simplices, given by their corners (n, dim + 1,
    dim)."""
    k = corners.shape[1]
    return np.array(
        [np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i in range(k) for j in range(i)]
    )


@kernel
def _longest(points, elements, squares):
    """Write the square of the longest edge of each element into ``squares`` (n_elements,)."""
    for e in range(len(elements)):
        squares[e] = 0.0
        for i in range(elements.shape[1]):
            for j in range(i):
                square = 0.0
                for c in range(points.shape[1]):
                    square += (points[elements[e, i], c] - points[elements[e, j], c]) ** 2
                squares[e] = max(squares[e], square)


def centroids(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the means (n, dim) of the corners of elements or facets; ``mean`` over all corners at
    the same time takes fifteen times as long (143 000 triangles 10.5 ms, here .7)."""
    return sum(points.take(nodes, axis=0) for nodes in cells.T) / cells.shape[1]


class HasMesh(Protocol):
    """A level of a hierarchy, or a result: its mesh is None if it comes from matrices."""

    @property
    def mesh(self) -> MeshArrays | None: ...


def need_mesh(owner: HasMesh) -> MeshArrays:
    """Return the mesh of a level or of a result; ValueError if it has none.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.mesh.need_mesh(grids.finest).n_nodes
    25
    """
    if owner.mesh is None:
        raise ValueError(
            f"this {type(owner).__name__.lower()} has no mesh, as it comes from matrices: pose the "
            "problem on meshes (Hierarchy.uniform, graded or from_meshes)"
        )
    return owner.mesh


def initial_elements(mesh: MeshArrays) -> np.ndarray:
    """Return the elements of the initial mesh that a mesh was bisected from."""
    return mesh.elements if mesh.refinement is None else mesh.refinement.initial


def parents_of(mesh: MeshArrays) -> np.ndarray:
    """Return the parents (n_nodes, 2) of each node; those of a node of the initial mesh are itself."""
    if mesh.refinement is not None:
        return mesh.refinement.parents
    return np.repeat(np.arange(mesh.n_nodes, dtype=np.int32), 2).reshape(-1, 2)


def trusted(mesh: MeshArrays, sound: bool = True) -> MeshArrays:
    """Return the arrays of a mesh, not copied, as a mesh that is known to be ``sound``, or not (yet)."""
    return MeshArrays.written(**vars(mesh) | {"sound": sound})


def in_sweep_order(mesh: MeshArrays) -> MeshArrays:
    """Return a sound mesh in the order in which Gauss-Seidel sweeps: nodes sorted along the longest side
    of the bounding box, elements by their first nodes; no node moves. Gauss-Seidel takes a fifth
    more cycles in the order that refinement leaves behind, where new nodes come last, and where
    bodies come one after the other."""
    order, number, rows, elements = sweep_order(mesh.points, mesh.elements)
    return sound_by_construction(
        replace(
            mesh,
            points=mesh.points[order],
            elements=elements,
            facets=number[mesh.facets],
            element_body=mesh.element_body[rows],
        )
    )


def sweep_order(
    points: np.ndarray, elements: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the order (n,) of nodes (``points`` (n, dim)) along the longest side of their bounding
    box, the new numbers (n,) of the nodes, which are the inverse of this order, the order (m,) of
    elements by their lowest new number, and the elements (m, dim + 1) in that order, with the new
    numbers of their nodes."""
    n = len(points)
    order = np.argsort(points[:, np.argmax(np.ptp(points, axis=0))], kind="stable")
    number = np.empty(n, dtype=np.int32)
    number[order] = np.arange(n, dtype=np.int32)
    elements = number[elements]
    lowest_nodes = np.min(list(elements.T), axis=0)
    # the elements whose lowest node is 0, then those of node 1, ...: a stable sort by this node
    _, rows = occurrences(lowest_nodes, n)
    return order, number, rows, elements[rows]


def occurrences(numbers: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return ``start`` (n + 1,) and ``places`` (size,): the number i below ``n`` stands in the flattened
    array ``numbers`` at the ascending places ``places[start[i]:start[i + 1]]``. They are sorted by counting:
    160 000 take .7 ms, a stable sort 10.9."""
    size = numbers.size
    # a matrix whose column k, the place, has its only entry in the row of the number there
    rows = sparse.csc_array(
        (np.ones(size, dtype=bool), numbers.ravel(), np.arange(size + 1, dtype=np.int32)),
        shape=(n, size),
    ).tocsr()
    return rows.indptr, rows.indices


def sound_by_construction(
    mesh: MeshArrays, lattices: tuple[tuple[int, ...], ...] = ()
) -> MeshArrays:
    """Return the mesh without checks: it was written down as it must be."""
    return MeshArrays.written(**vars(mesh) | {"sound": True, "apart": True, "lattices": lattices})


#: by dimension: node numbers are of 32 bits, and the three of a facet must fit into 63
MOST_NODES = {2: 2**31 - 1, 3: 2**21 - 1}

#: facet k lies opposite node k; of a positively oriented element its normal (see MeshArrays.facets) points outwards
OPPOSITE = {
    2: np.array([[1, 2], [2, 0], [0, 1]]),
    3: np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]),
}


@dataclass(frozen=True, eq=False)
class FacetTable:
    """The distinct facets of a mesh, sorted by key."""

    keys: np.ndarray  # (n,) int64: ascending, see facet_keys
    counts: np.ndarray  # (n,) int: how many elements share the facet
    first: np.ndarray  # (n,) int: one of those elements
    second: np.ndarray  # (n,) int: another one, -1 on the boundary
    facets: np.ndarray  # (n, dim) int: nodes, oriented outwards as seen from first
    folded: np.ndarray  # (n,) bool: both elements lie on the same side

    def find(self, keys: np.ndarray) -> np.ndarray:
        """Return the rows of this table that hold ``keys``, -1 where there is no such facet."""
        row = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[row] == keys, row, -1)


def element_facets(elements: np.ndarray) -> np.ndarray:
    """Return facets (n_elements, dim + 1, dim) of positively oriented elements, outward, facet k
    opposite node k."""
    return elements[:, OPPOSITE[elements.shape[1] - 1]]


def pair_keys(first: np.ndarray, second: np.ndarray, n: int) -> np.ndarray:
    """Return one integer (int64) a pair of numbers, the second of them below ``n``: ``divmod`` with
    n gives both back. Numbers of int32, as those of nodes are, overflow in n * n from n = 46341."""
    return np.multiply(first, n, dtype=np.int64) + second


def mask_of(indices: np.ndarray, shape: int | tuple[int, ...]) -> np.ndarray:
    """Return the mask of this shape that is True at some indices, of any number of dimensions."""
    mask = np.zeros(shape, dtype=bool)
    mask[indices] = True
    return mask


def by_first_occurrence(
    values: np.ndarray, axis: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Number the distinct values, or with ``axis`` 0 rows, in the order in which they occur first. Return
    the place at which each occurs first, ascending, and the number (n,) of each value."""
    _, first, number = np.unique(values, axis=axis, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.argsort(order)  # the inverse of the order
    return first[order], rank[number.reshape(-1)]


def doubled(sets: np.ndarray, nodes: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return new numbers for the ``nodes`` (m,), below n, of corners of elements, so that corners in
    different ``sets`` (m,) share no node: the lowest set at a node keeps its number, further ones have
    n, n + 1, ...; and the nodes of which these are copies."""
    pairs, pair_of_corner = np.unique(pair_keys(sets, nodes, n), return_inverse=True)
    node = pairs % n
    is_further = np.ones(len(pairs), dtype=bool)
    is_further[np.unique(node, return_index=True)[1]] = False
    # the first pair at a node keeps its number, the k-th further one of all gets n + k - 1
    number = np.where(is_further, n - 1 + np.cumsum(is_further), node)
    return number[pair_of_corner], node[is_further]


def places_of(nodes: np.ndarray, n: int, dtype: DTypeLike = np.int64) -> np.ndarray:
    """Return for each of n nodes its place (n,) among some distinct ``nodes``, -1 for the others."""
    places = np.full(n, -1, dtype=dtype)
    places[nodes] = np.arange(len(nodes))
    return places


def facet_keys(facets: np.ndarray, n_nodes: int) -> np.ndarray:
    """Return one integer (n_facets,) a facet of ``facets`` (n_facets, dim), the same for every order of its
    nodes, below n_nodes."""
    dim = facets.shape[1]
    if n_nodes > MOST_NODES[dim]:
        raise ValueError(f"a {dim}D mesh may have at most {MOST_NODES[dim]} nodes, got {n_nodes}")
    nodes = np.ascontiguousarray(facets.T)
    lowest = nodes.min(axis=0)
    highest = nodes.max(axis=0)
    if dim == 2:
        return pair_keys(lowest, highest, n_nodes)
    middle = nodes.sum(axis=0) - lowest - highest
    return pair_keys(pair_keys(lowest, middle, n_nodes), highest, n_nodes)


def sorted_facet_keys(facets: np.ndarray, n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the ascending keys (n,) of facets (n, dim) and the order of the facets, equal ones as they
    come. One number holds a key and its place if it has bits for both, as up to a million plane and
    20 000 solid nodes: 190 000 edges take 3.6 ms, to sort places by their keys 9.1, by counting 6.7."""
    keys = facet_keys(facets, n_nodes)
    bits = len(keys).bit_length()
    if keys.max(initial=0) >> (63 - bits):
        order = np.argsort(keys, kind="stable")
        return keys.take(order), order
    keys <<= bits
    keys |= np.arange(len(keys))
    keys.sort()
    return keys >> bits, keys & ((1 << bits) - 1)


def facet_table(elements: np.ndarray, n_nodes: int) -> FacetTable:
    """Return all distinct facets of the elements (n_elements, dim + 1) of a mesh."""
    dim = elements.shape[1] - 1
    facets = element_facets(elements).reshape(-1, dim)
    # a facet of two elements stands there twice: once sorted, in adjacent rows
    keys, order = sorted_facet_keys(facets, n_nodes)
    start = np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]])
    counts = np.diff(np.r_[start, len(keys)])
    shared = counts > 1
    # rows of ``facets``, dim + 1 for each element
    row = order[start]
    other_row = order[start[shared] + 1]
    second = np.full(len(start), -1, dtype=np.int64)
    second[shared] = other_row // (dim + 1)
    distinct = facets.take(row, axis=0)
    folded = np.zeros(len(start), dtype=bool)
    folded[shared] = same_orientation(distinct[shared], facets.take(other_row, axis=0))
    return FacetTable(keys[start], counts, row // (dim + 1), second, distinct, folded)


def same_orientation(facets: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return whether ``facets`` and ``others`` (n, dim), of the same nodes, also have the same orientation
    (n,)."""
    if facets.shape[1] == 2:
        return (facets == others).all(axis=1)
    return np.any([(facets == np.roll(others, k, axis=1)).all(axis=1) for k in range(3)], axis=0)


def components(table: FacetTable, element_body: np.ndarray) -> np.ndarray:
    """Return the number of the connected part that each element (n_elements,) belongs to: elements of one
    body (``element_body`` (n_elements,)) that hang together through facets."""
    inner = table.second >= 0
    a = table.first[inner]
    b = table.second[inner]
    same = element_body[a] == element_body[b]
    n = len(element_body)
    graph = sparse.coo_array((np.ones(same.sum(), dtype=np.int8), (a[same], b[same])), shape=(n, n))
    return connected_components(graph, directed=False)[1]


def normalised(
    points: np.ndarray,
    elements: np.ndarray,
    facets: np.ndarray,
    facet_index: np.ndarray,
    facet_names: Sequence[str],
    body_index: np.ndarray,
    body_names: Sequence[str],
) -> MeshArrays:
    """Make MeshArrays of tables as files hold them, ``points`` (n, dim), ``elements`` (m, dim + 1) and
    ``facets`` (k, dim): turn elements and facets, drop facets inside and unused nodes.
    ``facet_index`` (k,) and ``body_index`` (m,) are rows of the names."""
    facets = np.reshape(facets, (-1, points.shape[1]))
    _check_numbers(points, elements, facets)
    elements = positive(points, elements)
    number = np.full(len(points), -1, dtype=np.int64)
    used = np.unique(elements)
    number[used] = np.arange(len(used))
    points = points[used]
    elements = number[elements]
    facets = number[facets]
    # without facets that have a node of no element
    facet_index = np.asarray(facet_index)[(facets >= 0).all(axis=1)]
    facets = facets[(facets >= 0).all(axis=1)]
    table = facet_table(elements, len(points))
    row = table.find(facet_keys(facets, len(points)))
    outer = (row >= 0) & (table.counts[row] == 1)
    boundaries, labels = _merged(facet_index[outer], facet_names)
    bodies, element_body = _merged(np.asarray(body_index), body_names)
    return MeshArrays(
        points, elements, table.facets[row[outer]], labels, boundaries, element_body, bodies
    )


def _merged(index: np.ndarray, names: Sequence[str]) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the distinct ``names`` that an index (n,) uses, in their order, and the index (n,) into these."""
    used: list[int] = np.unique(index).tolist()
    distinct = tuple(dict.fromkeys(names[i] for i in used))
    new = np.array([distinct.index(name) if name in distinct else -1 for name in names])
    return distinct, new[index]
