"""VTK files hold the result exactly, and series list what is there."""

from __future__ import annotations

import dataclasses
import os
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from made import cube, result_on, square
from made_bodies import two_bodies
from nasty_texts import NASTY

import adaptmg as am
from adaptmg._text import printable
from adaptmg.discrete.stress import StressData
from adaptmg.export import vtk, vtk_series, vtu

meshio = pytest.importorskip("meshio")

RESULTS = {"2D": lambda: result_on(square(4)), "3D": lambda: result_on(cube(2)), "two bodies": two_bodies,
           "two solids": lambda: two_bodies(3, 3, 2)}


@pytest.mark.parametrize("make", RESULTS.values(), ids=RESULTS)
def test_vtk_holds_the_result(tmp_path, make):
    result = make()
    path = tmp_path / "r.vtu"
    vtk(result, path)
    read = meshio.read(path)
    mesh, contact = result.mesh, result.contact
    dim = mesh.dim
    np.testing.assert_array_equal(read.points[:, :dim], mesh.points)
    kind = "triangle" if dim == 2 else "tetra"
    np.testing.assert_array_equal(read.cells_dict[kind], mesh.elements)
    np.testing.assert_array_equal(read.cell_data_dict["body"][kind], mesh.element_body)
    np.testing.assert_array_equal(read.point_data["displacement"][:, :dim], result.displacement)
    np.testing.assert_array_equal(read.point_data["contact_pressure"][contact.node], contact.pressure)
    np.testing.assert_array_equal(read.point_data["contact_gap"][contact.node], contact.gap)
    np.testing.assert_array_equal(read.point_data["contact_state"][contact.node], contact.state)
    for name, values in (("contact_slip", contact.slip), ("contact_traction", contact.traction)):
        vectors = np.einsum("nk,nkd->nd", values, contact.frames[:, 1:])
        np.testing.assert_array_equal(read.point_data[name][contact.node][:, :dim], vectors)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("make", RESULTS.values(), ids=RESULTS)
def test_vtk_is_zero_and_masked_off_the_contact_nodes(tmp_path, make):
    result = make()
    vtk(result, tmp_path / "r.vtu")
    data = meshio.read(tmp_path / "r.vtu").point_data
    away = np.setdiff1d(np.arange(result.mesh.n_nodes), result.contact.node)
    assert all(np.isfinite(values).all() for values in data.values())
    for name in ("contact_pressure", "contact_traction", "contact_gap", "contact_slip", "contact_mask"):
        assert not data[name][away].any()
    assert (data["contact_mask"][result.contact.node] == 1).all()
    assert (data["contact_state"][away] == -1).all() and (data["contact_pair"][away] == -1).all()
    assert (data["contact_pair"][result.contact.node] == 0).all()


def test_vtk_names_bodies_and_pairs(tmp_path):
    result = two_bodies()
    odd = dataclasses.replace(result.mesh, bodies=('a "<b>" & c', "lower"))
    vtk(dataclasses.replace(result, mesh=odd), tmp_path / "r.vtu")
    fields = meshio.read(tmp_path / "r.vtu").field_data
    assert {name: int(value[0]) for name, value in fields.items()} == {
        'body:a "<b>" & c': 0, "body:lower": 1, "contact:upper.bottom|lower.top": 0}


@pytest.mark.parametrize("dim", [2, 3])
def test_vtk_stress_is_that_of_each_body(tmp_path, dim):
    result = two_bodies(dim, 3, 2)
    x, strain = result.mesh.points, 1e-4
    poisson = {"upper": 0.3, "lower": 0.1}
    make = am.PlaneStress if dim == 2 else am.Solid
    materials = {"upper": make(young=2e11, poisson=0.3), "lower": make(young=7e10, poisson=0.1)}
    # uniaxial tension along x in both bodies
    across = np.empty(len(x))
    for k, body in enumerate(result.mesh.bodies):
        across[result.mesh.elements[result.mesh.element_body == k]] = -poisson[body]
    u = strain * np.column_stack([x[:, 0], *(across * x[:, d] for d in range(1, dim))])
    data = StressData.of(result.mesh, materials)
    vtk(dataclasses.replace(result, displacement=u, stress_data=data), tmp_path / "r.vtu")
    kind = "triangle" if dim == 2 else "tetra"
    cells = {name: values[kind] for name, values in meshio.read(tmp_path / "r.vtu").cell_data_dict.items()}
    wanted = strain * np.array([2e11, 7e10])[result.mesh.element_body]
    np.testing.assert_allclose(cells["von_mises"], wanted)
    np.testing.assert_allclose(cells["stress"], wanted[:, None] * np.eye(6)[0], atol=1e-6 * wanted.max())


