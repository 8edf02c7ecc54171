"""Runs on workers of dask.distributed: on processes of this machine, or on a cluster of the user.

A run is sent when a worker is free, so that the run of a worker that dies is identified; dask tries
it again. Results come back through dask: workers need no disk in common with this process. This
process decides that a run is over its time, from when the worker reports that it begins; dask's
nanny kills the worker, even in compiled code, and starts another, as it does for a worker that
holds too much memory.

Processes of this machine are a scheduler in this process, and a ``dask worker`` with its nannies: a
process of its own, so that the workers run no script of the user again. They accept only who has
the certificate that is made for them, and end when this process does, which closes their standard
input."""

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
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import dask.config
import psutil
from distributed import Client, Future, KilledWorker, LocalCluster, Nanny, Security, get_worker
from distributed.comm.core import CommClosedError
from distributed.deploy.cluster import Cluster
from distributed.utils import sync

from adaptmg import _checks as checks
from adaptmg._files import waiting_folder
from adaptmg.study import execute
from adaptmg.study.designs import Point
from adaptmg.study.execute import Done, Execute, Finished, Order, RunFunction, Task, UnfitWorker
from adaptmg.study.store import Record

_log = logging.getLogger(__name__)

#: seconds that a cluster may take to have a worker, or this machine for each of its own, and for a scheduler to answer
PATIENCE_S, CONNECT_S = 60.0, 10.0
#: times that the processes of this machine are started: where one is killed while they start, as by
#: a system that is short of memory, dask ends the others, too
_STARTS = 3
#: set before a worker imports anything: one thread everywhere
_ONE_THREAD = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
        "NGS_NUM_THREADS",
    ),
    "1",
)
_FOLDER = "ADAPTMG_WORKERS_FOLDER"
_CONFIG = {
    # a run is started again where its worker dies
    "distributed.scheduler.allowed-failures": 1,
    # a worker that waits because memory is short would wait for ever: runs hand nothing on
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 1,
    "distributed.worker.multiprocessing-method": "spawn",
    # dask's web servers, which know no certificate, have no pages
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    # no samples of the running code a hundred times a second
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.interval": "5s",
}


