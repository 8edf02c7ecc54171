"""Closed forms and programmes on random networks, solved by every method."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import STIFF, assert_state, pressed, stacked, uniaxial
from smoother_problems import dual_solution, network
from test_agreement import LAWS, METHODS

import adaptmg as am


@pytest.mark.parametrize("method", METHODS)
def test_the_patch_test_is_exact(method):
    problem = am.cases.greco_bar(law=am.Frictionless())
    result = am.solve(am.Hierarchy.uniform(problem, (2, 4)), METHODS[method])
    exact = problem.reference["values"]["exact"]["A"]
    assert result.probe([problem.reference["points"]["A"]])[0, 0] == pytest.approx(exact, rel=1e-9)
    assert result.contact.pressure == pytest.approx(5e7, rel=1e-8)


@pytest.mark.parametrize("method", ["single", "monotone", "truncated nested", "sparse"])
@pytest.mark.parametrize("law", [am.Frictionless(), am.Coulomb(0.4), am.Tresca(1e7)], ids=LAWS)
def test_a_stack_of_bodies_is_exact(law, method):
    mesh = stacked([(3, 2), (4, 3)])
    problem = pressed(mesh, [("upper.bottom", "lower.top")], (STIFF, STIFF), law)
    grids = am.Hierarchy.from_meshes(problem, [mesh, stacked([(6, 4), (8, 6)])])
    result = am.solve(grids, replace(METHODS[method], rtol=1e-12))
    assert_state(result, uniaxial(result.mesh, (STIFF, STIFF)))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("dim", [2, 3])
def test_random_networks_solve_the_dual_problem(dim, law):
    local = network(dim, law, fixed_tangent=True)
    expected = local.to_cartesian(dual_solution(local))
    for solver in (am.ActiveSet(), am.SingleGrid(rtol=1e-12)):
        result = am.solve(local.discrete, solver)
        assert np.abs(result.displacement - expected).max() <= 1e-9 * np.abs(expected).max()
        assert result.residual < 1e-11
