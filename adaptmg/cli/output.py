"""Values and tables as JSON takes them.

What is shown on standard error while a command works: the log of adaptmg and, on a terminal, a bar.

Tables on a terminal that is narrower than they are: in blocks, the parameters at the left of each.
"""

from __future__ import annotations

import json
import logging
import math
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from adaptmg.study.tables import as_text, cells

__all__ = ["finite", "lines", "printed", "rows", "watched", "watched_loop"]

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


Callback = Callable[[dict[str, float]], None]


@contextmanager
def watched(rtol: float) -> Iterator[Callback | None]:
    """Show log and progress of what happens inside."""
    console = Console(stderr=True)
    with _logged(console):
        if not console.is_terminal:
            yield None
            return
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns, console=console, transient=True) as bar:
            yield _advance(bar, rtol)


def _advance(bar: Progress, rtol: float) -> Callback:
    """Fill the bar by decades of the error."""
    task = bar.add_task("grids and set-up", total=None)
    first: list[float] = []

    def callback(row: dict[str, float]) -> None:
        for error in (row.get("error_estimate", math.nan), row.get("residual", math.nan)):
            if math.isfinite(error) and error > 0:
                first.append(error)
                total = math.log10(max(first[0] / rtol, 10.0))
                bar.update(task, total=total, completed=min(max(math.log10(first[0] / error), 0.0), total),
                           description=f"cycle {row['cycle']}, error {error:.1e}")
                return

    return callback


@contextmanager
def watched_loop() -> Iterator[Callable[[dict[str, Any]], None] | None]:
    """Show log and progress of an adaptive loop inside: nodes, estimate, and when it should end."""
    console = Console(stderr=True)
    with _logged(console):
        if not console.is_terminal:
            yield None
            return
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("{task.fields[end]}"))
        with Progress(*columns, console=console, transient=True) as bar:
            yield _advance_loop(bar)


def _advance_loop(bar: Progress) -> Callable[[dict[str, Any]], None]:
    """Fill the bar by the seconds used of those expected."""
    task = bar.add_task("first mesh", total=None, end="")

    def callback(row: dict[str, Any]) -> None:
        words = f"step {row['step']}: {row['phase']}, {row['nodes']} nodes"
        if math.isfinite(row["estimate"]):
            words += f", estimate {row['estimate']:.2%}"
        expected = row["expected_seconds"]
        if math.isfinite(expected) and expected > 0:
            bar.update(task, total=expected, completed=min(row["seconds"], expected),
                       end=f"about {max(expected - row['seconds'], 0.0):.0f} s more")
        bar.update(task, description=words)

    return callback


@contextmanager
def _logged(console: Console) -> Iterator[None]:
    """Send adaptmg's log from INFO on to the console."""
    logger = logging.getLogger("adaptmg")
    handler = RichHandler(console=console, show_time=False, show_level=False, show_path=False)
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)


def printed(table: Mapping[str, Sequence[Any]], parameters: Sequence[str], *, units: Mapping[str, str],
            note: str = "", width: int | None = None) -> str:
    """A table as text, in blocks of columns where it is wider than the terminal."""
    if width is None:
        width = shutil.get_terminal_size().columns if sys.stdout.isatty() else 10**9
    headers, columns = cells(table, units, None)
    wide = {name: 2 + max(map(len, (header, *column))) for name, header, column
            in zip(table.keys(), headers, columns, strict=True)}
    head = [name for name in parameters if name in wide]
    if 2 * sum(wide[name] for name in head) > width:
        head = head[:1]
    blocks: list[list[str]] = [[]]
    for name in (name for name in wide if name not in head):
        if blocks[-1] and sum(wide[key] for key in (*head, *blocks[-1], name)) - 2 > width:
            blocks.append([])
        blocks[-1].append(name)
    texts = []
    for block in blocks:
        names = [name for name in wide if name in head or name in block]
        mine = {name: unit for name, unit in units.items() if name in names}
        texts.append(as_text({name: table[name] for name in names}, units=mine,
                             note=note if block is blocks[-1] else ""))
    return "\n\n".join(texts)
