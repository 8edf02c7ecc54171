"""problem: a picture of a contact problem - boundaries coloured by their use, loads as arrows, and
a legend.

The bodies are drawn on a mesh without the lines between its elements. The arrows of tractions are
proportional to them: those that push end on the boundary, those that pull start there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d import Axes3D

from adaptmg import _checks as checks
from adaptmg.discrete.loads import load_density
from adaptmg.level import meshed_domain
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.plot import style
from adaptmg.plot.bodies import boundary_marks, draw_bodies
from adaptmg.plot.surfaces import Lines, view_of, viewer
from adaptmg.problem import Contact, ContactPair, ContactProblem, StepFile, laws, loads

_CONTACT, _MASTER, _SUPPORT = "#e8833a", "#f2c530", "#4fb38a"

SurfaceLoad = loads.Pressure | loads.Traction
#: a load, and points, outward normals and tractions (n, dim) on its boundary; or a point and its force
_Drawn = tuple[SurfaceLoad | loads.PointForce, np.ndarray, np.ndarray, np.ndarray]


@style.styled
def problem(
    posed: ContactProblem, ax: Axes | None = None, *, mesh: MeshArrays | None = None
) -> Figure:
    """Draw a contact problem: bodies, contact boundaries, obstacles, supports and loads.

    Gaps in front of obstacles too small to be seen are drawn enlarged, and the legend says so.

    Parameters
    ----------
    posed : ContactProblem
        With a domain, or drawn on ``mesh``.
    ax : matplotlib Axes, optional
        In 3D with ``projection="3d"``.
    mesh : MeshArrays, optional
        The mesh whose bodies and boundaries are drawn; default: a coarse mesh of the domain.

    Examples
    --------
    >>> figure = am.plot.problem(am.cases.greco_bar())
    >>> figure.axes[0].get_title()
    'GRECO bar'
    """
    checks.instance("posed", posed, ContactProblem)
    if posed.domain is None and mesh is None:
        raise ValueError(
            "the problem has no domain to draw: give mesh=..., for example that of a level of the "
            "hierarchy"
        )
    mesh = (
        _coarse_mesh(posed)
        if mesh is None
        else checks.instance("mesh", mesh, MeshArrays, "MeshArrays: adaptmg.mesh.as_mesh converts")
    )
    posed.check_boundaries(mesh.boundaries)
    lower, upper, _ = style.bounds(mesh.points)
    width, height = (upper - lower)[:2] / np.max(upper - lower)
    size = (8.4, 5.6) if posed.dim == 3 else (4.4 * width + 3.9, 4.4 * height + 1.4)
    ax = style.canvas(ax, size, posed.dim)
    _draw(posed, mesh, ax)
    style.entitle(ax, style.plain(posed.name))
    return ax.figure


def _coarse_mesh(posed: ContactProblem) -> MeshArrays:
    """A mesh that shows the shape: edges of a fraction of the extent of each body."""
    from adaptmg.mesh import graded, step_table

    domain = meshed_domain(posed)
    if isinstance(domain, StepFile):
        table = step_table(domain)
        solids = table[table.kind == "solid"]
        extents = dict(zip(solids.solid, solids[["dx", "dy", "dz"]].max(axis=1), strict=True))
    else:
        extents = {
            body: float(np.max(part.upper - part.lower))
            for body, part in getattr(domain, "parts", {"": domain}).items()
        }
    sizes = {body: extent / (12 if posed.dim == 3 else 40) for body, extent in extents.items()}
    return graded(domain, sizes.get("", sizes))


def _draw(posed: ContactProblem, mesh: MeshArrays, ax: Axes) -> None:
    solid = posed.dim == 3
    names = "rzθ" if posed.axisymmetric else "xyz"
    fills = style.body_fills(len(mesh.bodies))
    uses = _uses(posed)
    extent = float(np.max(np.ptp(mesh.points, axis=0)))
    scale = style.scaled(style.bounds(mesh.points)[2], "m")[0]
    places: list[_Drawn] = []
    for load in (one for one in posed.loads if isinstance(one, SurfaceLoad)):
        length = mesh.surface(load.boundary).measures.sum()
        x, normals = _spread(
            mesh, load.boundary, 24 if solid else max(3, round(12 * length / extent))
        )
        places.append((load, x, normals, load_density(load, x[:, None], normals)[:, 0]))
    middle = mesh.points.mean(axis=0)
    points = [
        (load, np.array([load.point]), load.point - middle[None], np.array([load.components]))
        for load in posed.loads
        if isinstance(load, loads.PointForce)
    ]
    reach = extent / 6
    arrows = [
        (scale * tails, scale * vectors)
        for tails, vectors in (*_arrows(places, reach), *_arrows(points, reach))
    ]
    strokes = [stroke for arrow in arrows for stroke in _strokes(*arrow)] if solid else []
    draw_bodies(
        ax,
        mesh,
        fills,
        boundary_marks(mesh, {name: color for name, color, _ in uses}) if solid else None,
        lines=False,
        axes=names,
        strokes=[Lines(np.concatenate(strokes), style.BLUE, 1.6, "#8fbfe0")] if strokes else (),
    )
    for support in (one for one in posed.supports if one.boundary is None):
        ax.plot(
            *scale * np.array(support.point),
            "^",
            color=_SUPPORT,
            markeredgecolor=style.INK,
            markersize=9,
            zorder=9,
        )
    if solid:
        enlarged: dict[str, int] = {}
        _name_faces(posed, mesh, ax, scale, [load.boundary for load, *_ in places])
    else:
        for boundary, color, _ in (use for use in uses if use[0] in mesh.boundaries):
            ax.add_collection(
                LineCollection(
                    scale * mesh.points[mesh.boundary_facets(boundary)],
                    color=color,
                    zorder=4,
                    linewidth=2.0 if color == _MASTER else 4.0,
                    capstyle="round",
                )
            )
        enlarged = {
            contact.boundary: _draw_obstacle(ax, contact, mesh, extent, scale)
            for contact in posed.contact
            if isinstance(contact, Contact)
        }
        for tails, vectors in arrows:
            ax.quiver(
                *tails.T,
                *vectors.T,
                angles="xy",
                scale_units="xy",
                scale=1,
                color=style.BLUE,
                units="inches",
                width=0.02,
                headwidth=4.5,
                headlength=5.5,
                headaxislength=5,
                zorder=5,
            )
            ax.update_datalim(np.concatenate([tails, tails + vectors]))
        for boundary in mesh.boundaries if len(mesh.bodies) == 1 else ():
            middle, normal = (part[0] for part in _spread(mesh, boundary, 1))
            ax.annotate(
                style.plain(boundary),
                scale * middle,
                -9 * normal,
                textcoords="offset points",
                color=style.INK,
                fontsize=8,
                ha=("left", "center", "right")[round(normal[0]) + 1],
                va=("bottom", "center", "top")[round(normal[1]) + 1],
                zorder=6,
            )
        ax.set_anchor("W")
        ax.margins(0.06)
        ax.autoscale_view()
    _legend(posed, ax, mesh, fills, names, places, enlarged)


def _spread(mesh: MeshArrays, boundary: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (count, dim), m, at equal parts of a boundary, in 3D in the middle of facets; and
    outward unit normals."""
    surface = mesh.surface(boundary)
    ends = np.cumsum(surface.measures)
    # in 3D multiples of the golden ratio, which keep clear of the rows of a lattice
    at = ends[-1] * (
        (np.arange(count) + 0.5) / count if mesh.dim == 2 else 0.618034 * np.arange(count) % 1.0
    )
    facet = np.searchsorted(ends, at)
    left = (ends[facet] - at) / surface.measures[facet]
    weights = np.stack([left, 1 - left] if mesh.dim == 2 else [np.full(count, 1 / 3)] * 3, axis=1)
    return np.einsum("nk,nkd->nd", weights, mesh.points[surface.facets[facet]]), surface.normals[
        facet
    ]


