"""history: residual, change and error against work, cycles or time; path: the cycle diagram of a
solver; adaptation: the meshes of an adaptive loop, and how its error falls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator, NullFormatter

from adaptmg import _checks as checks
from adaptmg.estimate.loop import Step
from adaptmg.mesh.arrays import need_mesh
from adaptmg.plot import style
from adaptmg.plot.bodies import Coloring, draw_bodies, state_marks
from adaptmg.solver.result import Result

_QUANTITIES = {
    "error_estimate": "estimated error (relative, energy norm)",
    "true_error": "true error (relative, energy norm)",
    "residual": "natural residual (relative)",
    "relative_change": "change in one cycle (relative, Euclidean)",
    "change": "change between checks (relative, energy norm)",
}
_AGAINST = {"work_units": "work units", "cycle": "cycle", "seconds": "time [s]"}
_DASHES = ("-", "--", ":", "-.", (0, (8, 2)))  # one for each quantity


@style.styled
def history(
    results: Result | Mapping[str, Result], against: str = "work_units", ax: Axes | None = None
) -> Figure:
    """Draw convergence histories on a logarithmic scale: of one result all that it recorded, of
    several the true error, where all recorded it, else the natural residual, or what else all
    recorded.

    Parameters
    ----------
    results : Result or mapping of label to Result
    against : {"work_units", "cycle", "seconds"}
        Seconds are those since the solver began.
    ax : matplotlib Axes, optional

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> am.plot.history(result).axes[0].get_xlabel()
    'work units'
    """
    several = isinstance(results, Mapping)
    runs = dict(results) if several else {"": results}
    if not runs or not all(isinstance(r, Result) for r in runs.values()):
        raise TypeError(
            f"results must be a Result or a mapping of labels to Results, got {results!r}"
        )
    checks.choice("against", against, _AGAINST)
    quantities = _chosen(runs, several)
    ax = style.canvas(ax, (6.4, 4.2))
    for k, (label, result) in enumerate(runs.items()):
        for j, name in enumerate(quantities):
            x = np.asarray(result.history[against], dtype=float)
            y = np.asarray(result.history[name], dtype=float)
            shown = np.isfinite(x) & np.isfinite(y) & (y > 0)
            ax.semilogy(
                x[shown],
                y[shown],
                marker="o" if shown.sum() <= 60 else "",
                linestyle="-" if several else _DASHES[j],
                color=style.cycled(k if several else j),
                label=style.label_text(str(label))
                if several
                else _QUANTITIES[name].partition(" (")[0],
            )
    tolerances = {result.rtol for result in runs.values()}
    if len(tolerances) == 1:
        ax.axhline(
            tolerances.pop(), color=style.GREY, linewidth=0.9, linestyle=(0, (4, 3)), zorder=1
        )
        ax.annotate(
            "rtol",
            (0.0, next(iter(runs.values())).rtol),  # curves end at the right
            (3, 0),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            color=style.GREY,
            fontsize="small",
            ha="left",
            va="bottom",
        )
    ax.set_xlabel(_AGAINST[against])
    if several or len(quantities) == 1:
        ax.set_ylabel(_QUANTITIES[quantities[0]])
    else:
        ax.set_ylabel("relative measure")
        ax.set_title(style.titled(next(iter(runs.values())).problem_name), wrap=True)
    ax.grid(True)
    if several or len(quantities) > 1:
        style.legends_inside({ax: ax.get_legend_handles_labels()[0]})
    if against == "cycle":
        ax.xaxis.set_major_locator(MaxNLocator("auto", integer=True, steps=(1, 2, 5, 10)))
    return style.figure_of(ax)


def _chosen(runs: Mapping[str, Result], several: bool) -> list[str]:
    """Return the quantities that every run recorded with at least one finite positive value; of
    several runs the first such quantity only."""

    def recorded(result: Result, name: str) -> bool:
        values = np.asarray(result.history.get(name, ()), dtype=float)
        return bool((np.isfinite(values) & (values > 0)).any())

    names = (
        sorted(_QUANTITIES, key=("true_error", "residual", *_QUANTITIES).index)
        if several
        else _QUANTITIES
    )
    common = [name for name in names if all(recorded(result, name) for result in runs.values())]
    if not common:
        raise ValueError("results have no quantity of the history in common")
    return common[:1] if several else common


#: transfers by their names in the path: colour, line and label
_TRANSFERS = {
    "restrict": (style.ORANGE, "-", "restrict residual"),
    "prolong": (style.BLUE, "-", "prolong correction"),
    "start": (style.INK, (0, (3, 2)), "prolong solution (nested start)"),
}


@style.styled
def path(result: Result, ax: Axes | None = None, *, steps: int = 120) -> Figure:
    """Draw the cycle diagram, level against step (as Fig. 1 of the paper): smoothing, coarse solves
    and transfers.

    At most ``steps`` of them are drawn, from the start; the picture says how many there are.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> len(am.plot.path(result).axes)
    1
    """
    checks.integer("steps", steps, 2)
    entries = checks.instance("result", result, Result).path
    if not entries:
        raise ValueError("this result has no cycles to draw (result.path is empty)")
    levels = max(len(result.levels), max(level for level, _, _ in entries[:steps]) + 1)
    # inches: wider with the number of steps, higher with that of levels
    ax = style.canvas(
        ax, (min(11.0, 3.4 + 0.1 * len(entries[:steps])), 1.1 + 0.62 * max(levels, 2))
    )
    # the line goes on from (at, height); two actions on one level are drawn next to each other
    at = 0.0
    height = entries[0][0]
    before = "restrict"  # any transfer: there is no action next to which the first one is drawn
    for level, action, times in entries[:steps]:
        # a restriction is recorded on the level it leaves, the others on the one they reach
        reached = level - 1 if action == "restrict" else level
        if action in _TRANSFERS:
            color, dashes, label = _TRANSFERS[action]
            ax.plot(
                [at, at + 1],
                [height, reached],
                color=color,
                linestyle=dashes,
                linewidth=1.4,
                label=label,
            )
            at += 1
        elif before not in _TRANSFERS:
            at += 0.8  # next to another
        if action == "smooth":
            ax.scatter(
                at,
                level,
                marker="o",
                s=120,
                facecolor="white",
                edgecolor=style.INK,
                linewidth=1.1,
                zorder=3,
                label="smooth (sweeps)",
            )
            ax.text(
                at,
                level,
                str(times) if times < 100 else "",  # three digits are wider than the mark
                ha="center",
                va="center",
                fontsize="x-small",
                color=style.INK,
                zorder=4,
            )
        elif action == "solve":
            ax.scatter(at, level, marker="s", s=80, color=style.GREEN, zorder=3, label="solve")
        height = reached
        before = action
    # no number for levels that the result does not list
    nodes = [f"\n{int(level['nodes'])} nodes" for level in result.levels] + [""] * levels
    ax.set_yticks(range(levels), [f"level {k}{nodes[k]}" for k in range(levels)])
    ax.set(xlim=(-0.8, at + 0.8), ylim=(-0.6, levels - 0.45), xticks=[])
    ax.spines[["bottom", "left"]].set_visible(False)
    ax.tick_params(axis="y", length=0)
    ax.grid(True, axis="y")
    if len(entries) > steps:
        ax.text(
            1.0,
            -0.02,
            f"first {steps} of {len(entries)} steps",
            transform=ax.transAxes,
            ha="right",
            va="top",
            color=style.INK,
            fontsize="small",
        )
    handles, labels = ax.get_legend_handles_labels()
    entry = dict(zip(labels, handles, strict=True))
    style.legend_next_to(ax, list(entry.values()))
    return style.figure_of(ax)


@style.styled
def adaptation(steps: Sequence[Step]) -> Figure:
    """Draw an adaptive loop: three of its meshes with contact states, a map of the indicator, and
    how the error falls.

    ``steps`` are those of :func:`adaptmg.adapt`. Above are the first mesh, one in the middle and
    the last; below the square root of each element's part of the estimate on the last mesh, and the
    relative estimate against nodes and against seconds (meshes included), with the rate of smooth
    solutions (of a goal twice that of the energy norm).

    Examples
    --------
    >>> problem = am.cases.greco_bar()
    >>> mesh = am.mesh.structured(problem.domain, 2)
    >>> steps = list(am.adapt(problem, mesh, engine=am.Bisect(), max_nodes=20))
    >>> am.plot.adaptation(steps).savefig("adaptation.png")
    """
    steps = checks.items("steps", steps, Step, "Steps of am.adapt")
    if not steps:
        raise ValueError("steps is empty: give the steps of am.adapt, as in list(am.adapt(...))")
    last = steps[-1]
    present = set()
    dim = need_mesh(last.result).dim
    goal = last.estimate.signed is not None
    columns = style.columns_of(6, 3, 3.3)
    rows = 6 // columns
    engine = ConstrainedLayoutEngine(compress=columns == 3, w_pad=0.1)
    figure = style.new_figure((3.5 * columns, (3.0 if columns == 2 else 3.6) * rows), engine)
    between = " " if columns == 3 else "\n"
    # three meshes
    for k, number in enumerate(sorted({0, len(steps) // 2, len(steps) - 1})):
        title = f"step {number}:{between}{steps[number].nodes} nodes"
        ax = _panel(figure, (rows, columns, k + 1), dim, title)
        result = steps[number].result
        mesh = need_mesh(result)
        marks = state_marks(mesh, result.contact)
        present |= draw_bodies(ax, mesh, style.body_fills(len(mesh.bodies)), marks)
    figure.legend(
        handles=style.state_lines(present),
        loc="outside lower center" if style.narrow(ax) else "outside upper right",
        ncols=3,
        fontsize="small",
    )
    # the indicator, at most four decades of it in colour, and from half of the largest value on if all are equal:
    # a logarithmic scale needs two ends
    parts = np.sqrt(last.estimate.squares)
    largest = float(parts.max()) or 1.0
    norm = LogNorm(
        max(1e-4 * largest, parts.min(initial=0.5 * largest, where=parts > 0)), largest, clip=True
    )
    ax = _panel(figure, (rows, columns, 4), dim, f"indicator,{between}step {last.number}")
    draw_bodies(ax, need_mesh(last.result), Coloring(parts, False, "", norm), lines=False)
    label = r"$|\eta_E|^{1/2}$ of the goal" if goal else r"$\eta_E$ [$\sqrt{\mathrm{N\,m}}$]"
    location = "bottom" if style.narrow(ax) else "right"
    bar = figure.colorbar(ScalarMappable(norm), ax=ax, label=label, location=location, shrink=0.8)
    # labels of a short horizontal scale would touch each other
    bar.ax.xaxis.set_minor_formatter(NullFormatter())
    # the estimate against nodes and seconds
    nodes = np.array([step.nodes for step in steps], dtype=float)
    relative = np.array([step.estimate.relative for step in steps])
    left = figure.add_subplot(rows, columns, 5)
    right = figure.add_subplot(rows, columns, 6, sharey=left)
    right.tick_params(labelleft=False)
    seconds = np.array([step.total_seconds for step in steps])
    for ax, x, name in ((left, nodes, "nodes"), (right, seconds, "time with meshes [s]")):
        shown = (x > 0) & (relative > 0) & np.isfinite(relative)
        ax.loglog(x[shown], relative[shown], marker="o", color=style.cycled(0))
        ax.set_xlabel(name)
        ax.grid(True, which="both")
        for axis in (ax.xaxis, ax.yaxis):
            style.label_plainly(axis)
    left.set_ylabel("estimate / value of the goal [-]" if goal else r"estimate / $\|u_h\|_A$ [-]")
    if (relative > 0).all() and np.isfinite(relative[-1]) and nodes[-1] > nodes[0]:
        # the error of a quantity falls as the square of that in the energy norm; drawn above the curve
        power = -2 / dim if goal else -1 / dim
        left.plot(
            nodes,
            1.35 * relative[-1] * (nodes / nodes[-1]) ** power,
            color=style.GREY,
            linewidth=1.0,
            linestyle="--",
            label=f"nodes$^{{{Fraction(power).limit_denominator(9)}}}$",
        )
        style.legends_inside({left: left.get_legend_handles_labels()[0]})
    figure.suptitle(style.titled(last.result.problem_name))
    return figure


def _panel(figure: Figure, place: tuple[int, int, int], dim: int, title: str) -> Axes:
    """Return new axes for a mesh, without coordinates in narrow figures; ``place`` has the numbers
    of rows and columns, and its position."""
    ax = figure.add_subplot(*place, projection="3d" if dim == 3 else None)
    ax.set_title(title, wrap=True)
    if dim == 3 or style.narrow(ax):
        ax.set_axis_off()
    return ax
