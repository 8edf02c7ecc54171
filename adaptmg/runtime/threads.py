"""One BLAS thread around what the package does, and a fixed seed around libraries that draw random numbers.

Sums over two BLAS threads differ in the last digits from those over one, and small dense factorisations lose more to
starting threads than they gain. The number of BLAS threads belongs to the whole process: the first to enter sets it,
the last to leave gives it back, whichever thread they are in.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

__all__ = ["one_blas_thread", "seeded"]


class _Blas:
    """The BLAS libraries of the process, and how many are inside :func:`one_blas_thread`."""

    def __init__(self) -> None:
        self.controller: Any = None
        self.modules = -1
        self.renew()

    def renew(self) -> None:
        """Nobody is inside."""
        self.lock, self.inside = threading.RLock(), 0
        self.before: list[tuple[Any, int]] = []
        self.here = threading.local()

    def enter(self) -> None:
        with self.lock:
            self.here.inside = getattr(self.here, "inside", 0) + 1
            if self.here.inside == 1:
                # built on OpenMP a library counts its threads for each calling thread
                self.here.before = _limit([library for library in self._found() if _by_thread(library)])
            if self.inside == 0:
                self.before = _limit([library for library in self._found() if not _by_thread(library)])
            self.inside += 1

    def leave(self) -> None:
        with self.lock:
            self.here.inside -= 1
            self.inside -= 1
            if self.here.inside == 0:
                _give_back(self.here.before)
            if self.inside == 0:
                _give_back(self.before)

    def _found(self) -> list[Any]:
        """The libraries loaded by now: looked for again (some ms) when modules were imported since."""
        # imported late, inside the block, it would bring a BLAS of its own that nobody limits
        import scipy.linalg  # noqa: F401
        from threadpoolctl import ThreadpoolController

        if self.modules != len(sys.modules):
            self.controller, self.modules = ThreadpoolController(), len(sys.modules)
        return [library for library in self.controller.lib_controllers if library.user_api == "blas"]


def _by_thread(library: Any) -> bool:
    return getattr(library, "threading_layer", "") == "openmp"


def _limit(libraries: list[Any]) -> list[tuple[Any, int]]:
    before = [(library, library.get_num_threads()) for library in libraries]
    for library, _ in before:
        _set(library, 1)
    return before


def _give_back(before: list[tuple[Any, int]]) -> None:
    for library, threads in before:
        _set(library, threads)


def _set(library: Any, threads: int) -> None:
    """Set the number, whichever thread of Python set it before."""
    # threadpoolctl 3.7 and later obey, in silence, only the thread that was first to set it
    release = getattr(library, "clear_controlling_thread", lambda force: None)
    release(force=True)
    library.set_num_threads(threads)
    release(force=True)


_BLAS = _Blas()
_RANDOM = threading.RLock()


def _after_fork() -> None:
    """Locks that other threads held, and their being inside, do not come along to a child."""
    global _RANDOM
    _RANDOM, before = threading.RLock(), _BLAS.before if _BLAS.inside else []
    _BLAS.renew()
    _give_back(before)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Hold BLAS at one thread, in a with statement or as a decorator; may be nested, and entered by several threads."""
    _BLAS.enter()
    try:
        yield
    finally:
        _BLAS.leave()


@contextmanager
def seeded() -> Iterator[None]:
    """Let what draws from numpy's global generator (pyamg) draw the same numbers always, and put the state back.

    One thread at a time; a thread of the user that draws from the global generator meanwhile is not held back.
    """
    with _RANDOM:
        state = np.random.get_state()  # noqa: NPY002
        np.random.seed(0)  # noqa: NPY002
        try:
            yield
        finally:
            np.random.set_state(state)  # noqa: NPY002
