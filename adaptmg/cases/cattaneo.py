r"""Cattaneo's problem: a cylinder on a block of the same material, pressed first and then pulled sideways.

A tangential load Q < mu P makes the edges of the contact slip and leaves a strip of half-width c in its middle that
sticks. With the half-width a and the peak p0 of Hertz,

.. math:: \frac{c}{a} = \sqrt{1 - \frac{Q}{\mu P}},\qquad
   t(x) = \mu p_0 \Big[\sqrt{1 - x^2/a^2} - \frac{c}{a}\sqrt{1 - x^2/c^2}\Big]

with the second term within |x| < c only (C. Cattaneo 1938; K. L. Johnson, Contact Mechanics, 1985, section 7.2). It is
exact for half-planes of the same material, where normal and tangential tractions do not disturb each other.

The loads are posed so that both resultants are given and nothing can roll: the flat top of the half cylinder is held
in y and carries the tangential load, the block is guided between vertical walls and pressed up from below by P.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptmg import _checks as checks
from adaptmg.cases.hertz import MASTER_REACH, SLAVE_REACH, LineContact, closed_form, hertz_reference
from adaptmg.problem import (
    Assembly,
    ContactPair,
    ContactProblem,
    Coulomb,
    Law,
    LoadPath,
    Outline,
    PlaneStrain,
    Polygon,
    Pressure,
    Support,
    Traction,
)

__all__ = ["PartialSlip", "cattaneo", "cattaneo_path"]


@dataclass(frozen=True, kw_only=True)
class PartialSlip:
    """The closed form of Cattaneo.

    Parameters
    ----------
    normal : LineContact
        The normal contact.
    friction : float
        Coefficient, > 0.
    tangential : float
        Q, N/m, 0 <= Q < friction * P.
    """

    normal: LineContact
    friction: float
    tangential: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "friction", checks.positive("friction", self.friction))
        object.__setattr__(self, "tangential", checks.nonnegative("tangential", self.tangential))
        most = self.friction * self.normal.load
        if not self.tangential < most:
            raise ValueError(f"tangential must be below friction times load = {most:g} N/m, got {self.tangential!r}: "
                             "beyond, the cylinder slides off")

    @property
    def stick(self) -> float:
        """c, half the width of the strip that sticks, m."""
        return self.normal.half_width * math.sqrt(1 - self.tangential / (self.friction * self.normal.load))

    def traction(self, x: np.ndarray) -> np.ndarray:
        """Size of the tangential traction at x, Pa."""
        c, a = self.stick, self.normal.half_width
        inner = np.sqrt(np.maximum(0.0, 1 - (np.asarray(x) / c)**2))
        return self.friction * (self.normal.pressure(x) - self.normal.peak * (c / a) * inner)


def cattaneo(*, law: Law = Coulomb(0.3), load: float = 1e5, tangential: float = 1.5e4, radius: float = 50e-3,  # noqa: B008
             young: float = 2.1e11, poisson: float = 0.3) -> ContactProblem:
    """A cylinder on a block of the same material under a normal and a tangential load.

    Parameters
    ----------
    law : Law
        On the surface.
    load : float
        P, N/m.
    tangential : float
        Q on the cylinder in +x, N/m; with Coulomb friction below friction times ``load``.
    radius : float
        Of the cylinder, m.
    young, poisson : float
        Of both bodies, Pa, and a number.

    Returns
    -------
    ContactProblem
        Bodies "upper" (slave) and "lower", which touch at the origin. ``reference`` holds that of
        :func:`~adaptmg.cases.hertz.hertz_cylinder` and, with a constant coefficient of friction, ``stick``
        (c, m) and ``partial_slip`` (:class:`PartialSlip`).

    See Also
    --------
    cattaneo_path : the load history, first P, then Q.
    adaptmg.cases.hertz.line_contact_meshes : meshes.

    Notes
    -----
    Solved in one step under both loads the answer is the same to rounding as along :func:`cattaneo_path`: what little
    the normal load alone slips at the edges slips on under the tangential one, and never turns back.
    Bodies of finite size are strained along the surface by the loads, unlike half-planes, by stresses of the order of
    P/R: against the largest traction mu p0 this is of the order of a / (mu R), and it moves the strip that sticks.
    """
    radius = checks.quantity("radius", radius, positive=True)
    material = PlaneStrain(young=young, poisson=poisson)
    form = closed_form(load, radius, None, material)
    tangential = checks.nonnegative("tangential", tangential)
    reference: Mapping[str, Any] = hertz_reference(form)
    if isinstance(law, Coulomb) and not callable(law.friction) and np.ndim(law.friction) == 0:
        slip = PartialSlip(normal=form, friction=float(law.friction), tangential=tangential)
        sources = {**reference["sources"], "partial_slip": "Cattaneo; Johnson, Contact Mechanics, section 7.2"}
        reference = {**reference, "stick": slip.stick, "partial_slip": slip, "sources": sources}
    return ContactProblem(
        name="Cattaneo",
        material=material,
        domain=Assembly(parts={"upper": _half_cylinder(radius, form.half_width),
                               "lower": _whole_block(radius, form.half_width)}),
        contact=ContactPair("upper.contact", "lower.contact"),
        law=law,
        loads=(Pressure("lower.bottom", form.load / (2 * radius)),
               Traction("upper.top", (tangential / (2 * radius), 0.0))),
        supports=(Support("upper.top", y=0.0), Support("lower.left", x=0.0), Support("lower.right", x=0.0)),
        reference=reference,
    )


def cattaneo_path(steps: int = 1) -> LoadPath:
    """The load history: P in one step, then Q in equal steps.

    Parameters
    ----------
    steps : int
        Of the tangential load, >= 1.
    """
    steps = checks.integer("steps", steps, 1)
    return LoadPath({"lower.bottom": 1.0, "upper.top": np.arange(steps + 1) / steps})


def _half_cylinder(radius: float, a: float) -> Outline:
    """Flat at its middle plane y = radius."""
    turn = math.asin(min(SLAVE_REACH * a / radius, math.sqrt(0.5)))
    x, y = radius * math.sin(turn), 2 * radius * math.sin(0.5 * turn)**2
    center = (0.0, radius)
    return Outline(vertices=((-radius, radius), (-x, y), (0.0, 0.0), (x, y), (radius, radius)),
                   boundaries=("side", "contact", "contact", "side", "top"),
                   arcs={0: center, 1: center, 2: center, 3: center})


def _whole_block(size: float, a: float) -> Polygon:
    edge = min(MASTER_REACH * a, 0.75 * size)
    return Polygon(vertices=((-size, -size), (size, -size), (size, 0.0), (edge, 0.0), (-edge, 0.0), (-size, 0.0)),
                   boundaries=("bottom", "right", "top", "contact", "top", "left"))
