"""The residual indicator: nothing where the solution is exact; terms, norms, and the tractions it is made of."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from made import cube, result_on, square

import adaptmg as am
from adaptmg.discrete.stress import StressData
from adaptmg.estimate import boundary_tractions
from adaptmg.estimate.residual import condition_squares
from adaptmg.estimate.stress_fields import Posed, neighbours
from adaptmg.mesh.arrays import MeshArrays

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


@pytest.mark.parametrize("options", [None, {"slope": 20.0, "side_pressure": 3e7}, {"dim": 3}], ids=str)
def test_where_the_solution_is_exact_nothing_is_estimated_and_both_sides_bear_the_same_traction(options):
    if options is None:
        problem = am.cases.greco_bar(law=am.Frictionless())
        grids = am.Hierarchy.uniform(problem, divisions=(4, 8))
    else:
        problem = am.cases.two_block_patch(**options)
        grids = am.Hierarchy.from_meshes(problem, [am.cases.patch_mesh(problem, n) for n in (2, 4)])
    result = am.solve(grids, am.FullMultigrid(rtol=1e-11))
    for indicator in (am.Residual(), am.Recovery()):
        assert indicator.indicate(grids, result).relative < 1e-7
    if options is not None:
        sides = [boundary_tractions(result, name) for name in problem.pair_boundaries]
        for side in sides:
            for pressure in (side.pressure, side.stress_pressure):
                np.testing.assert_allclose(pressure, problem.reference["pressure"], rtol=1e-8)
            np.testing.assert_allclose(np.linalg.norm(side.tangential, axis=1), problem.reference["traction"],
                                       rtol=1e-7, atol=1e-1)
        slave, master = (side.contact.mean(axis=0) for side in sides)
        np.testing.assert_allclose(slave, -master, rtol=1e-7, atol=1.0)


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


def test_signs_of_tractions_and_where_nothing_touches(solved):
    result = solved[1]
    bottom, top = (boundary_tractions(result, name) for name in ("bottom", "top"))
    np.testing.assert_array_equal(bottom.nodes, result.contact.node)
    np.testing.assert_allclose(bottom.pressure, result.contact.pressure, rtol=1e-12)
    np.testing.assert_allclose(bottom.contact[:, 0], result.contact.traction[:, 0], rtol=1e-12)
    # the bar is pushed in +x, friction on it acts in -x, the plane pushes it up
    assert bottom.contact[5:10, 0].max() < 0 < bottom.contact[5:10, 1].min()
    np.testing.assert_array_equal(bottom.normals, np.tile([0.0, -1.0], (17, 1)))
    assert (top.contact == 0).all()
    np.testing.assert_allclose(top.stress_pressure, 5e7, rtol=0.5)


def test_a_contact_boundary_cut_in_two_bears_what_it_bears_whole():
    whole, size, floor = am.cases.greco_bar(), 40e-3, am.Plane((0, 0), (0, 1))
    cut = am.Polygon(vertices=((0, 0), (size / 2, 0), (size, 0), (size, size), (0, size)),
                     boundaries=("first", "second", "right", "top", "left"))
    mesh = am.mesh.graded(cut, 4e-3, ("first", "second"), 1.0)
    joined = dataclasses.replace(mesh, facet_labels=np.where(mesh.facet_labels == 1, 0, mesh.facet_labels),
                                 boundaries=("bottom", "unused", "right", "top", "left"))
    two = dataclasses.replace(whole, domain=cut, reference={},
                              contact=(am.Contact("first", floor), am.Contact("second", floor)))
    estimates = []
    for problem, used in ((two, mesh), (dataclasses.replace(whole, domain=None), joined)):
        grids = am.Hierarchy.from_meshes(problem, [used])
        estimates.append(am.Residual().indicate(grids, am.solve(grids, am.ActiveSet(rtol=1e-11))).squares)
    np.testing.assert_allclose(*estimates, rtol=1e-6, atol=1e-9 * estimates[1].max())


def test_a_facet_of_no_element_is_refused():
    mesh = square(2)
    wrong = dataclasses.replace(mesh, facets=np.vstack([mesh.facets[:-1], [[0, 8]]]))
    with pytest.raises(ValueError, match=r"boundary facet 7 of nodes \[0, 8\] belongs to no element"):
        neighbours(wrong)
