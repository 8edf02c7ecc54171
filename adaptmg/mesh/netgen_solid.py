r"""solid_mesh: solids meshed by Netgen and OCC, finer near some boundaries or where a size field says.

The wanted edge length, for a bulk size H, a size function s, sizes :math:`h_b` on boundaries b and a grading g, is

.. math:: h(x) = \min\bigl(H,\; s(x),\; \min_b (h_b + g\,\mathrm{dist}(x, b))\bigr).

Netgen is asked for it as far as it is not below H/16; what is finer is bisected, with new nodes put onto the curved
surfaces. Netgen also keeps edges on curved faces below their radius over ``curvature``.

occ_shape: a solid as data -> OCC's shape with named faces, in scaled lengths :math:`(x - \text{origin}) / s`.

OCC compares lengths with absolute tolerances of 1e-7: everything is built near unit size. A boolean operation that goes
wrong does so without a word; its volume is therefore compared with the complementary one,

.. math:: |a \setminus b| + |a \cap b| = |a|, \qquad |a \cup b| + |a \cap b| = |a| + |b|.

shape_arrays: the arrays of a mesh that Netgen made of an OCC solid at unit size: read, checked, placed, named.

Elements are straight: all nodes of curved faces lie on them, chords do not. The volume of the mesh therefore differs
from OCC's by :math:`O(h^2)`; it is compared with the bound :math:`\sum_F \tfrac12 A_F h_F \theta_F` over the boundary
triangles F, :math:`\theta` being the largest angle to a neighbour on the same face (on a sphere the error is a third to
a half of it).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import netgen.meshing
import ngsolve
import numpy as np
from netgen.occ import (
    ArcOfCircle,
    Axis,
    Dir,
    Edge,
    Face,
    OCCGeometry,
    Pnt,
    Segment,
    Solid,
    Sphere,
    TopoDS_Shape,
    Vec,
    Wire,
    X,
    Y,
    Z,
)
from netgen.occ import Box as OccBox
from netgen.occ import Cylinder as OccCylinder
from netgen.occ import Fuse as OccFuse
from scipy.spatial import cKDTree

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import BOX_SIDES, MeshArrays, facet_keys, facet_table, require_simple
from adaptmg.mesh.netgen_guard import curved_nodes, interruptible, refuse_thin, refuse_thin_shape
from adaptmg.mesh.netgen_plane import expected_nodes, refuse_too_many
from adaptmg.mesh.ngsolve_bridge import own_mesh, with_source
from adaptmg.problem.plane_domains import Box, Domain, Outline
from adaptmg.problem.solid_domains import (
    Ball,
    Combination,
    Common,
    Cut,
    Cylinder,
    Extrusion,
    Moved,
    Profile,
    Revolution,
    SolidDomain,
    outline_of,
)

__all__ = ["CURVATURE", "SolidSizes", "Unsound", "check_volume", "in_metres", "left_by_chords", "occ_shape", "ordered",
           "placed", "read_shape", "scaled_shape", "shape_mesh", "solid_mesh"]

CURVATURE = 2.0
"""On curved faces edges are at most their radius of curvature over this, about."""
_NETGEN_RATIO = 16.0
# an element is bisected when its size is this many times the wanted one: then it is not halved below 1 / sqrt(2)
_TOO_LARGE = math.sqrt(2)
_MAX_BISECTIONS = 30
# Netgen fails on curved faces, or makes slivers, where sizes grow faster; where it fails all the same, slower growth
# (which only makes the mesh finer) often helps
_MAX_GRADING = 0.6
_ATTEMPTS = (1.0, 0.7, 0.5)
_ENDLESS = 1e90
# Netgen's own, and what exceptions of OCC arrive as
_NETGEN_ERRORS = (netgen.meshing.NgException, RuntimeError)


@dataclass(frozen=True)
class SolidSizes:
    """Edge lengths in a solid."""

    size: float  # largest, m
    boundaries: Mapping[str, float] = field(default_factory=dict)  # along some boundaries, m
    grading: float = 0.3  # growth of the edge length per distance, above 0 and at most 1
    function: float | Callable[[np.ndarray], np.ndarray] | None = None
    curvature: float = CURVATURE  # on curved faces edges are at most their radius of curvature over this, about

    def __post_init__(self) -> None:
        for name in ("size", "grading", "curvature"):
            object.__setattr__(self, name, checks.positive(name, getattr(self, name)))
        if not self.grading <= 1:
            raise ValueError(f"grading must be at most 1, got {self.grading!r}")
        if self.boundaries is not None and not isinstance(self.boundaries, Mapping):
            raise TypeError(f"boundary_sizes must map boundary names to sizes in m, got {self.boundaries!r}")
        sizes = {name: min(self.size, checks.positive(f"boundary_sizes[{name!r}]", h))
                 for name, h in (self.boundaries or {}).items()}
        object.__setattr__(self, "boundaries", sizes)

    def field(self, points: np.ndarray, mesh: MeshArrays, groups: Mapping[str, list[str]], floor: float = 0.0
              ) -> np.ndarray:
        """Wanted edge lengths (n,), m, at points (n, 3)."""
        wanted = np.full(len(points), self.size)
        if self.function is not None:
            values = checks.field("size_function", self.function, points)
            if not (values > 0).all():
                i = int(np.argmin(values))
                raise ValueError(f"size_function must be > 0, got {values[i]} at {tuple(points[i].tolist())}")
            wanted = np.minimum(wanted, np.maximum(values, floor))
        for name, h in self.boundaries.items():
            facets = np.concatenate([mesh.boundary_facets(part) for part in groups[name]])
            places = np.concatenate([mesh.points[np.unique(facets)], mesh.points[facets].mean(axis=1)])
            wanted = np.minimum(wanted, raised(h, floor) + self.grading * cKDTree(places).query(points)[0])
        return wanted


def raised(size: float, floor: float) -> float:
    """``size`` times the smallest power of two that brings it to at least ``floor``."""
    return size * 2 ** max(0, math.ceil(math.log2(floor / size))) if floor > 0 else size


def solid_mesh(domain: SolidDomain | Box, size: float, boundary_sizes: Mapping[str, float] | None = None,
               grading: float = 0.3, size_function: float | Callable[[np.ndarray], np.ndarray] | None = None, *,
               curvature: float = CURVATURE) -> MeshArrays:
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
        Points (n, 3) in m -> wanted edge length (n,) in m. It is read at centroids of elements and boundary facets: a
        dip much narrower than the elements around it can be missed.
    curvature : float
        On curved faces edges are at most their radius of curvature over this, about, whatever ``size`` says.

    Returns
    -------
    MeshArrays
        One body, with its source; its boundaries are those of the domain of which a face is left, in the order of the
        domain. Plane faces normal to an axis have all nodes at one and the same coordinate, which is the
        given one up to 14 digits; nodes of curved faces lie on them within 1e-7 of the extent (on the intersection of
        two curved faces; elsewhere to rounding). The same arrays for the same arguments.

    Raises
    ------
    TypeError, ValueError
        On an unknown domain or boundary, sizes <= 0 or not finite, more than 2 million nodes, or where OCC or Netgen
        fails.
    """
    if not isinstance(domain, SolidDomain | Box):
        raise TypeError(f"domain must be a Box or another solid (Cylinder, Ball, Revolution, Cut, ...), got {domain!r}")
    sizes = SolidSizes(size, boundary_sizes, grading, size_function, curvature)
    for name in sizes.boundaries:
        if name not in domain.boundaries:
            raise ValueError(f"boundary_sizes: boundary {name!r} does not exist; "
                             f"the boundaries are {', '.join(domain.boundaries)}")
    refuse_thin(domain, sizes.size, sizes.boundaries)
    refuse_too_many(curved_nodes(domain, sizes.size, sizes.curvature), domain)
    shape, names, lower, scale = scaled_shape(domain)
    return ordered(domain, shape_mesh(shape, names, lower, scale, sizes, domain))


