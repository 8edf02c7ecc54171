r"""The two examples of the paper: the GRECO bar with its variants, and the dovetail joint.

The GRECO bar: a square pressed on a rigid plane and pushed along it (Example 1 of the paper), and
its variants.

Half of a long bar of 80 x 40 mm in plane strain: u_x = 0 on the plane of symmetry x = a ('right'),
a rigid plane with Coulomb friction at y = 0 ('bottom'), pressure on the top, and a larger one on x
= 0 ('left') that pushes in +x. The contact opens near x = 0, slips, and sticks towards the plane of
symmetry. Reference values: Code_Aster test SSNV128 (V6.04.128), after Raous, Chabrand and Lebon, J.
Mec. Theor. Appl. 7 (1988), and a P2 computation on fine meshes. Without friction the case is a
patch test: full contact under the uniform stress
:math:`\sigma_{xx} = -p_{side},\ \sigma_{yy} = -p_{top}`, with

.. math:: u_x = -(a - x)\,\varepsilon_{xx},\quad u_y = y\,\varepsilon_{yy},\quad
   E\,\varepsilon_{xx} = (1-\nu^2)\,\sigma_{xx} - \nu(1+\nu)\,\sigma_{yy}.

The dovetail joint: a tongue in a notch, pulled out against its flanks (Example 2 of the paper, our
reconstruction).

The paper shows a deformed mesh and gives neither geometry nor loads, so both are ours. One half by
symmetry, plane strain, lengths in mm (``angle`` is that of the flanks from the horizontal)::

              neck, pulled                      tongue: (0, -16) .. chamfer .. flank .. (12, 0), neck to y = 24
            +------+  y = 24                    block:  notch with the same flank and the floor y = -16,
            |      |                                    side at x = 36, bottom at y = -40
            |      +-------------+  y = 0
       x=0  |       \            |              The tongue's flank ends at the depth 13, where a chamfer of
            | tongue \   block   | x = 36       3 x 3 begins; the notch's flank goes on to the floor.
            |         \          | clamped
            +----------+         |
            |                    |
            +--------------------+  y = -40, fixed

The flank opens at the mouth, slips, sticks in its middle and slips to its lower end, where the
corner of the chamfer makes an edge singularity; the floor opens."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.problem import Law


def constant_friction(law: Law) -> float | None:
    """Return the coefficient of a law of Coulomb that is the same everywhere, else None."""
    return law.friction if isinstance(law, am.Coulomb) and isinstance(law.friction, float) else None


@cache
def defaults_of(case: Callable[..., object]) -> dict[str, object]:
    """Return the default arguments of a case, without its law."""
    arguments = inspect.signature(case).parameters.values()
    return {argument.name: argument.default for argument in arguments if argument.name != "law"}


# where the points of the test SSNV128 lie, m; studies/accuracy.py compares the values there
_POINTS = {
    "A": (0.0, 0.0),
    "B": (1.25e-3, 0.0),
    "C": (5e-3, 0.0),
    "D": (7.5e-3, 0.0),
    "E": (11.25e-3, 0.0),
}
# the sources are named in it; studies/accuracy.py compares with these values
_REFERENCE = {
    "quantity": "tangential displacement u_x, m",
    "points": _POINTS,
    "values": {
        "SSNV128": {"A": 2.86e-5, "B": 2.72e-5, "C": 2.28e-5, "D": 1.98e-5, "E": 1.50e-5},
        "converged": {
            "A": 2.860321e-5,
            "B": 2.722589e-5,
            "C": 2.286829e-5,
            "D": 1.980758e-5,
            "E": 1.541403e-5,
        },
    },
    "sources": {
        "SSNV128": "Code_Aster test SSNV128, average of codes (Raous, Chabrand, Lebon 1988)",
        "converged": "P2 on fine meshes, two independent codes agreeing to 2e-7",
    },
    "remark": "The published value at E is 2.8 % below the converged one; elsewhere the two agree to .3 %.",
    "zones": {"open": (0.0, 3.32e-3), "slip": (3.32e-3, 29.86e-3), "stick": (29.86e-3, 40e-3)},
}


def greco_bar(
    *,
    law: Law = am.Coulomb(1.0),
    top_pressure: float = 5e7,
    side_pressure: float = 15e7,
    young: float = 1.3e11,
    poisson: float = 0.2,
    size: float = 40e-3,
) -> am.ContactProblem:
    """Pose the GRECO bar.

    ``reference`` holds ``quantity``, ``points`` (name -> position, m), ``values`` (source -> point
    -> m), ``sources``, ``remark`` and ``zones`` (state -> range of x, m) for the default
    parameters, without friction for all with ``top_pressure`` > 0; otherwise it is empty.

    Parameters
    ----------
    law : Law
        On the plane y = 0.
    top_pressure, side_pressure : float
        On the top and on x = 0, Pa; positive pushes into the body.
    young, poisson : float
        Pa, and a number.
    size : float
        Side of the square, m.

    Examples
    --------
    >>> am.cases.greco_bar(law=am.Coulomb(0.5)).law.friction
    0.5
    """
    parameters = {
        "top_pressure": top_pressure,
        "side_pressure": side_pressure,
        "young": young,
        "poisson": poisson,
        "size": size,
    }
    size = checks.quantity("size", size, positive=True)
    material = am.PlaneStrain(young=young, poisson=poisson)
    top_pressure = checks.quantity("top_pressure", top_pressure)
    side_pressure = checks.quantity("side_pressure", side_pressure)
    reference: Mapping[str, object] = {}
    if isinstance(law, am.Frictionless) and top_pressure > 0:
        reference = _patch_test(material, top_pressure, side_pressure, size)
    elif parameters == defaults_of(greco_bar) and constant_friction(law) == 1.0:
        reference = _REFERENCE
    return am.ContactProblem(
        name="GRECO bar",
        material=material,
        domain=am.Rectangle(width=size, height=size),
        contact=am.Contact("bottom", am.Plane(point=(0.0, 0.0), normal=(0.0, 1.0))),
        law=law,
        loads=(am.Pressure("top", top_pressure), am.Pressure("left", side_pressure)),
        supports=(am.Support("right", x=0.0),),
        reference=reference,
    )


def _patch_test(
    material: am.PlaneStrain, top_pressure: float, side_pressure: float, size: float
) -> dict[str, object]:
    """Return the reference values of the bar without friction: uniform stress."""
    nu = material.poisson
    strain = (-(1 - nu**2) * side_pressure + nu * (1 + nu) * top_pressure) / material.young
    # where the points lie along the bottom, over its length: _POINTS are those of a bar of 40 mm
    fractions = {"A": 0.0, "B": 1.25 / 40, "C": 5 / 40, "D": 7.5 / 40, "E": 11.25 / 40}
    exact = {name: -(1 - fraction) * size * strain for name, fraction in fractions.items()}
    return {
        "quantity": _REFERENCE["quantity"],
        "points": {name: tuple(np.array(point) * size / 40e-3) for name, point in _POINTS.items()},
        "values": {"exact": exact},
        "sources": {"exact": "uniform stress (patch test): P1 elements are exact on every mesh"},
        "remark": "Full contact under uniform stress; a nested start solves it exactly, so it says nothing about "
        "the convergence of a solver.",
        "zones": {"slip": (0.0, size)},
    }


def greco_block(
    *,
    law: Law = am.Coulomb(1.0),
    top_pressure: float = 5e7,
    side_pressure: float = 15e7,
    young: float = 1.3e11,
    poisson: float = 0.2,
    size: float = 40e-3,
    depth: float = 40e-3,
    plane_strain: bool = True,
) -> am.ContactProblem:
    """Pose the GRECO bar as a solid: a box pressed on the plane z = 0 and pushed along x.

    Parameters
    ----------
    law, top_pressure, side_pressure, young, poisson : see :func:`~adaptmg.cases.greco_bar`
    size : float
        Length along x and height along z, m.
    depth : float
        Length along y, m.
    plane_strain : bool
        Fix u_y on front and back (True), where ``reference`` holds the values of the plane bar, or
        on the front only.

    Examples
    --------
    >>> am.cases.greco_block().dim
    3
    """
    checks.flag("plane_strain", plane_strain)
    depth = checks.quantity("depth", depth, positive=True)
    bar = greco_bar(
        law=law,
        top_pressure=top_pressure,
        side_pressure=side_pressure,
        young=young,
        poisson=poisson,
        size=size,
    )
    reference = {}
    if plane_strain and bar.reference:
        points = {name: (x, depth / 2, z) for name, (x, z) in bar.reference["points"].items()}
        remark = f"Values of the plane-strain bar. {bar.reference['remark']}"
        reference = {**bar.reference, "points": points, "remark": remark}
    held = ("front", "back") if plane_strain else ("front",)
    return am.ContactProblem(
        name="GRECO block" if plane_strain else "GRECO block, free back",
        material=am.Solid(young=young, poisson=poisson),
        domain=am.Box(width=size, depth=depth, height=size),
        contact=am.Contact("bottom", am.Plane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))),
        law=law,
        loads=(am.Pressure("top", top_pressure), am.Pressure("left", side_pressure)),
        supports=(am.Support("right", x=0.0), *(am.Support(face, y=0.0) for face in held)),
        reference=reference,
    )


def _parabolic_gap(position: float, radius: float, points: np.ndarray) -> np.ndarray:
    """Return the gaps (n,), m, at points (n, dim) to an obstacle that touches at x = position."""
    return (position - points[:, 0]) ** 2 / (2 * radius)


def curved_obstacle(
    *,
    law: Law = am.Frictionless(),
    radius: float = 10.0,
    top_pressure: float = 5e7,
    side_pressure: float = 15e7,
    young: float = 1.3e11,
    poisson: float = 0.2,
    size: float = 40e-3,
) -> am.ContactProblem:
    """Pose the GRECO bar in front of a curved obstacle: the contact zone is unknown.

    The gap under the bottom is (size - x)^2 / (2 radius).

    By default ``reference["touching"]`` is the number of touching nodes, by divisions of the
    uniform mesh.

    Parameters
    ----------
    law : Law
        On the bottom.
    radius : float
        Radius of curvature of the obstacle, m.
    top_pressure, side_pressure, young, poisson, size : float
        As in :func:`~adaptmg.cases.greco_bar`.

    Examples
    --------
    >>> am.cases.curved_obstacle().dim
    2
    """
    bar = greco_bar(
        law=law,
        top_pressure=top_pressure,
        side_pressure=side_pressure,
        young=young,
        poisson=poisson,
        size=size,
    )
    parameters = {
        "radius": radius,
        "top_pressure": top_pressure,
        "side_pressure": side_pressure,
        "young": young,
        "poisson": poisson,
        "size": size,
    }
    default = isinstance(law, am.Frictionless) and parameters == defaults_of(curved_obstacle)
    reference = (
        {"touching": {32: 17}, "sources": {"touching": "direct active-set solve"}}
        if default
        else {}
    )
    gap = partial(_parabolic_gap, float(size), checks.quantity("radius", radius, positive=True))
    return replace(
        bar,
        name="curved obstacle",
        contact=am.Contact("bottom", am.GapFunction(gap)),
        reference=reference,
    )


def upset_block(
    *,
    law: Law = am.Coulomb(0.5),
    top_pressure: float = 5e7,
    young: float = 1.3e11,
    poisson: float = 0.2,
    size: float = 40e-3,
) -> am.ContactProblem:
    """Pose the GRECO bar without side pressure, friction 0.5.

    Friction holds the foot, so that sticking contact meets the free 90 degree corner at x = 0:
    there u ~ r^lambda with lambda < 1.

    ``reference`` holds, for constant friction that suffices for that and a Poisson's ratio > 0 (at 0
    nothing spreads, and lambda is 1), ``exponent`` (lambda), ``sources`` and ``uniform_rate``: the energy
    error falls like N^-uniform_rate on uniform meshes of N nodes. Friction 0.5 suffices for Poisson's ratios
    up to 0.496, friction 0.3 for those up to 0.297.

    Parameters
    ----------
    law : Law
        On the plane y = 0.
    top_pressure, young, poisson, size : float
        As in :func:`~adaptmg.cases.greco_bar`.

    Examples
    --------
    >>> am.cases.upset_block().dim
    2
    """
    problem = greco_bar(
        law=law,
        top_pressure=top_pressure,
        side_pressure=0.0,
        young=young,
        poisson=poisson,
        size=size,
    )
    reference = {}
    friction = constant_friction(law)
    exponent = _clamped_free_exponent(poisson)
    if poisson > 0 and (friction or 0.0) >= _holding_friction(poisson, exponent):
        reference = {
            "exponent": exponent,
            "uniform_rate": exponent / 2,
            "sources": {"exponent": "characteristic equation of the clamped-free 90 degree corner"},
        }
    return replace(problem, name="upset block", reference=reference)


def _clamped_free_exponent(poisson: float) -> float:
    """Solve M. L. Williams' characteristic equation of a clamped-free corner of 90 degrees in plane
    strain, J. Appl. Mech. 19 (1952)."""
    from scipy.optimize import brentq  # takes long to import

    def characteristic(exponent: float) -> float:
        ratio = (4 * (1 - poisson) ** 2 - exponent**2) / (3 - 4 * poisson)
        return math.sin(exponent * math.pi / 2) ** 2 - ratio

    return float(brentq(characteristic, 0, 1))


def _holding_friction(poisson: float, exponent: float) -> float:
    r"""Return the friction from which on that corner sticks: the ratio of its shear traction to its
    pressure, the same all along the clamped side.

    With :math:`\varphi = a z^\lambda,\ \psi = b z^\lambda,\ \kappa = 3 - 4\nu` (as in
    :mod:`adaptmg.cases.transition`) no displacement at y = 0 makes
    :math:`\bar b = \kappa a - \lambda\bar a`, so that :math:`\sigma_{yy} + i\sigma_{xy} = \lambda (1 +
    \kappa)\bar a x^{\lambda - 1}`, and no force on x = 0 makes
    :math:`2\lambda\bar a = a (\kappa + e^{i\pi\lambda})`: the angle of a is half that of
    :math:`\kappa + e^{i\pi\lambda}`, but for its sign."""
    kappa = 3 - 4 * poisson
    turn = math.pi * exponent
    return math.tan(0.5 * math.atan2(math.sin(turn), kappa + math.cos(turn)))


_MM = 1 / 1000
# lengths of the joint in mm, chosen, since the paper has none
_NECK, _RISE, _DEPTH, _CHAMFER = 12, 24, 16, 3
_SIDE, _BOTTOM = 36, 40
# the least width of the block next to the notch
_LEAST_WALL = _NECK / 2
#: pressure on the side of the block, Pa: chosen so that the flank opens, slips and sticks, as measured
#: at 93, 28 and 24 nodes of the default mesh; with half or twice of it two of these states are left
_CLAMP = 120e6


def dovetail(
    *,
    law: Law = am.Coulomb(0.2),
    angle: float = 50.0,
    pull: float = 100e6,
    young: float = 2.1e11,
    poisson: float = 0.3,
) -> am.ContactProblem:
    """Pose the dovetail joint; a reconstruction with our own geometry and loads.

    Bodies "tongue" (slave) and "block". For the default parameters ``reference`` holds ``quantity``
    (as text), ``points`` (name -> position, m), ``values`` (source -> point -> lift u_y, m), ``zones`` on the flank
    (state -> ranges of depth below the mouth, m), ``tolerances`` of both (m), ``sources`` and
    ``remark``; otherwise only ``remark``.

    Parameters
    ----------
    law : Law
        On flank and floor.
    angle : float
        Of the flanks from the horizontal, degrees, below 90.
    pull : float
        Traction on the top of the neck, Pa; positive pulls the tongue out.
    young, poisson : float
        Of both parts, Pa, and a number.

    Examples
    --------
    >>> am.cases.dovetail().domain.bodies
    ('tongue', 'block')
    """
    parameters = {"angle": angle, "pull": pull, "young": young, "poisson": poisson}
    angle = _checked_angle(angle)
    pull = checks.quantity("pull", pull)
    reference: Mapping[str, object] = {"remark": _JOINT_REMARK}
    if constant_friction(law) == 0.2 and parameters == defaults_of(dovetail):
        reference = _JOINT_REFERENCE
    return am.ContactProblem(
        name="dovetail",
        material=am.PlaneStrain(young=young, poisson=poisson),
        domain=am.Assembly(parts={"tongue": _tongue(angle), "block": _block(angle)}),
        law=law,
        contact=(
            am.ContactPair("tongue.flank", "block.flank"),
            am.ContactPair("tongue.bottom", "block.floor"),
        ),
        loads=(am.Traction("tongue.top", (0.0, pull)), am.Pressure("block.side", _CLAMP)),
        supports=(
            am.Support("tongue.symmetry", x=0.0),
            am.Support("block.symmetry", x=0.0),
            am.Support("block.bottom", x=0.0, y=0.0),
        ),
        reference=reference,
    )


def _checked_angle(angle: float) -> float:
    """Return the angle of the flanks in radians; ValueError where the notch leaves no wall."""
    angle = checks.number("angle", angle)
    least = math.degrees(math.atan2(_DEPTH, _SIDE - _LEAST_WALL - _NECK))
    if not least <= angle < 90:
        raise ValueError(
            f"angle must be at least {least:.1f} degrees from the horizontal and below 90, got {angle!r}"
        )
    return math.radians(angle)


def _tongue(angle: float) -> am.Polygon:
    """Return the tongue with flanks at an angle in radians."""
    foot = _NECK + (_DEPTH - _CHAMFER) / math.tan(angle)
    return _polygon(
        [
            (0.0, -_DEPTH),
            (foot - _CHAMFER, -_DEPTH),
            (foot, _CHAMFER - _DEPTH),
            (_NECK, 0.0),
            (_NECK, _RISE),
            (0.0, _RISE),
        ],
        ("bottom", "chamfer", "flank", "neck", "top", "symmetry"),
    )


def _block(angle: float) -> am.Polygon:
    """Return the block with the notch of the same flanks."""
    root = _NECK + _DEPTH / math.tan(angle)
    return _polygon(
        [
            (0.0, -_BOTTOM),
            (_SIDE, -_BOTTOM),
            (_SIDE, 0.0),
            (_NECK, 0.0),
            (root, -_DEPTH),
            (0.0, -_DEPTH),
        ],
        ("bottom", "side", "shoulder", "flank", "floor", "symmetry"),
    )


def _polygon(corners: list[tuple[float, float]], names: tuple[str, ...]) -> am.Polygon:
    """Return a polygon with corners in mm."""
    return am.Polygon(vertices=tuple((x * _MM, y * _MM) for x, y in corners), boundaries=names)


_JOINT_REMARK = (
    "A reconstruction: the paper gives neither geometry nor loads of its Example 2, and no values are "
    "known to compare with but our own."
)
# by the meshes that its sources name; studies/dovetail.py solves the case
_JOINT_REFERENCE = {
    "quantity": "lift u_y of the top of the neck, m",
    "points": {"axis": (0.0, _RISE * _MM), "corner": (_NECK * _MM, _RISE * _MM)},
    "values": {"converged": {"axis": 90.68e-6, "corner": 90.93e-6}},
    "zones": {
        "open": ((0.0, 2.87e-3),),
        "slip": ((2.87e-3, 7.34e-3), (12.16e-3, 13e-3)),
        "stick": ((7.34e-3, 12.16e-3),),
    },
    "tolerances": {"values": 0.01e-6, "zones": 0.04e-3},
    "sources": {
        "converged": "our own: P1 meshes graded to the four corners at contact, sizes falling by 1.4 up to "
        "60 430 nodes, active set method to 1e-10; the lift extrapolated with an error ~ "
        "1 / nodes (90.42, 90.54, 90.61 um on the axis on the last three meshes)"
    },
    "remark": _JOINT_REMARK,
}
