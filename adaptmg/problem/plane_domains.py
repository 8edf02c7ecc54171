r"""Plane domains and boxes as data that the mesh generators mesh. Lengths in m, boundaries by name.

With the signed angle :math:`\theta` of an arc of radius r (positive: counter-clockwise about its
centre) the area of an outline is that of the polygon of the vertices plus :math:`\tfrac12 r^2
(\theta - \sin\theta)` an arc."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import pairwise
from typing import Annotated, ClassVar, TypeVar, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg._checks import Name, Size
from adaptmg.problem.plane_edges import Arc, Segment, check_simple

_CHORD = math.radians(3.0)


class Domain(checks.Checked):
    """A domain that a mesh generator can mesh: the base class of all domains.

    Attributes
    ----------
    dim : int
        Space dimension.
    boundaries : tuple of str or None
        Names of the boundaries; those of several bodies are "body.edge". None where only the mesh
        knows them.
    bodies : tuple of str or None
        Names of the bodies; ``("body",)`` unless a subclass says otherwise. None where only the
        mesh knows them.
    lower, upper : (dim,) arrays
        Lowest and highest corner of a box around the domain, m; not for a StepFile.
    """

    dim: int
    boundaries: tuple[str, ...] | None
    bodies: tuple[str, ...] | None = ("body",)
    outline: Outline  # of plane domains only
    #: whether the domain may be a part of the box that ends before its sides
    loose_box: bool = False
    #: points (n, dim), m, whose bounding box contains the domain
    _extremes: Callable[[], np.ndarray]

    @property
    def lower(self) -> np.ndarray:
        """Return the lowest corner (dim,) of a box around the domain, m."""
        return self._extremes().min(axis=0)

    @property
    def upper(self) -> np.ndarray:
        """Return the highest corner (dim,) of a box around the domain, m."""
        return self._extremes().max(axis=0)


def corner(name: str, value: object, dim: int) -> tuple[float, ...]:
    """Return ``value`` as ``dim`` finite numbers."""
    return tuple(map(float, checks.vector(name, value, dim)))


Pair = Annotated[tuple[float, float], partial(corner, dim=2)]
Triple = Annotated[tuple[float, float, float], partial(corner, dim=3)]


@dataclass(frozen=True, kw_only=True)
class Rectangle(Domain):
    """An axis-parallel rectangle; boundaries ``bottom``, ``right``, ``top``, ``left``.

    Parameters
    ----------
    width, height : float
        m, > 0.
    origin : pair of float
        Lower left corner, m.

    Examples
    --------
    >>> am.Rectangle(width=0.2, height=0.1).boundaries
    ('bottom', 'right', 'top', 'left')
    """

    width: Size
    height: Size
    origin: Pair = (0.0, 0.0)
    dim: ClassVar[int] = 2
    boundaries: ClassVar[tuple[str, ...]] = ("bottom", "right", "top", "left")

    def _extremes(self) -> np.ndarray:
        return np.array([[0.0, 0.0], [self.width, self.height]]) + self.origin

    @cached_property
    def outline(self) -> Outline:
        """Return the rectangle as an outline."""
        x0, y0 = self.lower
        x1, y1 = self.upper
        return Outline(
            vertices=((x0, y0), (x1, y0), (x1, y1), (x0, y1)), boundaries=self.boundaries
        )


#: axis, and lower (0) or upper (1) end of it; the vertical axis of a rectangle is its last one
BOX_SIDES = {
    "left": (0, 0),
    "right": (0, 1),
    "front": (1, 0),
    "back": (1, 1),
    "bottom": (2, 0),
    "top": (2, 1),
}


@dataclass(frozen=True, kw_only=True)
class Box(Domain):
    """An axis-parallel box; ``left``/``right`` are x, ``front``/``back`` y, ``bottom``/``top`` z.

    Parameters
    ----------
    width, depth, height : float
        Lengths along x, y and z, m, > 0.
    origin : triple of float
        Lowest corner, m.

    Examples
    --------
    >>> am.Box(width=0.2, depth=0.1, height=0.1).boundaries
    ('bottom', 'right', 'top', 'left', 'front', 'back')
    """

    width: Size
    depth: Size
    height: Size
    origin: Triple = (0.0, 0.0, 0.0)
    dim: ClassVar[int] = 3
    boundaries: ClassVar[tuple[str, ...]] = ("bottom", "right", "top", "left", "front", "back")

    def _extremes(self) -> np.ndarray:
        return np.array([[0.0, 0.0, 0.0], [self.width, self.depth, self.height]]) + self.origin


def _vertices(name: str, value: object) -> tuple[tuple[float, float], ...]:
    """Return two or more points, checked."""
    points = checks.array(name, value, (None, 2))
    if len(points) < 2:
        raise ValueError(f"{name} must be at least 2 pairs of numbers, got {checks.shown(value)}")
    if not (np.abs(points) <= checks.VAST).all():
        raise ValueError(f"{name} must be at most {checks.VAST:g} m, got {checks.shown(value)}")
    return tuple(map(tuple, points.tolist()))


def _arcs(name: str, value: Mapping[int, tuple[float, float]]) -> dict[int, tuple[float, float]]:
    """Return the centres of arcs by the number of the edge, in ascending order, checked."""
    arcs = {
        checks.integer("the edge number in arcs", i): cast(
            "tuple[float, float]", corner(f"arcs[{i}]", centre, 2)
        )
        for i, centre in checks.mapping(name, value, "edge numbers to centres").items()
    }
    return dict(sorted(arcs.items()))


def _holes(name: str, value: object) -> tuple[int, ...]:
    return tuple(checks.integer(name, i) for i in checks.listed(name, value, "vertex numbers"))


@dataclass(frozen=True, kw_only=True, repr=False)
class Outline(Domain):
    """A plane domain like :class:`Polygon`, some of whose edges are circular arcs; it may have
    holes.

    Meshes are straight: their nodes lie on the arcs, their edges are chords. Gaps of a
    :class:`~adaptmg.ContactPair` are those of the arcs.

    Parameters
    ----------
    vertices : sequence of pairs of float
        Corners in counter-clockwise order, m.
    boundaries : sequence of str
        ``boundaries[i]`` names the edge from vertex i to vertex i + 1.
    arcs : mapping of int to pair of float
        Edge i is the shorter arc about the centre ``arcs[i]``, m: less than 180 degrees, both
        vertices at the same distance from the centre. A full circle takes three edges or more.
        Other edges are straight.
    holes : sequence of int
        Numbers of the vertices at which holes begin: the vertices of each follow those of the outer
        edge, clockwise, so that the body lies to the left of every edge. The last edge of each
        closes it. ``Cut`` makes holes.

    Examples
    --------
    >>> quarter = am.Outline(
    ...     vertices=((0, 0), (1, 0), (0, 1)), boundaries=("bottom", "arc", "left"), arcs={1: (0, 0)})
    >>> quarter.boundaries
    ('bottom', 'arc', 'left')
    """

    vertices: Annotated[tuple[tuple[float, float], ...], _vertices]
    boundaries: Annotated[tuple[str, ...], checks.strings]
    arcs: Annotated[Mapping[int, tuple[float, float]], _arcs] = field(default_factory=dict)
    holes: Annotated[tuple[int, ...], _holes] = ()
    dim: ClassVar[int] = 2
    twins: ClassVar[Mapping[int, int]] = {}  # of cracks, see Slit

    def __post_init__(self) -> None:
        """Raise ValueError unless names, arcs and holes fit the vertices, and the edges are simple
        loops."""
        super().__post_init__()
        n = len(self.vertices)
        ends = self._loops()
        if len(self.boundaries) != n:
            raise ValueError(
                f"boundaries must name each of the {n} edges, got {len(self.boundaries)} names"
            )
        if self.holes and min(b - a for a, b in ends) < 2:
            raise ValueError(
                "holes must be ascending vertex numbers, two or more apart, from 2 to "
                f"{n - 2}, got {self.holes}"
            )
        if self.arcs and max(self.arcs) >= n:
            raise ValueError(
                f"arcs names edge {max(self.arcs)}, but there are {n} edges, counted from 0"
            )
        for i in self.arcs:
            self._check_arc(i)
        for (first, _), area in zip(ends, self._areas(), strict=True):
            # the outer edge begins at vertex 0
            if first == 0 and not area > 0:
                raise ValueError(
                    "vertices must run counter-clockwise around a positive area, got a signed area of "
                    f"{area}"
                )
            if first > 0 and not area < 0:
                raise ValueError(
                    f"vertices of a hole must run clockwise around it, got a signed area of {area}"
                )
        check_simple(self.edges, self.boundaries, np.arange(n), self.following)
        for first, last in ends[1:]:
            if self.winding(self.vertices[first], np.r_[0:first, last:n]) != 1:
                raise ValueError(
                    f"holes: the hole from vertex {first} on lies outside the outer edge, or in another "
                    "hole"
                )

    def _loops(self) -> list[tuple[int, int]]:
        """Return the first vertex, and the one after the last, of the outer edge and of each hole."""
        return list(pairwise((0, *self.holes, len(self.vertices))))

    def _areas(self) -> list[float]:
        """Return the signed areas of these loops, m^2; negative for a hole."""
        result = []
        for first, last in self._loops():
            x, y = (np.array(self.vertices[first:last]) - self.vertices[first]).T
            bulges = sum(self._arc(i).bulge for i in self.arcs if first <= i < last)
            result.append(0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) + bulges)
        return result

    def __hash__(self) -> int:
        return hash((self.vertices, self.boundaries, tuple(self.arcs.items()), self.holes))

    def _check_arc(self, i: int) -> None:
        """Raise ValueError unless edge i is an arc of less than 180 degrees around its centre."""
        a, b, c = (np.array(p) for p in (*self._ends(i), self.arcs[i]))
        first = np.linalg.norm(a - c)
        last = np.linalg.norm(b - c)
        name = f"arcs[{i}] ({self.boundaries[i]!r})"
        if not abs(first - last) <= checks.ALIKE * max(first, last) or not first > 0:
            raise ValueError(
                f"{name}: the centre {self.arcs[i]} must have the same distance > 0 from both vertices, "
                f"got {first:.12g} and {last:.12g} m"
            )
        if not np.linalg.norm(b - a) > checks.ALIKE * first:
            raise ValueError(
                f"{name}: both vertices are {self.vertices[i]}; cut a full circle into three edges "
                "or more"
            )
        if not np.linalg.norm(a + b - 2 * c) > checks.SIX_DIGITS * first:
            raise ValueError(
                f"{name}: an arc of 180 degrees has no shorter side; cut it into two edges"
            )

    @property
    def following(self) -> np.ndarray:
        """Return for each vertex (n,) the next one around the outer edge, or around its hole."""
        result = np.arange(1, len(self.vertices) + 1)
        for first, last in self._loops():
            result[last - 1] = first
        return result

    def _ends(self, i: int) -> tuple[tuple[float, float], tuple[float, float]]:
        return self.vertices[i], self.vertices[self.following[i]]

    def arc(self, i: int) -> Arc | None:
        """Return edge i as an arc, None if it is straight."""
        return self._arc(i) if i in self.arcs else None

    def _arc(self, i: int) -> Arc:
        """Return edge i, one of ``arcs``."""
        center = self.arcs[i]
        (ax, ay), (bx, by) = (np.array(p) - np.array(center) for p in self._ends(i))
        radius = 0.5 * (math.hypot(ax, ay) + math.hypot(bx, by))
        angle = math.atan2(ax * by - ay * bx, ax * bx + ay * by)
        return Arc(center, radius, math.atan2(ay, ax), angle)

    @cached_property
    def edges(self) -> tuple[Arc | Segment, ...]:
        """Return all edges, made once: a size field asks for the distance to some of them several
        hundred times."""
        return tuple(
            self.arc(i) or Segment(*map(np.array, self._ends(i))) for i in range(len(self.vertices))
        )

    def winding(self, x: np.ndarray | tuple[float, float], edges: np.ndarray | None = None) -> int:
        """Return how often all edges, or the closed loops of those with the numbers ``edges`` (n,), run
        around a point ``x`` (2,) that lies on none: 1 inside."""
        edges = np.arange(len(self.vertices)) if edges is None else edges
        a, b = (np.array(self.vertices)[ends] - x for ends in (edges, self.following[edges]))
        # angles at which the straight edges are seen from the point
        turns = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
        for k, arc in enumerate(map(self.arc, edges.tolist())):
            if arc is None:
                continue
            # a point between chord and arc sees the chord turn in the other direction than the arc runs,
            # and the arc by a full turn more in its own direction; every other point sees both alike
            in_circle = np.linalg.norm(x - np.array(arc.center)) < arc.radius
            between_chord_and_arc = in_circle and turns[k] * arc.angle < 0
            if between_chord_and_arc:
                turns[k] += math.copysign(2 * math.pi, arc.angle)
        return round(float(turns.sum()) / (2 * math.pi))

    @property
    def area(self) -> float:
        """Return the exact area, m^2."""
        return sum(self._areas())

    @cached_property
    def lengths(self) -> tuple[float, ...]:
        """Return the length of each edge, m."""
        return tuple(edge.length for edge in self.edges)

    def chords(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return points (n, 2), m, on the edges in order, every 3 degrees of an arc; and for each point
        the number of its edge (n,), and that of the next point on its loop (n,)."""
        counts = np.array(
            [
                math.ceil(abs(edge.angle) / _CHORD) if isinstance(edge, Arc) else 1
                for edge in self.edges
            ]
        )
        points = np.concatenate(
            [edge.at(np.arange(n) / n) for edge, n in zip(self.edges, counts.tolist(), strict=True)]
        )
        last = np.cumsum(counts) - 1
        first = last - counts + 1
        following = np.arange(1, len(points) + 1)
        following[last] = first[self.following]
        return points, np.repeat(np.arange(len(counts)), counts), following

    @property
    def outline(self) -> Outline:
        """Return the domain itself: every plane domain offers its outline."""
        return self

    def _extremes(self) -> np.ndarray:
        points = [np.array(self.vertices)]
        for i in self.arcs:
            # points of the arc farthest along the axes, at multiples of a quarter turn; the directions of
            # an arc lie between -4 and 4 of these
            arc = self._arc(i)
            fractions = (0.5 * math.pi * np.arange(-4, 5) - arc.start) / arc.angle
            points.append(arc.at(fractions[(fractions > 0) & (fractions < 1)]))
        return np.concatenate(points)


