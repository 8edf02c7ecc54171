"""What a picture of a plane problem is drawn on: polygons, named curves of the boundary, axes.

The plane problem: polygons, rollers, hatched obstacles, contact pairs, loads, dimensions.

problem: a picture of what is posed - bodies, obstacles, contact pairs, loads, supports (as Fig. 2 of the paper).

Solids of any shape are the surface of a mesh, coloured by what its boundaries are for, with arrows of loads; plane
problems are drawn by :mod:`adaptmg.plot.posed_problem`.

What pictures of posed problems say of laws, supports and loads, and the tractions that they draw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from mpl_toolkits.mplot3d import Axes3D

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.plot.style import (
    BLUE,
    BODY_COLORS,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PALE,
    bounds,
    canvas,
    number,
    plain,
    quoted,
    scaled,
    styled,
)
from adaptmg.plot.surfaces import Lines, draw_facets, finish_axes, normals_of, sharp_edges, view_of, viewer
from adaptmg.problem import (
    Assembly,
    BodyForce,
    Contact,
    ContactPair,
    ContactProblem,
    Coulomb,
    Domain,
    Frictionless,
    InitialStrain,
    Law,
    Plane,
    Pressure,
    Support,
    Traction,
    Tresca,
)

__all__ = ["Curve", "Plan", "curves_of", "describe_law", "draw", "polygons_of", "problem", "support_text",
           "surface_load_text", "tractions", "volume_load_text"]

#: edges of one boundary that meet at a flatter angle belong to one curve
_SMOOTH = np.cos(np.radians(20.0))


@dataclass(frozen=True)
class Curve:
    """A smooth part of a boundary, the body on its left."""

    corners: np.ndarray  # (k, 2): of the polyline

    @property
    def steps(self) -> np.ndarray:
        """Edges of the polyline as vectors (k - 1, 2)."""
        return np.diff(self.corners, axis=0)

    @property
    def length(self) -> float:
        """In the unit of the corners."""
        return float(np.linalg.norm(self.steps, axis=1).sum())

    @property
    def straight(self) -> bool:
        """Whether it is one straight edge."""
        return len(self.corners) == 2

    def at(self, fractions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (n, 2) at fractions (n,) of the length, and the outward unit normals there."""
        lengths = np.linalg.norm(self.steps, axis=1)
        ends = np.concatenate([[0.0], np.cumsum(lengths)])
        place = np.asarray(fractions, dtype=float) * ends[-1]
        edge = np.clip(np.searchsorted(ends, place, side="right") - 1, 0, len(lengths) - 1)
        direction = self.steps[edge] / lengths[edge, None]
        points = self.corners[edge] + (place - ends[edge])[:, None] * direction
        return points, np.stack([direction[:, 1], -direction[:, 0]], axis=1)

    def spread(self, count: int, inset: float = 0.06) -> tuple[np.ndarray, np.ndarray]:
        """``count`` points and normals along the curve, kept off its ends by a share ``inset``."""
        return self.at(np.linspace(inset, 1 - inset, count))

    @property
    def middle(self) -> np.ndarray:
        """Point half way (2,)."""
        return self.at(np.array([0.5]))[0][0]

    @property
    def normal(self) -> np.ndarray:
        """Outward unit normal half way (2,)."""
        return self.at(np.array([0.5]))[1][0]


def polygons_of(domain: Domain) -> dict[str, np.ndarray]:
    """Vertices (n, 2), m, of the polygon of each body of a plane domain, by body; arcs as chords."""
    parts = domain.parts if isinstance(domain, Assembly) else {domain.bodies[0]: domain}
    return {body: np.array(part.polygon.vertices) for body, part in parts.items()}


def curves_of(domain: Domain) -> dict[str, list[Curve]]:
    """The curves, m, of each boundary of a plane domain, by its name."""
    parts = domain.parts if isinstance(domain, Assembly) else {"": domain}
    curves: dict[str, list[Curve]] = {name: [] for name in domain.boundaries}
    for body, part in parts.items():
        vertices, names = np.array(part.polygon.vertices), part.polygon.boundaries
        following = np.roll(vertices, -1, axis=0)
        direction = (following - vertices) / np.linalg.norm(following - vertices, axis=1)[:, None]
        # a curve begins where the name changes or a corner is
        begins = [k for k in range(len(names))
                  if names[k] != names[k - 1] or direction[k] @ direction[k - 1] < _SMOOTH] or [0]
        for k, begin in enumerate(begins):
            end = begins[(k + 1) % len(begins)]
            count = (end - begin) % len(names) or len(names)
            run = vertices[np.arange(begin, begin + count + 1) % len(names)]
            curves[f"{body}.{names[begin]}" if body else names[begin]].append(Curve(run))
    return curves


