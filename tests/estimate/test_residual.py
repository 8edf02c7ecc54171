"""The residual indicator term by term against sums over single facets, and nothing where the solution is exact."""

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
from adaptmg.estimate import residual as jumps_module
from adaptmg.estimate import residual as volume_module
from adaptmg.estimate.residual import boundary_squares, condition_squares, jump_squares, volume_squares
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
        uncompile(monkeypatch, jumps_module)
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


def test_body_forces_are_what_constant_stress_cannot_balance():
    mesh = square(3)
    material = am.PlaneStress(young=1e9, poisson=0.3)
    stress = element_stress(mesh, np.zeros(mesh.points.shape), StressData.of(mesh, material))
    young = np.full(len(mesh.elements), 1e9)
    assert volume_squares(stress, [am.Pressure("top", 1.0)], young) is None
    loads = [am.BodyForce((3e3, 0.0)), am.BodyForce((0.0, -4e3), body="body")]
    wanted = mesh.element_sizes**2 * mesh.volumes * 25e6 / 1e9
    np.testing.assert_allclose(volume_squares(stress, loads, young), wanted, rtol=1e-12)
    # in axisymmetry beside div sigma, here 0, with the weight 2 pi r
    ring = element_stress(mesh, np.zeros(mesh.points.shape), StressData.of(mesh, am.Axisymmetric(young=1e9, poisson=0)))
    around = 2 * np.pi * mesh.points[mesh.elements, 0].mean(axis=1)
    np.testing.assert_allclose(volume_squares(ring, loads, young), around * wanted, rtol=1e-12)
    # linear forces are integrated exactly
    linear = [am.BodyForce((lambda x: 1e5 * x[:, 0], 0.0))]
    x = mesh.points[mesh.elements, 0]
    squared = 1e10 * mesh.volumes / 12 * ((x**2).sum(axis=1) + x.sum(axis=1)**2)
    np.testing.assert_allclose(volume_squares(stress, linear, young), mesh.element_sizes**2 / 1e9 * squared, rtol=1e-12)


@pytest.mark.parametrize("plain", [False, True], ids=["compiled", "plain"])
def test_axisymmetric_stress_is_balanced_where_it_is_homogeneous_and_not_elsewhere(plain, monkeypatch):
    if plain:
        uncompile(monkeypatch, volume_module)
    mesh, material = square(3), am.Axisymmetric(young=1e9, poisson=0.3)
    data, young = StressData.of(mesh, material), np.full(len(mesh.elements), 1e9)
    r, z = mesh.points.T
    def squares(u):
        return volume_squares(element_stress(mesh, np.column_stack(u), data), [], young)
    assert squares([2e-3 * r, -1e-3 * z]).max() < 1e-25 * 1e9 * 1e-6
    # u_z = c r: sigma_rz = mu c, div sigma = (0, mu c / r); weighted with 2 pi r, beyond the axis
    mu, away = material.shear_modulus, mesh.points[mesh.elements, 0].min(axis=1) > 0
    found = squares([0 * r, 2e-3 * r])[away]
    inverse = np.array([_mean_inverse(*mesh.points[cell]) for cell in mesh.elements[away]])
    wanted = mesh.element_sizes[away]**2 / 1e9 * mesh.volumes[away] * 2 * np.pi * (2e-3 * mu)**2 * inverse
    np.testing.assert_allclose(found, wanted, rtol=1e-3)
    # u_r = c z: div sigma = (-(lambda + 2 mu) c z / r^2, lambda c / r)
    found = squares([2e-3 * z, 0 * r])[away]
    lame = material.lame
    density = [_mean(*mesh.points[cell], lambda r, z: ((lame + 2 * mu) * z / r**2)**2 * r + (lame + mu)**2 / r)
               for cell in mesh.elements[away]]
    wanted = mesh.element_sizes[away]**2 / 1e9 * mesh.volumes[away] * 2 * np.pi * 4e-6 * np.array(density)
    np.testing.assert_allclose(found, wanted, rtol=3e-2)


