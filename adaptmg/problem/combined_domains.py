"""Bodies made of others: differences, unions and intersections, bodies with cracks, and assemblies.

When solids are combined, the names of faces survive: several faces may share one, and a name
without a face is an error only where it is used. Plane domains combined are an
:class:`~adaptmg.problem.Outline` as soon as they are made: edges are cut where those of the other
outline meet them, and a piece stays by the side of the other outline that it lies on: outside of it
in a union, inside in an intersection; in a difference pieces of b inside of a stay, turned round.
Where pieces of both coincide, one stays if the bodies lie on the same side of it (in a difference:
on either side).

A crack has two faces: a path of straight edges in the plane, a plane polygon in space.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Annotated, cast

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg.problem.plane_domains import (
    BOX_SIDES,
    Box,
    Circle,
    Domain,
    Outline,
    Polygon,
    Rectangle,
    with_vertex,
)
from adaptmg.problem.plane_edges import Arc, Segment, check_simple, meetings
from adaptmg.problem.solid_domains import SOLID, SolidDomain

Path = tuple[tuple[float, ...], ...]
_SIDES = ("left", "right")


def _part(name: str, value: Domain) -> Domain:
    """Return a domain that can be combined; TypeError or ValueError for others."""
    part = checks.instance(
        name,
        value,
        (SolidDomain, Box, Rectangle, Outline, Circle),
        f"{SOLID}, or a plane domain (Rectangle, Polygon, Outline, Circle, Cut, ...)",
    )
    if isinstance(part, Cracked):
        raise ValueError(
            f"{name} is cracked: combine the bodies first, and name all cracks of the result together"
        )
    return part


Part = Annotated[SolidDomain | Box | Rectangle | Outline | Circle, _part]


@dataclass(frozen=True, repr=False)
class Combination(SolidDomain):
    """Two solids, or two plane domains, combined: the base class of :class:`Cut`, :class:`Fuse` and
    :class:`Common`.

    Boundaries keep their names; where both parts have one of the same name, it becomes one boundary
    unless ``rename`` tells them apart.

    Parameters
    ----------
    a, b : Box, Cylinder, ..., or Rectangle, Polygon, Outline, Circle; or a combination of these
        Both in space or both plane. The result must be one piece; a plane one may have holes.
    rename : mapping of str to str
        New names: "side" of both parts, "b.side" of b alone.
    """

    a: Part
    b: Part
    rename: Annotated[Mapping[str, str], partial(checks.mapping, words="names to names")] = field(
        default_factory=dict, hash=False
    )

    loose_box = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.a.dim != self.b.dim:
            raise ValueError(
                f"a is {self.a.dim}D, b {self.b.dim}D: combine two solids or two plane domains"
            )
        # a name in either part, or "a.name", "b.name" for that of one part
        renamable = [
            key
            for part in "ab"
            for name in getattr(self, part).boundaries
            for key in (name, f"{part}.{name}")
        ]
        for old, new in self.rename.items():
            checks.choice("the keys of rename", old, dict.fromkeys(renamable))
            checks.boundary_name(f"rename[{old!r}]", new)
        if self.dim == 2:
            _ = self.outline  # a check: it is refused unless it is one piece

    @property
    def dim(self) -> int:
        """Return the space dimension of both."""
        return self.a.dim

    @cached_property
    def outline(self) -> Outline:
        """Return, of plane domains, the edges of the result, holes included."""
        parts = [
            replace(
                outline, boundaries=tuple(self.renamed(part, name) for name in outline.boundaries)
            )
            for part, outline in (("a", self.a.outline), ("b", self.b.outline))
        ]
        return combined(type(self).__name__, *parts)

    def renamed(self, part: str, name: str) -> str:
        """Return the name in the result of the boundary ``name`` of ``part``, "a" or "b"."""
        return self.rename.get(f"{part}.{name}", self.rename.get(name, name))

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Return the distinct names: those of a, then those of b. Of solids those sides of
        boxes are left out that lie beyond the box around the result; of other names no face may be
        left."""
        if self.dim == 2:
            return tuple(dict.fromkeys(self.outline.boundaries))
        both = ((part, name) for part in "ab" for name in getattr(self, part).boundaries)
        return tuple(
            dict.fromkeys(self.renamed(*named) for named in both if self._may_remain(*named))
        )

    def _may_remain(self, part: str, name: str) -> bool:
        """Return False for a side of a box that lies beyond the box around the result."""
        box = getattr(self, part)
        if not isinstance(box, Box):
            return True
        axis, end = BOX_SIDES[name]
        place = (box.lower, box.upper)[end][axis]
        beyond = abs(place - np.clip(place, self.lower[axis], self.upper[axis]))
        return bool(beyond <= checks.ALIKE * (box.upper - box.lower).max())


