"""deformation: bodies after loading over their outlines before, by body, displacement or stress."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from adaptmg.plot.bodies import plane, solid
from adaptmg.plot.bodies.scene import Coloring, Scene, automatic_factor, make_scene
from adaptmg.plot.states import state_lines
from adaptmg.plot.style import GREY, INK, axis_names, canvas, number, plain, scaled, styled
from adaptmg.problem import check_arrays, checks
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
        present = solid.draw(ax, scene, lines, states, None if view is None else check_arrays.vector("view", view, 2))
    else:
        plane.draw(ax, scene, scene.n_elements <= _LINES_UP_TO if lines is None else lines)
        present = plane.draw_states(ax, scene) if states else []
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
