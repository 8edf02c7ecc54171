"""history: how residual, change and estimated error fall with work, cycles or time.

path: the way of a solver through the levels, level against step (as Fig. 1 of the paper).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptmg import _checks as checks
from adaptmg.plot.style import BLUE, CYCLE, GREEN, GREY, INK, ORANGE, canvas, label_text, plain, styled
from adaptmg.solver.result import Result

__all__ = ["history", "path"]

_QUANTITIES = {"error_estimate": "estimated error (relative, energy norm)",
               "true_error": "true error (relative, energy norm)", "residual": "natural residual (relative)",
               "relative_change": "change in one cycle (relative, Euclidean)",
               "change": "change between checks (relative, energy norm)"}
_AGAINST = {"work_units": "work units", "cycle": "cycle", "seconds": "time [s]"}
_DASHES = ("-", "--", ":", "-.")


@styled
def history(results: Result | Mapping[str, Result], against: str = "work_units", ax: Axes | None = None, *,
            quantity: str | None = None) -> Figure:
    """Draw convergence histories on a logarithmic scale.

    Parameters
    ----------
    results : Result or mapping of label to Result
    against : {"work_units", "cycle", "seconds"}
        Seconds are those since the solver began.
    ax : matplotlib Axes, optional
    quantity : {"error_estimate", "true_error", "residual", "relative_change", "change"}, optional
        Default: for one result all it recorded, for several the true error if all recorded it, else the residual
        (an estimate made from changes cannot see that a method stalled).

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        If a result did not record what is asked for.
    """
    several = isinstance(results, Mapping)
    runs = dict(results) if several else {"": results}
    if not runs or not all(isinstance(r, Result) for r in runs.values()):
        raise TypeError(f"results must be a Result or a mapping of labels to Results, got {results!r}")
    checks.choice("against", against, _AGAINST)
    quantities = _chosen(runs, quantity, several)
    ax = canvas(ax, (6.4, 4.2))
    for k, (label, result) in enumerate(runs.items()):
        for j, name in enumerate(quantities):
            x, y = np.asarray(result.history[against], dtype=float), np.asarray(result.history[name], dtype=float)
            shown = np.isfinite(x) & np.isfinite(y) & (y > 0)
            ax.semilogy(x[shown], y[shown], marker="o" if shown.sum() <= 60 else "",
                        linestyle="-" if several else _DASHES[j], color=CYCLE[(k if several else j) % len(CYCLE)],
                        label=label_text(str(label)) if several else _QUANTITIES[name])
    tolerances = {result.rtol for result in runs.values()}
    if len(tolerances) == 1:
        ax.axhline(tolerances.pop(), color=GREY, linewidth=0.9, linestyle=(0, (4, 3)), zorder=1)
        ax.annotate("rtol", (1.0, next(iter(runs.values())).rtol), xycoords=("axes fraction", "data"), color=GREY,
                    fontsize=8.5, ha="right", va="bottom")
    ax.set_xlabel(_AGAINST[against])
    if several or len(quantities) == 1:
        ax.set_ylabel(_QUANTITIES[quantities[0]])
    else:
        ax.set_ylabel("relative measure")
        ax.set_title(plain(next(iter(runs.values())).problem_name))
    ax.grid(True)
    if several or len(quantities) > 1:
        ax.legend(loc="upper right")
    if against == "cycle":
        ax.xaxis.get_major_locator().set_params(integer=True)
    return ax.figure


def _chosen(runs: Mapping[str, Result], quantity: str | None, several: bool) -> list[str]:
    """What to draw, checked: recorded by every run with at least one finite positive value."""
    def recorded(result: Result, name: str) -> bool:
        values = np.asarray(result.history.get(name, ()), dtype=float)
        return bool((np.isfinite(values) & (values > 0)).any())

    if quantity is not None:
        checks.choice("quantity", quantity, _QUANTITIES)
    wanted = list(_QUANTITIES if quantity is None else (quantity,))
    if several and quantity is None:
        wanted.sort(key=("true_error", "residual", *_QUANTITIES).index)
    found = [name for name in wanted if all(recorded(result, name) for result in runs.values())]
    if not found:
        known = {label or result.method: [n for n in _QUANTITIES if recorded(result, n)]
                 for label, result in runs.items()}
        raise ValueError(f"not every result recorded {quantity or 'a common quantity'}; recorded are {known}")
    return found[:1] if several else found


@dataclass
class _Stop:
    """A place on the way: a level, what was done there, and how the way led there from the last one."""

    level: int
    action: str
    times: int
    arrival: str = ""


@styled
def path(result: Result, ax: Axes | None = None, *, steps: int = 60) -> Figure:
    """Draw the way through the levels: smoothing, coarse solves, restrictions down, prolongations up.

    Parameters
    ----------
    result : Result
    ax : matplotlib Axes, optional
    steps : int
        Places drawn at most, from the start; what is left out is stated.

    Returns
    -------
    matplotlib.figure.Figure
    """
    checks.integer("steps", steps, 2)
    stops = _stops(checks.instance("result", result, Result).path)
    if not stops:
        raise ValueError("this result has recorded no way through the levels (result.path is empty)")
    shown = stops[:steps]
    levels = max(len(result.levels), max(stop.level for stop in shown) + 1)
    ax = canvas(ax, (min(11.0, 3.4 + 0.18 * len(shown)), 1.1 + 0.62 * max(levels, 2)))
    _draw_ways(ax, shown)
    _draw_stops(ax, shown)
    ax.set_yticks(range(levels), [_level_name(result, k) for k in range(levels)])
    ax.set_ylim(-0.6, levels - 0.45)
    ax.set_xlim(-0.8, len(shown) - 0.2)
    ax.set_xticks([])
    ax.spines[["bottom", "left"]].set_visible(False)
    ax.tick_params(axis="y", length=0)
    for k in range(levels):
        ax.axhline(k, color="#e6e9ed", linewidth=0.8, zorder=0)
    if len(stops) > steps:
        ax.text(1.0, -0.02, f"first {steps} of {len(stops)} steps", transform=ax.transAxes, ha="right", va="top",
                color=INK, fontsize=8.5)
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02))
    return ax.figure


def _level_name(result: Result, level: int) -> str:
    if level >= len(result.levels):
        return f"level {level}"
    return f"level {level}\n{int(result.levels[level]['nodes'])} nodes"


def _stops(entries: list[tuple[int, str, int]]) -> list[_Stop]:
    """Places in order. A restriction is noted on the level it leaves, a prolongation on the one it reaches."""
    stops: list[_Stop] = []
    arrival = ""
    for level, action, times in entries:
        if action == "restrict":
            arrival = "restrict"
            if not stops or stops[-1].level != level:
                stops.append(_Stop(level, "", 0))
        elif action in ("prolong", "start"):
            stops.append(_Stop(level, "", 0, action))
            arrival = ""
        else:
            last = stops[-1] if stops else None
            if last is not None and last.level == level and not last.action:
                last.action, last.times = action, times
            else:
                stops.append(_Stop(level, action, times, arrival))
            arrival = ""
    return stops


_WAYS = {"restrict": (ORANGE, "-", "restrict residual"), "prolong": (BLUE, "-", "prolong correction"),
         "start": (INK, (0, (3, 2)), "prolong solution (nested start)"), "": (GREY, ":", None)}


def _draw_ways(ax: Axes, stops: list[_Stop]) -> None:
    named: set[str] = set()
    for k in range(1, len(stops)):
        color, style, label = _WAYS[stops[k].arrival]
        ax.plot([k - 1, k], [stops[k - 1].level, stops[k].level], color=color, linestyle=style, linewidth=1.4,
                label=None if stops[k].arrival in named else label, zorder=2)
        named.add(stops[k].arrival)


def _draw_stops(ax: Axes, stops: list[_Stop]) -> None:
    """Circles with the number of sweeps, squares for solves: of coarsest problems, or Newton steps."""
    for action, marker, face, text_color, label in (("smooth", "o", "white", INK, "smooth (sweeps)"),
                                                    ("solve", "s", GREEN, "white", "solve")):
        at = [k for k, stop in enumerate(stops) if stop.action == action]
        if at:
            ax.scatter(at, [stops[k].level for k in at], marker=marker, s=120 if action == "smooth" else 80,
                       facecolor=face, edgecolor=INK if action == "smooth" else GREEN, linewidth=1.1, zorder=3,
                       label=label)
        if action == "smooth":
            for k in at:
                text = str(stops[k].times) if stops[k].times < 100 else ""
                ax.text(k, stops[k].level, text, ha="center", va="center", fontsize=7, color=text_color, zorder=4)
