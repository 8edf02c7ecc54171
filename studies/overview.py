"""The pictures of the README: the bar (problem, grids, contact line, convergence), the dovetail, and adaptive meshes.

    python studies/overview.py [--out DIR] [NAME ...]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import adaptive_runs as runs
import matplotlib.pyplot as plt
import pandas as pd
from adaptive_figures import picture, steps_of
from common import write_picture
from matplotlib.figure import Figure

import adaptmg as am
from adaptmg.plot.style import BLUE, GREEN, INK, ORANGE, styled

SIZES = (10e-3, 6e-3, 3.6e-3, 2.2e-3, 1.3e-3)


@styled
def bar() -> Figure:
    """Solve the bar with friction 1 on graded independent meshes and draw."""
    problem = am.cases.greco_bar(law=am.Coulomb(1.0))
    grids = am.Hierarchy.graded(problem, sizes=SIZES, contact_ratio=4)
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12))
    smoother = am.ProjectedGaussSeidel(order="backward")
    full = am.FullMultigrid(correction=am.Monotone(), smoother=smoother)
    runs = {"one grid": am.solve(grids, am.SingleGrid(rtol=1e-7), reference=exact, throw=False),
            "monotone, zero start": am.solve(grids, am.Multigrid(correction=am.Monotone(), smoother=smoother),
                                             reference=exact),
            "monotone, nested start": am.solve(grids, full, reference=exact),
            "truncated (default)": am.solve(grids, am.FullMultigrid(), reference=exact)}
    figure = plt.figure(figsize=(13.6, 8.6), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(4.0, 4.6))
    left, right = above.subfigures(1, 2, width_ratios=(1.5, 2.2))
    am.plot.problem(problem, left.subplots())
    axes = right.subplots(1, 3)
    for k, ax in zip((0, 2, 4), axes, strict=True):
        level = grids[k]
        am.plot.mesh(level.mesh, ax, contact=("bottom",))
        ax.set_title(f"level {k}: {level.mesh.n_nodes} nodes")
        ax.set_axis_off()
    left, right = below.subfigures(1, 2)
    am.plot.contact(runs["truncated (default)"], left.subplots(3, 1, sharex=True))
    ax = right.subplots()
    am.plot.history(runs, ax=ax)
    for line, color in zip(ax.get_lines(), (INK, ORANGE, BLUE, GREEN), strict=True):
        line.set_color(color)
    ax.set_xscale("log")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=4, fontsize=8, columnspacing=1.0)
    ax.set_title(f"{grids.finest.mesh.n_nodes} nodes: true error against work")
    return figure


def dovetail() -> Figure:
    """The joint deformed as in Fig. 3 of the paper, and its stress."""
    problem = am.cases.dovetail()
    result = am.solve(am.Hierarchy.graded(problem, sizes=(6e-3, 3.6e-3, 2.2e-3), contact_ratio=6))
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 6.6), layout="constrained", width_ratios=(1.12, 1.0))
    am.plot.deformation(result, amplify=20, states=True, ax=left)
    am.plot.deformation(result, amplify=20, stress=True, lines=False, ax=right)
    return figure


def adaptive() -> Figure:
    """Adaptive meshes of the dovetail, and errors against uniform ones and those graded by hand."""
    case, reference = "dovetail", 150_000
    rows = [pd.DataFrame(json.loads(runs.family(case, family, 250_000 if family == "uniform" else 20_000, reference)
                                    ["meshes"])).assign(case=case, family=family) for family in runs.FAMILIES]
    steps = steps_of(case, 4000)
    return picture(pd.concat(rows, ignore_index=True), case, (steps[-3], steps[-1]))


PICTURES = {"overview": bar, "dovetail": dovetail, "adaptive": adaptive}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Draw the pictures of the README.",
                                     epilog="example: python studies/overview.py --out /tmp/pictures")
    parser.add_argument("--out", type=Path, default=Path("data/pictures"), metavar="DIR")
    parser.add_argument("pictures", nargs="*", metavar="NAME", help=f"some of: {', '.join(PICTURES)} (default: all)")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.pictures) - set(PICTURES))
    if unknown:
        parser.error(f"unknown picture {', '.join(unknown)}; there are {', '.join(PICTURES)}")
    for name in arguments.pictures or PICTURES:
        target = arguments.out / f"{name}.png"
        write_picture(PICTURES[name](), target, dpi=90)
        print(target)


if __name__ == "__main__":
    main()
