r"""Quantities of interest: displacements, contact forces and openings as functionals of a solution.

.. math:: J(u) = u_k(x), \qquad J(u) = \frac1{|\Gamma|} \int_\Gamma u_k, \qquad J(u) = \sum_i d_i \cdot (A u - b)_i

with nodal directions d_i at the contact nodes of a boundary (the normal against the body, the
tangent, or an axis) and the derivative :math:`J(v) = (A d) \cdot v`. Tangents that a support holds
are left out: there the force of contact cannot be separated from that of the support. The gap is
:math:`g_0 - u_n`, u_n between bodies relative.

A quantity is asked on the mesh of the solution, and for the solution on the mesh with all edges
halved, whose new nodes lie on the curves of the domain: what its value changes there is the error
of the chords."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Protocol, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg.discrete.contact_nodes import ContactNodes
from adaptmg.discrete.coordinates import from_frames
from adaptmg.discrete.discretise import discretise
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.estimate.adjoint import LinearisedContact, linearised_contact
from adaptmg.estimate.stress_fields import Solved
from adaptmg.geometry.search import BoxTree
from adaptmg.mesh.arrays import MeshArrays, Refinement
from adaptmg.mesh.bisection import refined
from adaptmg.mesh.projection import onto_domain
from adaptmg.problem import ContactProblem
from adaptmg.smoother.system import ContactState as State
from adaptmg.transfer import PointLocator

_AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True, eq=False)
class GoalView:
    """A solution on its mesh as quantities see it, or the same on the mesh with all edges
    halved."""

    problem: ContactProblem
    mesh: MeshArrays
    displacement: np.ndarray  # (n_nodes, dim), m
    contact: LinearisedContact
    #: on the halved mesh the view of the mesh whose edges are halved. Contact forces are taken from there: A u -
    #: b of the interpolated displacement is not a contact force
    coarse: GoalView | None = None

    @classmethod
    def of(cls, solved: Solved) -> GoalView:
        """Return the view of a result."""
        if solved.discrete.contact.compliance.any():
            raise ValueError("contact: am.Goal cannot take NormalCompliance; use am.Residual()")
        solved.discrete.need_given_friction("am.Goal", "am.Residual() or am.Recovery()")
        u = solved.result.displacement
        state = np.asarray(solved.result.contact.state).astype(int)
        return cls(solved.problem, solved.mesh, u, linearised_contact(solved.discrete, u, state))

    @property
    def discrete(self) -> DiscreteProblem:
        return self.contact.discrete

    @property
    def touching(self) -> ContactNodes:
        """Return the contact nodes."""
        return self.discrete.contact

    def load_of(self, nodal: np.ndarray) -> np.ndarray:
        """Return a functional of the displacement, by its derivatives ``nodal`` (n_nodes, dim), as one
        (n_dofs,) of the relative coordinates."""
        flat = np.asarray(nodal, dtype=np.float64).reshape(-1)
        return self.discrete.relative_forces(flat)

    def interpolated(self, coarse: np.ndarray) -> np.ndarray:
        """Return a vector (n_dofs,) of the coarse mesh, relative coordinates, on this one."""
        # of a halved mesh only
        nodal = cast("GoalView", self.coarse).discrete.physical(coarse).reshape(-1, self.mesh.dim)
        return self.discrete.relative(_halved(self.mesh, nodal, _mean)).reshape(-1)

    def halved(self) -> tuple[GoalView, np.ndarray]:
        """Return the view of the mesh with all edges halved, with the interpolated displacement, and the
        element of this mesh that holds each of its elements (n_elements,)."""
        bisected = refined(self.mesh, np.ones(len(self.mesh.elements), dtype=bool))
        mesh = onto_domain(self.problem.domain, bisected.mesh, self.mesh.n_nodes)
        slips = np.zeros(self.displacement.shape)
        states = np.full(self.mesh.n_nodes, _NONE)
        slips[self.touching.nodes] = self.touching.slip_reference
        states[self.touching.nodes] = self.contact.state
        discrete = discretise(self.problem, mesh, slip_reference=_halved(mesh, slips, _mean))
        u = _halved(mesh, self.displacement, _mean)
        states = _halved(mesh, states, _looser)
        at = discrete.contact.nodes
        # new contact nodes between nodes without a condition are open
        contact = linearised_contact(
            discrete, u, np.where(states[at] == _NONE, State.OPEN, states[at])
        )
        # H = g/|s| (I - f f') is left out: the limits g would come from A u - b, which is not a contact
        # force of the interpolated u
        contact = replace(contact, hessian=np.zeros_like(contact.hessian))
        return GoalView(self.problem, mesh, u, contact, self), bisected.origin


#: the state of a node without a contact condition
_NONE = -1


def _halved(
    mesh: MeshArrays, values: np.ndarray, rule: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> np.ndarray:
    """Return values (n_nodes, ...) on a bisected mesh: the given ones at its first nodes, and at each
    new node ``rule`` of the two ends of the edge that it halves."""
    n = len(values)
    first, second = cast("Refinement", mesh.refinement).parents[n:].T
    result = np.concatenate([values, np.zeros((len(first), *values.shape[1:]), values.dtype)])
    # a new node may halve an edge that ends in another new node, whose value is right only after a pass or
    # more: the passes end where nothing changes
    while True:
        new = rule(result[first], result[second])
        if np.array_equal(new, result[n:]):
            return result
        result[n:] = new


def _mean(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the value in the middle between two nodes."""
    return 0.5 * (a + b)


