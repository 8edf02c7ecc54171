"""The residual indicator: nothing where the solution is exact; terms, norms and load steps."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from made import cube, result_on, square

import adaptmg as am
from adaptmg.discrete.stress import StressData
from adaptmg.estimate.residual import condition_squares
from adaptmg.estimate.stress_fields import Posed, neighbours
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import step_problem

EXACT = am.FullMultigrid(rtol=1e-10)


def made(mesh: MeshArrays) -> Posed:
    """Made-up contact on 'bottom' of a square or cube."""
    dim, kind = mesh.dim, am.PlaneStrain if mesh.dim == 2 else am.Solid
    problem = am.ContactProblem(
        material=kind(young=1e11, poisson=0.2), law=am.Coulomb(1.0),
        contact=am.Contact("bottom", am.Plane((0.0,) * dim, tuple(np.eye(dim)[dim - 1]))))
    result = result_on(mesh, stress_data=StressData.of(mesh, problem.material))
    return Posed(problem, mesh, SimpleNamespace(law=problem.law, exchange=None), result)


@pytest.mark.parametrize("mesh", [square(6), cube(3)], ids=["2D", "3D"])
def test_what_a_solver_leaves_at_the_nodes_is_not_an_error_of_the_mesh(mesh):
    this = made(mesh)
    c = this.result.contact
    opens, slides = c.state == am.OPEN, (c.state == am.SLIP)[:, None]
    left = dataclasses.replace(c, force_n=c.force_n + 1e2 * opens, limit=c.limit + 1e2 * opens,
                               gap=c.gap - 1e-9 * ~opens,
                               force_t=np.where(slides | opens[:, None], c.force_t + 1e2, c.force_t))
    loose = dataclasses.replace(this, result=dataclasses.replace(this.result, contact=left))
    for exact, found in zip(condition_squares(this), condition_squares(loose), strict=True):
        assert exact.max() > 0 and exact.min() >= 0
        np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-14 * exact.max())


def test_nothing_is_estimated_where_the_solution_is_exact():
    bar = am.cases.greco_bar(law=am.Frictionless())
    grids = am.Hierarchy.uniform(bar, divisions=(4, 8))
    exact = [(grids, am.solve(grids, EXACT))]
    for options in ({"slope": 20.0, "side_pressure": 3e7}, {"dim": 3}):
        blocks = am.cases.two_block_patch(**options)
        grids = am.Hierarchy.from_meshes(blocks, [am.cases.patch_mesh(blocks, n) for n in (2, 4)])
        exact.append((grids, am.solve(grids, EXACT)))
    for grids, result in exact:
        for indicator in (am.Residual(), am.Recovery()):
            assert indicator.indicate(grids, result).relative < 1e-7


@pytest.fixture(scope="module")
def solved():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8, 16))
    return grids, am.solve(grids, EXACT)


def test_terms_sum_to_the_total_and_the_norm_is_that_of_the_displacement(solved, tmp_path):
    grids, result = solved
    result.save(tmp_path / "r.npz")
    for indicator in (am.Residual(), am.Recovery()):
        estimate = indicator.indicate(grids, result)
        assert sum(estimate.terms.values()) == pytest.approx(estimate.total**2, rel=1e-12)
        u = result.displacement.reshape(-1)
        assert estimate.norm == pytest.approx(np.sqrt(u @ (grids.finest.discrete.matrix @ u)), rel=1e-12)
        assert estimate.squares.shape == (len(result.mesh.elements),)
        again = indicator.indicate(grids, am.Result.load(tmp_path / "r.npz"))
        np.testing.assert_array_equal(again.squares, estimate.squares)
    broken = dataclasses.replace(result.contact, force_n=np.full(len(result.contact), np.nan))
    with pytest.raises(ValueError, match="squares must be finite"):
        am.Residual().indicate(grids, dataclasses.replace(result, contact=broken))


def test_steps_of_a_load_path_are_estimated_under_their_own_loads(solved):
    grids = solved[0]
    path = am.solve_path(grids, am.LoadPath({"top": [1.0, 1.0], "left": [0.3, 1.0]}), EXACT)
    step = dataclasses.replace(grids, problem=step_problem(grids.problem, {"left": 0.3}))
    again = am.Hierarchy.uniform(am.cases.greco_bar(side_pressure=4.5e7), divisions=(4, 8, 16))
    wanted = am.Residual().indicate(again, am.solve(again, EXACT))
    assert am.Residual().indicate(step, path[0]).total == pytest.approx(wanted.total, rel=1e-6)
    assert am.Residual().indicate(grids, path[1]).total > 0


def test_a_facet_of_no_element_is_refused():
    mesh = square(2)
    wrong = dataclasses.replace(mesh, facets=np.vstack([mesh.facets[:-1], [[0, 8]]]))
    with pytest.raises(ValueError, match=r"boundary facet 7 of nodes \[0, 8\] belongs to no element"):
        neighbours(wrong)
