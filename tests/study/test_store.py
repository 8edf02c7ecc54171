"""The store: two processes that write, a file that changes while it is in use, results that are
kept as files."""

import itertools
import json
import math
import os
import random
import re
import shutil
import sqlite3
import subprocess
import sys
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from matplotlib.figure import Figure

import adaptmg as am
from adaptmg._machine import process_name
from adaptmg.study import store as study_store
from adaptmg.study.designs import canonical
from adaptmg.study.store import Packed, Record, Store, new_owner, pack


def squares(n):
    return {"square": n * n}


def _removed(path):
    path.unlink()


def _replaced(path):
    path.unlink()
    Store(path)


def _folder_removed(path):
    shutil.rmtree(path.parent)


def _damaged(path):
    path.write_bytes(b"\xa5" * os.path.getsize(path))


def _locked(path):
    _locked.other = sqlite3.connect(path, isolation_level=None)
    _locked.other.execute("BEGIN EXCLUSIVE")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_removed, "was removed"),
        (_replaced, "replaced by another file"),
        (_folder_removed, "was removed"),
        (_damaged, "damaged"),
        (_locked, "another process holds it"),
    ],
)
def test_a_store_that_changes_while_it_is_in_use_is_named(tmp_path, monkeypatch, change, words):
    path = tmp_path / "deep" / "s.sqlite"
    monkeypatch.setattr(study_store, "_PATIENCE_S", 0.05)

    def run(n):
        if n == 6:
            change(path)
        return squares(n)

    study = am.Study(run, {"n": range(8)}, path, depends={"change": None})
    with pytest.raises((OSError, ValueError), match=rf"{re.escape(str(path))}.*{words}"):
        study.run(progress=False)
    if change is _locked:
        _locked.other.close()
        assert [record.results["square"] for record in Store(path).get("run").values()] == [
            n * n for n in range(6)
        ]


@pytest.mark.parametrize(
    ("pragma", "words"),
    [("PRAGMA query_only = ON", "write-protected"), ("PRAGMA max_page_count = 1", "make room")],
)
def test_a_full_disk_or_a_store_that_is_read_only(tmp_path, pragma, words):
    """Root may write everywhere and a test does not fill a disk: SQLite is told so."""
    path = tmp_path / "s.sqlite"
    am.Study(squares, {"n": range(4)}, path).run(progress=False)
    study = am.Study(squares, {"n": range(8)}, path)
    study._store._connection.execute(pragma)
    study._store._prepare()
    assert study.table()["status"].tolist()[:4] == ["done"] * 4
    study._function = lambda n: {"square": n * n, "text": "x" * 9000}
    with pytest.raises(OSError, match=rf"s\.sqlite: .*{words}"):
        study.run(progress=False)
    assert len(Store(path).get("squares")) >= 4


