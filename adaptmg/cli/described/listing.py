"""What ``adaptmg runs`` shows and writes."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from adaptmg.cli.described.work import rows
from adaptmg.problem import checks
from adaptmg.runtime.atomic import write_bytes
from adaptmg.study.frame import frame
from adaptmg.study.store import Store

__all__ = ["chosen", "filtered", "opened", "rows", "short", "studies", "table", "write"]


def opened(path: Path) -> Store:
    """A store that is there; none is made."""
    file = checks.file_path("STORE", path)
    if not file.exists():
        raise FileNotFoundError(2, "there is no such store", str(path))
    return Store(file)


def studies(store: Store) -> pd.DataFrame:
    """A row for each study in a store."""
    found = {name: list(store.get(name).values()) for name in store.studies()}
    return pd.DataFrame([{"study": name, "done": sum(r.status == "done" for r in records),
                          "failed": sum(r.status == "failed" for r in records),
                          "seconds": float(sum(r.seconds for r in records)),
                          "last": max(r.finished for r in records)} for name, records in found.items()],
                        columns=["study", "done", "failed", "seconds", "last"])


def chosen(names: Sequence[str], name: str | None) -> str:
    """The study of that name, or the only one."""
    if name is None:
        return names[0]
    if name not in names:
        raise ValueError(f"the store has no study {name!r}{checks.suggestion(name, names)}; it has {', '.join(names)}")
    return name


def table(store: Store, name: str, details: bool) -> pd.DataFrame:
    """All runs of a study in the order they were stored; parameters that are the same in all come last."""
    records = list(store.get(name).values())
    names = list(dict.fromkeys(key for record in records for key in record.parameters))
    texts = {key: {repr(record.parameters.get(key)) for record in records} for key in names}
    vary = [key for key in names if len(texts[key]) > 1] or names
    absent = dict.fromkeys(vary)
    made = frame(vary, [(absent | record.parameters, record, record.status) for record in records], details)
    return made


def filtered(found: pd.DataFrame, status: str | None, where: Sequence[str]) -> pd.DataFrame:
    """The rows of a status and with given values."""
    if status is not None:
        found = found[found["status"] == checks.choice("--status", status, ("done", "failed"))]
    for condition in where:
        name, equals, text = condition.partition("=")
        if not equals:
            raise ValueError(f"--where must be NAME=VALUE, got {checks.shown(condition)}")
        if name not in found.columns:
            raise ValueError(f"there is no column {name!r}{checks.suggestion(name, found.columns)}; there are "
                             f"{', '.join(map(str, found.columns))}")
        found = found[[_is(value, text) for value in found[name]]]
    return found


def _is(value: object, text: str) -> bool:
    """Whether a value is the one that a text says: as text, or as a number."""
    if str(value) == text:
        return True
    try:
        given = json.loads(text)
    except ValueError:
        return False
    if isinstance(given, list):
        return isinstance(value, tuple) and list(value) == given
    return isinstance(value, bool) == isinstance(given, bool) and value == given


def short(found: pd.DataFrame) -> pd.DataFrame:
    """With texts of one terminal line each."""
    return found.map(lambda value: f"{value[:57]}..." if isinstance(value, str) and len(value) > 60 else value)


def write(found: pd.DataFrame, path: Path) -> None:
    """A table as CSV, Parquet or LaTeX, by the ending of the name; whole or not at all."""
    target = checks.file_path("--to", path)
    if target.suffix == ".csv":
        content = found.to_csv(index=False).encode("utf-8", "backslashreplace")
    elif target.suffix == ".tex":
        content = _latex(found).encode("utf-8", "backslashreplace")
    elif target.suffix == ".parquet":
        buffer = io.BytesIO()
        plain = found.map(lambda value: json.dumps(value) if isinstance(value, tuple) else value)
        plain.attrs = {}
        try:
            plain.to_parquet(buffer, index=False)
        except ImportError:
            raise ValueError("--to FILE.parquet needs the package pyarrow: install it, or write .csv") from None
        content = buffer.getvalue()
    else:
        raise ValueError(f"--to must end in .csv, .parquet or .tex, got {checks.shown(str(path))}")
    write_bytes(target, content)


_SPECIAL = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
            **{c: f"\\{c}" for c in "&%$#_{}"}}


def _latex(found: pd.DataFrame) -> str:
    """A tabular of booktabs, numbers right-aligned."""
    from adaptmg.study.tables import cells

    headers, columns = cells(found, None, None)
    kinds = "".join("r" if pd.api.types.is_numeric_dtype(found[name]) else "l" for name in found.columns)
    escaped = [["".join(_SPECIAL.get(c, c) for c in cell) for cell in column] for column in [headers, *columns]]
    lines = [" & ".join(row) + r" \\" for row in zip(*escaped[1:], strict=True)]
    return "\n".join([f"\\begin{{tabular}}{{{kinds}}}", r"\toprule", " & ".join(escaped[0]) + r" \\", r"\midrule",
                      *lines, r"\bottomrule", r"\end{tabular}", ""])
