r"""Kernel of the edge bubbles :math:`b_E = 4 \lambda_a \lambda_b`: their stiffness blocks, and residuals against them.

With :math:`g = \nabla b_E`, and in axisymmetry :math:`h = b_E / r` and weight :math:`2 \pi r` (elsewhere h = 0),

.. math:: a(b_E e_i, b_E e_j) = \int \lambda\,(g_i + \delta_{i0} h)(g_j + \delta_{j0} h)
          + \mu\,(g_i g_j + \delta_{ij} |g|^2) + 2 \mu\,\delta_{i0} \delta_{j0} h^2,
          \qquad a(u, b_E e_i) = \int \sum_j \sigma_{ij}(u)\, g_j + \delta_{i0}\,\sigma_{\theta\theta}(u)\, h .

The error in the space of edge bubbles, and what it says of quantities of interest.

Residuals of the discrete solution and of its dual field against the bubbles,

.. math:: \rho_E(v) = b(b_E v) + \langle t_h, b_E v\rangle - a(u_h, b_E v), \qquad
          \rho^*_E(v) = J(b_E v) + \langle t^*_h, b_E v\rangle - a(b_E v, z_h)

(tractions t of contact on masters, whose bubbles move for themselves), give the error :math:`\sum_E b_E d_E` of all
bubbles together (by a few steps of GMRES, preconditioned edge by edge), or edge by edge,

.. math:: a\Bigl(\sum_F b_F d_F, b_E v\Bigr) = \rho_E(v), \qquad a(b_E d^0_E, b_E v) = \rho_E(v) .

The first one gives the signed estimate :math:`J(e) \approx \sum_E \rho^*_E(d_E)`: edge by edge it would be 1.3 to 2
times too large. The second one marks, :math:`|\rho^*_E(d^0_E)|`.

In which directions the bubble of an edge may move: its supports, and contact linearised as at the nodes.

On an edge of a contact surface whose ends both touch an error has no part along the normal, and none at all where both
stick; dual directions of a slipping edge are :math:`t + \mu f n`. An edge with one open end counts as open, one with
one slipping end as slipping: of these cells the solution does not know where contact ends. The slip Hessian of 3D and
friction that holds open nodes (Tresca) are left out.

Edge bubbles: the quadratic functions :math:`b_E = 4 \lambda_a \lambda_b` that a P1 space lacks, edge by edge.

The error of a field that solves :math:`a(v, z) = J(v)` is sought among them, one edge at a time,

.. math:: a(b_E v, b_E d_E) = J(b_E v) - a(b_E v, z_h) \quad\text{for all vectors } v

(hierarchical basis, R. Bank, R. K. Smith, SIAM J. Numer. Anal. 30, 1993, doi:10.1137/0730048). In 2D without body
forces the right-hand side is :math:`-\tfrac23 |E|\,[\sigma(z_h) n]\cdot v`. In 3D the edge has all its tetrahedra as
support, which is where quadratic functions live: a bubble of the faces, :math:`27 \lambda_a \lambda_b \lambda_c` with
the integral :math:`\tfrac{9}{20}|F|`, is a cubic and misses most of the error.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from adaptmg import _checks as checks
from adaptmg._runtime import inner_kernel, kernel
from adaptmg.discrete.coordinates import from_frames
from adaptmg.discrete.elasticity import body_materials, is_axisymmetric, lame_constants
from adaptmg.discrete.facets import area_vectors, named_facets
from adaptmg.discrete.loads import mean_initial_strain
from adaptmg.estimate.contact_state import LinearisedContact
from adaptmg.geometry.quadrature import (
    AXISYMMETRIC_DEGREE,
    PLAIN_DEGREE,
    quadrature_points,
    quadrature_rule,
    simplex_rule,
)
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.loads import BodyForce, InitialStrain, Pressure, Traction
from adaptmg.problem.materials import PlaneStress
from adaptmg.smoother.system import ContactState as State

__all__ = ["BubbleError", "BubbleSpaces", "EdgeBubbles", "add_bubbles", "bubble_error", "bubble_spaces", "edge_bubbles"]

@inner_kernel
def _gradients(points, corners, g):
    """Gradients of the barycentric coordinates into ``g`` (dim + 1, dim); returns the volume."""
    dim = points.shape[1]
    o = corners[0]
    ax, ay = points[corners[1], 0] - points[o, 0], points[corners[1], 1] - points[o, 1]
    bx, by = points[corners[2], 0] - points[o, 0], points[corners[2], 1] - points[o, 1]
    if dim == 2:
        det = ax * by - ay * bx
        g[1, 0], g[1, 1] = by / det, -bx / det
        g[2, 0], g[2, 1] = -ay / det, ax / det
        volume = 0.5 * det
    else:
        az, bz = points[corners[1], 2] - points[o, 2], points[corners[2], 2] - points[o, 2]
        cx, cy = points[corners[3], 0] - points[o, 0], points[corners[3], 1] - points[o, 1]
        cz = points[corners[3], 2] - points[o, 2]
        g[1, 0], g[1, 1], g[1, 2] = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        g[2, 0], g[2, 1], g[2, 2] = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
        g[3, 0], g[3, 1], g[3, 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        det = ax * g[1, 0] + ay * g[1, 1] + az * g[1, 2]
        for k in range(1, 4):
            for i in range(3):
                g[k, i] /= det
        volume = det / 6
    for i in range(dim):
        total = 0.0
        for c in range(1, dim + 1):
            total += g[c, i]
        g[0, i] = -total
    return volume


@inner_kernel
def _stress(lame, shear, corners, g, field, hoop, sigma):
    """Cartesian stress of a P1 field with the hoop strain ``hoop``, into ``sigma`` (dim, dim); returns the hoop one."""
    dim = g.shape[1]
    trace = hoop
    for i in range(dim):
        for j in range(dim):
            total = 0.0
            for c in range(dim + 1):
                v = corners[c]
                total += shear * (field[v, i] * g[c, j] + field[v, j] * g[c, i])
            sigma[i, j] = total
        for c in range(dim + 1):
            trace += field[corners[c], i] * g[c, i]
    for i in range(dim):
        sigma[i, i] += lame * trace
    return lame * trace + 2 * shear * hoop


@kernel
def add_bubbles(points, elements, body, lame, shear, local, element_edges, axisymmetric, rule, weights, fields,
                blocks, actions):
    """Add the blocks a(b e_i, b e_j) of every edge and the actions a(field, b e_i) of every field.

    ``local`` (k, 2) are the corners of an element's edges, ``element_edges`` (n_elements, k) their numbers; ``fields``
    (n_fields, n_nodes, dim); ``blocks`` (n_edges, dim, dim) and ``actions`` (n_fields, n_edges, dim) come as 0.
    """
    dim, n_fields = points.shape[1], len(fields)
    g, sigma, gb = np.empty((dim + 1, dim)), np.empty((dim, dim)), np.empty(dim)
    for e in range(len(elements)):
        corners = elements[e]
        volume = _gradients(points, corners, g)
        la, mu = lame[body[e]], shear[body[e]]
        for q in range(len(weights)):
            w, r = volume * weights[q], 1.0
            if axisymmetric:
                r = 0.0
                for c in range(dim + 1):
                    r += rule[q, c] * points[corners[c], 0]
                w *= 2 * np.pi * r
            for k in range(len(local)):
                edge, first, second = element_edges[e, k], local[k, 0], local[k, 1]
                l1, l2 = rule[q, first], rule[q, second]
                square = 0.0
                for i in range(dim):
                    gb[i] = 4 * (l1 * g[second, i] + l2 * g[first, i])
                    square += gb[i] * gb[i]
                h = 4 * l1 * l2 / r if axisymmetric else 0.0
                for i in range(dim):
                    di = gb[i] + (h if i == 0 else 0.0)
                    for j in range(dim):
                        dj = gb[j] + (h if j == 0 else 0.0)
                        blocks[edge, i, j] += w * (la * di * dj + mu * gb[i] * gb[j])
                    blocks[edge, i, i] += w * mu * square
                blocks[edge, 0, 0] += w * 2 * mu * h * h
            for f in range(n_fields):
                hoop = 0.0
                if axisymmetric:
                    for c in range(dim + 1):
                        hoop += rule[q, c] * fields[f, corners[c], 0]
                    hoop /= r
                around = _stress(la, mu, corners, g, fields[f], hoop, sigma)
                for k in range(len(local)):
                    edge, first, second = element_edges[e, k], local[k, 0], local[k, 1]
                    l1, l2 = rule[q, first], rule[q, second]
                    for j in range(dim):
                        gj = 4 * (l1 * g[second, j] + l2 * g[first, j])
                        for i in range(dim):
                            actions[f, edge, i] += w * sigma[i, j] * gj
                    if axisymmetric:
                        actions[f, edge, 0] += w * around * 4 * l1 * l2 / r


@kernel
def apply_bubbles(points, elements, body, lame, shear, local, element_edges, axisymmetric, rule, weights, values,
                  result):
    """Add the actions a(sum of bubbles, b e_i) of all edges to ``result`` (n_edges, dim); ``values`` (n_edges, dim)."""
    dim, n_local = points.shape[1], len(local)
    g, sigma, gb, bubble = np.empty((dim + 1, dim)), np.empty((dim, dim)), np.empty((n_local, dim)), np.empty(n_local)
    for e in range(len(elements)):
        corners = elements[e]
        volume = _gradients(points, corners, g)
        la, mu = lame[body[e]], shear[body[e]]
        for q in range(len(weights)):
            w, r = volume * weights[q], 1.0
            if axisymmetric:
                r = 0.0
                for c in range(dim + 1):
                    r += rule[q, c] * points[corners[c], 0]
                w *= 2 * np.pi * r
            hoop, trace = 0.0, 0.0
            sigma[:] = 0.0
            for k in range(n_local):
                edge, first, second = element_edges[e, k], local[k, 0], local[k, 1]
                l1, l2 = rule[q, first], rule[q, second]
                bubble[k] = 4 * l1 * l2
                hoop += bubble[k] * values[edge, 0] / r
                for j in range(dim):
                    gb[k, j] = 4 * (l1 * g[second, j] + l2 * g[first, j])
                    trace += gb[k, j] * values[edge, j]
                    for i in range(dim):
                        sigma[i, j] += mu * gb[k, j] * values[edge, i]
                        sigma[j, i] += mu * gb[k, j] * values[edge, i]
            if not axisymmetric:
                hoop = 0.0
            trace += hoop
            for i in range(dim):
                sigma[i, i] += la * trace
            around = la * trace + 2 * mu * hoop
            for k in range(n_local):
                edge = element_edges[e, k]
                for i in range(dim):
                    for j in range(dim):
                        result[edge, i] += w * sigma[i, j] * gb[k, j]
                if axisymmetric:
                    result[edge, 0] += w * around * bubble[k] / r


_LOG = logging.getLogger(__name__)

#: residual of the bubbles' equations, and the steps to a restart: five to ten suffice, the condition is about ten
_RTOL, _STEPS = 1e-2, 30


@dataclass(frozen=True, eq=False)
class BubbleError:
    """Amplitudes of the bubbles in the error, (n_edges, dim) each, m."""

    together: np.ndarray  # all bubbles at once: signed estimates
    alone: np.ndarray  # each edge for itself: marks
    energy: float  # energy norm of the error as the bubbles see it, sqrt(N m)


def bubble_error(problem: ContactProblem, bubbles: EdgeBubbles, spaces: BubbleSpaces, blocks: np.ndarray,
                 residual: np.ndarray) -> BubbleError:
    """The error of a discrete solution in the space of bubbles."""
    trial, test, shape = spaces.trial, spaces.test, residual.shape
    small = np.einsum("nik,nij,njl->nkl", test, blocks, trial)
    small[spaces.missing[:, :, None] & np.eye(shape[1], dtype=bool)] = 1.0
    inverse = np.linalg.inv(small)
    load = np.einsum("nik,ni->nk", test, residual)

    def stiffness(x: np.ndarray) -> np.ndarray:
        x = x.reshape(shape)
        action = bubbles.stiffness(problem, np.einsum("nik,nk->ni", trial, x))
        return (np.einsum("nik,ni->nk", test, action) + np.where(spaces.missing, x, 0.0)).reshape(-1)

    def alone(x: np.ndarray) -> np.ndarray:
        return np.einsum("nkl,nl->nk", inverse, x.reshape(shape)).reshape(-1)

    n = load.size
    operator, inner = (LinearOperator((n, n), matvec=f, dtype=np.float64) for f in (stiffness, alone))
    # the test of scipy is on the preconditioned residual; if the true one is a little larger it begins anew
    found, failed = gmres(operator, load.reshape(-1), rtol=_RTOL, atol=0.0, restart=_STEPS, maxiter=3, M=inner)
    if failed:
        _LOG.info("the equations of %d bubbles were not solved to %.0e", len(load), _RTOL)
    together = np.einsum("nik,nk->ni", trial, found.reshape(shape))
    single = np.einsum("nik,nk->ni", trial, alone(load).reshape(shape))
    return BubbleError(together, single, float(np.sqrt(max(np.sum(residual * together), 0.0))))


@dataclass(frozen=True, eq=False)
class BubbleSpaces:
    """Directions of the bubbles; columns of zeros are directions that do not exist."""

    trial: np.ndarray  # (n_edges, dim, dim)s: in columns: of errors; of dual fields
    test: np.ndarray  # (n_edges, dim, dim)s: in columns: of errors; of dual fields

    @property
    def missing(self) -> np.ndarray:
        """Directions (n_edges, dim) that do not exist, bool."""
        return ~self.trial.any(axis=1)


def bubble_spaces(problem: ContactProblem, bubbles: EdgeBubbles, contact: LinearisedContact) -> BubbleSpaces:
    """The directions of all bubbles of a mesh."""
    mesh, dim = bubbles.mesh, bubbles.mesh.dim
    trial = np.broadcast_to(np.eye(dim), (len(bubbles.edges), dim, dim)).copy()
    test = trial.copy()
    place = np.full(mesh.n_nodes, -1)
    place[contact.nodes] = np.arange(len(contact.nodes))
    names = [name for name in problem.contact_boundaries if name]
    surface = np.unique(np.concatenate([bubbles.of_facets(mesh.boundary_facets(name)).ravel() for name in names]))
    ends = place[bubbles.edges[surface]]
    # an end without contact conditions of its own follows the other one
    a, b = np.where(ends[:, 0] < 0, ends[:, 1], ends[:, 0]), np.where(ends[:, 1] < 0, ends[:, 0], ends[:, 1])
    state = contact.state
    closed = (a >= 0) & (state[a] != State.OPEN) & (state[b] != State.OPEN)
    surface, a, b = surface[closed], a[closed], b[closed]
    frames = _frames(contact, a, b)
    stick = (state[a] == State.STICK) & (state[b] == State.STICK)
    normal, tangents = frames[:, 0], np.where(stick[:, None, None], 0.0, frames[:, 1:])
    along = from_frames(contact.frames[:, 1:], contact.direction)
    weight = (state == State.SLIP).astype(float)
    mean = (weight[a, None] * along[a] + weight[b, None] * along[b]) / np.maximum(weight[a] + weight[b], 1.0)[:, None]
    share = np.einsum("nd,nkd->nk", mean, tangents)
    trial[surface], test[surface] = 0.0, 0.0
    trial[surface, :, 1:] = tangents.transpose(0, 2, 1)
    test[surface, :, 1:] = (tangents + share[:, :, None] * normal[:, None, :]).transpose(0, 2, 1)
    _hold(problem, bubbles, trial, test)
    return BubbleSpaces(trial, test)


def _frames(contact: LinearisedContact, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Orthonormal frames (n, dim, dim) between those of two contact nodes each."""
    first, second = contact.frames[a], contact.frames[b]
    normal = first[:, 0] + second[:, 0]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tangent = first[:, 1] - np.sum(first[:, 1] * normal, axis=1, keepdims=True) * normal
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    if normal.shape[1] == 2:
        return np.stack([normal, tangent], axis=1)
    return np.stack([normal, tangent, np.cross(normal, tangent)], axis=1)


