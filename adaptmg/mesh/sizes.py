r"""Sizes of elements: what domains are like before they are meshed, size fields, and how many nodes
they ask for.

About :math:`\int c\, h^{-d} dx` nodes are expected, c = 1.15 in 2D and 1.4 in 3D; too many are
refused before a mesher starts. The size of an element is the edge of the equilateral simplex of the
same measure: refinement halves it, unlike the longest edge."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Annotated

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import (
    MeshArrays,
    Surface,
    centroids,
    edge_lengths,
    facet_keys,
    facet_table,
    mask_of,
    signed_measures,
)
from adaptmg.problem.combined_domains import Assembly
from adaptmg.problem.plane_domains import BOX_SIDES, Box, Domain, Outline
from adaptmg.problem.solid_domains import SolidDomain, StepFile

#: from points (n, dim) to edge lengths (n,) there, m
SizeField = Callable[[np.ndarray], np.ndarray]

#: by dimension: what Netgen makes in about a quarter of an hour (0.2 ms a node in 2D, 0.7 ms in 3D)
MAX_NODES = {2: 5_000_000, 3: 2_000_000}
#: nodes over volume / h^dim: in the plane those of equilateral triangles, in space measured 1.25 to 1.3
#: on balls and cylinders of 1800 to 5200 nodes, 1.8 to 1.9 on boxes
NODES_PER_CELL = {2: 2 / math.sqrt(3), 3: 1.4}
#: default growth of sizes per distance: half and twice change the errors of 10 loops at equal nodes
#: by 1.0 and -.2 %
GRADING = 0.3
#: bisections at most: sizes down to 1e-9 of the domain; far below, neighbouring nodes would round to the same point
MAX_BISECTIONS = 30
# an element is bisected when its size is this many times the field: halving then leaves it no
# smaller than 1 / sqrt(2)
TOO_LARGE = math.sqrt(2)
# edges are at most this many times the field, but for a share of them: triangulations have none
# (348 of random outlines), refined drafts of solids up to .5 % and Netgen's up to 40 % before they are cut
_LONG, _FEW = 2.0, 0.01
# sagitta over the chord: .08 at the 35 degrees that meshers take at most, .125 at 56; measured, half
# refuses 6 of 160 meshes of random outlines, twice none
_SAGITTA = 0.125
# by number of corners: the edge of an equilateral simplex to the power of its dimension, over its
# measure
_EDGE = {2: 1, 3: 4 / math.sqrt(3), 4: 6 * math.sqrt(2)}


#: domains that can be meshed: plane ones as outlines of edges
MeshedDomain = Outline | Box | SolidDomain | Assembly | StepFile


def in_edges(domain: Domain) -> MeshedDomain:
    """Return a plane domain as the outline that is meshed; every other domain itself; TypeError for
    what is none."""
    if isinstance(domain, Box | StepFile | Assembly) or (
        isinstance(domain, SolidDomain) and domain.dim == 3
    ):
        return domain
    if not isinstance(domain, Domain):
        raise TypeError(
            "domain must be a Rectangle, a Polygon, an Outline, a Circle, a Box or another solid, a Cut or "
            f"Fuse, an Assembly of these, or a StepFile, got {domain!r}"
        )
    return domain.outline


def distance_to_boundaries(
    domain: Domain, boundaries: Sequence[str], points: np.ndarray
) -> np.ndarray:
    """Return the distances (n,), m, of points (n, dim) to the nearest of some boundaries of a plane domain
    or a box; infinite without boundaries."""
    if isinstance(domain, Box):
        sides = [BOX_SIDES[name] for name in boundaries]
        corners = (domain.lower, domain.upper)
        distances = [np.abs(points[:, axis] - corners[end][axis]) for axis, end in sides]
    else:
        outline = domain.outline
        distances = [
            outline.edges[i].distance(points)
            for i, name in enumerate(outline.boundaries)
            if name in boundaries
        ]
    return np.min(distances, axis=0, initial=np.inf)


def extent(domain: Domain) -> tuple[np.ndarray, float]:
    """Return the lowest corner and largest side of the bounding box."""
    return domain.lower, float((domain.upper - domain.lower).max())


def boundary_measures(domain: Outline | Box) -> tuple[float, dict[str, float]]:
    """Return the exact area or volume of a domain, and the lengths or areas of its boundaries by
    name."""
    if isinstance(domain, Box):
        lengths = domain.upper - domain.lower
        volume = float(np.prod(lengths))
        return volume, {name: volume / lengths[axis] for name, (axis, _) in BOX_SIDES.items()}
    result = dict.fromkeys(domain.boundaries, 0.0)
    for name, length in zip(domain.boundaries, domain.lengths, strict=True):
        result[name] += length
    return domain.area, result


def growth(name: str, value: object) -> float:
    """Return a checked grading."""
    grading = checks.positive(name, value)
    if not grading <= 1:
        raise ValueError(f"{name} must be at most 1, got {value!r}")
    return grading


def sizes_at(function: float | SizeField, points: np.ndarray) -> np.ndarray:
    """Return the values (n,), m, of a size function at points (n, dim); ValueError unless they are
    positive."""
    values = checks.field("size_function", function, points)
    if not (values > 0).all():
        i = int(np.argmin(values))
        raise ValueError(
            f"size_function must be > 0, got {values[i]} at {tuple(points[i].tolist())}"
        )
    return values


def _points(name: str, value: object) -> tuple[tuple[float, ...], ...]:
    """Return one point or several, all of the same dimension."""
    given = checks.listed(name, value, "points")
    points = tuple(tuple(checks.vector(name, point).tolist()) for point in given)
    if not points or len(set(map(len, points))) > 1:
        raise ValueError(
            f"{name} must be at least one point, all of the same dimension, "
            f"got {checks.shown(given)}"
        )
    return points


@dataclass(frozen=True, repr=False)
class SizeNear(checks.Checked):
    """A size function for :func:`adaptmg.mesh.sized`: small near some points, such as where balls
    first touch.

    Parameters
    ----------
    points : sequence of points
        m, each of ``dim`` numbers.
    size : float
        Edge length there, m, > 0.
    radius : float
        Up to this distance from a point the size stays the same, m; twice the expected half-width
        of contact, say.
    grading : float
        Growth of the edge length per distance beyond, above 0 and at most 1 (the smaller, the surer
        a single point is found in a coarse mesh: take 0.5 at most).

    Examples
    --------
    >>> size = am.SizeNear([(0.0, 0.0)], size=1e-3, radius=5e-3)
    >>> size.size
    0.001
    """

    points: Annotated[Sequence[Sequence[float]], _points]
    _: KW_ONLY
    size: checks.Size
    radius: checks.Nonnegative = 0.0
    grading: Annotated[float, growth] = GRADING

    def scaled(self, factor: float) -> SizeNear:
        """Return the size function times a factor everywhere, for another level of a family whose
        errors fall evenly.

        Where ``sized`` limits sizes, its ``max_size`` and ``grading`` take the same factor.
        """
        factor = checks.positive("factor", factor)
        if not factor * self.grading <= 1:
            raise ValueError(
                f"factor must be at most {1 / self.grading:.6g}, where the grading is 1, got {factor!r}; give "
                f"SizeNear a grading of at most 1 / factor, about {1 / factor:.3g}"
            )
        return replace(self, size=factor * self.size, grading=factor * self.grading)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the sizes (n,) at points (n, dim), m."""
        if x.shape[1] != len(self.points[0]):
            raise ValueError(
                f"points of SizeNear are {len(self.points[0])}D, the mesh is {x.shape[1]}D"
            )
        distance = np.min([np.linalg.norm(x - np.array(p), axis=1) for p in self.points], axis=0)
        return self.size + self.grading * np.maximum(0.0, distance - self.radius)


