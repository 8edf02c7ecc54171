r"""Scalar problems with closed forms: a membrane over a floor, and a twisted bar that yields.

A round membrane of tension k and radius R, held at its edge, under a pressure q over a floor at the
depth d lies on the floor for r <= a,

.. math:: u = -d + \frac{q}{4k}(r^2 - a^2) - \frac{q a^2}{2k}\ln\frac{r}{a}\quad (r \ge a),\qquad u(R) = 0,

and presses on it with :math:`\pi q a^2`: u and its slope are continuous at a (integrate twice from
there). It touches if :math:`q R^2 / 4k > d`.

A bar that is twisted by the angle :math:`\theta` per length, shear modulus G, has Prandtl's stress
function :math:`\phi`, :math:`-\Delta\phi = 2G\theta`, zero on the boundary, with the shear stress
:math:`|\nabla\phi|`. Where the bar yields at the shear stress k, :math:`\phi` lies on the roof
:math:`k\,\mathrm{dist}`: the solution is that between the limits :math:`\pm k\,\mathrm{dist}` (H.
Brezis, M. Sibony, Arch. Rational Mech. Anal. 41, 1971, doi:10.1007/BF00281866). The torque is
:math:`2\int\phi`. A round bar stays elastic within :math:`a = k/(G\theta)`, and bears

.. math:: T = \frac{2\pi k}{3}\Big(R^3 - \frac{a^3}{4}\Big)

(A. Nadai, Theory of Flow and Fracture of Solids 1, 1950, chapter 35); fully plastic a square bar of
side s bears :math:`k s^3/3`."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks


def obstacle_problem(
    *, radius: float = 1.0, tension: float = 1.0, load: float = 1.0, depth: float = 0.1
) -> am.ScalarProblem:
    """Pose a round membrane under a uniform pressure over a floor.

    ``reference`` holds ``contact_radius`` (m), ``force`` on the floor (N), and ``deflection``, a
    function of points (n, 2), m.

    Parameters
    ----------
    radius : float
        R, m.
    tension : float
        k, N/m.
    load : float
        q, Pa, down (u is up).
    depth : float
        d of the floor, m, below q R^2 / 4k: else the membrane does not touch it.

    Examples
    --------
    >>> round(am.cases.obstacle_problem().reference["contact_radius"], 4)
    0.5025
    """
    r, k, q, d = (
        checks.positive(name, value)
        for name, value in (
            ("radius", radius),
            ("tension", tension),
            ("load", load),
            ("depth", depth),
        )
    )
    if not d < q * r**2 / (4 * k):
        raise ValueError(
            f"depth must be below {q * r**2 / (4 * k):.6g}, the deflection without a floor, got {d:g}"
        )

    def above_floor(a: float) -> float:
        return q / (4 * k) * (r**2 - a**2 - 2 * a**2 * math.log(r / a)) - d

    from scipy.optimize import brentq  # takes long to import

    a = float(brentq(above_floor, 1e-9 * r, r))

    def deflection(points: np.ndarray) -> np.ndarray:
        s = np.maximum(np.linalg.norm(points, axis=1), a)
        return -d + q / (4 * k) * (s**2 - a**2 - 2 * a**2 * np.log(s / a))

    return am.ScalarProblem(
        name="membrane over a floor",
        domain=am.Circle((0.0, 0.0), r, "edge"),
        conductivity=k,
        load=-q,
        lower=-d,
        reference={"contact_radius": a, "force": math.pi * q * a**2, "deflection": deflection},
    )


def elastic_plastic_torsion(
    *,
    section: str = "disc",
    size: float = 1.0,
    shear: float = 1.0,
    twist: float = 2.0,
    yield_stress: float = 1.0,
) -> am.ScalarProblem:
    """Pose a twisted bar that yields where its stress function reaches the roof over its section.

    ``reference`` holds ``elastic_radius`` (m) and ``torque`` (N m) of a disc, and ``plastic_torque``,
    that of the bar which yields everywhere; the torque of a solution is twice the integral of u.

    Parameters
    ----------
    section : {"disc", "square"}
    size : float
        Radius of the disc, half the side of the square, m.
    shear : float
        G, Pa.
    twist : float
        Angle per length, rad/m.
    yield_stress : float
        k, in shear, Pa.

    Examples
    --------
    >>> am.cases.elastic_plastic_torsion(twist=2.0).reference["elastic_radius"]
    0.5
    """
    checks.choice("section", section, ("disc", "square"))
    half, g, theta, k = (
        checks.positive(name, value)
        for name, value in (
            ("size", size),
            ("shear", shear),
            ("twist", twist),
            ("yield_stress", yield_stress),
        )
    )

    def roof(sign: float) -> Callable[[np.ndarray], np.ndarray]:
        order = None if section == "disc" else np.inf
        return lambda x: sign * k * np.maximum(half - np.linalg.norm(x, order, axis=1), 0.0)

    a = min(k / (g * theta), half)
    if section == "disc":
        domain: am.Circle | am.Rectangle = am.Circle((0.0, 0.0), half, "edge")
        elastic = math.pi * g * theta * half**4 / 2
        plastic = 2 * math.pi * k * half**3 / 3
        torque = elastic if a == half else plastic - math.pi * k * a**3 / 6
        reference: dict[str, object] = {"elastic_radius": a, "torque": torque}
    else:
        domain = am.Rectangle(width=2 * half, height=2 * half, origin=(-half, -half))
        plastic = 8 * k * half**3 / 3
        reference = {}
    return am.ScalarProblem(
        name=f"torsion of a {section} bar",
        domain=domain,
        load=2 * g * theta,
        lower=roof(-1.0),
        upper=roof(1.0),
        reference=reference | {"plastic_torque": plastic},
    )
