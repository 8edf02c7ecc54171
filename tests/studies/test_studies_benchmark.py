"""The benchmark and the robustness campaign: they run, and what they measure holds."""

import numpy as np
import pandas as pd
import pytest
from study_scripts import load

rivals = load("linear_rivals")
benchmark = load("benchmark")
robustness = load("robustness")
true_errors = load("true_errors")


def test_exponent_of_a_power():
    nodes = np.array([1e3, 1e4, 1e5])
    slope, error = benchmark.shown.exponent(nodes, 3 * nodes**1.02)
    assert slope == pytest.approx(1.02) and error == pytest.approx(0, abs=1e-12)
    # a line through two points is no fit
    assert np.isnan(benchmark.shown.exponent([10, 20], [1, 2])[0])


def test_a_row_of_the_benchmark():
    row = benchmark.measure("nested 2D", 16, 1.0, 1, True)
    assert row["nodes"] == 289 and row["cycles"] <= 12 and row["work"] < row["full_passes"]
    assert 0 < row["start_work"] < row["work"]
    assert row["over_mgcg"] > 0 and row["over_pyamg"] > 0 and row["best_setting"] in rivals.SETTINGS


def test_full_passes_by_hand():
    hierarchy = benchmark.grids("nested 2D", 16, 1.0)
    record, outcome, _ = benchmark.run_ours(hierarchy, 1e-8)
    coarse, fine = (level.matrix.nnz for level in hierarchy.levels[1:])
    middle_and_finest = 2 * (outcome.cycles + 1) + 5 * outcome.cycles * coarse / fine
    start = 2 * coarse / fine
    assert benchmark.full_passes(record, hierarchy) >= middle_and_finest + start
    assert benchmark.full_passes(record, hierarchy) <= middle_and_finest + start + 2


def test_rivals_reach_the_tolerance():
    problem = rivals.glued(benchmark.grids("nested 2D", 16, 1.0))
    exact = np.linalg.solve(problem.matrix.toarray(), problem.load)
    for precondition in (rivals.geometric_preconditioner(problem)[0], rivals.pyamg_preconditioner(problem, "defaults")):
        count = rivals.iterations_needed(problem, precondition)
        x, _ = rivals.conjugate_gradients(problem.matrix, problem.load, precondition, count)
        error = x - exact
        assert error @ problem.matrix @ error <= 1.01e-16 * (exact @ problem.matrix @ exact) and count < 40


def test_random_cases_are_solved():
    rows = [robustness.solve_case(seed) for seed in range(4)] + [robustness.solve_pair(seed) for seed in range(2)]
    for row in rows:
        assert row["nested_status"] == row["cold_status"] == "CONVERGED"
        assert max(row["nested_residual"], row["cold_residual"]) <= robustness.RESIDUAL


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


@pytest.mark.slow
def test_converged_means_what_it_says():
    table = true_errors.outcomes(pd.DataFrame([true_errors.measure(seed, "compact") for seed in (1, 4, 10)]))
    assert (table["wrong"] == 0).all() and table["converged"].sum() >= 25


@pytest.mark.slow
@pytest.mark.parametrize("name", ["benchmark", "robustness"])
def test_quick_runs(quick, name):
    assert len(quick(name)) >= 2
