"""contact: pressure, friction, gap and slip along contact lines; pressure, friction, gap and state on surfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptmg.plot.contact_surfaces.flattened import flattened
from adaptmg.plot.contact_surfaces.line import Line, lines_of
from adaptmg.plot.contact_surfaces.maps import draw_map, draw_states
from adaptmg.plot.contact_surfaces.panels import blocks, cells, chosen_boundaries, described, keep_open
from adaptmg.plot.states import shade, state_lines, stated_curve
from adaptmg.plot.style import GREEN, axes_of, plain, styled
from adaptmg.problem import checks
from adaptmg.solver.result import Result

__all__ = ["contact"]


@styled
def contact(result: Result, axes: Sequence[Axes] | None = None, *, boundary: object = None) -> Figure:
    r"""Draw pressure, friction, gap and slip on contact boundaries, between two bodies on the slave surface of a pair.

    In 2D, against x or y where the boundary is straight, else against arc length: contact pressure p, MPa; tangential
    traction t on the body, MPa, within the band :math:`\pm \mu p` (Tresca: plus or minus the limit) that friction
    allows; gap and slip, micrometres (mm from 0.1 mm on). Curves and backgrounds have the colours of the states. In 3D:
    maps of pressure, size of the traction and gap, seen along the normal, or unrolled where the surface goes around an
    axis, and the states.

    Parameters
    ----------
    result : Result
    axes : sequence of matplotlib Axes, optional
        To draw one contact boundary into: three in 2D, four in 3D.
    boundary : str, Contact or ContactPair, optional
        The contact boundary, of a pair the slave; default all of them.

    Returns
    -------
    matplotlib.figure.Figure

    Notes
    -----
    Pressures and tractions are nodal forces over the nodes' weights (the lumped mass of the surface, with dual
    multipliers that of its covered part); the gap is that of the constraint, g0 minus the (relative) normal
    displacement.
    """
    solid = checks.instance("result", result, Result).dim == 3
    names = chosen_boundaries(result, boundary, "boundary")
    if axes is not None:
        if len(names) != 1:
            raise ValueError(f"axes takes one contact boundary, the result has {len(names)}: choose with boundary=...")
        panels = [axes_of(axes, 4 if solid else 3, "axes")]
    elif solid:
        panels = [cells(part, 4, 2) for part in blocks(len(names), (9.0, 7.0), columns=1)]
    else:
        panels = [part.subplots(3, sharex=True) for part in blocks(len(names), (6.2, 6.8), columns=3)]
    for name, drawn in zip(names, panels, strict=True):
        (_draw_surface if solid else _draw_lines)(result, name, drawn)
        title = described(result.contact, name)
        if len(names) == 1:
            title = f"{plain(result.problem_name)}: {title}"
        drawn[0].set_title(title, pad=8 if solid else 22)
        drawn[0].figure.align_ylabels()
    figure = panels[0][0].get_figure(root=True)
    if len(names) > 1:
        figure.suptitle(plain(result.problem_name), fontsize=11)
    return figure


def _length_unit(*lengths: np.ndarray) -> tuple[float, str]:
    """Micrometres for small lengths, millimetres for large ones."""
    return (1e3, "mm") if max(np.abs(values).max() for values in lengths) >= 1e-4 else (1e6, "µm")


def _draw_lines(result: Result, name: str, axes: Sequence[Axes]) -> None:
    c, lines = result.contact, lines_of(result, name)
    nodes = np.concatenate([line.index for line in lines])
    scale, unit = _length_unit(c.gap[nodes], c.slip[nodes])
    bound = 1e-6 * c.limit / c.weights
    for line in lines:
        at, s, first = line.index, line.position, line is lines[0]
        for ax in axes:
            shade(ax, s, c.state[at])
        if bound[nodes].any():
            axes[1].fill_between(s, -bound[at], bound[at], facecolor="#c9ced5", edgecolor="#9aa0a8", linewidth=0.8,
                                 alpha=0.55, zorder=1, label="friction bound" if first else None)
        axes[2].plot(s, scale * c.slip[at, 0], color=GREEN, linestyle="--", label="slip" if first else None)
        for ax, values in zip(axes, (1e-6 * c.pressure, 1e-6 * c.traction[:, 0], scale * c.gap), strict=True):
            stated_curve(ax, s, values[at], c.state[at])
    _finish_lines(result, lines, nodes, axes)
    for ax, label in zip(axes, ("pressure p\n[MPa]", "friction t\n[MPa]", f"gap, slip\n[{unit}]"), strict=True):
        ax.set_ylabel(label)


def _finish_lines(result: Result, lines: list[Line], nodes: np.ndarray, axes: Sequence[Axes]) -> None:
    """Limits of the axes and legends."""
    c, bound = result.contact, 1e-6 * result.contact.limit / result.contact.weights
    for ax in axes:
        ax.axhline(0.0, color="#5b626b", linewidth=0.8, zorder=1)
        ax.margins(x=0.0)
    axes[0].set_ylim(bottom=0.0)
    largest = 1e-6 * float(c.pressure.max())
    keep_open(axes[0], 1e-6 * c.pressure[nodes], largest)
    keep_open(axes[1], np.concatenate([-bound[nodes], 1e-6 * c.traction[nodes, 0]]), largest)
    if not bound[nodes].any():
        axes[1].text(0.5, 0.9, "frictionless", transform=axes[1].transAxes, ha="center", va="top", color="#5b626b")
    for ax in axes[1:] if bound[nodes].any() else axes[2:]:
        ax.legend(loc="best", frameon=True, framealpha=0.85, edgecolor="none")
    low, high = axes[2].get_ylim()
    # closed and stuck everywhere: rounding is not to fill the axes
    axes[2].set_ylim(min(low, -0.05), max(high, 0.5))
    axes[2].set_xlabel(lines[0].label)
    axes[0].legend(handles=state_lines(c.state[nodes]), loc="lower center", bbox_to_anchor=(0.5, 0.98), ncols=3)


def _draw_surface(result: Result, name: str, axes: Sequence[Axes]) -> None:
    c, flat = result.contact, flattened(result, name)
    at = flat.index
    scale, unit = _length_unit(c.gap[at])
    largest = 1e-6 * float(c.pressure.max())
    draw_map(axes[0], flat, 1e-6 * c.pressure[at], "contact pressure p [MPa]", largest=largest)
    draw_map(axes[1], flat, 1e-6 * np.linalg.norm(c.traction[at], axis=1), "friction traction |t| [MPa]",
             largest=largest)
    # closed everywhere: a nanometre is rounding
    draw_map(axes[2], flat, scale * c.gap[at], f"gap [{unit}]", largest=1e6 if unit == "µm" else 0.0)
    draw_states(axes[3], flat, c.state[at])
