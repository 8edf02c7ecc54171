"""A record as a row of the store, and back."""

from __future__ import annotations

import gc
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from adaptmg.problem import checks
from adaptmg.runtime.text import printable
from adaptmg.study.record import Record, canonical, plain_results, restored

__all__ = ["json_object", "record_row", "row_record", "uncollected"]

_PLAIN = {bool, int, float, str, type(None)}
_NAMES = ("status", "error", "seconds", "code", "finished", "traceback", "peak_memory", "started", "machine", "commit",
          "tries")


def record_row(study: str, record: Record) -> tuple[Any, ...]:
    """Columns as in :data:`adaptmg.study.stored.schema.COLUMNS`."""
    return (study, canonical(record.parameters), record.status, json.dumps(record.results), printable(record.error),
            record.seconds, record.code, json.dumps(record.versions), record.finished, printable(record.traceback),
            record.peak_memory, record.started, printable(record.machine), record.commit, record.tries,
            json.dumps(record.files) if record.files else "{}")


def row_record(row: Sequence[Any], parameters: Any, results: Any) -> Record:
    """A record of a row without its study; parameters and results are those of the row, read from JSON.

    Raises
    ------
    ValueError, TypeError
        If adaptmg cannot have written it.
    """
    (_, status, _, error, seconds, code, versions, finished, traceback, peak, started, machine, commit, tries,
     files) = row
    for found in (parameters, results):
        checks.instance("its JSON", found, dict, "an object")
    if not _PLAIN.issuperset(map(type, results.values())):
        plain_results(results, {})
    texts = (error, code, finished, traceback, started, machine, commit)
    if status not in ("done", "failed") or not {int, float}.issuperset(map(type, (seconds, peak, tries))) \
            or {str} != set(map(type, texts)):
        raise ValueError("a column holds something else than it should")
    if not _PLAIN.issuperset(map(type, parameters.values())):
        parameters = {name: restored(value) for name, value in parameters.items()}
    record = object.__new__(Record)
    # 100 000 of them: the __init__ of a frozen dataclass takes three times as long
    record.__dict__.update(zip(_NAMES, (status, error, seconds, code, finished, traceback, peak, started, machine,
                                        commit, tries), strict=True))
    record.__dict__.update(parameters=parameters, results=results, versions=_versions(versions),
                           files={} if files == "{}" else _files(files))
    return record


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


@lru_cache(maxsize=64)
def _versions(text: Any) -> dict[str, Any]:
    """The same for all rows of a sweep."""
    return json_object(text)


def _files(text: Any) -> dict[str, str]:
    files = json_object(text)
    if not all(isinstance(path, str) for path in files.values()):
        raise ValueError("its files have names that are no texts")
    return files
