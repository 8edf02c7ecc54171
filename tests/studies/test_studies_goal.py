"""The study of goal-oriented meshes: what its numbers mean, and that it runs."""

import numpy as np
import pytest
from study_scripts import load

study = load("goal_greco")


def test_the_nodes_needed_are_those_after_the_last_large_error():
    nodes = np.array([10, 20, 40, 80])
    assert study.needed(nodes, np.array([1.0, 1e-4, 1e-3, 1e-4])) == 80 and study.needed(nodes, np.full(4, 1e-4)) == 10
    assert np.isnan(study.needed(nodes, np.full(4, 1e-3)))


@pytest.mark.slow
def test_quick_run(quick, tables):
    tables = tables("goal_greco")
    summary = tables["goal_greco_summary"].set_index("meshes")
    assert summary["median"]["goal"] < 1000 and summary["median"]["goal"] < summary["median"]["residual"]
    assert summary["error times nodes"]["goal"] < 0.7 * summary["error times nodes"]["residual"]
    between = tables["goal_greco_quantities"]["effectivity"].dropna()
    assert between.between(0.4, 1.2).all() and "goal_greco_errors" in quick("goal_greco")
