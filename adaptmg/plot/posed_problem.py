"""problem: a picture of a contact problem - boundaries coloured by their use, loads as arrows, and a legend.

Plane bodies are polygons (arcs as chords), as in Fig. 2 of the paper, or the triangles of a user's mesh without the
lines between them; solids are the surface of a mesh. The arrows of tractions are proportional to them: those that push
end on the boundary, those that pull start there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch, Polygon
from matplotlib.path import Path
from mpl_toolkits.mplot3d import Axes3D

from adaptmg import _checks as checks
from adaptmg.discrete.loads import load_density
from adaptmg.discrete.supports import supported_nodes
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.plot import style
from adaptmg.plot.surfaces import Lines, ShadedSurface, finish_axes, normals_of, sharp_edges, view_of, viewer
from adaptmg.problem import Assembly, Contact, ContactPair, ContactProblem, Domain, StepFile, laws, loads

_CONTACT, _MASTER, _SUPPORT = "#e8833a", "#f2c530", "#4fb38a"

SurfaceLoad = loads.Pressure | loads.Traction
#: a load, and points, outward unit normals and tractions (n, dim) on its boundary
_Drawn = tuple[SurfaceLoad, np.ndarray, np.ndarray, np.ndarray]


@style.styled
def problem(posed: ContactProblem, ax: Axes | None = None, *, mesh: MeshArrays | None = None) -> Figure:
    """Draw a contact problem: bodies, contact boundaries, obstacles, supports and loads.

    Gaps in front of obstacles too small to be seen are drawn enlarged, and the legend says so.

    Parameters
    ----------
    posed : ContactProblem
        With a domain, or drawn on ``mesh``.
    ax : matplotlib Axes, optional
        In 3D with ``projection="3d"``.
    mesh : MeshArrays, optional
        The mesh whose bodies and boundaries are drawn; default: the domain, in 3D a coarse mesh of it.

    Examples
    --------
    >>> figure = am.plot.problem(am.cases.greco_bar())
    >>> figure.axes[0].get_title()
    'GRECO bar'
    """
    checks.instance("posed", posed, ContactProblem)
    if posed.domain is None and mesh is None:
        raise ValueError("the problem has no domain to draw: give mesh=..., for example that of a level of the "
                         "hierarchy")
    if mesh is not None:
        checks.instance("mesh", mesh, MeshArrays, "MeshArrays: adaptmg.mesh.as_mesh converts")
        posed.check_boundaries(mesh.boundaries)
    if posed.dim == 3:
        ax = style.canvas(ax, (8.4, 5.6), dim=3)
        _draw_solid(posed, _coarse_mesh(posed.domain) if mesh is None else mesh, ax)
    else:
        bodies = _loops(posed.domain) if mesh is None else _triangles(mesh)
        lower, upper, _ = style.bounds(np.concatenate([loop for loops in bodies.values() for loop in loops]))
        width, height = (upper - lower) / np.max(upper - lower)
        ax = style.canvas(ax, (4.4 * width + 3.9, 4.4 * height + 1.4))
        _draw_plane(posed, bodies, boundary_edges(posed.domain) if mesh is None else _mesh_edges(mesh), ax)
    style.entitle(ax, style.plain(posed.name))
    return ax.figure


def _draw_plane(posed: ContactProblem, bodies: dict[str, list[np.ndarray]], edges: dict[str, np.ndarray], ax: Axes
                ) -> None:
    diagonal = style.bounds(np.concatenate([loop for loops in bodies.values() for loop in loops]))[2]
    scale, unit = style.scaled(diagonal, "m")
    size, fills = 0.7 * diagonal, style.body_fills(len(bodies))
    for loops, fill in zip(bodies.values(), fills, strict=True):
        # small bodies on top of large ones
        area = sum(float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) for x, y in (loop.T for loop in loops))
        path = Path.make_compound_path(*(Path(scale * np.append(loop, loop[:1], axis=0), closed=True)
                                         for loop in loops))
        ax.add_patch(PathPatch(path, facecolor=fill, edgecolor="none", zorder=3 - area / diagonal**2))
    ax.add_collection(LineCollection(scale * np.concatenate(list(edges.values())), color=style.INK, linewidth=1.2,
                                     zorder=3.2, capstyle="round"))
    for support in (one for one in posed.supports if one.boundary is None):
        ax.plot(*scale * np.array(support.point), "^", color=_SUPPORT, markeredgecolor=style.INK, markersize=9,
                zorder=5)
    for boundary, color, _ in (use for use in _uses(posed) if use[0] in edges):
        ax.add_collection(LineCollection(scale * edges[boundary], color=color, zorder=4, capstyle="butt",
                                         linewidth=2.0 if color == _MASTER else 4.0))
    enlarged = {contact.boundary: _draw_obstacle(ax, contact, edges[contact.boundary], size, scale)
                for contact in posed.contact if isinstance(contact, Contact)}
    places: list[_Drawn] = []
    for load in _surface_loads(posed):
        length = np.linalg.norm(np.diff(edges[load.boundary], axis=1), axis=2).sum()
        x, normals = spread(edges[load.boundary], np.linspace(0.06, 0.94, max(3, round(12 * length / size))))
        places.append((load, x, normals, load_density(load, x[:, None], normals)[:, 0]))
    for tails, arrows in _arrows(places, 0.17 * size):
        ax.quiver(*scale * tails.T, *scale * arrows.T, angles="xy", scale_units="xy", scale=1, color=style.BLUE,
                  units="inches", width=0.02, headwidth=4.5, headlength=5.5, headaxislength=5, zorder=5)
        ax.update_datalim(scale * np.concatenate([tails, tails + arrows]))
    if len(bodies) == 1:
        for boundary, segments in edges.items():
            middle, normal = (part[0] for part in spread(segments, np.array([0.5])))
            ax.annotate(style.plain(boundary), scale * middle, -9 * normal, textcoords="offset points", color=style.INK,
                        fontsize=8, ha=("left", "center", "right")[round(normal[0]) + 1],
                        va=("bottom", "center", "top")[round(normal[1]) + 1], zorder=6)
    names = "rzθ" if posed.axisymmetric else "xyz"
    ax.set(aspect="equal", anchor="W", xlabel=f"{names[0]} [{unit}]", ylabel=f"{names[1]} [{unit}]")
    ax.margins(0.06)
    ax.autoscale_view()
    _legend(posed, ax, list(bodies), fills, names, places, edges, enlarged)


def _draw_obstacle(ax: Axes, contact: Contact, edges: np.ndarray, size: float, scale: float) -> int:
    """Hatch the obstacle in front of a boundary; return how many times the gap is enlarged."""
    fractions = np.linspace(0.0, 1.0, 21)[:, None]
    points = np.concatenate([a + fractions * (b - a) for a, b in edges])
    normals = np.repeat(_outward(edges), len(fractions), axis=0)
    inward, gaps = contact.obstacle.contact(points, normals)
    largest, visible = float(np.abs(gaps).max()), 0.06 * size
    times = 1 if largest < 1e-9 * size or largest > visible / 4 else int(float(f"{visible / largest:.0e}"))
    surface = points + times * gaps[:, None] * inward
    behind = surface + visible * inward
    for front, back in zip(np.split(scale * surface, len(edges)), np.split(scale * behind, len(edges)), strict=True):
        ax.add_patch(Polygon(np.concatenate([front, back[::-1]]), facecolor="none", edgecolor=style.GREY, hatch="////",
                             linewidth=0, zorder=1))
        ax.plot(*front.T, color=style.INK, linewidth=1.2, zorder=3.5)
    ax.update_datalim(scale * behind)
    return times


def _outlines(domain: Domain) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of each body of a plane domain the edges (n, 2, 2), m, the body on their left, and their boundaries (n,)."""
    result = {}
    for body, part in (domain.parts if isinstance(domain, Assembly) else {domain.bodies[0]: domain}).items():
        corners, edge, following = part.outline.chords()
        result[body] = np.stack([corners, corners[following]], axis=1), np.array(part.outline.boundaries)[edge]
    return result


