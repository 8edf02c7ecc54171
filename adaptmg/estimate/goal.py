r"""Goal: the error of single quantities of a contact solution, by dual-weighted residuals.

With the dual field z of a quantity J (:mod:`adaptmg.estimate.adjoint`) and edge bubbles b_E,

.. math:: J(u) - J(u_h) \approx \sum_E \rho^*_E(d_E), \qquad \eta_E = |\rho^*_E(d^0_E)|

(:mod:`adaptmg.estimate.edge_bubbles`). The signed sum is quoted; its parts by absolute value say where to
refine, and overestimate the error several times (10 times on meshes by Netgen, where errors cancel).

R. Becker, R. Rannacher, Acta Numerica 10, 2001, doi:10.1017/S0962492901000010; with contact and friction linearised at
the solution as in the semismooth Newton method. That the contact zones end elsewhere than in the discrete solution is
not seen by the sum; both fields being singular at the ends of the zones, the marks refine there all the same. Nodes
where the state changes can be given a part of their own (``transitions``,
:mod:`adaptmg.estimate.goal`).

Transitions: how much a quantity would change if the contact zones ended one node further or sooner.

What the dual-weighted residuals take as given is the state of every contact node. Releasing a touching node with the
force p, or closing an open one with the gap g, changes a quantity to first order by

.. math:: \frac{p_i\,|\lambda^*_{n,i}|}{a_{nn,i}}, \qquad g_i\,|z_{n,i}|\,a_{nn,i},

and likewise along the tangent at sticking nodes, with the force that is left before they slip, and slipping ones, with
their slip; :math:`\lambda^* = A z - j` is the reaction of the dual field, a the diagonal of the matrix. Only nodes
that have a neighbour in another state count. Both factors fall with the mesh size at the ends of the zones, the product
as other parts of the error do; it is an overestimate (10 to 500 times what the signed estimate missed of the GRECO bar,
50 in the median).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from adaptmg import _checks as checks
from adaptmg.estimate.adjoint import AdjointSolution, adjoint_system, algebraic_part
from adaptmg.estimate.contact_state import linearised_contact
from adaptmg.estimate.edge_bubbles import BubbleError, bubble_error, bubble_spaces, edge_bubbles
from adaptmg.estimate.goal_view import Functional, GoalEstimate, GoalView, checked_functionals
from adaptmg.estimate.quantities import friction_work, master_work
from adaptmg.estimate.stress_fields import posed
from adaptmg.hierarchy import Hierarchy
from adaptmg.smoother.system import ContactState as State
from adaptmg.smoother.system import contact_blocks, local_contact
from adaptmg.solver.examine import energy_norm
from adaptmg.solver.result import Result

__all__ = ["Goal", "Quantity", "transition_changes"]

#: of the sum of marks: a smaller signed error counts as chance
_CHANCE = 0.1


class Quantity(Protocol):
    """What a goal may ask for: one's own is any object with this method."""

    def functionals(self, view: GoalView) -> list[Functional]:
        """The quantity, or several, of a solution."""


