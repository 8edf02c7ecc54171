"""Transport of contact data: the monotone guarantee on random data, hand-made cases, failures."""

from functools import partial

import numpy as np
import pytest
from bodies import rotation
from hypothesis import given, settings
from hypothesis import strategies as st
from refused import refused
from scipy import sparse

import adaptmg as am

# fine nodes 0, 2, 4 lie on the coarse nodes 0, 1, 2; 1 and 3 halfway; the coarse node 3 has no fine
# node
P_LINE = sparse.csr_array(
    [[1, 0, 0, 0], [0.5, 0.5, 0, 0], [0, 1, 0, 0], [0, 0.5, 0.5, 0], [0, 0, 1, 0]]
)
LINE = am.transfer.supports(P_LINE)


def random_rows(rng, n_fine, n_coarse):
    """Rows >= 0 of up to three entries with sums 1; a few sums are less, as where coarse dofs are
    fixed."""
    P = np.zeros((n_fine, n_coarse))
    for i in range(n_fine):
        k = rng.integers(1, min(3, n_coarse) + 1)
        P[i, rng.choice(n_coarse, k, replace=False)] = rng.dirichlet(np.ones(k))
    P[rng.random(n_fine) < 0.1] *= rng.random()
    return sparse.csr_array(P)


def friction_change(limit, slip, change):
    return limit @ (np.linalg.norm(slip + change, axis=1) - np.linalg.norm(slip, axis=1))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**8), dim=st.sampled_from([2, 3]), one_way=st.booleans())
def test_monotone_guarantee(seed, dim, one_way):
    rng = np.random.default_rng(seed)
    n_fine, n_coarse = rng.integers(1, 30), rng.integers(1, 10)
    P = random_rows(rng, n_fine, n_coarse)
    opening = rng.random(n_fine) * (rng.random(n_fine) < 0.7)
    limit = rng.random(n_fine) * (rng.random(n_fine) < 0.8)
    slip = rng.standard_normal((n_fine, dim - 1)) * 10.0 ** rng.integers(-3, 3, (n_fine, 1))
    if one_way:
        direction = rng.standard_normal(dim - 1)
        slip = np.linalg.norm(slip, axis=1)[:, None] * direction / np.linalg.norm(direction)
    stick = rng.random(n_fine) < 0.15
    slip[stick] = 0
    sets = am.transfer.supports(P)
    bound, reference, force = am.Monotone().transport(sets, opening, slip, limit, None)
    for scale in (1e-3, 1.0, 1e3):
        normal = np.minimum(
            np.where(np.isfinite(bound), bound, 0), scale * rng.standard_normal(n_coarse)
        )
        assert (opening - P @ normal).min() >= -1e-13 * scale
        tangential = scale * rng.standard_normal((n_coarse, dim - 1))
        fine = friction_change(limit, slip, P @ tangential)
        coarse = friction_change(force, reference, tangential)
        assert fine <= coarse + 1e-12 * (1 + scale) * (1 + np.abs(slip).max())
    # the bound is attained: no larger gap is safe everywhere
    at_bound = np.where(np.isfinite(bound), bound, 0)
    assert (opening - P @ at_bound).min() >= -1e-14


OPENING, LIMIT = np.array([3.0, 1, 5, 2, 7]), np.array([1.0, 2, 4, 8, 16])
TINY = np.where(np.arange(5) == 1, -1e-200, 1e-200)  # the product of two of them is 0


@pytest.mark.parametrize(
    ("function", "values", "expected"),
    [
        (am.transfer.smallest_gap, OPENING, [1, 1, 2, np.inf]),
        (am.transfer.largest_gap, OPENING, [3, 5, 7, np.inf]),
        (am.transfer.injected_gap, OPENING, [3, 5, 7, np.inf]),
        (am.transfer.summed_limit, LIMIT, [2, 9, 20, 0]),
        (am.transfer.injected_limit, LIMIT, [1, 4, 16, 0]),
    ],
)
def test_gaps_and_limits_by_hand(function, values, expected):
    np.testing.assert_array_equal(function(LINE, values), expected)


@pytest.mark.parametrize(
    ("slip", "stick", "expected"),
    [
        ([3, 1, 2, -4, -1], None, [1, 0, -1, 0]),
        ([3, 1, 2, -4, -1], 0, [0, 0, -1, 0]),
        (TINY, None, [0, 0, 1e-200, 0]),
        ([3, 0, 2, 4, 1], None, [0, 0, 1, 0]),
    ],
)
def test_slips_by_hand(slip, stick, expected):
    slip = np.array(slip, dtype=float)[:, None]
    found = am.transfer.minmod_slip(
        LINE, slip, *(() if stick is None else (np.arange(5) == stick,))
    )
    np.testing.assert_array_equal(found[:, 0], expected)
    np.testing.assert_array_equal(am.transfer.injected_slip(LINE, slip)[:, 0], [*slip[::2, 0], 0])


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_slips_in_the_plane_by_hand(angle):
    slip = np.array([[3.0, 0], [1, 1e-8], [2, 0], [0, 2], [0, 1]])
    turn = rotation(angle)

    def found(slip, *stick, function=am.transfer.minmod_slip):
        return function(LINE, slip @ turn, *stick) @ turn.T

    equal = partial(np.testing.assert_allclose, atol=1e-15)
    equal(found(slip), [[1, 1e-8], [0, 0], [0, 1], [0, 0]])
    equal(found(slip + np.array([0, 1e-5]))[0], [0, 0])
    equal(found(slip * [[1], [-1], [1], [1], [1]])[0], [0, 0])
    equal(found(slip, np.arange(5) == 4)[2], [0, 0])
    equal(found(slip, function=am.transfer.injected_slip), [[3, 0], [2, 0], [0, 1], [0, 0]])


def test_supports():
    P = P_LINE.copy()
    P.data[1] = 0.0  # a stored zero is in no support
    sets = am.transfer.supports(P)
    np.testing.assert_array_equal(sets.nodes[: sets.indptr[1]], [0])
    np.testing.assert_array_equal(sets.main, [0, 2, 4, -1])
    assert P.nnz == 7  # the matrix given is left as it was
    equal = am.transfer.supports(sparse.csr_array([[0.5, 0.5], [0.5, 0.5]]))
    np.testing.assert_array_equal(equal.main, [0, 0])  # the first of equal weights
    # two entries at one place count as their sum
    twice = am.transfer.supports(sparse.csr_array(([1.0, -0.5, 1.0], [0, 0, 0], [0, 2, 3])))
    np.testing.assert_array_equal(twice.weights, [0.5, 1.0])


test_failures_name_the_argument = refused(
    *(
        (lambda bad=bad: am.transfer.supports(sparse.csr_array([[1.5, bad]])), "P_cc must be >= 0")
        for bad in (-0.5, np.nan)
    ),
    *(
        (
            lambda call=call: call(LINE, np.zeros(4)),
            "one value a fine contact node is needed, 5, got 4",
        )
        for call in (am.transfer.smallest_gap, am.transfer.largest_gap, am.transfer.injected_gap)
    ),
)
