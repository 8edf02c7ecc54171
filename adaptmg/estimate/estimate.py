r"""Estimate: what an indicator finds for a discrete solution, element by element and in all, and
which are marked.

With :math:`\eta_E^2` the square of element E (an energy, N m; in 2D per metre of thickness),

.. math:: \eta = \Bigl(\sum_E \eta_E^2\Bigr)^{1/2}, \qquad \eta / \|u_h\|_A .

Goals (:class:`adaptmg.Goal`) quote a signed estimate of the error of one quantity; their squares
only say where to refine. Doerfler marks a smallest set M (W. Doerfler, SIAM J. Numer. Anal. 33,
1996, doi:10.1137/0733054),

.. math:: \sum_{E \in M} \eta_E^2 \ge \theta \sum_E \eta_E^2 ,

Maximum all elements with :math:`\eta_E^2 \ge \theta \max \eta^2`; theta refers to squares in both.

Residual measures what the discrete solution leaves of the equations:

.. math:: \eta_T^2 = \frac1E \Big\{ h_T^2 \|f + \mathrm{div}\,\sigma_h\|^2 + \frac12 \sum_{\mathrm{interior}} h_F
   \|[\sigma_h n]\|^2 + \sum_{\mathrm{boundary}} h_F \|g + t_h - \sigma_h n\|^2 \Big\}
   + \int p_h (g_0 - u_n) + \int (\mu p_h |d_t| + t_h \cdot d_t)

:math:`L^2` norms over element or facet, E Young's modulus of the element, so that all terms are energies; :math:`h_T`
the longest edge, :math:`h_F = |F|`, in space :math:`\sqrt{2|F|}`; :math:`t_h` the contact traction
on slave and master, nodal forces over lumped masses; springs add :math:`-k_n u_n n - k_t u_t` to g.
In axisymmetry integrals are weighted with :math:`2 \pi r`. The last two terms, on slaves alone,
have linear interpolants of nodal pressures, gaps, limits and slips: they vanish where the
conditions hold all along an edge.

Measured, the estimate is 2 to 5 times the error, by problem and pattern of the mesh (the GRECO bar:
2.7 with alternating diagonals and on bisected meshes, 3.0 to 3.2 on Netgen meshes, 3.3 to 3.7 with
all diagonals alike), and nearly constant on the meshes of one family; it is not proven to bound the
error. Where body forces, or the hoop stress of smooth axisymmetric fields, rule the error it is 5.7
to 8.8 times the error; where a contact zone between curved bodies has one or two nodes up to 30
times, nearly all of it complementarity, until meshes resolve the zone. Of smoothed elements, on the
meshes of four adaptive loops, it is 2 to 2.7 times the error of their stress. Scalar problems:
:mod:`adaptmg.estimate.scalar_residual`.

The recovered estimate (Zienkiewicz and Zhu) is that of a smoother stress,

.. math:: \eta_E^2 = \int_E (\sigma^* - \sigma_h) : C^{-1} (\sigma^* - \sigma_h)

with a stress :math:`\sigma^*` that is continuous and piecewise linear in each body: it may jump
where materials meet and between bodies in contact (:mod:`adaptmg.discrete.stress`). Where the
solution is smooth the estimate tends to the error itself; it does not depend on loads and contact
conditions. Of smoothed elements, the error is that of the stress of :meth:`adaptmg.Result.stress`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Annotated, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._text import shortened
from adaptmg._threads import one_blas_thread
from adaptmg.discrete.coordinates import from_frames
from adaptmg.discrete.loads import body_elements, foundation, load_density
from adaptmg.discrete.scalar import ScalarProblem
from adaptmg.discrete.stress import displacement_gradient, recovered
from adaptmg.estimate.scalar_residual import scalar_squares
from adaptmg.estimate.stress_fields import ElementStress, Solved, contact_tractions, solved
from adaptmg.geometry.quadrature import integration
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays, Surface, need_mesh
from adaptmg.problem.loads import BodyForce, Load, Pressure, Spring, Traction
from adaptmg.smoother.system import ContactState as State
from adaptmg.solver.result import Result


def _terms(name: str, value: object) -> dict[str, float]:
    """Return the parts of the sum of squares by name, checked."""
    words = "a mapping of names to parts of the sum of squares"
    return {
        checks.instance(f"the keys of {name}", key, str, "text"): checks.number(
            f"{name}[{key!r}]", part
        )
        for key, part in checks.instance(name, value, Mapping, words).items()
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate(checks.Checked):
    """An error estimate on the finest mesh of a hierarchy.

    Parameters
    ----------
    squares : (n_elements,) array
        Square of each element's part, >= 0; N m. Of a goal: the absolute value of its part, in the
        goal's unit; these mark, their sum is mostly larger than the error and is never quoted.
    norm : float
        Energy norm of the displacement ||u_h||_A, sqrt(N m): what ``relative`` refers to.
    indicator : str
        Name of the indicator, for messages.
    terms : mapping of str to float
        Parts of the sum of squares by name; they add up to it.
    value, signed : float, optional
        Of a goal: the quantity of the discrete solution, and the estimate of exact minus discrete
        value.

    Examples
    --------
    >>> estimate = am.Estimate(squares=[9.0, 16.0], norm=50.0)
    >>> estimate.total, estimate.relative
    (5.0, 0.1)
    """

    squares: Annotated[np.ndarray, _checked_squares]
    norm: checks.Nonnegative
    indicator: Annotated[str, partial(checks.instance, types=str, words="text")] = ""
    terms: Annotated[Mapping[str, float], _terms] = field(default_factory=dict)
    value: Annotated[float, checks.number] | None = None
    signed: Annotated[float, checks.number] | None = None

    if TYPE_CHECKING:

        def __init__(
            self,
            *,
            squares: ArrayLike,
            norm: float,
            indicator: str = "",
            terms: Mapping[str, float] = ...,
            value: float | None = None,
            signed: float | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.value is None) != (self.signed is None):
            raise ValueError("value and signed belong together: give both, or neither")

    @property
    def total(self) -> float:
        """Return the square root of the sum of squares, sqrt(N m); of a goal the absolute
        ``signed``, in its unit."""
        return float(np.sqrt(self.squares.sum())) if self.signed is None else abs(self.signed)

    @property
    def relative(self) -> float:
        """Return ``total`` over ||u_h||_A; of a goal over ``|value|``, infinite where that is 0 and
        a square is not."""
        size = self.norm if self.value is None else abs(self.value)
        if size > 0:
            return self.total / size
        infinite = self.total > 0 or (self.value is not None and bool(self.squares.any()))
        return np.inf if infinite else 0.0

    def __repr__(self) -> str:
        return shortened(str(self))

    def __str__(self) -> str:
        lines = [f"Estimate by {self.indicator or 'an indicator'}: {len(self.squares)} elements"]
        if self.signed is None:
            lines.append(
                f"  total {self.total:.4g} sqrt(N m), relative {self.relative:.3%} of "
                f"||u||_A = {self.norm:.4g} sqrt(N m)"
            )
        else:
            lines.append(
                f"  value {self.value:.8g}, estimated error {self.signed:+.3g} (exact minus discrete), "
                f"relative {self.relative:.3%}"
            )
        whole = sum(self.terms.values())
        lines += [
            f"  {name:<28s} {part:11.4g} {part / whole:7.1%}"
            for name, part in self.terms.items()
            if whole > 0
        ]
        return "\n".join(lines)


def _checked_squares(name: str, squares: object) -> np.ndarray:
    """Return squares (n_elements,) as an array; ValueError unless all are >= 0."""
    result = checks.array(name, squares, (None,))
    if not len(result) or result.min() < 0:
        raise ValueError(
            f"{name} must be numbers >= 0, one for each element, got {checks.shown(squares)}"
        )
    return result


if TYPE_CHECKING:
    from typing_extensions import TypeVar  # Python's has no default before 3.13

    #: what an indicator returns, and so the steps of a loop with it hold
    AnyEstimate = TypeVar("AnyEstimate", bound=Estimate, default=Estimate, covariant=True)
else:
    AnyEstimate = TypeVar("AnyEstimate", covariant=True)


class Indicator(Protocol[AnyEstimate]):
    """An estimator of the error: Residual, Recovery, Goal or a user-defined object."""

    def indicate(self, hierarchy: Hierarchy, result: Result) -> AnyEstimate:
        """Return the estimate for the elements of the finest mesh."""
        ...


def estimate_of(indicator: Indicator, hierarchy: Hierarchy, result: Result) -> Estimate:
    """Return the estimate of an indicator, of the elements of the finest mesh."""
    return estimate_for(
        need_mesh(hierarchy.finest),
        indicator.indicate(hierarchy, result),
        f"what the indicator {checks.shown(indicator)} returns",
    )


def estimate_for(mesh: MeshArrays, estimate: Estimate, name: str = "estimate") -> Estimate:
    """Return an estimate, checked to be one of the elements of a mesh."""
    checks.instance(name, estimate, Estimate, "an Estimate")
    if len(estimate.squares) != len(mesh.elements):
        raise ValueError(
            f"{name} is of {len(estimate.squares)} elements, but mesh has {len(mesh.elements)}"
        )
    return estimate


class Mark(Protocol):
    """A choice of the elements to refine: Doerfler, Maximum or a user-defined object."""

    def mark(self, estimate: Estimate) -> np.ndarray:
        """Return the mask (n_elements,) of the marked elements."""
        ...


def marks_of(mark: Mark, estimate: Estimate) -> np.ndarray:
    """Return the mask (n_elements,) that a marking chooses, checked."""
    mask = mark.mark(estimate)
    if (
        not isinstance(mask, np.ndarray)
        or mask.dtype.kind != "b"
        or mask.shape != estimate.squares.shape
    ):
        raise TypeError(
            f"mark: {checks.shown(mark)} must return a boolean mask over the {len(estimate.squares)} "
            f"elements, got {checks.described(mask)}"
        )
    return mask


def _share(name: str, value: object) -> float:
    """Return a share as a float; ValueError unless it is above 0 and at most 1."""
    result = checks.number(name, value)
    if not 0 < result <= 1:
        raise ValueError(
            f"{name} must be > 0 and <= 1, got {checks.shown(value)}; to refine uniformly, take "
            "am.Doerfler(1.0), which marks all elements that have an error"
        )
    return result


Share = Annotated[float, _share]


@dataclass(frozen=True)
class Doerfler(checks.Checked):
    """Bulk marking: the smallest set of elements that holds the share ``theta`` of the sum of
    squares.

    Parameters
    ----------
    theta : float
        Share of the sum of squares, above 0 and at most 1; larger shares take fewer steps. With 1
        all elements are marked whose square is above 0: uniform refinement.

    Examples
    --------
    >>> am.Doerfler(0.3).theta
    0.3
    """

    theta: Share = 0.8

    def mark(self, estimate: Estimate | np.ndarray) -> np.ndarray:
        """Return the mask (n_elements,) of the marked elements of an estimate or of its squares
        (n_elements,).

        Of elements with equal squares those with the lowest numbers come first; none are marked
        where all are 0."""
        squares = _squares(estimate)
        # 1 takes every element that has a part, also one that the sum loses by rounding
        if self.theta == 1 or not squares.any():
            return squares > 0
        order = np.argsort(-squares, kind="stable")
        reached = np.cumsum(squares[order])
        count = int(np.searchsorted(reached, self.theta * reached[-1])) + 1
        mask = np.zeros(len(squares), dtype=bool)
        mask[order[:count]] = True
        return mask


@dataclass(frozen=True)
class Maximum(checks.Checked):
    """The elements whose square is at least the share ``theta`` of the largest; larger marks less.

    Parameters
    ----------
    theta : float
        Share of the largest square, above 0 and at most 1.

    Examples
    --------
    >>> am.Maximum(0.5).theta
    0.5
    """

    theta: Share = 0.5

    def mark(self, estimate: Estimate | np.ndarray) -> np.ndarray:
        """Return the mask (n_elements,) of the marked elements of an estimate or of its squares
        (n_elements,)."""
        squares = _squares(estimate)
        return (squares >= self.theta * squares.max()) & (squares > 0)


def _squares(estimate: Estimate | np.ndarray) -> np.ndarray:
    """Return the squares (n_elements,) of an estimate, or checked squares."""
    return (
        estimate.squares
        if isinstance(estimate, Estimate)
        else _checked_squares("estimate", estimate)
    )


@dataclass(frozen=True)
class Residual:
    """The residual indicator; it has no parameters.

    Examples
    --------
    >>> problem = am.cases.greco_bar()
    >>> mesh = am.mesh.structured(problem.domain, 2)
    >>> step = next(am.adapt(problem, mesh, indicator=am.Residual(), max_nodes=30))
    >>> step.estimate.squares.shape == (len(step.hierarchy.finest.mesh.elements),)
    True
    """

    @one_blas_thread()
    def indicate(self, hierarchy: Hierarchy, result: Result) -> Estimate:
        """Estimate the error on the finest mesh of a hierarchy, of a result of
        :func:`adaptmg.solve` on it.

        The terms of the estimate are "element residual", "jumps inside", "traction on boundaries",
        "traction in contact", "complementarity" and "friction", those of scalar problems "element
        residual", "flux jumps", "complementarity" and "obstacle"; squares of energies, N m (plane: per
        metre of thickness); elements at a :class:`adaptmg.PointForce`, whose energy is infinite, are
        left out. TypeError or ValueError without problem, mesh or materials, for a
        result of another mesh, other loads, or not finite."""
        checks.instance("hierarchy", hierarchy, Hierarchy, "a Hierarchy")
        if isinstance(hierarchy.problem, ScalarProblem):
            parts, norm = scalar_squares(hierarchy.problem, hierarchy.finest, result)
        else:
            state = solved(hierarchy, result)
            volume = volume_squares(state.stress, state.problem.loads, state.young)
            free, touching = boundary_squares(state)
            complementarity, friction = condition_squares(state)
            parts = {
                "element residual": volume,
                "jumps inside": jump_squares(state),
                "traction on boundaries": free,
                "traction in contact": touching,
                "complementarity": complementarity,
                "friction": friction,
            }
            parts = {name: part * state.regular for name, part in parts.items() if part is not None}
            norm = state.norm
        return Estimate(
            squares=sum(parts.values()),
            norm=norm,
            indicator="residuals",
            terms={name: part.sum() for name, part in parts.items()},
        )


def boundary_squares(state: Solved) -> tuple[np.ndarray, np.ndarray]:
    """Return the squares (n_elements,), N m, of residual tractions on boundaries without contact, and
    those on boundaries with contact."""
    mesh = state.mesh
    stress = state.stress
    neighbours = state.neighbours
    touching = contact_tractions(mesh, state.result, stress.axisymmetric)
    plain, contact = np.zeros((2, len(mesh.elements)))
    supports = state.posed.directions
    for k, name in enumerate(mesh.boundaries):
        on_boundary = mesh.facet_labels == k
        outside = neighbours.outer[on_boundary]
        if not outside.any():
            continue  # a name without facets on the outside, which may have no surface
        surface = mesh.surface(name)
        elements = neighbours.owner[on_boundary]
        facets = surface.facets
        normals = surface.normals
        rule, at, weights = integration(mesh.points, facets, surface.measures, stress.axisymmetric)
        # g + t_h - sigma_h n (n_facets, n_points, dim), with g the loads and springs, -k_n u_n n - k_t u_t
        residual = -stress.tractions(elements, normals, facets, rule)
        for load in state.problem.loads:
            if isinstance(load, Pressure | Traction) and load.boundary == name:
                residual += load_density(load, at, normals)
        if name in touching:
            residual += np.einsum("qk,fkd->fqd", rule, touching[name].corners)
        for spring in state.problem.supports:
            if isinstance(spring, Spring) and spring.boundary == name:
                stiffness = foundation(spring, at, normals)
                residual -= np.einsum(
                    "fqij,qk,fkj->fqi", stiffness, rule, state.result.displacement[facets]
                )
        # a support bears any traction along the orthonormal directions (n_held, dim) that it holds
        held = supports.get(name, np.empty((0, mesh.dim)))
        residual -= residual @ held.T @ held
        # h_F / E |residual|^2
        squares = (
            surface.sizes
            / state.young[elements]
            * np.einsum("fqd,fqd,fq->f", residual, residual, weights)
        )
        total = contact if name in touching else plain
        # in place: in ``contact`` or ``plain``
        total += np.bincount(
            elements, weights=np.where(outside, squares, 0.0), minlength=len(total)
        )
    return plain, contact


def condition_squares(state: Solved) -> tuple[np.ndarray, np.ndarray]:
    """Return squares (n_elements,), N m, from complementarity and from friction.

    At the nodes the conditions are taken as met: no pressure where a node is OPEN, no gap elsewhere,
    friction at its limit against the slip where there is one. The remainder that a solver leaves is
    algebraic error, and its product with a gap or slip far larger than the deformation would exceed
    the error of the mesh."""
    mesh = state.mesh
    contact = state.result.contact
    complementarity, friction = np.zeros((2, len(mesh.elements)))
    opens = contact.state == State.OPEN
    pressures = contact.pressure  # 0 at open nodes
    gaps = np.where(opens, np.maximum(contact.gap, 0.0), 0.0)
    limits, tractions = _friction(state, opens)
    slips = from_frames(contact.frames[:, 1:], contact.slip)
    for k, name in enumerate(contact.names):
        surface = mesh.surface(name)
        rows = np.flatnonzero(contact.boundary == k)
        # a node without a condition of this boundary takes the zero that is appended
        index = np.full(mesh.n_nodes, len(rows))
        index[contact.node[rows]] = np.arange(len(rows))
        # at the corners of the facets: numbers (n_facets, dim), vectors (n_facets, dim, dim)
        pressure, gap, limit, traction, slip = (
            np.concatenate([values[rows], np.zeros((1, *values.shape[1:]))])[index[surface.facets]]
            for values in (pressures, gaps, limits, tractions, slips)
        )
        rule, _, weights = integration(
            mesh.points, surface.facets, surface.measures, state.stress.axisymmetric
        )
        # int p (g0 - u_n), and the limit times |d_t| + t . d_t, by the mass matrices of facets
        mass = np.einsum("fq,qi,qj->fij", weights, rule, rule)
        open_part = np.einsum("fij,fi,fj->f", mass, pressure, gap)
        slip_part = np.einsum("fij,fi,fj->f", mass, limit, np.linalg.norm(slip, axis=2))
        slip_part += np.einsum("fij,fid,fjd->f", mass, traction, slip)
        elements = state.neighbours.owner[mesh.facet_labels == mesh.boundaries.index(name)]
        complementarity += np.bincount(elements, weights=open_part, minlength=len(complementarity))
        # the limit times |d| plus t . d is >= 0, as |t| is at most the limit; rounding may make it negative
        friction += np.bincount(
            elements, weights=np.maximum(slip_part, 0.0), minlength=len(friction)
        )
    return complementarity, friction


def _friction(state: Solved, opens: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the limits g (n_contact,) of friction and Cartesian friction tractions t (n_contact, dim),
    Pa, which obey the law: t = -g s / |s| where a node moves by the slip s, elsewhere the friction of
    the result, but |t| <= g. ``opens`` (n_contact,) is the mask of open nodes."""
    contact = state.result.contact
    # of open nodes the part that does not depend on the pressure
    fixed, _ = state.discrete.law.bounds(len(contact))
    limit = np.where(opens, fixed, contact.limit)
    length = np.linalg.norm(contact.slip, axis=1)
    rounding = checks.ROUNDING * np.abs(state.result.displacement).max(initial=0.0)
    moves = (contact.state != State.STICK) & (length > rounding)
    direction = np.where(moves[:, None], -contact.slip, contact.force_t)
    size = np.linalg.norm(direction, axis=1)
    at_limit = np.divide(limit, size, out=np.zeros_like(size), where=size > 0)
    factor = np.where(moves, at_limit, np.minimum(at_limit, 1.0)) / contact.weights
    return limit / contact.weights, from_frames(contact.frames[:, 1:], factor[:, None] * direction)


