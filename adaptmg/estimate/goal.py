r"""Goal: the error of single quantities of a contact solution, by dual-weighted residuals.

On the mesh with all edges halved the new nodes M carry most of the error d of the interpolated
solution
:math:`u_h`. With the dual field z of a quantity J (:mod:`adaptmg.estimate.adjoint`), interpolated as well,

.. math:: A_{MM}\,d = (b - A (u_h + g))_M, \qquad
          J(u) - J(u_h) \approx \tfrac43\,\bigl((J' - A^T z_h)_M \cdot (d + g) + J_{h/2}(u_h) - J_h(u_h)\bigr),

as halving the elements leaves a quarter of an error (hierarchical basis, R. Bank, R. K. Smith, SIAM
J. Numer. Anal. 30, 1993, doi:10.1137/0730048). At new nodes that a support or an obstacle holds the
error is known: g, what :math:`u_h` misses there of the prescribed value or of the gap. The last
difference is what the chords of curves change. Contact is linearised at the solution, and an edge
between an open node and a closed one counts as open. The signed sum is quoted; its parts with the
diagonal in place of :math:`A_{MM}` say by absolute value where to refine. The sum of these values
is .77 to 7.7 times the absolute value of the signed sum (17 goals on a bar, a dovetail and a
bolted junction).

R. Becker, R. Rannacher, Acta Numerica 10, 2001, doi:10.1017/S0962492901000010; with contact and
friction linearised at the solution as in the semismooth Newton method. The sum does not contain
that the contact zones end elsewhere than in the discrete solution; both fields are singular at the
ends of the zones, so that the marks refine there all the same."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, gmres

from adaptmg import _checks as checks
from adaptmg._text import shortened
from adaptmg._threads import one_blas_thread
from adaptmg.estimate.adjoint import (
    AdjointSolution,
    LinearisedContact,
    adjoint_system,
    error_spaces,
)
from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.quantities import Functional, GoalView, Quantity, checked_functionals
from adaptmg.estimate.stress_fields import solved
from adaptmg.hierarchy import Hierarchy
from adaptmg.problem import ContactProblem
from adaptmg.smoother.system import ContactState as State
from adaptmg.solver.result import Result

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GoalEstimate(Estimate):
    """An estimate of the error of quantities of interest.

    Arrays (n,) and tuples have an entry for each quantity.

    Examples
    --------
    >>> goal = am.Goal(am.Opening("contact"))
    >>> problem = am.cases.greco_bar()
    >>> mesh = am.mesh.structured(problem.domain, 2)
    >>> step = next(am.adapt(problem, mesh, indicator=goal, max_nodes=30))
    >>> len(step.estimate.values)
    1
    """

    value: float  # pyright: ignore[reportGeneralTypeIssues]  all are keywords
    signed: float  # pyright: ignore[reportGeneralTypeIssues]
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
        """Return the values plus their estimated errors (n,)."""
        return self.values + self.errors

    def __repr__(self) -> str:
        return shortened(str(self))

    def __str__(self) -> str:
        lines = [
            f"Estimate by {self.indicator}: {len(self.squares)} elements, estimated relative energy error "
            f"{self.discretisation:.3%}"
        ]
        width = max(map(len, self.names))
        lines += [
            f"  {name:<{width}s} {value:14.7g} {unit:<3s} estimated error {error:+.3g} (exact minus discrete)"
            + (f", {error / abs(value):+.3%}" if value else "")
            for name, unit, value, error in zip(
                self.names, self.units, self.values, self.errors, strict=True
            )
        ]
        if not self.converged:
            lines.append(
                f"  the adjoint problems were not solved: residual {self.residuals.max():.1e}"
            )
        return "\n".join(lines)


#: dofs up to which the adjoint problems are solved directly
DIRECT = 3000


@dataclass(frozen=True)
class Goal:
    """The error of a quantity, or of several.

    Parameters
    ----------
    quantity : Displacement, MeanDisplacement, ContactForce, Opening, PeakPressure, Dissipation
        Or a sequence of these. Of several (also several points of one Displacement) everything is
        relative to their values: the squares are sums of relative parts, ``value`` is 1 and
        ``signed`` the relative error of that with the largest.

    Notes
    -----
    A quantity that the contact state holds (an opening while all nodes touch, the motion of a node
    that sticks) has no dual field; then elements are marked by the energy of the error, until a
    finer mesh has another state. Where the estimate is rounding, as the load alone gives the quantity
    on that mesh, a loop refines all elements alike; it ends where this happens on two meshes in a row.

    The signed estimate contains the algebraic error, as far as it leaves the contact state
    unchanged. It is not a bound: it is .4 to 1.3 times the true error of most of 50 loops with known
    fields, more often below 1. What chords of a round body change in its stiffness is not a part
    of it, so that displacements of a press fit of rings are off by more than they say.

    Steps of :func:`adaptmg.adapt` print "(not settled)" where the corrected value, value plus signed
    estimate, has changed since the mesh before by more than the estimate, or the sign has changed. A
    small estimate after a large one, +.09 % after +1.5 %, may thus be chance, as where the error
    passes through zero; the change of the corrected value is then the better measure of the error.

    Examples
    --------
    >>> goal = am.Goal(am.ContactForce("contact", "normal"))
    >>> problem = am.cases.greco_bar()
    >>> mesh = am.mesh.structured(problem.domain, 2)
    >>> step = next(am.adapt(problem, mesh, indicator=goal, max_nodes=30))
    >>> step.estimate.value > 0                                       # N/m
    True
    """

    quantity: Quantity | Sequence[Quantity]

    def __post_init__(self) -> None:
        for item in self.quantities:
            checks.offers(
                "quantity",
                item,
                "functionals",
                "Displacement(...), MeanDisplacement(...), "
                "ContactForce(...), Opening(...), PeakPressure(...), Dissipation(...), or several of these",
            )
        if not self.quantities:
            raise ValueError("quantity is empty: give at least one")
        # options compare and have a hash, which lists have not
        if isinstance(self.quantity, list):
            object.__setattr__(self, "quantity", tuple(self.quantity))

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Return all quantities."""
        return (
            tuple(self.quantity)
            if isinstance(self.quantity, (list, tuple))
            else (cast("Quantity", self.quantity),)
        )

    @one_blas_thread()
    def indicate(self, hierarchy: Hierarchy, result: Result) -> GoalEstimate:
        """Estimate the error on the finest mesh of a hierarchy, of a result of
        :func:`adaptmg.solve` on it.

        The terms of the estimate are the sums of squares of each quantity by name. TypeError and
        ValueError as of
        :meth:`adaptmg.Residual.indicate`, where a point, boundary or pair of a quantity does not exist, where elements
        are smoothed (estimates were -1 to 3 times the error), and where of several quantities one
        is zero; numpy.linalg.LinAlgError if the adjoint matrix is singular."""
        state = solved(hierarchy, result)
        need_linear(state.problem)
        view = GoalView.of(state)
        functionals = [
            functional for item in self.quantities for functional in checked_functionals(view, item)
        ]
        names = tuple(functional.name for functional in functionals)
        if len(set(names)) < len(names):
            raise ValueError(f"quantity: one is given twice, {', '.join(names)}")
        sizes = _sizes(functionals)
        system = adjoint_system(view.contact)
        vectors = [functional.vector for functional in functionals]
        direct = len(hierarchy) == 1 or state.discrete.n_dofs <= DIRECT
        duals = system.direct(vectors) if direct else system.multigrid(hierarchy, vectors)
        fine, origin = view.halved()
        finer = [
            functional for item in self.quantities for functional in checked_functionals(fine, item)
        ]
        error = HalvedError(view, fine, state.norm)
        algebraic = np.array(
            [_algebraic(view, *pair) for pair in zip(functionals, duals, strict=True)]
        )
        # of each quantity its signed error and the parts (n_nodes,) of the nodes of the halved mesh
        discretised = [
            error.of_functional(*group) for group in zip(functionals, finer, duals, strict=True)
        ]
        errors = np.array([signed for signed, _ in discretised]) + algebraic
        worst = int(np.argmax(np.abs(errors / sizes)))
        squares = [
            _on_elements(fine, origin, parts / size)
            for (_, parts), size in zip(discretised, sizes, strict=True)
        ]
        values = np.array([functional.value for functional in functionals])
        return GoalEstimate(
            squares=sum(squares, np.zeros(len(squares[0]))),
            norm=state.norm,
            terms={name: part.sum() for name, part in zip(names, squares, strict=True)},
            indicator=f"dual-weighted residuals for {names[0]}"
            + (f" and {len(names) - 1} more" if len(names) > 1 else ""),
            # of several quantities ``signed`` is relative
            value=1.0 if len(functionals) > 1 else float(values[0]),
            signed=float(errors[worst] / sizes[worst]),
            names=names,
            units=tuple(functional.unit for functional in functionals),
            values=values,
            errors=errors,
            algebraic=algebraic,
            discretisation=error.energy,
            residuals=np.array([dual.residual for dual in duals]),
            iterations=sum(dual.iterations for dual in duals),
            converged=all(dual.converged for dual in duals),
        )


