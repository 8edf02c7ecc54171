"""The edges of plane domains, straight or circular arcs, the points where two meet, and the check
of closed loops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptmg import _checks as checks

#: distance below which points at which neighbours meet are one, over the tolerance of meetings: they are known to
#: 1e-9 of the extent, as vertices of arcs are
_SAME = 10 * checks.ALIKE / checks.ROUNDING


@dataclass(frozen=True)
class Segment:
    """A straight edge."""

    start: np.ndarray  # (2,), m
    end: np.ndarray

    @property
    def ends(self) -> np.ndarray:
        """Return the first and the last point (2, 2), m."""
        return np.stack([self.start, self.end])

    @property
    def length(self) -> float:
        """Return the length, m."""
        return math.dist(self.start, self.end)

    def at(self, fractions: np.ndarray) -> np.ndarray:
        """Return the points (n, 2), m, at fractions (n,) of the length."""
        return self.start + np.asarray(fractions, dtype=np.float64)[..., None] * (
            self.end - self.start
        )

    def along(self, point: np.ndarray) -> float:
        """Return the fraction of the length at which a point of the edge lies."""
        u = self.end - self.start
        return float((point - self.start) @ u / (u @ u))

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distance (n,) of points (n, 2) to the edge, m."""
        u = self.end - self.start
        offset = points - self.start
        along = np.minimum(np.maximum(offset @ u / (u @ u), 0.0), 1.0)
        x, y = (offset - along[:, None] * u).T
        return np.sqrt(x * x + y * y)  # a third of the time of norm(axis=1), the same bits


