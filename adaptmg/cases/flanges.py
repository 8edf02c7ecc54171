"""Flanges with their bolts: dimensions, sections and solids of the bolted junction.

The joint is the plane z = 0, the axis of the vessels the z axis. Sections are polygons in r and z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from adaptmg.problem import Polygon, checks
from adaptmg.problem.domains import Cut, Cylinder, Fuse, Revolution, SolidDomain

__all__ = ["Flanges", "bolt_places", "bolt_solid", "drilled", "flange_section", "mirrored", "ring_section"]

# effective section A_m of what the bolts clamp, m^2, from solutions of the default geometry without pressure
_CLAMPED = {2: 0.0341, 3: 0.0124}


@dataclass(frozen=True, kw_only=True)
class Flanges:
    """Dimensions of the junction, m.

    Parameters
    ----------
    bore : float
        Inner radius of the vessels.
    wall : float
        Thickness of their walls.
    length : float
        From the joint to the end of each pipe.
    outer : float
        Outer radius of the flanges.
    upper, lower : float
        Thickness of the flanges.
    bolt_circle : float
        Radius on which the bolts stand.
    n_bolts : int
    diameter : float
        Of a bolt's shank. Heads are 1.6 times as wide and 0.7 times as high, holes 1.1 times as wide.
    seat : float
        Radial width of the equivalent ring's heads, and of the ring on which bolts act as a traction.
    """

    bore: float = 0.200
    wall: float = 0.012
    length: float = 0.120
    outer: float = 0.270
    upper: float = 0.040
    lower: float = 0.050
    bolt_circle: float = 0.240
    n_bolts: int = 16
    diameter: float = 0.024
    seat: float = 0.020

    def __post_init__(self) -> None:
        for name in ("bore", "wall", "length", "outer", "upper", "lower", "bolt_circle", "diameter", "seat"):
            object.__setattr__(self, name, checks.positive(name, getattr(self, name)))
        checks.integer("n_bolts", self.n_bolts, 1)
        wide = 0.5 * max(1.2 * self.seat, self.head_diameter)
        if not self.bore + self.wall < self.bolt_circle - wide < self.bolt_circle + wide < self.outer:
            raise ValueError(f"bolt_circle must leave room for heads and seats, {wide:g} m to each side, between the "
                             f"wall (r = {self.bore + self.wall:g}) and outer (r = {self.outer:g}), "
                             f"got {self.bolt_circle!r}")
        if not max(self.upper, self.lower) < self.length:
            raise ValueError(f"length must exceed the thickness of the flanges, got {self.length!r}")
        if not self.shank < 0.8 * self.seat:
            raise ValueError(f"seat must be wider than 1.25 times the shank of a ring of the bolts' section, "
                             f"{self.shank:g} m, got {self.seat!r}")
        if not self.n_bolts * self.head_diameter < 2 * math.pi * self.bolt_circle:
            raise ValueError(f"n_bolts: {self.n_bolts} heads of {self.head_diameter:g} m do not fit on the bolt circle")

    @property
    def head_diameter(self) -> float:
        """m."""
        return 1.6 * self.diameter

    @property
    def head_height(self) -> float:
        """m."""
        return 0.7 * self.diameter

    @property
    def hole(self) -> float:
        """Radius of the bolt holes, m."""
        return 0.55 * self.diameter

    @property
    def clamped(self) -> float:
        """Clamped length of the bolts, m."""
        return self.upper + self.lower

    @property
    def bolt_area(self) -> float:
        """Section of all shanks together, m^2."""
        return self.n_bolts * 0.25 * math.pi * self.diameter**2

    @property
    def shank(self) -> float:
        """Radial width of the equivalent ring's shank, m: its section is that of all bolts."""
        return self.bolt_area / (2 * math.pi * self.bolt_circle)

    @property
    def inside_bolts(self) -> float:
        """Radius of the circle that touches the bolt holes from inside, m: a joint that lets the fluid get there
        leaks through them."""
        return self.bolt_circle - self.hole

    def thrust(self, pressure: float) -> float:
        """Force of the closed ends, N, under a pressure in Pa."""
        return pressure * math.pi * self.bore**2

    def shortening(self, preload: float, young: float, dim: int) -> float:
        r"""Shortening of the bolts without pressure.

        Parameters
        ----------
        preload : float
            Force F of all bolts, N.
        young : float
            Pa.
        dim : {2, 3}
            The equivalent ring, or bolts.

        Returns
        -------
        float
            :math:`\delta = F (c_b + c_m)`, m, with the compliances of :mod:`adaptmg.cases.bolted_junction`.
        """
        return preload * self.clamped / young * (1 / self.bolt_area + 1 / _CLAMPED[dim])


