"""The first screen of the report: the paper's three tables next to ours, and two pictures.

A section says itself what stands there (``Section.headline``); for one that does not, what stands here is made from its
tables. Nothing is computed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import common
import pandas as pd
from adaptive_pays import or_more, two
from common import Figure, Headline, Section, Table
from matplotlib import pyplot as plt
from paper_runs import CHANGE, TARGET, listed, span

from adaptmg.plot.style import BLUE, CYCLE, GREY, ORANGE, styled

#: engines of the adaptive loop with its default indicator, and what stands above their pictures
ENGINES = {"bisected": "bisected", "remeshed": "remeshed by Netgen (the default)"}
#: the column of what a mesh gains
OVER = "time, uniform over this"
MARKERS = "osD^vPX"


@dataclass(frozen=True)
class Place:
    """A place on the first screen: its title, the study it is of, and what to make of that study's tables."""

    title: str
    study: str
    make: Callable[[Mapping[str, pd.DataFrame]], Headline]


def headlines(sections: Mapping[str, Section]) -> dict[str, Headline | str]:
    """For each place what stands there, or why nothing does."""
    given = {line.place: line for section in sections.values() for line in section.headline}
    unknown = sorted(set(given) - set(PLACES))
    if unknown:
        raise ValueError(f"headline: there is no place {unknown} on the first screen; there are {list(PLACES)}")
    return {name: given.get(name) or _made(name, sections) for name in PLACES}


def _made(name: str, sections: Mapping[str, Section]) -> Headline | str:
    place = PLACES[name]
    if place.study not in sections:
        return f"Not in this run: python studies/reproduce.py {place.study}"
    frames = {item.name: item.frame for item in sections[place.study].items if isinstance(item, Table)}
    try:
        return place.make(frames)
    except (KeyError, IndexError) as error:
        return f"The tables of this run have nothing for this place ({type(error).__name__}: {error})."


def grid_counts(frames: Mapping[str, pd.DataFrame]) -> Headline:
    """Table 1: like with like, complete coarse solutions; the best of the table's other cycles is named after it."""
    frame = frames["table1"]
    ours = {name: frame[name] for name in frame.columns if name.startswith("monotone, ")}
    like = ours["monotone, complete"]
    shown = pd.DataFrame({"grids": frame["grids"], "paper": frame["paper"], "ours": like,
                          "its mode": frame["paper's mode"]})
    best = max(ours, key=lambda name: ours[name].max())
    row = int(ours[best].idxmax())
    also = "" if best == "monotone, complete" else (
        f" With {best.removeprefix('monotone, ')}-cycles {ours[best][row]:.0f} "
        f"({len(frame['grids'][row].split('/'))} grids).")
    units = {"paper": "CPU", "ours": "work", "its mode": "work"}
    return Headline("grids", Table("front_grids", shown, "", units=units, formats=dict.fromkeys(units, ".1f")),
                    f"Speed-up over one grid, {frame['grids'].iloc[0]} nodes. Ours: work to a true error of "
                    f"{TARGET:g} (monotone mode, complete coarse solves as in the paper).{also} By default "
                    f"{frame['default'].iloc[-1]:.0f}. Its mode: to a change of {CHANGE:g}, where it stops at a true "
                    f"error of {frame['its true error'].iloc[-1]:.0e}.")


def smoothings(frames: Mapping[str, pd.DataFrame]) -> Headline:
    """Table 2: cycles for 1 to 4 smoothings, from zero with tight coarse solves."""
    frame = frames["table2"].dropna(subset="paper")
    shown = frame[["smoothings", "paper", "tight", "loose"]].rename(columns={"tight": "ours", "loose": "ours, loose"})
    names = shown.columns[1:]
    return Headline("smoothings", Table("front_smoothings", shown, "", units=dict.fromkeys(names, "cycles"),
                                        formats=dict.fromkeys(names, ".0f")),
                    "Two grids (289/81) from zero, frictionless bar, until a cycle changes the solution by "
                    f"{CHANGE:g}. Ours: coarse problems solved to an error of 1e-8; loose: until a sweep changes them "
                    "by what the outer test allows.")


def starts(frames: Mapping[str, pd.DataFrame]) -> Headline:
    """Table 3: the speed-up of two grids, from zero and from the full start."""
    frame = frames["table3"]
    shown = frame[["method", "paper", "frictionless, its test", "friction 1, equal error"]].rename(
        columns={"frictionless, its test": "frictionless", "friction 1, equal error": "friction 1"})
    units = {"paper": "CPU", "frictionless": "work", "friction 1": "work"}
    return Headline("starts", Table("front_starts", shown, "", units=units, formats=dict.fromkeys(units, ".1f")),
                    "Speed-up over one grid, 289/81 nodes. Ours: frictionless in the paper's mode, to a change of "
                    f"{CHANGE:g} (a patch test: the full start is exact); friction 1 in the monotone mode, to a true "
                    f"error of {TARGET:g}.")