def need_linear(problem: ContactProblem) -> None:
    """Raise ValueError unless the elements of the problem are linear."""
    if problem.elements != "linear":
        raise ValueError(
            "am.Goal estimates errors of linear elements, not of smoothed ones: take am.Recovery() or "
            "am.Residual() as indicator"
        )


def _sizes(functionals: list[Functional]) -> np.ndarray:
    """Return the divisors (n,) that make the errors of quantities relative: 1 for a single one, else
    the absolute values."""
    if len(functionals) == 1:
        return np.ones(1)
    sizes = np.array([abs(functional.value) for functional in functionals])
    if not sizes.min() > 0:
        raise ValueError(
            f"quantity: {functionals[int(np.argmin(sizes))].name} is zero, and several quantities are "
            "taken relative to their values: estimate it alone"
        )
    return sizes


#: an error over what halving all elements takes from it
_WHOLE = 4 / 3
#: residual of the equations of the new nodes, whose condition is about ten: half changes estimates of
#: 32 goals by 1 % at most, twice by 3 %, 1e-1 by 29 %
_RTOL = 1e-2
#: steps to a restart
_STEPS = 30


class HalvedError:
    """The error of a discrete solution at the new nodes of the mesh with all edges halved.

    ``new`` (n_new,) are the dofs of these nodes in which it may move, ``error`` (n_new,) the error
    from all equations of these dofs together, for signed estimates, and ``diagonal_error`` (n_new,)
    that from each equation by itself, for marks, with the ``energies`` (n_new,), N m. ``prescribed``
    (n_dofs,) is the error g at other dofs, in local components. ``view`` and
    ``fine`` are the solution on its mesh and on the halved one, ``norm`` is its energy norm, sqrt(N m)."""

    def __init__(self, view: GoalView, fine: GoalView, norm: float) -> None:
        self.view = view
        self.fine = fine
        contact = fine.contact
        matrix, trial, test = error_spaces(contact)
        # new nodes have the numbers after those of the mesh that is halved
        new = np.flatnonzero(trial & (np.arange(len(trial)) >= view.discrete.n_dofs))
        self.new = new
        self.test = sparse.csr_array(test[:, new].T)
        self.prescribed = _missed(contact)
        # the equations A_MM d = (b - A (u_h + g))_M of the new dofs M are, with T and H of
        # adaptmg.estimate.adjoint at slipping nodes, T'(A + H)_MM d = T'(fixed friction - (A u_h - b) - A g).
        # A g takes the matrix of the problem, as ``matrix`` is decoupled from what supports hold
        change = contact.discrete.matrix @ contact.cartesian(self.prescribed)
        unbalanced = contact.discrete.free_part(contact.residual + change)
        load = self.test @ (contact.fixed_friction - contact.local(unbalanced))
        matrix = sparse.csr_array(self.test @ matrix[:, new])
        diagonal = matrix.diagonal()
        self.diagonal_error = load / diagonal
        preconditioner = LinearOperator(
            matrix.shape, lambda x: x.reshape(-1) / diagonal, dtype=np.float64
        )
        # scipy tests the residual over the diagonal; restarts are counted in ``maxiter``
        self.error, failed = gmres(
            matrix, load, rtol=_RTOL, atol=0.0, restart=_STEPS, maxiter=3, M=preconditioner
        )
        if failed:
            _LOG.info("the equations of %d new unknowns were not solved to %.0e", len(new), _RTOL)
        self.energies = np.abs(load * self.diagonal_error)
        #: energy norm of the error over that of the solution
        self.energy = (
            float(np.sqrt(max(_WHOLE * load @ self.error, 0.0))) / norm if norm > 0 else 0.0
        )

    def of_functional(
        self, coarse: Functional, finer: Functional, dual: AdjointSolution
    ) -> tuple[float, np.ndarray]:
        """Return the signed error of a quantity, and the parts (n_nodes,) of the nodes of the halved
        mesh by which elements are marked.

        ``coarse`` and ``finer`` are the quantity on the mesh and on the halved one."""
        contact = self.fine.contact
        reaction = finer.vector - self.fine.discrete.matrix @ self.fine.interpolated(dual.field)
        weighted = contact.local(reaction)
        geometry = finer.value - coarse.value
        # 4/3 ((J' - A'z_h)_M . d + J_(h/2)(u_h) - J_h(u_h))
        signed = _WHOLE * float(
            weighted[self.new] @ self.error + weighted @ self.prescribed + geometry
        )
        # marks depend on ratios alone: they need no factor 4/3
        parts = np.abs(weighted * self.prescribed)
        parts[self.new] = np.abs(weighted[self.new] * self.diagonal_error)
        if not dual.field.any() and self.view.discrete.free_part(coarse.vector).any():
            # the contact state does not let the quantity change, but a finer mesh may have another state
            parts = self._energy_parts(coarse)
        nodal = parts.reshape(-1, contact.discrete.dim).sum(axis=1)
        return signed, nodal + abs(geometry) * self._chord_shares(finer)

    def _energy_parts(self, functional: Functional) -> np.ndarray:
        """Return as parts (n_dofs,) of a quantity those of the energy; their sum is the change of the
        quantity by a relative error of the displacement as large as that of the energy."""
        displacement_size = np.abs(self.view.contact.unknowns).max(initial=0.0)
        largest_change = float(displacement_size * np.abs(functional.vector).sum())
        shares = self.energies / max(float(self.energies.sum()), np.finfo(float).tiny)
        parts = np.zeros(self.fine.discrete.n_dofs)
        parts[self.new] = shares * self.energy * largest_change
        return parts

    def _chord_shares(self, finer: Functional) -> np.ndarray:
        """Return the shares (n_nodes,), with sum 1, of the new nodes in the error of the chords. At a
        facet of size h the node has a weight ~ h^(d - 1) in a mean, and the error is ~ h^(d + 1)."""
        dim = self.view.mesh.dim
        weights = np.linalg.norm(finer.vector.reshape(-1, dim), axis=1)
        # with h ~ weight^(1 / (d - 1))
        errors = weights ** ((dim + 1) / (dim - 1))
        errors[: self.view.mesh.n_nodes] = 0.0
        return errors / max(float(errors.sum()), np.finfo(float).tiny)


