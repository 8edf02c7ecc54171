"""Doerfler marks a smallest set that holds a share of the squares, Maximum by the largest."""

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
        assert not marking.mark(np.zeros(4)).any()
    np.testing.assert_array_equal(am.Maximum(1.0).mark(np.array([1.0, 3.0, 3.0])), [False, True, True])
