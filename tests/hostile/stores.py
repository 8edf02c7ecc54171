"""Damaged stores: of load paths (a folder of step files) and of studies (a database); each error
names the file."""

import functools
import json
import os
import shutil
import sqlite3
from pathlib import Path

import numpy as np
from hostile_table import Hostile, each

import adaptmg as am
from adaptmg.study import store as study_store
from adaptmg.study.store import Record

STEPS, FACTORS = 3, {"left": np.array([0.5, 1.0, 0.0])}


@functools.cache
def results() -> tuple[am.Result, ...]:
    from made import result_on, square

    return tuple(result_on(square(2), cycles=k) for k in range(STEPS))


@functools.cache
def files(mark: str, mesh_of: int) -> dict[str, bytes]:
    """Those of a whole store of a load path."""
    from made import result_on, square

    found = results() if mesh_of == 2 else [result_on(square(mesh_of))] * STEPS
    folder = Path(f"made-{mark}")
    am.PathResult(tuple(found), FACTORS, {"problem": mark}, STEPS).save(folder)
    am.PathResult.load(folder)
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def kept(name: str, mark: str = "mine", mesh_of: int = 2) -> Path:
    """A whole store of a load path."""
    folder = Path(name)
    folder.mkdir()
    for file, data in files(mark, mesh_of).items():
        (folder / file).write_bytes(data)
    return folder


def _swapped(folder: Path) -> None:
    first, last, aside = folder / "step_0001.npz", folder / "step_0002.npz", folder / "x"
    first.rename(aside), last.rename(first), aside.rename(last)


def _copied(source: str, target: str):
    return lambda folder: shutil.copy(folder / source, folder / target)


def _cut(name: str, share: float = 0.5):
    return lambda folder: os.truncate(folder / name, int(share * (folder / name).stat().st_size))


def _head(**changes: object):
    """Another path.json, with the key that was there."""

    def change(folder: Path) -> None:
        text = json.loads((folder / "path.json").read_text())
        (folder / "path.json").write_text(
            json.dumps({k: v for k, v in (text | changes).items() if v != "gone"})
        )

    return change


def _foreign(**options: object):
    return lambda folder: shutil.copy(
        kept("other", **options) / "step_0001.npz", folder / "step_0001.npz"
    )


#: what is done to a whole store, by the part of it that the message names
_PATHS = {
    "step_0001.npz": {
        "steps swapped": _swapped,
        "a step of another path": _foreign(mark="another"),
        "a step on another mesh": _foreign(mark="a", mesh_of=3),
        "a step that is a pipe": lambda folder: (
            (folder / "step_0001.npz").unlink(),
            os.mkfifo(folder / "step_0001.npz"),
        ),
        "a step missing": lambda folder: (folder / "step_0001.npz").unlink(),
    },
    "step_0002.npz": {"half a step": _cut("step_0002.npz")},
    "step_0003.npz": {"a step too many": _copied("step_0002.npz", "step_0003.npz")},
    "path.json": {
        "no head": lambda folder: (folder / "path.json").unlink(),
        "deep": lambda folder: (folder / "path.json").write_bytes(b"[" * 10**5),
        "a head that is a pipe": lambda folder: (
            (folder / "path.json").unlink(),
            os.mkfifo(folder / "path.json"),
        ),
        "other factors": _head(factors={"left": [0.5, 1.0, 0.1]}),
        "no factors": _head(factors="gone"),
    },
    "store": {"a newer version": _head(format=10)},
}


def _paths():
    for says, changes in _PATHS.items():
        for name, change in changes.items():
            yield Hostile(
                f"path: {name}",
                lambda c=change: (c(kept("store")), am.PathResult.load("store")),
                says,
                ValueError,
                writes=True,
            )
    yield Hostile(
        "loop: a head that is a pipe",
        lambda: (
            os.mkfifo("loop.json"),
            am.adapt(am.cases.upset_block(), 1e-2, max_nodes=50, store="."),
        ),
        "loop.json",
        ValueError,
        writes=True,
    )
    yield Hostile("path: no folder", lambda: am.PathResult.load("nowhere"), "nowhere", ValueError)
    yield Hostile(
        "path: a file",
        lambda: (Path("a-file").write_text(""), am.PathResult.load("a-file")),
        "a-file",
        ValueError,
        writes=True,
    )
    yield Hostile("path: None", lambda: am.PathResult.load(None), "folder")


