r"""A tree of bounding boxes over simplices: which is the nearest to a point, which meet a box.

The simplices are laid along a Morton curve and cut into 2^m leaves of equal count; node i of the
complete binary tree has the children 2 i + 1 and 2 i + 2 and the box of all simplices below it.
Leaves hold the same number of simplices whatever their sizes, so graded meshes cost what uniform
ones do (a grid of cells does not have this). Points to locate are taken along a Morton curve too
and climb from the leaf where the last one ended. For Morton codes a coordinate is cut into 2^31
(2D) or 2^21 (3D) steps over the bounding box, and the bits of the components are interleaved.

Closest points are found on segments, triangles (by their Voronoi regions: Ericson, Real-Time
Collision Detection, 2005, section 5.1.5) and tetrahedra (the closest of the four faces: callers
test for points inside before).

Kernels read corners from ``points`` (n, 3) (2D is padded with z = 0), whose rows ``simplices`` (n, k)
has in the order of the curve; the position of a simplex is its row. ``boxes`` (2 n_leaves - 1, 2 dim)
are those of the nodes of the tree, lower corner and upper corner, and ``stack`` (STACK,) is scratch."""

from __future__ import annotations

import numpy as np

from adaptmg._numba import inner_kernel, kernel

LEAF_SIZE = 4
"""Largest number of simplices in a leaf."""

STACK = 128
"""Depth of the search stacks: more than twice the levels of any tree that fits in memory."""


@inner_kernel
def leaf_range(node, n_leaves, n_simplices):
    """Return the first and past-the-last position of the simplices in a leaf, given its node
    number."""
    leaf = node - (n_leaves - 1)
    return leaf * n_simplices // n_leaves, (leaf + 1) * n_simplices // n_leaves


@kernel
def _build(points, simplices, n_leaves, boxes):
    """Write the boxes (2 n_leaves - 1, 2 dim) of all nodes of the tree, leaves first: lower corner,
    upper corner; those of empty leaves are inverted."""
    n, k = simplices.shape
    dim = points.shape[1]
    for node in range(n_leaves - 1, 2 * n_leaves - 1):
        first, last = leaf_range(node, n_leaves, n)
        for c in range(dim):
            low = np.inf
            high = -np.inf
            for s in range(first, last):
                for m in range(k):
                    value = points[simplices[s, m], c]
                    low = min(low, value)
                    high = max(high, value)
            boxes[node, c] = low
            boxes[node, dim + c] = high
    for node in range(n_leaves - 2, -1, -1):
        left = 2 * node + 1
        right = 2 * node + 2
        for c in range(dim):
            boxes[node, c] = min(boxes[left, c], boxes[right, c])
            boxes[node, dim + c] = max(boxes[left, dim + c], boxes[right, dim + c])


@inner_kernel
def _box_overlaps(boxes, node, box, dim):
    """Return whether the box of ``node`` and ``box`` (2 dim,) meet."""
    meet = True
    for c in range(dim):
        meet = meet and box[dim + c] >= boxes[node, c] and box[c] <= boxes[node, dim + c]
    return meet


@inner_kernel
def bounding_box(points, corners, box):
    """Write lower and upper corner of the bounding box of an element to ``box`` (2 dim,)."""
    dim = len(corners) - 1
    for c in range(dim):
        box[c] = np.inf
        box[dim + c] = -np.inf
        for v in corners:
            box[c], box[dim + c] = min(box[c], points[v, c]), max(box[dim + c], points[v, c])


@kernel
def overlapping(boxes, box, points, simplices, stack, candidates):
    """Write the positions of all simplices whose bounding box meets ``box`` (2 dim,) into
    ``candidates``; returns their number."""
    n, k = simplices.shape
    dim = k - 1
    n_leaves = (len(boxes) + 1) // 2
    count = 0
    stack[0] = 0
    depth = 1
    while depth > 0:  # each node of the tree comes once
        depth -= 1
        node = stack[depth]
        if not _box_overlaps(boxes, node, box, dim):
            continue
        if node < n_leaves - 1:
            stack[depth] = 2 * node + 1
            stack[depth + 1] = 2 * node + 2
            depth += 2
            continue
        first, last = leaf_range(node, n_leaves, n)
        for s in range(first, last):
            if _simplex_meets(points, simplices[s], box, dim):
                candidates[count] = s
                count += 1
    return count


