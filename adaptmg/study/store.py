"""Store: the runs of studies in one SQLite file, one transaction for runs that finish together.

SQLite keeps its rollback journal with full synchronisation: a stored run survives a killed process and a power cut, and
a half-written one does not exist. (Its write-ahead log does not work on the network file systems of clusters.) Several
processes may write to one store.

Table ``runs`` has a row a run. ``origins`` has the parts of each fingerprint, so that a study can say why a row is
stale. ``claims`` has the runs that are being computed, each with the process that does.
"""

from __future__ import annotations

import json
import os
import platform
import sqlite3
import threading
import time
import uuid
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import cast

from adaptmg import _checks as checks
from adaptmg._files import make_folder
from adaptmg._text import printable
from adaptmg.study.record import Record, Scalar, canonical, restored

Cell = str | int | float
_FORMAT = 2
#: columns of ``runs`` after the study, in the order of the table; for each the attribute of a record and its type
_COLUMNS: dict[str, tuple[str, type | tuple[type, ...]]] = {
    "parameters": ("parameters", dict), "status": ("status", str), "results": ("results", dict),
    "error": ("error", str), "seconds": ("seconds", (int, float)), "code": ("code", str),
    "versions": ("versions", dict), "finished": ("finished", str), "traceback": ("traceback", str),
    "peak_memory": ("peak_memory", int), "started": ("started", str), "machine": ("machine", str),
    "commit_id": ("commit", str), "tries": ("tries", int), "files": ("files", dict)}
_NAMES = ", ".join(_COLUMNS)
_TYPES = {str: "TEXT", dict: "TEXT", int: "INTEGER", (int, float): "REAL"}
_TABLES = (
    f"CREATE TABLE runs (study TEXT NOT NULL, "
    f"{', '.join(f'{name} {_TYPES[kind]} NOT NULL' for name, (_, kind) in _COLUMNS.items())}, "
    "CHECK (status IN ('done', 'failed')), PRIMARY KEY (study, parameters))",
    "CREATE TABLE origins (code TEXT PRIMARY KEY, parts TEXT NOT NULL)",
    f"PRAGMA user_version = {_FORMAT}")
_CLAIMS = "CREATE TABLE IF NOT EXISTS claims (study TEXT, parameters TEXT, owner TEXT, PRIMARY KEY (study, parameters))"
#: seconds after which the claim of a process on another machine, which may have died, is taken over
_LEASE_S = 86400.0
_PUT = f"INSERT OR REPLACE INTO runs (study, {_NAMES}) VALUES ({', '.join('?' * (len(_COLUMNS) + 1))})"
#: seconds to wait for another process that writes
_PATIENCE_S = 60.0
#: remedies by a part of SQLite's message
_FIXES = {"locked": "another process holds it; wait, or end that process",
          "readonly": "it or its folder is write-protected", "full": "make room",
          "unable to open": "it cannot be opened; check the permissions of file and folder"}
_DAMAGE = (ValueError, TypeError, RecursionError)


