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
        self.lock, self.inside, self.limits = threading.RLock(), 0, None
        self.controller: Any = None
        self.modules = -1

    def enter(self) -> None:
        with self.lock:
            if self.inside == 0:
                self.limits = self._found().limit(limits=1, user_api="blas")
            self.inside += 1

    def leave(self) -> None:
        with self.lock:
            self.inside -= 1
            if self.inside == 0:
                limits, self.limits = self.limits, None
                limits.restore_original_limits()

    def _found(self) -> Any:
        """The libraries loaded by now: looked for again (some ms) when modules were imported since."""
        # imported late, inside the block, it would bring a BLAS of its own that nobody limits
        import scipy.linalg  # noqa: F401
        from threadpoolctl import ThreadpoolController

        if self.modules != len(sys.modules):
            self.controller, self.modules = ThreadpoolController(), len(sys.modules)
        return self.controller


_BLAS = _Blas()
_RANDOM = threading.RLock()


def _after_fork() -> None:
    """Locks that other threads held, and their being inside, do not come along to a child."""
    global _RANDOM
    _RANDOM, limits = threading.RLock(), _BLAS.limits
    _BLAS.lock, _BLAS.inside, _BLAS.limits = threading.RLock(), 0, None
    if limits is not None:
        limits.restore_original_limits()


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