@inner_kernel
def _simplex_meets(points, corners, box, dim):
    """Return whether the bounding box of the simplex with these ``corners`` (k,) meets ``box`` (2 dim,)."""
    for c in range(dim):
        low = np.inf
        high = -np.inf
        for v in corners:
            low = min(low, points[v, c])
            high = max(high, points[v, c])
        if high < box[c] or low > box[dim + c]:
            return False
    return True


@inner_kernel
def _box_distance(boxes, node, x, dim):
    """Return the squared distance of ``x`` from the box of ``node``; infinite for an empty box."""
    total = 0.0
    for c in range(dim):
        outside = max(max(boxes[node, c] - x[c], x[c] - boxes[node, dim + c]), 0.0)
        total += outside * outside
    return total


@kernel
def _nearest(queries, points, simplices, boxes, dim, found, weights, distances):
    """Write for each of ``queries`` (n, 3) the position of the nearest simplex into ``found`` (n,), the
    weights of its corners in the closest point into ``weights`` (n, k), and the distance into
    ``distances`` (n,)."""
    n, k = simplices.shape
    n_leaves = (len(boxes) + 1) // 2
    trial = np.empty(k)
    candidate = np.empty(k)
    stack = np.empty(STACK, dtype=np.int64)
    for q in range(len(queries)):
        x = queries[q]
        best = np.inf
        stack[0] = 0
        depth = 1
        while depth > 0:  # each node of the tree comes once
            depth -= 1
            node = stack[depth]
            if not _box_distance(boxes, node, x, dim) < best:
                continue
            if node < n_leaves - 1:
                left = 2 * node + 1
                right = 2 * node + 2
                if _box_distance(boxes, left, x, dim) < _box_distance(boxes, right, x, dim):
                    left, right = right, left
                stack[depth] = left
                stack[depth + 1] = right
                depth += 2
                continue
            first, last = leaf_range(node, n_leaves, n)
            for s in range(first, last):
                distance = closest_on_simplex(points, simplices[s], x, candidate, trial)
                if distance < best:
                    found[q] = s
                    best = distance
                    for m in range(k):
                        weights[q, m] = candidate[m]
        distances[q] = np.sqrt(best)


@inner_kernel
def _box_meets_turned(boxes, node, frame, origin, low, high):
    """Return whether the extents of the box of a node along each row of ``frame``, its centre plus
    and minus a radius, meet ``low`` to ``high`` (from ``origin``)."""
    dim = len(origin)
    for a in range(dim):
        centre = 0.0
        radius = 0.0
        for c in range(dim):
            centre += frame[a, c] * (0.5 * (boxes[node, c] + boxes[node, dim + c]) - origin[c])
            radius += abs(frame[a, c]) * 0.5 * (boxes[node, dim + c] - boxes[node, c])
        if centre - radius > high[a] or centre + radius < low[a]:
            return False
    return True


@inner_kernel
def _simplex_meets_turned(points, corners, frame, origin, low, high):
    """Return whether the extents of a simplex along each row of ``frame`` meet ``low`` to ``high``
    (from ``origin``)."""
    dim = len(origin)
    for a in range(dim):
        lowest = np.inf
        highest = -np.inf
        for v in corners:
            value = 0.0
            for c in range(dim):
                value += frame[a, c] * (points[v, c] - origin[c])
            lowest = min(lowest, value)
            highest = max(highest, value)
        if lowest > high[a] or highest < low[a]:
            return False
    return True


