"""The studies of the paper's three tables: quick runs end to end, and what must hold of what they measure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from study_scripts import load

grid_count, smoothing_count, full_multigrid = load("grid_count"), load("smoothing_count"), load("full_multigrid")
paper_runs, common, front = load("paper_runs"), load("common"), load("front")


def quick(module, out: Path) -> dict:
    """Run, print and write; the tables by name, and the directory."""
    section = module.run(common.Context(True, out))
    common.show(section, out, pictures=False)
    assert section.title and section.summary
    assert all((out / f"{item.name}.csv").stat().st_size > 100 for item in section.items
               if isinstance(item, common.Table))
    return {item.name: item for item in section.items}


@pytest.fixture(scope="module")
def grid_items(tmp_path_factory):
    return quick(grid_count, tmp_path_factory.mktemp("grid_count"))


@pytest.fixture(scope="module")
def smoothing_items(tmp_path_factory):
    return quick(smoothing_count, tmp_path_factory.mktemp("smoothing_count"))


@pytest.fixture(scope="module")
def start_items(tmp_path_factory):
    return quick(full_multigrid, tmp_path_factory.mktemp("full_multigrid"))


def rows(frame: pd.DataFrame, **values) -> pd.DataFrame:
    """Rows in which the columns have these values; at least one."""
    for name, value in values.items():
        frame = frame[frame[name] == value]
    assert len(frame)
    return frame


@pytest.mark.slow
class TestGridCount:
    def test_four_grids_gain_at_least_what_the_paper_reports(self, grid_items):
        frame = grid_items["grid_count"].frame
        four = frame[frame["method"].str.startswith("four grids") & ~frame["method"].str.contains("1e-4")]
        assert len(four) >= 5 and (four["gain"] >= 27).all()

    def test_every_run_reaches_the_error_that_is_compared(self, grid_items):
        frame = grid_items["grid_count"].frame
        assert frame["work"].notna().all() and (frame["true error"] <= paper_runs.TARGET).all()
        assert (frame["natural residual"] <= 1e-5).all() and (frame["status"] == "CONVERGED").all()

    def test_more_grids_need_less_work(self, grid_items):
        frame = grid_items["grid_count"].frame.set_index("method")["work"]
        works = [frame[f"{count} grids, complete to 1e-2"] for count in ("two", "three", "four")]
        assert works[0] > works[1] > works[2]

    def test_the_paper_stands_beside_ours(self, grid_items):
        frame = grid_items["grid_count"].frame
        assert rows(frame, grids="1089/289/81/25")["paper speed-up"].between(27, 28).all()
        assert frame["paper CPU"].iloc[0] == "12h" and frame["paper CPU"].iloc[1:4].isna().all()

    def test_the_paper_mode_stalls_where_the_monotone_mode_does_not(self, grid_items):
        frame = grid_items["grid_count_own_test"].frame
        stalled, good = rows(frame, correction="paper"), rows(frame, correction="monotone")
        assert (stalled["true error"] > 100 * paper_runs.TARGET).all() and (stalled["status"] == "STALLED").all()
        assert (good["true error"] < 1e-5).all()

    def test_the_stall_grows_as_the_coarsest_grid_gets_coarser(self, grid_items):
        frame = grid_items["coarsest_grid"].frame
        stalled = rows(frame, correction="paper").sort_values("levels")
        assert (np.diff(stalled["true error"]) > 0).all() and (stalled["last change"] <= 1e-10).all()
        assert (rows(frame, correction="monotone")["true error"] < 1e-8).all()

    def test_of_the_variants_the_monotone_choices_converge_and_the_literal_ones_do_not(self, grid_items):
        frame = grid_items["correction_variants"].frame
        assert rows(frame, gap="smallest", slip="minmod", limit="summed")["verdict"].item() == "converges"
        for gap in ("smallest", "largest"):
            assert rows(frame, gap=gap, slip="initial", limit="initial")["verdict"].item() != "converges"
        assert (rows(frame, limit="injected")["true error"] > 1e-2).all()

    def test_the_cycles_converge_on_nested_and_independent_meshes(self, grid_items):
        frame = grid_items["cycle_rates"].frame
        assert (frame["status"] == "CONVERGED").all() and (frame["rate"] < 0.85).all()
        assert set(frame["meshes"]) == {"nested", "independent, h/2", "independent, h/1.7"}
        assert (rows(frame, meshes="nested")["mesh ratio"].round(6) == 2).all()

    def test_the_ways_are_drawn(self, grid_items):
        assert len(grid_items["grid_count_paths"].figure.axes) == 4


@pytest.mark.slow
class TestSmoothingCount:
    def test_the_full_start_solves_the_patch_test(self, smoothing_items):
        frame = smoothing_items["smoothing_count_all"].frame
        patch = rows(frame, problem="frictionless bar", start="full")
        assert (patch[[str(n) for n in smoothing_count.SMOOTHINGS]] <= 1).all(axis=None)
        assert (patch["true error"] < 1e-7).all()

    def test_with_tight_coarse_solves_smoothing_never_costs_cycles_from_zero(self, smoothing_items):
        frame = rows(smoothing_items["smoothing_count_all"].frame, start="zero")
        tight = rows(frame, **{"coarse solve": "error 1e-8"})[[str(n) for n in smoothing_count.SMOOTHINGS]]
        assert (np.diff(tight.to_numpy(), axis=1) <= 0).all()

    def test_the_counts_rise_with_coarse_solves_as_loose_as_the_outer_test(self, smoothing_items):
        frame = rows(smoothing_items["smoothing_count"].frame, start="zero")
        loose = rows(frame, **{"coarse solve": "change 1 x outer"})["cycles"]
        assert loose.iloc[-1] > loose.min()

    def test_the_paper_stands_beside_ours(self, smoothing_items):
        frame = rows(smoothing_items["smoothing_count"].frame, start="zero", **{"coarse solve": "error 1e-8"})
        assert frame["paper iterations"].iloc[:4].tolist() == [12, 8, 8, 10]
        assert frame["cycles"].iloc[0] == 12

    def test_the_test_on_the_change_does_not_see_the_stall(self, smoothing_items):
        frame = rows(smoothing_items["smoothing_count_all"].frame, problem="Coulomb bar",
                     **{"coarse solve": "error 1e-8"})
        assert (rows(frame, correction="paper")["true error"] > 1e-3).all()
        assert (rows(frame, correction="monotone")["true error"] < 1e-5).all()

    def test_over_relaxation_is_not_needed_inside_two_grids(self, smoothing_items):
        frame = smoothing_items["smoother_omega"].frame
        for problem in ("curved obstacle", "Coulomb bar"):
            part = rows(frame, problem=problem).set_index("omega")["over omega 1"]
            assert part.min() > 0.8 and part[1.8] > 1.5

    def test_a_second_run_computes_nothing_and_says_the_same(self, tmp_path):
        context = common.Context(True, tmp_path)
        fixed = {"smoothings": 2, "rtol": 1e-3, "max_cycles": 5, "target": 1e-2, "times": 1}
        grid = {"problem": ["Coulomb bar"], "omega": [1.0, 1.2]}
        first, again = (context.study(smoothing_count.relaxed, grid, **fixed) for _ in range(2))
        pd.testing.assert_frame_equal(first, again)


@pytest.mark.slow
class TestFullMultigrid:
    def test_two_grids_beat_the_regular_resolution_in_work(self, start_items):
        frame = start_items["full_multigrid"].frame
        assert len(frame) == 3 * (2 + 2 * 6)
        alone = frame["method"] == "regular resolution"
        assert (frame["speed-up"][alone] == 1).all() and (frame["speed-up"][~alone] > 3).all()

    def test_the_full_start_helps_where_the_coarse_solution_is_exact(self, start_items):
        frame = rows(start_items["full_multigrid"].frame, problem="frictionless bar")
        zero, full = (rows(frame, method=f"two grids, {kind} start")["work"].to_numpy() for kind in ("zero", "full"))
        assert (zero > 1.5 * full).all()

    def test_the_paper_stands_beside_ours(self, start_items):
        frame = start_items["table3"].frame
        assert frame["paper"].round(1).tolist() == [1.0, 2.2, 4.6] and frame["paper CPU"].tolist() == [
            "24'", "11'", "5'10\""]
        assert (frame.drop(columns=["method", "grids", "paper CPU"]).iloc[0] == 1).all()

    def test_a_start_and_one_cycle_reach_the_discretisation_error(self, start_items):
        frame = start_items["nested_start"].frame
        full = frame[frame["start"] != "zero"]
        assert (full["after one cycle more"] < full["discretisation"]).all()
        deep = full[full["grids"].str.startswith("4225/")]
        assert len(deep) and (deep["start work"] < 8).all()

    def test_the_start_is_not_in_the_work_from_zero(self, start_items):
        frame = start_items["nested_start"].frame
        assert rows(frame, start="zero")["start work"].isna().all()
        assert (frame["zero over this"][frame["start"] != "zero"] > 1).all()


@pytest.mark.slow
@pytest.mark.parametrize(("place", "items"), [("grids", "grid_items"), ("smoothings", "smoothing_items"),
                                              ("starts", "start_items")])
def test_the_first_screen_of_the_report_finds_its_tables(place, items, request):
    frames = {name: item.frame for name, item in request.getfixturevalue(items).items()
              if isinstance(item, common.Table)}
    shown = front.PLACES[place].make(frames).item.frame
    assert 3 <= len(shown) <= 5 and 3 <= len(shown.columns) <= 5 and shown["paper"].notna().all()


def test_chain_and_nodes_are_those_of_the_paper():
    assert paper_runs.chain(32, 4) == (4, 8, 16, 32)
    assert paper_runs.nodes_text(paper_runs.chain(32, 4)) == "1089/289/81/25"


@pytest.mark.parametrize(("values", "sentence"), [([], "none"), ([1.0], "1.0"), ([1.0, 2.0], "1.0 and 2.0"),
                                                  (["a", "b", "c"], "a, b and c")])
def test_listed(values, sentence):
    assert paper_runs.listed(values) == sentence


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
