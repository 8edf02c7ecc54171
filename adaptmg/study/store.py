"""Store: the runs of studies in one SQLite file, one transaction a run.

SQLite's rollback journal is kept with full synchronisation: a run that was recorded survives a killed process and a
power cut, and a half-written one does not exist. Several processes may write to one store.
"""

from __future__ import annotations

import json
import os
import sqlite3
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from adaptmg.problem import checks
from adaptmg.runtime.atomic import make_folder
from adaptmg.runtime.text import printable
from adaptmg.study.record import Record, canonical, plain_results, restored

__all__ = ["Store"]

_FORMAT = 1
_COLUMNS = ["study", "parameters", "status", "results", "error", "seconds", "code", "versions", "finished"]
#: how long to wait for another process that writes
_PATIENCE_S = 60.0
#: what to do about an error of the operating system, by a part of its text
_FIXES = {"locked": "another process holds it; wait, or end that", "readonly": "it or its folder is write-protected",
          "full": "make room", "unable to open": "it cannot be opened; look at the permissions of file and folder"}
_SCHEMA = """
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


class Store:
    """Runs by study and parameters.

    Parameters
    ----------
    path : path or None
        The file; it and its directories are made where missing. None keeps the runs in memory only.

    Raises
    ------
    ValueError
        If the file is something else, of another version of adaptmg, or damaged; later too, when a row is read.
    OSError
        If it cannot be opened, read or written: a folder, write-protected, locked by another process, a full disk.
        Every message begins with the path.
    """

    def __init__(self, path: str | os.PathLike[str] | None) -> None:
        self.path = None if path is None else checks.file_path("store", path)
        if self.path is not None:
            make_folder("store", self.path.parent)
            if self.path.exists() and not self.path.is_file():
                raise ValueError(f"{self._called} is a folder or a device: store must be a file")
        with self._explained():
            self._connection = sqlite3.connect(":memory:" if self.path is None else self.path, timeout=_PATIENCE_S)
        weakref.finalize(self, self._connection.close)
        with self._explained():
            self._prepare()

    @property
    def _called(self) -> str:
        """The path in messages."""
        return "the store in memory" if self.path is None else printable(os.fspath(self.path))

    def _prepare(self) -> None:
        with self._connection as connection:
            connection.execute("PRAGMA synchronous = FULL")
            if self._checked_version() == 0:
                # in one transaction, so that a second process sees an empty file or a store
                connection.execute("BEGIN IMMEDIATE")
                if self._checked_version() == 0:
                    connection.execute(_SCHEMA)
                    connection.execute(f"PRAGMA user_version = {_FORMAT}")
            # another program may count versions too
            columns = [row[1] for row in connection.execute("PRAGMA table_info(runs)")]
            if columns != _COLUMNS:
                raise ValueError(f"{self._called} is a database, but not a store of adaptmg (its table 'runs' has "
                                 f"{checks.shown(columns)}): give another file")

    def _checked_version(self) -> int:
        """0 for an empty database; ValueError for one that is not a store of this version."""
        (version,) = self._connection.execute("PRAGMA user_version").fetchone()
        (tables,) = self._connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        if version not in (0, _FORMAT) or (version == 0 and tables):
            raise ValueError(f"{self._called} is a database, but not a store of this version of adaptmg "
                             f"(version {version}, wanted {_FORMAT}): give another file")
        return version

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Errors of sqlite become ones that name the file and say what to do."""
        try:
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

    def put(self, study: str, record: Record) -> None:
        """Write one run, in place of an earlier one with the same parameters."""
        row = (study, canonical(record.parameters), record.status, json.dumps(record.results), printable(record.error),
               record.seconds, record.code, json.dumps(record.versions), record.finished)
        with self._explained(), self._connection as connection:
            connection.execute("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", row)

    def get(self, study: str) -> dict[str, Record]:
        """All runs of a study, by :func:`canonical` parameters."""
        with self._explained():
            rows = self._connection.execute("SELECT parameters, status, results, error, seconds, code, versions, "
                                            "finished FROM runs WHERE study = ?", (study,)).fetchall()
        return {row[0]: self._record(study, row) for row in rows}

    def _record(self, study: str, row: tuple[Any, ...]) -> Record:
        """A row as a record; ValueError if adaptmg cannot have written it."""
        try:
            parameters, status, results, error, seconds, code, versions, finished = row
            record = Record(parameters={k: restored(v) for k, v in _object(parameters).items()}, status=status,
                            results=_object(results), error=error, seconds=seconds, code=code,
                            versions=_object(versions), finished=finished)
            plain_results(record.results, {})
            if status not in ("done", "failed") or not isinstance(seconds, int | float) \
                    or not all(isinstance(text, str) for text in (error, code, finished)):
                raise ValueError("a column holds something else than it should")
        except (ValueError, TypeError, RecursionError) as error:
            raise ValueError(f"{self._called} is damaged: the run {checks.shown(row[0])} of the study {study!r} cannot "
                             f"be read ({error}): delete that row, or give another file") from error
        return record

    def studies(self) -> list[str]:
        """Names of the studies in the store."""
        with self._explained():
            return [name for (name,) in
                    self._connection.execute("SELECT DISTINCT study FROM runs ORDER BY study").fetchall()]


def _object(text: Any) -> dict[str, Any]:
    return checks.instance("its JSON", json.loads(text), dict, "an object")
