"""Geometry of domains, before they are meshed: extent, measures, distance to boundaries, simple outlines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg.problem.plane_domains import Box, Circle, Domain, Outline, Polygon, Rectangle, distance_to_segments
from adaptmg.problem.solid_domains import Assembly, Combination, SolidDomain, StepFile

#: axis, and lower (0) or upper (1) end of it; the vertical axis of a rectangle is its last one
BOX_SIDES = {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1), "bottom": (2, 0), "top": (2, 1)}


def distance_to_boundaries(domain: Rectangle | Polygon | Outline | Box, boundaries: Sequence[str],
                           points: np.ndarray) -> np.ndarray:
    """Distance of points to the nearest of some boundaries of a domain."""
    distance = np.full(len(points), np.inf)
    if isinstance(domain, Box):
        for name in boundaries:
            axis, end = BOX_SIDES[name]
            distance = np.minimum(distance, np.abs(points[:, axis] - (domain.lower, domain.upper)[end][axis]))
        return distance
    curved = isinstance(domain, Outline)
    start = np.array(domain.vertices if curved else domain.polygon.vertices)
    end = start[domain.following] if curved else np.roll(start, -1, axis=0)
    for i, (name, a, b) in enumerate(zip(domain.boundaries, start, end, strict=True)):
        if name in boundaries and curved and i in domain.arcs:
            distance = np.minimum(distance, domain.arc(i).distance(points))
        elif name in boundaries:
            distance = np.minimum(distance, distance_to_segments(points, a, b))
    return distance


def extent(domain: Domain) -> tuple[np.ndarray, float]:
    """Lowest corner and largest side of the bounding box."""
    return domain.lower, float((domain.upper - domain.lower).max())


def boundary_measures(domain: Domain) -> tuple[float, dict[str, float]]:
    """Area or volume of a domain, and the lengths or areas of its boundaries by name."""
    if not isinstance(domain, Box):
        return plane_measures(domain)
    lengths = domain.upper - domain.lower
    volume = float(np.prod(lengths))
    return volume, {name: volume / lengths[axis] for name, (axis, _) in BOX_SIDES.items()}


def plane_measures(domain: Rectangle | Polygon | Outline) -> tuple[float, dict[str, float]]:
    """Exact area (m^2) of a plane domain, and the length (m) of its boundaries by name."""
    if isinstance(domain, Outline):
        area, lengths = domain.area, domain.lengths
    else:
        start = np.array(domain.polygon.vertices) - domain.polygon.vertices[0]
        end = np.roll(start, -1, axis=0)
        area = 0.5 * float(np.sum(start[:, 0] * end[:, 1] - end[:, 0] * start[:, 1]))
        lengths = np.linalg.norm(end - start, axis=1).tolist()
    perimeter = dict.fromkeys(domain.boundaries, 0.0)
    for name, length in zip(domain.boundaries, lengths, strict=True):
        perimeter[name] += length
    return area, perimeter


def in_edges(domain: Domain) -> Domain:
    """A circle, or plane domains combined, as the outline that is meshed; every other domain itself."""
    plane = isinstance(domain, Circle) or (isinstance(domain, Combination) and domain.dim == 2)
    return domain.outline if plane else domain


def check_domain(domain: Domain) -> None:
    """TypeError or ValueError unless it is a domain that can be meshed."""
    domain = in_edges(domain)
    if isinstance(domain, Polygon | Outline):
        require_simple(domain)
    elif not isinstance(domain, Rectangle | Box | SolidDomain | StepFile | Assembly):
        raise TypeError("domain must be a Rectangle, a Polygon, an Outline, a Circle, a Box or another solid, a Cut or "
                        f"Fuse, an Assembly of these, or a StepFile, got {domain!r}")


def require_simple(outline: Polygon | Outline) -> None:
    """ValueError if edges of an outline cross, touch, or have no length; arcs as chords of at most 3 degrees."""
    if isinstance(outline, Outline):
        a, owner, after = outline.chords()
    else:
        a, owner = np.array(outline.vertices), np.arange(len(outline.vertices))
        after = np.roll(owner, -1)
    b = a[after]
    what = type(outline).__name__.lower()

    def edge_name(k: int) -> str:
        return f"{owner[k]} ({outline.boundaries[owner[k]]!r})"

    lengths = np.linalg.norm(b - a, axis=1)
    tiny = 1e-12 * np.ptp(a, axis=0).max()
    if not lengths.min() > tiny:
        raise ValueError(f"vertices: edge {edge_name(int(np.argmin(lengths)))} of the {what} has no length")
    edge, following = b - a, (b - a)[after]
    turn = edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0]
    folded = (np.abs(turn) <= 1e-12 * lengths * lengths[after]) & ((edge * following).sum(axis=1) < 0)
    if folded.any():
        i = int(np.argmax(folded))
        raise ValueError(f"vertices: edge {edge_name(i)} of the {what} folds back on itself at "
                         f"{tuple(b[i].tolist())}")
    i, j = np.triu_indices(len(a), 1)
    apart = (after[i] != j) & (after[j] != i)
    i, j = i[apart], j[apart]
    distance = _apart(a, b, i, j)
    crossing = (_side(a[i], b[i], a[j]) * _side(a[i], b[i], b[j]) < 0) & (
        _side(a[j], b[j], a[i]) * _side(a[j], b[j], b[i]) < 0)
    bad = crossing | (distance <= tiny) if len(i) else np.zeros(0, dtype=bool)
    if bad.any():
        k = int(np.argmax(bad))
        raise ValueError(f"vertices: edges {edge_name(i[k])} and {edge_name(j[k])} of the {what} meet; its boundary "
                         "must not cross itself")


def _apart(a: np.ndarray, b: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Distance between edges i and j (m,) of those from a to b (n, 2); they must not cross."""
    # it is reached at an end of one of them
    pairs = ((a[j], i), (b[j], i), (a[i], j), (b[i], j))
    return np.min([distance_to_segments(p, a[k], b[k]) for p, k in pairs], axis=0)


def _side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Positive where c lies to the left of the line from a to b."""
    u, v = b - a, c - a
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
