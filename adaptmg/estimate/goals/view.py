"""GoalView: what quantities of interest are read from, a solution with its edge bubbles and linearised contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptmg.estimate.fields.posed import Posed
from adaptmg.estimate.goals.bubbles.edge_bubbles import EdgeBubbles
from adaptmg.estimate.goals.contact_state import LinearisedContact
from adaptmg.problem import check_arrays, checks

__all__ = ["Functional", "GoalView", "checked_functionals"]


@dataclass(frozen=True, eq=False)
class GoalView:
    """A solution and what belongs to it.

    Attributes
    ----------
    posed : Posed
        Problem, mesh, discrete problem and result.
    bubbles : EdgeBubbles
    contact : LinearisedContact
    """

    posed: Posed
    bubbles: EdgeBubbles
    contact: LinearisedContact

    def load_of(self, nodal: np.ndarray) -> np.ndarray:
        """A functional of the displacement (n_nodes, dim) as one (n_dofs,) of the unknowns."""
        flat, coupling = np.asarray(nodal, dtype=np.float64).reshape(-1), self.posed.discrete.coupling
        return flat if coupling is None else coupling.relative_forces(flat)


@dataclass(frozen=True, eq=False)
class Functional:
    """A quantity of a solution, and how it changes with it.

    Attributes
    ----------
    name : str
        For tables.
    value : float
        Of the discrete solution, in ``unit``.
    unit : str
    vector : (n_dofs,) array
        Its derivative by the unknowns of the problem (between bodies relative), Cartesian.
    bubbles : (n_edges, dim) array
        Its derivative by the bubbles of the edges.
    geometry : (n_edges,) array, optional
        What the domain changes in it, which the mesh has with chords in the place of curves, in ``unit``; default none.
    """

    name: str
    value: float
    unit: str
    vector: np.ndarray
    bubbles: np.ndarray
    geometry: np.ndarray | None = None


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
