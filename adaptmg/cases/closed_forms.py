r"""Closed forms of contact: round bodies after Hertz, partial slip after Cattaneo, and a flat
punch.

Hertz: with the load P (per length for cylinders), the relative curvature :math:`1/R = 1/R_1 +
1/R_2` and the contact modulus :math:`E^* = E / (2 (1 - \nu^2))` of two bodies of one material the
pressure is :math:`p_0 \sqrt{1 - x^2/a^2}`,

.. math:: a = \sqrt{\frac{4 P R}{\pi E^*}},\quad p_0 = \frac{2P}{\pi a}\qquad\text{(line)};\qquad
   a = \Big(\frac{3 P R}{4 E^*}\Big)^{1/3},\quad p_0 = \frac{3P}{2\pi a^2},\quad \delta = \frac{a^2}{R}\qquad
   \text{(point; delta: approach of distant points)}

(K. L. Johnson, Contact Mechanics, 1985, section 4.2), up to terms of the order of (a/R)^2. The
problems are a quarter of the section (x >= 0), in 3D turned by 90 degrees: the flat top of the
upper body is pressed down, the bottom of the lower one is held. Only a part of the curved surface,
five half-widths long, is named "contact": default meshes have 13 nodes on a half-width.

Cattaneo: a tangential load Q < mu P on a pressed cylinder makes the edges of the contact slip and
leaves a strip of half-width c in its middle that sticks,

.. math:: \frac{c}{a} = \sqrt{1 - \frac{Q}{\mu P}},\qquad
   t(x) = \mu p_0 \Big[\sqrt{1 - x^2/a^2} - \frac{c}{a}\sqrt{1 - x^2/c^2}\Big]

with the second term within |x| < c only (C. Cattaneo 1938; Johnson, section 7.2): exact for
half-planes of one material, where normal and tangential tractions do not disturb each other. Both
resultants are given and nothing can roll: the flat top of the half cylinder is held in y and
carries Q, the block is guided between vertical walls and pressed up by P.

Flat punch: under a flat rigid punch of half-width a the pressure on a half-plane is

.. math:: p(x) = \frac{P}{\pi\sqrt{a^2 - x^2}}

(Johnson, section 2.8), singular at the edge: u ~ r^(1/2), and uniform meshes converge like N^(-1/4)
in the energy norm. The punch is the plane y = 0 over the part |x| < a of the block's top; the block
is pressed up against it by P."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Annotated, cast

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.cases.paper import constant_friction
from adaptmg.problem import Elastic, Law

# the largest half-width over the smallest radius: measured on default meshes of two cylinders, peaks
# are 3.4 % above Hertz's at .02, .05 and .1, 4.1 % at .2
_LARGEST = 0.1
# lengths of the surfaces that may touch, in half-widths (balls in space: half of these); the master reaches further
# than the slave
SLAVE_REACH, MASTER_REACH = 5.0, 7.0


@dataclass(frozen=True, kw_only=True)
class HertzContact(checks.Checked):
    """The closed form of Hertz: a pressure that falls like half an ellipse from the middle of
    contact.

    Examples
    --------
    >>> line = am.cases.HertzContact(load=1e5, radius=0.05, modulus=1.15e11)
    >>> round(1e3 * line.half_width, 3)                               # mm
    0.235
    """

    load: checks.Positive  # P: N/m in line contact, N in point contact
    radius: checks.Positive  # R, of the relative curvature, m
    modulus: checks.Positive  # the contact modulus E*, Pa
    point: checks.Flag = False  # point contact, of balls; else line contact, of cylinders

    @property
    def half_width(self) -> float:
        """Return a, half the width or the radius of contact, m."""
        if self.point:
            return math.cbrt(0.75 * self.load * self.radius / self.modulus)
        return math.sqrt(4 * self.load * self.radius / (math.pi * self.modulus))

    @property
    def peak(self) -> float:
        """Return p0, Pa."""
        a = self.half_width
        return 1.5 * self.load / (math.pi * a**2) if self.point else 2 * self.load / (math.pi * a)

    def pressure(self, distance: np.ndarray) -> np.ndarray:
        """Return the pressure at distances from the middle (m), Pa."""
        distances = checks.array("distance", distance, np.shape(distance))
        return self.peak * np.sqrt(np.maximum(0.0, 1 - (distances / self.half_width) ** 2))


def _form(
    load: float, radius: float, lower_radius: float | None, material: Elastic, point: bool
) -> HertzContact:
    """Return the closed form for two bodies of one material; ValueError where it does not hold."""
    radii = [checks.quantity("radius", radius, positive=True)]
    if lower_radius is not None:
        radii.append(checks.quantity("lower_radius", lower_radius, positive=True))
    form = HertzContact(
        load=load,
        radius=1 / sum(1 / r for r in radii),
        point=point,
        modulus=material.young / (2 * (1 - material.poisson**2)),
    )
    if not form.half_width <= _LARGEST * min(radii):
        raise ValueError(
            f"load {load!r} makes a contact of half-width {form.half_width:.3g} m, more than a tenth of "
            f"the radius {min(radii):g} m: Hertz does not hold there"
        )
    return form


def _reference(form: HertzContact) -> dict[str, object]:
    """Return the reference values of a contact after Hertz."""
    width, spaces = (
        ("radius of contact", "half-spaces") if form.point else ("half-width", "half-planes")
    )
    return {
        "quantity": f"{width}, m, and largest pressure, Pa",
        "half_width": form.half_width,
        "peak": form.peak,
        **({"approach": form.half_width**2 / form.radius} if form.point else {}),
        "closed_form": form,
        "sources": {"closed_form": "Hertz; Johnson, Contact Mechanics, section 4.2"},
        "remark": f"Exact for {spaces}; bodies of finite size differ by terms of the order of (a/R)^2.",
    }


def hertz_cylinder(
    *,
    law: Law = am.Frictionless(),
    load: float = 1e6,
    radius: float = 50e-3,
    lower_radius: float | None = None,
    young: float = 2.1e11,
    poisson: float = 0.3,
) -> am.ContactProblem:
    """Pose a cylinder on a block, or on another cylinder; plane strain, one half by symmetry.

    Bodies "upper" (slave) and "lower", which touch at the origin. ``reference`` holds ``quantity``
    (as text), ``half_width`` (m), ``peak`` (Pa), ``closed_form`` (:class:`HertzContact`), ``sources`` and
    ``remark``. Meshes should be fine at the origin (:class:`adaptmg.SizeNear`).

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
    material = am.PlaneStrain(young=young, poisson=poisson)
    form = _form(load, radius, lower_radius, material, point=False)
    return _posed(
        form,
        "cylinder on block" if lower_radius is None else "two cylinders",
        material,
        law,
        _sections(radius, lower_radius, form.half_width),
        form.load / (2 * radius),
    )


