"""What ``adaptmg runs`` shows: runs of a store, chosen without reading more of it than is printed where that can be."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from adaptmg.cli.described.meanings import units_of
from adaptmg.cli.listed.conditions import RowFilter, matching
from adaptmg.problem import checks
from adaptmg.study.frame import columns
from adaptmg.study.record import Record
from adaptmg.study.store import Store

__all__ = ["chosen", "made", "opened", "same_in_all", "selected", "short", "studies", "units", "which"]


def opened(path: Path) -> Store:
    """A store that is there; none is made."""
    file = checks.file_path("STORE", path)
    if not file.exists():
        raise FileNotFoundError(2, "there is no such store", str(path))
    return Store(file)


def studies(store: Store) -> dict[str, list[Any]]:
    """A row for each study in a store, by columns."""
    found = store.summaries()
    return {name: [row[k] for row in found] for k, name in enumerate(("study", "done", "failed", "seconds", "last"))}


def chosen(names: Sequence[str], name: str | None) -> str:
    """The study of that name, or the only one."""
    if name is None:
        return names[0]
    if name not in names:
        raise ValueError(f"the store has no study {name!r}{checks.suggestion(name, names)}; it has {', '.join(names)}")
    return name


def which(path: Path, names: Sequence[str]) -> str:
    """What to say where a study must be named, or where there is none."""
    return f"the store has several studies: give --study, one of {', '.join(names)}" if names else \
        f"the store {path} has no runs"


def selected(store: Store, name: str, *, status: str | None = None, where: Sequence[RowFilter] = (),
             limit: int | None = None, details: bool = False) -> tuple[dict[str, list[Any]], int]:
    """Runs of a study in the order they were stored, by columns, and how many there are without ``limit``.

    Parameters that are the same in all runs of the study are left out.
    """
    if where:
        records = matching(store.runs(name, status), where)
        total, records = len(records), records[:limit]
    else:
        total, records = store.count(name, status), store.runs(name, status, limit)
    first = store.runs(name, limit=1)
    same = set(first[0].parameters) - set(store.varying(name, first[0])) if first else set()
    names = list(dict.fromkeys(key for record in records for key in record.parameters))
    vary = [key for key in names if key not in same] or names
    absent = dict.fromkeys(vary)
    return columns(vary, [(absent | record.parameters, record, record.status) for record in records], details), total


def units(store: Store, name: str, found: dict[str, list[Any]]) -> dict[str, str]:
    """Units of the columns of a table: those of what study files measure where the study is of one."""
    if any("case.case" in record.parameters for record in store.runs(name, limit=1)):
        return units_of(found)
    return {column: unit for column, unit in {"seconds": "s", "peak_memory": "bytes"}.items() if column in found}


def same_in_all(records: Sequence[Record], found: dict[str, list[Any]]) -> str:
    """A sentence on the parameters that all runs share, which the table leaves out; what is measured it shows."""
    same = {name: value for name, value in records[0].parameters.items()
            if name not in found and not name.startswith("measure.")} if records else {}
    told = [f"{name} = {_shown(value)}" for name, value in same.items()]
    return f"In all runs {'; '.join(told)}." if told else ""


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_shown, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def made(records: Sequence[Record]) -> dict[str, str]:
    """Machines, commits, versions and dates of runs."""
    facts = {"machine": [record.machine for record in records], "commit": [record.commit[:12] for record in records],
             "versions of the runs": [", ".join(f"{name} {version}" for name, version in record.versions.items())
                                      for record in records]}
    told = {name: "; ".join(sorted(set(filter(None, values)))[:3]) for name, values in facts.items()}
    when = sorted(record.finished for record in records if record.finished)
    return {name: text for name, text in told.items() if text} | \
        ({"runs made": f"{when[0][:16]} to {when[-1][:16]} UTC"} if when else {})


def short(found: dict[str, list[Any]]) -> dict[str, list[Any]]:
    """With texts of one terminal line each, and without errors where there are none."""
    if not any(found["error"]):
        found = {name: column for name, column in found.items() if name != "error"}
    return {name: [f"{value[:57]}..." if isinstance(value, str) and len(value) > 60 else value for value in column]
            for name, column in found.items()}
