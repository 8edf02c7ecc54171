"""Store: the runs of studies in one SQLite file, one transaction for what finished together.

SQLite's rollback journal is kept with full synchronisation: a run that was recorded survives a killed process and a
power cut, and a half-written one does not exist. (Its write-ahead log is not: it does not work on the network file
systems of clusters.) Several processes may write to one store. What cannot be written, because the file was removed,
replaced, damaged, is held by another process, or the disk is full, goes with all that this process has written into a
file of its own, which the error names (:mod:`adaptmg.study.store`).

What is asked of a store without reading all of it: rows of a status, how many there are, which parameters vary.

Runs are read in the order of their row identifiers, which is that of storing, without the index, which has them in
another.

What was done when a store cannot be written any more: into a file of its own, nothing is lost.

A record as a row of the store, and back.

Tables of a store, and how a store of an earlier version gets what it lacks.

``runs``: a row a run. ``origins``: what rows with the same fingerprint depend on, part by part, so that one can say why
a row is stale. ``points``: points that were added to a study (:meth:`adaptmg.study.Study.add`). Version 1 had ``runs``
alone, without the columns of :data:`NEW`; it is brought up to date when it is opened and can be written.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import shlex
import sqlite3
import tempfile
import threading
import weakref
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any

from adaptmg import _checks as checks
from adaptmg._files import make_folder
from adaptmg._text import printable
from adaptmg.study.record import Record, Value, canonical, plain_results, restored

__all__ = ["COLUMNS", "FORMAT", "NEW", "Store", "count", "json_object", "prepare", "record_row", "row_records", "save",
           "selected", "selected_rows", "summaries", "uncollected", "varying"]

_CHOSEN = "WHERE study = ? AND (? IS NULL OR status = ?)"


def selected_rows(connection: sqlite3.Connection, version: int, study: str, status: str | None = None,
         limit: int | None = None) -> list[tuple[Any, ...]]:
    """Rows of a study, without its name; at most ``limit``."""
    return connection.execute(f"SELECT {selected(version)} FROM runs NOT INDEXED {_CHOSEN} ORDER BY rowid "
                              "LIMIT ?", (study, status, status, -1 if limit is None else limit)).fetchall()


def count(connection: sqlite3.Connection, study: str, status: str | None = None) -> int:
    """How many runs of a study there are; without a status that is told by the index alone."""
    if status is None:
        return connection.execute("SELECT count(*) FROM runs WHERE study = ?", (study,)).fetchone()[0]
    return connection.execute(f"SELECT count(*) FROM runs {_CHOSEN}", (study, status, status)).fetchone()[0]


def summaries(connection: sqlite3.Connection) -> list[tuple[str, int, int, float, str]]:
    """Of each study its name, runs done and failed, their seconds, and when the last one finished."""
    return connection.execute("SELECT study, sum(status = 'done'), sum(status = 'failed'), total(seconds), "
                              "max(finished) FROM runs GROUP BY study ORDER BY study").fetchall()


def varying(connection: sqlite3.Connection, study: str, first: Mapping[str, Value]) -> list[str]:
    """The parameters of a run that another run of its study does not have, or has with another value.

    Canonical texts of parameters are searched for the piece that a name and its value make: no JSON is read.
    """
    other = "SELECT 1 FROM runs WHERE study = ? AND instr(parameters, ? || ',') = 0 " \
            "AND instr(parameters, ? || '}') = 0 LIMIT 1"
    pieces = {name: canonical({name: value})[1:-1] for name, value in first.items()}
    return [name for name, piece in pieces.items() if connection.execute(other, (study, piece, piece)).fetchone()]


def save(store: Path, connection: sqlite3.Connection | None, rows: Sequence[tuple[Any, ...]]) -> str:
    """Write a new store with the runs of this process, and those of the old file that can still be read."""
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
    failed = []
    for folder in (store.parent, Path(tempfile.gettempdir()), Path.home()):
        target = folder / f"{store.name}.rescued-{stamp}-{os.getpid()}.sqlite"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _write(target, connection, rows)
        except (OSError, sqlite3.Error) as error:
            failed.append(f"{target}: {error}")
            with contextlib.suppress(OSError):
                target.unlink()
            continue
        words = [printable(os.fspath(path)) for path in (store, target)]
        command = shlex.join(["adaptmg", "runs", words[0], "--take-in", words[1]])
        return f"The {len(rows)} runs of this process are safe in {words[1]}: bring them back with: {command}"
    return f"The {len(rows)} runs of this process could not be written elsewhere either ({'; '.join(failed)})"


def _write(target: Path, connection: sqlite3.Connection | None, rows: Sequence[tuple[Any, ...]]) -> None:
    new = sqlite3.connect(target)
    try:
        prepare(new, str(target))
        put = f"INSERT OR REPLACE INTO runs ({', '.join(COLUMNS)}) VALUES " \
              f"({', '.join('?' * len(COLUMNS))})"
        with new:
            if connection is not None:
                new.executemany(put, _readable(connection, f"SELECT {', '.join(COLUMNS)} FROM runs"))
                new.executemany("INSERT OR IGNORE INTO origins VALUES (?, ?)",
                                _readable(connection, "SELECT code, parts FROM origins"))
            new.executemany(put, rows)
    finally:
        new.close()


def _readable(connection: sqlite3.Connection, query: str) -> list[tuple[Any, ...]]:
    """Rows until the first that is damaged."""
    rows = []
    with contextlib.suppress(sqlite3.Error, UnicodeDecodeError):
        for row in connection.execute(query):
            rows.append(row)
    return rows


_PLAIN = {bool, int, float, str, type(None)}
#: attributes of a record, in the order of the columns of a row after its study
_COLUMNS = ("parameters", "status", "results", "error", "seconds", "code", "versions", "finished", "traceback",
            "peak_memory", "started", "machine", "commit", "tries", "files")
_NUMBERS = ("seconds", "peak_memory", "tries")
_TEXTS = ("error", "code", "finished", "traceback", "started", "machine", "commit")


def record_row(study: str, record: Record) -> tuple[Any, ...]:
    """Columns as in :data:`adaptmg.study.store.COLUMNS`."""
    return (study, canonical(record.parameters), record.status, json.dumps(record.results), printable(record.error),
            record.seconds, record.code, json.dumps(record.versions), record.finished, printable(record.traceback),
            record.peak_memory, record.started, printable(record.machine), record.commit, record.tries,
            json.dumps(record.files) if record.files else "{}")


def row_records(rows: Sequence[Sequence[Any]]) -> list[Record]:
    """Records of rows without their study, checked column by column, as there may be 100 000."""
    if not rows:
        return []
    columns = dict(zip(_COLUMNS, zip(*rows, strict=True), strict=True))
    found = {name: _objects(columns[name]) for name in ("parameters", "results")}
    if not _PLAIN.issuperset(map(type, _values(found["results"]))):
        for results in found["results"]:
            plain_results(results, {})
    if not _PLAIN.issuperset(map(type, _values(found["parameters"]))):
        found["parameters"] = [{name: restored(value) for name, value in point.items()}
                               for point in found["parameters"]]
    if not {"done", "failed"}.issuperset(columns["status"]) \
            or any(not {int, float}.issuperset(map(type, columns[name])) for name in _NUMBERS) \
            or any(set(map(type, columns[name])) != {str} for name in _TEXTS):
        raise ValueError("a column holds something else than it should")
    # the same for all rows of a sweep
    versions = {text: json_object(text) for text in set(columns["versions"])}
    found["versions"] = [versions[text] for text in columns["versions"]]
    found["files"] = [{} if text == "{}" else _files(text) for text in columns["files"]]
    make, put, made = object.__new__, object.__setattr__, []
    for values in zip(*(columns | found).values(), strict=True):
        # the __init__ of a frozen dataclass takes five times as long
        made.append(record := make(Record))
        put(record, "__dict__", dict(zip(_COLUMNS, values, strict=True)))
    return made


def _objects(texts: Sequence[Any]) -> list[dict[str, Any]]:
    """What texts of JSON hold, all read at once, if each is an object."""
    found = json.loads(f"[{','.join(texts)}]")
    if len(found) != len(texts) or set(map(type, found)) != {dict}:
        raise ValueError("its JSON must be an object")
    return found


def _values(objects: Sequence[dict[str, Any]]) -> Iterator[Any]:
    return chain.from_iterable(map(dict.values, objects))


@contextmanager
def uncollected() -> Iterator[None]:
    """Leave the search for garbage until many rows are made: it would look at all of them again and again."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def json_object(text: Any) -> dict[str, Any]:
    """What a text of JSON holds, if that is an object."""
    return checks.instance("its JSON", json.loads(text), dict, "an object")


