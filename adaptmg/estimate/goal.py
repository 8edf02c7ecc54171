r"""Goal: the error of single quantities of a contact solution, by dual-weighted residuals.

With the dual field z of a quantity J (:mod:`adaptmg.estimate.adjoint`) and edge bubbles b_E,

.. math:: J(u) - J(u_h) \approx \sum_E \rho^*_E(d_E), \qquad \eta_E = |\rho^*_E(d^0_E)|

(:mod:`adaptmg.estimate.edge_bubbles`). The signed sum is quoted; its parts by absolute value say where to
refine, and overestimate the error several times (10 times on meshes by Netgen, where errors cancel).

R. Becker, R. Rannacher, Acta Numerica 10, 2001, doi:10.1017/S0962492901000010; with contact and friction linearised at
the solution as in the semismooth Newton method. The sum does not contain that the contact zones end elsewhere than in
the discrete solution; both fields are singular at the ends of the zones, so that the marks refine there all the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._blas import one_blas_thread
from adaptmg._text import shortened
from adaptmg.discrete.coordinates import from_frames
from adaptmg.estimate.adjoint import AdjointSolution, LinearisedContact, adjoint_system, linearised_contact
from adaptmg.estimate.edge_bubbles import BubbleError, EdgeBubbles, bubble_error, bubble_spaces, edge_bubbles
from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.stress_fields import Posed, posed
from adaptmg.hierarchy import Hierarchy
from adaptmg.problem import ContactProblem
from adaptmg.smoother.system import ContactState as State
from adaptmg.solver.result import Result


@dataclass(frozen=True, eq=False)
class GoalView:
    """A solution as quantities see it."""

    posed: Posed  # problem, mesh, discrete problem and result
    bubbles: EdgeBubbles
    contact: LinearisedContact

    def load_of(self, nodal: np.ndarray) -> np.ndarray:
        """Return a functional of the displacement (n_nodes, dim) as one (n_dofs,) of the relative coordinates."""
        return self.posed.discrete.relative_forces(np.asarray(nodal, dtype=np.float64).reshape(-1))


@dataclass(frozen=True, eq=False)
class Functional:
    """A quantity of a solution, and how it changes with it."""

    name: str  # for tables
    value: float  # of the discrete solution, in unit
    unit: str
    vector: np.ndarray  # (n_dofs,): its derivative by the relative coordinates, Cartesian
    bubbles: np.ndarray  # (n_edges, dim): its derivative by the bubbles of the edges
    geometry: np.ndarray | None = None  # (n_edges,): what the chords of curves change in it


class Quantity(Protocol):
    """What a goal may ask for; a user-defined quantity is any object with this method."""

    def functionals(self, view: GoalView) -> list[Functional]:
        """Return the quantity, or several, of a solution."""


def checked_functionals(view: GoalView, quantity: Quantity) -> list[Functional]:
    """Return what a quantity asks for; TypeError or ValueError, which name it, unless these are functionals of this
    view."""
    made, name = quantity.functionals(view), f"quantity {checks.shown(quantity)}: "
    if not isinstance(made, (list, tuple)) or not all(isinstance(one, Functional) for one in made):
        raise TypeError(f"{name}functionals(view) must return a list of Functional, got {checks.described(made)}")
    if not made:
        raise ValueError(f"{name}functionals(view) must return at least one Functional, got none")
    n_edges = len(view.bubbles.edges)
    for one in made:
        checks.instance(f"{name}name", one.name, str, "text")
        checks.number(f"{name}value", one.value)
        check_arrays.array(f"{name}vector", one.vector, (view.posed.discrete.n_dofs,))
        check_arrays.array(f"{name}bubbles", one.bubbles, (n_edges, view.posed.mesh.dim))
        if one.geometry is not None:
            check_arrays.array(f"{name}geometry", one.geometry, (n_edges,))
    return list(made)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GoalEstimate(Estimate):
    """An estimate of the error of quantities of interest.

    Arrays (n,) and tuples have an entry for each quantity.

    Examples
    --------
    >>> goal = am.Goal(am.Opening("contact"))
    >>> problem = am.cases.greco_bar()
    >>> step = next(am.adapt(problem, am.mesh.structured(problem.domain, 2), indicator=goal, max_nodes=30))
    >>> len(step.estimate.values)
    1
    """

    value: float
    signed: float
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray  # of the discrete solution
    errors: np.ndarray  # estimated exact minus discrete values
    algebraic: np.ndarray  # the part of errors that the solver has left
    discretisation: float  # estimated relative energy error of the discrete solution
    residuals: np.ndarray  # relative residuals of the adjoint problems
    iterations: int = 0  # of GMRES, in all; 0 of direct solutions
    converged: bool = True  # whether all adjoint problems were solved to the tolerance

    @property
    def corrected(self) -> np.ndarray:
        """Values plus estimated errors (n,)."""
        return self.values + self.errors

    def __repr__(self) -> str:
        return shortened(str(self))

    def __str__(self) -> str:
        lines = [f"Estimate by {self.indicator}: {len(self.squares)} elements, estimated relative energy error "
                 f"{self.discretisation:.3%}"]
        width = max(map(len, self.names))
        lines += [f"  {name:<{width}s} {value:14.7g} {unit:<3s} estimated error {error:+.3g} (exact minus discrete)"
                  + (f", {error / abs(value):+.3%}" if value else "")
                  for name, unit, value, error in zip(self.names, self.units, self.values, self.errors, strict=True)]
        if not self.converged:
            lines.append(f"  the adjoint problems were not solved: residual {self.residuals.max():.1e}")
        return "\n".join(lines)


#: dofs up to which the adjoint problems are solved directly
DIRECT = 3000


@dataclass(frozen=True)
class Goal:
    """The error of a quantity, or of several.

    Parameters
    ----------
    quantity : Displacement, MeanDisplacement, ContactForce, Opening, or a sequence of these
        Of several (also several points of one Displacement) everything is relative to their values: the squares are
        sums of relative parts, ``value`` is 1 and ``signed`` the relative error of that with the largest.

    Notes
    -----
    A quantity that the contact state holds (an opening while all nodes touch, the motion of a node that sticks) has no
    dual field; then elements are marked by the energy of the error, until a finer mesh has another state.

    The signed estimate contains the algebraic error, as far as it leaves the contact state unchanged.

    Examples
    --------
    >>> goal = am.Goal(am.ContactForce("contact", "normal"))
    >>> problem = am.cases.greco_bar()
    >>> step = next(am.adapt(problem, am.mesh.structured(problem.domain, 2), indicator=goal, max_nodes=30))
    >>> step.estimate.value > 0                                       # N/m
    True
    """

    quantity: Quantity | Sequence[Quantity]

    def __post_init__(self) -> None:
        for item in self.quantities:
            checks.offers("quantity", item, "functionals", "Displacement(...), MeanDisplacement(...), "
                          "ContactForce(...), Opening(...), or several of these")
        if not self.quantities:
            raise ValueError("quantity is empty: give at least one")
        if isinstance(self.quantity, list):
            object.__setattr__(self, "quantity", tuple(self.quantity))

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All of them."""
        return tuple(self.quantity) if isinstance(self.quantity, (list, tuple)) else (self.quantity,)

    @one_blas_thread()
    def indicate(self, hierarchy: Hierarchy, result: Result) -> GoalEstimate:
        """Estimate the error on the finest mesh of a hierarchy, of a result of :func:`adaptmg.solve` on it.

        The terms of the estimate are the sums of squares of each quantity by name. TypeError and ValueError as of
        :meth:`adaptmg.Residual.indicate`, where a point, boundary or pair of a quantity does not exist, where elements
        are smoothed (estimates were -1 to 3 times the error), and where of several quantities one is zero;
        numpy.linalg.LinAlgError if the adjoint matrix is singular.
        """
        this = posed(hierarchy, result)
        need_linear(this.problem)
        view = GoalView(this, edge_bubbles(this.mesh, this.problem), linearised_contact(this.discrete, result))
        functionals = [one for item in self.quantities for one in checked_functionals(view, item)]
        names = tuple(one.name for one in functionals)
        if len(set(names)) < len(names):
            raise ValueError(f"quantity: one is given twice, {', '.join(names)}")
        sizes = _sizes(functionals)
        system, vectors = adjoint_system(view.contact), [one.vector for one in functionals]
        direct = len(hierarchy) == 1 or this.discrete.n_dofs <= DIRECT
        duals = system.direct(vectors) if direct else system.multigrid(hierarchy, vectors)
        error, parts, signed = _bubbles(view, functionals, duals)
        energy = error.energy / this.norm if this.norm > 0 else 0.0
        algebraic = np.array([_algebraic(view, *pair) for pair in zip(functionals, duals, strict=True)])
        errors = signed + algebraic
        worst = int(np.argmax(np.abs(errors / sizes)))
        squares = [view.bubbles.on_elements(part / size) for part, size in zip(parts, sizes, strict=True)]
        values = np.array([one.value for one in functionals])
        return GoalEstimate(
            squares=sum(squares), norm=this.norm, terms={name: part.sum() for name, part in zip(names, squares,
                                                                                             strict=True)},
            indicator=f"dual-weighted residuals for {names[0]}" + (f" and {len(names) - 1} more" if len(names) > 1
                                                                   else ""),
            value=1.0 if len(functionals) > 1 else float(values[0]), signed=float(errors[worst] / sizes[worst]),
            names=names, units=tuple(one.unit for one in functionals), values=values, errors=errors,
            algebraic=algebraic, discretisation=energy, residuals=np.array([dual.residual for dual in duals]),
            iterations=sum(dual.iterations for dual in duals), converged=all(dual.converged for dual in duals))


