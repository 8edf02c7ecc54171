"""Loads on a plane problem: arrows of pressures and tractions, body forces, initial strains."""

from __future__ import annotations

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon as Patch

from adaptmg.plot.curves import Curve
from adaptmg.plot.plan import Plan, values_at
from adaptmg.plot.style import BLUE, bounds, number, scaled
from adaptmg.problem import BodyForce, ContactProblem, InitialStrain, Pressure, Traction

__all__ = ["draw_loads"]


def draw_loads(plan: Plan, posed: ContactProblem) -> None:
    """Draw all loads; the arrows of tractions are proportional to them, the largest in sight of the body."""
    surface = [load for load in posed.loads if isinstance(load, Pressure | Traction)]
    sizes = [np.linalg.norm(_traction(plan, load, *curve.spread(9)), axis=1).max()
             for load in surface for curve in plan.curves[load.boundary]]
    largest = max(sizes, default=0.0)
    for load in posed.loads:
        if isinstance(load, BodyForce):
            _draw_body_force(plan, load)
        elif isinstance(load, InitialStrain):
            _draw_initial_strain(plan, load)
        elif largest > 0:
            _draw_surface_load(plan, load, largest)


def _traction(plan: Plan, load: Pressure | Traction, x: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Traction (n, 2) in Pa at points given in plot units, with outward normals (n, 2)."""
    if isinstance(load, Pressure):
        return -values_at(load.value, x / plan.scale)[:, None] * normals
    return np.stack([values_at(c, x / plan.scale) for c in load.components], axis=1)


def _draw_surface_load(plan: Plan, load: Pressure | Traction, largest: float) -> None:
    reach = 0.17 * plan.size / largest
    for curve in plan.curves[load.boundary]:
        _draw_arrows(plan, load, curve, reach)
    curve = plan.longest(load.boundary)
    traction = _traction(plan, load, *curve.spread(9))
    size = float(np.linalg.norm(traction, axis=1).max())
    factor, unit = scaled(size, "Pa")
    shown = size * factor
    if isinstance(load, Pressure) and not callable(load.value):
        shown = load.value * factor
    relation = "up to" if np.ptp(np.linalg.norm(traction, axis=1)) > 1e-9 * size else "="
    symbol = "p" if isinstance(load, Pressure) else "|t|"
    outward = curve.normal * (size * reach + 0.02 * plan.size)
    plan.text(curve.middle + outward, f"{symbol} {relation} {number(shown)} {unit}", curve.normal, BLUE)


def _draw_arrows(plan: Plan, load: Pressure | Traction, curve: Curve, reach: float) -> None:
    x, normals = curve.spread(max(3, round(12 * curve.length / plan.size)))
    arrows = _traction(plan, load, x, normals) * reach
    # pushing loads end on the edge, pulling ones start there
    pushing = (np.einsum("nd,nd->n", arrows, normals) <= 0)[:, None]
    tails = np.where(pushing, x - arrows, x)
    plan.ax.quiver(*tails.T, *arrows.T, angles="xy", scale_units="xy", scale=1, color=BLUE, width=0.0045,
                   headwidth=4.5, headlength=5.5, headaxislength=5, zorder=5)
    plan.ax.plot(*np.where(pushing, tails, x + arrows).T, color=BLUE, linewidth=1.0, zorder=5)


def _draw_body_force(plan: Plan, load: BodyForce) -> None:
    lower, upper = (plan.lower, plan.upper) if load.body is None else bounds(plan.polygons[load.body])[:2]
    centre = 0.5 * (lower + upper)
    force = np.array([values_at(c, centre[None] / plan.scale)[0] for c in load.components])
    size = float(np.linalg.norm(force))
    if not size > 0:
        return
    arrow = 0.15 * plan.size * force / size
    plan.ax.annotate("", centre + arrow / 2, centre - arrow / 2,
                     arrowprops={"arrowstyle": "-|>", "color": BLUE, "linewidth": 2}, zorder=6)
    factor, unit = scaled(size, "N/m³")
    text = f"{number(size * factor)} {unit}"
    if plan.several:
        where = "" if load.body is None else f" in {load.body!r}"
        plan.legend.append((Line2D([], [], color=BLUE, linewidth=2), f"body force {text}{where}"))
    else:
        side = np.array([abs(arrow[1]), -abs(arrow[0])]) / np.linalg.norm(arrow)
        plan.text(centre + 0.03 * plan.size * side, f"f = {text}", side, BLUE)


def _draw_initial_strain(plan: Plan, load: InitialStrain) -> None:
    """Hatching in the body; the legend says how much."""
    band = Patch(plan.polygons[load.body], facecolor="none", edgecolor=BLUE, hatch="....", linewidth=0, zorder=2.5)
    plan.ax.add_patch(band)
    axes = (*plan.names, "θ" if plan.axisymmetric else "z")
    parts = [f"$\\varepsilon_{axis}$ = {'f(x)' if callable(value) else number(value)}"
             for axis, value in zip(axes, load.components, strict=False) if callable(value) or value != 0]
    plan.legend.append((band, f"initial strain of {load.body!r}\n{', '.join(parts) or '0'}"))