def test_an_initial_hoop_strain_is_unbalanced_even_in_a_body_at_rest():
    mesh, material = square(3), am.Axisymmetric(young=1e9, poisson=0.3)
    young = np.full(len(mesh.elements), 1e9)
    data = StressData.of(mesh, material, [am.InitialStrain("body", (1e-3, 5e-4, 4e-3))])
    found = volume_squares(element_stress(mesh, np.zeros(mesh.points.shape), data), [], young)
    # sigma_rr - sigma_tt = 2 mu times 3e-3, div sigma = that over r
    away = mesh.points[mesh.elements, 0].min(axis=1) > 0
    inverse = np.array([_mean_inverse(*mesh.points[cell]) for cell in mesh.elements[away]])
    wanted = mesh.element_sizes[away]**2 / 1e9 * mesh.volumes[away] * 2 * np.pi * (6e-3 * material.shear_modulus)**2
    np.testing.assert_allclose(found[away], wanted * inverse, rtol=1e-3)


def _mean(a, b, c, function):
    """Mean of a function over a triangle, by a fine rule."""
    n = 60
    s, t = (np.mgrid[0:n, 0:n] + 1 / 3) / n
    inside = s + t < 1
    s, t = s[inside], t[inside]
    points = a + s[:, None] * (b - a) + t[:, None] * (c - a)
    return float(np.mean(function(*points.T)))


def _mean_inverse(a, b, c):
    return _mean(a, b, c, lambda r, z: 1 / r)


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
def test_what_contact_conditions_leave_between_nodes(mesh):
    this = made(mesh)
    c, dim = this.result.contact, mesh.dim
    slides = (c.state == am.SLIP)[:, None]
    c = dataclasses.replace(c, force_t=np.where(slides, -c.limit[:, None] * np.sign(c.slip), c.force_t))
    # what a solver leaves at the nodes is not an error of the mesh, however far the obstacle is
    opens = c.state == am.OPEN
    left = dataclasses.replace(c, force_n=c.force_n + 1e2 * opens, limit=c.limit + 1e2 * opens,
                               gap=c.gap - 1e-9 * ~opens,
                               force_t=np.where(slides | opens[:, None], c.force_t + 1e2, c.force_t))
    this = dataclasses.replace(this, result=dataclasses.replace(this.result, contact=left))
    facets = mesh.boundary_facets("bottom")
    vectors = np.linalg.norm(np.cross(*np.moveaxis(np.diff(mesh.points[facets], axis=1), 1, 0)), axis=1) / 2 \
        if dim == 3 else np.abs(np.diff(mesh.points[facets, 0], axis=1)[:, 0])
    at = np.searchsorted(c.node, facets)
    gaps = frictions = 0.0
    for cell, measure in zip(at, vectors, strict=True):
        for i in cell:
            for j in cell:
                mass = measure * (2 if i == j else 1) / (6 if dim == 2 else 12)
                gaps += mass * c.pressure[i] * c.gap[j]
                frictions += mass * (c.limit[i] / c.weights[i] * np.linalg.norm(c.slip[j])
                                     + c.traction[i] @ c.slip[j])
    complementarity, friction = condition_squares(this)
    assert complementarity.sum() == pytest.approx(gaps, rel=1e-12) and gaps > 0
    assert friction.sum() == pytest.approx(frictions, rel=1e-12) and frictions > 0
    touching = np.isin(mesh.elements, facets).sum(axis=1) == dim
    assert (complementarity[~touching] == 0).all() and complementarity.min() >= 0


