r"""contact: pressure, friction, gap and slip along contact lines, maps of them and of the states on
surfaces; and load_history: quantities of a sequence of load steps against the load, and the contact
pressure of each step.

Lines that run nearly along x or y are drawn against it, others against the arc length. A surface is
seen along its mean normal; where that is short, as around a hole, it is unrolled: the direction
across all normals is the axis, and the coordinates are the angle of the normal and the length along
the axis."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.plot import style
from adaptmg.problem import Contact, ContactPair
from adaptmg.smoother.system import OPEN, SLIP, STICK
from adaptmg.solver.examine import ContactResult
from adaptmg.solver.result import Result

#: length of the mean of the unit normals below which a surface bends around an axis: that of a
#: hemisphere, beyond which a picture along the mean normal folds
_AROUND = 1 / 2
#: what is drawn to each side of the middle of a small patch, over its width: a quarter of the picture is the patch.
#: Half and twice change none of 16 lines of plane cases, whose patches take a fifth of them at least
_AROUND_PATCH = 2.0
#: a patch is small where that is less than this part of the line: it has less than 32 of the 640 pixels measured of
#: a line. Half and twice change none of these pictures either
_SMALL_PART = 0.2

#: length over extent in x or y up to which a line is drawn against x or y; that of a quarter of a circle is 1.57, of an
#: arc of 85 degrees seen from its middle 1.1
_BENT = 1.1

#: part of the largest stress up to which stresses of a boundary are errors of the solve: on the open floor of a
#: dovetail the friction bound is 1.6e-8 of the pressure of the flank after am.adapt, 6e-11 after am.solve. Half and
#: twice change nothing there
_SOLVE_ERROR = 1e-7


@style.styled
def contact(
    result: Result,
    axes: Sequence[Axes] | None = None,
    *,
    boundary: str | Contact | ContactPair | None = None,
) -> Figure:
    r"""Draw pressure, friction, gap and slip on contact boundaries, between two bodies on the slave
    surface of a pair.

    In 2D: contact pressure p, MPa; tangential traction t on the body, MPa, within the band
    :math:`\pm \mu p` (Tresca: plus or minus the limit) that friction allows; gap and slip. Curves
    and backgrounds have the colours of the states. In 3D: maps of pressure, size of the traction
    and gap, and the states. Of a plane boundary of which less than a twentieth touches that part
    and its surroundings are drawn.

    Parameters
    ----------
    result : Result
    axes : sequence of matplotlib Axes, optional
        Axes for one contact boundary: three in 2D, four in 3D.
    boundary : str, Contact or ContactPair, optional
        The contact boundary, of a pair the slave; default all of them.

    Notes
    -----
    Pressures and tractions are nodal forces over the nodes' weights (the lumped mass of the
    surface, with dual multipliers that of its covered part); the gap is that of the constraint, g0
    minus the (relative) normal displacement.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> len(am.plot.contact(result).axes)  # pressure, friction, gap and slip
    3
    """
    style.need_displacements(checks.instance("result", result, Result))
    solid = result.dim == 3
    names = chosen_boundaries(result, boundary)
    if axes is not None:
        if len(names) != 1:
            raise ValueError(
                f"axes takes one contact boundary, the result has {len(names)}: choose with boundary=..."
            )
        panels = [style.axes_of(axes, 4 if solid else 3)]
    else:
        columns = 1 if solid else style.columns_of(len(names), 3, 6.2)
        # inches: four maps in two columns, in narrow figures in one; three curves above each other
        maps = style.columns_of(4, 2, 4.5)
        width, height = (4.5 * maps, 7.0 if maps == 2 else 10.4) if solid else (6.2, 6.8)
        rows = -(-len(names) // columns)
        whole = style.new_figure((width * columns, height * rows), "constrained")
        parts = whole.subfigures(rows, columns, squeeze=False).ravel()
        panels = [
            style.cells(part, 4, maps) if solid else part.subplots(3, sharex=True)
            for part in parts[: len(names)]
        ]
    for name, drawn in zip(names, panels, strict=True):
        (_draw_surface if solid else _draw_lines)(result, name, drawn)
        pair = pair_name(result.contact, name)
        title = style.titled(result.problem_name, pair) if len(names) == 1 else pair
        drawn[0].set_title(title, wrap=True)
        drawn[0].figure.align_ylabels()
    figure = style.figure_of(panels[0][0])
    if len(names) > 1:
        figure.suptitle(style.titled(result.problem_name))
    return figure


def _draw_lines(result: Result, name: str, axes: Sequence[Axes]) -> None:
    """Draw pressure, friction, gap and slip along a plane contact boundary, on three axes."""
    pressure_axes, friction_axes, gap_axes = axes
    c = result.contact
    lines = lines_of(result, name, near_contact=True)
    nodes = np.concatenate([line.index for line in lines])
    # in micrometres at least: smaller ones are rounding where all nodes are closed and stuck
    scale, unit = style.scaled(
        max(1e-6, np.abs(c.gap[nodes]).max(), np.abs(c.slip[nodes]).max()), "m"
    )
    share, stress_unit = style.stresses()
    # what friction can take at each node; ``largest`` pressure of all boundaries
    bound = share * c.limit / c.weights
    largest = share * float(c.pressure.max())
    friction = bound[nodes].any()
    for line in lines:
        at = line.index
        s = line.position
        first = line is lines[0]
        for ax, values in zip(
            axes, (share * c.pressure, share * c.traction[:, 0], scale * c.gap), strict=True
        ):
            style.shade(ax, s, c.state[at])
            style.stated_curve(ax, s, values[at], c.state[at])
        if friction:
            friction_axes.fill_between(
                s,
                -bound[at],
                bound[at],
                facecolor="#c9ced5",
                edgecolor="#9aa0a8",
                linewidth=0.8,
                alpha=0.55,
                zorder=1,
                label="friction bound" if first else None,
            )
        gap_axes.plot(
            s,
            scale * c.slip[at, 0],
            color=style.cycled(2),
            linestyle="--",
            label="slip (solid: gap)" if first else None,
        )
    for ax, label in zip(
        axes,
        (f"pressure p\n[{stress_unit}]", f"friction t\n[{stress_unit}]", f"gap, slip\n[{unit}]"),
        strict=True,
    ):
        ax.axhline(0.0, color="#5b626b", linewidth=0.8, zorder=1)
        ax.margins(x=0.0)
        ax.set_ylabel(label)
    pressure_axes.set_ylim(bottom=0.0)
    keep_open(pressure_axes, share * c.pressure[nodes], largest)
    keep_open(friction_axes, np.concatenate([-bound[nodes], share * c.traction[nodes, 0]]), largest)
    if not friction:
        friction_axes.set_ylim(-1.0, 1.0)
        friction_axes.text(
            0.5,
            0.9,
            "frictionless",
            transform=friction_axes.transAxes,
            ha="center",
            va="top",
            color="#5b626b",
        )
    low, high = gap_axes.get_ylim()
    # closed and stuck everywhere: the axes do not magnify rounding
    gap_axes.set_ylim(min(low, -0.05e-6 * scale), max(high, 0.5e-6 * scale))
    gap_axes.set_xlabel(lines[0].label)
    labelled = {ax: ax.get_legend_handles_labels()[0] for ax in (friction_axes, gap_axes)}
    style.legends_inside({pressure_axes: style.state_lines(c.state[nodes])} | labelled)


def _draw_surface(result: Result, name: str, axes: Sequence[Axes]) -> None:
    """Draw maps of pressure, friction, gap and states on a contact boundary in space, on four
    axes."""
    c = result.contact
    flat = flattened(result, name)
    at = flat.index
    share, stress_unit = style.stresses()
    largest = share * float(c.pressure.max())
    scale, unit = style.scaled(max(1e-6, np.abs(c.gap[at]).max()), "m")  # in micrometres at least
    # what varies by less than 1e-9 of the reference is drawn as 0: of the gap, whose reference is a metre, less
    # than a nanometre, which is rounding where all nodes are closed
    for ax, values, label, reference in (
        (axes[0], share * c.pressure[at], f"contact pressure p [{stress_unit}]", largest),
        (
            axes[1],
            share * np.linalg.norm(c.traction[at], axis=1),
            f"friction traction |t| [{stress_unit}]",
            largest,
        ),
        (axes[2], scale * c.gap[at], f"gap [{unit}]", scale),
    ):
        low = min(float(values.min()), 0.0)
        high = float(values.max())
        if high - low > 1e-9 * reference:
            shown = draw_map(ax, flat, values, Normalize(low, high))
            bar = style.figure_of(ax).colorbar(shown, ax=ax, shrink=0.8, label=label)
            bar.outline.set_visible(False)
        else:
            draw_map(ax, flat, 0 * values, Normalize(0.0, 1.0))
            ax.set_title(f"{label.rpartition(' [')[0]} = 0")
    _draw_states(axes[3], flat, c.state[at])


@dataclass(frozen=True)
class Flat:
    """A contact surface in the plane."""

    index: np.ndarray  # (n,) int: into the contact arrays
    points: np.ndarray  # (n, 2): in the units of the labels
    triangles: np.ndarray  # (m, 3) int: numbers within index; none without a mesh
    labels: tuple[str, str]  # of the axes
    equal: bool = True  # whether both axes have the same scale (not for an angle and a length)


def flattened(result: Result, boundary: str) -> Flat:
    """Return the contact nodes of a boundary in space laid into the plane: seen along its mean
    normal, or, if it runs around an axis, unrolled."""
    c = result.contact
    index = np.flatnonzero(c.boundary == c.names.index(boundary))
    x = c.x[index]
    normals = c.normal[index]
    if not np.isfinite(x).all():
        raise ValueError("this result has no coordinates: give the DiscreteProblem its coordinates")
    triangles = np.zeros((0, 3), dtype=int)
    if result.mesh is not None:
        place = np.full(result.mesh.n_nodes, -1)
        place[c.node[index]] = np.arange(len(index))
        triangles = place[result.mesh.boundary_facets(boundary)]
        triangles = triangles[(triangles >= 0).all(axis=1)]
    scale, unit = style.scaled(float(np.ptp(x, axis=0).max()), "m")
    mean = normals.mean(axis=0)
    if np.linalg.norm(mean) < _AROUND:
        # around the direction across all normals, the right singular vector of the least singular
        # value; its largest component is positive
        _, _, directions = np.linalg.svd(normals, full_matrices=False)
        axis = directions[2]
        frame, names = _frame(axis * np.sign(axis[np.argmax(np.abs(axis))]))
        first, second = (normals @ frame[:, :2]).T
        angle = np.degrees(np.arctan2(second, first))
        # the angle jumps from 180 to -180 degrees at a seam: triangles across the seam would cover the rest
        triangles = triangles[np.ptp(angle[triangles], axis=1) < 180.0]
        return Flat(
            index,
            np.stack([angle, scale * x @ frame[:, 2]], axis=1),
            triangles,
            (f"angle of the normal around {names[2]} [°]", f"{names[2]} [{unit}]"),
            equal=False,
        )
    frame, names = _frame(mean / np.linalg.norm(mean))
    return Flat(
        index, scale * x @ frame[:, :2], triangles, (f"{names[0]} [{unit}]", f"{names[1]} [{unit}]")
    )


def _frame(normal: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return two directions across a unit normal, and the normal, as the columns of a (3, 3) array, and
    the names of all three. The two directions are near the two Cartesian axes that are least along the
    normal: the first is the projection of one, the second has a positive component along the other."""
    *across, along = np.argsort(np.abs(normal), kind="stable").tolist()
    i, j = sorted(across)
    first = np.eye(3)[i] - normal[i] * normal
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    frame = np.stack([first, second * np.sign(second[j]), normal], axis=1)
    names = ["t1", "t2", "the axis"]
    for column, axis in enumerate((i, j, along)):
        # a direction that an axis has up to .1 degrees is called like this axis
        if abs(frame[axis, column]) > 1 - 1e-6:
            names[column] = "xyz"[axis]
    return frame, names


