"""The error against a reference is the exact one where that is known, and nothing between equal
solutions."""

import dataclasses

import pytest

import adaptmg as am

SOLVER = am.FullMultigrid(rtol=1e-9)


def on(problem, meshes):
    grids = am.Hierarchy.from_meshes(problem, meshes)
    return grids, am.solve(grids, SOLVER if len(grids) > 1 else am.ActiveSet(rtol=1e-10))


@pytest.fixture(scope="module")
def transition():
    problem = am.cases.coulomb_transition(kind="stick", sign="-")
    grids = am.Hierarchy.uniform(problem, divisions=[(8 * 2**k, 4 * 2**k) for k in range(5)])
    return grids, am.estimate.Reference.of(grids, am.solve(grids, SOLVER))


def test_errors_are_the_exact_ones(transition):
    """Prescribed displacements that vary, tractions, contact: on nested meshes and on others."""
    grids, reference = transition
    field, domain = grids.problem.reference["field"], grids.problem.domain
    coarse = grids.truncated(finest=2)
    solved = [
        am.solve(coarse, SOLVER),
        on(grids.problem, [am.mesh.graded(domain, 0.1, ("bottom",), 2.0)])[1],
    ]
    for result in solved:
        exact, found = field.energy_error(result), am.estimate.energy_error(reference, result)
        # of second order in the quotient of the two errors: measured .35 times its square, nested
        # 1e-3
        known = 0.5 * (found.allowance / found.absolute) ** 2
        assert found.absolute == pytest.approx(exact.absolute, rel=known)
        assert found.relative == pytest.approx(exact.relative, rel=known)
        assert found.norm == pytest.approx(exact.norm, rel=1e-4)
        assert 0.2 < found.allowance / exact.absolute < 0.27
    nested = am.estimate.energy_error(reference, solved[0]).absolute
    assert nested == pytest.approx(field.energy_error(solved[0]).absolute, rel=1e-3)


def test_the_own_error_counts_and_a_reference_must_be_finer(transition):
    grids, reference = transition
    result = am.solve(grids.truncated(finest=2), SOLVER)
    bare = dataclasses.replace(reference, own_error=0.0)
    with_own, without = (
        am.estimate.energy_error(reference, result),
        am.estimate.energy_error(bare, result),
    )
    assert with_own.absolute**2 - without.absolute**2 == pytest.approx(
        reference.own_error**2, rel=1e-6
    )
    small = grids.truncated(finest=1)
    worse = dataclasses.replace(
        am.estimate.Reference.of(small, am.solve(small, SOLVER)), own_error=0.0
    )
    with pytest.raises(ValueError, match="several times finer than the result"):
        am.estimate.energy_error(worse, am.solve(grids.truncated(finest=3), SOLVER))


SOLVED = {
    "bar": lambda: am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4)),
    "blocks": lambda: am.Hierarchy.graded(am.cases.two_block_patch(), (0.05, 0.03)),
    "axisymmetric": lambda: am.Hierarchy.graded(am.cases.bolted_junction(), (12e-3, 8e-3)),
    "3D": lambda: am.Hierarchy.uniform(am.cases.greco_block(), (2, 4)),
}


@pytest.mark.parametrize("case", SOLVED)
def test_a_solution_has_no_error_against_itself(case):
    grids = SOLVED[case]()
    result = am.solve(grids, SOLVER)
    own = am.estimate.energy_error(
        dataclasses.replace(am.estimate.Reference.of(grids, result), own_error=0.0), result
    )
    assert own.relative < 1e-4
    assert am.estimate.energy_error((grids, result), result).absolute == pytest.approx(
        am.Recovery().indicate(grids, result).total, rel=1e-2, abs=1e-4 * own.norm
    )


def test_what_tolerances_leave_of_exact_solutions_is_no_error():
    """Of the patch test, which is exact on every mesh, the squared error is rounding of any sign."""
    problem = am.cases.two_block_patch(slope=20.0, side_pressure=1e8)
    grids = am.Hierarchy.graded(problem, (0.05, 0.025, 0.0125))
    loose, result = (am.solve(grids, am.Multigrid(rtol=rtol)) for rtol in (1e-7, 1e-8))
    assert am.estimate.energy_error((grids, loose), result).relative < 1e-4


def test_two_bodies_on_meshes_that_do_not_match():
    problem = am.cases.dovetail()
    meshes = [
        am.mesh.graded(problem.domain, size, problem.pair_boundaries, 2.0)
        for size in (8e-3, 4e-3, 1.2e-3)
    ]
    reference = am.estimate.Reference.of(*on(problem, meshes))
    errors = [
        am.estimate.energy_error(reference, on(problem, meshes[:k])[1]).relative for k in (1, 2)
    ]
    # rate lambda = .54 at the corners of notch and tongue
    assert errors[0] < 0.4 and 1.2 < errors[0] / errors[1] < 1.8