def expected_nodes(mesh: MeshArrays, sizes: np.ndarray) -> float:
    """Return about how many nodes a mesh with ``sizes`` (n_elements,) on the elements of ``mesh``
    has."""
    with np.errstate(divide="ignore"):
        return NODES_PER_CELL[mesh.dim] * float(np.sum(mesh.volumes / sizes**mesh.dim))


def guessed_nodes(
    dim: int,
    volume: float,
    size: float,
    areas: float = 0.0,
    near: float = 1.0,
    grading: float = 1.0,
) -> float:
    """Return about how many nodes a mesh has whose sizes are ``size`` in a ``volume``, and near + grading
    x at the distance x from ``areas``: those of volume / size^dim cells, plus areas times the integral of (near +
    grading x)^-dim over x > 0."""
    with np.errstate(over="ignore", divide="ignore"):
        cells = volume * np.float64(1 / size) ** dim
        cells += areas / ((dim - 1) * grading) * np.float64(1 / near) ** (dim - 1)
    return float(NODES_PER_CELL[dim] * cells)


def refuse_too_many(nodes: float, domain: Domain) -> float:
    """Return the number of nodes expected; ValueError if it is more than Netgen makes in reasonable
    time and memory."""
    limit = MAX_NODES[domain.dim]
    if not nodes <= limit:
        raise ValueError(
            f"the sizes ask for about {nodes:.1g} nodes (at most {limit:.0e}) on {domain!r}; "
            "take larger sizes (they are in m) or refine a smaller part"
        )
    return nodes


