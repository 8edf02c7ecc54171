"""Point location: which element holds a point, with which barycentric weights, and how far outside it lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.transfer.box_tree import BoxTree, padded
from adaptmg.transfer.location_kernels import affine_maps, locate
from adaptmg.transfer.morton import morton_order

__all__ = ["Location", "PointLocator"]


@dataclass(frozen=True, eq=False)
class Location:
    """Where points lie in a mesh.

    Attributes
    ----------
    element : (n,) int32 array
        Element that holds the point, or the nearest one.
    weights : (n, dim + 1) array
        Barycentric weights at the corners of that element, of the point or, for one outside, of the closest point of
        the mesh; >= 0, sums 1.
    distance : (n,) array
        0 inside, else the distance from the mesh, m.
    """

    element: np.ndarray
    weights: np.ndarray
    distance: np.ndarray


class PointLocator:
    """Finds points in a mesh; build once, then ask as often as you like.

    Every point is found. The cost of a point is nearly the same for any number of elements and any grading, see
    :mod:`adaptmg.transfer.box_tree`. A point on a node or an edge belongs to one of the elements there: its
    interpolation weights do not depend on which.

    Parameters
    ----------
    mesh : MeshArrays
        Triangles or tetrahedra.
    body : int, optional
        Look only at the elements of this body (index into ``mesh.bodies``): where two bodies touch, a point lies in
        both. Default: all elements.

    Raises
    ------
    TypeError, ValueError
        No MeshArrays; no elements (of that body); an element without volume.
    """

    def __init__(self, mesh: MeshArrays, body: int | None = None) -> None:
        if not isinstance(mesh, MeshArrays):
            raise TypeError(f"mesh must be MeshArrays, got {type(mesh).__name__}")
        chosen = (np.arange(len(mesh.elements)) if body is None else np.flatnonzero(mesh.element_body == body))
        if len(chosen) == 0:
            whose = "mesh has no elements" if body is None else f"body {body} of the mesh has no elements"
            raise ValueError(f"mesh: {whose}")
        self.mesh, self.dim = mesh, mesh.dim
        self.tree = BoxTree(mesh.points, mesh.elements[chosen])
        self.element_of = chosen[self.tree.order].astype(np.int32)
        self.maps = np.empty((len(chosen), self.dim * (self.dim + 1)))
        affine_maps(self.tree.points, self.tree.simplices, self.maps)
        if not np.isfinite(self.maps.sum()) and (bad := ~np.isfinite(self.maps).all(axis=1)).any():
            raise ValueError(f"mesh: element {self.element_of[np.argmax(bad)]} has no volume; remove degenerate "
                             "elements")

    def locate(self, points: np.ndarray) -> Location:
        """Find points.

        Parameters
        ----------
        points : (n, dim) array
            m.

        Returns
        -------
        Location

        Raises
        ------
        ValueError
            Wrong shape, or coordinates that are not finite.
        """
        queries = np.asarray(points, dtype=np.float64)
        if queries.ndim != 2 or queries.shape[1] != self.dim:
            raise ValueError(f"points must have shape (n, {self.dim}), got {queries.shape}")
        if not np.isfinite(queries).all():
            raise ValueError(f"points must be finite; point {np.argmin(np.isfinite(queries).all(axis=1))} is not")
        n = len(queries)
        found = np.empty(n, dtype=np.int64)
        weights, distance = np.empty((n, self.dim + 1)), np.empty(n)
        locate(padded(queries), morton_order(queries), self.tree.points, self.tree.simplices, self.maps,
               self.tree.boxes, found, weights, distance)
        return Location(element=self.element_of[found], weights=weights, distance=distance)
