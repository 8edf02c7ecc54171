"""What is asked of a store without reading all of it: rows of a status, how many there are, which parameters vary.

Runs are read in the order of their row identifiers, which is that of storing, without the index, which has them in
another.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from typing import Any

from adaptmg.study.record import Value, canonical
from adaptmg.study.stored import schema

__all__ = ["count", "rows", "summaries", "varying"]

_CHOSEN = "WHERE study = ? AND (? IS NULL OR status = ?)"


def rows(connection: sqlite3.Connection, version: int, study: str, status: str | None = None,
         limit: int | None = None) -> list[tuple[Any, ...]]:
    """Rows of a study, without its name; at most ``limit``."""
    return connection.execute(f"SELECT {schema.selected(version)} FROM runs NOT INDEXED {_CHOSEN} ORDER BY rowid "
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
