"""Results in files and in other processes: what is saved or sent comes back; what is damaged is in tests/hostile."""

import copy
import os
import pickle
from dataclasses import fields, replace
from types import MappingProxyType

import numpy as np
import pytest
from made import cube, result_on, same, square

import adaptmg as am
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.solver.load_path import StepNotConverged
from adaptmg.solver.result import KINDS
from adaptmg.solver.store import packed, read

cloudpickle = pytest.importorskip("cloudpickle")


def moved(result: am.Result, folder) -> am.Result:
    result.save(folder / "r.npz")
    return am.Result.load(folder / "r.npz")


@pytest.mark.parametrize("result", [result_on(square(3)), result_on(cube(2)), result_on(None),
                                    result_on(square(2), history={}, path=[], levels=[], timings={})],
                         ids=["2D", "3D", "bare", "without a history"])
def test_every_field_comes_back(tmp_path, result):
    found = moved(result, tmp_path)
    assert same(found, result)
    assert {f.name for f in fields(found)} == {f.name for f in fields(result)}


def test_numbers_of_numpy_become_plain_ones(tmp_path):
    plain = result_on(square(2))
    given = replace(plain, cycles=np.int32(11), work_units=np.float32(47), residual=np.array(1e-9),
                    timings=MappingProxyType({"setup": np.float64(0.01), np.str_("cycles"): np.float64(0.2)}),
                    path=[(np.int64(level), np.str_(action), np.int8(times)) for level, action, times in plain.path],
                    levels=[{name: np.float64(v) for name, v in row.items()} for row in plain.levels])
    found = moved(given, tmp_path)
    assert type(found.cycles) is int and found.levels == plain.levels
    assert found.timings == plain.timings and found.path == plain.path


def test_what_did_not_converge_may_hold_what_is_not_finite(tmp_path):
    bad = result_on(square(2), status=am.Status.DIVERGED, displacement=np.full((9, 2), np.nan), residual=float("inf"))
    found = moved(bad, tmp_path)
    assert np.isnan(found.displacement).all() and found.residual == float("inf")


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
    more = {"a.b": np.arange(3), "a": {"b": np.ones(2)}, "c/d": (result.displacement, [result.mesh, result])}
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
    big = replace(result_on(square(2)), displacement=points, reaction=np.zeros((n, 2)),
                  mesh=MeshArrays(points, elements, elements[:, :2], np.zeros(4), ("bottom",)))
    assert same(moved(big, tmp_path), big)


def unfinished() -> am.Result:
    return result_on(square(3), status=am.Status.LIMIT)


def some_path() -> am.PathResult:
    return am.PathResult((result_on(square(3)), unfinished()), {"left": np.array([0.5, 1.0, 0.0])}, {"problem": "x"}, 3)


WAYS = {"pickle": lambda x: pickle.loads(pickle.dumps(x)), "oldest": lambda x: pickle.loads(pickle.dumps(x, 2)),
        "cloudpickle": lambda x: cloudpickle.loads(cloudpickle.dumps(x)), "copy": copy.copy, "deepcopy": copy.deepcopy}
THINGS = {"result": unfinished, "contact": lambda: unfinished().contact, "path": some_path, "mesh": lambda: cube(2),
          "meshed": lambda: am.mesh.structured(am.Rectangle(width=1.0, height=1.0), 2),
          "bare": lambda: result_on(None), "load path": lambda: am.LoadPath({"left": [1, 0.5]})}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("thing", THINGS)
def test_data_come_back_as_they_were(thing, way):
    given = THINGS[thing]()
    found = WAYS[way](given)
    assert same(given, found)
    if isinstance(given, am.MeshArrays):
        assert not any(getattr(found, name).flags.writeable for name in ("points", "elements", "facets"))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("error", [am.NotConverged(unfinished()),
                                   StepNotConverged(unfinished(), 1, "left 1", some_path())])
def test_exceptions_keep_what_they_carry(error, way):
    error.add_note("seen in a worker")
    found = WAYS[way](error)
    assert type(found) is type(error) and str(found) == str(error) and same(found.result, error.result)
    if isinstance(error, StepNotConverged):
        assert found.step == 1 and same(found.partial, error.partial)


def test_a_copy_keeps_the_ngsolve_mesh_and_a_pickle_needs_none():
    mesh = am.mesh.structured(am.Rectangle(width=1.0, height=1.0), 2)
    assert copy.copy(mesh).source is mesh.source is copy.deepcopy(mesh).source
    assert pickle.loads(pickle.dumps(mesh)).source is None
