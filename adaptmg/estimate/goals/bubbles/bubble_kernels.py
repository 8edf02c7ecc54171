r"""Kernel of the edge bubbles :math:`b_E = 4 \lambda_a \lambda_b`: their stiffness blocks, and residuals against them.

With :math:`g = \nabla b_E`, and in axisymmetry :math:`h = b_E / r` and weight :math:`2 \pi r` (elsewhere h = 0),

.. math:: a(b_E e_i, b_E e_j) = \int \lambda\,(g_i + \delta_{i0} h)(g_j + \delta_{j0} h)
          + \mu\,(g_i g_j + \delta_{ij} |g|^2) + 2 \mu\,\delta_{i0} \delta_{j0} h^2,
          \qquad a(u, b_E e_i) = \int \sum_j \sigma_{ij}(u)\, g_j + \delta_{i0}\,\sigma_{\theta\theta}(u)\, h .
"""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import inner_kernel, kernel

__all__ = ["add_bubbles"]


@inner_kernel
def _gradients(points, corners, g):
    """Gradients of the barycentric coordinates into ``g`` (dim + 1, dim); returns the volume."""
    dim = points.shape[1]
    o = corners[0]
    ax, ay = points[corners[1], 0] - points[o, 0], points[corners[1], 1] - points[o, 1]
    bx, by = points[corners[2], 0] - points[o, 0], points[corners[2], 1] - points[o, 1]
    if dim == 2:
        det = ax * by - ay * bx
        g[1, 0], g[1, 1] = by / det, -bx / det
        g[2, 0], g[2, 1] = -ay / det, ax / det
        volume = 0.5 * det
    else:
        az, bz = points[corners[1], 2] - points[o, 2], points[corners[2], 2] - points[o, 2]
        cx, cy = points[corners[3], 0] - points[o, 0], points[corners[3], 1] - points[o, 1]
        cz = points[corners[3], 2] - points[o, 2]
        g[1, 0], g[1, 1], g[1, 2] = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        g[2, 0], g[2, 1], g[2, 2] = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
        g[3, 0], g[3, 1], g[3, 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        det = ax * g[1, 0] + ay * g[1, 1] + az * g[1, 2]
        for k in range(1, 4):
            for i in range(3):
                g[k, i] /= det
        volume = det / 6
    for i in range(dim):
        total = 0.0
        for c in range(1, dim + 1):
            total += g[c, i]
        g[0, i] = -total
    return volume


@inner_kernel
def _stress(lame, shear, corners, g, field, hoop, sigma):
    """Cartesian stress of a P1 field with the hoop strain ``hoop``, into ``sigma`` (dim, dim); returns the hoop one."""
    dim = g.shape[1]
    trace = hoop
    for i in range(dim):
        for j in range(dim):
            total = 0.0
            for c in range(dim + 1):
                v = corners[c]
                total += shear * (field[v, i] * g[c, j] + field[v, j] * g[c, i])
            sigma[i, j] = total
        for c in range(dim + 1):
            trace += field[corners[c], i] * g[c, i]
    for i in range(dim):
        sigma[i, i] += lame * trace
    return lame * trace + 2 * shear * hoop


@kernel
def add_bubbles(points, elements, body, lame, shear, local, element_edges, axisymmetric, rule, weights, fields,
                blocks, actions):
    """Add the blocks a(b e_i, b e_j) of every edge and the actions a(field, b e_i) of every field.

    ``local`` (k, 2) are the corners of an element's edges, ``element_edges`` (n_elements, k) their numbers; ``fields``
    (n_fields, n_nodes, dim); ``blocks`` (n_edges, dim, dim) and ``actions`` (n_fields, n_edges, dim) come as 0.
    """
    dim, n_fields = points.shape[1], len(fields)
    g, sigma, gb = np.empty((dim + 1, dim)), np.empty((dim, dim)), np.empty(dim)
    for e in range(len(elements)):
        corners = elements[e]
        volume = _gradients(points, corners, g)
        la, mu = lame[body[e]], shear[body[e]]
        for q in range(len(weights)):
            w, r = volume * weights[q], 1.0
            if axisymmetric:
                r = 0.0
                for c in range(dim + 1):
                    r += rule[q, c] * points[corners[c], 0]
                w *= 2 * np.pi * r
            for k in range(len(local)):
                edge, first, second = element_edges[e, k], local[k, 0], local[k, 1]
                l1, l2 = rule[q, first], rule[q, second]
                square = 0.0
                for i in range(dim):
                    gb[i] = 4 * (l1 * g[second, i] + l2 * g[first, i])
                    square += gb[i] * gb[i]
                h = 4 * l1 * l2 / r if axisymmetric else 0.0
                for i in range(dim):
                    di = gb[i] + (h if i == 0 else 0.0)
                    for j in range(dim):
                        dj = gb[j] + (h if j == 0 else 0.0)
                        blocks[edge, i, j] += w * (la * di * dj + mu * gb[i] * gb[j])
                    blocks[edge, i, i] += w * mu * square
                blocks[edge, 0, 0] += w * 2 * mu * h * h
            for f in range(n_fields):
                hoop = 0.0
                if axisymmetric:
                    for c in range(dim + 1):
                        hoop += rule[q, c] * fields[f, corners[c], 0]
                    hoop /= r
                around = _stress(la, mu, corners, g, fields[f], hoop, sigma)
                for k in range(len(local)):
                    edge, first, second = element_edges[e, k], local[k, 0], local[k, 1]
                    l1, l2 = rule[q, first], rule[q, second]
                    for j in range(dim):
                        gj = 4 * (l1 * g[second, j] + l2 * g[first, j])
                        for i in range(dim):
                            actions[f, edge, i] += w * sigma[i, j] * gj
                    if axisymmetric:
                        actions[f, edge, 0] += w * around * 4 * l1 * l2 / r


@kernel
def apply_bubbles(points, elements, body, lame, shear, local, element_edges, axisymmetric, rule, weights, values,
                  result):
    """Add the actions a(sum of bubbles, b e_i) of all edges to ``result`` (n_edges, dim); ``values`` (n_edges, dim)."""
    dim, n_local = points.shape[1], len(local)
    g, sigma, gb, bubble = np.empty((dim + 1, dim)), np.empty((dim, dim)), np.empty((n_local, dim)), np.empty(n_local)
    for e in range(len(elements)):
        corners = elements[e]
        volume = _gradients(points, corners, g)
        la, mu = lame[body[e]], shear[body[e]]
        for q in range(len(weights)):
            w, r = volume * weights[q], 1.0
            if axisymmetric:
                r = 0.0
                for c in range(dim + 1):
                    r += rule[q, c] * points[corners[c], 0]
                w *= 2 * np.pi * r
            hoop, trace = 0.0, 0.0
            sigma[:] = 0.0
            for k in range(n_local):
                edge, first, second = element_edges[e, k], local[k, 0], local[k, 1]
                l1, l2 = rule[q, first], rule[q, second]
                bubble[k] = 4 * l1 * l2
                hoop += bubble[k] * values[edge, 0] / r
                for j in range(dim):
                    gb[k, j] = 4 * (l1 * g[second, j] + l2 * g[first, j])
                    trace += gb[k, j] * values[edge, j]
                    for i in range(dim):
                        sigma[i, j] += mu * gb[k, j] * values[edge, i]
                        sigma[j, i] += mu * gb[k, j] * values[edge, i]
            if not axisymmetric:
                hoop = 0.0
            trace += hoop
            for i in range(dim):
                sigma[i, i] += la * trace
            around = la * trace + 2 * mu * hoop
            for k in range(n_local):
                edge = element_edges[e, k]
                for i in range(dim):
                    for j in range(dim):
                        result[edge, i] += w * sigma[i, j] * gb[k, j]
                if axisymmetric:
                    result[edge, 0] += w * around * bubble[k] / r
