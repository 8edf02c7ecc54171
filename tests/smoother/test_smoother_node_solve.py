"""The node solve meets the contact conditions by every law: in convex problems they have one solution."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smoother_problems import spd

from adaptmg.smoother.node_solve import _inside, slip_3d, solve_2d, solve_3d

EXAMPLES = settings(max_examples=100, deadline=None)
BOUNDS = {"frictionless": (0.0, 0.0), "tresca": (1.0, 0.0), "coulomb": (0.0, 1.0), "both": (1.0, 1.0)}
laws = st.sampled_from(sorted(BOUNDS))
seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])
exponents = st.floats(-2, 2)


def solve(block, force, gap, reference, limit, friction):
    if len(force) == 2:
        return np.array(solve_2d(block[0, 0], block[0, 1], block[1, 1], *force, gap, *reference, limit, friction))
    upper = block[np.triu_indices(3)]
    return np.array(solve_3d(*upper, *force, gap, *reference, limit, friction))


def problem(dim, seed, law, exponent):
    """A random node problem; friction up to 5, so that the solution is not always unique."""
    rng = np.random.default_rng(seed)
    block = spd(rng, dim) * 10.0**exponent
    limit, friction = BOUNDS[law]
    return (block, 3 * rng.normal(size=dim), rng.normal() / 10.0**exponent, rng.normal(size=dim - 1) / 10.0**exponent,
            limit * rng.uniform(), friction * 5.0**rng.uniform(-2, 1))


def assert_conditions(w, block, force, gap, reference, limit, friction, relative=2e-14):
    q = force - block @ w
    slip = w[1:] - reference
    rounding = relative * (1 + friction) * (np.abs(force).sum() + np.abs(block @ np.diag(w)).sum()
                                            + np.abs(block[:, 1:] @ np.diag(reference)).sum()
                                            + np.abs(block[:, 0] * gap).sum())
    assert w[0] <= gap
    assert q[0] >= -rounding
    assert w[0] == gap or abs(q[0]) <= rounding
    bound = limit + friction * max(q[0], 0.0)
    size = np.linalg.norm(slip)
    if size > 0:
        np.testing.assert_allclose(q[1:], bound * slip / size, atol=rounding * (1 + np.abs(reference).max() / size))
    else:
        assert np.linalg.norm(q[1:]) <= bound + rounding


@EXAMPLES
@given(dims, seeds, laws, exponents, st.floats(0.05, 1.95))
def test_optimality_conditions(dim, seed, law, exponent, omega):
    block, *rest = problem(dim, seed, law, exponent)
    assert_conditions(solve(block / omega, *rest), block / omega, *rest)


@EXAMPLES
@given(seeds)
def test_large_friction_against_strong_coupling(seed):
    """mu |a| >> b: several solutions or a wedged node; whatever is returned meets the conditions."""
    rng = np.random.default_rng(seed)
    block = spd(rng, 3, 1e4)
    arguments = (block, rng.normal(size=3), 0.0, np.zeros(2), 0.0, 20.0)
    assert_conditions(solve(*arguments), *arguments)
    plane = (block[:2, :2], arguments[1][:2], 0.0, np.zeros(1), 0.0, 20.0)
    assert_conditions(solve(*plane), *plane)


@EXAMPLES
@given(seeds, laws, st.booleans())
def test_decoupled_tangent_stays_and_reduces_to_2d(seed, law, second):
    """A fixed tangent (decoupled, no load) stays at exactly zero and leaves the plane problem."""
    block, force, gap, reference, limit, friction = problem(2, seed, law, 0.0)
    w = solve(block, force, gap, reference, limit, friction)
    kept = [0, 1] if second else [0, 2]
    large = 7.0 * np.eye(3)
    large[np.ix_(kept, kept)] = block
    force_3d, reference_3d = np.zeros(3), np.zeros(2)
    force_3d[kept], reference_3d[kept[1] - 1] = force, reference[0]
    w_3d = solve(large, force_3d, gap, reference_3d, limit, friction)
    assert w_3d[3 - kept[1]] == 0.0
    if friction * abs(block[0, 1]) < 0.99 * block[1, 1]:
        np.testing.assert_allclose(w_3d[kept], w, atol=1e-10 * (1 + np.abs(w).max()))


@EXAMPLES
@given(seeds, st.floats(0, 0.9))
def test_a_gap_that_closes_by_rounding_changes_nothing(seed, share):
    """Where the pressure comes out as zero or below."""
    block, force, _, reference, limit, _ = problem(2, seed, "both", 0.0)
    friction = share * block[1, 1] / abs(block[0, 1])
    opened = solve(block, force, np.inf, reference, limit, friction)
    closed = solve(block, force, np.nextafter(opened[0], -np.inf), reference, limit, friction)
    np.testing.assert_allclose(closed, opened, atol=1e-9 * (1 + np.abs(opened).max()))


@given(st.floats(1e-9, 1e9), st.floats(1e-9, 1e9), st.floats(1e-9, 1e9))
def test_a_point_inside_a_bracket_of_any_extent(low, extent, stiffness):
    inside = getattr(_inside, "py_func", _inside)
    for bounds in ((low, low + max(extent, 1e-6 * low)), (0.0, extent), (low, np.inf), (0.0, np.inf)):
        assert bounds[0] < inside(*bounds, stiffness) < bounds[1]


@pytest.mark.parametrize("size", [1e-12, 1e-6, 1e-1, 1.0, 10.0])
def test_slip_just_beyond_the_bound(size):
    """The slip is accurate relative to itself, however little the force exceeds the bound."""
    limit = 2.0
    slip = np.array(slip_3d(4.0, 0.0, 4.0, (limit + size) * 0.6, (limit + size) * 0.8, 0.0, 0.0, 0.0, limit, 0.0))
    np.testing.assert_allclose(slip, [0.15 * size, 0.2 * size], rtol=1e-15 * limit / size + 1e-14)
