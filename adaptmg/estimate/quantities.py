r"""Quantities of interest: displacements, contact forces and openings as functionals of a solution.

.. math:: J(u) = u_k(x), \qquad J(u) = \frac1{|\Gamma|} \int_\Gamma u_k, \qquad J(u) = \sum_i d_i \cdot (A u - b)_i

with nodal directions d_i at the contact nodes of a boundary (the normal against the body, the tangent, or an axis) and
the derivative :math:`J(v) = (A d) \cdot v`. Tangents that a support holds are left out: there the force of contact
cannot be separated from that of the support. The gap is :math:`g_0 - u_n`, u_n between bodies relative.

A mesh has chords in the place of curves, and the gap :math:`g_0` is linear between its nodes. What that changes in an
opening is mostly far more than the error of the displacement; it follows from the gaps :math:`g_m` in the middle of the
edges, on the curve: of a mean, with the edges halved there, :math:`\tfrac43 (J_{h/2} - J_h)`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._text import brief
from adaptmg.discrete.coordinates import from_frames
from adaptmg.estimate.goal import Functional, GoalView
from adaptmg.geometry.search import BoxTree
from adaptmg.mesh.arrays import Surface
from adaptmg.mesh.bisection.onto_domain import curved_boundaries, on_surface
from adaptmg.problem import ContactPair
from adaptmg.transfer import PointLocator

_AXES = {"x": 0, "y": 1, "z": 2}
#: how far outside its element a point may lie, over the size of the element
_OUTSIDE = 1e-6


def _axis(name: str, value: int | str, dim: int | None = None) -> int:
    """The number of a component given as 0, 1, 2 or "x", "y", "z"."""
    if isinstance(value, str) and value not in _AXES:
        raise ValueError(f"{name} must be 'x', 'y', 'z' or 0, 1, 2, got {checks.shown(value)}")
    number = _AXES[value] if isinstance(value, str) else checks.integer(name, value, 0, 2)
    if dim is not None and number >= dim:
        raise ValueError(f"{name} is {value!r}, but the problem is {dim}D")
    return number


@dataclass(frozen=True)
class Displacement:
    """A component of the displacement at one point or several; each point is a separate quantity.

    Parameters
    ----------
    points : (dim,) or (n, dim) array-like
        m.
    component : 0, 1, 2 or "x", "y", "z"
    body : str, optional
        Of which body; where two touch, a point lies in both.

    Examples
    --------
    >>> am.Goal(am.Displacement((0.0, 0.04), "x")).quantity.component
    'x'
    """

    points: Sequence[float] | Sequence[Sequence[float]]
    component: int | str
    body: str | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        try:
            shape = np.shape(self.points)
        except ValueError:
            raise ValueError(f"points must all have 2 or all 3 coordinates, got {checks.shown(self.points)}") from None
        points = [] if 0 in shape else check_arrays.array("points", [self.points] if len(shape) == 1 else self.points,
                                                          (None, None))
        if not len(points) or points.shape[1] not in (2, 3):
            raise ValueError(f"points must hold at least one point of 2 or 3 coordinates, got shape {shape}")
        object.__setattr__(self, "points", tuple(tuple(float(c) for c in point) for point in points))
        _axis("component", self.component)
        if self.body is not None:
            checks.boundary_name("body", self.body)

    def functionals(self, view: GoalView) -> list[Functional]:
        """Return one functional a point."""
        mesh, points = view.posed.mesh, np.array(self.points)
        k, u = _axis("component", self.component, mesh.dim), view.posed.result.displacement
        if points.shape[1] != mesh.dim:
            raise ValueError(f"points have {points.shape[1]} coordinates in a {mesh.dim}D problem")
        if self.body is not None and self.body not in mesh.bodies:
            raise ValueError(f"body {self.body!r} does not exist{checks.suggestion(self.body, mesh.bodies)}; the "
                             f"bodies are {', '.join(mesh.bodies)}")
        at = PointLocator(mesh, None if self.body is None else mesh.bodies.index(self.body)).locate(points)
        result = []
        for point, element, weights, distance in zip(self.points, at.element, at.weights, at.distance, strict=True):
            if distance > _OUTSIDE * mesh.element_sizes[element]:
                raise ValueError(f"points: {point} lies {distance:.3g} m outside the mesh")
            nodal = np.zeros(mesh.points.shape)
            nodal[mesh.elements[element], k] = weights
            bubbles = np.zeros((len(view.bubbles.edges), mesh.dim))
            bubbles[view.bubbles.element_edges[element], k] = view.bubbles.values_at(weights)
            value = float(weights @ u[mesh.elements[element], k])
            result.append(Functional(f"u_{'xyz'[k]} at {_place(point)}", value, "m", view.load_of(nodal), bubbles))
        return result


def _integrals(view: GoalView, surface: Surface) -> np.ndarray:
    """Integrals (n_edges,) of the bubbles over facets."""
    return view.bubbles.boundary_work(surface, np.ones((*surface.facets.shape, 1)))[:, 0]


def _place(point: Sequence[float]) -> str:
    return f"({', '.join(f'{c:g}' for c in point)})"


@dataclass(frozen=True)
class MeanDisplacement:
    """The mean of a component of the displacement over a boundary (axisymmetric: weighted with the radius).

    Parameters
    ----------
    boundary : str
    component : 0, 1, 2 or "x", "y", "z"

    Examples
    --------
    >>> am.Goal(am.MeanDisplacement("top", "y")).quantity.boundary
    'top'
    """

    boundary: str
    component: int | str

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)
        _axis("component", self.component)

    def functionals(self, view: GoalView) -> list[Functional]:
        """Return the functional."""
        mesh = view.posed.mesh
        k, surface = _axis("component", self.component, mesh.dim), mesh.surface(self.boundary)
        shares = surface.shape_integrals(view.bubbles.axisymmetric)
        size = shares.sum()
        nodal, bubbles = np.zeros(mesh.points.shape), np.zeros((len(view.bubbles.edges), mesh.dim))
        np.add.at(nodal[:, k], surface.facets, shares / size)
        bubbles[:, k] = _integrals(view, surface) / size
        value = float(np.sum(nodal * view.posed.result.displacement))
        return [Functional(f"mean u_{'xyz'[k]} on {self.boundary!r}", value, "m", view.load_of(nodal), bubbles)]


def _contact_mask(view: GoalView, name: str) -> tuple[np.ndarray, float]:
    """Mask of the contact nodes of a boundary, and the sign: -1 where it is the master of a pair."""
    contact = view.posed.result.contact
    if name == "contact":
        return np.ones(len(contact.node), dtype=bool), 1.0
    if name in contact.names:
        return contact.boundary == contact.names.index(name), 1.0
    if name in contact.pair_names:
        return contact.boundary == contact.pair_names.index(name), 1.0
    if name not in contact.masters:
        candidates = ("contact", *contact.names, *filter(None, contact.masters))
        raise ValueError(f"there is no contact on boundary {name!r}{checks.suggestion(name, candidates)}; contact is "
                         f"on {', '.join(map(repr, contact.pair_names))}")
    return np.isin(contact.boundary, [k for k, master in enumerate(contact.masters) if master == name]), -1.0


@dataclass(frozen=True)
class ContactForce:
    """Force through a contact boundary, a sum over nodes.

    Next to a support that holds a tangent of the boundary the tangential part misses what acts on half an edge: where
    friction acts there, an error of first order in the size of that edge, which no estimate contains.

    Parameters
    ----------
    boundary : str
        A contact boundary, the slave, the master or the name ("slave on master") of a pair, or "contact" for all.
    direction : str or int
        "normal": the sum of the compressive nodal forces; "tangential" (2D): that of the tangential forces on the
        slave, along the normal turned by +90 degrees; 0, 1, 2 or "x", "y", "z": the component of the force on the body
        of this boundary.

    Examples
    --------
    >>> am.Goal(am.ContactForce("contact", "normal")).quantity.direction
    'normal'
    """

    boundary: str = "contact"
    direction: int | str = "normal"

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)
        if self.direction not in ("normal", "tangential"):
            _axis("direction", self.direction)

    def functionals(self, view: GoalView) -> list[Functional]:
        """Return the functional."""
        contact, discrete, dim = view.contact, view.posed.discrete, view.posed.mesh.dim
        mine, sign = _contact_mask(view, self.boundary)
        local, named = np.zeros((len(mine), dim)), self.direction in ("normal", "tangential")
        if not named:
            local[mine] = sign * contact.frames[mine, :, _axis("direction", self.direction, dim)]
        elif self.direction == "normal":
            local[mine, 0] = -1.0
        elif dim == 3:
            raise ValueError("direction 'tangential' has no meaning in 3D: give a component, 0, 1 or 2")
        else:
            local[mine, 1] = 1.0
        if discrete.exchange is not None:
            # forces on the node that was posed are those of the equations over sigma
            sigma = discrete.exchange.sigma
            local = local / (np.abs(sigma) if named else sigma)[:, None]
        vector = np.zeros((discrete.n_nodes, dim))
        vector[contact.nodes] = from_frames(contact.frames, local)
        flat = vector.reshape(-1)
        # where a support holds, the force of contact cannot be separated from its reaction
        flat[discrete.fixed] = 0.0
        action = view.bubbles.actions(discrete.physical(flat)[None])[1][0]
        name = f"{self.direction if isinstance(self.direction, str) else 'xyz'[self.direction]} force on "
        return [Functional(name + repr(self.boundary), float(flat @ contact.residual), "N", discrete.matrix @ flat,
                           action)]


@dataclass(frozen=True)
class Opening:
    """The gap at a point of a contact boundary, or its mean over the boundary.

    On curved boundaries of the domain, and in front of a curved obstacle, the signed estimate contains what the chords
    of the mesh change; on those of STEP files, combined solids and meshes without a domain it does not. Of a pair only
    that part of the slave counts that faces the master: where the slave bends away, the end of this part follows the
    mesh, which the estimate does not contain; name a boundary that ends before.

    Parameters
    ----------
    boundary : str
        A contact boundary, or the slave or name ("slave on master") of a pair.
    point : (dim,) array-like, optional
        On the boundary, m. Default: the mean, weighted with the lumped masses of the contact nodes.

    Examples
    --------
    >>> am.Goal(am.Opening("contact", point=(0.0, 0.0))).quantity.point
    (0.0, 0.0)
    """

    boundary: str = "contact"
    point: Sequence[float] | None = None

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)
        if self.point is not None:
            point = check_arrays.vector("point", self.point)
            if len(point) not in (2, 3):
                raise ValueError(f"point must have 2 or 3 coordinates, got {len(point)}")
            object.__setattr__(self, "point", tuple(float(c) for c in point))

    def functionals(self, view: GoalView) -> list[Functional]:
        """Return the functional."""
        contact, result, mesh = view.contact, view.posed.result.contact, view.posed.mesh
        mine, sign = _contact_mask(view, self.boundary)
        if sign < 0:
            raise ValueError(f"boundary {self.boundary!r} is the master of a pair: give the slave, which has the gaps")
        of_boundary = {k: mesh.surface(result.names[k]) for k in np.unique(result.boundary[mine])}
        every = Surface(mesh.points, np.concatenate([one.facets for one in of_boundary.values()]))
        masters = 0.0
        if self.point is None:
            weights = np.where(mine, result.weights, 0.0)
            weights = weights / weights.sum()
            mean, size = float(weights @ result.gap), every.shape_integrals(view.bubbles.axisymmetric).sum()
            bubbles = _integrals(view, every) / size
            name = f"mean opening of {self.boundary!r}"
            geometry = sum(_chords(view, k, own, mean) for k, own in of_boundary.items()) / size
            masters = sum(_of_master(view, k) for k in of_boundary) / size
        else:
            weights, bubbles = self._at_point(view, every.facets)
            geometry = bubbles * sum(_bumps(view, k, own) for k, own in of_boundary.items())
            name = f"opening of {self.boundary!r} at {_place(self.point)}"
        sigma = 1.0 if view.posed.discrete.exchange is None else np.abs(view.posed.discrete.exchange.sigma)
        vector = np.zeros((view.posed.discrete.n_nodes, mesh.dim))
        vector[contact.nodes] = -(weights * sigma)[:, None] * contact.frames[:, 0]
        normals = np.zeros(mesh.points.shape)
        normals[result.node] = result.frames[:, 0]
        along = normals[view.bubbles.edges].sum(axis=1)
        length = np.linalg.norm(along, axis=1, keepdims=True)
        along = -bubbles[:, None] * np.divide(along, length, out=np.zeros_like(along), where=length > 0) - masters
        return [Functional(name, float(weights @ result.gap), "m", vector.reshape(-1), along, geometry)]

    def _at_point(self, view: GoalView, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights of the contact nodes (n_contact,) and of the edges (n_edges,) at the point."""
        mesh, point = view.posed.mesh, np.array(self.point)
        if len(point) != mesh.dim:
            raise ValueError(f"point has {len(point)} coordinates in a {mesh.dim}D problem")
        (k,), (shape,), _ = BoxTree(mesh.points, facets).nearest(point[None])
        distance = np.linalg.norm(shape @ mesh.points[facets[k]] - point)
        if distance > _OUTSIDE * np.ptp(mesh.points[facets[k]], axis=0).max():
            raise ValueError(f"point {self.point} lies {distance:.3g} m off the boundary {self.boundary!r}")
        weights, bubbles = np.zeros(len(view.contact.nodes)), np.zeros(len(view.bubbles.edges))
        place = {node: i for i, node in enumerate(view.posed.result.contact.node)}
        for corner, share in zip(facets[k], shape, strict=True):
            if corner in place:
                weights[place[corner]] += share
            elif share > 1e-9:
                raise ValueError(f"point {self.point}: its neighbour, node {corner}, carries no contact condition")
        bubbles[view.bubbles.of_facets(facets[k:k + 1])[0]] = 4 * np.prod(_ends(shape[None]), axis=0)[0]
        return weights, bubbles


