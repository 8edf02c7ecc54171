r"""solid_mesh: solids meshed by Netgen and OCC, finer near some boundaries or where a size field says.

The wanted edge length, for a bulk size H, a size function s, sizes :math:`h_b` on boundaries b and a grading g, is

.. math:: h(x) = \min\bigl(H,\; s(x),\; \min_b (h_b + g\,\mathrm{dist}(x, b))\bigr).

Netgen is asked for it as far as it is not below H/16; what is finer is bisected, with new nodes put onto the curved
surfaces. Netgen also keeps edges on curved faces below their radius over ``curvature``.
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
from adaptmg.mesh.netgen.generate import expected_nodes, refuse_too_many
from adaptmg.mesh.netgen.interruptible import interruptible
from adaptmg.mesh.netgen.occ_shapes import occ_shape
from adaptmg.mesh.netgen.shape_arrays import Unsound, check_volume, in_metres, ordered, placed, read_shape
from adaptmg.mesh.netgen.thin import curved_nodes, refuse_thin, refuse_thin_shape
from adaptmg.mesh.topology import facet_keys, facet_table
from adaptmg.problem import checks
from adaptmg.problem.domains import Box, Domain, SolidDomain

__all__ = ["CURVATURE", "SolidSizes", "scaled_shape", "shape_mesh", "solid_mesh"]

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
