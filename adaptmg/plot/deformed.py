"""deformation: bodies after loading over their outlines before, coloured by body, displacement or stress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path
from matplotlib.tri import Triangulation
from mpl_toolkits.mplot3d import Axes3D

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays, facet_table
from adaptmg.plot import style
from adaptmg.plot.surfaces import Lines, ShadedSurface, finish_axes, sharp_edges
from adaptmg.solver.result import Result

#: the largest number of elements whose edges are drawn by default
_LINES_UP_TO = 8000
_DASHES = (0, (4, 3))


@style.styled
def deformation(result: Result, amplify: float | None = None, *, stress: bool = False, displacement: bool = False,
                states: bool = False, bodies: Sequence[str] | None = None, lines: bool | None = None,
                ax: Axes | None = None) -> Figure:
    """Draw the deformed bodies, each in its own colour, over their outlines before; the title has the amplification.

    Amplified bodies seem to overlap where an initial gap has closed, and to part where they only slid; with
    ``amplify=1`` the picture is to scale. ``ax.set_xlim`` and ``ax.set_ylim`` of the figure's axes show a part of it.

    Parameters
    ----------
    result : Result
        With a mesh.
    amplify : float, optional
        Factor of the displacements, >= 0; by default the largest is drawn as about 5 % of the size of the model.
    stress : bool
        Colour by von Mises stress, constant on each element, MPa (in 3D that of the element behind each facet). The
        scale ends where 99 % of the elements lie below; the label names the maximum.
    displacement : bool
        Colour by the length of the displacement, linear in each element.
    states : bool
        Mark the contact surfaces with the states of their nodes: open, slip, stick.
    bodies : sequence of str, optional
        Names of the bodies shown; default all. In 3D the others hide the contact surfaces.
    lines : bool, optional
        Whether to draw the edges of the elements; by default up to 8000 of them (in 3D, 6000 surface triangles).
    ax : matplotlib Axes, optional
        In 3D with ``projection="3d"``, where ``ax.view_init(elevation, azimuth)`` turns the picture.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> len(am.plot.deformation(result, amplify=10, stress=True).axes)  # with a colour bar
    2
    """
    mesh = checks.instance("result", result, Result).mesh  # which raises without one
    coloring = _coloring(result, stress, displacement)
    factor = _automatic_factor(result) if amplify is None else checks.nonnegative("amplify", amplify)
    shapes, moved = _shapes(mesh, bodies), mesh.points + factor * result.displacement
    nodes = np.unique(np.concatenate([shape.facets.ravel() for shape in shapes]))
    lower, upper, size = style.bounds(np.vstack([mesh.points[nodes], moved[nodes]]))
    scale, unit = style.scaled(size, "m")
    before, after, corners = scale * mesh.points, scale * moved, scale * np.array([lower, upper])
    if result.dim == 3:
        ax = style.canvas(ax, (6.8, 5.4), dim=3)
        present = _draw_solid(ax, result, shapes, before, after, coloring, lines, states)
        finish_axes(ax, corners, unit)
    else:
        width, height = (upper - lower) / np.max(upper - lower)
        ax = style.canvas(ax, (max(5.6 * width, 2.6) + 1.6, max(5.0 * height, 2.0) + 0.9))
        _draw_plane(ax, mesh, shapes, before, after, coloring, lines)
        present = _draw_states(ax, result, nodes, after) if states else set()
        (left, low), (right, high), margin = *corners, 0.03 * float(np.ptp(corners, axis=0).max())
        names = style.axis_names(result)
        ax.set(aspect="equal", xlim=(left - margin, right + margin), ylim=(low - margin, high + margin),
               xlabel=f"{names[0]} [{unit}]", ylabel=f"{names[1]} [{unit}]")
        ax.spines[:].set_visible(False)
    drawn = "to scale" if factor == 1 else f"{style.number(factor)} times"
    style.entitle(ax, f"{style.plain(result.problem_name)}: displacement drawn {drawn}")
    handles = [Line2D([], [], color=style.GREY, linewidth=0.9, linestyle=_DASHES, label="before"),
               *style.state_lines(present)]
    if coloring is None:
        names = [Patch(facecolor=shape.color, edgecolor=style.INK, linewidth=0.6, label=style.plain(shape.name))
                 for shape in sorted(shapes, key=lambda shape: mesh.bodies.index(shape.name))]
        ax.legend(handles=[*names, *handles], loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    else:
        above = coloring.values.max() > 1.001 * coloring.norm.vmax
        bar = ax.figure.colorbar(ScalarMappable(coloring.norm, "viridis"), ax=ax, label=coloring.label, shrink=0.75,
                                 pad=0.05 * result.dim - 0.06, extend="max" if above else "neither")
        bar.outline.set_visible(False)
        style.legend_below(ax, handles)
    return ax.figure


class _Coloring(NamedTuple):
    values: np.ndarray  # (n_nodes,) or (n_elements,), in the unit of the label
    nodal: bool
    label: str  # of the colour bar
    norm: Normalize


def _coloring(result: Result, stress: bool, displacement: bool) -> _Coloring | None:
    if stress and displacement:
        raise ValueError("stress and displacement cannot both be the colours: draw two pictures")
    if stress:
        values = 1e-6 * result.von_mises()
        largest = float(values.max())
        # a corner or the edge of a punch has one element of a stress far above all others
        top = float(np.quantile(values, 0.99)) or largest or 1.0
        return _Coloring(values, False, f"von Mises stress [MPa], maximum {style.number(largest)}", Normalize(0.0, top))
    if displacement:
        values = np.linalg.norm(result.displacement, axis=1)
        factor, unit = style.scaled(float(values.max()), "m")
        return _Coloring(factor * values, True, f"displacement |u| [{unit}]",
                         Normalize(0.0, factor * float(values.max()) or 1.0))
    return None


def _automatic_factor(result: Result) -> float:
    """A round factor that draws the largest displacement as about 5 % of the size; 1 if nothing moves."""
    size = style.bounds(result.mesh.points)[2]
    largest = float(np.linalg.norm(result.displacement, axis=1).max())
    if not largest > 1e-12 * size:
        return 1.0
    factor = 0.05 * size / largest
    power = 10.0 ** np.floor(np.log10(factor))
    return float(power * min((1, 2, 5, 10), key=lambda m: abs(np.log(m * power / factor))))


@dataclass(frozen=True)
class _Shape:
    """One body."""

    name: str
    color: str
    elements: np.ndarray  # (n,) int
    facets: np.ndarray  # (m, dim) int: nodes of their boundary, outward
    behind: np.ndarray  # (m,) int: the element behind each facet


def _shapes(mesh: MeshArrays, names: Sequence[str] | None) -> list[_Shape]:
    """The bodies to draw, large ones first."""
    names = mesh.bodies if names is None else (names,) if isinstance(names, str) else tuple(names)
    if not names:
        raise ValueError("bodies must name at least one body; None shows all")
    shapes = []
    for name in dict.fromkeys(names):
        body = mesh.bodies.index(checks.choice("bodies", name, mesh.bodies))
        elements = np.flatnonzero(mesh.element_body == body)
        table = facet_table(mesh.elements[elements], mesh.n_nodes)
        outer = table.counts == 1
        shapes.append(_Shape(name, style.BODY_COLORS[body % len(style.BODY_COLORS)], elements, table.facets[outer],
                             elements[table.first[outer]]))
    return sorted(shapes, key=lambda shape: -float(np.abs(mesh.volumes[shape.elements]).sum()))


def _draw_solid(ax: Axes3D, result: Result, shapes: Sequence[_Shape], before: np.ndarray, after: np.ndarray,
                coloring: _Coloring | None, lines: bool | None, states: bool) -> set[int]:
    """Draw all bodies as one surface, so that they hide each other; return the contact states drawn."""
    facets, present = np.concatenate([shape.facets for shape in shapes]), set()
    if coloring is None:
        colors = np.repeat(to_rgba_array([shape.color for shape in shapes]), [len(s.facets) for s in shapes], axis=0)
        colors = np.repeat(colors[:, None], 3, axis=1)
    else:
        at = facets if coloring.nodal else np.repeat(np.concatenate([s.behind for s in shapes])[:, None], 3, axis=1)
        colors = ScalarMappable(coloring.norm, "viridis").to_rgba(coloring.values[at].ravel()).reshape(-1, 3, 4)
    for boundary in range(len(result.contact.names)) if states else ():
        state = style.facet_states(style.states_of(result.contact, boundary, len(after))[facets])
        colors[state >= 0] = style.inks(state[state >= 0])[:, None]
        present |= set(state[state >= 0].tolist())
    edges = np.concatenate([sharp_edges(before, shape.facets) for shape in shapes])
    outlines = Lines(before[edges], style.GREY, 0.9, (4.0, 3.0)), Lines(after[edges], style.INK, 0.9)
    ax.add_artist(ShadedSurface(after[facets], colors, lines, outlines,
                          0.28 if coloring is None and not states else 0.14))
    return present


def _draw_plane(ax: Axes, mesh: MeshArrays, shapes: Sequence[_Shape], before: np.ndarray, after: np.ndarray,
                coloring: _Coloring | None, lines: bool | None) -> None:
    """Fill each body, draw the edges of its elements if ``lines``, and its outlines."""
    count = sum(len(shape.elements) for shape in shapes)
    width = float(np.clip(12 / np.sqrt(count), 0.08, 0.6)) if (count <= _LINES_UP_TO if lines is None else lines) else 0
    for k, shape in enumerate(shapes):
        elements, rings, zorder = mesh.elements[shape.elements], style.polylines(shape.facets), 2 + 0.1 * k
        if coloring is not None:
            draw = partial(ax.tripcolor, Triangulation(*after.T, elements), norm=coloring.norm, rasterized=True,
                           zorder=zorder)
            if coloring.nodal:
                draw(coloring.values, shading="gouraud")
            else:
                draw(facecolors=coloring.values[shape.elements])
        elif not width:
            path = Path.make_compound_path(*(Path(after[ring], closed=True) for ring in rings))
            ax.add_patch(PathPatch(path, facecolor=shape.color, edgecolor="none", zorder=zorder))
        if width:
            fill, edge, thin = (shape.color, style.INK, 1.0) if coloring is None else ("none", "white", 0.5)
            ax.add_collection(PolyCollection(after[elements], facecolor=fill, edgecolor=edge, linewidth=thin * width,
                                             zorder=zorder + 0.02))
        for points, color, thick, dashes, above in ((after, style.INK, 1.0, "-", 3.6),
                                                    (before, style.GREY, 0.8, _DASHES, 3.5)):
            ax.add_collection(LineCollection([points[ring] for ring in rings], color=color, linewidth=thick,
                                             linestyle=dashes, zorder=above))


def _draw_states(ax: Axes, result: Result, nodes: np.ndarray, after: np.ndarray) -> set[int]:
    """Draw edges whose ends are contact nodes among ``nodes`` in the colours of their states; return those states."""
    present = set()
    for boundary, name in enumerate(result.contact.names):
        state = style.states_of(result.contact, boundary, len(after))
        facets = result.mesh.boundary_facets(name)
        facets = facets[(state[facets] >= 0).all(axis=1) & np.isin(facets, nodes).all(axis=1)]
        style.stated_lines(ax, after, facets, state, 4.2, color="white")
        style.stated_lines(ax, after, facets, state, 2.8)
        present |= set(state[facets].ravel().tolist())
    return present