def _looser(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the states (n,) between two nodes each: the looser one, as the solution does not say where
    contact ends (the codes ascend: OPEN, SLIP, STICK), or that of the node that has one."""
    return np.where(a == _NONE, b, np.where(b == _NONE, a, np.minimum(a, b)))


@dataclass(frozen=True, eq=False)
class Functional:
    """A quantity of a solution, and how it changes with it."""

    name: str  # for tables
    value: float  # of the discrete solution, in ``unit``
    unit: str  # SI
    vector: np.ndarray  # (n_dofs,): its derivative by the relative coordinates, Cartesian


class Quantity(Protocol):
    """A quantity that a goal may ask for; a user-defined quantity is any object with this
    method."""

    def functionals(self, view: GoalView) -> list[Functional]:
        """Return the quantity, or several, of a solution."""
        ...


def checked_functionals(view: GoalView, quantity: Quantity) -> list[Functional]:
    """Return the functionals of a quantity; TypeError or ValueError, which name it, unless they fit this
    view."""
    made = quantity.functionals(view)
    name = f"quantity {checks.shown(quantity)}: "
    if not isinstance(made, (list, tuple)) or not all(
        isinstance(entry, Functional) for entry in made
    ):
        raise TypeError(
            f"{name}functionals(view) must return a list of Functional, got {checks.described(made)}"
        )
    if not made:
        raise ValueError(f"{name}functionals(view) must return at least one Functional, got none")
    for functional in made:
        checks.instance(f"{name}name", functional.name, str, "text")
        checks.number(f"{name}value", functional.value)
        checks.array(f"{name}vector", functional.vector, (view.discrete.n_dofs,))
    return list(made)


def _axis(name: str, value: int | str, dim: int | None = None, others: str = "") -> int:
    """Return the number of a component given as 0, 1, 2 or "x", "y", "z"; ValueError for others, and
    for those beyond the dimension. ``others`` are the values that the caller takes, too."""
    if isinstance(value, str) and value not in _AXES:
        raise ValueError(
            f"{name} must be {others}'x', 'y', 'z' or 0, 1, 2, got {checks.shown(value)}"
        )
    number = _AXES[value] if isinstance(value, str) else checks.integer(name, value, 0, 2)
    if dim is not None and number >= dim:
        raise ValueError(f"{name} is {value!r}, but the problem is {dim}D")
    return number


def _component(name: str, value: int | str) -> int | str:
    """Return a component unchanged; see :func:`_axis`."""
    _axis(name, value)
    return value


Component = Annotated[int | str, _component]


@dataclass(frozen=True, repr=False)
class Displacement(checks.Checked):
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
    component: Component
    body: checks.Name | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            shape = np.shape(self.points)
        except ValueError:
            raise ValueError(
                f"points must all have 2 or all 3 coordinates, got {checks.shown(self.points)}"
            ) from None
        points = np.empty((0, 0))  # stays where no points are given, and is refused below
        if 0 not in shape:
            rows = [self.points] if len(shape) == 1 else self.points
            points = checks.array("points", rows, (None, None))
        if not len(points) or points.shape[1] not in (2, 3):
            raise ValueError(
                f"points must hold at least one point of 2 or 3 coordinates, got shape {shape}"
            )
        object.__setattr__(
            self, "points", tuple(tuple(float(c) for c in point) for point in points)
        )

    def functionals(self, view: GoalView) -> list[Functional]:
        """Return the displacement component at each point, one functional a point."""
        mesh = view.mesh
        points = np.array(self.points)
        k = _axis("component", self.component, view.mesh.dim)
        if points.shape[1] != mesh.dim:
            raise ValueError(f"points have {points.shape[1]} coordinates in a {mesh.dim}D problem")
        if self.body is not None and self.body not in mesh.bodies:
            raise ValueError(
                f"body {self.body!r} does not exist{checks.suggestion(self.body, mesh.bodies)}; the "
                f"bodies are {', '.join(mesh.bodies)}"
            )
        number = None if self.body is None else mesh.bodies.index(self.body)
        place = PointLocator(mesh, number).locate(points)
        result = []
        for point, element, weights, distance in zip(
            self.points, place.element, place.weights, place.distance, strict=True
        ):
            # on the halved mesh curved boundaries have other chords, outside which the point may lie
            if view.coarse is None and distance > checks.SIX_DIGITS * mesh.element_sizes[element]:
                raise ValueError(f"points: {point} lies {distance:.3g} m outside the mesh")
            nodal = np.zeros(mesh.points.shape)
            nodal[mesh.elements[element], k] = weights
            value = float(np.sum(nodal * view.displacement))
            name = f"u_{'xyz'[k]} at {_place(cast('Sequence[float]', point))}"
            result.append(Functional(name=name, value=value, unit="m", vector=view.load_of(nodal)))
        return result


def _place(point: Sequence[float]) -> str:
    """Return a point as text."""
    return f"({', '.join(f'{c:g}' for c in point)})"


@dataclass(frozen=True)
class MeanDisplacement(checks.Checked):
    """The mean of a component of the displacement over a boundary (axisymmetric: weighted with the
    radius).

    Parameters
    ----------
    boundary : str
    component : 0, 1, 2 or "x", "y", "z"

    Examples
    --------
    >>> am.Goal(am.MeanDisplacement("top", "y")).quantity.boundary
    'top'
    """

    boundary: checks.Name
    component: Component

    def functionals(self, view: GoalView) -> list[Functional]:
        """Return the mean displacement over the boundary, as one functional."""
        mesh = view.mesh
        k = _axis("component", self.component, view.mesh.dim)
        surface = mesh.surface(self.boundary)
        nodal = np.zeros(mesh.points.shape)
        shares = surface.shape_integrals(view.problem.axisymmetric)
        np.add.at(nodal[:, k], surface.facets, shares / shares.sum())
        value = float(np.sum(nodal * view.displacement))
        return [
            Functional(f"mean u_{'xyz'[k]} on {self.boundary!r}", value, "m", view.load_of(nodal))
        ]


def _contact_mask(contact: ContactNodes, name: str) -> tuple[np.ndarray, float]:
    """Return the mask (n_contact,) of the contact nodes of the boundary or pair ``name``, and a sign:
    -1 where it is the master of a pair, else 1."""
    if name == "contact":
        return np.ones(len(contact), dtype=bool), 1.0
    pairs = [
        f"{slave} on {master}" if master else slave
        for slave, master in zip(contact.names, contact.masters, strict=True)
    ]
    for names, sign in ((contact.names, 1.0), (pairs, 1.0), (contact.masters, -1.0)):
        numbers = [k for k, boundary in enumerate(names) if boundary == name]
        if numbers:
            return np.isin(contact.boundary, numbers), sign
    candidates = ("contact", *contact.names, *filter(None, contact.masters))
    raise ValueError(
        f"there is no contact on boundary {name!r}{checks.suggestion(name, candidates)}; contact is on "
        f"{', '.join(map(repr, pairs))}"
    )


@dataclass(frozen=True)
class ContactForce:
    """Force through a contact boundary, a sum over nodes.

    Next to a support that holds a tangent of the boundary the tangential part misses what acts on
    half an edge: where friction acts there, an error of first order in the size of that edge, which
    no estimate contains.

    Parameters
    ----------
    boundary : str
        A contact boundary, the slave, the master or the name ("slave on master") of a pair, or
        "contact" for all.
    direction : str or int
        "normal": the sum of the compressive nodal forces; "tangential" (2D): that of the tangential
        forces on the slave, along the normal turned by +90 degrees; 0, 1, 2 or "x", "y", "z": the
        component of the force on the body of this boundary.

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
            _axis("direction", self.direction, others="'normal', 'tangential', ")

    def functionals(self, view: GoalView) -> list[Functional]:
        """Return the force on the boundary, as one functional."""
        source = view if view.coarse is None else view.coarse
        direction = self._direction(source)
        value = float(direction @ source.contact.residual)
        if view is not source:
            direction = view.interpolated(direction)
        name = f"{self.direction if isinstance(self.direction, str) else 'xyz'[self.direction]} force on "
        return [
            Functional(name + repr(self.boundary), value, "N", view.discrete.matrix @ direction)
        ]

    def _direction(self, view: GoalView) -> np.ndarray:
        """Return the vector d (n_dofs,) with which the quantity is d . (A u - b)."""
        contact = view.contact
        dim = view.mesh.dim
        on_boundary, sign = _contact_mask(view.touching, self.boundary)
        local = np.zeros((len(on_boundary), dim))
        # the contact force F of a node acts on it, and its shares V on the nodes that it takes over: together
        # (1 + sum(V)) F = F measures / weights
        share = on_boundary * view.touching.measures / view.touching.weights
        if self.direction not in ("normal", "tangential"):
            k = _axis("direction", self.direction, dim)
            # column k of a frame has the local components of the unit vector along axis k
            local = sign * share[:, None] * contact.frames[:, :, k]
        elif self.direction == "normal":
            # against the outward normal: compressive forces count positive, on master and slave alike
            local[:, 0] = -share
        elif dim == 3:
            raise ValueError(
                "direction 'tangential' has no meaning in 3D: give a component, 0, 1 or 2"
            )
        else:
            local[:, 1] = share  # on the slave, whichever side is named
        vector = np.zeros((view.discrete.n_nodes, dim))
        vector[contact.nodes] = from_frames(contact.frames, local)
        # where a support holds, the force of contact cannot be separated from its reaction
        return view.discrete.free_part(vector)


@dataclass(frozen=True)
class PeakPressure(checks.Checked):
    r"""The largest contact pressure, smoothed: a quantity needs a derivative.

    With the nodal pressures p_i, their weights w_i and a power q it is
    :math:`\sum_i w_i p_i^{q+1} / \sum_i w_i p_i^q`, at most the largest pressure. For
    Hertz' pressures and q = 8 it is 4.9 % below the largest one between cylinders, 9.1 % between
    spheres. Where pressures are singular (corners) there is no largest one.

    Parameters
    ----------
    boundary : str
        A contact boundary, the slave or name ("slave on master") of a pair, or "contact" for all.
    power : int
        q, from 1: the larger, the nearer to the largest pressure, and the less smooth.

    Examples
    --------
    >>> am.Goal(am.PeakPressure("contact")).quantity.power
    8
    """

    boundary: checks.Name = "contact"
    power: checks.Count = 8

    def functionals(self, view: GoalView) -> list[Functional]:
        """Return the smoothed peak of the pressure on the boundary, as one functional."""
        source = view if view.coarse is None else view.coarse
        contact = source.contact
        weights = _slave_weights(source, self.boundary)
        forces = np.maximum(-_at_nodes(source, contact.residual)[:, 0], 0.0)
        pressures = forces / source.touching.weights
        largest = pressures.max(initial=0.0) or 1.0  # nothing touches: the value is 0
        # J = sum w p^(q+1) / sum w p^q; with p and J over the largest pressure powers do not overflow
        shares = pressures / largest
        total = float(weights @ shares**self.power) or 1.0
        mean = float(weights @ shares ** (self.power + 1)) / total
        # dJ/dp_i = w_i ((q+1) p_i^q - q J p_i^(q-1)) / sum w p^q, which does not change with that scale;
        # p_i = -F_n/w_i with the normal force F_n of the body
        change = (self.power + 1) * shares**self.power
        change -= self.power * mean * shares ** (self.power - 1)
        local = np.zeros((len(weights), view.mesh.dim))
        local[:, 0] = np.where(weights > 0, -change / total, 0.0)
        direction = _direction(view, source, local)
        name = f"smoothed peak pressure on {self.boundary!r}"
        return [
            Functional(
                name=name,
                value=float(largest * mean),
                unit="Pa",
                vector=view.discrete.matrix @ direction,
            )
        ]


@dataclass(frozen=True)
class Dissipation(checks.Checked):
    """The energy that friction dissipates on a contact boundary in the (last) step of loading:
    minus the tangential forces on the body times the slips.

    Parameters
    ----------
    boundary : str
        A contact boundary, the slave or name ("slave on master") of a pair, or "contact" for all.

    Examples
    --------
    >>> am.Goal(am.Dissipation("contact")).quantity.boundary
    'contact'
    """

    boundary: checks.Name = "contact"

    def functionals(self, view: GoalView) -> list[Functional]:
        """Return the energy that friction dissipates on the boundary, as one functional."""
        source = view if view.coarse is None else view.coarse
        contact = source.contact
        on_boundary = _slave_weights(source, self.boundary) > 0
        frictions = np.where(on_boundary[:, None], _at_nodes(source, contact.residual)[:, 1:], 0.0)
        frictions[contact.held] = 0.0
        # D = -sum f_i . s_i of frictions f = (A u - b)_t and slips s = u_t - u_t^0: D'(v) = -sum (s_i .
        # (A v)_i + f_i . v_i)
        value = float(-np.sum(frictions * contact.slip))
        minus_slips = np.zeros((len(on_boundary), view.mesh.dim))
        minus_slips[on_boundary, 1:] = -contact.slip[on_boundary]
        by_frictions = view.discrete.matrix @ _direction(view, source, minus_slips)
        # to the halved mesh forces are carried as tractions, forces over weights
        minus_tractions = np.zeros_like(minus_slips)
        minus_tractions[:, 1:] = -frictions / source.touching.weights[:, None]
        carried = _direction(view, source, minus_tractions).reshape(-1, view.mesh.dim)
        nodes = view.touching.nodes
        by_slips = np.zeros_like(carried)
        by_slips[nodes] = view.touching.weights[:, None] * carried[nodes]
        plane = view.mesh.dim == 2 and not view.problem.axisymmetric
        name = f"dissipated energy on {self.boundary!r}"
        return [
            Functional(name, value, "J/m" if plane else "J", by_frictions + by_slips.reshape(-1))
        ]


def _slave_weights(view: GoalView, boundary: str) -> np.ndarray:
    """Return the weights w (n_contact,) of the contact nodes of a boundary, m or m^2: the measure of the
    surface that belongs to each node, in pairs that of the slave alone, and 0 at other contact nodes;
    ValueError for the master of a pair."""
    on_boundary, sign = _contact_mask(view.touching, boundary)
    if sign < 0:
        raise ValueError(f"boundary {boundary!r} is the master of a pair: give the slave")
    return np.where(on_boundary, view.touching.weights, 0.0)


def _at_nodes(view: GoalView, vector: np.ndarray) -> np.ndarray:
    """Return local components (n, dim) of a vector (n_dofs,) at the contact nodes."""
    contact = view.contact
    return contact.local(vector).reshape(-1, view.mesh.dim)[contact.nodes]


def _direction(view: GoalView, source: GoalView, local: np.ndarray) -> np.ndarray:
    """Return local components (n, dim) at the contact nodes of ``source`` as a Cartesian vector
    (n_dofs,) of ``view``; 0 where supports hold."""
    contact = source.contact
    vector = np.zeros((source.discrete.n_nodes, view.mesh.dim))
    vector[contact.nodes] = from_frames(contact.frames, local)
    direction = source.discrete.free_part(vector)
    return direction if view is source else view.interpolated(direction)


@dataclass(frozen=True)
class Opening:
    """The gap at a point of a contact boundary, or its mean over the boundary.

    On curved boundaries of the domain, and in front of a curved obstacle, the signed estimate
    contains what the chords of the mesh change; on those of STEP files, combined solids and meshes
    without a domain it does not. Of a pair only that part of the slave counts that faces the
    master: where the slave bends away, the end of this part follows the mesh; name a boundary that
    ends before.

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
            point = checks.vector("point", self.point)
            if len(point) not in (2, 3):
                raise ValueError(f"point must have 2 or 3 coordinates, got {len(point)}")
            object.__setattr__(self, "point", tuple(float(c) for c in point))

    def functionals(self, view: GoalView) -> list[Functional]:
        """Return the opening at the point, or its mean over the boundary, as one functional.

        The opening is a sum of c_j G_j over the contact nodes j. The gap of a node that takes over
        shares V_ji of nodes i without a condition is G_j = g_j + sum_i V_ji g_i. With the weight w_j
        of the node by itself, w_j G_j is the integral of the gap over the parts of all these nodes,
        whose measure is m_j = w_j (1 + sum_i V_ji), ``measures``. The mean over the boundary is the
        sum of these integrals over that of the measures, c_j = w_j / sum_k m_k. At a point x the mean
        gap of each node, w_j G_j / m_j, is interpolated: c_j = phi_j(x) w_j / m_j.

        The value has the G_j of the solution, which ``contact.gap`` holds. In relative coordinates they are
        G_j = G_0j - n_j . u_j, so that the derivative is -c_j n_j at node j."""
        contact = view.contact
        nodes = view.touching
        mesh = view.mesh
        weights = _slave_weights(view, self.boundary)  # w_j, and 0 on other boundaries
        on_boundary = weights > 0
        if self.point is None:
            name = f"mean opening of {self.boundary!r}"
            coefficients = weights / np.sum(nodes.measures[on_boundary])
        else:
            facets = np.concatenate(
                [
                    mesh.boundary_facets(nodes.names[k])
                    for k in np.unique(nodes.boundary[on_boundary])
                ]
            )
            name = f"opening of {self.boundary!r} at {_place(self.point)}"
            coefficients = self._shape_values(view, facets) * nodes.weights / nodes.measures
        vector = np.zeros((view.discrete.n_nodes, mesh.dim))
        vector[contact.nodes] = -coefficients[:, None] * contact.frames[:, 0]  # normals
        return [Functional(name, float(coefficients @ contact.gap), "m", vector.reshape(-1))]

    def _shape_values(self, view: GoalView, facets: np.ndarray) -> np.ndarray:
        """Return the shape functions (n_contact,) of the contact nodes at the point, on the nearest of the
        ``facets`` (n, dim). ValueError if the point is off them, or near a node without a condition; on
        the mesh of the result only: on the halved one curved boundaries have other chords, and new
        nodes at the end of a boundary may have no condition."""
        mesh = view.mesh
        point = np.array(self.point)
        if len(point) != mesh.dim:
            raise ValueError(f"point has {len(point)} coordinates in a {mesh.dim}D problem")
        (number,), (shape,), _ = BoxTree(mesh.points, facets).nearest(point[None])
        facet = facets[number]
        distance = np.linalg.norm(shape @ mesh.points[facet] - point)
        extent = np.ptp(mesh.points[facet], axis=0).max()
        if view.coarse is None and distance > checks.SIX_DIGITS * extent:
            raise ValueError(
                f"point {self.point} lies {distance:.3g} m off the boundary {self.boundary!r}"
            )
        nodal = np.zeros(mesh.n_nodes)
        nodes = view.touching.nodes
        nodal[facet] = shape
        # smaller shares are rounding: the point is at another node of the facet
        without_contact = facet[(shape > checks.ALIKE) & ~np.isin(facet, nodes)]
        if view.coarse is None and len(without_contact):
            raise ValueError(
                f"point {self.point}: its neighbour, node {without_contact[0]}, carries no contact condition"
            )
        return nodal[nodes]