def _ends(facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ends (n, n_edges) of the edges of facets."""
    return (facets[:, :1], facets[:, 1:]) if facets.shape[1] == 2 else (facets, np.roll(facets, -1, axis=1))


def _faced(view: GoalView, k: int) -> Surface:
    """Facets of the master of pair k whose nodes are all faced by contact nodes."""
    result, mesh = view.posed.result.contact, view.posed.mesh
    facets = mesh.surface(result.masters[k]).facets
    return Surface(mesh.points, facets[np.isin(facets, result.master_node[result.master_boundary == k]).all(axis=1)])


def _of_master(view: GoalView, k: int) -> np.ndarray | float:
    """By how much the bubbles (n_edges, dim) of the master of contact boundary k, moving outwards, close the gap."""
    if not view.posed.result.contact.masters[k]:
        return 0.0
    faced = _faced(view, k)
    return view.bubbles.boundary_work(faced, np.repeat(faced.normals[:, None], faced.facets.shape[1], axis=1))


def _middles(view: GoalView, name: str, surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Middles (n, n_edges, dim) of the edges of facets, on the curve, and how far (n, n_edges) out of the chord, m."""
    points, (a, b) = surface.points, _ends(surface.facets)
    middle = places = 0.5 * (points[a] + points[b])
    normals = np.repeat(surface.normals[:, None], a.shape[1], axis=1)
    curved = curved_boundaries(view.posed.problem.domain)
    if name in curved:
        flat = (-1, points.shape[1])
        places = on_surface(*curved[name], points[a].reshape(flat), points[b].reshape(flat), normals.reshape(flat)
                            ).reshape(middle.shape)
    return places, np.einsum("npd,npd->np", places - middle, normals)


def _middle_gaps(view: GoalView, k: int, surface: Surface) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gaps (n_nodes,), middles of the edges of facets of contact boundary k, and gaps (n, n_edges) there. A node
    without a condition makes them NaN."""
    contact, result, mesh = view.posed.problem.contact[k], view.posed.result.contact, view.posed.mesh
    gap, normal = np.full((2, mesh.n_nodes), np.nan)
    gap[result.node], normal[result.node] = result.gap, result.u_n
    middles, out = _middles(view, contact.boundary, surface)
    a, b = _ends(surface.facets)
    if isinstance(contact, ContactPair):
        # gaps that the user gives do not depend on the curve
        between = 0.5 * (gap[a] + gap[b]) - (out if contact.gap is None else 0.0)
    else:
        flat, normals = (-1, mesh.dim), np.repeat(surface.normals[:, None], a.shape[1], axis=1)
        _, first = contact.obstacle.contact(middles.reshape(flat), normals.reshape(flat))
        between = np.reshape(first, a.shape) - 0.5 * (normal[a] + normal[b])
    # where bodies touch at both ends they do so between
    return gap, middles, np.maximum(between, 0.0)


def _bumps(view: GoalView, k: int, surface: Surface) -> np.ndarray:
    """By how much (n_edges,) the gap in the middle of an edge of contact boundary k exceeds that of its nodes, m."""
    gap, _, between = _middle_gaps(view, k, surface)
    a, b = _ends(surface.facets)
    result = np.zeros(len(view.bubbles.edges))
    result[view.bubbles.of_facets(surface.facets)] = np.nan_to_num(between - 0.5 * (gap[a] + gap[b]))
    return result


def _chords(view: GoalView, k: int, surface: Surface, mean: float) -> np.ndarray:
    """What the curves of contact boundary k change in a mean, times the size of the boundary, by edges (n_edges,)."""
    gap, middles, between = _middle_gaps(view, k, surface)
    result = _halved(view, surface.facets, middles, gap[surface.facets] - mean, between - mean)
    master = view.posed.result.contact.masters[k]
    if master and view.posed.problem.contact[k].gap is None:
        faced = _faced(view, k)
        middles, out = _middles(view, master, faced)
        result += _halved(view, faced.facets, middles, np.zeros(faced.facets.shape), -out)
    return result


def _halved(view: GoalView, facets: np.ndarray, middles: np.ndarray, corners: np.ndarray, between: np.ndarray
            ) -> np.ndarray:
    """4/3 of what an integral over facets changes with their edges halved at ``middles``, by edges (n_edges,)."""
    mesh, dim = view.posed.mesh, facets.shape[1]
    points = np.concatenate([mesh.points, middles.reshape(-1, dim)])
    table = np.concatenate([facets, mesh.n_nodes + np.arange(between.size).reshape(between.shape)], axis=1)
    values = np.concatenate([corners, between], axis=1)

    def integrals(part: list[int]) -> np.ndarray:
        cells = Surface(points, table[:, part])
        return cells.measures * np.sum(cells.shares(view.bubbles.axisymmetric) * values[:, part], axis=1)

    parts = [[0, 2], [2, 1]] if dim == 2 else [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]
    change = sum(map(integrals, parts)) - integrals(list(range(dim)))
    share = np.nan_to_num(4 / 3 * change / between.shape[1])
    result = np.zeros(len(view.bubbles.edges))
    np.add.at(result, view.bubbles.of_facets(facets), np.repeat(share[:, None], between.shape[1], axis=1))
    return result
