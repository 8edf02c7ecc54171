"""Loaded by the processes of a local cluster: the system ends them with their parent, even in the midst of C code.

dask's own way, a thread that waits for the parent's end, needs Python's lock, which compiled code may hold for minutes.

The executor on dask.distributed: runs go out one a worker, and are tried again when a worker dies.

A run is sent when a worker is free for it, so that the run which a dead worker was busy with is known; short runs,
where the way to the worker would count, are sent several a worker as long as none has died. Results come back through
dask to the process that asked: workers need no disk in common with it.

Whether workers can compute a study, told at once; and functions that run on workers which may lack adaptmg.

A cluster on this machine: processes that are spawned, of one thread each, and end with this one whatever happens.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import ctypes
import functools
import itertools
import logging
import math
import multiprocessing
import multiprocessing.spawn
import os
import pickle
import queue
import re
import signal
import sys
import tempfile
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import dask.config
from distributed import Client, Future, KilledWorker, LocalCluster
from distributed.comm import CommClosedError
from distributed.core import Status
from distributed.deploy import Cluster

from adaptmg import _checks as checks
from adaptmg.study import in_worker
from adaptmg.study.execute import Execute, Finished, Point, Task, error_text
from adaptmg.study.in_worker import Order, identity, sent

__all__ = ["check_workers", "dask_setup", "local_cluster", "on_any_worker", "on_cluster", "opened", "revive",
           "start_again"]

_PR_SET_PDEATHSIG = 1


def dask_setup(worker: object) -> None:
    """Called by dask in the new process (Linux; elsewhere dask's way is the only one)."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


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
    """An executor on a cluster of its own, or on that of the user."""
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
    """An executor that computes on the workers of a client."""

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


#: how long a cluster may take to have a worker
PATIENCE_S = 60.0
#: how often it is looked for before processes of this machine are given up
_TRIES = 3


def check_workers(client: Client, order: Order, parts: dict[str, str]) -> None:
    """Tell of workers that could not compute the runs, or would compute others; ``parts`` are those of the fingerprint.
    """
    address = client.scheduler.address
    _wait_for_one(client, address)
    for name, worker in client.scheduler_info(n_workers=-1)["workers"].items():
        if worker["nthreads"] != 1:
            raise ValueError(f"the worker {name} has {worker['nthreads']} threads: start workers with one each ('dask "
                             f"worker {address} --nthreads 1 --nworkers N'), as libraries below are not safe for more")
        if not worker["nanny"] and (order.limit_s is not None or order.memory_limit is not None):
            raise ValueError(f"the worker {name} has no nanny, which would start it again after limit_s or "
                             "memory_limit ended it: start workers without --no-nanny")
    for name, found in client.run(_fitness(pickle.dumps((order, parts))), on_error="return").items():
        told = found if isinstance(found, str) else error_text(found)
        if isinstance(found, CommClosedError):
            _log.warning("the worker %s left while it was looked at", name)
        elif told:
            raise RuntimeError(f"the worker {name} cannot compute this study: {told}")


def _wait_for_one(client: Client, address: str) -> None:
    """Until there is a worker: as long as it takes where jobs were submitted, which may wait in a queue for hours."""
    for tries in itertools.count(1):
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError:
            if isinstance(client.cluster, LocalCluster):
                start_again(client.cluster, tries)
            elif not getattr(client.cluster, "worker_spec", None):
                raise OSError(f"the scheduler {address} has no workers after {PATIENCE_S:g} s: start some with 'dask "
                              f"worker {address} --nthreads 1', or, where they come later, wait for the first "
                              "(client.wait_for_workers(1)); a cluster that adapts needs a minimum of them") from None
            else:
                _log.warning("the scheduler %s has no workers yet: %d were asked for", address,
                             len(client.cluster.worker_spec))
        else:
            return


def start_again(cluster: LocalCluster, tries: int) -> None:
    """Start processes of this machine anew, of which none is left; OSError after some tries."""
    if tries == _TRIES:
        raise OSError("the processes that compute runs ended, and the system does not start them again (is it out of "
                      "memory, or very busy?); what is done is stored: run the study again, with fewer workers")
    _log.warning("no process that computes runs is left: starting %d", len(cluster.worker_spec))
    revive(cluster)


def _fitness(order: bytes) -> Callable[[], str]:
    """A check as a function inside a function, which is sent by value: the worker may not have this module."""
    def check(order: bytes) -> str:
        import pickle

        try:
            from adaptmg.study.in_worker import UnfitWorker, readied

            unpacked, parts = pickle.loads(order)
        except Exception as error:
            return f"it lacks adaptmg, or has another version ({type(error).__name__}: {error})"
        try:
            readied(unpacked, parts)
        except UnfitWorker as error:
            return str(error)
        return ""

    return functools.partial(check, order)


def on_any_worker() -> Callable[..., Any]:
    """What computes one run on a worker, by value too: a worker that joins later may not have this module."""
    def perform(order: bytes, point: dict[str, Any], tries: int, name: str, topic: str) -> Any:
        import pickle

        from distributed import get_worker

        try:
            from adaptmg.study import in_worker

            unpacked = pickle.loads(order)
        except Exception as error:
            class UnfitWorker(RuntimeError):
                pass

            raise UnfitWorker(f"it lacks adaptmg, or has another version ({type(error).__name__}: {error})") from None
        worker = get_worker()
        return in_worker.perform(unpacked, point, tries,
                                 lambda why: worker.log_event(topic, {"run": name, "why": why}))

    return perform


#: how often the processes are started until the system is called unfit
_STARTS = 3

#: set before a worker imports anything: one thread everywhere
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS",
                             "VECLIB_MAXIMUM_THREADS", "NGS_NUM_THREADS"), "1")
