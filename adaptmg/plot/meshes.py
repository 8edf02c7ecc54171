"""mesh, grids, adaptation: meshes with their contact boundary or its states, and the error of an adaptive loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LogNorm, to_rgba_array
from matplotlib.figure import Figure

from adaptmg import _checks as checks
from adaptmg.estimate.step import Step
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.plot import style
from adaptmg.plot.surfaces import ShadedSurface, finish_axes, view_of
from adaptmg.solver.contact_result import ContactResult

#: of marked facets
_MARK = (0.93, 0.55, 0.25, 1.0)


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
    checks.instance("drawn", drawn, MeshArrays, "MeshArrays (read a mesh file with am.Hierarchy.from_meshes or "
                    "adaptmg.mesh.read.as_mesh)")
    ax = style.canvas(ax, (5.4, 5.0), drawn.dim)
    _draw(drawn, ax, contact)
    style.entitle(ax, f"{drawn.n_nodes} nodes, {len(drawn.elements)} elements")
    return ax.figure


@style.styled
def grids(hierarchy: Hierarchy, axes: Sequence[Axes] | None = None) -> Figure:
    """Draw the grids of a hierarchy side by side, coarsest first, with their numbers of nodes.

    ``axes`` holds one for each level, in 3D with ``projection="3d"``. ValueError if a level has no mesh.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> len(am.plot.grids(grids).axes)
    2
    """
    levels = checks.instance("hierarchy", hierarchy, Hierarchy).levels
    without = [k for k, level in enumerate(levels) if level.mesh_or_none is None]
    if without:
        raise ValueError(f"levels {without} have no mesh to draw: make the hierarchy from meshes")
    dim = hierarchy.finest.mesh.dim
    if axes is None:
        columns = min(len(hierarchy), 4)
        figure = style.new_figure((3.1 * columns, 3.3 * -(-len(hierarchy) // columns)))
        axes = style.cells(figure, len(hierarchy), columns, dim=dim)
    axes = style.axes_of(axes, len(hierarchy))
    for k, (level, ax) in enumerate(zip(levels, axes, strict=True)):
        _draw(level.mesh, style.canvas(ax, (1, 1), dim), level.discrete.contact.names)
        ax.set_title(f"level {k}: {level.mesh.n_nodes} nodes, {len(level.discrete.contact)} contact", fontsize=9.5)
        if dim == 3:
            ax.set_axis_off()
        elif k % 4:
            ax.set_ylabel("")
    return axes[0].figure


def _draw(drawn: MeshArrays, ax: Axes, contact: Sequence[str], result: ContactResult | None = None) -> set[int]:
    """Draw a mesh with its contact boundaries marked, by the states of a result, which are returned."""
    scale, unit = style.scaled(style.bounds(drawn.points)[2], "m")
    points, solid, present = drawn.points * scale, drawn.dim == 3, set()
    fills = to_rgba_array(style.body_fills(len(drawn.bodies)) if result is None else [style.PALE] * len(drawn.bodies))
    body = np.zeros(drawn.n_nodes, dtype=int)
    body[drawn.elements] = drawn.element_body[:, None]
    colors, marked = fills[body[drawn.facets[:, 0]]], np.zeros(len(drawn.facets), dtype=bool)
    if not solid:
        width = float(np.clip(16 / np.sqrt(len(drawn.elements)), 0.1, 0.7))
        ax.add_collection(PolyCollection(points[drawn.elements], facecolor=fills[drawn.element_body], linewidth=width,
                                         edgecolor=style.INK, rasterized=len(drawn.elements) > 20_000))
        ax.add_collection(LineCollection(points[drawn.facets], color=style.INK, linewidth=0.9))
    for boundary, name in enumerate(contact):
        mine = drawn.facet_labels == (drawn.boundaries.index(name) if name in drawn.boundaries else -1)
        state = np.zeros(drawn.n_nodes, dtype=int) if result is None else style.states_of(result, boundary,
                                                                                          drawn.n_nodes)
        mine &= (state[drawn.facets] >= 0).all(axis=1)
        marked |= mine
        present |= set(state[drawn.facets[mine]].ravel().tolist())
        if solid:
            colors[mine] = _MARK if result is None else style.inks(style.facet_states(state[drawn.facets[mine]]))
        else:
            style.stated_lines(ax, points, drawn.facets[mine], state, 2.6, style.ORANGE if result is None else None)
    if solid:
        ax.add_artist(ShadedSurface(points[drawn.facets], colors))
        finish_axes(ax, points, unit)
        view_of(ax, points[drawn.facets[marked]])
        return present
    _finish_plane(ax, unit)
    return present


def _finish_plane(ax: Axes, unit: str) -> None:
    ax.set(aspect="equal", xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
    ax.autoscale_view()
    ax.spines[:].set_visible(False)


#: decades of the indicator in colour
_DECADES = 4


@style.styled
def adaptation(steps: Sequence[Step]) -> Figure:
    """Draw an adaptive loop: three of its meshes with contact states, a map of the indicator, and how the error falls.

    ``steps`` are those of :func:`adaptmg.adapt`. Above are the first mesh, one in the middle and the last; below the
    square root of each element's part of the estimate on the last mesh, and the relative estimate against nodes and
    against seconds (meshes included), with the rate of smooth solutions (of a goal twice that of the energy norm).

    Examples
    --------
    >>> problem = am.cases.greco_bar()
    >>> steps = list(am.adapt(problem, am.mesh.structured(problem.domain, 2), engine=am.Bisect(), max_nodes=20))
    >>> am.plot.adaptation(steps).savefig("adaptation.png")
    """
    steps = checks.items("steps", steps, Step, "Steps of am.adapt")
    if not steps:
        raise ValueError("steps is empty: give the steps of am.adapt, as in list(am.adapt(...))")
    dim = steps[0].result.dim
    figure = style.new_figure((10.5, 7.2))
    figure.get_layout_engine().set(w_pad=0.1)
    shown = sorted({0, len(steps) // 2, len(steps) - 1})
    kind = "3d" if dim == 3 else None
    present: set[int] = set()
    for k, number in enumerate(shown):
        ax = figure.add_subplot(2, 3, k + 1, projection=kind)
        contact = steps[number].result.contact
        present |= _draw(steps[number].hierarchy.finest.mesh, ax, contact.names, contact)
        if dim == 3:
            ax.set_axis_off()
        ax.set_title(f"step {number}: {steps[number].nodes} nodes", fontsize=9.5)
    figure.legend(handles=style.state_lines(present), loc="outside upper right", ncols=3, fontsize=8.5)
    _map(figure, figure.add_subplot(2, 3, 4, projection=kind), steps[-1])
    nodes = np.array([step.nodes for step in steps], dtype=float)
    relative = np.array([step.estimate.relative for step in steps])
    left, right = figure.add_subplot(2, 3, 5), figure.add_subplot(2, 3, 6)
    _falling(left, nodes, relative, "nodes", steps[-1])
    if (relative > 0).all() and np.isfinite(relative[-1]) and nodes[-1] > nodes[0]:
        # the error of a quantity falls as the square of that in the energy norm
        order = dim if steps[-1].estimate.signed is None else dim / 2
        guide = 1.35 * relative[-1] * (nodes / nodes[-1]) ** (-1 / order)
        left.plot(nodes, guide, color=style.GREY, linewidth=1.0, linestyle=(0, (4, 3)))
        power = {1: "-1", 1.5: "-2/3", 2: "-1/2", 3: "-1/3"}[order]
        left.annotate(f"  nodes$^{{{power}}}$", np.sqrt([nodes[0] * nodes[-1], guide[0] * guide[-1]]),
                      color=style.GREY, fontsize=8.5, va="bottom")
    _falling(right, np.array([step.total_seconds for step in steps]), relative, "time, meshes included [s]", steps[-1])
    figure.suptitle(style.plain(steps[-1].result.problem_name), fontsize=11)
    return figure


def _falling(ax: Axes, x: np.ndarray, relative: np.ndarray, name: str, step: Step) -> None:
    shown = (x > 0) & (relative > 0) & np.isfinite(relative)
    ax.loglog(x[shown], relative[shown], marker="o", color=style.BLUE)
    ax.set_xlabel(name)
    ax.set_ylabel("estimate / value of the goal [-]" if step.estimate.signed is not None else
                  r"estimate / $\|u_h\|_A$ [-]")
    ax.grid(True, which="both")
    for axis, values in ((ax.xaxis, x[shown]), (ax.yaxis, relative[shown])):
        decades = np.log10(values.max() / values.min()) if len(values) else 1.0
        # few labels on long ranges, several on short ones
        subs = (1.0,) if decades > 2 else (1.0, 2.0, 5.0) if decades > 0.7 else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
        style.label_plainly(axis, subs)


def _map(figure: Figure, ax: Axes, step: Step) -> None:
    """Draw the indicator of each element of the last mesh in colours by decades."""
    mesh, parts = step.hierarchy.finest.mesh, np.sqrt(step.estimate.squares)
    scale, unit = style.scaled(style.bounds(mesh.points)[2], "m")
    points, largest = mesh.points * scale, parts.max() or 1.0
    lowest = max(parts.min(initial=largest, where=parts > 0), largest * 10.0**-_DECADES)
    norm = LogNorm(vmin=min(lowest, 0.5 * largest), vmax=largest, clip=True)
    colors = ScalarMappable(norm, "viridis")
    if mesh.dim == 3:
        at_node = np.zeros(mesh.n_nodes)
        np.maximum.at(at_node, mesh.elements.ravel(), np.repeat(parts, 4))
        ax.add_artist(ShadedSurface(points[mesh.facets], colors.to_rgba(at_node[mesh.facets].min(axis=1))))
        finish_axes(ax, points, unit)
        ax.set_axis_off()
    else:
        ax.add_collection(PolyCollection(points[mesh.elements], facecolor=colors.to_rgba(parts), edgecolor="face",
                                         linewidth=0.1, rasterized=True))
        _finish_plane(ax, unit)
    what = r"$\eta_E$ [$\sqrt{\mathrm{N\,m}}$]" if step.estimate.signed is None else r"$|\eta_E|^{1/2}$ of the goal"
    figure.colorbar(colors, ax=ax, label=what, shrink=0.8)
    ax.set_title(f"indicator, step {step.number}", fontsize=9.5)
