"""When a solve is done: iterates with a known true error are accepted or not, whatever the changes
between them suggest."""

from functools import cache

import numpy as np
import pytest
from norms import distance
from scipy.sparse.linalg import splu

import adaptmg as am

RTOL = 1e-6
LAWS = {"frictionless": am.Frictionless(), "tresca": am.Tresca(3e7), "coulomb": am.Coulomb(0.5)}


@cache
def posed(law):
    """A bar, its solution in contact frames, and directions in which errors may lie: they move no
    contact node, and have the A-norm of the solution."""
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=LAWS[law]), (4, 8))
    discrete = grids.finest.discrete
    local = am.smoother.local_system(discrete)
    exact = am.solve(grids, am.ActiveSet(rtol=1e-13)).displacement
    held = (
        discrete.fixed.reshape(-1, 2)
        | np.isin(np.arange(discrete.n_nodes), local.system.nodes)[:, None]
    )
    free = np.flatnonzero(~held)
    factors = splu(discrete.matrix.tocsr()[free][:, free].tocsc())
    rough = np.random.default_rng(0).normal(size=len(free))
    directions = {}
    for name, values in (("rough", rough), ("smooth", factors.solve(np.ones(len(free))))):
        error = np.zeros(discrete.n_dofs)
        error[free] = values
        directions[name] = error / distance(discrete, exact + error.reshape(-1, 2), exact)
    return grids, exact, local.to_local(discrete.relative(exact)), directions


class Approach:
    """A method whose iterates have given errors, the last one for ever."""

    rtol = RTOL
    start_cycles = 0
    max_cycles = 100

    def __init__(self, law, errors, direction="smooth"):
        *_, self.exact, directions = posed(law)
        self.errors = errors
        self.direction = directions[direction]

    def setup(self, hierarchy, start):
        return self

    def step(self, state):
        k = 0 if state.memory is None else state.memory
        error = self.errors[min(k, len(self.errors) - 1)]
        return am.State(unknowns=self.exact + error * self.direction, memory=k + 1)


def solved(law, errors, direction="smooth"):
    """The result of iterates with these errors, and its true error."""
    grids, exact, *_ = posed(law)
    result = am.solve(grids, Approach(law, errors, direction), throw=False)
    return result, distance(grids.finest.discrete, result.displacement, exact)


@pytest.mark.parametrize("direction", ["rough", "smooth"])
@pytest.mark.parametrize("rate", [0.02, 0.3, 0.7])
@pytest.mark.parametrize("law", LAWS)
def test_errors_that_fall_are_accepted_soon_after_they_are_small(law, rate, direction):
    errors = rate ** np.arange(1, 200)
    result, error = solved(law, errors, direction)
    assert result.status is am.Status.CONVERGED and error <= RTOL
    assert result.cycles <= 3 + np.argmax(errors <= RTOL)
    # the estimate is exact for errors that fall by one rate
    known = rate ** np.arange(10, result.cycles + 1)
    np.testing.assert_allclose(result.history["error_estimate"][10:], known, rtol=3e-2)
    assert 0.5 * error <= result.checked.energy_error <= RTOL


#: errors that stay above the tolerance, or return there
NEVER = {
    "stand still": [3e-6],
    "fall and stand still": [1e-1, 1e-3, 1e-5, 1.5e-6],
    "creep": 1e-3 * (1 - 1e-9 * np.arange(100)),
    "creep just above": 2e-6 * 0.99 ** np.arange(40),
    "alternate": [1e-3, -1e-3] * 50,
    "shrink in their changes alone": 1e-2 + 0.01 ** np.arange(100),
    "rise slowly": 1e-4 * 1.01 ** np.arange(100),
}


@pytest.mark.parametrize("direction", ["rough", "smooth"])
@pytest.mark.parametrize("name", NEVER)
def test_errors_that_stay_large_are_never_accepted(name, direction):
    result, error = solved("coulomb", NEVER[name], direction)
    assert error > RTOL and not result.status.ok
    assert result.status is am.Status.STALLED or (
        result.status is am.Status.LIMIT and "creep" in name
    )
    # what is reported of the last iterate does not call it good
    assert not result.error_estimate <= RTOL


@pytest.mark.parametrize("law", LAWS)
def test_errors_that_stop_falling_below_the_tolerance_are_accepted(law):
    for last in (0.0, 1e-12, 0.5 * RTOL):
        result, error = solved(law, [1e-2, last])
        assert result.status is am.Status.CONVERGED and error <= RTOL
        assert result.cycles <= 4


def test_an_estimate_that_the_certificate_refutes_is_corrected():
    """Changes that fall belong to an error that stays three times the tolerance."""
    result, _ = solved("coulomb", RTOL * (3 + 0.9 ** np.arange(100)))
    assert not result.status.ok
    assert np.count_nonzero(result.history["error_estimate"] <= RTOL) <= 20


def test_an_estimate_follows_the_slow_part_of_an_error():
    grids, *_, directions = posed("coulomb")
    method = Approach("coulomb", [1.0])
    fast = 3 * 0.3 ** np.arange(100)
    slow = 0.8 ** np.arange(100)
    method.step = lambda state: am.State(
        unknowns=method.exact
        + fast[state.memory or 0] * directions["rough"]
        + slow[state.memory or 0] * directions["smooth"],
        memory=(state.memory or 0) + 1,
    )
    result = am.solve(grids, method, reference=am.solve(grids, am.ActiveSet(rtol=1e-13)))
    ratios = result.history["error_estimate"] / result.history["true_error"]
    assert result.status.ok and ratios[2:].min() > 0.2


def test_the_last_iterate_is_accepted_if_it_is_good_enough():
    """No change is known of a first iterate: the certificate decides."""
    for error, status in ((0.5 * RTOL, am.Status.CONVERGED), (2 * RTOL, am.Status.LIMIT)):
        grids, *_ = posed("coulomb")
        method = Approach("coulomb", [error])
        method.max_cycles = 1
        result = am.solve(grids, method, throw=False)
        assert result.status is status
        assert (result.error_estimate <= RTOL) == result.status.ok


@pytest.mark.parametrize("errors", [3.0 ** np.arange(60), [1.0, 1e-2, np.nan], [np.inf]])
def test_errors_that_grow_without_bound_have_diverged(errors):
    result, _ = solved("coulomb", errors)
    assert result.status is am.Status.DIVERGED
