"""Coarse spaces below a fine problem."""

import numpy as np
import pytest

import adaptmg as am
from adaptmg.multigrid.corrections import correction_levels
from adaptmg.smoother.system import local_system


def levels_of(grids, matrices="galerkin"):
    problems = [local_system(level.discrete) for level in grids.levels]
    return correction_levels(grids, problems, len(grids) - 1, matrices)


@pytest.mark.parametrize("diagonal", ["right", "left"])
def test_galerkin_matrices_are_the_discretised_ones_on_nested_meshes(diagonal):
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4, 8), diagonal=diagonal)
    for a, b in zip(levels_of(grids).levels, levels_of(grids, "discretised").levels, strict=True):
        free = ~a.system.fixed
        difference = (a.system.matrix - b.system.matrix).toarray()[np.ix_(free, free)]
        assert np.abs(difference).max() < 1e-12 * np.abs(b.system.data).max()


def test_contact_rows_allow_the_proof_nested_and_not():
    problem = am.cases.greco_bar()
    for grids in (am.Hierarchy.uniform(problem, divisions=(4, 8)),
                  am.Hierarchy.graded(problem, sizes=(10e-3, 5e-3), contact_ratio=2)):
        for level in levels_of(grids).levels[1:]:
            weights = level.contact_prolongation
            assert (weights.data >= 0).all() and np.abs(weights.sum(axis=1) - 1).max() < 1e-10


def inclined(angle):
    """The bar on a plane turned by ``angle``: the same problem in other coordinates."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    a = 40e-3
    corners = np.array([(0, 0), (a, 0), (a, a), (0, a)]) @ turn.T
    domain = am.Polygon(vertices=corners, boundaries=("bottom", "right", "top", "left"))
    return am.ContactProblem(
        material=am.PlaneStrain(young=1.3e11, poisson=0.2), domain=domain, law=am.Coulomb(1.0),
        contact=am.Contact("bottom", am.Plane((0, 0), turn @ (0, 1))),
        loads=(am.Pressure("top", 5e7), am.Pressure("left", 15e7), am.Pressure("right", 15e7)))


def test_local_prolongation_is_the_cartesian_one_in_other_components():
    grids = am.Hierarchy.graded(inclined(0.7), sizes=(20e-3, 10e-3), contact_ratio=1)
    coarse, fine = (local_system(level.discrete) for level in grids.levels)
    w = np.random.default_rng(0).normal(size=coarse.system.n_dofs)
    u = coarse.to_cartesian(w)
    expected = fine.to_local(grids[1].prolongation @ u)
    found = levels_of(grids).levels[1].prolongation @ w
    assert np.abs(found - expected).max() < 1e-12
