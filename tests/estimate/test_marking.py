"""Doerfler marks a smallest set, Maximum by the largest; neither takes what is not a square."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import adaptmg as am


@pytest.mark.parametrize("theta", [0.1, 0.5, 0.9, 1.0])
def test_doerfler_marks_a_smallest_set_that_holds_the_share(theta):
    rng = np.random.default_rng(3)
    for _ in range(20):
        squares = rng.integers(0, 5, 9).astype(float)
        squares[0] += 1.0
        mask = am.Doerfler(theta).mark(squares)
        assert squares[mask].sum() >= theta * squares.sum()
        smaller = max((squares[list(chosen)].sum() for chosen in itertools.combinations(range(9), mask.sum() - 1)),
                      default=0.0)
        assert smaller < theta * squares.sum()
        assert (squares[mask] > 0).all()


def test_marking_an_estimate_is_marking_its_squares():
    squares = np.array([4.0, 1.0, 0.0, 3.0])
    estimate = am.Estimate(squares=squares, norm=1.0)
    for marking in (am.Doerfler(0.6), am.Maximum(0.7)):
        np.testing.assert_array_equal(marking.mark(estimate), [True, False, False, True])
        np.testing.assert_array_equal(marking.mark(squares), marking.mark(estimate))


def test_nothing_is_marked_where_nothing_is_wrong():
    for marking in (am.Doerfler(), am.Maximum()):
        assert not marking.mark(np.zeros(4)).any()


def test_theta_one_of_maximum_marks_the_largest_alone():
    np.testing.assert_array_equal(am.Maximum(1.0).mark(np.array([1.0, 3.0, 3.0])), [False, True, True])


@pytest.mark.parametrize("marking", [am.Doerfler, am.Maximum])
def test_wrong_input_is_refused(marking):
    for theta in (0.0, -1.0, 1.1, float("nan")):
        with pytest.raises(ValueError, match="theta must be"):
            marking(theta)
    for squares, words in (([1.0, np.nan], "finite"), ([1.0, -1.0], "must be >= 0"), ([], "empty"),
                           ([[1.0]], "vector")):
        with pytest.raises(ValueError, match=words):
            marking().mark(np.array(squares))
    with pytest.raises(TypeError, match="numbers"):
        marking().mark(["a"])
