"""Processes of this machine as a cluster of dask: spawned, of one thread each; they end with this process."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import multiprocessing
import multiprocessing.spawn
import os
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import dask.config
import psutil
from distributed import Client, LocalCluster

from adaptmg import _checks as checks

__all__ = ["dask_setup", "local_cluster"]

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
#: the name of dask's processes
_NAME = "Dask Worker process"
_PR_SET_PDEATHSIG = 1


def dask_setup(worker: object) -> None:
    """Let the system end this process with its parent (Linux), even in compiled code that holds Python's lock.

    dask calls this in each process of a local cluster.
    """
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


@contextmanager
def local_cluster(workers: int) -> Iterator[Client]:
    """Start processes on this machine, and end them.

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
    # reports connections to processes that were ended
    logging.getLogger("distributed.batched").setLevel(logging.CRITICAL)
    with _scripts_not_run_again(), _environment_kept(), \
            tempfile.TemporaryDirectory(prefix="adaptmg-workers-", ignore_cleanup_errors=True) as folder, \
            dask.config.set(_CONFIG | {"temporary-directory": folder}):
        cluster = client = None
        try:
            with _interrupt_held_back():
                try:
                    cluster = LocalCluster(
                        n_workers=count, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0",
                        memory_limit=0, silence_logs=logging.CRITICAL, host="127.0.0.1", worker_dashboard_address=None,
                        env=_ONE_THREAD, preload=["adaptmg.study.processes"])
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
    """Spawned processes run the script of the user again, up to its ``if __name__ == "__main__"``; dask's need not.

    Run functions are sent by value. Processes of others are not changed.
    """
    prepare = multiprocessing.spawn.get_preparation_data

    def prepared(name: str) -> dict[str, object]:
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
