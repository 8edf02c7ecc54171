"""Threads of one solve: kernels over parts of their rows, and over ranges of one colour after the other.

Kernels release the interpreter's lock, so that threads of Python run them at the same time. Parts and ranges depend on
the size of the arrays, not on the number of threads beyond 1, so that the bits of results do not.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from itertools import pairwise
from threading import Event
from typing import Any

import numpy as np

from adaptmg import _checks as checks
from adaptmg._machine import after_fork

#: numbers read from which a kernel is cut into this many parts
LARGE, PARTS = 1_000_000, 16
_MOST = 1024  # threads; a million would take minutes to start


class _Threads:
    """The threads of the process: the one that calls, and those of a pool."""

    def __init__(self, number: int = 1) -> None:
        self.number, self.pool = number, ThreadPoolExecutor(number - 1, "adaptmg") if number > 1 else None

    def run(self, work: Callable[[], None]) -> None:
        """Do the work in all threads at the same time, this one included; those that did not begin are not awaited."""
        others = [self.pool.submit(work) for _ in range(self.number - 1)]
        try:
            work()
        finally:
            others = [other for other in others if not other.cancel()]
            wait(others)
        for other in others:
            other.result()


_THREADS = _Threads()
after_fork(_THREADS.__init__)  # threads do not come along to a child


def set_threads(threads: int) -> None:
    """Set the number of threads that a solve takes in this process, 1 unless it is set.

    More than one serve large problems: from about 40 000 nodes in 2D, 8 000 in 3D. The results have the same bits for
    any number above 1; on a uniform mesh of one body those of 1 thread too, elsewhere they agree to the tolerance. Many
    small solves are better run at the same time, by the workers of an :class:`adaptmg.Study`.

    Parameters
    ----------
    threads : int
        1 to 1024; more than the processors that the process may use gain nothing.

    Raises
    ------
    ValueError
        Also for more than one thread inside a dask worker that runs several tasks at the same time.

    Examples
    --------
    >>> am.set_threads(1)
    """
    threads = checks.integer("threads", threads, 1, _MOST)
    if threads > 1 and _tasks_at_a_time() > 1:
        raise ValueError(f"threads must be 1 in a worker that runs {_tasks_at_a_time()} tasks at the same time, got "
                         f"{threads}: start workers with one thread each")
    if _THREADS.pool is not None:
        _THREADS.pool.shutdown(wait=False)
    _THREADS.__init__(threads)


def several() -> bool:
    """Whether a solve takes more than one thread."""
    return _THREADS.number > 1


def _tasks_at_a_time() -> int:
    """Threads of the dask worker that runs this code; 1 outside of workers."""
    distributed = sys.modules.get("distributed")
    try:
        return 1 if distributed is None else distributed.get_worker().state.nthreads
    except ValueError:  # not a worker
        return 1


def in_parts(kernel: Callable[..., Any], n: int, size: int, *arguments: object, joined: bool = True) -> list[Any]:
    """What ``kernel(first, last, *arguments)`` returns for parts of n rows: one unless they read LARGE numbers
    (``size``) together, else one a thread, or PARTS if they are not ``joined``, as where a row depends on others."""
    if size < LARGE:
        return [kernel(0, n, *arguments)]
    ranges = [(n * k // PARTS, n * (k + 1) // PARTS) for k in range(PARTS)]
    return in_colours([ranges], kernel, *arguments, joined=joined)


def sum_of_parts(kernel: Callable[..., Any], n: int, size: int, *arguments: object) -> Any:
    """The sum of what ``kernel(first, last, *arguments)`` returns for parts that do not depend on the threads."""
    parts = in_parts(kernel, n, size, *arguments, joined=False)
    return parts[0] if len(parts) == 1 else np.sum(parts, axis=0)


def in_colours(colours: Sequence[Sequence[tuple[int, int]]], kernel: Callable[..., Any], *arguments: object,
               joined: bool = False) -> list[Any]:
    """What ``kernel(first, last, *arguments)`` returns for the ranges, one colour after the other. Ranges of a colour
    may be ``joined``, those of each thread to one, if they follow one another."""
    number = _THREADS.number
    if joined:
        colours = [_joined(ranges, number) for ranges in colours]
    places = [(stage, each) for stage, ranges in enumerate(colours) for each in ranges]
    if number == 1 or len(places) == len(colours):
        return [kernel(*each, *arguments) for _, each in places]
    results, left = [None] * len(places), iter(range(len(places)))
    done, over = [[] for _ in colours], [Event() for _ in colours]

    def work() -> None:
        for k in left:
            stage, each = places[k]
            if stage:
                over[stage - 1].wait()
            try:
                results[k] = kernel(*each, *arguments)
            finally:
                done[stage].append(k)
                if len(done[stage]) == len(colours[stage]):
                    over[stage].set()

    _THREADS.run(work)
    return results


def _joined(ranges: Sequence[tuple[int, int]], number: int) -> list[tuple[int, int]]:
    count = min(number, len(ranges))
    ends = [len(ranges) * k // count for k in range(count + 1)]
    return [(ranges[first][0], ranges[last - 1][1]) for first, last in pairwise(ends)]


def scattering(columns: np.ndarray, starts: np.ndarray | None = None, size: int = 0) -> list[list[tuple[int, int]]]:
    """Ranges of rows in two colours: those of a colour write to different ``columns``, given row by row (row k from
    ``starts[k]`` on, or all rows are as long). One range if they read few numbers (``size``), or where the order of
    rows and columns has little to do with each other."""
    if starts is None:
        starts = np.arange(len(columns) + 1) * columns.shape[1]
    n, flat = len(starts) - 1, columns.reshape(-1)
    bounds = [n * k // PARTS for k in range(PARTS + 1)]
    if size >= LARGE and (np.diff(starts[bounds]) > 0).all():
        at = starts[bounds[:-1]]
        least, most = np.minimum.reduceat(flat, at), np.maximum.reduceat(flat, at)
        if (most[:-2] < least[2:]).all():
            ranges = list(pairwise(bounds))
            return [ranges[::2], ranges[1::2]]
    return [[(0, n)]]
