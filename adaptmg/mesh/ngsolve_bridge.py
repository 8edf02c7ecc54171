"""to_ngsolve: arrays to an NGSolve mesh, node numbers kept, no loop over elements."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import ngsolve


def to_ngsolve(points: np.ndarray, elements: np.ndarray, facets: np.ndarray, facet_labels: np.ndarray,
               boundaries: Sequence[str], *, element_body: np.ndarray | None = None,
               bodies: Sequence[str] = ("body",)) -> ngsolve.Mesh:
    """Build an NGSolve mesh from the arrays of a :class:`MeshArrays`; bodies become materials.

    Nodes, elements and boundary elements have the numbers of the arrays; the mesh has no geometry, so it stays straight
    when refined. ValueError on wrong shapes, or numbers out of range (which would crash NGSolve).
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
