r"""Engines of the adaptive loop, which make the next mesh: Bisect, by bisection of what is marked,
and Remesh.

Bisect bisects each marked element, and its neighbours as far as conformity asks; new nodes of
curved boundaries are moved onto :attr:`ContactProblem.domain <adaptmg.ContactProblem>`.

Halving all edges leaves :math:`2^{-(2+d)}` of a square where the solution is smooth. Marked
elements of which more than half of the mean square would be left, as at singularities, are halved
twice, so that large steps lose nothing: measured on six problems, theta .8 takes .55 to .8 of the
seconds to an energy error that single halvings with theta .5 take, with as many nodes (a bolted
junction: a third more).

The first mesh decides on the shapes of all others. Regular ones stay regular: rectangles and boxes
begin with them. Measured at equal nodes, from such a mesh instead of one by Netgen, the energy
error is 3 % less in 2D, and 20 % (two boxes) to 30 % (one) in 3D.

Remesh makes each mesh from scratch, with sizes that equilibrate the error: independent of the one
before, coarser where the error is small, with nodes on the curves of the domain. Linear elements of
size h in d dimensions have
:math:`\eta_E^2 \sim h^{2+d}`. Equal squares therefore ask for

.. math:: \frac{h_{new}}{h} = c\,(\eta_E^2)^{-1/(2+d)}

(L. Y. Li and P. Bettess, Appl. Mech. Rev. 50, 1997, doi:10.1115/1.3101670), kept between two
bounds, averaged at the nodes (geometric mean over their elements) and graded: the largest sizes
below these with
:math:`h_i \le h_j + g\,|x_i - x_j|` for every edge ij. The constant c follows from the number of nodes that are wanted.
A mesh of sizes h has about

.. math:: N = q \Bigl(a_d \int h^{-d}\,dx + b_d \int_{\partial\Omega} h^{1-d}\,ds\Bigr), \qquad
          a_2 = 2/\sqrt3,\; b_2 = 1/2,\; a_3 = 1.4,\; b_3 = 0.6

nodes, where q makes it exact for the present mesh.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Protocol

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from adaptmg import _checks as checks
from adaptmg.discrete.scalar import ScalarProblem
from adaptmg.estimate.estimate import Estimate, estimate_for
from adaptmg.geometry.location import SimplexLocator
from adaptmg.level import check_problem, meshed_domain, need_domain
from adaptmg.mesh.arrays import MeshArrays, Surface, mask_of, pair_keys
from adaptmg.mesh.bisection import check_marked, refined
from adaptmg.mesh.lattices import lattices
from adaptmg.mesh.projection import onto_domain
from adaptmg.mesh.sizes import GRADING, NODES_PER_CELL
from adaptmg.mesh.soundness import check_mesh
from adaptmg.problem import Assembly, Box, ContactProblem, Rectangle


class Engine(Protocol):
    """The maker of the next mesh: Remesh, Bisect or a user-defined object. It may also have
    ``intermediate(problem, coarse, fine) -> MeshArrays or None``, a mesh between two whose sizes
    differ too much for neighbouring levels, and ``first(problem, size) -> MeshArrays or None``, the
    mesh to begin with."""

    def refine(
        self,
        problem: ContactProblem | ScalarProblem,
        mesh: MeshArrays,
        estimate: Estimate,
        marked: np.ndarray,
        max_nodes: int | None = None,
    ) -> MeshArrays | None:
        """Return the next mesh, finer at the elements of the mask ``marked`` (n_elements,), with at most
        about ``max_nodes`` nodes; the same one or None where there is no finer one."""


def sound_mesh(
    engine: Engine,
    method: str,
    problem: ContactProblem | ScalarProblem,
    made: object,
    like: MeshArrays | None = None,
) -> MeshArrays:
    """Return the mesh ``made`` by a ``method`` of an engine, which messages name, if it is sound and has the
    boundaries of a contact problem and, if given, the dimension and the bodies of the mesh ``like``; else
    TypeError or ValueError."""
    name = f"engine {checks.shown(engine)}: what {method} returns"
    made = checks.instance(name, made, MeshArrays, "MeshArrays")
    try:
        check_mesh(made)
        if like is not None and made.dim != like.dim:
            raise ValueError(f"it is {made.dim}D, not {like.dim}D")
        if isinstance(problem, ContactProblem):
            problem.check_boundaries(made.boundaries)
        if like is not None and set(made.bodies) != set(like.bodies):
            raise ValueError(
                f"its bodies are {', '.join(made.bodies)}, not {', '.join(like.bodies)}"
            )
    except (TypeError, ValueError) as error:
        raise type(error)(f"{name} is not a mesh of the problem: {error}") from error
    return made


#: how often fewer elements are marked until the mesh is small enough
_TRIES = 12
#: the part of ``max_nodes``, or of what is left of it, that is aimed at: to .9 and .975 the last meshes of 20 loops
#: to 700 nodes have 2 and 6 % fewer and 1 % more nodes, the error at equal nodes is the same to 1.5 %
_AIM = 0.95
#: nodes that halving a marked element adds, by dimension: measured 1.9 to 2.4 if all marked elements of the last mesh
#: are halved, in four loops to 700 nodes in the plane, 2.6 in one in space, but 4 on a bolted junction
_ADDED = {2: 2.0, 3: 2.6}
#: added nodes grow like this power of the number of halved elements, as closures cost a smaller set more: from half of
#: those marked to all of them .72 to .83, .64 in space and .33 on the bolted junction
_POWER = 0.85
#: elements are halved twice where once leaves more than this part of the mean square, and of the smallest marked one:
#: half makes errors at equal nodes of 10 loops .8 to 20 % larger, twice .7 % with 8 % more work
_LEFT = 0.5


def divisible(mesh: MeshArrays) -> np.ndarray:
    """Return the mask (n_elements,) of the elements that are so large that coordinates resolve
    smaller ones."""
    return mesh.volumes > (checks.ALIKE * np.abs(mesh.points).max()) ** mesh.dim


@dataclass(frozen=True)
class Bisect:
    """The default engine of :func:`adaptmg.adapt`: bisection.

    Processor time to the same estimate, that of :class:`Remesh` over that of bisection, on eight
    cases: 1.1 (a ball) to 2.7, 3.5 in 3D. The same estimate is a somewhat larger error here: at
    equal true errors the flat punch is remeshed as quickly, the others are not
    (``studies/adaptive_vs_uniform.py``).

    All edges of marked elements are halved: 4 triangles, at least 8 tetrahedra; twice where squares
    are large.

    Examples
    --------
    >>> problem = am.cases.upset_block()
    >>> mesh = am.mesh.structured(problem.domain, 2)
    >>> steps = am.adapt(problem, mesh, engine=am.Bisect(), max_nodes=30)
    >>> next(steps).number
    0
    """

    def first(self, problem: ContactProblem | ScalarProblem, size: float) -> MeshArrays | None:
        """Return the regular mesh to begin with, of an element size in m; None for domains that
        have no such mesh."""
        domain = meshed_domain(problem)
        parts = domain.parts if isinstance(domain, Assembly) else {"": domain}
        if not all(isinstance(part, Rectangle | Box) for part in parts.values()):
            return None
        cells = {}
        for name, part in parts.items():
            # a side of a body has at least two elements; rounding of a quotient makes no third one
            counts = np.maximum(np.ceil((part.upper - part.lower) / size * (1 - 1e-9)), 2)
            cells[name] = tuple(int(count) for count in counts)
        return lattices(domain, cells if isinstance(domain, Assembly) else cells[""])

    def refine(
        self,
        problem: ContactProblem | ScalarProblem,
        mesh: MeshArrays,
        estimate: Estimate,
        marked: np.ndarray,
        max_nodes: int | None = None,
    ) -> MeshArrays:
        """Return the next mesh.

        Where the mesh carries a history, bisection goes on from it; where the problem has a domain,
        this says where curved boundaries lie. If ``max_nodes`` asks for it, only the marked
        (n_elements,) elements with the largest squares are refined. The same mesh is returned where
        nothing is marked, ``max_nodes`` leaves no room, or coordinates do not resolve smaller
        elements than those that are marked."""
        check_problem(problem)
        marked = check_marked(check_mesh(mesh), marked)
        squares = estimate_for(mesh, estimate).squares
        limit = np.inf if max_nodes is None else checks.integer("max_nodes", max_nodes, 1)
        marked = marked & divisible(mesh)
        if not marked.any():
            return mesh
        fine = self._within(mesh, squares, marked, limit)
        return mesh if fine is None else onto_domain(problem.domain, fine, mesh.n_nodes)

    def _halved(
        self, mesh: MeshArrays, squares: np.ndarray, chosen: np.ndarray, limit: float
    ) -> MeshArrays:
        """Return the mesh with the edges of the ``chosen`` (n_elements,) elements halved; those of
        large squared errors ``squares`` (n_elements,) twice unless the mesh then exceeds the limit
        of nodes."""
        fine = refined(mesh, chosen)
        # the square of each child, whose edges are half as long, by eta^2 ~ h^2 |T|
        left_by_one_halving = 2.0 ** -(2 + mesh.dim) * squares
        # twice where a child keeps half of the mean square, and half of the least that is halved
        large = max(squares.mean(), squares[chosen].min())
        again = chosen & (left_by_one_halving > _LEFT * large)
        if again.any() and fine.mesh.n_nodes < limit:
            finer = refined(fine.mesh, again[fine.origin]).mesh
            return finer if finer.n_nodes <= limit else fine.mesh
        return fine.mesh

    def _within(
        self, mesh: MeshArrays, squares: np.ndarray, marked: np.ndarray, limit: float
    ) -> MeshArrays | None:
        """Return the mesh refined at the marked elements with the largest squares, as many as the limit
        of nodes allows; None if it allows not even one. The number is found by bracketing: ``fits``
        elements are within the limit, ``exceeds`` elements beyond it. Without a limit (inf) the first
        trial has all marked elements, and is the last one."""
        order = np.flatnonzero(marked)
        order = order[np.argsort(-squares[order], kind="stable")]
        allowed = limit - mesh.n_nodes
        exceeds = len(order) + 1
        fits = 0
        best = None
        count = len(order)
        added = _ADDED[mesh.dim] * count  # expected
        for _ in range(_TRIES if allowed > 0 else 0):
            # the count whose halving adds _AIM of the allowed nodes, as added ~ count^_POWER
            aim = count * (_AIM * allowed / added) ** (1 / _POWER)
            count = int(min(max(aim, fits + 1), exceeds - 1))
            chosen = mask_of(order[:count], len(marked))
            fine = self._halved(mesh, squares, chosen, limit)
            added = fine.n_nodes - mesh.n_nodes
            if added <= allowed:
                fits = count
                best = fine
            else:
                exceeds = count
            # within the limit, and at most as far below the aim, _AIM * allowed, as this is below the limit
            close = (2 * _AIM - 1) * allowed <= added <= allowed
            if exceeds <= fits + 1 or close:
                break
        return best


#: bounds of new over old size. At strong singularities sizes have to fall by 4 and more from mesh to mesh; the loop
#: then puts a level between. True errors at equal nodes, .1 over .25: .90 to .97 (upset block, flat punch), else 1.
#: On 10 loops half and twice of the first change errors at equal nodes by .1 and .2 % in the mean, 1.2 and 3 in place
#: of 1.5 by -1.2 and -1.4 %, with 8 % more work
_FINEST_SIZE, _COARSEST_SIZE = 0.1, 1.5
#: growth where sizes fall steeply: without it errors at equal nodes of these loops are 7.5 % larger in the mean, up to
#: 62 % (12 % more work with 1.6)
_SLOW = 2.0
#: they do where they fall by less than this factor in elements with this share of the sum of squares: half and twice
#: of the first 1.7 % larger and .8 % smaller errors, with 5 and 51 % more work; of the second 1.3 % smaller and 1.7 %
#: larger ones with 31 and 5 % more work
_STEEP, _SHARE = 0.3, 0.33
#: edges that each boundary that may touch keeps along it, however small its error
_EDGES = 4


Growth = Annotated[float, checks.number_that("> 1", lambda x: x > 1)]


@dataclass(frozen=True, kw_only=True)
class Remesh(checks.Checked):
    """Remeshing by a size field, an engine of :func:`adaptmg.adapt`.

    It takes 1.1 to 3.5 times the seconds of :class:`Bisect` to the same estimate: a third goes into
    meshing, and Galerkin matrices of independent meshes are denser. It pays where nodes are dear (a
    fifth fewer at strong singularities), where the first mesh is too fine somewhere, and where
    cycles count (a third fewer).

    Parameters
    ----------
    growth : float
        Nodes of the next mesh over those of this one, > 1; at most 2 where elements with a third of
        the sum of squares are to become smaller than .3 of their size. With ``max_nodes``
        all meshes before it grow alike, by a factor near this: up to a half (in the exponent) more
        where there is one only. Seconds to an
        error, 3.2 over 2.5: .65 to .96 on five cases, 1.07 on a sixth (bolted junction); rates are
        the same.

    Examples
    --------
    >>> am.Remesh(growth=2.0).growth
    2.0
    """

    growth: Growth = 3.2

    def refine(
        self,
        problem: ContactProblem | ScalarProblem,
        mesh: MeshArrays,
        estimate: Estimate,
        marked: object = None,
        max_nodes: int | None = None,
    ) -> MeshArrays:
        """Return the next mesh.

        Sizes follow from all squares of the estimate; ``marked`` is ignored. The mesh has about
        ``growth`` times as many nodes, within 15 %, less where ``max_nodes`` (5 % less are aimed
        at) says so. TypeError or ValueError if the problem has no domain, the estimate is not of
        this mesh, or Netgen fails."""
        need_domain(problem)
        estimate_for(checks.instance("mesh", mesh, MeshArrays), estimate)
        sizes = self._equilibrated(
            problem, mesh, estimate, _nodes_to_aim_at(mesh.n_nodes, max_nodes, self.growth)
        )
        # new over old size (n_elements,), the least one of the corners
        size_ratios = (sizes / nodal_sizes(mesh, simplex_sizes(mesh)))[mesh.elements].min(axis=1)
        # much of the error lies in elements that are to become much smaller
        if (
            self.growth > _SLOW
            and estimate.squares[size_ratios < _STEEP].sum() > _SHARE * estimate.squares.sum()
        ):
            sizes = self._equilibrated(
                problem, mesh, estimate, _nodes_to_aim_at(mesh.n_nodes, max_nodes, _SLOW)
            )
        return self.mesh(problem, SizeField(mesh, sizes))

    def _equilibrated(
        self,
        problem: ContactProblem | ScalarProblem,
        mesh: MeshArrays,
        estimate: Estimate,
        aim: float,
    ) -> np.ndarray:
        """Return sizes (n_nodes,), m, for a mesh of about ``aim`` nodes, more where this would leave fewer
        than _EDGES edges along a boundary that may touch."""
        sizes = equilibrated_sizes(mesh, estimate.squares, aim)
        for name in problem.pair_boundaries:
            surface = mesh.surface(name)
            # _EDGES along its length, in space along the side of a square of its area
            largest = surface.measures.sum() ** (1 / (mesh.dim - 1)) / _EDGES
            if sizes[surface.nodes].max() > largest:
                sizes[surface.nodes] = np.minimum(sizes[surface.nodes], largest)
                sizes = Grading(mesh, GRADING)(sizes)
        return sizes

    def intermediate(
        self, problem: ContactProblem | ScalarProblem, coarse: MeshArrays, fine: MeshArrays
    ) -> MeshArrays:
        """Return a mesh between two neighbouring levels, of the geometric mean of both sizes.

        A size ratio of q between the two becomes about the root of q to either side.
        """
        return self.mesh(problem, mean_sizes(coarse, fine, GRADING))

    def mesh(self, problem: ContactProblem | ScalarProblem, field: SizeField) -> MeshArrays:
        """Mesh the problem's domain by a size field."""
        from adaptmg.mesh.grading import sized_by

        functions = {body: field.function(body) for body in field.mesh.bodies}
        # a domain that is not an assembly takes one function
        return sized_by(
            meshed_domain(problem),
            functions if len(functions) > 1 else functions.popitem()[1],
            float(field.sizes.max()),
            GRADING,
        )


