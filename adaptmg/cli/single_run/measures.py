"""What a run of a study file measures, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from adaptmg.solver.result import Result

__all__ = ["MEASURES", "Solved", "at_boundaries", "at_points"]


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

    Notes
    -----
    A load path ends with the first step that does not converge, so that the last result says it.
    """

    result: Result
    steps: int
    cycles: int
    work_units: float
    estimate: float | None = None

    @property
    def outcome(self) -> str:
        """The name of the status."""
        return self.result.status.name


def _states(solved: Solved, name: str) -> int:
    from adaptmg.smoother import state

    return int((solved.result.contact.state == getattr(state, name)).sum())


def _along(solved: Solved, boundary: str = "contact") -> dict[str, float | None]:
    """Components of the force on a boundary; None for the third in 2D."""
    force = solved.result.resultant(boundary).force
    return {axis: float(force[k]) if k < len(force) else None for k, axis in enumerate("xyz")}


def _largest(values: Any) -> float:
    """The largest size of a number or vector, 0 of none."""
    import numpy as np

    sizes = np.linalg.norm(values, axis=1) if values.ndim > 1 else np.abs(values)
    return float(sizes.max(initial=0.0))


def _in_contact(solved: Solved, name: str) -> Any:
    """A contact quantity at the nodes that are not open."""
    from adaptmg.smoother.state import OPEN

    contact = solved.result.contact
    return getattr(contact, name)[contact.state != OPEN]


#: name -> function of :class:`Solved`; SI units; :mod:`adaptmg.cli.described.meanings` says what they are
MEASURES: dict[str, Callable[[Solved], Any]] = {
    "outcome": lambda s: s.outcome,
    "cycles": lambda s: s.cycles,
    "work_units": lambda s: s.work_units,
    "start_work_units": lambda s: s.result.start_work_units,
    "solve_seconds": lambda s: s.result.seconds,
    "residual": lambda s: s.result.residual,
    "error_estimate": lambda s: s.result.error_estimate,
    "energy_error": lambda s: s.result.certificate().energy_error,
    "violation": lambda s: s.result.certificate().worst.relative,
    "estimate": lambda s: s.estimate,
    "rate": lambda s: s.result.rate,
    "steps": lambda s: s.steps,
    "levels": lambda s: len(s.result.levels),
    "nodes": lambda s: len(s.result.displacement),
    "contact_nodes": lambda s: len(s.result.contact),
    "open": lambda s: _states(s, "OPEN"),
    "slip": lambda s: _states(s, "SLIP"),
    "stick": lambda s: _states(s, "STICK"),
    "contact_area": lambda s: float(_in_contact(s, "weights").sum()),
    "max_pressure": lambda s: float(s.result.contact.pressure.max()),
    "max_traction": lambda s: _largest(s.result.contact.traction),
    "max_slip": lambda s: _largest(_in_contact(s, "slip")),
    "max_gap": lambda s: float(s.result.contact.gap.max()),
    "max_displacement": lambda s: _largest(s.result.displacement),
    "max_von_mises": lambda s: float(s.result.von_mises().max()),
    "force_x": lambda s: _along(s)["x"],
    "force_y": lambda s: _along(s)["y"],
    "force_z": lambda s: _along(s)["z"],
}


def at_boundaries(solved: Solved, names: tuple[str, ...]) -> dict[str, float]:
    """Resultant forces on boundaries: columns ``force_x(NAME)``, N (2D: N/m)."""
    return {f"force_{axis}({name})": value for name in names for axis, value in _along(solved, name).items()
            if value is not None}


def at_points(solved: Solved, points: dict[str, tuple[float, ...]]) -> dict[str, float]:
    """Displacements at points: columns ``NAME.x``, m."""
    if not points:
        return {}
    found = solved.result.probe(list(points.values()))
    return {f"{name}.{axis}": float(value) for name, row in zip(points, found, strict=True)
            for axis, value in zip("xyz", row, strict=False)}
