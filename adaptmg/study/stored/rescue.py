"""What was done when a store cannot be written any more: into a file of its own, nothing is lost."""

from __future__ import annotations

import contextlib
import os
import shlex
import sqlite3
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from adaptmg.runtime.text import printable
from adaptmg.study.stored import schema

__all__ = ["save"]


def save(store: Path, connection: sqlite3.Connection | None, rows: Sequence[tuple[Any, ...]]) -> str:
    """Write a new store with the runs of this process, and those of the old file that can still be read.

    Parameters
    ----------
    store : Path
        The store that failed.
    connection : sqlite3.Connection or None
        To it, if its content is to be saved too: after it was removed that is still there.
    rows : sequence of tuples
        All runs that this process has written or tried to, columns as in :data:`adaptmg.study.stored.schema.COLUMNS`.

    Returns
    -------
    str
        What to tell the user: where the runs are, and how they come back.
    """
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
        schema.prepare(new, str(target))
        put = f"INSERT OR REPLACE INTO runs ({', '.join(schema.COLUMNS)}) VALUES " \
              f"({', '.join('?' * len(schema.COLUMNS))})"
        with new:
            if connection is not None:
                new.executemany(put, _readable(connection, f"SELECT {', '.join(schema.COLUMNS)} FROM runs"))
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
