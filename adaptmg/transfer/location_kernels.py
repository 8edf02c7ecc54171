r"""Kernels of point location: barycentric weights, and the search that climbs the box tree.

The weights of :math:`x` in an element with corners :math:`x_0 \dots x_d` are
:math:`\lambda_m = G_m\cdot(x - x_0)`, m = 1 .. d, and :math:`\lambda_0 = 1 - \sum_m \lambda_m`, where :math:`G_m` is
the gradient of the shape function of corner m. ``maps`` holds :math:`x_0, G_1, \dots, G_d` of each element.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from adaptmg.transfer.box_tree import STACK, box_contains, leaf_range, nearest_simplex

__all__ = ["INSIDE", "affine_maps", "barycentric", "locate"]

INSIDE = 1e-12
"""A point counts as inside an element when no barycentric weight is below minus this."""


@njit(cache=True)
def affine_maps(points, elements, maps):
    """Origin and gradients of the shape functions 1 .. d of every element, (n, dim + dim * dim).

    Not finite where an element has no volume.
    """
    dim = elements.shape[1] - 1
    # the gradients are cross products of the edges; in 2D the third edge is the unit vector along z
    edges = np.zeros((3, 3))
    edges[2, 2] = 1.0
    for e in range(len(elements)):
        for m in range(dim):
            maps[e, m] = points[elements[e, 0], m]
            for c in range(dim):
                edges[m, c] = points[elements[e, m + 1], c] - points[elements[e, 0], c]
        u, v, w = edges[0], edges[1], edges[2]
        det = (u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2])
               + u[2] * (v[0] * w[1] - v[1] * w[0]))
        scale = 1.0 / det if det != 0.0 else np.inf
        for m in range(dim):
            v, w = edges[(m + 1) % 3], edges[(m + 2) % 3]
            for c in range(dim):
                i, j = (c + 1) % 3, (c + 2) % 3
                maps[e, dim + m * dim + c] = (v[i] * w[j] - v[j] * w[i]) * scale


@njit(cache=True)
def barycentric(maps, e, x, dim, weights):
    """Write the weights of ``x`` in element ``e``; returns the smallest."""
    total, smallest = 0.0, np.inf
    for m in range(dim):
        value = 0.0
        for c in range(dim):
            value += maps[e, dim + m * dim + c] * (x[c] - maps[e, c])
        weights[m + 1] = value
        total += value
        smallest = min(smallest, value)
    weights[0] = 1.0 - total
    return min(smallest, weights[0])


@njit(cache=True)
def _inside_below(top, x, maps, boxes, dim, weights, stack):
    """(element, leaf) below node ``top`` that contains ``x``, or (-1, -1); writes the weights."""
    n = len(maps)
    n_leaves = (len(boxes) + 1) // 2
    stack[0] = top
    depth = 1
    while depth > 0:
        depth -= 1
        node = stack[depth]
        if not box_contains(boxes, node, x, dim):
            continue
        if node < n_leaves - 1:
            stack[depth], stack[depth + 1] = 2 * node + 1, 2 * node + 2
            depth += 2
            continue
        first, last = leaf_range(node, n_leaves, n)
        for s in range(first, last):
            if barycentric(maps, s, x, dim, weights) >= -INSIDE:
                return s, node
    return -1, -1


@njit(cache=True)
def _find(x, start, maps, boxes, dim, weights, stack):
    """Climb from leaf ``start``: search it, its sibling, its parent's sibling, and so on up to the root."""
    node = start
    found, leaf = _inside_below(node, x, maps, boxes, dim, weights, stack)
    while found < 0 and node > 0:
        sibling = node + 1 if node % 2 == 1 else node - 1
        found, leaf = _inside_below(sibling, x, maps, boxes, dim, weights, stack)
        node = (node - 1) // 2
    return found, leaf


@njit(cache=True)
def locate(queries, sequence, points, elements, maps, boxes, found, weights, distance):
    """Locate ``queries`` (n, 3) in the order ``sequence``; points outside get the closest point of the mesh."""
    k = elements.shape[1]
    dim = k - 1
    n_leaves = (len(boxes) + 1) // 2
    trial, candidate = np.empty(k), np.empty(k)
    stack = np.empty(STACK, dtype=np.int64)
    leaf = n_leaves - 1
    for q in sequence:
        x = queries[q]
        best, at = _find(x, leaf, maps, boxes, dim, weights[q], stack)
        distance[q] = 0.0
        if best >= 0:
            leaf = at
            _clip(weights[q])
        else:
            best, squared = nearest_simplex(x, points, elements, boxes, dim, weights[q], trial, candidate, stack)
            # rounding may put a point on an edge outside of every box and element around it
            if barycentric(maps, best, x, dim, trial) < -INSIDE:
                distance[q] = np.sqrt(squared)
        found[q] = best


@njit(cache=True)
def _clip(weights):
    """Clip at zero and renormalise."""
    total = 0.0
    for m in range(len(weights)):
        weights[m] = max(weights[m], 0.0)
        total += weights[m]
    for m in range(len(weights)):
        weights[m] /= total
