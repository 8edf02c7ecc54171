"""normalised: from raw tables, as mesh files hold them, to MeshArrays with every orientation as it should be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.topology import facet_keys, facet_table

__all__ = ["normalised"]


def normalised(points: np.ndarray, elements: np.ndarray, facets: np.ndarray, facet_index: np.ndarray,
               facet_names: Sequence[str], body_index: np.ndarray, body_names: Sequence[str]) -> MeshArrays:
    """MeshArrays from raw tables.

    Elements are oriented positively, in whatever order their nodes are given (whether the mesh is folded over is seen
    from where neighbours lie, by :func:`adaptmg.mesh.check_mesh`), boundary facets outwards; points of no element,
    facets between two elements and names of nothing are dropped; what has the same name becomes one boundary or body.
    The order of nodes, elements and facets is kept.

    Parameters
    ----------
    points : (n_points, dim) array
        m.
    elements : (n_elements, dim + 1) array of int
        In any orientation.
    facets : (n_facets, dim) array of int
        In any orientation; may hold facets inside the mesh.
    facet_index, body_index : (n_facets,), (n_elements,) array of int
        Index into the names.
    facet_names, body_names : sequence of str
        Names, possibly repeated or unused.

    Returns
    -------
    MeshArrays
        Without source and not yet checked, see :func:`adaptmg.mesh.with_source`.

    Raises
    ------
    ValueError
        If there are no elements, or nodes out of range.
    """
    if len(elements) == 0:
        raise ValueError("the mesh has no elements")
    for name, array in (("elements", elements), ("facets", facets)):
        if len(array) and (array.min() < 0 or array.max() >= len(points)):
            raise ValueError(f"{name} name nodes {array.min()} to {array.max()}, there are {len(points)} "
                             "(counted from 0)")
    dim = points.shape[1]
    corners = points[elements]
    negative = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    elements = np.array(elements)
    elements[negative, -2:] = elements[negative, :-3:-1]
    number = np.full(len(points), -1, dtype=np.int64)
    used = np.unique(elements)
    number[used] = np.arange(len(used))
    points, elements = points[used], number[elements]
    facets = number[np.reshape(facets, (-1, dim))]
    facet_index = np.asarray(facet_index)[(facets >= 0).all(axis=1)]
    facets = facets[(facets >= 0).all(axis=1)]
    table = facet_table(elements, len(points))
    row = table.find(facet_keys(facets, len(points)))
    outer = (row >= 0) & (table.counts[row] == 1)
    boundaries, labels = _merged(facet_index[outer], facet_names)
    bodies, element_body = _merged(np.asarray(body_index), body_names)
    return MeshArrays(points, elements, table.facets[row[outer]], labels, boundaries, element_body, bodies)


def _merged(index: np.ndarray, names: Sequence[str]) -> tuple[tuple[str, ...], np.ndarray]:
    """The distinct names that are used, in their order, and the index into them."""
    used = np.unique(index)
    distinct = tuple(dict.fromkeys(names[i] for i in used))
    new = np.full(len(names), -1)
    for i in used:
        new[i] = distinct.index(names[i])
    return distinct, new[index]
