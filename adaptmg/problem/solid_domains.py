"""Solids, assemblies of several bodies and STEP files as data. Lengths in m, angles in degrees.

A solid knows its boundaries by name and its bounding box; only the mesh layer builds its geometry. When solids are
combined, the names of faces survive: several faces may share one, and a name without a face is an error only where it
is used. Plane domains combined are an :class:`~adaptmg.problem.Outline` as soon as they are made.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._text import brief
from adaptmg.problem.plane_boolean import combined
from adaptmg.problem.plane_domains import Box, Circle, Domain, Outline, Polygon, Rectangle, corner

Triple = tuple[float, float, float]
Profile = Polygon | Outline | Rectangle
_ON_AXIS = 1e-12  # relative to the profile: vertices nearer to the axis of revolution lie on it
_PROFILE = "a Polygon, an Outline, a Rectangle, a Circle, or a combination of these"
_SOLID = "a Box or another solid (Cylinder, Ball, Revolution, Cut, ...)"
_PLANE = (Rectangle, Polygon, Outline, Circle)


class SolidDomain(Domain):
    """One body in space (of plane domains combined: in the plane): the base class of the solids of this module."""

    dim: ClassVar[int] = 3


def _direction(name: str, value: object) -> Triple:
    return tuple(map(float, check_arrays.direction(name, value, 3)))


def _profile(name: str, value: object) -> Profile:
    if isinstance(value, Circle | Combination) and value.dim == 2:
        value = value.outline
    profile = checks.instance(name, value, (Polygon, Outline, Rectangle), _PROFILE)
    if isinstance(profile, Outline) and profile.holes:
        raise ValueError("polygon has holes: make the solid of its outer edge, and Cut those of its holes from it")
    return profile


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
    axis: Triple
    radius: float
    height: float
    boundaries: ClassVar[tuple[str, ...]] = ("side", "bottom", "top")

    def __post_init__(self) -> None:
        checks.convert(self, corner, "point", dim=3)
        checks.convert(self, _direction, "axis")
        checks.convert(self, checks.quantity, "radius", "height", positive=True)

    def _extremes(self) -> np.ndarray:
        ends = np.array(self.point) + np.outer([0.0, self.height], self.axis)
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
    radius: float
    boundaries: ClassVar[tuple[str, ...]] = ("surface",)

    def __post_init__(self) -> None:
        checks.convert(self, corner, "centre", dim=3)
        checks.convert(self, checks.quantity, "radius", positive=True)

    def _extremes(self) -> np.ndarray:
        return np.array([[-self.radius], [self.radius]]) + self.centre


@dataclass(frozen=True)
class Revolution(SolidDomain):
    """A plane profile turned about the z axis, from the plane y = 0 towards +y.

    Boundaries are called like the edges of the profile (those on the axis have none); below 360 degrees ``start``, in
    the plane y = 0, and ``end`` are added.

    Parameters
    ----------
    polygon : Polygon, Outline, Rectangle, Circle, or a combination of these
        Profile in the half plane (r, z), r >= 0. It may touch the axis along edges, not at a single vertex.
    angle : float
        Degrees, 0 < angle <= 360.

    Examples
    --------
    >>> am.Revolution(am.Rectangle(width=0.1, height=0.2, origin=(0.1, 0)), angle=90).angle
    90.0
    """

    polygon: Profile
    angle: float = 360.0

    __repr__ = brief

    def __post_init__(self) -> None:
        checks.convert(self, _profile, "polygon")
        checks.convert(self, checks.positive, "angle")
        if not self.angle <= 360:
            raise ValueError(f"angle must be at most 360 degrees, got {self.angle!r}")
        r = np.array(self.polygon.outline.vertices)[:, 0]
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
        outline = self.polygon.outline
        r = np.array(outline.vertices)[:, 0]
        swept = (r > _ON_AXIS * r.max()) | (np.roll(r, -1) > _ON_AXIS * r.max())
        names = [name for name, face in zip(outline.boundaries, swept, strict=True) if face]
        return tuple(dict.fromkeys(names)) + (("start", "end") if self.angle < 360 else ())

    def _extremes(self) -> np.ndarray:
        turns = np.radians([a for a in (0, 90, 180, 270, 360) if a < self.angle] + [self.angle])
        # rounded so that quarter turns are exact
        directions = np.round(np.stack([np.cos(turns), np.sin(turns)], axis=1), 15)
        ends = self.polygon.lower, self.polygon.upper
        return np.concatenate([np.column_stack([r * directions, np.full(len(turns), z)]) for r, z in ends])


@dataclass(frozen=True)
class Extrusion(SolidDomain):
    """A plane profile in (x, y), extruded along z; boundaries are its edges, ``bottom`` and ``top``.

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
    height: float
    base: float = 0.0

    __repr__ = brief

    def __post_init__(self) -> None:
        checks.convert(self, _profile, "polygon")
        checks.convert(self, checks.quantity, "height", positive=True)
        checks.convert(self, checks.quantity, "base")
        if {"bottom", "top"} & set(self.polygon.boundaries):
            raise ValueError("the edges of polygon must not be called 'bottom' or 'top': these are the end planes")

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Distinct names, in the order of the edges."""
        return (*dict.fromkeys(self.polygon.boundaries), "bottom", "top")

    def _extremes(self) -> np.ndarray:
        return np.stack([np.append(self.polygon.lower, self.base),
                         np.append(self.polygon.upper, self.base + self.height)])


@dataclass(frozen=True)
class Moved(SolidDomain):
    """A solid that is first rotated about an axis through the origin, then moved; boundaries keep their names.

    Parameters
    ----------
    solid : Box, Cylinder, Cut, ...
    offset : triple of float
        m.
    angle : float
        Degrees, right-handed about ``axis``.
    axis : triple of float
        Direction, of any length; stored as a unit vector.

    Examples
    --------
    >>> am.Moved(am.Ball((0, 0, 0), 0.1), offset=(0, 0, 0.1)).offset
    (0.0, 0.0, 0.1)
    """

    solid: SolidDomain | Box
    offset: Triple = (0.0, 0.0, 0.0)
    angle: float = 0.0
    axis: Triple = (0.0, 0.0, 1.0)

    __repr__ = brief

    def __post_init__(self) -> None:
        checks.instance("solid", self.solid, (SolidDomain, Box), _SOLID)
        if self.solid.dim != 3 or hasattr(self.solid, "cracks"):
            what = "plane" if self.solid.dim != 3 else "cracked"
            raise ValueError(f"solid must be {_SOLID}, got a {what} {type(self.solid).__name__}")
        checks.convert(self, corner, "offset", dim=3)
        checks.convert(self, checks.quantity, "angle")
        checks.convert(self, _direction, "axis")

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Those of the solid."""
        return self.solid.boundaries

    def _extremes(self) -> np.ndarray:
        ends = np.stack([self.solid.lower, self.solid.upper])
        corners = np.stack([ends[[i, j, k], [0, 1, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        turn, axis = math.radians(self.angle), np.array(self.axis)
        # Rodrigues' formula
        turned = (math.cos(turn) * corners + math.sin(turn) * np.cross(axis, corners)
                  + (1 - math.cos(turn)) * np.outer(corners @ axis, axis))
        return turned + np.array(self.offset)


@dataclass(frozen=True)
class Combination(SolidDomain):
    """Two solids, or two plane domains, combined: the base class of :class:`Cut`, :class:`Fuse` and :class:`Common`.

    Boundaries keep their names; where both parts have one of the same name, it becomes one boundary unless ``rename``
    tells them apart.

    Parameters
    ----------
    a, b : Box, Cylinder, ..., or Rectangle, Polygon, Outline, Circle; or a combination of these
        Both in space or both plane. The result must be one piece; a plane one may have holes.
    rename : mapping of str to str
        New names: "side" of both parts, "b.side" of b alone.
    """

    a: Domain
    b: Domain
    rename: Mapping[str, str] = field(default_factory=dict, hash=False)

    __repr__ = brief

    def __post_init__(self) -> None:
        for name, part in (("a", self.a), ("b", self.b)):
            checks.instance(name, part, (SolidDomain, Box, *_PLANE),
                            f"{_SOLID}, or a plane domain (Rectangle, Polygon, Outline, Circle, Cut, ...)")
        if cracked := [name for name in "ab" if hasattr(getattr(self, name), "cracks")]:
            raise ValueError(f"{cracked[0]} is cracked: combine the bodies first, and crack the result")
        if self.a.dim != self.b.dim:
            raise ValueError(f"a is {self.a.dim}D, b {self.b.dim}D: combine two solids or two plane domains")
        checks.convert(self, checks.mapping, "rename", words="names to names")
        known = [key for part, solid in (("a", self.a), ("b", self.b)) for name in solid.boundaries
                 for key in (name, f"{part}.{name}")]
        for old, new in self.rename.items():
            checks.choice("the keys of rename", old, dict.fromkeys(known))
            checks.boundary_name(f"rename[{old!r}]", new)
        if self.dim == 2:
            _ = self.outline

    @property
    def dim(self) -> int:
        """Space dimension of both."""
        return self.a.dim

    @cached_property
    def outline(self) -> Outline:
        """Of plane domains: the edges of the result, holes included."""
        if self.dim != 2:
            raise ValueError(f"outline: only plane domains have one, a and b of this {type(self).__name__} are solids")
        parts = []
        for part, domain in (("a", self.a), ("b", self.b)):
            names = tuple(self.renamed(part, name) for name in domain.outline.boundaries)
            parts.append(replace(domain.outline, boundaries=names))
        return combined(type(self).__name__, *parts)

    def renamed(self, part: str, name: str) -> str:
        """Return the name in the result of the boundary ``name`` of ``part``, "a" or "b"."""
        return self.rename.get(f"{part}.{name}", self.rename.get(name, name))

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Distinct names: those of a, then those of b; of some of them no face of a solid may be left."""
        if self.dim == 2:
            return tuple(dict.fromkeys(self.outline.boundaries))
        both = ((part, name) for part in "ab" for name in getattr(self, part).boundaries)
        return tuple(dict.fromkeys(self.renamed(*one) for one in both))


class Cut(Combination):
    """``a`` without what it shares with ``b``. Parameters as of :class:`Combination`.

    Examples
    --------
    >>> plate = am.Cut(am.Rectangle(width=0.2, height=0.1), am.Circle((0.1, 0.05), 0.02, "hole"))
    >>> am.Cut(plate, am.Rectangle(width=0.02, height=0.03), rename={"b.right": "notch", "b.top": "notch"}).boundaries
    ('bottom', 'right', 'top', 'left', 'notch', 'hole')
    >>> drilled = am.Cut(am.Box(width=1, depth=1, height=1), am.Cylinder((0.5, 0.5, 0), (0, 0, 1), 0.2, 1.0))
    >>> drilled.a.width
    1.0
    """

    def _extremes(self) -> np.ndarray:
        return np.stack([self.a.lower, self.a.upper])


class Fuse(Combination):
    """``a`` and ``b`` as one body. Parameters as of :class:`Combination`.

    Examples
    --------
    >>> both = am.Fuse(am.Box(width=1, depth=1, height=1), am.Ball((0.5, 0.5, 1.0), 0.3))
    >>> both.b.radius
    0.3
    """

    def _extremes(self) -> np.ndarray:
        return np.stack([self.a.lower, self.b.lower, self.a.upper, self.b.upper])


class Common(Combination):
    """The intersection of ``a`` and ``b``. Parameters as of :class:`Combination`.

    Examples
    --------
    >>> lens = am.Common(am.Ball((0, 0, 0), 1.0), am.Ball((0, 0, 1.5), 1.0))
    >>> lens.b.centre[2]
    1.5
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        lower, upper = self._extremes()
        if not (lower < upper).all():
            raise ValueError(f"{self.a!r} and {self.b!r} have nothing in common: their bounding boxes do not overlap")

    def _extremes(self) -> np.ndarray:
        return np.stack([np.maximum(self.a.lower, self.b.lower), np.minimum(self.a.upper, self.b.upper)])


@dataclass(frozen=True, kw_only=True)
class Assembly(Domain):
    """Bodies that share no nodes; they may touch, or even overlap (a ring of bolts in an axisymmetric model does).

    Parameters
    ----------
    parts : mapping of str to Domain
        The geometry of each body by its name, without "."; all of the same dimension.

    Examples
    --------
    >>> from adaptmg.problem import Rectangle
    >>> Assembly(parts={"upper": Rectangle(width=1.0, height=1.0)}).boundaries
    ('upper.bottom', 'upper.right', 'upper.top', 'upper.left')
    """

    parts: Mapping[str, Domain]

    __repr__ = brief

    def __post_init__(self) -> None:
        checks.convert(self, checks.mapping, "parts", words="body names to domains")
        parts = self.parts
        if not parts:
            raise ValueError("parts is empty: an assembly needs at least one body")
        for name, part in parts.items():
            checks.boundary_name("the name of a body in parts", name)
            if "." in name:
                raise ValueError(f"the name of a body must not contain '.', got {name!r}: boundaries are 'body.edge'")
            checks.instance(f"parts[{name!r}]", part, Domain, "a Domain (Rectangle, Polygon, Outline, Box, ...)")
            if part.bodies is None or len(part.bodies) != 1 or part.boundaries is None or isinstance(part, Assembly):
                raise ValueError(f"parts[{name!r}] must be one body with known boundaries; name the bodies of "
                                 f"{type(part).__name__} one by one")
        dims = {name: part.dim for name, part in parts.items()}
        if len(set(dims.values())) > 1:
            raise ValueError(f"all parts must have the same dimension, got {dims}")

    def __hash__(self) -> int:
        return hash(tuple(self.parts.items()))

    @property
    def dim(self) -> int:
        """Space dimension."""
        return next(iter(self.parts.values())).dim

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies, in order."""
        return tuple(self.parts)

    @property
    def boundaries(self) -> tuple[str, ...]:
        """The distinct boundary names "body.edge", body by body."""
        return tuple(dict.fromkeys(f"{body}.{edge}" for body, part in self.parts.items() for edge in part.boundaries))

    def _extremes(self) -> np.ndarray:
        return np.stack([corner for part in self.parts.values() for corner in (part.lower, part.upper)])


@dataclass(frozen=True)
class StepFile(Domain):
    """The solids of a STEP file, each a body; boundaries are called "solid.face".

    Names come from the file: of products, where each is one solid, else of solids; those without one, and faces, are
    called ``solid1``, ``face1``, ... in the order of the file. Of several solids with one name (instances of a product)
    the later ones get "_2", "_3", ...; a "." becomes "_". Names are known only when the file is read
    (:func:`adaptmg.mesh.step_table` lists them).

    Parameters
    ----------
    path : str or Path
        A ``.step`` or ``.stp`` file.
    unit : float
        Length in m of one unit of the coordinates, after the reader has turned all units of length into millimetres:
        leave it at 1e-3 unless the file states a wrong unit.
    names : mapping of str to str
        New names: "solid1": "upper" of a solid, "solid1.face3": "contact" of one of its faces. Keys are names as in
        the file, or solids and faces by their numbers, counted from 1.
    solids : sequence of str, optional
        Which solids are meshed: "bolt" is all that have this name, "nut.2" the second of several; default all.

    Examples
    --------
    >>> part = am.StepFile("bracket.step", names={"face3": "foot"})
    >>> part.unit                                                      # of the file's lengths, m
    0.001
    """

    path: str | Path
    unit: float = 1e-3
    names: Mapping[str, str] = field(default_factory=dict, hash=False)
    solids: tuple[str, ...] | None = None
    dim: ClassVar[int] = 3
    boundaries: ClassVar[None] = None
    bodies: ClassVar[None] = None

    def __post_init__(self) -> None:
        checks.convert(self, checks.file_path, "path")
        checks.convert(self, checks.quantity, "unit", positive=True)
        checks.convert(self, checks.mapping, "names", words="names to names")
        if self.solids is not None:
            checks.convert(self, checks.strings, "solids")
        for old, new in self.names.items():
            checks.boundary_name("the keys of names", old)
            if "." in checks.boundary_name(f"names[{old!r}]", new):
                raise ValueError(f"names[{old!r}] must not contain '.', got {new!r}: boundaries are 'solid.face'")
