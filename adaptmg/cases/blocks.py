r"""Blocks with known contact forces: the patch test of two blocks, a block on an incline, and a
leaning strut.

Under a pressure p on the head and q on the sides two blocks on each other have the uniform stress
:math:`\sigma = -\mathrm{diag}(q, p)` (in 3D :math:`-\mathrm{diag}(q, q, p)`, with q also on the depth) on every mesh;
on an interface of slope theta

.. math:: p_n = p\cos^2\theta + q\sin^2\theta,\qquad t = (p - q)\sin\theta\cos\theta,

which P1 elements and a mortar method reproduce to rounding if friction can bear it: :math:`|t| \le
\mu p_n`."""

from __future__ import annotations

import math

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.cases.paper import constant_friction
from adaptmg.problem import Domain, Law

# measured on its default meshes, the patch is exact to 1e-11 at 15 and 30 degrees and to 1e-8 at 45;
# at 60 edges cross
_STEEPEST = 30.0


def two_block_patch(
    *,
    law: Law = am.Coulomb(0.5),
    dim: int = 2,
    slope: float = 0.0,
    pressure: float = 1e8,
    side_pressure: float = 0.0,
    young: float = 2.1e11,
    poisson: float = 0.3,
    size: float = 0.1,
) -> am.ContactProblem:
    """Pose two blocks of one material, one on the other, under uniform stress: the patch test of
    contact.

    Bodies "upper" (slave) and "lower". Flat blocks are rectangles or boxes (up is y, or z); sloping
    ones polygons, or their extrusions along z (up is y). ``reference`` holds ``quantity`` (as text),
    ``pressure`` and ``traction`` (size of the tangential one) on the interface, Pa, which the law must
    bear, and ``sources``.

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

    Examples
    --------
    >>> len(am.cases.two_block_patch().domain.bodies)
    2
    """
    checks.choice("dim", dim, (2, 3))
    slope = checks.nonnegative("slope", slope)
    size = checks.quantity("size", size, positive=True)
    if not slope <= _STEEPEST:
        raise ValueError(f"slope must be at most {_STEEPEST:g} degrees, got {slope!r}")
    pressure = checks.quantity("pressure", pressure, positive=True)
    side_pressure = checks.nonnegative("side_pressure", side_pressure)
    turn = math.radians(slope)
    normal = pressure * math.cos(turn) ** 2 + side_pressure * math.sin(turn) ** 2
    tangential = abs(pressure - side_pressure) * math.sin(turn) * math.cos(turn)
    most = _bound(law, normal)
    if not tangential <= most * (1 + 1e-12):  # up to rounding
        raise ValueError(
            f"the interface has to bear a tangential traction of {tangential:.6g} Pa, the law allows "
            f"{most:.6g} Pa at the pressure {normal:.6g} Pa: take side_pressure = pressure, for example"
        )
    reference = {
        "quantity": "pressure and tangential traction on the interface, Pa",
        "pressure": normal,
        "traction": tangential,
        "sources": {"pressure": "uniform stress (patch test), exact on every mesh"},
    }
    parts = _sloping(dim, math.tan(turn), size) if slope else _flat(dim, size)
    loads, supports = _held(dim, sloping=bool(slope), pressure=pressure, side=side_pressure)
    material = (am.PlaneStrain if dim == 2 else am.Solid)(young=young, poisson=poisson)
    pair = ("upper.interface", "lower.interface") if slope else ("upper.bottom", "lower.top")
    return am.ContactProblem(
        name=f"two blocks, {dim}D",
        material=material,
        domain=am.Assembly(parts=parts),
        law=law,
        contact=am.ContactPair(*pair),
        loads=loads,
        supports=supports,
        reference=reference,
    )


def _bound(law: Law, normal: float) -> float:
    """Return the largest tangential traction, Pa, that a law allows at a pressure; infinity for
    user-defined laws, and where parameters vary in space."""
    if isinstance(law, am.Frictionless):
        return 0.0
    if isinstance(law, am.Coulomb):
        value = law.friction
        factor = normal
    else:
        value = law.limit if isinstance(law, am.Tresca) else np.inf
        factor = 1.0
    if callable(value) or np.ndim(value):
        return np.inf
    return float(np.asarray(value)) * factor


