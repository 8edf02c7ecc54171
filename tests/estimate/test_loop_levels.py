"""The levels of a hierarchy that grows: neighbours neither too far apart nor too close, solutions carried up."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from adaptive_loop import upset
from hypothesis import given, settings
from hypothesis import strategies as st

import adaptmg as am
from adaptmg.estimate.loop import CLOSE, RATIO, THINNED, appended, carried, thinned
from adaptmg.estimate.step import Limits, algebraic_tolerance, expected_estimate, expected_seconds
from adaptmg.mesh import structured
from adaptmg.multigrid import split_matrix
from adaptmg.transfer import mesh_ratio, size_ratio


class Between:
    """An engine that makes structured meshes of the mean size."""

    def __init__(self, counts: list[int]) -> None:
        self.counts, self.asked = counts, 0

    def intermediate(self, problem, coarse, fine):
        self.asked += 1
        return structured(problem.domain, self.counts.pop(0)) if self.counts else None


def grids(*counts: int) -> am.Hierarchy:
    return am.Hierarchy.uniform(upset(), counts)


def nodes(hierarchy: am.Hierarchy) -> list[int]:
    return [round(level.n_nodes**0.5) - 1 for level in hierarchy.levels]


def test_a_mesh_is_put_between_where_sizes_fall_too_much():
    start, engine = grids(3), Between([9])
    found = appended(start, structured(start.problem.domain, 24), engine)
    assert nodes(found) == [3, 9, 24] and engine.asked == 1
    assert all(size_ratio(a.mesh, b.mesh) <= RATIO for a, b in pairwise(found.levels))


def test_no_mesh_is_put_between_where_sizes_fit_or_none_is_offered():
    start, engine = grids(3), Between([9])
    assert nodes(appended(start, structured(start.problem.domain, 9), engine)) == [3, 9] and engine.asked == 0
    assert nodes(appended(start, structured(start.problem.domain, 24), object())) == [3, 24]


def test_one_close_level_below_the_last_mesh_stays():
    assert nodes(thinned(grids(2, 6, 18, 20))) == [2, 6, 20]
    assert nodes(thinned(grids(2, 6, 18, 20), last=True)) == [2, 6, 18, 20]
    # of several none but those that sizes need
    assert nodes(thinned(grids(2, 6, 7, 8), last=True)) == [2, 6, 8]


def test_what_is_nested_is_remembered():
    found, asked = grids(3, 6, 12), []
    product, level = split_matrix.is_galerkin, found.levels[1:]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(split_matrix, "is_galerkin", lambda *given: asked.append(given) or product(*given))
        results = [am.solve(found, am.Multigrid(rtol=1e-6)) for _ in range(2)]
        assert len(asked) == len(level)
        # another coarse level below the same fine one is another question
        am.solve(found.without(1), am.Multigrid(rtol=1e-6))
        assert len(asked) == len(level) + 1
    np.testing.assert_array_equal(*(result.displacement for result in results))


@pytest.mark.parametrize("useless", [[], [3], [24]])
def test_a_useless_mesh_is_not_put_between(useless):
    start = grids(3)
    assert nodes(appended(start, structured(start.problem.domain, 24), Between(useless))) == [3, 24]


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(1, 8), min_size=2, max_size=6))
def test_thinning_as_levels_come_keeps_ratios_and_leaves_no_two_needlessly_close(steps):
    sizes = np.cumsum([3, *steps])
    kept = grids(int(sizes[0]))
    for n in sizes[1:]:
        kept = thinned(kept.append(structured(kept.problem.domain, int(n))))
    left = nodes(kept)
    assert left[0] == sizes[0] and left[-1] == sizes[-1]
    for k in range(1, len(left) - 1):
        close = kept[k + 1].n_nodes < CLOSE * kept[k].n_nodes
        if k >= len(left) - 2:
            assert not close or left[k + 1] >= THINNED * left[k - 1]
    for a, b in pairwise(left):
        assert b <= max(RATIO * a, a + max(steps)) + 1e-9


def test_the_coarsest_and_the_finest_level_stay():
    assert nodes(thinned(grids(6, 7))) == [6, 7]
    assert nodes(thinned(grids(6, 7, 8))) == [6, 8]


def test_a_level_stays_without_which_the_sizes_of_its_neighbours_are_far_apart():
    assert nodes(thinned(grids(6, 17, 20))) == [6, 20]
    assert nodes(thinned(grids(6, 20, 24))) == [6, 20, 24]


def test_the_ratio_of_a_sample_is_that_of_all():
    coarse, fine = (structured(am.Rectangle(width=1.0, height=1.0), n) for n in (7, 150))
    assert len(fine.elements) > 40_000
    assert size_ratio(coarse, fine) == pytest.approx(mesh_ratio(coarse, fine, quantile=0.99), rel=1e-12)


@pytest.mark.parametrize("case", [am.cases.greco_bar, am.cases.dovetail])
def test_a_carried_solution_keeps_its_contact_state(case):
    problem = case()
    start = am.Hierarchy.graded(problem, (8e-3, 4e-3))
    coarse = am.solve(start, am.ActiveSet())
    grown = start.append(am.mesh.graded(problem.domain, 2.2e-3))
    fine = am.solve(grown, am.ActiveSet())
    carried_up = carried(grown, 1, coarse.displacement)
    discrete = grown.finest.discrete
    again = am.solve(grown, am.Multigrid(rtol=1e-2), start=carried_up)
    moved = discrete.relative(carried_up)[discrete.contact.nodes]
    gap = discrete.contact.gaps - np.einsum("nd,nd->n", moved, discrete.contact.normals)
    closed = gap <= 1e-3 * np.abs(carried_up).max()
    assert np.mean(closed == (fine.contact.state != am.OPEN)) >= 0.85
    assert again.status.ok


def test_carrying_over_no_level_changes_nothing():
    start = grids(3, 6)
    values = np.arange(start.finest.n_nodes * 2, dtype=float).reshape(-1, 2)
    np.testing.assert_array_equal(carried(start, 1, values), values)


def test_tolerances_are_a_tenth_of_what_is_expected_within_bounds(steps):
    last = steps[-1]
    assert expected_estimate(last, 4 * last.nodes, 2) == pytest.approx(last.estimate.relative / 2)
    assert algebraic_tolerance(0.03) == pytest.approx(0.003)
    assert algebraic_tolerance(0.5) == 3e-2 and algebraic_tolerance(0.0) == 1e-10


def test_the_end_is_expected_by_the_first_limit(steps):
    last = steps[-1]
    by_nodes = expected_seconds(steps, Limits(max_nodes=10 * last.nodes))
    assert by_nodes == pytest.approx(10 * last.total_seconds)
    assert expected_seconds(steps, Limits(max_nodes=10 * last.nodes, max_seconds=1.5 * last.total_seconds)) < by_nodes
    by_tolerance = expected_seconds(steps, Limits(tolerance=last.estimate.relative / 3))
    assert by_tolerance == pytest.approx(9 * last.total_seconds)


@pytest.fixture(scope="module")
def steps():
    return list(am.adapt(upset(), 8e-3, engine=am.Bisect(), max_nodes=150))