def _hold(problem: ContactProblem, bubbles: EdgeBubbles, trial: np.ndarray, test: np.ndarray) -> None:
    """Take out, in place, what supports hold: every direction with a part along a fixed component."""
    for support in problem.supports:
        edges = np.unique(bubbles.of_facets(bubbles.mesh.boundary_facets(support.boundary)))
        for k, value in enumerate(support.components(bubbles.mesh.dim)):
            if value is not None:
                lost = np.abs(trial[edges, k, :]) > 1e-8
                for space in (trial, test):
                    space[edges] = np.where(lost[:, None, :], 0.0, space[edges])


_LOCAL = {2: np.array([[1, 2], [2, 0], [0, 1]]), 3: np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])}


@dataclass(frozen=True, eq=False)
class EdgeBubbles:
    """The edges of a mesh and the bubbles on them."""

    mesh: MeshArrays
    axisymmetric: bool
    edges: np.ndarray  # (n_edges, 2) int: nodes, ascending
    element_edges: np.ndarray  # (n_elements, k) int: edges of each element, k = 3 or 6

    @property
    def shares(self) -> np.ndarray:
        """How many elements have each edge (n_edges,)."""
        return np.bincount(self.element_edges.reshape(-1), minlength=len(self.edges))

    def find(self, pairs: np.ndarray) -> np.ndarray:
        """Numbers (n,) of the edges between pairs of nodes (n, 2)."""
        n = self.mesh.n_nodes
        low, high = pairs.min(axis=1).astype(np.int64), pairs.max(axis=1)
        return np.searchsorted(self.edges[:, 0].astype(np.int64) * n + self.edges[:, 1], low * n + high)

    def of_facets(self, facets: np.ndarray) -> np.ndarray:
        """Edges (n, 1) or (n, 3) of boundary facets (n, dim): in 3D the edge from corner k to the next one."""
        if self.mesh.dim == 2:
            return self.find(facets)[:, None]
        return np.column_stack([self.find(facets[:, [k, (k + 1) % 3]]) for k in range(3)])

    def values_at(self, weights: np.ndarray) -> np.ndarray:
        """Values (k,) of the bubbles of an element at a point with these barycentric weights (dim + 1,)."""
        first, second = _LOCAL[self.mesh.dim].T
        return 4 * weights[first] * weights[second]

    def on_elements(self, values: np.ndarray) -> np.ndarray:
        """Values (n_edges,) shared out evenly among the elements (n_elements,) of each edge."""
        return (values / self.shares)[self.element_edges].sum(axis=1)

    def actions(self, problem: ContactProblem, fields: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness of the bubbles, and of fields against them."""
        mesh, dim = self.mesh, self.mesh.dim
        lame, shear = lame_constants(body_materials(mesh, problem.material))
        rule, weights = self._rule
        blocks = np.zeros((len(self.edges), dim, dim))
        actions = np.zeros((len(fields), len(self.edges), dim))
        add_bubbles(mesh.points, mesh.elements, mesh.element_body, lame, shear, _LOCAL[dim],
                            self.element_edges, self.axisymmetric, rule, weights, np.ascontiguousarray(fields), blocks,
                            actions)
        return blocks, actions

    def stiffness(self, problem: ContactProblem, values: np.ndarray) -> np.ndarray:
        """a(sum of bubbles times values, b e_i) for values (n_edges, dim), (n_edges, dim)."""
        mesh, dim = self.mesh, self.mesh.dim
        lame, shear = lame_constants(body_materials(mesh, problem.material))
        result = np.zeros((len(self.edges), dim))
        apply_bubbles(mesh.points, mesh.elements, mesh.element_body, lame, shear, _LOCAL[dim],
                              self.element_edges, self.axisymmetric, *self._rule,
                              np.ascontiguousarray(values), result)
        return result

    def load(self, problem: ContactProblem) -> np.ndarray:
        """Work (n_edges, dim) of all loads on the bubbles, N."""
        result = np.zeros((len(self.edges), self.mesh.dim))
        for load in problem.loads:
            if isinstance(load, InitialStrain):
                continue
            if isinstance(load, BodyForce):
                self._add_body_force(result, load)
            else:
                self._add_traction(result, load)
        strain = [load for load in problem.loads if isinstance(load, InitialStrain)]
        if strain:
            self._add_strain(result, problem, strain)
        return result

    @property
    def _rule(self) -> tuple[np.ndarray, np.ndarray]:
        """For products of two gradients of bubbles: exact but for what is divided by r."""
        return quadrature_rule(self.mesh.dim + 1, AXISYMMETRIC_DEGREE if self.axisymmetric else PLAIN_DEGREE)

    def boundary_work(self, facets: np.ndarray, traction: np.ndarray) -> np.ndarray:
        """Work (n_edges, dim) on the bubbles of a traction that is linear on facets."""
        rule, weights = simplex_rule(self.mesh.dim - 1, 3)
        values = np.einsum("qc,ncm->nqm", rule, traction)
        result = np.zeros((len(self.edges), traction.shape[2]))
        self._add(result, facets, self.of_facets(facets), self._facet_pairs, rule, weights, values,
                  np.linalg.norm(area_vectors(self.mesh.points, facets), axis=1))
        return result

    @property
    def _facet_pairs(self) -> np.ndarray:
        return np.array([[0, 1]]) if self.mesh.dim == 2 else np.array([[0, 1], [1, 2], [2, 0]])

    def _add(self, result: np.ndarray, cells: np.ndarray, edges: np.ndarray, pairs: np.ndarray, rule: np.ndarray,
             weights: np.ndarray, values: np.ndarray, measures: np.ndarray) -> None:
        """Add the integrals of values (n, n_quadrature, m) times bubbles over cells, in place."""
        factor = measures[:, None] * weights
        if self.axisymmetric:
            factor = factor * 2 * np.pi * quadrature_points(self.mesh.points, cells, rule)[:, :, 0]
        for k, (a, b) in enumerate(pairs):
            bubble = 4 * rule[:, a] * rule[:, b]
            np.add.at(result, edges[:, k], np.einsum("nq,q,nqm->nm", factor, bubble, values))

    def _add_traction(self, result: np.ndarray, load: Pressure | Traction) -> None:
        mesh = self.mesh
        facets = named_facets(mesh, load.boundary)
        vectors = area_vectors(mesh.points, facets)
        measures = np.linalg.norm(vectors, axis=1)
        rule, weights = simplex_rule(mesh.dim - 1, 3)
        points = quadrature_points(mesh.points, facets, rule)
        flat = points.reshape(-1, mesh.dim)
        if isinstance(load, Pressure):
            value = checks.field(f"pressure on {load.boundary!r}", load.value, flat).reshape(points.shape[:2])
            values = -value[:, :, None] * (vectors / measures[:, None])[:, None, :]
        else:
            values = _components(load, flat).reshape(points.shape)
        self._add(result, facets, self.of_facets(facets), self._facet_pairs, rule, weights, values, measures)

    def _add_body_force(self, result: np.ndarray, load: BodyForce) -> None:
        mesh = self.mesh
        here = np.ones(len(mesh.elements), dtype=bool)
        if load.body is not None:
            here = mesh.element_body == mesh.bodies.index(load.body)
        rule, weights = simplex_rule(mesh.dim, 3)
        points = quadrature_points(mesh.points, mesh.elements[here], rule)
        values = _components(load, points.reshape(-1, mesh.dim)).reshape(points.shape)
        self._add(result, mesh.elements[here], self.element_edges[here], _LOCAL[mesh.dim], rule, weights, values,
                  mesh.volumes[here])

    def _add_strain(self, result: np.ndarray, problem: ContactProblem, loads: list[InitialStrain]) -> None:
        """Initial strains, by their means on the elements."""
        mesh, dim = self.mesh, self.mesh.dim
        materials = body_materials(mesh, problem.material)
        strain = mean_initial_strain(mesh, loads, axisymmetric=self.axisymmetric)
        thin = np.array([isinstance(one, PlaneStress) for one in materials])[mesh.element_body]
        strain[thin, 2] = 0.0
        lame, shear = (constants[mesh.element_body] for constants in lame_constants(materials))
        stress = lame[:, None] * strain.sum(axis=1)[:, None] + 2 * shear[:, None] * strain
        corners = mesh.points[mesh.elements]
        g = np.linalg.inv(corners[:, 1:] - corners[:, :1])
        g = np.concatenate([-g.sum(axis=2, keepdims=True), g], axis=2)
        rule, weights = simplex_rule(dim, 3)
        factor = mesh.volumes[:, None] * weights
        if self.axisymmetric:
            r = quadrature_points(mesh.points, mesh.elements, rule)[:, :, 0]
            factor = factor * 2 * np.pi * r
        for k, (a, b) in enumerate(_LOCAL[dim]):
            slope = 4 * (np.einsum("eq,q,ed->ed", factor, rule[:, a], g[:, :, b])
                         + np.einsum("eq,q,ed->ed", factor, rule[:, b], g[:, :, a]))
            value = stress[:, :dim] * slope
            if self.axisymmetric:
                value[:, 0] += stress[:, 2] * np.einsum("eq,q->e", factor / r, 4 * rule[:, a] * rule[:, b])
            np.add.at(result, self.element_edges[:, k], value)


def _components(load: BodyForce | Traction, points: np.ndarray) -> np.ndarray:
    """Force (n, dim) per volume or area at points."""
    return np.column_stack([checks.field(f"component {'xyz'[k]} of {type(load).__name__}", component, points)
                            for k, component in enumerate(load.components)])


def edge_bubbles(mesh: MeshArrays, problem: ContactProblem) -> EdgeBubbles:
    """The bubbles on the edges of a mesh."""
    local, n = _LOCAL[mesh.dim], mesh.n_nodes
    pairs = np.sort(mesh.elements[:, local].reshape(-1, 2), axis=1).astype(np.int64)
    keys, numbers = np.unique(pairs[:, 0] * n + pairs[:, 1], return_inverse=True)
    edges = np.column_stack([keys // n, keys % n])
    return EdgeBubbles(mesh, is_axisymmetric(body_materials(mesh, problem.material)), edges,
                       numbers.reshape(len(mesh.elements), len(local)))
