"""Coulomb friction without uniqueness: three exact equilibria of one load, and what is said of them."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import adaptmg as am
from adaptmg.solver.statics import critical_friction


@pytest.fixture(scope="module")
def grids():
    return am.Hierarchy.graded(am.cases.leaning_strut(), sizes=(20e-3, 10e-3, 5e-3), contact_ratio=2)


def with_friction(grids, law):
    return am.Hierarchy.from_meshes(replace(grids.problem, law=law), [level.mesh for level in grids.levels])


@pytest.mark.filterwarnings("ignore:friction:RuntimeWarning")
def test_the_strut_has_three_equilibria(grids):
    related = [am.solve(with_friction(grids, law), am.ActiveSet()) for law in (am.Tresca(1e6), am.Frictionless())]
    found = [am.solve(grids, am.FullMultigrid(rtol=1e-9)),
             *(am.solve(grids, am.Multigrid(rtol=1e-9), start=start) for start in related)]
    touching = [result.contact.state[result.contact.state != am.OPEN].tolist() for result in found]
    assert touching == [[am.STICK], [am.SLIP], []]
    for result in found:
        # each is one: Newton steps from it stay, and the conditions of contact hold
        assert result.residual <= 1e-7
        again = am.solve(grids, am.ActiveSet(rtol=1e-10), start=result)
        assert np.abs(again.displacement - result.displacement).max() <= 1e-6 * np.abs(result.displacement).max()


def test_a_warning_says_so_but_not_where_friction_is_small(grids):
    with pytest.warns(RuntimeWarning, match="may not be unique.*start"):
        am.solve(grids, am.ActiveSet())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        am.solve(with_friction(grids, am.Coulomb(0.1)), am.ActiveSet())


def test_the_estimate_against_the_compliance(grids):
    """From solves with unit forces at a node, on the matrix alone."""
    discrete = grids[1].discrete
    critical = critical_friction(discrete)
    free = np.flatnonzero(~discrete.fixed)
    matrix = discrete.matrix.toarray()[np.ix_(free, free)]
    for i in (0, len(critical) // 2):
        dofs = 2 * discrete.contact.nodes[i] + np.arange(2)
        n = discrete.contact.normals[i]
        frame = np.array([n, [-n[1], n[0]]])
        unit = np.zeros((len(free), 2))
        unit[np.searchsorted(free, dofs)] = frame.T
        stiffness = np.linalg.inv(unit.T @ np.linalg.solve(matrix, unit))
        assert critical[i] == pytest.approx(stiffness[1, 1] / abs(stiffness[0, 1]), rel=1e-8)
    # a body that contact holds has none
    assert np.isnan(critical_friction(am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4)).finest.discrete)).all()
