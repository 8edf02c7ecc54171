r"""solid_mesh: solids meshed by Netgen and OCC, finer near some boundaries or where a size field says.

The edge length asked for, with a bulk size H, a size function s, sizes :math:`h_b` on boundaries b and a grading g, is

.. math:: h(x) = \min\bigl(H,\; s(x),\; \min_b (h_b + g\,\mathrm{dist}(x, b))\bigr).

Where all faces lie on planes, cylinders, cones, spheres and tori, Netgen makes a draft of larger sizes, which is
refined (:mod:`adaptmg.mesh.improve`). Otherwise Netgen is asked for the sizes down to H/16; what is finer it bisects.
New nodes are put onto the faces. Netgen also keeps edges on curved faces below their radius over ``curvature``.

Elements are straight: all nodes of curved faces lie on them, chords do not. The volume of the mesh therefore differs
from OCC's by :math:`O(h^2)`; it is compared with the bound :math:`\sum_F \tfrac12 A_F h_F \theta_F` over the boundary
triangles F, :math:`\theta` being the largest angle to a neighbour on the same face (on a sphere the error is a third to
a half of it).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays, Surface, facet_table, longest_edges, normalised, swept, trusted
from adaptmg.mesh.bisection import refined
from adaptmg.mesh.domains import extent
from adaptmg.mesh.improve import drafted
from adaptmg.mesh.netgen_guard import LIMIT_S, Netgen, NetgenFails, meshing_limit, netgen
from adaptmg.mesh.netgen_plane import (
    MAX_BISECTIONS,
    SizesAt,
    expected_nodes,
    growth,
    netgen_error,
    refuse_too_many,
    sizes_at,
    too_large,
    unreachable,
)
from adaptmg.mesh.slits import opened_tables
from adaptmg.mesh.soundness import check_mesh, least_angle
from adaptmg.mesh.surfaces import Misplaced, Revolved, candidates, onto_surfaces, surfaces_of
from adaptmg.problem.combined_domains import Combination, Cracked, normal_of
from adaptmg.problem.plane_domains import Box, Domain
from adaptmg.problem.solid_domains import Ball, Cylinder, Moved, SolidDomain

_LOG = logging.getLogger(__name__)

CURVATURE = 2.0
"""On curved faces edges are at most their radius of curvature over this, about."""
_NETGEN_RATIO = 16.0
# Netgen fails on curved faces, or makes slivers, where sizes grow faster; where it fails all the same, slower growth
# (which only makes the mesh finer) often helps
_MAX_GRADING = 0.6
_ATTEMPTS = (1.0, 0.7, 0.5)
#: how many times larger than wanted the elements of a draft may be (not two powers of two, which would refine levels
#: whose sizes are halved from one draft), and nodes that it has at least
_FACTORS, _LEAST = (7.2, 4.0, 1.8), 100
# smallest angle of a draft, degrees: elements whose nodes all lie on the boundary keep theirs
_MIN_ANGLE = 12.0
_ENDLESS = 1e90
# of the largest coordinate: what scaling to unit size and back may move a node by
_FLAT = 1e-9
_DIGITS = 14


@dataclass(frozen=True)
class SolidSizes:
    """Edge lengths in a solid, m."""

    size: float  # largest
    boundaries: Mapping[str, float] = field(default_factory=dict)  # along some boundaries
    grading: float = 0.3  # growth of the edge length per distance, above 0 and at most 1
    function: float | Callable[[np.ndarray], np.ndarray] | None = None
    curvature: float = CURVATURE

    def __post_init__(self) -> None:
        for name in ("size", "curvature"):
            object.__setattr__(self, name, checks.positive(name, getattr(self, name)))
        object.__setattr__(self, "grading", growth(self.grading))
        if self.boundaries is not None and not isinstance(self.boundaries, Mapping):
            raise TypeError(f"boundary_sizes must map boundary names to sizes in m, got {self.boundaries!r}")
        sizes = {name: min(self.size, checks.positive(f"boundary_sizes[{name!r}]", h))
                 for name, h in (self.boundaries or {}).items()}
        object.__setattr__(self, "boundaries", sizes)

    def drafts(self, factor: float, slower: float) -> SolidSizes:
        """Return the sizes of a draft, ``factor`` times as large."""
        function = self.function
        return replace(self, size=factor * self.size, grading=slower * min(factor * self.grading, _MAX_GRADING),
                       boundaries={name: factor * h for name, h in self.boundaries.items()},
                       function=None if function is None else lambda x: factor * sizes_at(function, x))

    def field(self, points: np.ndarray, mesh: MeshArrays, groups: Mapping[str, list[str]], floor: float = 0.0
              ) -> np.ndarray:
        """Return the edge lengths (n,) at points (n, 3)."""
        from scipy.spatial import cKDTree  # a first solve without it starts sooner

        result = np.full(len(points), self.size)
        if self.function is not None:
            result = np.minimum(result, np.maximum(sizes_at(self.function, points), floor))
        for name, h in self.boundaries.items():
            facets = np.concatenate([mesh.boundary_facets(part) for part in groups[name]])
            places = np.concatenate([mesh.points[np.unique(facets)], mesh.points[facets].mean(axis=1)])
            h = _raised(h, floor)
            reach = max(self.size - h, 0.0) / self.grading
            result = np.minimum(result, h + self.grading * cKDTree(places).query(points, distance_upper_bound=reach)[0])
        return result


def _raised(size: float, floor: float) -> float:
    """``size`` times the smallest power of two that brings it to at least ``floor``."""
    return size * 2 ** max(0, math.ceil(math.log2(floor / size))) if floor > 0 else size


def solid_mesh(domain: SolidDomain | Box, size: float, boundary_sizes: Mapping[str, float] | None = None,
               grading: float = 0.3, size_function: float | Callable[[np.ndarray], np.ndarray] | None = None, *,
               curvature: float = CURVATURE, mesher: str = "own") -> MeshArrays:
    """Mesh a solid with straight tetrahedra.

    Parameters
    ----------
    domain : SolidDomain or Box
        What to mesh.
    size : float
        Largest edge length, m.
    boundary_sizes : mapping of str to float, optional
        Edge length along some boundaries, m.
    grading : float
        Growth of the edge length per distance from them, above 0 and at most 1.
    size_function : callable or float, optional
        Points (n, 3) in m -> edge length (n,) in m. It is read at centroids of elements and boundary facets: a
        dip much narrower than the elements around it can be missed.
    curvature : float
        On curved faces edges are at most their radius of curvature over this, about, whatever ``size`` says.
    mesher : {"own", "netgen"}
        As of :func:`adaptmg.mesh.graded`.

    Returns
    -------
    MeshArrays
        One body, with its source; its boundaries are those of the domain of which a face is left, in the order of the
        domain. Plane faces normal to an axis have all nodes at the same coordinate, which is the given one up to 14
        digits; nodes of curved faces lie on them within 1e-7 of the extent (on the intersection of two curved faces;
        elsewhere to rounding). The same arrays for the same arguments.

    Raises
    ------
    TypeError, ValueError
        On an unknown domain or boundary, sizes <= 0 or not finite, more than 2 million nodes, or where OCC or Netgen
        fails or does not finish.

    Examples
    --------
    >>> am.mesh.solid_mesh(am.Box(width=1, depth=1, height=1), 1.0).dim
    3
    """
    if not isinstance(domain, SolidDomain | Box):
        raise TypeError(f"domain must be a Box or another solid (Cylinder, Ball, Revolution, Cut, ...), got {domain!r}")
    sizes = SolidSizes(size, boundary_sizes, grading, size_function, curvature)
    for name in sizes.boundaries:
        if name not in domain.boundaries:
            raise ValueError(f"boundary_sizes: boundary {name!r} does not exist; "
                             f"the boundaries are {', '.join(domain.boundaries)}")
    curved = refuse_too_many(curved_nodes(domain, sizes.size, sizes.curvature), domain)
    with netgen() as worker:
        return ordered(domain, shape_mesh(worker, built_shape(worker, domain), sizes, domain, curved, mesher))


@dataclass(frozen=True, eq=False)
class Shape:
    """What is known of an OCC solid at about unit size that a process of Netgen holds."""

    names: list[str]  # of its faces
    areas: list[float]
    volume: float
    corners: np.ndarray  # (2, 3): of its bounding box
    samples: Sequence[np.ndarray]  # of each face: patches of points and normals on its surface (2, n, 6)
    centres: np.ndarray  # (n, 3): of its faces
    lower: np.ndarray  # m: where its origin lies
    scale: float  # m: its unit of length
    #: of the left faces of cracks, by number: the direction from there to the right face, whose number follows those of
    #: all others, in this order
    cracks: Mapping[str, np.ndarray] = field(default_factory=dict)


def built_shape(worker: Netgen, domain: SolidDomain | Box) -> Shape:
    """Build the OCC solid of a domain."""
    lower, scale = extent(domain)
    try:
        shape = Shape(*worker("build_shape", domain, lower, scale, seconds=LIMIT_S[3]), lower, scale)
    except NetgenFails as error:
        raise ValueError(f"OCC could not build {domain!r} ({error}); change its lengths a little") from error
    return _two_faced(domain, shape) if isinstance(domain, Cracked) else shape


def _two_faced(domain: Cracked, shape: Shape) -> Shape:
    """The shape with a right face, after all others, for each left one of a crack."""
    normals = {f"{name}.left": normal_of(path) for name, path in domain.cracks.items()}
    if missing := sorted(set(normals) - set(shape.names)):
        raise ValueError(f"cracks[{missing[0].removesuffix('.left')!r}] lies outside the body")
    left = [i for i, name in enumerate(shape.names) if name in normals]
    return replace(shape, names=[*shape.names, *(shape.names[i].removesuffix("left") + "right" for i in left)],
                   areas=[*shape.areas, *(shape.areas[i] for i in left)],
                   samples=[*shape.samples, *(shape.samples[i] for i in left)],
                   cracks={str(i): normals[shape.names[i]] for i in left})


def curved_nodes(domain: Domain, size: float, curvature: float) -> float:
    """Return the number of nodes that round faces ask for, whose edges are at most their radius over ``curvature``."""
    if isinstance(domain, Combination):
        return curved_nodes(domain.a, size, curvature) + curved_nodes(domain.b, size, curvature)
    if isinstance(domain, Moved | Cracked):
        return curved_nodes(domain.solid if isinstance(domain, Moved) else domain.domain, size, curvature)
    if isinstance(domain, Cylinder):
        area = 2 * math.pi * domain.radius * domain.height
    elif isinstance(domain, Ball):
        area = 4 * math.pi * domain.radius**2
    else:
        return 0.0
    h = domain.radius / curvature
    # at least the nodes of the surface itself; cut by other parts it may be smaller: half is counted
    return 0.5 * 1.15 * area / h**2 if h < size else 0.0


def shape_mesh(worker: Netgen, shape: Shape, sizes: SolidSizes, domain: Domain, curved: float = 0.0,
               mesher: str = "own") -> MeshArrays:
    """Mesh the solid that a process holds; ``curved`` nodes are expected on its round faces."""
    groups = {name: [str(i) for i, face in enumerate(shape.names) if face == name] for name in sizes.boundaries}
    # cut off where powers of it would overflow
    cells = shape.volume * min(shape.scale / sizes.size, _ENDLESS) ** 3
    for name, parts in groups.items():
        if not parts:
            raise ValueError(f"boundary_sizes: of boundary {name!r} no face is left on {domain!r}")
        area = sum(shape.areas[int(i)] for i in parts)
        cells += area * min(shape.scale / sizes.boundaries[name], _ENDLESS) ** 2 / (2 * sizes.grading)
    nodes = refuse_too_many(1.4 * cells, domain)
    known = candidates(shape.samples) if mesher == "own" else None
    if mesher == "own" and known is None:
        _LOG.info("Netgen makes all elements of %r, which has faces other than planes, cylinders, cones, spheres and "
                  "tori", domain)
    drafts = [(factor, 1.0) for factor in _FACTORS if known is not None and nodes > _LEAST * factor**3]
    why: Exception | None = None
    for factor, slower in (*drafts, *((1.0, slower) for slower in _ATTEMPTS)):
        try:
            wanted = sizes.drafts(factor, slower)
            rounds = 0 if wanted.function is None and not groups else 2 if factor == 1 and wanted.function else 1
            unit = _netgen_mesh(worker, shape, wanted, groups, domain, nodes / factor**3 + curved, rounds)
            try:
                if factor > 1 and (angle := least_angle(unit.points, unit.elements)) < _MIN_ANGLE:
                    raise Misplaced(f"it has angles of {angle:.1f} degrees")
                unit = (_bisected(worker, unit, shape, sizes, groups, domain) if known is None else
                        _refined(unit, shape, sizes, groups, domain, known))
            except Misplaced as error:
                _LOG.info("a draft of %r with sizes times %g is not refined: %s", domain, factor, error)
                why = error
                if factor > 1:
                    continue
                unit = _bisected(worker, unit, shape, sizes, groups, domain)
            check_volume(unit, shape.volume)
            return in_metres(unit, shape)
        except NetgenFails as error:
            why = error
            if not worker.alive:
                break
    raise netgen_error(domain, why) from why


def _sound(shape: Shape, tables: Sequence) -> MeshArrays:
    """The mesh of some tables, opened along cracks; NetgenFails if it is not sound."""
    try:
        if shape.cracks:
            label = {name: k for k, name in enumerate(tables[4])}
            first = len(shape.names) - len(shape.cracks)
            tables = opened_tables({label[name]: str(first + k) for k, name in enumerate(shape.cracks)},
                                   {label[name]: normal for name, normal in shape.cracks.items()}, *tables)
        return check_mesh(normalised(*tables))
    except ValueError as error:
        raise NetgenFails(str(error)) from error


def _netgen_mesh(worker: Netgen, shape: Shape, sizes: SolidSizes, groups: dict[str, list[str]], domain: Domain,
                 nodes: float, rounds: int) -> MeshArrays:
    """Netgen's mesh at unit size; again by the sizes on the mesh before where these vary."""
    lower, scale, floor = shape.lower, shape.scale, sizes.size / _NETGEN_RATIO
    face_sizes = {int(i): _raised(sizes.boundaries[name], floor) / scale for name, parts in groups.items()
                  for i in parts}
    options = {"maxh": sizes.size / scale, "grading": sizes.grading, "curvaturesafety": sizes.curvature}
    at: SizesAt = []
    for k in range(rounds + 1):
        # of a draft only its sizes matter: optimising takes most of the time
        unit = _sound(shape, worker("mesh_shape", face_sizes, options | ({"optsteps3d": 0} if k < rounds else {}), at,
                             seconds=meshing_limit(nodes, 3)))
        if k < rounds:
            mesh = _placed(unit, shape)
            centroids = mesh.points[mesh.elements].mean(axis=1)
            # before Netgen works for minutes on a mesh that bisection would then find too large
            nodes = max(nodes, refuse_too_many(expected_nodes(mesh, sizes.field(centroids, mesh, groups)), domain))
            wanted = sizes.field(centroids, mesh, groups, floor)
            small = wanted < sizes.size
            at = [((centroids[small] - lower) / scale, wanted[small] / scale)]
    return unit


