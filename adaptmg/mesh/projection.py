r"""onto_domain: nodes that bisection put on the chords of a curved boundary, moved onto the curve.

A node goes as long as every element around it keeps a quarter of its volume; otherwise it stays on
the chord. Nodes that halve edges of moved nodes follow. The moved mesh is not nested in the mesh
before.

A midpoint of two nodes goes along the normal onto the exact surface behind their edge, the one that
both nodes lie on and that is about parallel to the boundary there (:mod:`adaptmg.mesh.exact`); onto
two surfaces where it lies between them. Edges of plane domains and profiles, faces of solids and of
combined ones are known; those of STEP files are not read here: their midpoints stay on the
chord."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays, Surface, signed_measures, sound_by_construction
from adaptmg.mesh.bisection import with_refinement
from adaptmg.mesh.exact import surfaces_of
from adaptmg.mesh.improve import KEPT
from adaptmg.mesh.soundness import check_mesh
from adaptmg.mesh.surfaces import CHORDAL, Revolved, in_space, nearest, settled
from adaptmg.problem.plane_domains import Domain

# how often nodes of spoilt elements, more each time, stay on their chords, before all new nodes do
_MAX_TRIES = 10
# of the extent of the mesh: nodes nearer to their surfaces lie on them up to 64 roundings of double
# precision, which Newton's method reaches
_ROUNDING = 64 * float(np.finfo(np.float64).eps)


def onto_domain(domain: Domain | None, mesh: MeshArrays, n_old: int) -> MeshArrays:
    """Move new boundary nodes of a bisected mesh onto the curved boundaries of its domain.

    Parameters
    ----------
    domain : Domain or None
        What the mesh is a mesh of. Known are the arcs of an Outline (also as an axisymmetric
        profile), a Circle and plane domains combined, the round faces of Cylinder, Ball,
        Revolution, Extrusion, these Moved and combined (Cut, Fuse, Common), and assemblies of
        them. Nodes of STEP files stay where they are, on the chord of their parents; so do all if
        it is None.
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
    known = {
        name: patches for name, patches in surfaces_of(domain).items() if name in mesh.boundaries
    }
    if all(surface.plane for patches in known.values() for surface in patches):
        return mesh  # new nodes lie on planes already
    sides = [_Side(patches, *_new_nodes(mesh, name, n_old)) for name, patches in known.items()]
    parents = mesh.refinement.parents
    depth = _depth(parents, n_old)
    # nodes whose move would spoil an element stay, and all others are moved again
    stays = np.zeros(mesh.n_nodes, dtype=bool)
    near = None  # elements with a node that moves in the first try: later tries move fewer nodes
    for _ in range(_MAX_TRIES):
        points = _points_on_surfaces(mesh, parents, sides, depth, stays, n_old)
        moved = (points != mesh.points).any(axis=1)
        if near is None:
            near = np.flatnonzero(moved[mesh.elements].any(axis=1))
        spoilt = near[signed_measures(points, mesh.elements[near]) < KEPT * mesh.volumes[near]]
        if not len(spoilt):
            break
        stays[mesh.elements[spoilt]] = True
    else:
        return mesh  # each try spoils further elements: all nodes stay on their chords
    if not moved.any():
        return mesh
    return with_refinement(sound_by_construction(replace(mesh, points=points)), mesh.refinement)


class _Side(NamedTuple):
    """The new nodes of one boundary."""

    surfaces: list[Revolved]  # of its faces
    nodes: np.ndarray  # (n,) int
    normals: np.ndarray  # (n, dim): mean unit normals of the facets there


def _new_nodes(mesh: MeshArrays, name: str, n_old: int) -> tuple[np.ndarray, np.ndarray]:
    """Return new nodes (n,) of a boundary, those from number ``n_old`` on, and the mean unit normal (n, dim)
    of its facets around each."""
    facets = mesh.boundary_facets(name)
    facets = facets[(facets >= n_old).any(axis=1)]
    nodes, number = np.unique(facets, return_inverse=True)
    summed = np.zeros((len(nodes), mesh.dim))
    np.add.at(summed, number.reshape(facets.shape), Surface(mesh.points, facets).vectors[:, None])
    new = nodes >= n_old
    return nodes[new], summed[new] / np.linalg.norm(summed[new], axis=1)[:, None]


def _depth(parents: np.ndarray, n_old: int) -> np.ndarray:
    """Return how many new nodes (n_nodes,), those from number ``n_old`` on, follow each other in the
    ancestry of each node, itself included: 1 + the largest of its ``parents`` (n_nodes, 2); 0 of old
    ones."""
    depth = np.zeros(len(parents), dtype=np.int64)
    new = np.arange(n_old, len(parents))
    while True:
        following = 1 + depth[parents[new]].max(axis=1)
        if (following == depth[new]).all():
            return depth
        depth[new] = following


def _points_on_surfaces(
    mesh: MeshArrays,
    parents: np.ndarray,
    sides: list[_Side],
    depth: np.ndarray,
    stays: np.ndarray,
    n_old: int,
) -> np.ndarray:
    """Return the points (n_nodes, dim) with new nodes, those from number ``n_old`` on, on the surfaces of
    the one or two boundaries that they lie on, but for those that ``stays``: halfway between their
    ``parents``, which are moved before, since they have a lower ``depth`` (:func:`_depth`)."""
    points = mesh.points.copy()
    surfaces = [surface for side in sides for surface in side.surfaces]
    near = _ROUNDING * float(np.ptp(points, axis=0).max())
    for level in range(1, int(depth.max()) + 1):
        nodes_of_level = np.flatnonzero(depth[n_old:] == level) + n_old
        points[nodes_of_level] = 0.5 * (
            points[parents[nodes_of_level, 0]] + points[parents[nodes_of_level, 1]]
        )
        # numbers of the two surfaces of each node; of a node on one side twice the same, so that a
        # second side overwrites the second number
        surfaces_of_node = np.full((len(points), 2), -1)
        first = 0
        for side in sides:
            to_move = (depth[side.nodes] == level) & ~stays[side.nodes]
            nodes = side.nodes[to_move]
            ends = points[parents[nodes]]
            number = nearest(side.surfaces, ends, side.normals[to_move], CHORDAL)
            found = nodes[number >= 0]
            surfaces_of_node[found, 1] = first + number[number >= 0]
            of_first_side = found[surfaces_of_node[found, 0] < 0]
            surfaces_of_node[of_first_side, 0] = surfaces_of_node[of_first_side, 1]
            first += len(side.surfaces)
        moving = np.flatnonzero(surfaces_of_node[:, 0] >= 0)
        places, missed = settled(surfaces, in_space(points[moving]), surfaces_of_node[moving], near)
        # nodes that do not reach both surfaces stay on the chord
        places[missed] = in_space(points[moving[missed]])
        points[moving] = places[:, : mesh.dim]
    return points