class Plan:
    """Bodies and boundaries of a plane problem in plot units."""

    def __init__(self, posed: ContactProblem, ax: Axes) -> None:
        polygons = polygons_of(posed.domain)
        lower, upper, diagonal = bounds(np.vstack(list(polygons.values())))
        self.scale, self.unit = scaled(diagonal, "m")
        self.polygons = {body: vertices * self.scale for body, vertices in polygons.items()}
        self.curves = {name: [Curve(curve.corners * self.scale) for curve in found]
                       for name, found in curves_of(posed.domain).items()}
        self.ax, self.lower, self.upper = ax, lower * self.scale, upper * self.scale
        self.diagonal, self.size = diagonal * self.scale, 0.7 * diagonal * self.scale
        self.axisymmetric, self.several = posed.axisymmetric, len(polygons) > 1
        self.legend: list[tuple[Artist, str]] = []

    @property
    def names(self) -> tuple[str, str]:
        """Of the axes."""
        return ("r", "z") if self.axisymmetric else ("x", "y")

    def text(self, position: np.ndarray, text: str, normal: np.ndarray, color: str = INK, along: bool = False) -> None:
        """Text beside a point, on the side the normal points to; turned where it should run along a steep edge."""
        turn = 90 if along and abs(normal[0]) > 0.9 else 0
        across = "center" if abs(normal[0]) < 0.5 else "left" if normal[0] > 0 else "right"
        up = "center" if abs(normal[1]) < 0.5 else "bottom" if normal[1] > 0 else "top"
        behind = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0} if self.several else None
        self.ax.text(*position, text, ha=across, va=up, color=color, fontsize=9, rotation=turn, zorder=6, bbox=behind)

    def longest(self, boundary: str) -> Curve:
        """The longest curve of a boundary."""
        return max(self.curves[boundary], key=lambda curve: curve.length)


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
        patches[body] = Polygon(vertices, facecolor=color, edgecolor=INK, linewidth=1.2)
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
        plan.ax.add_patch(Polygon(band, facecolor="none", edgecolor=GREY, hatch="////", linewidth=0, zorder=1))
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
        plan.ax.add_patch(Polygon(band, facecolor="none", edgecolor=GREY, hatch="////", linewidth=0, zorder=1))
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
    band = Polygon(plan.polygons[load.body], facecolor="none", edgecolor=BLUE, hatch="....", linewidth=0, zorder=2.5)
    plan.ax.add_patch(band)
    plan.legend.append((band, volume_load_text(load, (*plan.names, "θ" if plan.axisymmetric else "z"))))


_CONTACT, _MASTER, _SUPPORT = "#f0a46a", "#f7df72", "#8fcab0"


def _coarse_mesh(domain: Domain) -> MeshArrays:
    """A mesh that shows the shape: edges of about a twelfth of each body's extent."""
    from adaptmg.mesh import graded

    def size(part: Domain) -> float:
        return float(np.max(part.upper - part.lower)) / 12

    parts = getattr(domain, "parts", None)
    if parts is None and not hasattr(domain, "lower"):
        raise ValueError(f"the size of a {type(domain).__name__} is not known before it is meshed: give mesh=..., say "
                         "that of a level of the hierarchy")
    return graded(domain, size(domain) if parts is None else {body: size(part) for body, part in parts.items()})


def _draw_solid(posed: ContactProblem, mesh: MeshArrays, ax: Axes3D, explode: float) -> None:
    """Draw a solid problem; see :func:`adaptmg.plot.problem`."""
    posed.check_boundaries(mesh.boundaries)
    scale, unit = scaled(bounds(mesh.points)[2], "m")
    body_of_node = np.zeros(mesh.n_nodes, dtype=int)
    body_of_node[mesh.elements] = mesh.element_body[:, None]
    points = (mesh.points + _apart(mesh, explode)[body_of_node]) * scale
    fills = BODY_COLORS if len(mesh.bodies) > 1 else (PALE,)
    body = body_of_node[mesh.facets[:, 0]]
    colors = to_rgba_array([fills[k % len(fills)] for k in range(len(mesh.bodies))])[body]
    legend: list[tuple[Artist, str]] = []
    if len(mesh.bodies) > 1:
        legend += [(Patch(facecolor=fills[k % len(fills)], edgecolor=INK, linewidth=0.6), plain(name))
                   for k, name in enumerate(mesh.bodies)]
    for boundary, color, text in _uses(posed):
        colors[mesh.facet_labels == mesh.boundaries.index(boundary)] = to_rgba(color)
        legend.append((Patch(facecolor=color, edgecolor=INK, linewidth=0.6), text))
    edges = np.concatenate([sharp_edges(points, mesh.facets[body == k]) for k in range(len(mesh.bodies))])
    arrows, loads = _loads(posed, mesh, points)
    draw_facets(ax, points[mesh.facets], colors, lines=False,
                extra=(Lines(points[edges], INK, 0.9), Lines(arrows, BLUE, 1.1)))
    finish_axes(ax, points, unit)
    if len(mesh.bodies) == 1:
        used = {name for name, *_ in _uses(posed)} | {getattr(load, "boundary", None) for load in posed.loads}
        free = [quoted(name) for name in mesh.boundaries if name not in used]
        loads += [(Patch(facecolor=PALE, edgecolor=INK, linewidth=0.6), ", ".join(free))] if free else []
        _look(posed, mesh, points, ax)
    handles, labels = zip(*legend, *loads, strict=True)
    ax.legend(handles, labels, loc="upper left", bbox_to_anchor=(1.02, 0.95), title=describe_law(posed.law),
              alignment="left")