def _refined(draft: MeshArrays, shape: Shape, sizes: SolidSizes, groups: dict[str, list[str]], domain: Domain,
             known: list[list[Revolved]]) -> MeshArrays:
    """The draft at unit size, refined to the sizes."""
    surfaces = surfaces_of(known, draft)

    def field(unit: MeshArrays) -> np.ndarray:
        mesh = _placed(unit, shape)
        return sizes.field(mesh.points, mesh, groups) / shape.scale

    return drafted(domain, draft, field, lambda mesh, n_old: onto_surfaces(surfaces, mesh, n_old))


def _bisected(worker: Netgen, unit: MeshArrays, shape: Shape, sizes: SolidSizes, groups: dict[str, list[str]],
              domain: Domain) -> MeshArrays:
    """The mesh at unit size after bisection until no element is too large."""
    if sizes.function is None and not groups:
        return unit
    for _ in range(MAX_BISECTIONS):
        mesh = _placed(unit, shape)
        large, at_centroids = too_large(mesh, lambda x, mesh=mesh: sizes.field(x, mesh, groups))
        if not large.any():
            return unit
        nodes = refuse_too_many(expected_nodes(mesh, at_centroids), domain)
        if shape.cracks:
            # of which Netgen's mesh is not opened
            unit = refined(unit, large, 1).mesh
            continue
        # on the mesh with its geometry, so that new nodes go onto the surfaces
        unit = _sound(shape, worker("bisect", large, seconds=meshing_limit(nodes, 3)))
    raise unreachable(domain, large)


