"""mesh, grids, deformation: bodies with the states of contact, before and after loading, coloured
by body or values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation

from adaptmg import _checks as checks
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays, facet_keys, facet_table, need_mesh
from adaptmg.plot import style
from adaptmg.plot.surfaces import (
    Lines,
    ShadedSurface,
    finish_axes,
    sharp_edges,
    solid_axes,
    view_of,
)
from adaptmg.solver.examine import ContactResult
from adaptmg.solver.result import Result

#: the largest numbers of triangles and of surface triangles whose edges are drawn by default
_LINES_UP_TO = {2: 8000, 3: 6000}
#: of the size: bodies are drawn over each other by less than the width of their outlines, and by
#: rounding of the factor 1.6 times as much; with ten times as much a cylinder on a block is a loop.
#: Half changes the factor of none of 16 pictures, twice that of one, 20 -> 50
_OVERLAP = 0.003

#: of the size of a contact patch: the most by which displacements there are drawn to differ. A cylinder of 10 mm on a
#: rigid plane, patch .3 mm, is drawn 50 times (without this limit 200 times: the patch is a cusp). Half and twice
#: change none of 12 pictures of the cases
_PATCH_SHARE = 0.25


@style.styled
def mesh(drawn: MeshArrays, ax: Axes | None = None, *, contact: Sequence[str] = ()) -> Figure:
    """Draw a mesh; several bodies in different colours.

    Parameters
    ----------
    drawn : MeshArrays
    ax : matplotlib Axes, optional
        In 3D with ``projection="3d"``.
    contact : sequence of str
        Boundaries to mark.

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.plot.mesh(grids.finest.mesh, contact=["bottom"]).axes[0].get_title()
    '25 nodes, 32 elements'
    """
    checks.instance(
        "drawn",
        drawn,
        MeshArrays,
        "MeshArrays (read a mesh file with am.Hierarchy.from_meshes or adaptmg.mesh.read.as_mesh)",
    )
    contact = checks.strings("contact", (contact,) if isinstance(contact, str) else contact)
    for name in contact:
        checks.choice("contact", name, drawn.boundaries)
    ax = style.canvas(ax, (5.4, 5.0), drawn.dim)
    _draw_mesh(ax, drawn, contact)
    style.entitle(ax, f"{drawn.n_nodes} nodes, {len(drawn.elements)} elements")
    return style.figure_of(ax)


@style.styled
def grids(hierarchy: Hierarchy, axes: Sequence[Axes] | None = None) -> Figure:
    """Draw the grids of a hierarchy side by side, coarsest first, with their numbers of nodes.

    ``axes`` holds one for each level, in 3D with ``projection="3d"``. ValueError if a level has no
    mesh.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> len(am.plot.grids(grids).axes)
    2
    """
    levels = checks.instance("hierarchy", hierarchy, Hierarchy).levels
    without = [k for k, level in enumerate(levels) if level.mesh is None]
    if without:
        raise ValueError(f"levels {without} have no mesh to draw: make the hierarchy from meshes")
    dim = need_mesh(hierarchy.finest).dim
    if axes is None:
        columns = style.columns_of(len(hierarchy), 4, 3.1)
        figure = style.new_figure((3.1 * columns, 3.3 * -(-len(hierarchy) // columns)))
        axes = style.cells(figure, len(hierarchy), columns, dim=dim)
    axes = style.axes_of(axes, len(hierarchy))
    # titles of one line fit above pictures that are more than 2.5 inches wide
    wide = style.figure_of(axes[0]).get_figwidth() > 2.5 * min(len(hierarchy), 4)
    between = " " if wide else "\n"
    for k, (level, ax) in enumerate(zip(levels, axes, strict=True)):
        _draw_mesh(style.canvas(ax, (1, 1), dim), need_mesh(level), level.discrete.contact.names)
        ax.set_title(
            f"level {k}:{between}{need_mesh(level).n_nodes} nodes, {len(level.discrete.contact)} contact",
        )
        place = ax.get_subplotspec()
        if dim == 3:
            ax.set_axis_off()
        elif place is not None and not place.is_first_col():
            ax.set_ylabel("")
    return style.figure_of(axes[0])


def _draw_mesh(ax: Axes, drawn: MeshArrays, contact: Sequence[str]) -> None:
    """Draw the bodies in a colour each, their boundaries ``contact`` in orange."""
    draw_bodies(
        ax,
        drawn,
        style.body_fills(len(drawn.bodies)),
        boundary_marks(drawn, dict.fromkeys(contact, style.ORANGE)),
    )


@style.styled
def deformation(
    result: Result,
    amplify: float | None = None,
    *,
    stress: bool = False,
    displacement: bool = False,
    velocity: bool = False,
    states: bool = False,
    bodies: Sequence[str] | None = None,
    lines: bool | None = None,
    ax: Axes | None = None,
) -> Figure:
    """Draw the deformed bodies, each in its own colour, over their outlines before; the title has
    the amplification.

    Amplified bodies overlap where an initial gap has closed, by default by at most 0.5 % of the
    size of the model, and part where they only slid; with ``amplify=1`` the picture is to scale.
    ``ax.set_xlim`` and ``ax.set_ylim`` of the figure's axes show a part of it.

    Parameters
    ----------
    result : Result
        With a mesh.
    amplify : float, optional
        Factor of the displacements, >= 0; by default the largest is drawn as about 5 % of the size
        of the model, less where gaps between bodies have closed or a contact patch would fold.
    stress : bool
        Colour by von Mises stress, constant on each element, MPa (in 3D that of the element behind
        each facet). The scale ends where 99 % of the elements lie below; the label names the
        maximum.
    displacement : bool
        Colour by the length of the displacement, linear in each element.
    velocity : bool
        Colour by the speed, linear in each element; of a step of :func:`adaptmg.march`.
    states : bool
        Mark the contact surfaces with the states of their nodes: open, slip, stick.
    bodies : sequence of str, optional
        Names of the bodies shown; default all. In 3D the others hide the contact surfaces.
    lines : bool, optional
        Whether to draw the edges of the elements; by default up to 8000 of them (in 3D, 6000
        surface triangles).
    ax : matplotlib Axes, optional
        In 3D with ``projection="3d"``, where ``ax.view_init(elevation, azimuth)`` turns the
        picture.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> len(am.plot.deformation(result, amplify=10, stress=True).axes)  # with a colour bar
    2
    """
    mesh = need_mesh(checks.instance("result", result, Result))
    style.need_displacements(result)
    shown = {"stress": stress, "displacement": displacement, "velocity": velocity}
    for name, value in (shown | {"states": states}).items():
        checks.flag(name, value)
    if lines is not None:
        checks.flag("lines", lines)
    names = _names(mesh, bodies)
    colors = _coloring(result, [name for name, value in shown.items() if value])
    factor = (
        _automatic_factor(result) if amplify is None else checks.nonnegative("amplify", amplify)
    )
    moved = mesh.points + factor * result.displacement
    if ax is None and result.dim == 2:
        extent = np.ptp(np.vstack([mesh.points, moved]), axis=0)
        width, height = extent / extent.max()
        # inches: room for the bodies, and next to them for the colour bar, above and below for texts
        ax = style.canvas(None, (max(5.6 * width, 2.6) + 1.6, max(5.0 * height, 2.0) + 0.9))
    ax = style.canvas(ax, (6.8, 5.4), result.dim)
    present = draw_bodies(
        ax,
        mesh,
        colors,
        state_marks(mesh, result.contact) if states else None,
        moved=moved,
        lines=lines,
        names=names,
        axes=style.axis_names(result),
    )
    style.entitle(
        ax,
        style.titled(
            result.problem_name,
            "displacement drawn "
            + ("to scale" if factor == 1 else f"{style.number(factor)} times"),
        ),
    )
    handles = [
        Line2D([], [], color=style.GREY, linewidth=0.9, label="before"),
        *style.state_lines(present),
    ]
    if isinstance(colors, Coloring):
        figure = style.figure_of(ax)
        bar = figure.colorbar(
            ScalarMappable(colors.norm),
            ax=ax,
            label=colors.label,
            shrink=1.0 if result.dim == 2 else 0.75,
            pad=0.04 if result.dim == 2 else 0.09,
            extend="max" if colors.clipped else "neither",
        )
        bar.outline.set_visible(False)
        style.legend_below(ax, handles)
        figure.draw_without_rendering()
        # the label of a solid may be longer than the bar: two lines leave no width for the solid
        limit = bar.ax.get_window_extent() if result.dim == 2 else figure.bbox
        if bar.ax.yaxis.label.get_window_extent().y1 > limit.y1:
            bar.set_label(colors.label.replace(", ", ",\n"))
    else:
        patches = [
            Patch(facecolor=color, edgecolor=style.INK, linewidth=0.6, label=style.plain(name))
            for name, color in zip(mesh.bodies, colors, strict=True)
            if name in names
        ]
        style.legend_next_to(ax, [*patches, *handles])
    return style.figure_of(ax)


def _names(mesh: MeshArrays, bodies: Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of the bodies to be drawn: those given, checked; None: all."""
    given = (bodies,) if isinstance(bodies, str) else bodies
    names = mesh.bodies if given is None else checks.strings("bodies", given)
    if not names:
        raise ValueError("bodies must name at least one body; None shows all")
    return tuple(checks.choice("bodies", name, mesh.bodies) for name in names)


