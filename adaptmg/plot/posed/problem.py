"""problem: a picture of what is posed - bodies, obstacles, contact pairs, loads, supports (as Fig. 2 of the paper)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.plot.posed import plane, solid
from adaptmg.plot.posed.plan import polygons_of
from adaptmg.plot.style import bounds, canvas, plain, styled
from adaptmg.problem import ContactProblem, checks

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
        3D only: whose surface is drawn, coloured by what boundaries are for; by default a coarse mesh is made.
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
    checks.instance("posed", posed, ContactProblem)
    if posed.domain is None and (mesh is None or posed.dim == 2):
        raise ValueError("the problem has no domain to draw: draw a mesh of it with am.plot.mesh")
    if posed.dim == 3:
        ax = canvas(ax, (7.6, 6.0), dim=3)
        solid.draw(posed, solid.coarse_mesh(posed.domain) if mesh is None else mesh, ax,
                   checks.number("explode", explode))
    else:
        polygons = polygons_of(posed.domain)
        lower, upper, _ = bounds(np.vstack(list(polygons.values())))
        width, height = (upper - lower) / np.max(upper - lower)
        # with several bodies there is a legend
        ax = canvas(ax, (4.2 * width + (6.0 if len(polygons) > 1 else 2.6), 4.2 * height + 1.8))
        plane.draw(posed, ax)
    ax.set_title(plain(posed.name))
    return ax.figure
