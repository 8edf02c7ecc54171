"""Store: the runs of studies in one SQLite file, one transaction for runs that finish together.

SQLite keeps its rollback journal with full synchronisation: a stored run survives a killed process
and a power cut, and a half-written one does not exist. (Its write-ahead log does not work on the
network file systems of clusters.) Several processes may write to one store.

Table ``runs`` has a row a run: its parameters (the text that identifies it) and a :class:`Record`
as JSON. ``kept`` has results that are not numbers or texts: arrays, meshes, solutions and figures,
packed into bytes where the run function runs; nothing is pickled. Both have a hash of each row, as
SQLite has none: a row that the disk has changed is stale, and what is kept is refused. ``origins``
has the parts of each fingerprint, so that a study can say why a row is stale. ``claims`` has the
runs that are being computed, each with the process that does and a number that this process
increases while it lives: whether it does is seen without comparing clocks."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import sqlite3
import sys
import threading
import time
import uuid
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import make_folder, waiting_folder
from adaptmg._machine import has_ended, process_name
from adaptmg._text import printable
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.study.designs import Scalar, Value, canonical

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from adaptmg.solver.result import Result

    Kept = np.ndarray | MeshArrays | Result | str

#: bytes of a result that is kept
_MOST_BYTES = 2**29


@dataclass(frozen=True, kw_only=True)
class Record:
    """One run: what it was given, what it returned, and where it ran."""

    parameters: dict[str, Value]  # the fixed ones too
    status: str  # "done" or "failed"
    results: dict[str, Scalar] = field(
        default_factory=dict
    )  # the kind of result where it is kept in ``kept``
    error: str = ""  # type and text of the exception of a failed run
    seconds: float = 0.0  # wall time without compiling
    code: str = ""  # fingerprint, see :mod:`adaptmg.solver.fingerprint`
    versions: dict[str, str] = field(default_factory=dict)  # of Python and of the packages
    finished: str = ""  # UTC, ISO 8601
    traceback: str = ""  # of a failed run
    peak_memory: int = (
        0  # largest memory of the process during the run, bytes; 0 where the system does not say
    )
    started: str = ""  # UTC, ISO 8601
    machine: str = ""
    commit: str = ""  # of adaptmg, where it lies in a git repository


#: what is stored as JSON
_FIELDS = [entry.name for entry in fields(Record) if entry.name != "parameters"]


@dataclass(frozen=True)
class Packed:
    """A result as bytes."""

    kind: str  # array, mesh, result or figure
    content: bytes


def pack(value: object) -> Packed | None:
    """Return ``value`` as bytes, None if it is of no kind that is kept."""
    packed = None
    if isinstance(value, np.ndarray) and value.ndim:
        packed = Packed("array", _array(value))
    # without the module loaded there is no object of its class
    elif isinstance(value, (MeshArrays, *_loaded("adaptmg.solver.result", "Result"))):
        from adaptmg.solver.result import KINDS
        from adaptmg.solver.store import packed as pack_fields

        packed = Packed(
            "mesh" if isinstance(value, MeshArrays) else "result", pack_fields(value, KINDS)
        )
    elif isinstance(value, _loaded("matplotlib.figure", "Figure")):
        buffer = io.BytesIO()
        cast("Figure", value).savefig(buffer, format="svg", bbox_inches="tight")
        packed = Packed("figure", buffer.getvalue())
    if packed is not None and len(packed.content) > _MOST_BYTES:
        raise ValueError(
            f"a result of {len(packed.content):.3g} bytes cannot be kept, at most {_MOST_BYTES:.3g}"
        )
    return packed


def _loaded(module: str, name: str) -> tuple[type, ...]:
    """Return the class of this name, alone in a tuple; () if its module is not loaded."""
    kind = getattr(sys.modules.get(module), name, None)
    return () if kind is None else (kind,)


def _array(array: np.ndarray) -> bytes:
    """Return an array in numpy's file format; TypeError for kinds that cannot be stored."""
    if isinstance(array, np.ma.MaskedArray):
        raise TypeError(
            "a masked array cannot be kept, as its mask would be lost: return its data and mask"
        )
    if array.dtype.kind not in "biufcUSMm":
        raise TypeError(f"an array of {array.dtype} cannot be kept: return numbers or texts")
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def unpack(packed: Packed) -> Kept:
    """Return an array, a mesh or a result; of a figure the text of its SVG."""
    if packed.kind == "figure":
        return packed.content.decode()
    if packed.kind == "array":
        return np.load(io.BytesIO(packed.content), allow_pickle=False)
    from adaptmg.solver.result import KINDS
    from adaptmg.solver.store import read

    with waiting_folder() as folder:
        (folder / "kept.npz").write_bytes(packed.content)
        return read(folder / "kept.npz", (MeshArrays,) if packed.kind == "mesh" else KINDS).value


