r"""A contact surface in three dimensions made flat: seen along its normal, or unrolled where it goes around an axis.

A surface is unrolled where its mean normal is short and its normals all lie in one plane: their common perpendicular
is the axis, and the circle :math:`x = c + r n` fitted to the points across it in least squares gives its centre. The
coordinates are then angle and length along the axis. Other surfaces are seen along their mean normal; one without any
(a whole sphere) from above.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.plot.style import scaled
from adaptmg.solver.result import Result

__all__ = ["Flat", "flattened"]

#: length of the mean of the unit normals below which the surface is taken to bend around
_AROUND = 0.5


@dataclass(frozen=True)
class Flat:
    """A contact surface in the plane.

    Attributes
    ----------
    index : (n,) int array
        Into the contact arrays.
    points : (n, 2) array
        In the units of the labels.
    triangles : (m, 3) int array or None
        Numbers within ``index``; None without a mesh.
    labels : pair of str
        Of the axes.
    equal : bool
        Whether both axes have the same scale (not for an angle and a length).
    """

    index: np.ndarray
    points: np.ndarray
    triangles: np.ndarray | None
    labels: tuple[str, str]
    equal: bool = True


def flattened(result: Result, boundary: str) -> Flat:
    """The contact nodes of a boundary in the plane.

    Parameters
    ----------
    result : Result
        Three-dimensional.
    boundary : str
        Contact boundary.
    """
    c = result.contact
    index = np.flatnonzero(c.boundary == c.names.index(boundary))
    x, normals = c.x[index], c.normal[index]
    if not np.isfinite(x).all():
        raise ValueError("this result has no coordinates to draw a contact surface in: give the DiscreteProblem its "
                         "coordinates")
    triangles = _triangles(result, boundary, index)
    if np.linalg.norm(normals.mean(axis=0)) < _AROUND and len(index) >= 6:
        _, strength, axes = np.linalg.svd(normals, full_matrices=False)
        if strength[2] < 0.05 * strength[0]:
            points, labels = _unrolled(x, normals, axes)
            if triangles is not None:
                # those across the seam would cover the rest
                triangles = triangles[np.ptp(points[triangles, 0], axis=1) < 180.0]
            return Flat(index, points, triangles, labels, equal=False)
    points, labels = _seen_along(x, normals)
    return Flat(index, points, triangles, labels)


def _unrolled(x: np.ndarray, normals: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, tuple[str, str]]:
    """Angle in degrees and length along the axis (the last row of ``axes``), and their labels."""
    axis = axes[2] * np.sign(axes[2][np.argmax(np.abs(axes[2]))])
    along = int(np.argmax(np.abs(axis)))
    first = np.eye(3)[(along + 1) % 3]
    first -= (first @ axis) * axis
    first /= np.linalg.norm(first)
    frame = np.stack([first, np.cross(axis, first)], axis=1)
    across, direction = x @ frame, normals @ frame
    # x = c + r n: unknown centre (2) and radius; the radius is negative where the body lies outside, as around a hole
    matrix = np.zeros((2 * len(x), 3))
    matrix[0::2, 0] = matrix[1::2, 1] = 1.0
    matrix[:, 2] = direction.ravel()
    centre = np.linalg.lstsq(matrix, across.ravel(), rcond=None)[0][:2]
    angle = np.degrees(np.arctan2(*(across - centre).T[::-1]))
    scale, unit = scaled(float(np.ptp(x @ axis)), "m")
    name = "xyz"[along] if abs(axis[along]) > 1 - 1e-6 else "along the axis"
    around = f"angle around {name}" if len(name) == 1 else "angle around the axis"
    return np.stack([angle, scale * (x @ axis)], axis=1), (f"{around} [°]", f"{name} [{unit}]")


def _seen_along(x: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, tuple[str, str]]:
    """Coordinates (n, 2) across the mean normal, and their labels; Cartesian ones for a normal along an axis."""
    mean = normals.mean(axis=0)
    if np.linalg.norm(mean) < 1e-3:
        mean = np.array([0.0, 0.0, 1.0])
    across = int(np.argmax(np.abs(mean)))
    keep = [k for k in range(3) if k != across]
    scale, unit = scaled(float(np.ptp(x, axis=0).max()), "m")
    if np.abs(mean[keep]).max() > 1e-6 * abs(mean[across]):
        # project along the mean normal, the first axis as near as it can be to the first Cartesian one left
        n = mean / np.linalg.norm(mean)
        first = np.eye(3)[keep[0]] - n[keep[0]] * n
        first /= np.linalg.norm(first)
        frame = np.stack([first, np.cross(n, first)], axis=1)
        return scale * (x - x.mean(axis=0)) @ frame, (f"along t1 [{unit}]", f"along t2 [{unit}]")
    return scale * x[:, keep], tuple(f"{'xyz'[k]} [{unit}]" for k in keep)


def _triangles(result: Result, boundary: str, index: np.ndarray) -> np.ndarray | None:
    """Facets of the boundary whose corners are all contact nodes, numbered within ``index``; None without any."""
    if result.mesh is None:
        return None
    place = np.full(result.mesh.n_nodes, -1)
    place[result.contact.node[index]] = np.arange(len(index))
    triangles = place[result.mesh.boundary_facets(boundary)]
    triangles = triangles[(triangles >= 0).all(axis=1)]
    return triangles if len(triangles) else None
