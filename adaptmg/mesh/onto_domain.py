r"""onto_domain: nodes that bisection put on the chords of a curved boundary, moved onto the curve.

A node goes as long as every element around it keeps a quarter of its volume; otherwise it stays on
the chord. Nodes that halve edges of moved nodes follow. The moved mesh is not nested in the mesh
before.

An arc moves the midpoint of two nodes along its radius, as cylinders and balls do. In a turned
profile the midpoint keeps its angle about the axis and gets the radius and height of the profile,
in an extruded one it keeps its height. Of several edges of one name that is taken which both nodes
lie on and which faces as the boundary does there. Plane domains combined are outlines; combined
solids (:class:`~adaptmg.problem.Cut`, ``Fuse``, ``Common``) and STEP files do not say which surface
a face lies on: their midpoints stay on the chord."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays, Surface, signed_measures, sound_by_construction
from adaptmg.mesh.bisection import with_refinement
from adaptmg.mesh.sizes import in_edges
from adaptmg.mesh.soundness import check_mesh
from adaptmg.problem.combined_domains import Assembly
from adaptmg.problem.plane_domains import Domain, Outline
from adaptmg.problem.plane_edges import Arc
from adaptmg.problem.solid_domains import Ball, Cylinder, Extrusion, Moved, Revolution

_KEPT_VOLUME = 0.25
_MAX_TRIES = 10


def onto_domain(domain: Domain | None, mesh: MeshArrays, n_old: int) -> MeshArrays:
    """Move new boundary nodes of a bisected mesh onto the curved boundaries of its domain.

    Parameters
    ----------
    domain : Domain or None
        What the mesh is a mesh of. Known are the arcs of an Outline (also as an axisymmetric
        profile), a Circle and plane domains combined, the round faces of Cylinder, Ball,
        Revolution, Extrusion, these Moved, and assemblies of them. Nodes of combined solids (Cut,
        Fuse, Common) and of STEP files stay where they are, on the chord of their parents; so do
        all if it is None.
    mesh : MeshArrays
        From :func:`adaptmg.mesh.bisect`; not changed.
    n_old : int
        Nodes from this number on are new; none of the others moves.

    Returns
    -------
    MeshArrays
        With its history; the same object if no node moves.

    Raises
    ------
    TypeError, ValueError
        If it is not a mesh, or has no history; if ``n_old`` is not a number of nodes.
    """
    check_mesh(mesh)
    n_old = checks.integer("n_old", n_old, 0, mesh.n_nodes)
    if mesh.refinement is None:
        raise ValueError(
            "mesh has no history: onto_domain moves the nodes that adaptmg.mesh.bisect made"
        )
    names = {
        name: curves
        for name, curves in _curved_boundaries(domain).items()
        if name in mesh.boundaries
    }
    sides = [(*curves, *_new_nodes(mesh, name, n_old)) for name, curves in names.items()]
    if not any(len(nodes) for _, _, nodes, _ in sides):
        return mesh
    depth = _depth(mesh.refinement.parents, n_old)
    stays = np.zeros(mesh.n_nodes, dtype=bool)
    near = None
    for _ in range(_MAX_TRIES):
        points = _moved(mesh, sides, depth, stays, n_old)
        moved = (points != mesh.points).any(axis=1)
        if near is None:
            near = np.flatnonzero(moved[mesh.elements].any(axis=1))
        spoilt = near[
            signed_measures(points, mesh.elements[near]) < _KEPT_VOLUME * mesh.volumes[near]
        ]
        if not len(spoilt):
            break
        stays[mesh.elements[spoilt]] = True
    else:
        return mesh
    if not moved.any():
        return mesh
    return with_refinement(
        sound_by_construction(replace(mesh, points=points, source=None)), mesh.refinement
    )


def _new_nodes(mesh: MeshArrays, name: str, n_old: int) -> tuple[np.ndarray, np.ndarray]:
    """New nodes of a boundary, and the sum of the normals of its facets around each."""
    facets = mesh.boundary_facets(name)
    facets = facets[(facets >= n_old).any(axis=1)]
    nodes, number = np.unique(facets, return_inverse=True)
    summed = np.zeros((len(nodes), mesh.dim))
    np.add.at(summed, number.reshape(facets.shape), Surface(mesh.points, facets).vectors[:, None])
    new = nodes >= n_old
    return nodes[new], summed[new]


def _depth(parents: np.ndarray, n_old: int) -> np.ndarray:
    """How many new nodes follow each other in the ancestry of each new node, itself included."""
    depth = np.zeros(len(parents), dtype=np.int64)
    new = np.arange(n_old, len(parents))
    while True:
        following = 1 + depth[parents[new]].max(axis=1)
        if (following == depth[new]).all():
            return depth
        depth[new] = following


def _moved(
    mesh: MeshArrays, sides: list, depth: np.ndarray, stays: np.ndarray, n_old: int
) -> np.ndarray:
    """The points, each new node after its parents."""
    points, parents = mesh.points.copy(), mesh.refinement.parents
    for level in range(1, int(depth.max()) + 1):
        these = np.flatnonzero(depth[n_old:] == level) + n_old
        points[these] = 0.5 * (points[parents[these, 0]] + points[parents[these, 1]])
        for domain, name, nodes, normals in sides:
            mine = (depth[nodes] == level) & ~stays[nodes]
            a, b = (points[parents[nodes[mine], k]] for k in (0, 1))
            places = _on_surface(domain, name, a, b, normals[mine])
            # a node of two boundaries is moved by the curved one of them
            goes = np.linalg.norm(places - 0.5 * (a + b), axis=1) > 1e-14 * np.linalg.norm(
                b - a, axis=1
            )
            points[nodes[mine][goes]] = places[goes]
    return points


# nodes further from an arc than this part of the edge between them do not lie on it
_NEAR = 0.25
# what an edge that faces the other way is further away for, in lengths of the edge between the
# nodes
_AVERTED = 10.0
# profiles: radii below this part of the largest lie on the axis
_ON_AXIS = 1e-12
# turned faces with less of their normal away from the axis are plane
_PLANE = 1e-9


def _curved_boundaries(domain: Domain | None) -> dict[str, tuple[Domain, str]]:
    """The boundaries that may be curved: their part of the domain, and its own name."""
    if isinstance(domain, Assembly):
        return {
            f"{body}.{name}": curves
            for body, part in domain.parts.items()
            for name, curves in _curved_boundaries(part).items()
        }
    if domain is None:
        return {}
    domain = in_edges(domain)
    return {name: (domain, name) for name in _curved(domain)}


def _curved(domain: Domain) -> tuple[str, ...]:
    if isinstance(domain, Outline):
        return tuple(dict.fromkeys(domain.boundaries[i] for i in domain.arcs))
    if isinstance(domain, Moved):
        return _curved(domain.solid)
    if isinstance(domain, Cylinder):
        return ("side",)
    if isinstance(domain, Ball):
        return ("surface",)
    if isinstance(domain, Extrusion):
        return _curved(domain.polygon)
    if isinstance(domain, Revolution):
        return tuple(name for name in domain.boundaries if name in domain.polygon.boundaries)
    return ()


def _on_surface(
    domain: Domain, name: str, a: np.ndarray, b: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Places on a boundary for the midpoints of some of its edges."""
    middle = 0.5 * (a + b)
    if isinstance(domain, Outline):
        return _on_outline(domain, name, a, b, normals)
    if isinstance(domain, Moved):
        turn, offset = domain.rotation, np.array(domain.offset)
        own = _on_surface(
            domain.solid, name, (a - offset) @ turn, (b - offset) @ turn, normals @ turn
        )
        return own @ turn.T + offset
    if isinstance(domain, Ball):
        centre = np.array(domain.centre)
        return centre + _stretched(middle - centre, domain.radius)
    if isinstance(domain, Cylinder):
        offset, axis = middle - np.array(domain.point), np.array(domain.axis)
        along = (offset @ axis)[:, None] * axis
        return np.array(domain.point) + along + _stretched(offset - along, domain.radius)
    if isinstance(domain, Extrusion):
        plane = _on_outline(domain.polygon, name, a[:, :2], b[:, :2], normals[:, :2])
        return np.column_stack([plane, middle[:, 2]])
    return _on_revolution(domain, name, a, b, normals)


