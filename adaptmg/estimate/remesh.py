r"""Remesh: the next mesh of an adaptive loop made anew by Netgen, with sizes that equilibrate the error.

Each mesh is independent of the one before: not nested in it, coarser where the error is small, with nodes on the
curves of the domain. Sizes come from :mod:`adaptmg.estimate.remesh`.

equilibration: the sizes of the next mesh, on which every element is to have the same share of the error.

Linear elements of size h in d dimensions have :math:`\eta_E^2 \sim h^{2+d}`. Equal squares therefore ask for

.. math:: \frac{h_{new}}{h} = c\,(\eta_E^2)^{-1/(2+d)}

(L. Y. Li and P. Bettess, Adaptive finite element methods: a review, Appl. Mech. Rev. 50, 1997), kept between two
bounds, averaged at the nodes (geometric mean over their elements) and graded
(:mod:`adaptmg.estimate.gradation`). The constant c is found by the secant method, safeguarded by a bracket, for
the wanted number of nodes. A mesh of sizes h has about

.. math:: N = q \Bigl(a_d \int h^{-d}\,dx + b_d \int_{\partial\Omega} h^{1-d}\,ds\Bigr), \qquad
          a_2 = 2/\sqrt3,\; b_2 = 1/2,\; a_3 = 1.4,\; b_3 = 0.6

nodes, where q makes it exact for the present mesh.

SizeField: sizes at the nodes of a mesh as a function of position, body by body.

intermediate: a mesh between two others, where the finer one is locally much finer than the coarser.

Its sizes are the geometric mean of both,

.. math:: h(x) = \sqrt{h_{coarse}(x)\, h_{fine}(x)},

so that a size ratio of q between the two becomes :math:`\sqrt q` to either side. Multigrid converges slowly where sizes
of neighbouring levels differ by more than about 4 (measured: rates of .35 to .64 at 3, .83 at 12).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptmg import _checks as checks
from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.gradation import ElementsAtNodes, graded_sizes, resolving
from adaptmg.geometry.location import SimplexLocator
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import ContactProblem

__all__ = ["NodeCount", "Remesh", "SizeField", "equilibrated_sizes", "mean_sizes", "nodal_sizes", "simplex_sizes"]

# growth of sizes, per distance, that Netgen copes with by dimension; refined meshes grow 2^k times more slowly
_MAX_GRADING = {2: 1.0, 3: 0.6}
# share of the nodes by which a mesh may miss the expected number without being made again
_MISSED = 0.15
# what is aimed at, of the most nodes; how many steps before them are of equal growth, and by which part of a step the
# way may be longer than they go
_BELOW = 0.95
_LAST, _LONGER = 2, 0.2
# growth where sizes fall steeply: by less than this factor in elements with this share of the sum of squares
_SLOW = 2.0
_STEEP, _SHARE = 0.3, 0.33


@dataclass(frozen=True, kw_only=True)
class Remesh:
    """Remeshing by a size field, an engine of :func:`adaptmg.adapt`.

    Parameters
    ----------
    growth : float
        Nodes of the next mesh over those of this one, > 1; at most 2 where elements with a third of the sum of squares
        are to become smaller than .3 of their size: at strong singularities the sizes of a few elements have to follow
        first (bolted junction, 10 000 nodes: 8 % less true error). The last two meshes before ``max_nodes`` grow alike,
        by less or up to a fifth (in the exponent) more, so that the last is neither cut short nor close to that before.
    finest, coarsest : float
        Bounds of new over old size, 0 < ``finest`` < 1 <= ``coarsest``. At strong singularities sizes have to fall by
        4 and more from mesh to mesh; the loop then puts a level between, as multigrid converges slowly above a ratio
        of 4.5. Measured true errors at equal nodes, .1 over .25: .90 to .97 (upset block, flat punch), else equal.
    gradation : float
        Growth of sizes per distance, above 0 and at most 1.
    refinements : int
        Netgen makes a mesh of :math:`2^{-dk}` of the nodes, which is refined k times uniformly. One refinement takes a
        third of the time for up to 11 % more error on coarse meshes (flat punch, 1 000 nodes; none at 26 000, 0 to 6 %
        on dovetail and junction); take 0 for goals. With more, sizes grow more slowly than ``gradation`` says.
    """

    growth: float = 2.5
    finest: float = 0.1
    coarsest: float = 1.5
    gradation: float = 0.3
    refinements: int = 1

    def __post_init__(self) -> None:
        for name in ("growth", "finest", "coarsest", "gradation"):
            object.__setattr__(self, name, checks.positive(name, getattr(self, name)))
        if not self.growth > 1:
            raise ValueError(f"growth must be > 1, got {self.growth!r}")
        if not self.finest < 1 <= self.coarsest:
            raise ValueError(f"finest and coarsest must satisfy 0 < finest < 1 <= coarsest, got {self.finest!r} and "
                             f"{self.coarsest!r}")
        if not self.gradation <= 1:
            raise ValueError(f"gradation must be at most 1, got {self.gradation!r}")
        object.__setattr__(self, "refinements", checks.integer("refinements", self.refinements, 0, 4))

    def refine(self, problem: ContactProblem, mesh: MeshArrays, estimate: Estimate, marked: Any = None,
               max_nodes: int | None = None) -> MeshArrays:
        """The next mesh.

        Parameters
        ----------
        problem : ContactProblem
            With a domain.
        mesh : MeshArrays
            The present mesh.
        estimate : Estimate
            On it.
        marked : ignored
            Sizes follow from all squares of the estimate; engines that refine marked elements have this argument.
        max_nodes : int, optional
            Aimed at are 5 % less; a mesh may miss its number of nodes by 15 %.

        Returns
        -------
        MeshArrays
            Of about ``growth`` times as many nodes; otherwise where ``max_nodes`` is near or ``finest`` says so.

        Raises
        ------
        TypeError, ValueError
            If the problem has no domain, the estimate is not of this mesh, or Netgen fails.
        """
        need_domain(problem)
        checks.instance("mesh", mesh, MeshArrays)
        checks.instance("estimate", estimate, Estimate, "an Estimate")
        wanted = _wanted(mesh.n_nodes, max_nodes, self.growth)
        sizes = self._equilibrated(problem, mesh, estimate, wanted)
        if self.growth > _SLOW and _fall_steeply(mesh, estimate, sizes):
            wanted = _wanted(mesh.n_nodes, max_nodes, _SLOW)
            sizes = self._equilibrated(problem, mesh, estimate, wanted)
        made, expected = self.mesh(problem, SizeField(mesh, sizes)), NodeCount(mesh)(sizes)
        if not abs(made.n_nodes - expected) <= _MISSED * expected:
            # mostly coarse meshes in 3D, which follow sizes badly and cost little
            sizes = self._equilibrated(problem, mesh, estimate, wanted * expected / made.n_nodes)
            again = self.mesh(problem, SizeField(mesh, sizes))
            made = min(made, again, key=lambda new: abs(math.log(new.n_nodes / expected)))
        return made

    def _equilibrated(self, problem: ContactProblem, mesh: MeshArrays, estimate: Estimate, wanted: float
                      ) -> np.ndarray:
        """Sizes (n_nodes,) for a mesh of about the wanted number of nodes, m."""
        sizes = equilibrated_sizes(mesh, estimate.squares, wanted, finest=self.finest, coarsest=self.coarsest,
                                   growth=self._growth(mesh.dim))
        return resolving(mesh, sizes, problem.pair_boundaries, self._growth(mesh.dim))

    def _growth(self, dim: int) -> float:
        """Growth of sizes per distance that the meshes can have."""
        return min(self.gradation, _MAX_GRADING[dim] / 2**self.refinements)

    def intermediate(self, problem: ContactProblem, coarse: MeshArrays, fine: MeshArrays) -> MeshArrays:
        """A mesh between two others, for levels whose sizes differ too much.

        See :mod:`adaptmg.estimate.remesh`.

        Parameters
        ----------
        problem : ContactProblem
            With a domain.
        coarse, fine : MeshArrays
            Neighbouring levels, see :func:`adaptmg.transfer.size_ratio`.

        Returns
        -------
        MeshArrays
            Its sizes are the geometric mean of both.
        """
        need_domain(problem)
        return self.mesh(problem, mean_sizes(coarse, fine, self._growth(fine.dim)))

    def mesh(self, problem: ContactProblem, field: SizeField) -> MeshArrays:
        """A mesh of the problem's domain by a size field."""
        from adaptmg.mesh.resized import PointSizes, resized

        need_domain(problem)
        # a plane mesh that Netgen makes whole is finer than the places of the old nodes
        samples = field.samples(dense=field.mesh.dim == 2 and self.refinements == 0)
        sizes = {body: PointSizes(*given) for body, given in samples.items()}
        return resized(problem.domain, sizes if len(sizes) > 1 else sizes.popitem()[1], refinements=self.refinements,
                       grading=self._growth(field.mesh.dim) * 2**self.refinements)


