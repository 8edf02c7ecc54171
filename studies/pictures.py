"""Draw the pictures of the README and of the documentation: the bar, the dovetail, an adaptive
mesh.

python studies/pictures.py [--out DIR] [NAME ...]
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
from adaptive_vs_uniform import ENGINES, solutions
from common import make_folder, small_png, write_bytes
from matplotlib.figure import Figure

import adaptmg as am

#: size of titles, as in the pictures of adaptmg
TITLE = 9


def overview() -> Figure:
    """The bar with friction 1 on independent meshes: problem, grids, contact line, convergence."""
    problem = am.cases.greco_bar(law=am.Coulomb(1.0))
    grids = am.Hierarchy.graded(
        problem, sizes=(10e-3, 6e-3, 3.6e-3, 2.2e-3, 1.3e-3), contact_ratio=4
    )
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12))
    monotone = {"correction": am.Monotone(), "smoother": am.ProjectedGaussSeidel(order="backward")}
    runs = {
        "one grid": am.solve(grids, am.SingleGrid(rtol=1e-7), reference=exact, throw=False),
        "monotone, zero start": am.solve(grids, am.Multigrid(**monotone), reference=exact),
        "monotone, nested start": am.solve(grids, am.FullMultigrid(**monotone), reference=exact),
        "truncated (default)": am.solve(grids, am.FullMultigrid(), reference=exact),
    }
    figure = plt.figure(figsize=(13.6, 8.6), layout="constrained")
    (above,), (below,) = figure.subfigures(2, 1, squeeze=False, height_ratios=(4.0, 4.6))
    left, right = above.subfigures(1, 2, width_ratios=(1.5, 2.2))
    am.plot.problem(problem, left.subplots())
    for k, ax in zip((0, 2, 4), right.subplots(1, 3), strict=True):
        am.plot.mesh(am.mesh.need_mesh(grids[k]), ax, contact=("bottom",))
        ax.set_title(f"level {k}: {grids[k].n_nodes} nodes", fontsize=TITLE)
        ax.set_axis_off()
    left, right = below.subfigures(1, 2)
    am.plot.contact(runs["truncated (default)"], left.subplots(3, 1, sharex=True))
    ax = right.subplots()
    am.plot.history(runs, ax=ax)
    ax.set_xscale("log")
    ax.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=4, fontsize=8, columnspacing=1.0
    )
    ax.set_ylim(top=3.0)  # the legend stands below
    ax.set_title(f"{grids.finest.n_nodes} nodes: true error against work", fontsize=TITLE)
    return figure


def dovetail() -> Figure:
    """The joint deformed as in Fig. 3 of the paper, and its stress."""
    result = am.solve(
        am.Hierarchy.graded(am.cases.dovetail(), sizes=(6e-3, 3.6e-3, 2.2e-3), contact_ratio=6)
    )
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(9.6, 6.6), layout="constrained", width_ratios=(1.12, 1.0)
    )
    am.plot.deformation(result, amplify=20, states=True, ax=left)
    am.plot.deformation(result, amplify=20, stress=True, lines=False, ax=right)
    return figure


def adaptive() -> Figure:
    """Two adaptive meshes of the dovetail: remeshed and bisected."""
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 5.6), layout="constrained")
    for ax, engine in zip(axes, ENGINES, strict=True):
        *_, (grids, _, _) = solutions("dovetail", engine, 4000)
        am.plot.mesh(am.mesh.need_mesh(grids.finest), ax)
        ax.set_title(f"{engine}, {grids.finest.n_nodes} nodes", fontsize=TITLE)
    return figure


PICTURES = {"overview": overview, "dovetail": dovetail, "adaptive": adaptive}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=str(__doc__).split("\n")[0],
        epilog="example: python studies/pictures.py --out /tmp/pictures overview",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("data/pictures"),
        metavar="DIR",
        help="default: data/pictures",
    )
    parser.add_argument(
        "pictures", nargs="*", metavar="NAME", help=f"some of: {', '.join(PICTURES)} (default: all)"
    )
    arguments = parser.parse_args()
    if unknown := sorted(set(arguments.pictures) - set(PICTURES)):
        parser.error(f"unknown picture {', '.join(unknown)}; there are {', '.join(PICTURES)}")
    make_folder("--out", arguments.out)
    for name in arguments.pictures or PICTURES:
        write_bytes(arguments.out / f"{name}.png", small_png(PICTURES[name](), 90))
        print(arguments.out / f"{name}.png")
