"""Solids and STEP files as data. Lengths in m, angles in degrees.

A solid knows its boundaries by name and its bounding box; only the mesh layer builds its geometry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np

from adaptmg import _checks as checks
from adaptmg._checks import Quantity, Size
from adaptmg.problem.plane_domains import Box, Domain, Outline, Triple

_ON_AXIS = checks.ROUNDING  # of the profile: vertices nearer to the axis of revolution lie on it
_PROFILE = "a Polygon, an Outline, a Rectangle, a Circle, or a combination of these"
SOLID = "a Box or another solid (Cylinder, Ball, Revolution, Cut, ...)"


class SolidDomain(Domain):
    """One body in space (of plane domains combined: in the plane): the base class of solids and
    combinations."""

    dim: ClassVar[int] = 3
    boundaries: tuple[str, ...]


def _direction(name: str, value: object) -> tuple[float, ...]:
    return tuple(map(float, checks.direction(name, value, 3)))


def _profile(name: str, value: Domain) -> Outline:
    """Return the outline of a plane domain without holes; TypeError or ValueError for others."""
    if not isinstance(value, Domain) or value.dim != 2 or not hasattr(value, "outline"):
        raise TypeError(f"{name} must be {_PROFILE}, got {checks.described(value)}")
    if value.outline.holes:
        raise ValueError(
            f"{name} has holes: make the solid of its outer edge, and Cut those of its holes from it"
        )
    return value.outline


Direction = Annotated[tuple[float, float, float], _direction]
Profile = Annotated[Outline, _profile]


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

    Examples
    --------
    >>> am.Cylinder((0, 0, 0), (0, 0, 1), radius=0.1, height=0.5).height
    0.5
    """

    point: Triple
    axis: Direction
    radius: Size
    height: Size
    boundaries: ClassVar[tuple[str, ...]] = ("side", "bottom", "top")

    def _extremes(self) -> np.ndarray:
        ends = np.array(self.point) + np.outer([0.0, self.height], self.axis)
        # how far the end discs extend along each axis
        reach = self.radius * np.sqrt(np.maximum(0.0, 1.0 - np.square(self.axis)))
        return np.concatenate([ends - reach, ends + reach])


@dataclass(frozen=True)
class Ball(SolidDomain):
    """A ball; boundary ``surface``.

    Parameters
    ----------
    centre : triple of float
        m.
    radius : float
        m, > 0.

    Examples
    --------
    >>> am.Ball((0, 0, 0.1), 0.1).radius
    0.1
    """

    centre: Triple
    radius: Size
    boundaries: ClassVar[tuple[str, ...]] = ("surface",)

    def _extremes(self) -> np.ndarray:
        return np.array([[-self.radius], [self.radius]]) + self.centre


@dataclass(frozen=True, repr=False)
class Revolution(SolidDomain):
    """A plane profile turned about the z axis, from the plane y = 0 towards +y.

    Boundaries are called like the edges of the profile (those on the axis have none); below 360
    degrees ``start``, in the plane y = 0, and ``end`` are added.

    Parameters
    ----------
    polygon : Polygon, Outline, Rectangle, Circle, or a combination of these
        Profile in the half plane (r, z), r >= 0. It may touch the axis along edges, not at a single
        vertex.
    angle : float
        Degrees, 0 < angle <= 360.

    Examples
    --------
    >>> am.Revolution(am.Rectangle(width=0.1, height=0.2, origin=(0.1, 0)), angle=90).angle
    90.0
    """

    polygon: Profile
    angle: Annotated[float, checks.positive] = 360.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.angle <= 360:
            raise ValueError(f"angle must be at most 360 degrees, got {self.angle!r}")
        r = np.array(self.polygon.vertices)[:, 0]
        if not self.polygon.lower[0] >= -_ON_AXIS * r.max():
            raise ValueError(
                f"polygon must lie in the half plane r >= 0, it reaches to r = {self.polygon.lower[0]:g}"
            )
        on_axis = r <= _ON_AXIS * r.max()
        touching = on_axis & ~np.roll(on_axis, 1) & ~np.roll(on_axis, -1)
        if touching.any():
            raise ValueError(
                f"polygon touches the axis at the single vertex {int(np.argmax(touching))}; let an edge of "
                "it lie on the axis, or move the vertex away"
            )
        if self.angle < 360 and {"start", "end"} & set(self.polygon.boundaries):
            raise ValueError(
                "the edges of polygon must not be called 'start' or 'end': these are the end planes"
            )

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Return the distinct names, in the order of the edges."""
        r = np.array(self.polygon.vertices)[:, 0]
        # edges with an end off the axis
        swept = (r > _ON_AXIS * r.max()) | (np.roll(r, -1) > _ON_AXIS * r.max())
        names = np.array(self.polygon.boundaries)[swept].tolist()
        return tuple(dict.fromkeys(names)) + (("start", "end") if self.angle < 360 else ())

    def _extremes(self) -> np.ndarray:
        # the bounding box is reached at quarter turns and at the end
        quarters = [degrees for degrees in (0, 90, 180, 270, 360) if degrees < self.angle]
        turns = np.radians([*quarters, self.angle])
        # rounded so that quarter turns are exact
        directions = np.round(np.stack([np.cos(turns), np.sin(turns)], axis=1), 15)
        ends = self.polygon.lower, self.polygon.upper
        return np.concatenate(
            [np.column_stack([r * directions, np.full(len(turns), z)]) for r, z in ends]
        )


@dataclass(frozen=True, repr=False)
class Extrusion(SolidDomain):
    """A plane profile in (x, y), extruded along z; boundaries are its edges, ``bottom`` and
    ``top``.

    Parameters
    ----------
    polygon : Polygon, Outline, Circle, or a combination of these
        Profile. (The edges of a rectangle are called bottom and top: use a Box.)
    height : float
        m, > 0.
    base : float
        z of the bottom, m.

    Examples
    --------
    >>> corner = am.Polygon(vertices=((0, 0), (1, 0), (0, 1)), boundaries=("south", "slope", "west"))
    >>> am.Extrusion(corner, height=0.01).height
    0.01
    """

    polygon: Profile
    height: Size
    base: Quantity = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if {"bottom", "top"} & set(self.polygon.boundaries):
            raise ValueError(
                "the edges of polygon must not be called 'bottom' or 'top': these are the end planes"
            )

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Return the distinct names, in the order of the edges."""
        return (*dict.fromkeys(self.polygon.boundaries), "bottom", "top")

    def _extremes(self) -> np.ndarray:
        return np.stack(
            [
                np.append(self.polygon.lower, self.base),
                np.append(self.polygon.upper, self.base + self.height),
            ]
        )


