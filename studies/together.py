"""Sections of several studies at the same time, their runs on the workers of one cluster; timed runs alone at the end.

Each section is made in its own thread, and has its turn: one thread at a time computes, tabulates and draws
(pyplot is not safe for more); while it waits for runs the others go on. A timed study waits until no other section
computes, and runs in this process while the workers are idle.
"""

from __future__ import annotations

import importlib
import queue
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import matplotlib.pyplot as plt
import pandas as pd
from common import Context, Figure, Section

import adaptmg as am
from adaptmg.export.report import Picture, picture_of


class Turns:
    """Whose turn it is, and whether all others wait to measure."""

    def __init__(self, threads: int, client: Any, progress: Callable[[Any], None] | bool = False) -> None:
        self._client, self._turn, self._progress = client, threading.Lock(), progress
        self._busy, self._quiet = threads, threading.Condition()

    def run(self, study: am.Study, timed: bool) -> pd.DataFrame:
        """The rows of a study, for a thread that has its turn; it has it again when this returns."""
        self._turn.release()
        try:
            if not timed:
                return study.run(self._progress, scheduler=self._client, throw=True)
            self._wait_for_quiet()
            return study.run(self._progress, throw=True)
        finally:
            self._turn.acquire()

    def draw(self, figures: dict[str, tuple[Any, str]]) -> dict[str, Picture]:
        """Pictures, made by the workers."""
        sent = [self._client.submit(picture_of, *given, pure=False) for given in figures.values()]
        for figure, _ in figures.values():
            plt.close(figure)
        self._turn.release()
        try:
            return dict(zip(figures, self._client.gather(sent), strict=True))
        finally:
            self._turn.acquire()

    @contextmanager
    def alone(self) -> Iterator[None]:
        """When no other section computes, for a thread that has its turn."""
        self._turn.release()
        try:
            self._wait_for_quiet()
        finally:
            self._turn.acquire()
        yield

    @contextmanager
    def turn(self) -> Iterator[None]:
        """All that a thread does."""
        try:
            with self._turn:
                yield
        finally:
            self._left()

    def _wait_for_quiet(self) -> None:
        """Until all others are done or wait as well; one after the other."""
        self._left()
        with self._quiet:
            self._quiet.wait_for(lambda: self._busy == 0)
            self._busy += 1

    def _left(self) -> None:
        with self._quiet:
            self._busy -= 1
            self._quiet.notify()


#: given the name of a study, its section, its pictures by name, and seconds since it began
Done = Callable[[str, Section, dict[str, Picture], float], None]


def in_turn(context: Context, names: Sequence[str], done: Done) -> list[str]:
    """Section after section in this process; returns the names of the studies that failed."""
    failed = []
    for name in names:
        begin = time.perf_counter()
        try:
            section = importlib.import_module(name).run(context)
            pictures = {key: picture_of(*given) for key, given in to_draw(section).items()}
        except Exception as error:
            section, pictures = failure(name, error), {}
            failed.append(name)
        done(name, section, pictures, time.perf_counter() - begin)
    return failed


def failure(name: str, error: Exception) -> Section:
    """What stands in place of a section: others take minutes, and should not be lost with it."""
    traceback.print_exception(error)
    said = f"This study failed: {type(error).__name__}: {error}"
    return Section(f"{name}: failed", f"python studies/{name}.py runs it alone.", summary=said)


def to_draw(section: Section) -> dict[str, tuple[Any, str]]:
    """The figures of a section by their names, with their captions."""
    return {item.name: (item.figure, item.caption) for item in section.items if isinstance(item, Figure)}


def at_once(context: Context, names: Sequence[str], done: Done, workers: int,
            progress: Callable[[Any], None] | bool = False) -> list[str]:
    """All sections on one cluster of this machine, as :func:`in_turn`; ``progress`` as for :class:`Turns`."""
    from adaptmg.study import local_cluster

    modules = {name: importlib.import_module(name) for name in names}
    ended: queue.SimpleQueue[BaseException | None] = queue.SimpleQueue()
    failed: list[str] = []
    with local_cluster(workers) as client:
        turns = Turns(len(names), client, progress)
        own = replace(context, compute=turns.run, alone=turns.alone)

        def make(name: str) -> None:
            begin = time.perf_counter()
            try:
                with turns.turn():
                    try:
                        section = modules[name].run(own)
                        pictures = turns.draw(to_draw(section))
                    except Exception as error:
                        section, pictures = failure(name, error), {}
                        failed.append(name)
                    done(name, section, pictures, time.perf_counter() - begin)
            except BaseException as error:
                ended.put(error)
            else:
                ended.put(None)

        for name in names:
            threading.Thread(target=make, args=(name,), name=name, daemon=True).start()
        for _ in names:
            error = ended.get()
            if error is not None:
                raise error
    return failed
