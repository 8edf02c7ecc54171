"""The study of the dovetail: a quick run end to end, and what must hold of what it measures."""

from __future__ import annotations

import numpy as np
import pytest
from study_scripts import load

import adaptmg as am

common = load("common")
dovetail, history, sweeps = load("dovetail"), load("dovetail_history"), load("dovetail_sweeps")
pictures = load("dovetail_pictures")


def test_grids_of_a_chain_end_at_the_same_mesh():
    two, one = dovetail.chain(1, 2), dovetail.chain(1, 1)
    assert len(two) == 2 and len(one) == 1 and two.finest.mesh.points == pytest.approx(one.finest.mesh.points, abs=0)


def test_zone_ends_lie_half_way_between_nodes():
    result = am.solve(dovetail.chain(1, 2), am.FullMultigrid())
    found = sweeps.zones(result)
    on = pictures.on_flank(result)
    depth = np.sort(-result.contact.x[on, 1])
    middles = 0.5 * (depth[1:] + depth[:-1])
    assert np.abs(middles - found["open_to"]).min() < 1e-12
    assert 0 < found["open_to"] < found["stick_from"] < found["stick_to"] <= 13e-3 + 1e-9


def test_energy_errors_are_those_of_relative_coordinates():
    grids = dovetail.chain(1, 2)
    exact = dovetail.exact(1)
    rough = am.solve(grids, am.FullMultigrid(max_cycles=3), reference=exact, throw=False)
    assert common.energy_error(rough, exact, grids) == pytest.approx(rough.history["true_error"][-1], rel=0.9)
    assert common.energy_error(exact, exact, grids) == 0.0


@pytest.mark.slow
def test_a_quick_run(quick, tables):
    figures = {f"dovetail_{name}" for name in ("deformed", "stress", "flank", "hysteresis")}
    assert figures <= set(quick("dovetail", True))
    tables = tables("dovetail", True)
    # several grids beat one
    frame = tables["dovetail_grids"].set_index("method")
    plain = frame.loc["one grid, omega 1"]
    assert plain["status"] == "LIMIT" and plain["true error"] > 1e-2
    several = frame[~frame.index.str.startswith("one grid")]
    assert (several["status"] == "CONVERGED").all() and (several["true error"] < 1e-6).all()
    truncated = several[several.index.str.endswith("truncated")]
    assert (truncated["over best one grid"] > 2).all()
    assert truncated["work"].max() < several.drop(truncated.index)["work"].min()
    # more smoothing needs fewer cycles
    frame = tables["dovetail_smoothing"]
    pre = frame[frame["post"] == 0].sort_values("pre")
    assert (np.diff(pre["cycles"]) < 0).all()
    local = tables["dovetail_local"].groupby("interface sweeps")["cycles"].max()
    assert local[2] < 0.6 * local[0]
    # the full start pays
    frame = tables["dovetail_start"]
    assert (frame["zero over full"].dropna() > 1).all()
    # friction
    frame = tables["dovetail_friction"]
    assert (frame["status"] == "CONVERGED").all() and (frame["rate"] <= 0.5).all()
    assert (np.diff(frame["lift"]) < 0).all()
    assert np.isnan(frame["stick from"].iloc[0]) and frame["stick from"].notna().iloc[-1]
    assert frame["cycles"].max() <= 12
    # two methods agree and forces balance
    row = tables["dovetail_agreement"].iloc[0]
    assert row["converged"] == row["active set converged"] == row["joints"]
    assert row["difference"] < 1e-8 and row["states that differ"] == 0
    assert row["force error"] < 1e-7 and row["slave + master"] < 1e-12
    # beside one body
    frame = tables["dovetail_one_body"]
    assert (frame["over one body"].dropna() < 3).all() and (frame["rate"] <= 0.5).all()
    # history
    frame = tables["dovetail_history"]
    assert (frame["status"] == "CONVERGED").all()
    up, down = frame["lift"][:11].to_numpy(), frame["lift"][10:].to_numpy()[::-1]
    assert (np.diff(up) > 0).all() and (np.diff(down) > 0).all()
    # friction holds back on both ways
    assert (down[1:-1] > up[1:-1]).all() and tables["dovetail_steps"]["all converged"].all()
    # ten steps cost less than ten times one
    frame = tables["dovetail_history_cost"]
    assert frame["complete"].all() and (frame["work ratio"] < 10).all()
