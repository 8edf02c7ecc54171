"""Plan: what a picture of a plane problem is drawn on - polygons and boundary curves in plot units, and the axes."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes

from adaptmg.plot.curves import Curve, curves_of, polygons_of
from adaptmg.plot.style import INK, bounds, scaled
from adaptmg.problem import ContactProblem

__all__ = ["Plan", "values_at"]


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


def values_at(value: object, x: np.ndarray) -> np.ndarray:
    """A number or a function of position at points (n, dim), m, as (n,)."""
    return np.broadcast_to(np.asarray(value(x) if callable(value) else value, dtype=float), len(x))