def _loops(domain: Domain) -> dict[str, list[np.ndarray]]:
    """Corners (n, 2), m, around each body of a plane domain, and around its holes."""
    return {body: np.split(edges[:, 0], 1 + np.flatnonzero((edges[:-1, 1] != edges[1:, 0]).any(axis=1)))
            for body, (edges, _) in _outlines(domain).items()}


def boundary_edges(domain: Domain) -> dict[str, np.ndarray]:
    """Return the edges (n, 2, 2), m, of each boundary of a plane domain, the body on their left."""
    return {f"{body}.{name}" if isinstance(domain, Assembly) else name: edges[names == name]
            for body, (edges, names) in _outlines(domain).items() for name in dict.fromkeys(names.tolist())}


def _triangles(mesh: MeshArrays) -> dict[str, list[np.ndarray]]:
    """The triangles (3, 2), m, of each body of a plane mesh."""
    return {body: list(mesh.points[mesh.elements[mesh.element_body == k]]) for k, body in enumerate(mesh.bodies)}


def _mesh_edges(mesh: MeshArrays) -> dict[str, np.ndarray]:
    """As :func:`boundary_edges`, of a mesh; edges that follow each other stand so."""
    lines = {name: style.polylines(mesh.boundary_facets(name)) for name in mesh.boundaries}
    return {name: np.concatenate([np.empty((0, 2, 2)), *(mesh.points[np.stack([line[:-1], line[1:]], axis=1)]
                                                        for line in parts)]) for name, parts in lines.items()}