def scaled_shape(domain: SolidDomain | Box) -> tuple[Solid, list[str], np.ndarray, float]:
    """OCC's shape of a solid at about unit size, the names of its faces, where its origin lies and its unit, m."""
    lower = domain.lower
    scale = float((domain.upper - lower).max())
    try:
        shape = interruptible(occ_shape, domain, lower, scale)
    except _NETGEN_ERRORS as error:
        raise ValueError(f"OCC could not build {domain!r} ({error}); change its lengths a little") from error
    return shape, [face.name for face in shape.faces], lower, scale


def shape_mesh(shape: Solid, names: list[str], lower: np.ndarray, scale: float, sizes: SolidSizes, domain: Domain
               ) -> MeshArrays:
    """Mesh one OCC solid."""
    groups: dict[str, list[str]] = {name: [] for name in sizes.boundaries}
    # cut off where powers of it would overflow
    cells = shape.mass * min(scale / sizes.size, _ENDLESS) ** 3
    for i, (face, name) in enumerate(zip(shape.faces, names, strict=True)):
        face.name = str(i)
        if name in groups:
            groups[name].append(str(i))
            face.maxh = raised(sizes.boundaries[name], sizes.size / _NETGEN_RATIO) / scale
            cells += face.mass * min(scale / sizes.boundaries[name], _ENDLESS) ** 2 / (2 * sizes.grading)
    for name, parts in groups.items():
        if not parts:
            raise ValueError(f"boundary_sizes: of boundary {name!r} no face is left on {domain!r}")
    corners = np.array([[p.x, p.y, p.z] for p in shape.bounding_box])
    refuse_thin_shape(domain, scale * np.ptp(corners, axis=0), min([sizes.size, *sizes.boundaries.values()]))
    refuse_too_many(1.4 * cells, domain)
    for factor in _ATTEMPTS:
        slower = replace(sizes, grading=factor * min(sizes.grading, _MAX_GRADING))
        try:
            curved = _netgen_mesh(shape, lower, scale, slower, groups, domain)
            unit = _bisected(curved, lower, scale, sizes, groups, domain)
            check_volume(unit, shape.mass)
            break
        except (*_NETGEN_ERRORS, Unsound) as error:
            why = error
    else:
        raise ValueError(f"Netgen could not mesh {domain!r} ({why}); change the sizes a little or take a smaller "
                         "grading") from why
    return in_metres(unit, names, lower, scale)


