"""Geometry of domains: sides of a box, distance to named boundaries, whether an outline crosses itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg.problem.domains import Box, Outline, Polygon, Rectangle

__all__ = ["BOX_SIDES", "distance_of_segments", "distance_to_boundaries", "require_simple"]

# which side of a box a boundary is: axis, and lower (0) or upper (1) end; a rectangle's vertical axis is its last one
BOX_SIDES = {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1), "bottom": (2, 0), "top": (2, 1)}


def distance_to_boundaries(domain: Rectangle | Polygon | Outline | Box, boundaries: Sequence[str],
                           points: np.ndarray) -> np.ndarray:
    """Distance of points to the nearest of some boundaries of a domain.

    Parameters
    ----------
    domain : Rectangle, Polygon, Outline or Box
        Whose boundaries; arcs count as arcs.
    boundaries : sequence of str
        At least one of ``domain.boundaries``.
    points : (n, dim) array
        m; in a box, points of the box itself.

    Returns
    -------
    (n,) array
        m.
    """
    distance = np.full(len(points), np.inf)
    if isinstance(domain, Box):
        for name in boundaries:
            axis, end = BOX_SIDES[name]
            distance = np.minimum(distance, np.abs(points[:, axis] - (domain.lower, domain.upper)[end][axis]))
        return distance
    curved = isinstance(domain, Outline)
    start = np.array(domain.vertices if curved else domain.polygon.vertices)
    end = np.roll(start, -1, axis=0)
    for i, (name, a, b) in enumerate(zip(domain.boundaries, start, end, strict=True)):
        if name in boundaries and curved and i in domain.arcs:
            distance = np.minimum(distance, domain.arc(i).distance(points))
        elif name in boundaries:
            along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            distance = np.minimum(distance, np.linalg.norm(points - a - along[:, None] * (b - a), axis=1))
    return distance


def require_simple(outline: Polygon | Outline) -> None:
    """Raise ValueError if edges of an outline cross, touch, or have no length (Netgen would not end, or err).

    Arcs are taken as chords of at most 3 degrees.
    """
    a, owner = outline.chords() if isinstance(outline, Outline) else (np.array(outline.vertices), None)
    b = np.roll(a, -1, axis=0)
    n = len(a)
    owner = np.arange(n) if owner is None else owner
    what = type(outline).__name__.lower()

    def edge_name(k: int) -> str:
        return f"{owner[k]} ({outline.boundaries[owner[k]]!r})"

    lengths = np.linalg.norm(b - a, axis=1)
    tiny = 1e-12 * np.ptp(a, axis=0).max()
    if not lengths.min() > tiny:
        raise ValueError(f"vertices: edge {edge_name(int(np.argmin(lengths)))} of the {what} has no length")
    edge, following = b - a, np.roll(b - a, -1, axis=0)
    turn = edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0]
    folded = (np.abs(turn) <= 1e-12 * lengths * np.roll(lengths, -1)) & ((edge * following).sum(axis=1) < 0)
    if folded.any():
        i = int(np.argmax(folded))
        raise ValueError(f"vertices: edge {edge_name(i)} of the {what} folds back on itself at "
                         f"{tuple(b[i].tolist())}")
    i, j = np.triu_indices(n, 2)
    apart = (i != 0) | (j != n - 1)
    i, j = i[apart], j[apart]
    distance = distance_of_segments(a, i, j)
    crossing = (_side(a[i], b[i], a[j]) * _side(a[i], b[i], b[j]) < 0) & (
        _side(a[j], b[j], a[i]) * _side(a[j], b[j], b[i]) < 0)
    bad = crossing | (distance <= tiny) if len(i) else np.zeros(0, dtype=bool)
    if bad.any():
        k = int(np.argmax(bad))
        raise ValueError(f"vertices: edges {edge_name(i[k])} and {edge_name(j[k])} of the {what} meet; its boundary "
                         "must not cross itself")


def distance_of_segments(a: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Distance between edges i and j (m,) of a closed polygon of corners a (n, 2); they must not cross."""
    b = np.roll(a, -1, axis=0)
    # it is reached at an end of one of them
    return np.min([_to_segment(a[j], a[i], b[i]), _to_segment(b[j], a[i], b[i]), _to_segment(a[i], a[j], b[j]),
                   _to_segment(b[i], a[j], b[j])], axis=0)


def _side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Positive where c lies to the left of the line from a to b."""
    u, v = b - a, c - a
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def _to_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance of points to segments, pair by pair."""
    u = b - a
    along = np.clip(np.sum((p - a) * u, axis=1) / np.sum(u * u, axis=1), 0.0, 1.0)
    return np.linalg.norm(p - a - along[:, None] * u, axis=1)
