"""problem: a picture of a contact problem - boundaries coloured by their use, loads as arrows, and
a legend.

The bodies are drawn on a mesh without the lines between its elements. The arrows of tractions are
proportional to them: those that push end on the boundary, those that pull start there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg.discrete.loads import load_density
from adaptmg.level import meshed_domain
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.plot import style
from adaptmg.plot.bodies import boundary_marks, draw_bodies
from adaptmg.plot.surfaces import Lines, solid_axes, view_of, viewer
from adaptmg.problem import Contact, ContactPair, ContactProblem, StepFile, laws, loads

_CONTACT, _MASTER, _SUPPORT = "#e8833a", "#f2c530", "#4fb38a"

SurfaceLoad = loads.Pressure | loads.Traction
#: points (n, dim), outward normals and tractions there; or one point and its force
_Vectors = tuple[np.ndarray, np.ndarray, np.ndarray]
#: tails and vectors (n, dim)
_Arrows = tuple[np.ndarray, np.ndarray]


class _SurfaceLoading(NamedTuple):
    """A load at points of its boundary."""

    load: SurfaceLoad
    points: np.ndarray  # (n, dim), m
    normals: np.ndarray  # (n, dim), outward
    tractions: np.ndarray  # (n, dim), Pa


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
    # inches: 4.4 along the longer side, 3.9 next to it for the legend, 1.4 for title and labels
    size = (8.4, 5.6) if posed.dim == 3 else (4.4 * width + 3.9, 4.4 * height + 1.4)
    ax = style.canvas(ax, size, posed.dim)
    _draw(posed, mesh, ax)
    style.entitle(ax, style.titled(posed.name))
    return style.figure_of(ax)


def _coarse_mesh(posed: ContactProblem) -> MeshArrays:
    """Return a mesh that shows the shape: its edges are a fraction of the extent of each body."""
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
    """Draw a problem on a mesh, with arrows for loads and a legend."""
    extent = float(np.max(np.ptp(mesh.points, axis=0)))
    loadings = _surface_loadings(posed, mesh, extent)
    arrows = _arrows([(at.points, at.normals, at.tractions) for at in loadings], reach=extent / 6)
    arrows += _arrows(_point_forces(posed, mesh), reach=extent / 6)
    if posed.dim == 3:
        enlarged: dict[str, int] = {}
        _draw_solid(posed, mesh, ax, arrows, loadings)
    else:
        enlarged = _draw_plane(posed, mesh, ax, arrows, extent)
    _draw_point_supports(posed, mesh, ax)
    _legend(posed, ax, mesh, loadings, enlarged)


def _axis_names(posed: ContactProblem) -> str:
    return "rzθ" if posed.axisymmetric else "xyz"


def _unit_scale(mesh: MeshArrays) -> float:
    """Return the factor from m to the unit of the axes."""
    return style.scaled(style.bounds(mesh.points)[2], "m")[0]


def _surface_loadings(
    posed: ContactProblem, mesh: MeshArrays, extent: float
) -> list[_SurfaceLoading]:
    """Return the surface loads at points spread over their boundaries."""
    loadings = []
    for load in posed.loads:
        if isinstance(load, SurfaceLoad):
            # 24 arrows on a face, 12 on an edge as long as the bodies, at least 3
            share = mesh.surface(load.boundary).measures.sum() / extent
            count = 24 if posed.dim == 3 else max(3, round(12 * share))
            x, normals = _spread(mesh, load.boundary, count)
            tractions = load_density(load, x[:, None], normals)[:, 0]
            loadings.append(_SurfaceLoading(load, x, normals, tractions))
    return loadings


def _point_forces(posed: ContactProblem, mesh: MeshArrays) -> list[_Vectors]:
    """Return the point of each force, the direction there from the middle of the mesh, and the
    force."""
    middle = mesh.points.mean(axis=0)
    return [
        (np.array([load.point]), np.array([load.point]) - middle, np.array([load.components]))
        for load in posed.loads
        if isinstance(load, loads.PointForce)
    ]


def _draw_solid(
    posed: ContactProblem,
    mesh: MeshArrays,
    ax: Axes,
    arrows: list[_Arrows],
    loadings: list[_SurfaceLoading],
) -> None:
    """Draw bodies with marked boundaries and the arrows of loads, and name the faces seen."""
    scale = _unit_scale(mesh)
    strokes = [
        stroke for tails, vectors in arrows for stroke in _strokes(scale * tails, scale * vectors)
    ]
    draw_bodies(
        ax,
        mesh,
        style.body_fills(len(mesh.bodies)),
        boundary_marks(mesh, {name: color for name, color, _ in _uses(posed)}),
        lines=False,
        axes=_axis_names(posed),
        strokes=[Lines(np.concatenate(strokes), style.BLUE, 1.6, "#8fbfe0")] if strokes else (),
    )
    _name_faces(posed, mesh, solid_axes(ax), [loading.load.boundary for loading in loadings])


def _draw_plane(
    posed: ContactProblem, mesh: MeshArrays, ax: Axes, arrows: list[_Arrows], extent: float
) -> dict[str, int]:
    """Draw plane bodies, boundaries, obstacles, loads and names; return by boundary how many times
    its gap is enlarged."""
    scale = _unit_scale(mesh)
    fills = style.body_fills(len(mesh.bodies))
    draw_bodies(ax, mesh, fills, lines=False, axes=_axis_names(posed))
    for boundary, color, _ in _uses(posed):
        if boundary in mesh.boundaries:
            ax.add_collection(
                LineCollection(
                    list(scale * mesh.points[mesh.boundary_facets(boundary)]),
                    color=color,
                    zorder=4,
                    # masters, drawn after their slaves, leave these visible where both touch
                    linewidth=2.0 if color == _MASTER else 4.0,
                    capstyle="round",
                )
            )
    enlarged = {
        contact.boundary: _draw_obstacle(ax, contact, mesh, extent)
        for contact in posed.contact
        if isinstance(contact, Contact)
    }
    for tails, vectors in arrows:
        _draw_arrows(ax, scale * tails, scale * vectors)
    if len(mesh.bodies) == 1:
        _name_edges(mesh, ax)
    ax.set_anchor("W")
    ax.margins(0.06)
    ax.autoscale_view()
    return enlarged


def _draw_point_supports(posed: ContactProblem, mesh: MeshArrays, ax: Axes) -> None:
    """Draw a triangle at each point that a support or a spring holds."""
    scale = _unit_scale(mesh)
    for support in posed.supports:
        if isinstance(support, loads.PointSupport | loads.PointSpring):
            ax.plot(
                *scale * np.array(support.point),
                "^",
                color=_SUPPORT,
                markeredgecolor=style.INK,
                markersize=9,
                zorder=9,
            )


def _draw_arrows(ax: Axes, tails: np.ndarray, vectors: np.ndarray) -> None:
    """Draw plane arrows from ``tails`` along ``vectors`` (both (n, 2)), in the unit of the axes, and
    widen the limits of the axes to contain them."""
    ax.quiver(
        tails[:, 0],
        tails[:, 1],
        vectors[:, 0],
        vectors[:, 1],
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


def _name_edges(mesh: MeshArrays, ax: Axes) -> None:
    """Write the name of each boundary inside the body, next to the middle of the boundary."""
    scale = _unit_scale(mesh)
    for boundary in mesh.boundaries:
        points, normals = _spread(mesh, boundary, 1)
        normal = normals[0]
        # 9 points inside, aligned by components of the normal of -1, 0 or 1
        ax.annotate(
            style.plain(boundary),
            scale * points[0],
            -9 * normal,
            textcoords="offset points",
            color=style.INK,
            fontsize="small",
            ha=("left", "center", "right")[round(normal[0]) + 1],
            va=("bottom", "center", "top")[round(normal[1]) + 1],
            zorder=6,
        )


def _spread(mesh: MeshArrays, boundary: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points (count, dim), m, at equal parts of a boundary, in 3D in the middle of facets;
    and outward unit normals."""
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


