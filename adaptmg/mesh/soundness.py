"""check_mesh: is a mesh closed, positively oriented, of one piece a body? Every mesh passes here
once.

Netgen does not raise when a face fails, it returns a mesh with holes; a misspelt boundary name
gives an empty integral without an error. Both are found here: every facet belongs to two elements,
or to one element and one named boundary facet. Where every two neighbours lie on opposite sides of
their facet, a mesh can still wind twice around a node, or run into another part of itself; then its
boundary lies inside it. This is asked of meshes that were not made here (``check_stranger``), and
of pairs of bodies."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import (
    FacetTable,
    MeshArrays,
    components,
    edge_lengths,
    element_facets,
    facet_keys,
    facet_table,
    mask_of,
    same_orientation,
    signed_measures,
    sound_by_construction,
)


def check_mesh(mesh: MeshArrays, boundaries: Sequence[str] = ()) -> MeshArrays:
    """Return the mesh itself if it is sound.

    Parameters
    ----------
    mesh : MeshArrays
        What to check.
    boundaries : sequence of str
        Boundaries that must exist and have facets.

    Raises
    ------
    TypeError, ValueError
        If it is not MeshArrays. An inverted or degenerate element; an unused node; a fold (two
        neighbours on the same side of their facet); a hole; a boundary facet inside the mesh, given
        twice, or oriented inwards; a missing boundary; a body of several pieces.

    Examples
    --------
    >>> mesh = am.mesh.check_mesh(am.mesh.structured(am.Rectangle(width=1, height=1), 2), ["bottom"])
    >>> mesh.n_nodes
    9
    """
    if not isinstance(mesh, MeshArrays):
        raise TypeError(f"mesh must be MeshArrays, got {type(mesh).__name__}; as_mesh converts")
    if not mesh.sound:
        if not len(mesh.facets):
            raise ValueError("the mesh has no boundary facets")
        _check_elements(mesh)
        table = facet_table(mesh.elements, mesh.n_nodes)
        _check_closed(mesh, table)
        _check_bodies(mesh, table)
        object.__setattr__(mesh, "sound", True)
    names = (boundaries,) if isinstance(boundaries, str) else boundaries
    _check_names(mesh, checks.strings("boundaries", names))
    return mesh


def check_stranger(mesh: MeshArrays) -> MeshArrays:
    """Return a mesh that was not made here, checked by :func:`check_mesh`; ValueError also if one of
    its bodies lies over itself."""
    return sound_by_construction(check_overlap(check_mesh(mesh)))


def _place_of(points: np.ndarray) -> str:
    """Return the mean of some points as text for a message."""
    return "(" + ", ".join(f"{c:.6g}" for c in points.mean(axis=0)) + ")"


def _check_elements(mesh: MeshArrays) -> None:
    """Raise ValueError if elements are flat or inverted, or nodes belong to none."""
    unit = "m^2" if mesh.dim == 2 else "m^3"
    inverted = np.flatnonzero(mesh.volumes < 0)
    flat = np.flatnonzero(np.abs(mesh.volumes) <= checks.ALIKE * mesh.element_sizes**mesh.dim)
    for bad, what in ((flat, "degenerate"), (inverted, "inverted")):
        if len(bad):
            e = int(bad[0])
            raise ValueError(
                f"{len(bad)} of {len(mesh.elements)} elements are {what}; element {e} at "
                f"{_place_of(mesh.points[mesh.elements[e]])} has volume {mesh.volumes[e]:.4g} {unit}, "
                f"nodes {mesh.elements[e].tolist()}"
            )
    used = mask_of(mesh.elements, mesh.n_nodes)
    if not used.all():
        i = int(np.argmin(used))
        raise ValueError(
            f"{np.count_nonzero(~used)} of {mesh.n_nodes} nodes belong to no element; node {i} at "
            f"{_place_of(mesh.points[i : i + 1])}; leave them out and renumber"
        )


def _check_closed(mesh: MeshArrays, table: FacetTable) -> None:
    """Raise ValueError unless the facets of the boundary are just the facets of one element only,
    each of them once and outwards, and no facet is folded or of three elements."""
    kind = "edge" if mesh.dim == 2 else "face"

    def fail(bad: np.ndarray, what: str, facets: np.ndarray) -> None:
        """Raise ValueError, which says ``what`` they are, if any of the facets (n, dim) is bad (n,)."""
        if bad.any():
            facet = facets[int(np.argmax(bad))]
            raise ValueError(
                f"{np.count_nonzero(bad)} {what}; one with nodes {facet.tolist()} at "
                f"{_place_of(mesh.points[facet])}"
            )

    fail(
        table.counts > 2,
        f"{kind}s belong to more than two elements (overlapping elements)",
        table.facets,
    )
    fail(
        table.folded,
        f"{kind}s have both their elements on the same side: the mesh is folded over (tangled) there, "
        "or holds an element twice",
        table.facets,
    )
    row = table.find(facet_keys(mesh.facets, mesh.n_nodes))
    fail(row < 0, f"boundary facets are no {kind} of any element", mesh.facets)
    fail(table.counts[row] == 2, "boundary facets lie inside the mesh", mesh.facets)
    named = np.bincount(row, minlength=len(table.keys))
    fail(named > 1, "boundary facets are given twice", table.facets)
    fail(
        (table.counts == 1) & (named == 0),
        f"{kind}s belong to one element and to no boundary (the mesh has a hole, "
        "or part of its boundary has no name)",
        table.facets,
    )
    fail(
        ~same_orientation(mesh.facets, table.facets[row]),
        "boundary facets have their normal inwards",
        mesh.facets,
    )


def _check_bodies(mesh: MeshArrays, table: FacetTable) -> None:
    """Raise ValueError unless the elements of each body hang together through facets."""
    part = components(table, mesh.element_body)
    elements_of = np.bincount(part)
    body_of = np.empty(len(elements_of), dtype=np.int64)
    body_of[part] = mesh.element_body
    pieces = np.bincount(body_of, minlength=len(mesh.bodies))
    for body in np.flatnonzero(pieces != 1):
        name = mesh.bodies[body]
        if pieces[body] == 0:
            raise ValueError(f"body {name!r} has no elements")
        sizes = np.sort(elements_of[body_of == body])[::-1]
        shown = ", ".join(map(str, sizes[:8])) + (", ..." if len(sizes) > 8 else "")
        raise ValueError(
            f"body {name!r} consists of {len(sizes)} pieces, of {shown} elements; "
            "give each piece another body (material) name, or join them"
        )


def _check_names(mesh: MeshArrays, boundaries: Sequence[str]) -> None:
    """Raise ValueError unless the mesh has facets on all these boundaries."""
    present = np.bincount(mesh.facet_labels, minlength=len(mesh.boundaries)) > 0
    known = [name for name, there in zip(mesh.boundaries, present, strict=True) if there]
    for name in boundaries:
        if name not in known:
            raise ValueError(
                f"boundary {name!r} does not exist; the boundaries are {', '.join(known)}"
            )


@dataclass(frozen=True, kw_only=True)
class MeshQuality:
    """Shape and size of the elements of a mesh.

    Examples
    --------
    >>> quality = am.mesh.quality(am.mesh.structured(am.Rectangle(width=1, height=1), 2))
    >>> round(quality.h_max, 3)
    0.707
    """

    min_angle: float  # degrees; in 3D dihedral angles
    max_angle: float
    h_min: float  # m: shortest edge
    h_max: float
    aspect_ratio: (
        float  # longest edge over the inradius, of the worst element; 1 if it is equilateral
    )


def quality(mesh: MeshArrays) -> MeshQuality:
    """Measure the elements of a mesh; ValueError unless it is sound, see :func:`check_mesh`.

    Examples
    --------
    >>> round(am.mesh.quality(am.mesh.structured(am.Rectangle(width=1, height=1), 2)).min_angle)
    45
    """
    dim = check_mesh(mesh).dim
    corners = mesh.points[mesh.elements]
    edges = edge_lengths(corners)
    angles, measures = _angles(mesh.points, mesh.elements)
    inradius = dim * mesh.volumes / measures.sum(axis=1)
    # edge over inradius of the equilateral element
    equilateral = 2 * np.sqrt(3.0) if dim == 2 else 2 * np.sqrt(6.0)
    return MeshQuality(
        min_angle=float(angles.min()),
        max_angle=float(angles.max()),
        h_min=float(edges.min()),
        h_max=float(edges.max()),
        aspect_ratio=float((edges.max(axis=0) / inradius).max() / equilateral),
    )


def _angles(points: np.ndarray, elements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles (n_pairs, n) inside ``elements`` (n, dim + 1) between ``points`` (n_nodes, dim)
    between their facets, degrees, and the measures (n, dim + 1) of the facets."""
    sides = points[element_facets(elements)]
    first = sides[:, :, 1] - sides[:, :, 0]
    if points.shape[1] == 2:
        normals = np.stack([first[..., 1], -first[..., 0]], axis=-1)
        measures = np.linalg.norm(normals, axis=-1)
    else:
        normals = np.cross(first, sides[:, :, 2] - sides[:, :, 0])
        measures = 0.5 * np.linalg.norm(normals, axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    # between two facets the angle inside is pi minus the one between the outward normals
    cosines = np.stack(
        [
            -(normals[:, i] * normals[:, j]).sum(axis=1)
            for i in range(sides.shape[1])
            for j in range(i)
        ]
    )
    return np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))), measures


