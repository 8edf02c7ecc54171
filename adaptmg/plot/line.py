"""Contact nodes of a boundary in two dimensions in order along the line, with a coordinate to draw them against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.plot.style import scaled
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
    c = result.contact
    index = np.flatnonzero(c.boundary == c.names.index(boundary))
    x = c.x[index]
    if not np.isfinite(x).all():
        return [Line(index, np.arange(len(index), dtype=float), "contact node")]
    extent = np.ptp(x, axis=0)
    scale, unit = scaled(float(extent.max()), "m")
    for axis, name in enumerate("xy"):
        if extent[1 - axis] <= 1e-9 * extent[axis]:
            order = np.argsort(x[:, axis])
            return [Line(index[order], scale * x[order, axis], f"{name} [{unit}]")]
    if result.mesh is not None:
        chains = _chains(result.mesh, boundary, c.node, index)
    else:
        centred = x - x.mean(axis=0)
        chains = [index[np.argsort(centred @ np.linalg.svd(centred, full_matrices=False)[2][0])]]
    lines, begin = [], 0.0
    for chain in chains:
        steps = np.linalg.norm(np.diff(c.x[chain], axis=0), axis=1)
        position = begin + np.concatenate([[0.0], np.cumsum(steps)])
        lines.append(Line(chain, scale * position, f"arc length [{unit}]"))
        begin = position[-1]
    return lines


def _chains(mesh: MeshArrays, boundary: str, nodes: np.ndarray, index: np.ndarray) -> list[np.ndarray]:
    """Walk the facets of the boundary (each points on to the next) from every free end; rings from any node."""
    facets = mesh.boundary_facets(boundary)
    following = dict(facets.tolist())
    heads = sorted(set(following) - set(following.values()))
    contact_index = dict(zip(nodes[index].tolist(), index.tolist(), strict=True))
    chains = []
    while following:
        node = heads.pop(0) if heads else min(following)
        walk = [node]
        while node in following:
            node = following.pop(node)
            walk.append(node)
        chain = [contact_index[n] for n in walk if n in contact_index]
        if chain:
            chains.append(np.array(chain))
    return chains
