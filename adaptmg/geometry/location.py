"""Point location: which element holds a point, with which barycentric weights, and how far outside it lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.geometry.box_tree import BoxTree, padded
from adaptmg.geometry.location_kernels import affine_maps, locate
from adaptmg.geometry.morton import morton_order
from adaptmg.runtime.compiled import read_only

__all__ = ["Location", "SimplexLocator"]


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


class SimplexLocator:
    """Finds points in a mesh of simplices; build once, then ask as often as you like.

    Every point is found. The cost of a point is nearly the same for any number of elements and any grading, see
    :mod:`adaptmg.geometry.box_tree`. A point on a node or an edge belongs to one of the elements there: its
    interpolation weights do not depend on which.

    Parameters
    ----------
    points : (n_nodes, dim) array
        m.
    elements : (n, dim + 1) array of int
        Triangles or tetrahedra.
    chosen : (k,) array of int, optional
        Look only at these elements. Default: all.

    Raises
    ------
    ValueError
        No elements, or one without volume.
    """

    def __init__(self, points: np.ndarray, elements: np.ndarray, chosen: np.ndarray | None = None) -> None:
        chosen = np.arange(len(elements)) if chosen is None else chosen
        if len(chosen) == 0:
            raise ValueError("mesh: there are no elements to look at")
        self.dim, self.n_nodes = points.shape[1], len(points)
        self.tree = BoxTree(points, elements[chosen])
        self.element_of = chosen[self.tree.order].astype(np.int32)
        self.maps = np.empty((len(chosen), self.dim * (self.dim + 1)))
        affine_maps(self.tree.points, read_only(self.tree.simplices), self.maps)
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
