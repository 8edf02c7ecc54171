"""deformation: bodies after loading over their outlines before, by body, displacement or stress."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.tri import Triangulation

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg.plot import surfaces
from adaptmg.plot.style import (
    GREY,
    INK,
    axis_names,
    canvas,
    filled_path,
    halves,
    number,
    plain,
    scaled,
    state_lines,
    styled,
    walks,
)
from adaptmg.plot.surfaces import Coloring, DrawnBody, Scene, automatic_factor, make_scene
from adaptmg.solver.result import Result

__all__ = ["deformation"]


#: elements above which their edges would only blacken the picture
_LINES_UP_TO = 8000


@styled
def deformation(result: Result, amplify: float | None = None, *, stress: bool = False, displacement: bool = False,
                states: bool = False, window: tuple[float, float, float, float] | None = None,
                bodies: Sequence[str] | None = None, lines: bool | None = None,
                view: tuple[float, float] | None = None, ax: Axes | None = None) -> Figure:
    """Draw the deformed bodies, each in its own colour, over their outlines before; the title says the amplification.

    Amplified bodies seem to overlap where an initial gap has closed, and to part where they only slid: ``amplify=1``
    is true to scale.

    Parameters
    ----------
    result : Result
        With a mesh.
    amplify : float, optional
        Factor of the displacements, >= 0; by default the largest is drawn as about 5 % of the size of the model.
    stress : bool
        Colour by von Mises stress, constant on each element, MPa (in 3D that of the element behind each facet).
    displacement : bool
        Colour by the length of the displacement, linear in each element.
    states : bool
        Mark the contact surfaces with the states of their nodes: open, slip, stick.
    window : (xmin, xmax, ymin, ymax), optional
        What is to be seen, m; 2D only.
    bodies : sequence of str, optional
        Names of the bodies shown; default all. In 3D the others hide the contact surfaces.
    lines : bool, optional
        Whether to draw the edges of the elements; by default up to 8000 of them (in 3D, 6000 surface triangles).
    view : (elevation, azimuth), optional
        Where a 3D picture is seen from, degrees; default (22, -58).
    ax : matplotlib Axes, optional
        In 3D with ``projection="3d"``.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        Without a mesh, without materials for the stress, for a window that shows nothing or bodies there are not.
    """
    if checks.instance("result", result, Result).mesh is None:
        raise ValueError("this result has no mesh to draw (it comes from a bare DiscreteProblem)")
    coloring = _coloring(result, stress, displacement)
    factor = automatic_factor(result) if amplify is None else checks.nonnegative("amplify", amplify)
    scene = make_scene(result, factor, bodies, window, coloring)
    ax = canvas(ax, _size(scene), result.dim)
    present: list[int] = []
    if result.dim == 3:
        at = None if view is None else check_arrays.vector("view", view, 2)
        present = surfaces.draw(ax, scene, lines, states, at)
    else:
        _draw_plane(ax, scene, scene.n_elements <= _LINES_UP_TO if lines is None else lines)
        present = _draw_states(ax, scene) if states else []
    _finish(ax, scene, factor)
    _legend(ax, scene, present)
    return ax.figure


def _coloring(result: Result, stress: bool, displacement: bool) -> Coloring | None:
    if stress and displacement:
        raise ValueError("stress and displacement cannot both be the colours: draw two pictures")
    if not stress and not displacement:
        return None
    values = result.von_mises() if stress else np.linalg.norm(result.displacement, axis=1)
    factor, unit = (1e-6, "MPa") if stress else scaled(float(values.max()), "m")
    label = f"{'von Mises stress' if stress else 'displacement |u|'} [{unit}]"
    return Coloring(factor * values, label, Normalize(0.0, max(factor * float(values.max()), np.finfo(float).tiny)))


def _size(scene: Scene) -> tuple[float, float]:
    """Inches that suit the proportions of what is seen."""
    if len(scene.lower) == 3:
        return 6.8, 5.4
    width, height = (scene.upper - scene.lower) / np.max(scene.upper - scene.lower)
    return max(5.6 * width, 2.6) + 1.6, max(5.0 * height, 2.0) + 0.9


def _finish(ax: Axes, scene: Scene, factor: float) -> None:
    """Colour bar, labels, title."""
    coloring, dim = scene.coloring, scene.result.dim
    if coloring is not None:
        bar = ax.figure.colorbar(ScalarMappable(coloring.norm, "viridis"), ax=ax, shrink=0.75, pad=0.05 * dim - 0.06)
        bar.set_label(coloring.label)
        bar.outline.set_visible(False)
    if dim == 2:
        names = axis_names(scene.result)
        ax.set_xlabel(f"{names[0]} [{scene.unit}]")
        ax.set_ylabel(f"{names[1]} [{scene.unit}]")
    drawn = "to scale" if factor == 1 else f"{number(factor)} times"
    # seen from below, an axis with its label runs along the upper side
    above = dim == 3 and ax.elev < 0
    ax.set_title(f"{plain(scene.result.problem_name)}: displacement drawn {drawn}", pad=30 if above else None)


def _legend(ax: Axes, scene: Scene, present: list[int]) -> None:
    """Names of the bodies, outline before, states; where a colour bar or an axis is not."""
    handles: list[Patch | Line2D] = []
    if scene.coloring is None:
        order = {name: k for k, name in enumerate(scene.result.mesh.bodies)}
        handles += [Patch(facecolor=shape.color, edgecolor=INK, linewidth=0.6, label=plain(shape.name))
                    for shape in sorted(scene.shapes, key=lambda shape: order[shape.name])]
    handles.append(Line2D([], [], color=GREY, linewidth=0.9, linestyle=(0, (4, 3)), label="before"))
    handles += state_lines(present)
    if scene.coloring is None:
        ax.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    elif scene.result.dim == 2:
        ax.figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 5))
    else:
        ax.legend(handles=handles, loc="upper left", bbox_to_anchor=(-0.05, 1.0), borderaxespad=0.0)


def _draw_plane(ax: Axes, scene: Scene, lines: bool) -> None:
    """Draw a scene."""
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


def _draw_states(ax: Axes, scene: Scene) -> list[int]:
    """Draw the contact surfaces of the shown bodies in the colours of their states; returns the states that occur.

    Each edge changes colour half way between its nodes; edges with a node that is no contact node are left out.
    """
    mesh = scene.result.mesh
    shown = np.unique(np.concatenate([shape.facets.ravel() for shape in scene.shapes]))
    present: set[int] = set()
    for k, name in enumerate(scene.result.contact.names):
        state = scene.states(k)
        facets = mesh.boundary_facets(name)
        facets = facets[(state[facets] >= 0).all(axis=1) & np.isin(facets, shown).all(axis=1)]
        for ring in walks(facets):
            segments, colors = halves(scene.after[ring], state[ring])
            ax.add_collection(LineCollection(segments, color="white", linewidth=4.2, capstyle="butt", zorder=4))
            ax.add_collection(LineCollection(segments, colors=colors, linewidth=2.8, capstyle="butt", zorder=4.1))
        present |= set(state[facets].ravel().tolist())
    return sorted(present)
