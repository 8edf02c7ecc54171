"""What a run depends on: everything that changes its results, and nothing that does not."""

import importlib
import os
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import adaptmg as am
from adaptmg.solver.fingerprint import environment, fingerprint
from adaptmg.study.store import Record

FACTOR = 2


def uses_factor(n):
    return {"m": FACTOR * n}


def test_rows_of_another_version_of_the_fingerprint_are_stale(tmp_path):
    study = am.Study(uses_factor, {"n": [1]}, tmp_path / "s.sqlite")
    old = Record(
        parameters={"n": 1},
        status="done",
        results={"m": 5},
        code="of another form",
        versions=environment(),
    )
    study._store.put("uses_factor", [old], {"module test_fingerprint": "1"})
    assert study.status().reasons["module test_fingerprint is gone"] == 1
    assert study.run(progress=False)["m"].tolist() == [2] and study.status().done == 1


def test_a_script_is_the_same_run_or_imported(tmp_path, monkeypatch):
    script = (
        "from dataclasses import dataclass\nLIMIT = 3\n@dataclass\nclass Size:\n    h: float = 1.0\n"
        "    def area(self):\n        return self.h**2\nSIZE = Size()\n"
        "def run(n):\n    return {'m': n * LIMIT * SIZE.area()}\n"
        "if __name__ == '__main__':\n    from adaptmg.solver.fingerprint import fingerprint\n"
        "    f = fingerprint(run)\n    print(f.code, *sorted(f.parts), sep='\\n')\n"
    )
    (tmp_path / "started.py").write_text(script, encoding="utf-8")
    run = subprocess.run(
        [sys.executable, str(tmp_path / "started.py")], capture_output=True, text=True, check=True
    )
    monkeypatch.syspath_prepend(tmp_path)
    imported = fingerprint(importlib.import_module("started").run)
    assert run.stdout.splitlines() == [imported.code, *sorted(imported.parts)]
    assert "value of started.LIMIT" in imported.parts


def test_adaptmg_and_packages_count_where_they_are_used():
    def uniform(n):
        grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(n, 2 * n))
        return {"cycles": am.solve(grids, am.FullMultigrid()).cycles}

    def none(n):
        return {"n": n}

    def numbers(n):
        return {"m": np.sqrt(n)}

    assert "adaptmg" in fingerprint(uniform).parts and "adaptmg" not in fingerprint(none).parts
    assert (
        "package numpy" not in fingerprint(none).parts
        and "package numpy" in fingerprint(numbers).parts
    )


