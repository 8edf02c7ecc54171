r"""Plastic bodies: Prandtl's punch, a plate with a hole, Hill's cylinder and an upset billet.

Prandtl: a flat rigid punch on a block that yields without hardening cannot bear a mean pressure
above

.. math:: p = (2 + \pi)\,k,\qquad k = \sigma_y / \sqrt 3 ,

smooth or rough (L. Prandtl 1920; R. Hill, The Mathematical Theory of Plasticity, 1950, section
9.5). The block, half of it by symmetry, is 5 half-widths wide and 4 deep, between rigid walls: the
zone that flows reaches 3 half-widths from the middle, and next to a free wall the block would fail
sooner.

Plate: a square plate of half-width b with a hole of radius a in plane strain bears the mean
pressure

.. math:: p = 2k\,(1 - a/b)

between rigid plates, smooth or rough. It is not less, as the stress -2k in the strips next to the
hole and zero in the strip with the hole is in equilibrium; it is not more, as from the two points
of the hole that are nearest to the free sides slip lines at 45 degrees may let the halves of the
plate approach each other and wedges escape to the sides. Thin plates have the same factor 1 - a/b
(F. A. Gaydon, A. W. McCrum, J. Mech. Phys. Solids 2, 1954).

Hill: a thick tube of radii a and b in plane strain under the inner pressure p yields within the
radius c,

.. math:: p = k \Big(2 \ln\frac{c}{a} + 1 - \frac{c^2}{b^2}\Big),\qquad
   \sigma_\theta - \sigma_r = 2k\ (r < c),\qquad
   \sigma_\theta = k\,c^2\Big(\frac{1}{b^2} + \frac{1}{r^2}\Big)\ (r > c) ,

and is elastic again where p is taken away: the stress of the elastic tube under p is subtracted
(Hill, section 5.2). This is Tresca's condition; von Mises' is the same for Poisson's ratio .5, and
near it for less, with the axial stress between the two others.

A billet of radius R and height 2h between rough plates needs, by the equilibrium of slabs, the mean
pressure

.. math:: p = \sigma_y \Big(1 + \frac{2\mu R}{3 \cdot 2h}\Big)

(E. Siebel 1923; W. Johnson and P. B. Mellor, Engineering Plasticity, 1973, section 6.5), and bulges
in the middle like a barrel. Slabs do not bulge: p is a little too large."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.problem import Law

# of the block, in half-widths of the punch: measured on a coarse mesh (186 nodes), the load is 1.32 times
# the limit; 1.30 and 1.29 with half and twice the width, 1.39 and 1.27 with half and twice the depth
_WIDTH, _DEPTH = 5.0, 4.0


def prandtl_punch(
    *,
    law: Law = am.Frictionless(),
    half_width: float = 10e-3,
    displacement: float = 4e-4,
    young: float = 2e11,
    poisson: float = 0.3,
    yield_stress: float = 3e8,
    hardening: float = 2e6,
    elements: str = "linear",
) -> am.ContactProblem:
    """Pose a flat rigid punch that is pressed into a plastic block; plane strain, one half by
    symmetry.

    ``reference`` holds ``quantity`` (what the limit is of, as text), ``limit``, the largest mean pressure
    without hardening, Pa, ``half_width``, m, and ``sources``. The motion of the punch has the name "punch"
    in load paths.

    Parameters
    ----------
    law : Law
        Under the punch; the limit is the same for every friction.
    half_width : float
        a, m.
    displacement : float
        Of the punch, into the block, m.
    young, poisson, yield_stress, hardening
        Of the block, see :class:`adaptmg.Plastic`.
    elements : {"linear", "smoothed"}
        Smoothed ones come nearer to the limit.

    Examples
    --------
    >>> round(am.cases.prandtl_punch().reference["limit"] / 3e8, 4)
    2.9685
    """
    a = checks.quantity("half_width", half_width, positive=True)
    indentation = checks.quantity("displacement", displacement, positive=True)
    steel = am.Plastic(
        am.PlaneStrain(young=young, poisson=poisson),
        yield_stress=yield_stress,
        hardening=hardening,
    )
    width = _WIDTH * a
    depth = _DEPTH * a
    punch = am.Moving(
        am.Plane(point=(0.0, 0.0), normal=(0.0, -1.0)),
        displacement=(0.0, -indentation),
        name="punch",
    )
    return am.ContactProblem(
        name="Prandtl's punch",
        material=steel,
        domain=am.Polygon(
            vertices=((0.0, -depth), (width, -depth), (width, 0.0), (a, 0.0), (0.0, 0.0)),
            boundaries=("bottom", "side", "free", "contact", "symmetry"),
        ),
        contact=am.Contact("contact", punch),
        law=law,
        supports=(
            am.Support("symmetry", x=0.0),
            am.Support("side", x=0.0),
            am.Support("bottom", x=0.0, y=0.0),
        ),
        elements=elements,
        reference={
            "quantity": "mean pressure under the punch, Pa",
            "limit": (2 + math.pi) * steel.yield_stress / math.sqrt(3),
            "half_width": a,
            "sources": {"limit": "Prandtl 1920; Hill, The Mathematical Theory of Plasticity, 9.5"},
        },
    )


def pierced_plate(
    *,
    law: Law = am.Frictionless(),
    half_width: float = 20e-3,
    radius: float = 4e-3,
    displacement: float = 1.2e-4,
    young: float = 2e11,
    poisson: float = 0.3,
    yield_stress: float = 3e8,
    hardening: float = 2e6,
    elements: str = "linear",
) -> am.ContactProblem:
    """Pose a square plate with a round hole that rigid plates squeeze beyond its yield limit; plane
    strain, one quarter by symmetry.

    ``reference`` holds ``quantity`` (what the limit is of, as text), ``limit``, the largest mean pressure
    without hardening, Pa, ``half_width``, m, and ``sources``. The motion of the plate has the name "press"
    in load paths.

    Parameters
    ----------
    law : Law
        Under the rigid plate; the limit is the same for every friction.
    half_width, radius : float
        Of the square, b, and of the hole, a, m.
    displacement : float
        Of the rigid plate towards the middle, m.
    young, poisson, yield_stress, hardening
        Of the plate, see :class:`adaptmg.Plastic`.
    elements : {"linear", "smoothed"}
        Smoothed ones come nearer to the limit.

    Examples
    --------
    >>> round(am.cases.pierced_plate().reference["limit"] / 3e8, 4)
    0.9238
    """
    b = checks.quantity("half_width", half_width, positive=True)
    a = checks.quantity("radius", radius, positive=True)
    if not a < b:
        raise ValueError(f"radius must be < half_width, {b:g}, got {a:g}")
    approach = checks.quantity("displacement", displacement, positive=True)
    steel = am.Plastic(
        am.PlaneStrain(young=young, poisson=poisson),
        yield_stress=yield_stress,
        hardening=hardening,
    )
    press = am.Moving(
        am.Plane(point=(0.0, b), normal=(0.0, -1.0)), displacement=(0.0, -approach), name="press"
    )
    return am.ContactProblem(
        name="pierced plate",
        material=steel,
        domain=am.Outline(
            vertices=((a, 0.0), (b, 0.0), (b, b), (0.0, b), (0.0, a)),
            boundaries=("middle", "side", "contact", "symmetry", "hole"),
            arcs={4: (0.0, 0.0)},
        ),
        contact=am.Contact("contact", press),
        law=law,
        supports=(am.Support("symmetry", x=0.0), am.Support("middle", y=0.0)),
        elements=elements,
        reference={
            "quantity": "mean pressure under the rigid plate, Pa",
            "limit": 2 * steel.yield_stress / math.sqrt(3) * (1 - a / b),
            "half_width": b,
            "sources": {"limit": "two bounds that agree, see adaptmg.cases.plastic_bodies"},
        },
    )


def hill_cylinder(
    *,
    pressure: float = 2e8,
    inner: float = 0.1,
    outer: float = 0.2,
    young: float = 2.1e11,
    poisson: float = 0.45,
    yield_stress: float = 3e8,
    elements: str = "linear",
) -> am.ContactProblem:
    """Pose a thick tube that yields under inner pressure; axisymmetric, a slice of it in plane
    strain, without contact.

    ``reference`` holds ``quantity`` (as text), ``plastic_radius``, c, m, ``limit``, the pressure at which
    all of the tube yields, Pa, ``stress`` and ``residual_stress``, functions of the radius, m, that return the
    radial and the hoop stress (2, n), Pa, under the pressure and after it, and ``sources``. The tube
    yields again as the pressure is taken away, and there is no ``residual_stress``, where the
    pressure is above twice that at which yield begins.

    Parameters
    ----------
    pressure : float
        p, Pa: at least where yield begins, below the limit.
    inner, outer : float
        a and b, m.
    young, poisson, yield_stress
        See :class:`adaptmg.Plastic`.
    elements : {"linear", "smoothed"}

    Examples
    --------
    >>> round(am.cases.hill_cylinder().reference["plastic_radius"], 4)
    0.1363
    """
    a = checks.quantity("inner", inner, positive=True)
    b = checks.quantity("outer", outer, positive=True)
    if not a < b:
        raise ValueError(f"outer must be > inner, {a:g}, got {b:g}")
    steel = am.Plastic(am.Axisymmetric(young=young, poisson=poisson), yield_stress=yield_stress)
    k = steel.yield_stress / math.sqrt(3)
    first = _pressure_at(k, a, b, a)
    last = _pressure_at(k, a, b, b)
    pressure = checks.quantity("pressure", pressure)
    if not first <= pressure < last:
        raise ValueError(
            f"pressure must be at least {first:.6g} Pa, where yield begins, and below the limit "
            f"{last:.6g} Pa, got {pressure!r}"
        )
    from scipy.optimize import brentq  # takes long to import

    radius = brentq(lambda c: _pressure_at(k, a, b, c) - pressure, a, b, xtol=checks.ROUNDING * b)
    stress = partial(_tube_stress, k, a, b, radius, pressure)
    reference = {
        "quantity": "radial and hoop stress, Pa",
        "plastic_radius": radius,
        "limit": last,
        "stress": stress,
        "sources": {"stress": "Hill, The Mathematical Theory of Plasticity, 5.2"},
    }
    # the pressure goes elastically: after a higher one the bore yields again, in the other direction
    if pressure <= 2 * first:
        reference["residual_stress"] = partial(_residual_stress, stress, a, b, pressure)
    return am.ContactProblem(
        name="Hill's cylinder",
        material=steel,
        # in plane strain any height will do
        domain=am.Rectangle(width=b - a, height=0.25 * (b - a), origin=(a, 0.0)),
        loads=(am.Pressure("left", pressure),),
        supports=(am.Support("bottom", y=0.0), am.Support("top", y=0.0)),
        elements=elements,
        reference=reference,
    )


def _pressure_at(k: float, a: float, b: float, c: float) -> float:
    """Return the pressure, Pa, that makes a tube from radius a to b, of the shear yield stress k, yield
    within the radius c."""
    return k * (2 * math.log(c / a) + 1 - (c / b) ** 2)


def _tube_stress(
    k: float, a: float, b: float, c: float, pressure: float, r: np.ndarray
) -> np.ndarray:
    """Return the radial and the hoop stress (2, n), Pa, at radii r (n,) of a tube that has yielded within
    the radius c under a pressure; k, a and b as of :func:`_pressure_at`."""
    r = np.asarray(r, dtype=np.float64)
    yielded = r < c
    radial = np.where(yielded, -pressure + 2 * k * np.log(r / a), k * c**2 * (1 / b**2 - 1 / r**2))
    return np.array([radial, np.where(yielded, radial + 2 * k, k * c**2 * (1 / b**2 + 1 / r**2))])


def _residual_stress(
    stress: partial, a: float, b: float, pressure: float, r: np.ndarray
) -> np.ndarray:
    """Return the radial and the hoop stress (2, n), Pa, at radii r (n,) after the pressure: the ``stress``
    under it, minus that of an elastic tube."""
    r = np.asarray(r, dtype=np.float64)
    size = pressure * a**2 / (b**2 - a**2)
    return stress(r) - size * np.array([1 - (b / r) ** 2, 1 + (b / r) ** 2])


def upset_billet(
    *,
    friction: float = 0.1,
    radius: float = 10e-3,
    height: float = 20e-3,
    compression: float = 0.03,
    young: float = 2e11,
    poisson: float = 0.3,
    yield_stress: float = 3e8,
    hardening: float = 2e6,
    elements: str = "smoothed",
) -> am.ContactProblem:
    """Pose a round billet that is pressed between two rough plates; axisymmetric, its upper half.

    ``reference`` holds ``quantity`` (as text), ``pressure``, the mean pressure of slabs without hardening,
    Pa, ``radius``, m, and ``sources``. The motion of the plate has the name "plate" in load paths.

    Parameters
    ----------
    friction : float
        Coulomb's coefficient at the plates.
    radius, height : float
        R and 2h, m.
    compression : float
        Motion of both plates towards each other over the height; a theory of small strains holds for
        some percent.
    young, poisson, yield_stress, hardening
        See :class:`adaptmg.Plastic`.
    elements : {"linear", "smoothed"}

    Examples
    --------
    >>> round(am.cases.upset_billet().reference["pressure"] / 3e8, 4)
    1.0333
    """
    friction = checks.nonnegative("friction", friction)
    r = checks.quantity("radius", radius, positive=True)
    half = 0.5 * checks.quantity("height", height, positive=True)
    approach = half * checks.quantity("compression", compression, positive=True)
    steel = am.Plastic(
        am.Axisymmetric(young=young, poisson=poisson),
        yield_stress=yield_stress,
        hardening=hardening,
    )
    plate = am.Moving(
        am.Plane(point=(0.0, half), normal=(0.0, -1.0)), displacement=(0.0, -approach), name="plate"
    )
    return am.ContactProblem(
        name="upset billet",
        material=steel,
        domain=am.Rectangle(width=r, height=half),
        contact=am.Contact("top", plate),
        law=am.Coulomb(friction),
        supports=(am.Support("left", x=0.0), am.Support("bottom", y=0.0)),
        elements=elements,
        reference={
            "quantity": "mean pressure under the plate, Pa",
            "pressure": steel.yield_stress * (1 + friction * r / (3 * half)),
            "radius": r,
            "sources": {"pressure": "Johnson and Mellor, Engineering Plasticity, 6.5"},
        },
    )
