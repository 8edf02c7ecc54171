"""mesh_ratio: how much finer a mesh is than the next coarser one, element by element."""

from __future__ import annotations

import numpy as np

from adaptmg.mesh.arrays import MeshArrays, longest_edges
from adaptmg.problem import checks
from adaptmg.transfer.location import body_locators

__all__ = ["mesh_ratio", "size_ratio"]

#: elements in which size_ratio is measured: a quantile needs no more
_SAMPLE = 5000


def mesh_ratio(coarse: MeshArrays, fine: MeshArrays, *, quantile: float = 1.0) -> float:
    """Largest local ratio h_coarse / h_fine; two-level rates suffer above about 3.

    For each fine element: the longest edge of the coarse element that holds its centroid, over its own longest edge.
    (Centroids, as a fine node on an edge belongs to coarse elements of several sizes.)

    Parameters
    ----------
    coarse, fine : MeshArrays
    quantile : float
        1 takes the largest; .99 leaves out the hundredth of the fine elements with the largest ratios, in which a
        single flat element cannot hide what holds elsewhere.

    Returns
    -------
    float
    """
    if not 0 <= checks.number("quantile", quantile) <= 1:
        raise ValueError(f"quantile must lie in [0, 1], got {quantile!r}")
    locators = body_locators(coarse, fine)
    ratio = np.empty(len(fine.elements))
    for body, locator in locators:
        elements = slice(None) if body is None else np.flatnonzero(fine.element_body == body)
        found = locator.locate(fine.points[fine.elements[elements]].mean(axis=1))
        ratio[elements] = coarse.element_sizes[found.element] / fine.element_sizes[elements]
    return float(np.quantile(ratio, quantile))


def size_ratio(coarse: MeshArrays, fine: MeshArrays, quantile: float = 0.99) -> float:
    """Local ratio h_coarse / h_fine by which levels of an adaptive hierarchy are kept: at most about 4.

    Parameters
    ----------
    coarse, fine : MeshArrays
    quantile : float
        See :func:`mesh_ratio`, of which this is the 99 % quantile; of large meshes over every so-manieth element.

    Returns
    -------
    float
    """
    step, ratios = max(1, len(fine.elements) // _SAMPLE), []
    for body, locator in body_locators(coarse, fine):
        elements = np.arange(len(fine.elements)) if body is None else np.flatnonzero(fine.element_body == body)
        corners = fine.points[fine.elements[elements[::step]]]
        found = locator.locate(corners.mean(axis=1))
        ratios.append(coarse.element_sizes[found.element] / longest_edges(corners))
    return float(np.quantile(np.concatenate(ratios), quantile))
