r"""The dovetail joint: a tongue in a notch, pulled out against its flanks (Example 2 of the paper, our reconstruction).

The paper shows a deformed mesh and gives neither geometry nor loads, so both are ours. One half by symmetry, plane
strain, lengths in mm (``angle`` is that of the flanks from the horizontal)::

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

The flank opens at the mouth, slips, sticks in its middle and slips to its lower end, where the corner of the chamfer
makes an edge singularity; the floor opens.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.problem import Law

_MM = 1e-3
_NECK, _RISE, _DEPTH, _CHAMFER = 12.0, 24.0, 16.0, 3.0
_SIDE, _BOTTOM = 36.0, 40.0
# the least width of the block next to the notch
_LEAST_WALL = 6.0

_DEFAULTS = {"angle": 50.0, "pull": 100e6, "clamp": 120e6, "young": 2.1e11, "poisson": 0.3}


def dovetail(*, law: Law = am.Coulomb(0.2), angle: float = 50.0, pull: float = 100e6, clamp: float = 120e6,  # noqa: B008
             young: float = 2.1e11, poisson: float = 0.3) -> am.ContactProblem:
    """Pose the dovetail joint; a reconstruction with our own geometry and loads.

    Bodies "tongue" (slave) and "block". For the default parameters ``reference`` holds ``points`` (name -> position,
    m), ``values`` (source -> point -> lift u_y, m), ``zones`` on the flank (state -> ranges of depth below the mouth,
    m), ``tolerances`` of both (m), ``sources`` and ``remark``; otherwise only ``remark``.

    Parameters
    ----------
    law : Law
        On flank and floor.
    angle : float
        Of the flanks from the horizontal, degrees, below 90.
    pull : float
        Traction on the top of the neck, Pa; positive pulls the tongue out.
    clamp : float
        Pressure on the side of the block, Pa.
    young, poisson : float
        Of both parts, Pa, and a number.

    Examples
    --------
    >>> am.cases.dovetail().domain.bodies
    ('tongue', 'block')
    """
    parameters = {"angle": angle, "pull": pull, "clamp": clamp, "young": young, "poisson": poisson}
    angle = _checked_angle(angle)
    pull, clamp = checks.quantity("pull", pull), checks.quantity("clamp", clamp)
    reference: Mapping[str, object] = {"remark": _REMARK}
    if parameters == _DEFAULTS and isinstance(law, am.Coulomb) and not callable(law.friction) and law.friction == 0.2:
        reference = _REFERENCE
    return am.ContactProblem(
        name="dovetail", material=am.PlaneStrain(young=young, poisson=poisson),
        domain=am.Assembly(parts={"tongue": _tongue(angle), "block": _block(angle)}),
        law=law,
        contact=(am.ContactPair("tongue.flank", "block.flank"), am.ContactPair("tongue.bottom", "block.floor")),
        loads=(am.Traction("tongue.top", (0.0, pull)), am.Pressure("block.side", clamp)),
        supports=(am.Support("tongue.symmetry", x=0.0), am.Support("block.symmetry", x=0.0),
                  am.Support("block.bottom", x=0.0, y=0.0)),
        reference=reference)


def _checked_angle(angle: float) -> float:
    angle = checks.number("angle", angle)
    least = math.degrees(math.atan2(_DEPTH, _SIDE - _LEAST_WALL - _NECK))
    if not least <= angle < 90:
        raise ValueError(f"angle must be at least {least:.1f} degrees from the horizontal and below 90, got {angle!r}")
    return math.radians(angle)


def _tongue(angle: float) -> am.Polygon:
    foot = _NECK + (_DEPTH - _CHAMFER) / math.tan(angle)
    return _polygon([(0.0, -_DEPTH), (foot - _CHAMFER, -_DEPTH), (foot, _CHAMFER - _DEPTH), (_NECK, 0.0),
                     (_NECK, _RISE), (0.0, _RISE)], ("bottom", "chamfer", "flank", "neck", "top", "symmetry"))


def _block(angle: float) -> am.Polygon:
    root = _NECK + _DEPTH / math.tan(angle)
    return _polygon([(0.0, -_BOTTOM), (_SIDE, -_BOTTOM), (_SIDE, 0.0), (_NECK, 0.0), (root, -_DEPTH), (0.0, -_DEPTH)],
                    ("bottom", "side", "shoulder", "flank", "floor", "symmetry"))


def _polygon(corners: list[tuple[float, float]], names: tuple[str, ...]) -> am.Polygon:
    return am.Polygon(vertices=tuple((x * _MM, y * _MM) for x, y in corners), boundaries=names)


_REMARK = ("A reconstruction: the paper gives neither geometry nor loads of its Example 2, and no values are known to "
           "compare with but our own.")
_REFERENCE = {
    "quantity": "lift u_y of the top of the neck, m",
    "points": {"axis": (0.0, _RISE * _MM), "corner": (_NECK * _MM, _RISE * _MM)},
    "values": {"converged": {"axis": 90.68e-6, "corner": 90.93e-6}},
    "zones": {"open": ((0.0, 2.87e-3),), "slip": ((2.87e-3, 7.34e-3), (12.16e-3, 13e-3)),
              "stick": ((7.34e-3, 12.16e-3),)},
    "tolerances": {"values": 0.01e-6, "zones": 0.04e-3},
    "sources": {"converged": "our own: P1 meshes graded to the four corners at contact, sizes falling by 1.4 up to "
                             "60 430 nodes, active set method to 1e-10; the lift extrapolated with an error ~ "
                             "1 / nodes (90.42, 90.54, 90.61 um on the axis on the last three meshes)"},
    "remark": _REMARK,
}
