"""Meshes that are bisected, moved, measured, and what is asked of them."""

from dataclasses import replace

import numpy as np

import adaptmg as am

SQUARE = am.mesh.structured(am.Rectangle(width=1, height=1), 3)


def cube(divisions: int = 1) -> am.MeshArrays:
    return am.mesh.structured(am.Box(width=1, depth=1, height=1), divisions)


def shaken(mesh: am.MeshArrays, size: float, seed: int = 3) -> am.MeshArrays:
    """A mesh with its inner nodes moved at random."""
    points, inner = mesh.points.copy(), np.setdiff1d(np.arange(mesh.n_nodes), mesh.facets)
    points[inner] += size * np.random.default_rng(seed).uniform(-1, 1, (len(inner), mesh.dim))
    return am.mesh.check_mesh(replace(mesh, points=points))


def crooked(mesh: am.MeshArrays) -> am.MeshArrays:
    """A mesh of a unit square or cube, its longest edges anyhow."""
    return shaken(mesh, 0.2 * np.diff(np.unique(mesh.points[:, 0])).min())


def edge_lengths(mesh: am.MeshArrays, boundary: str) -> np.ndarray:
    """Lengths of the edges on a boundary."""
    corners = mesh.points[mesh.boundary_facets(boundary)]
    pairs = [(0, 1)] if mesh.dim == 2 else [(0, 1), (1, 2), (2, 0)]
    return np.concatenate([np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i, j in pairs])


def single(points: np.ndarray) -> am.MeshArrays:
    """One triangle or tetrahedron."""
    points = np.array(points, dtype=float)
    corners = np.arange(len(points))
    if np.linalg.det(points[1:] - points[0]) < 0:
        points[[0, 1]] = points[[1, 0]]
    facets = {3: [[1, 2], [2, 0], [0, 1]], 4: [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]}[
        len(points)
    ]
    names = tuple(f"side{k}" for k in corners)
    return am.mesh.check_mesh(
        am.MeshArrays(points, corners[None], np.array(facets), corners, names)
    )


def random_mask(mesh: am.MeshArrays, part: float, seed: int) -> np.ndarray:
    marked = np.random.default_rng(seed).random(len(mesh.elements)) < part
    marked[0] = True
    return marked


def verified(mesh: am.MeshArrays) -> am.MeshArrays:
    """The mesh, which claims to be sound, checked as if it did not."""
    assert mesh.sound
    am.mesh.check_mesh(replace(mesh), mesh.boundaries)
    return mesh


def as_sets(mesh: am.MeshArrays) -> tuple[set, set, set]:
    """Nodes, elements and labelled facets by places, whatever their numbers and order."""
    places = [tuple(x) for x in mesh.points.tolist()]
    elements = [
        (body, frozenset(places[i] for i in nodes))
        for nodes, body in zip(mesh.elements.tolist(), mesh.element_body.tolist(), strict=True)
    ]
    facets = [
        (label, frozenset(places[i] for i in nodes))
        for nodes, label in zip(mesh.facets.tolist(), mesh.facet_labels.tolist(), strict=True)
    ]
    found = set(places), set(elements), set(facets)
    assert [len(x) for x in found] == [mesh.n_nodes, len(elements), len(facets)]
    return found


def shape_classes(mesh: am.MeshArrays) -> int:
    """How many elements there are that are not similar to each other."""
    corners = mesh.points[mesh.elements]
    k = corners.shape[1]
    lengths = np.sort(
        [np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i in range(k) for j in range(i)],
        axis=0,
    )
    return len(np.unique(np.round(lengths / lengths[-1], 6).T, axis=0))


def containing_elements(coarse: am.MeshArrays, fine: am.MeshArrays) -> np.ndarray:
    """The coarse element that holds each fine one, -1 where there is none."""
    found = np.full(len(fine.elements), -1)
    for e, corners in enumerate(coarse.points[coarse.elements]):
        weights = np.linalg.solve((corners[1:] - corners[0]).T, (fine.points - corners[0]).T)
        weights = np.vstack([1 - weights.sum(axis=0), weights])
        found[(weights.min(axis=0) > -1e-12)[fine.elements].all(axis=1)] = e
    return found
