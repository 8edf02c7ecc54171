r"""Threads of one solve: kernels over parts of their rows, and Gauss-Seidel sweeps over strips of nodes.

Kernels release the interpreter's lock, so that threads of Python run them at the same time. Parts and strips depend on
the size of the arrays and on the matrix, not on the number of threads beyond 1, so that the bits of results do not.

A :class:`Strips` cuts the nodes of a large matrix into strips, such that a node is coupled with its own strip and one
of the two next to it, never with both. All even strips may then be swept at the same time, and after them all odd ones:
no strip reads or writes what another one writes, even where a sweep scatters to neighbours. The result is that of
Gauss-Seidel over all even strips one after the other, then the odd ones. Small matrices are a single strip.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import pairwise
from threading import Event
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order

from adaptmg import _checks as checks
from adaptmg._machine import after_fork
from adaptmg._numba import kernel, read_only

#: numbers read from which a kernel is cut into this many parts; the least number of strips that pays
LARGE, PARTS, FEWEST = 1_000_000, 16, 4
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


def product(matrix: sparse.bsr_array, vector: np.ndarray) -> np.ndarray:
    """A v (n,), summed as scipy does."""
    arrays = map(read_only, (matrix.indptr, matrix.indices, matrix.data.reshape(-1)))
    result = np.empty(matrix.shape[0])
    in_parts(_multiply, len(matrix.indptr) - 1, matrix.data.size, (0.0,) * matrix.blocksize[0], *arrays, vector, result)
    return result


@kernel
def _multiply(first, last, zero, indptr, indices, data, v, result):
    dim = len(zero)
    for i in range(first, last):
        for a in range(dim):
            total = 0.0
            for k in range(indptr[i], indptr[i + 1]):
                for b in range(dim):
                    total += data[dim * (dim * k + a) + b] * v[dim * indices[k] + b]
            result[dim * i + a] = total


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
        strips = [order[first:last] for first, last in pairwise(bounds)]
        if order is not own:
            # in a strip in the order of the numbers: neighbours in memory
            strips = list(map(np.sort, strips))
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
        in_colours(self.colours[::-1] if backward else self.colours, kernel, self.order, *arguments, joined=True)


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
    new, layers = np.ones(n, dtype=bool), []
    while new.any():
        layers.append(breadth_first_order(graph, int(np.argmax(new)), return_predecessors=False))
        new[layers[-1]] = False
    return np.concatenate(layers).astype(np.int32)
