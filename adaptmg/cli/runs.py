"""``adaptmg runs`` and the table of ``adaptmg report``: runs of a store, conditions on them, tables as files."""

from __future__ import annotations

import io
import json
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pandas as pd

from adaptmg import _checks as checks
from adaptmg._files import write_bytes
from adaptmg.study.record import DETAILS, RESERVED, Record, frame
from adaptmg.study.store import Store
from adaptmg.study.tables import cells, numeric

Condition = tuple[str, str, str]


def opened(path: Path) -> Store:
    """Return a store that exists."""
    file = checks.file_path("STORE", path)
    if not file.exists():
        raise FileNotFoundError(2, "there is no such store", str(path))
    return Store(file)


def chosen(path: Path, names: Sequence[str], name: str | None) -> str:
    """Return the study of that name, or the only one."""
    if name is None and len(names) == 1:
        return names[0]
    if not names:
        raise ValueError(f"the store {path} has no runs")
    if name is None:
        raise ValueError(f"the store has several studies: give --study, one of {', '.join(names)}")
    if name not in names:
        raise ValueError(f"the store has no study {name!r}{checks.suggestion(name, names)}; it has {', '.join(names)}")
    return name


def selected(store: Store, name: str, *, status: str | None = None, where: Sequence[Condition] = (),
             limit: int | None = None, details: bool = False) -> tuple[pd.DataFrame, int]:
    """Return runs of a study in the order of storing, and their number without ``limit``. Parameters that are the same
    in all runs of the study are left out. Only runs that are shown are read, unless there are conditions."""
    if where:
        records = _matching(store.runs(name, status), where)
        total, records = len(records), records[:limit]
    else:
        total, records = store.count(name, status), store.runs(name, status, limit)
    first = store.runs(name, limit=1)
    same = set(first[0].parameters) - set(store.varying(name, first[0].parameters)) if first else set()
    names = list(dict.fromkeys(key for record in records for key in record.parameters))
    vary = [key for key in names if key not in same] or names
    return frame(vary, [(record.parameters, record, record.status) for record in records], details), total


def units(store: Store, name: str, columns: Sequence[str]) -> dict[str, str]:
    """Return units of the columns of a table: those of what study files measure where the study is of one."""
    if any("case.case" in record.parameters for record in store.runs(name, limit=1)):
        from adaptmg.cli.case_run import units_of  # loads the solvers

        return units_of(columns)
    return {column: unit for column, unit in {"seconds": "s", "peak_memory": "bytes"}.items() if column in columns}


def report(path: Path, study: str | None, results: list[str] | None, to: Path | None) -> tuple[Path, Path]:
    """Write the page of a study and its table; return both files."""
    from adaptmg.export import study_report

    store = opened(path)
    name = chosen(path, store.studies(), study)
    records = store.runs(name)
    table, _ = selected(store, name)
    table.attrs["study"] = name
    parameters = {key for record in records for key in record.parameters}
    if to is None and Path(name).name != name:
        raise ValueError(f"--to must be given, as the name of the study cannot be that of a file: {name!r}")
    page = path.with_name(f"{name}.html") if to is None else checks.file_path("--to", to)
    csv = page.with_suffix(".csv")
    if csv == page:
        raise ValueError(f"--to must be an HTML file, got {checks.shown(str(to))}: its table is a .csv next to it")
    written = study_report(table, page, parameters=[key for key in table if key in parameters], results=results,
                           csv=csv.name, units=units(store, name, table), summary=same_in_all(records, table),
                           made=made(records))
    write(table, csv)
    return written, csv


def same_in_all(records: Sequence[Record], columns: Sequence[str]) -> str:
    """Return a sentence on the parameters that all runs share, which the table leaves out."""
    same = {name: value for name, value in records[0].parameters.items()
            if name not in columns and not name.startswith("measure.")} if records else {}
    return f"In all runs {'; '.join(f'{name} = {_shown(value)}' for name, value in same.items())}." if same else ""


def _shown(value: object) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_shown, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def made(records: Sequence[Record]) -> dict[str, str]:
    """Return machines, commits, versions and dates of runs."""
    facts = {"machine": [record.machine for record in records], "commit": [record.commit[:12] for record in records],
             "versions of the runs": [", ".join(f"{name} {version}" for name, version in record.versions.items())
                                      for record in records]}
    texts = {name: "; ".join(sorted(set(filter(None, values)))[:3]) for name, values in facts.items()}
    when = sorted(record.finished for record in records if record.finished)
    return {name: text for name, text in texts.items() if text} | \
        ({"runs made": f"{when[0][:16]} to {when[-1][:16]} UTC"} if when else {})


