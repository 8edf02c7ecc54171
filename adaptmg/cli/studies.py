"""``adaptmg study``, ``runs`` and ``report``: the study of a Python script, the runs of a store, tables as files."""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from adaptmg import _checks as checks
from adaptmg._files import file_size, write_bytes
from adaptmg.cli.output import printed, rows
from adaptmg.study.record import Record, frame
from adaptmg.study.store import Store

if TYPE_CHECKING:
    from adaptmg.study import Study

#: points that a plan shows
_SHOWN = 20


def study_of(path: Path, store: Path | None) -> Study:
    """Import a script, and return the study that it makes, or that of its ``run`` and ``parameters`` (with ``fixed``
    and ``depends`` where it has them), which is stored in results/SCRIPT.sqlite. What stands below
    ``if __name__ == "__main__"`` does not run."""
    import cloudpickle

    from adaptmg.study import Study

    file = checks.file_path("FILE", path)
    if file.suffix != ".py":
        raise ValueError(f"FILE must be a Python script that makes an am.Study, got {checks.shown(os.fspath(path))}")
    file_size("FILE", file)
    # as Python does for a script, so that it finds its neighbours; workers get it by value
    sys.path.insert(0, os.fspath(file.resolve().parent))
    spec = importlib.util.spec_from_file_location(file.stem, file)
    module = sys.modules[file.stem] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ValueError(f"{file} cannot be imported: {type(error).__name__}: {error}") from error
    cloudpickle.register_pickle_by_value(module)
    studies = list({id(value): value for value in vars(module).values() if isinstance(value, Study)}.values())
    if len(studies) == 1:
        if store is not None:
            raise ValueError("--store belongs to scripts with run and parameters: this one makes its am.Study itself")
        return studies[0]
    run, parameters = getattr(module, "run", None), getattr(module, "parameters", None)
    if studies or run is None or parameters is None:
        raise ValueError(f"{file} must make one am.Study, or have run and parameters; it makes {len(studies)} studies")
    return Study(run, parameters, Path("results", f"{file.stem}.sqlite") if store is None else store, name=file.stem,
                 fixed=getattr(module, "fixed", None), depends=getattr(module, "depends", None))


def plan(study: Study) -> str:
    """Return the first points of a study, their status, and the number of points."""
    points = list(itertools.islice(study.design.points(), _SHOWN))
    shown = {name: [point[name] for point in points] for name in study.parameters}
    shown["status"] = list(study.table()["status"].head(_SHOWN))
    rest = len(study) - _SHOWN
    return "\n".join([printed(shown, study.parameters, units={}, note=f"... {rest} more" if rest > 0 else ""), "",
                      repr(study), repr(study.status())])


def summary(study: Study, with_rows: bool) -> dict[str, object]:
    """Return a study as JSON takes it."""
    status = study.status()
    head = {"study": study.name, "runs": status.total, "done": status.done, "failed": status.failed,
            "stale": status.stale, "missing": status.missing, "why_stale": status.reasons, "errors": status.errors}
    return head | ({"rows": rows(study.table(details=True))} if with_rows else {})


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


def selected(records: Sequence[Record], where: str = "", details: bool = False) -> pd.DataFrame:
    """Return runs of a study as a table, without the parameters that are the same in all of its runs."""
    counts = Counter((key, repr(value)) for record in records for key, value in record.parameters.items())
    varying = list(dict.fromkeys(key for (key, _), count in counts.items() if count < len(records)))
    matching = _matching(records, where) if where else records
    names = varying or list(dict.fromkeys(key for key, _ in counts))
    return frame(names, [(record.parameters, record, record.status) for record in matching], details)


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


def _matching(records: Sequence[Record], where: str) -> list[Record]:
    """Return the records for which a condition of pandas holds."""
    names = list(dict.fromkeys(key for record in records for key in record.parameters))
    table = frame(names, [(record.parameters, record, record.status) for record in records], True)
    try:
        holds = table.eval(where, engine="python")
        if not pd.api.types.is_bool_dtype(holds):
            raise ValueError("it is not true or false for each run")
    except Exception as error:  # parser and columns have their own
        raise ValueError(f"--where {checks.shown(where)}: {error}; the columns are {', '.join(table)}") from error
    return [record for record, matches in zip(records, holds, strict=True) if matches]


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