def _placed(unit: MeshArrays, shape: Shape) -> MeshArrays:
    """The mesh in m, without source."""
    return trusted(replace(unit, points=shape.lower + shape.scale * unit.points, source=None), None, unit.sound)


def in_metres(unit: MeshArrays, shape: Shape) -> MeshArrays:
    """Return the mesh in m, its faces (called by their numbers so far) with their names; without source."""
    mesh = _in_planes(_placed(unit, shape))
    order = tuple(dict.fromkeys(shape.names))
    faces = np.array([order.index(shape.names[int(face)]) for face in mesh.boundaries])
    # neither names nor rounding makes a sound mesh unsound
    return trusted(replace(mesh, facet_labels=faces[mesh.facet_labels], boundaries=order, bodies=("body",)), None,
                   mesh.sound)


def _in_planes(mesh: MeshArrays) -> MeshArrays:
    """Nodes of plane faces normal to an axis at one coordinate, free of the rounding of scaling."""
    points = mesh.points.copy()
    reach = float(np.abs(points).max())
    digits = _DIGITS - math.ceil(math.log10(reach))
    for face in mesh.boundaries:
        nodes = mesh.boundary_nodes(face)
        for axis in np.flatnonzero(np.ptp(points[nodes], axis=0) < _FLAT * reach):
            points[nodes, axis] = round(float(np.median(points[nodes, axis])), digits) + 0.0
    return trusted(replace(mesh, points=points), None, mesh.sound)