def need_domain(problem: ContactProblem) -> None:
    """ValueError unless the problem has a domain, of which a new mesh can be made."""
    checks.instance("problem", problem, ContactProblem, "a ContactProblem")
    if problem.domain is None:
        raise ValueError("problem.domain is None: of a mesh of one's own no new one can be made; give the problem a "
                         "domain, or refine its mesh with engine=am.Bisect()")


def _wanted(nodes: int, max_nodes: int | None, growth: float) -> float:
    """Nodes to aim at, after so many."""
    if max_nodes is None:
        return growth * nodes
    aim = _BELOW * checks.integer("max_nodes", max_nodes, 1)
    if aim <= nodes:
        return aim
    steps = max(math.ceil(math.log(aim / nodes) / math.log(growth) - _LONGER), 1)
    return nodes * (growth if steps > _LAST else (aim / nodes) ** (1 / steps))


def _fall_steeply(mesh: MeshArrays, estimate: Estimate, sizes: np.ndarray) -> bool:
    """Whether much of the error lies in elements that are to become much smaller."""
    factors = (sizes / nodal_sizes(mesh, simplex_sizes(mesh)))[mesh.elements].min(axis=1)
    return bool(estimate.squares[factors < _STEEP].sum() > _SHARE * estimate.squares.sum())


