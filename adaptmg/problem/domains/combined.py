"""Solids moved and combined, and several bodies as one domain, as pure data. Lengths in m, angles in degrees.

The names of faces survive: several faces may share one, and a name of which no face is left is an error only where it
is used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from adaptmg.problem import checks
from adaptmg.problem.domains.primitives import SolidDomain, Triple, direction, triple
from adaptmg.problem.domains.straight import Box, Domain

__all__ = ["Assembly", "Combination", "Common", "Cut", "Fuse", "Moved"]


def _solid(name: str, value: object) -> SolidDomain | Box:
    if not isinstance(value, SolidDomain | Box):
        raise TypeError(f"{name} must be a Box or another solid (Cylinder, Ball, Revolution, Cut, ...), "
                        f"got {checks.described(value)}")
    return value


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
    """

    solid: SolidDomain | Box
    offset: Triple = (0.0, 0.0, 0.0)
    angle: float = 0.0
    axis: Triple = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _solid("solid", self.solid)
        object.__setattr__(self, "offset", triple("offset", self.offset))
        object.__setattr__(self, "angle", checks.quantity("angle", self.angle))
        object.__setattr__(self, "axis", direction("axis", self.axis))

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Those of the solid."""
        return self.solid.boundaries

    @property
    def lower(self) -> np.ndarray:
        """Lowest corner of a box around the moved bounding box (3,), m."""
        return self._corners().min(axis=0)

    @property
    def upper(self) -> np.ndarray:
        """Highest corner of a box around the moved bounding box (3,), m."""
        return self._corners().max(axis=0)

    def _corners(self) -> np.ndarray:
        ends = np.stack([self.solid.lower, self.solid.upper])
        corners = np.stack([ends[[i, j, k], [0, 1, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        turn, axis = math.radians(self.angle), np.array(self.axis)
        # Rodrigues' formula
        turned = (math.cos(turn) * corners + math.sin(turn) * np.cross(axis, corners)
                  + (1 - math.cos(turn)) * np.outer(corners @ axis, axis))
        return turned + np.array(self.offset)


@dataclass(frozen=True)
class Combination(SolidDomain):
    """Two solids combined: the base class of :class:`Cut`, :class:`Fuse` and :class:`Common`.

    Parameters
    ----------
    a, b : Box, Cylinder, Cut, ...
        The solids. The result must be one piece.
    rename : mapping of str to str
        New names of boundaries: of one solid by the keys "a.NAME" or "b.NAME", of both by "NAME".
    """

    a: SolidDomain | Box
    b: SolidDomain | Box
    rename: Mapping[str, str] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        _solid("a", self.a)
        _solid("b", self.b)
        if not isinstance(self.rename, Mapping):
            raise TypeError(f"rename must map names to names, got {checks.shown(self.rename)}")
        known = [key for part, solid in (("a", self.a), ("b", self.b)) for name in solid.boundaries
                 for key in (name, f"{part}.{name}")]
        for old, new in self.rename.items():
            checks.choice("the keys of rename", old, dict.fromkeys(known))
            checks.boundary_name(f"rename[{old!r}]", new)
        object.__setattr__(self, "rename", dict(self.rename))

    def renamed(self, part: str, name: str) -> str:
        """The name in the result of the boundary ``name`` of ``part``, "a" or "b"."""
        return self.rename.get(f"{part}.{name}", self.rename.get(name, name))

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Distinct names: those of a, then those of b; of some of them no face may be left."""
        return tuple(dict.fromkeys([self.renamed("a", name) for name in self.a.boundaries]
                                   + [self.renamed("b", name) for name in self.b.boundaries]))


class Cut(Combination):
    """What is left of ``a`` when ``b`` is taken away. Parameters as of :class:`Combination`."""

    @property
    def lower(self) -> np.ndarray:
        """Lowest corner of a box around the solid (3,), m."""
        return self.a.lower

    @property
    def upper(self) -> np.ndarray:
        """Highest corner of a box around the solid (3,), m."""
        return self.a.upper


class Fuse(Combination):
    """``a`` and ``b`` as one solid. Parameters as of :class:`Combination`."""

    @property
    def lower(self) -> np.ndarray:
        """Lowest corner of the bounding box (3,), m."""
        return np.minimum(self.a.lower, self.b.lower)

    @property
    def upper(self) -> np.ndarray:
        """Highest corner of the bounding box (3,), m."""
        return np.maximum(self.a.upper, self.b.upper)


class Common(Combination):
    """What ``a`` and ``b`` have in common. Parameters as of :class:`Combination`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.lower < self.upper).all():
            raise ValueError(f"{self.a!r} and {self.b!r} have nothing in common: their bounding boxes do not overlap")

    @property
    def lower(self) -> np.ndarray:
        """Lowest corner of a box around the solid (3,), m."""
        return np.maximum(self.a.lower, self.b.lower)

    @property
    def upper(self) -> np.ndarray:
        """Highest corner of a box around the solid (3,), m."""
        return np.minimum(self.a.upper, self.b.upper)


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

    def __post_init__(self) -> None:
        if not isinstance(self.parts, Mapping):
            raise TypeError(f"parts must map body names to domains, got {checks.described(self.parts)}")
        parts = dict(self.parts)
        if not parts:
            raise ValueError("parts is empty: an assembly needs at least one body")
        for name, part in parts.items():
            checks.boundary_name("the name of a body in parts", name)
            if "." in name:
                raise ValueError(f"the name of a body must not contain '.', got {name!r}: boundaries are 'body.edge'")
            if not isinstance(part, Domain):
                raise TypeError(f"parts[{name!r}] must be a Domain (Rectangle, Polygon, Outline, Box, ...), "
                                f"got {checks.described(part)}")
            if part.bodies is None or len(part.bodies) != 1 or part.boundaries is None or isinstance(part, Assembly):
                raise ValueError(f"parts[{name!r}] must be one body with known boundaries; name the bodies of "
                                 f"{type(part).__name__} one by one")
        dims = {name: part.dim for name, part in parts.items()}
        if len(set(dims.values())) > 1:
            raise ValueError(f"all parts must have the same dimension, got {dims}")
        object.__setattr__(self, "parts", parts)

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

    @property
    def lower(self) -> np.ndarray:
        """Lowest corner of the bounding box (dim,), m."""
        return np.min([part.lower for part in self.parts.values()], axis=0)

    @property
    def upper(self) -> np.ndarray:
        """Highest corner of the bounding box (dim,), m."""
        return np.max([part.upper for part in self.parts.values()], axis=0)
