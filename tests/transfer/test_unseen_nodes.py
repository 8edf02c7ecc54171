"""Meshes that are locally finer than the next one: coarse nodes of which the next level takes nothing."""

import numpy as np
import pytest
from scipy import sparse

import adaptmg as am
from adaptmg.mesh import bisect, structured
from adaptmg.transfer.galerkin import galerkin_product, seen


def hierarchy(inserted: int) -> am.Hierarchy:
    """4, 8, 16 cells a side; the second mesh is bisected so many times in the middle of a cell, far from contact."""
    problem = am.cases.greco_bar(law=am.Coulomb(0.5))
    meshes = [structured(problem.domain, n) for n in (4, 8, 16)]
    for _ in range(inserted):
        centre = meshes[1].points[meshes[1].elements].mean(axis=1)
        near = np.linalg.norm(centre - np.array([20.4e-3, 20.8e-3]), axis=1)
        meshes[1] = bisect(meshes[1], near <= 1.01 * near.min())[0]
    return am.Hierarchy.from_meshes(problem, meshes)


def unseen(grids: am.Hierarchy) -> np.ndarray:
    """Nodes of the second level that the finest takes nothing from."""
    return np.flatnonzero(np.asarray(abs(grids[2].prolongation).sum(axis=0)).ravel() == 0)


@pytest.mark.parametrize("correction", [am.Truncated(), am.Monotone()])
def test_unseen_nodes_cost_no_cycles(correction):
    plain, refined = hierarchy(0), hierarchy(10)
    assert not len(unseen(plain)) and len(unseen(refined)) > 2
    before, after = (am.solve(grids, am.FullMultigrid(correction=correction)) for grids in (plain, refined))
    assert after.status is am.Status.CONVERGED
    assert after.cycles <= before.cycles + 3


def test_the_product_of_two_steps_is_that_of_their_product():
    grids = hierarchy(10)
    fine, P2, P1 = grids[2].matrix, sparse.csr_array(grids[2].prolongation), sparse.csr_array(grids[1].prolongation)
    middle = galerkin_product(fine, P2)
    both = galerkin_product(fine, sparse.csr_array(P2 @ P1)).toarray()
    assert galerkin_product(middle, seen(P1, P2)).toarray() == pytest.approx(both, abs=1e-12 * np.abs(both).max())
    # with what unseen nodes are lent it is not
    assert not np.allclose(galerkin_product(middle, P1).toarray(), both, rtol=1e-3)


def test_user_prolongations_too():
    grids = hierarchy(10)
    made = am.Hierarchy.from_prolongations(grids.finest.discrete, [grids[1].prolongation, grids[2].prolongation])
    result, reference = am.solve(made, am.Multigrid()), am.solve(grids, am.ActiveSet()).displacement
    assert result.cycles <= 25
    assert result.displacement == pytest.approx(reference, abs=1e-6 * np.abs(reference).max())


def test_a_coarsest_mesh_finer_than_the_next_is_solved_between_bodies():
    """Coarse functions that the next level cannot tell apart made the coarsest matrix of the nested start singular."""
    grids = am.Hierarchy.graded(am.cases.dovetail(), sizes=(6e-3, 3.6e-3, 2.2e-3), contact_ratio=4)
    result = am.solve(grids, am.FullMultigrid())
    assert result.status is am.Status.CONVERGED and result.cycles <= 14
