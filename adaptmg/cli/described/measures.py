"""What a run of a study file measures, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from adaptmg.solver.result import Result

__all__ = ["MEASURES", "Solved"]


@dataclass(frozen=True)
class Solved:
    """What there is to measure.

    Attributes
    ----------
    result : Result
        Of the last load step, on the last mesh.
    steps : int
        Load steps, or meshes of an adaptive solve; 1 otherwise.
    cycles, work_units : float
        Of all of them.
    estimate : float or None
        Relative, of the last mesh of an adaptive solve.
    """

    result: Result
    steps: int
    cycles: int
    work_units: float
    estimate: float | None = None


def _states(solved: Solved, name: str) -> int:
    from adaptmg.smoother import state

    return int((solved.result.contact.state == getattr(state, name)).sum())


def _force(solved: Solved, axis: int) -> float | None:
    force = solved.result.resultant("contact").force
    return float(force[axis]) if axis < len(force) else None


def _largest(solved: Solved) -> float:
    import numpy as np

    return float(np.linalg.norm(solved.result.displacement, axis=1).max())


#: name -> function of :class:`Solved`; SI units
MEASURES: dict[str, Callable[[Solved], Any]] = {
    "outcome": lambda s: s.result.status.name,
    "cycles": lambda s: s.cycles,
    "work_units": lambda s: s.work_units,
    "start_work_units": lambda s: s.result.start_work_units,
    "solve_seconds": lambda s: s.result.seconds,
    "residual": lambda s: s.result.residual,
    "error_estimate": lambda s: s.result.error_estimate,
    "estimate": lambda s: s.estimate,
    "rate": lambda s: s.result.rate,
    "steps": lambda s: s.steps,
    "nodes": lambda s: len(s.result.displacement),
    "contact_nodes": lambda s: len(s.result.contact),
    "open": lambda s: _states(s, "OPEN"),
    "slip": lambda s: _states(s, "SLIP"),
    "stick": lambda s: _states(s, "STICK"),
    "max_pressure": lambda s: float(s.result.contact.pressure.max()),
    "max_displacement": _largest,
    "force_x": lambda s: _force(s, 0),
    "force_y": lambda s: _force(s, 1),
    "force_z": lambda s: _force(s, 2),
}