def jump_squares(state: Solved) -> np.ndarray:
    """Return the squares h_F / (2 E) int_F |[sigma n]|^2 (n_elements,), N m, of jumps of the traction:
    those of a facet F for each of its elements, with its modulus E."""
    mesh = state.mesh
    stress = state.stress
    first, second = state.neighbours.pairs
    surface = Surface(mesh.points, state.neighbours.facets)
    if stress.axisymmetric:  # sigma n varies along the facet
        rule, _, weights = integration(
            mesh.points, surface.facets, surface.measures, axisymmetric=True
        )
        jump, opposite = (
            stress.tractions(elements, surface.normals, surface.facets, rule)
            for elements in (first, second)
        )
        jump -= opposite
        squares = np.einsum("fqd,fqd,fq->f", jump, jump, weights)
    else:
        # constant: |F| [sigma n]_i = sum_j [sigma_ij] (|F| n)_j, without arrays (n_facets, dim, dim)
        values = stress.values.T
        change = values.take(first, axis=1) - values.take(second, axis=1)
        jumps = [
            sum(change[column] * n for column, n in zip(row, surface.vectors.T, strict=True))
            for row in stress.columns
        ]
        squares = sum(jump * jump for jump in jumps) / surface.measures
    squares *= 0.5 * surface.sizes
    return (
        sum(np.bincount(elements, squares, len(mesh.elements)) for elements in (first, second))
        / state.young
    )


