"""Store: the runs of studies in one SQLite file, one transaction a run.

SQLite's rollback journal is kept with full synchronisation: a run that was recorded survives a killed process and a
power cut, and a half-written one does not exist. Several processes may write to one store.
"""

from __future__ import annotations

import json
import os
import sqlite3
import weakref
from pathlib import Path

from adaptmg.study.record import Record, canonical, restored

__all__ = ["Store"]

_FORMAT = 1
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
        If the file is something else, or of another version of adaptmg.
    """

    def __init__(self, path: str | os.PathLike[str] | None) -> None:
        self.path = None if path is None else Path(path)
        if self.path is not None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        self._connection = sqlite3.connect(":memory:" if self.path is None else self.path, timeout=60.0)
        weakref.finalize(self, self._connection.close)
        try:
            self._prepare()
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.OperationalError):
                raise
            raise ValueError(f"{path} is not a store of a study ({error}): give another file") from error

    def _prepare(self) -> None:
        with self._connection as connection:
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
            if version not in (0, _FORMAT) or (version == 0 and tables):
                raise ValueError(f"{self.path} is a database, but not a store of this version of adaptmg "
                                 f"(version {version}, wanted {_FORMAT}): give another file")
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute(_SCHEMA)
            connection.execute(f"PRAGMA user_version = {_FORMAT}")

    def put(self, study: str, record: Record) -> None:
        """Write one run, in place of an earlier one with the same parameters."""
        row = (study, canonical(record.parameters), record.status, json.dumps(record.results), record.error,
               record.seconds, record.code, json.dumps(record.versions), record.finished)
        with self._connection as connection:
            connection.execute("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", row)

    def get(self, study: str) -> dict[str, Record]:
        """All runs of a study, by :func:`canonical` parameters."""
        rows = self._connection.execute("SELECT parameters, status, results, error, seconds, code, versions, finished "
                                        "FROM runs WHERE study = ?", (study,)).fetchall()
        return {row[0]: Record(parameters={k: restored(v) for k, v in json.loads(row[0]).items()}, status=row[1],
                               results=json.loads(row[2]), error=row[3], seconds=row[4], code=row[5],
                               versions=json.loads(row[6]), finished=row[7]) for row in rows}

    def studies(self) -> list[str]:
        """Names of the studies in the store."""
        return [name for (name,) in self._connection.execute("SELECT DISTINCT study FROM runs ORDER BY study")]
