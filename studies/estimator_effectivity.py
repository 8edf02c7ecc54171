"""Effectivity of the error estimates with Coulomb friction, with multigrid counts and costs of the adaptive loop.

Eleven problems (one body and pairs, plane, axisymmetric and 3D, four with exact solutions), two engines, step by step:
estimates over true errors, cycles used and needed, algebraic errors left, asymptotic rates; then signed estimates of
goals, and what the whole loop costs over a nested start on its last meshes alone.

    python studies/estimator_effectivity.py [--quick | --full] [--out DIR]
"""

from __future__ import annotations

import adaptive_runs
import common
import estimator_runs as runs
import pandas as pd
from adaptive_cases import CASES
from bisected_family import bisected_table
from estimator_tables import cost_table, effectivity_figure, goal_table, rate_figure, step_table, summary_table
from paper_runs import span

#: nodes of the steps and of the reference at most
FULL = {2: (12_000, 100_000), 3: (3000, 40_000)}
QUICK = {2: (600, 5000), 3: (250, 1500)}
QUICK_CASES = ("upset block", "dovetail", "slip and open, +")
#: (engine, theta, dimension) -> nodes of the loops whose costs are measured, and turns
COSTS = {("bisected", 0.5, 2): (40_000, 3), ("bisected", 0.7, 2): (40_000, 3), ("remeshed", 0.5, 2): (12_000, 3),
         ("bisected", 0.5, 3): (10_000, 2)}
QUICK_COSTS = {("bisected", 0.5, 2): (1500, 1)}


def run(context: common.Context) -> common.Section:
    """Steps, goals, costs, and the family that stagnates."""
    limits = QUICK if context.quick else FULL
    names = QUICK_CASES if context.quick else (*CASES, *runs.EXACT)
    tables = []
    for name in names:
        case = CASES.get(name)
        most, reference = limits[2 if case is None else case.dim]
        if case is not None:
            stored = context.study(adaptive_runs.reference, {"case": [name], "nodes": [reference]})
            adaptive_runs.YARDSTICKS[name, reference] = adaptive_runs.yardstick(name, stored.iloc[0])
        # the yardstick is held by this process, and seconds are a result: these runs stay here
        tables.append(context.study(runs.loop, {"case": [name], "engine": list(runs.ENGINES)}, most=most,
                                    reference_nodes=reference, timed=True))
    steps = pd.DataFrame(runs.rows_of(pd.concat(tables, ignore_index=True), ("case", "engine")))
    costs = measured_costs(context, names)
    goals = measured_goals(context, names, limits)
    text = ("Each problem is solved by the adaptive loop with the residual indicator (Doerfler, theta = .5), with "
            "both engines. True errors are exact for the Coulomb transitions, else against a reference of some ten "
            "times the nodes, whose own error is allowed for. eta is the estimate of the residual indicator, ZZ the "
            "recovered one on the same meshes; algebraic errors are A-norms against the exact discrete solution.")
    every = summary_table(steps)
    return common.Section("Effectivity, cycles and costs of the adaptive loop", text, [
        every, *(step_table(steps, engine) for engine in runs.ENGINES), goal_table(goals), cost_table(costs),
        bisected_table(context), effectivity_figure(steps), rate_figure(steps)], summary=summary(every.frame))


def summary(every: pd.DataFrame) -> str:
    """What was asked and what came out."""
    missed = every[every["missed"] != ""]
    said = (f"How sharp are the estimates, and what does multigrid cost on adaptive meshes? In {len(every)} loops "
            f"({every['case'].nunique()} problems, {every['engine'].nunique()} engines) the residual "
            f"estimate eta is {every['least eta/error'].min():.2f} to {every['largest eta/error'].max():.2f} times the "
            f"true error, within a factor {every['spread'].max():.2f} in a loop; the recovered one "
            f"{every['least ZZ/error'].min():.2f} to {every['largest ZZ/error'].max():.2f} times. Cycles that bring "
            f"the algebraic error to a tenth of the estimate: {span(every['needed'], '.0f')}.")
    if missed.empty:
        return said + " All that was aimed at is met."
    names = "; ".join(f"{row['case']}, {row['engine']} ({row['missed']})" for _, row in missed.iterrows())
    return said + f" Missed of what was aimed at: {names}."


def measured_costs(context: common.Context, names: tuple[str, ...]) -> pd.DataFrame:
    """Costs of the loops by case and engine."""
    found = []
    for (engine, theta, dim), (most, turns) in (QUICK_COSTS if context.quick else COSTS).items():
        mine = [name for name in names if name in CASES and CASES[name].dim == dim]
        found.append(context.study(runs.cost, {"case": mine}, engine=engine, theta=theta, most=most,
                                   turns=turns, timed=True).assign(engine=engine, theta=theta))
    return pd.concat(found, ignore_index=True)


def measured_goals(context: common.Context, names: tuple[str, ...], limits: dict[int, tuple[int, int]]) -> pd.DataFrame:
    """Signed estimates of each case's goal on the meshes that follow it."""
    found = [context.study(runs.goal_loop, {"case": [name]}, most=limits[2][0] // 4, reference_nodes=2 * limits[2][0],
                           timed=True) for name in names if name in CASES and CASES[name].dim == 2]
    table = pd.concat(found, ignore_index=True)
    return pd.DataFrame(runs.rows_of(table, ("case", "exact", "reference", "reference_signed")))


if __name__ == "__main__":
    common.main(run, __doc__.split("\n")[0]
                + " Example: python studies/estimator_effectivity.py --quick --out /tmp/estimators")
