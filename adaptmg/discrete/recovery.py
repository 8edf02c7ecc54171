r"""Nodal values of what is constant on elements, continuous in each body: a linear fit around each node.

.. math:: \sum_e \big|\sigma_e - a - B (x_e - x_i)\big|^2 \to \min, \qquad \sigma^*_i = a

over the elements e around node i, with centroids :math:`x_e` (O. C. Zienkiewicz and J. Z. Zhu, Int. J. Numer. Meth.
Engng 33, 1992, doi:10.1002/nme.1620330702). Patches of boundary nodes lie on one side, where a fit around the node is
far less accurate (on the symmetry lines of a plate with a hole three times): a boundary node takes the mean of the
fits of the inner nodes around it, at its place; one without such nodes, a corner, a fit to the patches of all nodes of
its elements.
"""

from __future__ import annotations

import numpy as np

from adaptmg._numba import inner_kernel, kernel, read_only
from adaptmg.discrete.elasticity import list_elements
from adaptmg.mesh.arrays import MeshArrays


def apart(mesh: MeshArrays) -> tuple[np.ndarray, np.ndarray]:
    """Return the elements and points, a point for each body that uses a node."""
    if len(mesh.bodies) == 1:
        return mesh.elements, mesh.points
    n = mesh.n_nodes
    keys = mesh.element_body[:, None].astype(np.int64) * n + mesh.elements
    used = np.unique(keys)  # by body, then node
    number = used % n
    again = np.ones(len(used), dtype=bool)
    again[np.unique(number, return_index=True)[1]] = False
    points = np.concatenate([mesh.points, mesh.points[number[again]]])
    number[again] = n + np.arange(again.sum())
    return read_only(number[np.searchsorted(used, keys)].astype(np.int32)), read_only(points)