def need_linear(problem: ContactProblem) -> None:
    """Raise ValueError unless the elements of the problem are linear."""
    if problem.elements != "linear":
        raise ValueError("am.Goal estimates errors of linear elements, not of smoothed ones: take am.Recovery() or "
                         "am.Residual() as indicator")


def _sizes(functionals: list[Functional]) -> np.ndarray:
    """What each quantity is related to: 1 of a single one, else the size of its value."""
    if len(functionals) == 1:
        return np.ones(1)
    sizes = np.array([abs(functional.value) for functional in functionals])
    if not sizes.min() > 0:
        raise ValueError(f"quantity: {functionals[int(np.argmin(sizes))].name} is zero, and several quantities are "
                         "taken relative to their values: estimate it alone")
    return sizes


def _bubbles(view: GoalView, functionals: list[Functional], duals: list[AdjointSolution]
             ) -> tuple[BubbleError, np.ndarray, np.ndarray]:
    """The error in the bubbles, the parts that mark (n_goals, n_edges), and the signed errors (n_goals,)."""
    this, bubbles = view.posed, view.bubbles
    blocks, actions = bubbles.actions(np.array([this.result.displacement,
                                                *(this.discrete.physical(dual.field) for dual in duals)]))
    reactions = [view.contact.residual, *(_reaction(view, *pair) for pair in zip(functionals, duals, strict=True))]
    loads = [bubbles.load() + _friction_work(view), *(one.bubbles for one in functionals)]
    residual, *weighted = [load - action + _master_work(view, reaction)
                           for load, action, reaction in zip(loads, actions, reactions, strict=True)]
    error = bubble_error(bubbles, bubble_spaces(bubbles, view.contact), blocks, residual)
    parts = np.abs(np.einsum("gnd,nd->gn", weighted, error.alone))
    # whether the contact state alone, and no support, leaves a quantity no way to change
    held = [not dual.field.any() and functional.vector[~this.discrete.fixed].any()
            for functional, dual in zip(functionals, duals, strict=True)]
    if any(held):
        # of what the state does not let change the dual field contains nothing, but a finer mesh may have another
        # state: the parts of the energy; in all a relative error of the displacement as large as that of the energy
        squares = np.abs(np.einsum("nd,nd->n", residual, error.alone))
        shares = squares / max(float(squares.sum()), np.finfo(float).tiny)
        energy = error.energy / this.norm if this.norm > 0 else 0.0
        moved = float(np.abs(view.contact.unknowns).max(initial=0.0))
        for k in np.flatnonzero(held):
            parts[k] = shares * energy * moved * float(np.abs(functionals[k].vector).sum())
    geometry = np.array([np.zeros(parts.shape[1]) if one.geometry is None else one.geometry for one in functionals])
    return error, parts + np.abs(geometry), np.einsum("gnd,nd->g", weighted, error.together) + geometry.sum(axis=1)