def test_tractions_that_nothing_bears():
    mesh = square(2)
    this = made(mesh, loads=(am.Pressure("top", lambda x: 1e9 * x[:, 0]), am.Traction("right", (2e7, 3e7))),
                supports=(am.Support("right", x=0.0), am.Support("left", x=0.0, y=0.0)))
    still = dataclasses.replace(this.result, displacement=np.zeros(mesh.points.shape))
    free, touching = boundary_squares(dataclasses.replace(this, result=still))
    h = 0.02
    top = h / 1e11 * 1e18 * 0.04**3 / 3
    right = 0.04 * h / 1e11 * 9e14
    assert free.sum() == pytest.approx(top + right, rel=1e-12)
    # on the contact boundary the contact traction, linear between nodes
    c = this.result.contact
    force, weights = c.force, np.array([h / 2, h, h / 2])
    t = force / np.maximum(weights, c.weights)[:, None]
    wanted = sum(h / 3 * (t[i] @ t[i] + t[i] @ t[i + 1] + t[i + 1] @ t[i + 1]) for i in (0, 1))
    assert touching.sum() == pytest.approx(h / 1e11 * wanted, rel=1e-12)


def test_tractions_in_space():
    mesh = cube(2)
    this = made(mesh, loads=(am.Pressure("rest", 3e7),))
    still = dataclasses.replace(this.result, displacement=np.zeros(mesh.points.shape))
    free, _ = boundary_squares(dataclasses.replace(this, result=still))
    area = 0.02**2 / 2
    assert free.sum() == pytest.approx(5 * 8 * np.sqrt(2 * area) * area * 9e14 / 1e11, rel=1e-12)


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


def test_terms_sum_to_the_total_and_the_norm_is_that_of_the_displacement(solved):
    grids, result = solved
    for indicator in (am.Residual(), am.Recovery()):
        estimate = indicator.indicate(grids, result)
        assert sum(estimate.terms.values()) == pytest.approx(estimate.total**2, rel=1e-12)
        u = result.displacement.reshape(-1)
        assert estimate.norm == pytest.approx(np.sqrt(u @ (grids.finest.discrete.matrix @ u)), rel=1e-12)
        assert estimate.squares.shape == (len(result.mesh.elements),)


def test_forces_of_another_unit_scale_the_estimate():
    found = []
    for factor in (1.0, 4.0):
        bar = am.cases.greco_bar(top_pressure=5e7 * factor, side_pressure=15e7 * factor)
        grids = am.Hierarchy.uniform(bar, divisions=(4, 8))
        found.append(am.Residual().indicate(grids, am.solve(grids, EXACT)))
    assert found[1].total == pytest.approx(4 * found[0].total, rel=1e-6)
    assert found[1].relative == pytest.approx(found[0].relative, rel=1e-6)


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


def test_what_cannot_be_estimated_is_refused(solved):
    grids, result = solved
    for indicator in (am.Residual(), am.Recovery()):
        with pytest.raises(TypeError, match="hierarchy must be"):
            indicator.indicate(result, grids)
        with pytest.raises(TypeError, match="result must be"):
            indicator.indicate(grids, None)
        bare = am.Hierarchy.single(grids.finest.discrete)
        with pytest.raises(ValueError, match="no ContactProblem or no mesh"):
            indicator.indicate(bare, result)
        with pytest.raises(ValueError, match="result has no mesh"):
            indicator.indicate(grids, dataclasses.replace(result, mesh=None))
        with pytest.raises(ValueError, match=r"another mesh \(289 nodes\)"):
            indicator.indicate(grids.truncated(finest=1), result)
        broken = result.displacement.copy()
        broken[7, 1] = np.nan
        with pytest.raises(ValueError, match=r"must be finite.* at node 7"):
            indicator.indicate(grids, dataclasses.replace(result, displacement=broken))
        spoilt = dataclasses.replace(result.contact, force_n=np.full(len(result.contact), np.nan))
        if isinstance(indicator, am.Residual):
            with pytest.raises(ValueError, match="squares must be finite"):
                indicator.indicate(grids, dataclasses.replace(result, contact=spoilt))


def test_results_from_files_are_estimated_too(solved, tmp_path):
    grids, result = solved
    result.save(tmp_path / "r.npz")
    again = am.Result.load(tmp_path / "r.npz")
    np.testing.assert_array_equal(am.Residual().indicate(grids, again).squares,
                                  am.Residual().indicate(grids, result).squares)
