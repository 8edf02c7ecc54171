"""Store: the runs of studies in one SQLite file, one transaction for what finished together.

SQLite's rollback journal is kept with full synchronisation: a run that was recorded survives a killed process and a
power cut, and a half-written one does not exist. (Its write-ahead log is not: it does not work on the network file
systems of clusters.) Several processes may write to one store. What cannot be written, because the file was removed,
replaced, damaged, is held by another process, or the disk is full, goes with all that this process has written into a
file of its own, which the error names (:mod:`adaptmg.study.stored.rescue`).
"""

from __future__ import annotations

import json
import os
import sqlite3
import threading
import weakref
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from adaptmg.problem import checks
from adaptmg.runtime.atomic import make_folder
from adaptmg.runtime.text import printable
from adaptmg.study.record import Record
from adaptmg.study.stored import queries, rescue, schema
from adaptmg.study.stored.rows import json_object, record_row, row_records, uncollected

__all__ = ["Store"]

#: how long to wait for another process that writes
_PATIENCE_S = 60.0
#: what to do about an error of the operating system, by a part of its text
_FIXES = {"locked": "another process holds it; wait, or end that", "readonly": "it or its folder is write-protected",
          "full": "make room", "unable to open": "it cannot be opened; look at the permissions of file and folder"}
_PUT = f"INSERT OR REPLACE INTO runs ({', '.join(schema.COLUMNS)}) VALUES ({', '.join('?' * len(schema.COLUMNS))})"


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
        If it cannot be opened, read or written: a folder, write-protected, locked by another process, a full disk;
        if the file is no longer the one that was opened. Every message begins with the path.
    """

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
        self._version = schema.prepare(self._connection, self._called)

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
        """Write runs in one transaction; ``parts`` say what they depend on.

        Raises
        ------
        OSError, ValueError
            See the class. Nothing is lost: the message names the file that holds what this process has written.
        """
        self._waiting |= {row[:2]: row for row in (record_row(study, record) for record in records)}
        self._written |= self._waiting
        try:
            with self._explained():
                self._check_there()
                with self._connection as connection:
                    connection.executemany(_PUT, self._waiting.values())
                    if parts is not None:
                        codes = {row[schema.COLUMNS.index("code")] for row in self._waiting.values()}
                        connection.executemany("INSERT OR IGNORE INTO origins VALUES (?, ?)",
                                               [(code, json.dumps(parts)) for code in codes])
        except (OSError, ValueError) as error:
            if self.path is None:
                raise
            # what is locked, full or write-protected is whole, and stays where it is
            whole = isinstance(error, OSError) and self._identity() == self._opened
            words = rescue.save(self.path, None if whole else self._connection, list(self._written.values()))
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
        """Take in the runs of another store, such as one that was rescued; of two for a point the later stays.

        Returns
        -------
        int
            How many runs were taken.
        """
        other = Store(checks.file_path("store", Path(path).resolve(strict=True)))
        with other._explained():
            rows = other._connection.execute(f"SELECT study, {schema.selected(other._version)} FROM runs").fetchall()
            origins = other._connection.execute("SELECT code, parts FROM origins").fetchall() \
                if other._version == schema.FORMAT else []
        finished = schema.COLUMNS.index("finished")
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
            rows = queries.rows(self._connection, self._version, study)
            return dict(zip([row[0] for row in rows], self._records(study, rows), strict=True))

    def runs(self, study: str, status: str | None = None, limit: int | None = None) -> list[Record]:
        """Runs of a study, those of a status, at most so many, in the order they were stored."""
        with self._explained(), uncollected():
            return self._records(study, queries.rows(self._connection, self._version, study, status, limit))

    def count(self, study: str, status: str | None = None) -> int:
        """How many runs of a study there are, and of a status."""
        with self._explained():
            return queries.count(self._connection, study, status)

    def summaries(self) -> list[tuple[str, int, int, float, str]]:
        """Of each study its name, runs done and failed, their seconds, and when the last one finished (UTC)."""
        with self._explained():
            return queries.summaries(self._connection)

    def varying(self, study: str, first: Record) -> list[str]:
        """The parameters of a run that are not the same in all runs of its study."""
        with self._explained():
            return queries.varying(self._connection, study, first.parameters)

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
        if self._version < schema.FORMAT:
            return []
        with self._explained():
            return [key for (key,) in self._connection.execute(
                "SELECT parameters FROM points WHERE study = ? ORDER BY rowid", (study,)).fetchall()]

    def origins(self) -> dict[str, dict[str, str]]:
        """What rows depend on, by their fingerprint."""
        if self._version < schema.FORMAT:
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
