r"""Point location: which element holds a point, with which barycentric weights, and how far outside
it lies.

The weights of :math:`x` in an element with corners :math:`x_0 \dots x_d` are
:math:`\lambda_m = G_m\cdot(x - x_0)`, m = 1 .. d, and :math:`\lambda_0 = 1 - \sum_m \lambda_m`, where :math:`G_m` is
the gradient of the shape function of corner m. ``maps`` (n, dim + dim^2) holds :math:`x_0, G_1, \dots,
G_d` of each element. In kernels (x, y, z) is a point (z = 0 in the plane), ``e`` the position of an
element in the order of the tree, a row of ``maps``, and ``boxes`` are those of the tree, as
:mod:`adaptmg.geometry.search` has them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg import _checks as checks
from adaptmg._numba import inner_kernel, kernel
from adaptmg._threads import in_parts
from adaptmg.geometry.search import STACK, BoxTree, leaf_range, morton_order, padded


@dataclass(frozen=True, eq=False)
class Location:
    """Places of points in a mesh."""

    element: np.ndarray  # (n,) int32: the element that holds the point, or the nearest one
    #: (n, dim + 1), >= 0, sums 1: barycentric weights in that element, of the point or the closest one of the mesh
    weights: np.ndarray
    distance: np.ndarray  # (n,): 0 inside, else the distance from the mesh, m


class SimplexLocator:
    """Finds points in a mesh of simplices. Every point is found. A point on a node or an edge
    belongs to one of the elements there: its interpolation weights do not depend on which."""

    def __init__(
        self, points: np.ndarray, elements: np.ndarray, chosen: np.ndarray | None = None
    ) -> None:
        """Look for points among the ``elements`` (n_elements, dim + 1) between ``points`` (n_nodes,
        dim), or only among those with the numbers ``chosen`` (n,)."""
        #: numbers in the mesh of the elements among which points are looked for: ``chosen``, or all
        self.chosen = (
            np.arange(len(elements), dtype=np.int32) if chosen is None else chosen.astype(np.int32)
        )
        self.dim = points.shape[1]
        self.n_nodes = len(points)
        # the tree and the maps have the elements in the order of the tree
        self.tree = BoxTree(points, elements[self.chosen])
        self.maps = affine_maps(self.tree.points, self.tree.simplices)
        if not np.isfinite(self.maps.sum()) and (bad := ~np.isfinite(self.maps).all(axis=1)).any():
            element = self.chosen[self.tree.order[np.argmax(bad)]]
            raise ValueError(f"mesh: element {element} has no volume; remove degenerate elements")

    def locate(self, points: np.ndarray) -> Location:
        """Return where each of points (n, dim) lies in the mesh; of points outside the nearest
        place. TypeError or ValueError for other arrays, or if a point is not finite."""
        queries = checks.real_array(points)
        if queries is None:
            raise TypeError(f"points must be real numbers, got {checks.shown(points)}")
        queries = queries.astype(np.float64, copy=False)
        if queries.ndim != 2 or queries.shape[1] != self.dim:
            raise ValueError(f"points must have shape (n, {self.dim}), got {queries.shape}")
        if not np.isfinite(queries).all():
            raise ValueError(
                f"points must be finite; point {np.argmin(np.isfinite(queries).all(axis=1))} is not"
            )
        n = len(queries)
        holder = np.empty(n, dtype=np.int64)  # positions in the order of the tree, -1 outside
        weights = np.empty((n, self.dim + 1))
        distance = np.zeros(n)
        # about as long as it takes to read 20 numbers a point. A point on an edge goes to the element that is
        # met first, which depends on the point before it: parts are not joined to one for each thread, so
        # that they, and the result, do not depend on the number of threads
        in_parts(
            find_holders,
            n,
            20 * n,
            padded(queries),
            morton_order(queries),
            self.maps,
            self.tree.boxes,
            holder,
            weights,
            joined=False,
        )
        # numbers among the chosen elements. Outside, -1 gives the last one, which the nearest one replaces
        element = self.tree.order[holder]
        if len(outside := np.flatnonzero(holder < 0)):
            element[outside], weights[outside], distance[outside] = self.tree.nearest(
                queries[outside]
            )
            # rounding may put a point on an edge outside of every box and element around it
            lower, upper = self.tree.boxes[0].reshape(2, -1)
            distance[distance <= INSIDE * (upper - lower).max()] = 0.0
        return Location(element=self.chosen[element], weights=weights, distance=distance)


INSIDE = checks.ROUNDING
"""A point counts as inside an element when no barycentric weight is below minus this, or its distance is less than this
part of the extent of the mesh."""
_ROUNDING = 4 * np.finfo(np.float64).eps


def affine_maps(points: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """Return the origin and gradients of the shape functions 1 .. d of every element, (n, dim + dim
    * dim), of points (n, 3). Not finite where an element has no volume."""
    dim = elements.shape[1] - 1
    corners = [[x.take(nodes) for x in points.T[:dim]] for nodes in elements.T]
    origin = corners[0]
    # by component of all elements: .5 ms for 20 000 triangles, by numpy.cross 2.2
    edges = [[x - o for x, o in zip(corner, origin, strict=True)] for corner in corners[1:]]
    # the gradient of shape function m times the determinant of the edges: it is normal to all edges
    # but edge m
    if dim == 2:
        (a, b), (c, d) = edges
        normals = [[d, -c], [-b, a]]
    else:
        normals = [_cross(edges[m - 2], edges[m - 1]) for m in range(3)]
    determinant = sum(x * n for x, n in zip(edges[0], normals[0], strict=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / determinant
        gradients = [scale * component for normal in normals for component in normal]
    return np.stack([*origin, *gradients], axis=1)


def _cross(a: list[np.ndarray], b: list[np.ndarray]) -> list[np.ndarray]:
    """Return the components of the cross products of vectors given by components."""
    return [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]


@inner_kernel
def _coordinates(maps, e, x, y, z, dim):
    """Return the weights of corners 1, 2 and 3 (2D: 0) of element ``e`` at a point, and that of
    corner 0."""
    if dim == 2:
        x = x - maps[e, 0]
        y = y - maps[e, 1]
        first = maps[e, 2] * x + maps[e, 3] * y
        second = maps[e, 4] * x + maps[e, 5] * y
        return first, second, 0.0, 1.0 - (first + second)
    x = x - maps[e, 0]
    y = y - maps[e, 1]
    z = z - maps[e, 2]
    first = maps[e, 3] * x + maps[e, 4] * y + maps[e, 5] * z
    second = maps[e, 6] * x + maps[e, 7] * y + maps[e, 8] * z
    third = maps[e, 9] * x + maps[e, 10] * y + maps[e, 11] * z
    return first, second, third, 1.0 - (first + second + third)


@inner_kernel
def _inside(maps, e, x, y, z, dim):
    first, second, third, rest = _coordinates(maps, e, x, y, z, dim)
    return min(min(first, second), min(third, rest)) >= -INSIDE


@inner_kernel
def _box_contains(boxes, node, x, y, z, dim):
    """Return whether the closed box of ``node`` contains a point."""
    return (
        boxes[node, 0] <= x <= boxes[node, dim]
        and boxes[node, 1] <= y <= boxes[node, dim + 1]
        and (dim == 2 or boxes[node, 2] <= z <= boxes[node, 5])
    )


@inner_kernel
def _holder(x, y, z, start, maps, boxes, dim, stack):
    """Return the position of an element that contains a point and its leaf, -1 if there is none;
    leaf ``start`` comes first, then its sibling, its parent's sibling, and so on up to the root."""
    n = len(maps)
    n_leaves = (len(boxes) + 1) // 2
    top = stack[0] = start
    depth = 1
    while depth > 0:  # each node of the tree comes once
        depth -= 1
        node = stack[depth]
        if _box_contains(boxes, node, x, y, z, dim):
            if node < n_leaves - 1:
                stack[depth] = 2 * node + 1
                stack[depth + 1] = 2 * node + 2
                depth += 2
                continue
            first, last = leaf_range(node, n_leaves, n)
            for s in range(first, last):
                if _inside(maps, s, x, y, z, dim):
                    return s, node
        # all below ``top`` was seen: its sibling comes next, and then all below their parent was
        if depth == 0 and top > 0:
            stack[0] = top + 1 if top % 2 == 1 else top - 1
            top = (top - 1) // 2
            depth = 1
    return -1, start