def _netgen_mesh(shape: Solid, lower: np.ndarray, scale: float, sizes: SolidSizes, groups: dict[str, list[str]],
                 domain: Domain) -> ngsolve.Mesh:
    """Netgen's mesh of the scaled shape, with its geometry; again by the sizes on the mesh before where these vary."""
    floor = sizes.size / _NETGEN_RATIO
    rounds = 2 if sizes.function is not None else 1 if groups else 0
    mesh = None
    for k in range(rounds + 1):
        # Netgen's threads spend more time waiting than the work takes: 3 to 30 times slower
        options = netgen.meshing.MeshingParameters(maxh=sizes.size / scale, grading=sizes.grading,
                                                   curvaturesafety=sizes.curvature, parallel_meshing=False)
        if k < rounds:
            # only its sizes matter: optimising takes most of the time
            options = netgen.meshing.MeshingParameters(options, optsteps3d=0)
        if mesh is not None:
            arrays = placed(read_shape(mesh), lower, scale)
            centroids = arrays.points[arrays.elements].mean(axis=1)
            # before Netgen works for minutes on a mesh that bisection would then find too large
            refuse_too_many(expected_nodes(arrays, sizes.field(centroids, arrays, groups)), domain)
            wanted = sizes.field(centroids, arrays, groups, floor)
            small = wanted < sizes.size
            places = (centroids[small] - lower) / scale
            for (x, y, z), h in zip(places.tolist(), (wanted[small] / scale).tolist(), strict=True):
                options.RestrictH(x, y, z, h)
        mesh = ngsolve.Mesh(interruptible(OCCGeometry(shape).GenerateMesh, mp=options))
    return mesh


