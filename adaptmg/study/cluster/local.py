"""A cluster on this machine: processes that are spawned, of one thread each, and end with this one whatever happens."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import multiprocessing.spawn
import os
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import dask.config
from distributed import Client, LocalCluster
from distributed.core import Status

from adaptmg.problem import checks

__all__ = ["local_cluster", "revive"]

_log = logging.getLogger(__name__)

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
                                preload=["adaptmg.study.cluster.bound"])
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
