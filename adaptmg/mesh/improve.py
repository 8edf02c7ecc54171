r"""Meshes refined and improved in arrays: ``refined_draft`` makes meshes of solids by a size field,
``improved`` better shapes of any elements.

refined_draft: tetrahedra made of a draft, which is a coarse mesh of the solid. Of a box the draft is
cells as large as the field anywhere, of other solids Netgen's mesh with edges of k (near 2, 4 or 7)
times the field f, which may then grow k times as fast. It takes
:math:`k^{-3}` of the time that Netgen would take for the whole, and is the only part that is not nested in other
meshes.

With the size e of an element (the edge of the equilateral one of the same volume) and the mean w of
f at its corners, it is refined until no element has :math:`e > \sqrt 2 w` and no boundary
facet is longer than :math:`\sqrt 2 f` (also where no element is too large: one facet of twice the length next
to a re-entrant corner doubles the rate of multigrid). All elements are cut where half of them stay
too large even so, else those that are too large are bisected once. After each pass, and three times
in the end, moves make better shapes. New nodes on round faces are put onto them after each pass.

None of these steps can make a hole or a fold out of a sound mesh as long as all measures stay
positive: the draft alone is checked.

To cut all elements, the middles of their edges become nodes. A tetrahedron without its corners is
an octahedron, which is cut in four along the shortest of its three diagonals: on Netgen's meshes
the children are then better shaped than along a fixed one.

Shapes: an inner node p goes to the minimum of the sum over its elements of

.. math:: \frac{\sum_{edges} l^2}{4\sqrt3\,A} \quad\text{or}\quad \frac{\sum_{edges} l^2}{12\,(3 V)^{2/3}} ,

which is 1 for an equilateral element of any size, so that grading stays. Squares over a power of at
most 1 of a linear function are convex where measures are positive: one Newton step is taken, halved
until the sum falls. Edges between triangles are swapped before (:mod:`adaptmg.mesh.delaunay`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from adaptmg._numba import ZERO, inner_kernel, kernel
from adaptmg.mesh.arrays import (
    MeshArrays,
    by_first_occurrence,
    edge_lengths,
    facet_keys,
    mask_of,
    occurrences,
    trusted,
)
from adaptmg.mesh.bisection import refined
from adaptmg.mesh.delaunay import swap_all
from adaptmg.mesh.sizes import (
    MAX_BISECTIONS,
    TOO_LARGE,
    equilateral_sizes,
    expected_nodes,
    facet_elements,
    overlong,
    refuse_too_many,
    unreachable,
)
from adaptmg.problem.plane_domains import Domain

# rounds of improvement in the end
_ROUNDS = 3
# volume of the equilateral element of size 1
EQUILATERAL = math.sqrt(2) / 12
# measure that a move leaves, of that before, at least: .05 changes none of 110 random meshes, .25 in
# place of .1 two, with larger angles
KEPT = 0.25
# nodes after which kernels come back, so that Ctrl-C ends them
_BATCH = 100_000


def refined_draft(
    domain: Domain,
    draft: MeshArrays,
    field: Callable[[MeshArrays], np.ndarray],
    onto: Callable[[MeshArrays, int], MeshArrays] | None = None,
) -> MeshArrays:
    """Refine a sound draft until its elements have the sizes that ``field`` gives at the nodes of a
    mesh. ``onto`` puts the nodes of a mesh from a number on onto the boundary of the domain; itself
    ``domain`` is for messages only."""
    mesh = draft
    # three bisections halve the size of a tetrahedron
    for _ in range(3 * MAX_BISECTIONS):
        field_at_nodes = field(mesh)
        n_old = mesh.n_nodes
        field_on_elements = field_at_nodes[mesh.elements].mean(axis=1)
        field_on_facets = field_at_nodes[mesh.facets].mean(axis=1)
        excess = equilateral_sizes(mesh.points, mesh.elements) / field_on_elements
        large = excess > TOO_LARGE
        facet_excess = equilateral_sizes(mesh.points, mesh.facets) / field_on_facets
        large_facets = facet_excess > TOO_LARGE
        if not (large.any() or large_facets.any()):
            mesh = improved(mesh, rounds=_ROUNDS)
            # flat elements that go through a whole body are small by their volume
            large = overlong(mesh, field_on_elements)
            if not large.any():
                return mesh
        refuse_too_many(expected_nodes(mesh, field_on_elements), domain)
        if np.median(excess) > 2 * TOO_LARGE:
            # most are too large even when all edges are halved
            mesh = halved(mesh)
        else:
            large[facet_elements(mesh, mesh.facets[large_facets])] = True
            mesh = refined(mesh, large, passes=1).mesh
        if onto is not None:
            mesh = onto(mesh, n_old)
        mesh = improved(mesh, rounds=1)
    raise unreachable(domain, large)


# edges by their corners, of tetrahedra and of faces: the middle of edge k is number k of those
# below
_EDGES, _SIDES = (
    np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]),
    np.array([[1, 2], [0, 2], [0, 1]]),
)
# children by corners (0 ..) and middles of edges (4 .., of faces 3 ..)
_CORNERS = np.array([[0, 4, 5, 6], [4, 1, 7, 8], [5, 7, 2, 9], [6, 8, 9, 3]])
_FACES = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2], [3, 4, 5]])
# a diagonal of the octahedron, and the other middles in turn around it
_OCTAHEDRA = np.array([[4, 9, 5, 6, 8, 7], [5, 8, 4, 7, 9, 6], [6, 7, 4, 5, 9, 8]])
_AROUND = _OCTAHEDRA[:, [[0, 1, 2 + k, 2 + (k + 1) % 4] for k in range(4)]]


def _inside(points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return the four children (n, 4, 4) of the octahedron inside each element, around its shortest
    diagonal; ``nodes`` (n, 10): corners and middles of each element, rows of ``points`` (n_nodes, 3)."""
    ends = points[nodes[:, _OCTAHEDRA[:, :2]]]
    lengths = np.square(ends[:, :, 0] - ends[:, :, 1]).sum(axis=2)
    best = np.zeros(len(nodes), dtype=np.int64)
    shortest = lengths[:, 0]
    for d in (1, 2):
        # of diagonals that differ only by rounding, the first
        shorter = lengths[:, d] < (1.0 - 1e-9) * shortest
        best = np.where(shorter, d, best)
        shortest = np.where(shorter, lengths[:, d], shortest)
    return nodes[np.arange(len(nodes))[:, None, None], _AROUND[best]]