def _automatic_factor(result: Result) -> float:
    """Return a round factor that draws the largest displacement as about 5 % of the size, and
    bodies hardly over each other; 1 if nothing moves."""
    mesh = need_mesh(result)
    _, _, size = style.bounds(mesh.points)
    largest = float(np.linalg.norm(result.displacement, axis=1).max())
    if not largest > 1e-12 * size:
        return 1.0
    factor = 0.05 * size / largest
    contact = result.contact
    # drawn f times as large, a node with the initial gap g_0 in front of another body lies f u_n - g_0
    # inside it, which is at most _OVERLAP of the size
    faces_body = np.array(contact.masters, dtype=bool)[contact.boundary]
    closes = faces_body & (contact.u_n > 0)
    u_n = contact.u_n[closes]
    initial_gap = contact.gap[closes] + u_n
    factor = min(factor, ((_OVERLAP * size + initial_gap) / u_n).min(initial=np.inf))
    # the nodes that touch move apart by at most a share of the size of their patch
    for k in range(len(contact.names)):
        nodes = contact.node[contact.closed & (contact.boundary == k)]
        if len(nodes) > 1:
            _, _, extent = style.bounds(mesh.points[nodes])
            _, _, spread = style.bounds(result.displacement[nodes])
            # the spread is 0 where all of them move alike
            factor = min(factor, _PATCH_SHARE * extent / max(spread, 1e-12 * size))
    power = 10.0 ** np.floor(np.log10(factor))
    return float(power * min((1, 2, 5, 10), key=lambda m: abs(np.log(m * power / factor))))


