"""problem: a picture of what is posed - bodies, obstacles, contact pairs, loads, supports (as Fig. 2 of the paper).

Solids of any shape are the surface of a mesh, coloured by what its boundaries are for, with arrows of loads; plane
problems are drawn by :mod:`adaptmg.plot.posed.plane`.
"""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d import Axes3D

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.plot.posed import plane
from adaptmg.plot.posed.plan import polygons_of
from adaptmg.plot.posed.words import describe_law, support_text, surface_load_text, tractions, volume_load_text
from adaptmg.plot.space.axes import finish_axes, view_of
from adaptmg.plot.space.surface import Lines, draw_facets, normals_of, sharp_edges, viewer
from adaptmg.plot.style import BLUE, BODY_COLORS, INK, PALE, bounds, canvas, plain, quoted, scaled, styled
from adaptmg.problem import BodyForce, ContactPair, ContactProblem, Domain, InitialStrain, Pressure, Traction, checks

__all__ = ["problem"]


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
        plane.draw(posed, ax)
    ax.set_title(plain(posed.name))
    return ax.figure