def _bisected(mesh: ngsolve.Mesh, lower: np.ndarray, scale: float, sizes: SolidSizes, groups: dict[str, list[str]],
              domain: Domain) -> MeshArrays:
    """The arrays, still scaled, after bisection until no element is too large; ``mesh`` is changed."""
    for _ in range(_MAX_BISECTIONS):
        unit = read_shape(mesh)
        if sizes.function is None and not groups:
            return unit
        in_place = placed(unit, lower, scale)
        wanted = sizes.field(in_place.points[in_place.elements].mean(axis=1), in_place, groups)
        large = np.cbrt(in_place.volumes * 6 * math.sqrt(2)) > _TOO_LARGE * wanted
        corners = in_place.points[in_place.facets]
        areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        at_facets = sizes.field(corners.mean(axis=1), in_place, groups)
        on_boundary = np.sqrt(areas * 4 / math.sqrt(3)) > _TOO_LARGE * at_facets
        table = facet_table(unit.elements, unit.n_nodes)
        large[table.first[table.find(facet_keys(unit.facets[on_boundary], unit.n_nodes))]] = True
        if not large.any():
            return unit
        refuse_too_many(expected_nodes(in_place, wanted), domain)
        # on the mesh with its geometry, so that new nodes go onto the surfaces
        mesh.SetRefinementFlags(large.tolist())
        interruptible(mesh.Refine)
    raise ValueError(f"the size field cannot be reached: after {_MAX_BISECTIONS} bisections {large.sum()} elements of "
                     f"{domain!r} are still too large; does it tend to zero at a point?")


# volumes of boolean operations add up to 1e-9 of the operands
_VOLUME_TOLERANCE = 1e-6
_ZERO = np.zeros(3)


def occ_shape(domain: SolidDomain | Box, origin: np.ndarray, scale: float) -> Solid:
    """Build a solid."""
    shape = _shape(domain, np.asarray(origin, dtype=np.float64), float(scale))
    if len(shape.solids) != 1:
        what = "nothing" if len(shape.solids) == 0 else f"{len(shape.solids)} pieces"
        raise ValueError(f"{domain!r} leaves {what}; a solid must be one piece")
    solid = shape.solids[0]
    for face in solid.faces:
        if face.name not in domain.boundaries:
            raise ValueError(f"a face of {domain!r} at {_point(face.center)} got no name from OCC; "
                             "move its parts a little against each other")
    return solid


def _shape(domain: SolidDomain | Box, origin: np.ndarray, scale: float) -> TopoDS_Shape:
    if isinstance(domain, Combination):
        return _combined(domain, origin, scale)
    if isinstance(domain, Moved):
        shape = _shape(domain.solid, _ZERO, scale)
        if domain.angle % 360:
            shape = shape.Rotate(Axis(Pnt(0, 0, 0), Dir(*domain.axis)), domain.angle)
        return shape.Move(Vec(*((np.array(domain.offset) - origin) / scale)))
    if isinstance(domain, Ball):
        shape = Sphere(Pnt(*((np.array(domain.centre) - origin) / scale)), domain.radius / scale)
        shape.faces.name = "surface"
        return shape
    if isinstance(domain, Cylinder):
        return OccCylinder(Pnt(*((np.array(domain.point) - origin) / scale)), Dir(*domain.axis), domain.radius / scale,
                           domain.height / scale, bottom="bottom", top="top", mantle="side")
    for kind, build in ((Box, _box), (Revolution, _revolution), (Extrusion, _extrusion)):
        if isinstance(domain, kind):
            return build(domain, origin, scale)
    raise TypeError(f"domain must be a Box or another solid (Cylinder, Ball, Revolution, Cut, ...), got {domain!r}")