class Coloring(NamedTuple):
    """Colours by values."""

    values: np.ndarray  # (n_nodes,) or (n_elements,), in the unit of the label
    nodal: bool
    label: str  # of the colour bar
    norm: Normalize
    clipped: bool = False  # whether values lie above the scale


def _coloring(result: Result, shown: Sequence[str]) -> Coloring | list[str]:
    """Return the values and the scale of the quantity shown, the colours of the bodies if there is
    none; ValueError for several."""
    if len(shown) > 1:
        raise ValueError(f"{' and '.join(shown)} cannot both be the colours: draw two pictures")
    if "stress" in shown:
        factor, unit = style.stresses()
        values = factor * result.von_mises()
        largest = float(values.max())
        # a corner or the edge of a punch has one element of a stress far above all others
        top = float(np.quantile(values, 0.99)) or largest or 1.0
        return Coloring(
            values,
            False,
            f"von Mises stress [{unit}], maximum {style.number(largest)}",
            Normalize(0.0, top),
            clipped=largest > 1.001 * top,  # more than the three digits of labels show
        )
    for name, symbol, unit in (("displacement", "u", "m"), ("velocity", "v", "m/s")):
        if name not in shown:
            continue
        vectors = getattr(result, name)
        if not vectors.size:
            raise ValueError(f"{name}: this result has none; those of am.march have")
        values = np.linalg.norm(vectors, axis=1)
        factor, unit = style.scaled(float(values.max()), unit)
        return Coloring(
            factor * values,
            True,
            f"{name} |{symbol}| [{unit}]",
            Normalize(0.0, factor * float(values.max()) or 1.0),
        )
    return style.body_fills(len(need_mesh(result).bodies))


