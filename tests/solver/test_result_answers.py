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
    # what diverged has none
    moved = result.displacement.copy()
    moved[result.mesh.elements[0]] = np.nan
    missing = np.isnan(replace(result, displacement=moved).principal_stresses()).all(axis=1)
    assert missing[0] and not missing.all()
    for method in (result.stress, result.strain, result.von_mises, result.principal_stresses):
        with pytest.raises(ValueError, match=r"point 1 .* lies .* m outside the mesh"):
            method([inside[0], (5.0, 5.0)])
        with pytest.raises(ValueError, match="at='nodes' needs recovered=True"):
            method("nodes")
        with pytest.raises(ValueError, match="at must be one of 'elements', 'nodes'"):
            method("gauss")
        with pytest.raises(TypeError, match="recovered must be True or False"):
            method(inside, recovered="yes")


def answers(result: am.Result) -> list[object]:
    points = [(1e-4, 2e-4), (2e-4, 1e-3)]
    return [*(method(at, recovered=recovered) for at, recovered in ((points, False), (points, True), ("nodes", True))
              for method in (result.stress, result.strain, result.von_mises, result.principal_stresses)),
            result.energy, result.contact_area, result.contact_extent, result.max_pressure, result.work_to(1e-3),
            result.pairs().to_dict("list"), {k: list(v) for k, v in result.contact.table().items()}, repr(result),
            repr(result.contact), result._repr_html_()]


@pytest.mark.parametrize(("case", "finest"), [(cases.hertz_cylinder, 1 / 30), (cases.hertz_sphere, 1 / 20)])
def test_hertz_contact_and_the_pressure_below_it(case, finest, tmp_path):
    """Half a model: half the width and force of a line; of an axisymmetric body forces and areas of the whole ring."""
    problem, line = case(), case is cases.hertz_cylinder
    grids = am.Hierarchy.from_meshes(problem, cases.line_contact_meshes(problem, finest=finest, levels=3, grading=0.12))
    result, form = am.solve(grids), problem.reference["closed_form"]
    a, p0 = form.half_width, form.peak
    half, area, force, unit = (a / 2, a, 0.5 * form.load, "N/m") if line else (a, np.pi * a**2, form.load, "N")
    assert result.contact_extent[0] == pytest.approx(half, rel=0.05)
    assert result.contact_area == pytest.approx(area, rel=0.05 if line else 0.1)
    assert result.max_pressure == pytest.approx(p0, rel=0.02 if line else 0.1)
    assert result.pairs()[f"force_y [{unit}]"][0] == pytest.approx(force, rel=1e-8)
    assert result.contact.units[0] == unit and ("moment" in "".join(result.pairs())) == line
    # Johnson, Contact Mechanics, (4.44b) and (3.45)
    depth = np.array([0.5, 0.79, 1.1])
    below = np.column_stack([np.full(3, 1e-9), -depth * a])
    found = result.principal_stresses(below, recovered=True)[:, 2] / p0
    np.testing.assert_allclose(found, -(1 + depth**2) ** (-0.5 if line else -1.0), atol=0.02 if line else 0.04)
    u = grids.finest.discrete.relative(result.displacement).reshape(-1)
    assert result.energy == pytest.approx(0.5 * u @ (grids.finest.discrete.matrix @ u), rel=1e-9)
    result.save(tmp_path / "r.npz")
    assert same(answers(am.Result.load(tmp_path / "r.npz")), answers(result))
