"""The dovetail joint, Example 2 of the paper: its Tables 1 to 3 on two bodies, sweeps, and a load history.

    python studies/dovetail.py [--quick | --full] [--out DIR]

The geometry and loads are ours (:func:`adaptmg.cases.dovetail`); the paper reports its results on Example 2 in a talk
only. Independent meshes throughout. The load history is in :mod:`dovetail_history`, the comparison with one body and
the sweeps in :mod:`dovetail_sweeps`, pictures in :mod:`dovetail_pictures`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import dovetail_history
import dovetail_pictures
import dovetail_sweeps
import pandas as pd
from assembly_tables import compile_coupled, counts_table, counts_text, grid_counts, smoothing_table, start_table
from common import Context, Figure, Section, Table, main
from paper_runs import TARGET, measured, repeats, span, table

import adaptmg as am

#: sizes away from contact, m; at contact 4 times finer. The third has about as many nodes as the paper's grid 1
SIZES = (8e-3, 4e-3, 2e-3, 1e-3)
NAME = "dovetail"
START_REMARK = ("From zero the joint loses contact first, and the contact zones have to be found, in the truncated "
                "mode by safe cycles.")
SOFT = ("A joint that only contact holds is far softer than the bar of Example 1: one grid needs over-relaxation or "
        "condensation. ")
OMEGAS = (1.9, 1.97, 1.98, 1.95)
CONDENSED_OMEGAS = (1.7, 1.8, 1.95, 1.9)
MOST_SWEEPS = 20_000
QUICK_SWEEPS = 2500
#: sweeps before and after the correction
SMOOTHINGS = ((1, 0), (2, 0), (3, 0), (4, 0), (6, 0), (1, 1), (2, 1), (2, 2), (3, 3))
QUICK_SMOOTHINGS = ((1, 0), (2, 0), (1, 1))
INTERFACE = (0, 1, 2, 3, 4)
CYCLES = 300


@lru_cache(maxsize=16)
def chain(finest: int, levels: int) -> am.Hierarchy:
    """``levels`` grids of the joint, the finest of which is that of ``SIZES[finest]``."""
    return am.Hierarchy.graded(am.cases.dovetail(), SIZES[finest + 1 - levels:finest + 1], contact_ratio=4)


@lru_cache(maxsize=4)
def exact(finest: int) -> am.Result:
    """The exact discrete solution by an independent method: semismooth Newton with direct solves."""
    return am.solve(chain(finest, 1), am.ActiveSet(rtol=1e-12))


def one_grid(finest: int, condensed: bool, omega: float, max_sweeps: int, rtol: float, target: float, times: int
             ) -> dict[str, Any]:
    """The paper's regular resolution."""
    solver = am.SingleGrid(omega=omega, condensed=condensed, max_sweeps=max_sweeps, rtol=rtol)
    return on_chain(finest, 1, solver, target, times)


def several_grids(finest: int, levels: int, method: str, rtol: float, target: float, times: int) -> dict[str, Any]:
    """A full multigrid start and cycles; ``method`` is "truncated" or "monotone V", "monotone W", ..."""
    solver = (am.FullMultigrid(rtol=rtol) if method == "truncated" else
              am.FullMultigrid(correction=am.Monotone(), cycle=am.Cycle(shape=method.split()[1]), rtol=rtol,
                               max_cycles=CYCLES))
    return on_chain(finest, levels, solver, target, times)


def smoothing(finest: int, counts: tuple[int, int], stop: str, rtol: float, target: float, times: int
              ) -> dict[str, Any]:
    """Two grids in the monotone mode, n sweeps before and after the correction; full start."""
    pre, post = counts
    solver = am.FullMultigrid(correction=am.Monotone(), cycle=am.Cycle(pre=pre, post=post), stop=stop, rtol=rtol,
                              max_cycles=CYCLES)
    return on_chain(finest, 2, solver, target, times)


def local_smoothing(finest: int, levels: int, interface: int, coarse: int, rtol: float, target: float, times: int
                    ) -> dict[str, Any]:
    """The truncated mode with n sweeps along the interface, and on the coarser levels."""
    correction = am.Truncated(interface_sweeps=interface, coarse_sweeps=coarse)
    return on_chain(finest, levels, am.FullMultigrid(correction=correction, rtol=rtol), target, times)


def start(finest: int, levels: int, correction: str, full: bool, rtol: float, target: float, times: int
          ) -> dict[str, Any]:
    """With and without the full multigrid start."""
    kind = am.Truncated() if correction == "truncated" else am.Monotone()
    method = am.FullMultigrid if full else am.Multigrid
    return on_chain(finest, levels, method(correction=kind, rtol=rtol, max_cycles=CYCLES), target, times)


