"""The study of effectivity, multigrid counts and loop costs: it runs, and what it measures holds."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from study_scripts import load

import adaptmg as am

runs = load("estimator_runs")
limits = load("estimator_tables")


def test_rates_are_of_the_cycles_of_multigrid():
    problem, start = runs.posed("upset block")
    *_, step = am.adapt(problem, start, engine=am.Bisect(), max_nodes=100)
    result = am.solve(step.hierarchy, am.FullMultigrid(rtol=1e-10))
    changes = 0.5 ** np.arange(12.0)
    history = {"change": np.append(changes, 1e-9), "status_changes": np.append(np.zeros(12), np.nan)}
    assert runs.asymptotic_rate(replace(result, history=history)) == pytest.approx(0.5)
    assert 0 < runs.asymptotic_rate(result) < 0.5


def test_a_warm_start_is_what_the_loop_starts_from():
    problem, start = runs.posed("upset block")
    before, step = list(am.adapt(problem, start, engine=am.Bisect(), max_nodes=40))[:2]
    found = runs.warm_start(before, step.hierarchy)
    # nodes of the coarser mesh are nodes of the finer one
    assert found[:before.nodes] == pytest.approx(before.result.displacement)


def test_a_warm_start_where_the_level_is_gone():
    problem, start = runs.posed("upset block")
    before, step = list(am.adapt(problem, start, engine=am.Bisect(), max_nodes=60))[-2:]
    gone = step.hierarchy.without(len(step.hierarchy) - 2)
    assert all(level.mesh is not before.hierarchy.finest.mesh for level in gone.levels)
    assert runs.warm_start(before, gone)[:before.nodes] == pytest.approx(before.result.displacement)


def test_phases_add_up_to_the_loop():
    problem, start = runs.posed("upset block")
    seconds, last = runs.timed_loop(problem, start, am.Bisect(), am.Doerfler(0.5), 200)
    assert set(seconds) == {"mesh", "assembly", "solve", "estimate"} and all(value > 0 for value in seconds.values())
    assert last.nodes > 100


@pytest.mark.slow
def test_effectivity(tables):
    found = tables("estimator_effectivity")
    summary = found["estimator_summary"]
    assert (summary["spread"] < limits.SPREAD).all()
    assert (summary["least ZZ/error"] > 0.7).all() and (summary["largest ZZ/error"] < 1.2).all()
    assert (summary["needed"] <= [limits.wanted_cycles(case) for case in summary["case"]]).all()
    assert (summary["rate"] <= [limits.wanted_rate(case) for case in summary["case"]]).all()
    costs = found["estimator_costs"]
    assert (costs["work"] < limits.WORK).all() and (costs["over 1e-8"] < limits.TIGHT).all()
    family = found["bisected_family"].groupby("family")
    line, followed = family.get_group("bisected at contact"), family.get_group("adapted")
    assert line["warns"].iloc[-1] and not line["warns"].iloc[0]
    assert line["energy, ZZ"].iloc[-1] > 0.9 * line["energy, ZZ"].iloc[2]
    assert followed["energy, ZZ"].iloc[-1] < 0.6 * line["energy, ZZ"].iloc[-1]
    assert isinstance(found["estimator_goals"], pd.DataFrame)