def flange_section(flanges: Flanges, thickness: float, bolt: str) -> Polygon:
    """Section of the upper flange, the joint at z = 0.

    Parameters
    ----------
    flanges : Flanges
    thickness : float
        Of the flange, m.
    bolt : {"ring", "traction", "solid"}
        A solid bolt stands on the face, a ring and a traction act on the boundary ``seat``.
    """
    f, wall = flanges, flanges.bore + flanges.wall
    # the seat of a ring that is a body of its own is a little wider than its heads
    half = 0.5 * f.seat * (1.0 if bolt == "traction" else 1.2)
    seat = [] if bolt == "solid" else [((f.bolt_circle + half, thickness), "seat"),
                                       ((f.bolt_circle - half, thickness), "face")]
    corners = [((f.bore, 0.0), "joint"), ((f.outer, 0.0), "rim"), ((f.outer, thickness), "face"), *seat,
               ((wall, thickness), "wall"), ((wall, f.length), "pipe"), ((f.bore, f.length), "bore")]
    return Polygon(vertices=tuple(point for point, _ in corners), boundaries=tuple(name for _, name in corners))


def mirrored(profile: Polygon) -> Polygon:
    """The section on the other side of z = 0, counter-clockwise again."""
    vertices = tuple((r, -z) for r, z in reversed(profile.vertices))
    names = tuple(reversed(profile.boundaries))
    return Polygon(vertices=vertices, boundaries=names[1:] + names[:1])


def ring_section(flanges: Flanges) -> Polygon:
    """I-shaped section of the equivalent ring."""
    f, head, shank = flanges, 0.5 * flanges.seat, 0.5 * flanges.shank
    tip, top, low, end = f.upper + f.head_height, f.upper, -f.lower, -f.lower - f.head_height
    corners = [((-head, end), "tip"), ((head, end), "side"), ((head, low), "lower_head"), ((shank, low), "side"),
               ((shank, top), "upper_head"), ((head, top), "side"), ((head, tip), "tip"), ((-head, tip), "side"),
               ((-head, top), "upper_head"), ((-shank, top), "side"), ((-shank, low), "lower_head"),
               ((-head, low), "side")]
    return Polygon(vertices=tuple((f.bolt_circle + r, z) for (r, z), _ in corners),
                   boundaries=tuple(name for _, name in corners))


def bolt_places(flanges: Flanges) -> list[tuple[float, float]]:
    """Axes of the bolts in the sector of 90 degrees, m."""
    n = flanges.n_bolts
    if n % 4:
        raise ValueError(f"n_bolts must be a multiple of 4 in 3D: a sector of 90 degrees holds a quarter, got {n}")
    angles = (np.arange(n // 4) + 0.5) * 2 * math.pi / n
    return [(flanges.bolt_circle * math.cos(a), flanges.bolt_circle * math.sin(a)) for a in angles]


def drilled(profile: Polygon, flanges: Flanges, places: list[tuple[float, float]]) -> SolidDomain:
    """A flange as a solid with its holes."""
    solid: SolidDomain = Revolution(profile, angle=90.0)
    reach = 2 * flanges.clamped
    for x, y in places:
        solid = Cut(solid, Cylinder((x, y, -reach), (0.0, 0.0, 1.0), flanges.hole, 2 * reach), {"b.side": "hole"})
    return solid


def bolt_solid(flanges: Flanges, place: tuple[float, float]) -> SolidDomain:
    """A bolt: the shank reaches half into both heads, so that their undersides stay whole."""
    f, (x, y) = flanges, place
    inside = 0.5 * f.head_height
    solid: SolidDomain = Cylinder((x, y, -f.lower - inside), (0.0, 0.0, 1.0), 0.5 * f.diameter, f.clamped + 2 * inside)
    for name, z, axis in (("upper_head", f.upper, 1.0), ("lower_head", -f.lower, -1.0)):
        head = Cylinder((x, y, z), (0.0, 0.0, axis), 0.5 * f.head_diameter, f.head_height)
        solid = Fuse(solid, head, {"b.bottom": name, "b.top": "tip"})
    return solid