def _point(p: Pnt) -> tuple[float, float, float]:
    return p.x, p.y, p.z


def _box(domain: Box, origin: np.ndarray, scale: float) -> Solid:
    solid = OccBox(Pnt(*((domain.lower - origin) / scale)), Pnt(*((domain.upper - origin) / scale)))
    for name, (axis, end) in BOX_SIDES.items():
        (solid.faces.Min, solid.faces.Max)[end]((X, Y, Z)[axis]).name = name
    return solid


def _revolution(domain: Revolution, origin: np.ndarray, scale: float) -> TopoDS_Shape:
    # the profile may touch the axis up to rounding: put those vertices onto it
    r_min = 1e-11 * float(domain.polygon.upper[0])

    def place(p: np.ndarray) -> Pnt:
        return Pnt(*((np.array([p[0] if p[0] > r_min else 0.0, 0.0, p[1]]) - origin) / scale))

    face = _profile_face(domain.polygon, place)
    shape = face.Revolve(Axis(place(np.zeros(2)), Z), domain.angle)
    if domain.angle < 360:
        start = np.array(_point(face.center))
        ends = [f for f in shape.faces if not f.name]
        ends.sort(key=lambda f: float(np.linalg.norm(np.array(_point(f.center)) - start)))
        for f, name in zip(ends, ("start", "end"), strict=True):
            f.name = name
    return shape


def _extrusion(domain: Extrusion, origin: np.ndarray, scale: float) -> TopoDS_Shape:
    def place(p: np.ndarray) -> Pnt:
        return Pnt(*((np.array([p[0], p[1], domain.base]) - origin) / scale))

    shape = _profile_face(domain.polygon, place).Extrude(Vec(0, 0, domain.height / scale))
    ends = sorted((f for f in shape.faces if not f.name), key=lambda f: f.center.z)
    for f, name in zip(ends, ("bottom", "top"), strict=True):
        f.name = name
    return shape


def _profile_face(profile: Profile, place: Callable[[np.ndarray], Pnt]) -> Face:
    """A plane face whose edges are named; ``place`` puts points of the profile into space."""
    outline = outline_of(profile)
    require_simple(outline)
    vertices = [np.array(v) for v in outline.vertices]
    edges, middles = [], []
    for i, (a, b) in enumerate(zip(vertices, vertices[1:] + vertices[:1], strict=True)):
        arc = outline.arc(i) if isinstance(outline, Outline) else None
        middle = 0.5 * (a + b) if arc is None else arc.at(np.array([0.5]))[0]
        edges.append(Segment(place(a), place(b)) if arc is None else ArcOfCircle(place(a), place(middle), place(b)))
        middles.append(_point(place(middle)))
    face = Face(Wire(edges))
    # the wire makes new edges: find each by its middle
    for edge in face.edges:
        distance = np.linalg.norm(np.array(middles) - _point(_middle(edge)), axis=1)
        edge.name = outline.boundaries[int(np.argmin(distance))]
    return face


def _middle(edge: Edge) -> Pnt:
    first, last = edge.parameter_interval
    return edge.Value(0.5 * (first + last))


def _combined(domain: Combination, origin: np.ndarray, scale: float) -> TopoDS_Shape:
    a, b = (_shape(part, origin, scale) for part in (domain.a, domain.b))
    for part, shape in (("a", a), ("b", b)):
        for face in shape.faces:
            face.name = domain.renamed(part, face.name)
    common = a * b
    if isinstance(domain, Common):
        shape, check = common, a.mass - (a - b).mass
    elif isinstance(domain, Cut):
        shape, check = a - b, a.mass - common.mass
    else:
        # not a + b, which also joins coplanar faces and so loses names
        shape, check = OccFuse([a, b]), a.mass + b.mass - common.mass
    if not (math.isfinite(shape.mass) and abs(shape.mass - check) <= _VOLUME_TOLERANCE * (a.mass + b.mass)):
        raise ValueError(f"OCC could not combine the parts of {domain!r}: the volumes do not add up "
                         f"({shape.mass:.9g} instead of {check:.9g}); move or resize one of them a little, so that "
                         "faces cross or coincide clearly")
    return shape


