"""Contact nodes of a boundary in two dimensions in order along the line, with a coordinate to draw them against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.plot.style import axis_names, scaled
from adaptmg.plot.walks import walks
from adaptmg.solver.result import Result

__all__ = ["Line", "lines_of"]


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
    index = np.flatnonzero(result.contact.boundary == result.contact.names.index(boundary))
    x = result.contact.x[index]
    if not np.isfinite(x).all():
        return [Line(index, np.arange(len(index), dtype=float), "contact node")]
    extent = np.ptp(x, axis=0)
    factor, unit = scaled(float(extent.max()), "m")
    stretches, label = _stretches(result, boundary, index, factor)
    for axis, name in enumerate(axis_names(result)):
        if extent[1 - axis] <= 1e-9 * extent[axis]:
            along = ((nodes, factor * result.contact.x[nodes, axis]) for nodes, _ in stretches)
            ordered = ((nodes, s, np.argsort(s)) for nodes, s in along)
            return [Line(nodes[order], s[order], f"{name} [{unit}]") for nodes, s, order in ordered]
    return [Line(nodes, position, f"{label} [{unit}]") for nodes, position in stretches]


def _stretches(result: Result, boundary: str, index: np.ndarray, factor: float
               ) -> tuple[list[tuple[np.ndarray, np.ndarray]], str]:
    """Stretches with arc lengths along the whole boundary, the body on the left, and the name of that coordinate.

    Parts of the boundary without contact nodes count and separate stretches.
    """
    x = result.contact.x[index]
    if result.mesh is None:
        centred = x - x.mean(axis=0)
        order = np.argsort(centred @ np.linalg.svd(centred, full_matrices=False)[2][0])
        steps = np.linalg.norm(np.diff(x[order], axis=0), axis=1)
        return [(index[order], factor * np.concatenate([[0.0], np.cumsum(steps)]))], "arc length"
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
    return stretches, f"arc length from ({x0:.4g}, {y0:.4g})"
