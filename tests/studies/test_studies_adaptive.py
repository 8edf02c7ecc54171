"""The study of adaptive against uniform meshes: what it computes from its runs, and that it runs."""

import json
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from study_scripts import load

import adaptmg as am

common = load("common")
cases = load("adaptive_cases")
runs = load("adaptive_runs")
pays = load("adaptive_pays")
tables = load("adaptive_tables")
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
    assert (np.abs(cases.displacements(case, result)) > 1e-8).all()
    assert abs(case.force[1](result)) > 1.0
    where = case.compared(result.contact.x)
    assert where.any()
    places = result.contact.x[where & (result.contact.boundary == 0)]
    expected = result.contact.pressure[where & (result.contact.boundary == 0)]
    assert cases.pressure_at(result, places) == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_zone_ends_lie_between_nodes_of_different_state():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), (4, 8, 16))
    ends = cases.zone_ends(am.solve(grids))
    h = 40e-3 / 16
    assert len(ends) == 2
    for found, end in zip(ends, (3.32e-3, 29.86e-3), strict=True):
        assert (found / h) % 1 == pytest.approx(0.5)
        assert abs(found - end) <= h


def test_uniform_meshes_are_nested_and_pose_the_problem():
    for name in ("dovetail", "flat punch", "upset block"):
        problem = cases.CASES[name].problem()
        meshes = cases.uniform_meshes(cases.CASES[name], problem, 3)
        assert len(meshes) >= 2
        for coarse, fine in pairwise(meshes):
            assert len(fine.elements) == 4 * len(coarse.elements)
            known = {tuple(point) for point in np.round(fine.points, 12)}
            assert {tuple(point) for point in np.round(coarse.points, 12)} <= known


def test_a_reference_comes_back_from_its_row():
    row = runs.reference("upset block", 400)
    against = runs.yardstick("upset block", row)
    assert against.nodes == row["reached"] <= 400
    assert against.energy.energy == row["energy"]
    runs.YARDSTICKS["upset block", 400] = against
    meshes = json.loads(runs.family("upset block", "residual, bisected", 100, 400)["meshes"])
    assert [mesh["nodes"] for mesh in meshes] == sorted(mesh["nodes"] for mesh in meshes)
    assert (np.diff([mesh["energy_error"] for mesh in meshes]) < 0).all()
    assert (np.diff([mesh["cpu"] for mesh in meshes]) > 0).all()


def test_errors_are_found_between_meshes_and_beyond():
    group = pd.DataFrame({"nodes": [100, 400, 1600], "energy_error": [0.4, 0.2, 0.1], "cpu": [1.0, 4.0, 16.0]})
    value, beyond = pays.at_error(group, 0.1 * np.sqrt(2), "nodes")
    assert value == pytest.approx(800)
    assert not beyond
    value, beyond = pays.at_error(group, 0.05, "cpu")
    assert value == pytest.approx(64)
    assert beyond
    assert np.isnan(pays.at_error(group, 0.5, "nodes")[0])
    assert tables.rate(group) == pytest.approx(0.5)
    # two meshes have no rate, and nothing is continued from them
    assert np.isnan(tables.rate(group[1:]))
    assert np.isnan(pays.at_error(group[1:], 0.05, "cpu")[0])


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
    assert found.error == pytest.approx(0.1, rel=0.02)
    assert not found.throughout
    assert not pays.crossing(group, uniform).found
    quick = group.assign(cpu=0.01 * group["cpu"])
    assert pays.crossing(uniform, quick) == pays.Crossing(0.2, throughout=True)
    # nothing to compare
    assert not pays.crossing(uniform, group.assign(energy_error=group["energy_error"] + 1)).found


def test_gains_say_where_uniform_meshes_are_extrapolated():
    rows = made_rows()
    keep = (rows["family"] != "uniform") | (rows["energy_error"] > 0.04)
    gains = pays.gains(rows[keep])
    loop = gains[rows[keep]["family"] == runs.DEFAULT[1]]
    error = np.geomspace(0.2, 0.01, 5)
    assert loop["time"].to_numpy(float) == pytest.approx(0.1 / error)
    assert loop["beyond"].tolist() == list(error < 0.04)
    assert gains[rows[keep]["family"] == "uniform"]["time"].isna().all()


