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
from dataclasses import dataclass

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.cases.hertz import SLAVE_REACH, LineContact, block_contact, on_circle
from adaptmg.problem import Law


@dataclass(frozen=True, kw_only=True)
class PartialSlip:
    """The closed form of Cattaneo.

    Examples
    --------
    >>> line = am.cases.LineContact(load=1e5, radius=0.05, modulus=1.15e11)
    >>> slip = am.cases.PartialSlip(normal=line, friction=0.3, tangential=1.5e4)
    >>> slip.friction
    0.3
    """

    normal: LineContact  # the normal contact
    friction: float  # coefficient, > 0
    tangential: float  # Q, N/m, 0 <= Q < friction * P

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
        """Return the size of the tangential traction at x, Pa."""
        c, a = self.stick, self.normal.half_width
        inner = np.sqrt(np.maximum(0.0, 1 - (np.asarray(x) / c)**2))
        return self.friction * (self.normal.pressure(x) - self.normal.peak * (c / a) * inner)


def cattaneo(*, law: Law = am.Coulomb(0.3), load: float = 1e5, tangential: float = 1.5e4, radius: float = 50e-3,  # noqa: B008
             young: float = 2.1e11, poisson: float = 0.3) -> am.ContactProblem:
    """Pose a cylinder on a block of the same material under a normal and a tangential load.

    Bodies and meshes are those of :func:`~adaptmg.cases.hertz.hertz_cylinder`; ``reference`` also holds, with a
    constant coefficient of friction, ``stick`` (c, m) and ``partial_slip`` (:class:`PartialSlip`).

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

    Notes
    -----
    Solved in one step under both loads the answer is the same to rounding as along the path
    ``LoadPath({"lower.bottom": 1.0, "upper.top": [0.0, 1.0]})``: the slip under the normal load alone continues under
    the tangential one. Bodies of finite size are strained along the surface by stresses of the order of P/R, a / (mu R)
    of the largest traction, which moves the strip that sticks.

    Examples
    --------
    >>> am.cases.cattaneo(tangential=1e4).dim
    2
    """
    radius = checks.quantity("radius", radius, positive=True)
    material = am.PlaneStrain(young=young, poisson=poisson)
    form = LineContact.of(load, radius, None, material)
    tangential = checks.nonnegative("tangential", tangential)
    reference = form.reference()
    if isinstance(law, am.Coulomb) and not callable(law.friction) and np.ndim(law.friction) == 0:
        slip = PartialSlip(normal=form, friction=float(law.friction), tangential=tangential)
        sources = {**reference["sources"], "partial_slip": "Cattaneo; Johnson, Contact Mechanics, section 7.2"}
        reference |= {"stick": slip.stick, "partial_slip": slip, "sources": sources}
    return am.ContactProblem(
        name="Cattaneo", material=material,
        domain=am.Assembly(parts={"upper": _half_cylinder(radius, form.half_width),
                               "lower": _whole_block(radius, form.half_width)}),
        contact=am.ContactPair("upper.contact", "lower.contact"), law=law,
        loads=(am.Pressure("lower.bottom", form.load / (2 * radius)),
               am.Traction("upper.top", (tangential / (2 * radius), 0.0))),
        supports=(am.Support("upper.top", y=0.0), am.Support("lower.left", x=0.0), am.Support("lower.right", x=0.0)),
        reference=reference)


def _half_cylinder(radius: float, a: float) -> am.Outline:
    (x, y), center = on_circle(radius, SLAVE_REACH * a), (0.0, radius)
    return am.Outline(vertices=((-radius, radius), (-x, y), (0.0, 0.0), (x, y), (radius, radius)),
                   boundaries=("side", "contact", "contact", "side", "top"),
                   arcs=dict.fromkeys(range(4), center))


def _whole_block(size: float, a: float) -> am.Polygon:
    edge = block_contact(size, a)
    return am.Polygon(vertices=((-size, -size), (size, -size), (size, 0.0), (edge, 0.0), (-edge, 0.0), (-size, 0.0)),
                   boundaries=("bottom", "right", "top", "contact", "top", "left"))