def halved(mesh: MeshArrays) -> MeshArrays:
    """Return the mesh of tetrahedra with every edge cut in two."""
    n = mesh.n_nodes
    # number the distinct edges: each gets a node at its middle
    edges = [mesh.elements[:, _EDGES].reshape(-1, 2), mesh.facets[:, _SIDES].reshape(-1, 2)]
    keys = facet_keys(np.concatenate(edges), n)
    first, number = by_first_occurrence(keys)
    low, high = np.divmod(keys[first], n)
    points = np.concatenate([mesh.points, 0.5 * (mesh.points[low] + mesh.points[high])])
    middles, middles_of_sides = np.split(n + number, [len(edges[0])])
    nodes = np.concatenate([mesh.elements, middles.reshape(-1, 6)], axis=1)
    # eight children: four at the corners, four in the octahedron between them
    elements = np.concatenate([nodes[:, _CORNERS], _inside(points, nodes)], axis=1)
    facets = np.concatenate([mesh.facets, middles_of_sides.reshape(-1, 3)], axis=1)[:, _FACES]
    return trusted(
        replace(
            mesh,
            points=points,
            elements=elements.reshape(-1, 4),
            facets=facets.reshape(-1, 3),
            facet_labels=np.repeat(mesh.facet_labels, 4),
            element_body=np.repeat(mesh.element_body, 8),
        ),
        mesh.sound,
    )


def mean_ratios(mesh: MeshArrays) -> np.ndarray:
    """Return the inverse (n,) of the shape of each tetrahedron: 1 if it is equilateral."""
    squares = np.square(edge_lengths(mesh.points[mesh.elements])).sum(axis=0)
    return 12 * (3 * mesh.volumes) ** (2 / 3) / squares


