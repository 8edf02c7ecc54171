"""The residual indicator: jumps facet by facet, initial strains, and nothing where the solution is exact."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from made import cube, result_on, square
from simplex_meshes import random_box
from uncompiled import uncompile

import adaptmg as am
from adaptmg.discrete.stress import StressData
from adaptmg.estimate import residual as module
from adaptmg.estimate.residual import condition_squares, jump_squares, volume_squares
from adaptmg.estimate.stress_fields import Posed, element_stress, neighbours
from adaptmg.mesh.arrays import MeshArrays, facet_table
from adaptmg.problem import step_problem

EXACT = am.FullMultigrid(rtol=1e-10)
YOUNG = np.array([2e11, 7e10])


def two_materials(mesh: MeshArrays, kind: type) -> tuple[MeshArrays, StressData, np.ndarray]:
    """The mesh with two glued bodies, what stresses follow from, and Young's modulus of each element."""
    mesh = dataclasses.replace(mesh, bodies=("a", "b"), element_body=np.arange(len(mesh.elements)) % 2)
    data = StressData.of(mesh, {"a": kind(young=YOUNG[0], poisson=0.3), "b": kind(young=YOUNG[1], poisson=0.1)})
    return mesh, data, YOUNG[mesh.element_body]


@pytest.mark.parametrize("plain", [False, True], ids=["compiled", "plain"])
@pytest.mark.parametrize(("dim", "kind"), [(2, am.PlaneStrain), (2, am.Axisymmetric), (3, am.Solid)])
def test_jumps_are_summed_facet_by_facet(dim, kind, plain, monkeypatch):
    if plain:
        uncompile(monkeypatch, module)
    mesh, data, young = two_materials(random_box(8, dim, 1), kind)
    if kind is am.Axisymmetric:  # on the axis displacements must vanish
        mesh = dataclasses.replace(mesh, points=mesh.points + np.array([1.0, 0.0]))
    u = 1e-3 * np.random.default_rng(0).standard_normal(mesh.points.shape)
    stress, table = element_stress(mesh, u, data), facet_table(mesh.elements, mesh.n_nodes)
    tensors, wanted = data.tensors(mesh, u)[:, :dim, :dim], np.zeros(len(mesh.elements))
    inner = np.flatnonzero(table.second >= 0)
    for e, f, facet in zip(table.first[inner], table.second[inner], table.facets[inner], strict=True):
        corners = mesh.points[facet]
        side = corners[1] - corners[0]
        vector = (np.array([side[1], -side[0]]) if dim == 2 else 0.5 * np.cross(side, corners[2] - corners[0]))
        measure = np.linalg.norm(vector)
        size, normal = measure if dim == 2 else np.sqrt(2 * measure), vector / measure
        if kind is am.Axisymmetric:
            squared = 0.0
            for s, weight in zip(*np.polynomial.legendre.leggauss(12), strict=True):
                at = np.array([[0.5 - 0.5 * s, 0.5 + 0.5 * s]])
                ends = [stress.tractions(np.array([k]), normal[None], facet[None], at)[0, 0] for k in (e, f)]
                radius = at[0] @ corners[:, 0]
                squared += 0.5 * weight * measure * 2 * np.pi * radius * np.sum((ends[0] - ends[1])**2)
        else:
            squared = measure * np.sum(((tensors[e] - tensors[f]) @ normal)**2)
        for k in (e, f):
            wanted[k] += 0.5 * size * squared / young[k]
    found = jump_squares(stress, neighbours(mesh).across, young)
    # the hoop strain is no polynomial
    np.testing.assert_allclose(found, wanted, rtol=1e-9 if kind is not am.Axisymmetric else 1e-2)


def test_an_initial_hoop_strain_is_unbalanced_even_in_a_body_at_rest():
    mesh, material = square(3), am.Axisymmetric(young=1e9, poisson=0.3)
    young = np.full(len(mesh.elements), 1e9)
    data = StressData.of(mesh, material, [am.InitialStrain("body", (1e-3, 5e-4, 4e-3))])
    found = volume_squares(element_stress(mesh, np.zeros(mesh.points.shape), data), [], young)
    # sigma_rr - sigma_tt = 2 mu times 3e-3, div sigma = that over r
    away = mesh.points[mesh.elements, 0].min(axis=1) > 0
    inverse = np.array([mean(*mesh.points[cell], lambda r, z: 1 / r) for cell in mesh.elements[away]])
    wanted = mesh.element_sizes[away]**2 / 1e9 * mesh.volumes[away] * 2 * np.pi * (6e-3 * material.shear_modulus)**2
    np.testing.assert_allclose(found[away], wanted * inverse, rtol=1e-3)


def mean(a, b, c, function):
    """Mean of a function over a triangle, by a fine rule."""
    n = 60
    s, t = (np.mgrid[0:n, 0:n] + 1 / 3) / n
    inside = s + t < 1
    s, t = s[inside], t[inside]
    points = a + s[:, None] * (b - a) + t[:, None] * (c - a)
    return float(np.mean(function(*points.T)))


def made(mesh: MeshArrays, **changes: object) -> Posed:
    """Made-up contact on 'bottom' of a square or cube."""
    dim = mesh.dim
    kind = am.PlaneStrain if dim == 2 else am.Solid
    normal = tuple(np.eye(dim)[dim - 1])
    parts = {"material": kind(young=1e11, poisson=0.2), "law": am.Coulomb(1.0),
             "contact": am.Contact("bottom", am.Plane((0.0,) * dim, normal))} | changes
    problem = am.ContactProblem(**parts)
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
    with pytest.raises(ValueError, match="other loads than those of hierarchy"):
        am.Residual().indicate(grids, path[0])
    step = dataclasses.replace(grids, problem=step_problem(grids.problem, {"left": 0.3}))
    again = am.Hierarchy.uniform(am.cases.greco_bar(side_pressure=4.5e7), divisions=(4, 8, 16))
    wanted = am.Residual().indicate(again, am.solve(again, EXACT))
    assert am.Residual().indicate(step, path[0]).total == pytest.approx(wanted.total, rel=1e-6)
    assert am.Residual().indicate(grids, path[1]).total > 0
