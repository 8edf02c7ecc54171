r"""Plane domains for Netgen: its spline geometry, exact measures, nodes back on the arcs, names of the edges.

An arc becomes rational quadratic splines, which are exact circles: the middle control point is the meeting point of the
tangents, at the distance :math:`r / \cos(\theta / 2)` from the centre. Pieces turn by at most 80 degrees.

While an :class:`~adaptmg.problem.Outline` is meshed, its boundaries are called by the numbers of its edges, "0", "1",
..., so that nodes of every arc are known even where edges share a name; :func:`finished` gives them their names.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from netgen.geom2d import SplineGeometry

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.build import with_source
from adaptmg.problem.domains import Outline, Polygon, Rectangle

__all__ = ["finished", "onto_outline", "plane_measures", "spline_geometry", "straight_area"]

_MAX_TURN = math.radians(80.0)
# longest edge on an arc, of its radius; Netgen rounds the number of edges of a piece
_MAX_EDGE = 0.4
# Netgen's own "no limit"
_NO_LIMIT = 1e99


def spline_geometry(domain: Rectangle | Polygon | Outline, lower: np.ndarray, scale: float,
                    sides: dict[str, float]) -> SplineGeometry:
    """Netgen's geometry of a plane domain, moved by ``-lower`` and divided by ``scale``.

    Parameters
    ----------
    domain : Rectangle, Polygon or Outline
        Boundaries get its names; those of an Outline the numbers of its edges.
    lower : (2,) array
        m.
    scale : float
        m.
    sides : dict of str to float
        Edge length along some of the boundaries, in scaled lengths.

    Returns
    -------
    netgen.geom2d.SplineGeometry
    """
    geometry = SplineGeometry()
    curved = isinstance(domain, Outline)
    vertices = domain.vertices if curved else domain.polygon.vertices
    corners = [geometry.AppendPoint(*place) for place in (np.array(vertices) - lower) / scale]
    for i, name in enumerate(domain.boundaries):
        options = {"leftdomain": 1, "rightdomain": 0, "bc": str(i) if curved else name,
                   "maxh": sides.get(name, _NO_LIMIT)}
        first, last = corners[i], corners[(i + 1) % len(corners)]
        arc = domain.arc(i) if curved else None
        if arc is None:
            geometry.Append(["line", first, last], **options)
            continue
        pieces = math.ceil(abs(arc.angle) / _MAX_TURN)
        options["maxh"] = min(options["maxh"], _MAX_EDGE * arc.radius / scale)
        center = np.array(arc.center)
        stretch = 1 / math.cos(0.5 * arc.angle / pieces)
        ends = arc.at(np.arange(1, pieces) / pieces)
        middles = center + stretch * (arc.at((np.arange(pieces) + 0.5) / pieces) - center)
        numbers = [first, *(geometry.AppendPoint(*place) for place in (ends - lower) / scale), last]
        for k, middle in enumerate((middles - lower) / scale):
            geometry.Append(["spline3", numbers[k], geometry.AppendPoint(*middle), numbers[k + 1]], **options)
    geometry.SetMaterial(1, "body")
    return geometry


def plane_measures(domain: Rectangle | Polygon | Outline) -> tuple[float, dict[str, float]]:
    """Exact area (m^2) of a plane domain, and the length (m) of its boundaries by name."""
    if isinstance(domain, Outline):
        area, lengths = domain.area, domain.lengths
    else:
        start = np.array(domain.polygon.vertices)
        end = np.roll(start, -1, axis=0)
        area = 0.5 * float(np.sum(start[:, 0] * end[:, 1] - end[:, 0] * start[:, 1]))
        lengths = np.linalg.norm(end - start, axis=1).tolist()
    perimeter = dict.fromkeys(domain.boundaries, 0.0)
    for name, length in zip(domain.boundaries, lengths, strict=True):
        perimeter[name] += length
    return area, perimeter


def straight_area(domain: Rectangle | Polygon | Outline, mesh: MeshArrays) -> float:
    """Area in m^2 that a mesh of the domain must have: the exact one, less what chords cut off arcs."""
    area, _ = plane_measures(domain)
    if not isinstance(domain, Outline):
        return area
    for i in domain.arcs:
        arc = domain.arc(i)
        a, b = mesh.points[mesh.boundary_facets(str(i))].transpose(1, 0, 2) - np.array(arc.center)
        turns = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
        area -= 0.5 * arc.radius**2 * float(np.sum(turns - np.sin(turns)))
    return area


def onto_outline(domain: Outline, mesh: MeshArrays) -> MeshArrays:
    """The mesh with its boundary nodes exactly on the outline, without source.

    Parameters
    ----------
    domain : Outline
        What was meshed.
    mesh : MeshArrays
        Boundaries are the numbers of the edges.

    Returns
    -------
    MeshArrays
        Nodes of arcs are moved along the radius (bisection puts them on chords), corners to the vertices, nodes of
        horizontal and vertical edges to their coordinate.
    """
    points = mesh.points.copy()
    vertices = np.array(domain.vertices)
    for i in range(len(vertices)):
        nodes = mesh.boundary_nodes(str(i))
        arc = domain.arc(i)
        if arc is not None:
            offset = points[nodes] - np.array(arc.center)
            points[nodes] = np.array(arc.center) + offset * (arc.radius / np.linalg.norm(offset, axis=1))[:, None]
            continue
        first, last = vertices[i], vertices[(i + 1) % len(vertices)]
        points[nodes[:, None], np.flatnonzero(first == last)] = first[first == last]
    for i, vertex in enumerate(vertices):
        nodes = mesh.boundary_nodes(str(i))
        points[nodes[np.argmin(np.linalg.norm(points[nodes] - vertex, axis=1))]] = vertex
    return replace(mesh, points=points, source=None)


def finished(domain: Outline, mesh: MeshArrays) -> MeshArrays:
    """The mesh with the names of the outline's boundaries in place of edge numbers, checked, with source."""
    names = tuple(dict.fromkeys(domain.boundaries))
    labels = np.array([names.index(domain.boundaries[int(edge)]) for edge in mesh.boundaries])
    result = replace(mesh, facet_labels=labels[mesh.facet_labels], boundaries=names, source=None)
    # other names make no mesh unsound
    object.__setattr__(result, "sound", mesh.sound)
    return with_source(result)
