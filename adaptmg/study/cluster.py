"""Runs on workers of dask.distributed: on processes of this machine, or on a cluster of the user.

A run is sent when a worker is free, so that the run of a worker that dies is identified. A run whose worker died is
tried again. Results come back through dask: workers need no disk in common with this process.

Only this process decides that a run is over a limit: its clock starts when the worker reports that the run begins, and
a plugin in dask's nannies reports the memory of their workers. The run is cancelled, the nanny kills the process, even
one in compiled code, and starts another. A worker that dies on its own is never taken for one over its limit.
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
import time
import uuid
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import dask.config
import psutil
from distributed import Client, Future, KilledWorker, LocalCluster, Nanny, Scheduler, get_worker
from distributed.comm import CommClosedError
from distributed.deploy import Cluster
from distributed.diagnostics.plugin import NannyPlugin
from distributed.utils import sync
from tornado.ioloop import PeriodicCallback

from adaptmg import _checks as checks
from adaptmg._files import waiting_folder
from adaptmg.study.execute import (
    Execute,
    Finished,
    Order,
    Point,
    RunFunction,
    Task,
    UnfitWorker,
    error_text,
    identity,
    perform,
    readied,
    sent,
)

_log = logging.getLogger(__name__)

#: starts of a run until it counts as failed, as workers died
MOST_TRIES = 3
#: seconds that a cluster may take to have a worker, between two looks, and for a scheduler to answer
PATIENCE_S, _LOOK_S, CONNECT_S = 60.0, 0.5, 10.0
#: looks without a process of this machine until the study gives up
_TRIES = 3
_GONE = "the processes that compute runs ended, and dask does not start them again (is the system out of memory?); " \
        "finished runs are stored: run the study again, with fewer workers"


@contextmanager
def opened(workers: int | None, scheduler: str | Client | Cluster | None, runs: int) -> Iterator[Execute]:
    """Yield an executor on new processes of this machine, or on the cluster of the user."""
    if scheduler is None:
        with local_cluster(min(checks.integer("workers", workers, minimum=1), max(runs, 1))) as client:
            yield OnCluster(client)
    elif isinstance(scheduler, Client):
        yield OnCluster(scheduler)
    elif isinstance(scheduler, str | Cluster):
        # a client that cannot read the address blocks for a while when it is collected
        if isinstance(scheduler, str) and not re.fullmatch(r"\S+:\d+", scheduler):
            raise ValueError(f"scheduler must be an address such as 'tcp://host:8786', got {checks.shown(scheduler)}")
        try:
            client = Client(scheduler, set_as_default=False, timeout=CONNECT_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise OSError(f"scheduler: nobody answers at {scheduler}: start one with 'dask scheduler' ({error})") \
                from error
        with client:
            yield OnCluster(client)
    else:
        raise TypeError(f"scheduler must be an address such as 'tcp://host:8786', a distributed.Client or a cluster of "
                        f"dask, got {checks.described(scheduler)}")


class OnCluster:
    """An executor that computes on the workers of a client."""

    def __init__(self, client: Client) -> None:
        self._client, self._runs = client, None

    @property
    def running(self) -> int:
        """Runs that are being computed."""
        return 0 if self._runs is None else self._runs.running

    def __call__(self, task: Task, points: Sequence[Point]) -> Iterator[list[tuple[Point, Finished]]]:
        """Compute ``task`` at ``points``."""
        order = Order(sent(task.function), identity(), task.fingerprint.seen(), task.depends)
        check_workers(self._client, order, limited=task.limit_s is not None or task.memory_limit is not None)
        self._runs = _Runs(self._client, order, points, task.limit_s, task.memory_limit)
        yield from self._runs.finished()


def check_workers(client: Client, order: Order, limited: bool) -> None:
    """Raise ValueError or RuntimeError for workers that cannot compute the runs, or would compute others."""
    address = client.scheduler.address
    _wait_for_one(client, address)
    for name, worker in client.scheduler_info(n_workers=-1)["workers"].items():
        if worker["nthreads"] != 1:
            raise ValueError(f"the worker {name} has {worker['nthreads']} threads: start workers with one each ('dask "
                             f"worker {address} --nthreads 1 --nworkers N'), as libraries below are not safe for more")
        if limited and not worker["nanny"]:
            raise ValueError(f"the worker {name} has no nanny, which would restart it after limit_s or memory_limit: "
                             "start workers without --no-nanny")
    for name, error in client.run(_check, order, on_error="return").items():
        if isinstance(error, CommClosedError):
            _log.warning("the worker %s left during the check", name)
        elif error is not None:
            words = error if isinstance(error, UnfitWorker) else error_text(error)
            raise RuntimeError(f"the worker {name} cannot compute this study: {words}")


def _check(order: Order) -> None:
    readied(order)


def _wait_for_one(client: Client, address: str) -> None:
    """Wait until there is a worker; without end where jobs were submitted, which may wait in a queue for hours."""
    while True:
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
            return
        except TimeoutError:
            if isinstance(client.cluster, LocalCluster):
                raise OSError(_GONE) from None
            if not getattr(client.cluster, "worker_spec", None):
                raise OSError(f"the scheduler {address} has no workers after {PATIENCE_S:g} s: start some with 'dask "
                              f"worker {address} --nthreads 1', or, where they come later, wait for the first "
                              "(client.wait_for_workers(1)); a cluster that adapts needs a minimum of them") from None
            _log.warning("the scheduler %s has no workers yet: %d were requested", address,
                         len(client.cluster.worker_spec))


@functools.lru_cache(maxsize=8)
def _ready(order: bytes) -> tuple[RunFunction, bool]:
    """Return the run function of an order, checked, and whether it uses adaptmg."""
    unpacked = pickle.loads(order)
    return readied(unpacked), unpacked.fingerprint.uses_adaptmg


def _on_worker(order: bytes, point: Point, tries: int, name: str, topic: str) -> Finished:
    """Compute one run on a worker; with a topic, the scheduler knows that its clock starts before it starts. A function
    that holds Python's lock would keep a report that is only on its way."""
    worker = get_worker()
    return perform(*_ready(order), point, tries, lambda: topic and sync(
        worker.loop, worker.scheduler.log_event, topic=topic, msg={"run": name, "worker": worker.address}))


