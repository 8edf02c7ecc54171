r"""Threads of one solve: kernels over parts of their rows, and Gauss-Seidel sweeps over strips of nodes.

Kernels release the interpreter's lock, so that threads of Python run them at the same time. Parts and strips depend on
the size of the arrays and on the matrix, not on the number of threads beyond 1, so that the bits of results do not.

A :class:`Strips` cuts the nodes of a large matrix into strips, such that a node is coupled with its own strip and one
of the two next to it, never with both. All even strips may then be swept at the same time, and after them all odd ones:
no strip reads or writes what another one writes, even where a sweep scatters to neighbours. The result is that of
Gauss-Seidel over all even strips one after the other, then the odd ones. Small matrices are a single strip.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order

from adaptmg import _checks as checks

#: numbers read from which a kernel is cut into this many parts; the least number of strips that pays
LARGE, PARTS, FEWEST = 1_000_000, 16, 4


class _Threads:
    """The threads of the process, started when they are first needed."""

    def __init__(self) -> None:
        self.number, self.pool = 1, None

    def set(self, number: int) -> None:
        if self.pool is not None:
            self.pool.shutdown()
        self.number, self.pool = number, None

    def run(self, task: Callable[[], None]) -> None:
        """Do a task in all threads at the same time, this one included."""
        if self.number > 1 and self.pool is None:
            self.pool = ThreadPoolExecutor(self.number - 1, thread_name_prefix="adaptmg")
        others = [self.pool.submit(task) for _ in range(self.number - 1)]
        try:
            task()
        finally:
            for other in others:
                # one that has not begun finds nothing left to do
                if not other.cancel():
                    other.result()


_THREADS = _Threads()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_THREADS.__init__)  # threads do not come along to a child


def set_threads(threads: int) -> None:
    """Set the number of threads that a solve takes in this process, 1 unless it is set.

    More than one serve large problems: from about 40 000 nodes in 2D, 8 000 in 3D. The results have the same bits for
    any number above 1; on a uniform mesh of one body those of 1 thread too, elsewhere they agree to the tolerance. Many
    small solves are better run at the same time, by the workers of an :class:`adaptmg.Study`.

    Parameters
    ----------
    threads : int
        At least 1; more than the processors that the process may use gain nothing.

    Raises
    ------
    ValueError
        Also for more than one thread inside a dask worker that runs several tasks at the same time.

    Examples
    --------
    >>> am.set_threads(1)
    """
    threads = checks.integer("threads", threads, 1)
    if threads > 1 and _tasks_at_a_time() > 1:
        raise ValueError(f"threads must be 1 in a worker that runs {_tasks_at_a_time()} tasks at the same time, got "
                         f"{threads}: start workers with one thread each")
    _THREADS.set(threads)


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
    return _shared([(n * k // PARTS, n * (k + 1) // PARTS) for k in range(PARTS)], kernel, arguments, joined)


def sum_of_parts(kernel: Callable[..., Any], n: int, size: int, *arguments: object) -> Any:
    """The sum of what ``kernel(first, last, *arguments)`` returns for parts that do not depend on the threads."""
    found = in_parts(kernel, n, size, *arguments, joined=False)
    return found[0] if len(found) == 1 else np.sum(found, axis=0)


def _shared(ranges: Sequence[tuple[int, int]], kernel: Callable[..., Any], arguments: tuple[object, ...],
            joined: bool = False) -> list[Any]:
    """Results for the ranges, which may be ``joined``, those of each thread to one, if they follow one another."""
    if joined and len(ranges) > 1:
        count = min(_THREADS.number, len(ranges))
        ends = [len(ranges) * k // count for k in range(count + 1)]
        ranges = [(ranges[first][0], ranges[last - 1][1]) for first, last in pairwise(ends)]
    if len(ranges) == 1 or _THREADS.number == 1:
        return [kernel(first, last, *arguments) for first, last in ranges]
    results, left = [None] * len(ranges), iter(range(len(ranges)))

    def work() -> None:
        for k in left:
            results[k] = kernel(*ranges[k], *arguments)

    _THREADS.run(work)
    return results


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


def in_colours(colours: list[list[tuple[int, int]]], kernel: Callable[..., Any], *arguments: object) -> list[Any]:
    """What ``kernel(first, last, *arguments)`` returns for the ranges, one colour after the other."""
    return [value for ranges in colours for value in _shared(ranges, kernel, arguments)]


def product(matrix: sparse.bsr_array, vector: np.ndarray, of: Callable[[Any], Any] | None = None) -> np.ndarray:
    """A v (n,), or f(A) v with ``of`` the function f of the rows of A."""
    if matrix.data.size < LARGE:
        return (matrix if of is None else of(matrix)) @ vector
    dim, result = matrix.blocksize[0], np.empty(matrix.shape[0])

    def multiply(first: int, last: int) -> None:
        begin, end = matrix.indptr[first], matrix.indptr[last]
        blocks = matrix.data[begin:end], matrix.indices[begin:end], matrix.indptr[first:last + 1] - begin
        rows = sparse.bsr_array(blocks, shape=(dim * (last - first), matrix.shape[1]))
        result[dim * first:dim * last] = (rows if of is None else of(rows)) @ vector

    in_parts(multiply, len(matrix.indptr) - 1, matrix.data.size)
    return result


@dataclass(frozen=True, eq=False)
class Strips:
    """Nodes in the order of a forward sweep."""

    order: np.ndarray  # (n_nodes,) int32: even strips, then odd ones
    rank: np.ndarray  # (n_nodes,) int32: the place of a node in this order
    colours: list[list[tuple[int, int]]]  # ranges of places that are swept at the same time

    @classmethod
    def of(cls, indptr: np.ndarray, indices: np.ndarray, block: int, stored: bool = True) -> Strips:
        """The strips of a matrix with a symmetric pattern, sorted columns, and ``block`` entries a block. Where numbers
        have little to do with places, strips go by distance in the graph: sweeps then jump in memory, by a third slower
        even if rows are ``stored`` in their order, so that one thread does without."""
        n = len(indptr) - 1
        own = np.arange(n, dtype=np.int32)
        if block * len(indices) < LARGE:
            return cls(own, own, [[(0, n)]])
        order, bounds = own, _bounds(indices[indptr[1:] - 1])
        if len(bounds) <= FEWEST and stored and _THREADS.number > 1:
            order = _by_distance(indptr, indices)
            place = np.empty_like(order)
            place[order] = own
            bounds = _bounds(np.maximum.reduceat(place[indices], indptr[:-1])[order])
        if len(bounds) <= FEWEST:
            return cls(own, own, [[(0, n)]])
        # in a strip in the order of the numbers: neighbours in memory
        strips = [np.sort(order[first:last]) for first, last in pairwise(bounds)]
        parts = [*strips[::2], *strips[1::2]]
        ends = np.cumsum([0, *map(len, parts)]).tolist()
        ranges, even = list(pairwise(ends)), len(strips[::2])
        order, rank = np.concatenate(parts), np.empty_like(own)
        rank[order] = own
        return cls(order, rank, [ranges[:even], ranges[even:]])

    def sweep(self, kernel: Callable[..., Any], *arguments: object, backward: bool = False) -> None:
        """Call ``kernel(first, last, order, *arguments)``, which sweeps over these places, for all strips."""
        if len(self.colours) == 1:  # quick for small matrices
            kernel(0, len(self.order), self.order, *arguments)
            return
        for ranges in self.colours[::-1] if backward else self.colours:
            _shared(ranges, kernel, (self.order, *arguments), joined=True)


def _bounds(last: np.ndarray) -> list[int]:
    """Where strips begin and end: ``last`` (n,) is the place of the last neighbour of a node at each place."""
    n = len(last)
    reach = np.append(0, np.maximum.accumulate(last) + 1)  # the places before this one are not coupled beyond it
    bounds = [0]
    while bounds[-1] < n:
        two_layers = int(reach[reach[bounds[-1]]])
        bounds.append(min(max(two_layers, bounds[-1] + -(-n // (2 * PARTS))), n))
    return bounds


def _by_distance(indptr: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Nodes by their distance from one of them in the graph of a matrix, part by part where it falls apart."""
    n = len(indptr) - 1
    graph = sparse.csr_array((np.ones(len(indices), dtype=np.int8), indices, indptr), shape=(n, n))
    new, found = np.ones(n, dtype=bool), []
    while new.any():
        found.append(breadth_first_order(graph, int(np.argmax(new)), return_predecessors=False))
        new[found[-1]] = False
    return np.concatenate(found).astype(np.int32)