@dataclass(frozen=True)
class Goal:
    """The error of a quantity, or of several at once.

    Parameters
    ----------
    quantity : Displacement, MeanDisplacement, ContactForce, Opening, or a sequence of these
        Of several (also several points of one Displacement) everything is relative to their values: the squares are
        sums of relative parts, ``value`` is 1 and ``signed`` the relative error of that with the largest.
    rtol : float
        Relative residual of the adjoint problems.
    max_iterations : int
        Of GMRES, for each.
    direct_below : int
        Up to so many dofs, and where there is one level only, the adjoint problems are solved directly.
    transitions : float
        Weight, >= 0, with which the change of the quantity counts among the squares if the contact zones ended one node
        further or sooner; a term "transitions". On the GRECO bar it gained nothing.

    Notes
    -----
    A quantity that the contact state holds (an opening while all nodes touch, the motion of a node that sticks) has no
    dual field; then elements are marked by the energy of the error, until a finer mesh has another state.

    The algebraic error counts in the signed estimate (:mod:`adaptmg.estimate.adjoint`), as far as it leaves the
    contact state as it is. It is of first order in the residual: ``energy_error`` of the estimate, by which solvers are
    stopped, is the energy error that has as large a part in the quantity as the discretisation has, and not the
    energy error of the discretisation.
    """

    quantity: Quantity | Sequence[Quantity]
    rtol: float = 1e-4
    max_iterations: int = 100
    direct_below: int = 3000
    transitions: float = 0.0

    def __post_init__(self) -> None:
        for item in self.quantities:
            checks.offers("quantity", item, "functionals", "Displacement(...), MeanDisplacement(...), "
                          "ContactForce(...), Opening(...), or several of these")
        if not self.quantities:
            raise ValueError("quantity is empty: give at least one")
        if isinstance(self.quantity, list):
            object.__setattr__(self, "quantity", tuple(self.quantity))
        object.__setattr__(self, "rtol", checks.tolerance("rtol", self.rtol))
        checks.integer("max_iterations", self.max_iterations, 1)
        checks.integer("direct_below", self.direct_below, 0)
        object.__setattr__(self, "transitions", checks.nonnegative("transitions", self.transitions))

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """All of them."""
        return tuple(self.quantity) if isinstance(self.quantity, (list, tuple)) else (self.quantity,)

    def indicate(self, hierarchy: Hierarchy, result: Result) -> GoalEstimate:
        """Estimate the error on the finest mesh.

        Parameters
        ----------
        hierarchy : Hierarchy
            Of a ContactProblem.
        result : Result
            Of :func:`adaptmg.solve` on it.

        Returns
        -------
        GoalEstimate
            Terms: the sums of squares of each quantity by name, and "transitions".

        Raises
        ------
        TypeError, ValueError
            As of :func:`adaptmg.estimate.stress_fields.posed`; where a point, boundary or pair of a quantity does not
            exist, or of several quantities one is zero.
        numpy.linalg.LinAlgError
            If the adjoint matrix is singular.
        """
        this = posed(hierarchy, result)
        view = GoalView(this, edge_bubbles(this.mesh, this.problem), linearised_contact(this.discrete, result))
        wanted = [functional for item in self.quantities for functional in checked_functionals(view, item)]
        if len({functional.name for functional in wanted}) < len(wanted):
            raise ValueError(f"quantity: one is given twice, {', '.join(functional.name for functional in wanted)}")
        return self.of_functionals(hierarchy, view, wanted)

    def of_functionals(self, hierarchy: Hierarchy, view: GoalView, wanted: list[Functional]) -> GoalEstimate:
        """The same for functionals at hand."""
        sizes, norm = _sizes(wanted), view.posed.norm
        duals = self._duals(hierarchy, view, [functional.vector for functional in wanted])
        error, residual, weighted = _bubbles(view, wanted, duals)
        energy = error.energy / norm if norm > 0 else 0.0
        parts = np.abs(np.einsum("gnd,nd->gn", weighted, error.alone))
        held = [_held(view, functional, dual) for functional, dual in zip(wanted, duals, strict=True)]
        if any(held):
            parts[held] = _energy_parts(view, [one for one, is_held in zip(wanted, held, strict=True) if is_held],
                                        np.einsum("nd,nd->n", residual, error.alone), energy)
        geometry = np.array([np.zeros(parts.shape[1]) if one.geometry is None else one.geometry for one in wanted])
        parts = (parts + np.abs(geometry)) / sizes[:, None]
        squares = {functional.name: view.bubbles.on_elements(part)
                   for functional, part in zip(wanted, parts, strict=True)}
        if self.transitions > 0:
            squares["transitions"] = self.transitions * sum(
                transition_changes(view, functional, dual.field) / size
                for functional, dual, size in zip(wanted, duals, sizes, strict=True))
        signed = np.einsum("gnd,nd->g", weighted, error.together) + geometry.sum(axis=1)
        algebraic = np.array([algebraic_part(view, functional, dual.field)
                              for functional, dual in zip(wanted, duals, strict=True)])
        values, whole = np.array([functional.value for functional in wanted]), signed + algebraic
        worst = int(np.argmax(np.abs(whole / sizes)))
        return GoalEstimate(
            squares=sum(squares.values()), norm=norm,
            indicator=f"dual-weighted residuals for {wanted[0].name}"
                      + (f" and {len(wanted) - 1} more" if len(wanted) > 1 else ""),
            terms={name: part.sum() for name, part in squares.items()},
            value=1.0 if len(wanted) > 1 else float(values[0]), signed=float(whole[worst] / sizes[worst]),
            energy_error=_tolerance(view, duals, signed, parts.sum(axis=1) * sizes, energy),
            names=tuple(f.name for f in wanted), units=tuple(f.unit for f in wanted), values=values, errors=whole,
            algebraic=algebraic, discretisation=energy,
            residuals=np.array([dual.residual for dual in duals]), iterations=sum(dual.iterations for dual in duals),
            converged=all(dual.converged for dual in duals))

    def _duals(self, hierarchy: Hierarchy, view: GoalView, functionals: list[np.ndarray]) -> list[AdjointSolution]:
        system = adjoint_system(view.contact)
        if len(hierarchy) == 1 or view.posed.discrete.n_dofs <= self.direct_below:
            return system.direct(functionals)
        return system.multigrid(hierarchy, functionals, self.rtol, self.max_iterations)


