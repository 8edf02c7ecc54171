r"""Edge bubbles :math:`b_E = 4 \lambda_a \lambda_b`, which are quadratic and not in a P1 space, and the error in them.

With the residuals of the discrete solution and of a dual field against the bubbles,

.. math:: \rho_E(v) = b(b_E v) + \langle t_h, b_E v\rangle - a(u_h, b_E v), \qquad
          \rho^*_E(v) = J(b_E v) + \langle t^*_h, b_E v\rangle - a(b_E v, z_h)

(t: tractions of contact on masters, whose bubbles move for themselves), the amplitudes of the error are, for all
bubbles together (some steps of GMRES) and for each edge alone,

.. math:: a\Bigl(\sum_F b_F d_F, b_E v\Bigr) = \rho_E(v), \qquad a(b_E d^0_E, b_E v) = \rho_E(v)

(hierarchical basis, R. Bank, R. K. Smith, SIAM J. Numer. Anal. 30, 1993, doi:10.1137/0730048). The first gives the
signed estimate :math:`J(e) \approx \sum_E \rho^*_E(d_E)`, which edge by edge would be 1.3 to 2 times too large; the
second marks. In axisymmetry the hoop strain of a bubble is :math:`b_E / r` and the weight :math:`2 \pi r`. Bubbles of
faces in 3D (cubic) would miss most of the error.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from adaptmg.discrete.anisotropic import Moduli, as_tensors, moduli
from adaptmg.discrete.coordinates import from_frames
from adaptmg.discrete.elasticity import body_materials, is_axisymmetric, lame_constants
from adaptmg.discrete.loads import body_elements, foundation, load_density
from adaptmg.discrete.stress import StressData
from adaptmg.discrete.supports import held_directions
from adaptmg.estimate.adjoint import LinearisedContact
from adaptmg.geometry.quadrature import integration, quadrature_points, simplex_rule
from adaptmg.mesh.arrays import MeshArrays, Surface
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.loads import BodyForce, InitialStrain, Spring
from adaptmg.smoother.system import ContactState as State

_LOG = logging.getLogger(__name__)

#: corners of the edges of an element
_LOCAL = {2: np.array([[1, 2], [2, 0], [0, 1]]), 3: np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])}
#: corners of the edges of a facet
_OF_FACET = {2: np.array([[0, 1]]), 3: np.array([[0, 1], [1, 2], [2, 0]])}
#: Gauss points a direction for loads times bubbles
_LOAD_POINTS = 3


@dataclass(frozen=True, eq=False)
class EdgeBubbles:
    """The edges of a mesh and the bubbles on them."""

    mesh: MeshArrays
    problem: ContactProblem
    axisymmetric: bool
    edges: np.ndarray  # (n_edges, 2) int: nodes, ascending
    element_edges: np.ndarray  # (n_elements, k) int: edges of each element, k = 3 or 6

    def of_facets(self, facets: np.ndarray) -> np.ndarray:
        """Return edges (n, 1) or (n, 3) of boundary facets (n, dim): in 3D the edge from corner k to the next one."""
        n, ends = self.mesh.n_nodes, np.sort(facets[:, _OF_FACET[self.mesh.dim]], axis=2).astype(np.int64)
        keys = self.edges[:, 0].astype(np.int64) * n + self.edges[:, 1]
        return np.searchsorted(keys, ends[..., 0] * n + ends[..., 1])

    def of_boundaries(self, names: Sequence[str]) -> np.ndarray:
        """Return the edges (n,) on some boundaries, each once."""
        return np.unique(np.concatenate([np.empty(0, dtype=np.int64), *(
            self.of_facets(self.mesh.boundary_facets(name)).ravel() for name in names)]))

    def values_at(self, weights: np.ndarray) -> np.ndarray:
        """Return values (k,) of the bubbles of an element at a point with these barycentric weights (dim + 1,)."""
        first, second = _LOCAL[self.mesh.dim].T
        return 4 * weights[first] * weights[second]

    def on_elements(self, values: np.ndarray) -> np.ndarray:
        """Return values (n_edges,) shared out evenly among the elements (n_elements,) of each edge."""
        n_elements = np.bincount(self.element_edges.reshape(-1), minlength=len(self.edges))
        return (values / n_elements)[self.element_edges].sum(axis=1)

    def actions(self, fields: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a(b_E e_i, b_E e_j) (n_edges, dim, dim), and a(field, b_E e_i) (n_fields, n_edges, dim) of P1
        fields."""
        mesh, dim, (lame, shear) = self.mesh, self.mesh.dim, self._moduli
        blocks = np.zeros((*self.element_edges.shape, dim, dim))
        works = np.zeros((len(fields), *self.element_edges.shape, dim))
        slopes = [np.einsum("nci,ncj->nij", nodal[mesh.elements], self._gradients) for nodal in fields]
        for weight, at, r, gradients, hoop in self._points:
            if self._tensors is None:
                spread = gradients.copy()
                spread[:, :, 0] += hoop
                block = lame[:, None, None, None] * np.einsum("nki,nkj->nkij", spread, spread)
                block += shear[:, None, None, None] * np.einsum("nki,nkj->nkij", gradients, gradients)
                square = np.einsum("nkj,nkj->nk", gradients, gradients)
                block += (shear[:, None] * square)[:, :, None, None] * np.eye(dim)
                block[:, :, 0, 0] += 2 * shear[:, None] * hoop**2
            else:
                block = np.empty((*gradients.shape, dim))
                for k, i in product(range(gradients.shape[1]), range(dim)):
                    slope, alone = np.zeros((len(gradients), dim, dim)), slice(k, k + 1)
                    slope[:, i] = gradients[:, k]
                    around = hoop[:, k] if i == 0 else np.zeros(len(hoop))
                    block[:, k, :, i] = self._work(slope, around, gradients[:, alone], hoop[:, alone])[:, 0]
            blocks += weight[:, None, None, None] * block
            for work, nodal, slope in zip(works, fields, slopes, strict=True):
                around = nodal[mesh.elements, 0] @ at / r if self.axisymmetric else np.zeros(len(r))
                work += weight[:, None, None] * self._work(slope, around, gradients, hoop)
        blocks = self._on_edges(blocks)
        actions = np.array([self._on_edges(work) for work in works])
        for spring in (one for one in self.problem.supports if isinstance(one, Spring)):
            surface = self.mesh.surface(spring.boundary)
            stiffness = foundation(spring, self.mesh.points[surface.facets], surface.normals)
            for action, nodal in zip(actions, fields, strict=True):
                action += self.boundary_work(surface, np.einsum("fkij,fkj->fki", stiffness, nodal[surface.facets]))
        return blocks, actions

    def stiffness(self, values: np.ndarray) -> np.ndarray:
        """Return a(sum of bubbles times values, b_E e_i) for values (n_edges, dim), (n_edges, dim)."""
        local = values[self.element_edges]
        result = np.zeros(local.shape)
        for weight, _, _, gradients, hoop in self._points:
            slope, around = local.swapaxes(1, 2) @ gradients, np.einsum("nk,nk->n", hoop, local[:, :, 0])
            result += weight[:, None, None] * self._work(slope, around, gradients, hoop)
        return self._on_edges(result)

    @cached_property
    def _moduli(self) -> tuple[np.ndarray, np.ndarray]:
        """Lame constants (n_elements,)."""
        lame, shear = lame_constants(body_materials(self.mesh, self.problem.material))
        return lame[self.mesh.element_body], shear[self.mesh.element_body]

    @cached_property
    def _tensors(self) -> Moduli | None:
        """Tensors of the elements where a body is anisotropic."""
        return moduli(self.mesh, body_materials(self.mesh, self.problem.material))

    @cached_property
    def _gradients(self) -> np.ndarray:
        """Gradients (n_elements, dim + 1, dim) of the barycentric coordinates."""
        corners = self.mesh.points[self.mesh.elements]
        others = np.linalg.inv(corners[:, 1:] - corners[:, :1]).swapaxes(1, 2)
        return np.concatenate([-others.sum(axis=1, keepdims=True), others], axis=1)

    @cached_property
    def _points(self) -> list[tuple[np.ndarray, ...]]:
        """At each quadrature point weights (n_elements,), barycentric weights (dim + 1,), radii (n_elements,), and of
        the bubbles (n_elements, k) gradients and values over r, 0 in the plane. The rule is exact for two gradients
        but for what is over r."""
        result = []
        mesh, (first, second), g = self.mesh, _LOCAL[self.mesh.dim].T, self._gradients
        rule, places, weights = integration(mesh.points, mesh.elements, mesh.volumes, self.axisymmetric)
        for at, place, weight in zip(rule, places.swapaxes(0, 1), weights.T, strict=True):
            gradients = 4 * (at[first, None] * g[:, second] + at[second, None] * g[:, first])
            r = place[:, 0] if self.axisymmetric else np.ones(len(g))
            over_r = self.values_at(at) / r[:, None] if self.axisymmetric else np.zeros(gradients.shape[:2])
            result.append((weight, at, r, gradients, over_r))
        return result

    def _work(self, slope: np.ndarray, around: np.ndarray, gradients: np.ndarray, hoop: np.ndarray) -> np.ndarray:
        """Work (n_elements, k, dim) of the stress of displacement gradients and hoop strains on the bubbles."""
        dim, (lame, shear) = self.mesh.dim, self._moduli
        if self._tensors is not None:
            strain = np.zeros((len(slope), 3, 3))
            strain[:, :dim, :dim] = 0.5 * (slope + slope.swapaxes(1, 2))
            strain[:, 2, 2] += around
            stress = as_tensors(self._tensors.stress(strain))
            result = gradients @ stress[:, :dim, :dim]
            result[:, :, 0] += stress[:, 2, 2, None] * hoop
            return result
        pressure = lame * (np.trace(slope, axis1=1, axis2=2) + around)
        stress = shear[:, None, None] * (slope + slope.swapaxes(1, 2)) + pressure[:, None, None] * np.eye(dim)
        result = gradients @ stress
        result[:, :, 0] += (pressure + 2 * shear * around)[:, None] * hoop
        return result

    def _on_edges(self, values: np.ndarray) -> np.ndarray:
        """Sums (n_edges, ...) of values (n_elements, k, ...) over the elements of each edge."""
        flat, edges = values.reshape(self.element_edges.size, -1), self.element_edges.reshape(-1)
        sums = [np.bincount(edges, column, minlength=len(self.edges)) for column in flat.T]
        return np.stack(sums, axis=1).reshape(len(self.edges), *values.shape[2:])

    def boundary_work(self, surface: Surface, traction: np.ndarray) -> np.ndarray:
        """Return work (n_edges, m) on the bubbles of values (n, dim, m) at the corners of facets, linear in between."""
        rule, _ = simplex_rule(self.mesh.dim - 1, _LOAD_POINTS)
        result = np.zeros((len(self.edges), traction.shape[2]))
        self._add(result, surface.facets, self.of_facets(surface.facets), np.einsum("qc,ncm->nqm", rule, traction),
                  surface.measures)
        return result

    def load(self) -> np.ndarray:
        """Return work (n_edges, dim) of all loads of the problem on the bubbles, N."""
        mesh, dim, loads = self.mesh, self.mesh.dim, self.problem.loads
        result = np.zeros((len(self.edges), dim))
        for load in loads:
            if isinstance(load, InitialStrain):
                continue
            if isinstance(load, BodyForce):
                here = slice(None) if load.body is None else body_elements(mesh, load.body)
                cells, edges, measures = mesh.elements[here], self.element_edges[here], mesh.volumes[here]
                normals = None
            else:
                surface = mesh.surface(load.boundary)
                cells, measures, normals = surface.facets, surface.measures, surface.normals
                edges = self.of_facets(cells)
            rule, _ = simplex_rule(cells.shape[1] - 1, _LOAD_POINTS)
            density = load_density(load, quadrature_points(mesh.points, cells, rule), normals)
            self._add(result, cells, edges, density, measures)
        if any(isinstance(load, InitialStrain) for load in loads):
            result += self._strain_load()
        return result

    def _add(self, result: np.ndarray, cells: np.ndarray, edges: np.ndarray, values: np.ndarray, measures: np.ndarray
             ) -> None:
        """Add the integrals of values (n, n_quadrature, m) times bubbles over cells (elements or facets), in place."""
        dim = self.mesh.dim
        rule, weights = simplex_rule(cells.shape[1] - 1, _LOAD_POINTS)
        factor = measures[:, None] * weights
        if self.axisymmetric:
            factor = factor * 2 * np.pi * quadrature_points(self.mesh.points, cells, rule)[:, :, 0]
        for k, (a, b) in enumerate((_OF_FACET if cells.shape[1] == dim else _LOCAL)[dim]):
            np.add.at(result, edges[:, k], np.einsum("nq,q,nqm->nm", factor, 4 * rule[:, a] * rule[:, b], values))

    def _strain_load(self) -> np.ndarray:
        """Work (n_edges, dim) of the mean initial strains of the elements."""
        mesh, dim = self.mesh, self.mesh.dim
        data = StressData.of(mesh, self.problem.material, self.problem.loads)
        stress = -data.tensors(mesh, np.zeros(mesh.points.shape))
        total = np.zeros((*self.element_edges.shape, dim))
        for weight, _, _, gradients, hoop in self._points:
            work = gradients @ stress[:, :dim, :dim]
            work[:, :, 0] += stress[:, 2, 2, None] * hoop
            total += weight[:, None, None] * work
        return self._on_edges(total)