@kernel
def meet_turned(frames, origins, low, high, boxes, points, simplices, start, fill, found):
    """Find the simplices that meet turned boxes: extents ``low`` .. ``high`` (n, dim) from ``origins`` (n,
    dim) along the rows of ``frames`` (n, dim, dim). Counts those of box s to ``start[s + 1]`` or, with
    ``fill``, writes their positions from ``found[start[s]]`` on."""
    n_leaves = (len(boxes) + 1) // 2
    stack = np.empty(STACK, dtype=np.int64)
    for s in range(len(frames)):
        count = 0
        stack[0] = 0
        depth = 1
        while depth > 0:  # each node of the tree comes once
            depth -= 1
            node = stack[depth]
            if not _box_meets_turned(boxes, node, frames[s], origins[s], low[s], high[s]):
                continue
            if node < n_leaves - 1:
                stack[depth] = 2 * node + 1
                stack[depth + 1] = 2 * node + 2
                depth += 2
                continue
            first, last = leaf_range(node, n_leaves, len(simplices))
            for i in range(first, last):
                if _simplex_meets_turned(
                    points, simplices[i], frames[s], origins[s], low[s], high[s]
                ):
                    if fill:
                        found[start[s] + count] = i
                    count += 1
        if not fill:
            start[s + 1] = count


