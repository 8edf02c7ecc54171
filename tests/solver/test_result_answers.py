"""What a result answers about stress, strain, energy and contact; that it comes back from files and
processes."""

import copy
import os
import pickle
from dataclasses import fields, replace
from types import MappingProxyType

import numpy as np
import pytest
from hertz_meshes import contact_meshes
from made import cube, result_on, same, square
from made_bodies import two_bodies
from simplex_meshes import random_box

import adaptmg as am
from adaptmg import cases
from adaptmg.discrete.stress import StressData
from adaptmg.evolution.load_path import StepNotConverged
from adaptmg.solver.result import KINDS
from adaptmg.solver.store import packed, read

YOUNG, POISSON = 2e11, 0.3
ELASTIC = (am.PlaneStrain, am.PlaneStress, am.Axisymmetric, am.Solid)
#: where xx, yy, zz, xy, yz, xz stand in a tensor
AT = np.array([(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)]).T


def stretched(kind: type, initial: float = 0.0) -> tuple[am.Result, np.ndarray, np.ndarray]:
    """A linear displacement, with an initial strain; its strain and stress by the compliance of
    Hooke's law."""
    dim = 3 if kind is am.Solid else 2
    mesh, rng = random_box(5, dim, 3), np.random.default_rng(1)
    slope = 1e-3 * rng.standard_normal((dim, dim))
    if kind is am.Axisymmetric:
        slope[0, 1] = 0.0  # u_r = c r
        mesh = replace(mesh, points=mesh.points + np.array([1.0, 0.0]))
    strain, free = np.zeros((3, 3)), initial * np.eye(3)
    strain[:dim, :dim] = (slope + slope.T) / 2
    if kind is am.Axisymmetric:
        strain[2, 2] = slope[0, 0]
    if kind is am.PlaneStress:
        elastic = strain - free
        strain[2, 2] = initial - POISSON / (1 - POISSON) * (elastic[0, 0] + elastic[1, 1])
    elastic = strain - free
    stress = (
        YOUNG
        / (1 + POISSON)
        * (elastic + POISSON / (1 - 2 * POISSON) * np.trace(elastic) * np.eye(3))
    )
    data = StressData.of(
        mesh,
        kind(young=YOUNG, poisson=POISSON),
        [am.InitialStrain("body", (initial,) * 3)] if initial else (),
    )
    moved = replace(
        result_on(None),
        mesh=mesh,
        displacement=mesh.points @ slope.T,
        stress_data=data,
        reaction=np.zeros(mesh.points.shape),
    )
    return moved, strain, stress


@pytest.mark.parametrize("initial", [0.0, 2e-3])
@pytest.mark.parametrize("kind", ELASTIC)
def test_a_linear_displacement_has_one_strain_and_stress(kind, initial):
    result, strain, stress = stretched(kind, initial)
    inside = result.mesh.points[result.mesh.elements].mean(axis=1)[::7]
    deviator = stress - np.trace(stress) / 3 * np.eye(3)
    for at, recovered, n in (
        ("elements", False, len(result.mesh.elements)),
        (inside, False, len(inside)),
        ("elements", True, len(result.mesh.elements)),
        (inside, True, len(inside)),
        ("nodes", True, result.mesh.n_nodes),
        (inside[0], True, 1),
    ):
        found = {
            name: getattr(result, name)(at, recovered=recovered)
            for name in ("stress", "strain", "von_mises", "principal_stresses")
        }
        for name, wanted, unit in (
            ("stress", stress[*AT], YOUNG),
            ("strain", strain[*AT], 1.0),
            ("von_mises", np.sqrt(1.5 * np.sum(deviator**2)), YOUNG),
            ("principal_stresses", np.sort(np.linalg.eigvals(stress))[::-1], YOUNG),
        ):
            np.testing.assert_allclose(
                found[name],
                np.broadcast_to(wanted, (n, *np.shape(wanted))),
                rtol=1e-8,
                atol=1e-12 * unit,
            )
    volumes = result.mesh.volumes.copy()
    if kind is am.Axisymmetric:
        volumes *= 2 * np.pi * result.mesh.points[result.mesh.elements, 0].mean(axis=1)
    elastic = strain - initial * np.eye(3)
    assert result.energy == pytest.approx(0.5 * np.sum(stress * elastic) * volumes.sum(), rel=1e-10)
    if not initial:
        u, matrix = (
            np.sin(9 * result.mesh.points),
            am.discrete.stiffness(result.mesh, kind(young=YOUNG, poisson=POISSON)),
        )
        wanted = 0.5 * u.reshape(-1) @ (matrix @ u.reshape(-1))
        assert replace(result, displacement=u).energy == pytest.approx(wanted, rel=1e-12)