def improved(mesh: MeshArrays, rounds: int) -> MeshArrays:
    """Return the mesh of tetrahedra with its inner nodes moved."""
    held = mask_of(mesh.facets, mesh.n_nodes)
    points = np.array(mesh.points)
    around = occurrences(mesh.elements, mesh.n_nodes)
    for _ in range(rounds):
        _move(points, mesh.elements, around, held)
    # moves turn no element over
    return trusted(replace(mesh, points=points), mesh.sound)


def improve_triangles(
    points: np.ndarray, elements: np.ndarray, across: np.ndarray, held: np.ndarray, rounds: int
) -> None:
    """Move the nodes ``points`` (n, 2) of Delaunay triangles ``elements`` (m, 3) with the neighbours
    ``across`` (m, 3) that are not ``held`` (n,), and swap edges between the moves, in place."""
    around = occurrences(elements, len(points))
    for _ in range(rounds - 1):
        _move(points, elements, around, held)
        if swap_all(points, elements, across, np.ones(len(elements), dtype=bool)):
            # other elements are around the ends of swapped edges
            around = occurrences(elements, len(points))
    _move(points, elements, around, held)


def _move(
    points: np.ndarray,
    elements: np.ndarray,
    around: tuple[np.ndarray, np.ndarray],
    held: np.ndarray,
) -> None:
    """Move the nodes ``points`` (n, dim) that are not ``held`` (n,) once, in place; ``around`` are the
    places of each node among the corners of ``elements``, from :func:`occurrences`."""
    measures = np.empty(np.diff(around[0]).max())
    for begin in range(0, len(points), _BATCH):
        _move_nodes(
            ZERO[points.shape[1]],
            points,
            elements,
            *around,
            held,
            begin,
            min(begin + _BATCH, len(points)),
            measures,
        )


@inner_kernel
def _spokes(zero, points, cells, item, x, spokes):
    """Write the edges from x to the other corners of an element into ``spokes`` (dim, dim), as if
    x stood in place of its corner ``item`` (a place in ``cells``); returns their determinant: dim!
    times the measure. ``zero``, here and below, is ZERO[dim]."""
    k = len(zero) + 1
    e = item // k
    corner = item % k
    for j in range(k - 1):
        # the other corners in an even permutation, so that the measure stays positive: of a tetrahedron
        # corner ^ 1, 2, 3 are (1, 2, 3) of corner 0, (0, 3, 2) of 1, (3, 0, 1) of 2, (2, 1, 0) of 3
        other = cells[e, (corner + 1 + j) % 3 if k == 3 else corner ^ (j + 1)]
        for c in range(k - 1):
            spokes[j, c] = points[other, c] - x[c]
    if k == 3:
        return spokes[0, 0] * spokes[1, 1] - spokes[0, 1] * spokes[1, 0]
    return (
        spokes[0, 0] * (spokes[1, 1] * spokes[2, 2] - spokes[1, 2] * spokes[2, 1])
        + spokes[0, 1] * (spokes[1, 2] * spokes[2, 0] - spokes[1, 0] * spokes[2, 2])
        + spokes[0, 2] * (spokes[1, 0] * spokes[2, 1] - spokes[1, 1] * spokes[2, 0])
    )


@inner_kernel
def _shape(zero, spokes, measure, total):
    """Return the shape of an element (module docstring) times a constant: the sum of its squared
    edges over ``measure`` (dim! times its own) to the power 2 / dim. ``total`` (dim,) becomes the
    sum of the spokes s_j; all edges together have sum_edges l^2 = (dim + 1) sum_j |s_j|^2 -
    |total|^2."""
    dim = len(zero)
    squares = 0.0
    both = 0.0
    for c in range(dim):
        total[c] = 0.0
        for j in range(dim):
            total[c] += spokes[j, c]
            squares += spokes[j, c] ** 2
        both += total[c] ** 2
    squares = (dim + 1) * squares - both
    return squares / measure if dim == 2 else squares * measure ** (-2.0 / 3.0)