class BoxTree:
    """Bounding boxes over simplices."""

    def __init__(self, points: np.ndarray, simplices: np.ndarray) -> None:
        """Sort ``simplices`` (n, k) between ``points`` (n_nodes, dim) along a Morton curve, and build the
        tree; ``order`` (n,) has the number of the simplex at each position along the curve."""
        n = len(simplices)
        self.dim = points.shape[1]
        self.order = morton_order(
            sum(points[corner] for corner in simplices.T) / simplices.shape[1]
        )
        self.simplices = np.ascontiguousarray(simplices[self.order], dtype=np.int32)
        n_leaves = 1
        while n_leaves * LEAF_SIZE < n:
            n_leaves *= 2
        self.boxes = np.empty((2 * n_leaves - 1, 2 * self.dim))
        _build(points, self.simplices, n_leaves, self.boxes)
        self.points = padded(points)

    def nearest(self, queries: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the number (n,) of the simplex nearest to each of ``queries`` (n, dim), the weights (n, k)
        of its corners in the closest point, and the distances (n,)."""
        n = len(queries)
        found = np.empty(n, dtype=np.int64)
        weights = np.empty((n, self.simplices.shape[1]))
        distance = np.empty(n)
        _nearest(
            padded(queries),
            self.points,
            self.simplices,
            self.boxes,
            self.dim,
            found,
            weights,
            distance,
        )
        return self.order[found], weights, distance

    def meeting(
        self, frames: np.ndarray, origins: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return pairs as two arrays (n_pairs,), the number of a turned box and that of a simplex that meets
        it; the boxes have ``frames`` (n, dim, dim), ``origins``, ``low`` and ``high`` (n, dim) as of
        :func:`meet_turned`."""
        start = np.zeros(len(frames) + 1, dtype=np.int64)
        arguments = (frames, origins, low, high, self.boxes, self.points, self.simplices, start)
        # first without, then with ``fill``: the counts say where the pairs of each box go
        meet_turned(*arguments, False, np.empty(0, dtype=np.int64))
        np.cumsum(start, out=start)
        found = np.empty(start[-1], dtype=np.int64)
        meet_turned(*arguments, True, found)
        return np.repeat(np.arange(len(frames)), np.diff(start)), self.order[found]


def padded(points: np.ndarray) -> np.ndarray:
    """Return points (n, dim) as (n, 3), z = 0 in 2D."""
    result = np.zeros((len(points), 3))
    result[:, : points.shape[1]] = points
    return result


#: by dimension the shifts and masks that put one or two zero bits between the lower 31 or 21 bits
_SPREAD = {
    2: np.array(
        [
            (16, 0x0000FFFF0000FFFF),
            (8, 0x00FF00FF00FF00FF),
            (4, 0x0F0F0F0F0F0F0F0F),
            (2, 0x3333333333333333),
            (1, 0x5555555555555555),
        ],
        dtype=np.uint64,
    ),
    3: np.array(
        [
            (32, 0x001F00000000FFFF),
            (16, 0x001F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ],
        dtype=np.uint64,
    ),
}


def morton_order(points: np.ndarray) -> np.ndarray:
    """Return the order of points (n, dim), dim 2 or 3, along the Z-curve of their own bounding
    box."""
    dim = points.shape[1]
    codes = np.zeros(len(points), dtype=np.uint64)
    if len(points):
        # column by column: several times faster than along an axis of 2 or 3
        low = np.array([column.min() for column in points.T])
        extent = max(column.max() - least for column, least in zip(points.T, low, strict=True))
        scale = (2.0 ** (31 if dim == 2 else 21) - 1) / extent if extent > 0 else 0.0
        # of a copy: kernels are compiled separately for read-only and for strided arrays
        _add_codes(np.array(points, order="C"), low, scale, _SPREAD[dim], codes)
    return np.argsort(codes, kind="stable")


@kernel
def _add_codes(points, low, scale, spread, codes):
    """Add the Morton codes of points (n, dim) to ``codes`` (n,): the interleaved bits of their
    distances from ``low`` (dim,) times ``scale``, ``spread`` being that of _SPREAD. Meshing by a size
    field asks for those of 300 points a hundred times a mesh, for which numpy takes five times as
    long."""
    for i in range(len(points)):
        for c in range(len(low)):
            bits = np.uint64((points[i, c] - low[c]) * scale)
            for k in range(len(spread)):
                bits = (bits | (bits << spread[k, 0])) & spread[k, 1]
            codes[i] |= bits << np.uint64(c)


@inner_kernel
def _dot_from(points, a, b, x, c):
    """Return (x_b - x_a) . (x - x_c)."""
    total = 0.0
    for m in range(3):
        total += (points[b, m] - points[a, m]) * (x[m] - points[c, m])
    return total


@inner_kernel
def _on_segment(points, a, b, x):
    """Return the weight of b in the point of the segment (a, b) closest to x."""
    length = _dot_from(points, a, b, points[b], a)
    if length == 0.0:
        return 0.0
    return min(max(_dot_from(points, a, b, x, a) / length, 0.0), 1.0)


@inner_kernel
def _on_triangle(points, a, b, c, x):
    """Return the weights of b and c in the point of the triangle (a, b, c) closest to x: tests in
    turn whether that is a, b, on the edge a b, c, on a c, on b c, or inside (Ericson, with his
    names)."""
    d1 = _dot_from(points, a, b, x, a)
    d2 = _dot_from(points, a, c, x, a)
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0
    d3 = _dot_from(points, a, b, x, b)
    d4 = _dot_from(points, a, c, x, b)
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return _on_segment(points, a, b, x), 0.0
    d5 = _dot_from(points, a, b, x, c)
    d6 = _dot_from(points, a, c, x, c)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, _on_segment(points, a, c, x)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = _on_segment(points, b, c, x)
        return 1.0 - t, t
    total = va + vb + vc
    return vb / total, vc / total


@inner_kernel
def _squared_distance(points, corners, weights, x):
    """Return the squared distance of ``x`` (3,) from the point with these weights (k,) of ``corners``."""
    total = 0.0
    for m in range(3):
        difference = x[m]
        for k in range(len(corners)):
            difference -= weights[k] * points[corners[k], m]
        total += difference * difference
    return total


@inner_kernel
def closest_on_simplex(points, corners, x, weights, trial):
    """Compute the weights (k,) of the point of the simplex ``corners`` (k,), k = 2, 3, 4, closest
    to ``x`` (3,). ``trial`` (k,) is scratch. Returns the squared distance."""
    k = len(corners)
    if k == 2:
        weights[1] = _on_segment(points, corners[0], corners[1], x)
        weights[0] = 1.0 - weights[1]
        return _squared_distance(points, corners, weights, x)
    if k == 3:
        weights[1], weights[2] = _on_triangle(points, corners[0], corners[1], corners[2], x)
        weights[0] = max(1.0 - weights[1] - weights[2], 0.0)
        return _squared_distance(points, corners, weights, x)
    best = np.inf
    for opposite in range(4):
        a = (opposite + 1) % 4
        b = (opposite + 2) % 4
        c = (opposite + 3) % 4
        wb, wc = _on_triangle(points, corners[a], corners[b], corners[c], x)
        trial[opposite] = 0.0
        trial[a] = max(1.0 - wb - wc, 0.0)
        trial[b] = wb
        trial[c] = wc
        distance = _squared_distance(points, corners, trial, x)
        if distance < best:
            best = distance
            for m in range(4):
                weights[m] = trial[m]
    return best
