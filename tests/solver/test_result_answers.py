"""What a result answers about stress, strain, energy and contact, against exact fields, matrices and Hertz."""

from dataclasses import replace

import numpy as np
import pytest
from made import result_on, same, square
from made_bodies import two_bodies
from simplex_meshes import random_box

import adaptmg as am
from adaptmg import cases
from adaptmg.discrete.elasticity import stiffness
from adaptmg.discrete.stress import StressData, full_stress, von_mises

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
    if not initial:
        u, matrix = np.sin(9 * result.mesh.points), stiffness(result.mesh, kind(young=YOUNG, poisson=POISSON))
        wanted = 0.5 * u.reshape(-1) @ (matrix @ u.reshape(-1))
        assert replace(result, displacement=u).energy == pytest.approx(wanted, rel=1e-12)


def test_elements_answer_for_their_points_and_nodes_need_recovery():
    result, *_ = stretched(am.PlaneStrain)
    result = replace(result, displacement=1e-3 * np.sin(9 * result.mesh.points))
    inside = result.mesh.points[result.mesh.elements].mean(axis=1)
    np.testing.assert_array_equal(result.stress(inside), result.stress())
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


def squeezed(kind: type = am.PlaneStrain, strain: float = -2e-4) -> am.ContactProblem:
    """A warm plate between a support and a smooth plane."""
    plate = am.Rectangle(width=0.02, height=0.01, origin=(0.01, 0.0))
    return am.ContactProblem(
        material=kind(young=2e11, poisson=0.3), domain=plate, law=am.Frictionless(),
        contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
        supports=(am.Support("top", y=0), am.Support("left", x=0)),
        loads=(am.InitialStrain("body", (strain, strain, strain)), am.Pressure("right", 1e7)))


@pytest.mark.parametrize("kind", [am.PlaneStrain, am.PlaneStress, am.Axisymmetric])
def test_solved_results_and_steps_of_paths_have_the_stresses_of_their_problem(kind, tmp_path):
    problem = squeezed(kind)
    grids = am.Hierarchy.uniform(problem, divisions=(2, 4))
    factors = (0.0, 0.5, 2.0)
    steps = am.solve_path(grids, am.LoadPath({"body": factors, "right": (1.0, 1.0, 0.5)}))
    steps.save(tmp_path / "path")
    loaded = am.PathResult.load(tmp_path / "path")
    for factor, result, again in ((1.0, am.solve(grids), None), *zip(factors, steps, loaded, strict=True)):
        loads = [am.InitialStrain("body", tuple(factor * c for c in problem.loads[0].components))]
        wanted = full_stress(result.mesh, problem.material, result.displacement, loads)
        assert np.abs(wanted[:, 0, 0]).max() > 1e6
        np.testing.assert_allclose(result.stress(), wanted[:, *AT], rtol=1e-9,
                                   atol=1e-9 * np.abs(wanted).max())
        np.testing.assert_allclose(result.von_mises(), von_mises(wanted), rtol=1e-9)
        if kind is not am.PlaneStrain:  # whose stress through the thickness has energy whatever the displacement is
            assert result.checked.energy_norm**2 == pytest.approx(2 * result.energy, rel=1e-6)
        if again is not None:
            np.testing.assert_array_equal(again.stress(), result.stress())
            assert again.stress_data.axisymmetric == (kind is am.Axisymmetric)


def test_a_result_without_materials_says_so():
    grids = am.Hierarchy.uniform(squeezed(), divisions=(4,))
    for result in (am.solve(grids.finest.discrete), result_on(square(2)), result_on(None)):
        assert result.stress_data is None
        for method in (result.stress, result.von_mises):
            with pytest.raises(ValueError, match=r"no materials.*bare DiscreteProblem.*StressData\.of"):
                method()
    given = replace(result_on(square(2)), stress_data=StressData.of(square(2), squeezed().material))
    assert given.stress().shape == (8, 6)
    with pytest.raises(ValueError, match="do not belong to a mesh of 1"):
        replace(given, stress_data=two_bodies().stress_data).stress()


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
    grids = am.Hierarchy.from_meshes(problem, cases.line_contact_meshes(problem, finest=finest, levels=2, grading=0.2))
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
    result.save(tmp_path / "r.npz")
    assert same(answers(am.Result.load(tmp_path / "r.npz")), answers(result))
