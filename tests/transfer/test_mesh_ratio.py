"""Ratios of the sizes of two meshes, element by element."""

from __future__ import annotations

import pytest
from simplex_meshes import log_graded, structured, two_boxes

from adaptmg.transfer import mesh_ratio, size_ratio


@pytest.mark.parametrize("dim", [2, 3])
def test_mesh_ratio_of_uniform_meshes(dim):
    assert mesh_ratio(structured(2, dim), structured(4, dim)) == pytest.approx(2, abs=1e-12)
    assert mesh_ratio(structured(4, dim), structured(2, dim)) == pytest.approx(0.5, abs=1e-12)
    assert mesh_ratio(two_boxes(2, dim), two_boxes(6, dim)) == pytest.approx(3, abs=1e-12)


def test_mesh_ratio_sees_a_local_jump():
    coarse, fine = structured(8, 2), log_graded(3000, 4)
    assert mesh_ratio(coarse, fine) > 200
    assert mesh_ratio(coarse, structured(16, 2)) == pytest.approx(2)
    assert mesh_ratio(coarse, fine, quantile=0.1) < mesh_ratio(coarse, fine, quantile=0.9) < mesh_ratio(coarse, fine)


def test_size_ratio_leaves_out_the_hundredth_that_differs_most():
    coarse, fine = structured(8, 2), log_graded(3000, 4)
    assert size_ratio(coarse, fine) == mesh_ratio(coarse, fine, quantile=0.99) < mesh_ratio(coarse, fine)
    assert size_ratio(coarse, fine, quantile=0.5) == mesh_ratio(coarse, fine, quantile=0.5)


def test_failures_name_the_argument():
    with pytest.raises(ValueError, match="quantile"):
        mesh_ratio(structured(1, 2), structured(2, 2), quantile=2)
