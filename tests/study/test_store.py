"""The store: two processes at once, and everything that can happen to a file while it is in use."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import adaptmg as am
from adaptmg.cli import app
from adaptmg.study import Study
from adaptmg.study import store as study_store
from adaptmg.study.record import Record, bounded, canonical
from adaptmg.study.store import Store


def squares(n):
    return {"square": n * n}


def _rescued(error: pytest.ExceptionInfo) -> Path:
    """The file that an error names."""
    found = Path(re.search(r"safe in (\S+): bring", str(error.value))[1])
    assert len(list(found.parent.glob("*.rescued-*"))) == 1
    return found


def _taken_back(store: Path, error: pytest.ExceptionInfo) -> dict[str, Record]:
    """Runs after the advice of the error was followed, command and all."""
    rescued, command = _rescued(error), shlex.split(str(error.value).split("bring them back with: ")[1])
    assert command == ["adaptmg", "runs", str(store), "--take-in", str(rescued)]
    if "Move the damaged file away" in str(error.value):
        store.rename(store.with_suffix(".damaged"))
    with pytest.raises(SystemExit) as end:
        app(command[1:], prog_name="adaptmg")
    assert not end.value.code
    rescued.unlink()
    return Store(store).get("squares")


def _sweep(path: Path, change) -> pytest.ExceptionInfo:
    """Four of eight points are there; of the others the third changes the store while it is in use."""
    Study(squares, {"n": range(4)}, path).run(progress=False)

    def run(n):
        if n == 6:
            change()
        return squares(n)

    study = Study(run, {"n": range(4, 8)}, path, name="squares", depends={"change": None})
    with pytest.raises((OSError, ValueError), match=re.escape(str(path))) as error:
        study.run(progress=False)
    return error


@pytest.mark.parametrize("how", ["removed", "replaced", "folder removed"])
def test_a_store_that_is_removed_or_replaced_while_in_use(tmp_path, how):
    path = tmp_path / "deep" / "s.sqlite"

    def change():
        if how == "folder removed":
            shutil.rmtree(path.parent)
        else:
            path.unlink()
        if how == "replaced":
            Store(path)

    error = _sweep(path, change)
    assert ("replaced by another file" if how == "replaced" else "was removed") in str(error.value)
    back = _taken_back(path, error)
    assert [r.results["square"] for r in back.values()] == [k * k for k in range(7)]


def test_a_store_that_is_damaged_while_in_use(tmp_path):
    path = tmp_path / "s.sqlite"

    def change():
        with open(path, "r+b") as file:
            file.write(b"\xa5" * os.path.getsize(path))

    error = _sweep(path, change)
    assert "damaged" in str(error.value)
    back = _taken_back(path, error)
    # what this process computed; the rest was damaged
    assert {n for n in range(4, 7)} <= {r.parameters["n"] for r in back.values()}


def test_a_store_that_is_locked_while_in_use(tmp_path, monkeypatch):
    path = tmp_path / "s.sqlite"
    monkeypatch.setattr(study_store, "_PATIENCE_S", 0.05)
    others = []

    def change():
        others.append(sqlite3.connect(path, isolation_level=None))
        others[0].execute("BEGIN EXCLUSIVE")

    error = _sweep(path, change)
    assert "another process holds it" in str(error.value)
    others[0].close()
    assert len(_taken_back(path, error)) == 7


@pytest.mark.parametrize(("pragma", "words"), [("PRAGMA query_only = ON", "write-protected"),
                                               ("PRAGMA max_page_count = 1", "make room")])
def test_a_disk_that_is_full_or_a_store_that_is_read_only(tmp_path, pragma, words):
    """As root may write everywhere and a disk is not filled in a test: SQLite is told so."""
    path = tmp_path / "s.sqlite"
    Study(squares, {"n": range(4)}, path).run(progress=False)
    study = Study(squares, {"n": range(8)}, path)
    study._store._connection.execute(pragma)

    def long(n):
        return {"square": n * n, "text": "x" * 9000}

    study._function = long
    with pytest.raises(OSError, match=words) as error:
        study.run(progress=False)
    assert study.table()["status"].tolist()[:4] != []  # it can be read all the same
    assert len(_taken_back(path, error)) >= 4


def test_two_sweeps_on_one_store_do_not_disturb_each_other(tmp_path):
    path = tmp_path / "s.sqlite"
    code = ("import sys\nfrom adaptmg.study import Study\n"
            "def run(n):\n    return {'m': n}\n"
            "Study(run, {'n': range(*map(int, sys.argv[2:4]))}, sys.argv[1], name=sys.argv[4]).run(progress=False)\n")
    started = [subprocess.Popen([sys.executable, "-c", code, str(path), first, last, name])
               for first, last, name in (("0", "40", "one"), ("20", "60", "one"), ("0", "40", "two"))]
    assert [process.wait() for process in started] == [0, 0, 0]
    assert sorted(r.results["m"] for r in Store(path).get("one").values()) == list(range(60))
    assert len(Store(path).get("two")) == 40


def test_a_store_of_the_first_version_is_read_and_brought_up_to_date(tmp_path):
    path = tmp_path / "s.sqlite"
    with sqlite3.connect(path) as old:
        old.execute("CREATE TABLE runs (study TEXT NOT NULL, parameters TEXT NOT NULL, status TEXT NOT NULL CHECK "
                    "(status IN ('done', 'failed')), results TEXT NOT NULL, error TEXT NOT NULL, seconds REAL NOT NULL,"
                    " code TEXT NOT NULL, versions TEXT NOT NULL, finished TEXT NOT NULL, "
                    "PRIMARY KEY (study, parameters))")
        old.execute("INSERT INTO runs VALUES ('squares', '{\"n\":2}', 'done', '{\"square\": 4}', '', 0.5, 'abc', "
                    "'{\"python\": \"3\"}', '2025-01-01T00:00:00+00:00')")
        old.execute("PRAGMA user_version = 1")
    old.close()
    study = Study(squares, {"n": [2, 3]}, path)
    assert study.table()["status"].tolist() == ["stale", "missing"]
    assert study.table()["square"][0] == 4 and study.table(details=True)["tries"][0] == 1
    assert any("did not say" in reason for reason in study.status().reasons)
    assert study.run(progress=False)["status"].tolist() == ["done", "done"]


def test_texts_are_bounded_and_any_text_is_stored(tmp_path):
    def run(n):
        if n == 0:
            raise ValueError("x" * 10**6 + "\udcff\x00 the end")
        return {"name": "\udcff.msh", "long": "y" * 50_000}

    study = Study(run, {"n": [0, 1]}, tmp_path / "s.sqlite")
    table = study.run(progress=False)
    assert len(table["error"][0]) < 5000 and "characters left out" in table["error"][0]
    assert table["error"][0].endswith("the end")
    assert len(study.table(details=True)["traceback"][0]) < 21_000
    assert table["name"][1] == "\udcff.msh" and len(table["long"][1]) < 200
    assert study.load(1, "long") == "y" * 50_000
    assert bounded("abc", 100) == "abc"


def test_results_too_large_for_a_row_are_a_failure():
    table = Study(lambda n: {f"r{k}": "z" * 9000 for k in range(40)}, {"n": [1]}).run(progress=False)
    assert table["status"][0] == "failed" and "return arrays" in table["error"][0]
    table = Study(lambda n: {"r": 10**5000}, {"n": [1]}).run(progress=False)
    assert table["status"][0] == "failed"


@pytest.mark.parametrize("where", ["file", "memory"])
def test_arrays_meshes_results_and_figures_are_kept_and_given_back(tmp_path, where):
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    result = am.solve(grids, am.FullMultigrid(), throw=False)
    given = {"array": np.arange(6.0).reshape(2, 3), "mesh": grids.finest.mesh, "result": result, "n_nodes": 25,
             "figure": Figure()}

    def run(n):
        return given

    path = tmp_path / "s.sqlite" if where == "file" else None
    study = Study(run, {"n": [1]}, path, depends={"given": None})
    table = study.run(progress=False)
    assert table["status"][0] == "done" and table["n_nodes"][0] == 25, table["error"][0]
    back = study.load(table.iloc[0])
    np.testing.assert_array_equal(back["array"], given["array"])
    np.testing.assert_array_equal(back["mesh"].elements, grids.finest.mesh.elements)
    assert back["mesh"].boundaries == grids.finest.mesh.boundaries
    np.testing.assert_array_equal(back["result"].displacement, result.displacement)
    assert back["figure"].read_text(encoding="utf-8").lstrip().startswith("<?xml")
    if path is not None:
        assert all((tmp_path / "s.sqlite.files" / table[name][0]).is_file() for name in ("array", "mesh", "figure"))
        given["array"] = given["array"] + 1
        study.run(progress=False, rerun=True)
        assert study.load(0, "array")[0, 0] == 1.0
        # the old one is gone
        assert len(list((tmp_path / "s.sqlite.files").rglob("array*.npy"))) == 1
    with pytest.raises(ValueError, match="did you mean 'array'"):
        study.load(0, "arrey")


def test_a_kept_file_that_is_gone_or_damaged_is_named_and_made_again(tmp_path):
    study = Study(lambda n: {"a": np.arange(3), "t": "x" * 20_000, "f": Figure()}, {"n": [1]}, tmp_path / "s.sqlite")
    table = study.run(progress=False)
    for name in "atf":
        file = tmp_path / "s.sqlite.files" / table[name][0]
        content = file.read_bytes()
        for damage in (b"junk", content[:-1] + bytes([content[-1] ^ 1])):
            file.write_bytes(damage)
            with pytest.raises(ValueError, match=rf"{re.escape(str(file))} is damaged.*rerun=True"):
                study.load(0, name)
        study.run(progress=False, rerun=True)
        assert study.load(0, name) is not None
    file.unlink()
    with pytest.raises(FileNotFoundError, match="no longer there"):
        study.load(0)


@pytest.mark.parametrize("value", [1, -2.5, 1e300, -0.0, "a\"\\\n\u00e9", True, None, (1, (2.0, "b")), float("inf"),
                                   float("nan"), 10**30, ()])
def test_the_text_of_a_point_is_that_of_json(value):
    import json

    point = {"b": value, "a\u00e9": 1}
    assert canonical(point) == json.dumps(point, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def test_values_that_look_alike_are_different_points():
    values = [1, 1.0, True, "1", 0, 0.0, -0.0, False, None, "None", (1,), (1.0,), float("nan")]
    assert len({canonical({"x": value}) for value in values}) == len(values)
    table = Study(lambda x: {"kind": type(x).__name__}, {"x": values}).run(progress=False)
    assert table["kind"].tolist() == [type(value).__name__ for value in values]
