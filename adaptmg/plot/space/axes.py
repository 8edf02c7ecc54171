"""Three-dimensional axes as all pictures of solids have them, and where they are best seen from."""

from __future__ import annotations

import numpy as np
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D

from adaptmg.plot.space.surface import normals_of, viewer
from adaptmg.plot.style import bounds

__all__ = ["finish_axes", "view_of"]

#: elevations and azimuths in degrees, the common one first
_VIEWS = ((22, -58), (22, -148), (-24, -58), (-24, -148), (22, 32), (22, 122), (-24, 32), (-24, 122))


def view_of(ax: Axes3D, corners: np.ndarray) -> None:
    """Look from where most of some triangles (n, 3, 3) of a body shows: from the common side if that will do."""
    if not len(corners):
        return
    normals = normals_of(corners)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    best, found = 0.0, _VIEWS[0]
    for elevation, azimuth in _VIEWS:
        shown = float(areas @ np.maximum(normals @ viewer(elevation, azimuth), 0.0)) / float(areas.sum())
        if shown > 1.2 * best + 0.05:
            best, found = shown, (elevation, azimuth)
    ax.view_init(elev=found[0], azim=found[1])


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
    ax.set_box_aspect(extent, zoom=0.92)
    ax.view_init(elev=22, azim=-58)
