"""Pictures of the study of the number of grids: error against work, and the ways through the levels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import matplotlib.pyplot as plt
import pandas as pd
from common import Figure, grids
from paper_runs import COUNT, RTOL, TARGET, chain, draw_error

import adaptmg as am
from adaptmg.plot.style import BLUE, GREEN, GREY, INK, ORANGE, SKY, styled

BAR = "Coulomb bar"
#: name of the row without its own run
PREDICTED = "one grid, omega 1 (predicted)"


@styled
def error_figure(panels: list[tuple[pd.DataFrame, int]], tested: pd.DataFrame) -> Figure:
    """True error against work: colour says how many grids, line style which mode."""
    canvas, axes = plt.subplots(1, len(panels), figsize=(4.3 * len(panels) + 2.4, 4.3), sharey=True, squeeze=False)
    lines = {}
    for ax, (frame, divisions) in zip(axes[0], panels, strict=True):
        for row, label, style in curves(frame, tested if divisions == 32 else tested[:0]):
            lines.setdefault(label, draw_error(ax, row, label, **style))
        ax.set(title=f"{BAR}, {divisions + 1} x {divisions + 1} nodes", xlabel="work units", ylim=(RTOL / 2, 1))
        ax.axhline(TARGET, color=GREY, linewidth=0.8)
        ax.grid(True)
    axes[0, 0].set_ylabel("true error (relative A-norm)")
    canvas.legend(lines.values(), lines.keys(), loc="outside right upper", handlelength=3)
    return Figure("grid_count_error", canvas, "True error against work units: one grid (dash-dotted), the monotone "
                  "mode with W-cycles (dashed; two grids: complete), the default (full line), and the paper's mode "
                  "(dotted), which comes to rest at the crosses.")


def curves(frame: pd.DataFrame, tested: pd.DataFrame) -> Iterator[tuple[pd.Series, str, dict[str, Any]]]:
    """What the picture of errors shows: stored row, label, style."""
    roles = (("one grid, omega 1", INK), ("one grid, best omega", GREY), ("condensed, omega 1", "#b0568f"),
             ("condensed, best omega", "#d9a3c6"))
    for (_, row), (label, color) in zip(frame[frame["levels"] == 1].iterrows(), roles, strict=True):
        if row["label"] != PREDICTED:
            yield row, label, {"color": color, "linestyle": "-."}
    colors = dict(zip(COUNT, (INK, BLUE, ORANGE, GREEN, "#806000", SKY), strict=True))
    default = frame[frame["order"] == "truncated (default)"]
    swept = frame[(frame["levels"] > 1) & (frame["order"] == "forward") & (frame["coarse_rtol"] == 1e-2)]
    swept = swept[~swept["coarse_condensed"].astype(bool)]
    for _, row in swept[(swept["cycle"] == "W") | (swept["levels"] == 2)].iterrows():
        yield row, f"{COUNT[row['levels']]}, monotone", {"color": colors[row["levels"]], "linestyle": "--"}
    last = default.iloc[-1]
    yield last, f"{COUNT[last['levels']]}, default", {"color": colors[last["levels"]]}
    stalled = tested[(tested["correction"] == "paper") & ((tested["cycle"] == "W") | (tested["levels"] == 2))]
    for _, row in stalled.iterrows():
        yield row, f"{COUNT[row['levels']]}, paper's mode", {"color": colors[row["levels"]], "linestyle": ":"}


@styled
def path_figure() -> Figure:
    """The ways through the levels, as Fig. 1 of the paper."""
    canvas, axes = plt.subplots(2, 2, figsize=(11, 6.2))
    for ax, shape in zip(axes.ravel(), ("V", "F", "W", "complete"), strict=True):
        solver = am.FullMultigrid(correction=am.Monotone(), cycle=am.Cycle(shape=shape), max_cycles=1)
        am.plot.path(am.solve(grids(BAR, chain(32, 4)), solver, throw=False), ax=ax, steps=40)
        ax.set_title(f"{shape}-cycle" if len(shape) == 1 else "complete coarse solutions")
        handles, labels = ax.get_legend_handles_labels()
        ax.get_legend().remove()
    canvas.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return Figure("grid_count_paths", canvas, "The way through the levels in the full multigrid start and the first "
                  "cycle (as Fig. 1 of the paper); numbers in circles are sweeps.")
