"""SizeField: sizes at the nodes of a mesh as a function of position, body by body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.geometry.location import SimplexLocator
from adaptmg.mesh.arrays import MeshArrays

__all__ = ["SizeField"]


@dataclass(frozen=True, eq=False)
class SizeField:
    """Sizes between the nodes of a mesh: linear on each element, outside those of the nearest point of the mesh.

    Parameters
    ----------
    mesh : MeshArrays
    sizes : (n_nodes,) array
        Wanted edge lengths at its nodes, m, > 0.
    """

    mesh: MeshArrays
    sizes: np.ndarray

    def __post_init__(self) -> None:
        sizes = np.array(self.sizes, dtype=np.float64)
        if sizes.shape != (self.mesh.n_nodes,):
            raise ValueError(f"sizes must have shape ({self.mesh.n_nodes},), one for each node of mesh, got "
                             f"{sizes.shape}")
        if not (sizes > 0).all() or not np.isfinite(sizes).all():
            i = int(np.argmin(np.where(np.isfinite(sizes), sizes, -np.inf)))
            raise ValueError(f"sizes must be finite and > 0, got {sizes[i]} at node {i}")
        sizes.flags.writeable = False
        object.__setattr__(self, "sizes", sizes)
        object.__setattr__(self, "_locators", {})

    def __call__(self, points: np.ndarray, body: str | None = None) -> np.ndarray:
        """Sizes (n,), m, at points (n, dim) of a body; ``body`` may be left out where there is one only."""
        mesh = self.mesh
        if body is None and len(mesh.bodies) > 1:
            raise ValueError(f"body must be one of {', '.join(map(repr, mesh.bodies))}: where bodies touch, a point "
                             "lies in both")
        if body is not None and body not in mesh.bodies:
            raise ValueError(f"body: no body {body!r}; the bodies are {', '.join(map(repr, mesh.bodies))}")
        if body not in self._locators:
            chosen = None if body is None else np.flatnonzero(mesh.element_body == mesh.bodies.index(body))
            self._locators[body] = SimplexLocator(mesh.points, mesh.elements, chosen)
        found = self._locators[body].locate(points)
        return np.einsum("ij,ij->i", found.weights, self.sizes[mesh.elements[found.element]])

    def samples(self, dense: bool = False) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """What a mesher is told at once: by body, points (n, dim), m, and the sizes (n,) there, m.

        Parameters
        ----------
        dense : bool
            Nodes and centroids, and where ``dense`` the points halfway between each centroid and its corners too.
        """
        mesh, k = self.mesh, self.mesh.elements.shape[1]
        centre = np.full((1, k), 1 / k)
        weights = np.concatenate([centre, 0.5 * (centre + np.eye(k))]) if dense else centre
        result = {}
        for index, body in enumerate(mesh.bodies):
            elements = mesh.elements[mesh.element_body == index]
            nodes = np.unique(elements)
            inner = (weights @ mesh.points[elements]).reshape(-1, mesh.dim)
            result[body] = (np.concatenate([mesh.points[nodes], inner]),
                            np.concatenate([self.sizes[nodes], (self.sizes[elements] @ weights.T).ravel()]))
        return result
