"""What the studies say of their rows: sentences and tables by hand-made rows, which a run would not easily give."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from study_scripts import load

assembly, shown = load("assembly_tables"), load("benchmark_tables")
robustness, full_start, smoothing = load("robustness"), load("full_multigrid"), load("smoothing_count")


def one_grid(*works: float) -> pd.DataFrame:
    """Runs on one grid, the first with omega 1."""
    return pd.DataFrame({"label": [f"one grid, omega {1 + k / 10:g}" for k in range(len(works))], "work_at": works,
                         "true_error": 0.3, "cycles": 100, "levels": np.nan})


def test_the_best_factor_is_called_the_best_of_those_tried():
    assert assembly.best_of(one_grid(9.0, 5.0, 4.0, 6.0))["label"].item() == "one grid, omega 1.2 (best tried)"
    # a single factor is not the best of anything, and one that got nowhere neither
    assert assembly.best_of(one_grid(9.0, 5.0))["label"].item() == "one grid, omega 1.1"
    assert assembly.best_of(one_grid(9.0, np.nan, np.nan))["label"].item() == "one grid, omega 1.2"


def test_runs_that_do_not_get_there_are_named():
    said = assembly.single_grids(one_grid(np.nan, 5.0))
    assert "omega 1 (3e-01 after 100 sweeps)" in said and "1.1" not in said
    assert assembly.single_grids(one_grid(9.0, 5.0)) == ""


def test_a_summary_has_the_span_of_all_grids():
    several = pd.DataFrame({"label": ["two grids, truncated", "two grids, monotone", "three grids, truncated",
                                      "three grids, monotone"], "work_at": [20.0, 400.0, 30.0, 300.0],
                            "levels": [2, 2, 3, 3]})
    said = assembly.told(pd.concat([one_grid(np.nan, 90.0), several], ignore_index=True))
    assert said.startswith("Two and three grids need 20 to 30 work units") and "300 to 400 in the monotone" in said
    assert "(omega 1.1) 90." in said


def test_scaling_needs_three_large_meshes():
    rows = pd.DataFrame({"family": "nested", "nodes": [1000, 20_000, 80_000], "work": 20.0, "solve_s": [0.1, 2.0, 8.0]})
    assert shown.scaling_table(rows) == []
    more = pd.concat([rows, rows.tail(1).assign(nodes=320_000, solve_s=32.0)], ignore_index=True)
    frame = shown.scaling_table(more)[0].frame
    assert frame["exponent"].to_numpy() == pytest.approx(1.0) and (frame["sizes"] == 3).all()


def test_columns_that_are_empty_are_not_printed():
    rows = pd.DataFrame({"family": ["a"], "nodes": [10], "over_mgcg": [np.nan], "solve_s": [1.0], "seconds": [3.0]})
    table = shown.seconds_table(rows)
    assert list(table.frame) == ["meshes", "nodes", "solve"] and table.units == {"solve": "s"}


def test_a_coarse_solve_with_which_nothing_converges_keeps_its_row():
    lines = [{"problem": "bar", "correction": mode, "start": "zero", "coarse": coarse, "smoothings": n, "cycles": 8,
              "work": 50.0 + n, "run_seconds": 0.1, "true_error": 1e-6, "residual": 1e-6,
              "outcome": "LIMIT" if coarse == "loose" or n == 1 else "CONVERGED"}
             for mode in ("paper", "monotone") for coarse in ("tight", "loose") for n in (1, 2, 3)]
    frame = pd.DataFrame(lines + [line | {"problem": "Coulomb bar"} for line in lines])
    table = smoothing.counts_table(frame)
    assert len(table.frame) == 8 and "16 of 24 runs" in table.note
    tight, loose = (table.frame[table.frame["coarse solve"] == name] for name in ("tight", "loose"))
    assert loose[["1", "2", "3", "least work at"]].isna().all(axis=None) and (loose["status"] == "LIMIT").all()
    assert tight["1"].isna().all() and (tight["2"] == 8).all() and (tight["least work at"] == 2).all()


def campaign(**changed) -> pd.DataFrame:
    """Two problems, of which one is refused."""
    row = {f"{name}_{key}": value for name in ("nested", "cold") for key, value in
           (("status", ["CONVERGED", "REFUSED"]), ("cycles", [12, 0]), ("residual", [1e-9, np.nan]),
            ("fallback", ["", ""]))}
    return pd.DataFrame({"seed": [1, 2], "nested": True, "law": ["Coulomb", "Tresca"], "friction": [0.3, 2.0],
                         "nodes": 100} | row | changed)


def test_a_failure_that_the_status_hides_is_counted_as_silent():
    counts = robustness._outcomes(campaign()).iloc[0]
    assert (counts["refused"], counts["solved"], counts["silent failures"]) == (1, 1, 0)
    counts = robustness._outcomes(campaign(nested_residual=[1e-3, np.nan])).iloc[0]
    assert (counts["solved"], counts["silent failures"]) == (0, 1)
    both = robustness._outcomes(campaign(nested_residual=[1e-3, np.nan])).assign(bodies="one body")
    assert "Silent failures: 1." in robustness.summary(both)


def test_a_coefficient_that_is_not_used_is_not_shown():
    table = robustness._cases("cases", campaign(), {"seed": "seed", "law": "law", "friction": "friction"}, "", "")
    assert table.frame["friction"].tolist()[0] == 0.3 and np.isnan(table.frame["friction"].tolist()[1])
    assert np.isnan(table.frame["cycles, from zero"].tolist()[1])


def test_the_gain_of_a_start_is_taken_at_equal_error():
    frame = pd.DataFrame({"problem": "bar", "stop": "error", "mode": "monotone", "work at 1e-03": [90.0, 30.0, 10.0]})
    assert full_start.gain_of_start(frame, "bar", "monotone", (1e-3,)) == [3.0]
    assert full_start.speed_up(pd.Series([1440.0, 660.0, 310.0])).round(1).tolist() == [1.0, 2.2, 4.6]
