r"""Rigid obstacles: where a contact boundary may not go.

The condition at a contact node is :math:`u_n = u \cdot n \le g_0`, with n pointing out of the body.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from adaptmg.problem import check_arrays, checks

__all__ = ["GapFunction", "Obstacle", "Plane"]


@dataclass(frozen=True, eq=False)
class Plane:
    """A rigid plane.

    The contact normal of every node is minus the normal of the plane, so the linearised condition is exact however
    curved the body is: (x + u - point) . normal >= 0.

    Parameters
    ----------
    point : sequence of float
        A point of the plane, m.
    normal : sequence of float
        Its normal, pointing towards the body; any length > 0.
    """

    point: np.ndarray
    normal: np.ndarray

    def __post_init__(self) -> None:
        point = check_arrays.vector("point", self.point)
        if point.size not in (2, 3):
            raise ValueError(f"point must have 2 or 3 components, got {point.size}")
        normal = check_arrays.vector("normal", self.normal, point.size)
        length = np.linalg.norm(normal)
        if not length > 0:
            raise ValueError(f"normal must not be zero, got {checks.shown(self.normal)}")
        normal = normal / length
        normal.flags.writeable = False
        object.__setattr__(self, "point", point)
        object.__setattr__(self, "normal", normal)

    @property
    def dim(self) -> int:
        """Space dimension, 2 or 3."""
        return self.point.size

    def contact(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Contact normals and gaps at boundary points.

        Parameters
        ----------
        points, normals : (n, dim) arrays
            Nodes of the contact boundary (m) and outward unit normals of the body there.

        Returns
        -------
        normals : (n, dim) array
            The direction in which the gap is measured, out of the body.
        gaps : (n,) array
            m; negative where the node lies behind the plane.
        """
        facing = normals @ self.normal
        if (facing > 0).any():
            i = int(np.argmax(facing))
            raise ValueError(f"the obstacle's normal must point towards the body; at {points[i].tolist()} the "
                             "contact boundary faces away from the plane: turn the normal, or name another boundary")
        gaps = (points - self.point) @ self.normal
        return np.broadcast_to(-self.normal, points.shape).copy(), gaps


@dataclass(frozen=True, eq=False)
class GapFunction:
    """Any obstacle given by the gap in front of the contact boundary.

    Parameters
    ----------
    function : callable
        Points (n, dim) in m -> gaps (n,) in m, measured along the outward normal of the body.
    """

    function: Callable[[np.ndarray], np.ndarray]

    def __post_init__(self) -> None:
        if not callable(self.function) or isinstance(self.function, type):
            raise TypeError(f"function must be callable (points (n, dim) -> gaps (n,)), "
                            f"got {checks.described(self.function)}")

    def contact(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Contact normals and gaps at boundary points; see :meth:`Plane.contact`."""
        return normals.copy(), checks.field("gap", self.function, points)


Obstacle = Plane | GapFunction
