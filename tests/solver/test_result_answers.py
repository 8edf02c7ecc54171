"""What a result answers about stress, strain, energy and contact, against exact fields, matrices and Hertz."""

from dataclasses import replace

import numpy as np
import pytest
from made import result_on, same
from simplex_meshes import random_box

import adaptmg as am
from adaptmg import cases
from adaptmg.discrete.elasticity import stiffness
from adaptmg.discrete.stress import StressData

YOUNG, POISSON = 2e11, 0.3
KINDS = (am.PlaneStrain, am.PlaneStress, am.Axisymmetric, am.Solid)
#: where xx, yy, zz, xy, yz, xz stand in a tensor
AT = np.array([(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)]).T


def stretched(kind: type, initial: float = 0.0) -> tuple[am.Result, np.ndarray, np.ndarray]:
    """A linear displacement, with an initial strain; its strain and stress by the compliance of Hooke's law."""
    dim = 3 if kind is am.Solid else 2
    mesh, rng = random_box(5, dim, 3), np.random.default_rng(1)
    slope = 1e-3 * rng.standard_normal((dim, dim))
    if kind is am.Axisymmetric:
        slope[0, 1] = 0.0  # u_r = c r
        mesh = replace(mesh, points=mesh.points + np.array([1.0, 0.0]), source=None)
    strain, free = np.zeros((3, 3)), initial * np.eye(3)
    strain[:dim, :dim] = (slope + slope.T) / 2
    if kind is am.Axisymmetric:
        strain[2, 2] = slope[0, 0]
    if kind is am.PlaneStress:
        elastic = strain - free
        strain[2, 2] = initial - POISSON / (1 - POISSON) * (elastic[0, 0] + elastic[1, 1])
    elastic = strain - free
    stress = YOUNG / (1 + POISSON) * (elastic + POISSON / (1 - 2 * POISSON) * np.trace(elastic) * np.eye(3))
    data = StressData.of(mesh, kind(young=YOUNG, poisson=POISSON),
                         [am.InitialStrain("body", (initial,) * 3)] if initial else ())
    moved = replace(result_on(None), mesh=mesh, displacement=mesh.points @ slope.T, stress_data=data,
                    reaction=np.zeros(mesh.points.shape))
    return moved, strain, stress


@pytest.mark.parametrize("initial", [0.0, 2e-3])
@pytest.mark.parametrize("kind", KINDS)
def test_a_linear_displacement_has_one_strain_and_stress_everywhere(kind, initial):
    result, strain, stress = stretched(kind, initial)
    inside = result.mesh.points[result.mesh.elements].mean(axis=1)[::7]
    deviator = stress - np.trace(stress) / 3 * np.eye(3)
    for at, recovered, n in (("elements", False, len(result.mesh.elements)), (inside, False, len(inside)),
                             ("elements", True, len(result.mesh.elements)), (inside, True, len(inside)),
                             ("nodes", True, result.mesh.n_nodes), (inside[0], True, 1)):
        found = {name: getattr(result, name)(at, recovered=recovered)
                 for name in ("stress", "strain", "von_mises", "principal_stresses")}
        for name, wanted, unit in (("stress", stress[*AT], YOUNG), ("strain", strain[*AT], 1.0),
                                   ("von_mises", np.sqrt(1.5 * np.sum(deviator**2)), YOUNG),
                                   ("principal_stresses", np.sort(np.linalg.eigvals(stress))[::-1], YOUNG)):
            np.testing.assert_allclose(found[name], np.broadcast_to(wanted, (n, *np.shape(wanted))), rtol=1e-8,
                                       atol=1e-12 * unit)
    volumes = result.mesh.volumes.copy()
    if kind is am.Axisymmetric:
        volumes *= 2 * np.pi * result.mesh.points[result.mesh.elements, 0].mean(axis=1)
    elastic = strain - initial * np.eye(3)
    assert result.energy == pytest.approx(0.5 * np.sum(stress * elastic) * volumes.sum(), rel=1e-10)


@pytest.mark.parametrize("kind", KINDS)
def test_the_energy_is_that_of_the_stiffness_matrix(kind):
    result, *_ = stretched(kind)
    u = 1e-3 * np.random.default_rng(2).standard_normal(result.mesh.points.shape)
    matrix = stiffness(result.mesh, kind(young=YOUNG, poisson=POISSON))
    wanted = 0.5 * u.reshape(-1) @ (matrix @ u.reshape(-1))
    assert replace(result, displacement=u).energy == pytest.approx(wanted, rel=1e-12)


def test_elements_answer_for_their_points_and_nodes_need_recovery():
    result, *_ = stretched(am.PlaneStrain)
    result = replace(result, displacement=1e-3 * np.sin(9 * result.mesh.points))
    inside = result.mesh.points[result.mesh.elements].mean(axis=1)
    np.testing.assert_array_equal(result.stress(inside), result.stresses())
    np.testing.assert_array_equal(result.stress(), result.stresses())
    nodal = result.stress("nodes", recovered=True)
    np.testing.assert_allclose(result.stress(inside, recovered=True), nodal[result.mesh.elements].mean(axis=1))
    np.testing.assert_allclose(result.stress("elements", recovered=True), nodal[result.mesh.elements].mean(axis=1))
    for method in (result.stress, result.strain, result.von_mises, result.principal_stresses):
        with pytest.raises(ValueError, match=r"point 1 .* lies .* m outside the mesh"):
            method([inside[0], (5.0, 5.0)])
        with pytest.raises(ValueError, match="at='nodes' needs recovered=True"):
            method("nodes")
        with pytest.raises(ValueError, match="at must be one of 'elements', 'nodes'"):
            method("gauss")
        with pytest.raises(TypeError, match="recovered must be True or False"):
            method(inside, recovered="yes")


