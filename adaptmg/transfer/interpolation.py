r"""Transfers, and point interpolation: the coarse function evaluated at the fine nodes.

.. math:: u_f(x_i) \leftarrow \sum_j P_{ij}\, u_c(x_j), \qquad P_{ij} = \varphi^c_j(x_i), \qquad \sum_j P_{ij} = 1

P acts on nodal values (primal), component by component; its transpose restricts residuals (dual). A
fine node outside the coarse mesh takes the value at the closest point of the coarse mesh.

After entries have been dropped, the rest :math:`p_j` of a row is changed by the smallest
:math:`\delta_j` (least squares) that restores the sum and the first moments :math:`m` the row had
before:

.. math:: \min \sum_j \delta_j^2 \quad\text{with}\quad \sum_j (p_j + \delta_j)\, q_j = m, \qquad
          q_j = (1, (x_j - x_i)/h_i), \qquad \delta_j = q_j \cdot G^{-1} \Big(m - \sum_j p_j q_j\Big),\;
          G = \sum_j q_j q_j^T ,

where :math:`h_i` is a size of the mesh: a single coarse node that is left may equal the fine node
up to rounding, and its distance is not a scale."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._numba import kernel
from adaptmg._threads import in_parts
from adaptmg.geometry.location import Location, SimplexLocator
from adaptmg.mesh.arrays import MeshArrays, centroids, initial_elements, parents_of

# 1e-12 and 1e-8 leave the cycles of 8 random pairs (59) and the entries to .2 %; with 1e-9 affine
# fields are missed by 2e-9 on meshes whose nodes differ by 1e-9
CLIP = 1e-10
"""Weights smaller than this are removed: they would put spurious nodes into minima over the support of P."""


@runtime_checkable
class Transfer(Protocol):
    """Anything with this method can be given as ``transfer=``."""

    def build(self, coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array:
        """Return the nodal prolongation (n_fine, n_coarse); rows should sum to 1, or rigid
        translations are not reproduced."""
        ...


@dataclass(frozen=True, kw_only=True)
class Interpolation:
    """Point interpolation: the cheapest transfer, and the default.

    Entries are >= 0 with row sums 1. Reproduces constants always, and affine fields at every fine
    node that lies in the coarse mesh. On nested meshes it is the canonical embedding. Bodies are
    matched by name and interpolated apart.

    Examples
    --------
    >>> problem = am.cases.greco_bar()
    >>> meshes = [am.mesh.structured(problem.domain, n) for n in (2, 3)]       # not nested
    >>> grids = am.Hierarchy.from_meshes(problem, meshes, transfer=am.Interpolation())
    >>> grids.finest.prolongation.shape
    (16, 9)
    """

    def build(self, coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array:
        """Return the nodal prolongation (n_fine, n_coarse), at most dim + 1 entries a row.

        ValueError if a fine node lies outside by more than a quarter of an element, bodies or
        dimensions differ, or an element is inverted."""
        _check_meshes(coarse, fine)
        if (rows := without_search(coarse, fine)) is not None:
            return rows
        location = locate_nodes(coarse, fine)
        return csr_from_weights(coarse.elements[location.element], location.weights, coarse.n_nodes)


class PointLocator(SimplexLocator):
    """Finds points in a mesh; see :class:`~adaptmg.geometry.location.SimplexLocator`.

    With ``body``, an index into ``mesh.bodies``, only in the elements of this body: where two
    bodies touch, a point lies in both. ValueError if there are no elements (of that body), or one
    without volume.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> place = am.transfer.PointLocator(mesh).locate([(0.25, 0.1), (1.5, 0.1)])
    >>> place.weights.shape, place.distance.round(9).tolist()                   # of each point; m
    ((2, 3), [0.0, 0.5])
    """

    def __init__(self, mesh: MeshArrays, body: int | None = None) -> None:
        checks.instance("mesh", mesh, MeshArrays, "MeshArrays")
        chosen = None if body is None else np.flatnonzero(mesh.element_body == body)
        if len(mesh.elements if chosen is None else chosen) == 0:
            where = "mesh" if body is None else f"body {body} of the mesh"
            raise ValueError(f"mesh: {where} has no elements")
        super().__init__(mesh.points, mesh.elements, chosen)
        self.mesh = mesh


def nodes_of_bodies(mesh: MeshArrays, name: str = "fine") -> np.ndarray:
    """Return the body of each node (n_nodes,), that of its first element where bodies share it;
    ValueError if a node belongs to no element."""
    body = np.full(mesh.n_nodes, -1, dtype=np.int64)
    corners = mesh.elements.shape[1]
    # backwards, since the last assignment to a node counts
    body[mesh.elements.ravel()[::-1]] = np.repeat(mesh.element_body, corners)[::-1]
    if (body < 0).any():
        raise ValueError(
            f"{name}: node {np.argmax(body < 0)} belongs to no element; remove unused nodes"
        )
    return body


def _check_meshes(coarse: MeshArrays, fine: MeshArrays) -> None:
    """Raise ValueError unless both meshes have sound elements of the same dimension."""
    for name, mesh in (("coarse", coarse), ("fine", fine)):
        checks.instance(name, mesh, MeshArrays, "MeshArrays")
        if not (mesh.sound or (mesh.volumes > 0).all()):
            raise ValueError(
                f"{name}: element {np.argmin(mesh.volumes)} is inverted or degenerate: "
                "adaptmg.mesh.check_mesh finds all that is wrong with a mesh"
            )
    if coarse.dim != fine.dim:
        raise ValueError(
            f"coarse and fine must have the same dimension, got {coarse.dim} and {fine.dim}"
        )


def body_locators(coarse: MeshArrays, fine: MeshArrays) -> list[tuple[int | None, PointLocator]]:
    """Return pairs of a body of ``fine`` (None: all of it) and the locator in the coarse mesh of
    the same body."""
    _check_meshes(coarse, fine)
    if len(fine.bodies) == len(coarse.bodies) == 1:
        return [(None, PointLocator(coarse))]
    pairs = []
    for index in np.unique(fine.element_body):
        body = fine.bodies[index]
        if body not in coarse.bodies:
            raise ValueError(
                f"coarse: no body {body!r}, which fine has; its bodies are {', '.join(coarse.bodies)}"
            )
        pairs.append((int(index), PointLocator(coarse, coarse.bodies.index(body))))
    return pairs


# nodes of 24 round shapes lie up to .067 outside meshes of 2.5 times their size: measured half would do
OUTSIDE_TOLERANCE = 0.25
"""How far outside the coarse mesh a fine node may lie, over the size of the nearest element. A chord of a curved
boundary misses the arc by less; different units, a shifted body or a missing part do not."""


def locate_nodes(coarse: MeshArrays, fine: MeshArrays) -> Location:
    """Locate every fine node in the coarse elements of its body; ValueError for one that lies outside by
    more than ``OUTSIDE_TOLERANCE`` of an element."""
    locators = body_locators(coarse, fine)
    element = np.empty(fine.n_nodes, dtype=np.int32)
    weights = np.empty((fine.n_nodes, fine.dim + 1))
    distance = np.empty(fine.n_nodes)
    # of a single body all nodes are located
    body_of = None if locators[0][0] is None else nodes_of_bodies(fine)
    for body, locator in locators:
        nodes = slice(None) if body is None else np.flatnonzero(body_of == body)
        found = locator.locate(fine.points[nodes])
        element[nodes] = found.element
        weights[nodes] = found.weights
        distance[nodes] = found.distance
    relative = np.zeros(fine.n_nodes)
    outside = np.flatnonzero(distance)
    relative[outside] = distance[outside] / coarse.element_sizes[element[outside]]
    if (relative > OUTSIDE_TOLERANCE).any():
        node = int(np.argmax(relative))
        raise ValueError(
            f"fine node {node} at {tuple(float(c) for c in fine.points[node])} lies {distance[node]:.3g} m outside the "
            f"coarse mesh, {relative[node]:.3g} of the element size there "
            f"({np.count_nonzero(relative > OUTSIDE_TOLERANCE)} nodes exceed {OUTSIDE_TOLERANCE:g}). Both meshes must "
            "describe the same body in the same units; if they do, refine the coarse mesh at the curved boundary"
        )
    return Location(element=element, weights=weights, distance=distance)


def without_search(coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array | None:
    """Return the rows of interpolation, to rounding, between structured meshes, and between nested
    ones made by bisection; None for others. The rows of boundary nodes interpolate along the boundary."""
    rows = between_lattices(coarse, fine)
    return between_bisected(coarse, fine) if rows is None else rows


def between_bisected(coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array | None:
    """Return the rows of interpolation to a mesh that was bisected from the coarse one, or both from a
    third; None for other meshes, and where nodes were moved. All transfers of a loop to 19 764 nodes
    take 6 ms, with a search 40.

    A new node has half of the row of each parent. A mesh is given by the initial one and the edges
    that are halved: where the nodes of the coarse mesh are the first ones of the fine mesh, each of
    its elements is a union of fine ones, and a new node with its parents lies in one of them."""
    n = coarse.n_nodes
    history = fine.refinement
    if history is None or coarse.bodies != fine.bodies:
        return None
    first, second = history.parents[n:].T
    same_history = (
        np.array_equal(initial_elements(coarse), history.initial)
        and np.array_equal(parents_of(coarse), history.parents[:n])
        and np.array_equal(coarse.points, fine.points[:n])
        and np.array_equal(0.5 * (fine.points[first] + fine.points[second]), fine.points[n:])
    )
    if not same_history:
        return None
    # the identity for coarse nodes; parents may be new nodes themselves, for which products put their parents
    columns = np.concatenate([np.arange(n, dtype=np.int32), history.parents[n:].ravel()])
    start = np.concatenate([np.arange(n), np.arange(n, len(columns) + 1, 2)])
    weights = np.where(np.arange(len(columns)) < n, 1.0, 0.5)
    rows = sparse.csr_array((weights, columns, start), shape=(fine.n_nodes, fine.n_nodes))
    while rows.indices.max() >= n:  # ends: parents have lower numbers than their node
        rows = rows @ rows
    rows.sort_indices()
    return sparse.csr_array((rows.data, rows.indices, rows.indptr), shape=(fine.n_nodes, n))


def between_lattices(coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array | None:
    """Return the rows of interpolation between structured meshes of the same bodies, to rounding;
    None for other meshes."""
    if not (coarse.bodies == fine.bodies and len(coarse.lattices) == len(fine.lattices) > 0):
        return None
    node = 0
    column = 0
    bodies = []
    # bodies one after the other: fine nodes from ``node`` to ``next_node``, coarse ones from ``column``
    # to ``next_column``
    for coarse_cells, fine_cells in zip(coarse.lattices, fine.lattices, strict=True):
        next_node = node + math.prod(n + 1 for n in fine_cells)
        next_column = column + math.prod(m + 1 for m in coarse_cells)
        # the first and the last node of a body are opposite corners of its box
        ends_of_coarse = coarse.points[[column, next_column - 1]]
        if (ends_of_coarse != fine.points[[node, next_node - 1]]).any():
            return None  # another box
        # the rows of the body in indptr, which has an entry more than nodes
        bodies.append((slice(node, next_node + 1), _axes(coarse_cells, fine_cells, column)))
        node = next_node
        column = next_column
    # first the number of entries of each row, then the entries
    indptr = np.zeros(fine.n_nodes + 1, dtype=np.int32)
    _interpolate(bodies, indptr, np.empty(0, dtype=np.int32), np.empty(0))
    np.cumsum(indptr, out=indptr)
    columns = np.empty(indptr[-1], dtype=np.int32)
    weights = np.empty(len(columns))
    _interpolate(bodies, indptr, columns, weights)
    result = sparse.csr_array((weights, columns, indptr), shape=(fine.n_nodes, coarse.n_nodes))
    result.has_sorted_indices = True
    return result


#: the places of a fine lattice in a coarse one, along each of x, y and z: the first corners of the coarse cells (the
#: sum over the axes is the number of a node), the shares of the cells, and the step to the next coarse node
Axes = tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...], tuple[int, ...]]


def _axes(coarse_cells: Sequence[int], fine_cells: Sequence[int], column: int) -> Axes:
    """Return the places of a fine lattice in a coarse one, whose first node is ``column``. The lattices
    have these numbers of cells along the axes; those of the plane have one place along z."""
    corners = []
    shares = []
    steps = []
    step = 1
    # in the plane z has no fine cell, and so one place
    for m, n in zip([*coarse_cells, 1][:3], [*fine_cells, 0][:3], strict=True):
        cell, rest = np.divmod(np.arange(n + 1) * m, max(n, 1))
        corners.append(step * cell)
        shares.append(rest / max(n, 1))
        steps.append(step)
        step *= m + 1
    corners[0] += column
    return tuple(corners), tuple(shares), tuple(steps)


def _interpolate(
    bodies: list[tuple[slice, Axes]], indptr: np.ndarray, columns: np.ndarray, weights: np.ndarray
) -> None:
    """Write ``columns`` and ``weights`` (n_entries,) of interpolation between lattices, of rows that begin
    at ``indptr``; without room for them (n_entries 0) the number of entries of row i to ``indptr[i + 1]``.
    ``bodies`` has for each body its part of ``indptr`` and the places of its lattice."""
    for nodes, (corners, shares, steps) in bodies:
        lines = len(corners[1]) * len(corners[2])
        entries = 4 * (nodes.stop - nodes.start)  # a row has up to four
        arguments = corners, shares, steps, indptr[nodes], columns, weights
        in_parts(_interpolate_on_lattice, lines, entries, *arguments)


@kernel
def _interpolate_on_lattice(first, last, corners, shares, steps, indptr, columns, weights):
    """Write the rows of interpolation at the nodes of lines along x of a fine lattice: with 263k nodes
    all levels take 5 ms, by numpy 33. Without room in ``columns`` write their lengths instead.

    A coarse cell is cut into simplices along its diagonal: a node with the shares a >= b >= c along the
    axes of its cell has the corners that lie 0, 1, 2, 3 steps along these axes, in this order, from the
    first corner, and the weights 1 - a, a - b, b - c, c."""
    counts = len(columns) == 0
    length = len(corners[0])
    for line in range(first, last):
        z, y = divmod(line, len(corners[1]))
        for x in range(length):
            node = line * length + x
            column = corners[0][x] + corners[1][y] + corners[2][z]
            a = shares[0][x]
            b = shares[1][y]
            c = shares[2][z]
            step_a, step_b, step_c = steps
            # the largest share first
            if a < b:
                a, b, step_a, step_b = b, a, step_b, step_a
            if b < c:
                b, c, step_b, step_c = c, b, step_c, step_b
            if a < b:
                a, b, step_a, step_b = b, a, step_b, step_a
            stored = 0
            for weight, step in (
                (1.0 - a, step_a),
                (a - b, step_b),
                (b - c, step_c),
                (c, step_c),  # after the last corner the step leads nowhere
            ):
                if weight >= CLIP:
                    if not counts:
                        columns[indptr[node] + stored] = column
                        weights[indptr[node] + stored] = weight
                    stored += 1
                column += step
            if counts:
                indptr[node + 1] = stored


def _rows(
    columns: np.ndarray, weights: np.ndarray, stored: np.ndarray, n_columns: int
) -> sparse.csr_array:
    """Return the sparse matrix (n, n_columns) of weights (n, k) in some columns (n, k), those that
    are ``stored`` (n, k) of them."""
    entries = np.flatnonzero(stored)
    # the number of stored entries up to the end of each row
    indptr = np.append(0, np.cumsum(stored)[stored.shape[1] - 1 :: stored.shape[1]]).astype(
        np.int32
    )
    return sparse.csr_array(
        (weights.take(entries), columns.take(entries), indptr), shape=(len(stored), n_columns)
    )


def csr_from_weights(columns: np.ndarray, weights: np.ndarray, n_columns: int) -> sparse.csr_array:
    """Return sparse rows (n, n_columns) with the ``weights`` (n, k) in the ``columns`` (n, k): sorted,
    without those below ``CLIP``, with sums 1."""
    weights = np.where(weights < CLIP, 0.0, weights)
    weights = weights / weights.sum(axis=1, keepdims=True)
    result = _rows(columns.astype(np.int32), weights, weights > 0, n_columns)
    result.sort_indices()
    return result


def dropped(matrix: sparse.csr_array, tolerance: float) -> sparse.csr_array:
    """Return a copy without entries whose magnitude is below ``tolerance``."""
    large = np.abs(matrix.data) >= tolerance
    before = np.concatenate([[0], np.cumsum(large, dtype=matrix.indptr.dtype)])
    indptr = before[matrix.indptr].astype(matrix.indptr.dtype)
    return sparse.csr_array((matrix.data[large], matrix.indices[large], indptr), shape=matrix.shape)


def _with_moments(
    matrix: sparse.csr_array, coarse: MeshArrays, fine: MeshArrays, moments: np.ndarray
) -> tuple[sparse.csr_array, np.ndarray]:
    """Return the matrix with the prescribed ``moments`` (n_fine, 1 + dim) of its rows, and a mask of
    the rows that have reached them; no row is empty.

    The moments of row i are sum_k P_ik q_k with q_k = (1, x_k - x_i), the distances scaled to about 1.
    The least change of the row that corrects a ``residual`` r of them is q_k . m with the multiplier
    m, G m = r, and the Gram matrix G = sum_k q_k q_k'. With fewer than 1 + dim independent q_k the
    matrix G is singular: its pseudo-inverse corrects what such a row can reach."""
    row = np.repeat(np.arange(fine.n_nodes), np.diff(matrix.indptr))
    starts = matrix.indptr[:-1]
    apart = coarse.points[matrix.indices] - fine.points[row]
    scale = np.empty(fine.n_nodes)
    scale[fine.elements] = fine.element_sizes[:, None]  # that of one of its elements will do
    scale = np.maximum(scale, np.maximum.reduceat(np.abs(apart).max(axis=1), starts))[:, None]
    q = np.column_stack([np.ones(len(row)), apart / scale[row]])
    residual = np.column_stack([moments[:, 0], moments[:, 1:] / scale])
    residual -= np.add.reduceat(matrix.data[:, None] * q, starts)
    multiplier = np.zeros(residual.shape)
    reached = np.ones(fine.n_nodes, dtype=bool)
    # smaller residuals, of moments of about 1, are rounding
    inexact = np.flatnonzero(np.abs(residual).max(axis=1) > 4 * np.finfo(float).eps)
    gram = np.array([[np.add.reduceat(a * b, starts)[inexact] for a in q.T] for b in q.T]).T
    inverse = np.linalg.pinv(gram, rcond=1e-10, hermitian=True)
    multiplier[inexact] = np.einsum("nij,nj->ni", inverse, residual[inexact])
    rest = np.einsum("nij,nj->ni", gram, multiplier[inexact]) - residual[inexact]
    reached[inexact] = np.abs(rest).max(axis=1) <= CLIP
    data = matrix.data + np.einsum("ek,ek->e", q, multiplier[row])
    return sparse.csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape), reached


def clipped_rows(
    matrix: sparse.csr_array,
    coarse: MeshArrays,
    fine: MeshArrays,
    *,
    tolerance: float = CLIP,
    moments: np.ndarray | None = None,
) -> tuple[sparse.csr_array, np.ndarray]:
    """Drop entries below ``tolerance``, and restore row sums 1 and first ``moments`` (n_fine, 1 + dim), by
    default those before; return also which rows (n_fine,) have reached them."""
    if moments is None:
        centre = coarse.points.mean(axis=0)  # far from the origin the differences would lose digits
        moments = matrix @ np.column_stack([np.ones(coarse.n_nodes), coarse.points - centre])
        moments /= moments[:, :1]
        moments[:, 1:] -= fine.points - centre
    rows, reached = _with_moments(dropped(matrix, tolerance), coarse, fine, moments)
    # a correction may make an entry small; each round removes at least one
    while np.abs(rows.data).min() < CLIP:
        rows, reached = _with_moments(dropped(rows, CLIP), coarse, fine, moments)
    return rows, reached


#: elements in which size_ratio is measured: a quantile needs no more
_SAMPLE = 5000


def _size_ratios(coarse: MeshArrays, fine: MeshArrays, step: int) -> np.ndarray:
    """Return h_coarse / h_fine (n,) at the centroids of every ``step``-th fine element of each body."""
    ratios = []
    for body, locator in body_locators(coarse, fine):
        elements = (
            np.arange(len(fine.elements))
            if body is None
            else np.flatnonzero(fine.element_body == body)
        )
        sample = elements[::step]
        found = locator.locate(centroids(fine.points, fine.elements[sample]))
        ratios.append(coarse.element_sizes[found.element] / fine.element_sizes[sample])
    return np.concatenate(ratios)


def mesh_ratio(coarse: MeshArrays, fine: MeshArrays) -> float:
    """Return the largest local ratio h_coarse / h_fine; two-level rates suffer above about 3.

    For each fine element: the longest edge of the coarse element that holds its centroid, over its
    own longest edge.

    Examples
    --------
    >>> coarse, fine = (am.mesh.structured(am.Rectangle(width=1, height=1), n) for n in (2, 4))
    >>> round(am.transfer.mesh_ratio(coarse, fine), 6)
    2.0
    """
    return float(_size_ratios(coarse, fine, 1).max())


def size_ratio(coarse: MeshArrays, fine: MeshArrays) -> float:
    """Return the 99 % quantile of what :func:`mesh_ratio` is the largest of, of large meshes over a
    sample of the elements.

    Levels of an adaptive hierarchy are kept by it: at most about 4.

    Examples
    --------
    >>> coarse, fine = (am.mesh.structured(am.Rectangle(width=1, height=1), n) for n in (2, 6))
    >>> round(am.transfer.size_ratio(coarse, fine), 6)
    3.0
    """
    elements = checks.instance("fine", fine, MeshArrays).elements
    return float(np.quantile(_size_ratios(coarse, fine, max(1, len(elements) // _SAMPLE)), 0.99))