def _draw_obstacle(ax: Axes, contact: Contact, mesh: MeshArrays, extent: float) -> int:
    """Hatch the obstacle in front of a boundary of a plane body, of which the largest ``extent`` is given,
    m; return how many times the gap is enlarged."""
    scale = _unit_scale(mesh)
    surface = mesh.surface(contact.boundary)
    points = mesh.points[surface.facets].reshape(-1, 2)
    normals = np.repeat(surface.normals, 2, axis=0)
    inward, gaps = contact.obstacle.contact(points, normals)
    largest = float(np.abs(gaps).max())
    # a gap of less than a quarter of the hatched strip, but more than rounding, is drawn about as wide as the
    # strip, enlarged by a number of one digit and zeros, which the legend names
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
            list(scale * np.concatenate([front, behind[:, ::-1]], axis=1)),
            facecolor="none",
            edgecolor=style.GREY,
            hatch="////",
            linewidth=0,
            zorder=1,
        )
    )
    ax.add_collection(
        LineCollection(list(scale * front), color=style.INK, linewidth=1.2, zorder=3.5)
    )
    return times


def _name_faces(problem: ContactProblem, mesh: MeshArrays, ax: Axes3D, loaded: list[str]) -> None:
    """Turn a single body so that contact, which counts three times, and loads show most, and name the
    faces that are seen; of several bodies only those of a STEP file, whose names are looked up here."""
    scale = _unit_scale(mesh)
    corners = {name: scale * mesh.points[mesh.boundary_facets(name)] for name in mesh.boundaries}
    if len(mesh.bodies) == 1:
        # three times: contact is what the picture is about
        seen = [corners[name] for name in (*3 * problem.contact_boundaries, *loaded)]
        view_of(ax, np.concatenate([np.empty((0, 3, 3)), *seen]))
    elif not isinstance(problem.domain, StepFile):
        return
    # a face that is seen at less than 6 degrees is too narrow for a name
    for name in (boundary for boundary in mesh.boundaries if len(corners[boundary])):
        if mesh.surface(name).normals.mean(axis=0) @ viewer(ax.elev, ax.azim) > 0.1:
            ax.text(
                *corners[name].mean(axis=(0, 1)),
                s=style.plain(name),
                ha="center",
                va="center",
                fontsize="small",
                zorder=9,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.6, "pad": 1.0},
            )