class Cut(Combination):
    """``a`` without what it shares with ``b``. Parameters as of :class:`Combination`.

    Examples
    --------
    >>> plate = am.Cut(am.Rectangle(width=0.2, height=0.1), am.Circle((0.1, 0.05), 0.02, "hole"))
    >>> corner = am.Rectangle(width=0.02, height=0.03)
    >>> am.Cut(plate, corner, rename={"b.right": "notch", "b.top": "notch"}).boundaries
    ('bottom', 'right', 'top', 'left', 'notch', 'hole')
    >>> drill = am.Cylinder((0.5, 0.5, 0), (0, 0, 1), 0.2, 1.0)
    >>> drilled = am.Cut(am.Box(width=1, depth=1, height=1), drill)
    >>> drilled.a.width
    1.0
    """

    def _extremes(self) -> np.ndarray:
        return np.stack([self.a.lower, self.a.upper])


class Fuse(Combination):
    """``a`` and ``b`` as one body. Parameters as of :class:`Combination`.

    Examples
    --------
    >>> both = am.Fuse(am.Box(width=1, depth=1, height=1), am.Ball((0.5, 0.5, 1.0), 0.3))
    >>> both.b.radius
    0.3
    """

    def _extremes(self) -> np.ndarray:
        return np.stack([self.a.lower, self.b.lower, self.a.upper, self.b.upper])


class Common(Combination):
    """The intersection of ``a`` and ``b``. Parameters as of :class:`Combination`.

    Examples
    --------
    >>> lens = am.Common(am.Ball((0, 0, 0), 1.0), am.Ball((0, 0, 1.5), 1.0))
    >>> lens.b.centre[2]
    1.5
    """

    def _extremes(self) -> np.ndarray:
        return np.stack(
            [np.maximum(self.a.lower, self.b.lower), np.minimum(self.a.upper, self.b.upper)]
        )


@dataclass(frozen=True)
class _Piece:
    """A part of an edge between two numbered points."""

    start: int
    end: int
    name: str  # of the boundary
    centre: tuple[float, float] | None  # of an arc, m; None: it is straight
    middle: np.ndarray  # (2,): the point halfway along it, m


