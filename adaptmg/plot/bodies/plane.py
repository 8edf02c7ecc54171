"""Deformed plane bodies: filled shapes, mesh lines, outlines before and after, states along the contact surfaces."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import PathPatch
from matplotlib.tri import Triangulation

from adaptmg.plot.bodies.scene import DrawnBody, Scene
from adaptmg.plot.states import halves
from adaptmg.plot.style import GREY, INK
from adaptmg.plot.walks import filled_path, walks

__all__ = ["draw", "draw_states"]


def draw(ax: Axes, scene: Scene, lines: bool) -> None:
    """Draw a scene.

    Parameters
    ----------
    ax : matplotlib Axes
    scene : Scene
        Two-dimensional.
    lines : bool
        Whether to draw the edges of the elements.
    """
    width = float(np.clip(12 / np.sqrt(scene.n_elements), 0.08, 0.6))
    for k, shape in enumerate(scene.shapes):
        rings = walks(shape.facets)
        _fill(ax, scene, shape, rings, width if lines else 0.0, zorder=2 + 0.1 * k)
        after = LineCollection([scene.after[ring] for ring in rings], color=INK, linewidth=1.0, zorder=3.6)
        before = LineCollection([scene.before[ring] for ring in rings], color=GREY, linewidth=0.8,
                                linestyle=(0, (4, 3)), zorder=3.5)
        ax.add_collection(after)
        ax.add_collection(before)
    margin = 0.0 if _zoomed(scene) else 0.03 * float(np.max(scene.upper - scene.lower))
    ax.set_aspect("equal")
    ax.set_xlim(scene.lower[0] - margin, scene.upper[0] + margin)
    ax.set_ylim(scene.lower[1] - margin, scene.upper[1] + margin)
    ax.spines[:].set_visible(_zoomed(scene))


def _zoomed(scene: Scene) -> bool:
    """Whether something shown lies outside what is to be seen."""
    nodes = np.unique(np.concatenate([shape.facets.ravel() for shape in scene.shapes]))
    points, slack = scene.after[nodes], 1e-9 * (scene.upper - scene.lower)
    return bool((points < scene.lower - slack).any() or (points > scene.upper + slack).any())


def _fill(ax: Axes, scene: Scene, shape: DrawnBody, rings: list[np.ndarray], width: float, zorder: float) -> None:
    elements, coloring = scene.result.mesh.elements[shape.elements], scene.coloring
    if coloring is None and width:
        ax.add_collection(PolyCollection(scene.after[elements], facecolor=shape.color, edgecolor=INK, linewidth=width,
                                         zorder=zorder))
        return
    if coloring is None:
        ax.add_patch(PathPatch(filled_path(scene.after, rings), facecolor=shape.color, edgecolor="none", zorder=zorder))
        return
    grid = Triangulation(*scene.after.T, elements)
    if len(coloring.values) == len(scene.after):
        ax.tripcolor(grid, coloring.values, norm=coloring.norm, cmap="viridis", shading="gouraud", rasterized=True,
                     zorder=zorder)
    else:
        ax.tripcolor(grid, facecolors=coloring.values[shape.elements], norm=coloring.norm, cmap="viridis",
                     rasterized=True, zorder=zorder)
    if width:
        ax.add_collection(PolyCollection(scene.after[elements], facecolor="none", edgecolor="white",
                                         linewidth=0.5 * width, zorder=zorder + 0.02))


def draw_states(ax: Axes, scene: Scene) -> list[int]:
    """Draw the contact surfaces of the shown bodies in the colours of their states; returns the states that occur.

    Each edge changes colour half way between its nodes; edges with a node that is no contact node are left out.
    """
    mesh = scene.result.mesh
    shown = np.unique(np.concatenate([shape.facets.ravel() for shape in scene.shapes]))
    present: set[int] = set()
    for number, name in enumerate(scene.result.contact.names):
        state = scene.states(number)
        facets = mesh.boundary_facets(name)
        facets = facets[(state[facets] >= 0).all(axis=1) & np.isin(facets, shown).all(axis=1)]
        for ring in walks(facets):
            segments, colors = halves(scene.after[ring], state[ring])
            ax.add_collection(LineCollection(segments, color="white", linewidth=4.2, capstyle="butt", zorder=4))
            ax.add_collection(LineCollection(segments, colors=colors, linewidth=2.8, capstyle="butt", zorder=4.1))
        present |= set(state[facets].ravel().tolist())
    return sorted(present)