def _files(text: Any) -> dict[str, str]:
    files = json_object(text)
    if not all(isinstance(path, str) for path in files.values()):
        raise ValueError("its files have names that are no texts")
    return files


FORMAT = 2
_FIRST = ("study", "parameters", "status", "results", "error", "seconds", "code", "versions", "finished")
#: columns that came later, with the values they have in older rows
NEW = {"traceback": "TEXT NOT NULL DEFAULT ''", "peak_memory": "INTEGER NOT NULL DEFAULT 0",
       "started": "TEXT NOT NULL DEFAULT ''", "machine": "TEXT NOT NULL DEFAULT ''",
       "commit_id": "TEXT NOT NULL DEFAULT ''", "tries": "INTEGER NOT NULL DEFAULT 1",
       "files": "TEXT NOT NULL DEFAULT '{}'"}
COLUMNS = (*_FIRST, *NEW)
_RUNS = """
CREATE TABLE IF NOT EXISTS runs (
    study TEXT NOT NULL,
    parameters TEXT NOT NULL,
    status TEXT NOT NULL CHECK (status IN ('done', 'failed')),
    results TEXT NOT NULL,
    error TEXT NOT NULL,
    seconds REAL NOT NULL,
    code TEXT NOT NULL,
    versions TEXT NOT NULL,
    finished TEXT NOT NULL,
    PRIMARY KEY (study, parameters)
)
"""
_OTHERS = ("CREATE TABLE IF NOT EXISTS origins (code TEXT PRIMARY KEY, parts TEXT NOT NULL)",
           "CREATE TABLE IF NOT EXISTS points (study TEXT NOT NULL, parameters TEXT NOT NULL, "
           "PRIMARY KEY (study, parameters))")


