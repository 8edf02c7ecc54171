"""Geometry of domains, before they are meshed: extent, measures, distance to boundaries."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg.problem.combined_domains import Assembly
from adaptmg.problem.plane_domains import Box, Domain, Outline
from adaptmg.problem.solid_domains import SolidDomain, StepFile

#: axis, and lower (0) or upper (1) end of it; the vertical axis of a rectangle is its last one
BOX_SIDES = {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1), "bottom": (2, 0), "top": (2, 1)}


def in_edges(domain: Domain) -> Domain:
    """Return a plane domain as the outline that is meshed; every other domain itself; TypeError for what is none."""
    if isinstance(domain, Box | StepFile | Assembly) or (isinstance(domain, SolidDomain) and domain.dim == 3):
        return domain
    if not isinstance(domain, Domain):
        raise TypeError("domain must be a Rectangle, a Polygon, an Outline, a Circle, a Box or another solid, a Cut or "
                        f"Fuse, an Assembly of these, or a StepFile, got {domain!r}")
    return domain.outline


def distance_to_boundaries(domain: Domain, boundaries: Sequence[str], points: np.ndarray) -> np.ndarray:
    """Return the distance of points to the nearest of some boundaries of a plane domain or a box."""
    domain, distance = in_edges(domain), np.full(len(points), np.inf)
    for i, name in enumerate(domain.boundaries):
        if name in boundaries and isinstance(domain, Box):
            axis, end = BOX_SIDES[name]
            distance = np.minimum(distance, np.abs(points[:, axis] - (domain.lower, domain.upper)[end][axis]))
        elif name in boundaries:
            distance = np.minimum(distance, domain.edge(i).distance(points))
    return distance


def extent(domain: Domain) -> tuple[np.ndarray, float]:
    """Return the lowest corner and largest side of the bounding box."""
    return domain.lower, float((domain.upper - domain.lower).max())


def boundary_measures(domain: Outline | Box) -> tuple[float, dict[str, float]]:
    """Return the exact area or volume of a domain, and the lengths or areas of its boundaries by name."""
    if isinstance(domain, Box):
        lengths = domain.upper - domain.lower
        volume = float(np.prod(lengths))
        return volume, {name: volume / lengths[axis] for name, (axis, _) in BOX_SIDES.items()}
    result = dict.fromkeys(domain.boundaries, 0.0)
    for name, length in zip(domain.boundaries, domain.lengths, strict=True):
        result[name] += length
    return domain.area, result
