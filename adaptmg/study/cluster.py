"""Runs on workers of dask.distributed: on processes of this machine, or on a cluster of the user.

A run is sent when a worker is free, so that the run of a worker that dies is identified and tried again. Results come
back through dask: workers need no disk in common with this process.

This process decides that a run is over its time: the clock starts when the worker reports that the run begins. The run
is cancelled, and dask's nanny kills the process, even one in compiled code, and starts another. A nanny also ends a
worker that holds too much memory, and reports it.

Processes of this machine are a scheduler in this process, and a ``dask worker`` with its nannies: a process of its own,
so that the workers run no script of the user again. Scheduler and workers accept only who has the certificate that is
made for them, and there is no dashboard. All end with this process.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import functools
import itertools
import logging
import math
import multiprocessing
import os
import pickle
import queue
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import dask.config
import psutil
from distributed import Client, Future, KilledWorker, LocalCluster, Nanny, Security, get_worker
from distributed.comm import CommClosedError
from distributed.deploy import Cluster
from distributed.utils import sync

from adaptmg import _checks as checks
from adaptmg._files import waiting_folder
from adaptmg.study import execute
from adaptmg.study.execute import Done, Execute, Finished, Order, Point, RunFunction, Task, UnfitWorker

#: starts of a run, or of the processes, until it counts as failed
MOST_TRIES = 3
#: set before a worker imports anything: one thread everywhere
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS",
                             "VECLIB_MAXIMUM_THREADS", "NGS_NUM_THREADS"), "1")
_FOLDER = "ADAPTMG_WORKERS_FOLDER"
_CONFIG = {
    # the death of a worker is reported immediately, and the study counts the tries
    "distributed.scheduler.allowed-failures": 0,
    # a worker that waits because memory is short would wait for ever: runs hand nothing on
    "distributed.worker.memory.target": False, "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False, "distributed.worker.memory.terminate": 1.0,
    "distributed.worker.multiprocessing-method": "spawn",
    # dask's web servers, which know no certificate, have no pages
    "distributed.scheduler.http.routes": [], "distributed.worker.http.routes": [],
    # no samples of the running code a hundred times a second
    "distributed.worker.profile.enabled": False, "distributed.admin.system-monitor.interval": "5s",
}


@contextmanager
def local_cluster(workers: int, *, memory_limit: float | None = None) -> Iterator[Client]:
    """Start ``workers`` processes on this machine, and end them.

    Yields the distributed.Client for :meth:`adaptmg.study.Study.run` as ``scheduler``; many studies can share it.
    ``memory_limit`` is the number of bytes that each process may hold.
    """
    count = checks.integer("workers", workers, minimum=1)
    limit = 0 if memory_limit is None else int(checks.positive("memory_limit", memory_limit))
    if multiprocessing.current_process().daemon:
        raise RuntimeError("a process that computes runs cannot start workers: leave workers= out of a study inside a "
                           "run")
    # reports connections to processes that were ended
    logging.getLogger("distributed.batched").setLevel(logging.CRITICAL)
    with waiting_folder() as folder, dask.config.set(_CONFIG | {"temporary-directory": str(folder)}), \
            contextlib.ExitStack() as started:
        with _interrupt_held_back():
            security = Security.temporary()
            cluster = LocalCluster(n_workers=0, host="127.0.0.1", protocol="tls://", security=security,
                                   dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False},
                                   silence_logs=logging.CRITICAL)
            started.callback(_end, cluster.close, 3)
            client = Client(cluster, set_as_default=False)
            started.callback(_end, client.close, 1)
            processes = _Processes(cluster.scheduler_address, count, limit, str(folder), security)
            started.callback(processes.end)
        while len(client.nthreads()) < count:
            if processes.over.wait(0.05):
                raise OSError(f"workers: {count} processes could not be started ({processes.last_words()}): give fewer "
                              "workers, or free memory")
        yield client


def _end(close: Callable[..., object], timeout: float) -> None:
    with _interrupt_held_back(), contextlib.suppress(Exception):
        close(timeout=timeout)


class _Processes:
    """A ``dask worker`` with nannies and workers; it is started again where it ends, as when a worker dies while it
    starts."""

    def __init__(self, address: str, count: int, limit: int, folder: str, security: Security) -> None:
        keys = security.get_tls_config_for_role("worker")
        config = _CONFIG | {"distributed.comm.require-encryption": True, "distributed.comm.tls.ca-file":
                            keys["ca_file"], "distributed.comm.tls.worker.cert": keys["cert"],
                            "distributed.comm.tls.worker.key": keys["key"]}
        # only this user can read the environment of the process
        self._environment = os.environ | _ONE_THREAD | {
            _FOLDER: folder, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))} | {
            f"DASK_{name.replace('.', '__').replace('-', '_').upper()}": str(value) for name, value in config.items()}
        self._command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nworkers", str(count),
                         "--nthreads", "1", "--host", "127.0.0.1", "--no-dashboard", "--memory-limit", str(limit),
                         "--local-directory", folder, "--preload-nanny", __name__]
        self._log, self._ends = os.path.join(folder, "log.txt"), False
        #: whether the processes have ended, and are not started again
        self.over = threading.Event()
        self._start()
        threading.Thread(target=self._supervise, daemon=True).start()

    def _start(self) -> None:
        with open(self._log, "wb") as log:
            self._process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=log, stderr=log,
                                             env=self._environment, start_new_session=True)

    def _supervise(self) -> None:
        for _ in range(MOST_TRIES - 1):
            self._process.wait()
            if self._ends:
                return
            self._start()
        self._process.wait()
        self.over.set()

    def last_words(self) -> str:
        """Return the end of what the processes wrote."""
        with open(self._log, encoding="utf-8", errors="replace") as log:
            return " ".join(log.read()[-300:].split())

    def end(self) -> None:
        """End all processes immediately, whatever they compute."""
        with _interrupt_held_back():
            self._ends = True
            _kill_children(self._process.pid)
            self._process.kill()
            self._process.wait()


def _kill_children(process: int) -> None:
    with contextlib.suppress(psutil.Error):
        for child in psutil.Process(process).children(recursive=True):
            with contextlib.suppress(psutil.Error):
                child.kill()


def dask_setup(nanny: Nanny) -> None:
    """End this process and its workers with the process of the study, even in compiled code that holds Python's lock:
    its end closes standard input. dask calls this for each nanny."""
    def watch() -> None:
        sys.stdin.buffer.read()
        _kill_children(os.getpid())
        shutil.rmtree(os.environ[_FOLDER], ignore_errors=True)
        os._exit(1)

    if not any(thread.name == _FOLDER for thread in threading.enumerate()):
        threading.Thread(target=watch, name=_FOLDER, daemon=True).start()


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


_log = logging.getLogger(__name__)

#: seconds that a cluster may take to have a worker, and for a scheduler to answer
PATIENCE_S, CONNECT_S = 60.0, 10.0
_GONE = "the processes of runs ended, and dask does not start them again: run the study again, with fewer workers"


@contextmanager
def opened(workers: int | None, scheduler: str | Client | Cluster | None, runs: int, memory_limit: int | None
           ) -> Iterator[Execute]:
    """Yield an executor on new processes of this machine, or on the cluster of the user."""
    if scheduler is None:
        count = min(checks.integer("workers", workers, minimum=1), max(runs, 1))
        with local_cluster(count, memory_limit=memory_limit) as client:
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
            raise OSError(f"scheduler: nobody answers at {scheduler}: start 'dask scheduler' ({error})") from error
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
        return 0 if self._runs is None else len(self._runs.out)

    def __call__(self, task: Task, points: Iterator[Point | None]) -> Done:
        order = Order(execute.sent(task.function), execute.identity(), task.fingerprint.seen(), task.depends)
        check_workers(self._client, order, limited=task.limit_s is not None)
        self._runs = _Runs(self._client, order, points, task.limit_s)
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
            raise ValueError(f"the worker {name} has no nanny, which limit_s needs: start it without --no-nanny")
    for name, error in client.run(execute.check, order, on_error="return").items():
        if isinstance(error, CommClosedError):
            _log.warning("the worker %s left during the check", name)
        elif error is not None:
            words = error if isinstance(error, UnfitWorker) else execute.error_text(error)
            raise RuntimeError(f"the worker {name} cannot compute this study: {words}")


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
    return execute.readied(unpacked), unpacked.fingerprint.uses_adaptmg


def _on_worker(order: bytes, point: Point, tries: int, name: str, topic: str) -> Finished:
    """Compute one run on a worker; with a topic, the scheduler knows that its clock starts before it starts. A function
    that holds Python's lock would keep a report that is only on its way."""
    worker = get_worker()
    return execute.perform(*_ready(order), point, tries, lambda: topic and sync(
        worker.loop, worker.scheduler.log_event, topic=topic, msg={"run": name, "worker": worker.address}))