def least_angle(points: np.ndarray, elements: np.ndarray) -> float:
    """Return the smallest angle between facets of ``elements`` (n, dim + 1) between ``points`` (n_nodes,
    dim), degrees; 0 where one is flat or turned over, 180 without elements."""
    if not (
        signed_measures(points, elements)
        > checks.ALIKE * edge_lengths(points[elements]).max(axis=0) ** points.shape[1]
    ).all():
        return 0.0
    return float(_angles(points, elements)[0].min(initial=180.0))


# the boundary this deep inside an element, in barycentric coordinates: the two sides of a curved
# slit, cut into chords apart, may cross by less; half and twice change none of 160 meshes of outlines
_DEEP = 0.05


def check_overlap(mesh: MeshArrays) -> MeshArrays:
    """Return the mesh if none of its bodies lies over itself."""
    for number, name in enumerate(mesh.bodies):
        inside = _buried(mesh, number, number)
        if len(inside):
            raise ValueError(
                f"the boundary of body {name!r} lies inside other elements of it at {len(inside)} places, "
                f"one of them {_place_of(inside[:1])}: the body lies over itself (overlapping elements)"
            )
    return mesh


def overlapping_bodies(
    mesh: MeshArrays, apart: Iterable[tuple[int, int]]
) -> Iterator[tuple[int, int, np.ndarray]]:
    """Yield the pairs of bodies, of those ``apart``, of which one lies deep inside elements of the
    other, and such a place (dim,)."""
    box = {}
    for k in np.unique(mesh.element_body).tolist():
        points = mesh.points[mesh.elements[mesh.element_body == k]].reshape(-1, mesh.dim)
        box[k] = points.min(axis=0), points.max(axis=0)
    for a, b in apart:
        if (box[a][0] < box[b][1]).all() and (box[b][0] < box[a][1]).all():
            places = np.concatenate([_buried(mesh, a, b), _buried(mesh, b, a)])
            if len(places):
                yield a, b, places[0]


