r"""Displacement and MeanDisplacement: a component at points, or its mean over a boundary.

.. math:: J(u) = u_k(x), \qquad J(u) = \frac1{|\Gamma|} \int_\Gamma u_k .
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adaptmg.discretisation.facets import area_vectors, named_facets, shape_integrals
from adaptmg.estimate.goals.view import Functional, GoalView
from adaptmg.geometry.location import Location
from adaptmg.problem import check_arrays, checks
from adaptmg.transfer import PointLocator

__all__ = ["Displacement", "MeanDisplacement", "axis_number"]

_AXES = {"x": 0, "y": 1, "z": 2}
#: how far outside its element a point may lie, over the size of the element
_OUTSIDE = 1e-6


def axis_number(name: str, value: int | str, dim: int | None = None) -> int:
    """The number of a component given as 0, 1, 2 or "x", "y", "z"."""
    if isinstance(value, str) and value not in _AXES:
        raise ValueError(f"{name} must be 'x', 'y', 'z' or 0, 1, 2, got {checks.shown(value)}")
    number = _AXES[value] if isinstance(value, str) else checks.integer(name, value, 0, 2)
    if dim is not None and number >= dim:
        raise ValueError(f"{name} is {value!r}, but the problem is {dim}D")
    return number


@dataclass(frozen=True)
class Displacement:
    """A component of the displacement at one point or several; each point is a quantity of its own.

    Parameters
    ----------
    points : (dim,) or (n, dim) array-like
        m.
    component : int or str
        0, 1, 2 or "x", "y", "z".
    body : str, optional
        Of which body; where two touch, a point lies in both.
    """

    points: Sequence[float] | Sequence[Sequence[float]]
    component: int | str
    body: str | None = None

    def __post_init__(self) -> None:
        try:
            shape = np.shape(self.points)
        except ValueError:
            raise ValueError("points must all have 2 or all have 3 coordinates, got "
                             f"{checks.shown(self.points)}") from None
        points = [] if 0 in shape else check_arrays.array("points", [self.points] if len(shape) == 1 else self.points,
                                                          (None, None))
        if not len(points) or points.shape[1] not in (2, 3):
            raise ValueError(f"points must hold at least one point of 2 or 3 coordinates, got shape {shape}")
        object.__setattr__(self, "points", tuple(tuple(float(c) for c in point) for point in points))
        axis_number("component", self.component)
        if self.body is not None:
            checks.boundary_name("body", self.body)

    def functionals(self, view: GoalView) -> list[Functional]:
        """One functional a point."""
        mesh = view.posed.mesh
        k, points = axis_number("component", self.component, mesh.dim), np.array(self.points)
        if points.shape[1] != mesh.dim:
            raise ValueError(f"points have {points.shape[1]} coordinates in a {mesh.dim}D problem")
        found, u = self._located(view, points), view.posed.result.displacement
        result = []
        for i, point in enumerate(self.points):
            element, weights = found.element[i], found.weights[i]
            nodal = np.zeros(mesh.points.shape)
            nodal[mesh.elements[element], k] = weights
            bubbles = np.zeros((len(view.bubbles.edges), mesh.dim))
            bubbles[view.bubbles.element_edges[element], k] = view.bubbles.values_at(weights)
            name = f"u_{'xyz'[k]} at ({', '.join(f'{c:g}' for c in point)})"
            value = float(weights @ u[mesh.elements[element], k])
            result.append(Functional(name, value, "m", view.load_of(nodal), bubbles))
        return result

    def _located(self, view: GoalView, points: np.ndarray) -> Location:
        mesh = view.posed.mesh
        if self.body is not None and self.body not in mesh.bodies:
            raise ValueError(f"body {self.body!r} does not exist{checks.suggestion(self.body, mesh.bodies)}; the "
                             f"bodies are {', '.join(mesh.bodies)}")
        found = PointLocator(mesh, None if self.body is None else mesh.bodies.index(self.body)).locate(points)
        outside = found.distance > _OUTSIDE * mesh.element_sizes[found.element]
        if outside.any():
            i = int(np.argmax(outside))
            raise ValueError(f"points: {self.points[i]} lies {found.distance[i]:.3g} m outside the mesh")
        return found


@dataclass(frozen=True)
class MeanDisplacement:
    """The mean of a component of the displacement over a boundary (axisymmetric: weighted with the radius).

    Parameters
    ----------
    boundary : str
    component : int or str
        0, 1, 2 or "x", "y", "z".
    """

    boundary: str
    component: int | str

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)
        axis_number("component", self.component)

    def functionals(self, view: GoalView) -> list[Functional]:
        """One functional."""
        mesh, axisymmetric = view.posed.mesh, view.bubbles.axisymmetric
        k = axis_number("component", self.component, mesh.dim)
        facets = named_facets(mesh, self.boundary)
        areas = np.linalg.norm(area_vectors(mesh.points, facets), axis=1)
        shares = areas[:, None] * shape_integrals(mesh.points, facets, axisymmetric)
        size = shares.sum()
        nodal = np.zeros(mesh.points.shape)
        np.add.at(nodal[:, k], facets, shares / size)
        bubbles = np.zeros((len(view.bubbles.edges), mesh.dim))
        bubbles[:, k] = view.bubbles.boundary_work(facets, np.ones((*facets.shape, 1)))[:, 0] / size
        value = float(np.sum(nodal * view.posed.result.displacement))
        return [Functional(f"mean u_{'xyz'[k]} on {self.boundary!r}", value, "m", view.load_of(nodal), bubbles)]
