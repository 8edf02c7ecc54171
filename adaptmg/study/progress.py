"""What one sees while a study runs: a bar on a terminal, a line of the log for each run elsewhere."""

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
    """Counts of a study that runs."""

    def __init__(self, name: str, total: int, before: int, running: Callable[[], int],
                 show: Callable[[Watch], None] | None = None) -> None:
        self.name, self.total, self.done, self.failed = name, total, before, 0
        self._before, self._running, self._show = before, running, show
        self._begin = time.monotonic()

    def finished(self, point: Point, outcome: Finished) -> None:
        """Count a run and tell of it; ``point`` without what is the same in all runs."""
        self.done += 1
        self.failed += bool(outcome.error)
        if self._show is not None:
            self._show(self)
        if outcome.error:
            _log.warning("study %s: [%d/%d] %s failed: %s", self.name, self.done, self.total, _named(point),
                         outcome.error)
        elif self._show is None and _log.isEnabledFor(logging.INFO):
            _log.info("study %s: [%d/%d] %s done in %.3g s; %s", self.name, self.done, self.total, _named(point),
                      outcome.seconds, self.words())

    def words(self) -> str:
        """What is left."""
        left = self.total - self.done
        failed = f"{self.failed} failed" if self.failed else "none failed"
        if not left:
            return f"{failed}, the end"
        return f"{failed}, {min(self._running(), left)} running, {left} left, {self._end(left)}"

    def line(self, width: int, full: str = "━", empty: str = "─") -> str:
        """All of that in one line of at most ``width`` characters, with a bar; what is told first goes last."""
        share = self.done / max(self.total, 1)
        seconds = int(time.monotonic() - self._begin)
        counts, clock = f"{self.done}/{self.total}", f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02}"
        words, left = self.words(), self.total - self.done
        short = (f"{self.failed} failed, " if self.failed else "") + (self._end(left) if left else "the end")

        def bar(length: int) -> str:
            return full * int(share * length) + empty * (length - int(share * length))

        for parts in ((self.name, bar(24), counts, clock, words), (bar(16), counts, clock, words),
                      (bar(8), counts, words), (bar(8), counts, short), (counts, short), (counts,)):
            found = "  ".join(parts)
            if len(found) <= width:
                return found
        return counts[:width]

    def _end(self, left: int) -> str:
        """By the pace so far."""
        here = self.done - self._before
        if not here:
            return "end unknown"
        seconds = (time.monotonic() - self._begin) / here * left
        end = datetime.now().astimezone() + timedelta(seconds=seconds)
        return f"ends about {end:%H:%M:%S}" if seconds < 12 * 3600 else f"ends about {end:%Y-%m-%d %H:%M}"


def _named(point: Point) -> str:
    return ", ".join(f"{name}={value!r}" for name, value in point.items())


@contextmanager
def watched(name: str, total: int, before: int, running: Callable[[], int],
            bar: bool | Callable[[Watch], None] | None) -> Iterator[Watch]:
    """A watch; with a bar on standard error if ``bar``, or if it is None and standard error a terminal.

    ``bar`` may be a function, which is then told of each run instead.
    """
    if callable(bar):
        yield Watch(name, total, before, running, bar)
        return
    # without a console (pythonw, a service) Python has no standard error
    if sys.stderr is None or not (sys.stderr.isatty() if bar is None else bar):
        yield Watch(name, total, before, running)
        return
    from rich.console import Console
    from rich.progress import Progress, ProgressColumn, Task
    from rich.text import Text

    console = Console(stderr=True)
    signs = ("━", "─") if console.encoding.startswith("utf") else ("#", "-")
    watch: Watch

    class WatchLine(ProgressColumn):
        """The whole line, for the terminal as wide as it now is."""

        def render(self, task: Task) -> Text:
            return Text(watch.line(console.width - 1, *signs), no_wrap=True)

    with Progress(WatchLine(), console=console) as shown:
        task = shown.add_task(name, total=total, completed=before, visible=False)
        watch = Watch(name, total, before, running, lambda watch: shown.update(task, completed=watch.done))
        shown.update(task, visible=True)
        yield watch
