"""WarmMultigrid: from a start that is nearly solved a cycle may do, and what it leaves is what it says."""

import pytest
from norms import distance

import adaptmg as am
from adaptmg.solver.multigrid import WarmMultigrid


@pytest.fixture(scope="module", params=[am.cases.greco_bar, am.cases.dovetail])
def near(request):
    """A hierarchy, its exact solution, and that of the level below on it."""
    problem = request.param()
    grids = am.Hierarchy.graded(problem, (8e-3, 4e-3, 2e-3))
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12)).displacement
    below = am.solve(grids.truncated(finest=1), am.ActiveSet()).displacement
    discrete = grids.finest.discrete
    return grids, exact, discrete.physical(grids.finest.prolongation @ grids[1].discrete.relative(below))


def test_it_leaves_no_larger_error_than_it_says_from_wrong_starts_too(near):
    grids, exact, start = near
    for rtol, begin in ((1e-2, start), (1e-6, start), (1e-6, -start)):
        result = am.solve(grids, WarmMultigrid(rtol=rtol), start=begin)
        assert result.status.ok and result.rtol == rtol
        assert distance(grids.finest.discrete, result.displacement, exact) <= 2.5 * rtol


def test_one_cycle_may_do(near):
    grids, exact, start = near
    first = distance(grids.finest.discrete, start, exact)
    result = am.solve(grids, WarmMultigrid(rtol=min(0.5 * first, 0.5), first_rate=0.3), start=start)
    assert result.cycles == 1
    # the cold start takes safe cycles, and assumes no rate
    assert am.solve(grids, am.Multigrid(rtol=min(0.5 * first, 0.5)), start=start).cycles > 1
    assert am.solve(grids, WarmMultigrid(rtol=1e-6), start=exact).cycles <= 2
    cycles = [am.solve(grids, WarmMultigrid(rtol=2e-2, first_rate=rate), start=start).cycles for rate in (0.05, 0.95)]
    assert cycles[0] <= cycles[1]


def test_it_needs_a_start_and_a_rate():
    with pytest.raises(ValueError, match="start"):
        am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), (3, 6)), WarmMultigrid())
    for rate in (0.0, 1.0, float("nan")):
        with pytest.raises(ValueError, match="first_rate"):
            WarmMultigrid(first_rate=rate)
