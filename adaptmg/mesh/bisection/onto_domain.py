"""onto_domain: nodes that bisection put on the chords of a curved boundary, moved onto the curve.

A node goes as long as every element around it keeps a quarter of its volume; otherwise it stays on the chord. Nodes
that halve edges of moved nodes follow. What was moved is no longer nested in the mesh before.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.bisection.refinement import with_refinement
from adaptmg.mesh.bisection.surfaces import curved_boundaries, on_surface
from adaptmg.mesh.checks.check import check_mesh
from adaptmg.mesh.on_demand_source import sound_by_construction
from adaptmg.problem import checks
from adaptmg.problem.domains import Domain

__all__ = ["onto_domain"]

_KEPT_VOLUME = 0.25
_MAX_TRIES = 10


def onto_domain(domain: Domain | None, mesh: MeshArrays, n_old: int) -> MeshArrays:
    """Move new boundary nodes of a bisected mesh onto the curved boundaries of its domain.

    Parameters
    ----------
    domain : Domain or None
        What the mesh is a mesh of. Known are the arcs of an Outline (also as an axisymmetric profile), the round faces
        of Cylinder, Ball, Revolution, Extrusion, these Moved, and assemblies of them. Nodes of combined solids (Cut,
        Fuse, Common) and of STEP files stay where they are, on the chord of their parents; so do all if it is None.
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
        If it is no mesh, or one without history; if ``n_old`` is no number of nodes.
    """
    check_mesh(mesh)
    n_old = checks.integer("n_old", n_old, 0, mesh.n_nodes)
    if mesh.refinement is None:
        raise ValueError("mesh has no history: onto_domain moves the nodes that adaptmg.mesh.bisect made")
    names = {name: found for name, found in curved_boundaries(domain).items() if name in mesh.boundaries}
    sides = [(*found, *_new_nodes(mesh, name, n_old)) for name, found in names.items()]
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
        spoilt = near[_volumes(points, mesh.elements[near]) < _KEPT_VOLUME * _volumes(mesh.points, mesh.elements[near])]
        if not len(spoilt):
            break
        stays[mesh.elements[spoilt]] = True
    else:
        return mesh
    if not moved.any():
        return mesh
    return with_refinement(sound_by_construction(replace(mesh, points=points, source=None)), mesh.refinement)


def _new_nodes(mesh: MeshArrays, name: str, n_old: int) -> tuple[np.ndarray, np.ndarray]:
    """New nodes of a boundary, and the sum of the normals of its facets around each."""
    facets = mesh.boundary_facets(name)
    facets = facets[(facets >= n_old).any(axis=1)]
    corners = mesh.points[facets]
    edges = corners[:, 1:] - corners[:, :1]
    normals = (np.column_stack([edges[:, 0, 1], -edges[:, 0, 0]]) if mesh.dim == 2
               else np.cross(edges[:, 0], edges[:, 1]))
    nodes, number = np.unique(facets, return_inverse=True)
    summed = np.zeros((len(nodes), mesh.dim))
    np.add.at(summed, number.reshape(facets.shape), normals[:, None])
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


def _moved(mesh: MeshArrays, sides: list, depth: np.ndarray, stays: np.ndarray, n_old: int) -> np.ndarray:
    """The points, each new node after its parents."""
    points, parents = mesh.points.copy(), mesh.refinement.parents
    for level in range(1, int(depth.max()) + 1):
        these = np.flatnonzero(depth[n_old:] == level) + n_old
        points[these] = 0.5 * (points[parents[these, 0]] + points[parents[these, 1]])
        for domain, name, nodes, normals in sides:
            mine = (depth[nodes] == level) & ~stays[nodes]
            a, b = (points[parents[nodes[mine], k]] for k in (0, 1))
            places = on_surface(domain, name, a, b, normals[mine])
            # a node of two boundaries is moved by the curved one of them
            goes = np.linalg.norm(places - 0.5 * (a + b), axis=1) > 1e-14 * np.linalg.norm(b - a, axis=1)
            points[nodes[mine][goes]] = places[goes]
    return points


def _volumes(points: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """Signed volumes, up to a factor."""
    corners = points[elements]
    return np.linalg.det(corners[:, 1:] - corners[:, :1])