def edge_bubbles(mesh: MeshArrays, problem: ContactProblem) -> EdgeBubbles:
    """Return the bubbles on the edges of a mesh."""
    local, n = _LOCAL[mesh.dim], mesh.n_nodes
    pairs = np.sort(mesh.elements[:, local].reshape(-1, 2), axis=1).astype(np.int64)
    keys, numbers = np.unique(pairs[:, 0] * n + pairs[:, 1], return_inverse=True)
    edges = np.column_stack([keys // n, keys % n])
    return EdgeBubbles(mesh, problem, is_axisymmetric(body_materials(mesh, problem.material)), edges,
                       numbers.reshape(len(mesh.elements), len(local)))


@dataclass(frozen=True, eq=False)
class BubbleSpaces:
    """Directions of the bubbles, (n_edges, dim, dim) in columns; columns of zeros are directions that do not exist."""

    trial: np.ndarray  # of errors
    test: np.ndarray  # of dual fields

    @property
    def missing(self) -> np.ndarray:
        """Directions (n_edges, dim) that do not exist, bool."""
        return ~self.trial.any(axis=1)


def bubble_spaces(bubbles: EdgeBubbles, contact: LinearisedContact) -> BubbleSpaces:
    r"""Return the directions of all bubbles of a mesh, with supports, and contact linearised as at the nodes. On a
    contact edge whose ends both touch an error has no part along the normal, and none at all where both stick; dual
    directions of a slipping edge are :math:`t + \mu f n`. An edge with one open end counts as open, one with one
    slipping end as slipping: of these the solution does not know where contact ends. The slip Hessian of 3D and
    friction that holds open nodes (Tresca) are left out."""
    mesh, dim, problem = bubbles.mesh, bubbles.mesh.dim, bubbles.problem
    trial = np.broadcast_to(np.eye(dim), (len(bubbles.edges), dim, dim)).copy()
    test = trial.copy()
    place = np.full(mesh.n_nodes, -1)
    place[contact.nodes] = np.arange(len(contact.nodes))
    surface = bubbles.of_boundaries(problem.contact_boundaries if len(contact.nodes) else ())
    ends = place[bubbles.edges[surface]]
    # an end without a contact condition follows the other one
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
    # slaves of ties follow their masters
    tied = bubbles.of_boundaries([tie.slave for tie in problem.ties])
    trial[tied], test[tied] = 0.0, 0.0
    for name, directions in held_directions(mesh, problem.supports).items():
        edges = np.unique(bubbles.of_facets(mesh.boundary_facets(name)))
        # with columns along and across what is held, where no contact has chosen others
        plain = edges[(trial[edges] == np.eye(dim)).all(axis=(1, 2))]
        trial[plain] = test[plain] = np.linalg.qr(directions.T, mode="complete")[0]
        held = (np.abs(np.einsum("kd,edj->ekj", directions, trial[edges])) > 1e-8).any(axis=1)
        for space in (trial, test):
            space[edges] = np.where(held[:, None, :], 0.0, space[edges])
    return BubbleSpaces(trial, test)


def _frames(contact: LinearisedContact, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Orthonormal frames (n, dim, dim) between those of two contact nodes each."""
    first, second = contact.frames[a], contact.frames[b]
    normal = first[:, 0] + second[:, 0]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tangent = first[:, 1] - np.sum(first[:, 1] * normal, axis=1, keepdims=True) * normal
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    third = [np.cross(normal, tangent)] if normal.shape[1] == 3 else []
    return np.stack([normal, tangent, *third], axis=1)


#: residual of the bubbles' equations, and the steps to a restart: five to ten suffice, the condition is about ten
_RTOL, _STEPS = 1e-2, 30


@dataclass(frozen=True, eq=False)
class BubbleError:
    """Amplitudes of the bubbles in the error, (n_edges, dim) each, m."""

    together: np.ndarray  # of all bubbles in one system: signed estimates
    alone: np.ndarray  # of each edge by itself: marks
    energy: float  # energy norm of the error in the bubbles, sqrt(N m)


def bubble_error(bubbles: EdgeBubbles, spaces: BubbleSpaces, blocks: np.ndarray, residual: np.ndarray) -> BubbleError:
    """Return the error of a discrete solution in the space of bubbles, from its residual (n_edges, dim)."""
    trial, test, shape = spaces.trial, spaces.test, residual.shape
    small = np.einsum("nik,nij,njl->nkl", test, blocks, trial)
    small[spaces.missing[:, :, None] & np.eye(shape[1], dtype=bool)] = 1.0
    inverse = np.linalg.inv(small)
    load = np.einsum("nik,ni->nk", test, residual)

    def stiffness(x: np.ndarray) -> np.ndarray:
        x = x.reshape(shape)
        action = bubbles.stiffness(np.einsum("nik,nk->ni", trial, x))
        return (np.einsum("nik,ni->nk", test, action) + np.where(spaces.missing, x, 0.0)).reshape(-1)

    def alone(x: np.ndarray) -> np.ndarray:
        return np.einsum("nkl,nl->nk", inverse, x.reshape(shape)).reshape(-1)

    n = load.size
    operator, inner = (LinearOperator((n, n), matvec=f, dtype=np.float64) for f in (stiffness, alone))
    # scipy tests the preconditioned residual; if the true one is a little larger it restarts
    solution, failed = gmres(operator, load.reshape(-1), rtol=_RTOL, atol=0.0, restart=_STEPS, maxiter=3, M=inner)
    if failed:
        _LOG.info("the equations of %d bubbles were not solved to %.0e", len(load), _RTOL)
    together = np.einsum("nik,nk->ni", trial, solution.reshape(shape))
    single = np.einsum("nik,nk->ni", trial, alone(load).reshape(shape))
    return BubbleError(together, single, float(np.sqrt(max(np.sum(residual * together), 0.0))))
