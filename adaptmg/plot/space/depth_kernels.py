r"""Kernels of the depth buffer: triangles and lines on a raster of pixels, the nearest on top.

A pixel with centre x lies in a triangle where its barycentric coordinates :math:`w_k` are all >= 0; depth and colour
are :math:`\sum_k w_k z_k` (after the perspective division depth is linear on the screen) and :math:`\sum_k w_k c_k`.
The distance to the edge opposite corner k is :math:`w_k \cdot 2A / \ell_k`.
"""

from __future__ import annotations

from adaptmg.runtime.compiled import kernel

__all__ = ["raster_segments", "raster_triangles"]


@kernel
def raster_triangles(corners, colors, ink, width, image, depth):
    """Draw triangles.

    ``corners`` (n, 3, 3): x, y in pixels, depth (smaller is nearer) of each corner; ``colors`` (n, 3, 3) rgb of each
    corner; ``ink`` (3,) colour of edges drawn ``width`` pixels wide (0 for none), half in each triangle. ``image``
    (rows, columns, 4) and ``depth`` (rows, columns) are changed.
    """
    rows, columns = depth.shape
    for t in range(len(corners)):
        x0, y0, z0 = corners[t, 0]
        x1, y1, z1 = corners[t, 1]
        x2, y2, z2 = corners[t, 2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-12:
            continue
        l0 = ((x2 - x1) ** 2 + (y2 - y1) ** 2) ** 0.5
        l1 = ((x0 - x2) ** 2 + (y0 - y2) ** 2) ** 0.5
        l2 = ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5
        first_row = max(int(min(y0, y1, y2) - 0.5), 0)
        last_row = min(int(max(y0, y1, y2) + 0.5), rows - 1)
        first_column = max(int(min(x0, x1, x2) - 0.5), 0)
        last_column = min(int(max(x0, x1, x2) + 0.5), columns - 1)
        for i in range(first_row, last_row + 1):
            y = i + 0.5
            for j in range(first_column, last_column + 1):
                x = j + 0.5
                w0 = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) / area
                w1 = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) / area
                w2 = 1.0 - w0 - w1
                if w0 < -1e-9 or w1 < -1e-9 or w2 < -1e-9:
                    continue
                z = w0 * z0 + w1 * z1 + w2 * z2
                if z >= depth[i, j]:
                    continue
                depth[i, j] = z
                near = min(w0 * abs(area) / l0, w1 * abs(area) / l1, w2 * abs(area) / l2)
                edge = near < 0.5 * width
                for k in range(3):
                    if edge:
                        image[i, j, k] = ink[k]
                    else:
                        image[i, j, k] = w0 * colors[t, 0, k] + w1 * colors[t, 1, k] + w2 * colors[t, 2, k]
                image[i, j, 3] = 1.0


@kernel
def raster_segments(ends, ink, width, dash, space, bias, image, depth):
    """Draw the parts of segments that nothing hides.

    ``ends`` (n, 2, 3): x, y in pixels and depth of both ends; ``width``, ``dash`` and ``space`` in pixels (``space`` 0:
    solid); what lies nearer by no more than ``bias`` does not hide.
    """
    rows, columns = depth.shape
    reach = int(0.5 * width + 1.0)
    for s in range(len(ends)):
        dx, dy, dz = ends[s, 1] - ends[s, 0]
        length = (dx * dx + dy * dy) ** 0.5
        steps = int(2.0 * length) + 1
        # dashes by the place along the whole line, so that they run on over the short segments of a mesh
        along = 1.0 / max(length, 1e-300)
        if dx < 0.0 or (dx == 0.0 and dy < 0.0):
            along = -along
        for m in range(steps + 1):
            t = m / steps
            x, y, z = ends[s, 0, 0] + t * dx, ends[s, 0, 1] + t * dy, ends[s, 0, 2] + t * dz
            if space > 0.0 and (along * (x * dx + y * dy)) % (dash + space) > dash:
                continue
            for i in range(max(int(y) - reach, 0), min(int(y) + reach, rows - 1) + 1):
                for j in range(max(int(x) - reach, 0), min(int(x) + reach, columns - 1) + 1):
                    if (i + 0.5 - y) ** 2 + (j + 0.5 - x) ** 2 <= 0.25 * width * width and z <= depth[i, j] + bias:
                        for k in range(3):
                            image[i, j, k] = ink[k]
                        image[i, j, 3] = 1.0
