"""A record as a row of the store, and back."""

from __future__ import annotations

import gc
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from typing import Any

from adaptmg.problem import checks
from adaptmg.runtime.text import printable
from adaptmg.study.record import Record, canonical, plain_results, restored

__all__ = ["json_object", "record_row", "row_records", "uncollected"]

_PLAIN = {bool, int, float, str, type(None)}
#: attributes of a record, in the order of the columns of a row after its study
_COLUMNS = ("parameters", "status", "results", "error", "seconds", "code", "versions", "finished", "traceback",
            "peak_memory", "started", "machine", "commit", "tries", "files")
_NUMBERS = ("seconds", "peak_memory", "tries")
_TEXTS = ("error", "code", "finished", "traceback", "started", "machine", "commit")


def record_row(study: str, record: Record) -> tuple[Any, ...]:
    """Columns as in :data:`adaptmg.study.stored.schema.COLUMNS`."""
    return (study, canonical(record.parameters), record.status, json.dumps(record.results), printable(record.error),
            record.seconds, record.code, json.dumps(record.versions), record.finished, printable(record.traceback),
            record.peak_memory, record.started, printable(record.machine), record.commit, record.tries,
            json.dumps(record.files) if record.files else "{}")


def row_records(rows: Sequence[Sequence[Any]]) -> list[Record]:
    """Records of rows without their study, checked column by column, as there may be 100 000.

    Raises
    ------
    ValueError, TypeError, RecursionError
        If adaptmg cannot have written one of them; which one, rows given one by one tell.
    """
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