@contextmanager
def local_cluster(workers: int, *, memory_limit: float | None = None) -> Iterator[Client]:
    """Start ``workers`` processes on this machine, and end them.

    Yields the distributed.Client for :meth:`adaptmg.study.Study.run` as ``scheduler``; many studies
    can share it. ``memory_limit`` is the number of bytes that each process may hold.

    Examples
    --------
    >>> study = am.Study(lambda n: {"square": n * n}, {"n": [1, 2, 3]})
    >>> with am.study.local_cluster(2) as client:                              # doctest: +SKIP
    ...     table = study.run(scheduler=client)
    """
    count = checks.integer("workers", workers, minimum=1)
    limit = 0 if memory_limit is None else int(checks.positive("memory_limit", memory_limit))
    if multiprocessing.current_process().daemon:
        raise RuntimeError(
            "a process that computes runs cannot start workers: leave workers= out of a study inside a "
            "run"
        )
    # reports connections to processes that were ended
    logging.getLogger("distributed.batched").setLevel(logging.CRITICAL)
    security = Security.temporary()
    with (
        waiting_folder() as folder,
        dask.config.set(_CONFIG | {"temporary-directory": str(folder)}),
        LocalCluster(
            n_workers=0,
            host="127.0.0.1",
            protocol="tls://",
            security=security,
            dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        # distributed infers coroutines and None for what a client that is connected returns
        address = cast("str", cluster.scheduler_address)  # pyright: ignore[reportAttributeAccessIssue]
        # workers that hold more memory than their limit from the beginning are killed and started again for ever
        last = time.monotonic() + PATIENCE_S * count
        for _ in range(_STARTS):
            with _processes(address, count, limit, folder, security) as process:
                while (n := len(client.nthreads())) < count and time.monotonic() < last:  # pyright: ignore[reportArgumentType]
                    if process.poll() is not None:
                        break
                    time.sleep(0.05)
                if n >= count and process.poll() is None:
                    yield client
                    return
            while client.nthreads():  # the scheduler has not seen yet that they ended
                time.sleep(0.05)
        words = " ".join((folder / "log.txt").read_text("utf-8", "replace")[-300:].split())
        raise OSError(
            f"workers: {count} processes could not be started ({words}): give fewer workers, or free "
            "memory"
        )


@contextmanager
def _processes(
    address: str, count: int, limit: int, folder: Path, security: Security
) -> Iterator[subprocess.Popen]:
    """Start a ``dask worker`` with nannies and workers; end all of them, whatever they compute."""
    keys = security.get_tls_config_for_role("worker")
    config = _CONFIG | {
        "distributed.comm.require-encryption": True,
        "distributed.comm.tls.ca-file": keys["ca_file"],
        "distributed.comm.tls.worker.cert": keys["cert"],
        "distributed.comm.tls.worker.key": keys["key"],
    }
    # only this user can read the environment of the process
    environment = (
        os.environ
        | _ONE_THREAD
        | {_FOLDER: str(folder), "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}
        | {
            f"DASK_{name.replace('.', '__').replace('-', '_').upper()}": str(value)
            for name, value in config.items()
        }
    )
    command = [
        sys.executable,
        "-m",
        "distributed.cli.dask_worker",
        address,
        "--nworkers",
        str(count),
        "--nthreads",
        "1",
        "--host",
        "127.0.0.1",
        "--no-dashboard",
        "--dashboard-address",  # of the web server, which dask starts all the same: not 0.0.0.0
        "127.0.0.1:0",
        "--memory-limit",
        str(limit),
        "--local-directory",
        str(folder),
        "--preload-nanny",
        __name__,
    ]
    with (
        open(folder / "log.txt", "wb") as log,
        subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=log,
            env=environment,
            start_new_session=True,
        ) as process,
    ):
        try:
            yield process
        finally:
            _kill_children(process.pid)
            process.kill()


def _kill_children(process: int) -> None:
    """End the processes that a process has started, and those that these have; it, or they, may have
    ended already."""
    with contextlib.suppress(psutil.Error):
        for child in psutil.Process(process).children(recursive=True):
            with contextlib.suppress(psutil.Error):
                child.kill()


def dask_setup(nanny: Nanny) -> None:
    """End this process and its workers when standard input is closed. dask calls this for each
    nanny."""

    def watch() -> None:
        sys.stdin.buffer.read()
        _kill_children(os.getpid())
        shutil.rmtree(os.environ[_FOLDER], ignore_errors=True)
        os._exit(1)

    # once, though there are several nannies in this process
    if not any(thread.name == _FOLDER for thread in threading.enumerate()):
        threading.Thread(target=watch, name=_FOLDER, daemon=True).start()


@contextmanager
def opened(
    workers: int | None,
    scheduler: str | Client | Cluster | None,
    runs: int,
    memory_limit: int | None,
) -> Iterator[Execute]:
    """Yield an executor on new processes of this machine, or on the cluster of the user."""
    if scheduler is None:
        count = cast("int", workers)  # where no scheduler is given
        clients = local_cluster(min(count, runs), memory_limit=memory_limit)
    elif isinstance(scheduler, Client):
        clients = contextlib.nullcontext(scheduler)
    else:
        checks.instance(
            "scheduler",
            scheduler,
            (str, Cluster),
            "an address such as 'tcp://host:8786', a distributed.Client or a cluster of dask",
        )
        # a client that cannot read the address blocks for a while when it is collected
        if isinstance(scheduler, str) and not re.fullmatch(r"\S+:\d+", scheduler):
            raise ValueError(
                f"scheduler must be an address such as 'tcp://host:8786', got {checks.shown(scheduler)}"
            )
        try:
            clients = Client(scheduler, set_as_default=False, timeout=CONNECT_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise OSError(
                f"scheduler: nobody answers at {scheduler}: start 'dask scheduler' ({error})"
            ) from error
    with clients as client:
        yield functools.partial(on_cluster, client)


def on_cluster(client: Client, task: Task, points: Iterator[Point | None]) -> Done:
    """Compute runs on the workers of a client."""
    order = Order(
        execute.sent(task.function), execute.identity(), task.fingerprint.seen(), task.depends
    )
    check_workers(client, order, limited=task.limit_s is not None)
    yield from _Runs(client, order, points, task.limit_s).finished()


def check_workers(client: Client, order: Order, limited: bool) -> None:
    """Raise ValueError or RuntimeError for workers that cannot compute the runs, or would compute
    others."""
    address = client.scheduler.address  # pyright: ignore[reportOptionalMemberAccess]
    while True:
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
            break
        except TimeoutError:
            # jobs that were submitted may wait in a queue for hours
            if not getattr(client.cluster, "worker_spec", None):
                raise OSError(
                    f"the scheduler {address} has no workers after {PATIENCE_S:g} s: start some with 'dask "
                    f"worker {address} --nthreads 1', or, where they come later, wait for the first "
                    "(client.wait_for_workers(1)); a cluster that adapts needs a minimum of them"
                ) from None
            _log.warning(
                "the scheduler %s has no workers yet: %d were requested",
                address,
                len(client.cluster.worker_spec),  # pyright: ignore[reportOptionalMemberAccess]
            )
    for name, worker in client.scheduler_info(n_workers=-1)["workers"].items():
        if worker["nthreads"] != 1:
            raise ValueError(
                f"the worker {name} has {worker['nthreads']} threads: start workers with one each ('dask "
                f"worker {address} --nthreads 1 --nworkers N'), as libraries below are not safe for more"
            )
        if limited and not worker["nanny"]:
            raise ValueError(
                f"the worker {name} has no nanny, which limit_s needs: start it without --no-nanny"
            )
    for name, error in client.run(execute.check, order, on_error="return").items():  # pyright: ignore[reportAttributeAccessIssue]
        if error is not None and not isinstance(
            error, CommClosedError
        ):  # that of a worker that left meanwhile
            words = error if isinstance(error, UnfitWorker) else execute.error_text(error)
            raise RuntimeError(f"the worker {name} cannot compute this study: {words}")


@functools.lru_cache(maxsize=8)
def _ready(order: bytes) -> tuple[RunFunction, bool]:
    """Return the run function of an order, checked, and whether it uses adaptmg."""
    unpacked = pickle.loads(order)
    return execute.readied(unpacked), "adaptmg" in unpacked.fingerprint.parts


def _on_worker(order: bytes, point: Point, name: str, topic: str) -> Finished:
    """Compute one run on a worker; with a topic, the scheduler knows that its clock starts before
    it starts."""
    worker = get_worker()

    def report_start() -> None:
        if topic:
            # waits until it is sent: a run that holds Python's lock would keep a report back
            message = {"run": name, "worker": worker.address}
            sync(worker.loop, worker.scheduler.log_event, topic=topic, msg=message)

    return execute.perform(*_ready(order), point, report_start)


def _kill_worker(dask_worker: Nanny) -> None:
    """End the worker of a nanny, and the processes that its run has started, which nobody finds
    afterwards."""
    pid = dask_worker.pid
    if pid is None:  # no worker is left, and psutil takes None for this process
        return
    with contextlib.suppress(psutil.Error):
        _kill_children(pid)
        psutil.Process(pid).kill()


@dataclass(eq=False)
class _Run:
    """A run that is out."""

    point: Point
    sent: float  # when, by time.monotonic(), s
    future: Future
    worker: str = ""  # where it has begun, if there is a limit
    began: float = math.inf  # when, by the same clock; infinite before, and once stopped

    def failed(self, error: str, exception: BaseException | None = None) -> Finished:
        """Return the outcome of a run that gave none."""
        return Finished(
            Record(
                parameters=self.point,
                status="failed",
                error=error,
                seconds=time.monotonic() - self.sent,
            ),
            exception=exception,
        )


#: what stands for a point after the last one
_END: Point = {}


class _Runs:
    """All runs of one call."""

    def __init__(
        self, client: Client, order: Order, points: Iterator[Point | None], limit_s: float | None
    ) -> None:
        self._client = client
        self._order = pickle.dumps(order)
        self._limit_s = math.inf if limit_s is None else limit_s
        self._name = f"adaptmg-{uuid.uuid4().hex[:12]}"
        self._numbers = itertools.count()  # of runs, for their names
        self._points = points
        self._open = True  # whether there may be more points
        self._out: dict[str, _Run] = {}  # runs that were sent, by their names
        # names of runs that ended, and their outcomes
        self._back: queue.SimpleQueue[tuple[str, Finished | BaseException]] = queue.SimpleQueue()
        self._large: set[str] = set()  # workers that held too much memory
        self._seen = time.monotonic()  # when there was a worker

    def finished(self) -> Done:
        """Yield runs as they finish, those of one moment together."""
        self._client.subscribe_topic(
            "worker-restart-memory", lambda event: self._large.add(event[1]["worker"])
        )
        self._client.subscribe_topic(self._name, self._note_begin)
        try:
            self._send()
            while self._out or self._open:
                done = [
                    run
                    for name, result in self._come_back()
                    if (run := self._outcome(name, result)) is not None
                ]
                # before the rows are stored, so that workers need not wait for the disk
                self._send()
                if done:
                    yield done
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be gone, and its client closed
                self._cancel_all()
                self._client.unsubscribe_topic("worker-restart-memory")
                self._client.unsubscribe_topic(self._name)

    def _send(self) -> None:
        """Send a run to each worker that has none, as long as there are points."""
        slots = self._slots()
        while len(self._out) < slots:
            point = next(self._points, _END)
            if point is None:
                return  # other processes compute those that are left: there may be more later
            if point is _END:
                self._open = False
                return
            name = f"{self._name}-{next(self._numbers)}"
            # workers report the start of runs with a limit
            topic = self._name if self._limit_s < math.inf else ""
            future = self._client.submit(
                _on_worker,
                self._order,
                point,
                name,
                topic,
                key=name,
                pure=False,
            )
            self._out[name] = _Run(point, time.monotonic(), future)
            future.add_done_callback(functools.partial(self._fetch, name))

    def _slots(self) -> int:
        """Return the number of workers; OSError if the processes of this machine are gone for
        good."""
        count = len(self._client.nthreads())  # pyright: ignore[reportArgumentType]
        if count or time.monotonic() - self._seen > PATIENCE_S:
            self._seen = time.monotonic()
            if not count:
                _log.warning(
                    "the scheduler %s has no workers: %d runs wait",
                    self._client.scheduler.address,  # pyright: ignore[reportOptionalMemberAccess]
                    len(self._out),
                )
                if isinstance(self._client.cluster, LocalCluster):
                    raise OSError(
                        "the processes of runs ended, and dask does not start them again: run the study "
                        "again, with fewer workers"
                    )
        return max(count, 1)

    def _fetch(self, name: str, future: Future) -> None:
        """Put the result of a run, or its error, into the queue, in a thread of dask."""
        try:
            result = future.result()
        except BaseException as error:
            result = error
        self._back.put((name, result))

    def _note_begin(self, event: tuple[float, dict[str, str]]) -> None:
        """Note the worker of a run, and when it began: dask may start it again on another worker. An
        ``event`` is the time at the scheduler, and the message of :func:`_on_worker`."""
        if (run := self._out.get(event[1]["run"])) is not None:
            run.worker = event[1]["worker"]
            run.began = time.monotonic()

    def _stop_late(self) -> None:
        """Stop the runs that are over their time."""
        for name, run in self._out.items():
            if time.monotonic() - run.began < self._limit_s or run.future.done():
                continue
            run.began = math.inf
            if name not in self._client.processing().get(run.worker, ()):  # pyright: ignore[reportAttributeAccessIssue]
                continue  # its worker died, and dask starts it again on another one, with a new clock
            # cancelled first, so that dask does not start it elsewhere
            self._back.put(
                (name, run.failed(f"TimeLimit: stopped after limit_s={self._limit_s:g} s"))
            )
            self._stop([run], [run.worker])

    def _cancel_all(self) -> None:
        """Cancel the runs that are out; on a cluster that goes on, nannies restart the workers that
        compute them."""
        if not self._out:
            return
        # the scheduler does not know yet where a run of a moment ago is
        time.sleep(0.2)
        busy = [
            address
            for address, keys in self._client.processing().items()  # pyright: ignore[reportAttributeAccessIssue]
            if set(keys) & set(self._out)
        ]
        self._stop(self._out.values(), busy)

    def _stop(self, runs: Iterable[_Run], workers: list[str]) -> None:
        """Cancel runs, and kill the processes of workers, by their addresses; nannies start others."""
        self._client.cancel([run.future for run in runs], force=True)
        if workers:
            self._client.run(_kill_worker, nanny=True, workers=workers, on_error="ignore")

    def _come_back(self) -> list[tuple[str, Finished | BaseException]]:
        """Return the results that have come back; after a while without any, none."""
        self._stop_late()
        results = []
        with contextlib.suppress(queue.Empty):
            # a run is stopped at most a tenth of its limit late
            results.append(self._back.get(timeout=min(execute.LOOK_S, self._limit_s / 10)))
            while True:
                results.append(self._back.get_nowait())
        return results

    def _outcome(self, name: str, result: Finished | BaseException) -> Finished | None:
        """Return the outcome of a run; None if it was stopped."""
        run = self._out.pop(name, None)
        if run is None:
            return None
        if isinstance(result, Finished):
            return result
        if isinstance(result, concurrent.futures.CancelledError):
            address = self._client.scheduler.address  # pyright: ignore[reportOptionalMemberAccess]
            raise OSError(
                f"scheduler: the connection to {address} was lost; finished runs are stored"
            ) from result
        if isinstance(result, UnfitWorker | ImportError | AttributeError):
            raise RuntimeError(
                f"a worker that joined cannot compute this study: {result}"
            ) from result
        if not isinstance(result, KilledWorker):
            return run.failed(execute.error_text(result), result)
        if result.last_worker is not None and result.last_worker.address in self._large:
            return run.failed("MemoryLimit: stopped as its process held more than its limit")
        return run.failed(
            f"WorkerDied: worker died {result.allowed_failures + 1} times during this run"
        )
