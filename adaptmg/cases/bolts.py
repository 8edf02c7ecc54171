r"""Bolted junction of two vessels under internal pressure (after Example 3 of the paper): a
reconstruction.

The paper gives neither dimensions nor loads; these are ours. Two flanged pipes touch along the
plane z = 0 with Coulomb friction, n bolts on a circle press them together, and the internal
pressure p acts on the bores and, through the ends of the closed vessel, as the thrust :math:`p\pi
r_i^2` on the upper pipe. The lower pipe is held axially at its end; no pressure acts in the joint.
The joint carries the bolt force F less the thrust. The bolts are shortened by
:math:`\delta` (an initial strain :math:`-\delta/l` over the clamped length l),

.. math:: F = \frac{\delta}{c_b + c_m},\qquad c_b = \frac{l}{E\,n A},\qquad c_m = \frac{l}{E\,A_m},

:math:`A_m` being the effective section of flanges, heads and seats. In axisymmetry the bolts are an equivalent ring of
I-shaped section, the section of its shank that of the n bolts; only the undersides of its heads
touch the flanges. Its Poisson's ratio is 0, because a ring under tension would shrink towards the
axis of the vessels. It also resists hoop strain, which without friction under the heads (the
default in 2D) does not reach the flanges."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.cases.paper import defaults_of
from adaptmg.problem import Law
from adaptmg.problem.solid_domains import SolidDomain

_REMARK = (
    "A reconstruction: the paper gives no dimensions and no loads. The values are our own, by mesh convergence; "
    "nothing published stands behind them."
)

# with the default parameters: studies/bolted_junction.py draws the states that they belong to
_VALUES = {
    "open_to": 0.2249,
    "slip_to": 0.2342,
    "gap": 8.88e-6,
    "peak": 33.5e6,
    "peak_at": 0.245,
    "joint_force": 1.985e6,
    "bolt_force": 2.488e6,
}


def bolted_junction(
    *,
    dim: int = 2,
    preload: float = 2.5e6,
    pressure: float = 4e6,
    friction: float = 0.2,
    flanges: Flanges | None = None,
    young: float = 2.1e11,
    poisson: float = 0.3,
) -> am.ContactProblem:
    """Pose two vessels bolted together, under internal pressure.

    Bodies ``upper``, ``lower`` and the bolts: ``bolt`` (a ring), or ``bolt0``, ``bolt1``, ... in
    3D. The first contact pair is the joint. Along a load path the bolts are tightened before the
    vessels are filled if the loads on "upper.bore", "lower.bore" and "upper.pipe" begin with 0.
    ``reference`` holds ``remark``, ``flanges``, ``pressure`` (Pa) and ``thrust`` (N); with the
    default parameters in 2D also ``values`` by mesh convergence: ``open_to``, ``slip_to``,
    ``peak_at`` (radii, m), ``gap`` (at the bore, m), ``peak`` (Pa), ``joint_force`` and
    ``bolt_force`` (N; of the ring).

    Parameters
    ----------
    dim : {2, 3}
        Axisymmetric with an equivalent ring of bolts, or a sector of 90 degrees with solid bolts,
        between the planes of symmetry y = 0 and x = 0.
    preload : float
        Force of all bolts together without pressure, N, to a few per cent.
    pressure : float
        Inside, Pa.
    friction : float
        Between the flanges. Under the heads it is 0 in 2D, and 0.2 in 3D, where nothing else holds
        the bolts.
    flanges : Flanges, optional
        Dimensions; by default 16 bolts of 24 mm, in 3D 8 bolts of the same section.
    young, poisson : float
        Pa, and a number.

    Examples
    --------
    >>> am.cases.bolted_junction().domain.bodies
    ('upper', 'lower', 'bolt')
    """
    checks.choice("dim", dim, (2, 3))
    if flanges is None:
        flanges = Flanges() if dim == 2 else Flanges(n_bolts=8, diameter=0.034)
    checks.instance("flanges", flanges, Flanges)
    preload = checks.quantity("preload", preload, positive=True)
    pressure = checks.quantity("pressure", pressure)
    material = (am.Axisymmetric if dim == 2 else am.Solid)(young=young, poisson=poisson)
    parameters = {
        "dim": dim,
        "preload": preload,
        "pressure": pressure,
        "friction": friction,
        "flanges": flanges,
        "young": young,
        "poisson": poisson,
    }
    by_default = parameters == defaults_of(bolted_junction) | {"flanges": Flanges()}
    reference: dict[str, object] = {
        "remark": _REMARK,
        "flanges": flanges,
        "pressure": pressure,
        "thrust": flanges.thrust(pressure),
    }
    if by_default:
        reference |= {
            "values": dict(_VALUES),
            "sources": {
                "values": "mesh convergence of this case: contact edges of 1, 0.5 and 0.25 mm"
            },
        }
    parts = _parts(flanges, dim)
    bolts = [name for name in parts if name.startswith("bolt")]
    heads = [
        am.ContactPair(f"{name}.{side}_head", f"{side}.{'seat' if dim == 2 else 'face'}")
        for name in bolts
        for side in ("upper", "lower")
    ]
    # each bolt contracts towards its own axis, not towards that of the vessels
    ring = {"upper": material, "lower": material, "bolt": am.Axisymmetric(young=young, poisson=0.0)}
    # components across the axis of the vessels, which is the last axis
    across = (0.0,) * (dim - 1)
    wall_area = math.pi * ((flanges.bore + flanges.wall) ** 2 - flanges.bore**2)
    strain = (*across, -flanges.shortening(preload, material.young, dim) / flanges.clamped)
    supports = [am.Support("lower.pipe", y=0.0) if dim == 2 else am.Support("lower.pipe", z=0.0)]
    if dim == 3:
        supports += [
            support
            for side in ("upper", "lower")
            for support in (am.Support(f"{side}.start", y=0.0), am.Support(f"{side}.end", x=0.0))
        ]
    return am.ContactProblem(
        name="bolted junction" if dim == 2 else "bolted junction, sector",
        material=ring if dim == 2 else material,
        domain=am.Assembly(parts=parts),
        contact=(am.ContactPair("upper.joint", "lower.joint"), *heads),
        law=_law(friction, flanges, dim),
        supports=supports,
        reference=reference,
        loads=(
            *(am.InitialStrain(name, strain) for name in bolts),
            am.Pressure("upper.bore", pressure),
            am.Pressure("lower.bore", pressure),
            am.Traction("upper.pipe", (*across, flanges.thrust(pressure) / wall_area)),
        ),
    )


def _law(friction: float, flanges: Flanges, dim: int) -> Law:
    """Return the law of the joint and of the heads, whose friction is another one: they lie farther
    from z = 0 than half of the thinner flange."""
    friction = checks.nonnegative("friction", friction)
    heads = 0.0 if dim == 2 else 0.2  # in space nothing else holds the bolts
    if heads == friction:
        return am.Coulomb(friction) if friction else am.Frictionless()
    return am.Coulomb(partial(_friction, friction, heads, 0.5 * min(flanges.upper, flanges.lower)))


def _friction(joint: float, heads: float, reach: float, points: np.ndarray) -> np.ndarray:
    """Return the friction (n,) at points: of the joint within ``reach`` of z = 0, of the heads
    elsewhere."""
    return np.where(np.abs(points[:, -1]) < reach, joint, heads)


def _parts(flanges: Flanges, dim: int) -> dict[str, am.Polygon | SolidDomain]:
    """Return the flanges and bolts by name: sections in axisymmetry, solids in space."""
    upper = _flange_section(flanges, flanges.upper, dim)
    lower = _mirrored(_flange_section(flanges, flanges.lower, dim))
    if dim == 2:
        return {"upper": upper, "lower": lower, "bolt": _ring_section(flanges)}
    places = _bolt_places(flanges)
    return {
        "upper": _drilled(upper, flanges, places),
        "lower": _drilled(lower, flanges, places),
        **{f"bolt{k}": _bolt_solid(flanges, place) for k, place in enumerate(places)},
    }


# effective section A_m of what the bolts clamp, m^2, measured on solutions of the default geometry
# without pressure; bolts are shortened by preload / young (1 / bolt area + 1 / A_m)
_CLAMPED = {2: 0.0341, 3: 0.0124}


@dataclass(frozen=True, kw_only=True)
class Flanges(checks.Checked):
    """Dimensions of the junction, m. Heads are 1.6 times as wide and 0.7 times as high as bolts,
    holes 1.1 times.

    Examples
    --------
    >>> am.cases.Flanges(n_bolts=12).n_bolts
    12
    """

    bore: checks.Positive = 0.200  # inner radius of the vessels
    wall: checks.Positive = 0.012  # thickness of their walls
    length: checks.Positive = 0.120  # from the joint to the end of each pipe
    outer: checks.Positive = 0.270  # outer radius of the flanges
    upper: checks.Positive = 0.040  # thickness of the upper flange
    lower: checks.Positive = 0.050  # thickness of the lower flange
    bolt_circle: checks.Positive = 0.240  # radius on which the bolts stand
    n_bolts: checks.Count = 16
    diameter: checks.Positive = 0.024  # of the shank of a bolt
    seat: checks.Positive = 0.020  # radial width of the heads of the equivalent ring

    def __post_init__(self) -> None:
        super().__post_init__()
        # half of the seat of the ring, as _flange_section draws it, or of a head
        half = 0.5 * max(1.2 * self.seat, self.head_diameter)
        inner = self.bolt_circle - half
        outer = self.bolt_circle + half
        if not self.bore + self.wall < inner < outer < self.outer:
            raise ValueError(
                f"bolt_circle must leave room for heads and seats, {half:g} m to each side, between "
                f"{self.bore + self.wall:g} and {self.outer:g}, got {self.bolt_circle!r}"
            )
        if not max(self.upper, self.lower) < self.length:
            raise ValueError(
                f"length must exceed the thickness of the flanges, got {self.length!r}"
            )
        if not self.shank < 0.8 * self.seat:
            raise ValueError(
                f"seat must be wider than 1.25 times the shank of the ring, {self.shank:g} m, "
                f"got {self.seat!r}"
            )
        if not self.n_bolts * self.head_diameter < 2 * math.pi * self.bolt_circle:
            raise ValueError(
                f"n_bolts: {self.n_bolts} heads of {self.head_diameter:g} m do not fit on the bolt circle"
            )

    @property
    def head_diameter(self) -> float:
        """Return the diameter of the head of a bolt, m."""
        return 1.6 * self.diameter

    @property
    def head_height(self) -> float:
        """Return the height of the head of a bolt, m."""
        return 0.7 * self.diameter

    @property
    def hole(self) -> float:
        """Return the radius of the bolt holes, m."""
        return 0.55 * self.diameter

    @property
    def clamped(self) -> float:
        """Return the clamped length of the bolts, m."""
        return self.upper + self.lower

    @property
    def bolt_area(self) -> float:
        """Return the section of all shanks together, m^2."""
        return self.n_bolts * 0.25 * math.pi * self.diameter**2

    @property
    def shank(self) -> float:
        """Return the radial width of the equivalent ring's shank, m: its section is that of all
        bolts."""
        return self.bolt_area / (2 * math.pi * self.bolt_circle)

    @property
    def inside_bolts(self) -> float:
        """Return the radius of the circle that touches the bolt holes from inside, m."""
        return self.bolt_circle - self.hole

    def thrust(self, pressure: float) -> float:
        """Return the force of the closed ends, N, under a pressure in Pa."""
        return pressure * math.pi * self.bore**2

    def shortening(self, preload: float, young: float, dim: int) -> float:
        """Return the shortening, m, for a force of all bolts, N, without pressure; of the ring for
        dim 2."""
        return preload * self.clamped / young * (1 / self.bolt_area + 1 / _CLAMPED[dim])


def _flange_section(flanges: Flanges, thickness: float, dim: int) -> am.Polygon:
    """Return the section of the upper flange, with the joint at z = 0."""
    f = flanges
    wall = flanges.bore + flanges.wall
    seat = []
    if dim == 2:
        # the seat of a ring is a little wider than its heads
        half = 0.6 * f.seat
        seat = [
            ((f.bolt_circle + half, thickness), "seat"),
            ((f.bolt_circle - half, thickness), "face"),
        ]
    corners = [
        ((f.bore, 0.0), "joint"),
        ((f.outer, 0.0), "rim"),
        ((f.outer, thickness), "face"),
        *seat,
        ((wall, thickness), "wall"),
        ((wall, f.length), "pipe"),
        ((f.bore, f.length), "bore"),
    ]
    return am.Polygon(
        vertices=tuple(point for point, _ in corners), boundaries=tuple(name for _, name in corners)
    )


def _mirrored(profile: am.Polygon) -> am.Polygon:
    """Return a section mirrored at z = 0."""
    vertices = tuple((r, -z) for r, z in reversed(profile.vertices))
    names = tuple(reversed(profile.boundaries))
    # an edge is named at its first vertex, which was its last one
    return am.Polygon(vertices=vertices, boundaries=names[1:] + names[:1])


def _ring_section(flanges: Flanges) -> am.Polygon:
    """Return the I-shaped section of the ring that stands for all bolts."""
    f = flanges
    head = 0.5 * flanges.seat
    shank = 0.5 * flanges.shank
    tip = f.upper + f.head_height
    top = f.upper
    bottom = -f.lower
    end = -f.lower - f.head_height
    corners = [
        ((-head, end), "tip"),
        ((head, end), "side"),
        ((head, bottom), "lower_head"),
        ((shank, bottom), "side"),
        ((shank, top), "upper_head"),
        ((head, top), "side"),
        ((head, tip), "tip"),
        ((-head, tip), "side"),
        ((-head, top), "upper_head"),
        ((-shank, top), "side"),
        ((-shank, bottom), "lower_head"),
        ((-head, bottom), "side"),
    ]
    return am.Polygon(
        vertices=tuple((f.bolt_circle + r, z) for (r, z), _ in corners),
        boundaries=tuple(name for _, name in corners),
    )


def _bolt_places(flanges: Flanges) -> list[tuple[float, float]]:
    """Return the points (x, y), m, of the axes of the bolts in the sector of 90 degrees."""
    n = flanges.n_bolts
    if n % 4:
        raise ValueError(
            f"n_bolts must be a multiple of 4 in 3D: a sector of 90 degrees holds a quarter, got {n}"
        )
    angles = (np.arange(n // 4) + 0.5) * 2 * math.pi / n
    return [(flanges.bolt_circle * math.cos(a), flanges.bolt_circle * math.sin(a)) for a in angles]


def _drilled(
    profile: am.Polygon, flanges: Flanges, places: list[tuple[float, float]]
) -> SolidDomain:
    """Return a quarter of a flange, between the planes of symmetry y = 0 and x = 0, with a hole for each
    bolt axis at (x, y) in ``places``, m."""
    solid: SolidDomain = am.Revolution(profile, angle=90.0)
    reach = 2 * flanges.clamped
    for x, y in places:
        solid = am.Cut(
            solid,
            am.Cylinder((x, y, -reach), (0.0, 0.0, 1.0), radius=flanges.hole, height=2 * reach),
            rename={"b.side": "hole"},  # the side of the cylinder bounds the hole
        )
    return solid


def _bolt_solid(flanges: Flanges, place: tuple[float, float]) -> SolidDomain:
    """Return a bolt. Its shank reaches half into both heads, so that their undersides are cut by its
    side only."""
    x, y = place
    inside = 0.5 * flanges.head_height
    solid: SolidDomain = am.Cylinder(
        (x, y, -flanges.lower - inside),
        (0.0, 0.0, 1.0),
        0.5 * flanges.diameter,
        flanges.clamped + 2 * inside,
    )
    for name, z, axis in (("upper_head", flanges.upper, 1.0), ("lower_head", -flanges.lower, -1.0)):
        head = am.Cylinder(
            (x, y, z), (0.0, 0.0, axis), 0.5 * flanges.head_diameter, flanges.head_height
        )
        solid = am.Fuse(solid, head, {"b.bottom": name, "b.top": "tip"})
    return solid