def test_vtk_leaves_initial_strains_out_of_the_stress(tmp_path):
    result = two_bodies(2, 3, 2)
    material = {body: am.Axisymmetric(young=2e11, poisson=0.3) for body in result.mesh.bodies}
    moved = dataclasses.replace(result.mesh, points=result.mesh.points + np.array([0.1, 0.0]))
    u = np.zeros(moved.points.shape)
    inside = np.unique(moved.elements[moved.element_body == 0])
    u[inside] = 1e-3 * moved.points[inside]
    for loads, largest in (((am.InitialStrain("upper", (1e-3,) * 3),), 1.0), ((), np.inf)):
        data = StressData.of(moved, material, loads)
        vtk(dataclasses.replace(result, mesh=moved, displacement=u, stress_data=data), tmp_path / "r.vtu")
        found = np.abs(meshio.read(tmp_path / "r.vtu").cell_data_dict["stress"]["triangle"]).max()
        assert found < largest
    assert found > 1e8


def test_vtk_has_no_stress_without_materials(tmp_path):
    vtk(dataclasses.replace(two_bodies(), stress_data=None), tmp_path / "r.vtu")
    assert list(meshio.read(tmp_path / "r.vtu").cell_data_dict) == ["body"]


def test_vtk_refuses_what_it_cannot_write(tmp_path):
    with pytest.raises(ValueError, match="no mesh"):
        vtk(result_on(None), tmp_path / "r.vtu")
    with pytest.raises(ValueError, match=r"\.vtu"):
        vtk(result_on(square(2)), tmp_path / "r.vtk")
    with pytest.raises(TypeError, match="Result"):
        vtk("result", tmp_path / "r.vtu")
    with pytest.raises(FileNotFoundError):
        vtk(result_on(square(2)), tmp_path / "nowhere" / "r.vtu")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", NASTY, ids=ascii)
def test_any_name_gives_a_well_formed_vtu_file(tmp_path, name):
    made = two_bodies(2, 3, 2)
    mesh = dataclasses.replace(made.mesh, bodies=(name, f"{name}2"))
    contact = dataclasses.replace(made.contact, names=(name,), masters=(f"{name}2",))
    vtk(dataclasses.replace(made, mesh=mesh, contact=contact, problem_name=name), tmp_path / "r.vtu")
    head, tail = re.fullmatch(rb"(.*<AppendedData encoding=.raw.>).*(</AppendedData>.*)",
                              (tmp_path / "r.vtu").read_bytes(), re.DOTALL).groups()
    fields = ElementTree.fromstring(head + tail).find(".//FieldData")
    shown = printable(name)
    assert [array.get("Name") for array in fields] == [f"body:{shown}", f"body:{shown}2", f"contact:{shown}|{shown}2"]
    read = meshio.read(tmp_path / "r.vtu")
    np.testing.assert_array_equal(read.point_data["displacement"][:, :2], made.displacement)


def test_texts_stay_what_they_are_where_they_can():
    every = "".join(map(chr, [*range(0x110000)]))
    shown = printable(every)
    assert shown.encode() and printable(shown) == shown
    kept = set(shown)
    assert {c for c in every if c.isprintable()} | set("\t\n\r") <= kept
    assert printable("a\x00\x1b\udcff\ufffe\U0010ffff") == "a\\x00\\x1b\\udcff\\ufffe\\U0010ffff"


def _steps(count: int) -> list:
    result = two_bodies(2, 3, 2)
    return [dataclasses.replace(result, displacement=k * result.displacement) for k in range(count)]


