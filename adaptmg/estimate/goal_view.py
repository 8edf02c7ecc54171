"""What quantities of interest are read from, what they return, and the estimate of their errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._text import shortened
from adaptmg.discrete.facets import area_vectors, shape_integrals
from adaptmg.estimate.adjoint import LinearisedContact
from adaptmg.estimate.edge_bubbles import EdgeBubbles
from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.stress_fields import Posed


@dataclass(frozen=True, eq=False)
class GoalView:
    """A solution as quantities see it."""

    posed: Posed  # problem, mesh, discrete problem and result
    bubbles: EdgeBubbles
    contact: LinearisedContact

    def load_of(self, nodal: np.ndarray) -> np.ndarray:
        """A functional of the displacement (n_nodes, dim) as one (n_dofs,) of the relative coordinates."""
        return self.posed.discrete.relative_forces(np.asarray(nodal, dtype=np.float64).reshape(-1))

    def shape_integrals(self, facets: np.ndarray) -> np.ndarray:
        """Integrals (n, dim) of the shape functions of the corners of facets."""
        points = self.posed.mesh.points
        measures = np.linalg.norm(area_vectors(points, facets), axis=1)
        return measures[:, None] * shape_integrals(points, facets, self.bubbles.axisymmetric)


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
        """The quantity, or several, of a solution."""


def checked_functionals(view: GoalView, quantity: Quantity) -> list[Functional]:
    """What a quantity asks for; TypeError or ValueError, which name it, unless these are functionals of this view."""
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
