"""What a picture of a plane problem is drawn on: polygons, named curves of the boundary, axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes

from adaptmg.plot.style import INK, bounds, scaled
from adaptmg.problem import Assembly, ContactProblem, Domain

__all__ = ["Curve", "Plan", "curves_of", "polygons_of"]

#: edges of one boundary that meet at a flatter angle belong to one curve
_SMOOTH = np.cos(np.radians(20.0))


@dataclass(frozen=True)
class Curve:
    """A smooth part of a boundary, the body on its left.

    Attributes
    ----------
    corners : (k, 2) array
        Of the polyline.
    """

    corners: np.ndarray

    @property
    def steps(self) -> np.ndarray:
        """Edges of the polyline as vectors (k - 1, 2)."""
        return np.diff(self.corners, axis=0)

    @property
    def length(self) -> float:
        """In the unit of the corners."""
        return float(np.linalg.norm(self.steps, axis=1).sum())

    @property
    def straight(self) -> bool:
        """Whether it is one straight edge."""
        return len(self.corners) == 2

    def at(self, fractions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 2) at fractions (n,) of the length, and the outward unit normals there."""
        lengths = np.linalg.norm(self.steps, axis=1)
        ends = np.concatenate([[0.0], np.cumsum(lengths)])
        place = np.asarray(fractions, dtype=float) * ends[-1]
        edge = np.clip(np.searchsorted(ends, place, side="right") - 1, 0, len(lengths) - 1)
        direction = self.steps[edge] / lengths[edge, None]
        points = self.corners[edge] + (place - ends[edge])[:, None] * direction
        return points, np.stack([direction[:, 1], -direction[:, 0]], axis=1)

    def spread(self, count: int, inset: float = 0.06) -> tuple[np.ndarray, np.ndarray]:
        """``count`` points and normals along the curve, kept off its ends by a share ``inset``."""
        return self.at(np.linspace(inset, 1 - inset, count))

    @property
    def middle(self) -> np.ndarray:
        """Point half way (2,)."""
        return self.at(np.array([0.5]))[0][0]

    @property
    def normal(self) -> np.ndarray:
        """Outward unit normal half way (2,)."""
        return self.at(np.array([0.5]))[1][0]


def polygons_of(domain: Domain) -> dict[str, np.ndarray]:
    """Vertices (n, 2), m, of the polygon of each body of a plane domain, by body; arcs as chords."""
    parts = domain.parts if isinstance(domain, Assembly) else {domain.bodies[0]: domain}
    return {body: np.array(part.polygon.vertices) for body, part in parts.items()}


def curves_of(domain: Domain) -> dict[str, list[Curve]]:
    """The curves, m, of each boundary of a plane domain, by its name."""
    parts = domain.parts if isinstance(domain, Assembly) else {"": domain}
    curves: dict[str, list[Curve]] = {name: [] for name in domain.boundaries}
    for body, part in parts.items():
        vertices, names = np.array(part.polygon.vertices), part.polygon.boundaries
        following = np.roll(vertices, -1, axis=0)
        direction = (following - vertices) / np.linalg.norm(following - vertices, axis=1)[:, None]
        # a curve begins where the name changes or a corner is
        begins = [k for k in range(len(names))
                  if names[k] != names[k - 1] or direction[k] @ direction[k - 1] < _SMOOTH] or [0]
        for k, begin in enumerate(begins):
            end = begins[(k + 1) % len(begins)]
            count = (end - begin) % len(names) or len(names)
            run = vertices[np.arange(begin, begin + count + 1) % len(names)]
            curves[f"{body}.{names[begin]}" if body else names[begin]].append(Curve(run))
    return curves


class Plan:
    """Bodies and boundaries of a plane problem in plot units.

    Attributes
    ----------
    polygons : dict of str to (n, 2) array
        By body.
    curves : dict of str to list of Curve
        By boundary.
    scale, unit : float, str
        Plot units a metre, and what they are called.
    lower, upper : (2,) arrays
        Corners of the bounding box.
    size : float
        What lengths in the picture are measured by.
    several : bool
        Whether there are several bodies: they have colours and a legend then, and pairs are not told in words beside
        them.
    legend : list of (artist, str)
        Filled while drawing.
    """

    def __init__(self, posed: ContactProblem, ax: Axes) -> None:
        polygons = polygons_of(posed.domain)
        lower, upper, diagonal = bounds(np.vstack(list(polygons.values())))
        self.scale, self.unit = scaled(diagonal, "m")
        self.polygons = {body: vertices * self.scale for body, vertices in polygons.items()}
        self.curves = {name: [Curve(curve.corners * self.scale) for curve in found]
                       for name, found in curves_of(posed.domain).items()}
        self.ax, self.lower, self.upper = ax, lower * self.scale, upper * self.scale
        self.diagonal, self.size = diagonal * self.scale, 0.7 * diagonal * self.scale
        self.axisymmetric, self.several = posed.axisymmetric, len(polygons) > 1
        self.legend: list[tuple[Artist, str]] = []

    @property
    def names(self) -> tuple[str, str]:
        """Of the axes."""
        return ("r", "z") if self.axisymmetric else ("x", "y")

    def text(self, position: np.ndarray, text: str, normal: np.ndarray, color: str = INK, along: bool = False) -> None:
        """Text beside a point, on the side the normal points to; turned where it should run along a steep edge."""
        turn = 90 if along and abs(normal[0]) > 0.9 else 0
        across = "center" if abs(normal[0]) < 0.5 else "left" if normal[0] > 0 else "right"
        up = "center" if abs(normal[1]) < 0.5 else "bottom" if normal[1] > 0 else "top"
        behind = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0} if self.several else None
        self.ax.text(*position, text, ha=across, va=up, color=color, fontsize=9, rotation=turn, zorder=6, bbox=behind)

    def longest(self, boundary: str) -> Curve:
        """The longest curve of a boundary."""
        return max(self.curves[boundary], key=lambda curve: curve.length)
