"""Boundary tractions: uniform on both sides of a patch test, in balance, zero where nothing touches."""

import dataclasses

import numpy as np
import pytest

import adaptmg as am
from adaptmg.estimate import boundary_tractions


@pytest.mark.parametrize("options", [{"slope": 20.0, "side_pressure": 3e7}, {"dim": 3}])
def test_both_sides_of_a_patch_bear_the_same_traction(options):
    problem = am.cases.two_block_patch(**options)
    grids = am.Hierarchy.from_meshes(problem, [am.cases.patch_mesh(problem, n) for n in (2, 4)])
    result = am.solve(grids, am.FullMultigrid(rtol=1e-11))
    slave, master = (boundary_tractions(result, name) for name in problem.pair_boundaries)
    for side in (slave, master):
        for pressure in (side.pressure, side.stress_pressure):
            np.testing.assert_allclose(pressure, problem.reference["pressure"], rtol=1e-8)
        np.testing.assert_allclose(np.linalg.norm(side.tangential, axis=1), problem.reference["traction"],
                                   rtol=1e-7, atol=1e-1)
    np.testing.assert_allclose(slave.contact.mean(axis=0), -master.contact.mean(axis=0), rtol=1e-7, atol=1.0)


def test_signs_and_where_nothing_touches():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8, 16))
    result = am.solve(grids, am.FullMultigrid(rtol=1e-10))
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
    two = dataclasses.replace(whole, domain=cut, contact=(am.Contact("first", floor), am.Contact("second", floor)),
                              reference={})
    mesh = am.mesh.graded(cut, 4e-3, ("first", "second"), 1.0)
    labels = np.where(mesh.facet_labels == 1, 0, mesh.facet_labels)
    joined = dataclasses.replace(mesh, facet_labels=labels, boundaries=("bottom", "unused", "right", "top", "left"))
    posed = dataclasses.replace(whole, domain=None)
    estimates = []
    for problem, used in ((two, mesh), (posed, joined)):
        grids = am.Hierarchy.from_meshes(problem, [used])
        estimates.append(am.Residual().indicate(grids, am.solve(grids, am.ActiveSet(rtol=1e-11))))
    np.testing.assert_allclose(estimates[0].squares, estimates[1].squares, rtol=1e-6,
                               atol=1e-9 * estimates[1].squares.max())
