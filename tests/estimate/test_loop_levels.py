"""The levels of a hierarchy that grows: neighbours neither too far apart nor too close, solutions carried up."""

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
    def __init__(self, counts: list[int]) -> None:
        self.counts, self.asked = counts, 0

    def intermediate(self, problem, coarse, fine):
        self.asked += 1
        return structured(problem.domain, self.counts.pop(0)) if self.counts else None


def grids(*counts: int) -> am.Hierarchy:
    return am.Hierarchy.uniform(upset(), counts)


def nodes(hierarchy: am.Hierarchy) -> list[int]:
    return [round(level.n_nodes**0.5) - 1 for level in hierarchy.levels]


@pytest.mark.parametrize(("offered", "fine", "kept", "asked"), [
    ([9], 24, [3, 9, 24], 1), ([9], 9, [3, 9], 0), (None, 24, [3, 24], 0), ([], 24, [3, 24], 1), ([3], 24, [3, 24], 1),
    ([24], 24, [3, 24], 1)], ids=["put between", "sizes fit", "not offered", "none made", "no finer", "no coarser"])
def test_a_mesh_is_put_between_where_sizes_fall_too_much_and_the_engine_makes_one(offered, fine, kept, asked):
    start, engine = grids(3), object() if offered is None else Between(offered)
    found = appended(start, structured(start.problem.domain, fine), engine)
    assert nodes(found) == kept and getattr(engine, "asked", 0) == asked
    assert len(kept) == 2 or all(size_ratio(a.mesh, b.mesh) <= RATIO for a, b in pairwise(found.levels))


@pytest.mark.parametrize(("sizes", "last", "kept"), [
    ((2, 6, 18, 20), False, (2, 6, 20)), ((2, 6, 18, 20), True, (2, 6, 18, 20)),  # a single close level stays
    ((2, 6, 7, 8), True, (2, 6, 8)), ((6, 7), False, (6, 7)), ((6, 7, 8), False, (6, 8)),
    ((6, 17, 20), False, (6, 20)), ((6, 20, 24), False, (6, 20, 24))])  # without it sizes are too far apart
def test_close_levels_that_are_not_needed_are_dropped(sizes, last, kept):
    assert tuple(nodes(thinned(grids(*sizes), last=last))) == kept


def test_whether_levels_are_nested_is_asked_once(monkeypatch):
    hierarchy, asked, is_galerkin = grids(3, 6, 12), [], split_matrix.is_galerkin
    monkeypatch.setattr(split_matrix, "is_galerkin", lambda *given: asked.append(given) or is_galerkin(*given))
    results = [am.solve(hierarchy, am.Multigrid(rtol=1e-6)) for _ in range(2)]
    assert len(asked) == 2
    # another coarse level below the same fine one is another question
    am.solve(hierarchy.without(1), am.Multigrid(rtol=1e-6))
    assert len(asked) == 3
    np.testing.assert_array_equal(*(result.displacement for result in results))


@settings(max_examples=12, deadline=None)
@given(st.lists(st.integers(1, 8), min_size=2, max_size=6))
def test_thinning_as_levels_come_keeps_ratios_and_leaves_no_two_needlessly_close(steps):
    sizes = np.cumsum([3, *steps])
    kept = grids(int(sizes[0]))
    for n in sizes[1:]:
        kept = thinned(kept.append(structured(kept.problem.domain, int(n))))
    left = nodes(kept)
    assert left[0] == sizes[0] and left[-1] == sizes[-1]
    if len(left) > 2:
        assert kept[-1].n_nodes >= CLOSE * kept[-2].n_nodes or left[-1] >= THINNED * left[-3]
    for a, b in pairwise(left):
        assert b <= max(RATIO * a, a + max(steps)) + 1e-9


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
    assert am.solve(grown, am.Multigrid(rtol=1e-2), start=carried_up).status.ok
    moved = discrete.relative(carried_up)[discrete.contact.nodes]
    gap = discrete.contact.gaps - np.einsum("nd,nd->n", moved, discrete.contact.normals)
    closed = gap <= 1e-3 * np.abs(carried_up).max()
    assert np.mean(closed == (fine.contact.state != am.OPEN)) >= 0.85


def test_tolerances_and_the_end_are_expected():
    *_, last = steps = list(am.adapt(upset(), 8e-3, engine=am.Bisect(), max_nodes=150))
    assert expected_estimate(last, 4 * last.nodes, 2) == pytest.approx(last.estimate.relative / 2)
    assert [algebraic_tolerance(one) for one in (0.03, 0.5, 0.0)] == [0.003, 3e-2, 1e-10]
    by_nodes = expected_seconds(steps, Limits(max_nodes=10 * last.nodes))
    assert by_nodes == pytest.approx(10 * last.total_seconds)
    assert expected_seconds(steps, Limits(max_nodes=10 * last.nodes, max_seconds=1.5 * last.total_seconds)) < by_nodes
    by_tolerance = expected_seconds(steps, Limits(tolerance=last.estimate.relative / 3))
    assert by_tolerance == pytest.approx(9 * last.total_seconds)