@dataclass(frozen=True, kw_only=True, repr=False)
class Polygon(Outline):
    """A simple polygon.

    Parameters
    ----------
    vertices, boundaries
        As of an :class:`Outline`.

    Examples
    --------
    >>> wedge = am.Polygon(vertices=((0, 0), (1, 0), (0, 1)), boundaries=("bottom", "slope", "left"))
    >>> wedge.boundaries
    ('bottom', 'slope', 'left')
    """

    arcs: Mapping[int, tuple[float, float]] = field(default_factory=dict, init=False, repr=False)
    holes: tuple[int, ...] = field(default=(), init=False, repr=False)

    __hash__ = Outline.__hash__


@dataclass(frozen=True)
class Circle(Domain):
    """A disc with one boundary around it; cut from a plate it is a round hole.

    Parameters
    ----------
    centre : pair of float
        m.
    radius : float
        m, > 0.
    boundary : str
        Name of its edge.

    Examples
    --------
    >>> from adaptmg.problem import Cut, Rectangle
    >>> Cut(Rectangle(width=0.2, height=0.1), Circle((0.1, 0.05), 0.01, "hole")).boundaries
    ('bottom', 'right', 'top', 'left', 'hole')
    """

    centre: Pair
    radius: Size
    boundary: Name = "circle"
    dim: ClassVar[int] = 2

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Return its one name."""
        return (self.boundary,)

    @property
    def outline(self) -> Outline:
        """Return the circle as an outline of four arcs, which begins at the right."""
        x, y = self.centre
        r = self.radius
        return Outline(
            vertices=((x + r, y), (x, y + r), (x - r, y), (x, y - r)),
            boundaries=(self.boundary,) * 4,
            arcs=dict.fromkeys(range(4), self.centre),
        )

    def _extremes(self) -> np.ndarray:
        return np.array([[-self.radius], [self.radius]]) + self.centre


_Outlined = TypeVar("_Outlined", bound=Domain)


def with_vertex(
    domain: _Outlined, point: tuple[float, ...], arcs: bool = False
) -> _Outlined | Outline:
    """Return a plane domain with a further vertex at a point of a straight edge (``arcs``: of any
    edge). The domain is returned unchanged if the point lies on a vertex or on no such edge."""
    outline = domain.outline
    tolerance = checks.ALIKE * float((domain.upper - domain.lower).max())
    distances = [
        np.inf
        if i in outline.arcs and not arcs
        else outline.edges[i].distance(np.array([point]))[0]
        for i in range(len(outline.vertices))
    ]
    i = int(np.argmin(distances))
    to_vertices = np.linalg.norm(np.array(outline.vertices) - point, axis=1)
    if distances[i] > tolerance or to_vertices.min() <= tolerance:
        return domain
    # edge i is cut in two, and the numbers of later edges and vertices grow by 1
    centres = {k + (k > i): centre for k, centre in outline.arcs.items()}
    if (arc := outline.arc(i)) is not None:
        x, y = arc.at(np.array(arc.along(np.array(point)))).tolist()
        centres[i + 1] = arc.center
    else:
        x, y = point
    return Outline(
        vertices=(*outline.vertices[: i + 1], (x, y), *outline.vertices[i + 1 :]),
        boundaries=(*outline.boundaries[: i + 1], *outline.boundaries[i:]),
        arcs=centres,
        holes=tuple(k + (k > i) for k in outline.holes),
    )
