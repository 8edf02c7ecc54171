"""The plane problem: polygon, pressure arrows, rollers, hatched obstacles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon as Patch

from adaptmg.plot.labels import describe_law, support_text
from adaptmg.plot.style import BLUE, GREY, INK, ORANGE, PALE, bounds, number, scaled
from adaptmg.problem import BodyForce, Contact, ContactProblem, Plane, Pressure, Support, Traction

__all__ = ["draw"]


@dataclass(frozen=True)
class _Edge:
    """One edge of the polygon, in plot units: ends, outward normal, length."""

    start: np.ndarray
    end: np.ndarray
    normal: np.ndarray
    length: float

    def points(self, count: int, inset: float = 0.06) -> np.ndarray:
        """``count`` points along the edge, kept off its ends by a share ``inset``."""
        s = np.linspace(inset, 1 - inset, count)[:, None]
        return (1 - s) * self.start + s * self.end

    @property
    def middle(self) -> np.ndarray:
        return 0.5 * (self.start + self.end)


class _Plan:
    """The polygon in plot units, and the axes to draw on."""

    def __init__(self, posed: ContactProblem, ax: Axes) -> None:
        vertices = np.array(posed.domain.polygon.vertices)
        self.scale, self.unit = scaled(bounds(vertices)[2], "m")
        self.ax, self.vertices = ax, vertices * self.scale
        self.lower, self.upper, self.diagonal = bounds(self.vertices)
        self.size = 0.7 * self.diagonal
        self.edges: dict[str, list[_Edge]] = {}
        for a, b, name in zip(self.vertices, np.roll(self.vertices, -1, axis=0), posed.domain.polygon.boundaries,
                              strict=True):
            direction, length = b - a, float(np.linalg.norm(b - a))
            normal = np.array([direction[1], -direction[0]]) / length
            self.edges.setdefault(name, []).append(_Edge(a, b, normal, length))

    def text(self, position: np.ndarray, text: str, normal: np.ndarray, color: str = INK, along: bool = False) -> None:
        """Text beside a point, on the side the normal points to; turned where it should run along a steep edge."""
        turn = 90 if along and abs(normal[0]) > 0.9 else 0
        across = "center" if abs(normal[0]) < 0.5 else "left" if normal[0] > 0 else "right"
        up = "center" if abs(normal[1]) < 0.5 else "bottom" if normal[1] > 0 else "top"
        self.ax.text(*position, text, ha=across, va=up, color=color, fontsize=9, rotation=turn, zorder=6)

    def longest(self, boundary: str) -> _Edge:
        return max(self.edges[boundary], key=lambda edge: edge.length)


def draw(posed: ContactProblem, ax: Axes) -> None:
    """Draw a plane problem on axes; see :func:`adaptmg.plot.problem`."""
    plan = _Plan(posed, ax)
    ax.add_patch(Patch(plan.vertices, facecolor=PALE, edgecolor=INK, linewidth=1.2, zorder=2))
    for contact in posed.contact:
        _draw_contact(plan, contact, describe_law(posed.law))
    for support in posed.supports:
        _draw_support(plan, support)
    largest = _largest_load(plan, posed)
    for load in posed.loads:
        if isinstance(load, BodyForce):
            _draw_body_force(plan, load)
        else:
            _draw_surface_load(plan, load, largest)
    for name in plan.edges:
        edge = plan.longest(name)
        plan.text(edge.middle - 0.03 * plan.size * edge.normal, name, -edge.normal, GREY)
    _draw_dimensions(plan)
    ax.set_aspect("equal")
    ax.set_xlim(plan.lower[0] - 0.42 * plan.size, plan.upper[0] + 0.42 * plan.size)
    ax.set_ylim(plan.lower[1] - 0.32 * plan.size, plan.upper[1] + 0.24 * plan.size)
    ax.axis("off")


def _draw_dimensions(plan: _Plan) -> None:
    """Width and height of the body, beside everything else, and the axes."""
    (x0, y0), (x1, y1) = plan.lower, plan.upper
    low, far = y0 - 0.24 * plan.size, x1 + 0.34 * plan.size
    for start, end, turn in (((x0, low), (x1, low), 0), ((far, y0), (far, y1), 90)):
        plan.ax.annotate("", start, end, arrowprops={"arrowstyle": "<->", "color": GREY, "linewidth": 0.8,
                                                     "shrinkA": 0, "shrinkB": 0})
        length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
        plan.ax.text((start[0] + end[0]) / 2, (start[1] + end[1]) / 2, f"{length:.4g} {plan.unit}", rotation=turn,
                     ha="center", va="center", color=INK, fontsize=9, backgroundcolor="white")
    corner, reach = np.array([x0 - 0.36 * plan.size, low]), 0.1 * plan.size
    for name, direction in (("x", np.array([1.0, 0.0])), ("y", np.array([0.0, 1.0]))):
        plan.ax.annotate("", corner + reach * direction, corner,
                         arrowprops={"arrowstyle": "-|>", "color": INK, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0})
        plan.ax.text(*(corner + 1.25 * reach * direction), name, ha="center", va="center", fontsize=9)


def _draw_contact(plan: _Plan, contact: Contact, law: str) -> None:
    for edge in plan.edges[contact.boundary]:
        ends = np.array([edge.start, edge.end])
        plan.ax.plot(*ends.T, color=ORANGE, linewidth=3, solid_capstyle="butt", zorder=4)
    surface, inward, times = _obstacle(plan, contact)
    depth = 0.06 * plan.size
    band = np.vstack([surface, (surface + depth * inward)[::-1]])
    plan.ax.add_patch(Patch(band, facecolor="none", edgecolor=GREY, hatch="////", linewidth=0, zorder=1))
    plan.ax.plot(*surface.T, color=INK, linewidth=1.2, zorder=3)
    middle = len(surface) // 2
    enlarged = f"\n(gap drawn {times} times)" if times > 1 else ""
    plan.text(surface[middle] + 1.35 * depth * inward[middle], law + enlarged, inward[middle], ORANGE, along=True)


def _obstacle(plan: _Plan, contact: Contact) -> tuple[np.ndarray, np.ndarray, int]:
    """Surface of the obstacle and the direction into it, (n, 2) each in plot units; how many times gaps are drawn."""
    edges = plan.edges[contact.boundary]
    points = np.vstack([edge.points(61, inset=0.0) for edge in edges])
    inward, gaps = contact.obstacle.contact(points / plan.scale, np.repeat([e.normal for e in edges], 61, axis=0))
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


def _largest_load(plan: _Plan, posed: ContactProblem) -> float:
    sizes = [np.linalg.norm(_traction(plan, load, edge, edge.points(9)), axis=1).max()
             for load in posed.loads if not isinstance(load, BodyForce) for edge in plan.edges[load.boundary]]
    return max(sizes, default=0.0)


def _values(value: float | Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    return np.broadcast_to(np.asarray(value(x) if callable(value) else value, dtype=float), len(x))


def _traction(plan: _Plan, load: Pressure | Traction, edge: _Edge, x: np.ndarray) -> np.ndarray:
    """Traction (n, 2) in Pa at points given in plot units."""
    if isinstance(load, Pressure):
        return -_values(load.value, x / plan.scale)[:, None] * edge.normal
    return np.stack([_values(c, x / plan.scale) for c in load.components], axis=1)


def _draw_surface_load(plan: _Plan, load: Pressure | Traction, largest: float) -> None:
    if not largest > 0:
        return
    reach = 0.17 * plan.size / largest
    for edge in plan.edges[load.boundary]:
        x = edge.points(max(3, round(12 * edge.length / plan.size)))
        arrows = _traction(plan, load, edge, x) * reach
        # pushing loads end on the edge, pulling ones start there
        pushing = (arrows @ edge.normal <= 0)[:, None]
        tails = np.where(pushing, x - arrows, x)
        plan.ax.quiver(*tails.T, *arrows.T, angles="xy", scale_units="xy", scale=1, color=BLUE, width=0.0045,
                       headwidth=4.5, headlength=5.5, headaxislength=5, zorder=5)
        free_ends = np.where(pushing, tails, x + arrows)
        plan.ax.plot(*free_ends.T, color=BLUE, linewidth=1.0, zorder=5)
    edge = plan.longest(load.boundary)
    x = edge.points(9)
    traction = _traction(plan, load, edge, x)
    size = float(np.linalg.norm(traction, axis=1).max())
    factor, unit = scaled(size, "Pa")
    shown = size * factor
    if isinstance(load, Pressure) and not callable(load.value):
        shown = load.value * factor
    relation = "up to" if np.ptp(np.linalg.norm(traction, axis=1)) > 1e-9 * size else "="
    symbol = "p" if isinstance(load, Pressure) else "|t|"
    outward = edge.normal * (size * reach + 0.02 * plan.size)
    plan.text(edge.middle + outward, f"{symbol} {relation} {number(shown)} {unit}", edge.normal, BLUE)


def _draw_body_force(plan: _Plan, load: BodyForce) -> None:
    centre = 0.5 * (plan.lower + plan.upper)
    force = np.array([_values(c, centre[None] / plan.scale)[0] for c in load.components])
    size = float(np.linalg.norm(force))
    if not size > 0:
        return
    arrow = 0.15 * plan.size * force / size
    plan.ax.annotate("", centre + arrow / 2, centre - arrow / 2,
                     arrowprops={"arrowstyle": "-|>", "color": BLUE, "linewidth": 2}, zorder=6)
    factor, unit = scaled(size, "N/m³")
    side = np.array([abs(arrow[1]), -abs(arrow[0])]) / np.linalg.norm(arrow)
    plan.text(centre + 0.03 * plan.size * side, f"f = {number(size * factor)} {unit}", side, BLUE)


def _draw_support(plan: _Plan, support: Support) -> None:
    """A wall beside the edge: directly at it if all is fixed, behind rollers if it may slide along the wall."""
    for edge in plan.edges[support.boundary]:
        fixed = np.array([c is not None for c in support.components(2)])
        slides = not fixed.all() and abs(edge.normal[fixed][0]) > 0.99
        radius = 0.016 * plan.size
        offset = 2 * radius if slides else 0.0
        if slides:
            rollers = edge.points(max(3, round(9 * edge.length / plan.size))) + radius * edge.normal
            plan.ax.scatter(*rollers.T, s=26, facecolor="white", edgecolor=INK, linewidth=0.9, zorder=4)
        wall = np.array([edge.start, edge.end]) + (offset + 0.2 * radius) * edge.normal
        band = np.vstack([wall, (wall + 0.05 * plan.size * edge.normal)[::-1]])
        plan.ax.add_patch(Patch(band, facecolor="none", edgecolor=GREY, hatch="////", linewidth=0, zorder=1))
        plan.ax.plot(*wall.T, color=INK, linewidth=1.2, zorder=3)
    edge = plan.longest(support.boundary)
    plan.text(edge.middle + 0.12 * plan.size * edge.normal, support_text(support, 2), edge.normal)
