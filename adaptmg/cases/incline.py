r"""A block on an incline, held by friction alone.

A block of weight W on a plane tilted by an angle alpha presses on it with :math:`W\cos\alpha` and pulls down it with
:math:`W\sin\alpha`: it rests if and only if :math:`\tan\alpha \le \mu`, and does not tip if :math:`\tan\alpha` is below
its width over its height. An elastic block slips in part before it slides as a whole.

Both bodies are drawn as they lie, the gravity points down; the plane is an elastic slab, held at its underside.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from adaptmg.problem import (
    Assembly,
    BodyForce,
    ContactPair,
    ContactProblem,
    Coulomb,
    Law,
    PlaneStrain,
    Polygon,
    Support,
    checks,
)

__all__ = ["incline"]

_GRAVITY = 9.80665


def incline(*, law: Law = Coulomb(0.5), angle: float = 20.0, width: float = 0.1, height: float = 0.05,  # noqa: B008
            density: float = 2000.0, young: float = 1e9, poisson: float = 0.3) -> ContactProblem:
    """A block on a tilted slab under its own weight; plane strain.

    Parameters
    ----------
    law : Law
        Between block and slab.
    angle : float
        Of the slab, degrees, 0 <= angle < 90; the block would slide towards -x.
    width, height : float
        Of the block, along and normal to the slab, m. The slab is twice as long and as thick as the block is high.
    density : float
        Of the block, kg/m^3; the slab has no weight.
    young, poisson : float
        Of both bodies, Pa, and a number.

    Returns
    -------
    ContactProblem
        Bodies "block" (slave) and "slab". ``reference`` holds ``weight``, ``force_n`` and ``force_t`` (resultants
        normal to the slab and along it, N/m), ``points`` and, with a constant coefficient of friction, ``holds``:
        where it is False, :func:`adaptmg.solve` refuses the problem.

    Raises
    ------
    ValueError
        If the block would tip over.
    """
    angle = checks.nonnegative("angle", angle)
    width, height = checks.quantity("width", width, positive=True), checks.quantity("height", height, positive=True)
    density = checks.quantity("density", density, positive=True)
    if not angle < 90:
        raise ValueError(f"angle must be below 90 degrees, got {angle!r}")
    slope = math.tan(math.radians(angle))
    if not slope < width / height:
        raise ValueError(f"at {angle!r} degrees a block {width:g} m wide and {height:g} m high tips over: its width "
                         f"over its height must be above tan(angle) = {slope:.3g}")
    weight = density * _GRAVITY * width * height
    reference: dict[str, Any] = {
        "quantity": "resultant contact force on the block, N/m", "weight": weight,
        "force_n": weight * math.cos(math.radians(angle)), "force_t": weight * math.sin(math.radians(angle)),
        "sources": {"force_n": "equilibrium", "force_t": "equilibrium"}}
    if isinstance(law, Coulomb) and not callable(law.friction) and np.ndim(law.friction) == 0:
        reference["holds"] = slope <= law.friction
    return ContactProblem(
        name="block on an incline",
        material=PlaneStrain(young=young, poisson=poisson),
        domain=Assembly(parts={
            "block": _tilted(-width / 2, 0.0, width, height, angle, ("bottom", "uphill", "top", "downhill")),
            "slab": _tilted(-width, -height, 2 * width, height, angle, ("bottom", "right", "top", "left"))}),
        contact=ContactPair("block.bottom", "slab.top"),
        law=law,
        loads=(BodyForce((0.0, -density * _GRAVITY), body="block"),),
        supports=(Support("slab.bottom", x=0.0, y=0.0),),
        reference=reference,
    )


def _tilted(x: float, y: float, width: float, height: float, angle: float, names: tuple[str, ...]) -> Polygon:
    """A rectangle turned about the origin by an angle in degrees."""
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    corners = ((x, y), (x + width, y), (x + width, y + height), (x, y + height))
    return Polygon(vertices=tuple((c * p - s * q, s * p + c * q) for p, q in corners), boundaries=names)
