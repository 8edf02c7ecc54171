"""Values and tables as JSON takes them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

__all__ = ["finite", "lines", "rows"]


def finite(value: Any) -> Any:
    """Plain values as JSON takes them: numbers that are not finite become None, tuples lists."""
    if isinstance(value, dict):
        return {key: finite(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [finite(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def rows(table: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """The rows of a table, of pandas or by columns, as JSON takes them."""
    given = {name: _finite_column(list(column)) for name, column in table.items()}
    return [dict(zip(given, row, strict=True)) for row in zip(*given.values(), strict=True)]


def _finite_column(column: list[Any]) -> list[Any]:
    return column if {bool, int, str, type(None)}.issuperset(map(type, column)) else list(map(finite, column))


def lines(rows: Sequence[dict[str, Any]]) -> str:
    """Rows as JSON, one a line, as there may be 100 000."""
    return "[" + ",".join(f"\n  {json.dumps(row, allow_nan=False)}" for row in rows) + "\n]"
