"""problem: a picture of what is posed - bodies, obstacles, contact pairs, loads, supports (as Fig. 2 of the paper)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.plot.curves import polygons_of
from adaptmg.plot.style import bounds, canvas, styled
from adaptmg.problem import Box, ContactProblem, InitialStrain

__all__ = ["problem"]


@styled
def problem(posed: ContactProblem, ax: Axes | None = None, *, mesh: MeshArrays | None = None,
            explode: float = 0.0) -> Figure:
    """Draw a contact problem: geometry, contact boundaries, obstacles and pairs, loads, supports, names of boundaries.

    Arrows are proportional to the tractions. Gaps in front of obstacles too small to be seen are drawn larger, and the
    picture says so. Several bodies have a colour each and a legend that names them and the pairs.

    Parameters
    ----------
    posed : ContactProblem
        With a domain, or in 3D with ``mesh``.
    ax : matplotlib Axes, optional
        In 3D with ``projection="3d"``.
    mesh : MeshArrays, optional
        3D only: whose surface is drawn, coloured by what boundaries are for. A single Box needs none; for other
        domains a coarse mesh is made where none is given.
    explode : float
        3D only, with several bodies: how far they are drawn apart, in distances of their centres from that of the
        whole; their contact surfaces hide each other otherwise.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        If the problem has neither domain nor mesh.
    """
    if not isinstance(posed, ContactProblem):
        raise TypeError(f"posed must be a ContactProblem, got {type(posed).__name__}")
    if posed.domain is None and (mesh is None or posed.dim == 2):
        raise ValueError("the problem has no domain to draw: draw a mesh of it with am.plot.mesh")
    one_box = isinstance(posed.domain, Box) and not any(posed.masters) and not any(isinstance(load, InitialStrain)
                                                                                   for load in posed.loads)
    if posed.dim == 3 and mesh is None and one_box:
        from adaptmg.plot.posed_3d import draw

        ax = canvas(ax, (6.4, 6.0), dim=3)
        draw(posed, ax)
    elif posed.dim == 3:
        from adaptmg.plot.posed_surface import coarse_mesh, draw_on_mesh

        ax = canvas(ax, (7.6, 6.0), dim=3)
        draw_on_mesh(posed, coarse_mesh(posed.domain) if mesh is None else mesh, ax, explode)
    else:
        from adaptmg.plot.posed_2d import draw

        polygons = polygons_of(posed.domain)
        lower, upper, _ = bounds(np.vstack(list(polygons.values())))
        width, height = (upper - lower) / np.max(upper - lower)
        # with several bodies there is a legend
        ax = canvas(ax, (4.2 * width + (6.0 if len(polygons) > 1 else 2.6), 4.2 * height + 1.8))
        draw(posed, ax)
    ax.set_title(posed.name)
    return ax.figure
