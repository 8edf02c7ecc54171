r"""SizeNear: a size function that is small near some points.

With the distance d to the nearest of the points,

.. math:: h(x) = \text{size} + \text{grading} \cdot \max(0,\; d(x) - \text{radius}).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np

from adaptmg import _checks as checks
from adaptmg._text import brief


@dataclass(frozen=True)
class SizeNear:
    """A size function for :func:`adaptmg.mesh.sized`: small near some points, such as where balls first touch.

    Parameters
    ----------
    points : sequence of points
        m, each of ``dim`` numbers.
    size : float
        Edge length there, m, > 0.
    radius : float
        Up to this distance from a point the size stays the same, m; twice the expected half-width of contact, say.
    grading : float
        Growth of the edge length per distance beyond, above 0 and at most 1 (the smaller, the surer a single point
        is found in a coarse mesh: take 0.5 at most).

    Examples
    --------
    >>> size = am.SizeNear([(0.0, 0.0)], size=1e-3, radius=5e-3)
    >>> size.size
    0.001
    """

    points: Sequence[Sequence[float]]
    _: KW_ONLY
    size: float
    radius: float = 0.0
    grading: float = 0.3

    __repr__ = brief

    def __post_init__(self) -> None:
        given = checks.listed("points", self.points, "points")
        points = tuple(tuple(checks.vector("points", p).tolist()) for p in given)
        if not points or len({len(p) for p in points}) > 1:
            raise ValueError(f"points must be at least one point, all of the same dimension, "
                             f"got {checks.shown(given)}")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "size", checks.quantity("size", self.size, positive=True))
        object.__setattr__(self, "radius", checks.nonnegative("radius", self.radius))
        object.__setattr__(self, "grading", checks.positive("grading", self.grading))
        if not self.grading <= 1:
            raise ValueError(f"grading must be at most 1, got {self.grading!r}")

    def scaled(self, factor: float) -> SizeNear:
        """Return the size function times a factor everywhere, for another level of a family whose errors fall evenly.

        Where ``sized`` limits sizes, its ``max_size`` and ``grading`` take the same factor.
        """
        factor = checks.positive("factor", factor)
        if not factor * self.grading <= 1:
            raise ValueError(f"factor must be at most {1 / self.grading:.6g}, where the grading is 1, got {factor!r}")
        return replace(self, size=factor * self.size, grading=factor * self.grading)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Sizes (n,) at points (n, dim), m."""
        if x.shape[1] != len(self.points[0]):
            raise ValueError(f"points of SizeNear are {len(self.points[0])}D, the mesh is {x.shape[1]}D")
        distance = np.min([np.linalg.norm(x - np.array(p), axis=1) for p in self.points], axis=0)
        return self.size + self.grading * np.maximum(0.0, distance - self.radius)