def _outward(edges: np.ndarray) -> np.ndarray:
    """Outward unit normals (n, 2) of edges."""
    along = edges[:, 1] - edges[:, 0]
    return np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]


def spread(edges: np.ndarray, fractions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points (k, 2) at fractions (k,) of the length of edges (n, 2, 2), and the outward unit normals there."""
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    place = fractions * ends[-1]
    edge = np.clip(np.searchsorted(ends, place, side="right") - 1, 0, len(edges) - 1)
    share = ((place - ends[edge]) / lengths[edge])[:, None]
    return (1 - share) * edges[edge, 0] + share * edges[edge, 1], _outward(edges)[edge]


def _coarse_mesh(domain: Domain) -> MeshArrays:
    """A mesh that shows the shape: edges of a twelfth of the extent of each body."""
    from adaptmg.mesh import graded, step_table

    if isinstance(domain, StepFile):
        table = step_table(domain)
        solids = table[table.kind == "solid"]
        extents = dict(zip(solids.solid, solids[["dx", "dy", "dz"]].max(axis=1), strict=True))
    else:
        extents = {body: float(np.max(part.upper - part.lower))
                   for body, part in getattr(domain, "parts", {"": domain}).items()}
    sizes = {body: extent / 12 for body, extent in extents.items()}
    return graded(domain, sizes.get("", sizes))


def _draw_solid(posed: ContactProblem, mesh: MeshArrays, ax: Axes3D) -> None:
    scale, unit = style.scaled(style.bounds(mesh.points)[2], "m")
    body_of_node = np.zeros(mesh.n_nodes, dtype=int)
    body_of_node[mesh.elements] = mesh.element_body[:, None]
    points = mesh.points * scale
    corners, of_boundary = points[mesh.facets], {name: mesh.facet_labels == k for k, name in enumerate(mesh.boundaries)}
    body, fills = body_of_node[mesh.facets[:, 0]], style.body_fills(len(mesh.bodies))
    colors = to_rgba_array(fills)[body]
    for boundary, color, _ in (use for use in _uses(posed) if use[0] in of_boundary):
        colors[of_boundary[boundary]] = to_rgba(color)
    places = []
    for load in _surface_loads(posed):
        mine = np.flatnonzero(of_boundary[load.boundary])
        mine = mine[np.unique(np.linspace(0, len(mine) - 1, 24).astype(int))]
        normals = normals_of(corners[mine])
        places.append((load, corners[mine].mean(axis=1), normals,
                       load_density(load, corners[mine].mean(axis=1)[:, None] / scale, normals)[:, 0]))
    arrows = [stroke for arrow in _arrows(places, float(np.max(np.ptp(points, axis=0))) / 6)
              for stroke in _strokes(*arrow)]
    edges = np.concatenate([sharp_edges(points, mesh.facets[body == k]) for k in range(len(mesh.bodies))])
    for support in (one for one in posed.supports if one.boundary is None):
        ax.plot(*points[supported_nodes(mesh, support)].T, "^", color=_SUPPORT, markeredgecolor=style.INK, zorder=9)
    ax.add_artist(ShadedSurface(corners, colors, edges=False, lines=(
        Lines(points[edges], style.INK, 0.9), Lines(np.concatenate([np.empty((0, 2, 3)), *arrows]), style.BLUE, 1.6,
                                                     hidden="#8fbfe0"))))
    finish_axes(ax, points, unit)
    if len(mesh.bodies) == 1:
        # the view in which contact, three times, and loads show most
        seen = [*3 * posed.contact_boundaries, *(load.boundary for load in _surface_loads(posed))]
        view_of(ax, np.concatenate([corners[:0], *(corners[of_boundary[name]] for name in seen)]))
    if len(mesh.bodies) == 1 or isinstance(posed.domain, StepFile):
        for name, mine in of_boundary.items():
            if mine.any() and normals_of(corners[mine]).mean(axis=0) @ viewer(ax.elev, ax.azim) > 0.1:
                ax.text(*corners[mine].mean(axis=(0, 1)), style.plain(name), ha="center", va="center", fontsize=8,
                        zorder=9, bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.6, "pad": 1.0})
    _legend(posed, ax, mesh.bodies, fills, "xyz", places, mesh.boundaries, {})


def _strokes(tails: np.ndarray, arrows: np.ndarray) -> list[np.ndarray]:
    """Shafts and the four strokes of each head as segments (n, 2, 3)."""
    tips, first = tails + arrows, np.zeros_like(arrows)
    first[np.arange(len(arrows)), np.argmin(np.abs(arrows), axis=1)] = 1.0
    second, size = np.cross(arrows, first), np.linalg.norm(arrows, axis=1)[:, None]
    across = size * second / np.maximum(np.linalg.norm(second, axis=1)[:, None], 1e-300)
    other = np.cross(arrows, across) / np.maximum(size, 1e-300)
    return [np.stack([tails, tips], 1), *(np.stack([tips - 0.3 * arrows + 0.12 * side, tips], 1)
                                          for side in (across, -across, other, -other))]


def _surface_loads(posed: ContactProblem) -> list[SurfaceLoad]:
    return [load for load in posed.loads if isinstance(load, SurfaceLoad)]


def _arrows(places: list[_Drawn], reach: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Tails and vectors (n, dim) for points, normals and tractions of each load, the longest ``reach``."""
    largest = max((float(np.linalg.norm(traction, axis=1).max()) for *_, traction in places), default=0.0)
    arrows = [(x, normals, traction * (reach / largest if largest else 0.0)) for _, x, normals, traction in places]
    return [(np.where(np.einsum("nd,nd->n", arrow, normals)[:, None] <= 0, x - arrow, x), arrow)
            for x, normals, arrow in arrows]


def _uses(posed: ContactProblem) -> list[tuple[str, str, str]]:
    """Boundary, colour and text of supports and contacts; later ones are painted over earlier ones."""
    uses = [(support.place, _SUPPORT, support_text(support, posed.dim, "rz" if posed.axisymmetric else "xyz"))
            for support in posed.supports]
    for tie in posed.ties:
        uses += [(tie.slave, _CONTACT, "tie"), (tie.master, _MASTER, "  its master")]
    for contact in posed.contact:
        uses.append((contact.boundary, _CONTACT, "contact" if contact.law is None else _law_text(contact.law)))
        if isinstance(contact, ContactPair):
            uses.append((contact.master, _MASTER, "  its master"))
    return uses


def _legend(posed: ContactProblem, ax: Axes, bodies: Sequence[str], fills: Sequence[str], axes: str,
            places: list[_Drawn], boundaries: Sequence[str], enlarged: dict[str, int]) -> None:
    """List bodies, uses of boundaries and loads under the name of the law; of a single body the free boundaries too."""
    entries: list[tuple[Artist, str]] = []
    if len(bodies) > 1:
        entries += [(Patch(facecolor=fill, edgecolor=style.INK), style.plain(body))
                    for body, fill in zip(bodies, fills, strict=True)]
    for boundary, color, text in _uses(posed):
        times = enlarged.get(boundary, 1)
        text = f"{text} on" if color != _MASTER else text
        entries.append((Patch(facecolor=color, edgecolor=style.INK),
                        f"{text} {style.quoted(boundary)}" + (f"\n(gap drawn {times} times)" if times > 1 else "")))
    acting = [(load, traction) for load, _, _, traction in places if traction.any()]
    entries += [(Line2D([], [], color=style.BLUE), f"{_surface_text(load, traction)} on {style.quoted(load.boundary)}")
                for load, traction in acting]
    entries += [(Line2D([], [], color=style.BLUE, linestyle=":"), _volume_text(load, axes)) for load in posed.loads
                if isinstance(load, loads.BodyForce | loads.InitialStrain | loads.Preload)]
    used = {name for name, *_ in _uses(posed)} | {load.boundary for load, _ in acting}
    if len(bodies) == 1 and (free := [style.quoted(name) for name in boundaries if name not in used]):
        entries.append((Patch(facecolor=style.PALE, edgecolor=style.INK), f"free: {', '.join(free)}"))
    handles, labels = zip(*entries, strict=True)
    ax.legend(handles, labels, loc="upper left", bbox_to_anchor=(1.02, 1.0), fontsize=8, alignment="left",
              title=_law_text(posed.law) if posed.contact else None, borderaxespad=0.0)


def _law_text(law: laws.Law) -> str:
    if isinstance(law, laws.Frictionless):
        return "frictionless contact"
    if isinstance(law, laws.Coulomb):
        return f"Coulomb friction {_value(law.friction)}"
    if isinstance(law, laws.Tresca):
        return f"Tresca limit {_value(law.limit, 'Pa')}"
    return f"contact ({type(law).__name__})"


def _value(value: object, unit: str = "") -> str:
    """A parameter as text: f(x), or a number with its prefixed unit."""
    if callable(value):
        return "f(x)"
    factor, unit = style.scaled(abs(float(value)), unit) if unit else (1.0, "")
    return f"{style.number(float(value) * factor)} {unit}".strip()


def support_text(support: loads.AnySupport, dim: int, axes: str = "xyz") -> str:
    """Return the prescribed components as text, equal ones together: '$u_x$ = $u_y$ = 0'; or what else holds."""
    if isinstance(support, loads.Symmetry):
        return "symmetry: $u_n$ = 0"
    if isinstance(support, loads.Spring | loads.PointSpring):
        names, unit = (("normal", "tangential"), "N/m³") if isinstance(support, loads.Spring) else ("xyz"[:dim], "N/m")
        return "springs " + ", ".join(f"{name} {_value(getattr(support, name), unit)}" for name in names
                                      if callable(getattr(support, name)) or getattr(support, name))
    values: dict[str, list[str]] = {}
    along = (*zip(axes, support.components(dim), strict=False), ("n", getattr(support, "normal", None)))
    for axis, value in along:
        if value is not None:
            values.setdefault("0" if value == 0 else _value(value, "m"), []).append(f"$u_{axis}$")
    return ", ".join(f"{' = '.join(names)} = {value}" for value, names in values.items())


def _surface_text(load: SurfaceLoad, traction: np.ndarray) -> str:
    """The size of a load with tractions (n, dim), Pa: 'p = 2 MPa', '|t| up to 3 kPa'."""
    sizes = np.linalg.norm(traction, axis=1)
    largest = float(sizes.max())
    pressure, relation = isinstance(load, loads.Pressure), "up to" if np.ptp(sizes) > 1e-9 * largest else "="
    value = load.value if pressure and not callable(load.value) else largest
    return f"{'p' if pressure else '|t|'} {relation} {_value(value, 'Pa')}"


def _volume_text(load: loads.BodyForce | loads.InitialStrain | loads.Preload, axes: str) -> str:
    """The load in a body: 'body force (0, 3) kN/m³ in 'rod''."""
    where = "" if load.body is None else f" in {style.quoted(load.body)}"
    if isinstance(load, loads.Preload):
        return f"preload {_value(load.force, 'N')}{where}"
    if isinstance(load, loads.InitialStrain):
        parts = [f"$\\varepsilon_{axis}$ = {_value(value)}"
                 for axis, value in zip(axes, load.components, strict=False) if callable(value) or value != 0]
        return f"initial strain{where}\n{', '.join(parts) or '0'}"
    if any(map(callable, load.components)):
        return f"body force f(x){where}"
    factor, unit = style.scaled(max(map(abs, load.components)), "N/m³")
    return f"body force ({', '.join(style.number(factor * c) for c in load.components)}) {unit}{where}"
