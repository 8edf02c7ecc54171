"""A contact surface in three dimensions, made flat: maps of pressure, traction or gap, and the states of the nodes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation

from adaptmg.plot.contact_surfaces.flattened import Flat
from adaptmg.plot.states import STATE_INKS, STATE_NAMES, state_colormap
from adaptmg.plot.style import INK
from adaptmg.smoother.state import OPEN, SLIP, STICK

__all__ = ["draw_map", "draw_states"]


def draw_map(ax: Axes, flat: Flat, values: np.ndarray, label: str, norm: Normalize | None = None,
             bar: bool = True, largest: float = 0.0) -> None:
    """Draw nodal values in colours.

    Parameters
    ----------
    ax : matplotlib Axes
    flat : Flat
    values : (n,) array
        At ``flat.index``.
    label : str
        Of the colour bar.
    norm : matplotlib Normalize, optional
        By default from zero, or from the smallest value where that is negative.
    bar : bool
        Whether to draw a colour bar.
    largest : float
        Of such values elsewhere: what is only rounding beside it is drawn as zero.
    """
    if norm is None:
        low, high = min(float(values.min()), 0.0), float(values.max())
        norm = Normalize(low, high) if high - low > 1e-9 * largest else Normalize(0.0, 1.0)
    if flat.triangles is None:
        shown = ax.scatter(*flat.points.T, c=values, s=18, cmap="viridis", norm=norm)
    else:
        shown = ax.tripcolor(Triangulation(*flat.points.T, flat.triangles), values, cmap="viridis", shading="gouraud",
                             norm=norm, rasterized=True)
    if bar:
        ax.figure.colorbar(shown, ax=ax, shrink=0.8, label=label).outline.set_visible(False)
    _finish(ax, flat)


def draw_states(ax: Axes, flat: Flat, states: np.ndarray) -> None:
    """Draw the nodes in the colours of their states, over the triangles; the legend counts them."""
    colors, norm = state_colormap()
    if flat.triangles is not None:
        ax.triplot(Triangulation(*flat.points.T, flat.triangles), color="#c9ced5", linewidth=0.4, zorder=1)
    size = float(np.clip(4000 / len(states), 1.5, 40.0))
    ax.scatter(*flat.points.T, c=states.astype(float), s=size, cmap=colors, norm=norm, zorder=2, edgecolors=INK,
               linewidths=0.2)
    counts = np.bincount(states.astype(int), minlength=3)
    ax.legend(handles=[Patch(color=STATE_INKS[s], label=f"{STATE_NAMES[s]} ({counts[int(s)]})")
                       for s in (OPEN, SLIP, STICK)],
              loc="lower center", bbox_to_anchor=(0.5, 0.98), ncols=3, handlelength=1.2, columnspacing=1.2)
    _finish(ax, flat)


def _finish(ax: Axes, flat: Flat) -> None:
    ax.set_aspect("equal" if flat.equal else "auto")
    ax.set_xlabel(flat.labels[0])
    ax.set_ylabel(flat.labels[1])
