"""Tables as files: CSV, Parquet, LaTeX."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adaptmg.problem import checks
from adaptmg.runtime.atomic import write_bytes

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["ending", "write"]

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
