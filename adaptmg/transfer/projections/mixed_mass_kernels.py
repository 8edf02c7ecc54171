"""Kernels of the integrals of two meshes: find and clip overlapping elements, and add up over patches."""

from __future__ import annotations

import numpy as np

from adaptmg.geometry.box_tree import STACK, bounding_box, overlapping
from adaptmg.geometry.simplex_clipping import PIECES, SNAP, common_moments
from adaptmg.runtime.compiled import inner_kernel, kernel

__all__ = ["clip_elements", "count_rows", "fill_rows"]


@kernel
def clip_elements(points, elements, fine_maps, chosen, done, count, coarse_points, coarse, maps, boxes, marker, covered,
                  element, columns, values):
    """Integrals over the ``chosen`` fine elements from the one numbered ``done`` on, each scaled to volume 1.

    Entries are written from position ``count`` on: fine element, coarse node and the integrals with the shape
    functions of the corners. ``covered`` gets the share of each element that the coarse mesh covers; ``marker``
    (n_coarse,) is -1 throughout on entry and exit.

    Returns
    -------
    done, count
        Less than all elements are done when the arrays are full: enlarge them and call again.
    """
    k = elements.shape[1]
    mu, moments = np.empty((k, k)), np.empty((k, k))
    pieces, levels = np.empty((PIECES, 1 + 2 * k * k)), np.empty(PIECES, dtype=np.int64)
    stack, box, candidates = np.empty(STACK, dtype=np.int64), np.empty(2 * (k - 1)), np.empty(len(coarse), np.int64)
    for c in range(done, len(chosen)):
        e = chosen[c]
        start = count
        covered[c] = 0.0
        bounding_box(points, elements[e], box)
        full = False
        for at in range(overlapping(boxes, box, coarse_points, coarse, stack, candidates)):
            s = candidates[at]
            if (_apart(coarse_points, coarse[s], fine_maps, e, mu) or _apart(points, elements[e], maps, s, mu)):
                continue
            share = common_moments(mu, k, pieces, levels, moments)
            full = count + k > len(columns)
            if full:
                break
            if share > 0.0:
                covered[c] += share
                count = _add_entries(coarse[s], mu, moments, marker, count, columns, values)
        for at in range(start, count):
            marker[columns[at]] = -1
            element[at] = e
        if full:
            return c, start
    return len(chosen), count


@kernel
def _apart(points, corners, maps, e, mu):
    """Whether a face of element ``e`` of ``maps`` parts it from the simplex ``corners``.

    Writes the barycentric coordinate m of corner v at ``mu[v, m]``, snapped to zero.
    """
    # the same as ``barycentric``, but face by face: most pairs are parted by one of the first
    k = len(corners)
    dim = k - 1
    for v in range(k):
        mu[v, 0] = 1.0
    for m in range(1, k):
        largest = 0.0
        for v in range(k):
            value = 0.0
            for c in range(dim):
                value += maps[e, m * dim + c] * (points[corners[v], c] - maps[e, c])
            mu[v, 0] -= value
            mu[v, m] = value if abs(value) >= SNAP else 0.0
            largest = max(largest, mu[v, m])
        if largest == 0.0:
            return True
    largest = 0.0
    for v in range(k):
        if abs(mu[v, 0]) < SNAP:
            mu[v, 0] = 0.0
        largest = max(largest, mu[v, 0])
    return largest == 0.0


@inner_kernel
def _add_entries(coarse_corners, mu, moments, marker, count, columns, values):
    """Add the integrals of lambda_i mu_m = sum_v lambda_i lambda_v mu_m(v)."""
    k = len(coarse_corners)
    for m in range(k):
        column = coarse_corners[m]
        at = marker[column]
        if at < 0:
            at = count
            marker[column] = at
            columns[at] = column
            values[at] = 0.0
            count += 1
        for i in range(k):
            total = 0.0
            for v in range(k):
                total += moments[i, v] * mu[v, m]
            values[at, i] += total
    return count


@kernel
def count_rows(node_indptr, node_elements, indptr, columns, marker, counts):
    """Number of distinct coarse nodes in the patch of each fine node i, to ``counts[i + 1]``; ``marker`` is -1."""
    for i in range(len(node_indptr) - 1):
        for p in range(node_indptr[i], node_indptr[i + 1]):
            e = node_elements[p]
            for at in range(indptr[e], indptr[e + 1]):
                if marker[columns[at]] != i:
                    marker[columns[at]] = i
                    counts[i + 1] += 1


@kernel
def fill_rows(node_indptr, node_elements, coefficients, indptr, columns, values, marker, row_indptr, indices, data):
    """Sum coefficients times integrals over the patch of each fine node; ``marker`` is -1, ``data`` 0."""
    k = coefficients.shape[1]
    for i in range(len(node_indptr) - 1):
        first = row_indptr[i]
        used = first
        for p in range(node_indptr[i], node_indptr[i + 1]):
            e = node_elements[p]
            for at in range(indptr[e], indptr[e + 1]):
                place = marker[columns[at]]
                if place < first:
                    place = used
                    marker[columns[at]] = place
                    indices[place] = columns[at]
                    used += 1
                for v in range(k):
                    data[place] += coefficients[p, v] * values[at, v]