def _bubbles(view: GoalView, wanted: list[Functional], duals: list[AdjointSolution]
             ) -> tuple[BubbleError, np.ndarray, np.ndarray]:
    """The error in the bubbles, its residuals (n_edges, dim) and the dual ones (n_goals, n_edges, dim)."""
    this, bubbles = view.posed, view.bubbles
    spaces = bubble_spaces(this.problem, bubbles, view.contact)
    fields = [this.result.displacement, *(this.discrete.physical(dual.field) for dual in duals)]
    blocks, actions = bubbles.actions(this.problem, np.array(fields))
    reactions = [view.contact.residual, *(this.discrete.matrix @ dual.field - functional.vector
                                          for dual, functional in zip(duals, wanted, strict=True))]
    loads = [bubbles.load(this.problem) + friction_work(view), *(functional.bubbles for functional in wanted)]
    residuals = np.array([load - action + master_work(view, reaction)
                          for load, action, reaction in zip(loads, actions, reactions, strict=True)])
    return bubble_error(this.problem, bubbles, spaces, blocks, residuals[0]), residuals[0], residuals[1:]


def _held(view: GoalView, functional: Functional, dual: AdjointSolution) -> bool:
    """Whether the contact state alone, and no support, leaves a quantity no way to change."""
    return not dual.field.any() and bool(functional.vector[~view.posed.discrete.fixed].any())


def _energy_parts(view: GoalView, wanted: list[Functional], squares: np.ndarray, energy: float) -> np.ndarray:
    """Parts (n_goals, n_edges) as the energies of the bubbles (n_edges,) have them, for quantities that are held.

    Of what the state does not let change the dual field says nothing, but a finer mesh may have another state. In all
    they are what a relative error of the displacement as large as that of the energy makes of the quantity.
    """
    shares = np.abs(squares) / max(float(np.abs(squares).sum()), np.finfo(float).tiny)
    moved = float(np.abs(view.contact.unknowns).max(initial=0.0))
    return np.array([shares * energy * moved * float(np.abs(one.vector).sum()) for one in wanted])