@dataclass(frozen=True, repr=False)
class Moved(SolidDomain):
    """A solid that is first rotated about an axis through the origin, then moved; boundaries keep
    their names.

    Parameters
    ----------
    solid : Box, Cylinder, Cut, ...
    offset : triple of float
        m.
    angle : float
        In degrees, right-handed about ``axis`` (the rotation of :class:`adaptmg.Moving` is in rad).
    axis : triple of float
        Direction, of any length; stored as a unit vector.

    Examples
    --------
    >>> am.Moved(am.Ball((0, 0, 0), 0.1), offset=(0, 0, 0.1)).offset
    (0.0, 0.0, 0.1)
    """

    solid: Annotated[
        SolidDomain | Box, partial(checks.instance, types=(SolidDomain, Box), words=SOLID)
    ]
    offset: Triple = (0.0, 0.0, 0.0)
    angle: Quantity = 0.0
    axis: Direction = (0.0, 0.0, 1.0)
    loose_box = True  # it contains the turned corners of the box of the solid

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.solid.dim != 3 or hasattr(self.solid, "cracks"):
            what = "plane" if self.solid.dim != 3 else "cracked"
            raise ValueError(f"solid must be {SOLID}, got a {what} {type(self.solid).__name__}")

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Return the boundaries of the solid."""
        return self.solid.boundaries

    @property
    def rotation(self) -> np.ndarray:
        """Return Rodrigues' matrix R (3, 3): the solid's x goes to R x + offset."""
        turn = math.radians(self.angle)
        cross = np.cross(np.eye(3), self.axis)
        return np.eye(3) + math.sin(turn) * cross + (1 - math.cos(turn)) * cross @ cross

    def _extremes(self) -> np.ndarray:
        ends = np.stack([self.solid.lower, self.solid.upper])
        corners = np.stack(
            [ends[[i, j, k], [0, 1, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        )
        return corners @ self.rotation.T + np.array(self.offset)


def _names(name: str, value: Mapping[str, str]) -> dict[str, str]:
    """Return new names by old ones, checked."""
    result = checks.mapping(name, value, "names to names")
    for old, new in result.items():
        checks.boundary_name(f"the keys of {name}", old)
        if "." in checks.boundary_name(f"{name}[{old!r}]", new):
            raise ValueError(
                f"{name}[{old!r}] must not contain '.', got {new!r}: boundaries are 'solid.face'"
            )
    return result


@dataclass(frozen=True)
class StepFile(Domain):
    """The solids of a STEP file, each a body; boundaries are called "solid.face".

    Names come from the file: of products, where each is one solid, else of solids; those without
    one, and faces, are called ``solid1``, ``face1``, ... in the order of the file. Of several
    solids with one name (instances of a product) the later ones get "_2", "_3", ...; a "." becomes
    "_". Names are known only when the file is read (:func:`adaptmg.mesh.step_table` lists them).

    Parameters
    ----------
    path : str or Path
        A ``.step`` or ``.stp`` file.
    unit : float
        Length in m of one unit of the coordinates, after the reader has turned all units of length
        into millimetres: leave it at 1e-3 unless the file states a wrong unit.
    names : mapping of str to str
        New names: "solid1": "upper" of a solid, "solid1.face3": "contact" of one of its faces. Keys
        are names as in the file, or solids and faces by their numbers, counted from 1.
    solids : sequence of str, optional
        Which solids are meshed: "bolt" is all that have this name, "nut.2" the second of several;
        default all.

    Examples
    --------
    >>> part = am.StepFile("bracket.step", names={"face3": "foot"})
    >>> part.unit                                                      # of the file's lengths, m
    0.001
    """

    path: Annotated[str | Path, checks.file_path]
    unit: Size = 1e-3
    names: Annotated[Mapping[str, str], _names] = field(default_factory=dict, hash=False)
    solids: Annotated[tuple[str, ...], checks.strings] | None = None
    dim: ClassVar[int] = 3
    boundaries: ClassVar[None] = None
    bodies: ClassVar[None] = None