def volume_squares(
    stress: ElementStress, loads: Sequence[Load], young: np.ndarray
) -> np.ndarray | None:
    """Return the squares h_T^2 / E int_T |f + div sigma|^2 (n_elements,), N m, of residuals inside
    elements, with E of each (``young`` (n_elements,)); None where there is neither a body force nor
    axisymmetry, so that they vanish."""
    forces = [load for load in loads if isinstance(load, BodyForce)]
    if not forces and not stress.axisymmetric:
        return None
    mesh = stress.mesh
    rule, at, weights = integration(mesh.points, mesh.elements, mesh.volumes, stress.axisymmetric)
    residual = (
        _divergence(stress, rule) if stress.axisymmetric else np.zeros((*weights.shape, mesh.dim))
    )
    for load in forces:
        elements = slice(None) if load.body is None else body_elements(mesh, load.body)
        residual[elements] += load_density(load, at[elements], normals=None)
    return mesh.element_sizes**2 / young * np.einsum("eqd,eqd,eq->e", residual, residual, weights)


def _divergence(stress: ElementStress, rule: np.ndarray) -> np.ndarray:
    """Return the divergence (n_elements, n_points, 2), N/m^3, of an axisymmetric stress at the points of a
    ``rule`` (n_points, 3) of barycentric weights,

    (d_r sigma_rr + d_z sigma_rz + (sigma_rr - sigma_tt) / r, d_r sigma_rz + d_z sigma_zz + sigma_rz / r).

    Within an element only the hoop strain e = u_r / r varies: sigma(e) = sigma(e_c) + (e - e_c) c with
    the stress at the centroid, c that of a hoop strain of 1 and r d_r e = d_r u_r - e, r d_z e = d_z
    u_r."""
    mesh = stress.mesh
    slope = displacement_gradient(mesh, stress.displacement)[:, 0, :, None]
    variation = stress.hoop_variation(slice(None), mesh.elements, rule)  # e - e_c
    rr, _, tt, rz = stress.values.T[:, :, None]
    c_rr, c_zz, c_tt, c_rz = stress.of_hoop.T[:, :, None]
    r = mesh.points[mesh.elements, 0] @ rule.T
    # r d_r e and r d_z e
    along_r = slope[:, 0] - stress.hoop[:, None] - variation
    along_z = slope[:, 1]
    radial = c_rr * along_r + c_rz * along_z + rr - tt + (c_rr - c_tt) * variation
    axial = c_rz * (along_r + variation) + c_zz * along_z + rz
    return np.stack([radial / r, axial / r], axis=2)


