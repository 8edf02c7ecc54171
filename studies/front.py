"""The first screen of the report: the paper's three tables beside ours, and two pictures.

A section says itself what stands there (``Section.headline``); for one that does not, what stands here is made from its
tables. Nothing is computed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import common
import numpy as np
import pandas as pd
from common import Figure, Headline, Section, Table
from matplotlib import pyplot as plt
from paper_runs import CHANGE, TARGET

from adaptmg.plot.style import BLUE, GREEN, GREY, ORANGE, styled

#: the meshes of the adaptive loop with its default settings
ADAPTIVE, BISECTED = "residual, remeshed", "residual, bisected"


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
                    f"Speed-up over one grid. Ours: work to a true error of {TARGET:g}, with complete coarse solves as "
                    f"in the paper.{also} Its mode: to the paper's test, where it stops at a true error of "
                    f"{frame['its true error'].iloc[-1]:.0e}.")


def smoothings(frames: Mapping[str, pd.DataFrame]) -> Headline:
    """Table 2: cycles for 1 to 4 smoothings, from zero with tight coarse solves."""
    frame = frames["smoothing_count"]
    tight = frame[(frame["start"] == "zero") & (frame["coarse solve"] == "error 1e-8")].set_index("smoothings")
    loose = frame[(frame["start"] == "zero") & (frame["coarse solve"] == "change 1 x outer")].set_index("smoothings")
    printed = tight["paper iterations"].dropna()
    shown = pd.DataFrame({"smoothings": printed.index, "paper": printed.to_numpy(),
                          "ours": tight.loc[printed.index, "cycles"].to_numpy(),
                          "ours, loose": loose["cycles"].reindex(printed.index).to_numpy()})
    names = shown.columns[1:]
    return Headline("smoothings", Table("front_smoothings", shown, "", units=dict.fromkeys(names, "cycles"),
                                        formats=dict.fromkeys(names, ".0f")),
                    "Two grids (289/81) from zero, frictionless bar, until a cycle changes the solution by "
                    f"{CHANGE:g}. Ours: coarse problems solved to an error of 1e-8; loose: until a sweep changes them "
                    "by what the outer test allows.")


def starts(frames: Mapping[str, pd.DataFrame]) -> Headline:
    """Table 3: the cost of each method over that of two grids with the full start."""
    frame = frames["full_multigrid"]
    theirs = frame[(frame["problem"] == "frictionless bar") & (frame["mode"] == "paper")]
    equal = frame[(frame["problem"] == "Coulomb bar") & (frame["mode"] == "monotone")
                  & frame["test"].str.startswith("true error")]
    if not len(theirs) == len(equal) == 3:
        raise KeyError("three methods on the frictionless and on the Coulomb bar")
    shown = pd.DataFrame({
        "method": theirs["method"].to_numpy(), "paper": theirs["paper ratio"].to_numpy(),
        "frictionless": theirs["work ratio"].to_numpy(), "friction 1": equal["work ratio"].to_numpy()})
    units = {"paper": "CPU", "frictionless": "work", "friction 1": "work"}
    return Headline("starts", Table("front_starts", shown, "", units=units, formats=dict.fromkeys(units, ".1f")),
                    "Cost over two grids with the full start, 289/81 nodes. Ours: frictionless in the paper's mode and "
                    "by its test (a patch test: the start is exact), with friction to equal true error.")


@styled
def adaptive(frames: Mapping[str, pd.DataFrame]) -> Headline:
    """Nodes and seconds on uniform meshes over those on adaptive ones, problem by problem."""
    frame = frames["adaptive_cost"]
    rows = frame[frame["meshes"] == ADAPTIVE].dropna(subset=["nodes x", "seconds x"])
    if rows.empty:
        raise KeyError(ADAPTIVE)
    bisected = frame[frame["meshes"] == BISECTED].set_index("case")["seconds x"].reindex(rows["case"])
    bars = [(rows["nodes x"], BLUE, "nodes"), (rows["seconds x"], ORANGE, "seconds")]
    if bisected.notna().any():
        bars.append((bisected, GREEN, "seconds, bisected"))
    figure, ax = plt.subplots(figsize=(5.6, 2.8))
    width = 0.8 / len(bars)
    for k, (values, color, label) in enumerate(bars):
        place = np.arange(len(rows)) + (k - (len(bars) - 1) / 2) * width
        ax.barh(place, values.to_numpy() - 1.0, 0.95 * width, left=1.0, color=color, label=label)
    ax.axvline(1.0, color=GREY, linewidth=1.0)
    ax.set_xscale("log")
    ax.set_yticks(range(len(rows)), rows["case"])
    ax.invert_yaxis()
    ax.set_xlabel("uniform over adaptive, at equal energy error")
    common.plain_ticks(ax.xaxis)
    ax.tick_params(axis="y", length=0)
    ax.grid(True, axis="x")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
    return Headline("adaptive", Figure("front_adaptive", figure, "Nodes and seconds on uniform meshes over those on "
                                       "adaptive ones, at equal error in the energy norm"), _who_gains(rows, bisected))


def _who_gains(rows: pd.DataFrame, bisected: pd.Series) -> str:
    """Where adaptive meshes pay, in nodes and in seconds, and where they do not."""
    wins = rows["seconds x"] > 1
    slower = rows[~wins]
    most = f" (by up to {rows['seconds x'].max():.1f} times)" if wins.any() else ""
    said = (f"With its defaults the adaptive loop takes {rows['nodes x'].min():.1f} to {rows['nodes x'].max():.1f} "
            f"times fewer nodes than uniform meshes at equal energy error, and is quicker in {wins.sum()} of "
            f"{len(rows)} problems{most}; seconds count meshing, assembly, every step and its estimate.")
    if len(slower):
        said += f" Uniform meshes are quicker on: {', '.join(slower['case'])}."
    known = bisected.dropna()
    if len(known):
        said += (f" Bisection, which needs no mesh generator, is quicker than uniform meshes in {(known > 1).sum()} of "
                 f"{len(known)}. Where solutions are singular they gain more the smaller the error: the table says "
                 "from which on.")
    if (rows["how"] == "extrapolated").any():
        said += " Some ratios are extrapolated: see the table."
    return said


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
    ratio = (ours.set_index("nodes")["total"] / amg.set_index("nodes")["total"]).dropna()
    return Headline("linear", Figure("front_linear", figure, "Seconds of set-up and solve against nodes: the contact "
                                     "problem by multigrid, the linear problem by pyamg"),
                    f"GRECO bar on uniform grids, one thread. The contact problem takes {ratio.min():.2f} to "
                    f"{ratio.max():.2f} times the seconds of one linear solve of the same matrix (contact nodes "
                    f"fixed), {ratio.iloc[-1]:.2f} on {ratio.index[-1]} nodes.")


PLACES: Mapping[str, Place] = {
    "grids": Place("Table 1: more grids", "grid_count", grid_counts),
    "smoothings": Place("Table 2: smoothings", "smoothing_count", smoothings),
    "starts": Place("Table 3: full start", "full_multigrid", starts),
    "adaptive": Place("Adaptive against uniform meshes", "adaptive_vs_uniform", adaptive),
    "linear": Place("Contact against a linear solve", "amg_comparison", linear),
}