def test_what_diverged_has_no_principal_stresses():
    result, *_ = stretched(am.PlaneStrain)
    result.displacement[result.mesh.elements[0]] = np.nan
    missing = np.isnan(result.principal_stresses()).all(axis=1)
    assert missing[0] and not missing.all()


def test_recovered_stresses_jump_between_materials():
    mesh = random_box(6, 2, 2)
    upper = mesh.points[mesh.elements, 1].mean(axis=1) > np.median(mesh.points[:, 1])
    mesh = replace(mesh, bodies=("soft", "stiff"), element_body=upper.astype(int), source=None)
    soft, stiff = (am.PlaneStress(young=E, poisson=0.2) for E in (1e9, 9e9))
    result = replace(result_on(None), mesh=mesh, displacement=1e-3 * mesh.points,
                     stress_data=StressData.of(mesh, {"soft": soft, "stiff": stiff}))
    np.testing.assert_allclose(result.stress("elements", recovered=True), result.stress(), rtol=1e-9, atol=1.0)
    at_nodes = result.von_mises("nodes", recovered=True)
    np.testing.assert_allclose(at_nodes, np.where(np.isin(np.arange(mesh.n_nodes), mesh.elements[~upper]), 1, 9)
                               * at_nodes.min(), rtol=1e-9)


def hertzian(case, finest: float, tmp_path) -> tuple[am.Result, object]:
    problem = case()
    grids = am.Hierarchy.from_meshes(problem, cases.line_contact_meshes(problem, finest=finest, levels=3, grading=0.12))
    result = am.solve(grids)
    u = grids.finest.discrete.relative(result.displacement).reshape(-1)
    assert result.energy == pytest.approx(0.5 * u @ (grids.finest.discrete.matrix @ u), rel=1e-9)
    result.save(tmp_path / "r.npz")
    return result, problem.reference["closed_form"]


def answers(result: am.Result) -> list[object]:
    points = [(1e-4, 2e-4), (2e-4, 1e-3)]
    return [*(method(at, recovered=recovered) for at, recovered in ((points, False), (points, True), ("nodes", True))
              for method in (result.stress, result.strain, result.von_mises, result.principal_stresses)),
            result.energy, result.contact_area, result.contact_extent, result.max_pressure, result.work_to(1e-3),
            result.pairs().to_dict("list"), {k: list(v) for k, v in result.contact.table().items()}, repr(result),
            repr(result.contact), result._repr_html_()]


def test_hertz_line_contact(tmp_path):
    """Half a model: its width is half the true one. Stresses below the middle: Johnson, Contact Mechanics, (4.44)."""
    result, form = hertzian(cases.hertz_cylinder, 1 / 30, tmp_path)
    a, p0 = form.half_width, form.peak
    assert 2 * result.contact_extent[0] == pytest.approx(a, rel=0.05)
    assert result.contact_area == pytest.approx(2 * result.contact_extent[0], rel=1e-3)
    assert result.max_pressure == pytest.approx(p0, rel=0.02)
    row = result.pairs().iloc[0]
    assert row["force_y [N/m]"] == pytest.approx(0.5 * form.load, rel=1e-8)
    depth = np.array([0.5, 0.79, 1.1]) * a
    root, poisson = np.sqrt(1 + (depth / a)**2), 0.3
    wanted = np.zeros((3, 3))
    wanted[:, 0], wanted[:, 1] = -p0 * ((1 + 2 * (depth / a)**2) / root - 2 * depth / a), -p0 / root
    wanted[:, 2] = poisson * (wanted[:, 0] + wanted[:, 1])
    below = np.column_stack([np.full(3, 1e-9), -depth])
    found = result.stress(below, recovered=True)
    np.testing.assert_allclose(found[:, :3] / p0, wanted / p0, atol=0.02)
    np.testing.assert_allclose(result.principal_stresses(below, recovered=True)[:, 2] / p0, -1 / root, atol=0.02)
    assert same(answers(am.Result.load(tmp_path / "r.npz")), answers(result))


def test_hertz_point_contact(tmp_path):
    """An axisymmetric body: the first half-width is the radius of contact, forces and areas are of the whole ring."""
    result, form = hertzian(cases.hertz_sphere, 1 / 20, tmp_path)
    assert result.contact_extent[0] == pytest.approx(form.half_width, rel=0.05)
    assert result.contact_area == pytest.approx(np.pi * form.half_width**2, rel=0.1)
    assert result.pairs()["force_y [N]"][0] == pytest.approx(form.load, rel=1e-8)
    assert result.contact.units == ("N", "m^2") and "moment" not in "".join(result.pairs())
    # straight below: Johnson (3.45)
    a, p0, depth, poisson = form.half_width, form.peak, np.array([0.5, 1.0]) * form.half_width, 0.3
    axial = -p0 / (1 + (depth / a)**2)
    radial = -p0 * ((1 + poisson) * (1 - depth / a * np.arctan(a / depth)) - 0.5 / (1 + (depth / a)**2))
    found = result.stress(np.column_stack([np.full(2, 1e-9), -depth]), recovered=True)
    np.testing.assert_allclose(found[:, :3] / p0, np.column_stack([radial, axial, radial]) / p0, atol=0.04)
    assert same(answers(am.Result.load(tmp_path / "r.npz")), answers(result))
