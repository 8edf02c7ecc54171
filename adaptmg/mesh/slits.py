r"""split and opened: meshes cut open along facets inside them, the two faces of a crack.

A facet of a slit stands twice among the facets of the boundary, once in each orientation. The
corners that elements have at a node of the slit hang together through all other facets there; each
connected set of them gets a node: a node between k facets of slits in the plane becomes k nodes,
one at a tip stays one. No geometry is needed, so that kinks and branches need no care. A facet with
all its nodes at tips stays closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import (
    MeshArrays,
    Surface,
    doubled,
    facet_keys,
    facet_table,
    mask_of,
    positive,
    same_orientation,
    sound_by_construction,
)
from adaptmg.mesh.soundness import check_mesh


def opened(
    elements: np.ndarray, facets: np.ndarray, n_nodes: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the elements (n_elements, k) and facets (n, k - 1) with nodes doubled along slits:
    facets that stand twice; a mask (n,) of the facets that are open; and the old node that each
    node comes from. ValueError if a facet of a slit is not inside the mesh."""
    # facets of slits, and the elements (``near``, ``cells``) with a node on them
    keys = facet_keys(facets, n_nodes)
    slit, counts = np.unique(keys, return_counts=True)
    slit = slit[counts > 1]
    at_slit = mask_of(facets[np.isin(keys, slit)], n_nodes)
    k = elements.shape[1]
    near = np.flatnonzero(at_slit[elements].any(axis=1))
    cells = elements[near]
    table = facet_table(cells, n_nodes)
    rows = table.find(slit)
    if (rows < 0).any() or (table.second[rows] < 0).any():
        raise ValueError("facets of a slit must lie between two elements")

    def corners(cell: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Return where nodes (n,) stand in ``cells.ravel()`` as corners of the cells ``cell`` (n,)."""
        return k * cell + np.argmax(cells[cell] == nodes[:, None], axis=1)

    # graph of the corners: a and b are the same node, seen from both sides of a facet of no slit
    joined = np.flatnonzero((table.second >= 0) & ~np.isin(table.keys, slit))
    a, b = (
        np.concatenate([corners(cell[joined], nodes) for nodes in table.facets[joined].T])
        for cell in (table.first, table.second)
    )
    corner_set = connected_components(
        sparse.coo_array((np.ones(len(a), dtype=bool), (a, b)), shape=(cells.size, cells.size))
    )[1]
    # each connected set of corners at a node of a slit gets a node; elsewhere all corners stay together
    node = cells.ravel()
    corner_set = np.where(at_slit[node], corner_set, cells.size)
    new, doubled_nodes = doubled(corner_set, node, n_nodes)
    opened_elements = np.array(elements)
    opened_facets = np.array(facets)
    opened_elements[near] = new.reshape(cells.shape)
    # facets take the nodes of the element on their inner side
    touched = np.flatnonzero(at_slit[facets].any(axis=1))
    row = table.find(keys[touched])
    inner_elements = np.where(
        same_orientation(facets[touched], table.facets[row]), table.first[row], table.second[row]
    )
    opened_facets[touched] = np.stack(
        [new[corners(inner_elements, nodes)] for nodes in facets[touched].T], axis=1
    )
    origin = np.concatenate([np.arange(n_nodes), doubled_nodes])
    # a facet that still stands twice did not open
    closed, counts = np.unique(facet_keys(opened_facets, len(origin)), return_counts=True)
    is_open = ~np.isin(facet_keys(opened_facets, len(origin)), closed[counts > 1])
    return opened_elements, opened_facets, is_open, origin


def opened_tables(
    right: Mapping[str, str],
    normals: Mapping[str, np.ndarray],
    points: np.ndarray,
    elements: np.ndarray,
    facets: np.ndarray,
    labels: np.ndarray,
    names: Sequence[str],
    body: np.ndarray,
    bodies: Sequence[str],
) -> tuple:
    """Return Netgen's tables with cracks opened: points, elements, facets, the label of each facet and the
    names of labels, the body of each element and the names of bodies.

    ``right`` has the names of the right faces by those of the left ones, and ``normals`` outward normals
    of the left faces. Facets that would stay closed are cut at their middles first."""
    elements = positive(points, elements)
    left_labels = [names.index(name) for name in right]
    crack = np.isin(labels, left_labels)
    # each facet of a crack once, oriented as the left face
    once = np.unique(facet_keys(facets[crack], len(points)), return_index=True)[1]
    faces = facets[crack][once]
    left = labels[crack][once]
    outward = np.array([normals[names[int(label)]] for label in left])
    faces_outward = np.einsum("nd,nd->n", Surface(points, faces).vectors, outward) > 0
    faces = np.where(faces_outward[:, None], faces, faces[:, ::-1])
    facets = facets[~crack]
    labels = labels[~crack]
    # until no facet stays closed: each time at least one facet is cut, and opens
    while True:
        every = np.concatenate([facets, faces, faces[:, ::-1]])
        opened_elements, sides, is_open, origin = opened(elements, every, len(points))
        if is_open.all():
            break
        closed = np.flatnonzero(~is_open[len(facets) : len(facets) + len(faces)])
        points, elements, faces, left, body = _cut_middles(
            points, elements, faces, left, body, closed
        )
    right_label = {label: len(names) + k for k, label in enumerate(left_labels)}
    labels = np.concatenate([labels, left, [right_label[k] for k in left]]).astype(np.int64)
    return points[origin], opened_elements, sides, labels, [*names, *right.values()], body, bodies


def _cut_middles(
    points: np.ndarray,
    elements: np.ndarray,
    faces: np.ndarray,
    labels: np.ndarray,
    body: np.ndarray,
    closed: np.ndarray,
) -> tuple[np.ndarray, ...]:
    """Return the tables (points, elements, faces, and the labels of faces and bodies of elements) with a
    new node in the middle of the faces ``closed`` (n,), which cuts them and the elements on both sides
    in dim parts.

    A facet is closed if all its nodes are at tips of the slit, where nodes stay single: its two sides
    share them. The new node is not at a tip: :func:`opened` doubles it. Of closed facets of the same
    element only the first is cut; the others wait for the next round."""
    table = facet_table(elements, len(points))
    row = table.find(facet_keys(faces[closed], len(points)))
    # the two elements (n, 2) at each facet; an element is cut by the first facet that names it
    cells = np.stack([table.first[row], table.second[row]], axis=1)
    is_first_place = mask_of(np.unique(cells, return_index=True)[1], cells.size)
    cuttable = is_first_place.reshape(cells.shape).all(axis=1)
    closed = closed[cuttable]
    old = cells[cuttable].ravel()
    corners = faces[closed]
    middle = len(points) + np.arange(len(closed))[:, None]
    # in part k of a facet (dim,), and of both elements there (dim + 1,), the new node stands for corner k
    new_faces = [np.delete(faces, closed, axis=0)]
    new_elements = [np.delete(elements, old, axis=0)]
    for corner in corners.T[:, :, None]:
        new_faces.append(np.where(corners == corner, middle, corners))
        in_both = elements[old] == np.repeat(corner, 2, axis=0)
        new_elements.append(np.where(in_both, np.repeat(middle, 2, axis=0), elements[old]))
    n_parts = corners.shape[1]
    return (
        np.concatenate([points, points[corners].mean(axis=1)]),
        np.concatenate(new_elements),
        np.concatenate(new_faces),
        np.concatenate([np.delete(labels, closed), *[labels[closed]] * n_parts]),
        np.concatenate([np.delete(body, old), *[body[old]] * n_parts]),
    )


def split(mesh: MeshArrays, facets: ArrayLike, name: str = "crack") -> MeshArrays:
    """Cut a mesh open along facets inside it.

    Parameters
    ----------
    mesh : MeshArrays
    facets : (n, dim) array of int
        Nodes of facets between two elements, also of two bodies that share nodes, oriented as
        outward facets of the left face: in 2D along the path, in 3D counter-clockwise as seen from
        the right.
    name : str
        The new boundaries are called "name.left" and "name.right".

    Returns
    -------
    MeshArrays
        With its old nodes first, then one more for each node that the slit doubles; nodes at its
        tips (in 3D along its front) stay single, and so does a facet that has all its nodes there.

    Raises
    ------
    TypeError, ValueError
        Where facets are not inside the mesh, nothing opens, or the body falls apart.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 4)
    >>> cracked = am.mesh.split(mesh, [[11, 12], [12, 13]])
    >>> cracked.n_nodes - mesh.n_nodes, cracked.boundaries[-2:]
    (1, ('crack.left', 'crack.right'))
    """
    check_mesh(mesh)
    along = checks.array("facets", facets, (None, mesh.dim), integer=True)
    if not len(along) or along.min() < 0 or along.max() >= mesh.n_nodes:
        raise ValueError(
            f"facets must hold nodes from 0 to {mesh.n_nodes - 1}, a row a facet, got "
            f"{checks.shown(facets)}"
        )
    names = tuple(f"{checks.boundary_name('name', name)}.{side}" for side in ("left", "right"))
    if taken := sorted(set(names) & set(mesh.boundaries)):
        raise ValueError(f"name: the mesh has a boundary {taken[0]!r} already")
    every = np.concatenate([mesh.facets, along, along[:, ::-1]])
    first = len(mesh.boundaries)
    labels = np.concatenate([mesh.facet_labels, np.repeat([first, first + 1], len(along))])
    elements, sides, is_open, origin = opened(mesh.elements, every, mesh.n_nodes)
    if not is_open[len(mesh.facets) :].any():
        raise ValueError(
            "facets: nothing opens, as all their nodes are at tips; a crack needs two edges at least"
        )
    cut = replace(
        mesh,
        points=mesh.points[origin],
        elements=elements,
        facets=sides[is_open],
        facet_labels=labels[is_open],
        boundaries=(*mesh.boundaries, *names),
    )
    return sound_by_construction(check_mesh(cut))