def test_what_is_said_of_who_is_quicker_is_true_for_its_rows():
    rows = pd.concat([made_rows(), made_rows("GRECO bar", factor=100.0)], ignore_index=True)
    frame = pays.pays_table(rows).frame.set_index("problem")
    assert frame.loc["flat punch", "time, bisected"] == pytest.approx(10.0, rel=0.01)
    assert frame["bisected pays below"].tolist() == ["10", "no"]
    said = pays.summary(rows)
    assert "bisected they are quicker than uniform ones in 1 of 2 problems, 10 times, with 10 times fewer nodes" in said
    assert ("Bisected, they pay below 10 % (flat punch); uniform meshes are quicker on, by factors: "
            "GRECO bar (10).") in said
    assert "slow uniform meshes down (flat punch)" in said
    alone = pays.summary(made_rows("GRECO bar", factor=100.0))
    assert "bisected they are quicker than uniform ones in 0 of 1 problems;" in alone
    assert "Bisected, uniform meshes are quicker on, by factors: GRECO bar (10). Remeshed by Netgen" in alone
    assert "singular" not in alone.lower()
    assert "20 % or more (flat punch)" in pays.summary(made_rows(factor=0.1))


def test_the_cost_is_asked_for_at_an_error_that_loops_reach():
    assert tables.common_error(made_rows("flat punch")) == tables.WANTED["flat punch"]
    assert tables.common_error(made_rows("flat punch", finest=0.05)) == pytest.approx(0.05)
    cost = tables.cost_table(made_rows()).frame.set_index("meshes")
    assert cost["how"].tolist() == ["measured"] * 3
    assert cost.loc[runs.DEFAULT[0], "time, uniform over these"] == pytest.approx(4.0)


def test_the_gain_is_that_at_equal_nodes():
    uniform = pd.DataFrame({"nodes": [100, 10_000], "energy_error": [1.0, 0.01]})
    group = pd.DataFrame({"nodes": [1000, 5], "energy_error": [0.05, 0.5]})
    assert tables.gain(group, uniform, "energy_error") == pytest.approx(2.0)


@pytest.mark.slow
def test_adaptive_against_uniform(tmp_path):
    section = study.run(common.Context(quick=True, out=tmp_path))
    common.show(section, tmp_path)
    written = {item.name: tmp_path / f"{item.name}.{'csv' if isinstance(item, common.Table) else 'png'}"
               for item in section.items}
    assert all(path.stat().st_size > 100 for path in written.values())
    found = {item.name: item.frame for item in section.items if isinstance(item, common.Table)}
    rates = found["adaptive_rates"].set_index("problem")
    for family in runs.DEFAULT:
        assert (rates[family] > 0.47).all()
    assert rates.loc["upset block", "uniform"] == pytest.approx(0.39, abs=0.04)
    # three nested meshes of the punch, not two, have a rate
    assert rates.loc["flat punch", "uniform"] == pytest.approx(0.25, abs=0.04)
    meshes = found["adaptive_meshes"]
    assert (meshes["status"] == "CONVERGED").all()
    assert (found["adaptive_gains"]["energy"] > 1.1).all()
    paying = found["adaptive_pays"].set_index("problem")
    assert list(paying.index) == list(study.QUICK_CASES)
    assert (paying[["nodes, bisected", "nodes, remeshed"]] > 1.5).all(axis=None)
    # errors, and so the order of nodes, do not depend on the machine
    assert paying["nodes, bisected"].idxmax() == "flat punch"
    line = front.adaptive(found)
    assert all(f"{problem}" in line.text for problem in paying.index[(paying["bisected pays below"] != "no")])
    assert not section.items[0].frame.isna().any(axis=None)