# nodes per h^-d of volume, and per h^(1-d) of boundary
_INSIDE = {2: 2 / math.sqrt(3), 3: 1.4}
_BOUNDARY = {2: 0.5, 3: 0.6}
# squares below this share of the largest ask for nothing: the upper bound of growth holds there anyway
_TINY = 1e-30
_MAX_STEPS = 60


def simplex_sizes(mesh: MeshArrays) -> np.ndarray:
    """Edge length (n_elements,), m, of the equilateral element with the same area or volume."""
    if mesh.dim == 2:
        return np.sqrt(mesh.volumes * (4 / math.sqrt(3)))
    return np.cbrt(mesh.volumes * (6 * math.sqrt(2)))


def nodal_sizes(mesh: MeshArrays, sizes: np.ndarray) -> np.ndarray:
    """Geometric mean (n_nodes,) of the sizes (n_elements,) of the elements at each node."""
    corners = mesh.elements.shape[1]
    flat = mesh.elements.ravel()
    total = np.bincount(flat, np.repeat(np.log(sizes), corners), mesh.n_nodes)
    return np.exp(total / np.bincount(flat, minlength=mesh.n_nodes))


class NodeCount:
    """About how many nodes a mesh has whose sizes are given at the nodes of another (module docstring)."""

    def __init__(self, mesh: MeshArrays) -> None:
        self.mesh, dim = mesh, mesh.dim
        self.inside = mesh.volumes * (_INSIDE[dim] / (dim + 1))
        corners = mesh.points[mesh.facets]
        sides = corners[:, 1:] - corners[:, :1]
        measures = np.sqrt(np.linalg.det(sides @ sides.transpose(0, 2, 1))) / (dim - 1)
        self.boundary = measures * (_BOUNDARY[dim] / dim)
        self.factor = 1.0
        self.factor = mesh.n_nodes / self(nodal_sizes(mesh, simplex_sizes(mesh)))

    def __call__(self, sizes: np.ndarray) -> float:
        """Nodes for the sizes (n_nodes,), m."""
        mesh = self.mesh
        # sizes at the middles between corner and centroid: integrated as linear functions nearly exactly
        at = sizes[mesh.elements]
        at = 0.5 * (at + at.mean(axis=1, keepdims=True))
        on = sizes[mesh.facets]
        on = 0.5 * (on + on.mean(axis=1, keepdims=True))
        inside, boundary = (at**-mesh.dim).sum(axis=1), (on ** (1 - mesh.dim)).sum(axis=1)
        return self.factor * float(self.inside @ inside + self.boundary @ boundary)


def equilibrated_sizes(mesh: MeshArrays, squares: np.ndarray, n_nodes: float, *, finest: float = 0.25,
                       coarsest: float = 1.5, growth: float = 0.3) -> np.ndarray:
    """Sizes at the nodes of a mesh, for a new mesh of about ``n_nodes`` nodes."""
    squares = np.asarray(squares, dtype=np.float64)
    if squares.shape != (len(mesh.elements),):
        raise ValueError(f"squares must have shape ({len(mesh.elements)},), one for each element of mesh, got "
                         f"{squares.shape}")
    n_nodes = checks.positive("n_nodes", n_nodes)
    if not 0 < checks.number("finest", finest) < checks.number("coarsest", coarsest):
        raise ValueError(f"finest and coarsest must satisfy 0 < finest < coarsest, got {finest!r} and {coarsest!r}")
    largest = squares.max()
    share = np.maximum(squares / largest, _TINY) if largest > 0 else np.ones(len(squares))
    factors = share ** (-1 / (2 + mesh.dim))
    old = simplex_sizes(mesh)
    neighbours, count = ElementsAtNodes(mesh.points, mesh.elements), NodeCount(mesh)

    def sizes(log_c: float) -> np.ndarray:
        wanted = old * np.clip(math.exp(log_c) * factors, finest, coarsest)
        return graded_sizes(neighbours, nodal_sizes(mesh, wanted), growth)

    low, high = math.log(finest / factors.max()), math.log(coarsest / factors.min())
    return sizes(_constant(lambda x: math.log(count(sizes(x)) / n_nodes), low, high, mesh.dim))