class Store:
    """Runs by study and parameters, in a SQLite file or (path None) in memory; errors name the file."""

    def __init__(self, path: str | os.PathLike[str] | None) -> None:
        # SQLite keeps its journal next to the file itself, so links are followed
        self.path = None if path is None else Path(os.path.realpath(checks.file_path("store", path)))
        self._called = "the store in memory" if self.path is None else printable(os.fspath(self.path))
        self._lock = threading.RLock()
        if self.path is not None:
            make_folder("store", self.path.parent)
            if self.path.exists() and not self.path.is_file():
                raise ValueError(f"{self._called} is a folder or a device: store must be a file")
        with self._explained():
            self._connection = sqlite3.connect(":memory:" if self.path is None else self.path, timeout=_PATIENCE_S,
                                               check_same_thread=False)
        weakref.finalize(self, self._connection.close)
        with self._explained():
            self._prepare()
        self._opened = self._identity()

    def _prepare(self) -> None:
        self._connection.execute("PRAGMA synchronous = FULL")
        # transactions: another process that makes the tables is seen before or after, not in between
        with self._connection:
            self._connection.execute("BEGIN")
            exists = self._is_store()
        if not exists:
            with self._connection:
                self._connection.execute("BEGIN IMMEDIATE")
                if not self._is_store():
                    for statement in _TABLES:
                        self._connection.execute(statement)

    def _is_store(self) -> bool:
        """Whether there are tables of this version; False for an empty file, ValueError for other databases."""
        (version,) = self._connection.execute("PRAGMA user_version").fetchone()
        kinds = dict(self._connection.execute("SELECT name, type FROM sqlite_master").fetchall())
        if not version and not kinds:
            return False
        columns = [row[1] for row in self._connection.execute("PRAGMA table_info(runs)")]
        # a view may have no end, and a trigger changes what is written
        if version != _FORMAT or columns != ["study", *_COLUMNS] or {"view", "trigger"} & set(kinds.values()):
            raise ValueError(f"{self._called} is a database, but not a store of this version of adaptmg (version "
                             f"{version}, tables {checks.shown(kinds)}): give another file")
        return True

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Errors of SQLite become ones that name the file and the remedy."""
        try:
            with self._lock:
                yield
        except sqlite3.OperationalError as error:
            text = str(error)
            if "decode" in text:
                raise ValueError(f"{self._called} is damaged ({text}): give another file") from error
            fix = next((words for sign, words in _FIXES.items() if sign in text), "give another file")
            raise OSError(f"{self._called}: {text}: {fix}") from error
        except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter for names of tables
            raise ValueError(f"{self._called} is not a store of a study, or damaged ({error}): give another "
                             "file") from error

    def _identity(self) -> tuple[int, int] | None:
        try:
            status = None if self.path is None else self.path.stat()
        except OSError:
            return None
        return None if status is None else (status.st_dev, status.st_ino)

    def _check_there(self) -> None:
        """SQLite goes on writing into a file that was removed: the path must still name the file that was opened."""
        now = self._identity()
        if now != self._opened:
            how = "removed" if now is None else "replaced by another file"
            raise OSError(f"{self._called} was {how} while it was in use: run the study again")

    # writing

    def put(self, study: str, record: Record) -> None:
        """Write one run, in place of an earlier one with the same parameters."""
        self.put_all(study, [record])

    def put_all(self, study: str, records: Sequence[Record], parts: dict[str, str] | None = None) -> None:
        """Write runs in one transaction, which Ctrl-C does not prevent; ``parts`` are those of their fingerprint."""
        rows = [(study, *_row(record)) for record in records]
        origins = [] if parts is None else [(code, json.dumps(parts)) for code in {record.code for record in records}]
        try:
            self._write(rows, origins)
        except KeyboardInterrupt:  # it undid the transaction
            self._write(rows, origins)
            raise

    def claim(self, study: str, keys: Sequence[str], owner: str) -> list[bool]:
        """Claim runs, in one transaction; whether each is claimed: not where a process that may live has claimed it."""
        with self._explained():
            self._check_there()
            with self._connection as connection:
                connection.execute("BEGIN IMMEDIATE")
                connection.execute(_CLAIMS)
                held = [connection.execute("SELECT owner FROM claims WHERE study = ? AND parameters = ?",
                                           (study, key)).fetchone() for key in keys]
                claimed = [other is None or not _may_live(other[0]) for other in held]
                connection.executemany("INSERT OR REPLACE INTO claims VALUES (?, ?, ?)",
                                       [(study, key, owner) for key, ours in zip(keys, claimed, strict=True) if ours])
        return claimed

    def release(self, owner: str, key: str = "%") -> None:
        """Give up the claims of an owner, or that on one run."""
        with self._explained(), self._connection as connection:
            connection.execute(_CLAIMS)
            connection.execute("DELETE FROM claims WHERE owner = ? AND ? IN (parameters, '%')", (owner, key))

    def _write(self, rows: Sequence[tuple[Cell, ...]], origins: Sequence[tuple[str, str]]) -> None:
        with self._explained():
            self._check_there()
            with self._connection as connection:
                connection.execute(_CLAIMS)
                connection.executemany("DELETE FROM claims WHERE study = ? AND parameters = ?",
                                       [row[:2] for row in rows])
                connection.executemany(_PUT, rows)
                connection.executemany("INSERT OR IGNORE INTO origins VALUES (?, ?)", origins)

    # reading

    def get(self, study: str) -> dict[str, Record]:
        """Return all runs of a study in the order of storing, by their canonical parameters."""
        return {canonical(record.parameters): record for record in self.runs(study)}

    def runs(self, study: str) -> list[Record]:
        """Return the runs of a study in the order of storing."""
        # the index has the rows in another order
        rows = self._select(f"SELECT {_NAMES} FROM runs NOT INDEXED WHERE study = ? ORDER BY rowid", study)
        return [self._record(study, row) for row in rows]

    def one(self, study: str, key: str) -> Record | None:
        """Return the run of a study with these canonical parameters, if it is stored."""
        rows = self._select(f"SELECT {_NAMES} FROM runs WHERE study = ? AND parameters = ?", study, key)
        return self._record(study, rows[0]) if rows else None

    def _record(self, study: str, row: Sequence[Cell]) -> Record:
        try:
            return _read(row)
        except _DAMAGE as error:
            raise ValueError(f"{self._called} is damaged: the run {checks.shown(row[0])} of the study {study!r} cannot "
                             f"be read ({error}): delete that row, or give another file") from error

    def studies(self) -> list[str]:
        """Return the names of the studies."""
        return [name for (name,) in self._select("SELECT DISTINCT study FROM runs ORDER BY study")]

    def summaries(self) -> list[tuple[str, int, int, float, str]]:
        """Return for each study its name, runs done and failed, their seconds, and when the last one ended (UTC)."""
        return self._select("SELECT study, sum(status = 'done'), sum(status = 'failed'), total(seconds), max(finished) "
                            "FROM runs GROUP BY study ORDER BY study")

    def origins(self) -> dict[str, dict[str, str]]:
        """Return the parts of the stored fingerprints, by the fingerprint."""
        rows = self._select("SELECT code, parts FROM origins")
        try:
            return {code: cast(dict[str, str], _object(parts)) for code, parts in rows}
        except _DAMAGE as error:
            raise ValueError(f"{self._called} is damaged: its table 'origins' cannot be read ({error}): give another "
                             "file") from error

    def _select(self, query: str, *values: str) -> list:
        with self._explained():
            return self._connection.execute(query, values).fetchall()


def new_owner() -> str:
    """Return the name of this process, and of one study in it, for claims."""
    import psutil

    return json.dumps([platform.node(), os.getpid(), psutil.Process().create_time(), time.time(), uuid.uuid4().hex])


def _may_live(owner: str) -> bool:
    """Whether the process of a claim may still compute."""
    import psutil

    try:
        machine, process, created, claimed, _ = json.loads(owner)
        if machine != platform.node():
            return time.time() - claimed < _LEASE_S
        return abs(psutil.Process(process).create_time() - created) < 1.0
    except (psutil.Error, *_DAMAGE):
        return False


def _row(record: Record) -> tuple[Cell, ...]:
    """Return the columns of a record; a text may hold anything, so it is made printable."""
    values = {column: getattr(record, name) for column, (name, _) in _COLUMNS.items()}
    texts = {name: printable(values[name]) for name in ("error", "traceback", "machine")}
    return tuple((values | texts | {"parameters": canonical(record.parameters)} | {
        name: json.dumps(values[name]) for name in ("results", "versions", "files")}).values())


def _read(row: Sequence[Cell]) -> Record:
    """Return the record of a row; ValueError or TypeError for a row that adaptmg cannot have written."""
    values = {}
    for cell, (name, kind) in zip(row, _COLUMNS.values(), strict=True):
        values[name] = _object(cell) if kind is dict else checks.instance(name, cell, kind)
    results, files = values["results"], values["files"]
    if any(type(value) not in (bool, int, float, str, type(None)) for value in results.values()):
        raise ValueError("a result is not a number, text, true, false or null")
    if any(type(path) is not str for path in files.values()):
        raise ValueError("the name of a file is not a text")
    values["parameters"] = {name: restored(value) for name, value in values["parameters"].items()}
    return Record(**values)


def _object(text: Cell) -> dict[str, Scalar | list]:
    return checks.instance("its JSON", json.loads(cast(str, text)), dict, "an object")
