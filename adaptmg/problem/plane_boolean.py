"""combined: difference, union and intersection of two plane outlines of straight edges and circular arcs.

Edges are cut where those of the other outline meet them. A piece stays by the side of the other outline that it lies
on: outside of it in a union, inside in an intersection; in a difference pieces of b inside of a stay, turned round.
Where pieces of both coincide, one stays if the bodies lie on the same side of it (in a difference: on either side).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np

from adaptmg.problem.plane_domains import Outline
from adaptmg.problem.plane_edges import Arc, Segment, meetings

_ROUND = 1e-12  # of the extent: points nearer to each other are one


@dataclass(frozen=True)
class _Piece:
    """A part of an edge between two numbered points."""

    start: int
    end: int
    name: str
    centre: tuple[float, float] | None
    middle: np.ndarray

    @property
    def turned(self) -> _Piece:
        return _Piece(self.end, self.start, self.name, self.centre, self.middle)


def combined(what: str, a: Outline, b: Outline) -> Outline:
    """Return the outline of "Cut", "Fuse" or "Common" of two outlines; ValueError unless it is one piece."""
    tol = _ROUND * float(max(np.ptp(outline.vertices, axis=0).max() for outline in (a, b)))
    points: list[np.ndarray] = []
    edges = [[outline.edge(i) for i in range(len(outline.vertices))] for outline in (a, b)]
    met = [[meetings(e, f, tol) for f in edges[1]] for e in edges[0]]
    of_a = _pieces(a, edges[0], [list(chain(*row)) for row in met], points, tol)
    of_b = _pieces(b, edges[1], [list(chain(*column)) for column in zip(*met, strict=True)], points, tol)
    kept = []
    for piece in of_a:
        twins = [other for other in of_b if {piece.start, piece.end} == {other.start, other.end}
                 and np.linalg.norm(piece.middle - other.middle) <= 10 * tol]
        if twins:
            if (twins[0].start == piece.start) != (what == "Cut"):
                kept.append(piece)
        elif (b.winding(piece.middle) == 1) == (what == "Common"):
            kept.append(piece)
        of_b = [other for other in of_b if other not in twins]
    for piece in of_b:
        if (a.winding(piece.middle) == 1) == (what != "Fuse"):
            kept.append(piece.turned if what == "Cut" else piece)
    return _chained(what, kept, points)


def _pieces(outline: Outline, edges: list[Segment | Arc], cuts: list[list[np.ndarray]], points: list[np.ndarray],
            tol: float) -> list[_Piece]:
    """The edges of an outline cut at points, which are numbered in ``points``."""
    def number(p: np.ndarray) -> int:
        for k, other in enumerate(points):
            if np.abs(p - other).max() <= 4 * tol:
                return k
        points.append(p)
        return len(points) - 1

    result = []
    for i, (edge, here) in enumerate(zip(edges, cuts, strict=True)):
        ends = [np.array(outline.vertices[k]) for k in (i, outline.following[i])]
        inner = sorted(here, key=edge.along)
        numbers = list(dict.fromkeys(map(number, (ends[0], *inner))))
        last = number(ends[1])
        numbers = [k for k in numbers if k != last] + [last]
        centre = outline.arcs.get(i)
        for start, end in pairwise(numbers):
            middle = 0.5 * (points[start] + points[end])
            if centre is not None:
                off = middle - np.array(centre)
                middle = np.array(centre) + off * (edge.radius / np.linalg.norm(off))
            result.append(_Piece(start, end, outline.boundaries[i], centre, middle))
    return result


def _chained(what: str, pieces: list[_Piece], points: list[np.ndarray]) -> Outline:
    """The outline that pieces make, its outer edge first."""
    leaving: dict[int, _Piece] = {}
    for piece in pieces:
        if piece.start in leaving:
            raise ValueError(f"the edges of the {what} touch each other at the point "
                             f"{tuple(points[piece.start].tolist())}: move or resize one part a little")
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
        raise ValueError(f"the {what} leaves {f'{len(outer)} pieces' if outer else 'nothing'}; a body must be one "
                         "piece: pose several as an Assembly")
    loops.insert(0, loops.pop(outer[0]))
    starts = np.cumsum([0, *map(len, loops)])
    every = list(chain(*loops))
    return Outline(vertices=tuple(tuple(points[piece.start].tolist()) for piece in every),
                   boundaries=tuple(piece.name for piece in every), holes=tuple(starts[1:-1].tolist()),
                   arcs={k: piece.centre for k, piece in enumerate(every) if piece.centre is not None})


def _loop_area(loop: list[_Piece], points: list[np.ndarray]) -> float:
    x, y = np.array([p for piece in loop for p in (points[piece.start], piece.middle)]).T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