def _constant(excess, low: float, high: float, dim: int) -> float:
    """Where in [low, high] the falling function ``excess`` is within .005 of zero; an end if it has no zero."""
    # nodes go like c^-d where no bound holds
    x, slope = 0.5 * (low + high), -float(dim)
    before = None
    for _ in range(_MAX_STEPS):
        value = excess(x)
        if abs(value) < 5e-3 or high - low < 1e-6:
            break
        low, high = (x, high) if value > 0 else (low, x)
        if before is not None and value != before[1]:
            slope = min((value - before[1]) / (x - before[0]), -0.1 * dim)
        before = x, value
        step = x - value / slope
        x = step if low < step < high else 0.5 * (low + high)
    return x


@dataclass(frozen=True, eq=False)
class SizeField:
    """Sizes between the nodes of a mesh: linear on each element, outside those of the nearest point of the mesh."""

    mesh: MeshArrays
    sizes: np.ndarray  # (n_nodes,): wanted edge lengths at its nodes, m, > 0

    def __post_init__(self) -> None:
        sizes = np.array(self.sizes, dtype=np.float64)
        if sizes.shape != (self.mesh.n_nodes,):
            raise ValueError(f"sizes must have shape ({self.mesh.n_nodes},), one for each node of mesh, got "
                             f"{sizes.shape}")
        if not (sizes > 0).all() or not np.isfinite(sizes).all():
            i = int(np.argmin(np.where(np.isfinite(sizes), sizes, -np.inf)))
            raise ValueError(f"sizes must be finite and > 0, got {sizes[i]} at node {i}")
        sizes.flags.writeable = False
        object.__setattr__(self, "sizes", sizes)
        object.__setattr__(self, "_locators", {})

    def __call__(self, points: np.ndarray, body: str | None = None) -> np.ndarray:
        """Sizes (n,), m, at points (n, dim) of a body; ``body`` may be left out where there is one only."""
        mesh = self.mesh
        if body is None and len(mesh.bodies) > 1:
            raise ValueError(f"body must be one of {', '.join(map(repr, mesh.bodies))}: where bodies touch, a point "
                             "lies in both")
        if body is not None and body not in mesh.bodies:
            raise ValueError(f"body: no body {body!r}; the bodies are {', '.join(map(repr, mesh.bodies))}")
        if body not in self._locators:
            chosen = None if body is None else np.flatnonzero(mesh.element_body == mesh.bodies.index(body))
            self._locators[body] = SimplexLocator(mesh.points, mesh.elements, chosen)
        found = self._locators[body].locate(points)
        return np.einsum("ij,ij->i", found.weights, self.sizes[mesh.elements[found.element]])

    def samples(self, dense: bool = False) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """What a mesher is told at once: by body, points (n, dim), m, and the sizes (n,) there, m."""
        mesh, k = self.mesh, self.mesh.elements.shape[1]
        centre = np.full((1, k), 1 / k)
        weights = np.concatenate([centre, 0.5 * (centre + np.eye(k))]) if dense else centre
        result = {}
        for index, body in enumerate(mesh.bodies):
            elements = mesh.elements[mesh.element_body == index]
            nodes = np.unique(elements)
            inner = (weights @ mesh.points[elements]).reshape(-1, mesh.dim)
            result[body] = (np.concatenate([mesh.points[nodes], inner]),
                            np.concatenate([self.sizes[nodes], (self.sizes[elements] @ weights.T).ravel()]))
        return result


def mean_sizes(coarse: MeshArrays, fine: MeshArrays, growth: float) -> SizeField:
    """The geometric mean of the sizes of two meshes."""
    for name, mesh in (("coarse", coarse), ("fine", fine)):
        checks.instance(name, mesh, MeshArrays)
    if coarse.dim != fine.dim or set(coarse.bodies) != set(fine.bodies):
        raise ValueError(f"coarse and fine must have the same dimension and bodies, got {coarse.dim}D with "
                         f"{', '.join(coarse.bodies)} and {fine.dim}D with {', '.join(fine.bodies)}")
    of_coarse = SizeField(coarse, nodal_sizes(coarse, simplex_sizes(coarse)))
    sizes = nodal_sizes(fine, simplex_sizes(fine))
    for index, body in enumerate(fine.bodies):
        nodes = np.unique(fine.elements[fine.element_body == index])
        sizes[nodes] = np.sqrt(sizes[nodes] * of_coarse(fine.points[nodes], body))
    return SizeField(fine, graded_sizes(ElementsAtNodes(fine.points, fine.elements), sizes, growth))
