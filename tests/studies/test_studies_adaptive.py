"""The study of adaptive against uniform meshes: what it computes from its runs, and that it runs."""

import json

import numpy as np
import pandas as pd
import pytest
from study_scripts import load

import adaptmg as am

cases = load("adaptive_cases")
runs = load("adaptive_runs")
pays = load("adaptive_pays")
made_tables = load("adaptive_tables")
study = load("adaptive_vs_uniform")
front = load("front")


@pytest.mark.parametrize("name", list(cases.CASES))
def test_cases_are_posed_and_measured(name):
    case = cases.CASES[name]
    problem = case.problem()
    assert problem.dim == case.dim
    hierarchy = am.Hierarchy.graded(problem, case.start[:1], case.start[1])
    result = am.solve(hierarchy, am.ActiveSet())
    # a point, a force and a pressure that come out zero would make relative errors meaningless
    assert (np.abs(cases.displacements(case, result)) > 1e-8).all() and abs(case.force[1](result)) > 1.0
    where = case.compared(result.contact.x)
    assert where.any()
    places = result.contact.x[where & (result.contact.boundary == 0)]
    expected = result.contact.pressure[where & (result.contact.boundary == 0)]
    assert cases.pressure_at(result, places) == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_a_reference_comes_back_from_its_row():
    row = runs.reference("upset block", 400)
    against = runs.yardstick("upset block", row)
    assert against.nodes == row["reached"] <= 400 and against.energy.energy == row["energy"]
    runs.YARDSTICKS["upset block", 400] = against
    meshes = json.loads(runs.family("upset block", "residual, bisected", 100, 400)["meshes"])
    assert [mesh["nodes"] for mesh in meshes] == sorted(mesh["nodes"] for mesh in meshes)
    assert (np.diff([mesh["energy_error"] for mesh in meshes]) < 0).all()
    assert (np.diff([mesh["cpu"] for mesh in meshes]) > 0).all()


def test_errors_are_found_between_meshes_and_beyond():
    group = pd.DataFrame({"nodes": [100, 400, 1600], "energy_error": [0.4, 0.2, 0.1], "cpu": [1.0, 4.0, 16.0]})
    value, beyond = pays.at_error(group, 0.1 * np.sqrt(2), "nodes")
    assert value == pytest.approx(800) and not beyond
    value, beyond = pays.at_error(group, 0.05, "cpu")
    assert value == pytest.approx(64) and beyond and np.isnan(pays.at_error(group, 0.5, "nodes")[0])
    assert made_tables.rate(group) == pytest.approx(0.5)
    # two meshes have no rate, and nothing is continued from them
    assert np.isnan(made_tables.rate(group[1:])) and np.isnan(pays.at_error(group[1:], 0.05, "cpu")[0])


def made_rows(case="flat punch", factor=1.0, finest=0.01):
    """Uniform meshes with error ~ time^-1/2 from 1 s on, loops with error ~ 1 / time: equal at an error of .1."""
    parts = []
    for family, power, start in (("uniform", -0.5, 1.0), *((name, -1.0, factor) for name in runs.DEFAULT)):
        error = np.geomspace(0.2, finest, 5)
        cpu = start * (error / 0.1) ** (1 / power)
        parts.append(pd.DataFrame({"case": case, "family": family, "energy_error": error, "cpu": cpu,
                                   "nodes": 100 * cpu, "work_units": 5.0, "nonzeros": 1000.0}))
    return pd.concat(parts, ignore_index=True)


def test_the_crossing_is_found():
    rows = made_rows()
    uniform, group = (rows[rows["family"] == family] for family in ("uniform", runs.DEFAULT[0]))
    found = pays.crossing(uniform, group)
    assert found.error == pytest.approx(0.1, rel=0.02) and not found.throughout
    assert not pays.crossing(group, uniform).found
    quick = group.assign(cpu=0.01 * group["cpu"])
    assert pays.crossing(uniform, quick) == pays.Crossing(0.2, throughout=True)
    # nothing to compare
    assert not pays.crossing(uniform, group.assign(energy_error=group["energy_error"] + 1)).found


@pytest.mark.slow
def test_adaptive_against_uniform(tables):
    found = tables("adaptive_vs_uniform")
    rates = found["adaptive_rates"].set_index("problem")
    for family in runs.DEFAULT:
        assert (rates[family] > 0.47).all()
    assert rates.loc["upset block", "uniform"] == pytest.approx(0.39, abs=0.04)
    # three nested meshes of the punch, not two, have a rate
    assert rates.loc["flat punch", "uniform"] == pytest.approx(0.25, abs=0.04)
    meshes = found["adaptive_meshes"]
    assert (meshes["status"] == "CONVERGED").all() and (found["adaptive_gains"]["energy"] > 1.1).all()
    paying = found["adaptive_pays"].set_index("problem")
    assert list(paying.index) == list(study.QUICK_CASES)
    assert (paying[["nodes, bisected", "nodes, remeshed"]] > 1.5).all(axis=None)
    # errors, and so the order of nodes, do not depend on the machine
    assert paying["nodes, bisected"].idxmax() == "flat punch"
    line = front.adaptive(found)
    assert all(f"{problem}" in line.text for problem in paying.index[(paying["bisected pays below"] != "no")])
    assert not next(iter(found.values())).isna().any(axis=None)
