"""Designs: the points one expects, in order, and no endless ones."""

import itertools

import numpy as np
import pandas as pd
import pytest

import adaptmg as am


def run(n, law="a", seed=0):
    return {"m": n if law == "a" else -n, "s": seed}


def points(design):
    return [tuple(point.values()) for point in design.points()]


@pytest.mark.parametrize(
    ("parameters", "results"),
    [
        ({"n": [1, 2], "law": ["a", "b"]}, [1, -1, 2, -2]),
        ([{"n": 1, "law": "a"}, {"law": "b", "n": 2}], [1, -2]),
        (pd.DataFrame({"n": [1, 2], "law": ["a", "b"]}), [1, -2]),
    ],
    ids=["grid", "list", "table"],
)
def test_every_combination_or_the_points_of_a_list_are_run_in_order(parameters, results):
    assert am.Study(run, parameters).run(progress=False)["m"].tolist() == results


@pytest.mark.parametrize("kind", [am.study.Random, am.study.LatinHypercube, am.study.Sobol])
def test_samples_lie_in_their_ranges_and_come_again(kind):
    ranges = {"x": (0.5, 2.0), "h": (1e-6, 1e-2), "n": (1, 4)}
    sample = kind(ranges, 64, seed=3, log="h")
    x, h, n = (np.array(column) for column in zip(*points(sample), strict=True))
    assert len(sample) == 64 and points(kind(ranges, 64, seed=3, log="h")) == points(sample)
    assert points(kind(ranges, 64, seed=4, log="h")) != points(sample)
    assert x.min() >= 0.5 and x.max() <= 2.0 and h.min() >= 1e-6 and h.max() <= 1e-2
    assert set(n.tolist()) == {1, 2, 3, 4}
    # on a logarithmic scale half lie below the geometric mean
    assert 20 <= (h < 1e-4).sum() <= 44
    if kind is not am.study.Random:
        assert np.histogram(x, 16, (0.5, 2.0))[0].tolist() == [4] * 16


def test_a_sobol_sequence_is_extended_and_no_point_runs_twice():
    assert points(am.study.Sobol({"x": (0.0, 1.0)}, 100))[:40] == points(
        am.study.Sobol({"x": (0.0, 1.0)}, 40)
    )
    assert sorted(points(am.study.Random({"n": (1, 3)}, 50))) == [(1,), (2,), (3,)]


@pytest.mark.parametrize(
    ("make", "error", "match"),
    [
        (lambda: am.Study(run, {"n": itertools.count()}), TypeError, "must be a list"),
        (lambda: am.Study(run, {"n": (k for k in range(3))}), TypeError, "must be a list"),
        (lambda: am.Study(run, {"n": range(10**12)}), ValueError, "1000000000000 points, at most"),
        (lambda: am.Study(run, [{"n": 1}, {"n": 1}]), ValueError, "the same as one before it"),
        (lambda: am.Study(run, [{"n": 1}, {"m": 1}]), ValueError, "give all points the same"),
        (lambda: am.Study(run, []), TypeError, "a list or table of points"),
        (lambda: am.study.Sobol({"x": (1.0, 1.0)}, 4), ValueError, "go up"),
        (lambda: am.study.Sobol({"x": (0.0, 1.0)}, 4, log=["x"]), ValueError, "logarithmic"),
        (lambda: am.study.Sobol({"x": (0.0, float("nan"))}, 4), ValueError, "finite"),
    ],
)
def test_wrong_designs_are_refused_before_memory_is(make, error, match):
    with pytest.raises(error, match=match):
        make()
