"""The executor on dask.distributed: runs go out one a worker, and are tried again when a worker dies.

A run is sent when a worker is free for it, so that the run which a dead worker was busy with is known; short runs,
where the way to the worker would count, are sent several a worker as long as none has died. Results come back through
dask to the process that asked: workers need no disk in common with it.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import itertools
import logging
import math
import pickle
import queue
import re
import time
import uuid
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from distributed import Client, Future, KilledWorker
from distributed.deploy import Cluster, LocalCluster

from adaptmg.problem import checks
from adaptmg.study.cluster import in_worker
from adaptmg.study.cluster.fitness import check_workers, on_any_worker, start_again
from adaptmg.study.cluster.identity import identity
from adaptmg.study.cluster.local import local_cluster
from adaptmg.study.cluster.sending import sent
from adaptmg.study.execute import Execute, Finished, Point, Task, error_text

__all__ = ["on_cluster", "opened"]

_log = logging.getLogger(__name__)

#: starts of a run until it is given up, as workers died
MOST_TRIES = 3
#: runs are sent ahead as far as they take so long together
_SHORT_S = 0.2
#: seconds after which one says that there are no workers; between two looks
_PATIENCE_S, _LOOK_S = 60.0, 0.5
#: seconds that a scheduler may take to answer
CONNECT_S = 10.0


@contextmanager
def opened(workers: int | None, scheduler: Any, runs: int) -> Iterator[Execute]:
    """An executor on a cluster of its own, or on that of the user.

    Parameters
    ----------
    workers : int or None
        Local processes to start; no more than there are runs.
    scheduler : str, distributed.Client, a cluster of dask, or None
        The user's.
    runs : int
        How many runs there are.
    """
    if scheduler is None:
        with local_cluster(min(checks.integer("workers", workers, minimum=1), max(runs, 1))) as client:
            yield on_cluster(client)
    elif isinstance(scheduler, Client):
        yield on_cluster(scheduler)
    elif isinstance(scheduler, str | Cluster):
        # a client that was given none hangs for a while when it is collected
        if isinstance(scheduler, str) and not re.fullmatch(r"\S+:\d+", scheduler):
            raise ValueError(f"scheduler must be an address such as 'tcp://host:8786', got {checks.shown(scheduler)}")
        try:
            client = Client(scheduler, set_as_default=False, timeout=CONNECT_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise OSError(f"scheduler: nobody answers at {scheduler}: start one with 'dask scheduler' ({error})") \
                from error
        with client:
            yield on_cluster(client)
    else:
        raise TypeError(f"scheduler must be an address such as 'tcp://host:8786', a distributed.Client or a cluster of "
                        f"dask, got {checks.described(scheduler)}")


class OnCluster:
    """An executor that computes on the workers of a client.

    Attributes
    ----------
    running : int
        Runs that are out.
    """

    def __init__(self, client: Client) -> None:
        self._client, self._runs = client, None

    @property
    def running(self) -> int:
        return 0 if self._runs is None else self._runs.running

    def __call__(self, task: Task, points: Sequence[Point]) -> Iterator[list[tuple[Point, Finished]]]:
        """Compute ``task`` at ``points``."""
        seen = task.fingerprint.seen()
        order = in_worker.Order(sent(task.function), identity(), seen.code, task.depends, seen.uses_adaptmg,
                                task.limit_s, task.memory_limit)
        check_workers(self._client, order, seen.parts)
        self._runs = _Runs(self._client, order, points)
        yield from self._runs.finished()


def on_cluster(client: Client) -> OnCluster:
    """An executor that computes on the workers of ``client``."""
    return OnCluster(client)


@dataclass(eq=False)
class _Run:
    """A run that is out; when its clock began, where there is a limit."""

    point: Point
    tries: int
    sent: float
    future: Future
    alone: bool
    began: float = math.inf


def _allowed_failures(dask_scheduler: Any) -> int:
    return int(dask_scheduler.allowed_failures)


class _Runs:
    """All runs of one call."""

    def __init__(self, client: Client, order: in_worker.Order, points: Sequence[Point]) -> None:
        self._client = client
        self._name = f"adaptmg-{uuid.uuid4().hex[:12]}"
        self._perform, self._order = on_any_worker(), pickle.dumps(order)
        self._limit_s = math.inf if order.limit_s is None else order.limit_s
        self._numbers = itertools.count()
        self._left: deque[tuple[Point, int]] = deque((point, 1) for point in points)
        #: last tries, one at a time when all else is done: whose worker dies then was not there by chance
        self._alone: deque[tuple[Point, int]] = deque()
        self._out: dict[str, _Run] = {}
        self._over: dict[str, str] = {}
        self._back: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._ahead, self._died, self._slots, self._looked = 1, False, 1, -math.inf
        self._recent: deque[float] = deque(maxlen=8)
        #: how often dask itself starts a run again; unless set otherwise three times
        self._allowed = 3

    @property
    def running(self) -> int:
        """How many are out, without those that wait at their worker."""
        return min(len(self._out), self._slots)

    def finished(self) -> Iterator[list[tuple[Point, Finished]]]:
        """Runs as they finish, those of one moment together."""
        self._client.subscribe_topic(self._name, self._told)
        with contextlib.suppress(Exception):  # some clusters let nobody look
            self._allowed = self._client.run_on_scheduler(_allowed_failures)
        try:
            self._send()
            while self._out:
                done = [row for name, result in self._come_back() if (row := self._outcome(name, result)) is not None]
                # before the rows are stored, so that workers need not wait for the disk
                self._send()
                if done:
                    yield done
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be gone, and its client closed
                self._client.unsubscribe_topic(self._name)
                self._drop()

    def _drop(self) -> None:
        """Give up what is out; on a cluster that goes on, workers that compute it are started anew."""
        if not self._out:
            return
        if self._allowed:
            # what was sent a moment ago is not told of yet
            time.sleep(0.2)
        busy = [address for address, keys in self._client.processing().items() if set(keys) & set(self._out)] \
            if self._allowed else []
        self._client.cancel([run.future for run in self._out.values()], force=True)
        if busy:
            self._client.restart_workers(busy, timeout=3, raise_for_error=False)

    def _send(self) -> None:
        """As many runs as there are workers free for."""
        now = time.monotonic()
        if now - self._looked > 1.0:
            self._slots, self._looked = max(len(self._client.nthreads()), 1), now
        while (self._left and len(self._out) < self._ahead * self._slots) or (self._alone and not self._out):
            point, tries = (self._left or self._alone).popleft()
            name = f"{self._name}-{next(self._numbers)}"
            future = self._client.submit(self._perform, self._order, point, tries, name, self._name, key=name,
                                         pure=False)
            self._out[name] = _Run(point, tries, time.monotonic(), future, tries >= MOST_TRIES)
            self._client.loop.add_callback(self._wait_for, name, future)

    async def _wait_for(self, name: str, future: Future) -> None:
        """In the thread of dask: fetch what comes of a run. (as_completed sleeps .1 s where it misses a wake-up.)"""
        try:
            result = await future._result(raiseit=False)
        except BaseException as error:
            result = error
        if name in self._over and self._allowed:
            # its worker lives a moment longer, and should get no other run
            await asyncio.sleep(2 * in_worker.LEAVE_S)
        self._back.put((name, result))

    def _come_back(self) -> list[tuple[str, Any]]:
        """What is back, at least one."""
        waited, without = 0.0, 0
        while True:
            try:
                found = [self._back.get(timeout=_LOOK_S)]
                break
            except queue.Empty:
                waited += _LOOK_S
                if waited % _PATIENCE_S < _LOOK_S:
                    without = 0 if self._client.nthreads() else without + 1
                    self._tell_of_no_workers(without)
        while not self._back.empty():
            found.append(self._back.get())
        return found

    def _tell_of_no_workers(self, times: int) -> None:
        """A cluster of the user's may get some; the processes of this machine should have been there again long ago."""
        if not times:
            return
        _log.warning("the scheduler %s has no workers: %d runs wait", self._client.scheduler.address,
                     len(self._out) + len(self._left) + len(self._alone))
        if isinstance(self._client.cluster, LocalCluster):
            start_again(self._client.cluster, times)

    def _far_ahead(self) -> int:
        """How many runs a worker is given at once: more where they are so short that the way would count."""
        if self._died or self._allowed:
            return 1
        known = len(self._recent) == self._recent.maxlen
        return min(max(int(_SHORT_S / max(*self._recent, 0.02)), 1), 10 if known else 2)

    async def _told(self, event: tuple[float, Any]) -> None:
        """A worker says that a run begins, or ends as it is over its limit; dask must not start that elsewhere."""
        message = event[1]
        run = self._out.get(message["run"]) if isinstance(message, dict) else None
        if run is not None and not message["why"]:
            run.began = time.monotonic()
        elif run is not None:
            self._over[message["run"]] = message["why"]
            if self._allowed:
                await self._client._cancel([run.future], force=True)

    def _outcome(self, name: str, result: Any) -> tuple[Point, Finished] | None:
        """What came of a run; None if it is tried again."""
        run = self._out.pop(name)
        why = self._over.pop(name, "")
        if isinstance(result, Finished):
            self._recent.append(result.seconds)
            self._ahead = self._far_ahead()
            return run.point, result
        seconds = time.monotonic() - run.sent
        error = result[1] if isinstance(result, tuple) else result
        ended_hard = self._limit_s + 0.5 * in_worker.HARD_S
        if not why and isinstance(error, KilledWorker) and time.monotonic() - run.began >= ended_hard:
            # in code that holds Python's lock, so that the worker could not say it; one that died earlier may be told
            # of late
            why = f"TimeLimit: stopped after limit_s={self._limit_s:g} s"
        if why:
            return run.point, Finished(error=why, seconds=seconds, tries=run.tries)
        if isinstance(error, KilledWorker):
            self._died, self._ahead = True, 1
            # dask on its own starts a run again as often as the scheduler allows
            tries = run.tries + error.allowed_failures
            if not run.alone:
                (self._alone if tries + 1 >= MOST_TRIES else self._left).append((run.point, tries + 1))
                _log.warning("a worker died during %s: tried again", run.point)
                return None
            return run.point, Finished(error=f"WorkerDied: worker died {tries} times during this run", seconds=seconds,
                                       tries=tries)
        if isinstance(error, asyncio.CancelledError | concurrent.futures.CancelledError):
            raise OSError(f"scheduler: the connection to {self._client.scheduler.address} was lost; what is done is "
                          "stored") from error
        if type(error).__name__ == "UnfitWorker":
            raise RuntimeError(f"a worker that joined cannot compute this study: {error}") from error
        return run.point, Finished(error=error_text(error), seconds=seconds, exception=error, tries=run.tries)
