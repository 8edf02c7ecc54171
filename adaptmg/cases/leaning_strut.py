r"""A leaning strut: with Coulomb friction the same load has three equilibria.

A strut clamped at its head leans by an angle :math:`\theta` to the normal of the plane before its foot, which is so
curved that one node touches. Along its axis it is stiff, across it soft, so that a force that would push the foot along
the plane also presses it on: for :math:`\mu > \tan\theta`, about, the foot may stick, slip or have lifted off, each in
exact equilibrium. Friction without uniqueness is no defect of a solver: which solution is found depends on the start.
"""

from __future__ import annotations

import math

import numpy as np

from adaptmg.problem import (
    Contact,
    ContactProblem,
    Coulomb,
    GapFunction,
    Law,
    PlaneStrain,
    Polygon,
    Support,
    Traction,
    checks,
)

__all__ = ["leaning_strut"]

_LENGTH, _WIDTH = 0.1, 0.02


def leaning_strut(*, law: Law = Coulomb(0.6), angle: float = 20.0, traction: float = 3e6,  # noqa: B008
                  direction: float = 4.5, young: float = 2e11, poisson: float = 0.3) -> ContactProblem:
    """A strut 100 mm long and 20 mm thick on a rigid plane; plane strain.

    Parameters
    ----------
    law : Law
        Of the foot.
    angle : float
        Of the strut to the normal of the plane, degrees, 0 < angle < 45.
    traction, direction : float
        Size (Pa) and direction (rad, from x to y) of the load on the right side.
    young, poisson : float
        Pa, and a number.

    Returns
    -------
    ContactProblem
        With the defaults one node open, slipping and sticking are all solutions.
    """
    angle = checks.positive("angle", angle)
    if not angle < 45:
        raise ValueError(f"angle must be below 45 degrees, got {angle!r}")
    traction, direction = checks.number("traction", traction), checks.number("direction", direction)
    along = _LENGTH * np.array([math.sin(math.radians(angle)), math.cos(math.radians(angle))])
    corners = np.array([[0.0, 0.0], [_WIDTH, 0.0], [_WIDTH + along[0], along[1]], along])
    return ContactProblem(
        name="leaning strut", law=law, material=PlaneStrain(young=young, poisson=poisson),
        domain=Polygon(vertices=tuple(map(tuple, corners.tolist())), boundaries=("foot", "right", "head", "left")),
        contact=Contact("foot", GapFunction(_curved)),
        loads=(Traction("right", (traction * math.cos(direction), traction * math.sin(direction))),),
        supports=(Support("head", x=0.0, y=0.0),))


def _curved(points: np.ndarray) -> np.ndarray:
    """Gap (n,) below the foot, radius 25 mm, m."""
    return 20.0 * (points[:, 0] - _WIDTH / 2) ** 2
