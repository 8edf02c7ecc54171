r"""refuse_thin: is a domain too thin for the sizes asked? And how many nodes curved faces of solids will take.

Where a wall, slot or needle is thinner than about a thousandth of the edge length around it, Netgen fails, or never
ends; OCC, which compares lengths with 1e-7 of the extent, ends the process. Therefore elements may be at most 500 times
as long as the domain is thick, and solids no thinner than 1e-5 of their extent.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from adaptmg.mesh.geometry import distance_of_segments
from adaptmg.problem.domains import (
    Ball,
    Box,
    Combination,
    Cylinder,
    Domain,
    Extrusion,
    Moved,
    Outline,
    Polygon,
    Rectangle,
    Revolution,
    SolidDomain,
)

__all__ = ["curved_nodes", "refuse_thin", "refuse_thin_shape", "thickness"]

_MAX_RATIO = 500.0
_THINNEST = 1e-5
# cosine between the directions of two edges that face each other
_FACING = -0.5


def thickness(outline: Polygon | Outline, sizes: np.ndarray | None = None) -> float:
    """Smallest distance between two edges that face each other, across the body or a slot; arcs as their chords.

    Parameters
    ----------
    outline : Polygon or Outline
        Edges that meet count with the height of the triangle between them.
    sizes : (n_edges,) array, optional
        Then each distance is divided by the smaller size of its two edges.
    """
    a, owner = outline.chords() if isinstance(outline, Outline) else (np.array(outline.vertices), None)
    edges = np.roll(a, -1, axis=0) - a
    length = np.linalg.norm(edges, axis=1)
    weight = np.ones(len(a)) if sizes is None else np.asarray(sizes)[slice(None) if owner is None else owner]
    i, j = np.triu_indices(len(a), 1)
    facing = (edges[i] * edges[j]).sum(axis=1) < _FACING * length[i] * length[j]
    i, j = i[facing], j[facing]
    if len(i) == 0:
        return math.inf
    touching = (j == i + 1) | ((i == 0) & (j == len(a) - 1))
    turn = np.abs(edges[i, 0] * edges[j, 1] - edges[i, 1] * edges[j, 0]) / np.maximum(length[i], length[j])
    apart = distance_of_segments(a, i, j)
    return float((np.where(touching, turn, apart) / np.minimum(weight[i], weight[j])).min())


def refuse_thin(domain: Domain, size: float, side_sizes: Mapping[str, float]) -> None:
    """Raise ValueError if a plane domain or solid is too thin for Netgen or OCC.

    Parameters
    ----------
    domain : Rectangle, Polygon, Outline, Box or SolidDomain
    size : float
        Largest edge length, m.
    side_sizes : mapping of str to float
        Edge lengths along some boundaries, m.
    """
    if not isinstance(domain, Box | SolidDomain):
        outline = domain if isinstance(domain, Outline) else domain.polygon
        sizes = np.array([min(size, side_sizes.get(name, size)) for name in outline.boundaries])
        extent = float((domain.upper - domain.lower).max())
        ratio = thickness(outline, np.minimum(sizes, extent))
        if ratio * _MAX_RATIO < 1:
            _refuse(domain, ratio * min(size, extent), min(size, extent))
        return
    extent = float((domain.upper - domain.lower).max())
    smallest = min([size, extent, *side_sizes.values()])
    for part, thick in _parts(domain):
        if thick < _THINNEST * extent:
            raise ValueError(f"{part!r} is {thick:.3g} m thin, less than {_THINNEST:.0e} of the extent of the whole "
                             f"({extent:.3g} m): OCC cannot tell its sides apart; make it thicker, or leave it out")
        if thick * _MAX_RATIO < smallest:
            _refuse(part, thick, smallest)


def _refuse(domain: Domain, thick: float, size: float) -> None:
    raise ValueError(f"size: edges of {size:.3g} m are more than {_MAX_RATIO:.0f} times as long as a wall, slot or "
                     f"needle of {domain!r} is thick (about {thick:.3g} m): Netgen would come to no end; ask for at "
                     f"most {_MAX_RATIO * thick:.3g} m there, or make it thicker")


def refuse_thin_shape(domain: Domain, lengths: np.ndarray, size: float) -> None:
    """The same for what a combination left, or a STEP file holds: by its bounding box (3,), m."""
    thick, extent = float(lengths.min()), float(lengths.max())
    if thick < _THINNEST * extent or thick * _MAX_RATIO < min(size, extent):
        _refuse(domain, thick, min(size, extent))


def _parts(domain: Box | SolidDomain) -> Iterator[tuple[Domain, float]]:
    """The primitives a solid is made of, and how thick they are, m."""
    if isinstance(domain, Combination):
        yield from _parts(domain.a)
        yield from _parts(domain.b)
    elif isinstance(domain, Moved):
        yield from _parts(domain.solid)
    elif isinstance(domain, Box):
        yield domain, min(domain.width, domain.depth, domain.height)
    elif isinstance(domain, Cylinder):
        yield domain, min(2 * domain.radius, domain.height)
    elif isinstance(domain, Ball):
        yield domain, 2 * domain.radius
    elif isinstance(domain, Extrusion):
        yield domain, min(domain.height, _profile(domain.polygon))
    elif isinstance(domain, Revolution):
        turned = math.radians(domain.angle) * float(domain.polygon.upper[0])
        yield domain, min(turned, _profile(domain.polygon))


def _profile(polygon: Rectangle | Polygon | Outline) -> float:
    return thickness(polygon if isinstance(polygon, Outline) else polygon.polygon)


def curved_nodes(domain: Domain, size: float, curvature: float) -> float:
    """Nodes that round faces ask for, whose edges are at most their radius over ``curvature``."""
    if isinstance(domain, Combination):
        return curved_nodes(domain.a, size, curvature) + curved_nodes(domain.b, size, curvature)
    if isinstance(domain, Moved):
        return curved_nodes(domain.solid, size, curvature)
    if isinstance(domain, Cylinder):
        area = 2 * math.pi * domain.radius * domain.height
    elif isinstance(domain, Ball):
        area = 4 * math.pi * domain.radius**2
    else:
        return 0.0
    h = domain.radius / curvature
    # at least the nodes of the surface itself; cut by other parts it may be smaller: half is counted
    return 0.5 * 1.15 * area / h**2 if h < size else 0.0
