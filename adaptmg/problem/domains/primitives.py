"""Solids as pure data: cylinders, balls, profiles turned or extruded. Lengths in m, angles in degrees.

A solid knows its boundaries by name and its bounding box; only the mesh layer builds its geometry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from adaptmg.problem import check_arrays, checks
from adaptmg.problem.domains.outlines import Outline
from adaptmg.problem.domains.straight import Domain, Polygon, Rectangle

__all__ = ["Ball", "Cylinder", "Extrusion", "Profile", "Revolution", "SolidDomain", "Triple", "direction",
           "outline_of", "triple"]

Triple = tuple[float, float, float]
Profile = Polygon | Outline | Rectangle
# relative to the profile: vertices nearer to the axis of revolution than this lie on it
_ON_AXIS = 1e-12


class SolidDomain(Domain):
    """One body in space: the base class of the solids of this module."""

    dim: ClassVar[int] = 3


def triple(name: str, value: object) -> Triple:
    """Three finite numbers."""
    return tuple(map(float, check_arrays.vector(name, value, 3)))


def direction(name: str, value: object) -> Triple:
    """A unit vector from one of any length > 0."""
    vector = check_arrays.vector(name, value, 3)
    length = float(np.linalg.norm(vector))
    if not length > 0:
        raise ValueError(f"{name} must not be zero, got {checks.shown(value)}")
    return tuple(map(float, vector / length))


def _profile(name: str, value: object) -> Profile:
    if not isinstance(value, Profile):
        raise TypeError(f"{name} must be a Polygon, an Outline or a Rectangle, got {checks.described(value)}")
    return value


def outline_of(profile: Profile) -> Polygon | Outline:
    """The profile with its own vertices: arcs stay arcs."""
    return profile if isinstance(profile, Outline) else profile.polygon


@dataclass(frozen=True)
class Cylinder(SolidDomain):
    """A circular cylinder; boundaries ``side``, ``bottom`` (around ``point``) and ``top``.

    Parameters
    ----------
    point : triple of float
        Centre of the bottom, m.
    axis : triple of float
        Direction from bottom to top, of any length; stored as a unit vector.
    radius, height : float
        m, > 0.
    """

    point: Triple
    axis: Triple
    radius: float
    height: float
    boundaries: ClassVar[tuple[str, ...]] = ("side", "bottom", "top")

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", triple("point", self.point))
        object.__setattr__(self, "axis", direction("axis", self.axis))
        for name in ("radius", "height"):
            object.__setattr__(self, name, checks.quantity(name, getattr(self, name), positive=True))

    @property
    def lower(self) -> np.ndarray:
        """Lowest corner of the bounding box (3,), m."""
        return self._ends().min(axis=0) - self._reach()

    @property
    def upper(self) -> np.ndarray:
        """Highest corner of the bounding box (3,), m."""
        return self._ends().max(axis=0) + self._reach()

    def _ends(self) -> np.ndarray:
        return np.array(self.point) + np.outer([0.0, self.height], self.axis)

    def _reach(self) -> np.ndarray:
        return self.radius * np.sqrt(np.maximum(0.0, 1.0 - np.square(self.axis)))


@dataclass(frozen=True)
class Ball(SolidDomain):
    """A ball; boundary ``surface``.

    Parameters
    ----------
    centre : triple of float
        m.
    radius : float
        m, > 0.
    """

    centre: Triple
    radius: float
    boundaries: ClassVar[tuple[str, ...]] = ("surface",)

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", triple("centre", self.centre))
        object.__setattr__(self, "radius", checks.quantity("radius", self.radius, positive=True))

    @property
    def lower(self) -> np.ndarray:
        """Lowest corner of the bounding box (3,), m."""
        return np.array(self.centre) - self.radius

    @property
    def upper(self) -> np.ndarray:
        """Highest corner of the bounding box (3,), m."""
        return np.array(self.centre) + self.radius


@dataclass(frozen=True)
class Revolution(SolidDomain):
    """A plane profile turned about the z axis, from the plane y = 0 towards +y.

    Boundaries are called like the edges of the profile (those on the axis have none); below 360 degrees ``start``, in
    the plane y = 0, and ``end`` are added.

    Parameters
    ----------
    polygon : Polygon, Outline or Rectangle
        Profile in the half plane (r, z), r >= 0. It may touch the axis along edges, not at a single vertex.
    angle : float
        Degrees, 0 < angle <= 360.
    """

    polygon: Profile
    angle: float = 360.0

    def __post_init__(self) -> None:
        _profile("polygon", self.polygon)
        object.__setattr__(self, "angle", checks.positive("angle", self.angle))
        if not self.angle <= 360:
            raise ValueError(f"angle must be at most 360 degrees, got {self.angle!r}")
        r = np.array(outline_of(self.polygon).vertices)[:, 0]
        if not self.polygon.lower[0] >= -_ON_AXIS * r.max():
            raise ValueError(f"polygon must lie in the half plane r >= 0, it reaches to r = {self.polygon.lower[0]:g}")
        on_axis = r <= _ON_AXIS * r.max()
        alone = on_axis & ~np.roll(on_axis, 1) & ~np.roll(on_axis, -1)
        if alone.any():
            raise ValueError(f"polygon touches the axis at the single vertex {int(np.argmax(alone))}; let an edge of "
                             "it lie on the axis, or move the vertex away")
        if self.angle < 360 and {"start", "end"} & set(self.polygon.boundaries):
            raise ValueError("the edges of polygon must not be called 'start' or 'end': these are the end planes")

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Distinct names, in the order of the edges."""
        outline = outline_of(self.polygon)
        r = np.array(outline.vertices)[:, 0]
        swept = (r > _ON_AXIS * r.max()) | (np.roll(r, -1) > _ON_AXIS * r.max())
        names = [name for name, face in zip(outline.boundaries, swept, strict=True) if face]
        return tuple(dict.fromkeys(names)) + (("start", "end") if self.angle < 360 else ())

    @property
    def lower(self) -> np.ndarray:
        """Lowest corner of the bounding box (3,), m."""
        return np.append(self._extremes().min(axis=0), self.polygon.lower[1])

    @property
    def upper(self) -> np.ndarray:
        """Highest corner of the bounding box (3,), m."""
        return np.append(self._extremes().max(axis=0), self.polygon.upper[1])

    def _extremes(self) -> np.ndarray:
        """Points (n, 2) among which x and y are largest and smallest."""
        turns = np.radians([a for a in (0, 90, 180, 270, 360) if a < self.angle] + [self.angle])
        # rounded so that quarter turns are exact
        directions = np.round(np.stack([np.cos(turns), np.sin(turns)], axis=1), 15)
        return np.concatenate([r * directions for r in (self.polygon.lower[0], self.polygon.upper[0])])


