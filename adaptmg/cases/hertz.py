r"""A cylinder pressed on a block or on another cylinder: line contact after Hertz.

With the load P per length, the relative curvature :math:`1/R = 1/R_1 + 1/R_2` and the contact modulus
:math:`E^* = E / (2 (1 - \nu^2))` of two bodies of the same material, the half-width and the pressure are

.. math:: a = \sqrt{\frac{4 P R}{\pi E^*}},\qquad p(x) = p_0 \sqrt{1 - x^2/a^2},\qquad p_0 = \frac{2P}{\pi a}

(K. L. Johnson, Contact Mechanics, 1985, section 4.2). They hold for a much smaller than the radii and the bodies: what
is posed here differs from them by terms of the order of (a/R)^2.

One half by symmetry (x >= 0): a quarter of a cylinder, its flat top pressed down, on a square block or the mirrored
quarter of another cylinder, its flat bottom held. Only a part of the curved surface, ten half-widths long, is named
"contact".

HertzContact: what the closed forms of Hertz for line and point contact share.

A ball pressed on a block or on another ball: point contact after Hertz.

With the load P, the relative curvature :math:`1/R = 1/R_1 + 1/R_2` and the contact modulus
:math:`E^* = E / (2 (1 - \nu^2))` of two bodies of the same material, the radius of contact, the pressure and the
approach of points far away are

.. math:: a = \Big(\frac{3 P R}{4 E^*}\Big)^{1/3},\qquad p(r) = p_0 \sqrt{1 - r^2/a^2},\qquad
   p_0 = \frac{3P}{2\pi a^2} = \frac{2 E^* a}{\pi R},\qquad \delta = \frac{a^2}{R}

(K. L. Johnson, Contact Mechanics, 1985, section 4.2). They hold for a much smaller than the radii and the bodies.

The meridians are those of :mod:`~adaptmg.cases.hertz`: half a ball, its flat top pressed down, on a block or
the mirrored half of another ball, its flat bottom held; in axisymmetry, or as a quarter of the full turn in 3D.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptmg import _checks as checks
from adaptmg.cases.flat_punch import point_meshes
from adaptmg.mesh import MeshArrays
from adaptmg.problem import (
    Assembly,
    Axisymmetric,
    ContactPair,
    ContactProblem,
    Frictionless,
    Law,
    Outline,
    PlaneStrain,
    Polygon,
    Pressure,
    Solid,
    Support,
)
from adaptmg.problem.solid_domains import Revolution

__all__ = ["HertzContact", "LineContact", "PointContact", "hertz_cylinder", "hertz_sphere", "line_contact_meshes",
           "pressure_fit"]

@dataclass(frozen=True, kw_only=True)
class HertzContact(ABC):
    """A pressure that falls like half an ellipse from the middle of contact."""

    load: float  # P, > 0: N/m in line contact, N in point contact
    radius: float  # R, of the relative curvature, m, > 0
    modulus: float  # the contact modulus E*, Pa, > 0

    def __post_init__(self) -> None:
        for name in ("load", "radius", "modulus"):
            object.__setattr__(self, name, checks.positive(name, getattr(self, name)))

    @property
    @abstractmethod
    def half_width(self) -> float:
        """a, half the width or the radius of contact, m."""

    @property
    @abstractmethod
    def peak(self) -> float:
        """p0, Pa."""

    def pressure(self, distance: np.ndarray) -> np.ndarray:
        """Pressure at distances from the middle (m), Pa."""
        return self.peak * np.sqrt(np.maximum(0.0, 1 - (np.asarray(distance) / self.half_width)**2))


_LARGEST = 0.1
# lengths of the surfaces that may touch, in half-widths; the master reaches further than the slave
SLAVE_REACH, MASTER_REACH = 10.0, 14.0


@dataclass(frozen=True, kw_only=True)
class LineContact(HertzContact):
    """The closed form of Hertz for line contact; ``load`` in N/m."""

    @property
    def half_width(self) -> float:
        """a, m."""
        return math.sqrt(4 * self.load * self.radius / (math.pi * self.modulus))

    @property
    def peak(self) -> float:
        """p0, Pa."""
        return 2 * self.load / (math.pi * self.half_width)


def hertz_cylinder(*, law: Law = Frictionless(), load: float = 1e6, radius: float = 50e-3,  # noqa: B008
                   lower_radius: float | None = None, young: float = 2.1e11, poisson: float = 0.3) -> ContactProblem:
    """A cylinder on a block, or on another cylinder; plane strain, one half by symmetry.

    Parameters
    ----------
    law : Law
        On the surface; with equal materials friction changes nothing but terms of the order of a/R.
    load : float
        P of the whole cylinder, N/m; the half carries P/2.
    radius : float
        Of the cylinder, m.
    lower_radius : float, optional
        Of the body below, m; None for a block with a flat top.
    young, poisson : float
        Of both bodies, Pa, and a number.

    Returns
    -------
    ContactProblem
        Bodies "upper" (slave) and "lower", which touch at the origin. ``reference`` holds ``half_width`` (m),
        ``peak`` (Pa), ``closed_form`` (:class:`LineContact`), ``sources`` and ``remark``.

    Raises
    ------
    ValueError
        If the half-width would be more than a tenth of a radius.

    See Also
    --------
    line_contact_meshes : meshes fine enough near the contact.
    """
    radius = checks.quantity("radius", radius, positive=True)
    material = PlaneStrain(young=young, poisson=poisson)
    lower_radius = None if lower_radius is None else checks.quantity("lower_radius", lower_radius, positive=True)
    form = closed_form(load, radius, lower_radius, material)
    a = form.half_width
    lower = (half_block(radius, a) if lower_radius is None else
             quarter_cylinder(lower_radius, MASTER_REACH * a, above=False))
    return ContactProblem(
        name="Hertz, cylinder on block" if lower_radius is None else "Hertz, two cylinders",
        material=material,
        domain=Assembly(parts={"upper": quarter_cylinder(radius, SLAVE_REACH * a, above=True), "lower": lower}),
        # the weighted gap at the pole, of chords seen along turning normals, is negative by terms of the order of h^4
        contact=ContactPair("upper.contact", "lower.contact", allow_interference=True),
        law=law,
        loads=(Pressure("upper.top", form.load / (2 * radius)),),
        supports=(Support("upper.symmetry", x=0.0), Support("lower.symmetry", x=0.0), Support("lower.bottom", y=0.0)),
        reference=hertz_reference(form),
    )


def closed_form(load: float, radius: float, lower_radius: float | None, material: PlaneStrain) -> LineContact:
    """The closed form for two bodies of one material; ValueError where it does not hold."""
    curvature = 1 / radius + (0.0 if lower_radius is None else 1 / lower_radius)
    form = LineContact(load=load, radius=1 / curvature, modulus=material.young / (2 * (1 - material.poisson**2)))
    refuse_large(load, form.half_width, radius, lower_radius)
    return form


def refuse_large(load: float, half_width: float, radius: float, lower_radius: float | None) -> None:
    """ValueError if the contact is too wide for Hertz."""
    smallest = min(radius, radius if lower_radius is None else lower_radius)
    if not half_width <= _LARGEST * smallest:
        raise ValueError(f"load {load!r} makes a contact of half-width {half_width:.3g} m, more than a tenth of the "
                         f"radius {smallest:g} m: Hertz does not hold there; take a smaller load or a larger radius")


def hertz_reference(form: LineContact) -> Mapping[str, Any]:
    """What the reference of a problem says of its closed form."""
    return {"quantity": "half-width, m, and largest pressure, Pa", "half_width": form.half_width, "peak": form.peak,
            "closed_form": form, "sources": {"closed_form": "Hertz; Johnson, Contact Mechanics, section 4.2"},
            "remark": "Exact for half-planes; bodies of finite size differ by terms of the order of (a/R)^2."}


def quarter_cylinder(radius: float, contact: float, *, above: bool) -> Outline:
    """The quarter x >= 0 of a cylinder that touches the origin from above or below, flat at its middle plane."""
    x, y = _on_circle(radius, contact)
    if above:
        return Outline(vertices=((0.0, 0.0), (x, y), (radius, radius), (0.0, radius)),
                       boundaries=("contact", "side", "top", "symmetry"), arcs={0: (0.0, radius), 1: (0.0, radius)})
    return Outline(vertices=((0.0, 0.0), (0.0, -radius), (radius, -radius), (x, -y)),
                   boundaries=("symmetry", "bottom", "side", "contact"), arcs={2: (0.0, -radius), 3: (0.0, -radius)})


def _on_circle(radius: float, contact: float) -> tuple[float, float]:
    """The point of the circle at x = contact, at most at 45 degrees."""
    turn = math.asin(min(contact / radius, math.sqrt(0.5)))
    return radius * math.sin(turn), 2 * radius * math.sin(0.5 * turn)**2


def half_block(size: float, a: float) -> Polygon:
    """The square x >= 0 below the origin; its top is called "contact" over 14 half-widths a, at most 3/4 of it."""
    edge = min(MASTER_REACH * a, 0.75 * size)
    return Polygon(vertices=((0.0, -size), (size, -size), (size, 0.0), (edge, 0.0), (0.0, 0.0)),
                   boundaries=("bottom", "side", "top", "contact", "symmetry"))


def line_contact_meshes(problem: ContactProblem, *, finest: float | None = None, levels: int | None = None,
                        factor: float = 2.0, grading: float | None = None) -> list[MeshArrays]:
    """Independent meshes for a hierarchy, coarse to fine, refined around the contact at the origin.

    Parameters
    ----------
    problem : ContactProblem
        :func:`hertz_cylinder`, :func:`~adaptmg.cases.cattaneo.cattaneo` or
        :func:`~adaptmg.cases.hertz.hertz_sphere`.
    finest : float, optional
        Edge length at contact over the half-width on the finest mesh, above 0 and at most 0.5; default 1/40, in 3D 1/6.
    levels : int, optional
        Number of meshes, >= 1; on the coarsest, ``finest * factor**(levels - 1)`` is at most 1. Default 5, in 3D 3.
    factor : float
        By which the edge lengths fall everywhere from mesh to mesh, above 1 and at most 3.
    grading : float, optional
        Growth of the edge length per distance on the finest mesh; ``factor`` times as much on each coarser one, up to
        1 on the coarsest. Default 0.06, in 3D 0.25.

    Returns
    -------
    list of MeshArrays
        For :meth:`adaptmg.Hierarchy.from_meshes`. Within 1.3 half-widths of the middle the edges have the length
        ``finest`` times a times ``factor`` to the number of finer meshes.
    """
    defaults = {"finest": 1 / 40, "levels": 5, "grading": 0.06}
    if problem.dim == 3:
        defaults = {"finest": 1 / 6, "levels": 3, "grading": 0.25}
    finest = checks.positive("finest", defaults["finest"] if finest is None else finest)
    levels = checks.integer("levels", defaults["levels"] if levels is None else levels, 1)
    if not finest <= 0.5:
        raise ValueError(f"finest must be at most 0.5 of the half-width, got {finest!r}")
    if "half_width" not in problem.reference or problem.domain is None:
        raise ValueError(f"problem {problem.name!r} has no half_width in its reference, or no domain: take a case of "
                         "Hertz")
    coarsest = finest * checks.number("factor", factor)**(levels - 1)
    if not coarsest <= 1 + 1e-9:
        raise ValueError(f"the coarsest mesh would have edges of {coarsest:.3g} half-widths at contact, more than 1: "
                         "take fewer levels or a smaller finest")
    a = problem.reference["half_width"]
    return point_meshes(problem.domain, [(0.0,) * problem.dim], size=finest * a, radius=1.3 * a, levels=levels,
                        factor=factor, grading=defaults["grading"] if grading is None else grading)


def pressure_fit(x: np.ndarray, pressure: np.ndarray, half_width: float, share: float = 0.8) -> tuple[float, float]:
    r"""Half-width and peak of the Hertzian pressure that fits nodal pressures best.

    :math:`p^2 = p_0^2 - (p_0/a)^2 x^2` is linear in :math:`x^2`; a least-squares line through the nodes away from the
    edge averages the noise of single nodes.

    Parameters
    ----------
    x : (n,) array
        Distances from the middle, m.
    pressure : (n,) array
        Pa.
    half_width : float
        About which a is expected, m.
    share : float
        Nodes within this share of ``half_width`` count.

    Returns
    -------
    half_width, peak : float
        m and Pa.
    """
    x, pressure = np.asarray(x, dtype=np.float64), np.asarray(pressure, dtype=np.float64)
    inside = np.abs(x) < share * half_width
    if inside.sum() < 3:
        raise ValueError(f"only {inside.sum()} nodes lie within {share:g} of the half-width {half_width:g} m: refine "
                         "the mesh near contact")
    slope, square = np.polyfit(x[inside]**2, pressure[inside]**2, 1)
    if not (slope < 0 and square > 0):
        raise ValueError("the pressures do not fall from the middle outwards: there is no Hertzian pressure to fit")
    return math.sqrt(square / -slope), math.sqrt(square)


@dataclass(frozen=True, kw_only=True)
class PointContact(HertzContact):
    """The closed form of Hertz for point contact; ``load`` in N."""

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


def hertz_sphere(*, law: Law = Frictionless(), dim: int = 2, load: float = 1300.0, radius: float = 50e-3,  # noqa: B008
                 lower_radius: float | None = None, young: float = 2.1e11, poisson: float = 0.3) -> ContactProblem:
    """A ball on a block, or on another ball.

    Parameters
    ----------
    law : Law
        On the surface; with equal materials friction changes nothing but terms of the order of a/R.
    dim : {2, 3}
        2 is axisymmetric (x is the radius, y the axis), 3 a quarter of the full turn (z is the axis).
    load : float
        P on the whole ball, N; a quarter carries P/4.
    radius : float
        Of the ball, m.
    lower_radius : float, optional
        Of the body below, m; None for a block with a flat top.
    young, poisson : float
        Of both bodies, Pa, and a number.

    Returns
    -------
    ContactProblem
        Bodies "upper" (slave) and "lower", which touch at the origin. ``reference`` holds ``half_width`` (the radius of
        contact, m), ``peak`` (Pa), ``approach`` (m), ``closed_form`` (:class:`PointContact`), ``sources`` and
        ``remark``.

    Raises
    ------
    ValueError
        If the radius of contact would be more than a tenth of a radius.

    See Also
    --------
    adaptmg.cases.hertz.line_contact_meshes : meshes fine enough near the contact, in 3D too.
    """
    checks.choice("dim", dim, (2, 3))
    radius = checks.quantity("radius", radius, positive=True)
    lower_radius = None if lower_radius is None else checks.quantity("lower_radius", lower_radius, positive=True)
    material = (Axisymmetric if dim == 2 else Solid)(young=young, poisson=poisson)
    curvature = 1 / radius + (0.0 if lower_radius is None else 1 / lower_radius)
    form = PointContact(load=load, radius=1 / curvature, modulus=material.young / (2 * (1 - material.poisson**2)))
    a = form.half_width
    refuse_large(load, a, radius, lower_radius)
    lower = (half_block(radius, a) if lower_radius is None else
             quarter_cylinder(lower_radius, MASTER_REACH * a, above=False))
    parts = {"upper": quarter_cylinder(radius, SLAVE_REACH * a, above=True), "lower": lower}
    supports = [Support("upper.symmetry", x=0.0), Support("lower.symmetry", x=0.0), Support("lower.bottom", y=0.0)]
    if dim == 3:
        parts = {name: Revolution(part, 90.0) for name, part in parts.items()}
        supports = [Support(f"{body}.{side}", **{axis: 0.0}) for body in parts
                    for side, axis in (("start", "y"), ("end", "x"))] + [Support("lower.bottom", z=0.0)]
    return ContactProblem(
        name="Hertz, " + ("ball on block" if lower_radius is None else "two balls"),
        material=material,
        domain=Assembly(parts=parts),
        # as for cylinders: weighted gaps of chords are negative by terms of the order of h^4
        contact=ContactPair("upper.contact", "lower.contact", allow_interference=True),
        law=law,
        loads=(Pressure("upper.top", form.load / (math.pi * radius**2)),),
        supports=supports,
        reference=_reference(form),
    )


def _reference(form: PointContact) -> Mapping[str, Any]:
    return {"quantity": "radius of contact, m, and largest pressure, Pa", "half_width": form.half_width,
            "peak": form.peak, "approach": form.approach, "closed_form": form,
            "sources": {"closed_form": "Hertz; Johnson, Contact Mechanics, section 4.2"},
            "remark": "Exact for half-spaces; bodies of finite size differ by terms of the order of (a/R)^2."}
