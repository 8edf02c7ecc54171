"""Progress of studies that run at the same time: a line that follows them on a terminal, else a line now and then."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console

if TYPE_CHECKING:
    from adaptmg.study.study import Watch


class Watching:
    """Counts of studies that run at the same time, told from any of their threads."""

    def __init__(self, studies: int, every: float = 15.0, console: Console | None = None) -> None:
        self._studies, self._ended, self._runs = studies, 0, 0
        self._now: dict[str, Watch] = {}
        self._lock, self._begin, self._every = threading.RLock(), time.monotonic(), every
        self._told = self._begin
        self._console = Console(stderr=True) if console is None else console
        self._line = self._console.status("") if self._console.is_terminal else None

    def run_ended(self, watch: Watch) -> None:
        """Count a run, as ``progress=`` of :meth:`adaptmg.study.Study.run`."""
        with self._lock:
            self._runs += 1
            self._now.pop(watch.name, None)
            if watch.done < watch.total:
                self._now[watch.name] = watch  # the last that told of itself stands last
            self._tell()

    def study_ended(self, name: str, seconds: float) -> None:
        """Tell that a section is made."""
        with self._lock:
            self._ended += 1
            self._now = {key: watch for key, watch in self._now.items() if not key.startswith(f"{name}.")}
            self._print(f"[{self._ended}/{self._studies}] {name}: done after {seconds:.0f} s")
            self._tell()

    @contextmanager
    def printing(self) -> Iterator[None]:
        """While something else is printed, the line on the terminal is away."""
        with self._lock:
            if self._line is not None:
                self._line.stop()
            try:
                yield
            finally:
                if self._line is not None and self._ended < self._studies:
                    self._line.start()

    def __enter__(self) -> Watching:
        if self._line is not None:
            self._line.start()
            self._tell()
        return self

    def __exit__(self, *failure: object) -> None:
        if self._line is not None:
            self._line.stop()

    def words(self) -> str:
        """How many studies and runs are done, and what goes on, the newest first."""
        seconds = int(time.monotonic() - self._begin)
        going = [f"{watch.name} {watch.done}/{watch.total}" for watch in reversed(self._now.values())]
        return "; ".join([f"{seconds // 60}:{seconds % 60:02} min, {self._ended} of {self._studies} studies done, "
                          f"runs: {self._runs}", *going])

    def _tell(self) -> None:
        if self._line is not None:
            width = self._console.width - 4
            words = self.words()
            self._line.update(words if len(words) <= width else f"{words[:width - 4]} ...")
        elif time.monotonic() - self._told >= self._every and self._ended < self._studies:
            self._told = time.monotonic()
            self._print(self.words())

    def _print(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)
