"""What a picture of deformed bodies shows: which elements, where they were and are, and in what colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import Normalize

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.topology import facet_table
from adaptmg.plot.style import BODY_COLORS, bounds, scaled
from adaptmg.problem import check_arrays, checks
from adaptmg.solver.result import Result

__all__ = ["Coloring", "DrawnBody", "Scene", "automatic_factor", "make_scene"]


@dataclass(frozen=True)
class Coloring:
    """Values to colour by.

    Attributes
    ----------
    values : (n_nodes,) or (n_elements,) array
        In the unit of the label.
    label : str
        Of the colour bar.
    norm : matplotlib Normalize
    """

    values: np.ndarray
    label: str
    norm: Normalize


@dataclass(frozen=True)
class DrawnBody:
    """One body, or the part of it within a window.

    Attributes
    ----------
    name, color : str
    elements : (n,) int array
        Its elements shown.
    facets : (m, dim) int array
        Nodes of their boundary, outward.
    behind : (m,) int array
        The element behind each facet.
    """

    name: str
    color: str
    elements: np.ndarray
    facets: np.ndarray
    behind: np.ndarray


@dataclass(frozen=True)
class Scene:
    """Bodies in plot units.

    Attributes
    ----------
    result : Result
    before, after : (n_nodes, dim) arrays
        Positions, the displacement amplified, in ``unit``.
    unit : str
    shapes : tuple of DrawnBody
        Large bodies first.
    lower, upper : (dim,) arrays
        Corners of what is to be seen.
    coloring : Coloring or None
        None for a colour a body.
    """

    result: Result
    before: np.ndarray
    after: np.ndarray
    unit: str
    shapes: tuple[DrawnBody, ...]
    lower: np.ndarray
    upper: np.ndarray
    coloring: Coloring | None = None

    @property
    def n_elements(self) -> int:
        """Elements shown."""
        return sum(len(shape.elements) for shape in self.shapes)

    def states(self, boundary: int) -> np.ndarray:
        """States (n_nodes,) of the contact nodes of a boundary, given by its number; -1 elsewhere."""
        contact, states = self.result.contact, np.full(len(self.after), -1)
        mine = contact.boundary == boundary
        states[contact.node[mine]] = contact.state[mine]
        return states


def automatic_factor(result: Result) -> float:
    """A round factor that makes the largest displacement about 5 % of the size; 1 if nothing moves."""
    size = bounds(result.mesh.points)[2]
    largest = float(np.linalg.norm(result.displacement, axis=1).max())
    if not largest > 1e-12 * size:
        return 1.0
    wanted = 0.05 * size / largest
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * min((1, 2, 5, 10), key=lambda m: abs(np.log(m * power / wanted))))


def make_scene(result: Result, factor: float, bodies: Sequence[str] | None,
               window: tuple[float, float, float, float] | None, coloring: Coloring | None) -> Scene:
    """Choose bodies and elements, and place them.

    Parameters
    ----------
    result : Result
        With a mesh.
    factor : float
        Of the displacements.
    bodies : sequence of str or None
        Names of the bodies shown; None for all.
    window : (xmin, xmax, ymin, ymax) or None
        What is to be seen, m.
    coloring : Coloring or None
    """
    mesh = result.mesh
    chosen = _bodies(mesh, bodies)
    moved = mesh.points + factor * result.displacement
    seen = np.isin(mesh.element_body, chosen)
    if window is None:
        nodes = np.unique(mesh.elements[seen])
        lower, upper, _ = bounds(np.vstack([mesh.points[nodes], moved[nodes]]))
    else:
        lower, upper = _window(window, mesh.dim)
        seen &= _touches(mesh, mesh.points, lower, upper) | _touches(mesh, moved, lower, upper)
        if not seen.any():
            raise ValueError(f"window {tuple(window)} shows nothing: it is (xmin, xmax, ymin, ymax) in m, and the "
                             f"bodies lie between {mesh.points.min(axis=0)} and {mesh.points.max(axis=0)}")
    scale, unit = scaled(float(np.linalg.norm(upper - lower)), "m")
    shapes = [_shape(mesh, body, np.flatnonzero(seen & (mesh.element_body == body))) for body in chosen]
    shapes = [shape for shape in shapes if len(shape.elements)]
    shapes.sort(key=lambda shape: -float(np.abs(mesh.volumes[shape.elements]).sum()))
    return Scene(result, mesh.points * scale, moved * scale, unit, tuple(shapes), lower * scale, upper * scale,
                 coloring)


def _bodies(mesh: MeshArrays, names: Sequence[str] | None) -> list[int]:
    if names is None:
        return list(range(len(mesh.bodies)))
    names = (names,) if isinstance(names, str) else tuple(names)
    if not names:
        raise ValueError("bodies must name at least one body; None shows all")
    return [mesh.bodies.index(checks.choice("bodies", name, mesh.bodies)) for name in dict.fromkeys(names)]


def _window(window: tuple[float, float, float, float], dim: int) -> tuple[np.ndarray, np.ndarray]:
    if dim != 2:
        raise ValueError("window is for two dimensions: in 3D choose bodies=... and view=...")
    x0, x1, y0, y1 = check_arrays.vector("window", window, 4)
    if not (x0 < x1 and y0 < y1):
        raise ValueError(f"window must be (xmin, xmax, ymin, ymax) with xmin < xmax and ymin < ymax, got {window!r}")
    return np.array([x0, y0]), np.array([x1, y1])


def _touches(mesh: MeshArrays, points: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Elements (n_elements,) whose boxes meet a box, with a margin of a tenth so that nothing ends in sight."""
    corners, margin = points[mesh.elements], 0.1 * (upper - lower)
    return ((corners.min(axis=1) <= upper + margin) & (corners.max(axis=1) >= lower - margin)).all(axis=1)


def _shape(mesh: MeshArrays, body: int, elements: np.ndarray) -> DrawnBody:
    color = BODY_COLORS[body % len(BODY_COLORS)]
    if not len(elements):
        return DrawnBody(mesh.bodies[body], color, elements, np.empty((0, mesh.dim), int), np.empty(0, int))
    table = facet_table(mesh.elements[elements], mesh.n_nodes)
    outer = table.counts == 1
    return DrawnBody(mesh.bodies[body], color, elements, table.facets[outer], elements[table.first[outer]])