def _flat(dim: int, size: float) -> dict[str, Domain]:
    """Return two squares or cubes, one on the other."""
    if dim == 2:
        return {
            "upper": am.Rectangle(width=size, height=size),
            "lower": am.Rectangle(width=size, height=size, origin=(0.0, -size)),
        }
    return {
        "upper": am.Box(width=size, depth=size, height=size),
        "lower": am.Box(width=size, depth=size, height=size, origin=(0.0, 0.0, -size)),
    }


def _sloping(dim: int, tangent: float, size: float) -> dict[str, Domain]:
    """Return two bodies with an interface through (size / 2, 0). Their walls at x = 0 are held, except for
    the "shoulder" next to the interface: nodes of which a support holds a part of the normal, which
    slopes here, carry no condition of a pair."""
    # at the walls the interface is at most .29 sizes from y = 0 (30 degrees), the shoulders end at .6
    left = -0.5 * tangent * size
    right = 0.5 * tangent * size
    lower = am.Polygon(
        vertices=((0.0, -size), (size, -size), (size, right), (0.0, left), (0.0, -0.6 * size)),
        boundaries=("foot", "right", "interface", "shoulder", "left"),
    )
    upper = am.Polygon(
        vertices=((0.0, left), (size, right), (size, size), (0.0, size), (0.0, 0.6 * size)),
        boundaries=("interface", "right", "head", "left", "shoulder"),
    )
    if dim == 2:
        return {"upper": upper, "lower": lower}
    return {"upper": am.Extrusion(upper, size), "lower": am.Extrusion(lower, size)}


def _held(
    dim: int, sloping: bool, pressure: float, side: float
) -> tuple[list[am.Pressure], list[am.Support]]:
    """Return the loads and supports of the two blocks, under ``pressure`` on the head and ``side`` on
    the sides. In 3D the first boundary of ``depth`` is held, the second loaded; it runs along z in
    extrusions, which slope, along y in boxes."""
    if sloping:
        walls = ("right", "shoulder")
        head = "upper.head"
        depth = ("bottom", "top")
        foot = am.Support("lower.foot", y=0.0)
    elif dim == 2:
        walls = ("right",)
        head = "upper.top"
        foot = am.Support("lower.bottom", y=0.0)
        depth = ("", "")  # of no use in the plane
    else:
        walls = ("right",)
        head = "upper.top"
        foot = am.Support("lower.bottom", z=0.0)
        depth = ("front", "back")
    loads = [am.Pressure(head, pressure)]
    supports = [foot]
    for body in ("upper", "lower"):
        supports.append(am.Support(f"{body}.left", x=0.0))
        loads += [am.Pressure(f"{body}.{wall}", side) for wall in walls if side]
        if dim == 3:
            side_wall = f"{body}.{depth[0]}"
            along_z = am.Support(side_wall, z=0.0)
            supports.append(along_z if sloping else am.Support(side_wall, y=0.0))
            loads += [am.Pressure(f"{body}.{depth[1]}", side)] if side else []
    return loads, supports


def incline(
    *,
    law: Law = am.Coulomb(0.5),
    angle: float = 20.0,
    width: float = 0.1,
    height: float = 0.05,
    density: float = 2000.0,
    young: float = 1e9,
    poisson: float = 0.3,
) -> am.ContactProblem:
    """Pose a block on a tilted elastic slab under its own weight; plane strain.

    The block of weight W presses on the slab with W cos(angle) and pulls down it with W sin(angle):
    it rests if and only if tan(angle) <= mu. The gravity points down; the slab is held at its
    underside.

    Bodies "block" (slave) and "slab". ``reference`` holds ``quantity`` (as text), ``weight``,
    ``force_n`` and ``force_t`` (resultants normal to the slab and along it, N/m), ``sources`` and, with
    a constant coefficient of friction, ``holds``: where it is False, :func:`adaptmg.solve` refuses the
    problem.

    Parameters
    ----------
    law : Law
        Between block and slab.
    angle : float
        Of the slab, degrees, 0 <= angle < 90; the block would slide towards -x.
    width, height : float
        Of the block, along and normal to the slab, m. The slab is twice as long and as thick as the
        block is high.
    density : float
        Of the block, kg/m^3; the slab has no weight.
    young, poisson : float
        Of both bodies, Pa, and a number.

    Examples
    --------
    >>> am.cases.incline().domain.bodies
    ('block', 'slab')
    """
    angle = checks.nonnegative("angle", angle)
    width = checks.quantity("width", width, positive=True)
    height = checks.quantity("height", height, positive=True)
    density = checks.quantity("density", density, positive=True)
    if not angle < 90:
        raise ValueError(f"angle must be below 90 degrees, got {angle!r}")
    slope = math.tan(math.radians(angle))
    if not slope < width / height:
        raise ValueError(
            f"width over height must be above tan(angle) = {slope:.3g}, got {width / height:.3g}: the "
            "block tips over"
        )
    from scipy.constants import g as gravity  # takes long to import

    weight = density * gravity * width * height
    reference = {
        "quantity": "resultant contact force on the block, N/m",
        "weight": weight,
        "force_n": weight * math.cos(math.radians(angle)),
        "force_t": weight * math.sin(math.radians(angle)),
        "sources": {"force_n": "equilibrium", "force_t": "equilibrium"},
    }
    if (friction := constant_friction(law)) is not None:
        reference["holds"] = slope <= friction
    return am.ContactProblem(
        name="block on an incline",
        material=am.PlaneStrain(young=young, poisson=poisson),
        domain=am.Assembly(
            parts={
                "block": _tilted(
                    -width / 2, 0.0, width, height, angle, ("bottom", "uphill", "top", "downhill")
                ),
                "slab": _tilted(
                    -width, -height, 2 * width, height, angle, ("bottom", "right", "top", "left")
                ),
            }
        ),
        contact=am.ContactPair("block.bottom", "slab.top"),
        law=law,
        loads=(am.BodyForce((0.0, -density * gravity), body="block"),),
        supports=(am.Support("slab.bottom", x=0.0, y=0.0),),
        reference=reference,
    )