def _tolerance(view: GoalView, duals: list[AdjointSolution], signed: np.ndarray, absolute: np.ndarray,
               energy: float) -> float:
    """The relative energy error that has as large a part in a quantity as its discretisation error, for the strictest.

    By the inequality of Cauchy and Schwarz, |z . r| <= ||z||_A ||e||_A. A signed error may vanish by chance. Of
    quantities that the contact state holds alone it is ``energy``, that of the discretisation.
    """
    matrix, norm = view.posed.discrete.matrix, view.posed.norm
    sizes = np.array([energy_norm(dual.field, matrix @ dual.field) for dual in duals]) * norm
    errors = np.maximum(np.abs(signed), _CHANCE * absolute)
    counts = (sizes > 0) & (errors > 0)
    if counts.any():
        return float((errors[counts] / sizes[counts]).min())
    return energy if errors.any() else 0.0


def _sizes(wanted: list[Functional]) -> np.ndarray:
    """What each quantity is related to: 1 of a single one, else the size of its value."""
    if len(wanted) == 1:
        return np.ones(1)
    sizes = np.array([abs(functional.value) for functional in wanted])
    if not sizes.min() > 0:
        raise ValueError(f"quantity: {wanted[int(np.argmin(sizes))].name} is zero, and several quantities are taken "
                         "relative to their values: estimate it alone")
    return sizes


def transition_changes(view: GoalView, functional: Functional, dual: np.ndarray) -> np.ndarray:
    """The change of a quantity, element by element."""
    contact, discrete = view.contact, view.posed.discrete
    dim, nodes, state = discrete.dim, contact.nodes, contact.state
    opens, sticks = _beside(view, state == State.OPEN), _beside(view, state == State.STICK)
    touches, slips = _beside(view, state != State.OPEN), _beside(view, state == State.SLIP)
    reaction = contact.local(discrete.matrix @ dual - functional.vector).reshape(-1, dim)[nodes]
    z = contact.local(dual).reshape(-1, dim)[nodes]
    nodal, frames = local_contact(discrete)
    diagonal = np.abs(np.einsum("nii->ni", contact_blocks(discrete, nodal, frames)))
    along, across = diagonal[:, 0], diagonal[:, 1:].max(axis=1)
    gap = np.where(np.isfinite(contact.gap), np.maximum(contact.gap, 0.0), 0.0)
    slack = np.maximum(contact.limit - np.linalg.norm(contact.force[:, 1:], axis=1), 0.0)
    slack = np.where(contact.held.any(axis=1), 0.0, slack)
    parts = [np.where((state != State.OPEN) & opens, np.abs(contact.force[:, 0] * reaction[:, 0]) / along, 0.0),
             np.where((state == State.OPEN) & touches, gap * np.abs(z[:, 0]) * along, 0.0),
             np.where((state == State.STICK) & slips, slack * np.linalg.norm(reaction[:, 1:], axis=1) / across, 0.0),
             np.where((state == State.SLIP) & sticks,
                      np.linalg.norm(contact.slip, axis=1) * np.linalg.norm(z[:, 1:], axis=1) * across, 0.0)]
    mesh, nodal = view.posed.mesh, np.zeros(discrete.n_nodes)
    nodal[nodes] = np.sum(parts, axis=0)
    return (nodal / np.bincount(mesh.elements.ravel(), minlength=len(nodal)))[mesh.elements].sum(axis=1)


def _beside(view: GoalView, chosen: np.ndarray) -> np.ndarray:
    """Contact nodes (n,) with an edge to one of those that are chosen (n,)."""
    contact, mesh = view.contact, view.posed.mesh
    marked = np.zeros(mesh.n_nodes, dtype=bool)
    marked[contact.nodes[chosen]] = True
    place = np.zeros(mesh.n_nodes, dtype=bool)
    place[contact.nodes] = True
    a, b = view.bubbles.edges[place[view.bubbles.edges].all(axis=1)].T
    result = np.zeros(mesh.n_nodes, dtype=bool)
    np.logical_or.at(result, b, marked[a])
    np.logical_or.at(result, a, marked[b])
    return result[contact.nodes]
