"""Numba kernels that take the rows of some nodes out of a symmetric matrix stored by its lower half."""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import kernel

__all__ = ["alone", "count", "fill"]


@kernel
def count(indptr, indices, place, result):
    """Row pointers of the rows (without diagonal) of the nodes with ``place`` >= 0."""
    for i in range(len(indptr) - 1):
        for k in range(indptr[i], indptr[i + 1]):
            j = np.int64(indices[k])
            if place[i] >= 0:
                result[place[i] + 1] += 1
            if place[j] >= 0:
                result[place[j] + 1] += 1
    for i in range(len(result) - 1):
        result[i + 1] += result[i]


@kernel
def fill(dim, indptr, indices, lower, place, row_indptr, columns, blocks):
    """Columns and blocks of those rows; a block above the diagonal is the transpose of the one below."""
    size = dim * dim
    at = row_indptr[:-1].copy()
    for i in range(len(indptr) - 1):
        for k in range(indptr[i], indptr[i + 1]):
            j = np.int64(indices[k])
            p, q = place[i], place[j]
            if p >= 0:
                columns[at[p]] = j
                for c in range(size):
                    blocks[size * at[p] + c] = lower[size * k + c]
                at[p] += 1
            if q >= 0:
                columns[at[q]] = i
                for a in range(dim):
                    for b in range(dim):
                        blocks[size * at[q] + dim * a + b] = lower[size * k + dim * b + a]
                at[q] += 1


@kernel
def _add(dim, p, node, left, right, nodes, indptr, columns, blocks, diagonal, result, at):
    """result += diag(left) A diag(right) for the block in row ``p`` (a position) and column ``node``."""
    size = dim * dim
    if nodes[p] == node:
        for a in range(dim):
            for b in range(dim):
                result[at + dim * a + b] += left[a] * diagonal[size * p + dim * a + b] * right[b]
        return
    for k in range(indptr[p], indptr[p + 1]):
        if np.int64(columns[k]) == node:
            for a in range(dim):
                for b in range(dim):
                    result[at + dim * a + b] += left[a] * blocks[size * k + dim * a + b] * right[b]
            return


@kernel
def alone(dim, nodes, indptr, columns, blocks, diagonal, follow_indptr, followers, weights, result):
    """Blocks D'AD of the motion D of each node that leaves its followers where they are."""
    one = np.ones(dim)
    left, right = np.empty(dim), np.empty(dim)
    for p in range(len(nodes)):
        at = dim * dim * p
        _add(dim, p, nodes[p], one, one, nodes, indptr, columns, blocks, diagonal, result, at)
        for s in range(follow_indptr[p], follow_indptr[p + 1]):
            for a in range(dim):
                left[a] = -weights[dim * s + a]
            q = followers[s]
            _add(dim, q, nodes[p], left, one, nodes, indptr, columns, blocks, diagonal, result, at)
            _add(dim, p, nodes[q], one, left, nodes, indptr, columns, blocks, diagonal, result, at)
            for t in range(follow_indptr[p], follow_indptr[p + 1]):
                for a in range(dim):
                    right[a] = -weights[dim * t + a]
                _add(dim, q, nodes[followers[t]], left, right, nodes, indptr, columns, blocks, diagonal, result, at)
