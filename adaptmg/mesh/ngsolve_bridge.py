"""to_ngsolve: arrays to an NGSolve mesh, node numbers kept, no loop over elements."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from adaptmg.mesh.arrays import MeshArrays

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

    arrays = MeshArrays(points, elements, facets, facet_labels, tuple(boundaries), element_body, tuple(bodies))
    points, elements, dim = arrays.points, arrays.elements, arrays.dim
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
    mesh.AddElements(dim=dim - 1, index=1, data=arrays.facets, base=0)
    volume, surface = ((mesh.Elements2D(), mesh.Elements1D()) if dim == 2 else (mesh.Elements3D(), mesh.Elements2D()))
    volume.NumPy()["index"] = arrays.element_body + 1
    surface.NumPy()["index"] = arrays.facet_labels + 1
    for i, name in enumerate(boundaries):
        mesh.SetBCName(i, name)
    return ngsolve.Mesh(mesh)