@styled
def adaptive(frames: Mapping[str, pd.DataFrame]) -> Headline:
    """Time on uniform meshes over that on adaptive ones against the energy error, problem by problem."""
    rows, pays = frames["adaptive_meshes"], frames["adaptive_pays"]
    # what is extrapolated further says little
    reached = rows["problem"].map(rows[rows["meshes"] == "uniform"].groupby("problem")["energy"].min())
    rows = rows[rows["meshes"].isin([f"residual, {name}" for name in ENGINES]) & (rows["energy"] >= 0.5 * reached)]
    rows = rows.dropna(subset=OVER)
    if rows.empty:
        raise KeyError(OVER)
    figure, axes = plt.subplots(1, 2, figsize=(5.6, 3.3), sharey=True)
    problems = list(pays["problem"])
    for ax, (name, title) in zip(axes, ENGINES.items(), strict=True):
        for k, problem in enumerate(problems):
            mine = rows[(rows["problem"] == problem) & (rows["meshes"] == f"residual, {name}")]
            beyond = (mine["uniform"] == "extrapolated").to_numpy()
            ax.loglog(mine["energy"], mine[OVER], ":", color=CYCLE[k], linewidth=1.0)
            ax.loglog(mine["energy"][~beyond], mine[OVER][~beyond], marker=MARKERS[k], color=CYCLE[k], markersize=3.5,
                      linewidth=1.4, label=problem)
            ax.loglog(mine["energy"][beyond], mine[OVER][beyond], marker=MARKERS[k], color=CYCLE[k], markersize=3.5,
                      linestyle="", markerfacecolor="white")
        ax.axhline(1.0, color=GREY, linewidth=1.0)
        ax.set_title(title, fontsize=9.5)
        ax.set_xlabel("energy error [%]")
        ax.invert_xaxis()
        ax.grid(True)
        common.plain_ticks(ax.xaxis, ax.yaxis)
    axes[0].set_ylabel("time, uniform over adaptive")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, handlelength=1.6, columnspacing=1.2)
    caption = ("Time on uniform meshes over that on adaptive ones at equal energy error, against that error; above 1 "
               "adaptive meshes are quicker")
    return Headline("adaptive", Figure("front_adaptive", figure, caption), _who_gains(rows, pays))


def _who_gains(rows: pd.DataFrame, pays: pd.DataFrame) -> str:
    """From which error on adaptive meshes pay, and where they do not."""
    pays = pays.set_index("problem")
    counts, details = [], []
    for name in ENGINES:
        below, ratio = pays[f"{name} pays below"], pays[f"time, {name}"]
        wins = below.index[below != "no"]
        counts.append(f"{name}, they pay in {len(wins)} of {len(pays)} problems"
                      + f" (by up to {two(ratio[wins].max())} times)" * bool(len(wins)))
        if len(wins):
            details.append(f"{name.capitalize()} they pay below "
                           f"{listed([f'{or_more(below[problem])} ({problem})' for problem in wins])}.")
    neither = pays.index[[all(pays.loc[problem, f"{name} pays below"] == "no" for name in ENGINES)
                          for problem in pays.index]]
    lost = f"; uniform meshes are quicker than both on: {', '.join(neither)}" if 0 < len(neither) < len(pays) else ""
    said = [f"Above 1 adaptive meshes are quicker, everything counted. At the least error that all reach: "
            f"{'; '.join(counts)}{lost}.", *details]
    if (rows["uniform"] == "extrapolated").any():
        said.append("Open marks: uniform meshes extrapolated.")
    return " ".join(said)


@styled
def linear(frames: Mapping[str, pd.DataFrame]) -> Headline:
    """Seconds of the contact problem by multigrid and of the linear one by algebraic multigrid."""
    frame = frames["amg_glued"]
    rows = frame[frame["grid"] == "uniform"]
    ours, amg = (rows[rows["method"] == name].sort_values("nodes")
                 for name in ("contact, FullMultigrid", "AMG-CG, rigid-body modes"))
    if ours.empty or amg.empty:
        raise KeyError("FullMultigrid and AMG-CG on uniform grids")
    figure, ax = plt.subplots(figsize=(5.6, 2.5))
    ax.loglog(amg["nodes"], amg["total"], marker="s", color=ORANGE, label="linear (glued) problem, pyamg AMG-CG")
    ax.loglog(ours["nodes"], ours["total"], marker="o", color=BLUE, label="contact with friction, multigrid")
    ax.set(xlabel="nodes", ylabel="set-up and solve [s]")
    common.plain_ticks(ax.xaxis, ax.yaxis)
    ax.grid(True)
    ax.legend()
    over = (ours.set_index("nodes")[["total", "work"]] / amg.set_index("nodes")[["total", "work"]]).dropna()
    ratio = over["total"]
    return Headline("linear", Figure("front_linear", figure, "Seconds of set-up and solve against nodes: the contact "
                                     "problem by multigrid, the linear problem by pyamg"),
                    f"GRECO bar on uniform grids, one thread. The contact problem takes {span(ratio, '.2f')} "
                    "times the seconds of one linear solve of the same matrix (contact nodes fixed), "
                    f"{ratio.iloc[-1]:.2f} on {ratio.index[-1]} nodes, and {span(over['work'], '.2f')} times the work "
                    "units.")


PLACES: Mapping[str, Place] = {
    "grids": Place("Table 1: more grids", "grid_count", grid_counts),
    "smoothings": Place("Table 2: smoothings", "smoothing_count", smoothings),
    "starts": Place("Table 3: full start", "full_multigrid", starts),
    "adaptive": Place("Adaptive against uniform meshes", "adaptive_vs_uniform", adaptive),
    "linear": Place("Contact against a linear solve", "amg_comparison", linear),
}