def _kill_worker(dask_worker: Nanny) -> None:
    with contextlib.suppress(psutil.Error):
        psutil.Process(dask_worker.pid).kill()


def _allowed_failures(dask_scheduler: Scheduler) -> int:
    return int(dask_scheduler.allowed_failures)


class _MemoryWatch(NannyPlugin):
    """Reports workers that hold more than ``limit`` bytes."""

    def __init__(self, limit: int, topic: str) -> None:
        self.limit, self.topic = limit, topic

    def setup(self, nanny: Nanny) -> None:
        self.looks = PeriodicCallback(lambda: self._look(nanny), 100)
        self.looks.start()

    def _look(self, nanny: Nanny) -> None:
        with contextlib.suppress(psutil.Error):
            if nanny.pid and psutil.Process(nanny.pid).memory_info().rss > self.limit:
                nanny.log_event(self.topic, {"run": None, "worker": nanny.worker_address})

    def teardown(self, nanny: Nanny) -> None:
        self.looks.stop()


@dataclass(eq=False)
class _Run:
    """A run that is out."""

    point: Point
    tries: int
    sent: float
    future: Future
    worker: str = ""  # where it has begun, if there are limits
    clock: object = None  # handle of its time limit
    stopped: bool = False


class _Runs:
    """All runs of one call."""

    def __init__(self, client: Client, order: Order, points: Sequence[Point], limit_s: float | None,
                 memory_limit: int | None) -> None:
        self._client, self._order = client, pickle.dumps(order)
        self._limit_s, self._memory_limit = limit_s, memory_limit
        self._name = f"adaptmg-{uuid.uuid4().hex[:12]}"
        self._limited = limit_s is not None or memory_limit is not None
        self._numbers = itertools.count()
        self._left: deque[tuple[Point, int]] = deque((point, 1) for point in points)
        #: last tries, one at a time when all else is done: a worker that dies then dies because of the run
        self._alone: deque[tuple[Point, int]] = deque()
        self._out: dict[str, _Run] = {}
        self._back: queue.SimpleQueue[tuple[str, Finished | BaseException]] = queue.SimpleQueue()
        self._slots, self._looked = 1, -math.inf
        #: how often dask itself starts a run again; unless set otherwise three times
        self._allowed = 3

    @property
    def running(self) -> int:
        """Number of runs that are out."""
        return len(self._out)

    def finished(self) -> Iterator[list[tuple[Point, Finished]]]:
        """Yield runs as they finish, those of one moment together."""
        with contextlib.suppress(Exception):  # some clusters refuse this
            self._allowed = self._client.run_on_scheduler(_allowed_failures)
        if self._limited:
            self._client.subscribe_topic(self._name, self._event)
        if self._memory_limit is not None:
            self._client.register_plugin(_MemoryWatch(self._memory_limit, self._name), name=self._name)
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
                self._drop()
                if self._memory_limit is not None:
                    self._client.unregister_worker_plugin(self._name, nanny=True)
                if self._limited:
                    self._client.unsubscribe_topic(self._name)

    def _drop(self) -> None:
        """Cancel the runs that are out; on a cluster that goes on, nannies restart the workers that compute them."""
        if not self._out:
            return
        busy = []
        if self._allowed:
            # the scheduler does not know yet where a run of a moment ago is
            time.sleep(0.2)
            busy = [address for address, keys in self._client.processing().items() if set(keys) & set(self._out)]
        self._client.cancel([run.future for run in self._out.values()], force=True)
        if busy:
            self._client.run(_kill_worker, nanny=True, workers=busy, on_error="ignore")

    def _send(self) -> None:
        now = time.monotonic()
        if now - self._looked > 1.0:
            self._slots, self._looked = max(len(self._client.nthreads()), 1), now
        while (self._left and len(self._out) < self._slots) or (self._alone and not self._out):
            point, tries = (self._left or self._alone).popleft()
            name = f"{self._name}-{next(self._numbers)}"
            future = self._client.submit(_on_worker, self._order, point, tries, name, self._name * self._limited,
                                         key=name, pure=False)
            self._out[name] = _Run(point, tries, time.monotonic(), future)
            self._client.loop.add_callback(self._wait_for, name, future)

    async def _wait_for(self, name: str, future: Future) -> None:
        """Fetch the result of a run, in the thread of dask (as_completed sleeps .1 s where it misses a wake-up)."""
        try:
            result = await future._result(raiseit=False)
        except BaseException as error:
            result = error
        run = self._out.get(name)
        if run is not None and not run.stopped:
            self._back.put((name, result[1] if isinstance(result, tuple) else result))

    def _event(self, event: tuple[float, dict[str, str | None]]) -> None:
        """A worker reports that a run begins, or a nanny that its worker holds too much memory."""
        name, address = event[1]["run"], event[1]["worker"]
        if name is None:
            for busy in [key for key, run in list(self._out.items()) if run.worker == address]:
                self._client.loop.add_callback(
                    self._stop, busy, "MemoryLimit: stopped as its process held more than "
                                      f"memory_limit={self._memory_limit} bytes")
        elif (run := self._out.get(name)) is not None:
            run.worker = address
            if run.clock is not None:  # dask started it again on another worker
                self._client.loop.remove_timeout(run.clock)
            if self._limit_s is not None:
                run.clock = self._client.loop.call_later(self._limit_s, self._stop, name,
                                                         f"TimeLimit: stopped after limit_s={self._limit_s:g} s")

    async def _stop(self, name: str, why: str) -> None:
        """Stop a run that is over a limit, in the thread of dask."""
        run = self._out.get(name)
        if run is None or run.stopped or run.future.done():
            return
        worker = run.worker
        try:
            if name not in (await self._client.scheduler.processing()).get(worker, ()) or run.stopped:
                return  # its worker died, and dask starts it again on another one, with a new clock
            run.stopped = True
            # cancelled first, so that dask does not start it elsewhere
            await self._client._cancel([run.future], force=True)
            await self._client._run(_kill_worker, nanny=True, workers=[worker], on_error="ignore")
        except Exception as error:
            _log.warning("the worker %s of a run over its limit was not killed: %s", run.worker, error_text(error))
        self._back.put((name, Finished(error=why, seconds=time.monotonic() - run.sent, tries=run.tries)))

    def _come_back(self) -> list[tuple[str, Finished | BaseException]]:
        """Return what is back, at least one result; OSError if the processes of this machine are gone for good."""
        begin, empty = time.monotonic(), 0
        while True:
            try:
                found = [self._back.get(timeout=_LOOK_S)]
                break
            except queue.Empty:
                if time.monotonic() - begin < PATIENCE_S:
                    continue
            begin = time.monotonic()
            empty = 0 if self._client.nthreads() else empty + 1
            if empty:
                _log.warning("the scheduler %s has no workers: %d runs wait", self._client.scheduler.address,
                             len(self._out) + len(self._left) + len(self._alone))
            if empty == _TRIES and isinstance(self._client.cluster, LocalCluster):
                raise OSError(_GONE)
        while not self._back.empty():
            found.append(self._back.get())
        return found

    def _outcome(self, name: str, result: Finished | BaseException) -> tuple[Point, Finished] | None:
        """Return the outcome of a run; None if it is tried again."""
        run = self._out.pop(name)
        if isinstance(result, Finished):
            return run.point, result
        seconds = time.monotonic() - run.sent
        if isinstance(result, KilledWorker):
            # dask itself starts a run again as often as the scheduler allows
            tries = run.tries + result.allowed_failures
            if run.tries >= MOST_TRIES:
                return run.point, Finished(error=f"WorkerDied: worker died {tries} times during this run",
                                           seconds=seconds, tries=tries)
            (self._alone if tries + 1 >= MOST_TRIES else self._left).append((run.point, tries + 1))
            _log.warning("a worker died during %s: tried again", run.point)
            return None
        if isinstance(result, asyncio.CancelledError | concurrent.futures.CancelledError):
            raise OSError(f"scheduler: the connection to {self._client.scheduler.address} was lost; finished runs are "
                          "stored") from result
        if isinstance(result, UnfitWorker | ImportError | AttributeError):
            raise RuntimeError(f"a worker that joined cannot compute this study: {result}") from result
        return run.point, Finished(error=error_text(result), seconds=seconds, exception=result, tries=run.tries)


