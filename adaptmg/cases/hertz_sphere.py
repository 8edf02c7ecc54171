r"""A ball pressed on a block or on another ball: point contact after Hertz.

With the load P, the relative curvature :math:`1/R = 1/R_1 + 1/R_2` and the contact modulus
:math:`E^* = E / (2 (1 - \nu^2))` of two bodies of the same material, the radius of contact, the pressure and the
approach of points far away are

.. math:: a = \Big(\frac{3 P R}{4 E^*}\Big)^{1/3},\qquad p(r) = p_0 \sqrt{1 - r^2/a^2},\qquad
   p_0 = \frac{3P}{2\pi a^2} = \frac{2 E^* a}{\pi R},\qquad \delta = \frac{a^2}{R}

(K. L. Johnson, Contact Mechanics, 1985, section 4.2). They hold for a much smaller than the radii and the bodies.

The meridians are those of :mod:`~adaptmg.cases.hertz_cylinder`: half a ball, its flat top pressed down, on a block or
the mirrored half of another ball, its flat bottom held; in axisymmetry, or as a quarter of the full turn in 3D.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from adaptmg.cases.hertz_contact import HertzContact
from adaptmg.cases.hertz_cylinder import MASTER_REACH, SLAVE_REACH, half_block, quarter_cylinder, refuse_large
from adaptmg.problem import (
    Assembly,
    Axisymmetric,
    ContactPair,
    ContactProblem,
    Frictionless,
    Law,
    Pressure,
    Solid,
    Support,
    checks,
)
from adaptmg.problem.domains import Revolution

__all__ = ["PointContact", "hertz_sphere"]


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
    adaptmg.cases.hertz_cylinder.line_contact_meshes : meshes fine enough near the contact, in 3D too.
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
