"""Netgen, OCC and readers of files in a process of their own, with limits of processor time and
memory.

Netgen fails, or does not finish, where a wall, slot or needle is much thinner than the edges around
it; OCC ends its process on some damaged files. Both then end the other process only, which is
started again when it is next needed. Ctrl-C ends it too. One process serves all calls one after the
other: it starts in 0.4 s, which loading NGSolve here would take as well, and stays; a call costs
0.3 ms."""

from __future__ import annotations

import atexit
import io
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from adaptmg import _checks as checks
from adaptmg._text import say

#: by dimension, seconds of the processor: for the shape, and for each node (twenty times in 2D, five
#: times in 3D what Netgen takes)
LIMIT_S, _NODE_LIMIT_S = {2: 30.0, 3: 120.0}, {2: 4e-3, 3: 35e-3}
#: seconds for a file, and for each byte of it: OCC takes a second a megabyte
_FILE_S, _BYTE_S = 60.0, 2e-5

#: how many times as long a process may take by the clock: of 16 that compute on 2 processors each
#: has an eighth; one that only waits must end, too
_PATIENCE = 20.0
#: seconds after which a terminal hears of a call
_QUIET_S = 5.0

_WORKER = Path(__file__).with_name("netgen_worker.py")
# by the process that started them: after a fork the other one must not use them
_idle: dict[int, list[Netgen]] = {}


class NetgenFails(ValueError):
    """Netgen or OCC raised an error, or broke down."""


class NetgenUnfinished(NetgenFails):
    """Netgen or OCC did not finish in time."""


def limit_s(nodes: float, dim: int) -> float:
    """Return the seconds that Netgen may take for about ``nodes`` nodes."""
    return LIMIT_S[dim] + _NODE_LIMIT_S[dim] * nodes


def _say_runs(function: str, seconds: float) -> None:
    """Say on a terminal that a function of the worker takes long, and how long it may take."""
    if sys.stderr is not None and sys.stderr.isatty():
        say(
            f"adaptmg: {function} runs in Netgen's process, at most {seconds:.0f} s of the processor"
        )


def read_s(path: Path) -> float:
    """Return the seconds that reading a file may take."""
    return _FILE_S + _BYTE_S * path.stat().st_size


class Netgen:
    """A process of :mod:`adaptmg.mesh.netgen_worker`."""

    def __init__(self) -> None:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        # -P: the folder of the script, adaptmg/mesh, is not searched for modules
        self.process = subprocess.Popen(
            [sys.executable, "-P", str(_WORKER)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        self.requests = checks.instance("stdin", self.process.stdin, io.BufferedWriter)
        self.answers = checks.instance("stdout", self.process.stdout, io.BufferedReader)

    @property
    def alive(self) -> bool:
        """Return whether the process still runs."""
        return self.process.poll() is None

    def __call__(self, function: str, *arguments: Any, seconds: float) -> Any:
        """Call a function of the worker; NetgenFails with its message, NetgenUnfinished after
        ``seconds`` of the processor."""
        late = threading.Event()
        done = threading.Event()
        start = self._processor_seconds()
        end = time.monotonic() + _PATIENCE * seconds

        def watch() -> None:
            # kill the process when its time is up, which ends the wait for its answer. The next look is after
            # what is left of its time, but at most ten times a second
            left = seconds
            while not done.wait(min(max(left, 0.1), threading.TIMEOUT_MAX)):
                left = min(seconds - self._processor_seconds() + start, end - time.monotonic())
                if left <= 0:
                    late.set()
                    self.process.kill()
                    return

        threading.Thread(target=watch, daemon=True).start()
        notice = threading.Timer(_QUIET_S, _say_runs, (function, seconds))
        notice.daemon = True
        notice.start()
        try:
            pickle.dump((function, arguments), self.requests, protocol=pickle.HIGHEST_PROTOCOL)
            self.requests.flush()
            well, answer = pickle.load(self.answers)
        except (EOFError, OSError, pickle.UnpicklingError):
            self.end()
            if late.is_set():
                raise NetgenUnfinished(
                    f"it does not finish within {seconds:.3g} s of the processor"
                ) from None
            raise NetgenFails(f"it breaks down, exit code {self.process.returncode}") from None
        except BaseException:
            self.end()
            raise
        finally:
            notice.cancel()
            done.set()
        if not well:
            raise NetgenFails(answer)
        return answer

    def _processor_seconds(self) -> float:
        """Return the seconds of the processor that the process has taken."""
        import psutil  # a first solve without it starts sooner

        try:
            times = psutil.Process(self.process.pid).cpu_times()
        except psutil.Error:
            return 0.0
        return times.user + times.system

    def end(self) -> None:
        """Kill the process."""
        self.process.kill()
        for pipe in (self.requests, self.answers):
            with suppress(OSError):
                pipe.close()
        self.process.wait()


@contextmanager
def netgen() -> Iterator[Netgen]:
    """Yield a process that nobody else uses meanwhile: what a call leaves in it is there for the
    next."""
    idle = _idle.setdefault(os.getpid(), [])
    worker = idle.pop() if idle else None
    if worker is None or not worker.alive:
        worker = Netgen()
    try:
        yield worker
    finally:
        # one process is kept for the next call
        if worker.alive and not idle:
            idle.append(worker)
        else:
            worker.end()


@atexit.register
def _end_idle() -> None:
    for worker in _idle.pop(os.getpid(), []):
        worker.end()