def combined(what: str, a: Outline, b: Outline) -> Outline:
    """Return the outline of "Cut", "Fuse" or "Common" of two outlines; ValueError unless it is one
    piece."""
    tol = checks.ROUNDING * float(max(np.ptp(outline.vertices, axis=0).max() for outline in (a, b)))
    points: list[np.ndarray] = []
    # points where edge i of a meets edge j of b
    crossings = [[meetings(e, f, tol) for f in b.edges] for e in a.edges]
    cuts_of_a = [list(chain(*row)) for row in crossings]
    cuts_of_b = [list(chain(*column)) for column in zip(*crossings, strict=True)]
    of_a = _pieces(a, cuts_of_a, points, tol)
    of_b = _pieces(b, cuts_of_b, points, tol)
    # Pieces of a stay that lie in b (Common) or outside b (Cut, Fuse), and pieces of b that lie in a
    # (Common, and Cut, where they are reversed) or outside a (Fuse). A piece of both stays once if
    # both bodies lie on the same side of it; for a Cut, if they lie on opposite sides.
    pieces = []
    for piece in of_a:
        # the middles tell arcs from their chords, and from arcs to the other side; they add roundings to
        # those of the ends
        twins = [
            other
            for other in of_b
            if {piece.start, piece.end} == {other.start, other.end}
            and np.linalg.norm(piece.middle - other.middle) <= 10 * tol
        ]
        if twins:
            same_side = twins[0].start == piece.start
            stays = same_side != (what == "Cut")
        else:
            inside = b.winding(piece.middle) == 1
            stays = inside == (what == "Common")
        if stays:
            pieces.append(piece)
        of_b = [other for other in of_b if other not in twins]
    for piece in of_b:
        inside = a.winding(piece.middle) == 1
        if inside == (what != "Fuse"):
            pieces.append(
                replace(piece, start=piece.end, end=piece.start) if what == "Cut" else piece
            )
    return _chained(what, pieces, points)


def _pieces(
    outline: Outline,
    cuts: list[list[np.ndarray]],
    points: list[np.ndarray],
    tol: float,
) -> list[_Piece]:
    """Return the edges of an outline, cut at the points ``cuts`` of each edge. The ends of all pieces
    are appended to ``points``, where pieces refer to them by number."""

    def number(p: np.ndarray) -> int:
        """Return the number of a point, a new one if none in ``points`` is near."""
        for k, other in enumerate(points):
            # a few roundings: both outlines compute their common points
            if np.abs(p - other).max() <= 4 * tol:
                return k
        points.append(p)
        return len(points) - 1

    result = []
    for i, (edge, cut_points) in enumerate(zip(outline.edges, cuts, strict=True)):
        ends = [np.array(outline.vertices[k]) for k in (i, outline.following[i])]
        inner = sorted(cut_points, key=edge.along)
        numbers = list(dict.fromkeys(map(number, (ends[0], *inner))))
        last = number(ends[1])
        # a cut at the end of the edge makes no piece
        numbers = [k for k in numbers if k != last] + [last]
        centre = outline.arcs.get(i)
        for start, end in pairwise(numbers):
            middle = 0.5 * (points[start] + points[end])
            if isinstance(edge, Arc):
                # from the middle of the chord to that of the arc
                spoke = middle - np.array(centre)
                middle = np.array(centre) + spoke * (edge.radius / np.linalg.norm(spoke))
            result.append(_Piece(start, end, outline.boundaries[i], centre, middle))
    return result


def _chained(what: str, pieces: list[_Piece], points: list[np.ndarray]) -> Outline:
    """Join pieces, which have ends by their numbers in ``points``, (2,) each, to closed loops and return
    their outline, its outer loop first; ValueError unless they bound one body."""
    # by the number of the point at which a piece starts
    leaving: dict[int, _Piece] = {}
    for piece in pieces:
        if piece.start in leaving:
            raise ValueError(
                f"the edges of the {what} touch each other at the point "
                f"{tuple(points[piece.start].tolist())}: move or resize one part a little"
            )
        leaving[piece.start] = piece
    loops = []
    while leaving:
        loop = [leaving.pop(next(iter(leaving)))]
        while loop[-1].end in leaving:
            loop.append(leaving.pop(loop[-1].end))
        loops.append(loop)
    areas = [_loop_area(loop, points) for loop in loops]
    outer = [k for k, area in enumerate(areas) if area > 0]
    if len(outer) != 1:
        raise ValueError(
            f"the {what} leaves {f'{len(outer)} pieces' if outer else 'nothing'}; a body must be one "
            "piece: pose several as an Assembly"
        )
    loops.insert(0, loops.pop(outer[0]))
    starts = np.cumsum([0, *map(len, loops)])
    ordered = list(chain(*loops))
    return Outline(
        vertices=tuple(tuple(points[piece.start].tolist()) for piece in ordered),
        boundaries=tuple(piece.name for piece in ordered),
        holes=tuple(starts[1:-1].tolist()),
        arcs={k: piece.centre for k, piece in enumerate(ordered) if piece.centre is not None},
    )


