r"""Aggregates: groups of neighbouring nodes whose rigid motions represent what is smooth in an error.

They follow the graph of the matrix, not space: two arms that nearly touch share none, nor do two bodies, nor the slave
nodes (whose displacement is relative) and the rest. With B the rigid motions of each aggregate about its centre, each
node projected onto what a contact status lets move, the coarse matrix is :math:`B^T (A + S) B`.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg.lapack import dpbtrf, dpbtrs
from scipy.sparse.csgraph import reverse_cuthill_mckee

from adaptmg._numba import kernel
from adaptmg._threads import in_parts
from adaptmg.discrete.problem import DiscreteProblem, remembered_of_structure
from adaptmg.smoother.blocks import ZERO, add, in_loop, increase, inner, read, scale, subtract, times, write

#: nodes of an aggregate and its depth in the graph, by dimension
_SIZE = {2: (64, 4), 3: (80, 3)}
#: beyond this number of nodes, by dimension: least nodes of an aggregate, and about the most aggregates, which bound
#: the cost of the coarse matrix
_MANY, _LARGE, _MOST = {2: 40_000, 3: 24_000}, 100, {2: 1800, 3: 300}
#: aggregates below this share of their size join a neighbour
_REMNANT = 8
#: neighbours of an aggregate for which there is room at first
_ROOM = 16
#: of the diagonal, added to it: a status may take motions from an aggregate
_SHIFT = 1e-10


@kernel
def _grow(indptr, indices, group, sizes, most_deep, label, queue, depth):
    """Number the aggregates in ``label`` by breadth-first search inside groups; returns their number. ``queue`` and
    ``depth`` (n_nodes,) are overwritten."""
    n, count = len(group), 0
    for seed in range(n):
        if label[seed] >= 0 or group[seed] < 0:
            continue
        size = sizes[group[seed]]
        queue[0], label[seed], depth[seed] = seed, count, 0
        head, tail = 0, 1
        while head < tail:  # each node enters the queue once
            i = queue[head]
            head += 1
            if depth[i] == most_deep:
                continue
            for p in range(indptr[i], indptr[i + 1]):
                j = indices[p]
                if tail < size and label[j] < 0 and group[j] == group[seed]:
                    label[j], depth[j], queue[tail] = count, depth[i] + 1, j
                    tail += 1
        count += 1
    return count


@kernel
def _join(indptr, indices, group, sizes, remnant, label, members, of, best):
    """Remnants join their smallest neighbour; returns the number of aggregates left, numbered again. ``members``,
    ``of`` and ``best`` (n_aggregates,) come as 0, 0 and -1."""
    n, count = len(label), len(best)
    for i in range(n):
        if label[i] >= 0:
            members[label[i]] += 1
            of[label[i]] = group[i]
    for i in range(n):
        if label[i] < 0 or remnant * members[label[i]] >= sizes[group[i]]:
            continue
        for p in range(indptr[i], indptr[i + 1]):
            other = label[indices[p]]
            if other < 0 or other == label[i] or of[other] != group[i]:
                continue
            if remnant * members[other] >= sizes[group[i]] and (
                    best[label[i]] < 0 or members[other] < members[best[label[i]]]):
                best[label[i]] = other
    left = 0
    for a in range(count):
        if best[a] < 0:
            of[a] = left
            left += 1
    for i in range(n):
        if label[i] >= 0:
            home = best[label[i]]
            label[i] = of[home] if home >= 0 else of[label[i]]
    return left


@kernel
def _arrange(label, points, count, order, starts, ends, offset):
    """Nodes by aggregate, and their places from its centre over its extent (root of the mean square). ``starts``
    (count + 1,) comes as 0; ``ends`` (count,) is overwritten."""
    for i in range(len(label)):
        if label[i] >= 0:
            starts[label[i] + 1] += 1
    for a in range(count):
        starts[a + 1] += starts[a]
        ends[a] = starts[a]
    for i in range(len(label)):
        if label[i] >= 0:
            order[ends[label[i]]] = i
            ends[label[i]] += 1
    if len(points) == 0:
        return
    for a in range(count):
        begin, end, square = starts[a], starts[a + 1], 0.0
        for k in range(points.shape[1]):
            centre = 0.0
            for place in range(begin, end):
                centre += points[order[place], k]
            centre /= end - begin
            for place in range(begin, end):
                i = order[place]
                offset[i, k] = points[i, k] - centre
                square += offset[i, k] ** 2
        extent = np.sqrt(square / (end - begin))
        if extent > 0:
            for place in range(begin, end):
                for k in range(points.shape[1]):
                    offset[order[place], k] /= extent


@kernel
def _pattern(indptr, indices, label, order, starts, coarse_indptr, seen, coarse_indices):
    """Aggregates J met from rows i <= j of each aggregate I, as rows of a matrix; returns their number, which may be
    more than ``coarse_indices`` holds. ``seen`` (n_aggregates,) comes as -1."""
    count = 0
    for a in range(len(starts) - 1):
        seen[a] = a
        if count < len(coarse_indices):
            coarse_indices[count] = a
        count += 1
        for q in range(starts[a], starts[a + 1]):
            i = order[q]
            for p in range(indptr[i], indptr[i + 1]):
                b = label[indices[p]]
                if indices[p] > i and b >= 0 and seen[b] != a:
                    seen[b] = a
                    if count < len(coarse_indices):
                        coarse_indices[count] = b
                    count += 1
        coarse_indptr[a + 1] = count
    return count


class Aggregates:
    """The aggregates of a problem: they depend on mesh, bodies and supports, not on the contact status."""

    def __init__(self, problem: DiscreteProblem) -> None:
        matrix, dim, n = problem.matrix, problem.dim, problem.n_nodes
        group = np.zeros(n, dtype=np.int32)
        for k, nodes in enumerate((problem.bodies or {}).values()):
            group[nodes] = k
        bodies = int(group.max()) + 1
        if problem.coupling is not None:
            group[problem.contact.nodes] += bodies
        group[np.logical_and.reduce([problem.fixed[k::dim] for k in range(dim)])] = -1
        size, depth = _SIZE[dim]
        if n > _MANY[dim]:
            size = max(_LARGE, n // _MOST[dim])
            depth = round(0.9 * size ** (1 / dim))
        sizes = np.repeat([size, round(size ** ((dim - 1) / dim))], bodies)
        self.label = np.full(n, -1, dtype=np.int32)
        count = _grow(matrix.indptr, matrix.indices, group, sizes, depth, self.label,
                      *np.empty((2, n), dtype=np.int32))
        count = _join(matrix.indptr, matrix.indices, group, sizes, _REMNANT, self.label,
                      np.zeros(count, dtype=np.int32), np.zeros(count, dtype=np.int32), np.full(count, -1))
        self.order, self.starts = np.empty(n, dtype=np.int32), np.zeros(count + 1, dtype=np.int32)
        self.offset = np.zeros((n, dim))
        points = np.empty((0, dim)) if problem.coordinates is None else problem.coordinates
        _arrange(self.label, points, count, self.order, self.starts, np.empty(count, dtype=np.int32), self.offset)
        self.indptr = np.zeros(count + 1, dtype=np.int32)
        given = matrix.indptr, matrix.indices, self.label, self.order, self.starts, self.indptr
        self.indices = np.empty(_ROOM * count, dtype=np.int32)
        while (found := _pattern(*given, np.full(count, -1), self.indices)) > len(self.indices):
            self.indices = np.empty(found, dtype=np.int32)
        self.indices = self.indices[:found].copy()
        self._number_entries(count, 3 * dim - 3)

    def _number_entries(self, count: int, modes: int) -> None:
        """Order the unknowns so that the coarse matrix has a narrow band, and number the entries in it."""
        graph = sparse.csr_array((np.ones(len(self.indices), dtype=np.int8), self.indices, self.indptr),
                                 shape=(count, count))
        order = reverse_cuthill_mckee(graph) if count else np.empty(0, dtype=np.int32)
        place = np.empty(count, dtype=np.int64)
        place[order] = modes * np.arange(count)
        within = np.arange(modes)
        self.unknowns = (modes * order.astype(np.int64)[:, None] + within).reshape(-1)
        row = place[np.repeat(np.arange(count), np.diff(self.indptr))][:, None, None] + within[:, None]
        column = place[self.indices][:, None, None] + within
        below = np.abs(row - column)
        self.band = int(below.max(initial=0)) + 1
        # column by column, as LAPACK has it
        self.entries = (below + self.band * np.minimum(row, column)).reshape(-1)


aggregates_of = remembered_of_structure(Aggregates)


@in_loop
def _motion(q, x):
    """Rigid motion q at a place: translations, then rotations."""
    if len(x) == 2:
        if q == 0:
            return 1.0, 0.0
        if q == 1:
            return 0.0, 1.0
        return -x[1], x[0]
    if q == 0:
        return 1.0, 0.0, 0.0
    if q == 1:
        return 0.0, 1.0, 0.0
    if q == 2:
        return 0.0, 0.0, 1.0
    if q == 3:
        return 0.0, -x[2], x[1]
    if q == 4:
        return x[2], 0.0, -x[0]
    return -x[1], x[0], 0.0


@in_loop
def _moved(q, i, zero, offset, held, kept):
    """Motion q of the aggregate of node i there, projected."""
    dim = np.uint64(len(zero))
    v = _motion(q, read(offset, dim * np.uint64(i), zero))
    if held[i] >= 0:
        return times(kept, dim * dim * np.uint64(held[i]), v)
    return v


@in_loop
def _column(blocks, at, like):
    """A column of a block, from the position of its first entry on."""
    dim = np.uint64(len(like))
    if len(like) == 2:
        return blocks[at], blocks[at + dim]
    return blocks[at], blocks[at + dim], blocks[at + dim + dim]


@in_loop
def _across(y, v, z, w):
    return subtract(scale(y, v), scale(z, w))


@in_loop
def _add_forces(blocks, at, i, zero, offset, held, kept, forces):
    """Forces (modes x dim) += the block at a position times the motions of the aggregate of node i there."""
    dim, modes = np.uint64(len(zero)), 3 * len(zero) - 3
    x = read(offset, dim * np.uint64(i), zero)
    if held[i] >= 0:
        for q in range(modes):
            increase(forces, dim * np.uint64(q), times(blocks, at, _moved(q, i, zero, offset, held, kept)))
        return
    first, second = _column(blocks, at, zero), _column(blocks, at + np.uint64(1), zero)
    increase(forces, np.uint64(0), first)
    increase(forces, dim, second)
    if len(zero) == 2:
        increase(forces, np.uint64(4), _across(x[0], second, x[1], first))
    else:
        third = _column(blocks, at + np.uint64(2), zero)
        increase(forces, np.uint64(6), third)
        increase(forces, np.uint64(9), _across(x[1], third, x[2], second))
        increase(forces, np.uint64(12), _across(x[2], first, x[0], third))
        increase(forces, np.uint64(15), _across(x[0], second, x[1], first))


@in_loop
def _collect(forces, i, zero, offset, held, kept, coarse):
    """Coarse (modes, modes) += the work of forces at node i by the motions of its aggregate; forces become zero."""
    dim, modes = np.uint64(len(zero)), 3 * len(zero) - 3
    x = read(offset, dim * np.uint64(i), zero)
    for q in range(modes):
        f = read(forces, dim * np.uint64(q), zero)
        write(forces, dim * np.uint64(q), zero)
        if held[i] >= 0:
            for k in range(modes):
                coarse[k, q] += inner(_moved(k, i, zero, offset, held, kept), f)
            continue
        coarse[0, q] += f[0]
        coarse[1, q] += f[1]
        if len(zero) == 2:
            coarse[2, q] += x[0] * f[1] - x[1] * f[0]
        else:
            coarse[2, q] += f[2]
            coarse[3, q] += x[1] * f[2] - x[2] * f[1]
            coarse[4, q] += x[2] * f[0] - x[0] * f[2]
            coarse[5, q] += x[0] * f[1] - x[1] * f[0]


@kernel
def _galerkin(first, last, zero, indptr, indices, data, diagonal, held, kept, offset, label, order, starts,
              coarse_indptr, coarse_indices, coarse):
    """coarse += half of B' (A + S) B: the other half is its transpose. ``diagonal`` are the blocks of A + S."""
    size, modes = np.uint64(len(zero) * len(zero)), 3 * len(zero) - 3
    slot, forces = np.empty(len(starts) - 1, dtype=np.int32), np.zeros(modes * len(zero))
    for a in range(first, last):
        for s in range(coarse_indptr[a], coarse_indptr[a + 1]):
            slot[coarse_indices[s]] = s
        for place in range(starts[a], starts[a + 1]):
            i, met = np.int64(order[place]), a
            _add_forces(diagonal, size * np.uint64(i), i, zero, offset, held, kept, forces)
            for k in range(len(forces)):
                forces[k] *= 0.5
            for p in range(indptr[i], indptr[i + 1]):
                j = np.int64(indices[p])
                if j <= i or label[j] < 0:
                    continue
                if label[j] != met:
                    _collect(forces, i, zero, offset, held, kept, coarse[slot[met]])
                    met = label[j]
                _add_forces(data, size * np.uint64(p), j, zero, offset, held, kept, forces)
            _collect(forces, i, zero, offset, held, kept, coarse[slot[met]])


