"""path: the way of a solver through the levels, level against step (as Fig. 1 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptmg.plot.style import BLUE, GREEN, GREY, INK, ORANGE, canvas, styled
from adaptmg.problem import checks
from adaptmg.solver.result import Result

__all__ = ["path"]


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
