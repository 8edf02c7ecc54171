"""GoalView: what quantities of interest are read from, a solution with its edge bubbles and linearised contact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.estimate.fields.posed import Posed
from adaptmg.estimate.goals.bubbles.edge_bubbles import EdgeBubbles
from adaptmg.estimate.goals.contact_state import LinearisedContact

__all__ = ["Functional", "GoalView"]


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
    """

    name: str
    value: float
    unit: str
    vector: np.ndarray
    bubbles: np.ndarray