def _strokes(tails: np.ndarray, arrows: np.ndarray) -> list[np.ndarray]:
    """Return the shafts of ``arrows`` (n, 3) from ``tails`` (n, 3), and the four strokes of each head, as
    segments (n, 2, 3)."""
    tips = tails + arrows
    # two directions across each arrow, as long as it: from the axis that it has least of
    first = np.zeros_like(arrows)
    first[np.arange(len(arrows)), np.argmin(np.abs(arrows), axis=1)] = 1.0
    second = np.cross(arrows, first)
    size = np.linalg.norm(arrows, axis=1)[:, None]
    across = size * second / np.maximum(np.linalg.norm(second, axis=1)[:, None], 1e-300)
    other = np.cross(arrows, across) / np.maximum(size, 1e-300)
    # heads are .3 of the arrow long, and .12 of it wide to each side
    return [
        np.stack([tails, tips], 1),
        *(
            np.stack([tips - 0.3 * arrows + 0.12 * side, tips], 1)
            for side in (across, -across, other, -other)
        ),
    ]


def _arrows(loadings: list[_Vectors], reach: float) -> list[_Arrows]:
    """Return the arrows of tractions at points with outward normals, the longest ``reach``: those
    that push end at their point, those that pull start there."""
    largest = max(
        (float(np.linalg.norm(traction, axis=1).max()) for *_, traction in loadings), default=0.0
    )
    arrows = []
    for points, normals, traction in loadings:
        vectors = traction * (reach / largest if largest else 0.0)
        pushes = np.einsum("nd,nd->n", vectors, normals)[:, None] <= 0
        arrows.append((np.where(pushes, points - vectors, points), vectors))
    return arrows