@dataclass(frozen=True)
class Line:
    """One connected part of a contact boundary."""

    index: np.ndarray  # (n,) int: into the contact arrays, in order along the line
    position: np.ndarray  # (n,): along the line, increasing, in the unit of the label
    label: str  # for the axis

    def around(self, touching: np.ndarray) -> Line:
        """Return the part around the nodes of the mask ``touching`` (n,), where they are on a small part of
        the line; else the whole line."""
        places = self.position[touching]
        reach = _AROUND_PATCH * float(np.ptp(places)) if len(places) else 0.0
        if not 0 < 2 * reach < _SMALL_PART * np.ptp(self.position):
            return self
        drawn = np.abs(self.position - (places.min() + places.max()) / 2) <= reach
        return replace(self, index=self.index[drawn], position=self.position[drawn])


def lines_of(result: Result, boundary: str, near_contact: bool = False) -> list[Line]:
    """Return the lines on which the contact nodes of a boundary in the plane follow each other; a node
    of the boundary that is not a contact node ends a line. With ``near_contact`` each is cut to the
    surroundings of the nodes that touch (:meth:`Line.around`)."""
    c = result.contact
    index = np.flatnonzero(c.boundary == c.names.index(boundary))
    if not np.isfinite(c.x[index]).all():  # a DiscreteProblem without coordinates
        return [Line(index, np.arange(len(index), dtype=float), "contact node")]
    extent = np.ptp(c.x[index], axis=0)
    scale, unit = style.scaled(float(extent.max()), "m")
    parts = (
        # without a mesh no edges join the nodes: they are drawn against a coordinate
        [(index, c.x[index, extent.argmax()])]
        if result.mesh is None
        else _parts(result.mesh, c, boundary, index)
    )
    # arc lengths of all parts count from the first node of the first part: so parts keep their distances
    nodes, arc = parts[0]
    begin = arc[0]
    x, y = scale * c.x[nodes[0], :2]
    label = f"arc length from ({x:.4g}, {y:.4g}) [{unit}]"
    lines = [Line(nodes, scale * (arc - begin), label) for nodes, arc in parts]
    if near_contact:
        lines = [line.around(c.state[line.index] != OPEN) for line in lines]
    drawn = np.ptp(c.x[np.concatenate([line.index for line in lines])], axis=0)
    axis = int(drawn.argmax())
    length = np.ptp(np.concatenate([line.position for line in lines]))
    is_bent = length > _BENT * scale * drawn[axis]
    return lines if is_bent else [_along_axis(result, line, axis, scale, unit) for line in lines]


