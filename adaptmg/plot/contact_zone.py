"""contact: pressure, friction, gap and slip along contact lines; pressure and state on contact surfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptmg.plot.line import Line, lines_of
from adaptmg.plot.panels import blocks, cells, chosen_boundaries, described, keep_open
from adaptmg.plot.states import STATE_COLORS, shade, state_patches
from adaptmg.plot.style import BLUE, GREEN, INK, ORANGE, axes_of, styled
from adaptmg.solver.result import Result

__all__ = ["STATE_COLORS", "contact"]


@styled
def contact(result: Result, axes: Sequence[Axes] | None = None, *, boundary: str | None = None) -> Figure:
    """Draw contact quantities.

    In 2D, along each contact boundary: above, contact pressure, tangential traction and what friction allows, MPa;
    below, gap and slip, micrometres; the zones open, slip and stick are shaded. In 3D, seen along the normal: pressure
    and states. Pressures and tractions are nodal forces over lumped boundary mass. Between two bodies all are those of
    the slave surface, gap and slip relative to the master; see :func:`adaptmg.plot.interface` too.

    Parameters
    ----------
    result : Result
    axes : pair of matplotlib Axes, optional
        To draw one contact boundary into.
    boundary : str, optional
        Name of the contact boundary, of a pair the slave; default all of them.

    Returns
    -------
    matplotlib.figure.Figure
    """
    if not isinstance(result, Result):
        raise TypeError(f"result must be a Result, got {type(result).__name__}")
    names = chosen_boundaries(result, boundary, "boundary")
    if axes is not None:
        if len(names) != 1:
            raise ValueError(f"axes takes one contact boundary, the result has {len(names)}: choose with boundary=...")
        panels = [axes_of(axes, 2, "axes")]
    elif result.dim == 3:
        panels = [cells(part, 2, 2) for part in blocks(len(names), (9.0, 4.0), columns=1)]
    else:
        size = (7.0 if len(names) == 1 else 5.6, 5.4)
        panels = [part.subplots(2, sharex=True) for part in blocks(len(names), size, columns=3)]
    for name, pair in zip(names, panels, strict=True):
        if result.dim == 3:
            from adaptmg.plot.contact_surface import draw_surface

            draw_surface(result, name, pair)
        else:
            _draw_line(result, lines_of(result, name), *pair)
            pair[0].set_title(f"{result.problem_name}: contact on {name!r}" if len(names) == 1
                              else described(result.contact, name), pad=22)
        pair[0].figure.align_ylabels()
    figure = panels[0][0].figure if axes is not None else panels[0][0].get_figure(root=True)
    if len(names) > 1:
        figure.suptitle(result.problem_name)
    return figure


def _draw_line(result: Result, lines: list[Line], upper: Axes, lower: Axes) -> None:
    c = result.contact
    for line in lines:
        at, s = line.index, line.position
        shade(upper, s, c.state[at])
        shade(lower, s, c.state[at])
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
    lower.axhline(0.0, color="#5b626b", linewidth=0.8, zorder=1)
    upper.set_ylim(bottom=0.0)
    keep_open(upper, c.pressure[np.concatenate([line.index for line in lines])], float(c.pressure.max()))
    for ax in (upper, lower):
        ax.margins(x=0.0)
        ax.legend(loc="best", frameon=True, framealpha=0.85, edgecolor="none")
    _legend_of_states(upper, {int(state) for line in lines for state in c.state[line.index]})


def _legend_of_states(ax: Axes, present: set[int]) -> None:
    """The states above the axes, beside the legend of the curves."""
    curves = ax.get_legend()
    ax.legend(handles=state_patches(present), loc="lower center", bbox_to_anchor=(0.5, 0.99), ncols=3, handlelength=1.4)
    ax.add_artist(curves)
