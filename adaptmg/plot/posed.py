"""problem: a picture of what is posed - body, obstacle, loads, supports (as Fig. 2 of the paper)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptmg.plot.style import bounds, canvas, styled
from adaptmg.problem import Box, ContactProblem

__all__ = ["problem"]


@styled
def problem(posed: ContactProblem, ax: Axes | None = None) -> Figure:
    """Draw a contact problem: geometry, contact boundaries and obstacles, loads, supports, names of boundaries.

    Arrows are proportional to the tractions. Gaps too small to be seen are drawn larger, and the picture says so.

    Parameters
    ----------
    posed : ContactProblem
        With a domain.
    ax : matplotlib Axes, optional
        In 3D with ``projection="3d"``.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        If the problem has no domain.
    """
    if not isinstance(posed, ContactProblem):
        raise TypeError(f"posed must be a ContactProblem, got {type(posed).__name__}")
    if posed.domain is None:
        raise ValueError("the problem has no domain to draw: draw a mesh of it with am.plot.mesh")
    if isinstance(posed.domain, Box):
        from adaptmg.plot.posed_3d import draw

        ax = canvas(ax, (6.4, 6.0), dim=3)
    else:
        from adaptmg.plot.posed_2d import draw

        lower, upper, _ = bounds(np.array(posed.domain.polygon.vertices))
        width, height = (upper - lower) / np.max(upper - lower)
        ax = canvas(ax, (4.2 * width + 2.6, 4.2 * height + 1.8))
    draw(posed, ax)
    ax.set_title(posed.name)
    return ax.figure