@dataclass(frozen=True)
class Recovery:
    """The recovery indicator; it has no parameters.

    Examples
    --------
    >>> problem = am.cases.greco_bar()
    >>> mesh = am.mesh.structured(problem.domain, 2)
    >>> step = next(am.adapt(problem, mesh, indicator=am.Recovery(), max_nodes=30))
    >>> 0 < step.estimate.relative < 1
    True
    """

    @one_blas_thread()
    def indicate(self, hierarchy: Hierarchy, result: Result) -> Estimate:
        """Estimate the error on the finest mesh of a hierarchy, of a result of
        :func:`adaptmg.solve` on it.

        The terms of the estimate are the bodies by name; elements at a
        :class:`adaptmg.PointForce` are left out. Plastic bodies count as elastic under their whole
        strain, so that the error of the plastic strain counts too. TypeError and ValueError as of
        :meth:`adaptmg.Residual.indicate`.
        """
        state = solved(hierarchy, result, plastic=True)
        squares = state.regular * recovered_energy(
            state.stress, *recovered(state.mesh, state.stress.values)
        )
        by_body = np.bincount(
            state.mesh.element_body, weights=squares, minlength=len(state.mesh.bodies)
        )
        return Estimate(
            squares=squares,
            norm=state.norm,
            indicator="recovered stress",
            terms=dict(zip(state.mesh.bodies, by_body, strict=True)),
        )


def recovered_energy(stress: ElementStress, cells: np.ndarray, nodal: np.ndarray) -> np.ndarray:
    """Return the squares of energy norms (n_elements,), N m, of the difference of a recovered stress and
    that of the elements; the former is linear between values ``nodal`` at the corners ``cells``
    (n_elements, dim + 1), rows of ``nodal``."""
    mesh = stress.mesh
    rule, _, weights = integration(mesh.points, mesh.elements, mesh.volumes, stress.axisymmetric)
    difference = rule @ nodal[cells] - stress.values[:, None]
    if stress.axisymmetric:
        difference -= (
            stress.hoop_variation(slice(None), mesh.elements, rule)[:, :, None]
            * stress.of_hoop[:, None]
        )
    plane = mesh.dim == 2 and not stress.axisymmetric
    return np.einsum(
        "eq,eq->e", weights, stress.invertible_moduli.work(difference, difference, plane)
    )
