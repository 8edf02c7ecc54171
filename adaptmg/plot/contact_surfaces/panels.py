"""Axes for several contact boundaries, each in panels of its own; and what the boundaries are called."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure

from adaptmg.plot.style import new_figure, quoted
from adaptmg.problem import checks
from adaptmg.solver.result import ContactResult, Result

__all__ = ["blocks", "cells", "chosen_boundaries", "described", "keep_open"]


def chosen_boundaries(result: Result, boundary: object, argument: str) -> tuple[str, ...]:
    """Contact boundaries to draw: one, by its name or as a Contact or ContactPair; by default all with nodes."""
    contact = result.contact
    name = getattr(boundary, "boundary", boundary)
    names = contact.names if name is None else (checks.choice(argument, name, contact.names),)
    found = tuple(n for n in names if (contact.boundary == contact.names.index(n)).any())
    if not found:
        raise ValueError(f"{argument}: {', '.join(map(repr, names)) or 'this result'} has no contact nodes to draw")
    return found


def described(contact: ContactResult, boundary: str) -> str:
    """'slave on master', or the boundary alone in front of a rigid obstacle."""
    masters = contact.masters or ("",) * len(contact.names)
    master = masters[contact.names.index(boundary)]
    return f"{quoted(boundary)} on {quoted(master)}" if master else quoted(boundary)


def blocks(count: int, size: tuple[float, float], columns: int) -> list[SubFigure]:
    """Parts of ``size`` inches of a new figure, at most ``columns`` side by side."""
    columns = min(count, columns)
    rows = -(-count // columns)
    figure = new_figure((size[0] * columns, size[1] * rows))
    return list(figure.subfigures(rows, columns, squeeze=False).ravel())[:count]


def cells(part: SubFigure, count: int, columns: int, share: bool = False) -> list[Axes]:
    """``count`` axes row by row; with ``share`` on common scales, with numbers only at the left and below."""
    grid = part.add_gridspec(-(-count // columns), columns)
    axes: list[Axes] = []
    for k in range(count):
        first = axes[0] if share and axes else None
        axes.append(part.add_subplot(grid[k // columns, k % columns], sharex=first, sharey=first))
        if share:
            axes[-1].tick_params(labelleft=k % columns == 0, labelbottom=k + columns >= count)
    return axes


def keep_open(ax: Axes, values: np.ndarray, largest: float) -> None:
    """Scale an axis of nothing but rounding, against the ``largest`` value elsewhere, so that it looks like zero."""
    if not np.abs(values).max() > 1e-9 * largest:
        ax.set_ylim(-1.0 if values.min() < 0 else 0.0, 1.0)
