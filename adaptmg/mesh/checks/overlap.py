r"""check_overlap: does a body lie over itself, overlapping_bodies: over another? For meshes of strangers.

Where every two neighbours lie on opposite sides of their facet (:func:`adaptmg.mesh.check_mesh`), a mesh can still wind
twice around a node (in 3D: an edge), so that the angles there add up to :math:`4\pi`, or run into another part of
itself; then its boundary lies inside it, and so do boundary nodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from adaptmg.mesh.arrays import MeshArrays

__all__ = ["check_overlap", "overlapping_bodies"]

# the boundary this deep inside an element, in barycentric coordinates: the two sides of a curved slit, cut into
# chords apart, may cross by less
_DEEP = 0.05


def check_overlap(mesh: MeshArrays) -> MeshArrays:
    """Return the mesh if none of its bodies lies over itself.

    Parameters
    ----------
    mesh : MeshArrays
        One that :func:`adaptmg.mesh.check_mesh` has passed.

    Returns
    -------
    MeshArrays
        The same object.

    Raises
    ------
    ValueError
        Elements wind more than once around a node or edge, or the boundary lies inside elements of its body.
    """
    total, corners = _turns(mesh)
    if total.max() > 2 * np.pi * (1 + 1e-6):
        k = int(np.argmax(total))
        what = "node" if mesh.dim == 2 else "edge with nodes"
        raise ValueError(f"the elements around {what} {np.atleast_1d(corners[k]).tolist()} at "
                         f"{_place(mesh.points[np.atleast_1d(corners[k])].mean(axis=0))} fill "
                         f"{np.degrees(total[k]):.0f} degrees, more than 360: the mesh lies over itself (tangled)")
    for number, name in enumerate(mesh.bodies):
        inside = _buried(mesh, number, number)
        if len(inside):
            raise ValueError(f"the boundary of body {name!r} lies inside other elements of it at {len(inside)} places, "
                             f"one of them {_place(inside[0])}: the body lies over itself (overlapping elements)")
    return mesh


def _place(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{c:.6g}" for c in point) + ")"


def _turns(mesh: MeshArrays) -> tuple[np.ndarray, np.ndarray]:
    """Sum of the angles of elements around each node (3D: dihedral, around each edge), and these nodes."""
    x = mesh.points
    if mesh.dim == 2:
        total = np.zeros(mesh.n_nodes)
        for k in range(3):
            a, b, c = (mesh.elements[:, (k + i) % 3] for i in range(3))
            u, v = x[b] - x[a], x[c] - x[a]
            angle = np.arctan2(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0], (u * v).sum(axis=1))
            total += np.bincount(a, angle, minlength=mesh.n_nodes)
        return total, np.arange(mesh.n_nodes)
    keys, angles = [], []
    for i, j in combinations(range(4), 2):
        k, m = sorted({0, 1, 2, 3} - {i, j})
        a, b = mesh.elements[:, i], mesh.elements[:, j]
        along = x[b] - x[a]
        first, second = (np.cross(along, x[mesh.elements[:, n]] - x[a]) for n in (k, m))
        angles.append(np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), (first * second).sum(axis=1)))
        keys.append(np.minimum(a, b).astype(np.int64) * mesh.n_nodes + np.maximum(a, b))
    edge, row = np.unique(np.concatenate(keys), return_inverse=True)
    total = np.bincount(row, np.concatenate(angles))
    return total, np.stack([edge // mesh.n_nodes, edge % mesh.n_nodes], axis=1)


def overlapping_bodies(mesh: MeshArrays, apart: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int, np.ndarray]]:
    """Those pairs of bodies of which one lies deep inside elements of the other, and a place (dim,) where it does."""
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
    """Boundary nodes of a body, and centroids of its boundary facets, deep inside elements of another; places (n, dim).

    Centroids as well: in extruded meshes nodes may lie in planes that no element crosses. Both may be the same body.
    """
    own = np.zeros(mesh.n_nodes, dtype=bool)
    own[mesh.elements[mesh.element_body == body]] = True
    elements = mesh.elements[mesh.element_body == other]
    facets = mesh.facets[own[mesh.facets].all(axis=1)]
    if len(facets) == 0:
        return np.empty((0, mesh.dim))
    places = np.concatenate([mesh.points[np.unique(facets)], mesh.points[facets].mean(axis=1)])
    tree = cKDTree(places)
    corners = mesh.points[elements]
    centre = corners.mean(axis=1)
    reach = np.sqrt(np.square(corners - centre[:, None]).sum(axis=2).max(axis=1))
    near = np.flatnonzero(tree.query(centre, distance_upper_bound=float(reach.max()))[0] < reach)
    found = tree.query_ball_point(centre[near], reach[near])
    element = np.repeat(near, [len(f) for f in found])
    place = np.concatenate([np.empty(0, dtype=np.int64), *map(np.asarray, found)]).astype(np.int64)
    base = corners[element, 0]
    edges = (corners[element, 1:] - base[:, None]).transpose(0, 2, 1)
    weights = np.linalg.solve(edges, (places[place] - base)[:, :, None])[:, :, 0]
    deep = np.minimum(weights.min(axis=1, initial=1.0), 1 - weights.sum(axis=1)) > _DEEP
    return places[np.unique(place[deep])]
