"""Rows of a study as a pandas table, column by column, as tables may have 100 000 rows."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from adaptmg.study.record import DETAILS, RESERVED, Record, Value

__all__ = ["frame"]

_NAN = float("nan")


def frame(names: Sequence[str], rows: Sequence[tuple[dict[str, Value], Record | None, str]],
          details: bool = False) -> pd.DataFrame:
    """A table of runs.

    Parameters
    ----------
    names : sequence of str
        Of the parameters.
    rows : sequence of (parameters, record or None, status)
    details : bool
        Also the columns of :data:`adaptmg.study.record.DETAILS`.
    """
    results = dict.fromkeys(name for _, record, _ in rows if record is not None for name in record.results)
    columns = {name: [point[name] for point, _, _ in rows] for name in names}
    found = [{} if record is None else record.results for _, record, _ in rows]
    # NaN where a row lacks a result, as a table of dicts has it
    columns |= {name: [values.get(name, _NAN) for values in found] for name in results}
    columns["status"] = [status for _, _, status in rows]
    columns["seconds"] = [_NAN if record is None else record.seconds for _, record, _ in rows]
    columns["error"] = ["" if record is None else record.error for _, record, _ in rows]
    if details:
        taken = [name for name in DETAILS if name in columns]
        columns |= {name: [None if record is None else getattr(record, name) for _, record, _ in rows]
                    for name in DETAILS if name not in taken}
    order = [*names, *results, *RESERVED, *(name for name in columns if name in DETAILS and name not in results)]
    return pd.DataFrame({name: columns[name] for name in order})
