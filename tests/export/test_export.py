"""VTK files hold the result exactly, and a series lists its steps."""

import dataclasses
from xml.etree import ElementTree

import numpy as np
import pytest
from made import cube, result_on, square
from made_bodies import two_bodies

import adaptmg as am
from adaptmg.discrete.stress import StressData

meshio = pytest.importorskip("meshio")


@pytest.mark.parametrize(
    "make",
    [
        lambda: result_on(square(4)),
        lambda: result_on(cube(2)),
        two_bodies,
        lambda: two_bodies(3, 3, 2),
    ],
    ids=["2D", "3D", "two bodies", "two solids"],
)
def test_vtk_holds_the_result_and_is_zero_off_the_contact_nodes(tmp_path, make):
    result = make()
    path = tmp_path / "r.vtu"
    am.export.vtk(result, path)
    read = meshio.read(path)
    mesh, contact, data = result.mesh, result.contact, read.point_data
    dim, kind = mesh.dim, "triangle" if mesh.dim == 2 else "tetra"
    vectors = {
        name: np.einsum("nk,nkd->nd", values, contact.frames[:, 1:])
        for name, values in (("contact_slip", contact.slip), ("contact_traction", contact.traction))
    }
    for found, expected in (
        (read.points[:, :dim], mesh.points),
        (read.cells_dict[kind], mesh.elements),
        (read.cell_data_dict["body"][kind], mesh.element_body),
        (data["displacement"][:, :dim], result.displacement),
        *(
            (data[f"contact_{name}"][contact.node], getattr(contact, name))
            for name in ("pressure", "gap", "state")
        ),
        *((data[name][contact.node][:, :dim], values) for name, values in vectors.items()),
    ):
        np.testing.assert_array_equal(found, expected)
    away = np.setdiff1d(np.arange(mesh.n_nodes), contact.node)
    assert all(np.isfinite(values).all() for values in data.values())
    for name in (
        "contact_pressure",
        "contact_traction",
        "contact_gap",
        "contact_slip",
        "contact_mask",
    ):
        assert not data[name][away].any()
    assert (data["contact_state"][away] == -1).all() and (data["contact_pair"][away] == -1).all()
    assert (data["contact_mask"][contact.node] == 1).all() and (
        data["contact_pair"][contact.node] == 0
    ).all()
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("dim", [2, 3])
def test_vtk_stress_is_that_of_each_body(tmp_path, dim):
    result = two_bodies(dim, 3, 2)
    x, strain = result.mesh.points, 1e-4
    make = am.PlaneStress if dim == 2 else am.Solid
    materials = {"upper": make(young=2e11, poisson=0.3), "lower": make(young=7e10, poisson=0.1)}
    # uniaxial tension along x in both bodies
    across = np.empty(len(x))
    for k, body in enumerate(result.mesh.bodies):
        across[result.mesh.elements[result.mesh.element_body == k]] = -materials[body].poisson
    u = strain * np.column_stack([x[:, 0], *(across * x[:, d] for d in range(1, dim))])
    data = StressData.of(result.mesh, materials)
    am.export.vtk(dataclasses.replace(result, displacement=u, stress_data=data), tmp_path / "r.vtu")
    kind = "triangle" if dim == 2 else "tetra"
    cells = {
        name: values[kind]
        for name, values in meshio.read(tmp_path / "r.vtu").cell_data_dict.items()
    }
    expected = strain * np.array([2e11, 7e10])[result.mesh.element_body]
    np.testing.assert_allclose(cells["von_mises"], expected)
    np.testing.assert_allclose(
        cells["stress"], expected[:, None] * np.eye(6)[0], atol=1e-6 * expected.max()
    )
    am.export.vtk(dataclasses.replace(result, stress_data=None), tmp_path / "r.vtu")
    assert list(meshio.read(tmp_path / "r.vtu").cell_data_dict) == ["body"]


def _steps(count: int) -> list:
    result = two_bodies(2, 3, 2)
    return [dataclasses.replace(result, displacement=k * result.displacement) for k in range(count)]


def test_a_series_lists_every_step_and_replaces_an_older_one(tmp_path):
    for steps, times in (
        (_steps(3), (0.5, 1.0, 4.0)),
        (_steps(4)[2:], None),
        (_steps(3), (1.0, 2.0, 3.0)),
    ):
        pvd = am.export.vtk_series(steps, tmp_path / "deep" / "down" / "a&b.pvd", times)
        listed = [
            (float(entry.get("timestep")), entry.get("file"))
            for entry in ElementTree.parse(pvd).iter("DataSet")
        ]
        assert [time for time, _ in listed] == list(times or (0.0, 1.0))
        for (_, name), step in zip(listed, steps, strict=True):
            read = meshio.read(pvd.parent / name)
            np.testing.assert_array_equal(read.point_data["displacement"][:, :2], step.displacement)
        assert {p.name for p in pvd.parent.iterdir()} == {"a&b.pvd", *(name for _, name in listed)}


def test_a_series_replaces_no_file_that_is_not_of_an_older_one(tmp_path):
    am.export.vtk_series(_steps(2), tmp_path / "run.pvd")
    step = tmp_path / "run_0002.vtu"
    step.write_bytes(b"mine")
    with pytest.raises(FileExistsError, match=r"run_0002\.vtu"):
        am.export.vtk_series(_steps(3), tmp_path / "run.pvd")
    assert step.read_bytes() == b"mine"


def test_a_series_is_written_whole_or_not_at_all(tmp_path):
    am.export.vtk_series(_steps(1), tmp_path / "old.pvd")
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    for bad, error in (
        ([*_steps(2), result_on(None)], ValueError),
        ([*_steps(2), "result"], TypeError),
    ):
        for target in ("run.pvd", "old.pvd"):
            with pytest.raises(error):
                am.export.vtk_series(bad, tmp_path / target)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_the_list_of_a_series_is_written_last(tmp_path):
    listed = am.export.vtk_series(_steps(2), tmp_path / "run.pvd")
    before = listed.read_bytes()
    # a step that cannot be replaced
    (tmp_path / "run_0001.vtu").unlink()
    (tmp_path / "run_0001.vtu").mkdir()
    with pytest.raises(OSError, match=r"run_0001\.vtu"):
        am.export.vtk_series(_steps(3), listed)
    assert listed.read_bytes() == before
