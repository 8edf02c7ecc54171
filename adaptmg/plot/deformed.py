"""deformation: bodies after loading over their outlines before, coloured by body, displacement or stress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
from adaptmg.plot.surfaces import Lines, draw_facets, finish_axes, sharp_edges
from adaptmg.solver.result import Result

#: the largest number of elements whose edges are drawn by default
_LINES_UP_TO = 8000


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
    _ = checks.instance("result", result, Result).mesh  # which raises without one
    coloring = _coloring(result, stress, displacement)
    factor = _automatic_factor(result) if amplify is None else checks.nonnegative("amplify", amplify)
    scene = _scene(result, factor, bodies, coloring)
    ax = style.canvas(ax, _size(scene), result.dim)
    if result.dim == 3:
        present = _draw_solid(ax, scene, lines, states)
    else:
        _draw_plane(ax, scene, scene.n_elements <= _LINES_UP_TO if lines is None else lines)
        present = _draw_states(ax, scene) if states else set()
    _finish(ax, scene, factor)
    _legend(ax, scene, present)
    return ax.figure


@dataclass(frozen=True)
class Coloring:
    """Values to colour by."""

    values: np.ndarray  # (n_nodes,) or (n_elements,), in the unit of the label
    label: str  # of the colour bar
    norm: Normalize

    @property
    def extend(self) -> str:
        """Whether the colour bar is open above: 'max' or 'neither'."""
        return "max" if self.values.max() > 1.001 * self.norm.vmax else "neither"


@dataclass(frozen=True)
class DrawnBody:
    """One body."""

    name: str
    color: str
    elements: np.ndarray  # (n,) int: the elements that are shown
    facets: np.ndarray  # (m, dim) int: nodes of their boundary, outward
    behind: np.ndarray  # (m,) int: the element behind each facet


@dataclass(frozen=True)
class Scene:
    """The bodies and their positions in plot units."""

    result: Result
    before: np.ndarray  # (n_nodes, dim): initial positions
    after: np.ndarray  # (n_nodes, dim): positions with the amplified displacement
    unit: str
    shapes: tuple[DrawnBody, ...]  # large bodies first
    lower: np.ndarray  # (dim,): lower corner of the part that is shown
    upper: np.ndarray  # (dim,): upper corner
    coloring: Coloring | None = None  # None: a colour for each body

    @property
    def n_elements(self) -> int:
        """Number of elements shown."""
        return sum(len(shape.elements) for shape in self.shapes)


def _coloring(result: Result, stress: bool, displacement: bool) -> Coloring | None:
    if stress and displacement:
        raise ValueError("stress and displacement cannot both be the colours: draw two pictures")
    if not stress and not displacement:
        return None
    values = result.von_mises() if stress else np.linalg.norm(result.displacement, axis=1)
    factor, unit = (1e-6, "MPa") if stress else style.scaled(float(values.max()), "m")
    values = factor * values
    # a corner or the edge of a punch has one element of a stress far above all others
    top = float(np.quantile(values, 0.99) if stress else values.max()) or float(values.max())
    label = f"von Mises stress [{unit}], maximum {style.number(float(values.max()))}" if stress else (
        f"displacement |u| [{unit}]")
    return Coloring(values, label, Normalize(0.0, top or 1.0))


def _automatic_factor(result: Result) -> float:
    """A round factor that draws the largest displacement as about 5 % of the size; 1 if nothing moves."""
    size = style.bounds(result.mesh.points)[2]
    largest = float(np.linalg.norm(result.displacement, axis=1).max())
    if not largest > 1e-12 * size:
        return 1.0
    factor = 0.05 * size / largest
    power = 10.0 ** np.floor(np.log10(factor))
    return float(power * min((1, 2, 5, 10), key=lambda m: abs(np.log(m * power / factor))))


def _scene(result: Result, factor: float, bodies: Sequence[str] | None, coloring: Coloring | None) -> Scene:
    """Choose bodies, and place them."""
    mesh = result.mesh
    chosen = _bodies(mesh, bodies)
    moved = mesh.points + factor * result.displacement
    nodes = np.unique(mesh.elements[np.isin(mesh.element_body, chosen)])
    lower, upper, size = style.bounds(np.vstack([mesh.points[nodes], moved[nodes]]))
    scale, unit = style.scaled(size, "m")
    shapes = [_shape(mesh, body, np.flatnonzero(mesh.element_body == body)) for body in chosen]
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


def _shape(mesh: MeshArrays, body: int, elements: np.ndarray) -> DrawnBody:
    table = facet_table(mesh.elements[elements], mesh.n_nodes)
    outer = table.counts == 1
    return DrawnBody(mesh.bodies[body], style.BODY_COLORS[body % len(style.BODY_COLORS)], elements, table.facets[outer],
                     elements[table.first[outer]])


def _size(scene: Scene) -> tuple[float, float]:
    """Inches that suit the proportions of the bodies."""
    if len(scene.lower) == 3:
        return 6.8, 5.4
    width, height = (scene.upper - scene.lower) / np.max(scene.upper - scene.lower)
    return max(5.6 * width, 2.6) + 1.6, max(5.0 * height, 2.0) + 0.9


def _draw_solid(ax: Axes3D, scene: Scene, lines: bool | None, states: bool) -> set[int]:
    """Draw all bodies as one surface, so that they hide each other; return the contact states drawn."""
    facets = np.concatenate([shape.facets for shape in scene.shapes])
    colors = np.concatenate([_facet_colors(scene, shape) for shape in scene.shapes])
    contact, present = scene.result.contact, set()
    for boundary in range(len(contact.names)) if states else ():
        # the state of most corners, where all are nodes of one contact boundary
        corners = np.sort(style.states_of(contact, boundary, len(scene.after))[facets], axis=1)
        mine = corners[:, 0] >= 0
        colors[mine] = to_rgba_array([style.STATE_INKS[state] for state in corners[mine, 1]]).reshape(-1, 1, 4)
        present |= set(corners[mine, 1].tolist())
    edges = np.concatenate([sharp_edges(scene.before, shape.facets) for shape in scene.shapes])
    draw_facets(ax, scene.after[facets], colors, lines,
                (Lines(scene.before[edges], style.GREY, 0.9, (4.0, 3.0)), Lines(scene.after[edges], style.INK, 0.9)),
                0.28 if scene.coloring is None and not states else 0.14)
    finish_axes(ax, np.array([scene.lower, scene.upper]), scene.unit)
    return present


def _facet_colors(scene: Scene, shape: DrawnBody) -> np.ndarray:
    """Colours (n, 3, 4) of the corners of the facets."""
    coloring = scene.coloring
    if coloring is None:
        return np.tile(to_rgba_array(shape.color), (len(shape.facets), 3, 1))
    nodal = len(coloring.values) == len(scene.after)
    values = coloring.values[shape.facets if nodal else np.repeat(shape.behind[:, None], 3, axis=1)]
    return ScalarMappable(coloring.norm, "viridis").to_rgba(values.ravel()).reshape(-1, 3, 4)


def _draw_plane(ax: Axes, scene: Scene, lines: bool) -> None:
    width = float(np.clip(12 / np.sqrt(scene.n_elements), 0.08, 0.6))
    for k, shape in enumerate(scene.shapes):
        rings = style.polylines(shape.facets)
        _fill(ax, scene, shape, rings, width if lines else 0.0, zorder=2 + 0.1 * k)
        ax.add_collection(LineCollection([scene.after[ring] for ring in rings], color=style.INK, linewidth=1.0,
                                         zorder=3.6))
        ax.add_collection(LineCollection([scene.before[ring] for ring in rings], color=style.GREY, linewidth=0.8,
                                         linestyle=(0, (4, 3)), zorder=3.5))
    margin = 0.03 * float(np.max(scene.upper - scene.lower))
    ax.set(aspect="equal", xlim=(scene.lower[0] - margin, scene.upper[0] + margin),
           ylim=(scene.lower[1] - margin, scene.upper[1] + margin))
    ax.spines[:].set_visible(False)


def _fill(ax: Axes, scene: Scene, shape: DrawnBody, rings: list[np.ndarray], width: float, zorder: float) -> None:
    elements, coloring = scene.result.mesh.elements[shape.elements], scene.coloring
    if coloring is None and width:
        ax.add_collection(PolyCollection(scene.after[elements], facecolor=shape.color, edgecolor=style.INK,
                                         linewidth=width, zorder=zorder))
    elif coloring is None:
        path = Path.make_compound_path(*(Path(scene.after[ring], closed=True) for ring in rings))
        ax.add_patch(PathPatch(path, facecolor=shape.color, edgecolor="none", zorder=zorder))
    else:
        grid = Triangulation(*scene.after.T, elements)
        look = {"norm": coloring.norm, "cmap": "viridis", "rasterized": True, "zorder": zorder}
        if len(coloring.values) == len(scene.after):
            ax.tripcolor(grid, coloring.values, shading="gouraud", **look)
        else:
            ax.tripcolor(grid, facecolors=coloring.values[shape.elements], **look)
        if width:
            ax.add_collection(PolyCollection(scene.after[elements], facecolor="none", edgecolor="white",
                                             linewidth=0.5 * width, zorder=zorder + 0.02))


def _draw_states(ax: Axes, scene: Scene) -> set[int]:
    """Draw the edges whose nodes are contact nodes in the colours of their states; return the states that occur."""
    contact, present = scene.result.contact, set()
    shown = np.unique(np.concatenate([shape.facets.ravel() for shape in scene.shapes]))
    for boundary, name in enumerate(contact.names):
        state = style.states_of(contact, boundary, len(scene.after))
        facets = scene.result.mesh.boundary_facets(name)
        facets = facets[(state[facets] >= 0).all(axis=1) & np.isin(facets, shown).all(axis=1)]
        for line in style.polylines(facets):
            segments, colors = style.halves(scene.after[line], state[line])
            ax.add_collection(LineCollection(segments, color="white", linewidth=4.2, capstyle="butt", zorder=4))
            ax.add_collection(LineCollection(segments, colors=colors, linewidth=2.8, capstyle="butt", zorder=4.1))
        present |= set(state[facets].ravel().tolist())
    return present


def _finish(ax: Axes, scene: Scene, factor: float) -> None:
    """Add colour bar, labels and title."""
    coloring, dim = scene.coloring, scene.result.dim
    if coloring is not None:
        bar = ax.figure.colorbar(ScalarMappable(coloring.norm, "viridis"), ax=ax, shrink=0.75, pad=0.05 * dim - 0.06,
                                 extend=coloring.extend)
        bar.set_label(coloring.label)
        bar.outline.set_visible(False)
    if dim == 2:
        names = style.axis_names(scene.result)
        ax.set(xlabel=f"{names[0]} [{scene.unit}]", ylabel=f"{names[1]} [{scene.unit}]")
    size = "to scale" if factor == 1 else f"{style.number(factor)} times"
    style.entitle(ax, f"{style.plain(scene.result.problem_name)}: displacement drawn {size}")


def _legend(ax: Axes, scene: Scene, present: set[int]) -> None:
    """Add names of bodies, the outline before, and states, away from colour bar and axes."""
    handles: list[Patch | Line2D] = []
    if scene.coloring is None:
        order = {name: k for k, name in enumerate(scene.result.mesh.bodies)}
        handles += [Patch(facecolor=shape.color, edgecolor=style.INK, linewidth=0.6, label=style.plain(shape.name))
                    for shape in sorted(scene.shapes, key=lambda shape: order[shape.name])]
    handles.append(Line2D([], [], color=style.GREY, linewidth=0.9, linestyle=(0, (4, 3)), label="before"))
    handles += style.state_lines(present)
    if scene.coloring is not None:
        style.legend_below(ax, handles)
    else:
        ax.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