def _buried(mesh: MeshArrays, body: int, other: int) -> np.ndarray:
    """Return places (n, dim) of the boundary of a body that lie deep inside elements of another, or of
    itself: nodes, and a point inside each facet, not its centroid: in regular meshes nodes and
    centroids of one body may all lie in planes between the elements of the other."""
    of_body = mask_of(mesh.elements[mesh.element_body == body], mesh.n_nodes)
    elements = mesh.elements[mesh.element_body == other]
    facets = mesh.facets[of_body[mesh.facets].all(axis=1)]
    if len(facets) == 0:
        return np.empty((0, mesh.dim))
    shares = np.arange(mesh.dim, 2.0 * mesh.dim)
    places = np.concatenate(
        [mesh.points[np.unique(facets)], shares @ mesh.points[facets] / shares.sum()]
    )
    from scipy.spatial import cKDTree  # a first solve without it starts sooner

    # pairs of an element and a place in the ball around it; first find the elements that have any
    tree = cKDTree(places)
    corners = mesh.points[elements]
    centre = corners.mean(axis=1)
    reach = np.sqrt(np.square(corners - centre[:, None]).sum(axis=2).max(axis=1))
    near = np.flatnonzero(tree.query(centre, distance_upper_bound=float(reach.max()))[0] < reach)
    found = tree.query_ball_point(centre[near], reach[near])
    element = np.repeat(near, [len(f) for f in found])
    place = np.concatenate([np.empty(0, dtype=np.int64), *map(np.asarray, found)]).astype(np.int64)
    # deep inside: barycentric coordinates, of which the first is 1 - the sum of the others
    base = corners[element, 0]
    edges = (corners[element, 1:] - base[:, None]).transpose(0, 2, 1)
    weights = np.linalg.solve(edges, (places[place] - base)[:, :, None])[:, :, 0]
    deep = np.minimum(weights.min(axis=1), 1 - weights.sum(axis=1)) > _DEEP
    return places[np.unique(place[deep])]