def too_large(mesh: MeshArrays, field: SizeField) -> tuple[np.ndarray, np.ndarray]:
    """Return the mask of the elements to bisect, by their own size, their longest edge or the size
    of a boundary facet (centroids lie off the boundary); the field at their centroids."""
    sizes = field(centroids(mesh.points, mesh.elements))
    large = equilateral_sizes(mesh.points, mesh.elements) > TOO_LARGE * sizes
    large |= overlong(mesh, sizes)
    facets_large = equilateral_sizes(mesh.points, mesh.facets) > TOO_LARGE * field(
        centroids(mesh.points, mesh.facets)
    )
    large[facet_elements(mesh, mesh.facets[facets_large])] = True
    return large, sizes


class Unfit(ValueError):
    """A mesh that is not what was asked for."""


def overlong(mesh: MeshArrays, sizes: np.ndarray) -> np.ndarray:
    """Return the mask of the elements with an edge longer than their ``sizes`` (n_elements,) allow;
    none where these are few edges."""
    long = edge_lengths(mesh.points[mesh.elements]) > _LONG * sizes
    return long.any(axis=0) & (long.mean() > _FEW)


def check_sizes(mesh: MeshArrays, field: SizeField) -> MeshArrays:
    """Return the mesh if its element edges are as short as the field at the centroids asks for;
    Unfit otherwise. Shorter ones are not judged: thin parts and short edges need them."""
    middles = centroids(mesh.points, mesh.elements)
    sizes = field(middles)
    relative = mesh.element_sizes / sizes
    if relative.max() > _LONG and (long := overlong(mesh, sizes)).any():
        worst = int(np.argmax(relative))
        place = ", ".join(f"{x:.6g}" for x in middles[worst])
        raise Unfit(
            f"{long.mean():.0%} of the elements have edges more than {_LONG:g} times as long as the "
            f"sizes ask for, {relative[worst]:.3g} times at ({place})"
        )
    return mesh


def check_rims(domain: Outline, mesh: MeshArrays) -> MeshArrays:
    """Return the mesh if its boundary nodes lie on the edges of the domain, the chords between them
    follow these, and its area is that of the domain but for the parts they cut off; Unfit
    otherwise."""
    scale = float((domain.upper - domain.lower).max())
    # rounding of the meshers, and of coordinates far from the origin
    rounded = checks.ALIKE * scale + 8 * np.spacing(np.abs(mesh.points).max())
    cut_off = rounded * scale  # area between the edges and their chords, at most
    for name in mesh.boundaries:
        surface = mesh.surface(name)
        nodes = surface.nodes
        middles = mesh.points[surface.facets].mean(axis=1)
        places = np.concatenate([mesh.points[nodes], middles])
        distances = distance_to_boundaries(domain, [name], places)
        away, sagittas = np.split(distances, [len(nodes)])
        if not away.max(initial=0.0) <= rounded:
            place = ", ".join(f"{x:.6g}" for x in mesh.points[nodes[np.argmax(away)]])
            raise Unfit(f"a node of boundary {name!r} lies {away.max():.3g} m off it at ({place})")
        lengths = surface.measures
        if not (sagittas <= _SAGITTA * lengths + rounded).all():
            place = ", ".join(f"{x:.6g}" for x in middles[np.argmax(sagittas / lengths)])
            raise Unfit(f"a facet of boundary {name!r} is too long for its curve at ({place})")
        cut_off += float(lengths @ sagittas)
    if not abs(float(mesh.volumes.sum()) - domain.area) <= cut_off:
        raise Unfit(
            f"the area is {mesh.volumes.sum():.9g} m^2, that of the domain {domain.area:.9g}"
        )
    return mesh


def facet_elements(mesh: MeshArrays, facets: np.ndarray) -> np.ndarray:
    """Return the elements (n,) that some boundary facets (n, dim) belong to."""
    if not len(facets):
        return np.empty(0, dtype=np.int64)
    on_facets = mask_of(facets, mesh.n_nodes)
    # only these have as many nodes on them as a facet
    near = np.flatnonzero(on_facets[mesh.elements].sum(axis=1) >= mesh.dim)
    table = facet_table(mesh.elements[near], mesh.n_nodes)
    return near[table.first[table.find(facet_keys(facets, mesh.n_nodes))]]


def equilateral_sizes(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the edge lengths (n,), m, of equilateral simplices with the same measures as those with the
    corners ``cells`` (n, k): elements of the space of ``points``, or facets."""
    corners = cells.shape[1]
    measures = (
        np.abs(signed_measures(points, cells))
        if corners > points.shape[1]
        else Surface(points, cells).measures
    )
    return (_EDGE[corners] * measures) ** (1 / (corners - 1))


def unreachable(domain: Domain, large: np.ndarray) -> ValueError:
    """Return the error where bisection does not reach a size field at the elements of a mask ``large``."""
    return ValueError(
        f"the size field cannot be reached: after {MAX_BISECTIONS} bisections {large.sum()} elements of "
        f"{domain!r} are still too large; does it tend to zero at a point?"
    )