def test_elements_answer_for_their_points_nodes_need_recovery():
    result, *_ = stretched(am.PlaneStrain)
    result = replace(result, displacement=1e-3 * np.sin(9 * result.mesh.points))
    inside = result.mesh.points[result.mesh.elements].mean(axis=1)
    np.testing.assert_array_equal(result.stress(inside), result.stress())
    nodal = result.stress("nodes", recovered=True)
    np.testing.assert_allclose(
        result.stress(inside, recovered=True), nodal[result.mesh.elements].mean(axis=1)
    )
    np.testing.assert_allclose(
        result.stress("elements", recovered=True), nodal[result.mesh.elements].mean(axis=1)
    )
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
        material=kind(young=2e11, poisson=0.3),
        domain=plate,
        law=am.Frictionless(),
        contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
        supports=(am.Support("top", y=0), am.Support("left", x=0)),
        loads=(am.InitialStrain("body", (strain, strain, strain)), am.Pressure("right", 1e7)),
    )


@pytest.mark.parametrize("kind", [am.PlaneStrain, am.PlaneStress, am.Axisymmetric])
def test_results_and_steps_have_the_stresses_of_their_problem(kind, tmp_path):
    problem = squeezed(kind)
    grids = am.Hierarchy.uniform(problem, divisions=(2, 4))
    factors = (0.0, 0.5, 2.0)
    steps = am.solve_path(grids, am.LoadPath({"body": factors, "right": (1.0, 1.0, 0.5)}))
    steps.save(tmp_path / "path")
    loaded = am.PathResult.load(tmp_path / "path")
    for factor, result, again in (
        (1.0, am.solve(grids), None),
        *zip(factors, steps, loaded, strict=True),
    ):
        loads = [am.InitialStrain("body", tuple(factor * c for c in problem.loads[0].components))]
        wanted = am.discrete.full_stress(result.mesh, problem.material, result.displacement, loads)
        assert np.abs(wanted[:, 0, 0]).max() > 1e6
        np.testing.assert_allclose(
            result.stress(), wanted[:, *AT], rtol=1e-9, atol=1e-9 * np.abs(wanted).max()
        )
        np.testing.assert_allclose(result.von_mises(), am.discrete.von_mises(wanted), rtol=1e-9)
        if (
            kind is not am.PlaneStrain
        ):  # whose stress through the thickness has energy whatever the displacement is
            assert result.checked.energy_norm**2 == pytest.approx(2 * result.energy, rel=1e-6)
        if again is not None:
            np.testing.assert_array_equal(again.stress(), result.stress())
            assert again.stress_data.axisymmetric == (kind is am.Axisymmetric)


def test_a_result_without_materials_says_so():
    grids = am.Hierarchy.uniform(squeezed(), divisions=(4,))
    for result in (am.solve(grids.finest.discrete), result_on(square(2)), result_on(None)):
        assert result.stress_data is None
        for method in (result.stress, result.von_mises):
            with pytest.raises(
                ValueError, match=r"no materials.*bare DiscreteProblem.*StressData\.of"
            ):
                method()
    given = replace(result_on(square(2)), stress_data=StressData.of(square(2), squeezed().material))
    assert given.stress().shape == (8, 6)
    with pytest.raises(ValueError, match="do not belong to a mesh of 1"):
        replace(given, stress_data=two_bodies().stress_data).stress()


def answers(result: am.Result) -> list[object]:
    points = [(1e-4, 2e-4), (2e-4, 1e-3)]
    return [
        *(
            method(at, recovered=recovered)
            for at, recovered in ((points, False), (points, True), ("nodes", True))
            for method in (
                result.stress,
                result.strain,
                result.von_mises,
                result.principal_stresses,
            )
        ),
        result.energy,
        result.contact_area,
        result.contact_extent,
        result.max_pressure,
        result.work_to(1e-3),
        result.pairs().to_dict("list"),
        {k: list(v) for k, v in result.contact.table().items()},
        repr(result),
        repr(result.contact),
        result._repr_html_(),
    ]