def _look(posed: ContactProblem, mesh: MeshArrays, points: np.ndarray, ax: Axes3D) -> None:
    """Choose from where contact shows; name the boundaries on that side."""
    boundaries = [points[mesh.facets[mesh.facet_labels == k]] for k in range(len(mesh.boundaries))]
    contact = [mesh.boundaries.index(one.boundary) for one in posed.contact]
    loaded = [mesh.boundaries.index(load.boundary) for load in posed.loads if isinstance(load, Pressure | Traction)]
    # contact counts three times
    view_of(ax, np.concatenate([boundaries[k] for k in (*3 * contact, *loaded)]))
    for name, corners in zip(mesh.boundaries, boundaries, strict=True):
        if len(corners) and normals_of(corners).mean(axis=0) @ viewer(ax.elev, ax.azim) > 0.1:
            ax.text(*corners.mean(axis=(0, 1)), plain(name), ha="center", va="center", fontsize=8, zorder=9,
                    bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.6, "pad": 1.0})


def _apart(mesh: MeshArrays, explode: float) -> np.ndarray:
    """How far each body is moved (n_bodies, 3), m."""
    centres = np.array([np.mean(bounds(mesh.points[np.unique(mesh.elements[mesh.element_body == k])])[:2], axis=0)
                        for k in range(len(mesh.bodies))])
    return explode * (centres - centres.mean(axis=0))


def _uses(posed: ContactProblem) -> list[tuple[str, str, str]]:
    """Boundary, colour and words for supports and contact; what comes later is painted over what came before."""
    found = []
    for support in posed.supports:
        text = support_text(support, 3).replace("\n", ", ")
        found.append((support.boundary, _SUPPORT, f"{text} on {quoted(support.boundary)}"))
    for contact in posed.contact:
        found.append((contact.boundary, _CONTACT, f"contact on {quoted(contact.boundary)}"))
        if isinstance(contact, ContactPair):
            found.append((contact.master, _MASTER, f"  its master {quoted(contact.master)}"))
    return found


def _loads(posed: ContactProblem, mesh: MeshArrays, points: np.ndarray
           ) -> tuple[np.ndarray, list[tuple[Artist, str]]]:
    """Arrows (n, 2, 3) at some facets of loaded boundaries, the largest a sixth of the size; legend of all loads."""
    surface = [load for load in posed.loads if isinstance(load, Pressure | Traction)]
    places = [_places(load, mesh) for load in surface]
    largest = max((float(np.linalg.norm(traction, axis=1).max()) for _, traction in places), default=0.0)
    reach = float(np.max(np.ptp(points, axis=0))) / 6 / largest if largest > 0 else 0.0
    strokes, entries = [np.empty((0, 2, 3))], []
    for load, (facets, traction) in zip(surface, places, strict=True):
        x, arrows = points[facets].mean(axis=1), reach * traction
        pushing = np.einsum("nd,nd->n", traction, normals_of(points[facets])) <= 0
        strokes += _arrows(np.where(pushing[:, None], x - arrows, x), arrows)
        entries.append((Line2D([], [], color=BLUE), f"{surface_load_text(load, traction)} on {quoted(load.boundary)}"))
    entries += [(Line2D([], [], color=BLUE, linestyle=":"), volume_load_text(load)) for load in posed.loads
                if isinstance(load, BodyForce | InitialStrain)]
    return np.concatenate(strokes), entries


def _arrows(tails: np.ndarray, arrows: np.ndarray) -> list[np.ndarray]:
    """Shafts and the four strokes of each head as segments (n, 2, 3)."""
    tips, first = tails + arrows, np.zeros_like(arrows)
    first[np.arange(len(arrows)), np.argmin(np.abs(arrows), axis=1)] = 1.0
    second = np.cross(arrows, first)
    size = np.linalg.norm(arrows, axis=1)[:, None]
    across = size * second / np.maximum(np.linalg.norm(second, axis=1)[:, None], np.finfo(float).tiny)
    other = np.cross(arrows, across) / np.maximum(size, np.finfo(float).tiny)
    sides = (across, -across, other, -other)
    return [np.stack([tails, tips], 1), *(np.stack([tips - 0.3 * arrows + 0.12 * side, tips], 1) for side in sides)]