def prepare(connection: sqlite3.Connection, called: str) -> int:
    """Make the tables of an empty database, and those that an older store lacks."""
    version = _checked_version(connection, called)
    if version < FORMAT:
        try:
            # in one transaction, so that a second process sees an empty file or a store
            connection.execute("BEGIN IMMEDIATE")
            version = _checked_version(connection, called)
            if version < FORMAT:
                _check_columns(connection, called, version)
                _bring_up(connection)
                version = FORMAT
            connection.execute("COMMIT")
        except sqlite3.OperationalError as error:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            if version == 0 or "readonly" not in str(error):
                raise
    _check_columns(connection, called, version)
    return version


def _bring_up(connection: sqlite3.Connection) -> None:
    connection.execute(_RUNS)
    there = _columns(connection)
    for name, kind in NEW.items():
        if name not in there:
            connection.execute(f"ALTER TABLE runs ADD COLUMN {name} {kind}")
    for statement in _OTHERS:
        connection.execute(statement)
    connection.execute(f"PRAGMA user_version = {FORMAT}")


def _columns(connection: sqlite3.Connection) -> list[str]:
    return [row[1] for row in connection.execute("PRAGMA table_info(runs)")]


def _check_columns(connection: sqlite3.Connection, called: str, version: int) -> None:
    """Another program may count versions too."""
    wanted = {0: [], 1: list(_FIRST)}.get(version, list(COLUMNS))
    columns = _columns(connection)
    if columns != wanted:
        raise ValueError(f"{called} is a database, but not a store of adaptmg (its table 'runs' has "
                         f"{checks.shown(columns)}): give another file")


def _checked_version(connection: sqlite3.Connection, called: str) -> int:
    """0 for an empty database; ValueError for one that is not a store of this or an earlier version."""
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if version not in range(FORMAT + 1) or (version == 0 and tables):
        raise ValueError(f"{called} is a database, but not a store of this version of adaptmg "
                         f"(version {version}, wanted {FORMAT}): give another file")
    # a view in place of a table may have no end, a trigger change what is written
    foreign = connection.execute("SELECT type, name FROM sqlite_master WHERE type IN ('view', 'trigger')").fetchone()
    if foreign is not None:
        raise ValueError(f"{called} has a {foreign[0]} {checks.shown(foreign[1])}, which adaptmg does not write: "
                         "remove it, or give another file")
    return version


