"""interface: what two bodies do to each other along their common surface, pair by pair."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptmg.plot.contact_surface import draw_map, draw_states
from adaptmg.plot.flattened import flattened
from adaptmg.plot.line import Line, arcs_of
from adaptmg.plot.panels import blocks, cells, chosen_boundaries, described, keep_open
from adaptmg.plot.states import shade, state_lines, stated_curve
from adaptmg.plot.style import styled
from adaptmg.solver.result import Result

__all__ = ["interface"]


@styled
def interface(result: Result, pair: object = None) -> Figure:
    r"""Draw pressure, friction and gap on the slave surface of each contact pair.

    In 2D, against arc length along the slave surface, mm: contact pressure p, MPa; tangential traction t on the slave,
    MPa, within the band :math:`\pm \mu p` (Tresca: plus or minus the limit) that friction allows; and the gap,
    micrometres (mm from 0.1 mm on). Curves and backgrounds have the colours of the states. In 3D: maps of the same on
    the slave surface seen along its normal, or unrolled where it goes around an axis, and the states.

    Parameters
    ----------
    result : Result
    pair : str or ContactPair, optional
        The slave boundary of a pair (or a boundary in front of a rigid obstacle); by default all.

    Returns
    -------
    matplotlib.figure.Figure

    Notes
    -----
    Pressures and tractions are nodal forces over the nodes' weights (the lumped mass of the slave surface, with dual
    multipliers that of its covered part); the gap is that of the constraint, g0 minus the relative normal displacement.
    """
    if not isinstance(result, Result):
        raise TypeError(f"result must be a Result, got {type(result).__name__}")
    names = chosen_boundaries(result, pair, "pair")
    if result.dim == 3:
        panels = [cells(part, 4, 2) for part in blocks(len(names), (9.0, 7.0), columns=1)]
    else:
        panels = [part.subplots(3, sharex=True) for part in blocks(len(names), (6.2, 6.8), columns=3)]
    for name, axes in zip(names, panels, strict=True):
        if result.dim == 3:
            _draw_surface(result, name, axes)
        else:
            _draw_lines(result, arcs_of(result, name), axes)
        title = described(result.contact, name)
        axes[0].set_title(title if result.dim == 2 else f"{title}: pressure", pad=22 if result.dim == 2 else None)
        if result.dim == 2:
            axes[0].figure.align_ylabels()
    figure = panels[0][0].get_figure(root=True)
    figure.suptitle(result.problem_name, fontsize=11)
    return figure


def _gap_unit(gap: np.ndarray) -> tuple[float, str]:
    """Micrometres for small gaps, millimetres for large ones."""
    return (1e3, "mm") if np.abs(gap).max() >= 1e-4 else (1e6, "µm")


def _draw_lines(result: Result, lines: list[Line], axes: list[Axes]) -> None:
    c = result.contact
    nodes = np.concatenate([line.index for line in lines])
    scale, unit = _gap_unit(c.gap[nodes])
    bound = 1e-6 * c.limit / c.weights
    for line in lines:
        at, s = line.index, line.position
        for ax in axes:
            shade(ax, s, c.state[at])
        if bound[nodes].any():
            axes[1].fill_between(s, -bound[at], bound[at], facecolor="#c9ced5", edgecolor="#9aa0a8", linewidth=0.8,
                                 alpha=0.55, zorder=1, label="friction bound" if line is lines[0] else None)
        for ax, values in zip(axes, (1e-6 * c.pressure, 1e-6 * c.traction[:, 0], scale * c.gap), strict=True):
            stated_curve(ax, s, values[at], c.state[at])
    for ax, label in zip(axes, ("pressure p [MPa]", "friction t [MPa]", f"gap [{unit}]"), strict=True):
        ax.set_ylabel(label)
        ax.axhline(0.0, color="#5b626b", linewidth=0.8, zorder=1)
        ax.margins(x=0.0)
    axes[0].set_ylim(bottom=0.0)
    largest = 1e-6 * float(c.pressure.max())
    keep_open(axes[0], 1e-6 * c.pressure[nodes], largest)
    keep_open(axes[1], np.concatenate([-bound[nodes], 1e-6 * c.traction[nodes, 0]]), largest)
    if not bound[nodes].any():
        axes[1].text(0.5, 0.9, "frictionless", transform=axes[1].transAxes, ha="center", va="top", color="#5b626b")
    else:
        axes[1].legend(loc="best", frameon=True, framealpha=0.85, edgecolor="none")
    low, high = axes[2].get_ylim()
    # closed everywhere: rounding is not to fill the axes
    axes[2].set_ylim(min(low, -0.05), max(high, 0.5))
    axes[2].set_xlabel(lines[0].label)
    axes[0].legend(handles=state_lines(c.state[nodes]), loc="lower center", bbox_to_anchor=(0.5, 0.98), ncols=3)


def _draw_surface(result: Result, name: str, axes: list[Axes]) -> None:
    c, flat = result.contact, flattened(result, name)
    at = flat.index
    scale, unit = _gap_unit(c.gap[at])
    largest = 1e-6 * float(c.pressure.max())
    draw_map(axes[0], flat, 1e-6 * c.pressure[at], "contact pressure p [MPa]", largest=largest)
    draw_map(axes[1], flat, 1e-6 * np.linalg.norm(c.traction[at], axis=1), "friction traction |t| [MPa]",
             largest=largest)
    # closed everywhere: a nanometre is rounding
    draw_map(axes[2], flat, scale * c.gap[at], f"gap [{unit}]", largest=1e6 if unit == "µm" else 0.0)
    draw_states(axes[3], flat, c.state[at])
    for ax, what in zip(axes[1:], ("friction", "gap", "state"), strict=True):
        ax.set_title(what, pad=22 if what == "state" else None)
