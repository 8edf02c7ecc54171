"""Domains as pure data: what the mesh generators mesh. Lengths in m, boundaries by name."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from adaptmg.problem import check_arrays, checks

__all__ = ["Box", "Domain", "Polygon", "Rectangle"]


class Domain:
    """What a mesh generator can mesh: the base class of all domains.

    Attributes
    ----------
    dim : int
        Space dimension.
    boundaries : tuple of str or None
        Names of the boundaries; those of several bodies are "body.edge". None where only the mesh knows them.
    bodies : tuple of str or None
        Names of the bodies; ``("body",)`` unless a subclass says otherwise. None where only the mesh knows them.
    """

    dim: int
    boundaries: tuple[str, ...] | None

    @property
    def bodies(self) -> tuple[str, ...] | None:
        """Names of the bodies."""
        return ("body",)


@dataclass(frozen=True, kw_only=True)
class Rectangle(Domain):
    """An axis-parallel rectangle; boundaries ``bottom``, ``right``, ``top``, ``left``.

    Parameters
    ----------
    width, height : float
        m, > 0.
    origin : pair of float
        Lower left corner, m.
    """

    width: float
    height: float
    origin: tuple[float, float] = (0.0, 0.0)
    dim: ClassVar[int] = 2
    boundaries: ClassVar[tuple[str, ...]] = ("bottom", "right", "top", "left")

    def __post_init__(self) -> None:
        object.__setattr__(self, "width", checks.quantity("width", self.width, positive=True))
        object.__setattr__(self, "height", checks.quantity("height", self.height, positive=True))
        object.__setattr__(self, "origin", tuple(map(float, check_arrays.vector("origin", self.origin, 2))))

    @property
    def lower(self) -> np.ndarray:
        """Lower left corner (2,), m."""
        return np.array(self.origin)

    @property
    def upper(self) -> np.ndarray:
        """Upper right corner (2,), m."""
        return self.lower + np.array([self.width, self.height])

    @property
    def polygon(self) -> Polygon:
        """The same as a polygon."""
        (x0, y0), (x1, y1) = self.lower, self.upper
        return Polygon(vertices=((x0, y0), (x1, y0), (x1, y1), (x0, y1)), boundaries=self.boundaries)


@dataclass(frozen=True, kw_only=True)
class Box(Domain):
    """An axis-parallel box; ``left``/``right`` are x, ``front``/``back`` y, ``bottom``/``top`` z.

    Parameters
    ----------
    width, depth, height : float
        Lengths along x, y and z, m, > 0.
    origin : triple of float
        Lowest corner, m.
    """

    width: float
    depth: float
    height: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    dim: ClassVar[int] = 3
    boundaries: ClassVar[tuple[str, ...]] = ("bottom", "right", "top", "left", "front", "back")

    def __post_init__(self) -> None:
        for name in ("width", "depth", "height"):
            object.__setattr__(self, name, checks.quantity(name, getattr(self, name), positive=True))
        object.__setattr__(self, "origin", tuple(map(float, check_arrays.vector("origin", self.origin, 3))))

    @property
    def lower(self) -> np.ndarray:
        """Lowest corner (3,), m."""
        return np.array(self.origin)

    @property
    def upper(self) -> np.ndarray:
        """Highest corner (3,), m."""
        return self.lower + np.array([self.width, self.depth, self.height])


def edges(vertices: object, boundaries: object, least: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """The vertices (n, 2) of an outline, at least so many, and the names of its edges, checked."""
    points = check_arrays.array("vertices", vertices, (None, 2))
    if len(points) < least:
        raise ValueError(f"vertices must be at least {least} pairs of numbers, got {checks.shown(vertices)}")
    if not (np.abs(points) <= checks.VAST).all():
        raise ValueError(f"vertices must be at most {checks.VAST:g} m, got {checks.shown(vertices)}")
    names = checks.strings("boundaries", boundaries)
    if len(names) != len(points):
        raise ValueError(f"boundaries must name each of the {len(points)} edges, got {len(names)} names")
    return points, names


@dataclass(frozen=True, kw_only=True)
class Polygon(Domain):
    """A simple polygon.

    Parameters
    ----------
    vertices : sequence of pairs of float
        Corners in counter-clockwise order, m.
    boundaries : sequence of str
        ``boundaries[i]`` names the edge from vertex i to vertex i + 1.
    """

    vertices: tuple[tuple[float, float], ...]
    boundaries: tuple[str, ...] = field()
    dim: ClassVar[int] = 2

    def __post_init__(self) -> None:
        points, boundaries = edges(self.vertices, self.boundaries, 3)
        x, y = points.T
        area = 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
        if not area > 0:
            raise ValueError(f"vertices must run counter-clockwise around a positive area, got a signed area of {area}")
        object.__setattr__(self, "vertices", tuple((float(a), float(b)) for a, b in points))
        object.__setattr__(self, "boundaries", boundaries)

    @property
    def polygon(self) -> Polygon:
        """Itself: every plane domain offers its polygon."""
        return self

    @property
    def lower(self) -> np.ndarray:
        """Lower left corner of the bounding box (2,), m."""
        return np.min(self.vertices, axis=0)

    @property
    def upper(self) -> np.ndarray:
        """Upper right corner of the bounding box (2,), m."""
        return np.max(self.vertices, axis=0)
