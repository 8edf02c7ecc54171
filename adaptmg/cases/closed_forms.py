r"""Closed forms of contact: round bodies after Hertz, partial slip after Cattaneo, and a flat punch.

Hertz: cylinders (line contact) or balls (point contact) on a block or each other.

With the load P (per length for cylinders), the relative curvature :math:`1/R = 1/R_1 + 1/R_2` and the contact modulus
:math:`E^* = E / (2 (1 - \nu^2))` of two bodies of one material, the pressure is :math:`p_0 \sqrt{1 - x^2/a^2}` with

.. math:: a = \sqrt{\frac{4 P R}{\pi E^*}},\quad p_0 = \frac{2P}{\pi a}\qquad\text{(line)};\qquad
   a = \Big(\frac{3 P R}{4 E^*}\Big)^{1/3},\quad p_0 = \frac{3P}{2\pi a^2},\quad \delta = \frac{a^2}{R}\qquad
   \text{(point; delta: approach of distant points)}

(K. L. Johnson, Contact Mechanics, 1985, section 4.2). They hold for a much smaller than the radii and the bodies: the
problems here differ from them by terms of the order of (a/R)^2. They are a quarter of the section (x >= 0): the flat
top of the upper body is pressed down, the bottom of the lower one is held. Only a part of the curved surface, ten
half-widths long, is named "contact". In 3D the section is turned by 90 degrees.

Cattaneo's problem: a cylinder on a block of the same material, pressed first and then pulled sideways.

A tangential load Q < mu P makes the edges of the contact slip and leaves a strip of half-width c in its middle that
sticks. With the half-width a and the peak p0 of Hertz,

.. math:: \frac{c}{a} = \sqrt{1 - \frac{Q}{\mu P}},\qquad
   t(x) = \mu p_0 \Big[\sqrt{1 - x^2/a^2} - \frac{c}{a}\sqrt{1 - x^2/c^2}\Big]

with the second term within |x| < c only (C. Cattaneo 1938; K. L. Johnson, Contact Mechanics, 1985, section 7.2). It is
exact for half-planes of the same material, where normal and tangential tractions do not disturb each other.

The loads are posed so that both resultants are given and nothing can roll: the flat top of the half cylinder is held
in y and carries the tangential load, the block is guided between vertical walls and pressed up from below by P.

Flat punch: a flat rigid punch without friction on an elastic half-plane.

The punch is a rigid plane that ends: only the part |x| < a of the block's top is called "contact" and lies against the
plane y = 0. The block, guided at its plane of symmetry, is pressed up against it from below by the load P per length.
For the half-plane

.. math:: p(x) = \frac{P}{\pi\sqrt{a^2 - x^2}}

(K. L. Johnson, Contact Mechanics, 1985, section 2.8), singular at the edge: u ~ r^(1/2), so that uniform meshes
converge like N^(-1/4) in the energy norm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.problem import Elastic, Law

# the largest half-width over the smallest radius
_LARGEST = 0.1
# lengths of the surfaces that may touch, in half-widths; the master reaches further than the slave
SLAVE_REACH, MASTER_REACH = 10.0, 14.0


@dataclass(frozen=True, kw_only=True)
class HertzContact:
    """A pressure that falls like half an ellipse from the middle of contact."""

    load: float  # P, > 0: N/m in line contact, N in point contact
    radius: float  # R, of the relative curvature, m, > 0
    modulus: float  # the contact modulus E*, Pa, > 0
    words: ClassVar[tuple[str, str]]
    #: a, half the width or the radius of contact, m; p0, Pa
    half_width: ClassVar[Any]
    peak: ClassVar[Any]

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
    law, lower_radius, young, poisson : see :func:`~adaptmg.cases.hertz_cylinder`
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

    Bodies and meshes are those of :func:`~adaptmg.cases.hertz_cylinder`; ``reference`` also holds, with a
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


# depth and half the width of the block, in half-widths of the punch
_SIZE = 40.0


@dataclass(frozen=True, kw_only=True)
class PunchPressure:
    """The pressure P / (pi sqrt(a^2 - x^2)) under a flat rigid punch.

    Examples
    --------
    >>> am.cases.PunchPressure(load=1e5, half_width=0.01).half_width
    0.01
    """

    load: float  # P, N/m
    half_width: float  # a, m

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Pressure at |x| < a, Pa."""
        return self.load / (math.pi * np.sqrt(self.half_width**2 - np.asarray(x)**2))


def flat_punch(*, law: Law = am.Frictionless(), load: float = 1e6, half_width: float = 10e-3,  # noqa: B008
               young: float = 2.1e11, poisson: float = 0.3) -> am.ContactProblem:
    """Pose a flat rigid punch on a block 40 half-widths deep and 80 wide; plane strain, one half by symmetry.

    ``reference`` holds, without friction, ``pressure`` (:class:`PunchPressure`, of x in m), ``exponent`` (of the
    singularity at the edge) and ``sources``.

    Parameters
    ----------
    law : Law
        Under the punch; the closed form is that without friction.
    load : float
        P of the whole punch, N/m, > 0.
    half_width : float
        a, m.
    young, poisson : float
        Of the block, Pa, and a number.

    Examples
    --------
    >>> am.cases.flat_punch().dim
    2
    """
    a, load = checks.quantity("half_width", half_width, positive=True), checks.quantity("load", load, positive=True)
    reference = {}
    if isinstance(law, am.Frictionless):
        reference = {"quantity": "contact pressure, Pa", "pressure": PunchPressure(load=load, half_width=a),
                     "exponent": 0.5, "half_width": a,
                     "sources": {"pressure": "Johnson, Contact Mechanics, section 2.8, for a half-plane"},
                     "remark": "The block is finite: the difference is of the order of (a / depth)^2, .1 %."}
    size = _SIZE * a
    return am.ContactProblem(
        name="flat punch", material=am.PlaneStrain(young=young, poisson=poisson),
        domain=am.Polygon(vertices=((0.0, -size), (size, -size), (size, 0.0), (a, 0.0), (0.0, 0.0)),
                       boundaries=("bottom", "side", "free", "contact", "symmetry")),
        contact=am.Contact("contact", am.Plane(point=(0.0, 0.0), normal=(0.0, -1.0))), law=law,
        loads=(am.Pressure("bottom", load / (2 * size)),), supports=(am.Support("symmetry", x=0.0),),
        reference=reference)