def hertz_sphere(
    *,
    law: Law = am.Frictionless(),
    dim: int = 2,
    load: float = 1300.0,
    radius: float = 50e-3,
    lower_radius: float | None = None,
    young: float = 2.1e11,
    poisson: float = 0.3,
) -> am.ContactProblem:
    """Pose a ball on a block, or on another ball.

    ``reference`` is that of :func:`hertz_cylinder`, and ``approach`` (m).

    Parameters
    ----------
    law, lower_radius, young, poisson : see :func:`~adaptmg.cases.hertz_cylinder`
    dim : {2, 3}
        2 is axisymmetric (x is the radius, y the axis), 3 a quarter of the full turn (z is the
        axis).
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
    material = (am.Axisymmetric if dim == 2 else am.Solid)(young=young, poisson=poisson)
    form = _form(load, radius, lower_radius, material, point=True)
    return _posed(
        form,
        "ball on block" if lower_radius is None else "two balls",
        material,
        law,
        # in space, where they hold most nodes of a mesh, contact boundaries reach half as far
        _sections(radius, lower_radius, form.half_width / (dim - 1)),
        form.load / (math.pi * radius**2),
    )


def _posed(
    form: HertzContact,
    name: str,
    material: Elastic,
    law: Law,
    sections: dict[str, am.Outline | am.Polygon],
    pressure: float,
) -> am.ContactProblem:
    """Return the problem of two bodies with these sections, under a pressure on the upper one; in
    space a quarter of their revolutions."""
    supports = [am.Support("upper.symmetry", x=0.0), am.Support("lower.symmetry", x=0.0)]
    parts = sections
    if material.dim == 3:
        parts = {body: am.Revolution(section, 90.0) for body, section in sections.items()}
        supports = [
            support
            for body in parts
            for support in (am.Support(f"{body}.start", y=0.0), am.Support(f"{body}.end", x=0.0))
        ]
    plane = material.dim == 2
    held = am.Support("lower.bottom", y=0.0) if plane else am.Support("lower.bottom", z=0.0)
    supports.append(held)
    return am.ContactProblem(
        name=f"Hertz, {name}",
        material=material,
        domain=am.Assembly(parts=parts),
        law=law,
        supports=supports,
        # the weighted gap at the pole, of chords seen along turning normals, is negative by terms
        # of the order of h^4
        contact=am.ContactPair("upper.contact", "lower.contact", allow_interference=True),
        loads=(am.Pressure("upper.top", pressure),),
        reference=_reference(form),
    )


def _sections(
    radius: float, lower_radius: float | None, a: float
) -> dict[str, am.Outline | am.Polygon]:
    """Return the sections of a round body and of the body below it, for a contact of half-width a;
    the lower one is a block where ``lower_radius`` is None."""
    if lower_radius is not None:
        lower = quarter_cylinder(lower_radius, MASTER_REACH * a, above=False)
    else:
        lower = am.Polygon(
            vertices=(
                (0.0, -radius),
                (radius, -radius),
                (radius, 0.0),
                (_block_contact(radius, a), 0.0),
                (0.0, 0.0),
            ),
            boundaries=("bottom", "side", "top", "contact", "symmetry"),
        )
    return {"upper": quarter_cylinder(radius, SLAVE_REACH * a, above=True), "lower": lower}


def _block_contact(size: float, a: float) -> float:
    """Return the x at which the contact boundary on a block ends: 7 half-widths a, at most 3/4 of the
    block."""
    return min(MASTER_REACH * a, 0.75 * size)


def quarter_cylinder(radius: float, contact: float, *, above: bool) -> am.Outline:
    """Return the quarter x >= 0 of a cylinder that touches the origin from above or below, flat at
    its middle plane."""
    x, y = _on_circle(radius, contact)
    if above:
        return am.Outline(
            vertices=((0.0, 0.0), (x, y), (radius, radius), (0.0, radius)),
            boundaries=("contact", "side", "top", "symmetry"),
            arcs=dict.fromkeys((0, 1), (0.0, radius)),
        )
    return am.Outline(
        vertices=((0.0, 0.0), (0.0, -radius), (radius, -radius), (x, -y)),
        boundaries=("symmetry", "bottom", "side", "contact"),
        arcs=dict.fromkeys((2, 3), (0.0, -radius)),
    )


def _on_circle(radius: float, contact: float) -> tuple[float, float]:
    """Return the point at x = contact, at most at 45 degrees, of the circle that touches the origin
    from above."""
    turn = math.asin(min(contact / radius, math.sqrt(0.5)))
    return radius * math.sin(turn), 2 * radius * math.sin(0.5 * turn) ** 2


@dataclass(frozen=True, kw_only=True)
class PartialSlip(checks.Checked):
    """The closed form of Cattaneo.

    Examples
    --------
    >>> line = am.cases.HertzContact(load=1e5, radius=0.05, modulus=1.15e11)
    >>> slip = am.cases.PartialSlip(normal=line, friction=0.3, tangential=1.5e4)
    >>> slip.friction
    0.3
    """

    # the normal contact
    normal: Annotated[HertzContact, partial(checks.instance, types=HertzContact)]
    friction: checks.Positive  # coefficient
    tangential: checks.Nonnegative  # Q, N/m, below friction * P

    def __post_init__(self) -> None:
        super().__post_init__()
        limit = self.friction * self.normal.load
        if not self.tangential < limit:
            raise ValueError(
                f"tangential must be below friction times load = {limit:g} N/m, got {self.tangential!r}: "
                "beyond, the cylinder slides off"
            )

    @property
    def stick(self) -> float:
        """Return c, half the width of the strip that sticks, m."""
        return self.normal.half_width * math.sqrt(
            1 - self.tangential / (self.friction * self.normal.load)
        )

    def traction(self, x: np.ndarray) -> np.ndarray:
        """Return the size of the tangential traction t(x) at x (n,), m, Pa; see the module."""
        c = self.stick
        inner = np.sqrt(np.maximum(0.0, 1 - (np.asarray(x) / c) ** 2))
        return self.friction * (
            self.normal.pressure(x) - self.normal.peak * (c / self.normal.half_width) * inner
        )


def cattaneo(
    *,
    law: Law = am.Coulomb(0.3),
    load: float = 1e5,
    tangential: float = 1.5e4,
    radius: float = 50e-3,
    young: float = 2.1e11,
    poisson: float = 0.3,
) -> am.ContactProblem:
    """Pose a cylinder on a block of the same material under a normal and a tangential load.

    Bodies and meshes are those of :func:`~adaptmg.cases.hertz_cylinder`; ``reference`` also holds,
    with a constant coefficient of friction, ``stick`` (c, m) and ``partial_slip``
    (:class:`PartialSlip`).

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
    ``LoadPath({"lower.bottom": 1.0, "upper.top": [0.0, 1.0]})``: the slip under the normal load
    alone continues under the tangential one. Bodies of finite size are strained along the surface
    by stresses of the order of P/R, a / (mu R) of the largest traction, which moves the strip that
    sticks.

    Examples
    --------
    >>> am.cases.cattaneo(tangential=1e4).dim
    2
    """
    material = am.PlaneStrain(young=young, poisson=poisson)
    form = _form(load, radius, None, material, point=False)
    tangential = checks.nonnegative("tangential", tangential)
    reference = _reference(form)
    if (friction := constant_friction(law)) is not None:
        slip = PartialSlip(normal=form, friction=friction, tangential=tangential)
        sources = {
            **cast("dict[str, str]", reference["sources"]),
            "partial_slip": "Cattaneo; Johnson, Contact Mechanics, section 7.2",
        }
        reference |= {"stick": slip.stick, "partial_slip": slip, "sources": sources}
    a = form.half_width
    r = radius
    x, y = _on_circle(r, SLAVE_REACH * a)
    edge = _block_contact(r, a)
    upper = am.Outline(
        vertices=((-r, r), (-x, y), (0.0, 0.0), (x, y), (r, r)),
        boundaries=("side", "contact", "contact", "side", "top"),
        arcs=dict.fromkeys(range(4), (0.0, r)),
    )
    lower = am.Polygon(
        vertices=((-r, -r), (r, -r), (r, 0.0), (edge, 0.0), (-edge, 0.0), (-r, 0.0)),
        boundaries=("bottom", "right", "top", "contact", "top", "left"),
    )
    return am.ContactProblem(
        name="Cattaneo",
        material=material,
        domain=am.Assembly(parts={"upper": upper, "lower": lower}),
        contact=am.ContactPair("upper.contact", "lower.contact"),
        law=law,
        reference=reference,
        loads=(
            am.Pressure("lower.bottom", form.load / (2 * r)),
            am.Traction("upper.top", (tangential / (2 * r), 0.0)),
        ),
        supports=(
            am.Support("upper.top", y=0.0),
            am.Support("lower.left", x=0.0),
            am.Support("lower.right", x=0.0),
        ),
    )


# depth and half the width of the block, in half-widths of the punch: measured on default meshes, the
# pressure in the middle is .59 % below that on a half-plane; .75 % with half, .52 % with twice
_SIZE = 40.0


def _punch_pressure(load: float, a: float, x: np.ndarray) -> np.ndarray:
    """Return the pressure, Pa, at x, |x| < a."""
    return load / (math.pi * np.sqrt(a**2 - np.asarray(x) ** 2))


def flat_punch(
    *,
    law: Law = am.Frictionless(),
    load: float = 1e6,
    half_width: float = 10e-3,
    young: float = 2.1e11,
    poisson: float = 0.3,
) -> am.ContactProblem:
    """Pose a flat rigid punch on a block 40 half-widths deep and 80 wide; plane strain, one half by
    symmetry.

    ``reference`` holds, without friction, ``quantity`` (as text), ``pressure`` (a function of x, m,
    between -a and a, that returns Pa), ``exponent`` (of the singularity at the edge), ``half_width``
    (m), ``sources`` and ``remark``.

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
    a = checks.quantity("half_width", half_width, positive=True)
    load = checks.quantity("load", load, positive=True)
    reference = {}
    if isinstance(law, am.Frictionless):
        reference = {
            "quantity": "contact pressure, Pa",
            "pressure": partial(_punch_pressure, load, a),
            "exponent": 0.5,
            "half_width": a,
            "sources": {"pressure": "Johnson, Contact Mechanics, section 2.8, for a half-plane"},
            "remark": "The block is finite: the difference is of the order of (a / depth)^2, .1 %.",
        }
    size = _SIZE * a
    return am.ContactProblem(
        name="flat punch",
        material=am.PlaneStrain(young=young, poisson=poisson),
        domain=am.Polygon(
            vertices=((0.0, -size), (size, -size), (size, 0.0), (a, 0.0), (0.0, 0.0)),
            boundaries=("bottom", "side", "free", "contact", "symmetry"),
        ),
        contact=am.Contact("contact", am.Plane(point=(0.0, 0.0), normal=(0.0, -1.0))),
        law=law,
        loads=(am.Pressure("bottom", load / (2 * size)),),
        supports=(am.Support("symmetry", x=0.0),),
        reference=reference,
    )
