"""What depends on the matrix alone is computed once for problems that share it, and goes with them."""

import gc
import weakref

import numpy as np
import pytest

import adaptmg as am
from adaptmg.solver.aggregates import aggregates_of
from adaptmg.solver.factorisation import condense_coarsest
from adaptmg.solver.iterate import StopTest
from adaptmg.solver.record import Run
from adaptmg.solver.statics import critical_friction

CASES = {"bar": am.cases.greco_bar, "block": am.cases.greco_block}


@pytest.mark.parametrize("case", CASES)
def test_other_laws_and_loads_share_factors_and_aggregates(case):
    make = CASES[case]
    grids = am.Hierarchy.uniform(make(), (2, 4))
    first, other = grids[0].discrete, make(law=am.Coulomb(0.2), top_pressure=1e7)
    shared = grids.with_problem(other)[0].discrete
    alone = am.Hierarchy.uniform(other, (2, 4))[0].discrete
    assert aggregates_of(first) is aggregates_of(shared) is not aggregates_of(alone)
    assert critical_friction(first) is critical_friction(shared)
    ours, theirs, fresh = (condense_coarsest(problem) for problem in (first, shared, alone))
    assert ours.factors is theirs.factors is not fresh.factors
    assert theirs.full.discrete is shared and not np.array_equal(ours.full.load, theirs.full.load)
    for part in ("full.load", "full.contact.friction", "full.system.data", "matrix", "problem.load"):
        a, b = theirs, fresh
        for name in part.split("."):
            a, b = getattr(a, name), getattr(b, name)
        np.testing.assert_array_equal(a, b)


def test_nothing_outlives_its_problem():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4))
    am.solve(grids)
    gone = [weakref.ref(level.discrete) for level in grids.levels] + [
        weakref.ref(aggregates_of(grids.finest.discrete)), weakref.ref(condense_coarsest(grids[0].discrete).factors)]
    del grids
    gc.collect()
    assert [one() for one in gone] == [None] * 4


@pytest.mark.parametrize("solver", [am.FullMultigrid(), am.FullMultigrid(correction=am.Monotone()), am.ActiveSet(),
                                    am.SingleGrid(max_sweeps=5)])
def test_what_a_solve_needs_is_freed_when_it_returns(solver):
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4))
    gc.collect()
    gc.disable()
    try:
        am.solve(grids, solver, throw=False)
        left = [one for one in gc.get_objects() if issubclass(type(one), StopTest | Run)]
    finally:
        gc.enable()
    assert not left
