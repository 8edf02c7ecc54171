"""What is shown on standard error while a command works: the log of adaptmg and, on a terminal, a bar."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

__all__ = ["watched", "watched_loop"]

Callback = Callable[[dict[str, float]], None]


@contextmanager
def watched(rtol: float) -> Iterator[Callback | None]:
    """Show log and progress of what happens inside.

    Parameters
    ----------
    rtol : float
        Tolerance of the solver: the bar is full when the error has come down to it.

    Yields
    ------
    callable or None
        Callback for :func:`adaptmg.solve`; None where standard error is no terminal.
    """
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
    """Show log and progress of an adaptive loop inside: nodes, estimate, and when it should end.

    Yields
    ------
    callable or None
        ``progress`` for :func:`adaptmg.adapt`; None where standard error is no terminal.
    """
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
