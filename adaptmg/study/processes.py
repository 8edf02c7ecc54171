"""Processes of this machine that compute runs: a scheduler in this process, and a ``dask worker`` with its nannies.

That is a process of its own, so that the workers run no script of the user again. Scheduler and workers accept only who
has the certificate that is made for them, and there is no dashboard. All end with this process.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import dask.config
import psutil
from distributed import Client, LocalCluster, Nanny, Security

from adaptmg import _checks as checks
from adaptmg._files import waiting_folder

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