@dataclass(frozen=True)
class Arc:
    """A circular arc of less than 180 degrees."""

    center: tuple[float, float]  # m
    radius: float  # m
    start: float  # direction of the first point as seen from the centre, radians
    angle: float  # signed angle to the last point, radians; positive is counter-clockwise, as on a convex boundary

    @property
    def ends(self) -> np.ndarray:
        """Return the first and the last point (2, 2), m."""
        return self.at(np.array([0.0, 1.0]))

    @property
    def length(self) -> float:
        """Return the length, m."""
        return self.radius * abs(self.angle)

    @property
    def bulge(self) -> float:
        """Return the signed area between arc and chord, m^2; positive where the arc lies outside
        the chord."""
        return 0.5 * self.radius**2 * (self.angle - math.sin(self.angle))

    def at(self, fractions: np.ndarray) -> np.ndarray:
        """Return the points (n, 2), m, at fractions (n,) of the angle."""
        directions = self.start + np.asarray(fractions, dtype=np.float64) * self.angle
        return np.array(self.center) + self.radius * np.stack(
            [np.cos(directions), np.sin(directions)], axis=-1
        )

    def along(self, point: np.ndarray) -> float:
        """Return the fraction of the angle at which a point of the arc lies."""
        x, y = point - np.array(self.center)
        # from the middle of the arc, between -pi and pi, so that no end is a full turn off
        turn = math.atan2(y, x) - self.start - 0.5 * self.angle
        return 0.5 + ((turn + math.pi) % (2 * math.pi) - math.pi) / self.angle

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distance (n,) of points (n, 2) to the arc, m."""
        offset = points - np.array(self.center)
        # coordinates along the direction to the middle of the arc, and across it
        middle = self.start + 0.5 * self.angle
        along = offset @ np.array([math.cos(middle), math.sin(middle)])
        across = offset @ np.array([-math.sin(middle), math.cos(middle)])
        in_sector = np.abs(np.arctan2(across, along)) <= 0.5 * abs(self.angle)
        ends = np.min([np.linalg.norm(points - end, axis=1) for end in self.ends], axis=0)
        return np.where(in_sector, np.abs(np.hypot(along, across) - self.radius), ends)


def meetings(e: Segment | Arc, f: Segment | Arc, tol: float) -> list[np.ndarray]:
    """Return the points where two edges cross or touch, and the ends of one that lie on the
    other."""
    points = [*e.ends, *f.ends]
    if isinstance(e, Arc):
        both = isinstance(f, Arc)
        points += _circles(e, f, tol) if both else _line_and_circle(f, e, tol)
    elif isinstance(f, Arc):
        points += _line_and_circle(e, f, tol)
    else:
        u = e.end - e.start
        v = f.end - f.start
        w = f.start - e.start
        # the lines meet at e.start + s u with s = (w x v) / (u x v)
        cross = u[0] * v[1] - u[1] * v[0]
        if abs(cross) > checks.ROUNDING * np.linalg.norm(u) * np.linalg.norm(v):
            points.append(e.start + u * ((w[0] * v[1] - w[1] * v[0]) / cross))
    return on_both(e, f, points, tol)


def _line_and_circle(line: Segment, arc: Arc, tol: float) -> list[np.ndarray]:
    """Return the points where the line and the circle of two edges meet."""
    along = (line.end - line.start) / np.linalg.norm(line.end - line.start)
    centre = np.array(arc.center)
    foot = line.start + along * ((centre - line.start) @ along)
    return _both_sides(foot, along, arc.radius, float(np.linalg.norm(foot - centre)), tol)


def on_both(
    e: Segment | Arc, f: Segment | Arc, points: list[np.ndarray], tol: float
) -> list[np.ndarray]:
    """Return those points that lie on both edges, up to twice the rounding ``tol`` of their places."""
    return [
        p for p in points if e.distance(p[None])[0] <= 2 * tol and f.distance(p[None])[0] <= 2 * tol
    ]


def _circles(e: Arc, f: Arc, tol: float) -> list[np.ndarray]:
    """Return the points where the circles of two arcs meet; their chord crosses the line from centre
    to centre at the distance ``along``."""
    centre = np.array(e.center)
    apart = np.array(f.center) - np.array(e.center)
    distance = float(np.linalg.norm(apart))
    if distance <= tol:
        return []
    toward = apart / distance
    along = (distance**2 + e.radius**2 - f.radius**2) / (2 * distance)
    return _both_sides(
        centre + along * toward, np.array([-toward[1], toward[0]]), e.radius, abs(along), tol
    )


def _both_sides(
    foot: np.ndarray, along: np.ndarray, radius: float, distance: float, tol: float
) -> list[np.ndarray]:
    """Return the points where a circle meets a line with the unit vector ``along``; ``foot`` is the
    point of the line nearest to the centre, at this distance from it."""
    if distance > radius - tol:
        return [foot] if distance <= radius + tol else []
    half_chord = math.sqrt((radius - distance) * (radius + distance))
    return [foot - half_chord * along, foot + half_chord * along]


def check_simple(
    edges: Sequence[Segment | Arc],
    names: Sequence[str],
    first: np.ndarray,
    last: np.ndarray,
    what: str = "vertices",
) -> None:
    """Raise ValueError if ``edges`` (n) of the boundaries ``names`` are too short, or meet elsewhere
    than at common vertices: ``first`` (n,) and ``last`` (n,) are the numbers of the vertices of each.
    Messages begin with the argument ``what``."""
    a, b = np.array([edge.ends for edge in edges]).transpose(1, 0, 2)
    straight = np.array([isinstance(edge, Segment) for edge in edges])
    # an arc is shorter than a half circle: it lies in the box around its ends grown by their
    # distance
    lengths = np.linalg.norm(b - a, axis=1)
    extent = float(np.ptp(a, axis=0).max())
    shortest = int(np.argmin(lengths))
    if not lengths[shortest] > checks.ALIKE * extent:
        raise ValueError(
            f"{what}: edge {shortest} ({names[shortest]!r}) must be longer than {checks.ALIKE:g} of the "
            f"extent, got {lengths[shortest] / extent:.2g}"
        )
    grown = np.where(straight, 0.0, lengths)[:, None]
    low = np.minimum(a, b) - grown
    high = np.maximum(a, b) + grown
    tiny = checks.ROUNDING * extent
    pairs = np.stack(np.triu_indices(len(a), 1), axis=1)
    # the boxes of both edges overlap
    near = (low[pairs] <= high[pairs[:, ::-1]] + tiny).all(axis=(1, 2))
    close: list[list[int]] = pairs[near].tolist()
    for i, j in close:
        common_vertices = {first[i], last[i]} & {first[j], last[j]}
        shared = [a[i] if vertex == first[i] else b[i] for vertex in common_vertices]
        if _meet(edges[i], edges[j], shared, tiny):
            raise ValueError(
                f"{what}: edges {i} ({names[i]!r}) and {j} ({names[j]!r}) meet; a boundary must not cross "
                "itself, or fold back"
            )


def _meet(e: Segment | Arc, f: Segment | Arc, shared: list[np.ndarray], tiny: float) -> bool:
    """Return whether two edges meet elsewhere than at the vertices ``shared``, (2,) each, that both have;
    ``tiny`` is the tolerance of :func:`meetings`, m."""
    if shared:
        candidates = [*e.ends, *f.ends, *(p for v in shared for p in _second_meeting(e, f, v))]
        points = on_both(e, f, candidates, tiny)
    else:
        points = meetings(e, f, tiny)
    return any(all(np.linalg.norm(p - v) > _SAME * tiny for v in shared) for p in points)


def _second_meeting(e: Segment | Arc, f: Segment | Arc, v: np.ndarray) -> list[np.ndarray]:
    """Return the second point, if any, where the lines or circles of two edges meet that meet at v."""
    if isinstance(e, Arc):
        arc = e
        other = f
    elif isinstance(f, Arc):
        arc = f
        other = e
    else:
        return []
    centre = np.array(arc.center)
    # v mirrored at the line through both centres; where the other is a line, at its normal through the centre
    along = np.array(other.center) - centre if isinstance(other, Arc) else other.end - other.start
    if not np.linalg.norm(along) > 0:
        return []
    along = along / np.linalg.norm(along)
    part = ((v - centre) @ along) * along
    if isinstance(other, Arc):
        return [centre + 2 * part - (v - centre)]
    return [v - 2 * part]