def _listed(pvd) -> list[tuple[float, str]]:
    return [(float(entry.get("timestep")), entry.get("file")) for entry in ElementTree.parse(pvd).iter("DataSet")]


@pytest.mark.parametrize("path", ["run.pvd", "run"])
def test_a_series_lists_every_step_and_each_holds_its_result(tmp_path, path):
    steps = _steps(3)
    pvd = vtk_series(steps, tmp_path / path, times=(0.5, 1.0, 4.0))
    assert pvd == tmp_path / ("run.pvd" if path == "run.pvd" else "run/run.pvd")
    listed = _listed(pvd)
    assert [time for time, _ in listed] == [0.5, 1.0, 4.0]
    for (_, name), step in zip(listed, steps, strict=True):
        read = meshio.read(pvd.parent / name)
        np.testing.assert_array_equal(read.point_data["displacement"][:, :2], step.displacement)
    assert sorted(p.name for p in pvd.parent.iterdir()) == sorted(["run.pvd", *(name for _, name in listed)])


def test_a_series_replaces_an_older_one(tmp_path):
    vtk_series(_steps(3), tmp_path / "run.pvd")
    later = _steps(4)[2:]
    assert [time for time, _ in _listed(vtk_series(later, tmp_path / "run.pvd"))] == [0.0, 1.0]
    read = meshio.read(tmp_path / "run_0000.vtu")
    np.testing.assert_array_equal(read.point_data["displacement"][:, :2], later[0].displacement)


@pytest.mark.parametrize("path", ["run.pvd", "run"])
def test_a_series_is_written_whole_or_not_at_all(tmp_path, path):
    vtk_series(_steps(1), tmp_path / "old.pvd")
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    for bad, error in ([*_steps(2), result_on(None)], ValueError), ([*_steps(2), "result"], TypeError):
        with pytest.raises(error):
            vtk_series(bad, tmp_path / path)
        with pytest.raises(error):
            vtk_series(bad, tmp_path / "old.pvd")
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_a_series_whose_steps_cannot_all_be_put_in_place_has_no_list(tmp_path, monkeypatch):
    vtk_series(_steps(2), tmp_path / "run.pvd")
    replace = os.replace

    def failing(source, target):
        if target == tmp_path / "run_0001.vtu":
            raise OSError("disk full")
        replace(source, target)

    monkeypatch.setattr(vtu.os, "replace", failing)
    with pytest.raises(OSError, match="disk full"):
        vtk_series(_steps(2), tmp_path / "run.pvd")
    assert not (tmp_path / "run.pvd").exists()


def test_a_series_is_written_through_a_link_and_a_long_name_fits(tmp_path):
    (tmp_path / "there").mkdir()
    for target in ("there/old.pvd", "there/new.pvd"):
        (tmp_path / "run.pvd").unlink(missing_ok=True)
        (tmp_path / "run.pvd").symlink_to(tmp_path / target)
        for _ in range(2):
            vtk_series(_steps(1), tmp_path / "run.pvd")
            assert (tmp_path / "run.pvd").is_symlink() and len(_listed(tmp_path / target)) == 1
    name = "n" * 246
    assert _listed(vtk_series(_steps(1), tmp_path / f"{name}.pvd")) == [(0.0, f"{name}_0000.vtu")]


def test_a_series_checks_what_it_is_given(tmp_path):
    with pytest.raises(ValueError, match="at least one step"):
        vtk_series([], tmp_path / "run.pvd")
    with pytest.raises(ValueError, match="2 results, 1 times"):
        vtk_series(_steps(2), tmp_path / "run.pvd", times=[0.0])
    with pytest.raises(ValueError, match="pseudo-times"):
        vtk_series(_steps(3), tmp_path / "run.pvd", times=[0.0, 1.0, 0.5])
    with pytest.raises(ValueError, match=r"\.pvd file or a folder"):
        vtk_series(_steps(1), tmp_path / "run.vtu")
    with pytest.raises(FileNotFoundError):
        vtk_series(_steps(1), tmp_path / "nowhere" / "deep" / "run.pvd")
    assert not list(tmp_path.iterdir())