def _nodes_to_aim_at(nodes: int, max_nodes: int | None, growth: float) -> float:
    """Return the number of nodes to aim at after a mesh of ``nodes`` nodes: ``growth`` times as many,
    or with ``max_nodes`` by the factor near it by which equal steps lead to _AIM of these; where the mesh
    has as many already, _AIM of these in one step."""
    if max_nodes is None:
        return growth * nodes
    aim = _AIM * checks.integer("max_nodes", max_nodes, 1)
    if aim <= nodes:
        return aim
    steps = max(round(math.log(aim / nodes) / math.log(growth)), 1)
    return nodes * (aim / nodes) ** (1 / steps)


# b_d, nodes per h^(1-d) of boundary, in the plane by Euler's formula: half and twice change the nodes of 10 loops by
# -3 and 1 %; a_d is NODES_PER_CELL
_BOUNDARY = {2: 1 / 2, 3: 0.6}


def simplex_sizes(mesh: MeshArrays) -> np.ndarray:
    """Return the edge length (n_elements,), m, of the equilateral element with the same area or
    volume."""
    if mesh.dim == 2:
        return np.sqrt(mesh.volumes * (4 / math.sqrt(3)))
    return np.cbrt(mesh.volumes * (6 * math.sqrt(2)))


def nodal_sizes(mesh: MeshArrays, sizes: np.ndarray) -> np.ndarray:
    """Return the geometric mean (n_nodes,) of the sizes (n_elements,) of the elements at each
    node."""
    flat = mesh.elements.ravel()
    total = np.bincount(flat, np.repeat(np.log(sizes), mesh.elements.shape[1]), mesh.n_nodes)
    return np.exp(total / np.bincount(flat, minlength=mesh.n_nodes))