def _places(load: Pressure | Traction, mesh: MeshArrays) -> tuple[np.ndarray, np.ndarray]:
    """Facets (n, 3) spread over a loaded boundary, at most 24, and the traction there (n, 3), Pa."""
    facets = mesh.boundary_facets(load.boundary)
    facets = facets[np.unique(np.linspace(0, len(facets) - 1, 24).astype(int))]
    corners = mesh.points[facets]
    return facets, tractions(load, corners.mean(axis=1), normals_of(corners))


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
        _draw_solid(posed, _coarse_mesh(posed.domain) if mesh is None else mesh, ax,
                    checks.number("explode", explode))
    else:
        polygons = polygons_of(posed.domain)
        lower, upper, _ = bounds(np.vstack(list(polygons.values())))
        width, height = (upper - lower) / np.max(upper - lower)
        # with several bodies there is a legend
        ax = canvas(ax, (4.2 * width + (6.0 if len(polygons) > 1 else 2.6), 4.2 * height + 1.8))
        draw(posed, ax)
    ax.set_title(plain(posed.name))
    return ax.figure


def describe_law(law: Law) -> str:
    """A law in a few words: 'Coulomb, friction 0.3'."""
    if isinstance(law, Frictionless):
        return "frictionless contact"
    if isinstance(law, Coulomb):
        return f"Coulomb friction {_parameter(law.friction)}"
    if isinstance(law, Tresca):
        return f"Tresca limit {_parameter(law.limit, 'Pa')}"
    return f"contact ({type(law).__name__})"


def _parameter(value: object, unit: str = "") -> str:
    return "f(x)" if callable(value) else _quantity(float(value), unit) if unit else number(float(value))


def _quantity(value: float, unit: str) -> str:
    factor, unit = scaled(abs(value), unit)
    return f"{number(value * factor)} {unit}"


def support_text(support: Support, dim: int, axes: Sequence[str] = "xyz") -> str:
    """The prescribed components, a line each: '$u_x$ = 0'; equal ones together. ``axes`` are the names of the axes."""
    lines: dict[str, list[str]] = {}
    for axis, value in zip(axes, support.components(dim), strict=False):
        if value is not None:
            lines.setdefault("0" if value == 0 else _parameter(value, "m"), []).append(f"$u_{axis}$")
    return "\n".join(f"{' = '.join(names)} = {value}" for value, names in lines.items())


def surface_load_text(load: Pressure | Traction, traction: np.ndarray) -> str:
    """How large a load is whose tractions (n, dim), Pa, are known at some points: 'p = 2 MPa', '|t| up to 3 kPa'."""
    sizes = np.linalg.norm(traction, axis=1)
    largest = float(sizes.max())
    relation = "up to" if np.ptp(sizes) > 1e-9 * largest else "="
    given = load.value if isinstance(load, Pressure) and not callable(load.value) else largest
    return f"{'p' if isinstance(load, Pressure) else '|t|'} {relation} {_quantity(given, 'Pa')}"


def volume_load_text(load: BodyForce | InitialStrain, axes: Sequence[str] = "xyz") -> str:
    """What acts in a body, how much and in which: 'body force 3 kN/m³ in 'rod''."""
    where = "" if load.body is None else f" in {quoted(load.body)}"
    if isinstance(load, InitialStrain):
        parts = [f"$\\varepsilon_{axis}$ = {_parameter(value)}"
                 for axis, value in zip(axes, load.components, strict=False) if callable(value) or value != 0]
        return f"initial strain{where}\n{', '.join(parts) or '0'}"
    if any(map(callable, load.components)):
        return f"body force f(x){where}"
    size = float(np.linalg.norm(load.components))
    if len(load.components) == 2:
        return f"body force {_quantity(size, 'N/m³')}{where}"
    factor, unit = scaled(size, "N/m³")
    return f"body force ({', '.join(number(c * factor) for c in load.components)}) {unit}{where}"


def tractions(load: Pressure | Traction, x: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Tractions (n, dim), Pa, of a load at points (n, dim), m, with outward unit normals."""
    def at(value: object) -> np.ndarray:
        return np.broadcast_to(np.asarray(value(x) if callable(value) else value, dtype=float), len(x))

    if isinstance(load, Pressure):
        return -at(load.value)[:, None] * normals
    return np.stack([at(component) for component in load.components], axis=1)
