"""The edges of plane domains, straight or circular arcs, the points where two meet, and the check of closed loops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_PARALLEL = 1e-12
# of the extent: points nearer to each other are one; edges as short as this cannot be meshed
_ROUND, _SHORTEST = 1e-12, 1e-9
# points at which neighbours meet again are known to 1e-9 of the extent, as vertices of arcs are
_SAME = 1e4


def distance_to_segments(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the distance (n,) of points (n, 2) to one segment, or to one segment each."""
    u = b - a
    along = (p - a) @ u / (u @ u) if u.ndim == 1 else np.sum((p - a) * u, axis=1) / np.sum(u * u, axis=1)
    along = np.clip(along, 0.0, 1.0)
    return np.linalg.norm(p - a - along[:, None] * u, axis=1)


@dataclass(frozen=True)
class Segment:
    """A straight edge."""

    start: np.ndarray  # (2,), m
    end: np.ndarray

    @property
    def length(self) -> float:
        """m."""
        return math.dist(self.start, self.end)

    def at(self, fractions: np.ndarray) -> np.ndarray:
        """Return the points (n, 2), m, at fractions (n,) of the length."""
        return self.start + np.asarray(fractions, dtype=np.float64)[..., None] * (self.end - self.start)

    def along(self, point: np.ndarray) -> float:
        """Return the fraction of the length at which a point of the edge lies."""
        u = self.end - self.start
        return float((point - self.start) @ u / (u @ u))

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distance (n,) of points (n, 2) to the edge, m."""
        return distance_to_segments(points, self.start, self.end)


@dataclass(frozen=True)
class Arc:
    """A circular arc of less than 180 degrees."""

    center: tuple[float, float]  # m
    radius: float  # m
    start: float  # direction of the first point as seen from the centre, radians
    angle: float  # signed angle to the last point, radians; positive is counter-clockwise, as on a convex boundary

    @property
    def length(self) -> float:
        """m."""
        return self.radius * abs(self.angle)

    @property
    def bulge(self) -> float:
        """Signed area between arc and chord, m^2; positive where the arc lies outside the chord."""
        return 0.5 * self.radius**2 * (self.angle - math.sin(self.angle))

    def at(self, fractions: np.ndarray) -> np.ndarray:
        """Return the points (n, 2), m, at fractions (n,) of the angle."""
        directions = self.start + np.asarray(fractions, dtype=np.float64) * self.angle
        return np.array(self.center) + self.radius * np.stack([np.cos(directions), np.sin(directions)], axis=-1)

    def along(self, point: np.ndarray) -> float:
        """Return the fraction of the angle at which a point of the arc lies."""
        x, y = point - np.array(self.center)
        turn = math.atan2(y, x) - self.start - 0.5 * self.angle
        return 0.5 + ((turn + math.pi) % (2 * math.pi) - math.pi) / self.angle

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distance (n,) of points (n, 2) to the arc, m."""
        offset = points - np.array(self.center)
        middle = self.start + 0.5 * self.angle
        along, across = (offset @ np.array(d) for d in ((math.cos(middle), math.sin(middle)),
                                                        (-math.sin(middle), math.cos(middle))))
        in_sector = np.abs(np.arctan2(across, along)) <= 0.5 * abs(self.angle)
        ends = np.min([np.linalg.norm(points - end, axis=1) for end in self.at(np.array([0.0, 1.0]))], axis=0)
        return np.where(in_sector, np.abs(np.hypot(along, across) - self.radius), ends)


def meetings(e: Segment | Arc, f: Segment | Arc, tol: float) -> list[np.ndarray]:
    """Return the points where two edges cross or touch, and the ends of one that lie on the other."""
    found = [*e.at(np.array([0.0, 1.0])), *f.at(np.array([0.0, 1.0]))]
    if isinstance(e, Arc) and isinstance(f, Arc):
        found += _circles(e, f, tol)
    elif isinstance(e, Arc) or isinstance(f, Arc):
        arc, line = (e, f) if isinstance(e, Arc) else (f, e)
        along = (line.end - line.start) / np.linalg.norm(line.end - line.start)
        centre = np.array(arc.center)
        foot = line.start + along * ((centre - line.start) @ along)
        found += _both_sides(foot, along, arc.radius, float(np.linalg.norm(foot - centre)), tol)
    else:
        u, v, w = e.end - e.start, f.end - f.start, f.start - e.start
        cross = u[0] * v[1] - u[1] * v[0]
        if abs(cross) > _PARALLEL * np.linalg.norm(u) * np.linalg.norm(v):
            found.append(e.start + u * ((w[0] * v[1] - w[1] * v[0]) / cross))
    return [p for p in found if e.distance(p[None])[0] <= 2 * tol and f.distance(p[None])[0] <= 2 * tol]