# processes of this machine: spawned, of one thread each

#: set before a worker imports anything: one thread everywhere
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS",
                             "VECLIB_MAXIMUM_THREADS", "NGS_NUM_THREADS"), "1")
_CONFIG = {
    # the death of a worker is reported immediately, and the study counts the tries
    "distributed.scheduler.allowed-failures": 0,
    # a worker that waits because memory is short would wait for ever: runs hand nothing on
    "distributed.worker.memory.target": False, "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False, "distributed.worker.memory.terminate": False,
    # a busy machine may take longer than the usual 15 s to start a process again
    "distributed.deploy.lost-worker-timeout": "1h",
    "distributed.worker.multiprocessing-method": "spawn",
    # no dashboard, no samples of the running code a hundred times a second
    "distributed.worker.profile.enabled": False, "distributed.admin.system-monitor.interval": "5s",
}


def dask_setup(worker: object) -> None:
    """Let the system end this process with its parent, even in compiled code that holds Python's lock. dask calls this
    in each process of a local cluster."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


@contextmanager
def local_cluster(workers: int) -> Iterator[Client]:
    """Start ``workers`` processes on this machine, and end them.

    Yields the distributed.Client for :meth:`adaptmg.study.Study.run` as ``scheduler``; many studies can share it.
    """
    count = checks.integer("workers", workers, minimum=1)
    if multiprocessing.current_process().daemon:
        raise RuntimeError("a process that computes runs cannot start workers: leave workers= out of a study inside a "
                           "run")
    # reports connections to processes that were ended
    logging.getLogger("distributed.batched").setLevel(logging.CRITICAL)
    with _scripts_not_run_again(), _environment_kept(), \
            waiting_folder() as folder, \
            dask.config.set(_CONFIG | {"temporary-directory": str(folder)}):
        cluster = client = None
        try:
            with _interrupt_held_back():
                try:
                    cluster = LocalCluster(
                        n_workers=count, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0",
                        memory_limit=0, silence_logs=logging.CRITICAL, host="127.0.0.1", worker_dashboard_address=None,
                        env=_ONE_THREAD, preload=[__name__])
                except (RuntimeError, OSError) as error:
                    raise OSError(f"workers: {count} processes could not be started ({error.__cause__ or error}): give "
                                  "fewer workers, or free memory") from error
                client = Client(cluster, set_as_default=False)
            yield client
        finally:
            if cluster is not None:
                _end(cluster, client)


def _end(cluster: LocalCluster, client: Client | None) -> None:
    """End all processes immediately, whatever they compute; a second Ctrl-C waits."""
    with _interrupt_held_back():
        for nanny in list(cluster.workers.values()):
            # it does not start another process
            nanny.close_gracefully()
            if nanny.pid is not None:
                with contextlib.suppress(psutil.Error):
                    psutil.Process(nanny.pid).kill()
        if client is not None:
            with contextlib.suppress(Exception):
                client.close(timeout=1)
        with contextlib.suppress(Exception):
            cluster.close(timeout=3)


@contextmanager
def _interrupt_held_back() -> Iterator[None]:
    """Let Ctrl-C wait for the end of the block, where this is the main thread."""
    held: list[int] = []
    try:
        before = signal.signal(signal.SIGINT, lambda number, frame: held.append(number))
    except ValueError:
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if held:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def _environment_kept() -> Iterator[None]:
    """dask sets variables for its processes in this one too; numba refuses a number of threads that changes."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    with dask.config.set({"distributed.nanny.pre-spawn-environ": _ONE_THREAD}):
        try:
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value


@contextmanager
def _scripts_not_run_again() -> Iterator[None]:
    """Spawned processes run the script of the user again, up to its ``if __name__ == "__main__"``; dask's need not. Run
    functions are sent by value. Processes of others are not changed."""
    prepare = multiprocessing.spawn.get_preparation_data

    def prepared(name: str) -> dict[str, object]:
        data = prepare(name)
        if name.startswith("Dask Worker process"):
            data.pop("init_main_from_name", None)
            data.pop("init_main_from_path", None)
        return data

    multiprocessing.spawn.get_preparation_data = prepared
    try:
        yield
    finally:
        multiprocessing.spawn.get_preparation_data = prepare
