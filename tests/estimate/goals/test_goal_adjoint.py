"""Dual fields: the sensitivity of quantities to forces, for every law, one body and pairs;
multigrid against LU."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from bodies import bar_on_block

import adaptmg as am
from adaptmg.estimate import stress_fields
from adaptmg.estimate.adjoint import adjoint_system
from adaptmg.estimate.quantities import GoalView

EXACT = am.ActiveSet(rtol=1e-13)

CASES = {
    "bar": (am.cases.greco_bar, 8e-3),
    "frictionless": (am.cases.curved_obstacle, 8e-3),
    "block": (am.cases.greco_block, 15e-3),
    "block, Tresca": (lambda: am.cases.greco_block(law=am.Tresca(3e7)), 15e-3),
    "dovetail": (am.cases.dovetail, 8e-3),
    "junction": (am.cases.bolted_junction, 12e-3),
    "held slave": (
        lambda: dataclasses.replace(
            bar_on_block(am.Coulomb(0.5)),
            supports=(am.Support("upper.right", x=0.0), am.Support("lower.bottom", x=0.0, y=0.0)),
        ),
        8e-3,
    ),
}


@cache
def solved(name):
    make, size = CASES[name]
    hierarchy = am.Hierarchy.graded(make(), (size,))
    return hierarchy, am.solve(hierarchy, EXACT)


def view_of(hierarchy, result):
    return GoalView.of(stress_fields.solved(hierarchy, result))


def quantities(hierarchy):
    dim, first = hierarchy.problem.dim, hierarchy.problem.contact_boundaries[0]
    at = hierarchy.finest.mesh.points[hierarchy.finest.discrete.contact.nodes[-1]]
    return [
        am.Displacement(at, 0),
        am.ContactForce(first, 0),
        am.ContactForce(),
        am.Opening(first),
        am.MeanDisplacement(first, dim - 1),
    ]


@pytest.mark.parametrize("name", CASES)
def test_the_dual_field_is_the_sensitivity_to_a_load(name):
    hierarchy, result = solved(name)
    discrete, view = hierarchy.finest.discrete, view_of(*solved(name))
    first = hierarchy.problem.contact_boundaries[0]
    force = am.ContactForce(first, 0).functionals(view)[0].value
    assert force == pytest.approx(
        result.resultant(first).force[0], rel=1e-9, abs=1e-12 * np.linalg.norm(discrete.load)
    )
    functionals = [f for item in quantities(hierarchy) for f in item.functionals(view)]
    duals = adjoint_system(view.contact).direct([f.vector for f in functionals])
    # forces in the unknowns of the problem, not on contact nodes (those are part of the conditions
    # there)
    force = np.random.default_rng(0).standard_normal((discrete.n_nodes, discrete.dim))
    force[discrete.contact.nodes] = 0.0
    force = np.where(discrete.fixed, 0.0, force.reshape(-1))
    force *= 1e-6 * np.linalg.norm(discrete.load) / np.linalg.norm(force)
    changed = []
    for sign in (1, -1):
        other = dataclasses.replace(discrete, load=discrete.load + sign * force)
        level = hierarchy.finest.posing(discrete=other, prolongation=None)
        grids = dataclasses.replace(hierarchy, levels=(level,))
        # the certificate finds that this is not the load that is posed
        moved = am.solve(grids, EXACT, start=result.displacement, throw=False)
        np.testing.assert_array_equal(moved.contact.state, result.contact.state)
        there = view_of(grids, moved)
        changed.append(
            np.array([f.value for item in quantities(hierarchy) for f in item.functionals(there)])
        )
    found, wanted = (changed[0] - changed[1]) / 2, np.array([dual.field @ force for dual in duals])
    scale = np.array([np.linalg.norm(dual.field) * np.linalg.norm(force) for dual in duals])
    assert (np.abs(wanted) > 1e-3 * scale).any()
    # where all nodes touch, their mean opening does not depend on anything
    assert (np.abs(found - wanted) <= 1e-6 * scale + 1e-20).all(), (found - wanted) / scale


@pytest.mark.parametrize(
    ("make", "sizes"),
    [
        (am.cases.greco_bar, (8e-3, 4e-3, 2e-3)),
        (am.cases.dovetail, (8e-3, 4e-3)),
        (am.cases.greco_block, (20e-3, 14e-3)),
    ],
)
def test_multigrid_on_the_transpose_equals_the_direct_solution(make, sizes):
    hierarchy = am.Hierarchy.graded(make(), sizes)
    result = am.solve(hierarchy, am.FullMultigrid(rtol=1e-6))
    view = view_of(hierarchy, result)
    system = adjoint_system(view.contact)
    vectors = [f.vector for item in quantities(hierarchy)[:3] for f in item.functionals(view)]
    direct, iterated = system.direct(vectors), system.multigrid(hierarchy, vectors, 1e-9, 60)
    for a, b in zip(direct, iterated, strict=True):
        assert b.converged and b.iterations <= 20
        np.testing.assert_allclose(b.field, a.field, atol=1e-6 * np.abs(a.field).max())


def test_an_adjoint_that_is_not_solved_says_so():
    grids = am.Hierarchy.graded(am.cases.greco_bar(), (4e-3, 2e-3, 1e-3))
    result = am.solve(grids, am.FullMultigrid(rtol=1e-6))
    force = am.ContactForce("bottom", "x")
    estimate = am.Goal(force).indicate(grids, result)
    assert estimate.converged and 0 < estimate.iterations < 20
    view = view_of(grids, result)
    vectors = [f.vector for f in force.functionals(view)]
    (dual,) = adjoint_system(view.contact).multigrid(grids, vectors, 1e-12, 2)
    assert not dual.converged and dual.residual > 1e-12
    failed = dataclasses.replace(estimate, converged=False, residuals=np.array([dual.residual]))
    assert "not solved" in repr(failed)
