"""deformed: the deformed body over its outline before, coloured by displacement or stress."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from adaptmg.mesh.topology import facet_keys, facet_table
from adaptmg.plot.solid import draw_facets, finish_axes
from adaptmg.plot.stress import von_mises
from adaptmg.plot.style import GREY, INK, PALE, bounds, canvas, number, scaled, styled
from adaptmg.problem import Elastic, checks
from adaptmg.solver.result import Result

__all__ = ["deformed"]


@styled
def deformed(result: Result, amplification: float | None = None, quantity: str | None = "magnitude",
             ax: Axes | None = None, *, material: Elastic | None = None) -> Figure:
    """Draw the deformed body; the title states the amplification.

    Parameters
    ----------
    result : Result
        With a mesh.
    amplification : float, optional
        Of the displacements, >= 0; by default the largest is drawn as about 5 % of the size of the body.
    quantity : {"magnitude", "von_mises"} or None
        What the colours show: length of the displacement (linear in each element), von Mises stress (constant in
        each; in 3D that of the element behind each facet), or None for the mesh alone.
    ax : matplotlib Axes, optional
        In 3D with ``projection="3d"``.
    material : PlaneStrain, PlaneStress or Solid, optional
        For the stress; a result does not carry it.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        Without a mesh, or without a material for the stress.
    """
    if not isinstance(result, Result):
        raise TypeError(f"result must be a Result, got {type(result).__name__}")
    if result.mesh is None:
        raise ValueError("this result has no mesh to draw (it comes from a bare DiscreteProblem)")
    if quantity is not None:
        checks.choice("quantity", quantity, ("magnitude", "von_mises"))
    if quantity == "von_mises" and not isinstance(material, Elastic):
        raise ValueError("quantity='von_mises' needs the material: give material=problem.material")
    size = bounds(result.mesh.points)[2]
    factor = _automatic(result, size) if amplification is None else checks.nonnegative("amplification", amplification)
    scale, unit = scaled(size, "m")
    ax = canvas(ax, (6.0, 5.0), result.dim)
    before, after = result.mesh.points * scale, (result.mesh.points + factor * result.displacement) * scale
    values, label = _values(result, quantity, material)
    norm = None if values is None else Normalize(0.0, max(float(values.max()), np.finfo(float).tiny))
    (_draw_solid if result.dim == 3 else _draw_plane)(ax, result, before, after, values, norm)
    if norm is not None:
        bar = ax.figure.colorbar(ScalarMappable(norm, "viridis"), ax=ax, shrink=0.75, pad=0.05 * result.dim - 0.06)
        bar.set_label(label)
        bar.outline.set_visible(False)
    if result.dim == 3:
        finish_axes(ax, np.vstack([before, after]), unit)
    else:
        ax.set_aspect("equal")
        ax.autoscale_view()
        ax.spines[:].set_visible(False)
        ax.set_xlabel(f"x [{unit}]")
        ax.set_ylabel(f"y [{unit}]")
    ax.set_title(f"{result.problem_name}: displacement drawn {number(factor)} times")
    return ax.figure


def _automatic(result: Result, size: float) -> float:
    """A round factor that makes the largest displacement about 5 % of the size; 1 if nothing moves."""
    largest = float(np.linalg.norm(result.displacement, axis=1).max())
    if not largest > 1e-12 * size:
        return 1.0
    wanted = 0.05 * size / largest
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * min((1, 2, 5, 10), key=lambda m: abs(np.log(m * power / wanted))))


def _values(result: Result, quantity: str | None, material: Elastic | None) -> tuple[np.ndarray | None, str]:
    """Values to colour by, at nodes or elements, and the label of the colour bar."""
    if quantity is None:
        return None, ""
    if quantity == "magnitude":
        values, name, unit = np.linalg.norm(result.displacement, axis=1), "displacement |u|", "m"
    else:
        values, name, unit = von_mises(result.mesh, result.displacement, material), "von Mises stress", "Pa"
    scale, unit = scaled(float(values.max()), unit)
    return values * scale, f"{name} [{unit}]"


def _draw_plane(ax: Axes, result: Result, before: np.ndarray, after: np.ndarray, values: np.ndarray | None,
                norm: Normalize | None) -> None:
    elements, facets = result.mesh.elements, result.mesh.facets
    width = float(np.clip(12 / np.sqrt(len(elements)), 0.08, 0.6))
    if values is None:
        ax.add_collection(PolyCollection(after[elements], facecolor=PALE, edgecolor=INK, linewidth=width))
    else:
        grid = Triangulation(*after.T, elements)
        if len(values) == len(after):
            ax.tripcolor(grid, values, norm=norm, cmap="viridis", shading="gouraud", rasterized=True)
        else:
            ax.tripcolor(grid, facecolors=values, norm=norm, cmap="viridis", rasterized=True)
        ax.add_collection(PolyCollection(after[elements], facecolor="none", edgecolor="white", linewidth=0.5 * width))
    ax.add_collection(LineCollection(before[facets], color=GREY, linewidth=1.0, linestyle=(0, (4, 3)), zorder=3))
    ax.add_collection(LineCollection(after[facets], color=INK, linewidth=1.1, zorder=4))


def _draw_solid(ax: Axes, result: Result, before: np.ndarray, after: np.ndarray, values: np.ndarray | None,
                norm: Normalize | None) -> None:
    facets = result.mesh.facets
    if values is None:
        colors: np.ndarray | str = PALE
    else:
        shown = values[facets].mean(axis=1) if len(values) == len(after) else values[_behind(result)]
        colors = ScalarMappable(norm, "viridis").to_rgba(shown)
    draw_facets(ax, after[facets], colors)
    edges = _sharp_edges(before, facets)
    ax.add_collection3d(Line3DCollection(before[edges], color=GREY, linewidth=1.0, linestyle=(0, (4, 3))))


def _behind(result: Result) -> np.ndarray:
    """The element behind each boundary facet (n_facets,)."""
    mesh = result.mesh
    table = facet_table(mesh.elements, mesh.n_nodes)
    return table.first[table.find(facet_keys(mesh.facets, mesh.n_nodes))]


def _sharp_edges(points: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Edges of the surface (n, 2) where it bends by more than 30 degrees."""
    normals = np.cross(points[facets[:, 1]] - points[facets[:, 0]], points[facets[:, 2]] - points[facets[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]
    edges = np.sort(np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(facets)), 3)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], owner[order]
    same = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    bend = np.einsum("ni,ni->n", normals[owner[same]], normals[owner[same + 1]])
    return edges[same[bend < np.cos(np.pi / 6)]]
