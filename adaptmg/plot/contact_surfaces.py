r"""contact: pressure, friction, gap and slip along contact lines; maps of them and of the states on surfaces.

Lines are drawn against x or y where they are straight, else against the arc length. A surface is seen along its mean
normal, or unrolled where that is short and the normals lie in one plane: their common perpendicular is the axis, and
the circle :math:`x = c + r n` fitted to the points across it in least squares gives its centre; the coordinates are
angle and length along the axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation

from adaptmg import _checks as checks
from adaptmg.plot import style
from adaptmg.smoother.system import OPEN, SLIP, STICK
from adaptmg.solver.contact_result import ContactResult
from adaptmg.solver.result import Result

#: length of the mean of the unit normals below which a surface is taken to bend around an axis
_AROUND = 0.5

@style.styled
def contact(result: Result, axes: Sequence[Axes] | None = None, *, boundary: object = None) -> Figure:
    r"""Draw pressure, friction, gap and slip on contact boundaries, between two bodies on the slave surface of a pair.

    In 2D: contact pressure p, MPa; tangential traction t on the body, MPa, within the band :math:`\pm \mu p` (Tresca:
    plus or minus the limit) that friction allows; gap and slip, micrometres (mm from 0.1 mm on). Curves and backgrounds
    have the colours of the states. In 3D: maps of pressure, size of the traction and gap, and the states.

    Parameters
    ----------
    result : Result
    axes : sequence of matplotlib Axes, optional
        Axes for one contact boundary: three in 2D, four in 3D.
    boundary : str, Contact or ContactPair, optional
        The contact boundary, of a pair the slave; default all of them.

    Notes
    -----
    Pressures and tractions are nodal forces over the nodes' weights (the lumped mass of the surface, with dual
    multipliers that of its covered part); the gap is that of the constraint, g0 minus the (relative) normal
    displacement.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> len(am.plot.contact(result).axes)                               # pressure, friction, gap and slip
    3
    """
    solid = checks.instance("result", result, Result).dim == 3
    names = chosen_boundaries(result, boundary)
    if axes is not None:
        if len(names) != 1:
            raise ValueError(f"axes takes one contact boundary, the result has {len(names)}: choose with boundary=...")
        panels = [style.axes_of(axes, 4 if solid else 3)]
    else:
        (width, height), columns = ((9.0, 7.0), 1) if solid else ((6.2, 6.8), min(len(names), 3))
        rows = -(-len(names) // columns)
        parts = style.new_figure((width * columns, height * rows)).subfigures(rows, columns, squeeze=False).ravel()
        panels = [style.cells(part, 4, 2) if solid else part.subplots(3, sharex=True) for part in parts[:len(names)]]
    for name, drawn in zip(names, panels, strict=True):
        (_draw_surface if solid else _draw_lines)(result, name, drawn)
        title = pair_name(result.contact, name)
        if len(names) == 1:
            title = f"{style.plain(result.problem_name)}: {title}"
        drawn[0].set_title(title, pad=8 if solid else 22)
        drawn[0].figure.align_ylabels()
    figure = panels[0][0].get_figure(root=True)
    if len(names) > 1:
        figure.suptitle(style.plain(result.problem_name), fontsize=11)
    return figure


def _length_unit(*lengths: np.ndarray) -> tuple[float, str]:
    """Micrometres for small lengths, millimetres for large ones."""
    return (1e3, "mm") if max(np.abs(values).max() for values in lengths) >= 1e-4 else (1e6, "µm")


def _draw_lines(result: Result, name: str, axes: Sequence[Axes]) -> None:
    c, lines = result.contact, lines_of(result, name)
    nodes = np.concatenate([line.index for line in lines])
    scale, unit = _length_unit(c.gap[nodes], c.slip[nodes])
    bound, largest = 1e-6 * c.limit / c.weights, 1e-6 * float(c.pressure.max())
    friction = bound[nodes].any()
    for line in lines:
        at, s, first = line.index, line.position, line is lines[0]
        for ax, values in zip(axes, (1e-6 * c.pressure, 1e-6 * c.traction[:, 0], scale * c.gap), strict=True):
            style.shade(ax, s, c.state[at])
            style.stated_curve(ax, s, values[at], c.state[at])
        if friction:
            axes[1].fill_between(s, -bound[at], bound[at], facecolor="#c9ced5", edgecolor="#9aa0a8", linewidth=0.8,
                                 alpha=0.55, zorder=1, label="friction bound" if first else None)
        axes[2].plot(s, scale * c.slip[at, 0], color=style.GREEN, linestyle="--", label="slip" if first else None)
    for ax, label in zip(axes, ("pressure p\n[MPa]", "friction t\n[MPa]", f"gap, slip\n[{unit}]"), strict=True):
        ax.axhline(0.0, color="#5b626b", linewidth=0.8, zorder=1)
        ax.margins(x=0.0)
        ax.set_ylabel(label)
    axes[0].set_ylim(bottom=0.0)
    keep_open(axes[0], 1e-6 * c.pressure[nodes], largest)
    keep_open(axes[1], np.concatenate([-bound[nodes], 1e-6 * c.traction[nodes, 0]]), largest)
    if not friction:
        axes[1].set_ylim(-1.0, 1.0)
        axes[1].text(0.5, 0.9, "frictionless", transform=axes[1].transAxes, ha="center", va="top", color="#5b626b")
    for ax in axes[1:] if friction else axes[2:]:
        ax.legend(loc="best", frameon=True, framealpha=0.85, edgecolor="none")
    low, high = axes[2].get_ylim()
    # closed and stuck everywhere: the axes do not magnify rounding
    axes[2].set_ylim(min(low, -0.05), max(high, 0.5))
    axes[2].set_xlabel(lines[0].label)
    axes[0].legend(handles=style.state_lines(c.state[nodes]), loc="lower center", bbox_to_anchor=(0.5, 0.98), ncols=3)


def _draw_surface(result: Result, name: str, axes: Sequence[Axes]) -> None:
    c, flat = result.contact, flattened(result, name)
    at, largest = flat.index, 1e-6 * float(c.pressure.max())
    scale, unit = _length_unit(c.gap[at])
    # closed everywhere: a gap of a nanometre is rounding
    for ax, values, label, reference in (
            (axes[0], 1e-6 * c.pressure[at], "contact pressure p [MPa]", largest),
            (axes[1], 1e-6 * np.linalg.norm(c.traction[at], axis=1), "friction traction |t| [MPa]", largest),
            (axes[2], scale * c.gap[at], f"gap [{unit}]", 1e6 if unit == "µm" else 0.0)):
        low, high = min(float(values.min()), 0.0), float(values.max())
        if high - low > 1e-9 * reference:
            shown = draw_map(ax, flat, values, Normalize(low, high))
            ax.figure.colorbar(shown, ax=ax, shrink=0.8, label=label).outline.set_visible(False)
        else:
            draw_map(ax, flat, 0 * values, Normalize(0.0, 1.0))
            ax.set_title(f"{label.rpartition(' [')[0]} = 0", fontsize=9.5)
    _draw_states(axes[3], flat, c.state[at])


@dataclass(frozen=True)
class Flat:
    """A contact surface in the plane."""

    index: np.ndarray  # (n,) int: into the contact arrays
    points: np.ndarray  # (n, 2): in the units of the labels
    triangles: np.ndarray | None  # (m, 3) int: numbers within index; None without a mesh
    labels: tuple[str, str]  # of the axes
    equal: bool = True  # whether both axes have the same scale (not for an angle and a length)


def flattened(result: Result, boundary: str) -> Flat:
    """Return the contact nodes of a boundary in the plane."""
    c = result.contact
    index = np.flatnonzero(c.boundary == c.names.index(boundary))
    x, normals = c.x[index], c.normal[index]
    if not np.isfinite(x).all():
        raise ValueError("this result has no coordinates: give the DiscreteProblem its coordinates")
    triangles = _triangles(result, boundary, index)
    if np.linalg.norm(normals.mean(axis=0)) < _AROUND and len(index) >= 6:
        _, strength, axes = np.linalg.svd(normals, full_matrices=False)
        if strength[2] < 0.05 * strength[0]:
            points, labels = _unrolled(x, normals, axes[2])
            if triangles is not None:
                # triangles across the seam would cover the rest
                triangles = triangles[np.ptp(points[triangles, 0], axis=1) < 180.0]
            return Flat(index, points, triangles, labels, equal=False)
    points, labels = _seen_along(x, normals.mean(axis=0))
    return Flat(index, points, triangles, labels)


def _unrolled(x: np.ndarray, normals: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, tuple[str, str]]:
    """Angle in degrees and length along an axis, and their labels."""
    along = int(np.argmax(np.abs(axis)))
    axis = axis * np.sign(axis[along])
    frame = _across(axis, (along + 1) % 3)
    across, direction = x @ frame, normals @ frame
    # x = c + r n: unknown centre (2) and radius, which is negative where the body lies outside, as around a hole
    matrix = np.zeros((2 * len(x), 3))
    matrix[0::2, 0] = matrix[1::2, 1] = 1.0
    matrix[:, 2] = direction.ravel()
    centre = np.linalg.lstsq(matrix, across.ravel(), rcond=None)[0][:2]
    angle = np.degrees(np.arctan2(*(across - centre).T[::-1]))
    scale, unit = style.scaled(float(np.ptp(x @ axis)), "m")
    name = "xyz"[along] if axis[along] > 1 - 1e-6 else ""
    return np.stack([angle, scale * (x @ axis)], axis=1), (
        f"angle around {name or 'the axis'} [°]", f"{name or 'along the axis'} [{unit}]")


def _across(normal: np.ndarray, k: int) -> np.ndarray:
    """Two orthonormal directions (3, 2) across a unit normal, the first as near as possible to Cartesian axis ``k``."""
    first = np.eye(3)[k] - normal[k] * normal
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)], axis=1)


def _seen_along(x: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, tuple[str, str]]:
    """Coordinates (n, 2) across the mean normal, and their labels; Cartesian ones for a normal along an axis."""
    if np.linalg.norm(mean) < 1e-3:
        mean = np.array([0.0, 0.0, 1.0])
    across = int(np.argmax(np.abs(mean)))
    rest = [k for k in range(3) if k != across]
    scale, unit = style.scaled(float(np.ptp(x, axis=0).max()), "m")
    if np.abs(mean[rest]).max() <= 1e-6 * abs(mean[across]):
        return scale * x[:, rest], (f"{'xyz'[rest[0]]} [{unit}]", f"{'xyz'[rest[1]]} [{unit}]")
    frame = _across(mean / np.linalg.norm(mean), rest[0])
    return scale * (x - x.mean(axis=0)) @ frame, (f"along t1 [{unit}]", f"along t2 [{unit}]")


def _triangles(result: Result, boundary: str, index: np.ndarray) -> np.ndarray | None:
    """Facets of the boundary whose corners are all contact nodes, numbered within ``index``; None without any."""
    if result.mesh_or_none is None:
        return None
    place = np.full(result.mesh.n_nodes, -1)
    place[result.contact.node[index]] = np.arange(len(index))
    triangles = place[result.mesh.boundary_facets(boundary)]
    triangles = triangles[(triangles >= 0).all(axis=1)]
    return triangles if len(triangles) else None


@dataclass(frozen=True)
class Line:
    """One connected part of a contact boundary."""

    index: np.ndarray  # (n,) int: into the contact arrays, in order along the line
    position: np.ndarray  # (n,): along the line, increasing, in the unit of the label
    label: str  # for the axis


def lines_of(result: Result, boundary: str) -> list[Line]:
    """Return the connected parts of a contact boundary; parts without contact nodes separate them."""
    index = np.flatnonzero(result.contact.boundary == result.contact.names.index(boundary))
    x = result.contact.x[index]
    if not np.isfinite(x).all():
        return [Line(index, np.arange(len(index), dtype=float), "contact node")]
    extent = np.ptp(x, axis=0)
    factor, unit = style.scaled(float(extent.max()), "m")
    parts, label = _parts(result, boundary, index)
    for axis, name in enumerate(style.axis_names(result)):
        if extent[1 - axis] <= 1e-9 * extent[axis]:
            straight = [nodes[np.argsort(result.contact.x[nodes, axis])] for nodes, _ in parts]
            return [Line(nodes, factor * result.contact.x[nodes, axis], f"{name} [{unit}]") for nodes in straight]
    start = "" if label is None else f" from ({factor * label[0]:.4g}, {factor * label[1]:.4g})"
    return [Line(nodes, factor * position, f"arc length{start} [{unit}]") for nodes, position in parts]


def _parts(result: Result, boundary: str, index: np.ndarray
           ) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray | None]:
    """Contact nodes of each part with arc lengths along the whole boundary, and the point where these begin."""
    if result.mesh_or_none is None:
        x = result.contact.x[index]
        order = np.argsort((x - x.mean(axis=0)) @ np.linalg.svd(x - x.mean(axis=0), full_matrices=False)[2][0])
        return [(index[order], _arc_length(x[order]))], None
    points, place = result.mesh.points, np.full(result.mesh.n_nodes, -1)
    place[result.contact.node[index]] = index
    parts, begin = [], 0.0
    lines = style.polylines(result.mesh.boundary_facets(boundary))
    for line in lines:
        position = begin + _arc_length(points[line])
        begin = position[-1]
        covered = np.flatnonzero(place[line] >= 0)
        for run in np.split(covered, np.flatnonzero(np.diff(covered) > 1) + 1):
            if len(run):
                parts.append((place[line[run]], position[run]))
    return parts, points[lines[0][0]]


def _arc_length(points: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def draw_map(ax: Axes, flat: Flat, values: np.ndarray, norm: Normalize) -> ScalarMappable:
    """Draw nodal values in colours."""
    _finish(ax, flat)
    if flat.triangles is None:
        return ax.scatter(*flat.points.T, c=values, s=18, cmap="viridis", norm=norm)
    return ax.tripcolor(Triangulation(*flat.points.T, flat.triangles), values, cmap="viridis", shading="gouraud",
                        norm=norm, rasterized=True)


def _draw_states(ax: Axes, flat: Flat, states: np.ndarray) -> None:
    """Draw the nodes in the colours of their states over the triangles; the legend counts them."""
    if flat.triangles is not None:
        ax.triplot(Triangulation(*flat.points.T, flat.triangles), color="#c9ced5", linewidth=0.4, zorder=1)
    ax.scatter(*flat.points.T, c=[style.STATE_INKS[int(s)] for s in states], zorder=2, edgecolors=style.INK,
               linewidths=0.2, s=float(np.clip(4000 / len(states), 1.5, 40.0)))
    counts = np.bincount(states.astype(int), minlength=3)
    ax.legend(handles=[Patch(color=style.STATE_INKS[s], label=f"{style.STATE_NAMES[s]} ({counts[int(s)]})")
                       for s in (OPEN, SLIP, STICK)],
              loc="lower center", bbox_to_anchor=(0.5, 0.98), ncols=3, handlelength=1.2, columnspacing=1.2)
    _finish(ax, flat)


def _finish(ax: Axes, flat: Flat) -> None:
    ax.set(aspect="equal" if flat.equal else "auto", xlabel=flat.labels[0], ylabel=flat.labels[1])


def chosen_boundaries(result: Result, boundary: object = None) -> tuple[str, ...]:
    """Return the contact boundaries to draw: one, by its name or as a Contact or ContactPair, or all with nodes."""
    contact = result.contact
    name = getattr(boundary, "boundary", boundary)
    names = contact.names if name is None else (checks.choice("boundary", name, contact.names),)
    drawn = tuple(n for n in names if (contact.boundary == contact.names.index(n)).any())
    if not drawn:
        raise ValueError(f"boundary: {', '.join(map(repr, names)) or 'this result'} has no contact nodes to draw")
    return drawn


def pair_name(contact: ContactResult, boundary: str) -> str:
    """Return 'slave on master', or the boundary alone in front of a rigid obstacle."""
    master = contact.masters[contact.names.index(boundary)]
    return f"{style.quoted(boundary)} on {style.quoted(master)}" if master else style.quoted(boundary)


def keep_open(ax: Axes, values: np.ndarray, largest: float) -> None:
    """Scale an axis of values that are rounding, against the ``largest`` value elsewhere, so that they look like 0."""
    if not np.abs(values).max() > 1e-9 * largest:
        ax.set_ylim(-1.0 if values.min() < 0 else 0.0, 1.0)
