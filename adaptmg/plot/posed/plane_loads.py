"""Loads on a plane problem: arrows of pressures and tractions, body forces, initial strains."""

from __future__ import annotations

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon as Patch

from adaptmg.plot.posed.plan import Curve, Plan
from adaptmg.plot.posed.words import surface_load_text, tractions, volume_load_text
from adaptmg.plot.style import BLUE, bounds
from adaptmg.problem import BodyForce, ContactProblem, InitialStrain, Pressure, Traction

__all__ = ["draw_loads"]


def draw_loads(plan: Plan, posed: ContactProblem) -> None:
    """Draw all loads; the arrows of tractions are proportional to them, the largest in sight of the body."""
    surface = [load for load in posed.loads if isinstance(load, Pressure | Traction)]
    sizes = [np.linalg.norm(_at_nine(plan, load, curve), axis=1).max()
             for load in surface for curve in plan.curves[load.boundary]]
    largest = max(sizes, default=0.0)
    for load in posed.loads:
        if isinstance(load, BodyForce):
            _draw_body_force(plan, load)
        elif isinstance(load, InitialStrain):
            _draw_initial_strain(plan, load)
        elif largest > 0:
            _draw_surface_load(plan, load, largest)


def _draw_surface_load(plan: Plan, load: Pressure | Traction, largest: float) -> None:
    reach = 0.17 * plan.size / largest
    for curve in plan.curves[load.boundary]:
        _draw_arrows(plan, load, curve, reach)
    curve = plan.longest(load.boundary)
    traction = _at_nine(plan, load, curve)
    outward = curve.normal * (float(np.linalg.norm(traction, axis=1).max()) * reach + 0.02 * plan.size)
    plan.text(curve.middle + outward, surface_load_text(load, traction), curve.normal, BLUE)


def _at_nine(plan: Plan, load: Pressure | Traction, curve: Curve) -> np.ndarray:
    """Tractions (9, 2) spread over a curve, Pa."""
    points, normals = curve.spread(9)
    return tractions(load, points / plan.scale, normals)


def _draw_arrows(plan: Plan, load: Pressure | Traction, curve: Curve, reach: float) -> None:
    x, normals = curve.spread(max(3, round(12 * curve.length / plan.size)))
    arrows = tractions(load, x / plan.scale, normals) * reach
    # pushing loads end on the edge, pulling ones start there
    pushing = (np.einsum("nd,nd->n", arrows, normals) <= 0)[:, None]
    tails = np.where(pushing, x - arrows, x)
    plan.ax.quiver(*tails.T, *arrows.T, angles="xy", scale_units="xy", scale=1, color=BLUE, width=0.0045,
                   headwidth=4.5, headlength=5.5, headaxislength=5, zorder=5)
    plan.ax.plot(*np.where(pushing, tails, x + arrows).T, color=BLUE, linewidth=1.0, zorder=5)


def _draw_body_force(plan: Plan, load: BodyForce) -> None:
    lower, upper = (plan.lower, plan.upper) if load.body is None else bounds(plan.polygons[load.body])[:2]
    centre = 0.5 * (lower + upper)
    force = np.array([c(centre[None] / plan.scale)[0] if callable(c) else c for c in load.components], dtype=float)
    size = float(np.linalg.norm(force))
    if not size > 0:
        return
    arrow = 0.15 * plan.size * force / size
    plan.ax.annotate("", centre + arrow / 2, centre - arrow / 2,
                     arrowprops={"arrowstyle": "-|>", "color": BLUE, "linewidth": 2}, zorder=6)
    if plan.several:
        plan.legend.append((Line2D([], [], color=BLUE, linewidth=2), volume_load_text(load)))
    else:
        side = np.array([abs(arrow[1]), -abs(arrow[0])]) / np.linalg.norm(arrow)
        plan.text(centre + 0.03 * plan.size * side, volume_load_text(load).replace("body force", "f ="), side, BLUE)


def _draw_initial_strain(plan: Plan, load: InitialStrain) -> None:
    """Hatching in the body; the legend says how much."""
    band = Patch(plan.polygons[load.body], facecolor="none", edgecolor=BLUE, hatch="....", linewidth=0, zorder=2.5)
    plan.ax.add_patch(band)
    plan.legend.append((band, volume_load_text(load, (*plan.names, "θ" if plan.axisymmetric else "z"))))
