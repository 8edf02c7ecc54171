"""mesh and grids: the triangles, or in three dimensions the boundary facets, with the contact boundary marked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure

from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.plot.space.axes import finish_axes, view_of
from adaptmg.plot.space.surface import draw_facets
from adaptmg.plot.style import BODY_COLORS, INK, ORANGE, PALE, axes_of, bounds, canvas, new_figure, scaled, styled
from adaptmg.problem import checks

__all__ = ["grids", "mesh"]


@styled
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
    """
    checks.instance("drawn", drawn, MeshArrays, "MeshArrays (read a mesh file with am.Hierarchy.from_meshes or "
                    "adaptmg.mesh.user.as_mesh)")
    ax = canvas(ax, (5.4, 5.0), drawn.dim)
    _draw(drawn, ax, contact)
    ax.set_title(f"{drawn.n_nodes} nodes, {len(drawn.elements)} elements")
    return ax.figure


@styled
def grids(hierarchy: Hierarchy, axes: Sequence[Axes] | None = None) -> Figure:
    """Draw the grids of a hierarchy side by side, coarsest first, with their numbers of nodes.

    Parameters
    ----------
    hierarchy : Hierarchy
        Made of meshes.
    axes : sequence of matplotlib Axes, optional
        One a level; in 3D with ``projection="3d"``.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        If a level has no mesh.
    """
    levels = checks.instance("hierarchy", hierarchy, Hierarchy).levels
    without = [k for k, level in enumerate(levels) if level.mesh is None]
    if without:
        raise ValueError(f"levels {without} have no mesh to draw: make the hierarchy from meshes")
    dim = hierarchy.finest.mesh.dim
    if axes is None:
        columns = min(len(hierarchy), 4)
        rows = -(-len(hierarchy) // columns)
        figure = new_figure((3.1 * columns, 3.3 * rows))
        axes = [figure.add_subplot(rows, columns, k + 1, projection="3d" if dim == 3 else None)
                for k in range(len(hierarchy))]
    axes = axes_of(axes, len(hierarchy), "axes")
    for k, (level, ax) in enumerate(zip(levels, axes, strict=True)):
        _draw(level.mesh, canvas(ax, (1, 1), dim), level.discrete.contact.names)
        ax.set_title(f"level {k}: {level.mesh.n_nodes} nodes, {len(level.discrete.contact)} contact", fontsize=9.5)
        if dim == 3:
            # many small axes would cover each other's labels
            ax.set_axis_off()
        elif k % 4:
            ax.set_ylabel("")
    return axes[0].figure


def _draw(drawn: MeshArrays, ax: Axes, contact: Sequence[str]) -> None:
    scale, unit = scaled(bounds(drawn.points)[2], "m")
    points = drawn.points * scale
    marked = np.isin(drawn.facet_labels, [drawn.boundaries.index(name) for name in contact if name in drawn.boundaries])
    several = len(drawn.bodies) > 1
    fills = to_rgba_array([BODY_COLORS[k % len(BODY_COLORS)] for k in range(len(drawn.bodies))] if several else [PALE])
    if drawn.dim == 3:
        body = np.zeros(drawn.n_nodes, dtype=int)
        body[drawn.elements] = drawn.element_body[:, None]
        colors = np.where(marked[:, None], np.array([0.93, 0.55, 0.25, 1.0]), fills[body[drawn.facets[:, 0]]])
        draw_facets(ax, points[drawn.facets], colors)
        finish_axes(ax, points, unit)
        view_of(ax, points[drawn.facets[marked]])
        return
    width = float(np.clip(18 / np.sqrt(len(drawn.elements)), 0.12, 0.7))
    ax.add_collection(PolyCollection(points[drawn.elements], facecolor=fills[drawn.element_body],
                                     edgecolor=INK, linewidth=width))
    ax.add_collection(LineCollection(points[drawn.facets], color=INK, linewidth=0.9))
    ax.add_collection(LineCollection(points[drawn.facets[marked]], color=ORANGE, linewidth=2.4, capstyle="butt"))
    ax.set_aspect("equal")
    ax.autoscale_view()
    ax.spines[:].set_visible(False)
    ax.set_xlabel(f"x [{unit}]")
    ax.set_ylabel(f"y [{unit}]")