@inner_kernel
def _add_derivatives(zero, spokes, measure, shape, total, normal, gradient, hessian):
    """Add the first and second derivatives of the shape of an element with respect to its corner x
    to ``gradient`` (dim,) and the lower half of ``hessian`` (dim, dim).

    With the sum q of squared edges, m = ``measure`` and p = m^(-2/dim) the shape is S = q p. As
    grad q = -2 t (t = ``total``) and n = -grad m / m (written into ``normal``), with s = 2 / dim

        gradient  s S n - 2 p t
        hessian   s (s + 1) S n n' - 2 s p (t n' + n t') + 2 dim p I"""
    dim = len(zero)
    for c in range(dim):
        if dim == 2:
            normal[c] = (1 - 2 * c) * (spokes[1, 1 - c] - spokes[0, 1 - c]) / measure
        else:
            a = (c + 1) % 3
            b = (c + 2) % 3
            normal[c] = (
                (spokes[1, a] - spokes[0, a]) * (spokes[2, b] - spokes[0, b])
                - (spokes[1, b] - spokes[0, b]) * (spokes[2, a] - spokes[0, a])
            ) / measure
    share = 2.0 / dim
    power = 1.0 / measure if dim == 2 else measure ** (-2.0 / 3.0)
    for c in range(dim):
        gradient[c] += share * shape * normal[c] - 2.0 * power * total[c]
        hessian[c, c] += 2.0 * dim * power
        for d in range(c + 1):
            hessian[c, d] += share * (share + 1.0) * shape * normal[c] * normal[
                d
            ] - 2.0 * share * power * (total[c] * normal[d] + total[d] * normal[c])


@inner_kernel
def _solve(zero, hessian, step):
    """Solve the system of which the lower half is ``hessian`` (dim, dim), overwritten, for the right side
    ``step`` (dim,), which becomes the solution; returns False unless it is positive definite."""
    dim = len(zero)
    for k in range(dim):
        if not hessian[k, k] > 0.0:
            return False
        for r in range(k + 1, dim):
            ratio = hessian[r, k] / hessian[k, k]
            step[r] -= ratio * step[k]
            for c in range(k + 1, r + 1):
                hessian[r, c] -= ratio * hessian[c, k]
    for k in range(dim - 1, -1, -1):
        for r in range(k + 1, dim):
            step[k] -= hessian[r, k] * step[r]
        step[k] /= hessian[k, k]
    return True


@kernel
def _move_nodes(zero, points, cells, start, items, held, begin, end, measures):
    """Move each node that is not ``held`` once, in place; ``start``, ``items`` as
    :func:`occurrences` has the corners at each; ``measures``, as many as corners are at a node, is
    overwritten (made here, it takes 3 s to compile)."""
    dim = len(zero)
    x = np.empty(dim)
    y = np.empty(dim)
    step = np.empty(dim)
    total = np.empty(dim)
    normal = np.empty(dim)
    hessian = np.empty((dim, dim))
    spokes = np.empty((dim, dim))
    for i in range(begin, end):
        if held[i]:
            continue
        # gradient (in ``step``) and hessian of the sum of shapes around the node
        before = 0.0
        for c in range(dim):
            x[c] = points[i, c]
            step[c] = 0.0
            for d in range(dim):
                hessian[c, d] = 0.0
        for s in range(start[i], start[i + 1]):
            measure = _spokes(zero, points, cells, items[s], x, spokes)
            measures[s - start[i]] = measure
            shape = _shape(zero, spokes, measure, total)
            before += shape
            _add_derivatives(zero, spokes, measure, shape, total, normal, step, hessian)
        if not _solve(zero, hessian, step):
            continue
        # a Newton step x - H^-1 g, halved until the sum falls and every element keeps enough of its measure;
        # a node for which this takes more than four halvings stays
        share = -1.0
        for _ in range(5):
            after = 0.0
            for c in range(dim):
                y[c] = x[c] + share * step[c]
            for s in range(start[i], start[i + 1]):
                measure = _spokes(zero, points, cells, items[s], y, spokes)
                if not measure > KEPT * measures[s - start[i]]:
                    after = np.inf
                    break
                after += _shape(zero, spokes, measure, total)
            if after < before:
                for c in range(dim):
                    points[i, c] = y[c]
                break
            share *= 0.5