@pytest.mark.parametrize(
    ("case", "finest"), [(cases.hertz_cylinder, 1 / 30), (cases.hertz_sphere, 1 / 20)]
)
def test_hertz_contact_and_the_pressure_below_it(case, finest, tmp_path):
    """Half a model: half the width and force of a line; of an axisymmetric body forces and areas of
    the whole ring."""
    problem, line = case(), case is cases.hertz_cylinder
    grids = am.Hierarchy.from_meshes(problem, contact_meshes(problem, finest, 2, 0.2))
    result, form = am.solve(grids), problem.reference["closed_form"]
    a, p0 = form.half_width, form.peak
    half, area, force, unit = (
        (a / 2, a, 0.5 * form.load, "N/m") if line else (a, np.pi * a**2, form.load, "N")
    )
    assert result.contact_extent[0] == pytest.approx(half, rel=0.05)
    assert result.contact_area == pytest.approx(area, rel=0.05 if line else 0.1)
    assert result.max_pressure == pytest.approx(p0, rel=0.02 if line else 0.1)
    assert result.pairs()[f"force_y [{unit}]"][0] == pytest.approx(force, rel=1e-8)
    assert result.contact.units[0] == unit and ("moment" in "".join(result.pairs())) == line
    # Johnson, Contact Mechanics, (4.44b) and (3.45)
    depth = np.array([0.5, 0.79, 1.1])
    below = np.column_stack([np.full(3, 1e-9), -depth * a])
    found = result.principal_stresses(below, recovered=True)[:, 2] / p0
    np.testing.assert_allclose(
        found, -((1 + depth**2) ** (-0.5 if line else -1.0)), atol=0.02 if line else 0.04
    )
    result.save(tmp_path / "r.npz")
    assert same(answers(am.Result.load(tmp_path / "r.npz")), answers(result))


@pytest.mark.parametrize("bore", [0.0, 0.3])
def test_the_contact_extent_of_a_ring_is_half_its_width(bore):
    """A tube that stands on a plane, and a full cylinder."""
    rng = np.random.default_rng()
    outer, base = 10 ** rng.uniform(-3, 1), rng.normal()
    tube = am.Rectangle(width=(1 - bore) * outer, height=outer, origin=(bore * outer, base))
    problem = am.ContactProblem(
        domain=tube,
        material=am.Axisymmetric(young=YOUNG, poisson=POISSON),
        law=am.Frictionless(),
        contact=am.Contact("bottom", am.Plane((0, base), (0, 1))),
        loads=(am.Pressure("top", 1e6),),
        supports=() if bore else (am.Support("left", x=0.0),),
    )
    result = am.solve(am.Hierarchy.uniform(problem, (4, 8)))
    half = 0.5 * (1 - bore) * outer if bore else outer
    np.testing.assert_allclose(result.contact_extent, (half, 0.0), rtol=1e-12, atol=1e-12)
    assert result.pairs()["half_width_x [m]"][0] == result.contact_extent[0]


cloudpickle = pytest.importorskip("cloudpickle")


def moved(result: am.Result, folder) -> am.Result:
    result.save(folder / "r.npz")
    return am.Result.load(folder / "r.npz")


@pytest.mark.parametrize(
    "result",
    [
        result_on(square(3)),
        result_on(cube(2)),
        result_on(None),
        result_on(square(2), history={}, path=[], levels=[], timings={}),
        result_on(
            square(2),
            status=am.Status.DIVERGED,
            residual=float("inf"),
            displacement=np.full((9, 2), np.nan),
        ),
    ],
    ids=["2D", "3D", "bare", "without a history", "diverged"],
)
def test_every_field_comes_back(tmp_path, result):
    found = moved(result, tmp_path)
    assert same(found, result)
    assert {f.name for f in fields(found)} == {f.name for f in fields(result)}


def test_numbers_of_numpy_become_plain_ones(tmp_path):
    plain = result_on(square(2))
    given = replace(
        plain,
        cycles=np.int32(11),
        work_units=np.float32(47),
        residual=np.array(1e-9),
        timings=MappingProxyType({"setup": np.float64(0.01), np.str_("cycles"): np.float64(0.2)}),
        path=[
            (np.int64(level), np.str_(action), np.int8(times))
            for level, action, times in plain.path
        ],
        levels=[{name: np.float64(v) for name, v in row.items()} for row in plain.levels],
    )
    found = moved(given, tmp_path)
    assert type(found.cycles) is int and found.levels == plain.levels
    assert found.timings == plain.timings and found.path == plain.path


def test_a_foreign_byte_order_is_read(tmp_path):
    result = result_on(square(2))
    foreign, columns = result.displacement.astype(">f8"), np.asfortranarray(result.reaction)
    assert same(moved(replace(result, displacement=foreign, reaction=columns), tmp_path), result)


