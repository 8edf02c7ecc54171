"""A contact surface in three dimensions, seen along its normal: pressure beside states."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation

from adaptmg.plot.style import INK, scaled
from adaptmg.solver.result import Result

__all__ = ["draw_surface"]

_COLORS, _NAMES = ("#dfe2e6", "#e69f00", "#0072b2"), ("open", "slip", "stick")


def draw_surface(result: Result, boundary: str, axes: list[Axes]) -> None:
    """Draw pressure into the first axes and states into the second.

    Parameters
    ----------
    result : Result
        Three-dimensional; with a mesh its triangles are drawn, else a point a node.
    boundary : str
        Contact boundary.
    axes : list of two matplotlib Axes
    """
    c = result.contact
    index = np.flatnonzero(c.boundary == c.names.index(boundary))
    points, labels = _plane_coordinates(c.x[index], c.normal[index])
    triangles = _triangles(result, boundary, index)
    pressure, states = 1e-6 * c.pressure[index], np.asarray(c.state[index], dtype=float)
    top = max(float(pressure.max()), np.finfo(float).tiny)
    colors, steps = ListedColormap(_COLORS), BoundaryNorm([-0.5, 0.5, 1.5, 2.5], 3)
    if triangles is None:
        shown = axes[0].scatter(*points.T, c=pressure, s=18, cmap="viridis", vmin=0.0, vmax=top)
        axes[1].scatter(*points.T, c=states, s=18, cmap=colors, norm=steps)
    else:
        grid = Triangulation(*points.T, triangles)
        shown = axes[0].tripcolor(grid, pressure, cmap="viridis", shading="gouraud", vmin=0.0, vmax=top,
                                  rasterized=True)
        axes[1].triplot(grid, color="#c9ced5", linewidth=0.4, zorder=1)
        size = float(np.clip(4000 / len(index), 1.5, 40.0))
        axes[1].scatter(*points.T, c=states, s=size, cmap=colors, norm=steps, zorder=2, edgecolors=INK, linewidths=0.2)
    bar = axes[0].figure.colorbar(shown, ax=axes[0], shrink=0.8, label="contact pressure [MPa]")
    bar.outline.set_visible(False)
    counts = np.bincount(states.astype(int), minlength=3)
    axes[1].legend(handles=[Patch(color=color, label=f"{name} ({n})")
                            for color, name, n in zip(_COLORS, _NAMES, counts, strict=True)],
                   loc="upper left", bbox_to_anchor=(1.0, 1.0), title="nodes", alignment="left")
    for ax, what in zip(axes, ("pressure", "state"), strict=True):
        ax.set_title(f"{what} on {boundary!r}")
        ax.set_aspect("equal")
        ax.set_xlabel(labels[0])
        ax.set_ylabel(labels[1])


def _plane_coordinates(x: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, tuple[str, str]]:
    """Coordinates (n, 2) across the mean normal, and their labels; Cartesian ones for a normal along an axis."""
    if not np.isfinite(x).all():
        raise ValueError("this result has no coordinates to draw a contact surface in: give the DiscreteProblem its "
                         "coordinates")
    mean = normals.mean(axis=0)
    across = int(np.argmax(np.abs(mean)))
    keep = [k for k in range(3) if k != across]
    scale, unit = scaled(float(np.ptp(x, axis=0).max()), "m")
    if np.abs(mean[keep]).max() > 1e-6 * abs(mean[across]):
        # project along the mean normal, the first axis as near as it can be to the first Cartesian one left
        n = mean / np.linalg.norm(mean)
        first = np.eye(3)[keep[0]] - n[keep[0]] * n
        first /= np.linalg.norm(first)
        frame = np.stack([first, np.cross(n, first)], axis=1)
        return scale * (x - x.mean(axis=0)) @ frame, (f"along t1 [{unit}]", f"along t2 [{unit}]")
    return scale * x[:, keep], tuple(f"{'xyz'[k]} [{unit}]" for k in keep)


def _triangles(result: Result, boundary: str, index: np.ndarray) -> np.ndarray | None:
    """Facets of the boundary whose corners are all contact nodes, numbered within ``index``; None without any."""
    if result.mesh is None:
        return None
    place = np.full(result.mesh.n_nodes, -1)
    place[result.contact.node[index]] = np.arange(len(index))
    triangles = place[result.mesh.boundary_facets(boundary)]
    triangles = triangles[(triangles >= 0).all(axis=1)]
    return triangles if len(triangles) else None
