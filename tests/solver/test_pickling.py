"""Results, meshes and exceptions go to other processes and come back: a pool hangs on what it cannot unpickle."""

import copy
import pickle

import numpy as np
import pytest
from made import cube, result_on, same, square

import adaptmg as am
from adaptmg.solver.load_path import StepNotConverged
from adaptmg.solver.record import Status
from adaptmg.solver.result import NotConverged

cloudpickle = pytest.importorskip("cloudpickle")


def unfinished() -> am.Result:
    return result_on(square(3), status=Status.LIMIT)


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
@pytest.mark.parametrize("error", [NotConverged(unfinished()),
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