_FORMAT = 4
_TABLES = {
    "runs": "CREATE TABLE runs (study TEXT, parameters TEXT, record TEXT, hash BLOB, PRIMARY KEY (study, parameters))",
    "kept": "CREATE TABLE kept (study TEXT, parameters TEXT, name TEXT, kind TEXT, content BLOB, hash BLOB, "
    "PRIMARY KEY (study, parameters, name))",
    "origins": "CREATE TABLE origins (code TEXT PRIMARY KEY, parts TEXT)",
    "claims": "CREATE TABLE claims (study TEXT, parameters TEXT, owner TEXT, renewals INTEGER, "
    "PRIMARY KEY (study, parameters))",
}
#: seconds between two renewals of a claim, and those without one after which it is taken over from
#: a process of which is not seen whether it has ended: a function that holds Python's lock, such as
#: scipy's factorisations, keeps renewals back for minutes. A claim that is taken over too early
#: costs a run that is computed twice.
_RENEWAL_S, _LEASE_S = 30.0, 900.0
#: seconds to wait for another process that writes
_PATIENCE_S = 60.0
#: remedies by a part of SQLite's message
_FIXES = {
    "locked": "another process holds it; wait, or end that process",
    "readonly": "it or its folder is write-protected",
    "full": "make room",
    "unable to open": "it cannot be opened; check the permissions of file and folder",
}