def _kill_worker(dask_worker: Nanny) -> None:
    with contextlib.suppress(psutil.Error):
        psutil.Process(dask_worker.pid).kill()


@dataclass(eq=False)
class _Run:
    """A run that is out."""

    point: Point
    tries: int
    sent: float
    future: Future
    worker: str = ""  # where it has begun, if there is a limit
    began: float = math.inf


class _Runs:
    """All runs of one call."""

    def __init__(self, client: Client, order: Order, points: Iterator[Point | None], limit_s: float | None) -> None:
        self._client, self._order, self._limit_s = client, pickle.dumps(order), limit_s
        self._name = f"adaptmg-{uuid.uuid4().hex[:12]}"
        self._numbers = itertools.count()
        self._points, self._open = points, True
        self._left: deque[tuple[Point, int]] = deque()
        #: last tries, one at a time when all else is done: a worker that dies then dies because of the run
        self._alone: deque[tuple[Point, int]] = deque()
        self.out: dict[str, _Run] = {}
        self._back: queue.SimpleQueue[tuple[str, Finished | BaseException]] = queue.SimpleQueue()
        self._slots, self._looked = 1, -math.inf
        self._large: set[str] = set()  # workers that held too much memory

    def finished(self) -> Done:
        """Yield runs as they finish, those of one moment together."""
        self._client.subscribe_topic("worker-restart-memory", lambda event: self._large.add(event[1]["worker"]))
        self._client.subscribe_topic(self._name, self._begun)
        try:
            self._send()
            while self.out or self._open:
                if not self.out:  # other processes compute what is left
                    time.sleep(execute.LOOK_S)
                    self._send()
                    continue
                done = [row for name, result in self._come_back() if (row := self._outcome(name, result)) is not None]
                # before the rows are stored, so that workers need not wait for the disk
                self._send()
                if done:
                    yield done
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be gone, and its client closed
                self._drop()
                self._client.unsubscribe_topic("worker-restart-memory")
                self._client.unsubscribe_topic(self._name)

    def _drop(self) -> None:
        """Cancel the runs that are out; on a cluster that goes on, nannies restart the workers that compute them."""
        if not self.out:
            return
        # the scheduler does not know yet where a run of a moment ago is
        time.sleep(0.2)
        busy = [address for address, keys in self._client.processing().items() if set(keys) & set(self.out)]
        self._client.cancel([run.future for run in self.out.values()], force=True)
        if busy:
            self._client.run(_kill_worker, nanny=True, workers=busy, on_error="ignore")

    def _send(self) -> None:
        now = time.monotonic()
        if now - self._looked > 1.0:
            self._slots, self._looked = max(len(self._client.nthreads()), 1), now
        while len(self.out) < self._slots and (task := self._next()) is not None:
            point, tries = task
            name = f"{self._name}-{next(self._numbers)}"
            future = self._client.submit(_on_worker, self._order, point, tries, name,
                                         self._name * (self._limit_s is not None), key=name, pure=False)
            self.out[name] = _Run(point, tries, time.monotonic(), future)
            future.add_done_callback(functools.partial(self._fetch, name))

    def _next(self) -> tuple[Point, int] | None:
        if not self._left and self._open:
            with contextlib.suppress(StopIteration):
                point = next(self._points)
                return None if point is None else (point, 1)
            self._open = False
        return self._left.popleft() if self._left else self._alone.popleft() if self._alone and not self.out else None

    def _fetch(self, name: str, future: Future) -> None:
        """Fetch what a run gave, in a thread of dask."""
        try:
            result = future.result()
        except BaseException as error:
            result = error
        self._back.put((name, result))

    def _begun(self, event: tuple[float, dict[str, str]]) -> None:
        """A worker reports that a run begins, perhaps again, as dask started it on another worker."""
        if (run := self.out.get(event[1]["run"])) is not None:
            run.worker, run.began = event[1]["worker"], time.monotonic()

    def _stop_late(self) -> None:
        """Stop the runs that are over their time."""
        for name, run in self.out.items():
            if self._limit_s is None or time.monotonic() - run.began < self._limit_s or run.future.done():
                continue
            run.began = math.inf
            if name not in self._client.processing().get(run.worker, ()):
                continue  # its worker died, and dask starts it again on another one, with a new clock
            # cancelled first, so that dask does not start it elsewhere
            self._back.put((name, Finished(error=f"TimeLimit: stopped after limit_s={self._limit_s:g} s",
                                           seconds=time.monotonic() - run.sent, tries=run.tries)))
            self._client.cancel([run.future], force=True)
            self._client.run(_kill_worker, nanny=True, workers=[run.worker], on_error="ignore")

    def _come_back(self) -> list[tuple[str, Finished | BaseException]]:
        """Return what is back, at least one result; OSError if the processes of this machine are gone for good."""
        begin, empty = time.monotonic(), 0
        while True:
            self._stop_late()
            try:
                results = [self._back.get(timeout=min(execute.LOOK_S, (self._limit_s or math.inf) / 10))]
                break
            except queue.Empty:
                if time.monotonic() - begin < PATIENCE_S:
                    continue
            begin = time.monotonic()
            empty = 0 if self._client.nthreads() else empty + 1
            if empty:
                _log.warning("the scheduler %s has no workers: %d runs wait", self._client.scheduler.address,
                             len(self.out) + len(self._left) + len(self._alone))
            if empty == MOST_TRIES and isinstance(self._client.cluster, LocalCluster):
                raise OSError(_GONE)
        while not self._back.empty():
            results.append(self._back.get())
        return results

    def _outcome(self, name: str, result: Finished | BaseException) -> tuple[Point, Finished] | None:
        """Return the outcome of a run; None if it is tried again, or was stopped."""
        run = self.out.pop(name, None)
        if run is None:
            return None
        if isinstance(result, Finished):
            return run.point, result
        seconds = time.monotonic() - run.sent
        if isinstance(result, KilledWorker):
            if result.last_worker is not None and result.last_worker.address in self._large:
                return run.point, Finished(error="MemoryLimit: stopped as its process held more than its limit",
                                           seconds=seconds, tries=run.tries)
            # dask itself starts a run again as often as the scheduler allows
            tries = run.tries + result.allowed_failures
            if run.tries >= MOST_TRIES:
                return run.point, Finished(error=f"WorkerDied: worker died {tries} times during this run",
                                           seconds=seconds, tries=tries)
            (self._alone if tries + 1 >= MOST_TRIES else self._left).append((run.point, tries + 1))
            _log.warning("a worker died during %s: tried again", run.point)
            return None
        if isinstance(result, concurrent.futures.CancelledError):
            raise OSError(f"scheduler: the connection to {self._client.scheduler.address} was lost; finished runs are "
                          "stored") from result
        if isinstance(result, UnfitWorker | ImportError | AttributeError):
            raise RuntimeError(f"a worker that joined cannot compute this study: {result}") from result
        return run.point, Finished(error=execute.error_text(result), seconds=seconds, exception=result, tries=run.tries)
