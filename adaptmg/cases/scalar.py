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

(A. Nadai, Theory of Flow and Fracture of Solids 1, 1950, chapter 35).

A square bar of side 2 a stays elastic up to the largest stress, in the middle of its sides,

.. math:: \tau = 2 G\theta a\Big(1 - \frac{8}{\pi^2}\sum_{n\ \text{odd}}\frac{1}{n^2\cosh(n\pi/2)}\Big)
   = 1.3506\,G\theta a,\qquad
   T = \frac{16}{3} G\theta a^4\Big(1 - \frac{192}{\pi^5}\sum_{n\ \text{odd}}\frac{\tanh(n\pi/2)}{n^5}\Big)

(S. Timoshenko, J. N. Goodier, Theory of Elasticity, chapter 10), and bears :math:`8 k a^3/3` where all
of it yields. Between them there is no closed form; three torques are computed apart from this package."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks

#: torques of a square bar over k a^3, by G theta a / k: differences with 5 and with 9 points on 16 to 256 cells
#: over a, the nodes on the roof by repeated direct solves, extrapolated by h^2; the two kinds of differences
#: agree to 1e-6, and the last two extrapolations to 9e-6; measured again with 5 points on 16 to 128 cells: 2.11879,
#: 2.55434 and 2.64221, the last two extrapolations within 6e-5
_SQUARE_TORQUES = {1.0: 2.1188, 2.0: 2.5543, 4.0: 2.6422}


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
    r = checks.positive("radius", radius)
    k = checks.positive("tension", tension)
    q = checks.positive("load", load)
    d = checks.positive("depth", depth)
    if not d < q * r**2 / (4 * k):
        raise ValueError(
            f"depth must be below {q * r**2 / (4 * k):.6g}, the deflection without a floor, got {d:g}"
        )

    from scipy.optimize import brentq  # takes long to import

    # for the radius a of contact the edge is at the height 0
    edge = np.array([[r, 0.0]])
    a = float(brentq(lambda a: _deflection(q / (4 * k), d, a, edge)[0], 1e-9 * r, r))
    deflection = partial(_deflection, q / (4 * k), d, a)
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

    ``reference`` holds ``torque`` (N m), of a disc ``elastic_radius`` (m), and ``plastic_torque``, that
    of the bar which yields everywhere; the torque of a solution is twice the integral of u. A square
    that yields in part has a torque where shear * twist * size / yield_stress is 1, 2 or 4, to five
    digits.

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
    half = checks.positive("size", size)
    g = checks.positive("shear", shear)
    theta = checks.positive("twist", twist)
    k = checks.positive("yield_stress", yield_stress)

    order = None if section == "disc" else np.inf
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
        reference = _square_torque(g * theta * half / k, k * half**3)
    return am.ScalarProblem(
        name=f"torsion of a {section} bar",
        domain=domain,
        load=2 * g * theta,
        lower=partial(_roof, -k, half, order),
        upper=partial(_roof, k, half, order),
        reference=reference | {"plastic_torque": plastic},
    )


# partial functions of these can be pickled
def _deflection(factor: float, depth: float, a: float, points: np.ndarray) -> np.ndarray:
    """Return the deflection (n,) at points (n, 2) of the membrane, m, that lies on the floor for r <= a;
    ``factor`` is q / 4k."""
    s = np.maximum(np.linalg.norm(points, axis=1), a)
    return -depth + factor * (s**2 - a**2 - 2 * a**2 * np.log(s / a))


def _roof(slope: float, size: float, order: float | None, points: np.ndarray) -> np.ndarray:
    """Return the limit (n,) slope times the distance from the edge; the section is where norms of
    this order are below ``size``."""
    return slope * np.maximum(size - np.linalg.norm(points, order, axis=1), 0.0)


def _square_torque(twist: float, scale: float) -> dict[str, object]:
    """Return the torque of a square bar, where it is known, over ``scale`` = k a^3 at the twist
    G theta a / k."""
    n = np.arange(1, 40, 2)  # the next terms are below 1e-8
    largest = 2 * (1 - 8 / math.pi**2 * np.sum(1 / (n**2 * np.cosh(n * math.pi / 2))))
    if twist * largest <= 1:
        rest = 192 / math.pi**5 * np.sum(np.tanh(n * math.pi / 2) / n**5)
        return {"torque": float(16 / 3 * twist * scale * (1 - rest))}
    for at, torque in _SQUARE_TORQUES.items():
        if math.isclose(twist, at):
            return {"torque": torque * scale}
    return {}
