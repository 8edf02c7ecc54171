"""Cycles of the default method on five problems: a change that costs cycles is seen. No seconds."""

import pytest
from study_scripts import load

import adaptmg as am

benchmark = load("benchmark")
#: cycles to an estimated error of 1e-8, from a nested start; one more may be rounding
CYCLES = {
    "bar": 9,
    "block 3D": 12,
    "dovetail": 12,
    "bolted junction": 11,
    "cantilever 24 : 1": 18,
}


@pytest.mark.parametrize("name", CYCLES)
def test_cycles_have_not_risen(name):
    assert set(CYCLES) == set(benchmark.WATCHED)
    _, result = benchmark.watched(name)
    assert result.status is am.Status.CONVERGED and not result.fallback
    assert result.cycles <= CYCLES[name] + 1


@pytest.mark.slow
def test_the_history_has_a_row_a_commit(tmp_path):
    for name in ("one", "two", "two"):
        benchmark.history(tmp_path / "history.csv", ["bar"], name)
    rows = (tmp_path / "history.csv").read_text().splitlines()
    assert [row.partition(",")[0] for row in rows] == ["commit", "one", "two"]
    assert "bar: cycles" in rows[0] and (tmp_path / "history.png").exists()
