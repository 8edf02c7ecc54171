"""Surfaces of solids: shaded boundary triangles in matplotlib's three-dimensional axes."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LightSource
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from adaptmg.plot.style import INK, bounds

__all__ = ["draw_facets", "finish_axes"]

#: triangles above which their edges would only blacken the picture
_EDGES_UP_TO = 6000


def draw_facets(ax: Axes3D, corners: np.ndarray, colors: np.ndarray | str) -> Poly3DCollection:
    """Draw triangles (n, 3, 3) in plot units in one colour or colours (n, 4), shaded by their direction."""
    from matplotlib.colors import to_rgba_array

    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]
    light = LightSource(azdeg=220, altdeg=50).direction
    shade = 0.84 + 0.16 * np.clip(normals @ light, -1.0, 1.0)
    rgba = np.broadcast_to(to_rgba_array(colors), (len(corners), 4)).copy()
    rgba[:, :3] *= shade[:, None]
    width = 0.0 if len(corners) > _EDGES_UP_TO else float(np.clip(12 / np.sqrt(len(corners)), 0.15, 0.6))
    edges = rgba if width == 0.0 else INK
    patches = Poly3DCollection(corners, facecolors=rgba, edgecolors=edges, linewidths=max(width, 0.1))
    ax.add_collection3d(patches)
    return patches


def finish_axes(ax: Axes3D, points: np.ndarray, unit: str) -> None:
    """Equal scales around points (n, 3), labels with units, plain panes, the common view."""
    lower, upper, _ = bounds(points)
    extent = np.maximum(upper - lower, 1e-3 * np.max(upper - lower))
    for axis, low, wide, name in zip((ax.xaxis, ax.yaxis, ax.zaxis), lower, extent, "xyz", strict=True):
        getattr(ax, f"set_{name}lim")(low - 0.02 * wide, low + 1.02 * wide)
        getattr(ax, f"set_{name}label")(f"{name} [{unit}]", labelpad=2)
        axis.pane.set_facecolor("white")
        axis.pane.set_edgecolor("#dfe3e8")
        axis.set_major_locator(MaxNLocator(nbins=4 if wide > 0.4 * extent.max() else 2))
        axis.set_tick_params(labelsize=8, pad=0)
    ax.grid(False)
    ax.set_box_aspect(extent)
    ax.view_init(elev=22, azim=-58)