def _reaction(view: GoalView, functional: Functional, dual: AdjointSolution) -> np.ndarray:
    """The reaction A z - j (n_dofs,) of a dual field."""
    return view.posed.discrete.matrix @ dual.field - functional.vector


def _friction_work(view: GoalView) -> np.ndarray:
    """Work (n_edges, dim) of the friction that does not depend on pressure on the bubbles of contact surfaces, N.
    Contact conditions of slaves are part of the spaces, in which Coulomb's friction does no work; Tresca's does, the
    part s / (s + mu p) of the friction."""
    contact, solution, mesh = view.contact, view.posed.result.contact, view.posed.mesh
    result = np.zeros((len(view.bubbles.edges), mesh.dim))
    if not contact.fixed_limit.any():
        return result
    share = np.divide(contact.fixed_limit, contact.limit, out=np.zeros_like(contact.limit), where=contact.limit > 0)
    traction = np.zeros((mesh.n_nodes, mesh.dim))
    traction[solution.node] = share[:, None] * from_frames(solution.frames[:, 1:], solution.traction)
    for name in solution.names:
        surface = mesh.surface(name)
        result += view.bubbles.boundary_work(surface, traction[surface.facets])
    return result


def _master_work(view: GoalView, reaction: np.ndarray) -> np.ndarray:
    """Work (n_edges, dim) of contact forces, over lumped masses, on the bubbles of masters."""
    discrete, mesh = view.posed.discrete, view.posed.mesh
    result = np.zeros((len(view.bubbles.edges), mesh.dim))
    if discrete.coupling is None:
        return result
    # at fixed dofs they are reactions of supports
    forces = np.where(discrete.fixed, 0.0, discrete.physical_forces(reaction)).reshape(-1, mesh.dim)
    problem = view.posed.problem
    for name in dict.fromkeys([*filter(None, problem.masters), *(tie.master for tie in problem.ties)]):
        surface = mesh.surface(name)
        mass = surface.lumped(view.bubbles.axisymmetric)
        traction = np.divide(forces, mass[:, None], out=np.zeros_like(forces), where=mass[:, None] > 0)
        result += view.bubbles.boundary_work(surface, traction[surface.facets])
    return result


