"""history: residual, change and estimated error against work, cycles or time. path: the cycle diagram of a solver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptmg import _checks as checks
from adaptmg.plot.style import BLUE, CYCLE, GREEN, GREY, INK, ORANGE, canvas, label_text, plain, styled
from adaptmg.solver.result import Result

_QUANTITIES = {"error_estimate": "estimated error (relative, energy norm)",
               "true_error": "true error (relative, energy norm)", "residual": "natural residual (relative)",
               "relative_change": "change in one cycle (relative, Euclidean)",
               "change": "change between checks (relative, energy norm)"}
_AGAINST = {"work_units": "work units", "cycle": "cycle", "seconds": "time [s]"}
_DASHES = ("-", "--", ":", "-.")


@styled
def history(results: Result | Mapping[str, Result], against: str = "work_units", ax: Axes | None = None) -> Figure:
    """Draw convergence histories on a logarithmic scale: of one result all that it recorded, of several the true error,
    where all recorded it, else the natural residual, or what else all recorded.

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
        raise TypeError(f"results must be a Result or a mapping of labels to Results, got {results!r}")
    checks.choice("against", against, _AGAINST)
    quantities = _chosen(runs, several)
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


def _chosen(runs: Mapping[str, Result], several: bool) -> list[str]:
    """The quantities that every run recorded with at least one finite positive value; of several runs the first."""
    def recorded(result: Result, name: str) -> bool:
        values = np.asarray(result.history.get(name, ()), dtype=float)
        return bool((np.isfinite(values) & (values > 0)).any())

    names = sorted(_QUANTITIES, key=("true_error", "residual", *_QUANTITIES).index) if several else _QUANTITIES
    common = [name for name in names if all(recorded(result, name) for result in runs.values())]
    if not common:
        raise ValueError("results have no quantity of the history in common")
    return common[:1] if several else common


#: transfers by their names in the path: colour, line and label
_TRANSFERS = {"restrict": (ORANGE, "-", "restrict residual"), "prolong": (BLUE, "-", "prolong correction"),
              "start": (INK, (0, (3, 2)), "prolong solution (nested start)")}


@dataclass
class _Stop:
    """A point of the cycle diagram: a level, the action there, and the transfer that leads to it."""

    level: int
    action: str
    times: int
    arrival: str = ""


@styled
def path(result: Result, ax: Axes | None = None, *, steps: int = 60) -> Figure:
    """Draw the cycle diagram, level against step (as Fig. 1 of the paper): smoothing, coarse solves and transfers.

    At most ``steps`` points are drawn, from the start; the picture says how many there are.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> len(am.plot.path(result).axes)
    1
    """
    checks.integer("steps", steps, 2)
    stops = _stops(checks.instance("result", result, Result).path)
    if not stops:
        raise ValueError("this result has no cycles to draw (result.path is empty)")
    shown = stops[:steps]
    levels = max(len(result.levels), max(stop.level for stop in shown) + 1)
    ax = canvas(ax, (min(11.0, 3.4 + 0.18 * len(shown)), 1.1 + 0.62 * max(levels, 2)))
    height = np.array([stop.level for stop in shown])
    for k, stop in enumerate(shown):
        if k and stop.arrival:
            color, style, label = _TRANSFERS[stop.arrival]
            first = stop.arrival not in {before.arrival for before in shown[1:k]}
            ax.plot([k - 1, k], height[k - 1:k + 1], color=color, linestyle=style, linewidth=1.4,
                    label=label if first else None, zorder=2)
    for action, marker, face, edge, size, label in (("smooth", "o", "white", INK, 120, "smooth (sweeps)"),
                                                    ("solve", "s", GREEN, GREEN, 80, "solve")):
        if at := [k for k, stop in enumerate(shown) if stop.action == action]:
            ax.scatter(at, height[at], marker=marker, s=size, facecolor=face, edgecolor=edge, linewidth=1.1, zorder=3,
                       label=label)
    for k, stop in enumerate(shown):
        if stop.action == "smooth" and stop.times < 100:
            ax.text(k, stop.level, str(stop.times), ha="center", va="center", fontsize=7, color=INK, zorder=4)
    nodes = [f"\n{int(level['nodes'])} nodes" for level in result.levels] + [""] * levels
    ax.set_yticks(range(levels), [f"level {k}{nodes[k]}" for k in range(levels)])
    ax.set(xlim=(-0.8, len(shown) - 0.2), ylim=(-0.6, levels - 0.45), xticks=[])
    ax.spines[["bottom", "left"]].set_visible(False)
    ax.tick_params(axis="y", length=0)
    for k in range(levels):
        ax.axhline(k, color="#e6e9ed", linewidth=0.8, zorder=0)
    if len(stops) > steps:
        ax.text(1.0, -0.02, f"first {steps} of {len(stops)} steps", transform=ax.transAxes, ha="right", va="top",
                color=INK, fontsize=8.5)
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02))
    return ax.figure


def _stops(entries: list[tuple[int, str, int]]) -> list[_Stop]:
    """Points in order. A restriction is recorded on the level it leaves, a prolongation on the one it reaches."""
    stops: list[_Stop] = []
    arrival = ""
    for level, action, times in entries:
        if action == "restrict":
            if not stops or stops[-1].level != level:
                stops.append(_Stop(level, "", 0, arrival))
            arrival = "restrict"
            continue
        if action in ("prolong", "start"):
            stops.append(_Stop(level, "", 0, action))
        elif stops and stops[-1].level == level and not stops[-1].action:
            stops[-1].action, stops[-1].times = action, times
        else:
            stops.append(_Stop(level, action, times, arrival))
        arrival = ""
    return stops
