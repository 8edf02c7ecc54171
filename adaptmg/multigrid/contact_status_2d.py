"""Numba kernel: the status of contact nodes after a sweep and their natural residual, 2D."""

from __future__ import annotations

import numpy as np
from numba import njit

from adaptmg.multigrid.contact_loops import BACKWARDS, CLOSED, HELD, SLIPS
from adaptmg.smoother.node_solve import solve_2d

__all__ = ["classify"]


@njit(cache=True)
def classify(nodes, frames, blocks, gap, reference, limit, friction, values, r, codes, pressure):
    """Update ``codes`` and ``pressure`` from local unknowns and the residual r (n_dofs,).

    Returns the number of codes that changed, and the sums of squares of the natural residual and of the reactions.
    """
    changed = 0
    natural = 0.0
    reactions = 0.0
    for k in range(len(nodes)):
        at = 2 * np.int64(nodes[k])
        r_n = frames[4 * k] * r[at] + frames[4 * k + 1] * r[at + 1]
        r_t = frames[4 * k + 2] * r[at] + frames[4 * k + 3] * r[at + 1]
        w_n, w_t = values[2 * k], values[2 * k + 1]
        code = 0
        if w_n == gap[k]:
            code = CLOSED
        if limit[k] > 0.0 or (code and friction[k] > 0.0):
            if w_t == reference[k]:
                code += HELD
            elif w_t > reference[k]:
                code += SLIPS
            else:
                code += BACKWARDS
        changed += code != codes[k]
        codes[k] = code
        p = max(r_n, 0.0)
        pressure[k] = p
        d_nn, d_nt, d_tt = blocks[3 * k], blocks[3 * k + 1], blocks[3 * k + 2]
        new_n, new_t = solve_2d(d_nn, d_nt, d_tt, r_n + d_nn * w_n + d_nt * w_t, r_t + d_nt * w_n + d_tt * w_t,
                                gap[k], reference[k], limit[k] + friction[k] * p, 0.0)
        new_n, new_t = new_n - w_n, new_t - w_t
        natural += (d_nn * new_n + d_nt * new_t) ** 2 + (d_nt * new_n + d_tt * new_t) ** 2
        reactions += r_n * r_n + r_t * r_t
    return changed, natural, reactions