@dataclass(frozen=True)
class Extrusion(SolidDomain):
    """A plane profile in (x, y), extruded along z; boundaries are its edges, ``bottom`` and ``top``.

    Parameters
    ----------
    polygon : Polygon or Outline
        Profile. (A rectangle's own edges are called bottom and top: use a Box.)
    height : float
        m, > 0.
    base : float
        z of the bottom, m.
    """

    polygon: Profile
    height: float
    base: float = 0.0

    def __post_init__(self) -> None:
        _profile("polygon", self.polygon)
        object.__setattr__(self, "height", checks.quantity("height", self.height, positive=True))
        object.__setattr__(self, "base", checks.quantity("base", self.base))
        if {"bottom", "top"} & set(self.polygon.boundaries):
            raise ValueError("the edges of polygon must not be called 'bottom' or 'top': these are the end planes")

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Distinct names, in the order of the edges."""
        return (*dict.fromkeys(self.polygon.boundaries), "bottom", "top")

    @property
    def lower(self) -> np.ndarray:
        """Lowest corner of the bounding box (3,), m."""
        return np.append(self.polygon.lower, self.base)

    @property
    def upper(self) -> np.ndarray:
        """Highest corner of the bounding box (3,), m."""
        return np.append(self.polygon.upper, self.base + self.height)
