"""The problems on which adaptive meshes are measured, and what is measured on each.

Part of ``adaptive_vs_uniform.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import LinearNDInterpolator

import adaptmg as am
from adaptmg.mesh import MeshArrays, bisect, graded, structured
from adaptmg.transfer import PointLocator

MM = 1e-3


@dataclass(frozen=True, kw_only=True)
class Case:
    """A problem, its meshes, and what is measured besides the energy error.

    Attributes
    ----------
    problem : callable
    start : (float, float)
        Element size of the first adaptive mesh, m, and its ratio to that at contact.
    coarse : int or float
        Of the first uniform mesh: cells along a side, or Netgen's element size, m.
    points : sequence of (position, component, body)
        Displacements to be right, body None where there is one only; position in m.
    compared : callable
        Mask over points of the contact boundary (n, dim): where the pressure is compared. It leaves out the
        neighbourhood of singular edges.
    force : (name, function of a Result)
        A number that contact gives and equilibrium alone does not.
    goal : quantity, optional
        Of :class:`adaptmg.Goal`.
    graded : (float, float)
        Coarsest size of meshes graded by hand, m, and its ratio to that at contact.
    """

    problem: Callable[[], am.ContactProblem]
    start: tuple[float, float]
    coarse: int | float
    points: Sequence[tuple[tuple[float, ...], int, str | None]]
    compared: Callable[[np.ndarray], np.ndarray]
    force: tuple[str, Callable[[am.Result], float]]
    graded: tuple[float, float]
    goal: Any = None
    dim: int = 2


def upset_block_3d() -> am.ContactProblem:
    """The upset block as a solid: free at x = 0 and at the back, symmetric at x = 40 mm and at the front."""
    block = am.cases.greco_block(law=am.Coulomb(0.5), side_pressure=0.0, plane_strain=False)
    return replace(block, name="upset block 3D")


def two_blocks_3d() -> am.ContactProblem:
    """A cube pressed on a stiffer, wider block, friction .5; a quarter by symmetry."""
    side, wide = 40 * MM, 60 * MM
    return am.ContactProblem(
        name="two blocks 3D",
        material={"upper": am.Solid(young=1.3e11, poisson=0.2), "lower": am.Solid(young=2.1e11, poisson=0.3)},
        domain=am.Assembly(parts={"upper": am.Box(width=side, depth=side, height=side),
                                  "lower": am.Box(width=wide, depth=wide, height=side, origin=(0.0, 0.0, -side))}),
        contact=am.ContactPair("upper.bottom", "lower.top"), law=am.Coulomb(0.5),
        loads=(am.Pressure("upper.top", 5e7),),
        supports=(*(am.Support(f"{body}.left", x=0.0) for body in ("upper", "lower")),
                  *(am.Support(f"{body}.front", y=0.0) for body in ("upper", "lower")),
                  am.Support("lower.bottom", z=0.0)))


def friction_force(result: am.Result) -> float:
    """Component x of the contact force on the (slave) body, N (2D: N/m)."""
    return float(result.contact.force[:, 0].sum())


def pair_force(result: am.Result) -> float:
    """Compressive force through the first pair, N (2D: N/m; axisymmetric: of the whole circle)."""
    return float(result.contact.force_n[result.contact.boundary == 0].sum())


def centre_pressure(result: am.Result) -> float:
    """Mean pressure under the inner half of a punch, Pa."""
    x, pressure = along(result)
    inner = np.linspace(0.0, 0.5 * x.max(), 401)
    return float(np.trapezoid(np.interp(inner, x, pressure), inner) / inner[-1])


def along(result: am.Result) -> tuple[np.ndarray, np.ndarray]:
    """Place along the first contact boundary of a plane problem, m, and the pressure there, Pa."""
    mine = result.contact.boundary == 0
    x = result.contact.x[mine]
    # every such boundary is straight
    place = np.linalg.norm(x - x[np.argmin(x[:, 0])], axis=1)
    order = np.argsort(place)
    return place[order], result.contact.pressure[mine][order]


def pressure_at(result: am.Result, points: np.ndarray) -> np.ndarray:
    """Pressure of the first contact boundary at points of it, linear between contact nodes, Pa."""
    mine = result.contact.boundary == 0
    x, pressure = result.contact.x[mine], result.contact.pressure[mine]
    if x.shape[1] == 3:
        return LinearNDInterpolator(x[:, :2], pressure)(points[:, :2])
    axis = int(np.argmax(np.ptp(x, axis=0)))
    order = np.argsort(x[:, axis])
    return np.interp(points[:, axis], x[order, axis], pressure[order])


def zone_ends(result: am.Result) -> list[float]:
    """Places along the first contact boundary of a plane problem where the contact state changes, m."""
    mine = result.contact.boundary == 0
    x = result.contact.x[mine]
    place = np.linalg.norm(x - x[np.argmin(x[:, 0])], axis=1)
    order = np.argsort(place)
    state, place = result.contact.state[mine][order], place[order]
    change = np.flatnonzero(np.diff(state))
    return [float(0.5 * (place[k] + place[k + 1])) for k in change]


def displacements(case: Case, result: am.Result) -> np.ndarray:
    """The displacements of the case's points, m."""
    mesh = result.mesh
    values = []
    for position, component, body in case.points:
        found = PointLocator(mesh, None if body is None else mesh.bodies.index(body)).locate(np.array([position]))
        corners = result.displacement[mesh.elements[found.element[0]], component]
        values.append(float(found.weights[0] @ corners))
    return np.array(values)