class Marks(NamedTuple):
    """Colours of boundary facets, in 2D of the half of an edge at each corner."""

    codes: (
        np.ndarray
    )  # (n_facets, dim) int: into the colours, of each corner; -1 at facets without a mark
    colors: Sequence[str]


def boundary_marks(mesh: MeshArrays, colors: Mapping[str, str]) -> Marks:
    """Return the marks of boundaries by their names; names that do not exist are passed over."""
    codes = np.full(mesh.facets.shape, -1)
    for code, name in enumerate(colors):
        if name in mesh.boundaries:
            codes[mesh.facet_labels == mesh.boundaries.index(name)] = code
    return Marks(codes, list(colors.values()))


def state_marks(mesh: MeshArrays, contact: ContactResult) -> Marks:
    """Return the states of facets whose corners are all contact nodes of their boundary."""
    codes = np.full(mesh.facets.shape, -1)
    for k, name in enumerate(contact.names):
        state = np.full(mesh.n_nodes, -1)
        rows = contact.boundary == k
        state[contact.node[rows]] = contact.state[rows]
        # none where the mesh has no boundary of this name, as in scalar problems
        facets = np.array(mesh.boundaries)[mesh.facet_labels] == name
        codes[facets] = state[mesh.facets[facets]]
    codes[codes.min(axis=1) < 0] = -1
    return Marks(codes, list(style.STATE_INKS.values()))


def draw_bodies(
    ax: Axes,
    mesh: MeshArrays,
    colors: Coloring | Sequence[str],
    marks: Marks | None = None,
    *,
    moved: np.ndarray | None = None,
    lines: bool | None = None,
    names: Sequence[str] | None = None,
    axes: str = "xyz",
    strokes: Sequence[Lines] = (),
) -> set[int]:
    """Draw bodies, by default all, in one colour each or by values, with their outlines; return the
    codes of the marks. Nodes ``moved`` to other places (n_nodes, dim) are drawn there, over the
    outlines before."""
    table = facet_table(mesh.elements, mesh.n_nodes)
    points = mesh.points if moved is None else moved
    element_of_facet = table.first[table.find(facet_keys(mesh.facets, mesh.n_nodes))]
    shown = np.isin(mesh.element_body, [mesh.bodies.index(name) for name in names or mesh.bodies])
    visible = shown[element_of_facet]
    facets = mesh.facets[visible]
    element_of_facet = element_of_facet[visible]
    # (n, dim): at each corner of a facet the number of its colour in ``inks``, -1 without a mark
    codes = np.full(facets.shape, -1) if marks is None else marks.codes[visible]
    marked = codes[:, 0] >= 0
    inks = to_rgba_array([] if marks is None else marks.colors)
    corners = np.concatenate([mesh.points[facets], points[facets]]).reshape(-1, mesh.dim)
    # points in the unit of the axes; those before the motion only where there is one
    _, _, size = style.bounds(corners)
    scale, unit = style.scaled(size, "m")
    points_before = None if moved is None else scale * mesh.points
    points_now = scale * points
    elements = np.flatnonzero(shown)
    lines = (
        len(elements if mesh.dim == 2 else facets) <= _LINES_UP_TO[mesh.dim]
        if lines is None
        else lines
    )
    if mesh.dim == 2:
        # small bodies over large ones
        volumes = np.bincount(mesh.element_body, np.abs(mesh.volumes))
        elements = elements[np.argsort(-volumes[mesh.element_body[elements]], kind="stable")]
        _fill(ax, points_now, mesh, elements, colors, lines)
        if points_before is not None:
            _draw_edges(ax, points_before[facets], style.GREY, 0.8)
        _draw_edges(ax, points_now[facets], style.INK, 1.0)
        halves = style.halves(points_now[facets[marked]])
        _draw_edges(ax, halves, "white", 4.2, over=True)
        _draw_edges(ax, halves, inks[codes[marked].ravel()], 2.8, over=True)
        ax.set(aspect="equal", xlabel=f"{axes[0]} [{unit}]", ylabel=f"{axes[1]} [{unit}]")
        ax.spines[:].set_visible(False)
        ax.margins(0.03)
        ax.autoscale_view()
    else:
        # a colour for each corner of a facet
        if isinstance(colors, Coloring) and colors.nodal:
            rgba = _rgba(colors, mesh, facets)
        else:
            rgba = np.repeat(_rgba(colors, mesh, element_of_facet)[:, None], 3, axis=1)
        # of three corners with different states the middle one colours the facet
        rgba[marked] = inks[np.median(codes[marked], axis=1).astype(int)][:, None]
        edges = sharp_edges(mesh.points, facets)
        outlines = [Lines(points_now[edges], style.INK, 0.9)]
        if points_before is not None:
            outlines.insert(0, Lines(points_before[edges], style.GREY, 0.9))
        ax.add_artist(ShadedSurface(points_now[facets], rgba, lines, (*outlines, *strokes)))
        ax = solid_axes(ax)
        finish_axes(ax, scale * corners, unit)
        if len(names or mesh.bodies) == 1:
            view_of(ax, points_now[facets[marked]])
    return set(codes[marked].ravel().tolist())