# of the largest coordinate: what scaling to unit size and back may move a node by
_FLAT = 1e-9
_DIGITS = 14


class Unsound(ValueError):
    """A mesh with holes, inverted elements or the wrong volume."""


def read_shape(mesh: ngsolve.Mesh) -> MeshArrays:
    """The checked arrays of a scaled mesh."""
    try:
        return own_mesh(mesh)
    except ValueError as error:
        raise Unsound(error) from error


def placed(unit: MeshArrays, lower: np.ndarray, scale: float) -> MeshArrays:
    """The mesh in m, without source."""
    return replace(unit, points=lower + scale * unit.points, source=None)


def in_metres(unit: MeshArrays, names: list[str], lower: np.ndarray, scale: float) -> MeshArrays:
    """The mesh of a scaled shape in m, its faces (called by their numbers so far) with their names; without source."""
    mesh = _in_planes(placed(unit, lower, scale))
    order = tuple(dict.fromkeys(names))
    faces = np.array([order.index(names[int(face)]) for face in mesh.boundaries])
    return replace(mesh, facet_labels=faces[mesh.facet_labels], boundaries=order, bodies=("body",),
                   source=None)


def ordered(domain: SolidDomain | Box, mesh: MeshArrays) -> MeshArrays:
    """The checked mesh with its boundaries in the order of the domain, with source."""
    order = tuple(name for name in domain.boundaries if name in mesh.boundaries)
    labels = np.array([order.index(name) for name in mesh.boundaries])[mesh.facet_labels]
    return with_source(replace(mesh, facet_labels=labels, boundaries=order, source=None))


def check_volume(mesh: MeshArrays, volume: float) -> None:
    """Raise Unsound unless the volume is right but for the chords of curved faces."""
    bound, meshed = left_by_chords(mesh) + 1e-5 * volume, float(mesh.volumes.sum())
    if not abs(meshed - volume) <= bound:
        raise Unsound(f"the mesh fills {meshed / volume:.6g} of the volume, chords explain a deviation of "
                       f"{bound / volume:.2g}")


def left_by_chords(mesh: MeshArrays) -> float:
    """Bound of the volume between curved faces and the mesh (module docstring)."""
    a, b, c = (mesh.points[mesh.facets[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    areas = 0.5 * np.linalg.norm(normals, axis=1)
    normals /= 2 * areas[:, None]
    longest = np.max([np.linalg.norm(e, axis=1) for e in (b - a, c - b, a - c)], axis=0)
    edges = facet_table(mesh.facets, mesh.n_nodes)
    first, second = edges.first, edges.second
    angles = np.arccos(np.clip(np.sum(normals[first] * normals[second], axis=1), -1.0, 1.0))
    angles[mesh.facet_labels[first] != mesh.facet_labels[second]] = 0.0
    turn = np.zeros(len(areas))
    np.maximum.at(turn, first, angles)
    np.maximum.at(turn, second, angles)
    return 0.5 * float(np.sum(areas * longest * turn))


def _in_planes(mesh: MeshArrays) -> MeshArrays:
    """Nodes of plane faces normal to an axis at one coordinate, free of the rounding of scaling."""
    points = mesh.points.copy()
    reach = float(np.abs(points).max())
    digits = _DIGITS - math.ceil(math.log10(reach))
    for face in mesh.boundaries:
        nodes = mesh.boundary_nodes(face)
        for axis in np.flatnonzero(np.ptp(points[nodes], axis=0) < _FLAT * reach):
            points[nodes, axis] = round(float(np.median(points[nodes, axis])), digits) + 0.0
    return replace(mesh, points=points, source=None)
