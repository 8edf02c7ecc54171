"""The study of the bolted junction: it runs, and what it measures holds."""

import numpy as np
import pandas as pd
import pytest
from study_scripts import load

import adaptmg as am
from adaptmg.cases import Flanges

grids = load("bolted_grids")
pressure = load("bolted_pressure")
sector = load("bolted_sector")


def test_where_a_curve_falls_below_zero():
    x = np.array([0.0, 1.0, 2.0, 4.0])
    assert pressure.falls_below_zero(x, np.array([3.0, 1.0, -1.0, -9.0])) == pytest.approx(1.5)
    assert np.isnan(pressure.falls_below_zero(x, np.ones(4))) and np.isnan(pressure.falls_below_zero(x, -np.ones(4)))


def test_limits_are_read_off_between_the_steps():
    flanges = Flanges()
    rows = pd.DataFrame({"pressure": [0.0, 2e6, 4e6], "seal": [8e6, 6e6, 0.0], "open_to": [0.2, 0.23, 0.25],
                         "bolts": [2.5e6, 2.5e6, 2.6e6], "opening": [0.0, 1e-6, 3e-6]})
    found = pressure.limits(rows, flanges)
    # seal - p falls from 4 MPa to -4 MPa between 2 and 4 MPa
    assert found["leak"] == pytest.approx(3e6) and found["open"] == pytest.approx(3e6)
    assert found["bolts at leak"] == pytest.approx(2.55e6) and found["opening at leak"] == pytest.approx(2e-6)


def test_meshes_are_shared_and_friction_is_not():
    one, two = grids.chain("ring", 1, 2), grids.chain("ring", 1, 1, 0.4)
    assert one.finest.mesh is two.finest.mesh
    assert grids.nodes_of(one) == f"{one.levels[1].n_nodes}/{one.levels[0].n_nodes}"
    assert set(np.unique(one.finest.discrete.law.friction)) == {0.0, 0.2}
    assert set(np.unique(two.finest.discrete.law.friction)) == {0.0, 0.4}
    assert grids.chain("bar", 0, 1).problem.name != one.problem.name


def test_paths_by_multigrid_and_by_the_active_set_method_agree():
    steps = (2e6, 6e6)
    path = pressure.history("ring", 1, steps)
    problem = grids.chain("ring", 1, 1).problem
    exact = am.solve_path(grids.chain("ring", 1, 1), am.cases.junction_path(problem, steps), am.ActiveSet())
    rows, expected = (pressure.read_off(p, steps, Flanges()) for p in (path, exact))
    for name in ("bolts", "joint", "opening"):
        assert rows[name].to_numpy() == pytest.approx(expected[name].to_numpy(), rel=1e-5, abs=1e-11)
    assert (rows["joint"] + rows["thrust"]).to_numpy() == pytest.approx(rows["bolts"].to_numpy(), rel=1e-6)


@pytest.mark.slow
def test_bolted_junction(tables):
    tables = tables("bolted_junction", True)
    counts = tables["bolted_grids"].set_index("method")
    several = counts[~counts.index.str.startswith("one grid")]
    assert (several["status"] == "CONVERGED").all() and (several["true error"] < 1e-6).all()
    assert counts.loc["three grids, truncated", "over best one grid"] > 2
    cost = tables["bolted_cost"]
    assert (cost["difference"] < 1e-8).all() and (cost["rate"] < 0.5).all() and (cost["over one body"] < 2.3).all()
    starts = tables["bolted_start"].set_index(["mode", "start"])
    assert starts.loc[("three grids, truncated", "full"), "zero over full"] > 1
    leaks = tables["bolted_leak"]
    assert np.ptp(leaks.loc[leaks["bolts as"] == "ring", "leaks at / preload"]) < 1e-3
    assert (leaks["leaks at"] < leaks["open to bolts at"]).all()
    steps = tables["bolted_steps"]
    difference = steps["joint force"] + steps["thrust"] - steps["bolt force"]
    assert difference.abs().max() < 1e-6 * 2.5
    # prying: in the end the bolts take more than the further thrust
    assert np.diff(steps["bolt force"])[-1] > np.diff(steps["thrust"])[-1]
