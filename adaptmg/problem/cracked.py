"""Cracked: a body with cracks, each with two faces: paths of straight edges in the plane, polygons in space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._text import brief
from adaptmg.problem.plane_domains import Box, Circle, Domain, Outline, Polygon, Rectangle, with_vertex
from adaptmg.problem.plane_edges import Segment, check_simple
from adaptmg.problem.solid_domains import SolidDomain

Path = tuple[tuple[float, ...], ...]
# of the extent: ends of cracks this near to a vertex or an edge lie on it
_NEAR = 1e-9


@dataclass(frozen=True)
class Slit(Outline):
    """An outline whose last holes have no width: along the left face of each crack, and back along the right one."""

    twins: Mapping[int, int] | None = None  # edge of a right face -> that of the left one at the same place
    body: Outline | None = None  # the same without cracks

    __repr__ = brief
    __hash__ = Outline.__hash__

    def __post_init__(self) -> None:
        """Nothing: it is made of what has been checked."""

    @property
    def area(self) -> float:
        """Exact area, m^2."""
        return self.body.area


@dataclass(frozen=True)
class Cracked(SolidDomain):
    """A body with cracks.

    Parameters
    ----------
    domain : Rectangle, Polygon, Outline, Circle, or a combination of these; or Box, Cylinder, Cut, ...
        The body without cracks.
    cracks : mapping of str to sequence of points
        The path of each crack by its name, m: straight edges between two or more points inside the body; each end may
        lie on the boundary, or at a point of another crack. In space a plane polygon. The boundaries "name.left" and
        "name.right" are its faces, seen along the path; polygons run counter-clockwise as seen from the right. The
        faces touch where an :class:`~adaptmg.ContactPair` says so.

    Examples
    --------
    >>> plate = am.Cracked(am.Rectangle(width=1, height=1), {"crack": ((0.3, 0.3), (0.7, 0.7))})
    >>> plate.boundaries
    ('bottom', 'right', 'top', 'left', 'crack.left', 'crack.right')
    """

    domain: Domain
    cracks: Mapping[str, Path]

    __repr__ = brief
    if TYPE_CHECKING:
        def __init__(self, domain: Domain, cracks: Mapping[str, ArrayLike]) -> None: ...

    def __post_init__(self) -> None:
        body = checks.instance("domain", self.domain, (SolidDomain, Box, Rectangle, Polygon, Outline, Circle), "a "
                               "Rectangle, a Polygon, an Outline, a Circle, a Box or another solid, or a combination")
        if isinstance(body, Cracked):
            raise TypeError("domain is cracked already; name all its cracks together")
        paths = {}
        for name, points in checks.mapping("cracks", self.cracks, "names to paths").items():
            checks.boundary_name("the names of cracks", name)
            path = check_arrays.array(f"cracks[{name!r}]", points, (None, body.dim))
            if len(path) < body.dim:
                raise ValueError(f"cracks[{name!r}] must be {body.dim} points or more, got {checks.shown(points)}")
            if body.dim == 3:
                _check_plane(name, path)
            paths[name] = tuple(map(tuple, (path + 0.0).tolist()))
        if not paths:
            raise ValueError("cracks is empty: name one crack at least")
        object.__setattr__(self, "cracks", paths)
        names = [*dict.fromkeys(self.domain.boundaries), *(f"{name}.{side}" for name in paths for side in _SIDES)]
        if len(set(names)) < len(names):
            raise ValueError(f"cracks: the faces {', '.join(names[-2 * len(paths):])} must have other names than the "
                             f"boundaries {', '.join(self.domain.boundaries)}")
        if body.dim == 2:
            _ = self.outline

    def __hash__(self) -> int:
        return hash((self.domain, tuple(self.cracks.items())))

    @property
    def dim(self) -> int:
        """Space dimension."""
        return self.domain.dim

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Those of the body, then the two faces of each crack."""
        return (*self.domain.boundaries, *(f"{name}.{side}" for name in self.cracks for side in _SIDES))

    def _extremes(self) -> np.ndarray:
        return np.stack([self.domain.lower, self.domain.upper])

    @cached_property
    def outline(self) -> Slit:
        """Of a plane body its outline, with the cracks as holes without width."""
        if self.dim != 2:
            raise ValueError("outline: only plane domains have one")
        body, paths = self._anchored()
        _check_cracks(body, paths)
        vertices, names, holes, twins = list(body.vertices), list(body.boundaries), list(body.holes), {}
        for name, path in paths.items():
            n, first = len(path) - 1, len(vertices)
            holes.append(first)
            vertices += [*path, *path[-2:0:-1]]
            names += [f"{name}.left"] * n + [f"{name}.right"] * n
            twins |= {first + n + j: first + n - 1 - j for j in range(n)}
        return Slit(vertices=tuple(vertices), boundaries=tuple(names), arcs=body.arcs, holes=tuple(holes), twins=twins,
                    body=body)

    def _anchored(self) -> tuple[Outline, dict[str, Path]]:
        """The outline with a vertex where cracks end on it, and the cracks with these ends, or points of others; one of
        one edge gets a vertex in the middle, so that there is a node that opens."""
        body, paths = self.domain.outline, {}
        near = _NEAR * float((self.upper - self.lower).max())
        for name, path in self.cracks.items():
            ends = []
            for end in (path[0], path[-1]):
                body = with_vertex(body, end, arcs=True)
                places = [*body.vertices, *(p for other, points in self.cracks.items() if other != name
                                            for p in paths.get(other, points[1:-1]))]
                away = np.linalg.norm(np.array(places) - end, axis=1)
                ends.append(places[int(np.argmin(away))] if away.min() <= near else end)
            middle = path[1:-1] or (tuple((0.5 * np.add(*ends)).tolist()),)
            paths[name] = (ends[0], *middle, ends[1])
        return body, paths


