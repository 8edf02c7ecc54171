"""Kernels of the transport of contact data: minima over the supports S_k of the columns of P.

``indptr``, ``nodes`` hold S_k as in a CSC matrix; results are written to the last argument.
"""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import kernel

__all__ = ["largest", "minmod_line", "minmod_plane", "smallest"]


@kernel
def smallest(indptr, nodes, values, result):
    """Minimum over S_k, +inf where it is empty."""
    for k in range(len(indptr) - 1):
        result[k] = np.inf
        for at in range(indptr[k], indptr[k + 1]):
            result[k] = min(result[k], values[nodes[at]])


@kernel
def largest(indptr, nodes, values, result):
    """Maximum over S_k, +inf where it is empty."""
    for k in range(len(indptr) - 1):
        result[k] = np.inf if indptr[k] == indptr[k + 1] else -np.inf
        for at in range(indptr[k], indptr[k + 1]):
            result[k] = max(result[k], values[nodes[at]])


@kernel
def minmod_line(indptr, nodes, slip, stick, result):
    """2D: the slip of smallest magnitude, 0 unless all slips in S_k have one sign and none sticks."""
    for k in range(len(indptr) - 1):
        result[k] = 0.0
        for at in range(indptr[k], indptr[k + 1]):
            i = nodes[at]
            value = slip[i]
            first = at == indptr[k]
            if stick[i] or value == 0.0 or (not first and (value > 0.0) != (result[k] > 0.0)):
                result[k] = 0.0
                break
            if first or abs(value) < abs(result[k]):
                result[k] = value


@kernel
def minmod_plane(indptr, nodes, slip, stick, sine, result):
    """3D: the shortest slip, 0 unless all slips in S_k point its way within an angle below 90 degrees."""
    for k in range(len(indptr) - 1):
        result[k, 0], result[k, 1] = 0.0, 0.0
        shortest, length = -1, np.inf
        for at in range(indptr[k], indptr[k + 1]):
            i = nodes[at]
            norm = 0.0 if stick[i] else np.hypot(slip[i, 0], slip[i, 1])
            if norm < length:
                shortest, length = i, norm
        if shortest < 0 or length == 0.0:
            continue
        parallel = True
        for at in range(indptr[k], indptr[k + 1]):
            i = nodes[at]
            scale = length * np.hypot(slip[i, 0], slip[i, 1])
            dot = slip[i, 0] * slip[shortest, 0] + slip[i, 1] * slip[shortest, 1]
            cross = slip[i, 0] * slip[shortest, 1] - slip[i, 1] * slip[shortest, 0]
            if not dot > 0.0 or abs(cross) > sine * scale:
                parallel = False
                break
        if parallel:
            result[k, 0], result[k, 1] = slip[shortest, 0], slip[shortest, 1]
