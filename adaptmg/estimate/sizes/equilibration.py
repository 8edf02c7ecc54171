r"""equilibration: the sizes of the next mesh, on which every element is to have the same share of the error.

Linear elements of size h in d dimensions have :math:`\eta_E^2 \sim h^{2+d}`. Equal squares therefore ask for

.. math:: \frac{h_{new}}{h} = c\,(\eta_E^2)^{-1/(2+d)}

(L. Y. Li and P. Bettess, Adaptive finite element methods: a review, Appl. Mech. Rev. 50, 1997), kept between two
bounds, averaged at the nodes (geometric mean over their elements) and graded
(:mod:`adaptmg.estimate.sizes.gradation`). The constant c is found by the secant method, safeguarded by a bracket, for
the wanted number of nodes. A mesh of sizes h has about

.. math:: N = q \Bigl(a_d \int h^{-d}\,dx + b_d \int_{\partial\Omega} h^{1-d}\,ds\Bigr), \qquad
          a_2 = 2/\sqrt3,\; b_2 = 1/2,\; a_3 = 1.4,\; b_3 = 0.6

nodes, where q makes it exact for the present mesh.
"""

from __future__ import annotations

import math

import numpy as np

from adaptmg.estimate.sizes.gradation import ElementsAtNodes, graded_sizes
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks

__all__ = ["NodeCount", "equilibrated_sizes", "nodal_sizes", "simplex_sizes"]

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
    """About how many nodes a mesh has whose sizes are given at the nodes of another (module docstring).

    Parameters
    ----------
    mesh : MeshArrays
    """

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
    """Sizes at the nodes of a mesh, for a new mesh of about ``n_nodes`` nodes.

    Parameters
    ----------
    mesh : MeshArrays
        Which the estimate is of.
    squares : (n_elements,) array
        Of the estimate, >= 0, in any unit: only their ratios count.
    n_nodes : float
        Wanted number of nodes. What the bounds do not allow is approached as far as they do.
    finest, coarsest : float
        Bounds of new over old size, 0 < finest < coarsest.
    growth : float
        Largest growth of sizes per distance along edges, > 0.

    Returns
    -------
    (n_nodes,) array
        m.

    Raises
    ------
    ValueError
        If the squares are not those of this mesh.
    """
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
