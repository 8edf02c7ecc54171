"""load_history: quantities of a sequence of load steps against the load, and the contact pressure of each step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, SubFigure
from numpy.typing import ArrayLike

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg.plot.contact_surfaces import chosen_boundaries, draw_map, flattened, keep_open, lines_of, pair_name
from adaptmg.plot.style import BLUE, cells, label_text, new_figure, number, plain, state_lines, stated_curve, styled
from adaptmg.solver.result import Result

_COLUMNS = 4


@styled
def load_history(results: Sequence[Result], factors: ArrayLike,
                 quantities: Mapping[str, Callable[[Result], float]], *, against: str = "load factor",
                 steps: int = 8) -> Figure:
    """Draw quantities against the load factor, and below them the contact pressure of single steps.

    Parameters
    ----------
    results : sequence of Result
        One a step, in order; all on the same mesh.
    factors : sequence of float
        One a step, rising or falling (arrows show the order); any other abscissa is possible, e.g. displacements.
    quantities : mapping of str to callable
        Label of the axis, with its unit, to a function of a Result that returns a number; one panel each.
    against : str
        The label of ``factors``, with their unit.
    steps : int
        The largest number of steps drawn for each contact boundary: the first, the last, that of the largest pressure,
        those where ``factors`` turn, and others between them; 0 for none. The title says how many are left out.

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
    against = label_text(checks.instance("against", against, str))
    rows = _evaluate(results, quantities)
    names = chosen_boundaries(results[-1]) if checks.integer("steps", steps) else ()
    if not rows and not names:
        raise ValueError("nothing to draw: give quantities, or steps > 0")
    shown = _shown(results, factors, steps) if names else ()
    columns, curve_columns = min(_COLUMNS, max(len(shown), 1)), min(3, max(len(rows), 1))
    curve_rows, map_rows = -(-len(rows) // curve_columns), -(-len(shown) // columns)
    heights = [2.7 * curve_rows] * bool(rows) + [2.1 * map_rows + 0.5] * len(names)
    figure = new_figure((max(3.2 * curve_columns * bool(rows), 2.4 * columns, 5.0), sum(heights) + 0.4))
    parts = iter(figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0])
    if rows:
        axes = cells(next(parts), len(rows), curve_columns)
        for ax, (label, values) in zip(axes, rows.items(), strict=True):
            _draw_curve(ax, factors, values, label, against)
    for name in names:
        part = next(parts)
        left_out = f": {len(shown)} of {len(results)} steps" if len(shown) < len(results) else ""
        part.suptitle(pair_name(results[0].contact, name) + left_out, fontsize=10)
        _draw_steps(part, [results[k] for k in shown], [f"{against} {number(factors[k])}" for k in shown], name,
                    columns)
    figure.suptitle(plain(results[-1].problem_name), fontsize=11)
    return figure


def _checked(results: Sequence[Result], factors: ArrayLike) -> tuple[list[Result], np.ndarray]:
    results = list(results)
    if not results or not all(isinstance(r, Result) for r in results):
        raise TypeError("results must be a sequence of at least one Result, one a load step")
    factors = check_arrays.vector("factors", factors)
    if len(factors) != len(results):
        raise ValueError(f"factors must have one value a result: {len(results)} results, {len(factors)} factors")
    if len({(len(r.displacement), r.dim, len(r.contact), r.contact.names) for r in results}) > 1:
        raise ValueError("results must all belong to the same mesh and contact boundaries")
    return results, factors


def _shown(results: list[Result], factors: np.ndarray, steps: int) -> np.ndarray:
    """The numbers of the steps to draw: both ends, the largest pressure and turns, then those farthest from all these.
    """
    last = len(results) - 1
    turns = np.flatnonzero(np.diff(np.sign(np.diff(factors))) != 0) + 1
    turns = turns[np.unique(np.linspace(0, len(turns) - 1, min(max(steps - 3, 0), len(turns))).astype(int))]
    peak = int(np.argmax([result.contact.pressure.max(initial=0.0) for result in results]))
    chosen = list(dict.fromkeys([0, last, peak, *turns.tolist()]))[:steps]
    while len(chosen) < min(steps, len(results)):
        chosen.append(int(np.argmax(np.abs(np.subtract.outer(np.arange(last + 1), chosen)).min(axis=1))))
    return np.sort(chosen)


def _evaluate(results: list[Result], quantities: Mapping[str, Callable[[Result], float]]) -> dict[str, np.ndarray]:
    if not isinstance(quantities, Mapping) or not all(map(callable, quantities.values())):
        raise TypeError(f"quantities must map labels to functions of a Result, got {quantities!r}")
    return {label_text(str(label)): np.array([checks.number(f"quantities[{label!r}] of step {k}", function(result))
                             for k, result in enumerate(results)]) for label, function in quantities.items()}


def _draw_curve(ax: Axes, factors: np.ndarray, values: np.ndarray, label: str, against: str) -> None:
    ax.plot(factors, values, marker="o" if len(factors) <= 60 else "", markersize=3.5, color=BLUE)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(factors))) != 0) + 1
    if len(turns):
        # up and down: an arrow in the middle of each branch
        for a, b in zip(np.r_[0, turns], np.r_[turns, len(factors) - 1], strict=True):
            k = (a + b) // 2
            middle = [0.5 * (v[k] + v[k + 1]) for v in (factors, values)]
            ax.annotate("", middle, (factors[k], values[k]),
                        arrowprops={"arrowstyle": "-|>,head_width=0.35,head_length=0.8", "color": BLUE, "shrinkA": 0,
                                    "shrinkB": 0})
    ax.set_xlabel(against)
    ax.set_ylabel(label)
    ax.grid(True)


def _draw_steps(part: SubFigure, results: list[Result], titles: list[str], name: str, columns: int) -> None:
    """Draw the contact pressure of each step, with common scales: curves, in 3D maps."""
    axes = cells(part, len(results), columns, share=True)
    if results[0].dim == 3:
        flat = flattened(results[0], name)
        pressures = [1e-6 * result.contact.pressure[flat.index] for result in results]
        norm = Normalize(0.0, max(float(p.max()) for p in pressures) or 1.0)
        for ax, pressure in zip(axes, pressures, strict=True):
            draw_map(ax, flat, pressure, norm)
            ax.set(xlabel="", ylabel="")
        along = flat.labels[0]
        part.supylabel(flat.labels[1], fontsize=9.5)
        bar = part.colorbar(ScalarMappable(norm, "viridis"), ax=axes, label="contact pressure [MPa]")
        bar.outline.set_visible(False)
    else:
        lines, contacts = lines_of(results[0], name), [result.contact for result in results]
        for ax, c in zip(axes, contacts, strict=True):
            for line in lines:
                stated_curve(ax, line.position, 1e-6 * c.pressure[line.index], c.state[line.index], 1.5)
        for ax in axes[::columns]:
            ax.set_ylabel("pressure [MPa]")
        along = lines[0].label
        axes[0].margins(x=0.02)
        axes[0].set_ylim(bottom=0.0)
        pressures = np.array([1e-6 * c.pressure for c in contacts])
        keep_open(axes[0], pressures[:, np.concatenate([line.index for line in lines])], float(pressures.max()))
        part.legend(handles=state_lines(np.concatenate([c.state for c in contacts]), 2.5), loc="outside right upper")
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title, fontsize=9)
    part.supxlabel(along, fontsize=9.5)