def _draw_obstacle(
    ax: Axes, contact: Contact, mesh: MeshArrays, extent: float, scale: float
) -> int:
    """Hatch the obstacle in front of a boundary; return how many times the gap is enlarged."""
    surface = mesh.surface(contact.boundary)
    points = mesh.points[surface.facets].reshape(-1, 2)
    normals = np.repeat(surface.normals, 2, axis=0)
    inward, gaps = contact.obstacle.contact(points, normals)
    largest = float(np.abs(gaps).max())
    visible = 0.06 * extent
    times = (
        1
        if largest < 1e-9 * extent or largest > visible / 4
        else int(float(f"{visible / largest:.0e}"))
    )
    front = (points + times * gaps[:, None] * inward).reshape(-1, 2, 2)
    behind = front + visible * inward.reshape(-1, 2, 2)
    ax.add_collection(
        PolyCollection(
            scale * np.concatenate([front, behind[:, ::-1]], axis=1),
            facecolor="none",
            edgecolor=style.GREY,
            hatch="////",
            linewidth=0,
            zorder=1,
        )
    )
    ax.add_collection(LineCollection(scale * front, color=style.INK, linewidth=1.2, zorder=3.5))
    return times


def _name_faces(
    posed: ContactProblem, mesh: MeshArrays, ax: Axes3D, scale: float, loaded: list[str]
) -> None:
    """Turn a single body so that contact, which counts three times, and loads show most, and name
    what is seen."""
    corners = {name: scale * mesh.points[mesh.boundary_facets(name)] for name in mesh.boundaries}
    if len(mesh.bodies) == 1:
        seen = [corners[name] for name in (*3 * posed.contact_boundaries, *loaded)]
        view_of(ax, np.concatenate([np.empty((0, 3, 3)), *seen]))
    elif not isinstance(posed.domain, StepFile):
        return
    for name in (one for one in mesh.boundaries if len(corners[one])):
        if mesh.surface(name).normals.mean(axis=0) @ viewer(ax.elev, ax.azim) > 0.1:
            ax.text(
                *corners[name].mean(axis=(0, 1)),
                style.plain(name),
                ha="center",
                va="center",
                fontsize=8,
                zorder=9,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.6, "pad": 1.0},
            )