class Store:
    """Runs by study and parameters, in a SQLite file or (path None) in memory; errors name the
    file."""

    def __init__(self, path: str | os.PathLike[str] | None) -> None:
        # SQLite keeps its journal next to the file itself, so links are followed
        self.path = (
            None if path is None else Path(os.path.realpath(checks.file_path("store", path)))
        )
        self._called = (
            "the store in memory" if self.path is None else printable(os.fspath(self.path))
        )
        self._lock = threading.RLock()
        # claims of others by run: owner and renewals, and when these were seen first
        self._seen: dict[tuple[str, str], tuple[tuple[str, int], float]] = {}
        if self.path is not None:
            make_folder("store", self.path.parent)
            if self.path.exists() and not self.path.is_file():
                raise ValueError(f"{self._called} is a folder or a device: store must be a file")
        with self._explained():
            self._connection = sqlite3.connect(
                ":memory:" if self.path is None else self.path,
                timeout=_PATIENCE_S,
                check_same_thread=False,
            )
        weakref.finalize(self, self._connection.close)
        with self._explained():
            self._prepare()
        self._opened = self._identity()

    def _prepare(self) -> None:
        """Set up the connection, and make the tables in an empty file."""
        self._connection.execute("PRAGMA synchronous = FULL")
        if not self._is_store():
            with self._transaction() as connection:
                if not self._is_store():  # made by another process meanwhile
                    for statement in (*_TABLES.values(), f"PRAGMA user_version = {_FORMAT}"):
                        connection.execute(statement)

    def _is_store(self) -> bool:
        """Return whether there are tables of this version; False for an empty file, ValueError for
        other databases, also for those with views and triggers."""
        tables = dict(
            self._connection.execute(
                "SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL UNION ALL "
                "SELECT 'version', user_version FROM pragma_user_version"
            )
        )
        if tables not in ({"version": 0}, _TABLES | {"version": _FORMAT}):
            raise ValueError(
                f"{self._called} is a database, but not a store of this version of adaptmg (version "
                f"{tables['version']}, tables {checks.shown(list(tables))}): give another file"
            )
        return len(tables) > 1

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Do all inside or nothing, before or after what other processes do."""
        with self._connection as connection:
            connection.execute("BEGIN IMMEDIATE")
            yield connection

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Raise errors of SQLite, and of content that is not what was written, as errors that name
        the file."""
        try:
            with self._lock:
                yield
        except (
            sqlite3.Error,
            UnicodeDecodeError,
            json.JSONDecodeError,
            TypeError,
            AttributeError,
            RecursionError,
        ) as error:
            if fix := next((words for sign, words in _FIXES.items() if sign in str(error)), ""):
                raise OSError(f"{self._called}: {error}: {fix}") from error
            raise ValueError(
                f"{self._called} is not a store of a study, or damaged ({error}): give another file"
            ) from error

    def _identity(self) -> tuple[int, int] | None:
        """Return the device and the number of the file; None in memory, or where the file is gone."""
        try:
            status = None if self.path is None else self.path.stat()
        except OSError:
            return None
        return None if status is None else (status.st_dev, status.st_ino)

    def _check_there(self) -> None:
        """Raise OSError unless the path still names the file that was opened: SQLite goes on writing
        into a file that was removed."""
        now = self._identity()
        if now != self._opened:
            how = "removed" if now is None else "replaced by another file"
            raise OSError(f"{self._called} was {how} while it was in use: run the study again")

    def put(
        self,
        study: str,
        records: Sequence[Record],
        parts: dict[str, str] | None = None,
        contents: Sequence[dict[str, Packed]] = (),
    ) -> None:
        """Write runs in one transaction, which Ctrl-C does not prevent, in place of earlier ones
        with the same parameters; ``parts`` are those of their fingerprint, ``contents`` has for each
        what is kept by name."""
        try:
            self._write(study, records, parts, contents)
        except KeyboardInterrupt:  # it undid the transaction
            self._write(study, records, parts, contents)
            raise

    def _write(
        self,
        study: str,
        records: Sequence[Record],
        parts: dict[str, str] | None,
        contents: Sequence[dict[str, Packed]],
    ) -> None:
        """Store runs in place of older ones with the same parameters, with their packed results
        (``contents``, one for each or none at all), and end the claims on them."""
        keys = [(study, canonical(record.parameters)) for record in records]
        rows = [json.dumps({name: getattr(record, name) for name in _FIELDS}) for record in records]
        kept_rows = [
            (*key, name, item.kind, item.content, _hash(*key, name, item.kind, item.content))
            for key, packed in zip(keys, contents, strict=bool(contents))
            for name, item in packed.items()
        ]
        with self._explained():
            self._check_there()
            with self._transaction() as connection:
                for table in ("claims", "kept"):
                    connection.executemany(
                        f"DELETE FROM {table} WHERE study = ? AND parameters = ?", keys
                    )
                connection.executemany(
                    "INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?)",
                    [(*key, row, _hash(*key, row)) for key, row in zip(keys, rows, strict=True)],
                )
                connection.executemany("INSERT INTO kept VALUES (?, ?, ?, ?, ?, ?)", kept_rows)
                if parts is not None:
                    connection.executemany(
                        "INSERT OR IGNORE INTO origins VALUES (?, ?)",
                        [(code, json.dumps(parts)) for code in {record.code for record in records}],
                    )

    def claim(self, study: str, keys: Sequence[str], owner: str) -> list[bool]:
        """Claim the runs that no process which may live has claimed, in one transaction; return for
        each whether it is claimed now."""
        with self._explained():
            self._check_there()
            with self._transaction() as connection:
                held = [
                    connection.execute(
                        "SELECT owner, renewals FROM claims WHERE study = ? AND parameters = ?",
                        (study, key),
                    ).fetchone()
                    for key in keys
                ]
                claimed = [
                    other is None or not self._may_live((study, key), *other)
                    for key, other in zip(keys, held, strict=True)
                ]
                connection.executemany(
                    "INSERT OR REPLACE INTO claims VALUES (?, ?, ?, 0)",
                    [(study, key, owner) for key, ours in zip(keys, claimed, strict=True) if ours],
                )
        return claimed

    def _may_live(self, run: tuple[str, str], owner: str, renewals: int) -> bool:
        """Return whether the process of a claim may still compute: not if it has ended, nor if it
        has not renewed the claim for a while by the clock of this process."""
        process, _, _ = owner.partition(" ")  # as new_owner joins them
        if has_ended(process):
            return False
        if run not in self._seen or self._seen[run][0] != (owner, renewals):
            self._seen[run] = (owner, renewals), time.monotonic()
        _, first_seen = self._seen[run]
        return time.monotonic() - first_seen < _LEASE_S

    @contextmanager
    def claims_of(self, owner: str) -> Iterator[None]:
        """Renew the claims of an owner while it computes, and give them up in the end."""
        ended = threading.Event()

        def renew() -> None:
            while not ended.wait(_RENEWAL_S):
                # a store that has gone, say, is reported where a run is stored
                with (
                    contextlib.suppress(OSError, ValueError),
                    self._explained(),
                    self._transaction() as connection,
                ):
                    connection.execute(
                        "UPDATE claims SET renewals = renewals + 1 WHERE owner = ?", (owner,)
                    )

        threading.Thread(target=renew, daemon=True).start()
        try:
            yield
        finally:
            ended.set()
            with contextlib.suppress(OSError, ValueError):
                self.release(owner)

    def release(self, owner: str, key: str = "%") -> None:
        """Give up the claims of an owner: on all runs ("%", which is the text of no run), or on the one
        with the canonical parameters ``key``."""
        with self._explained(), self._transaction() as connection:
            connection.execute(
                "DELETE FROM claims WHERE owner = ? AND ? IN (parameters, '%')", (owner, key)
            )

    def get(self, study: str) -> dict[str, Record]:
        """Return all runs of a study in the order of storing, by their canonical parameters."""
        # the index has the rows in another order
        return self._records("NOT INDEXED WHERE study = ? ORDER BY rowid", study)

    def one(self, study: str, key: str) -> Record | None:
        """Return the run of a study with these canonical parameters, if it is stored."""
        return self._records("WHERE study = ? AND parameters = ?", study, key).get(key)

    def _records(self, condition: str, *values: str) -> dict[str, Record]:
        """Return the records of the runs that meet an SQL condition, by their parameters."""
        columns = ", ".join(f"CAST({name} AS BLOB)" for name in ("parameters", "record", "hash"))
        with self._explained():
            rows = self._connection.execute(
                f"SELECT {columns} FROM runs {condition}", values
            ).fetchall()
            return {
                key.decode("utf-8", "replace"): _record(values[0], key, record, written)
                for key, record, written in rows
            }

    def kept(self, study: str, key: str) -> dict[str, Packed]:
        """Return the values that a run keeps, by name; ValueError if they are damaged."""
        with self._explained():
            rows = self._connection.execute(
                "SELECT name, kind, content, hash FROM kept WHERE study = ? AND parameters = ?",
                (study, key),
            ).fetchall()
        for name, kind, content, written in rows:
            if written != _hash(study, key, name, kind, content):
                raise ValueError(
                    f"{self._called}: the {kind} {checks.shown(name)} of the run {checks.shown(key)} is "
                    "damaged, as its hash says: compute it again with Study.run(rerun=True)"
                )
        return {name: Packed(kind, content) for name, kind, content, _ in rows}

    def studies(self) -> list[str]:
        """Return the names of the studies."""
        with self._explained():
            return [
                name
                for (name,) in self._connection.execute(
                    "SELECT DISTINCT study FROM runs ORDER BY study"
                )
            ]

    def origins(self) -> dict[str, dict[str, str]]:
        """Return the parts of the stored fingerprints, by the fingerprint."""
        with self._explained():
            return {
                code: json.loads(parts)
                for code, parts in self._connection.execute("SELECT * FROM origins")
            }


def new_owner() -> str:
    """Return the name of this process and, after a space, that of one study in it, for claims."""
    return f"{process_name(os.getpid())} {uuid.uuid4().hex}"


def _hash(*parts: str | bytes) -> bytes:
    """Return the hash of texts and bytes, each after its length, so that it counts where they end."""
    content = hashlib.sha256()
    for part in parts:
        part = part if isinstance(part, bytes) else part.encode()
        content.update(b"%d " % len(part))
        content.update(part)
    return content.digest()


def _record(study: str, key: bytes, record: bytes, written: bytes) -> Record:
    """Return a run as it was stored; a stale one in place of a row that is damaged."""
    if written != _hash(study, key, record):
        error = "DamagedRow: the store does not hold what was written"
        return Record(parameters={}, status="failed", error=error)
    parameters = {name: _restored(value) for name, value in json.loads(key).items()}
    return Record(parameters=parameters, **json.loads(record))


def _restored(value: Scalar | list) -> Value:
    """Return a value read from JSON with its lists as the tuples that they were."""
    return tuple(map(_restored, value)) if isinstance(value, list) else value
