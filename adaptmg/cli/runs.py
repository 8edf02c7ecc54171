"""``adaptmg runs`` and the table of ``adaptmg report``: runs of a store, conditions on them, tables as files."""

from __future__ import annotations

import json
import operator
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import pandas as pd

from adaptmg import _checks as checks
from adaptmg._files import write_bytes
from adaptmg.study.record import DETAILS, RESERVED, Record, frame
from adaptmg.study.store import Store

Condition = tuple[str, str, str]


def opened(path: Path) -> Store:
    """Return a store that exists."""
    file = checks.file_path("STORE", path)
    if not file.exists():
        raise FileNotFoundError(2, "there is no such store", str(path))
    return Store(file)


def chosen(store: Store, name: str | None) -> str:
    """Return the study of that name, or the only one."""
    names = store.studies()
    if not names:
        raise ValueError(f"the store {store.path} has no runs")
    if name is None and len(names) > 1:
        raise ValueError(f"the store has several studies: give --study, one of {', '.join(names)}")
    if name is not None and name not in names:
        raise ValueError(f"the store has no study {name!r}{checks.suggestion(name, names)}; it has {', '.join(names)}")
    return names[0] if name is None else name


def selected(records: Sequence[Record], *, status: str | None = None, where: Sequence[Condition] = (),
             details: bool = False) -> pd.DataFrame:
    """Return runs of a study as a table, without the parameters that are the same in all of its runs."""
    counts = Counter((key, repr(value)) for record in records for key, value in record.parameters.items())
    varying = list(dict.fromkeys(key for (key, _), count in counts.items() if count < len(records)))
    found = [record for record in records if status in (None, record.status)]
    found = _matching(found, where) if where else found
    names = varying or list(dict.fromkeys(key for key, _ in counts))
    return frame(names, [(record.parameters, record, record.status) for record in found], details)


def units(columns: Sequence[str]) -> dict[str, str]:
    """Return units of the columns that every table of a study has."""
    return {column: unit for column, unit in {"seconds": "s", "peak_memory": "bytes"}.items() if column in columns}


def report(path: Path, study: str | None, results: list[str] | None, to: Path | None) -> tuple[Path, Path]:
    """Write the page of a study and its table; return both files."""
    from adaptmg.export import study_report

    store = opened(path)
    name = chosen(store, study)
    records = store.runs(name)
    table = selected(records)
    table.attrs["study"] = name
    parameters = {key for record in records for key in record.parameters}
    if to is None and Path(name).name != name:
        raise ValueError(f"--to must be given, as the name of the study cannot be that of a file: {name!r}")
    page = path.with_name(f"{name}.html") if to is None else checks.file_path("--to", to)
    csv = page.with_suffix(".csv")
    if csv == page:
        raise ValueError(f"--to must be an HTML file, got {checks.shown(str(to))}: its table is a .csv next to it")
    same = [f"{key} = {_shown(value)}" for key, value in records[0].parameters.items()
            if key not in table]
    written = study_report(table, page, parameters=[key for key in table if key in parameters], results=results,
                           csv=csv.name, units=units(list(table)), made=_origin(records),
                           summary=f"In all runs {'; '.join(same)}." if same else "")
    write(table, csv)
    return written, csv


def _shown(value: object) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_shown, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _origin(records: Sequence[Record]) -> dict[str, str]:
    """Return machines, commits, versions and dates of runs."""
    facts = {"machine": {record.machine for record in records}, "commit": {record.commit[:12] for record in records},
             "versions of the runs": {", ".join(map(" ".join, record.versions.items())) for record in records}}
    when = sorted(record.finished for record in records if record.finished)
    facts["runs made"] = {f"{when[0][:16]} to {when[-1][:16]} UTC"} if when else set()
    return {name: "; ".join(sorted(texts - {""})[:3]) for name, texts in facts.items() if texts - {""}}


def short(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with texts of one terminal line each, and without errors where there are none."""
    shown = table if table["error"].any() else table.drop(columns="error")
    return shown.map(lambda value: f"{value[:57]}..." if isinstance(value, str) and len(value) > 60 else value)


_ORDERED = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}


def parsed(text: str) -> Condition:
    """Return column, sign and value of a condition on runs."""
    found = re.fullmatch(r"([^=<>!]+)(=|!=|<=|>=|<|>)(.*)", text, re.DOTALL)
    if not found:
        raise ValueError(f"--where must be NAME=VALUE, or with !=, <, <=, > or >=, got {checks.shown(text)}")
    name, sign, value = (part.strip() for part in found.groups())
    if sign in _ORDERED and _number(value) is None:
        raise ValueError(f"--where {name}{sign} must be followed by a number, got {checks.shown(value)}")
    return name, sign, value


def _number(text: str) -> float | None:
    with suppress(ValueError):
        return float(text) if float(text) == float(text) else None
    return None


def _matching(records: Sequence[Record], conditions: Sequence[Condition]) -> list[Record]:
    """Return the records for which all conditions hold; values that a record lacks are unequal to every other."""
    values = [{**record.parameters, **record.results, **{name: getattr(record, name) for name in (*RESERVED, *DETAILS)
                                                         if name not in record.results}} for record in records]
    names = sorted(dict.fromkeys(name for row in values for name in row), key=lambda name: name in RESERVED + DETAILS)
    for name, _, _ in conditions:
        if name not in names:
            raise ValueError(f"there is no column {name!r}{checks.suggestion(name, names)}; there are "
                             f"{', '.join(names)}")
    return [record for record, row in zip(records, values, strict=True)
            if all(_holds(row, *condition) for condition in conditions)]


def _holds(row: Mapping[str, object], name: str, sign: str, text: str) -> bool:
    value, number = row.get(name), _number(text) if type(row.get(name)) in (int, float) else None
    if sign in _ORDERED:
        return number is not None and _ORDERED[sign](value, number)
    equal = text in (str(value), json.dumps(value)) or (number is not None and value == number)
    return (name in row and equal) == (sign == "=")


def ending(path: Path) -> Path:
    """Return a path whose ending names a kind of file that can be written."""
    target = checks.file_path("--to", path)
    if target.suffix != ".csv":
        raise ValueError(f"--to must end in .csv, got {checks.shown(str(path))}")
    return target


def write(table: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV."""
    write_bytes(ending(path), table.map(_plain).to_csv(index=False).encode())


def _plain(value: object) -> object:
    if isinstance(value, tuple):
        return json.dumps(value)
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value