@kernel
def _restrict(zero, residual, held, kept, offset, label, sums):
    dim, modes = np.uint64(len(zero)), 3 * len(zero) - 3
    sums[:] = 0.0
    for i in range(len(label)):
        if label[i] >= 0:
            r = read(residual, dim * np.uint64(i), zero)
            for q in range(modes):
                sums[modes * label[i] + q] += inner(_moved(q, i, zero, offset, held, kept), r)


@kernel
def _prolong(zero, values, held, kept, offset, label, result):
    dim, modes = np.uint64(len(zero)), 3 * len(zero) - 3
    for i in range(len(label)):
        if label[i] >= 0:
            at = dim * np.uint64(i)
            v = read(result, at, zero)
            for q in range(modes):
                v = add(v, scale(values[modes * label[i] + q], _moved(q, i, zero, offset, held, kept)))
            write(result, at, v)


class CoarseMatrix:
    """B'(A + S)B of a contact status, factorised."""

    def __init__(self, aggregates: Aggregates, matrix: sparse.bsr_array, diagonal: np.ndarray, held: np.ndarray,
                 kept: np.ndarray) -> None:
        dim = diagonal.shape[1]
        modes, count = 3 * dim - 3, len(aggregates.indptr) - 1
        self._zero = ZERO[dim]
        self._given = held, kept.reshape(-1), aggregates.offset.reshape(-1), aggregates.label
        half = np.zeros((len(aggregates.indices), modes, modes))
        in_parts(_galerkin, count, matrix.data.size, self._zero, matrix.indptr, matrix.indices,
                 matrix.data.reshape(-1), diagonal.reshape(-1), *self._given, aggregates.order, aggregates.starts,
                 aggregates.indptr, aggregates.indices, half)
        self._sums = np.zeros(count * modes)
        self._unknowns, self._factor = aggregates.unknowns, None
        band = np.bincount(aggregates.entries, half.reshape(-1), aggregates.band * len(self._sums))
        band = band.reshape(-1, aggregates.band).T
        band[0] = 2 * band[0] + raised(2 * band[0])
        if count:
            factor, failed = dpbtrf(band, lower=1, overwrite_ab=1)
            # a motion that nothing holds: the sweeps alone precondition too
            self._factor = None if failed else factor

    def correct(self, residual: np.ndarray, result: np.ndarray) -> None:
        if self._factor is not None:
            _restrict(self._zero, residual, *self._given, self._sums)
            self._sums[self._unknowns], _ = dpbtrs(self._factor, self._sums[self._unknowns], lower=1, overwrite_b=1)
            _prolong(self._zero, self._sums, *self._given, result)


def raised(diagonal: np.ndarray) -> np.ndarray:
    """Return what is added to the diagonal of the coarse matrix."""
    # motions that the status takes away altogether
    most = diagonal.max(initial=0.0)
    return np.where(diagonal > 1e-14 * most, _SHIFT * diagonal, most)