def on_chain(finest: int, levels: int, solver: Any, target: float, times: int) -> dict[str, Any]:
    """One row, see :func:`paper_runs.measured`."""
    warm_up()
    grids = chain(finest, levels)
    row = measured(grids, solver, exact(finest), target, times)
    return row | {"grids": "/".join(str(level.n_nodes) for level in reversed(grids.levels))}


@lru_cache(maxsize=1)
def warm_up() -> None:
    """Compile what two bodies need beyond :func:`common.warm_up`."""
    compile_coupled(chain(1, 2))


def run(context: Context) -> Section:
    """Tables and figures; see the module."""
    finest = 2 if context.quick else 3
    fixed = {"finest": finest, "target": TARGET, "times": repeats(context)}
    counts = grid_counts(context, fixed, one_grid, several_grids, {False: OMEGAS, True: CONDENSED_OMEGAS},
                         QUICK_SWEEPS if context.quick else MOST_SWEEPS,
                         lambda n: ("monotone V", "monotone W", "truncated") if n > 2 else ("monotone V", "truncated"))
    items: list[Table | Figure] = [] if context.quick else [dovetail_pictures.posed()]
    items += [counts_table("dovetail_grids", NAME, counts, SOFT), dovetail_pictures.error_figure(counts)]
    smoothings = QUICK_SMOOTHINGS if context.quick else SMOOTHINGS
    items += [smoothing_table(context, smoothing, smoothings, NAME, fixed), local_table(context, fixed),
              start_table(context, start, NAME, fixed, START_REMARK)]
    items += dovetail_pictures.solution(context.quick)
    said = summary(counts)
    if context.full:
        sweeps, ratios = dovetail_sweeps.items(context)
        history, costs = dovetail_history.items(context)
        items += [*sweeps, *history]
        said += further_text(ratios, costs)
    return Section("Example 2: the dovetail joint", "", items, summary=said)


def local_table(context: Context, fixed: dict[str, Any]) -> Table:
    """What the sweeps of the truncated mode do."""
    levels = fixed["finest"] + 1
    frame = context.study(local_smoothing, {"interface": INTERFACE[:3:2] if context.quick else INTERFACE, "coarse": (1,)
                                            if context.quick else (1, 2)}, levels=levels, rtol=1e-8, **fixed)
    frame = frame.assign(**{"interface sweeps": frame["interface"], "coarse sweeps": frame["coarse"],
                            "test": "error 1e-08"})
    none, default = (frame[(frame["interface"] == n) & (frame["coarse"] == 1)].iloc[0] for n in (0, 2))
    least = frame.loc[frame["work"].idxmin()]
    note = (f"Sweeps within two elements of the interface after the one symmetric sweep of a cycle: without them "
            f"{none['cycles']} cycles, rate {none['rate']:.2f}; with two (the default) {default['cycles']} and "
            f"{default['rate']:.2f}. Coarse sweeps: before and after each correction on the coarser levels, on these "
            f"grids one by default. Least work with {least['interface']} and {least['coarse']}.")
    return table("dovetail_local", frame, ["interface sweeps", "coarse sweeps", "grids", "cycles", "work", "rate",
                                           "run_seconds", "test", "true_error", "residual", "outcome"],
                 "Truncated mode, full start: sweeps along the interface and on the coarser levels", note,
                 {"interface sweeps": "d", "coarse sweeps": "d"})


def summary(counts: pd.DataFrame) -> str:
    """What was asked and what came out."""
    return ("Tables 1 to 3 on the paper's Example 2, of which it prints no figures; geometry and loads are ours: a "
            "tongue pulled out of its notch, one half by symmetry, plane strain, Coulomb friction .2, "
            f"{counts['grids'].iloc[0]} nodes. {counts_text(counts)}")


def further_text(ratios: pd.DataFrame, costs: pd.DataFrame) -> str:
    """What the sweeps and the load history add."""
    pulled = costs[~costs["unload"].astype(bool)]
    return (" Against one body (the GRECO bar, same sizes and grading, friction .2) two need "
            f"{span(ratios['ratio'].dropna(), '.2f')} times the work units, at rates up to "
            f"{ratios['rate'].max():.2f}. Ten steps of pull cost {pulled['work ratio'].max():.1f} times the "
            "work units of one at most.")


if __name__ == "__main__":
    main(run, "The dovetail joint: Tables 1 to 3 on two bodies; with --full sweeps and a load history. "
              "Example: python studies/dovetail.py --quick --out /tmp/dovetail")
