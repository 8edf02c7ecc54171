"""What ``adaptmg runs`` shows: runs of a store, chosen without reading more of it than is printed where that can be.

Conditions on runs, ``NAME=VALUE``: parameters, results and what a store adds, compared as numbers or as text.

Tables as files: CSV, Parquet, LaTeX.
"""

from __future__ import annotations

import io
import json
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adaptmg import _checks as checks
from adaptmg._files import write_bytes
from adaptmg.study.record import DETAILS, RESERVED, Record
from adaptmg.study.store import Store
from adaptmg.study.tables import columns

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["RowFilter", "chosen", "ending", "made", "matching", "opened", "parsed", "same_in_all", "selected", "short",
           "studies", "units", "which", "write"]

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
        from adaptmg.cli.measure import units_of  # loads the solvers

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


_ORDERED: dict[str, Callable[[Any, Any], bool]] = {"<": operator.lt, "<=": operator.le, ">": operator.gt,
                                                   ">=": operator.ge}
_ABSENT = object()


@dataclass(frozen=True)
class RowFilter:
    """A condition on one column."""

    name: str  # of the column
    sign: str  # one of = != < <= > >=
    text: str  # the value as it was written

    def holds(self, value: Any) -> bool:
        """Whether a value meets it; ``<`` and the like hold for numbers only."""
        if self.sign in _ORDERED:
            return type(value) in (int, float) and _ORDERED[self.sign](value, float(self.text))
        return _is(value, self.text) == (self.sign == "=")


def parsed(text: str) -> RowFilter:
    """The condition that a text says."""
    found = re.fullmatch(r"([^=<>!]+)(=|!=|<=|>=|<|>)(.*)", text, re.DOTALL)
    if not found:
        raise ValueError(f"--where must be NAME=VALUE, or with !=, <, <=, > or >=, got {checks.shown(text)}")
    made = RowFilter(found[1].strip(), found[2], found[3].strip())
    if made.sign in _ORDERED and _number(made.text) is None:
        raise ValueError(f"--where {made.name}{made.sign} must be followed by a number, got {checks.shown(made.text)}")
    return made


def matching(records: Sequence[Record], conditions: Sequence[RowFilter]) -> list[Record]:
    """The runs for which all conditions hold; ValueError for a column that no run has."""
    names = dict.fromkeys([*(name for record in records for name in (*record.parameters, *record.results)),
                           *RESERVED, *DETAILS])
    for condition in conditions:
        if condition.name not in names:
            raise ValueError(f"there is no column {condition.name!r}{checks.suggestion(condition.name, names)}; there "
                             f"are {', '.join(names)}")
        records = [record for record in records if condition.holds(_value(record, condition.name))]
    return list(records)


def _value(record: Record, name: str) -> Any:
    for values in (record.parameters, record.results):
        if name in values:
            return values[name]
    return getattr(record, name) if name in RESERVED or name in DETAILS else _ABSENT


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return None if math.isnan(number) else number


def _is(value: Any, text: str) -> bool:
    """Whether a value is the one that a text says: as text, as a number, or as JSON (true, null, lists)."""
    if value is _ABSENT:
        return False
    if str(value) == text:
        return True
    if type(value) in (int, float):
        return value == _number(text)
    try:
        given = json.loads(text)
    except ValueError:
        return False
    if isinstance(given, list):
        return isinstance(value, tuple) and json.loads(json.dumps(value)) == given
    return type(value) is type(given) and value == given


_ENDINGS = (".csv", ".parquet", ".tex")


def ending(path: Path) -> Path:
    """A path whose ending says a kind of file that can be written."""
    target = checks.file_path("--to", path)
    if target.suffix not in _ENDINGS:
        raise ValueError(f"--to must end in {', '.join(_ENDINGS[:-1])} or {_ENDINGS[-1]}, got "
                         f"{checks.shown(str(path))}")
    return target


def write(found: Mapping[str, Sequence[Any]], path: Path, units: Mapping[str, str] | None = None) -> None:
    """A table, by columns, as CSV, Parquet or LaTeX (with units), by the ending of the name; whole or not at all."""
    target = ending(path)
    if target.suffix == ".tex":
        content = _latex(found, units).encode("utf-8", "backslashreplace")
    else:
        import pandas as pd

        plain = pd.DataFrame({name: [_plain(value) for value in column] for name, column in found.items()})
        content = _parquet(plain) if target.suffix == ".parquet" else plain.to_csv(index=False).encode()
    write_bytes(target, content)


def _plain(value: Any) -> Any:
    """Lists as JSON, texts as UTF-8 takes them."""
    if isinstance(value, tuple):
        return json.dumps(value)
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


def _parquet(found: pd.DataFrame) -> bytes:
    buffer = io.BytesIO()
    try:
        found.apply(_of_one_type).to_parquet(buffer, index=False)
    except ImportError:
        raise ValueError("--to FILE.parquet needs the package pyarrow: pip install \"adaptmg[parquet]\", or write "
                         ".csv") from None
    return buffer.getvalue()


def _of_one_type(column: pd.Series) -> pd.Series:
    """Parquet has one type a column: values of several become texts of JSON."""
    kinds = {type(value) for value in column if value is not None and value == value}
    if column.dtype != object or len(kinds) < 2 or kinds <= {int, float}:
        return column
    return column.map(lambda value: None if value is None else json.dumps(value))


_SPECIAL = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}",
            ">": r"\textgreater{}", "|": r"\textbar{}", **{c: f"\\{c}" for c in "&%$#_{}"},
            # at the beginning of a row they would belong to the end of the row before
            "[": "{[}", "*": "{*}"}


_POWER = re.compile(r"^(-?[\d.]+)e(?:\+|(-))0*(\d+)$")


def _latex(found: Mapping[str, Sequence[Any]], units: Mapping[str, str] | None) -> str:
    """A tabular of booktabs, numbers right-aligned, powers of ten as such."""
    from adaptmg.study.tables import cells, numeric

    headers, columns = cells(found, units, None)
    kinds = "".join("r" if numeric(column) else "l" for _, column in found.items())
    escaped = [["".join(_SPECIAL.get(c, c) for c in cell) for cell in column] for column in [headers, *columns]]
    escaped[1:] = [[_POWER.sub(r"$\1 \\cdot 10^{\2\3}$", cell) for cell in column] if kind == "r" else column
                   for kind, column in zip(kinds, escaped[1:], strict=True)]
    lines = [" & ".join(row) + r" \\" for row in zip(*escaped[1:], strict=True)]
    return "\n".join([f"\\begin{{tabular}}{{{kinds}}}", r"\toprule", " & ".join(escaped[0]) + r" \\", r"\midrule",
                      *lines, r"\bottomrule", r"\end{tabular}", ""])