def short(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with texts of one terminal line each, and without errors where there are none."""
    shown = table if table["error"].any() else table.drop(columns="error")
    return shown.map(lambda value: f"{value[:57]}..." if isinstance(value, str) and len(value) > 60 else value)


_ORDERED: dict[str, Callable[[float, float], bool]] = {"<": operator.lt, "<=": operator.le, ">": operator.gt,
                                                       ">=": operator.ge}
_ABSENT = object()


def parsed(text: str) -> Condition:
    """Return column, sign and value of a condition on runs."""
    found = re.fullmatch(r"([^=<>!]+)(=|!=|<=|>=|<|>)(.*)", text, re.DOTALL)
    if not found:
        raise ValueError(f"--where must be NAME=VALUE, or with !=, <, <=, > or >=, got {checks.shown(text)}")
    name, sign, value = (part.strip() for part in found.groups())
    if sign in _ORDERED and not _is_number(value):
        raise ValueError(f"--where {name}{sign} must be followed by a number, got {checks.shown(value)}")
    return name, sign, value


def _is_number(text: str) -> bool:
    try:
        return float(text) == float(text)
    except ValueError:
        return False


def _matching(records: list[Record], conditions: Sequence[Condition]) -> list[Record]:
    names = dict.fromkeys([*(name for record in records for name in (*record.parameters, *record.results)),
                           *RESERVED, *DETAILS])
    for name, sign, text in conditions:
        if name not in names:
            raise ValueError(f"there is no column {name!r}{checks.suggestion(name, names)}; there are "
                             f"{', '.join(names)}")
        records = [record for record in records if _holds(_value(record, name), sign, text)]
    return records


def _value(record: Record, name: str) -> object:
    for values in (record.parameters, record.results):
        if name in values:
            return values[name]
    return getattr(record, name) if name in RESERVED or name in DETAILS else _ABSENT


def _holds(value: object, sign: str, text: str) -> bool:
    plain = type(value) in (int, float)
    if sign in _ORDERED:
        return plain and _ORDERED[sign](value, float(text))
    equal = value is not _ABSENT and (text in (str(value), json.dumps(value))
                                      or (plain and _is_number(text) and value == float(text)))
    return equal == (sign == "=")


_ENDINGS = (".csv", ".parquet", ".tex")


def ending(path: Path) -> Path:
    """Return a path whose ending names a kind of file that can be written."""
    target = checks.file_path("--to", path)
    if target.suffix not in _ENDINGS:
        raise ValueError(f"--to must end in {', '.join(_ENDINGS[:-1])} or {_ENDINGS[-1]}, got "
                         f"{checks.shown(str(path))}")
    return target


def write(table: pd.DataFrame, path: Path, units: Mapping[str, str] | None = None) -> None:
    """Write a table as CSV, Parquet or LaTeX (with units), by the ending of the name."""
    target = ending(path)
    if target.suffix == ".tex":
        content = _latex(table, units).encode("utf-8", "backslashreplace")
    elif target.suffix == ".csv":
        content = table.map(_plain).to_csv(index=False).encode()
    else:
        buffer = io.BytesIO()
        try:
            table.map(_plain).apply(_of_one_type).to_parquet(buffer, index=False)
        except ImportError:
            raise ValueError("--to FILE.parquet needs the package pyarrow: pip install pyarrow, or write "
                             ".csv") from None
        content = buffer.getvalue()
    write_bytes(target, content)


def _plain(value: object) -> object:
    if isinstance(value, tuple):
        return json.dumps(value)
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


def _of_one_type(column: pd.Series) -> pd.Series:
    """Parquet has one type a column: values of several become texts of JSON."""
    kinds = {type(value) for value in column if value is not None and value == value}
    if column.dtype != object or len(kinds) < 2 or kinds <= {int, float}:
        return column
    return column.map(lambda value: None if value is None else json.dumps(value))


def _latex(table: pd.DataFrame, units: Mapping[str, str] | None) -> str:
    headers, columns = cells(table, units)
    kinds = "".join("r" if numeric(column) else "l" for _, column in table.items())
    made = pd.DataFrame(dict(zip(headers, columns, strict=True)))
    text = made.to_latex(index=False, column_format=kinds, escape=True)
    # at the beginning of a row these would belong to the end of the row before
    return re.sub(r"^(?=[\[*])", "{}", text, flags=re.MULTILINE)
