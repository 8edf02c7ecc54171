r"""What an engineer reads off a solved bolted junction: bolt force, opening, tightness; and its load path.

The fluid is not followed into the joint. An axisymmetric joint is called tight as long as somewhere between the bore
and the bolt holes the contact pressure exceeds that of the fluid: :func:`sealing_pressure` > p. At a higher pressure it
is open as far as the bolts: :func:`open_to` reaches the bolt circle.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg.cases.flanges import Flanges
from adaptmg.problem import ContactProblem, LoadPath, check_arrays
from adaptmg.smoother.state import OPEN
from adaptmg.solver.contact_result import ContactResult
from adaptmg.solver.result import Result

__all__ = ["bolt_force", "joint_opening", "junction_path", "open_to", "sealing_pressure"]

_JOINT = "upper.joint"
_HEAD = ".upper_head"
# of a sector of 90 degrees in a whole
_SECTORS = {2: 1, 3: 4}
# nodes whose radii differ by less than this share of the largest lie on one circle
_CIRCLE = 1e-6


def junction_path(problem: ContactProblem, pressures: Sequence[float]) -> LoadPath:
    """The load history of a junction: the bolts are tightened in the first step, then the pressure changes.

    Parameters
    ----------
    problem : ContactProblem
        From :func:`~adaptmg.cases.bolted_junction.bolted_junction`, with a pressure other than zero.
    pressures : sequence of float
        Internal pressure of each step after the first, Pa.

    Returns
    -------
    LoadPath
        Of ``len(pressures) + 1`` steps.

    Examples
    --------
    >>> am.solve_path(grids, am.cases.junction_path(problem, [1e6, 2e6, 4e6]))
    """
    full = problem.reference.get("pressure") if isinstance(problem, ContactProblem) else None
    if full is None:
        raise TypeError(f"problem must be one from bolted_junction, got {problem!r}")
    if full == 0:
        raise ValueError("problem has no pressure that a path could scale: give bolted_junction one other than 0")
    values = np.append(0.0, check_arrays.vector("pressures", pressures)) / full
    return LoadPath(dict.fromkeys(("upper.bore", "lower.bore", "upper.pipe"), values))


def bolt_force(result: Result) -> float:
    """Force of all bolts around the circumference, N: what their upper heads press on the flange.

    ValueError if the bolts are given as a traction.
    """
    c = _contact(result)
    heads = [k for k, name in enumerate(c.names) if name.endswith(_HEAD)]
    if not heads:
        raise ValueError("this junction has no bolts (bolt='traction'): their force is what was given as preload")
    return _SECTORS[result.dim] * float(c.force_n[np.isin(c.boundary, heads)].sum())


def joint_opening(result: Result) -> float:
    """Opening of the joint at the bore, m: the mean normal gap of the contact nodes there."""
    radii, joint = _joint(result)
    at_bore = radii <= radii.min() + _CIRCLE * radii.max()
    return float(result.contact.gap[joint][at_bore].mean())


def open_to(result: Result) -> float:
    """Radius up to which an axisymmetric joint is open, m.

    It lies half-way between the innermost node that touches and the next node further in; it is the bore's where the
    joint is closed there, and that of the rim where nothing touches.
    """
    radii, joint = _joint(result, axisymmetric="open_to")
    touching = radii[result.contact.state[joint] != OPEN]
    if not touching.size:
        return float(radii.max())
    first = touching.min()
    further_in = radii[radii < first * (1 - _CIRCLE)]
    return float(0.5 * (first + further_in.max())) if further_in.size else float(first)


def sealing_pressure(result: Result, flanges: Flanges) -> float:
    """Largest contact pressure of an axisymmetric joint between the bore and the bolt holes, Pa."""
    radii, joint = _joint(result, axisymmetric="sealing_pressure")
    inside = joint[radii <= flanges.inside_bolts]
    return float(result.contact.pressure[inside].max())


def _contact(result: Result) -> ContactResult:
    if not isinstance(result, Result):
        raise TypeError(f"result must be a Result, got {type(result).__name__}")
    if _JOINT not in result.contact.names:
        raise ValueError(f"result is not one of a bolted junction: its contact boundaries are {result.contact.names}")
    return result.contact


def _joint(result: Result, axisymmetric: str = "") -> tuple[np.ndarray, np.ndarray]:
    """Radii (n,), m, and positions (n,) of the contact nodes of the joint; the name of a measure for 2D only."""
    c = _contact(result)
    if axisymmetric and result.dim != 2:
        raise ValueError(f"{axisymmetric} is for the axisymmetric junction; in 3D it changes along the circumference")
    joint = np.flatnonzero(c.boundary == c.names.index(_JOINT))
    x = c.x[joint]
    return (x[:, 0] if result.dim == 2 else np.hypot(x[:, 0], x[:, 1])), joint
