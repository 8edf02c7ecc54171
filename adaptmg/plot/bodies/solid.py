"""Deformed solids: shaded surface triangles of all bodies, what is hidden hidden; sharp edges before and after."""

from __future__ import annotations

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import to_rgba_array
from mpl_toolkits.mplot3d import Axes3D

from adaptmg.plot.bodies.scene import DrawnBody, Scene
from adaptmg.plot.space.axes import finish_axes
from adaptmg.plot.space.surface import Lines, draw_facets, sharp_edges
from adaptmg.plot.states import STATE_INKS
from adaptmg.plot.style import GREY, INK

__all__ = ["draw"]


def draw(ax: Axes3D, scene: Scene, lines: bool | None, states: bool, view: tuple[float, float] | None) -> list[int]:
    """Draw a scene; returns the contact states drawn.

    Parameters
    ----------
    ax : matplotlib Axes3D
    scene : Scene
        Three-dimensional.
    lines : bool or None
        Whether to draw the edges of the triangles; None: where they would not blacken the picture.
    states : bool
        Whether facets of contact surfaces have the colour of the state of most of their nodes.
    view : (elevation, azimuth) or None
        Degrees.
    """
    facets = np.concatenate([shape.facets for shape in scene.shapes])
    colors = np.concatenate([_colors(scene, shape) for shape in scene.shapes])
    present: list[int] = []
    if states:
        code = _facet_states(scene, facets)
        present = sorted(set(code[code >= 0].tolist()))
        for state in present:
            colors[code == state] = to_rgba_array(STATE_INKS[state])
    edges = np.concatenate([sharp_edges(scene.before, shape.facets) for shape in scene.shapes])
    # all in one: triangles of different bodies hide each other only within one surface
    draw_facets(ax, scene.after[facets], colors, lines,
                (Lines(scene.before[edges], GREY, 0.9, (4.0, 3.0)), Lines(scene.after[edges], INK, 0.9)),
                0.28 if scene.coloring is None and not states else 0.14)
    finish_axes(ax, np.array([scene.lower, scene.upper]), scene.unit)
    if view is not None:
        ax.view_init(elev=view[0], azim=view[1])
    return present


def _colors(scene: Scene, shape: DrawnBody) -> np.ndarray:
    """Colours (n, 3, 4) of the corners of the facets."""
    coloring = scene.coloring
    if coloring is None:
        return np.tile(to_rgba_array(shape.color), (len(shape.facets), 3, 1))
    values = coloring.values
    nodal = len(values) == len(scene.after)
    shown = values[shape.facets] if nodal else np.repeat(values[shape.behind][:, None], 3, axis=1)
    return ScalarMappable(coloring.norm, "viridis").to_rgba(shown.ravel()).reshape(-1, 3, 4)


def _facet_states(scene: Scene, facets: np.ndarray) -> np.ndarray:
    """State of most corners (n,) of facets whose corners are all nodes of one contact boundary; -1 elsewhere."""
    found = np.full(len(facets), -1)
    for number in range(len(scene.result.contact.names)):
        corners = np.sort(scene.states(number)[facets], axis=1)
        # the middle one of three is that of the majority
        found = np.where(corners[:, 0] >= 0, corners[:, 1], found)
    return found
