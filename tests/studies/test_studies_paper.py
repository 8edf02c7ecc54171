"""The studies of the paper's three tables: quick runs end to end, and what must hold of what they measure."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from study_scripts import load

smoothing_count = load("smoothing_count")
paper_runs, common, front = load("paper_runs"), load("common"), load("front")


def rows(frame: pd.DataFrame, **values) -> pd.DataFrame:
    """Rows in which the columns have these values; at least one."""
    for name, value in values.items():
        frame = frame[frame[name] == value]
    assert len(frame)
    return frame


@pytest.mark.slow
def test_grid_count(tables):
    tables = tables("grid_count")
    frame = tables["grid_count"]
    # four grids gain at least what the paper reports, and every run reaches the error that is compared
    four = frame[frame["method"].str.startswith("four grids") & ~frame["method"].str.contains("1e-4")]
    assert len(four) >= 5 and (four["gain"] >= 27).all()
    assert frame["work"].notna().all() and (frame["true error"] <= paper_runs.TARGET).all()
    assert (frame["natural residual"] <= 1e-5).all() and (frame["status"] == "CONVERGED").all()
    # the paper stands beside ours
    assert rows(frame, grids="1089/289/81/25")["paper speed-up"].between(27, 28).all()
    assert frame["paper CPU"].iloc[0] == "12h" and frame["paper CPU"].iloc[1:4].isna().all()
    # more grids need less work
    work = frame.set_index("method")["work"]
    assert (np.diff([work[f"{count} grids, complete to 1e-2"] for count in ("two", "three", "four")]) < 0).all()
    # the paper mode stalls where the monotone mode does not, the more the coarser the coarsest grid
    stalled, good = (rows(tables["grid_count_own_test"], correction=name) for name in ("paper", "monotone"))
    assert (stalled["true error"] > 100 * paper_runs.TARGET).all() and (stalled["status"] == "STALLED").all()
    assert (good["true error"] < 1e-5).all()
    stalled = rows(tables["coarsest_grid"], correction="paper").sort_values("levels")
    assert (np.diff(stalled["true error"]) > 0).all() and (stalled["last change"] <= 1e-10).all()
    assert (rows(tables["coarsest_grid"], correction="monotone")["true error"] < 1e-8).all()
    # of the variants the monotone choices converge and the literal ones do not
    frame = tables["correction_variants"]
    assert rows(frame, gap="smallest", slip="minmod", limit="summed")["verdict"].item() == "converges"
    for gap in ("smallest", "largest"):
        assert rows(frame, gap=gap, slip="initial", limit="initial")["verdict"].item() != "converges"
    assert (rows(frame, limit="injected")["true error"] > 1e-2).all()
    # the cycles converge on nested and independent meshes
    frame = tables["cycle_rates"]
    assert (frame["status"] == "CONVERGED").all() and (frame["rate"] < 0.85).all()
    assert set(frame["meshes"]) == {"nested", "independent, h/2", "independent, h/1.7"}
    assert (rows(frame, meshes="nested")["mesh ratio"].round(6) == 2).all()


@pytest.mark.slow
def test_smoothing_count(tables):
    tables = tables("smoothing_count")
    counts, every = [str(n) for n in smoothing_count.SMOOTHINGS], tables["smoothing_count_all"]
    # the full start solves the patch test
    patch = rows(every, problem="frictionless bar", start="full")
    assert (patch[counts] <= 1).all(axis=None) and (patch["true error"] < 1e-7).all()
    # from zero, smoothing never costs cycles with tight coarse solves, but with those as loose as the outer test
    tight = rows(every, start="zero", **{"coarse solve": "error 1e-8"})[counts]
    assert (np.diff(tight.to_numpy(), axis=1) <= 0).all()
    frame = rows(tables["smoothing_count"], start="zero")
    loose = rows(frame, **{"coarse solve": "change 1 x outer"})["cycles"]
    assert loose.iloc[-1] > loose.min()
    # the paper stands beside ours
    frame = rows(frame, **{"coarse solve": "error 1e-8"})
    assert frame["paper iterations"].iloc[:4].tolist() == [12, 8, 8, 10] and frame["cycles"].iloc[0] == 12
    # the test on the change does not see the stall
    frame = rows(every, problem="Coulomb bar", **{"coarse solve": "error 1e-8"})
    assert (rows(frame, correction="paper")["true error"] > 1e-3).all()
    assert (rows(frame, correction="monotone")["true error"] < 1e-5).all()
    # over relaxation is not needed inside two grids
    for problem in ("curved obstacle", "Coulomb bar"):
        part = rows(tables["smoother_omega"], problem=problem).set_index("omega")["over omega 1"]
        assert part.min() > 0.8 and part[1.8] > 1.5


def test_a_second_run_computes_nothing_and_says_the_same(tmp_path):
    context = common.Context(True, tmp_path)
    fixed = {"smoothings": 2, "rtol": 1e-3, "max_cycles": 5, "target": 1e-2, "times": 1}
    grid = {"problem": ["Coulomb bar"], "omega": [1.0, 1.2]}
    first, again = (context.study(smoothing_count.relaxed, grid, **fixed) for _ in range(2))
    pd.testing.assert_frame_equal(first, again)


@pytest.mark.slow
def test_full_multigrid(tables):
    tables = tables("full_multigrid")
    # two grids beat the regular resolution in work
    frame = tables["full_multigrid"]
    alone = frame["method"] == "regular resolution"
    assert len(frame) == 3 * (2 + 2 * 6) and (frame["speed-up"][alone] == 1).all()
    assert (frame["speed-up"][~alone] > 3).all()
    # the full start helps where the coarse solution is exact
    frame = rows(frame, problem="frictionless bar")
    zero, full = (rows(frame, method=f"two grids, {kind} start")["work"].to_numpy() for kind in ("zero", "full"))
    assert (zero > 1.5 * full).all()
    # the paper stands beside ours
    frame = tables["table3"]
    assert frame["paper"].round(1).tolist() == [1.0, 2.2, 4.6]
    assert frame["paper CPU"].tolist() == ["24'", "11'", "5'10\""]
    assert (frame.drop(columns=["method", "grids", "paper CPU"]).iloc[0] == 1).all()
    # a start, which is not in the work from zero, and one cycle reach the discretisation error
    frame = tables["nested_start"]
    assert rows(frame, start="zero")["start work"].isna().all()
    full = frame[frame["start"] != "zero"]
    assert (full["after one cycle more"] < full["discretisation"]).all() and (full["zero over this"] > 1).all()
    assert (rows(full.assign(deep=full["grids"].str.startswith("4225/")), deep=True)["start work"] < 8).all()


@pytest.mark.slow
@pytest.mark.parametrize(("place", "items"), [
    ("grids", "grid_count"), ("smoothings", "smoothing_count"), ("starts", "full_multigrid")])
def test_the_first_screen_of_the_report_finds_its_tables(place, items, tables):
    shown = front.PLACES[place].make(tables(items)).item.frame
    assert 3 <= len(shown) <= 5 and 3 <= len(shown.columns) <= 5 and shown["paper"].notna().all()


def test_measured_says_where_the_target_was_never_reached():
    hierarchy, exact = common.grids("Coulomb bar", (4, 8)), common.exact("Coulomb bar", 8)
    am = paper_runs.am
    row = paper_runs.measured(hierarchy, am.SingleGrid(max_sweeps=20), exact, 1e-6, times=1)
    assert row["outcome"] == "LIMIT" and np.isnan(row["work_at"]) and row["true_error"] > 1e-6
    row = paper_runs.measured(hierarchy, am.FullMultigrid(rtol=1e-8), exact, 1e-6, times=1)
    assert row["outcome"] == "CONVERGED" and row["work_at"] < row["work"] and row["true_error"] < 1e-7


def test_the_discretisation_error_is_halved_with_the_mesh_size():
    coarse, fine = (paper_runs.discretisation_error("curved obstacle", n) for n in (8, 16))
    assert 1.7 < coarse / fine < 2.3