def _circles(e: Arc, f: Arc, tol: float) -> list[np.ndarray]:
    centre, apart = np.array(e.center), np.array(f.center) - np.array(e.center)
    distance = float(np.linalg.norm(apart))
    if distance <= tol:
        return []
    toward = apart / distance
    along = (distance**2 + e.radius**2 - f.radius**2) / (2 * distance)
    return _both_sides(centre + along * toward, np.array([-toward[1], toward[0]]), e.radius, abs(along), tol)


def _both_sides(foot: np.ndarray, along: np.ndarray, radius: float, distance: float, tol: float) -> list[np.ndarray]:
    if distance > radius - tol:
        return [foot] if distance <= radius + tol else []
    half = math.sqrt((radius - distance) * (radius + distance))
    return [foot - half * along, foot + half * along]


def check_simple(edges: Sequence[Segment | Arc], names: Sequence[str], first: np.ndarray, last: np.ndarray,
                 what: str = "vertices") -> None:
    """Raise ValueError if edges from vertices ``first`` to ``last``, by number, are too short, or meet elsewhere."""
    a, b = np.array([edge.at(np.array([0.0, 1.0])) for edge in edges]).transpose(1, 0, 2)
    straight = np.array([isinstance(edge, Segment) for edge in edges])
    # an arc is shorter than a half circle: it lies in the box around its ends grown by their distance
    lengths = np.linalg.norm(b - a, axis=1)
    extent = float(np.ptp(a, axis=0).max())
    k = int(np.argmin(lengths))
    if not lengths[k] > _SHORTEST * extent:
        raise ValueError(f"{what}: edge {k} ({names[k]!r}) must be longer than {_SHORTEST:g} of the extent, got "
                         f"{lengths[k] / extent:.2g}")
    low, high = (pick(a, b) + sign * np.where(straight, 0.0, lengths)[:, None]
                 for pick, sign in ((np.minimum, -1), (np.maximum, 1)))
    i, j = np.triu_indices(len(a), 1)
    tiny = _ROUND * extent
    near = ((low[i] <= high[j] + tiny) & (low[j] <= high[i] + tiny)).all(axis=1)
    i, j = i[near], j[near]
    common = np.stack([x[i] == y[j] for x in (first, last) for y in (first, last)])
    simple = straight[i] & straight[j] & ~common.any(axis=0)
    bad = np.zeros(len(i), dtype=bool)
    m, n = i[simple], j[simple]
    bad[simple] = ((_side(a[m], b[m], a[n]) * _side(a[m], b[m], b[n]) < 0)
                   & (_side(a[n], b[n], a[m]) * _side(a[n], b[n], b[m]) < 0)) | (_apart(a, b, m, n) <= tiny)
    for k in np.flatnonzero(~simple):
        shared = [end[i[k]] for end, there in ((a, common[:2, k]), (b, common[2:, k])) if there.any()]
        bad[k] = _meet(edges[i[k]], edges[j[k]], shared, tiny)
    if bad.any():
        k = int(np.argmax(bad))
        raise ValueError(f"{what}: edges {i[k]} ({names[i[k]]!r}) and {j[k]} ({names[j[k]]!r}) meet; a boundary must "
                         "not cross itself, or fold back")


def _meet(e: Segment | Arc, f: Segment | Arc, shared: list[np.ndarray], tiny: float) -> bool:
    """Whether two edges meet elsewhere than at the vertices they share."""
    found = meetings(e, f, tiny) if not shared else [*e.at(np.array([0.0, 1.0])), *f.at(np.array([0.0, 1.0])),
                                                     *(p for v in shared for p in _again(e, f, v))]
    return any(e.distance(p[None])[0] <= 2 * tiny and f.distance(p[None])[0] <= 2 * tiny
               and all(np.linalg.norm(p - v) > _SAME * tiny for v in shared) for p in found)


def _again(e: Segment | Arc, f: Segment | Arc, v: np.ndarray) -> list[np.ndarray]:
    """The other point where the lines or circles of two edges meet that meet at v."""
    if isinstance(e, Segment) and isinstance(f, Segment):
        return []
    arc, other = (e, f) if isinstance(e, Arc) else (f, e)
    centre = np.array(arc.center)
    # mirrored at the line of both centres, or at the normal of the line through the centre
    along = np.array(other.center) - centre if isinstance(other, Arc) else other.end - other.start
    if not np.linalg.norm(along) > 0:
        return []
    along = along / np.linalg.norm(along)
    part = ((v - centre) @ along) * along
    return [centre + 2 * part - (v - centre) if isinstance(other, Arc) else v - 2 * part]


def _apart(a: np.ndarray, b: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Distance between edges i and j (m,) of those from a to b (n, 2); they must not cross."""
    if not len(i):
        return np.empty(0)
    # it is reached at an end of one of them
    pairs = ((a[j], i), (b[j], i), (a[i], j), (b[i], j))
    return np.min([distance_to_segments(p, a[k], b[k]) for p, k in pairs], axis=0)


def _side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Positive where c lies to the left of the line from a to b."""
    u, v = b - a, c - a
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
