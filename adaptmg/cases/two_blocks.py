r"""Two blocks pressed on each other: the patch test of contact, flat or with a sloping interface, in 2D and 3D.

Under a pressure p on the head and q on the sides both blocks have the uniform stress
:math:`\sigma = -\mathrm{diag}(q, p)` (in 3D :math:`-\mathrm{diag}(q, q, p)`, with q also on the depth), whatever the
meshes: on an interface whose slope is theta,

.. math:: p_n = p\cos^2\theta + q\sin^2\theta,\qquad t = (p - q)\sin\theta\cos\theta,

which P1 elements and a mortar method reproduce to rounding if friction can bear it: :math:`|t| \le \mu p_n`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from adaptmg.mesh import MeshArrays
from adaptmg.problem import (
    Assembly,
    Box,
    ContactPair,
    ContactProblem,
    Coulomb,
    Domain,
    Extrusion,
    Frictionless,
    Law,
    PlaneStrain,
    Polygon,
    Pressure,
    Rectangle,
    Solid,
    Support,
    Tresca,
    checks,
)

__all__ = ["patch_mesh", "two_block_patch"]

_STEEPEST = 30.0


def two_block_patch(*, law: Law = Coulomb(0.5), dim: int = 2, slope: float = 0.0, pressure: float = 1e8,  # noqa: B008
                    side_pressure: float = 0.0, young: float = 2.1e11, poisson: float = 0.3, size: float = 0.1
                    ) -> ContactProblem:
    """Two blocks of one material, one on the other; the stress is uniform.

    Parameters
    ----------
    law : Law
        Between the blocks.
    dim : int
        2 (plane strain) or 3.
    slope : float
        Of the interface against the horizontal, rising along x, degrees, 0 .. 30.
    pressure, side_pressure : float
        p > 0 on the head, q on the sides, Pa.
    young, poisson : float
        Of both blocks, Pa, and a number.
    size : float
        Width and depth of the blocks, m; each is ``size`` high in the mean.

    Returns
    -------
    ContactProblem
        Bodies "upper" (slave) and "lower". Flat blocks are rectangles or boxes (up is y, or z); sloping ones polygons,
        or their extrusions along z (up is y). ``reference`` holds ``pressure`` and ``traction`` (size of the
        tangential one) on the interface, Pa.

    Raises
    ------
    ValueError
        If the law cannot bear the uniform stress: without friction a slope wants ``side_pressure`` = ``pressure``.

    See Also
    --------
    patch_mesh : a mesh whose nodes match along the interface, or do not.
    """
    if dim not in (2, 3):
        raise ValueError(f"dim must be 2 or 3, got {dim!r}")
    slope, size = checks.nonnegative("slope", slope), checks.quantity("size", size, positive=True)
    if not slope <= _STEEPEST:
        raise ValueError(f"slope must be at most {_STEEPEST:g} degrees, got {slope!r}")
    pressure = checks.quantity("pressure", pressure, positive=True)
    side_pressure = checks.nonnegative("side_pressure", side_pressure)
    turn = math.radians(slope)
    normal = pressure * math.cos(turn)**2 + side_pressure * math.sin(turn)**2
    tangential = abs(pressure - side_pressure) * math.sin(turn) * math.cos(turn)
    most = _bound(law, normal)
    if not tangential <= most * (1 + 1e-12):
        raise ValueError(f"the interface would have to bear a tangential traction of {tangential:.6g} Pa, the law "
                         f"allows {most:.6g} Pa at the pressure {normal:.6g} Pa: take less slope, more friction, or "
                         "side_pressure = pressure")
    reference: dict[str, Any] = {"quantity": "pressure and tangential traction on the interface, Pa",
                                 "pressure": normal, "traction": tangential,
                                 "sources": {"pressure": "uniform stress (patch test), exact on every mesh"}}
    parts = _sloping(dim, math.tan(turn), size) if slope else _flat(dim, size)
    loads, supports = _held(dim, bool(slope), pressure, side_pressure)
    material = (PlaneStrain if dim == 2 else Solid)(young=young, poisson=poisson)
    pair = ContactPair("upper.interface", "lower.interface") if slope else ContactPair("upper.bottom", "lower.top")
    return ContactProblem(name=f"two blocks, {dim}D", material=material, domain=Assembly(parts=parts), contact=pair,
                          law=law, loads=loads, supports=supports, reference=reference)


def _bound(law: Law, normal: float) -> float:
    """What a law allows at a pressure; infinity where its parameters vary in space."""
    if isinstance(law, Frictionless):
        return 0.0
    value = law.friction if isinstance(law, Coulomb) else law.limit if isinstance(law, Tresca) else np.inf
    if callable(value) or np.ndim(value):
        return np.inf
    return float(value) * normal if isinstance(law, Coulomb) else float(value)


def _flat(dim: int, size: float) -> dict[str, Domain]:
    if dim == 2:
        return {"upper": Rectangle(width=size, height=size),
                "lower": Rectangle(width=size, height=size, origin=(0.0, -size))}
    return {"upper": Box(width=size, depth=size, height=size),
            "lower": Box(width=size, depth=size, height=size, origin=(0.0, 0.0, -size))}


def _sloping(dim: int, tangent: float, size: float) -> dict[str, Domain]:
    """Profiles whose interface goes through the middle (size / 2, 0); the walls x = 0 are held away from it only."""
    left, right = -0.5 * tangent * size, 0.5 * tangent * size
    lower = Polygon(vertices=((0.0, -size), (size, -size), (size, right), (0.0, left), (0.0, -0.6 * size)),
                    boundaries=("foot", "right", "interface", "shoulder", "left"))
    upper = Polygon(vertices=((0.0, left), (size, right), (size, size), (0.0, size), (0.0, 0.6 * size)),
                    boundaries=("interface", "right", "head", "left", "shoulder"))
    if dim == 2:
        return {"upper": upper, "lower": lower}
    return {"upper": Extrusion(upper, size), "lower": Extrusion(lower, size)}


def _held(dim: int, sloping: bool, pressure: float, side: float) -> tuple[list[Pressure], list[Support]]:
    """Loads and supports; a held wall near a sloping interface would have no business with its normals."""
    if sloping:
        walls, head, foot, depth = ("right", "shoulder"), "upper.head", Support("lower.foot", y=0.0), ("bottom", "top")
    elif dim == 2:
        walls, head, foot, depth = ("right",), "upper.top", Support("lower.bottom", y=0.0), ("", "")
    else:
        walls, head, foot, depth = ("right",), "upper.top", Support("lower.bottom", z=0.0), ("front", "back")
    loads, supports = [Pressure(head, pressure)], [foot]
    for body in ("upper", "lower"):
        supports.append(Support(f"{body}.left", x=0.0))
        loads += [Pressure(f"{body}.{wall}", side) for wall in walls if side]
        if dim == 3:
            supports.append(Support(f"{body}.{depth[0]}", **{"z" if sloping else "y": 0.0}))
            loads += [Pressure(f"{body}.{depth[1]}", side)] if side else []
    return loads, supports


def patch_mesh(problem: ContactProblem, cells: int = 4, *, matching: bool = False) -> MeshArrays:
    """A mesh of :func:`two_block_patch`.

    Parameters
    ----------
    problem : ContactProblem
    cells : int
        Along the width of the upper block, >= 1.
    matching : bool
        Whether the nodes of both blocks meet on the interface (by default the lower block has other cells). On flat
        blocks only.
    """
    from adaptmg.mesh import graded, structured

    cells = checks.integer("cells", cells, 1)
    if not isinstance(matching, bool):
        raise TypeError(f"matching must be True or False, got {matching!r}")
    domain = problem.domain
    other = cells if matching else cells + 1 + cells // 3
    if isinstance(domain.parts["upper"], Rectangle | Box):
        return structured(domain, {"upper": cells, "lower": other})
    if matching:
        raise ValueError("matching=True is for flat blocks: nodes of independent meshes of sloping ones do not meet")
    width = float(domain.upper[0] - domain.lower[0])
    return graded(domain, {"upper": width / cells, "lower": width / other})
