"""Threads of a solve over parts of the rows of its kernels, one thread of BLAS, and the same random
numbers always.

Kernels release the interpreter's lock, so that threads of Python run them at the same time. Parts
and ranges depend on the size of the arrays, not on the number of threads beyond 1, so that the bits
of results do not. Sums of BLAS over two threads would differ in the last digits, and small dense
factorisations lose more to starting threads than they gain."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import lru_cache
from itertools import pairwise
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np

from adaptmg import _checks as checks

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController, _ThreadpoolLimiter

#: numbers that a kernel reads at least to be cut into parts, and the number of these parts
LARGE = 1_000_000
PARTS = 16


class _Threads:
    """The threads of the process: the one that calls, and those of a pool."""

    def __init__(self, number: int = 1) -> None:
        self.number = number
        self.pool = ThreadPoolExecutor(number - 1, "adaptmg") if number > 1 else None

    def map(
        self, kernel: Callable, ranges: Sequence[tuple[int, int]], arguments: Sequence[object]
    ) -> list:
        """Return what ``kernel(first, last, *arguments)`` returns for each range. All threads, this
        one included, take one range after the other; threads that have not begun when none is left
        are not awaited."""
        if self.pool is None:
            return [kernel(first, last, *arguments) for first, last in ranges]
        results: list = [None] * len(ranges)
        numbers = iter(range(len(ranges)))  # shared by the threads: each number goes to one of them

        def work() -> None:
            for k in numbers:
                results[k] = kernel(*ranges[k], *arguments)

        tasks = [self.pool.submit(work) for _ in range(min(self.number, len(ranges)) - 1)]
        try:
            work()
        finally:
            tasks = [task for task in tasks if not task.cancel()]
            wait(tasks)
        for task in tasks:
            task.result()
        return results


_THREADS = _Threads()


def set_threads(threads: int) -> None:
    """Set the number of threads that a solve takes in this process, 1 unless it is set.

    More than one serve large problems: from about 40 000 nodes in 2D, 8 000 in 3D. The results have
    the same bits for any number above 1; on a uniform mesh of one body those of 1 thread too,
    elsewhere they agree to the tolerance. Many small solves are better run at the same time, by the
    workers of an :class:`adaptmg.Study`.

    Parameters
    ----------
    threads : int
        1 to 1024; more than the processors that the process may use gain nothing. In a worker that
        runs several tasks at the same time leave it at 1.

    Examples
    --------
    >>> am.set_threads(1)
    """
    if checks.integer("threads", threads, 1, 1024) != _THREADS.number:
        _THREADS.__init__(threads)


def several() -> bool:
    """Return whether a solve takes more than one thread."""
    return _THREADS.number > 1


def in_parts(kernel: Callable, n: int, size: int, *arguments: object, joined: bool = True) -> list:
    """Return what ``kernel(first, last, *arguments)`` returns for each part of n rows. There is one part
    if all rows together read fewer than LARGE numbers (``size``), else one for each thread, or PARTS
    if they are not ``joined``, as where a row depends on others."""
    if size < LARGE:
        return [kernel(0, n, *arguments)]
    ranges = [(n * k // PARTS, n * (k + 1) // PARTS) for k in range(PARTS)]
    return in_colours([ranges], kernel, *arguments, joined=joined)


def sum_of_parts(kernel: Callable, n: int, size: int, *arguments: object) -> float | np.ndarray:
    """Return the sum of what ``kernel(first, last, *arguments)`` returns for parts of its n rows. How
    many there are follows from ``size``, the numbers that all rows read, and not from the threads."""
    parts = in_parts(kernel, n, size, *arguments, joined=False)
    return parts[0] if len(parts) == 1 else np.sum(parts, axis=0)


def in_colours(
    colours: Sequence[Sequence[tuple[int, int]]],
    kernel: Callable,
    *arguments: object,
    joined: bool = False,
) -> list:
    """Return what ``kernel(first, last, *arguments)`` returns for the ranges, one colour after the
    other. Ranges of a colour that follow one another may be ``joined`` to one for each thread."""
    results: list = []
    for ranges in colours:
        parts = _joined(ranges, _THREADS.number) if joined else ranges
        results += _THREADS.map(kernel, parts, arguments)
    return results


def _joined(ranges: Sequence[tuple[int, int]], number: int) -> list[tuple[int, int]]:
    """Return ranges that follow one another, joined to at most ``number``."""
    count = min(number, len(ranges))
    ends = [len(ranges) * k // count for k in range(count + 1)]
    return [(ranges[first][0], ranges[last - 1][1]) for first, last in pairwise(ends)]


def scattering(
    columns: np.ndarray, starts: np.ndarray | None = None, size: int = 0
) -> list[list[tuple[int, int]]]:
    """Return ranges of rows in two colours; no two ranges of a colour write to the same column.

    Row k writes to ``columns[starts[k] : starts[k + 1]]``, with ``starts`` (n + 1,) of n rows; without
    it to the row ``columns[k]`` of a table (n, length). Return one range if the rows read few numbers
    (``size``), or if ranges that are not neighbours share columns."""
    offsets: np.ndarray = (
        np.arange(len(columns) + 1) * columns.shape[1] if starts is None else starts
    )
    n = len(offsets) - 1
    flat = columns.reshape(-1)
    bounds = [n * k // PARTS for k in range(PARTS + 1)]
    # reduceat needs ranges that are not empty
    if size >= LARGE and (np.diff(offsets[bounds]) > 0).all():
        begins = offsets[bounds[:-1]]
        first_column = np.minimum.reduceat(flat, begins)
        last_column = np.maximum.reduceat(flat, begins)
        # ranges k, k + 2, k + 4, ... have one colour: the last column of each lies before the first
        # column of the next one
        if (last_column[:-2] < first_column[2:]).all():
            ranges = list(pairwise(bounds))
            return [ranges[::2], ranges[1::2]]
    return [[(0, n)]]


class _Blas:
    """The limit of BLAS, set by the first thread of Python to enter, and lifted by the last to
    leave: threadpoolctl's own ends with the thread that set it."""

    # set where the first thread enters
    libraries: ThreadpoolController
    limit: _ThreadpoolLimiter

    def __init__(self) -> None:
        self.lock = RLock()
        self.inside = 0

    def enter(self) -> None:
        """Hold BLAS at one thread, unless a thread of Python does so already."""
        # imported inside the block scipy would bring another BLAS without a limit
        import scipy.linalg  # noqa: F401

        with self.lock:
            if self.inside == 0:
                self.libraries = _libraries(len(sys.modules))
                self.release()
                self.limit = self.libraries.limit(limits=1)
            self.inside += 1

    def leave(self) -> None:
        """Lift the limit, unless another thread of Python still needs it."""
        with self.lock:
            self.inside -= 1
            if self.inside == 0:
                self.release()
                self.limit.restore_original_limits()

    def release(self) -> None:
        """Let this thread set limits: threadpoolctl 3.7 and later obey, in silence, only the one
        that set them first."""
        for library in self.libraries.lib_controllers:
            getattr(library, "clear_controlling_thread", lambda force: None)(force=True)


@lru_cache(maxsize=1)
def _libraries(_modules: int) -> ThreadpoolController:
    """Return the libraries of BLAS. A search takes some ms: it is repeated only where the number of
    modules has changed."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


_BLAS = _Blas()
_RANDOM = RLock()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Hold BLAS at one thread, in a with statement or as a decorator; may be nested, and entered by
    several threads."""
    _BLAS.enter()
    try:
        yield
    finally:
        _BLAS.leave()


@contextmanager
def seeded() -> Iterator[None]:
    """Let what draws from numpy's global generator (pyamg) draw the same numbers always, and put
    the state back. One thread at a time; a thread of the user that draws from the global generator
    meanwhile is not held back."""
    with _RANDOM:
        state = np.random.get_state()  # noqa: NPY002
        np.random.seed(0)  # noqa: NPY002
        try:
            yield
        finally:
            np.random.set_state(state)  # noqa: NPY002


def _in_a_child() -> None:
    """Renew pool and locks in a forked process, which has none of the threads that may hold them."""
    global _RANDOM
    _RANDOM = RLock()
    _THREADS.__init__()
    _BLAS.__init__()


if hasattr(os, "register_at_fork"):  # Windows does not fork
    os.register_at_fork(after_in_child=_in_a_child)
