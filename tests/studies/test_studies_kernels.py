"""The study of the kernels runs, and counts bytes as one does by hand."""

import pytest
from study_scripts import load

study = load("kernels")


def test_bytes_are_counted_by_hand():
    """3 x 3 nodes in 2D: 9 + 2 * 16 blocks of 4 doubles and an index, 9 rows."""
    calls = study.sweep_calls(study.elastic_system(2, 2))
    matrix = 41 * (4 * 8 + 4) + 10 * 4
    vector = 18 * 8
    assert calls["residual"][1] == matrix + 3 * vector
    assert calls["sweep forward"][1] == matrix + 3 * vector + 9 * 4 * 8 + 9 * 4
    for call, _ in calls.values():
        call()


@pytest.mark.slow
def test_quick_run(tables):
    kernels, transfer = tables("kernels").values()
    assert {(row.dim, row.kernel) for row in kernels.itertuples()} >= {(2, "sweep forward"), (3, "sweep backward")}
    assert (kernels["over triad"] > 0).all() and (transfer.time > 0).all()
