r"""netgen_mesh: plane domains meshed by Netgen along a size field.

Netgen is given a size along each side and, in the later rounds, the sizes at the centroids of the mesh before (its own
interpolation of sizes between sides misses the field by up to 4). It grows sizes by at most ``grading`` per distance.
The domain is scaled to unit extent before, because Netgen and OCC compare lengths with absolute tolerances.

About :math:`\int c\, h^{-d} dx` nodes are expected, c = 1.15 in 2D and 1.4 in 3D; too many are refused before Netgen
starts. Boundaries are called by the numbers of the edges, so that nodes of every arc are known even where edges share a
name; :func:`finished` gives them their names.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from adaptmg import _checks as checks
from adaptmg._numba import kernel
from adaptmg.mesh.arrays import MeshArrays, facet_keys, facet_table, normalised, sound_by_construction, swept
from adaptmg.mesh.domains import boundary_measures, extent
from adaptmg.mesh.netgen_guard import MAX_NODES, NetgenUnfinished, meshing_limit, netgen
from adaptmg.mesh.slits import opened_tables
from adaptmg.mesh.soundness import check_mesh
from adaptmg.problem.plane_domains import Domain, Outline

SizeField = Callable[[np.ndarray], np.ndarray]
SizesAt = list[tuple[np.ndarray, np.ndarray]]
"""Points (n, dim) and sizes (n,) there, of the domain at unit size."""

#: bisections at most: sizes down to 1e-9 of the domain; far below, neighbouring nodes would round to the same point
MAX_BISECTIONS = 30
# an element is bisected when its size is this many times the field: halving then leaves it no smaller than 1 / sqrt(2)
_TOO_LARGE = math.sqrt(2)
# area over the square of the longest edge, below which a triangle is flat: 1 degree
_FLAT = 0.5 * math.tan(math.radians(1.0))
#: nodes over volume / h^dim
NODES_PER_CELL = {2: 1.15, 3: 1.4}


def netgen_mesh(domain: Outline, sizes: SizeField | Sequence[SizeField], max_size: float, side_sizes: dict[str, float],
                grading: float, rounds: int) -> MeshArrays:
    """Return a mesh by a size field, or by one a round, not checked."""
    lower, scale = extent(domain)
    nodes = refuse_too_many(guessed_nodes(domain, max_size, side_sizes, grading), domain)
    sides = {name: h / scale for name, h in side_sizes.items()}
    at: SizesAt = []
    for step in range(rounds + 1):
        options = {"maxh": max_size / scale, "grading": grading}
        # the steps that improve shapes take most of the time: here only nodes and centroids are used
        if not callable(sizes) and step < rounds:
            options |= {"optsteps2d": 0}
        try:
            with netgen() as worker:
                tables = worker("mesh_plane", domain, lower, scale, sides, options, at, seconds=meshing_limit(nodes, 2))
            if domain.twins:
                # edges turned by -90 degrees
                normals = (np.array(domain.vertices)[domain.following] - domain.vertices) @ [[0, -1], [1, 0]]
                edges = {i: k for k, i in enumerate(map(int, tables[4]))}
                tables = opened_tables({edges[left]: str(right) for right, left in domain.twins.items()},
                                       {k: normals[i] for i, k in edges.items()}, *tables)
            unit = normalised(*tables)
        except ValueError as error:
            raise netgen_error(domain, error) from error
        mesh = _onto_outline(domain, replace(unit, points=lower + scale * unit.points, bodies=("body",)))
        if step < rounds:
            places = mesh.points[mesh.elements].mean(axis=1)
            wanted = (sizes if callable(sizes) else sizes[step])(places)
            nodes = refuse_too_many(expected_nodes(mesh, wanted), domain)
            small = wanted < max_size
            at = [((places[small] - lower) / scale, wanted[small] / scale)]
    return mesh


def growth(value: float) -> float:
    """Return a checked grading."""
    grading = checks.positive("grading", value)
    if not grading <= 1:
        raise ValueError(f"grading must be at most 1, got {value!r}")
    return grading


def sizes_at(function: float | SizeField, points: np.ndarray) -> np.ndarray:
    """Return the values (n,) of a size function; ValueError unless they are positive."""
    values = checks.field("size_function", function, points)
    if not (values > 0).all():
        i = int(np.argmin(values))
        raise ValueError(f"size_function must be > 0, got {values[i]} at {tuple(points[i].tolist())}")
    return values


def expected_nodes(mesh: MeshArrays, sizes: np.ndarray) -> float:
    """Return about how many nodes a mesh with ``sizes`` (n_elements,) on the elements of ``mesh`` has."""
    with np.errstate(divide="ignore"):
        return NODES_PER_CELL[mesh.dim] * float(np.sum(mesh.volumes / sizes**mesh.dim))


def refuse_too_many(nodes: float, domain: Domain) -> float:
    """Return the number of nodes expected; ValueError if it is more than Netgen makes in reasonable time and memory."""
    limit = MAX_NODES[domain.dim]
    if not nodes <= limit:
        raise ValueError(f"the sizes ask for about {nodes:.1g} nodes (at most {limit:.0e}) on {domain!r}; "
                         "take larger sizes (they are in m) or refine a smaller part")
    return nodes


def guessed_nodes(domain: Domain, max_size: float, side_sizes: dict[str, float], grading: float) -> float:
    """Return the number of nodes by sizes along the sides alone: the integral of (h + grading x)^-dim over x > 0."""
    volume, areas = boundary_measures(domain)
    with np.errstate(over="ignore", divide="ignore"):
        cells = volume * np.float64(1 / max_size) ** domain.dim
        for name, h in side_sizes.items():
            cells += areas[name] / ((domain.dim - 1) * grading) * np.float64(1 / h) ** (domain.dim - 1)
    return float(NODES_PER_CELL[domain.dim] * cells)


def netgen_error(domain: Domain, why: Exception) -> ValueError:
    """Return the error that names the domain and the remedy."""
    if isinstance(why, NetgenUnfinished):
        return NetgenUnfinished(f"Netgen could not mesh {domain!r}: {why}: take smaller sizes where a part is thin, or "
                                "make it thicker")
    return ValueError(f"Netgen could not mesh {domain!r} ({why}); change the sizes a little or take a smaller grading")


def too_large(mesh: MeshArrays, field: SizeField) -> tuple[np.ndarray, np.ndarray]:
    """Return the mask of the elements to bisect, by their own size or that of a boundary facet; the field at their
    centroids. A size is the edge of the equilateral simplex of the same measure: refinement halves it, unlike the
    longest edge. Facets are looked at as well because centroids lie off the boundary."""
    sizes = field(mesh.points[mesh.elements].mean(axis=1))
    large = equilateral_sizes(mesh.points, mesh.elements) > _TOO_LARGE * sizes
    facets_large = (equilateral_sizes(mesh.points, mesh.facets)
                    > _TOO_LARGE * field(mesh.points[mesh.facets].mean(axis=1)))
    large[facet_elements(mesh, mesh.facets[facets_large])] = True
    return large, sizes


def facet_elements(mesh: MeshArrays, facets: np.ndarray) -> np.ndarray:
    """Return the elements that some boundary facets (n, dim) belong to."""
    if not len(facets):
        return np.empty(0, dtype=np.int64)
    on = np.zeros(mesh.n_nodes, dtype=bool)
    on[facets] = True
    near = np.flatnonzero(on[mesh.elements].sum(axis=1) >= mesh.dim)
    table = facet_table(mesh.elements[near], mesh.n_nodes)
    return near[table.first[table.find(facet_keys(facets, mesh.n_nodes))]]


@kernel
def equilateral_sizes(points, cells):
    """Return the edge length (n,) of equilateral simplices with the same measures as those with corners ``cells``."""
    result = np.empty(len(cells))
    k = cells.shape[1]
    for i in range(len(cells)):
        # the square of the measure times (k - 1)!: Gram's determinant
        g00 = g01 = g02 = g11 = g12 = g22 = 0.0
        for d in range(points.shape[1]):
            x = points[cells[i, 0], d]
            u, v, w = points[cells[i, 1], d] - x, points[cells[i, min(2, k - 1)], d] - x, points[cells[i, k - 1], d] - x
            g00, g01, g02 = g00 + u * u, g01 + u * v, g02 + u * w
            g11, g12, g22 = g11 + v * v, g12 + v * w, g22 + w * w
        square = g00 * g11 - g01 * g01
        if k == 2:
            result[i] = np.sqrt(g00)
        elif k == 3:
            result[i] = np.sqrt(np.sqrt(4.0 / 3.0 * max(square, 0.0)))
        else:
            square = g22 * square - g02 * (g02 * g11 - g01 * g12) + g12 * (g02 * g01 - g00 * g12)
            result[i] = (2.0 * max(square, 0.0)) ** (1.0 / 6.0)
    return result


def unreachable(domain: Domain, large: np.ndarray) -> ValueError:
    """Return the error where bisection does not reach a size field."""
    return ValueError(f"the size field cannot be reached: after {MAX_BISECTIONS} bisections {large.sum()} elements of "
                      f"{domain!r} are still too large; does it tend to zero at a point?")


def _onto_outline(domain: Outline, mesh: MeshArrays) -> MeshArrays:
    """The mesh with its boundary nodes exactly on the outline, without source."""
    points = mesh.points.copy()
    vertices = np.array(domain.vertices)
    for i in range(len(vertices)):
        nodes = mesh.boundary_nodes(str(i))
        arc = domain.arc(i)
        if arc is not None:
            offset = points[nodes] - np.array(arc.center)
            points[nodes] = np.array(arc.center) + offset * (arc.radius / np.linalg.norm(offset, axis=1))[:, None]
            continue
        first, last = vertices[i], vertices[domain.following[i]]
        points[nodes[:, None], np.flatnonzero(first == last)] = first[first == last]
    for i, vertex in enumerate(vertices):
        nodes = mesh.boundary_nodes(str(i))
        points[nodes[np.argmin(np.linalg.norm(points[nodes] - vertex, axis=1))]] = vertex
    return replace(mesh, points=points, source=None)


def finished(domain: Outline, mesh: MeshArrays) -> MeshArrays:
    """Return the mesh with the names of the domain's boundaries in place of edge numbers, checked, with source."""
    mesh, names = swept(check_mesh(mesh)), tuple(dict.fromkeys(domain.boundaries))
    if (flat := float((mesh.volumes / mesh.element_sizes**2).min())) < _FLAT:
        warnings.warn(f"triangles are up to {0.5 / flat:.0f} times as long as high: {domain!r} is thin or has a sharp "
                      "corner; take smaller sizes (they are in m) there", UserWarning, stacklevel=2)
    labels = np.array([names.index(domain.boundaries[int(edge)]) for edge in mesh.boundaries])
    # other names leave a mesh sound
    return sound_by_construction(replace(mesh, facet_labels=labels[mesh.facet_labels], boundaries=names, source=None))