def _missed(contact: LinearisedContact) -> np.ndarray:
    """Return what the interpolated displacement misses of prescribed values and, where bodies touch, of
    the gap (n_dofs,), in local components, m; it matters where errors may not move."""
    discrete = contact.discrete
    missed = discrete.fixed_values - contact.unknowns
    missed = contact.local(missed - discrete.free_part(missed)).reshape(-1, discrete.dim)
    touches = (contact.state != State.OPEN) & np.isfinite(contact.gap)
    missed[contact.nodes[touches], 0] = contact.gap[touches]
    return missed.reshape(-1)


def _on_elements(fine: GoalView, origin: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Return for each element the sum (n_elements,) of ``parts`` (n_nodes,) of the nodes of the halved
    mesh. Elements around a node share its part evenly; ``origin`` is the element that holds each."""
    elements = fine.mesh.elements
    around = np.bincount(elements.ravel(), minlength=len(parts))
    return np.bincount(origin, (parts / around)[elements].sum(axis=1))


def _algebraic(view: GoalView, functional: Functional, dual: AdjointSolution) -> float:
    r"""Return the error of the solver: J of the discrete solution minus J of the result, in the
    unit of the quantity.

    With the residual r = A u - b, the force s f of Tresca's law against the slip (f has length 1), and the amount
    :math:`\delta` by which the result misses prescribed values (a gap where bodies touch, minus the
    slip where they stick),

    .. math:: -z \cdot r + \sum_{\mathrm{slip}} s\, f \cdot z_t - \lambda^* \cdot \delta, \qquad \lambda^* = A z - j .
    """
    contact = view.contact
    discrete = view.discrete
    multiplier = contact.local(discrete.matrix @ dual.field - functional.vector)  # lambda*
    multiplier = multiplier.reshape(-1, discrete.dim)[contact.nodes]
    # reactions of supports, in the residual at fixed dofs, are not errors
    error = -float(dual.field @ discrete.free_part(contact.residual))
    error += float(contact.fixed_friction @ contact.local(dual.field))
    # nodes with friction alone have no obstacle, and an infinite gap
    touches = (contact.state != State.OPEN) & np.isfinite(contact.gap)
    sticks = contact.is_sticking[:, None] & ~contact.held
    # - lambda* . delta, with delta the gap along the normal and minus the slip along tangents
    error -= float(np.sum(np.where(touches, multiplier[:, 0] * contact.gap, 0.0)))
    return error + float(np.sum(np.where(sticks, multiplier[:, 1:] * contact.slip, 0.0)))
