"""Numba kernel: the status of contact nodes after a sweep and their natural residual, 3D."""

from __future__ import annotations

import numpy as np
from numba import njit

from adaptmg.multigrid.contact_loops import CLOSED, HELD, SLIPS
from adaptmg.smoother.node_solve import solve_3d

__all__ = ["classify"]


@njit(cache=True)
def classify(nodes, frames, blocks, gap, reference, limit, friction, values, r, codes, pressure):
    """See :func:`adaptmg.multigrid.contact_status_2d.classify`; the direction of a slip is no part of the code."""
    changed = 0
    natural = 0.0
    reactions = 0.0
    local = np.empty(3)
    for k in range(len(nodes)):
        at = 3 * np.int64(nodes[k])
        for a in range(3):
            f = 9 * k + 3 * a
            local[a] = frames[f] * r[at] + frames[f + 1] * r[at + 1] + frames[f + 2] * r[at + 2]
        w_n, w_1, w_2 = values[3 * k], values[3 * k + 1], values[3 * k + 2]
        ref_1, ref_2 = reference[2 * k], reference[2 * k + 1]
        code = 0
        if w_n == gap[k]:
            code = CLOSED
        if limit[k] > 0.0 or (code and friction[k] > 0.0):
            code += HELD if w_1 == ref_1 and w_2 == ref_2 else SLIPS
        changed += code != codes[k]
        codes[k] = code
        p = max(local[0], 0.0)
        pressure[k] = p
        b = 6 * k
        d_nn, d_n1, d_n2, d_11, d_12, d_22 = (blocks[b], blocks[b + 1], blocks[b + 2], blocks[b + 3], blocks[b + 4],
                                              blocks[b + 5])
        new_n, new_1, new_2 = solve_3d(
            d_nn, d_n1, d_n2, d_11, d_12, d_22, local[0] + d_nn * w_n + d_n1 * w_1 + d_n2 * w_2,
            local[1] + d_n1 * w_n + d_11 * w_1 + d_12 * w_2, local[2] + d_n2 * w_n + d_12 * w_1 + d_22 * w_2,
            gap[k], ref_1, ref_2, limit[k] + friction[k] * p, 0.0)
        new_n, new_1, new_2 = new_n - w_n, new_1 - w_1, new_2 - w_2
        natural += ((d_nn * new_n + d_n1 * new_1 + d_n2 * new_2) ** 2
                    + (d_n1 * new_n + d_11 * new_1 + d_12 * new_2) ** 2
                    + (d_n2 * new_n + d_12 * new_1 + d_22 * new_2) ** 2)
        reactions += local[0] ** 2 + local[1] ** 2 + local[2] ** 2
    return changed, natural, reactions
