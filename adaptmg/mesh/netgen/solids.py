r"""solid_mesh: solids meshed by Netgen and OCC, finer near some boundaries or where a size field says.

The wanted edge length, for a bulk size H, a size function s, sizes :math:`h_b` on boundaries b and a grading g, is

.. math:: h(x) = \min\bigl(H,\; s(x),\; \min_b (h_b + g\,\mathrm{dist}(x, b))\bigr).

Netgen is asked for it as far as it is not below H/16; what is finer is bisected, with new nodes put onto the curved
surfaces. Netgen also keeps edges on curved faces below their radius over ``curvature``. Elements are straight: all
nodes of curved faces lie on them, chords do not. The volume of the mesh therefore differs from OCC's by
:math:`O(h^2)`; it is compared with the bound :math:`\sum_F \tfrac12 A_F h_F \theta_F` over the boundary triangles F,
:math:`\theta` being the largest angle to a neighbour on the same face (on a sphere the error is a third to a half of
it).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import netgen.meshing
import ngsolve
import numpy as np
from netgen.occ import OCCGeometry, Solid
from scipy.spatial import cKDTree

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.build import own_mesh, with_source
from adaptmg.mesh.netgen.generate import expected_nodes, refuse_too_many
from adaptmg.mesh.netgen.interruptible import interruptible
from adaptmg.mesh.netgen.occ_shapes import occ_shape
from adaptmg.mesh.netgen.thin import curved_nodes, refuse_thin, refuse_thin_shape
from adaptmg.mesh.topology import facet_keys, facet_table
from adaptmg.problem import checks
from adaptmg.problem.domains import Box, Domain, SolidDomain

__all__ = ["CURVATURE", "SolidSizes", "in_metres", "ordered", "read_shape", "scaled_shape", "shape_mesh", "solid_mesh"]

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
# of the largest coordinate: what scaling to unit size and back may move a node by
_FLAT = 1e-9
_DIGITS = 14
_ENDLESS = 1e90
# Netgen's own, and what exceptions of OCC arrive as
_NETGEN_ERRORS = (netgen.meshing.NgException, RuntimeError)


class _Unsound(ValueError):
    """A mesh with holes, inverted elements or the wrong volume."""


@dataclass(frozen=True)
class SolidSizes:
    """Edge lengths in a solid.

    Parameters
    ----------
    size : float
        Largest, m.
    boundaries : mapping of str to float
        Along some boundaries, m.
    grading : float
        Growth of the edge length per distance, above 0 and at most 1.
    function : callable or float, optional
        Points (n, 3) in m -> wanted edge length (n,) in m.
    curvature : float
        On curved faces edges are at most their radius of curvature over this, about.
    """

    size: float
    boundaries: Mapping[str, float] = field(default_factory=dict)
    grading: float = 0.3
    function: float | Callable[[np.ndarray], np.ndarray] | None = None
    curvature: float = CURVATURE

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
        """Wanted edge lengths (n,), m, at points (n, 3).

        Parameters
        ----------
        points : (n, 3) array
            m.
        mesh : MeshArrays
            Distances are taken to nodes and centroids of its boundary facets.
        groups : mapping of str to list of str
            For each boundary of ``boundaries``, its parts among the boundaries of ``mesh``.
        floor : float
            Lengths below are raised: those of boundaries by a power of two, so that bisection makes it up exactly.
        """
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


def ordered(domain: SolidDomain | Box, mesh: MeshArrays) -> MeshArrays:
    """The checked mesh with its boundaries in the order of the domain, with source."""
    order = tuple(name for name in domain.boundaries if name in mesh.boundaries)
    labels = np.array([order.index(name) for name in mesh.boundaries])[mesh.facet_labels]
    return with_source(replace(mesh, facet_labels=labels, boundaries=order, source=None))


def shape_mesh(shape: Solid, names: list[str], lower: np.ndarray, scale: float, sizes: SolidSizes, domain: Domain
               ) -> MeshArrays:
    """Mesh one OCC solid.

    Parameters
    ----------
    shape : netgen.occ.Solid
        Of about unit size; the names and sizes of its faces are overwritten.
    names : list of str
        Of its faces.
    lower : (3,) array
        Where the origin of the shape lies, m.
    scale : float
        Unit length of the shape, m.
    sizes : SolidSizes
        Its boundaries are among the names.
    domain : Domain
        For messages.

    Returns
    -------
    MeshArrays
        Without source; not yet checked after its nodes have been put onto planes.
    """
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
            _check_volume(unit, shape.mass)
            break
        except (*_NETGEN_ERRORS, _Unsound) as error:
            why = error
    else:
        raise ValueError(f"Netgen could not mesh {domain!r} ({why}); change the sizes a little or take a smaller "
                         "grading") from why
    return in_metres(unit, names, lower, scale)


def in_metres(unit: MeshArrays, names: list[str], lower: np.ndarray, scale: float) -> MeshArrays:
    """The mesh of a scaled shape in m, its faces (called by their numbers so far) with their names; without source."""
    mesh = _in_planes(_placed(unit, lower, scale))
    order = tuple(dict.fromkeys(names))
    faces = np.array([order.index(names[int(face)]) for face in mesh.boundaries])
    return replace(mesh, facet_labels=faces[mesh.facet_labels], boundaries=order, bodies=("body",),
                   source=None)


def read_shape(mesh: ngsolve.Mesh, volume: float) -> MeshArrays:
    """The checked arrays of a mesh of a scaled shape of that volume; ValueError if it is not sound."""
    unit = _read(mesh)
    _check_volume(unit, volume)
    return unit


def _read(mesh: ngsolve.Mesh) -> MeshArrays:
    """The checked arrays of a scaled mesh."""
    try:
        return own_mesh(mesh)
    except ValueError as error:
        raise _Unsound(error) from error


def _placed(unit: MeshArrays, lower: np.ndarray, scale: float) -> MeshArrays:
    """The mesh in m, without source."""
    return replace(unit, points=lower + scale * unit.points, source=None)


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
            arrays = _placed(_read(mesh), lower, scale)
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
        unit = _read(mesh)
        if sizes.function is None and not groups:
            return unit
        placed = _placed(unit, lower, scale)
        wanted = sizes.field(placed.points[placed.elements].mean(axis=1), placed, groups)
        large = np.cbrt(placed.volumes * 6 * math.sqrt(2)) > _TOO_LARGE * wanted
        corners = placed.points[placed.facets]
        areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        on_boundary = np.sqrt(areas * 4 / math.sqrt(3)) > _TOO_LARGE * sizes.field(corners.mean(axis=1), placed, groups)
        table = facet_table(unit.elements, unit.n_nodes)
        large[table.first[table.find(facet_keys(unit.facets[on_boundary], unit.n_nodes))]] = True
        if not large.any():
            return unit
        refuse_too_many(expected_nodes(placed, wanted), domain)
        # on the mesh with its geometry, so that new nodes go onto the surfaces
        mesh.SetRefinementFlags(large.tolist())
        interruptible(mesh.Refine)
    raise ValueError(f"the size field cannot be reached: after {_MAX_BISECTIONS} bisections {large.sum()} elements of "
                     f"{domain!r} are still too large; does it tend to zero at a point?")


def _check_volume(mesh: MeshArrays, volume: float) -> None:
    """Raise _Unsound unless the volume is right but for the chords of curved faces."""
    bound, meshed = _left_by_chords(mesh) + 1e-5 * volume, float(mesh.volumes.sum())
    if not abs(meshed - volume) <= bound:
        raise _Unsound(f"the mesh fills {meshed / volume:.6g} of the volume, chords explain a deviation of "
                       f"{bound / volume:.2g}")


def _left_by_chords(mesh: MeshArrays) -> float:
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
