"""The study of the kernels runs, writes what it returns, and its kernels do what it times."""

from __future__ import annotations

import csv
import importlib.util
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def study():
    path = Path(__file__).parents[1] / "studies" / "kernels.py"
    spec = importlib.util.spec_from_file_location("kernels_study", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_bytes_are_counted_by_hand(study):
    """3 x 3 nodes in 2D: 9 + 2 * 16 blocks of 4 doubles and an index, 9 rows."""
    calls = study.sweep_calls(study.elastic_system(2, 2))
    matrix = 41 * (4 * 8 + 4) + 10 * 4
    vector = 18 * 8
    assert calls["residual"][1] == matrix + 3 * vector
    assert calls["sweep forward"][1] == matrix + 3 * vector + 9 * 4 * 8 + 9 * 4
    for call, _ in calls.values():
        call()


@pytest.mark.slow
def test_quick_run(study, tmp_path):
    rows = study.run(quick=True, out=tmp_path / "results")
    assert {(row["dim"], row["kernel"]) for row in rows} >= {(2, "sweep forward"), (3, "sweep backward")}
    assert all(row["ratio"] > 0 for row in rows)
    with open(tmp_path / "results" / "kernels.csv", encoding="utf-8") as file:
        stored = list(csv.DictReader(file))
    assert [float(row["seconds"]) for row in stored] == [row["seconds"] for row in rows]