def _draw_edges(
    ax: Axes, edges: np.ndarray, colors: str | np.ndarray, width: float, over: bool = False
) -> None:
    """Draw edges (n, 2, 2) of a plane mesh in one colour or in ``colors`` (n, 4), marks ``over`` outlines."""
    ax.add_collection(
        LineCollection(
            list(edges),
            color=colors,
            linewidth=width,
            zorder=4 if over else 3,
            capstyle="round" if over else "projecting",
        )
    )


def _fill(
    ax: Axes,
    points: np.ndarray,
    mesh: MeshArrays,
    shown: np.ndarray,
    colors: Coloring | Sequence[str],
    lines: bool,
) -> None:
    """Fill the elements ``shown`` (numbers) of a plane mesh with its nodes at ``points`` (n_nodes, 2), in the
    unit of the axes, and draw their edges if ``lines``."""
    valued = isinstance(colors, Coloring)
    elements = mesh.elements[shown]
    # lines are thinner the more elements there are; without lines edges as wide as a pixel in the
    # colour of their triangle close the seams between triangles
    edge, width = (
        ("white" if valued else style.INK, float(np.clip(14 / np.sqrt(len(shown)), 0.1, 0.6)))
        if lines
        else ("face", 0.6)
    )
    if valued and colors.nodal:
        nodes, corners = np.unique(elements, return_inverse=True)
        ax.tripcolor(
            Triangulation(points[nodes, 0], points[nodes, 1], corners.reshape(elements.shape)),
            colors.values[nodes],
            shading="gouraud",
            norm=colors.norm,
            rasterized=True,
            zorder=2,
        )
        fills = "none"
        edge = edge if lines else "none"
    else:
        fills = _rgba(colors, mesh, shown)
    ax.add_collection(
        PolyCollection(
            list(points[elements]),
            facecolor=fills,
            edgecolor=edge,
            linewidth=width,
            rasterized=len(shown) > 20_000,
            zorder=2.1,
        )
    )


def _rgba(colors: Coloring | Sequence[str], mesh: MeshArrays, index: np.ndarray) -> np.ndarray:
    """Return the colours (..., 4) of elements, or nodes, with the numbers ``index``."""
    if isinstance(colors, Coloring):
        return ScalarMappable(colors.norm).to_rgba(colors.values[index])
    return to_rgba_array(colors)[mesh.element_body[index]]