def _strokes(tails: np.ndarray, arrows: np.ndarray) -> list[np.ndarray]:
    """Shafts and the four strokes of each head as segments (n, 2, 3)."""
    tips = tails + arrows
    first = np.zeros_like(arrows)
    first[np.arange(len(arrows)), np.argmin(np.abs(arrows), axis=1)] = 1.0
    second = np.cross(arrows, first)
    size = np.linalg.norm(arrows, axis=1)[:, None]
    across = size * second / np.maximum(np.linalg.norm(second, axis=1)[:, None], 1e-300)
    other = np.cross(arrows, across) / np.maximum(size, 1e-300)
    return [
        np.stack([tails, tips], 1),
        *(
            np.stack([tips - 0.3 * arrows + 0.12 * side, tips], 1)
            for side in (across, -across, other, -other)
        ),
    ]


def _arrows(places: list[_Drawn], reach: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Tails and vectors (n, dim) for points, normals and tractions of each load, the longest
    ``reach``."""
    largest = max(
        (float(np.linalg.norm(traction, axis=1).max()) for *_, traction in places), default=0.0
    )
    arrows = [
        (x, normals, traction * (reach / largest if largest else 0.0))
        for _, x, normals, traction in places
    ]
    return [
        (np.where(np.einsum("nd,nd->n", arrow, normals)[:, None] <= 0, x - arrow, x), arrow)
        for x, normals, arrow in arrows
    ]


def _uses(posed: ContactProblem) -> list[tuple[str, str, str]]:
    """Boundary, colour and text of supports and contacts; later ones are painted over earlier
    ones."""
    uses = [
        (
            support.place,
            _SUPPORT,
            support_text(support, posed.dim, "rz" if posed.axisymmetric else "xyz"),
        )
        for support in posed.supports
    ]
    for tie in posed.ties:
        uses += [(tie.slave, _CONTACT, "tie"), (tie.master, _MASTER, "  its master")]
    for contact in posed.contact:
        uses.append(
            (
                contact.boundary,
                _CONTACT,
                "contact" if contact.law is None else _law_text(contact.law),
            )
        )
        if isinstance(contact, ContactPair):
            uses.append((contact.master, _MASTER, "  its master"))
    return uses


def _legend(
    posed: ContactProblem,
    ax: Axes,
    mesh: MeshArrays,
    fills: Sequence[str],
    axes: str,
    places: list[_Drawn],
    enlarged: dict[str, int],
) -> None:
    """List bodies, uses of boundaries and loads under the name of the law; of a single body the
    free boundaries too."""
    entries: list[tuple[Artist, str]] = []
    if len(mesh.bodies) > 1:
        entries += [
            (Patch(facecolor=fill, edgecolor=style.INK), style.plain(body))
            for body, fill in zip(mesh.bodies, fills, strict=True)
        ]
    for boundary, color, text in _uses(posed):
        times = enlarged.get(boundary, 1)
        text = f"{text} on" if color != _MASTER else text
        entries.append(
            (
                Patch(facecolor=color, edgecolor=style.INK),
                f"{text} {style.quoted(boundary)}"
                + (f"\n(gap drawn {times} times)" if times > 1 else ""),
            )
        )
    acting = [(load, traction) for load, _, _, traction in places if traction.any()]
    entries += [
        (
            Line2D([], [], color=style.BLUE),
            f"{_surface_text(load, traction)} on {style.quoted(load.boundary)}",
        )
        for load, traction in acting
    ]
    entries += [
        (Line2D([], [], color=style.BLUE, linestyle=":"), _volume_text(load, axes))
        for load in posed.loads
        if isinstance(load, loads.BodyForce | loads.InitialStrain | loads.Preload)
    ]
    entries += [
        (Line2D([], [], color=style.BLUE), f"{_force_text(load, posed)} at {load.place}")
        for load in posed.loads
        if isinstance(load, loads.PointForce)
    ]
    used = {name for name, *_ in _uses(posed)} | {load.boundary for load, _ in acting}
    if len(mesh.bodies) == 1 and (
        free := [style.quoted(name) for name in mesh.boundaries if name not in used]
    ):
        entries.append((Patch(facecolor=fills[0], edgecolor=style.INK), f"free: {', '.join(free)}"))
    handles, labels = zip(*entries, strict=True)
    ax.legend(
        handles,
        labels,
        loc="upper left",
        bbox_to_anchor=(1.02, 1.0),
        fontsize=8,
        alignment="left",
        title=_law_text(posed.law) if posed.contact else None,
        borderaxespad=0.0,
    )


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
    """Return the prescribed components as text, equal ones together: '$u_x$ = $u_y$ = 0'; or what
    else holds."""
    if isinstance(support, loads.Symmetry):
        return "symmetry: $u_n$ = 0"
    if isinstance(support, loads.Spring | loads.PointSpring):
        names, unit = (
            (("normal", "tangential"), "N/m³")
            if isinstance(support, loads.Spring)
            else ("xyz"[:dim], "N/m")
        )
        return "springs " + ", ".join(
            f"{name} {_value(getattr(support, name), unit)}"
            for name in names
            if callable(getattr(support, name)) or getattr(support, name)
        )
    values: dict[str, list[str]] = {}
    along = (
        *zip(axes, support.components(dim), strict=False),
        ("n", getattr(support, "normal", None)),
    )
    for axis, value in along:
        if value is not None:
            values.setdefault("0" if value == 0 else _value(value, "m"), []).append(f"$u_{axis}$")
    return ", ".join(f"{' = '.join(names)} = {value}" for value, names in values.items())


def _surface_text(load: SurfaceLoad, traction: np.ndarray) -> str:
    """The size of a load with tractions (n, dim), Pa: 'p = 2 MPa', '|t| up to 3 kPa'."""
    sizes = np.linalg.norm(traction, axis=1)
    largest = float(sizes.max())
    pressure = isinstance(load, loads.Pressure)
    relation = "up to" if np.ptp(sizes) > 1e-9 * largest else "="
    value = load.value if pressure and not callable(load.value) else largest
    return f"{'p' if pressure else '|t|'} {relation} {_value(value, 'Pa')}"


def _volume_text(load: loads.BodyForce | loads.InitialStrain | loads.Preload, axes: str) -> str:
    """The load in a body: 'body force (0, 3) kN/m³ in 'rod''."""
    where = "" if load.body is None else f" in {style.quoted(load.body)}"
    if isinstance(load, loads.Preload):
        return f"preload {_value(load.force, 'N')}{where}"
    if isinstance(load, loads.InitialStrain):
        parts = [
            f"$\\varepsilon_{axis}$ = {_value(value)}"
            for axis, value in zip(axes, load.components, strict=False)
            if callable(value) or value != 0
        ]
        return f"initial strain{where}\n{', '.join(parts) or '0'}"
    if any(map(callable, load.components)):
        return f"body force f(x){where}"
    return f"body force {_vector_text(load.components, 'N/m³')}{where}"


def _force_text(load: loads.PointForce, posed: ContactProblem) -> str:
    return "force " + _vector_text(
        load.components, "N/m" if posed.dim == 2 and not posed.axisymmetric else "N"
    )


def _vector_text(components: Sequence[float], unit: str) -> str:
    factor, unit = style.scaled(max(map(abs, components)), unit)
    return f"({', '.join(style.number(factor * c) for c in components)}) {unit}"