_CONFIG = {
    # a dead worker is told at once, and the study counts the tries
    "distributed.scheduler.allowed-failures": 0,
    # a worker that waits because memory is short would wait for ever: runs hand nothing on
    "distributed.worker.memory.target": False, "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False, "distributed.worker.memory.terminate": False,
    # a process may be slow to start again where the machine is busy: after 15 s dask would give it up for good
    "distributed.deploy.lost-worker-timeout": "1h",
    "distributed.worker.multiprocessing-method": "spawn",
    # nobody looks at the dashboard: no samples of what is running a hundred times a second
    "distributed.worker.profile.enabled": False, "distributed.admin.system-monitor.interval": "5s",
}
#: how dask calls its processes
_NAME = "Dask Worker process"


@contextmanager
def local_cluster(workers: int) -> Iterator[Client]:
    """Start a cluster of processes on this machine, and end it.

    Parameters
    ----------
    workers : int
        How many.

    Yields
    ------
    distributed.Client
        For :meth:`adaptmg.study.Study.run` as ``scheduler``; many studies can share it.
    """
    count = checks.integer("workers", workers, minimum=1)
    if multiprocessing.current_process().daemon:
        raise RuntimeError("a process that computes runs cannot start workers: leave workers= out of a study inside a "
                           "run")
    # tells at length, and late, of connections to processes that were ended
    logging.getLogger("distributed.batched").setLevel(logging.CRITICAL)
    with _scripts_not_run_again(), _environment_kept(), \
            tempfile.TemporaryDirectory(prefix="adaptmg-workers-", ignore_cleanup_errors=True) as folder, \
            dask.config.set(_CONFIG | {"temporary-directory": folder}):
        cluster = client = None
        try:
            with _interrupt_held_back() as interrupted:
                cluster = _started(count, interrupted)
                client = Client(cluster, set_as_default=False)
            yield client
        finally:
            if cluster is not None:
                _end(cluster, client)


def _started(count: int, interrupted: list[Any]) -> LocalCluster:
    """All processes: dask gives up where one ends while it starts, killed as memory is short, or by Ctrl-C."""
    tries = 1
    while True:
        try:
            return LocalCluster(n_workers=count, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0",
                                memory_limit=0, silence_logs=logging.CRITICAL, host="127.0.0.1",
                                worker_dashboard_address=None, env=_ONE_THREAD,
                                preload=["adaptmg.study.cluster"])
        except (RuntimeError, OSError) as error:
            if tries == _STARTS or interrupted:
                raise OSError(f"workers: {count} processes could not be started ({error.__cause__ or error}): give "
                              "fewer workers, or make memory free") from error
            _log.warning("a process that computes runs ended while it started: starting %d again", count)
            tries += 1


def revive(cluster: LocalCluster) -> None:
    """Start processes anew that dask gave up, or could not start; those that are starting are left alone."""
    async def forget() -> None:
        for name, nanny in list(cluster.workers.items()):
            if nanny.status in (Status.closed, Status.failed):
                del cluster.workers[name]

    cluster.sync(forget)
    # as many as before: starts what is not there
    cluster.scale(len(cluster.worker_spec))


def _end(cluster: LocalCluster, client: Client | None) -> None:
    """At once, whatever runs still go on; a second Ctrl-C does not get in between."""
    with _interrupt_held_back():
        for nanny in list(cluster.workers.values()):
            process = getattr(nanny, "process", None)
            # no longer started anew when it ends
            nanny.close_gracefully()
            if process is not None and process.pid is not None:
                with contextlib.suppress(OSError):
                    os.kill(process.pid, signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
        if client is not None:
            with contextlib.suppress(Exception):
                client.close(timeout=1)
        with contextlib.suppress(Exception):
            cluster.close(timeout=3)


@contextmanager
def _interrupt_held_back() -> Iterator[list[Any]]:
    """Let Ctrl-C wait for the end of the block, where this is the main thread; what came so far."""
    came: list[Any] = []
    try:
        before = signal.signal(signal.SIGINT, lambda *signalled: came.append(signalled))
    except ValueError:
        yield came
        return
    try:
        yield came
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def _environment_kept() -> Iterator[None]:
    """dask sets variables for its processes in this one too; numba objects to a number of threads that changes."""
    before = dict(os.environ)
    with dask.config.set({"distributed.nanny.pre-spawn-environ": _ONE_THREAD}):
        try:
            yield
        finally:
            for name in _ONE_THREAD:
                if name in before:
                    os.environ[name] = before[name]
                else:
                    os.environ.pop(name, None)


@contextmanager
def _scripts_not_run_again() -> Iterator[None]:
    """Spawned processes run the user's script again, as far as its ``if __name__ == "__main__"``, if it has one.

    Run functions come by value: dask's processes need not. Those of others are left as they are.
    """
    prepare = multiprocessing.spawn.get_preparation_data

    def prepared(name: str) -> dict[str, Any]:
        data = prepare(name)
        if name.startswith(_NAME):
            data.pop("init_main_from_name", None)
            data.pop("init_main_from_path", None)
        return data

    multiprocessing.spawn.get_preparation_data = prepared
    try:
        yield
    finally:
        multiprocessing.spawn.get_preparation_data = prepare
