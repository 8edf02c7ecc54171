"""Tables of a store, and how a store of an earlier version gets what it lacks.

``runs``: a row a run. ``origins``: what rows with the same fingerprint depend on, part by part, so that one can say why
a row is stale. ``points``: points that were added to a study (:meth:`adaptmg.study.Study.add`). Version 1 had ``runs``
alone, without the columns of :data:`NEW`; it is brought up to date when it is opened and can be written.
"""

from __future__ import annotations

import sqlite3

from adaptmg.problem import checks

__all__ = ["COLUMNS", "FORMAT", "NEW", "prepare", "selected"]

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
    """Make the tables of an empty database, and those that an older store lacks.

    Parameters
    ----------
    connection : sqlite3.Connection
    called : str
        The file in messages.

    Returns
    -------
    int
        Version of what is there now: an older store that cannot be written stays as it is.

    Raises
    ------
    ValueError
        If it is another program's database, or of a later version.
    """
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
