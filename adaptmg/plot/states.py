"""Open, slip and stick in pictures: the same three colours everywhere, on curves, interfaces and backgrounds."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.lines import Line2D

from adaptmg.smoother.state import OPEN, SLIP, STICK

__all__ = ["STATE_COLORS", "STATE_INKS", "STATE_NAMES", "halves", "shade", "state_colormap", "state_lines",
           "stated_curve"]

#: pale enough to draw on
STATE_COLORS = {OPEN: "#f1f2f4", SLIP: "#fbe3d3", STICK: "#d6e8f5"}
#: strong enough for lines and marks
STATE_INKS = {OPEN: "#9aa0a8", SLIP: "#e69f00", STICK: "#0072b2"}
STATE_NAMES = {OPEN: "open", SLIP: "slip", STICK: "stick"}


def state_colormap() -> tuple[ListedColormap, BoundaryNorm]:
    """Colour map and norm of the codes 0, 1, 2."""
    return ListedColormap([STATE_INKS[s] for s in (OPEN, SLIP, STICK)]), BoundaryNorm([-0.5, 0.5, 1.5, 2.5], 3)


def shade(ax: Axes, position: np.ndarray, state: np.ndarray) -> None:
    """Shade the background in runs of equal state; they meet half way between nodes.

    Parameters
    ----------
    ax : matplotlib Axes
    position : (n,) array
        Increasing, in units of the axis.
    state : (n,) int array
    """
    starts = np.flatnonzero(np.diff(state, prepend=state[0] - 1))
    ends = np.append(starts[1:], len(state)) - 1
    for a, b in zip(starts, ends, strict=True):
        left = position[a] if a == 0 else 0.5 * (position[a - 1] + position[a])
        right = position[b] if b == len(state) - 1 else 0.5 * (position[b] + position[b + 1])
        ax.axvspan(left, right, facecolor=STATE_COLORS[int(state[a])], edgecolor="none", linewidth=0, zorder=0)


def halves(points: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """A polyline cut half way between its nodes, each half in the colour of its node.

    Parameters
    ----------
    points : (n, 2) array
    state : (n,) int array

    Returns
    -------
    segments : (2 (n - 1), 2, 2) array
    colors : list of str
    """
    middle = 0.5 * (points[:-1] + points[1:])
    segments = np.stack([np.stack([points[:-1], middle], 1), np.stack([middle, points[1:]], 1)], 1).reshape(-1, 2, 2)
    codes = np.stack([state[:-1], state[1:]], 1).ravel()
    return segments, [STATE_INKS[int(code)] for code in codes]


def stated_curve(ax: Axes, position: np.ndarray, values: np.ndarray, state: np.ndarray, linewidth: float = 1.8) -> None:
    """Draw values against position as a curve coloured by state; with marks where these can be told apart."""
    segments, colors = halves(np.stack([position, values], 1), state)
    ax.add_collection(LineCollection(segments, colors=colors, linewidths=linewidth, capstyle="round", zorder=3))
    size = 9.0 if len(position) <= 150 else 0.0
    ax.scatter(position, values, s=size, c=[STATE_INKS[int(code)] for code in state], linewidths=0, zorder=4)


def state_lines(states: Iterable[int], linewidth: float = 3.0) -> list[Line2D]:
    """Legend entries of coloured lines, for the states that occur."""
    present = set(map(int, states))
    return [Line2D([], [], color=STATE_INKS[s], linewidth=linewidth, label=STATE_NAMES[s])
            for s in (OPEN, SLIP, STICK) if int(s) in present]
