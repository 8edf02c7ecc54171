"""GoalEstimate: the estimate of a goal, quantity by quantity.

GoalView: what quantities of interest are read from, a solution with its edge bubbles and linearised contact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg.estimate.contact_state import LinearisedContact
from adaptmg.estimate.edge_bubbles import EdgeBubbles
from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.stress_fields import Posed

__all__ = ["Functional", "GoalEstimate", "GoalView", "checked_functionals"]

@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GoalEstimate(Estimate):
    """An estimate of the error of quantities of interest.

    Parameters
    ----------
    names, units : tuples of str
        Of the quantities.
    values, errors : (n,) arrays
        Of the discrete solution, and estimated exact minus discrete values.
    algebraic : (n,) array
        The part of ``errors`` that the solver has left.
    discretisation : float
        Estimated relative energy error of the discrete solution.
    residuals : (n,) array
        Relative residuals of the adjoint problems.
    iterations : int
        Of GMRES, in all; 0 of direct solutions.
    converged : bool
        Whether all adjoint problems were solved to the tolerance asked for.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    errors: np.ndarray
    algebraic: np.ndarray
    discretisation: float
    residuals: np.ndarray
    iterations: int = 0
    converged: bool = True

    @property
    def corrected(self) -> np.ndarray:
        """Values plus estimated errors (n,)."""
        return self.values + self.errors

    def __repr__(self) -> str:
        lines = [f"Estimate by {self.indicator}: {len(self.squares)} elements, estimated relative energy error "
                 f"{self.discretisation:.3%}"]
        width = max(map(len, self.names))
        lines += [f"  {name:<{width}s} {value:14.7g} {unit:<3s} estimated error {error:+.3g} (exact minus discrete)"
                  + (f", {error / abs(value):+.3%}" if value else "")
                  for name, unit, value, error in zip(self.names, self.units, self.values, self.errors, strict=True)]
        if not self.converged:
            lines.append(f"  the adjoint problems were not solved: residual {self.residuals.max():.1e}; take more "
                         "max_iterations")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class GoalView:
    """A solution and what belongs to it."""

    posed: Posed  # problem, mesh, discrete problem and result
    bubbles: EdgeBubbles
    contact: LinearisedContact

    def load_of(self, nodal: np.ndarray) -> np.ndarray:
        """A functional of the displacement (n_nodes, dim) as one (n_dofs,) of the unknowns."""
        return self.posed.discrete.relative_forces(np.asarray(nodal, dtype=np.float64).reshape(-1))


@dataclass(frozen=True, eq=False)
class Functional:
    """A quantity of a solution, and how it changes with it."""

    name: str  # for tables
    value: float  # of the discrete solution, in unit
    unit: str
    vector: np.ndarray  # (n_dofs,): its derivative by the unknowns of the problem (between bodies relative), Cartesian
    bubbles: np.ndarray  # (n_edges, dim): its derivative by the bubbles of the edges
    geometry: np.ndarray | None = None  # (n_edges,)


def checked_functionals(view: GoalView, quantity: Any) -> list[Functional]:
    """What a quantity asks for; TypeError or ValueError, which name it, unless these are functionals of this view."""
    made = quantity.functionals(view)
    said = f"quantity {checks.shown(quantity)}: functionals(view) must return"
    if not isinstance(made, (list, tuple)) or not all(isinstance(one, Functional) for one in made):
        raise TypeError(f"{said} a list of Functional, got {checks.described(made)}")
    if not made:
        raise ValueError(f"{said} at least one Functional, got none")
    for one in made:
        name = f"quantity {checks.shown(quantity)}: "
        checks.instance(f"{name}name", one.name, str, "text")
        checks.number(f"{name}value", one.value)
        check_arrays.array(f"{name}vector", one.vector, (view.posed.discrete.n_dofs,))
        check_arrays.array(f"{name}bubbles", one.bubbles, (len(view.bubbles.edges), view.posed.mesh.dim))
        if one.geometry is not None:
            check_arrays.array(f"{name}geometry", one.geometry, (len(view.bubbles.edges),))
    return list(made)