class NodeCount:
    """The estimated number of nodes N of a mesh whose sizes h are given at the nodes of another ``mesh``;
    see the module for the formula."""

    def __init__(self, mesh: MeshArrays) -> None:
        """Prepare the weights of the integrals: a sample at each of the dim + 1 corners of an element, and
        of the dim corners of a facet, has its share of a_d and of b_d."""
        self.mesh = mesh
        dim = mesh.dim
        self.inside = mesh.volumes * (NODES_PER_CELL[dim] / (dim + 1))
        self.boundary = Surface(mesh.points, mesh.facets).measures * (_BOUNDARY[dim] / dim)
        # q, by which the estimate of this mesh is its number of nodes
        self.factor = 1.0
        self.factor = mesh.n_nodes / self(nodal_sizes(mesh, simplex_sizes(mesh)))

    def __call__(self, sizes: np.ndarray) -> float:
        """Return the number of nodes of a mesh with sizes (n_nodes,), m: the integral of 1 / size^dim
        over the bodies, and of 1 / size^(dim - 1) over the boundary."""
        mesh = self.mesh
        # sizes at the middles between corner and centroid: integrated as linear functions nearly
        # exactly
        in_elements = sizes[mesh.elements]
        in_elements = 0.5 * (in_elements + in_elements.mean(axis=1, keepdims=True))
        on_facets = sizes[mesh.facets]
        on_facets = 0.5 * (on_facets + on_facets.mean(axis=1, keepdims=True))
        inside = (1 / in_elements**mesh.dim).sum(axis=1)
        boundary = (1 / on_facets ** (mesh.dim - 1)).sum(axis=1)
        return self.factor * float(self.inside @ inside + self.boundary @ boundary)