def uniform_meshes(case: Case, problem: am.ContactProblem, refinements: int) -> list[MeshArrays]:
    """Nested uniform meshes, coarse to fine: structured, or by Netgen and refined everywhere."""
    if isinstance(case.coarse, int):
        return [structured(problem.domain, case.coarse * 2**k) for k in range(refinements + 1)]
    meshes = [graded(problem.domain, case.coarse, problem.pair_boundaries, 1)]
    for _ in range(refinements):
        meshes.append(bisect(meshes[-1], np.ones(len(meshes[-1].elements), dtype=bool))[0])
    # a coarser one cannot pose the problem
    return [mesh for mesh in meshes if len(mesh.boundary_nodes(problem.contact_boundaries[0])) >= 3]


def _between(axis: int, low: float, high: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda x: (x[:, axis] >= low) & (x[:, axis] <= high)


_GRECO = am.cases.greco_bar().reference["points"]
_SIDE, _PUNCH = 40 * MM, 10 * MM
#: of the dovetail's flank, from the mouth to its lower end
_FOOT = am.cases.dovetail().domain.parts["tongue"].vertices[2]

CASES: Mapping[str, Case] = {
    "GRECO bar": Case(
        problem=am.cases.greco_bar, start=(10 * MM, 1), coarse=4,
        points=[(point, 0, None) for point in _GRECO.values()], compared=_between(0, 0.0, _SIDE),
        force=("friction force", friction_force), graded=(20 * MM, 4),
        goal=am.Displacement(tuple(_GRECO.values()), "x")),
    "upset block": Case(
        problem=am.cases.upset_block, start=(10 * MM, 1), coarse=4,
        points=[((0.0, 0.5 * _SIDE), 0, None), ((0.0, _SIDE), 1, None)], compared=_between(0, 0.05 * _SIDE, _SIDE),
        force=("friction force", friction_force), graded=(20 * MM, 8), goal=am.ContactForce("contact", "x")),
    "flat punch": Case(
        problem=am.cases.flat_punch, start=(80 * MM, 16), coarse=40 * MM,
        points=[((0.0, -40 * _PUNCH), 1, None), ((2 * _PUNCH, 0.0), 1, None)],
        compared=_between(0, 0.0, 0.95 * _PUNCH), force=("pressure under the inner half", centre_pressure),
        graded=(80 * MM, 32), goal=am.Displacement((2 * _PUNCH, 0.0), "y")),
    "dovetail": Case(
        problem=am.cases.dovetail, start=(6 * MM, 1), coarse=6 * MM,
        points=[((0.0, 24 * MM), 1, "tongue"), ((12 * MM, 24 * MM), 1, "tongue")],
        compared=_between(1, 0.95 * _FOOT[1], 0.05 * _FOOT[1]), force=("force through the flank", pair_force),
        graded=(6 * MM, 6), goal=am.ContactForce("tongue.flank", "normal")),
    "bolted junction": Case(
        problem=am.cases.bolted_junction, start=(16 * MM, 1), coarse=12 * MM,
        points=[((0.2, 0.0), 1, "upper"), ((0.2, 0.0), 1, "lower")], compared=_between(0, 0.2, 0.27),
        force=("force through the joint", pair_force), graded=(16 * MM, 4),
        goal=am.Opening("upper.joint", (0.2, 0.0))),
    "upset block 3D": Case(
        problem=upset_block_3d, start=(20 * MM, 1), coarse=2, dim=3,
        points=[((0.0, 0.0, 0.5 * _SIDE), 0, None), ((0.0, _SIDE, _SIDE), 2, None)],
        compared=lambda x: (x[:, 0] >= 0.1 * _SIDE) & (x[:, 1] <= 0.9 * _SIDE),
        force=("friction force", friction_force), graded=(20 * MM, 3), goal=am.ContactForce("contact", "x")),
    "two blocks 3D": Case(
        problem=two_blocks_3d, start=(20 * MM, 1), coarse=2, dim=3,
        points=[((0.0, 0.0, _SIDE), 2, "upper"), ((_SIDE, 0.0, 0.5 * _SIDE), 0, "upper")],
        compared=lambda x: (x[:, :2] <= 0.9 * _SIDE).all(axis=1),
        force=("friction force", friction_force), graded=(20 * MM, 3), goal=am.ContactForce("upper.bottom", "x")),
}
#: strongest singularity, u ~ r^exponent: end of a contact zone, stick at a free corner, edge of a punch, corners of
#: 270 degrees; that of a free edge of one block on another of other stiffness is not known to us
EXPONENTS: Mapping[str, float] = {
    "GRECO bar": 1.39, "upset block": 0.781, "flat punch": 0.5, "dovetail": 0.5445, "bolted junction": 0.5445,
    "upset block 3D": 0.781, "two blocks 3D": float("nan")}
