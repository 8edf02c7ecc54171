"""The square of the GRECO bar in front of a curved obstacle: a frictionless case in which the contact zone is unknown.

The gap under the bottom is (a - x)^2 / (2 R), the parabola of a cylinder of radius R that touches at x = a. With the
default parameters the right half of the bottom comes into contact (17 of the 33 contact nodes of the uniform mesh of
32 x 32 cells), unlike in the frictionless GRECO bar, which is a patch test.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from adaptmg.cases.greco import greco_bar
from adaptmg.problem import Contact, ContactProblem, Frictionless, GapFunction, Law, checks

__all__ = ["ParabolicGap", "curved_obstacle"]


@dataclass(frozen=True)
class ParabolicGap:
    """The gap (position - x)^2 / (2 radius); a class, so that problems can be pickled.

    Parameters
    ----------
    position : float
        x at which the obstacle touches, m.
    radius : float
        Radius of curvature, m.
    """

    position: float
    radius: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Gaps (n,) at points (n, dim), m."""
        return (self.position - points[:, 0])**2 / (2 * self.radius)


def curved_obstacle(*, law: Law = Frictionless(), radius: float = 10.0, top_pressure: float = 5e7,  # noqa: B008
                    side_pressure: float = 15e7, young: float = 1.3e11, poisson: float = 0.2, size: float = 40e-3
                    ) -> ContactProblem:
    """The GRECO bar's body, loads and supports in front of a curved obstacle.

    Parameters
    ----------
    law : Law
        On the bottom.
    radius : float
        Radius of curvature of the obstacle, m.
    top_pressure, side_pressure, young, poisson, size : float
        As in :func:`~adaptmg.cases.greco.greco_bar`.

    Returns
    -------
    ContactProblem
        ``reference`` holds, for the default parameters, ``touching``: contact nodes that touch, by divisions of the
        uniform mesh.
    """
    bar = greco_bar(law=law, top_pressure=top_pressure, side_pressure=side_pressure, young=young, poisson=poisson,
                    size=size)
    default = (isinstance(law, Frictionless) and (radius, top_pressure, side_pressure, young, poisson, size)
               == (10.0, 5e7, 15e7, 1.3e11, 0.2, 40e-3))
    reference = {"touching": {32: 17}, "sources": {"touching": "direct active-set solve"}} if default else {}
    gap = ParabolicGap(position=float(size), radius=checks.quantity("radius", radius, positive=True))
    return replace(bar, name="curved obstacle", contact=Contact("bottom", GapFunction(gap)), reference=reference)
