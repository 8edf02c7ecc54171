"""Arrays to an NGSolve mesh and back, node numbers kept, no loop over elements.

normalised: from raw tables, as mesh files hold them, to MeshArrays with every orientation as it should be.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from adaptmg.mesh.arrays import MeshArrays, facet_keys, facet_table
from adaptmg.mesh.soundness import check_stranger

if TYPE_CHECKING:
    import ngsolve

__all__ = ["from_ngsolve", "ngsolve_mesh", "normalised", "to_ngsolve"]

# Netgen's types of triangles and tetrahedra of second order
_CURVED = (12, 21)


def to_ngsolve(points: np.ndarray, elements: np.ndarray, facets: np.ndarray, facet_labels: np.ndarray,
               boundaries: Sequence[str], *, element_body: np.ndarray | None = None,
               bodies: Sequence[str] = ("body",)) -> ngsolve.Mesh:
    """Build an NGSolve mesh from arrays, as :class:`MeshArrays` describes them.

    Parameters
    ----------
    points : (n_nodes, dim) array
        m, dim 2 or 3.
    elements : (n_elements, dim + 1) array of int
        Positively oriented.
    facets : (n_facets, dim) array of int
        Boundary facets, normal outwards: NGSolve takes the sign of its normals from them.
    facet_labels : (n_facets,) array of int
        Index into ``boundaries``.
    boundaries : sequence of str
        Boundary names.
    element_body : (n_elements,) array of int, optional
        Index into ``bodies``.
    bodies : sequence of str
        Material names.

    Returns
    -------
    ngsolve.Mesh
        Its nodes, elements and boundary elements have the numbers of the arrays; it has no geometry, so it stays
        straight when refined.

    Raises
    ------
    ValueError
        On wrong shapes, or numbers out of range (which would crash NGSolve).
    """
    import netgen.meshing
    import ngsolve

    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise ValueError(f"points must have shape (n, 2) or (n, 3), got {points.shape}")
    dim = points.shape[1]
    elements = _table("elements", elements, dim + 1, len(points))
    facets = _table("facets", facets, dim, len(points))
    labels = _labels("facet_labels", facet_labels, len(facets), len(boundaries))
    body = np.zeros(len(elements)) if element_body is None else element_body
    body = _labels("element_body", body, len(elements), len(bodies))

    mesh = netgen.meshing.Mesh(dim=dim)
    mesh.AddPoints(np.ascontiguousarray(np.pad(points, ((0, 0), (0, 3 - dim)))))
    for i in range(len(bodies if dim == 2 else boundaries)):
        mesh.Add(netgen.meshing.FaceDescriptor(surfnr=i + 1, domin=i + 1 if dim == 2 else 1, domout=0, bc=i + 1))
    for i, name in enumerate(bodies):
        mesh.SetMaterial(i + 1, name)
    if dim == 3:
        # Netgen counts the other orientation of tetrahedra as positive
        elements = np.ascontiguousarray(elements[:, [0, 1, 3, 2]])
    mesh.AddElements(dim=dim, index=1, data=elements, base=0)
    mesh.AddElements(dim=dim - 1, index=1, data=facets, base=0)
    volume, surface = ((mesh.Elements2D(), mesh.Elements1D()) if dim == 2 else (mesh.Elements3D(), mesh.Elements2D()))
    volume.NumPy()["index"] = body + 1
    surface.NumPy()["index"] = labels + 1
    for i, name in enumerate(boundaries):
        mesh.SetBCName(i, name)
    return ngsolve.Mesh(mesh)


def _table(name: str, array: np.ndarray, width: int, n_nodes: int) -> np.ndarray:
    table = np.ascontiguousarray(array, dtype=np.int32)
    if table.ndim != 2 or table.shape[1] != width or len(table) == 0:
        raise ValueError(f"{name} must have shape (n, {width}) with n > 0, got {table.shape}")
    if table.min() < 0 or table.max() >= n_nodes:
        raise ValueError(f"{name} must be node numbers from 0 to {n_nodes - 1}, got {table.min()} to {table.max()}")
    return table


def _labels(name: str, array: np.ndarray, n: int, n_names: int) -> np.ndarray:
    labels = np.asarray(array, dtype=np.int32)
    if labels.shape != (n,):
        raise ValueError(f"{name} must have shape ({n},), got {labels.shape}")
    if labels.min() < 0 or labels.max() >= n_names:
        raise ValueError(f"{name} must index {n_names} names, got {labels.min()} to {labels.max()}")
    return labels


def ngsolve_mesh(mesh: MeshArrays) -> ngsolve.Mesh:
    """A new ``ngsolve.Mesh`` of checked arrays."""
    return to_ngsolve(mesh.points, mesh.elements, mesh.facets, mesh.facet_labels, mesh.boundaries,
                      element_body=mesh.element_body, bodies=mesh.bodies)


def from_ngsolve(mesh: ngsolve.Mesh) -> MeshArrays:
    """Read an NGSolve mesh.

    Parameters
    ----------
    mesh : ngsolve.Mesh
        Straight triangles or tetrahedra. Materials become bodies, those with the same name one body; boundaries inside
        the mesh (interfaces of glued materials) are left out.

    Returns
    -------
    MeshArrays
        Copies: refining ``mesh`` later changes nothing here. The nodes keep their numbers unless some belong to no
        element (these are dropped). ``source`` is a straight mesh of its own with the same node numbers.

    Raises
    ------
    TypeError
        If it is no NGSolve mesh.
    ValueError
        On other elements, curved or of second order, a deformation, periodic boundaries, dimensions other than 2 and 3,
        or a mesh that is not sound (:func:`adaptmg.mesh.check_mesh`).
    """
    import ngsolve

    from adaptmg.mesh.netgen_worker import tables

    if not isinstance(mesh, ngsolve.Mesh):
        raise TypeError(f"mesh must be an ngsolve.Mesh, got {type(mesh).__name__}")
    types = np.concatenate([table.NumPy()["type"] for table in (mesh.ngmesh.Elements2D(), mesh.ngmesh.Elements3D())])
    order = 2 if np.isin(types, _CURVED).any() else mesh.GetCurveOrder()
    if order > 1:
        raise ValueError(f"mesh has curved elements (order {order}), bodies are made of straight ones: give the mesh "
                         "before SecondOrder() and Curve(), finer where its boundary is curved")
    if mesh.deformation is not None:
        raise ValueError("mesh has a deformation, which would be left out: call mesh.UnsetDeformation(), or move the "
                         "nodes")
    if mesh.ngmesh.GetIdentifications():
        raise ValueError("mesh has identified nodes (periodic boundaries), which a contact problem does not know: make "
                         "it without them")
    return check_stranger(normalised(*tables(mesh.ngmesh, mesh.GetBoundaries(), mesh.GetMaterials())))


def normalised(points: np.ndarray, elements: np.ndarray, facets: np.ndarray, facet_index: np.ndarray,
               facet_names: Sequence[str], body_index: np.ndarray, body_names: Sequence[str]) -> MeshArrays:
    """MeshArrays from raw tables."""
    if len(elements) == 0:
        raise ValueError("the mesh has no elements")
    for name, array in (("elements", elements), ("facets", facets)):
        if len(array) and (array.min() < 0 or array.max() >= len(points)):
            raise ValueError(f"{name} name nodes {array.min()} to {array.max()}, there are {len(points)} "
                             "(counted from 0)")
    if not np.isfinite(points).all():
        raise ValueError(f"points must be finite, node {int(np.argmin(np.isfinite(points).all(axis=1)))} is not")
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