def _along_axis(result: Result, line: Line, axis: int, scale: float, unit: str) -> Line:
    """Return a line with a coordinate in place of the arc length."""
    c = result.contact
    nodes = line.index[np.argsort(c.x[line.index, axis])]
    return Line(nodes, scale * c.x[nodes, axis], f"{style.axis_names(result)[axis]} [{unit}]")


def _parts(
    mesh: MeshArrays, contact: ContactResult, boundary: str, index: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return of each run of contact nodes (n,) its entries in the contact arrays, in order, and the arc
    lengths there along the whole boundary, m; ``index`` are the entries of all of them."""
    place = np.full(mesh.n_nodes, -1)
    place[contact.node[index]] = index
    parts = []
    begin = 0.0
    for line in polylines(mesh.boundary_facets(boundary)):
        lengths = np.linalg.norm(np.diff(mesh.points[line], axis=0), axis=1)
        arc = begin + np.concatenate([[0.0], np.cumsum(lengths)])
        begin = arc[-1]
        # runs of contact nodes that follow each other on the line
        covered = np.flatnonzero(place[line] >= 0)
        parts += [
            (place[line[run]], arc[run])
            for run in np.split(covered, np.flatnonzero(np.diff(covered) > 1) + 1)
            if len(run)
        ]
    return parts


def polylines(edges: np.ndarray) -> list[np.ndarray]:
    """Join oriented edges (n, 2), one from each node, to polylines of nodes: open ones, then rings,
    which end at their first node."""
    following = dict(edges.tolist())
    ends = set(following.values())
    lines = []
    for start in (*sorted(set(following) - ends), *sorted(ends)):
        line = [start]
        while line[-1] in following:
            line.append(following.pop(line[-1]))
        if len(line) > 1:
            lines.append(np.array(line))
    return lines


def draw_map(ax: Axes, flat: Flat, values: np.ndarray, norm: Normalize) -> ScalarMappable:
    """Draw ``values`` (n,) at the nodes of a flat surface in colours."""
    _finish(ax, flat)
    if not len(flat.triangles):
        return ax.scatter(flat.points[:, 0], flat.points[:, 1], c=values, s=18, norm=norm)
    return ax.tripcolor(
        Triangulation(flat.points[:, 0], flat.points[:, 1], flat.triangles),
        values,
        shading="gouraud",
        norm=norm,
        rasterized=True,
    )


def _draw_states(ax: Axes, flat: Flat, states: np.ndarray) -> None:
    """Draw the nodes in the colours of their states over the triangles; the legend counts them."""
    if len(flat.triangles):
        ax.triplot(
            Triangulation(flat.points[:, 0], flat.points[:, 1], flat.triangles),
            color="#c9ced5",
            linewidth=0.4,
            zorder=1,
        )
    ax.scatter(
        flat.points[:, 0],
        flat.points[:, 1],
        c=[style.STATE_INKS[int(s)] for s in states],
        zorder=2,
        edgecolors=style.INK,
        linewidths=0.2,
        s=float(np.clip(4000 / len(states), 1.5, 40.0)),  # smaller where there are many
    )
    counts = np.bincount(states.astype(int), minlength=3)
    ax.legend(
        handles=[
            Patch(color=style.STATE_INKS[s], label=f"{style.STATE_NAMES[s]} ({counts[int(s)]})")
            for s in (OPEN, SLIP, STICK)
        ],
        loc="lower center",
        bbox_to_anchor=(0.5, 0.98),
        ncols=3,
        handlelength=1.2,
        columnspacing=1.2,
    )
    _finish(ax, flat)


def _finish(ax: Axes, flat: Flat) -> None:
    ax.set(aspect="equal" if flat.equal else "auto", xlabel=flat.labels[0], ylabel=flat.labels[1])


def chosen_boundaries(
    result: Result, boundary: str | Contact | ContactPair | None = None
) -> tuple[str, ...]:
    """Return the contact boundaries to draw: one, by its name or as a Contact or ContactPair, or
    all with nodes."""
    contact = result.contact
    name = boundary.boundary if isinstance(boundary, Contact | ContactPair) else boundary
    names = contact.names if name is None else (checks.choice("boundary", name, contact.names),)
    drawn = tuple(n for n in names if (contact.boundary == contact.names.index(n)).any())
    if not drawn:
        raise ValueError(
            f"boundary: {', '.join(map(repr, names)) or 'this result'} has no contact nodes to draw"
        )
    return drawn


def pair_name(contact: ContactResult, boundary: str) -> str:
    """Return 'slave on master', or the boundary alone in front of a rigid obstacle."""
    master = contact.masters[contact.names.index(boundary)]
    return (
        f"{style.quoted(boundary)} on {style.quoted(master)}" if master else style.quoted(boundary)
    )


def keep_open(ax: Axes, values: np.ndarray, largest: float) -> None:
    """Scale an axis of values that are errors of the solve, against the ``largest`` value
    elsewhere, so that they look like 0."""
    if not np.abs(values).max() > _SOLVE_ERROR * largest:
        ax.set_ylim(-1.0 if values.min() < 0 else 0.0, 1.0)


_COLUMNS = 4


@style.styled
def load_history(
    results: Sequence[Result],
    factors: ArrayLike,
    quantities: Mapping[str, Callable[[Result], float]],
    *,
    against: str = "load factor",
    steps: int = 8,
) -> Figure:
    """Draw quantities against the load factor, and below them the contact pressure of single steps.

    Parameters
    ----------
    results : sequence of Result
        One a step, in order; all on the same mesh.
    factors : sequence of float
        One a step, rising or falling (arrows show the order); any other abscissa is possible, e.g.
        displacements.
    quantities : mapping of str to callable
        Label of the axis, with its unit, to a function of a Result that returns a number; one panel
        each.
    against : str
        The label of ``factors``, with their unit.
    steps : int
        The largest number of steps drawn for each contact boundary: in this order of preference the
        first, the last, those of the largest factor and pressure, and others between them; 0 for
        none. The title says how many are drawn.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> path = am.LoadPath({"left": [0.5, 1.0]})
    >>> pressure = {"largest pressure [MPa]": lambda step: 1e-6 * step.contact.pressure.max()}
    >>> figure = am.plot.load_history(am.solve_path(grids, path), path.factors["left"], pressure)
    >>> len(figure.axes)                                               # the curve, and two steps
    3
    """
    results, factors = _checked(results, factors)
    against = style.label_text(checks.instance("against", against, str))
    rows = _evaluate(results, quantities)
    names = chosen_boundaries(results[-1]) if checks.integer("steps", steps) else ()
    if not rows and not names:
        raise ValueError("nothing to draw: give quantities, or steps > 0")
    shown = _shown(results, factors, steps) if names else ()
    # above rows of curves, below for each boundary rows of pictures of single steps; sizes are in inches
    columns = style.columns_of(max(len(shown), 1), _COLUMNS, 2.4)
    curve_columns = style.columns_of(max(len(rows), 1), 3, 3.2)
    curve_rows = -(-len(rows) // curve_columns)
    map_rows = -(-len(shown) // columns)
    heights = [2.7 * curve_rows] * bool(rows) + [2.1 * map_rows + 0.5] * len(names)
    size = max(3.2 * curve_columns * bool(rows), 2.4 * columns, 5.0), sum(heights) + 0.4
    figure = style.new_figure(size, "constrained")
    parts = iter(figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0])
    if rows:
        axes = style.cells(next(parts), len(rows), curve_columns)
        for ax, (label, values) in zip(axes, rows.items(), strict=True):
            _draw_curve(ax, factors, values, label, against)
    for name in names:
        part = next(parts)
        left_out = f": {len(shown)} of {len(results)} steps" if len(shown) < len(results) else ""
        part.suptitle(pair_name(results[0].contact, name) + left_out)
        _draw_steps(
            part,
            [results[k] for k in shown],
            [f"{against} {style.number(float(factors[k]))}" for k in shown],
            name,
            columns,
        )
    figure.suptitle(style.titled(results[-1].problem_name))
    return figure


def _checked(results: Sequence[Result], factors: ArrayLike) -> tuple[list[Result], np.ndarray]:
    """Return results and factors; TypeError or ValueError unless there are as many, all on the same
    mesh."""
    results = list(checks.listed("results", results, "Result, one a load step"))
    if not results or not all(isinstance(r, Result) for r in results):
        raise TypeError("results must be a sequence of at least one Result, one a load step")
    factors = checks.vector("factors", factors)
    if len(factors) != len(results):
        raise ValueError(
            f"factors must have one value a result: {len(results)} results, {len(factors)} factors"
        )
    places = results[0].contact.x
    if len({(len(r.displacement), r.dim, r.contact.names) for r in results}) > 1 or not all(
        np.array_equal(r.contact.x, places, equal_nan=True) for r in results
    ):
        raise ValueError("results must all belong to the same mesh and contact boundaries")
    return results, factors


def _shown(results: list[Result], factors: np.ndarray, steps: int) -> np.ndarray:
    """Return the numbers of the ``steps`` results to draw, in order: evenly spread, but with the first, the
    last, those of the largest of the ``factors`` (n_results,) and the largest pressure. Of more of these
    than ``steps`` the ones named first are drawn."""
    last = len(results) - 1
    pressures = [result.contact.pressure.max(initial=0.0) for result in results]
    peaks = [int(np.argmax(values)) for values in (factors, pressures)]
    required = list(dict.fromkeys([0, last, *peaks]))[:steps]
    shown = np.linspace(0, last, min(steps, len(results))).round().astype(int)
    for step in np.setdiff1d(required, shown):
        others = np.flatnonzero(~np.isin(shown, required))
        shown[others[np.argmin(np.abs(shown[others] - step))]] = step
    return np.sort(shown)


def _evaluate(
    results: list[Result], quantities: Mapping[str, Callable[[Result], float]]
) -> dict[str, np.ndarray]:
    """Return the values (n,) of each quantity for the results, by label."""
    if not isinstance(quantities, Mapping) or not all(map(callable, quantities.values())):
        raise TypeError(f"quantities must map labels to functions of a Result, got {quantities!r}")
    return {
        style.label_text(str(label)): np.array(
            [
                checks.number(f"quantities[{label!r}] of step {k}", function(result))
                for k, result in enumerate(results)
            ]
        )
        for label, function in quantities.items()
    }


def _draw_curve(
    ax: Axes, factors: np.ndarray, values: np.ndarray, label: str, against: str
) -> None:
    """Draw ``values`` (n,) of a quantity against the load ``factors`` (n,), with an arrow on each branch if
    these turn."""
    ax.plot(factors, values, marker="o" if len(factors) <= 60 else "", color=style.cycled(0))
    turns = np.flatnonzero(np.diff(np.sign(np.diff(factors))) != 0) + 1
    if len(turns):
        # up and down: an arrow in the middle of each branch
        for first, last in zip(np.r_[0, turns], np.r_[turns, len(factors) - 1], strict=True):
            k = (first + last) // 2
            ax.annotate(
                "",
                (0.5 * (factors[k] + factors[k + 1]), 0.5 * (values[k] + values[k + 1])),
                (factors[k], values[k]),
                arrowprops={
                    "arrowstyle": "-|>,head_width=0.35,head_length=0.8",
                    "color": style.cycled(0),
                    "shrinkA": 0,
                    "shrinkB": 0,
                },
            )
    ax.set_xlabel(against)
    ax.set_ylabel(label)
    ax.grid(True)


def _draw_steps(
    part: SubFigure, results: list[Result], titles: list[str], name: str, columns: int
) -> None:
    """Draw the contact pressure of each step, with common scales: curves, in 3D maps."""
    axes = style.cells(part, len(results), columns, share=True)
    factor, unit = style.stresses()
    if results[0].dim == 3:
        flat = flattened(results[0], name)
        pressures = [factor * result.contact.pressure[flat.index] for result in results]
        norm = Normalize(0.0, max(float(p.max()) for p in pressures) or 1.0)
        for ax, pressure in zip(axes, pressures, strict=True):
            draw_map(ax, flat, pressure, norm)
            ax.set(xlabel="", ylabel="")
        along = flat.labels[0]
        part.supylabel(flat.labels[1], fontsize="medium")
        bar = part.colorbar(ScalarMappable(norm), ax=axes, label=f"contact pressure [{unit}]")
        bar.outline.set_visible(False)
    else:
        lines = lines_of(results[0], name)
        contacts = [result.contact for result in results]
        for ax, c in zip(axes, contacts, strict=True):
            for line in lines:
                style.stated_curve(
                    ax, line.position, factor * c.pressure[line.index], c.state[line.index]
                )
        for ax in axes[::columns]:
            ax.set_ylabel(f"pressure [{unit}]")
        along = lines[0].label
        axes[0].margins(x=0.02)
        axes[0].set_ylim(bottom=0.0)
        pressures = np.array([factor * c.pressure for c in contacts])
        keep_open(
            axes[0],
            pressures[:, np.concatenate([line.index for line in lines])],
            float(pressures.max()),
        )
        states = np.concatenate([c.state for c in contacts])
        entries = style.state_lines(states)
        if style.narrow(axes[0]):
            style.legends_inside({axes[0]: entries})
        else:
            part.legend(handles=entries, loc="outside right upper")
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title)
    part.supxlabel(along, fontsize="medium")
