r"""Contact of round bodies after Hertz: cylinders (line contact) or balls (point contact) on a block or each other.

With the load P (per length for cylinders), the relative curvature :math:`1/R = 1/R_1 + 1/R_2` and the contact modulus
:math:`E^* = E / (2 (1 - \nu^2))` of two bodies of one material, the pressure is :math:`p_0 \sqrt{1 - x^2/a^2}` with

.. math:: a = \sqrt{\frac{4 P R}{\pi E^*}},\quad p_0 = \frac{2P}{\pi a}\qquad\text{(line)};\qquad
   a = \Big(\frac{3 P R}{4 E^*}\Big)^{1/3},\quad p_0 = \frac{3P}{2\pi a^2},\quad \delta = \frac{a^2}{R}\qquad
   \text{(point; delta: approach of distant points)}

(K. L. Johnson, Contact Mechanics, 1985, section 4.2). They hold for a much smaller than the radii and the bodies: the
problems here differ from them by terms of the order of (a/R)^2. They are a quarter of the section (x >= 0): the flat
top of the upper body is pressed down, the bottom of the lower one is held. Only a part of the curved surface, ten
half-widths long, is named "contact". In 3D the section is turned by 90 degrees.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.problem import Elastic, Law

# the largest half-width over the smallest radius
_LARGEST = 0.1
# lengths of the surfaces that may touch, in half-widths; the master reaches further than the slave
SLAVE_REACH, MASTER_REACH = 10.0, 14.0


@dataclass(frozen=True, kw_only=True)
class HertzContact(ABC):
    """A pressure that falls like half an ellipse from the middle of contact."""

    load: float  # P, > 0: N/m in line contact, N in point contact
    radius: float  # R, of the relative curvature, m, > 0
    modulus: float  # the contact modulus E*, Pa, > 0
    words: ClassVar[tuple[str, str]]

    def __post_init__(self) -> None:
        checks.convert(self, checks.positive, "load", "radius", "modulus")

    @classmethod
    def of(cls, load: float, radius: float, lower_radius: float | None, material: Elastic) -> HertzContact:
        """Return the closed form for two bodies of one material; ValueError where it does not hold."""
        curvature = 1 / radius + (0.0 if lower_radius is None else 1 / lower_radius)
        form = cls(load=load, radius=1 / curvature, modulus=material.young / (2 * (1 - material.poisson**2)))
        smallest = min(radius, lower_radius or radius)
        if not form.half_width <= _LARGEST * smallest:
            raise ValueError(f"load {load!r} makes a contact of half-width {form.half_width:.3g} m, more than a tenth "
                             f"of the radius {smallest:g} m: Hertz does not hold there")
        return form

    @property
    @abstractmethod
    def half_width(self) -> float:
        """a, half the width or the radius of contact, m."""

    @property
    @abstractmethod
    def peak(self) -> float:
        """p0, Pa."""

    def pressure(self, distance: np.ndarray) -> np.ndarray:
        """Return the pressure at distances from the middle (m), Pa."""
        return self.peak * np.sqrt(np.maximum(0.0, 1 - (np.asarray(distance) / self.half_width)**2))

    def reference(self) -> dict[str, object]:
        """Return the reference of a problem with this closed form."""
        width, spaces = self.words
        return {"quantity": f"{width}, m, and largest pressure, Pa", "half_width": self.half_width, "peak": self.peak,
                "closed_form": self, "sources": {"closed_form": "Hertz; Johnson, Contact Mechanics, section 4.2"},
                "remark": f"Exact for {spaces}; bodies of finite size differ by terms of the order of (a/R)^2."}


@dataclass(frozen=True, kw_only=True)
class LineContact(HertzContact):
    """The closed form of Hertz for line contact; ``load`` in N/m.

    Examples
    --------
    >>> line = am.cases.LineContact(load=1e5, radius=0.05, modulus=1.15e11)
    >>> round(1e3 * line.half_width, 3)                               # mm
    0.235
    """

    words: ClassVar[tuple[str, str]] = ("half-width", "half-planes")

    @property
    def half_width(self) -> float:
        """a, m."""
        return math.sqrt(4 * self.load * self.radius / (math.pi * self.modulus))

    @property
    def peak(self) -> float:
        """p0, Pa."""
        return 2 * self.load / (math.pi * self.half_width)


@dataclass(frozen=True, kw_only=True)
class PointContact(HertzContact):
    """The closed form of Hertz for point contact; ``load`` in N.

    Examples
    --------
    >>> point = am.cases.PointContact(load=100.0, radius=0.01, modulus=1.15e11)
    >>> point.radius
    0.01
    """

    words: ClassVar[tuple[str, str]] = ("radius of contact", "half-spaces")

    @property
    def half_width(self) -> float:
        """a, the radius of contact, m."""
        return math.cbrt(0.75 * self.load * self.radius / self.modulus)

    @property
    def peak(self) -> float:
        """p0, Pa."""
        return 1.5 * self.load / (math.pi * self.half_width**2)

    @property
    def approach(self) -> float:
        """The approach of points far from contact, m."""
        return self.half_width**2 / self.radius

    def reference(self) -> dict[str, object]:
        """Return the reference of a problem with this closed form."""
        return {**super().reference(), "approach": self.approach}


def hertz_cylinder(*, law: Law = am.Frictionless(), load: float = 1e6, radius: float = 50e-3,  # noqa: B008
                   lower_radius: float | None = None, young: float = 2.1e11, poisson: float = 0.3) -> am.ContactProblem:
    """Pose a cylinder on a block, or on another cylinder; plane strain, one half by symmetry.

    Bodies "upper" (slave) and "lower", which touch at the origin. ``reference`` holds ``half_width`` (m), ``peak``
    (Pa), ``closed_form`` (:class:`LineContact`), ``sources`` and ``remark``. Meshes should be fine at the origin
    (:class:`adaptmg.SizeNear`).

    Parameters
    ----------
    law : Law
        On the surface; with equal materials friction changes nothing but terms of the order of a/R.
    load : float
        P of the whole cylinder, N/m; the half carries P/2.
    radius : float
        Of the cylinder, m, at least ten half-widths of contact.
    lower_radius : float, optional
        Of the body below, m; None for a block with a flat top.
    young, poisson : float
        Of both bodies, Pa, and a number.

    Examples
    --------
    >>> am.cases.hertz_cylinder().dim
    2
    """
    radius, lower_radius = _radii(radius, lower_radius)
    material = am.PlaneStrain(young=young, poisson=poisson)
    form = LineContact.of(load, radius, lower_radius, material)
    return _posed(form, "cylinder on block" if lower_radius is None else "two cylinders", material, law,
                  _sections(radius, lower_radius, form.half_width), form.load / (2 * radius))


def hertz_sphere(*, law: Law = am.Frictionless(), dim: int = 2, load: float = 1300.0, radius: float = 50e-3,  # noqa: B008
                 lower_radius: float | None = None, young: float = 2.1e11, poisson: float = 0.3) -> am.ContactProblem:
    """Pose a ball on a block, or on another ball.

    ``reference`` is that of :func:`hertz_cylinder` with a :class:`PointContact`, and ``approach`` (m).

    Parameters
    ----------
    law, lower_radius, young, poisson : see :func:`~adaptmg.cases.hertz.hertz_cylinder`
    dim : {2, 3}
        2 is axisymmetric (x is the radius, y the axis), 3 a quarter of the full turn (z is the axis).
    load : float
        P on the whole ball, N; a quarter carries P/4.
    radius : float
        Of the ball, m, at least ten radii of contact.

    Examples
    --------
    >>> am.cases.hertz_sphere().axisymmetric
    True
    """
    checks.choice("dim", dim, (2, 3))
    radius, lower_radius = _radii(radius, lower_radius)
    material = (am.Axisymmetric if dim == 2 else am.Solid)(young=young, poisson=poisson)
    form = PointContact.of(load, radius, lower_radius, material)
    return _posed(form, "ball on block" if lower_radius is None else "two balls", material, law,
                  _sections(radius, lower_radius, form.half_width), form.load / (math.pi * radius**2))


def _radii(radius: float, lower_radius: float | None) -> tuple[float, float | None]:
    return (checks.quantity("radius", radius, positive=True),
            None if lower_radius is None else checks.quantity("lower_radius", lower_radius, positive=True))


def _posed(form: HertzContact, name: str, material: Elastic, law: Law, sections: dict[str, am.Outline | am.Polygon],
           pressure: float) -> am.ContactProblem:
    supports, parts = [am.Support("upper.symmetry", x=0.0), am.Support("lower.symmetry", x=0.0)], sections
    if material.dim == 3:
        parts = {body: am.Revolution(section, 90.0) for body, section in sections.items()}
        supports = [am.Support(f"{body}.{side}", **{axis: 0.0}) for body in parts
                    for side, axis in (("start", "y"), ("end", "x"))]
    supports.append(am.Support("lower.bottom", **{"y" if material.dim == 2 else "z": 0.0}))
    return am.ContactProblem(
        name=f"Hertz, {name}", material=material, domain=am.Assembly(parts=parts), law=law, supports=supports,
        # the weighted gap at the pole, of chords seen along turning normals, is negative by terms of the order of h^4
        contact=am.ContactPair("upper.contact", "lower.contact", allow_interference=True),
        loads=(am.Pressure("upper.top", pressure),), reference=form.reference())


def _sections(radius: float, lower_radius: float | None, a: float) -> dict[str, am.Outline | am.Polygon]:
    if lower_radius is not None:
        lower = quarter_cylinder(lower_radius, MASTER_REACH * a, above=False)
    else:
        edge = block_contact(radius, a)
        lower = am.Polygon(vertices=((0.0, -radius), (radius, -radius), (radius, 0.0), (edge, 0.0), (0.0, 0.0)),
                        boundaries=("bottom", "side", "top", "contact", "symmetry"))
    return {"upper": quarter_cylinder(radius, SLAVE_REACH * a, above=True), "lower": lower}


def block_contact(size: float, a: float) -> float:
    """Return the x at which the contact boundary on a block ends: 14 half-widths a, at most 3/4 of the block."""
    return min(MASTER_REACH * a, 0.75 * size)


def quarter_cylinder(radius: float, contact: float, *, above: bool) -> am.Outline:
    """Return the quarter x >= 0 of a cylinder that touches the origin from above or below, flat at its middle plane."""
    x, y = on_circle(radius, contact)
    if above:
        return am.Outline(vertices=((0.0, 0.0), (x, y), (radius, radius), (0.0, radius)),
                       boundaries=("contact", "side", "top", "symmetry"), arcs={0: (0.0, radius), 1: (0.0, radius)})
    return am.Outline(vertices=((0.0, 0.0), (0.0, -radius), (radius, -radius), (x, -y)),
                   boundaries=("symmetry", "bottom", "side", "contact"), arcs={2: (0.0, -radius), 3: (0.0, -radius)})


def on_circle(radius: float, contact: float) -> tuple[float, float]:
    """Return the point of the circle on the origin at x = contact, at most at 45 degrees."""
    turn = math.asin(min(contact / radius, math.sqrt(0.5)))
    return radius * math.sin(turn), 2 * radius * math.sin(0.5 * turn)**2