_SIDES = ("left", "right")


def normal_of(polygon: ArrayLike) -> np.ndarray:
    """Return twice the area vector (3,) of a plane polygon, pointing to where it runs counter-clockwise."""
    spokes = np.array(polygon) - polygon[0]
    return np.cross(spokes[1:-1], spokes[2:]).sum(axis=0)


def _check_plane(name: str, path: np.ndarray) -> None:
    """ValueError unless a path is a plane polygon that does not cross itself."""
    normal, extent = normal_of(path), float(np.ptp(path, axis=0).max())
    length = float(np.linalg.norm(normal))
    if not length > _NEAR * extent**2 or not np.abs((path - path[0]) @ normal).max() <= _NEAR * extent * length:
        raise ValueError(f"cracks[{name!r}] must be the corners of a plane polygon, got {checks.shown(path.tolist())}")
    first = (path[1] - path[0]) / np.linalg.norm(path[1] - path[0])
    axes = np.stack([first, np.cross(normal / length, first)])
    try:
        Polygon(vertices=(path - path[0]) @ axes.T, boundaries=(name,) * len(path))
    except ValueError as error:
        raise ValueError(f"cracks[{name!r}]: {error}") from error


def _check_cracks(body: Outline, paths: Mapping[str, Path]) -> None:
    """ValueError unless cracks lie in the body, meet only at their points, and leave it in one piece."""
    n = len(body.vertices)
    number = {p: i for i, p in reversed(list(enumerate(body.vertices)))}
    starts, ends, names = list(range(n)), body.following.tolist(), list(body.boundaries)
    # a loop of the boundary is one part; each edge of a crack joins two parts, or encloses a piece
    part = np.searchsorted(body.holes, np.arange(n), side="right").tolist()
    for name, path in paths.items():
        for p, q in pairwise(path):
            for end in (p, q):
                if end not in number:
                    number[end] = len(part)
                    part.append(len(part) + n)
            u, v = number[p], number[q]
            if u == v:
                raise ValueError(f"cracks[{name!r}] has the point {p} twice in a row")
            if body.winding(0.5 * np.add(p, q)) != 1:
                raise ValueError(f"cracks[{name!r}] leaves the body between {p} and {q}")
            if part[u] == part[v]:
                raise ValueError(f"cracks[{name!r}] cuts the body in two between {p} and {q}: pose the pieces as an "
                                 "Assembly")
            part = [part[u] if k == part[v] else k for k in part]
            starts.append(u)
            ends.append(v)
            names.append(f"{name}.left")
    places = np.array(list(number))[np.argsort(list(number.values()))]
    edges = [*map(body.edge, range(n)), *(Segment(places[u], places[v]) for u, v in zip(starts[n:], ends[n:],
                                                                                        strict=True))]
    check_simple(edges, names, np.array(starts), np.array(ends), "cracks")