def elements_of_nodes(elements: np.ndarray, n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the elements of each node, ascending, in compressed rows: of node i ``listed[start[i]:start[i + 1]]``."""
    start, listed = np.zeros(n_nodes + 1, dtype=np.int64), np.empty(elements.size, dtype=np.int32)
    list_elements(elements, start, listed)
    return start, listed


def recovered(mesh: MeshArrays, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells of :func:`apart`, and nodal values (n, n_values) of those (n_elements, n_values) of elements."""
    cells, points = apart(mesh)
    start, listed = elements_of_nodes(cells, len(points))
    nodal, inner = np.zeros((len(points), values.shape[1])), np.zeros(len(points), dtype=bool)
    marker, patch = np.full(max(len(cells), len(points)), -1, dtype=np.int64), np.empty(len(cells), dtype=np.int64)
    mark_inner(cells, start, listed, marker, inner)
    marker[:] = -1
    recover(points, mesh.points[mesh.elements].mean(axis=1), cells, start, listed, inner, values, marker, patch, nodal)
    return cells, nodal


#: pivots below this part of the number of samples: these lie on a line, or in a plane
_SINGULAR = 1e-5


@inner_kernel
def _gather(i, elements, start, listed, wide, marker, patch):
    """Write the elements of the patch of node i; returns their number."""
    count = 0
    for at in range(start[i], start[i + 1]):
        patch[count] = listed[at]
        marker[listed[at]] = i
        count += 1
    if wide:
        for first in range(count):
            for v in elements[patch[first]]:
                for at in range(start[v], start[v + 1]):
                    if marker[listed[at]] != i:
                        marker[listed[at]] = i
                        patch[count] = listed[at]
                        count += 1
    return count


@inner_kernel
def _factor(matrix):
    """Cholesky factor in place, of the lower half; returns whether it is safe to use."""
    n = len(matrix)
    limit = _SINGULAR * matrix[0, 0]
    for j in range(n):
        for k in range(j):
            matrix[j, j] -= matrix[j, k] * matrix[j, k]
        if not matrix[j, j] > limit:
            return False
        matrix[j, j] = np.sqrt(matrix[j, j])
        for i in range(j + 1, n):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            matrix[i, j] /= matrix[j, j]
    return True


@kernel
def mark_inner(elements, start, listed, marker, inner):
    """Set ``inner`` (n_nodes,), which comes as False, where the elements of a node close around it. By Euler's formula
    F elements do so if they have F other nodes (3D: F / 2 + 2); else there are more. ``marker`` (n_nodes,): -1."""
    solid = elements.shape[1] == 4
    for i in range(len(start) - 1):
        others = 0
        for at in range(start[i], start[i + 1]):
            for v in elements[listed[at]]:
                if v != i and marker[v] != i:
                    marker[v] = i
                    others += 1
        count = start[i + 1] - start[i]
        inner[i] = count > 0 and (2 * others == count + 4 if solid else others == count)


@inner_kernel
def _sums(points, i, centroids, patch, count, values, terms, matrix, sides):
    """Normal equations of the fit at node i, distances over the largest one, which it returns."""
    dim, n_values = points.shape[1], values.shape[1]
    size = 0.0
    for at in range(count):
        for d in range(dim):
            size = max(size, abs(centroids[patch[at], d] - points[i, d]))
    matrix[:] = 0.0
    sides[:] = 0.0
    for at in range(count):
        e = patch[at]
        for d in range(dim):
            terms[d + 1] = (centroids[e, d] - points[i, d]) / size
        for a in range(dim + 1):
            for b in range(a + 1):
                matrix[a, b] += terms[a] * terms[b]
            for c in range(n_values):
                sides[a, c] += terms[a] * values[e, c]
    return size


@inner_kernel
def _solve(matrix, sides):
    """Coefficients in place of the right-hand sides, by the Cholesky factor."""
    n, n_values = sides.shape
    for c in range(n_values):
        for a in range(n):
            for b in range(a):
                sides[a, c] -= matrix[a, b] * sides[b, c]
            sides[a, c] /= matrix[a, a]
        for a in range(n - 1, -1, -1):
            for b in range(a + 1, n):
                sides[a, c] -= matrix[b, a] * sides[b, c]
            sides[a, c] /= matrix[a, a]


@inner_kernel
def _extrapolate(points, i, size, sides, reached, inner, nodal, weights):
    """Add the fit of node i to the nodes on the boundary among those of an element, ``reached``."""
    for v in reached:
        if not inner[v]:
            weights[v] += 1
            for c in range(nodal.shape[1]):
                nodal[v, c] += sides[0, c]
                for d in range(points.shape[1]):
                    nodal[v, c] += sides[d + 1, c] * (points[v, d] - points[i, d]) / size


@kernel
def recover(points, centroids, elements, start, listed, inner, values, marker, patch, nodal):
    """Write the recovered values ``nodal`` (n_nodes, n_values), which come as 0, from those of the elements
    (n_elements, n_values): those of ``inner`` nodes (n_nodes,) first. ``marker`` (n_elements,) comes as -1, ``patch``
    (n_elements,) uninitialised. Where a patch is too small for a fit it is widened, and if that does not help its mean
    is taken."""
    dim, n_values = points.shape[1], values.shape[1]
    matrix, sides, terms = np.empty((dim + 1, dim + 1)), np.empty((dim + 1, n_values)), np.ones(dim + 1)
    weights = np.zeros(len(points), dtype=np.int64)
    for first in (True, False):
        for i in range(len(start) - 1):
            if start[i] == start[i + 1] or inner[i] != first:
                continue
            if weights[i] > 0:
                nodal[i] /= weights[i]
                continue
            fits = False
            for wide in range(2):
                if not fits and (wide == 1 or inner[i]):
                    count = _gather(i, elements, start, listed, wide == 1, marker, patch)
                    size = _sums(points, i, centroids, patch, count, values, terms, matrix, sides)
                    mean_weight = matrix[0, 0]
                    fits = _factor(matrix)
            if fits:
                _solve(matrix, sides)
            else:
                sides[0] /= mean_weight
            nodal[i] = sides[0]
            if fits and first:
                for at in range(start[i], start[i + 1]):
                    _extrapolate(points, i, size, sides, elements[listed[at]], inner, nodal, weights)