@functools.cache
def good() -> bytes:
    """The file of a store of a study."""
    made = study_store.Store("good.sqlite")
    made.put(
        "s",
        [Record(parameters={"n": 0}, status="done", results={"m": 1.5}, versions={"python": "3"})],
    )
    assert len(made.get("s")) == 1
    made._connection.close()
    return Path("good.sqlite").read_bytes()


def database(change: str) -> None:
    """A store of a study, changed by SQL; rows have the hash of what stands in them."""
    Path("study.sqlite").write_bytes(good())
    with sqlite3.connect("study.sqlite") as connection:
        connection.create_function("hash_of", 3, study_store._hash)
        connection.executescript(change)
        if "UPDATE runs" in change:
            connection.execute(
                "UPDATE runs SET hash = hash_of(study, parameters, CAST(record AS BLOB))"
            )
    connection.close()


def read(path: object = "study.sqlite") -> None:
    store = study_store.Store(path)
    store.studies()
    store.get("s")
    store.put("s", [Record(parameters={"n": 0}, status="done")])


_STUDIES = {
    "bad UTF-8": "UPDATE runs SET record = CAST(x'7b22ff' AS TEXT)",
    "a blob": "UPDATE runs SET record = x'00ff'",
    "other JSON": "UPDATE runs SET record = '{\"a\": [1]}'",
    "no JSON": "UPDATE runs SET parameters = 'n=1'",
    "deep JSON": f"UPDATE runs SET record = '{'[' * 10**5}'",
    "a foreign database": "DROP TABLE runs; DROP TABLE origins; CREATE TABLE mine (x); PRAGMA user_version = 0",
    "another table": "DROP TABLE runs; CREATE TABLE runs (id, name)",
    "an endless view": "CREATE VIEW points AS WITH RECURSIVE n(study, parameters) AS (SELECT 's', 1 "
    "UNION ALL SELECT study, parameters + 1 FROM n) SELECT * FROM n",
    "a trigger": "CREATE TRIGGER t AFTER INSERT ON runs BEGIN DELETE FROM runs; END",
    "a newer version": "PRAGMA user_version = 7",
}


def _studies():
    for name, change in _STUDIES.items():
        yield Hostile(
            f"study: {name}",
            lambda c=change: (database(c), read()),
            "study.sqlite",
            ValueError,
            writes=True,
        )
    files = {
        "junk": lambda: Path("study.sqlite").write_bytes(b"junk" * 999),
        "a folder": lambda: Path("study.sqlite").mkdir(),
        "a pipe": lambda: os.mkfifo("study.sqlite"),
    }
    for name, make in files.items():
        yield Hostile(
            f"study: {name}", lambda m=make: (m(), read()), "study.sqlite", ValueError, writes=True
        )
    yield Hostile(
        "study: below a file",
        lambda: (Path("file").write_text(""), read("file/s.sqlite")),
        "file",
        OSError,
        writes=True,
    )
    yield from each("study: store", read, {"number": 3})

    def run(n: object) -> dict[str, object]:
        return {"m": 1}

    yield Hostile(
        "study: a surrogate", lambda: am.Study(run, {"n": ["\udcff"]}).run(progress=False), "'n'"
    )
    yield Hostile(
        "study: progress", lambda: am.Study(run, {"n": [1]}).run(progress=1), "progress", TypeError
    )
    yield Hostile(
        "study: a name of control characters",
        lambda: am.Study(run, {"n": [1]}, name="a\x00b"),
        "name",
    )


INPUTS = (*_paths(), *_studies())