def _algebraic(view: GoalView, functional: Functional, dual: AdjointSolution) -> float:
    r"""What the solver has left: J of the discrete solution minus J of the result, in the unit of the quantity.

    With the residual r = A u - b, the slip force s f of Tresca's law, and what is left of prescribed values,
    :math:`\delta` (a gap where bodies touch, a slip where they stick),

    .. math:: -z \cdot r + \sum_{\mathrm{slip}} s\, f \cdot z_t - \lambda^* \cdot \delta, \qquad \lambda^* = A z - j .
    """
    contact, discrete = view.contact, view.posed.discrete
    dim, nodes = discrete.dim, contact.nodes
    z = contact.local(dual.field).reshape(-1, dim)[nodes]
    reaction = contact.local(_reaction(view, functional, dual)).reshape(-1, dim)[nodes]
    part = -float(dual.field @ np.where(discrete.fixed, 0.0, contact.residual))
    part += float(np.sum(np.where(contact.slips, contact.fixed_limit, 0.0) * np.sum(contact.unit * z[:, 1:], axis=1)))
    touches, sticks = contact.state != State.OPEN, contact.sticks[:, None] & ~contact.held
    part -= float(np.sum(np.where(touches & np.isfinite(contact.gap), reaction[:, 0] * contact.gap, 0.0)))
    return part + float(np.sum(np.where(sticks, reaction[:, 1:] * contact.slip, 0.0)))