def test_sources_edited_after_they_were_loaded_are_refused(tmp_path):
    """By their times alone, whatever the clock says: a copy whose files are dated in the future
    runs. Pictures are not numerical."""
    package = tmp_path / "adaptmg"
    shutil.copytree(Path(am.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    source = package / "hierarchy.py"
    os.utime(source, (4e9, 4e9))
    run = subprocess.run(
        [
            sys.executable,
            "-c",
            "import os, adaptmg as am, adaptmg.plot.style\n"
            "from adaptmg.solver.fingerprint import _sources\n"
            "def edit(*names):\n"
            "    os.utime(os.path.join(am.__path__[0], *names), (5e9, 5e9))\n"
            "    _sources.cache_clear()\n    _sources()\n"
            "am.Study(lambda n: {'m': len(am.cases.__name__)}, {'n': [1]})\n"
            "edit('plot', 'style.py')\nprint('sound')\nedit('hierarchy.py')",
        ],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert run.stdout == "sound\n"
    assert "hierarchy.py was edited after adaptmg was loaded: start Python again" in run.stderr


class Locked:
    lock = threading.Lock()

    def twice(self):
        return FACTOR * 2


def uses_locked(n):
    return {"m": Locked().twice() * n}


@pytest.fixture
def restored():
    """The value of FACTOR, which it has again after the test."""
    before = FACTOR
    yield before
    globals()["FACTOR"] = before


def test_what_is_named_for_an_attribute_replaces_it_alone(restored):
    with pytest.raises(TypeError, match=r"Locked\.lock.*depends=\{'lock'"):
        fingerprint(uses_locked)
    before = fingerprint(uses_locked, {"lock": None})
    assert fingerprint(uses_locked, {"lock": "seed 0"}).code != before.code
    globals()["FACTOR"] = 3
    changed = fingerprint(uses_locked, {"lock": None}).differences(before.parts)
    assert changed == ["value of test_fingerprint.FACTOR is changed"]


#: names that scripts have at their top, and what they make there
OF_LIBRARIES = {
    "pandas": "from pandas import DataFrame, Categorical, Timestamp\n"
    "frame = DataFrame({'a': [1, 2], 'b': ['x', 'y']})\nday = Timestamp('2020-01-01')\nkinds = Categorical(['a', 'b'])",
    "numpy": "from numpy.random import default_rng, RandomState\nfrom numpy import sin, linalg",
    "scipy": "from scipy.stats import norm, qmc\nfrom scipy.spatial import cKDTree\nfrozen = norm(0, 1)\n"
    "tree = cKDTree([[0.0], [1.0]])",
    "ngsolve": "from ngsolve import Mesh, H1, x, CoefficientFunction\nfrom netgen.geom2d import unit_square\n"
    "from netgen.meshing import Element2D\nfield = x * x",
}


def test_globals_of_libraries_count_by_the_version(tmp_path, monkeypatch):
    """And are the same in another process with other hashes."""
    lines = "\n".join(OF_LIBRARIES.values())
    names = [
        name
        for line in lines.splitlines()
        for name in (line.split(" import ")[1:] or [line.split(" = ")[0]])
    ]
    script = (
        f"{lines}\ndef run(n):\n    used = [{', '.join(names)}]\n    return {{'m': n + len(used)}}\n"
        "if __name__ == '__main__':\n    import adaptmg as am, sys\n"
        "    print(*am.Study(run, {'n': [1]}, sys.argv[1]).table()['status'])\n"
    )
    (tmp_path / "of_libraries.py").write_text(script, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    imported = importlib.import_module("of_libraries").run
    am.Study(imported, {"n": [1]}, tmp_path / "s.sqlite").run(progress=False)
    ended = subprocess.run(
        [sys.executable, str(tmp_path / "of_libraries.py"), str(tmp_path / "s.sqlite")],
        env=os.environ | {"PYTHONHASHSEED": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert ended.stdout == "done\n"
    parts = fingerprint(imported).parts
    assert {f"package {library}" for library in OF_LIBRARIES} <= set(parts)
    assert not [part for part in parts if part.startswith("class ")]


@pytest.mark.parametrize(
    "made",
    [
        "threading.Lock()",
        "np.random.default_rng(1)",
        "np.random.RandomState(1)",
        "np.random.rand",
        "np.random.default_rng(1).normal",
        "scipy.linalg.lapack.dgetrf",
        "ngsolve.Mesh(netgen.geom2d.unit_square.GenerateMesh(maxh=0.5))",
        "(i for i in range(3))",
        "{'deep': [Holder(threading.Lock())]}",
    ],
)
def test_the_remedy_for_what_is_refused_works(made):
    namespace = {"__name__": "__main__", "Holder": Holder}
    exec(
        "import threading, scipy.linalg, ngsolve, netgen.geom2d\nimport numpy as np\n"
        f"given = {made}\ndef run(n):\n    return {{'m': n * (given is not None)}}",
        namespace,
    )
    with pytest.raises(TypeError, match=r"depends=\{'\w+': \.\.\.\}") as refused:
        am.Study(namespace["run"], {"n": [1]})
    name = re.search(r"depends=\{'(\w+)'", str(refused.value))[1]
    study = am.Study(namespace["run"], {"n": [1]}, depends={name: "a text"})
    assert study.run(progress=False)["m"].tolist() == [1]


def scaled_by(modules):
    return lambda n: {"m": n * modules}


def test_a_variable_may_have_the_name_of_what_is_hidden():
    two, three = (fingerprint(scaled_by(factor)).code for factor in (2.0, 3.0))
    assert two != three


class Holder:
    def __init__(self, held):
        self.held = held


def test_contents_of_files_count_wherever_depends_names_them(tmp_path):
    file = tmp_path / "mesh.txt"
    for inside in (lambda path: path, lambda path: [{"mesh": path}]):
        seen = set()
        for text in ("a", "b", "a"):
            file.write_text(text, encoding="utf-8")
            seen.add(fingerprint(uses_factor, {"data": inside(file)}).code)
        assert len(seen) == 2 and fingerprint(uses_factor).code not in seen
    for path in (Path("/dev/zero"), tmp_path, tmp_path / "none"):
        with pytest.raises(ValueError, match="must be a file"):
            fingerprint(uses_factor, {"data": path})


def test_a_run_that_sets_a_global_is_not_stored_under_the_old(restored, tmp_path):
    def run(n):
        global FACTOR
        FACTOR = n
        return {"m": FACTOR}

    with pytest.warns(UserWarning, match="FACTOR is changed"):
        am.Study(run, {"n": [7]}, tmp_path / "s.sqlite").run(progress=False)
    assert am.Study(run, {"n": [7]}, tmp_path / "s.sqlite").table()["status"].tolist() == ["stale"]
    globals()["FACTOR"] = restored
    assert am.Study(run, {"n": [7]}, tmp_path / "s.sqlite").table()["status"].tolist() == ["done"]


def test_deep_calls_and_circles_are_walked():
    namespace = {"__name__": "__main__"}
    exec(
        "\n".join(f"def f{k}(n):\n    return f{k + 1}(n)" for k in range(2000))
        + "\ndef f2000(n):\n    return {'m': n, 'f': f0.__name__}",
        namespace,
    )
    assert len(fingerprint(namespace["f0"]).parts) == 2001


def test_the_closure_of_a_run_function_of_adaptmg_is_seen():
    """Such as that of a study file."""

    def made(size):
        def run(n):
            return {"m": n * size}

        run.__module__ = "adaptmg.cli"
        return run

    first, other = fingerprint(made(1)), fingerprint(made(2))
    assert "adaptmg" in first.parts and first.code == fingerprint(made(1)).code != other.code