def _loop_area(loop: list[_Piece], points: list[np.ndarray]) -> float:
    """Return twice the signed area of the polygon through the starts and middles of a loop, m^2."""
    x, y = np.array([p for piece in loop for p in (points[piece.start], piece.middle)]).T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


@dataclass(frozen=True, repr=False)
class Slit(Outline):
    """An outline whose last holes have no width: along the left face of each crack, and back along
    the right one."""

    #: edge of a right face -> edge of the left face at the same place
    twins: Mapping[int, int] | None = None

    __hash__ = Outline.__hash__

    def __post_init__(self) -> None:
        """Check nothing: a slit is made of parts that have been checked."""


@dataclass(frozen=True, repr=False)
class Cracked(SolidDomain):
    """A body with cracks.

    Parameters
    ----------
    domain : Rectangle, Polygon, Outline, Circle, or a combination of these; or Box, Cylinder, Cut,
    ...
        The body without cracks.
    cracks : mapping of str to sequence of points
        The path of each crack by its name, m: straight edges between two or more points inside the
        body; each end may lie on the boundary, or at a point of another crack. In space a plane
        polygon. The boundaries "name.left" and "name.right" are its faces, seen along the path;
        polygons run counter-clockwise as seen from the right. The faces touch where an
        :class:`~adaptmg.ContactPair` says so.

    Examples
    --------
    >>> plate = am.Cracked(am.Rectangle(width=1, height=1), {"crack": ((0.3, 0.3), (0.7, 0.7))})
    >>> plate.boundaries
    ('bottom', 'right', 'top', 'left', 'crack.left', 'crack.right')
    """

    domain: Part
    cracks: Mapping[str, Path]

    if TYPE_CHECKING:

        def __init__(self, domain: Domain, cracks: Mapping[str, ArrayLike]) -> None: ...

    def __post_init__(self) -> None:
        """Store the paths of cracks as tuples of points, checked."""
        super().__post_init__()
        body = self.domain
        paths = {}
        for name, points in checks.mapping("cracks", self.cracks, "names to paths").items():
            checks.boundary_name("the names of cracks", name)
            path = checks.array(f"cracks[{name!r}]", points, (None, body.dim))
            if len(path) < body.dim:
                raise ValueError(
                    f"cracks[{name!r}] must be {body.dim} points or more, got {checks.shown(points)}"
                )
            if body.dim == 3:
                _check_plane(name, path)
            paths[name] = tuple(map(tuple, (path + 0.0).tolist()))  # + 0.0: no -0.0
        if not paths:
            raise ValueError("cracks is empty: name one crack at least")
        object.__setattr__(self, "cracks", paths)
        names = [
            *dict.fromkeys(self.domain.boundaries),
            *(f"{name}.{side}" for name in paths for side in _SIDES),
        ]
        if len(set(names)) < len(names):
            raise ValueError(
                f"cracks: the faces {', '.join(names[-2 * len(paths) :])} must have other names than the "
                f"boundaries {', '.join(self.domain.boundaries)}"
            )
        if body.dim == 2:
            # a check: cracks that cross, or leave the body, are refused in the plane alone
            _ = self.outline

    def __hash__(self) -> int:
        return hash((self.domain, tuple(self.cracks.items())))

    @property
    def dim(self) -> int:
        """Return the space dimension."""
        return self.domain.dim

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Return the boundaries of the body, then the two faces of each crack."""
        return (
            *self.domain.boundaries,
            *(f"{name}.{side}" for name in self.cracks for side in _SIDES),
        )

    @property
    def loose_box(self) -> bool:
        """Return whether the body may end before the sides of its box."""
        return self.domain.loose_box

    def _extremes(self) -> np.ndarray:
        return np.stack([self.domain.lower, self.domain.upper])

    @cached_property
    def outline(self) -> Slit:
        """Return the outline of a plane body, with the cracks as holes without width."""
        body, paths = self._anchored()
        _check_cracks(body, paths)
        vertices: list[tuple[float, ...]] = list(body.vertices)
        names = list(body.boundaries)
        holes = list(body.holes)
        twins = {}
        # A crack of n edges is a loop of 2 n: along its left side and back along its right. Edges j
        # and 2 n - 1 - j of the loop coincide.
        for name, path in paths.items():
            n = len(path) - 1
            first = len(vertices)
            holes.append(first)
            vertices += [*path, *path[-2:0:-1]]
            names += [f"{name}.left"] * n + [f"{name}.right"] * n
            twins |= {first + n + j: first + n - 1 - j for j in range(n)}
        return Slit(
            vertices=cast("tuple[tuple[float, float], ...]", tuple(vertices)),
            boundaries=tuple(names),
            arcs=body.arcs,
            holes=tuple(holes),
            twins=twins,
        )

    def _anchored(self) -> tuple[Outline, dict[str, Path]]:
        """Return the outline with a vertex where a crack ends on it, and the cracks.

        A crack that ends near a vertex, or near a point of another crack, ends exactly there. A crack of
        a single edge gets a vertex in the middle: a node that can open."""
        body = self.domain.outline
        paths: dict[str, Path] = {}
        tolerance = checks.ALIKE * float((self.upper - self.lower).max())
        for name, path in self.cracks.items():
            ends = []
            for end in (path[0], path[-1]):
                body = with_vertex(body, end, arcs=True)
                places: list[tuple[float, ...]] = list(body.vertices)
                for other, points in self.cracks.items():
                    if other != name:
                        # without the ends of cracks that follow, which may still be moved
                        places += paths.get(other, points[1:-1])
                distances = np.linalg.norm(np.array(places) - end, axis=1)
                nearest = int(np.argmin(distances))
                ends.append(places[nearest] if distances[nearest] <= tolerance else end)
            middle = path[1:-1] or (tuple((0.5 * np.add(*ends)).tolist()),)
            paths[name] = (ends[0], *middle, ends[1])
        return body, paths


def normal_of(polygon: np.ndarray | Path) -> np.ndarray:
    """Return twice the area vector (3,) of a plane polygon, pointing to where it runs
    counter-clockwise."""
    spokes = np.array(polygon) - polygon[0]
    return np.cross(spokes[1:-1], spokes[2:]).sum(axis=0)


def _check_plane(name: str, path: np.ndarray) -> None:
    """Raise ValueError unless a path is a plane polygon that does not cross itself."""
    normal = normal_of(path)
    extent = float(np.ptp(path, axis=0).max())
    length = float(np.linalg.norm(normal))
    has_area = length > checks.ALIKE * extent**2
    heights = np.abs((path - path[0]) @ normal)
    if not has_area or not heights.max() <= checks.ALIKE * extent * length:
        raise ValueError(
            f"cracks[{name!r}] must be the corners of a plane polygon, got {checks.shown(path.tolist())}"
        )
    # Polygon checks the path in coordinates of its plane
    edges = np.diff(path, axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    longest = np.argmax(lengths)
    first = edges[longest] / lengths[longest]
    axes = np.stack([first, np.cross(normal / length, first)])
    try:
        Polygon(vertices=(path - path[0]) @ axes.T, boundaries=(name,) * len(path))
    except ValueError as error:
        raise ValueError(f"cracks[{name!r}]: {error}") from error


def _check_cracks(body: Outline, paths: Mapping[str, Path]) -> None:
    """Raise ValueError unless cracks lie in the body, meet only at their points, and leave it in
    one piece."""
    n = len(body.vertices)
    # distinct points, first the vertices of the boundary
    points = list(dict.fromkeys(chain(body.vertices, *paths.values())))
    number = {point: k for k, point in enumerate(points)}
    starts = list(range(n))
    ends = body.following.tolist()
    names = list(body.boundaries)
    # part[k] is the connected part that point k is in: at first its loop of the boundary, or the point
    # alone. An edge of a crack joins two parts; within one part it would close a loop and cut off a
    # piece of the body.
    part = np.searchsorted(body.holes, np.arange(n), side="right").tolist()
    part += range(n, len(points))
    for name, path in paths.items():
        for p, q in pairwise(path):
            u = number[p]
            v = number[q]
            if u == v:
                raise ValueError(f"cracks[{name!r}] has the point {p} twice in a row")
            if body.winding(0.5 * np.add(p, q)) != 1:
                raise ValueError(f"cracks[{name!r}] leaves the body between {p} and {q}")
            if part[u] == part[v]:
                raise ValueError(
                    f"cracks[{name!r}] cuts the body in two between {p} and {q}: pose the pieces as an "
                    "Assembly"
                )
            part = [part[u] if k == part[v] else k for k in part]
            starts.append(u)
            ends.append(v)
            names.append(f"{name}.left")
    places = np.array(points)
    edges = [*body.edges[:n], *map(Segment, places[starts[n:]], places[ends[n:]])]
    check_simple(edges, names, np.array(starts), np.array(ends), "cracks")


@dataclass(frozen=True, kw_only=True, repr=False)
class Assembly(Domain):
    """Bodies that share no nodes; they may touch, or even overlap (a ring of bolts in an
    axisymmetric model does).

    Parameters
    ----------
    parts : mapping of str to Domain
        The geometry of each body by its name, without "."; all of the same dimension.

    Examples
    --------
    >>> from adaptmg.problem import Rectangle
    >>> Assembly(parts={"upper": Rectangle(width=1.0, height=1.0)}).boundaries
    ('upper.bottom', 'upper.right', 'upper.top', 'upper.left')
    """

    parts: Annotated[Mapping[str, Domain], partial(checks.mapping, words="body names to domains")]

    def __post_init__(self) -> None:
        """Raise TypeError or ValueError unless each part is one body, all of the same dimension."""
        super().__post_init__()
        parts = self.parts
        if not parts:
            raise ValueError("parts is empty: an assembly needs at least one body")
        for name, part in parts.items():
            if "." in checks.boundary_name("the name of a body in parts", name):
                raise ValueError(
                    f"the name of a body must not contain '.', got {name!r}: boundaries are 'body.edge'"
                )
            checks.instance(
                f"parts[{name!r}]", part, Domain, "a Domain (Rectangle, Polygon, Outline, Box, ...)"
            )
            if (
                part.bodies is None
                or len(part.bodies) != 1
                or part.boundaries is None
                or isinstance(part, Assembly)
            ):
                raise ValueError(
                    f"parts[{name!r}] must be one body with known boundaries; name the bodies of "
                    f"{type(part).__name__} one by one"
                )
        dims = {name: part.dim for name, part in parts.items()}
        if len(set(dims.values())) > 1:
            raise ValueError(f"all parts must have the same dimension, got {dims}")

    def __hash__(self) -> int:
        return hash(tuple(self.parts.items()))

    @property
    def dim(self) -> int:
        """Return the space dimension."""
        return next(iter(self.parts.values())).dim

    @property
    def bodies(self) -> tuple[str, ...]:
        """Return the names of the bodies, in order."""
        return tuple(self.parts)

    @cached_property
    def boundaries(self) -> tuple[str, ...]:
        """Return the distinct boundary names "body.edge", body by body."""
        return tuple(
            dict.fromkeys(
                f"{body}.{edge}"
                for body, part in self.parts.items()
                for edge in part.boundaries or ()
            )
        )

    @property
    def loose_box(self) -> bool:
        """Return whether a body may end before the sides of its box."""
        return any(part.loose_box for part in self.parts.values())

    def _extremes(self) -> np.ndarray:
        return np.stack(
            [corner for part in self.parts.values() for corner in (part.lower, part.upper)]
        )
