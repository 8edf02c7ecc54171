r"""generate: one Netgen mesh of a domain that follows a size field.

Netgen is told a size along each side and, in the later rounds, the wanted size at the centroids of the mesh before
(its own interpolation of sizes between sides misses the field by up to 4). It grows sizes by at most ``grading`` per
distance. The domain is scaled to unit extent before, because Netgen and OCC compare lengths with absolute tolerances.

About :math:`\int c\, h^{-d} dx` nodes are expected, c = 1.15 in 2D and 1.4 in 3D; too many are refused before Netgen
starts.

Plane domains for Netgen: its spline geometry, exact measures, nodes back on the arcs, names of the edges.

An arc becomes rational quadratic splines, which are exact circles: the middle control point is the meeting point of the
tangents, at the distance :math:`r / \cos(\theta / 2)` from the centre. Pieces turn by at most 80 degrees.

While an :class:`~adaptmg.problem.Outline` is meshed, its boundaries are called by the numbers of its edges, "0", "1",
..., so that nodes of every arc are known even where edges share a name; :func:`finished` gives them their names.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import netgen.meshing
import ngsolve
import numpy as np
from netgen.geom2d import SplineGeometry
from netgen.occ import Box as OccBox
from netgen.occ import OCCGeometry, Pnt, X, Y, Z

from adaptmg.mesh.arrays import BOX_SIDES, MeshArrays
from adaptmg.mesh.netgen_guard import MAX_NODES, interruptible, refuse_thin
from adaptmg.mesh.ngsolve_bridge import own_mesh, raw_mesh, with_source
from adaptmg.problem.plane_domains import Box, Domain, Outline, Polygon, Rectangle

__all__ = ["NODES_PER_CELL", "SizeField", "expected_nodes", "extent", "finished", "guessed_nodes", "netgen_mesh",
           "one_mesh", "onto_outline", "plane_measures", "refine_uniformly", "refuse_too_many", "spline_geometry",
           "straight_area"]

SizeField = Callable[[np.ndarray], np.ndarray]

# seconds: several times what meshes of that many nodes take
_LIMIT_S = {2: 20_000.0, 3: 70_000.0}
#: nodes over volume / h^dim
NODES_PER_CELL = {2: 1.15, 3: 1.4}


def netgen_mesh(domain: Domain, sizes: SizeField | Sequence[SizeField], max_size: float, side_sizes: dict[str, float],
                grading: float, rounds: int) -> MeshArrays:
    """Mesh a domain by a size field."""
    lower, scale = extent(domain)
    refuse_thin(domain, max_size, side_sizes)
    refuse_too_many(guessed_nodes(domain, max_size, side_sizes, grading), domain)
    mesh = None
    for step in range(rounds + 1):
        # the steps that improve shapes take most of the time; of a draft only the centroids are used
        draft = {"optsteps2d": 0} if not callable(sizes) and step < rounds else {}
        # its threads spend more time waiting than the work takes
        options = netgen.meshing.MeshingParameters(maxh=max_size / scale, grading=grading, parallel_meshing=False,
                                                   **draft)
        if mesh is not None:
            centroids = mesh.points[mesh.elements].mean(axis=1)
            wanted = (sizes if callable(sizes) else sizes[step - 1])(centroids)
            refuse_too_many(expected_nodes(mesh, wanted), domain)
            small = wanted < max_size
            places = np.zeros((small.sum(), 3))
            places[:, :mesh.dim] = (centroids[small] - lower) / scale
            # one call a point is Netgen's only interface; it costs 1.4 us, meshing 100 times as much
            for (x, y, z), h in zip(places.tolist(), (wanted[small] / scale).tolist(), strict=True):
                options.RestrictH(x, y, z, h)
        sides = {name: h / scale for name, h in side_sizes.items()}
        mesh = one_mesh(domain, lower, scale, sides, options, draft=step < rounds)
    return with_source(mesh)


def expected_nodes(mesh: MeshArrays, wanted: np.ndarray) -> float:
    """About how many nodes a mesh with the sizes ``wanted`` (n_elements,) on the elements of ``mesh`` has."""
    return NODES_PER_CELL[mesh.dim] * float(np.sum(mesh.volumes / wanted**mesh.dim))


def refuse_too_many(nodes: float, domain: Domain) -> None:
    """Raise ValueError if more nodes are expected than Netgen can make in reasonable time and memory."""
    limit = MAX_NODES[domain.dim]
    if nodes > limit:
        raise ValueError(f"the sizes ask for about {nodes:.1g} nodes (at most {limit:.0e}) on {domain!r}; "
                         "take larger sizes (they are in m) or refine a smaller part")


def extent(domain: Domain) -> tuple[np.ndarray, float]:
    """Lowest corner and largest side of the bounding box."""
    return domain.lower, float((domain.upper - domain.lower).max())


def _measures(domain: Domain) -> tuple[float, dict[str, float]]:
    """Area or volume of a domain, and the lengths or areas of its boundaries by name."""
    if not isinstance(domain, Box):
        return plane_measures(domain)
    lengths = domain.upper - domain.lower
    volume = float(np.prod(lengths))
    return volume, {name: volume / lengths[axis] for name, (axis, _) in BOX_SIDES.items()}


def guessed_nodes(domain: Domain, max_size: float, side_sizes: dict[str, float],
                 grading: float) -> float:
    """Expected nodes from the sizes along the sides alone: the integral of (h + grading x)^-dim over x > 0."""
    volume, areas = _measures(domain)
    with np.errstate(over="ignore", divide="ignore"):
        cells = volume * np.float64(1 / max_size) ** domain.dim
        for name, h in side_sizes.items():
            cells += areas[name] / ((domain.dim - 1) * grading) * np.float64(1 / h) ** (domain.dim - 1)
    return float(NODES_PER_CELL[domain.dim] * cells)


def one_mesh(domain: Domain, lower: np.ndarray, scale: float, sides: dict[str, float],
             options: netgen.meshing.MeshingParameters, refinements: int = 0, *, draft: bool = False) -> MeshArrays:
    """One call of Netgen on the scaled domain, all elements then cut in four (3D: eight) ``refinements`` times.

    The mesh in m, without source; see :func:`netgen_mesh` for the names of its boundaries. A ``draft`` is not checked
    but for its area or volume.
    """
    try:
        geometry = (_box if isinstance(domain, Box) else spline_geometry)(domain, lower, scale, sides)
        made = interruptible(geometry.GenerateMesh, mp=options, limit=_LIMIT_S[domain.dim])
        refine_uniformly(made, refinements)
        unit = (raw_mesh if draft else own_mesh)(ngsolve.Mesh(made))
    except (netgen.meshing.NgException, ValueError, RuntimeError) as error:
        raise ValueError(f"Netgen could not mesh {domain!r} ({error}); change the sizes a little or take a smaller "
                         "grading") from error
    mesh = replace(unit, points=lower + scale * unit.points, bodies=("body",), source=None)
    mesh = onto_outline(domain, mesh) if isinstance(domain, Outline) else _onto_planes(domain, mesh, scale)
    volume = _measures(domain)[0] if isinstance(domain, Box) else straight_area(domain, mesh)
    if not abs(mesh.volumes.sum() - volume) <= 1e-9 * volume:
        raise ValueError(f"Netgen meshed {mesh.volumes.sum():.9g} instead of {volume:.9g} of {domain!r}; "
                         "change the sizes a little")
    return mesh


def refine_uniformly(mesh: netgen.meshing.Mesh, refinements: int) -> None:
    """Cut every element in four (3D: eight) some times, in place; new nodes go onto the curves of its geometry.

    The tetrahedra inside those that are cut are flat (mean quality .83 of 1 where Netgen's have .88): swapping faces
    and moving nodes once brings them to .89, at a tenth of the cost of Netgen's own mesh of that size.
    """
    for _ in range(refinements):
        interruptible(mesh.Refine)
    if refinements and mesh.dim == 3:
        options = netgen.meshing.MeshingParameters(optimize3d="sm", optsteps3d=1, parallel_meshing=False)
        interruptible(mesh.OptimizeVolumeMesh, options)


def _onto_planes(domain: Domain, mesh: MeshArrays, scale: float) -> MeshArrays:
    """Nodes of sides normal to an axis exactly on them, boundaries in the order of the domain."""
    points = mesh.points.copy()
    for name, axis, value in _planes(domain):
        nodes = mesh.boundary_nodes(name)
        nodes = nodes[np.abs(points[nodes, axis] - value) < 1e-9 * scale]
        points[nodes, axis] = value
    boundaries = tuple(dict.fromkeys(domain.boundaries))
    labels = np.array([boundaries.index(name) for name in mesh.boundaries])[mesh.facet_labels]
    return replace(mesh, points=points, facet_labels=labels, boundaries=boundaries, source=None)


def _box(domain: Box, lower: np.ndarray, scale: float, sides: dict[str, float]) -> OCCGeometry:
    """OCC's geometry of a box, scaled, its lowest corner at the origin."""
    solid = OccBox(Pnt(0, 0, 0), Pnt(*((domain.upper - lower) / scale)))
    for name, (axis, end) in BOX_SIDES.items():
        face = (solid.faces.Min, solid.faces.Max)[end]((X, Y, Z)[axis])
        face.name = name
        if name in sides:
            face.maxh = sides[name]
    return OCCGeometry(solid)


def _planes(domain: Domain) -> list[tuple[str, int, float]]:
    """Sides normal to an axis: name, axis, coordinate in m. Scaling moves them by a rounding error."""
    if isinstance(domain, Box):
        return [(name, axis, float((domain.lower, domain.upper)[end][axis]))
                for name, (axis, end) in BOX_SIDES.items()]
    vertices = domain.polygon.vertices
    return [(name, axis, a[axis]) for name, a, b in zip(domain.boundaries, vertices, vertices[1:] + vertices[:1],
                                                        strict=True) for axis in (0, 1) if a[axis] == b[axis]]


_MAX_TURN = math.radians(80.0)
# longest edge on an arc, of its radius; Netgen rounds the number of edges of a piece
_MAX_EDGE = 0.4
# Netgen's own "no limit"
_NO_LIMIT = 1e99


def spline_geometry(domain: Rectangle | Polygon | Outline, lower: np.ndarray, scale: float,
                    sides: dict[str, float]) -> SplineGeometry:
    """Netgen's geometry of a plane domain, moved by ``-lower`` and divided by ``scale``."""
    geometry = SplineGeometry()
    curved = isinstance(domain, Outline)
    vertices = domain.vertices if curved else domain.polygon.vertices
    corners = [geometry.AppendPoint(*place) for place in (np.array(vertices) - lower) / scale]
    for i, name in enumerate(domain.boundaries):
        options = {"leftdomain": 1, "rightdomain": 0, "bc": str(i) if curved else name,
                   "maxh": sides.get(name, _NO_LIMIT)}
        first, last = corners[i], corners[(i + 1) % len(corners)]
        arc = domain.arc(i) if curved else None
        if arc is None:
            geometry.Append(["line", first, last], **options)
            continue
        pieces = math.ceil(abs(arc.angle) / _MAX_TURN)
        options["maxh"] = min(options["maxh"], _MAX_EDGE * arc.radius / scale)
        center = np.array(arc.center)
        stretch = 1 / math.cos(0.5 * arc.angle / pieces)
        ends = arc.at(np.arange(1, pieces) / pieces)
        middles = center + stretch * (arc.at((np.arange(pieces) + 0.5) / pieces) - center)
        numbers = [first, *(geometry.AppendPoint(*place) for place in (ends - lower) / scale), last]
        for k, middle in enumerate((middles - lower) / scale):
            geometry.Append(["spline3", numbers[k], geometry.AppendPoint(*middle), numbers[k + 1]], **options)
    geometry.SetMaterial(1, "body")
    return geometry


def plane_measures(domain: Rectangle | Polygon | Outline) -> tuple[float, dict[str, float]]:
    """Exact area (m^2) of a plane domain, and the length (m) of its boundaries by name."""
    if isinstance(domain, Outline):
        area, lengths = domain.area, domain.lengths
    else:
        start = np.array(domain.polygon.vertices)
        end = np.roll(start, -1, axis=0)
        area = 0.5 * float(np.sum(start[:, 0] * end[:, 1] - end[:, 0] * start[:, 1]))
        lengths = np.linalg.norm(end - start, axis=1).tolist()
    perimeter = dict.fromkeys(domain.boundaries, 0.0)
    for name, length in zip(domain.boundaries, lengths, strict=True):
        perimeter[name] += length
    return area, perimeter


def straight_area(domain: Rectangle | Polygon | Outline, mesh: MeshArrays) -> float:
    """Area in m^2 that a mesh of the domain must have: the exact one, less what chords cut off arcs."""
    area, _ = plane_measures(domain)
    if not isinstance(domain, Outline):
        return area
    for i in domain.arcs:
        arc = domain.arc(i)
        a, b = mesh.points[mesh.boundary_facets(str(i))].transpose(1, 0, 2) - np.array(arc.center)
        turns = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
        area -= 0.5 * arc.radius**2 * float(np.sum(turns - np.sin(turns)))
    return area


def onto_outline(domain: Outline, mesh: MeshArrays) -> MeshArrays:
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
        first, last = vertices[i], vertices[(i + 1) % len(vertices)]
        points[nodes[:, None], np.flatnonzero(first == last)] = first[first == last]
    for i, vertex in enumerate(vertices):
        nodes = mesh.boundary_nodes(str(i))
        points[nodes[np.argmin(np.linalg.norm(points[nodes] - vertex, axis=1))]] = vertex
    return replace(mesh, points=points, source=None)


def finished(domain: Outline, mesh: MeshArrays) -> MeshArrays:
    """The mesh with the names of the outline's boundaries in place of edge numbers, checked, with source."""
    names = tuple(dict.fromkeys(domain.boundaries))
    labels = np.array([names.index(domain.boundaries[int(edge)]) for edge in mesh.boundaries])
    result = replace(mesh, facet_labels=labels[mesh.facet_labels], boundaries=names, source=None)
    # other names make no mesh unsound
    object.__setattr__(result, "sound", mesh.sound)
    return with_source(result)