def selected(version: int) -> str:
    """The columns of a row after its study, for a SELECT, in the order of :data:`COLUMNS`."""
    given = {"files": "'{}'", "peak_memory": "0", "tries": "1"}
    return ", ".join([*_FIRST[1:], *(name if version == FORMAT else given.get(name, "''") for name in NEW)])


#: how long to wait for another process that writes
_PATIENCE_S = 60.0
#: what to do about an error of the operating system, by a part of its text
_FIXES = {"locked": "another process holds it; wait, or end that", "readonly": "it or its folder is write-protected",
          "full": "make room", "unable to open": "it cannot be opened; look at the permissions of file and folder"}
_PUT = f"INSERT OR REPLACE INTO runs ({', '.join(COLUMNS)}) VALUES ({', '.join('?' * len(COLUMNS))})"


class Store:
    """Runs by study and parameters."""

    def __init__(self, path: str | os.PathLike[str] | None) -> None:
        # with links followed: SQLite keeps its journal beside the file itself
        self.path = None if path is None else Path(os.path.realpath(checks.file_path("store", path)))
        self._lock = threading.RLock()
        #: what this process has written, and what of it is not there yet
        self._written: dict[tuple[str, str], tuple[Any, ...]] = {}
        self._waiting: dict[tuple[str, str], tuple[Any, ...]] = {}
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

    @property
    def _called(self) -> str:
        """The path in messages."""
        return "the store in memory" if self.path is None else printable(os.fspath(self.path))

    def _prepare(self) -> None:
        self._connection.execute("PRAGMA synchronous = FULL")
        self._version = prepare(self._connection, self._called)

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Errors of sqlite become ones that name the file and say what to do."""
        try:
            with self._lock:
                yield
        except sqlite3.OperationalError as error:
            text = str(error)
            if "decode" in text:
                raise ValueError(f"{self._called} is damaged ({text}): give another file, or mend it") from error
            fix = next((words for sign, words in _FIXES.items() if sign in text), "give another file")
            raise OSError(f"{self._called}: {text}: {fix}") from error
        except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter where names of tables are damaged
            raise ValueError(f"{self._called} is not a store of a study, or damaged ({error}): give another "
                             "file") from error

    def _identity(self) -> tuple[int, int] | None:
        """Of the file under the path now."""
        if self.path is None:
            return None
        try:
            found = self.path.stat()
        except OSError:
            return None
        return found.st_dev, found.st_ino

    def _check_there(self) -> None:
        """SQLite goes on writing into a file that was removed: what is under the path must be what was opened."""
        now = self._identity()
        if now != self._opened:
            how = "removed" if now is None else "replaced by another file"
            raise OSError(f"{self._called} was {how} while it was in use: start again when nothing else changes it")

    # writing

    def put(self, study: str, record: Record) -> None:
        """Write one run, in place of an earlier one with the same parameters."""
        self.put_all(study, [record])

    def put_all(self, study: str, records: Iterable[Record], parts: dict[str, str] | None = None) -> None:
        """Write runs in one transaction; ``parts`` say what they depend on."""
        self._waiting |= {row[:2]: row for row in (record_row(study, record) for record in records)}
        self._written |= self._waiting
        try:
            with self._explained():
                self._check_there()
                with self._connection as connection:
                    connection.executemany(_PUT, self._waiting.values())
                    if parts is not None:
                        codes = {row[COLUMNS.index("code")] for row in self._waiting.values()}
                        connection.executemany("INSERT OR IGNORE INTO origins VALUES (?, ?)",
                                               [(code, json.dumps(parts)) for code in codes])
        except (OSError, ValueError) as error:
            if self.path is None:
                raise
            # what is locked, full or write-protected is whole, and stays where it is
            whole = isinstance(error, OSError) and self._identity() == self._opened
            words = save(self.path, None if whole else self._connection, list(self._written.values()))
            self._waiting = {}
            first = "Move the damaged file away. " if isinstance(error, ValueError) else ""
            raise type(error)(f"{error}. {first}{words}") from error
        self._waiting = {}

    def flush(self) -> None:
        """Write what an interrupt kept from being written."""
        if self._waiting:
            self.put_all("", ())

    def add_points(self, study: str, keys: Iterable[str]) -> None:
        """Remember points that were added to a study, by :func:`~adaptmg.study.record.canonical` parameters."""
        with self._explained(), self._connection as connection:
            connection.executemany("INSERT OR IGNORE INTO points VALUES (?, ?)", [(study, key) for key in keys])

    def take_in(self, path: str | os.PathLike[str]) -> int:
        """Take in the runs of another store, such as one that was rescued; of two for a point the later stays."""
        other = Store(checks.file_path("store", Path(path).resolve(strict=True)))
        with other._explained():
            rows = other._connection.execute(f"SELECT study, {selected(other._version)} FROM runs").fetchall()
            origins = other._connection.execute("SELECT code, parts FROM origins").fetchall() \
                if other._version == FORMAT else []
        finished = COLUMNS.index("finished")
        with self._explained(), self._connection as connection:
            have = {row[:2]: row[2] for row in connection.execute("SELECT study, parameters, finished FROM runs")}
            later = [row for row in rows if row[:2] not in have or have[row[:2]] < row[finished]]
            connection.executemany(_PUT, later)
            connection.executemany("INSERT OR IGNORE INTO origins VALUES (?, ?)", origins)
        return len(later)

    # reading

    def get(self, study: str) -> dict[str, Record]:
        """All runs of a study, in the order they were stored, by :func:`~adaptmg.study.record.canonical` parameters."""
        with self._explained(), uncollected():
            rows = selected_rows(self._connection, self._version, study)
            return dict(zip([row[0] for row in rows], self._records(study, rows), strict=True))

    def runs(self, study: str, status: str | None = None, limit: int | None = None) -> list[Record]:
        """Runs of a study, those of a status, at most so many, in the order they were stored."""
        with self._explained(), uncollected():
            return self._records(study, selected_rows(self._connection, self._version, study, status, limit))

    def count(self, study: str, status: str | None = None) -> int:
        """How many runs of a study there are, and of a status."""
        with self._explained():
            return count(self._connection, study, status)

    def summaries(self) -> list[tuple[str, int, int, float, str]]:
        """Of each study its name, runs done and failed, their seconds, and when the last one finished (UTC)."""
        with self._explained():
            return summaries(self._connection)

    def varying(self, study: str, first: Record) -> list[str]:
        """The parameters of a run that are not the same in all runs of its study."""
        with self._explained():
            return varying(self._connection, study, first.parameters)

    def _records(self, study: str, rows: Sequence[Sequence[Any]]) -> list[Record]:
        """Rows as records; ValueError for one that adaptmg cannot have written."""
        damage = (ValueError, TypeError, RecursionError)
        try:
            return row_records(rows)
        except damage:
            for row in rows:
                try:
                    row_records([row])
                except damage as error:
                    raise ValueError(f"{self._called} is damaged: the run {checks.shown(row[0])} of the study "
                                     f"{study!r} cannot be read ({error}): delete that row, or give another "
                                     "file") from error
            raise

    def points(self, study: str) -> list[str]:
        """Points that were added to a study, by canonical parameters, in the order of adding."""
        if self._version < FORMAT:
            return []
        with self._explained():
            return [key for (key,) in self._connection.execute(
                "SELECT parameters FROM points WHERE study = ? ORDER BY rowid", (study,)).fetchall()]

    def origins(self) -> dict[str, dict[str, str]]:
        """What rows depend on, by their fingerprint."""
        if self._version < FORMAT:
            return {}
        with self._explained():
            rows = self._connection.execute("SELECT code, parts FROM origins").fetchall()
        try:
            return {code: json_object(parts) for code, parts in rows}
        except (ValueError, TypeError, RecursionError) as error:
            raise ValueError(f"{self._called} is damaged: what its runs depend on cannot be read ({error}): give "
                             "another file") from error

    def studies(self) -> list[str]:
        """Names of the studies in the store."""
        with self._explained():
            return [name for (name,) in
                    self._connection.execute("SELECT DISTINCT study FROM runs ORDER BY study").fetchall()]