def _uses(posed: ContactProblem) -> list[tuple[str, str, str]]:
    """Return boundary, colour and text of supports, ties and contacts; later ones are painted over
    earlier ones."""
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
    loadings: list[_SurfaceLoading],
    enlarged: dict[str, int],
) -> None:
    """List bodies, uses of boundaries and loads under the name of the law; of a single body the
    free boundaries too."""
    fills = style.body_fills(len(mesh.bodies))
    entries: list[Artist] = []
    if len(mesh.bodies) > 1:
        entries += [
            Patch(facecolor=fill, edgecolor=style.INK, label=style.plain(body))
            for body, fill in zip(mesh.bodies, fills, strict=True)
        ]
    for boundary, color, text in _uses(posed):
        times = enlarged.get(boundary, 1)
        text += f"{' on' if color != _MASTER else ''} {style.quoted(boundary)}"
        text += f"\n(gap drawn {times} times)" if times > 1 else ""
        entries.append(Patch(facecolor=color, edgecolor=style.INK, label=text))
    acting = [loading for loading in loadings if loading.tractions.any()]
    entries += [
        Line2D(
            [],
            [],
            color=style.BLUE,
            label=f"{_surface_text(load, tractions)} on {style.quoted(load.boundary)}",
        )
        for load, _, _, tractions in acting
    ]
    entries += [
        Line2D(
            [],
            [],
            color=style.BLUE,
            linestyle=":",
            label=_volume_text(load, _axis_names(posed)),
        )
        for load in posed.loads
        if isinstance(load, loads.BodyForce | loads.InitialStrain | loads.Preload)
    ]
    entries += [
        Line2D([], [], color=style.BLUE, label=f"{_force_text(load, posed)} at {load.place}")
        for load in posed.loads
        if isinstance(load, loads.PointForce)
    ]
    used = {name for name, *_ in _uses(posed)} | {loading.load.boundary for loading in acting}
    if len(mesh.bodies) == 1 and (
        free := [style.quoted(name) for name in mesh.boundaries if name not in used]
    ):
        text = f"free: {', '.join(free)}"
        entries.append(Patch(facecolor=fills[0], edgecolor=style.INK, label=text))
    style.legend_next_to(
        ax,
        entries,
        fontsize="small",
        alignment="left",
        title=_law_text(posed.law) if posed.contact else None,
    )


def _law_text(law: laws.Law) -> str:
    """Return a law as text for a legend."""
    if isinstance(law, laws.Frictionless):
        return "frictionless contact"
    if isinstance(law, laws.Coulomb):
        return f"Coulomb friction {_value(law.friction)}"
    if isinstance(law, laws.Tresca):
        return f"Tresca limit {_value(law.limit, 'Pa')}"
    return f"contact ({type(law).__name__})"


def _value(value: checks.FieldLike | ArrayLike, unit: str = "") -> str:
    """Return a parameter as text: f(x), or a number with its prefixed unit."""
    if callable(value):
        return "f(x)"
    number = float(np.asarray(value))
    factor, unit = style.scaled(abs(number), unit) if unit else (1.0, "")
    return f"{style.number(number * factor)} {unit}".strip()


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
    """Return the size of a load with tractions (n, dim), Pa: 'p = 2 MPa', '|t| up to 3 kPa'."""
    sizes = np.linalg.norm(traction, axis=1)
    largest = float(sizes.max())
    pressure = isinstance(load, loads.Pressure)
    relation = "up to" if np.ptp(sizes) > 1e-9 * largest else "="
    value = load.value if pressure and not callable(load.value) else largest
    return f"{'p' if pressure else '|t|'} {relation} {_value(value, 'Pa')}"


def _volume_text(load: loads.BodyForce | loads.InitialStrain | loads.Preload, axes: str) -> str:
    """Return the load in a body as text: 'body force (0, 3) kN/m³ in 'rod''."""
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
    numbers = [value for value in load.components if not callable(value)]
    if len(numbers) < len(load.components):
        return f"body force f(x){where}"
    return f"body force {_vector_text(numbers, 'N/m³')}{where}"


def _force_text(load: loads.PointForce, posed: ContactProblem) -> str:
    """Return a point force as text; of plane models per thickness."""
    return "force " + _vector_text(
        load.components, "N/m" if posed.dim == 2 and not posed.axisymmetric else "N"
    )


def _vector_text(components: Sequence[float], unit: str) -> str:
    factor, unit = style.scaled(max(map(abs, components)), unit)
    return f"({', '.join(style.number(factor * c) for c in components)}) {unit}"