def _tilted(
    x: float, y: float, width: float, height: float, angle: float, names: tuple[str, ...]
) -> am.Polygon:
    """Return a rectangle with the lower left corner (x, y), turned by an angle in degrees about the
    origin."""
    c = math.cos(math.radians(angle))
    s = math.sin(math.radians(angle))
    corners = ((x, y), (x + width, y), (x + width, y + height), (x, y + height))
    return am.Polygon(
        vertices=tuple((c * p - s * q, s * p + c * q) for p, q in corners), boundaries=names
    )


# m: a strut of 5 : 1 and the radius of its foot; at other lengths the problem is the same, scaled
_LENGTH = 1 / 10
_WIDTH = _LENGTH / 5
_FOOT = _LENGTH / 4


def leaning_strut(
    *,
    law: Law = am.Coulomb(0.6),
    angle: float = 20.0,
    traction: float = 3e6,
    direction: float = 4.5,
    young: float = 2e11,
    poisson: float = 0.3,
) -> am.ContactProblem:
    """Pose a strut, 100 mm long and 20 mm thick, that leans on a rigid plane: one load has three
    equilibria.

    Its foot is so curved that one node touches. Along its axis it is stiff, across it soft, so that
    a force along the plane also presses the foot on: for friction above tan(angle), about, the foot
    may stick, slip or have lifted off, each in exact equilibrium. The start decides which of them a
    solver finds.

    Parameters
    ----------
    law : Law
        Of the foot.
    angle : float
        Of the strut to the normal of the plane, degrees, 0 < angle < 45.
    traction, direction : float
        Size (Pa) and direction (rad, from x to y) of the load on the right side.
    young, poisson : float
        Pa, and a number.

    Examples
    --------
    >>> am.cases.leaning_strut().dim
    2
    """
    angle = checks.positive("angle", angle)
    if not angle < 45:
        raise ValueError(f"angle must be below 45 degrees, got {angle!r}")
    traction = checks.number("traction", traction)
    direction = checks.number("direction", direction)
    along = _LENGTH * np.array([math.sin(math.radians(angle)), math.cos(math.radians(angle))])
    corners = np.array([[0.0, 0.0], [_WIDTH, 0.0], [_WIDTH + along[0], along[1]], along])
    return am.ContactProblem(
        name="leaning strut",
        law=law,
        material=am.PlaneStrain(young=young, poisson=poisson),
        domain=am.Polygon(
            vertices=tuple(map(tuple, corners.tolist())),
            boundaries=("foot", "right", "head", "left"),
        ),
        contact=am.Contact("foot", am.GapFunction(_curved)),
        loads=(
            am.Traction("right", (traction * math.cos(direction), traction * math.sin(direction))),
        ),
        supports=(am.Support("head", x=0.0, y=0.0),),
    )


def _curved(points: np.ndarray) -> np.ndarray:
    """Return the gap (n,) below the foot, m."""
    return (points[:, 0] - _WIDTH / 2) ** 2 / (2 * _FOOT)
