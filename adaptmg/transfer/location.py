"""Points located in a mesh, and the nodes of a fine mesh in a coarse one, body by body."""

from __future__ import annotations

import numpy as np

from adaptmg.geometry.location import Location, SimplexLocator
from adaptmg.mesh.arrays import MeshArrays

__all__ = ["OUTSIDE_TOLERANCE", "PointLocator", "body_locators", "locate_nodes", "nodes_of_bodies"]

OUTSIDE_TOLERANCE = 0.25
"""How far outside the coarse mesh a fine node may lie, over the size of the nearest element. A chord of a curved
boundary misses the arc by less; different units, a shifted body or a missing part do not."""


class PointLocator(SimplexLocator):
    """Finds points in a mesh; see :class:`~adaptmg.geometry.location.SimplexLocator`.

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
        chosen = None if body is None else np.flatnonzero(mesh.element_body == body)
        if len(mesh.elements if chosen is None else chosen) == 0:
            whose = "mesh has no elements" if body is None else f"body {body} of the mesh has no elements"
            raise ValueError(f"mesh: {whose}")
        super().__init__(mesh.points, mesh.elements, chosen)
        self.mesh = mesh


def nodes_of_bodies(mesh: MeshArrays, name: str = "fine") -> np.ndarray:
    """Body of each node (n_nodes,), the first where bodies share one; ValueError if a node belongs to no element."""
    body = np.full(mesh.n_nodes, -1, dtype=np.int64)
    corners = mesh.elements.shape[1]
    body[mesh.elements.ravel()[::-1]] = np.repeat(mesh.element_body, corners)[::-1]
    if (body < 0).any():
        raise ValueError(f"{name}: node {np.argmax(body < 0)} belongs to no element; remove unused nodes")
    return body


def body_locators(coarse: MeshArrays, fine: MeshArrays, names: tuple[str, str] = ("coarse", "fine")
                  ) -> list[tuple[int | None, PointLocator]]:
    """Pairs of a body of ``fine`` (None: all of it) and the locator in the coarse mesh of the same body.

    Parameters
    ----------
    coarse, fine : MeshArrays
        The mesh to search and the mesh of the points.
    names : tuple of str
        What messages call them.

    Raises
    ------
    TypeError, ValueError
        No meshes; different dimensions; a body that only the fine mesh has.
    """
    for name, mesh in zip(names, (coarse, fine), strict=True):
        if not isinstance(mesh, MeshArrays):
            raise TypeError(f"{name} must be MeshArrays, got {type(mesh).__name__}")
    if coarse.dim != fine.dim:
        raise ValueError(f"{names[0]} and {names[1]} must have the same dimension, got {coarse.dim} and {fine.dim}")
    if len(fine.bodies) == len(coarse.bodies) == 1:
        return [(None, PointLocator(coarse))]
    pairs = []
    for index in np.unique(fine.element_body):
        body = fine.bodies[index]
        if body not in coarse.bodies:
            raise ValueError(f"{names[0]}: no body {body!r}, which {names[1]} has; its bodies are "
                             f"{', '.join(coarse.bodies)}")
        pairs.append((int(index), PointLocator(coarse, coarse.bodies.index(body))))
    return pairs


def locate_nodes(coarse: MeshArrays, fine: MeshArrays, outside_tolerance: float,
                 names: tuple[str, str] = ("coarse", "fine")) -> Location:
    """Locate every fine node in the coarse elements of its body.

    Parameters
    ----------
    coarse, fine : MeshArrays
        The mesh to search and the mesh of the points.
    outside_tolerance : float
        Largest distance from the coarse mesh allowed, over the size (longest edge) of the nearest coarse element.
    names : tuple of str
        What messages call the meshes.

    Raises
    ------
    ValueError
        A node lies further outside; names the node, its position and distance.
    """
    locators = body_locators(coarse, fine, names)
    element = np.empty(fine.n_nodes, dtype=np.int32)
    weights, distance = np.empty((fine.n_nodes, fine.dim + 1)), np.empty(fine.n_nodes)
    body_of = None if locators[0][0] is None else nodes_of_bodies(fine, names[1])
    for body, locator in locators:
        nodes = slice(None) if body is None else np.flatnonzero(body_of == body)
        found = locator.locate(fine.points[nodes])
        element[nodes], weights[nodes], distance[nodes] = found.element, found.weights, found.distance
    outside = np.flatnonzero(distance > 0)
    if not len(outside):
        return Location(element=element, weights=weights, distance=distance)
    relative = distance[outside] / coarse.element_sizes[element[outside]]
    if (relative > outside_tolerance).any():
        worst = int(np.argmax(relative))
        node = outside[worst]
        raise ValueError(
            f"{names[1]} node {node} at {tuple(float(c) for c in fine.points[node])} lies {distance[node]:.3g} m "
            f"outside the {names[0]} mesh, {relative[worst]:.3g} of the element size there (outside_tolerance is "
            f"{outside_tolerance:g}; {np.count_nonzero(relative > outside_tolerance)} nodes exceed it): do both meshes "
            f"describe the same body in the same units? If so, refine the {names[0]} mesh at the curved boundary or "
            "raise outside_tolerance")
    return Location(element=element, weights=weights, distance=distance)
