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
tables = load("adaptive_tables")
study = load("adaptive_vs_uniform")


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
    value, beyond = tables.at_error(group, 0.1 * np.sqrt(2), "nodes")
    assert value == pytest.approx(800)
    assert not beyond
    value, beyond = tables.at_error(group, 0.05, "cpu")
    assert value == pytest.approx(64)
    assert beyond
    assert np.isnan(tables.at_error(group, 0.5, "nodes")[0])
    assert tables.rate(group) == pytest.approx(0.5)


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
    rates = found["adaptive_rates"].set_index("case")
    plane = [name for name, case in cases.CASES.items() if case.dim == 2 and name != "bolted junction"]
    for family in ("residual, remeshed", "residual, bisected", "recovery, remeshed"):
        assert (rates.loc[plane, family] > 0.47).all()
    assert rates.loc["upset block", "uniform"] == pytest.approx(0.39, abs=0.04)
    meshes = found["adaptive_meshes"]
    assert (meshes["status"] == "CONVERGED").all()
    gains = found["adaptive_gains"]
    adaptive = gains[~gains["meshes"].isin(["graded by hand"]) & gains["case"].isin(plane)]
    # none on the flat punch, where the coarsest uniform mesh is finer than the others get in a quick run
    assert (adaptive["energy"].dropna() > 1.1).all()
    assert len(adaptive["energy"].dropna()) == 12