def equilibrated_sizes(
    mesh: MeshArrays, squares: np.ndarray, n_nodes: float, growth: float = GRADING
) -> np.ndarray:
    """Return sizes (n_nodes of the mesh,), m, for a new mesh of about ``n_nodes`` nodes on which the
    squares (n_elements,) are equal; they grow by at most ``growth`` per distance."""
    from scipy.optimize import brentq  # takes long to import

    largest = squares.max()
    share = squares / largest if largest > 0 else np.ones(len(squares))
    # smaller shares ask for nothing: sizes there are at their upper bound when the others are at
    # their lower one
    share = np.maximum(share, (_FINEST_SIZE / _COARSEST_SIZE) ** (2 + mesh.dim))
    factors = share ** (-1 / (2 + mesh.dim))  # squares fall like size^(2 + dim)
    old = simplex_sizes(mesh)
    count = NodeCount(mesh)
    grading = Grading(mesh, growth)

    @cache
    def sizes(log_c: float) -> np.ndarray:
        """Return the sizes (n_nodes,) for the constant c of the module."""
        new = old * np.clip(math.exp(log_c) * factors, _FINEST_SIZE, _COARSEST_SIZE)
        return grading(nodal_sizes(mesh, new))

    @cache
    def excess(log_c: float) -> float:
        """Return the logarithm of the number of nodes over that asked for."""
        return math.log(count(sizes(log_c)) / n_nodes)

    # with these constants all sizes are at their lower, or all at their upper bound
    low = math.log(_FINEST_SIZE / factors.max())
    high = math.log(_COARSEST_SIZE / factors.min())
    if excess(low) <= 0.0:
        return sizes(low)
    if excess(high) >= 0.0:
        return sizes(high)
    # accurate to about a node
    return sizes(brentq(excess, low, high, xtol=1 / n_nodes))