def ordered(domain: SolidDomain | Box, mesh: MeshArrays) -> MeshArrays:
    """Return the checked mesh with its boundaries in the order of the domain."""
    order = tuple(name for name in domain.boundaries if name in mesh.boundaries)
    labels = np.array([order.index(name) for name in mesh.boundaries])[mesh.facet_labels]
    return swept(check_mesh(trusted(replace(mesh, facet_labels=labels, boundaries=order), None, mesh.sound)))


def check_volume(mesh: MeshArrays, volume: float) -> None:
    """Raise NetgenFails unless the volume is right but for the chords of curved faces."""
    bound, meshed = _left_by_chords(mesh) + 1e-5 * volume, float(mesh.volumes.sum())
    if not abs(meshed - volume) <= bound:
        raise NetgenFails(f"the mesh fills {meshed / volume:.6g} of the volume, chords explain a deviation of "
                          f"{bound / volume:.2g}")


def _left_by_chords(mesh: MeshArrays) -> float:
    """Bound of the volume between curved faces and the mesh (module docstring)."""
    surface = Surface(mesh.points, mesh.facets)
    normals, areas, longest = surface.normals, surface.measures, longest_edges(mesh.points[mesh.facets])
    edges = facet_table(mesh.facets, mesh.n_nodes)
    first, second = edges.first, edges.second
    angles = np.arccos(np.clip(np.sum(normals[first] * normals[second], axis=1), -1.0, 1.0))
    angles[mesh.facet_labels[first] != mesh.facet_labels[second]] = 0.0
    turn = np.zeros(len(areas))
    np.maximum.at(turn, first, angles)
    np.maximum.at(turn, second, angles)
    return 0.5 * float(np.sum(areas * longest * turn))
