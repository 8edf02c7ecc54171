"""The plane problem: polygons, rollers, hatched obstacles, contact pairs, loads, dimensions."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon as Patch

from adaptmg.plot.posed.plan import Curve, Plan
from adaptmg.plot.posed.words import describe_law, support_text, surface_load_text, tractions, volume_load_text
from adaptmg.plot.style import BLUE, BODY_COLORS, GREEN, GREY, INK, ORANGE, PALE, bounds, plain, quoted
from adaptmg.problem import (
    BodyForce,
    Contact,
    ContactPair,
    ContactProblem,
    InitialStrain,
    Plane,
    Pressure,
    Support,
    Traction,
)

__all__ = ["draw"]


def draw(posed: ContactProblem, ax: Axes) -> None:
    """Draw a plane problem on axes; see :func:`adaptmg.plot.problem`."""
    plan = Plan(posed, ax)
    _draw_bodies(plan)
    for contact in posed.contact:
        if isinstance(contact, ContactPair):
            _draw_pair(plan, contact)
        else:
            _draw_contact(plan, contact, describe_law(posed.law))
    for support in posed.supports:
        _draw_support(plan, support)
    _draw_loads(plan, posed)
    if not plan.several:
        _draw_names(plan)
    _draw_dimensions(plan)
    if plan.axisymmetric and plan.lower[0] <= 1e-9 * plan.size:
        reach = [plan.lower[1] - 0.1 * plan.size, plan.upper[1] + 0.1 * plan.size]
        ax.plot([0, 0], reach, color=INK, linewidth=0.9, linestyle=(0, (12, 3, 2, 3)), zorder=3.5)
    ax.set_aspect("equal")
    ax.set_xlim(plan.lower[0] - 0.42 * plan.size, plan.upper[0] + (0.54 if plan.several else 0.42) * plan.size)
    ax.set_ylim(plan.lower[1] - 0.32 * plan.size, plan.upper[1] + 0.24 * plan.size)
    ax.axis("off")
    if plan.legend:
        handles, labels = zip(*plan.legend, strict=True)
        title = describe_law(posed.law) if any(posed.masters) else None
        ax.legend(handles, labels, loc="upper left", bbox_to_anchor=(1.0, 1.0), title=title, alignment="left",
                  borderaxespad=0.0)


def _draw_bodies(plan: Plan) -> None:
    """Filled polygons, small ones on top of large ones; with several the legend names them."""
    def area(vertices: np.ndarray) -> float:
        (x, y), (x2, y2) = vertices.T, np.roll(vertices, -1, axis=0).T
        return 0.5 * float(np.sum(x * y2 - x2 * y))

    patches = {}
    for k, (body, vertices) in enumerate(plan.polygons.items()):
        color = BODY_COLORS[k % len(BODY_COLORS)] if plan.several else PALE
        patches[body] = Patch(vertices, facecolor=color, edgecolor=INK, linewidth=1.2)
    for k, body in enumerate(sorted(patches, key=lambda body: -area(plan.polygons[body]))):
        patches[body].set_zorder(2 + 0.01 * k)
        plan.ax.add_patch(patches[body])
    if plan.several:
        plan.legend += [(patches[body], plain(body)) for body in plan.polygons]


def _draw_names(plan: Plan) -> None:
    """Names of the boundaries inside the body."""
    for name in plan.curves:
        curve = plan.longest(name)
        plan.text(curve.middle - 0.03 * plan.size * curve.normal, plain(name), -curve.normal, GREY)


def _draw_dimensions(plan: Plan) -> None:
    """Width and height of all, beside everything else, and the axes; in axisymmetry the radii."""
    (x0, y0), (x1, y1) = plan.lower, plan.upper
    low, far = y0 - 0.24 * plan.size, x1 + (0.46 if plan.several else 0.34) * plan.size
    for start, end, turn in (((x0, low), (x1, low), 0), ((far, y0), (far, y1), 90)):
        plan.ax.annotate("", start, end, arrowprops={"arrowstyle": "<->", "color": GREY, "linewidth": 0.8,
                                                     "shrinkA": 0, "shrinkB": 0})
        text = f"{float(np.hypot(end[0] - start[0], end[1] - start[1])):.4g} {plan.unit}"
        if plan.axisymmetric and turn == 0:
            text = f"r = {x0:.4g} to {x1:.4g} {plan.unit}"
        plan.ax.text((start[0] + end[0]) / 2, (start[1] + end[1]) / 2, text, rotation=turn, ha="center", va="center",
                     color=INK, fontsize=9, backgroundcolor="white")
    corner, reach = np.array([x0 - 0.36 * plan.size, low]), 0.1 * plan.size
    for name, direction in zip(plan.names, np.eye(2), strict=True):
        plan.ax.annotate("", corner + reach * direction, corner,
                         arrowprops={"arrowstyle": "-|>", "color": INK, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0})
        plan.ax.text(*(corner + 1.25 * reach * direction), name, ha="center", va="center", fontsize=9)


def _draw_pair(plan: Plan, pair: ContactPair) -> None:
    """Slave boundary broad, master boundary thin beside it, inside their bodies."""
    slave = Line2D([], [], color=ORANGE, linewidth=3)
    for name, color, width, zorder in ((pair.master, GREEN, 1.8, 4.1), (pair.slave, ORANGE, 3.0, 4.0)):
        lines = [curve.corners for curve in plan.curves[name]]
        plan.ax.add_collection(LineCollection(lines, color=color, linewidth=width, capstyle="butt", zorder=zorder))
    if not any(isinstance(artist, Line2D) for artist, _ in plan.legend):
        plan.legend.append((Line2D([], [], color=GREEN, linewidth=1.8), "master"))
    plan.legend.append((slave, f"{quoted(pair.slave)} on {quoted(pair.master)}"))


def _draw_contact(plan: Plan, contact: Contact, law: str) -> None:
    for curve in plan.curves[contact.boundary]:
        plan.ax.plot(*curve.corners.T, color=ORANGE, linewidth=3, solid_capstyle="butt", zorder=4)
        surface, inward, times = _obstacle(plan, contact, curve)
        depth = 0.06 * plan.size
        band = np.vstack([surface, (surface + depth * inward)[::-1]])
        plan.ax.add_patch(Patch(band, facecolor="none", edgecolor=GREY, hatch="////", linewidth=0, zorder=1))
        plan.ax.plot(*surface.T, color=INK, linewidth=1.2, zorder=3)
        if curve is plan.longest(contact.boundary):
            middle = len(surface) // 2
            enlarged = f"\n(gap drawn {times} times)" if times > 1 else ""
            plan.text(surface[middle] + 1.35 * depth * inward[middle], law + enlarged, inward[middle], ORANGE,
                      along=True)


def _obstacle(plan: Plan, contact: Contact, curve: Curve) -> tuple[np.ndarray, np.ndarray, int]:
    """Surface of the obstacle and the direction into it, (n, 2) each in plot units; how many times gaps are drawn."""
    points, normals = curve.spread(61, inset=0.0)
    inward, gaps = contact.obstacle.contact(points / plan.scale, normals)
    gaps = gaps * plan.scale
    largest = float(np.abs(gaps).max())
    visible = 0.06 * plan.size
    times = 1 if largest < 1e-9 * plan.size or largest > visible / 4 else int(float(f"{visible / largest:.0e}"))
    surface = points + times * gaps[:, None] * inward
    if isinstance(contact.obstacle, Plane):
        # a plane goes on beyond the boundary
        along = np.array([-inward[0, 1], inward[0, 0]])
        order = np.argsort(surface @ along)
        beyond = 0.08 * plan.size * along
        surface = np.vstack([surface[order[0]] - beyond, surface[order], surface[order[-1]] + beyond])
        inward = np.broadcast_to(inward[0], surface.shape)
    return surface, inward, times


def _draw_support(plan: Plan, support: Support) -> None:
    """A wall beside the edge: directly at it if all is fixed, behind rollers if it may slide along the wall."""
    for curve in plan.curves[support.boundary]:
        fixed = np.array([c is not None for c in support.components(2)])
        slides = curve.straight and not fixed.all() and abs(curve.normal[fixed][0]) > 0.99
        radius = 0.016 * plan.size
        offset = 2 * radius if slides else 0.0
        if slides:
            points, normals = curve.spread(max(3, round(9 * curve.length / plan.size)))
            plan.ax.scatter(*(points + radius * normals).T, s=26, facecolor="white", edgecolor=INK, linewidth=0.9,
                            zorder=4)
        points, normals = curve.spread(2 if curve.straight else 31, inset=0.0)
        wall = points + (offset + 0.2 * radius) * normals
        band = np.vstack([wall, (wall + 0.05 * plan.size * normals)[::-1]])
        plan.ax.add_patch(Patch(band, facecolor="none", edgecolor=GREY, hatch="////", linewidth=0, zorder=1))
        plan.ax.plot(*wall.T, color=INK, linewidth=1.2, zorder=3)
    curve = plan.longest(support.boundary)
    text = support_text(support, 2, plan.names)
    plan.text(curve.middle + 0.12 * plan.size * curve.normal, text, curve.normal)


def _draw_loads(plan: Plan, posed: ContactProblem) -> None:
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
