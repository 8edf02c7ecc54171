"""Contact nodes of a boundary in two dimensions in order along the line, with a coordinate to draw them against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.plot.style import scaled
from adaptmg.plot.walks import walks
from adaptmg.solver.result import Result

__all__ = ["Line", "arcs_of", "lines_of"]


@dataclass(frozen=True)
class Line:
    """One connected stretch of a contact boundary.

    Attributes
    ----------
    index : (n,) int array
        Into the contact arrays, in order along the line.
    position : (n,) array
        Along the line, increasing, in the unit the label says.
    label : str
        For the axis.
    """

    index: np.ndarray
    position: np.ndarray
    label: str


def lines_of(result: Result, boundary: str) -> list[Line]:
    """The connected stretches of a contact boundary, drawn against x or y where straight, else against arc length.

    Parameters
    ----------
    result : Result
        Two-dimensional. Without a mesh the nodes are put in order along the direction of their largest extent, and
        without coordinates as they come.
    boundary : str
        Contact boundary.
    """
    index = _nodes_of(result, boundary)
    x = result.contact.x[index]
    if not np.isfinite(x).all():
        return arcs_of(result, boundary)
    extent = np.ptp(x, axis=0)
    scale, unit = scaled(float(extent.max()), "m")
    for axis, name in enumerate("xy"):
        if extent[1 - axis] <= 1e-9 * extent[axis]:
            order = np.argsort(x[:, axis])
            return [Line(index[order], scale * x[order, axis], f"{name} [{unit}]")]
    return arcs_of(result, boundary, (scale, unit), start=False)


def arcs_of(result: Result, boundary: str, scale: tuple[float, str] = (1e3, "mm"), start: bool = True) -> list[Line]:
    """The connected stretches of a contact boundary against arc length along the whole boundary.

    The length runs with the body on the left; parts of the boundary without contact nodes count and separate stretches.

    Parameters
    ----------
    result : Result
        Two-dimensional; see :func:`lines_of` for results without a mesh or without coordinates.
    boundary : str
        Contact boundary.
    scale : pair of float and str
        Unit of the lengths and its name.
    start : bool
        Whether the label says where the length begins.
    """
    index = _nodes_of(result, boundary)
    x = result.contact.x[index]
    factor, unit = scale
    if not np.isfinite(x).all():
        return [Line(index, np.arange(len(index), dtype=float), "contact node")]
    if result.mesh is None:
        centred = x - x.mean(axis=0)
        order = np.argsort(centred @ np.linalg.svd(centred, full_matrices=False)[2][0])
        steps = np.linalg.norm(np.diff(x[order], axis=0), axis=1)
        return [Line(index[order], factor * np.concatenate([[0.0], np.cumsum(steps)]), f"arc length [{unit}]")]
    points, place = result.mesh.points, np.full(result.mesh.n_nodes, -1)
    place[result.contact.node[index]] = index
    stretches, begin = [], 0.0
    found = walks(result.mesh.boundary_facets(boundary))
    for walk in found:
        steps = np.linalg.norm(np.diff(points[walk], axis=0), axis=1)
        position = begin + np.concatenate([[0.0], np.cumsum(steps)])
        begin = position[-1]
        covered = np.flatnonzero(place[walk] >= 0)
        for run in np.split(covered, np.flatnonzero(np.diff(covered) > 1) + 1):
            if len(run):
                stretches.append((place[walk[run]], factor * position[run]))
    x0, y0 = factor * points[found[0][0]]
    label = f"arc length from ({x0:.4g}, {y0:.4g}) [{unit}]" if start else f"arc length [{unit}]"
    return [Line(nodes, position, label) for nodes, position in stretches]


def _nodes_of(result: Result, boundary: str) -> np.ndarray:
    """Contact nodes of a boundary as indices into the contact arrays."""
    return np.flatnonzero(result.contact.boundary == result.contact.names.index(boundary))