class Grading:
    """Limits the growth of sizes along the edges of a mesh to ``growth`` per distance.

    Graded sizes are distances from a further node, whose edge to each of the others is as long as
    the size there: its row is the last one of ``graph``."""

    def __init__(self, mesh: MeshArrays, growth: float) -> None:
        n = mesh.n_nodes
        # both ends of the edges of all elements; then of each edge once
        i, j = (mesh.elements[:, corners].ravel() for corners in np.triu_indices(mesh.dim + 1, 1))
        i, j = np.divmod(np.unique(pair_keys(np.minimum(i, j), np.maximum(i, j), n)), n)
        weights = growth * np.linalg.norm(mesh.points[i] - mesh.points[j], axis=1)
        one_way = sparse.coo_array((weights, (i, j)), shape=(n, n)).tocsr()
        # both ways: scipy would add the other one in each search, which takes as long as the search
        edges = one_way + one_way.T
        self.n_nodes = n
        self.graph = sparse.csr_array(
            (
                np.append(edges.data, np.empty(n)),  # each call writes its sizes there
                np.append(edges.indices, np.arange(n, dtype=np.int32)),
                np.append(edges.indptr, np.int32(len(edges.data) + n)),
            ),
            shape=(n + 1, n + 1),
        )

    def __call__(self, sizes: np.ndarray) -> np.ndarray:
        """Return the largest sizes (n_nodes,), m, of this growth that are not above ``sizes`` (n_nodes,)."""
        n = self.n_nodes
        self.graph.data[-n:] = sizes
        return dijkstra(self.graph, indices=n)[:n]  # pyright: ignore[reportArgumentType]  scipy-stubs