def test_paths_are_expanded_and_long_names_fit(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    result, name = result_on(square(2)), "n" * 250
    for path in ("~/r.npz", f"~/{name}.npz"):
        result.save(path)
        assert same(am.Result.load(path), result)
    am.PathResult((result,), {"left": np.array([1.0])}, {}, 1).save("~/steps")
    assert same(am.PathResult.load("~/steps")[0], result)
    am.export.vtk(result, "~/r.vtu")
    am.export.vtk_series([result], "~/s.pvd")
    am.export.Report("t").write("~/t.html")
    am.Study(count, {"n": [1]}, "~/s.sqlite").run(progress=False)
    wanted = {"r.npz", f"{name}.npz", "steps", "r.vtu", "s.pvd", "s_0000.vtu", "t.html", "s.sqlite"}
    assert {file for file in os.listdir(tmp_path) if file[0] != "."} == wanted


def count(n):
    return {"m": n}


def test_a_part_of_a_path_is_a_result_too(tmp_path):
    result = result_on(square(2))
    more = {
        "a.b": np.arange(3),
        "a": {"b": np.ones(2)},
        "c/d": (result.displacement, [result.mesh, result]),
    }
    (tmp_path / "s.npz").write_bytes(packed(result, KINDS, more, {"step": 3, "key": "k"}))
    assert same(am.Result.load(tmp_path / "s.npz"), result)
    back = read(tmp_path / "s.npz", KINDS, more=True)
    assert back.part_of == {"step": 3, "key": "k"} and same(back.more, more)
    # what occurs twice is one object again
    assert back.more["c/d"][1][1] is back.value and back.more["c/d"][1][0] is back.value.mesh


def test_the_largest_of_files_is_not_taken_for_a_bomb(tmp_path):
    """Displacements that do not shrink, and all else that shrinks well."""
    n = 60_000
    points = np.random.default_rng(1).random((n, 2))
    elements = np.zeros((4, 3), dtype=int)
    big = replace(
        result_on(square(2)),
        displacement=points,
        reaction=np.zeros((n, 2)),
        mesh=am.MeshArrays(points, elements, elements[:, :2], np.zeros(4), ("bottom",)),
    )
    assert same(moved(big, tmp_path), big)


def unfinished() -> am.Result:
    return result_on(square(3), status=am.Status.LIMIT)


def some_path() -> am.PathResult:
    return am.PathResult(
        (result_on(square(3)), unfinished()),
        {"left": np.array([0.5, 1.0, 0.0])},
        {"problem": "x"},
        3,
    )


WAYS = {
    "pickle": lambda x: pickle.loads(pickle.dumps(x)),
    "oldest": lambda x: pickle.loads(pickle.dumps(x, 2)),
    "cloudpickle": lambda x: cloudpickle.loads(cloudpickle.dumps(x)),
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}
THINGS = {
    "result": unfinished,
    "contact": lambda: unfinished().contact,
    "path": some_path,
    "mesh": lambda: cube(2),
    "meshed": lambda: am.mesh.structured(am.Rectangle(width=1.0, height=1.0), 2),
    "bare": lambda: result_on(None),
    "load path": lambda: am.LoadPath({"left": [1, 0.5]}),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("thing", THINGS)
def test_data_come_back_as_they_were(thing, way):
    given = THINGS[thing]()
    found = WAYS[way](given)
    assert same(given, found)
    if isinstance(given, am.MeshArrays):
        assert not any(
            getattr(found, name).flags.writeable for name in ("points", "elements", "facets")
        )


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    "error",
    [am.NotConverged(unfinished()), StepNotConverged(unfinished(), 1, "left 1", some_path())],
)
def test_exceptions_keep_what_they_carry(error, way):
    error.add_note("seen in a worker")
    found = WAYS[way](error)
    assert (
        type(found) is type(error) and str(found) == str(error) and same(found.result, error.result)
    )
    if isinstance(error, StepNotConverged):
        assert found.step == 1 and same(found.partial, error.partial)


def test_a_copy_keeps_the_ngsolve_mesh_and_a_pickle_makes_another():
    mesh = am.mesh.structured(am.Rectangle(width=1.0, height=1.0), 2)
    assert copy.copy(mesh).source is mesh.source is copy.deepcopy(mesh).source
    assert pickle.loads(pickle.dumps(mesh)).source.nv == mesh.n_nodes
