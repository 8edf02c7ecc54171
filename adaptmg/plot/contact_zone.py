"""contact: pressure, friction, gap and slip along contact lines; pressure and state on contact surfaces."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from adaptmg.plot.line import Line, lines_of
from adaptmg.plot.style import BLUE, GREEN, INK, ORANGE, axes_of, styled
from adaptmg.problem import checks
from adaptmg.smoother.state import OPEN, SLIP, STICK
from adaptmg.solver.result import Result

__all__ = ["STATE_COLORS", "contact"]

#: pale enough to draw on
STATE_COLORS = {OPEN: "#f1f2f4", SLIP: "#fbe3d3", STICK: "#d6e8f5"}
_NAMES = {OPEN: "open", SLIP: "slip", STICK: "stick"}


@styled
def contact(result: Result, axes: Sequence[Axes] | None = None, *, boundary: str | None = None) -> Figure:
    """Draw contact quantities.

    In 2D, along each contact boundary: above, contact pressure, tangential traction and what friction allows, MPa;
    below, gap and slip, micrometres; the zones open, slip and stick are shaded. In 3D, seen along the normal: pressure
    and states. Pressures and tractions are nodal forces over lumped boundary mass.

    Parameters
    ----------
    result : Result
    axes : pair of matplotlib Axes, optional
        To draw one contact boundary into.
    boundary : str, optional
        Name of the contact boundary; default all of them.

    Returns
    -------
    matplotlib.figure.Figure
    """
    if not isinstance(result, Result):
        raise TypeError(f"result must be a Result, got {type(result).__name__}")
    names = result.contact.names if boundary is None else (checks.choice("boundary", boundary, result.contact.names),)
    names = tuple(n for n in names if (result.contact.boundary == result.contact.names.index(n)).any())
    if result.dim == 3:
        from adaptmg.plot.contact_surface import draw_surface

        axes = _panels(axes, len(names), (9.0, 4.0), stacked=False)
        for k, name in enumerate(names):
            draw_surface(result, name, axes[2 * k:2 * k + 2])
    else:
        axes = _panels(axes, len(names), (7.0, 5.4), stacked=True)
        for k, name in enumerate(names):
            _draw_line(result, name, lines_of(result, name), axes[2 * k], axes[2 * k + 1])
    axes[0].figure.align_ylabels()
    return axes[0].figure


def _panels(axes: Sequence[Axes] | None, count: int, size: tuple[float, float], stacked: bool) -> list[Axes]:
    """Two axes for each contact boundary, boundary by boundary."""
    if axes is not None:
        if count != 1:
            raise ValueError(f"axes takes one contact boundary, the result has {count}: choose with boundary=...")
        return axes_of(axes, 2, "axes")
    if stacked:
        _, grid = plt.subplots(2, count, figsize=(size[0] * (1 if count == 1 else 0.8 * count), size[1]), sharex="col",
                               squeeze=False)
        return list(grid.T.ravel())
    _, grid = plt.subplots(count, 2, figsize=(size[0], size[1] * count), squeeze=False)
    return list(grid.ravel())


def _draw_line(result: Result, name: str, lines: list[Line], upper: Axes, lower: Axes) -> None:
    c = result.contact
    for line in lines:
        at, s = line.index, line.position
        _shade(upper, s, c.state[at])
        _shade(lower, s, c.state[at])
        first = line is lines[0]

        def draw(ax: Axes, values: np.ndarray, color: str, label: str, s: np.ndarray = s, first: bool = first) -> None:
            ax.plot(s, values, marker="o" if len(s) <= 150 else "", markersize=3, color=color,
                    label=label if first else None)

        if c.limit.any():
            # broad and below: where a node slips the traction lies on it
            upper.plot(s, 1e-6 * c.limit[at] / c.weights[at], color="#b4b9c0", linewidth=5,
                       label="friction bound" if first else None)
        draw(upper, 1e-6 * c.pressure[at], BLUE, "pressure p")
        draw(upper, 1e-6 * np.abs(c.traction[at, 0]), ORANGE, "traction |t|")
        draw(lower, 1e6 * c.gap[at], INK, "gap")
        draw(lower, 1e6 * c.slip[at, 0], GREEN, "slip")
    upper.set_ylabel("pressure, traction [MPa]")
    lower.set_ylabel("gap, slip [µm]")
    lower.set_xlabel(lines[0].label)
    upper.set_title(f"{result.problem_name}: contact on {name!r}", pad=22)
    lower.axhline(0.0, color="#5b626b", linewidth=0.8, zorder=1)
    upper.set_ylim(bottom=0.0)
    for ax in (upper, lower):
        ax.margins(x=0.0)
        ax.legend(loc="best", frameon=True, framealpha=0.85, edgecolor="none")
    _legend_of_states(upper, {int(state) for line in lines for state in c.state[line.index]})


def _shade(ax: Axes, position: np.ndarray, state: np.ndarray) -> None:
    """Shade runs of equal state; they meet half way between nodes."""
    starts = np.flatnonzero(np.diff(state, prepend=state[0] - 1))
    ends = np.append(starts[1:], len(state)) - 1
    for a, b in zip(starts, ends, strict=True):
        left = position[a] if a == 0 else 0.5 * (position[a - 1] + position[a])
        right = position[b] if b == len(state) - 1 else 0.5 * (position[b] + position[b + 1])
        ax.axvspan(left, right, facecolor=STATE_COLORS[int(state[a])], edgecolor="none", linewidth=0, zorder=0)


def _legend_of_states(ax: Axes, present: set[int]) -> None:
    """The states above the axes, beside the legend of the curves."""
    patches = [Patch(facecolor=STATE_COLORS[s], edgecolor=np.array(to_rgb(STATE_COLORS[s])) * 0.8, label=_NAMES[s])
               for s in (OPEN, SLIP, STICK) if int(s) in present]
    curves = ax.get_legend()
    ax.legend(handles=patches, loc="lower center", bbox_to_anchor=(0.5, 0.99), ncols=3, handlelength=1.4)
    ax.add_artist(curves)
