"""Meshes of the unit square and cube, the disk and two boxes, made without a mesh generator."""

import itertools
from dataclasses import replace

import numpy as np
from scipy.spatial import Delaunay

import adaptmg as am
from adaptmg.mesh.arrays import facet_table


def mesh_of(points, elements, **options):
    """MeshArrays from points and elements: oriented, with the outer facets as boundary 'all'."""
    points, elements = np.asarray(points, dtype=float), np.array(elements)
    corners = points[elements]
    negative = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    elements[np.ix_(negative, [0, 1])] = elements[np.ix_(negative, [1, 0])]
    table = facet_table(elements, len(points))
    facets = table.facets[table.counts == 1]
    return am.MeshArrays(
        points=points,
        elements=elements,
        facets=facets,
        facet_labels=np.zeros(len(facets)),
        boundaries=("all",),
        **options,
    )


def numbered_at_random(mesh, seed):
    """The mesh with its nodes in another order."""
    new = np.random.default_rng(seed).permutation(mesh.n_nodes)
    return replace(
        mesh,
        points=mesh.points[np.argsort(new)],
        elements=new[mesh.elements],
        facets=new[mesh.facets],
    )


def delaunay(points):
    """Delaunay mesh of points, without the flat elements it puts on straight boundaries."""
    elements = Delaunay(points).simplices
    corners = points[elements]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    used, numbers = np.unique(elements[volumes > 1e-13], return_inverse=True)
    return mesh_of(points[used], numbers.reshape(-1, elements.shape[1]))


def random_box(n, dim, seed):
    """Unit square or cube with n random inner points and n // 4 on each side, none shared between
    seeds but corners."""
    rng = np.random.default_rng(seed)
    parts = [np.array(list(itertools.product((0.0, 1.0), repeat=dim))), rng.random((n, dim))]
    for axis, value in itertools.product(range(dim), (0.0, 1.0)):
        side = rng.random((max(n // 4, 1), dim))
        side[:, axis] = value
        parts.append(side)
    for axis in range(dim) if dim == 3 else ():
        for ends in itertools.product((0.0, 1.0), repeat=2):
            edge = rng.random((max(n // 8, 1), dim))
            edge[:, [a for a in range(dim) if a != axis]] = ends
            parts.append(edge)
    return delaunay(np.concatenate(parts))


def structured(n, dim, grading=1.0):
    """Unit square or cube, n cells a side, each cut along its diagonal; n and 2 n are nested;
    graded by t^grading."""
    mesh = am.mesh.structured(
        am.Rectangle(width=1, height=1) if dim == 2 else am.Box(width=1, depth=1, height=1), n
    )
    return mesh_of(mesh.points**grading, mesh.elements)


def log_graded(n, seed):
    """Square whose elements shrink by more than 1000 towards the corner (0, 0)."""
    rng = np.random.default_rng(seed)
    points = np.clip(10.0 ** (-4 * rng.random((n, 1))) * rng.random((n, 2)) * 1.5, 0, 1)
    return delaunay(np.unique(np.concatenate([points, [[0, 0], [0, 1], [1, 0], [1, 1]]]), axis=0))


def disk(rings, turn=0.0):
    """Unit disk of concentric rings, nodes of the last on the circle."""
    points = [np.zeros((1, 2))]
    for r in range(1, rings + 1):
        angle = np.linspace(0, 2 * np.pi, 6 * r, endpoint=False) + turn * r
        points.append(r / rings * np.column_stack([np.cos(angle), np.sin(angle)]))
    return delaunay(np.concatenate(points))


def two_boxes(n, dim):
    """Two unit boxes, one on the other, that do not share the nodes of their common face."""
    below, above = structured(n, dim), structured(n, dim)
    shift = np.eye(dim)[-1]
    return mesh_of(
        np.concatenate([below.points - shift, above.points]),
        np.concatenate([below.elements, above.elements + below.n_nodes]),
        element_body=np.repeat([0, 1], len(below.elements)),
        bodies=("below", "above"),
    )