def test_processes_that_share_a_store_do_not_disturb_each_other(tmp_path):
    path = tmp_path / "s.sqlite"
    code = (
        "import sys\nfrom adaptmg.study import Study\n"
        "def run(n):\n    return {'m': n}\n"
        "sys.stdout.write('x'); sys.stdout.flush(); sys.stdin.read(1)\n"
        "Study(run, {'n': range(*map(int, sys.argv[2:4]))}, sys.argv[1], name=sys.argv[4]).run(progress=False)\n"
    )
    started = [
        subprocess.Popen(
            [sys.executable, "-c", code, str(path), first, last, name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        for first, last, name in (("0", "40", "one"), ("20", "60", "one"))
    ]
    for process in started:
        process.stdout.read(1)
    for process in started:
        process.stdin.write(b"x")
        process.stdin.close()
    am.Study(squares, {"n": range(40)}, path, name="two").run(progress=False)
    assert [process.wait() for process in started] == [0, 0]
    assert sorted(r.results["m"] for r in Store(path).get("one").values()) == list(range(60))
    assert len(Store(path).get("two")) == 40


def test_several_may_open_a_new_store_at_the_same_time(tmp_path):
    def opened(turn):
        together.wait()
        return Store(tmp_path / f"{turn}.sqlite").studies()

    together = threading.Barrier(6, timeout=60)
    with ThreadPoolExecutor(6) as pool:
        assert not any(pool.map(opened, [turn for turn in range(40) for _ in range(6)]))


def test_a_row_survives_a_power_cut(tmp_path):
    """That cannot be tested, but SQLite says whether it waits for the disk (2: FULL)."""
    store = Store(tmp_path / "s.sqlite")
    assert store._connection.execute("PRAGMA synchronous").fetchone() == (2,)
    assert store._connection.execute("PRAGMA journal_mode").fetchone() == ("delete",)


def test_a_row_whose_writing_was_interrupted_is_written(tmp_path, monkeypatch):
    study, turns = am.Study(squares, {"n": range(4)}, tmp_path / "s.sqlite"), iter(range(100))
    odd = Record(parameters={"n": 1}, status="failed", error="\udcff\x00", machine="\udcff")
    study._store.put("surrogates", [odd])
    assert study._store.get("surrogates")[canonical({"n": 1})] == odd
    check = study._store._check_there

    def interrupted():
        if next(turns) == 5:  # claimed and written in turn
            raise KeyboardInterrupt
        check()

    monkeypatch.setattr(study._store, "_check_there", interrupted)
    with pytest.raises(KeyboardInterrupt):
        study.run(progress=False)
    assert [
        record.parameters["n"] for record in Store(tmp_path / "s.sqlite").get("squares").values()
    ] == [0, 1, 2]


@pytest.mark.parametrize("rerun", [False, True])
def test_those_who_share_a_store_compute_each_point_once(tmp_path, rerun):
    done = []

    def run(n):
        done.append(n)
        time.sleep(0.05)
        return {"m": n}

    def study():
        return am.Study(run, {"n": range(8)}, tmp_path / "s.sqlite", depends={"done": None})

    if rerun:
        study().run(progress=False)
        done.clear()
    together = threading.Barrier(3)  # who looks into the store when others have run computes again
    with ThreadPoolExecutor(3) as pool:
        tables = list(
            pool.map(
                lambda one: one.run(progress=False, rerun=rerun, cost=lambda _: together.wait()),
                [study() for _ in range(3)],
            )
        )
    assert sorted(done) == list(range(8))
    assert all(table["m"].tolist() == list(range(8)) for table in tables)


def test_claims_of_live_processes_hold_those_of_dead_ones_not(tmp_path):
    store, key, here = Store(tmp_path / "s.sqlite"), canonical({"n": 1}), new_owner()
    ended = subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=-1)
    other = process_name(ended.pid)
    started_before = re.sub(r"\d+$", "5", here.split(" ")[0])
    owners = {other: True, here: True, f"{started_before} 1": False, "elsewhere-1-5 1": True}
    for owner, lives in owners.items():
        assert store.claim("s", [key], owner) == [True]
        assert store.claim("s", [key, canonical({"n": 2})], here) == [not lives, True]
        store.release(owner)
        store.release(here)
    assert store.claim("s", [key], other) == [True]
    ended.kill()
    while process_name(ended.pid):  # it is a zombie then: nobody has waited for it
        time.sleep(0.01)
    assert store.claim("s", [key], here) == [True]
    ended.communicate()


def test_a_claim_from_elsewhere_holds_while_it_is_renewed(tmp_path, monkeypatch):
    """Whatever the clocks say, of which there are as many as machines."""
    monkeypatch.setattr(study_store, "_RENEWAL_S", 0.02)
    monkeypatch.setattr(study_store, "_LEASE_S", 0.3)
    there, here = (Store(tmp_path / "s.sqlite") for _ in range(2))
    end = time.monotonic() + 1.0
    with there.claims_of("elsewhere-1-5 1"):
        there.claim("s", ["{}"], "elsewhere-1-5 1")
        for step in itertools.count():
            monkeypatch.setattr(time, "time", lambda step=step: 1e9 + (-1) ** step * 1e7)
            assert here.claim("s", ["{}"], new_owner()) == [False]
            if time.monotonic() > end:
                break
            time.sleep(0.02)
    assert here.claim("s", ["{}"], "elsewhere-1-5 2") == [
        True
    ]  # given up, and claimed by a machine that dies
    begin = time.monotonic()
    while there.claim("s", ["{}"], new_owner()) == [False]:
        time.sleep(0.02)
    assert 0.3 <= time.monotonic() - begin < 1.0


def test_a_flipped_bit_is_never_another_number(tmp_path):
    """Of 300: an error, a stale row, or, where no row lies, what was stored."""
    path, values = tmp_path / "s.sqlite", np.random.default_rng(0).random((3, 3000))
    study = am.Study(lambda n: {"u": values[n], "sum": float(values[n].sum())}, {"n": [0, 1, 2]}, path,
                  name="s", depends={"values": None})  # fmt: skip
    study.run(progress=False)
    content, flips = path.read_bytes(), random.Random(0)
    seen = Counter()
    for _ in range(300):
        at, bit = flips.randrange(len(content)), flips.randrange(8)
        path.write_bytes(content[:at] + bytes([content[at] ^ 1 << bit]) + content[at + 1 :])
        try:
            again = am.Study(
                study._function, {"n": [0, 1, 2]}, path, name="s", depends={"values": None}
            )
            table = again.table()
            for n in np.flatnonzero(table["status"] == "done"):
                assert table["sum"][n] == values[n].sum()
                np.testing.assert_array_equal(again.load(int(n), "u"), values[n])
            seen[" ".join(sorted(set(table["status"])))] += 1
        except (OSError, ValueError) as error:
            assert "s.sqlite" in str(error) or "keeps" in str(error), error
            seen["refused"] += 1
    assert seen["refused"] > 100 and seen["done stale"] > 2, seen


def test_a_damaged_row_is_computed_again(tmp_path):
    def study():
        return am.Study(squares, {"n": [1, 2]}, tmp_path / "s.sqlite")

    study().run(progress=False)
    with sqlite3.connect(tmp_path / "s.sqlite") as file:
        file.execute("UPDATE runs SET record = replace(record, '\"square\": 4', '\"square\": 5')")
    assert study().status().reasons == {"DamagedRow: the store does not hold what was written": 1}
    assert study().run(progress=False)["square"].tolist() == [1, 4]


def test_errors_are_bounded_and_any_text_is_stored(tmp_path):
    def run(n):
        if n == 0:
            raise ValueError("\udcff\x00" + "x" * 10**6)
        return {"name": "\udcff.msh"}

    table = am.Study(run, {"n": [0, 1]}, tmp_path / "s.sqlite").run(progress=False)
    assert (
        table["error"][0].startswith("ValueError: \udcff\x00xxx") and len(table["error"][0]) == 4000
    )
    assert table["name"][1] == "\udcff.msh"


@pytest.mark.parametrize("where", ["file", "memory"])
def test_arrays_meshes_results_and_figures_are_kept(tmp_path, where):
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    result = am.solve(grids, am.FullMultigrid(), throw=False)
    given = {
        "array": np.arange(6.0).reshape(2, 3),
        "mesh": grids.finest.mesh,
        "result": result,
        "n_nodes": 25,
        "figure": Figure(),
    }
    study = am.Study(
        lambda n: given,
        {"n": [1]},
        tmp_path / "s.sqlite" if where == "file" else None,
        name="s",
        depends={"given": None},
    )
    table = study.run(progress=False)
    assert table["status"][0] == "done" and table["n_nodes"][0] == 25, table["error"][0]
    back = study.load(table.iloc[0])
    np.testing.assert_array_equal(back["array"], given["array"])
    np.testing.assert_array_equal(back["mesh"].elements, grids.finest.mesh.elements)
    assert back["mesh"].boundaries == grids.finest.mesh.boundaries
    np.testing.assert_array_equal(back["result"].displacement, result.displacement)
    assert back["figure"].lstrip().startswith("<?xml") and table["array"][0] == "array"
    given["array"] = given["array"] + 1
    study.run(progress=False, rerun=True)
    assert study.load(0, "array")[0, 0] == 1.0
    with pytest.raises(ValueError, match="did you mean 'array'"):
        study.load(0, "arrey")
    given["array"] = 1.0
    study.run(progress=False, rerun=True)
    assert sorted(study.load(0)) == ["figure", "mesh", "result"]


def test_what_is_kept_is_stored_with_its_row_or_not_at_all(tmp_path, monkeypatch):
    study = am.Study(lambda n: {"a": np.arange(n)}, {"n": [3]}, tmp_path / "s.sqlite", name="s")
    with pytest.raises(ValueError, match=r"keeps nothing \(it is not in the store\)"):
        study.load(0)
    study.run(progress=False)
    store = Store(tmp_path / "s.sqlite")
    row = Record(parameters={"n": 3}, status="done")
    store._connection.execute("PRAGMA max_page_count = 20")
    with pytest.raises(OSError, match="make room"):
        store.put("s", [row], None, [{"a": Packed("array", bytes(10**6))}])
    store._connection.execute("PRAGMA max_page_count = 1000000")
    assert study.load(0, "a").tolist() == [0, 1, 2] and store.get("s")[
        canonical({"n": 3})
    ].results == {"a": "array"}
    large = am.MeshArrays(
        np.zeros((10**7, 2)), np.zeros((1, 3), int), np.zeros((1, 2), int), [0], ["a"]
    )
    store.put("s", [row], None, [{"a": pack(large)}])
    with pytest.raises(ValueError, match="would unpack to"):
        study.load(0)
    monkeypatch.setattr(study_store, "_MOST_BYTES", 100)
    with pytest.raises(ValueError, match="cannot be kept, at most 100"):
        pack(np.ones(99))


def test_a_link_to_a_store_is_followed(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link.sqlite").symlink_to(tmp_path / "real" / "s.sqlite")
    am.Study(lambda n: {"a": np.ones(2)}, {"n": [1]}, tmp_path / "link.sqlite", name="s").run(
        progress=False
    )
    assert sorted(path.name for path in (tmp_path / "real").iterdir()) == ["s.sqlite"]
    assert (tmp_path / "link.sqlite").is_symlink()


def test_the_text_of_a_point_is_json_and_of_no_other_value(tmp_path):
    values = [
        1,
        1.0,
        True,
        "1",
        0,
        0.0,
        -0.0,
        False,
        None,
        "None",
        (1,),
        (1.0,),
        math.nan,
        math.inf,
        (),
        10**30,
        1e300,
        'a"\\\n\u00e9',
        (1, (2.0, "b")),
    ]
    for value in values:
        point = {"b": value, "a\u00e9": 1}
        assert canonical(point) == json.dumps(
            point, sort_keys=True, separators=(",", ":"), ensure_ascii=False
        )
        assert canonical(point) == canonical(dict(reversed(point.items())))
    study = am.Study(
        lambda x: {"kind": type(x).__name__}, {"x": values}, tmp_path / "s.sqlite", name="s"
    )
    assert study.run(progress=False)["kind"].tolist() == [type(value).__name__ for value in values]
    back = [record.parameters["x"] for record in Store(tmp_path / "s.sqlite").get("s").values()]
    assert repr(back) == repr(values)