@dataclass(frozen=True, eq=False)
class SizeField:
    """Sizes between the nodes of a mesh: linear on each element, outside those of the nearest point
    of the mesh."""

    mesh: MeshArrays
    sizes: np.ndarray  # (n_nodes,): edge lengths at its nodes, m, > 0

    def function(self, body: str) -> Callable[[np.ndarray], np.ndarray]:
        """Return sizes (n,), m, at points (n, dim) of a body."""
        mesh = self.mesh
        elements = np.flatnonzero(mesh.element_body == mesh.bodies.index(body))
        locator = SimplexLocator(mesh.points, mesh.elements, elements)

        def at(points: np.ndarray) -> np.ndarray:
            place = locator.locate(points)
            corners = mesh.elements.take(place.element, axis=0)
            return np.einsum("ij,ij->i", place.weights, self.sizes.take(corners))

        return at


def mean_sizes(coarse: MeshArrays, fine: MeshArrays, growth: float) -> SizeField:
    """Return the geometric mean of the sizes of two meshes, at the nodes of the fine one, graded; at a
    node that bodies share, with the coarse size of the last of them."""
    of_coarse = SizeField(coarse, nodal_sizes(coarse, simplex_sizes(coarse)))
    of_fine = nodal_sizes(fine, simplex_sizes(fine))
    sizes = np.empty(fine.n_nodes)
    for index, body in enumerate(fine.bodies):
        nodes = np.unique(fine.elements[fine.element_body == index])
        sizes[nodes] = np.sqrt(of_fine[nodes] * of_coarse.function(body)(fine.points[nodes]))
    return SizeField(fine, Grading(fine, growth)(sizes))
