"""Rows of a study as a table, column by column, as tables may have 100 000 rows; pandas is loaded when asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from adaptmg.study.record import DETAILS, RESERVED, Record, Value

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["columns", "frame", "from_columns"]

_NAN = float("nan")


def frame(names: Sequence[str], rows: Sequence[tuple[dict[str, Value], Record | None, str]],
          details: bool = False) -> pd.DataFrame:
    """A table of runs; arguments as of :func:`columns`."""
    return from_columns(columns(names, rows, details))


def from_columns(made: Mapping[str, Sequence[Any]]) -> pd.DataFrame:
    """A table of columns, whatever their texts are."""
    import pandas as pd

    try:
        return pd.DataFrame(made)
    except UnicodeEncodeError:
        # texts that are not UTF-8: pandas cannot hold them as its own kind where pyarrow is installed
        return pd.DataFrame({name: pd.Series(column, dtype=object if any(isinstance(v, str) for v in column) else None)
                             for name, column in made.items()})


def columns(names: Sequence[str], rows: Sequence[tuple[dict[str, Value], Record | None, str]],
            details: bool = False) -> dict[str, list[Any]]:
    """The columns of a table of runs.

    Parameters
    ----------
    names : sequence of str
        Of the parameters.
    rows : sequence of (parameters, record or None, status)
    details : bool
        Also the columns of :data:`adaptmg.study.record.DETAILS`.
    """
    results = dict.fromkeys(name for _, record, _ in rows if record is not None for name in record.results)
    made: dict[str, list[Any]] = {name: [point[name] for point, _, _ in rows] for name in names}
    found = [{} if record is None else record.results for _, record, _ in rows]
    # NaN where a row lacks a result, as a table of dicts has it
    made |= {name: [values.get(name, _NAN) for values in found] for name in results}
    made["status"] = [status for _, _, status in rows]
    made["seconds"] = [_NAN if record is None else record.seconds for _, record, _ in rows]
    made["error"] = ["" if record is None else record.error for _, record, _ in rows]
    if details:
        taken = [name for name in DETAILS if name in made]
        made |= {name: [None if record is None else getattr(record, name) for _, record, _ in rows]
                 for name in DETAILS if name not in taken}
    order = [*names, *results, *RESERVED, *(name for name in made if name in DETAILS and name not in results)]
    return {name: made[name] for name in order}
