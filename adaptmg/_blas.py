"""One thread of BLAS, and the same random numbers always: results have the same bits on each run.

Sums over two threads differ in the last digits, and small dense factorisations lose more to starting threads than they
gain.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from adaptmg._machine import after_fork


class _Process:
    """The lock of numpy's generator, and the limit of BLAS. threadpoolctl's own limit ends with the thread that set it;
    this one is set by the first thread of Python to enter, and lifted by the last to leave."""

    def __init__(self) -> None:
        self.random, self.lock, self.inside, self.modules = threading.RLock(), threading.RLock(), 0, -1
        self.controller: Any = None
        self.limit: Any = None

    def enter(self) -> None:
        # imported inside the block scipy would bring another BLAS without a limit
        import scipy.linalg  # noqa: F401
        from threadpoolctl import ThreadpoolController

        with self.lock:
            if self.inside == 0:
                if self.modules != len(sys.modules):  # some ms, when modules were imported since
                    self.controller, self.modules = ThreadpoolController().select(user_api="blas"), len(sys.modules)
                self.release()
                self.limit = self.controller.limit(limits=1)
            self.inside += 1

    def leave(self) -> None:
        with self.lock:
            self.inside -= 1
            if self.inside == 0:
                self.release()
                self.limit.restore_original_limits()

    def release(self) -> None:
        """Let this thread set limits: threadpoolctl 3.7 and later obey, in silence, only the one that set them first.
        """
        for library in self.controller.lib_controllers:
            getattr(library, "clear_controlling_thread", lambda force: None)(force=True)


_PROCESS = _Process()
after_fork(_PROCESS.__init__)  # other threads, which may hold the locks, do not come along to a child


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Hold BLAS at one thread, in a with statement or as a decorator; may be nested, and entered by several threads."""
    _PROCESS.enter()
    try:
        yield
    finally:
        _PROCESS.leave()


@contextmanager
def seeded() -> Iterator[None]:
    """Let what draws from numpy's global generator (pyamg) draw the same numbers always, and put the state back. One
    thread at a time; a thread of the user that draws from the global generator meanwhile is not held back."""
    with _PROCESS.random:
        state = np.random.get_state()  # noqa: NPY002
        np.random.seed(0)  # noqa: NPY002
        try:
            yield
        finally:
            np.random.set_state(state)  # noqa: NPY002
