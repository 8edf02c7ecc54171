"""Progress of a study: a bar on a terminal, a line of the log for each run elsewhere."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta

from adaptmg.study.execute import Finished, Point

__all__ = ["Watch", "watched"]

_log = logging.getLogger("adaptmg.study")


class Watch:
    """Counts of a running study; ``show`` is called after each run."""

    def __init__(self, name: str, total: int, before: int, running: Callable[[], int],
                 show: Callable[[Watch], None] | None = None) -> None:
        self.name, self.total, self.done, self.failed = name, total, before, 0
        self._before, self._running, self._show = before, running, show
        self._begin = time.monotonic()

    def finished(self, point: Point, outcome: Finished) -> None:
        """Count a run and report it; ``point`` has the parameters that vary."""
        self.done += 1
        self.failed += bool(outcome.error)
        if self._show is not None:
            self._show(self)
        given = ", ".join(f"{name}={value!r}" for name, value in point.items())
        head = f"study {self.name}: [{self.done}/{self.total}] {given}"
        if outcome.error:
            _log.warning("%s failed: %s", head, outcome.error)
        elif self._show is None and _log.isEnabledFor(logging.INFO):
            _log.info("%s done in %.3g s; %s", head, outcome.seconds, self.words())

    def words(self) -> str:
        """Return failures, runs that are left, and when the study should end at the pace so far."""
        left, here = self.total - self.done, self.done - self._before
        failed = f"{self.failed or 'none'} failed"
        if not left:
            return f"{failed}, the end"
        seconds = (time.monotonic() - self._begin) / max(here, 1) * left
        end = datetime.now().astimezone() + timedelta(seconds=seconds)
        when = f"ends about {end:{'%H:%M:%S' if seconds < 12 * 3600 else '%Y-%m-%d %H:%M'}}" if here else "end unknown"
        return f"{failed}, {min(self._running(), left)} running, {left} left, {when}"


@contextmanager
def watched(name: str, total: int, before: int, running: Callable[[], int],
            bar: bool | Callable[[Watch], None] | None) -> Iterator[Watch]:
    """Yield a watch; with a bar on standard error if ``bar``, or if it is None and standard error is a terminal.

    A function as ``bar`` is called after each run instead.
    """
    # without a console (pythonw, a service) Python has no standard error
    if callable(bar) or sys.stderr is None or not (sys.stderr.isatty() if bar is None else bar):
        yield Watch(name, total, before, running, bar if callable(bar) else None)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    with Progress(TextColumn("{task.description}", markup=False), BarColumn(24), MofNCompleteColumn(),
                  TimeElapsedColumn(), TextColumn("{task.fields[words]}"), console=Console(stderr=True)) as shown:
        task = shown.add_task(name, total=total, completed=before, words="")
        watch = Watch(name, total, before, running,
                      lambda watch: shown.update(task, completed=watch.done, words=watch.words()))
        shown.update(task, words=watch.words())
        yield watch