def _stretched(vectors: np.ndarray, length: float) -> np.ndarray:
    """Vectors (n, dim) with their direction and this length; those without direction stay."""
    own = np.linalg.norm(vectors, axis=1)
    return vectors * np.where(own > 0, length / np.where(own > 0, own, 1.0), 1.0)[:, None]


def _on_revolution(
    domain: Revolution, name: str, a: np.ndarray, b: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Radius and height of the profile, at the angle of the midpoint."""
    middle = 0.5 * (a + b)
    profile = domain.polygon
    radius = np.hypot(middle[:, 0], middle[:, 1])
    off_axis = radius > _ON_AXIS * float(profile.upper[0])
    direction = middle[:, :2] / np.where(off_axis, radius, 1.0)[:, None]
    flat_a, flat_b = (np.column_stack([np.hypot(x[:, 0], x[:, 1]), x[:, 2]]) for x in (a, b))
    outward = np.column_stack([(normals[:, :2] * direction).sum(axis=1), normals[:, 2]])
    flat = _on_outline(profile, name, flat_a, flat_b, outward)
    result = np.column_stack([flat[:, :1] * direction, flat[:, 1]])
    # faces normal to the axis are plane
    turned = np.hypot(normals[:, 0], normals[:, 1]) > _PLANE * np.linalg.norm(normals, axis=1)
    return np.where((off_axis & turned)[:, None], result, middle)


def _on_outline(
    outline: Outline, name: str, a: np.ndarray, b: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Midpoints on the edges of an outline that have one name."""
    middle = 0.5 * (a + b)
    length = np.linalg.norm(b - a, axis=1)
    result, best = middle.copy(), np.full(len(a), np.inf)
    for edge in (outline.edge(i) for i, own in enumerate(outline.boundaries) if own == name):
        if isinstance(edge, Arc):
            offset = middle - np.array(edge.center)
            facing = math.copysign(1.0, edge.angle) * (normals * offset).sum(axis=1)
            place = np.array(edge.center) + _stretched(offset, edge.radius)
        else:
            along, place = edge.end - edge.start, middle
            facing = normals @ np.array([along[1], -along[0]])
        away = np.maximum(edge.distance(a), edge.distance(b)) + np.where(
            facing > 0, 0.0, _AVERTED * length
        )
        nearer = (away < best) & (away <= _NEAR * length)
        best = np.where(nearer, away, best)
        result = np.where(nearer[:, None], place, result)
    return result