@kernel
def find_holders(first, last, queries, sequence, maps, boxes, holder, weights):
    """Find the position ``holder`` (n,) of an element that holds each of ``queries`` (n, 3), -1 if there
    is none, and the ``weights`` (n, dim + 1) there, in the order ``sequence[first:last]``."""
    dim = weights.shape[1] - 1
    stack = np.empty(STACK, dtype=np.int64)
    leaf = len(boxes) // 2
    for q in sequence[first:last]:
        # numbers, not slices: making a slice costs more than looking into an element
        x = queries[q, 0]
        y = queries[q, 1]
        z = queries[q, 2]
        holder[q], leaf = _holder(x, y, z, leaf, maps, boxes, dim, stack)
        if holder[q] >= 0:
            _take_clipped(maps, holder[q], x, y, z, dim, q, weights)


@inner_kernel
def _take_clipped(maps, e, x, y, z, dim, q, weights):
    """Write row q of the weights of a point in element e, normalised; those so small that the
    rounding of coordinates explains them become zero."""
    # a point on an edge of a small element has a weight of about eps |x| / h at the corner opposite
    steepest = 0.0
    for m in range(dim, dim + dim * dim):
        steepest += abs(maps[e, m])
    least = _ROUNDING * (abs(x) + abs(y) + abs(z)) * steepest
    first, second, third, rest = _coordinates(maps, e, x, y, z, dim)
    first = first if first > least else 0.0
    second = second if second > least else 0.0
    third = third if third > least else 0.0
    rest = rest if rest > least else 0.0
    total = rest + first + second + third
    weights[q, 0] = rest / total
    weights[q, 1] = first / total
    weights[q, 2] = second / total
    if dim == 3:
        weights[q, 3] = third / total
