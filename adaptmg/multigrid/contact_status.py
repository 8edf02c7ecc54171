"""Numba kernel: the status of contact nodes after a sweep and their natural residual."""

from __future__ import annotations

import numpy as np

from adaptmg.multigrid.contact_loops import BACKWARDS, CLOSED, HELD, SLIPS
from adaptmg.runtime.compiled import kernel
from adaptmg.smoother.blocks import in_loop, inner, read, read_upper, times
from adaptmg.smoother.node_solve import natural_at, read_reference

__all__ = ["classify"]


@kernel
def classify(zero, nodes, frames, blocks, gap, reference, limit, friction, values, defect, codes, pressure):
    """Update ``codes`` and ``pressure`` from local unknowns and the residual ``defect`` (n_dofs,).

    ``zero`` are dim zeros, see :mod:`adaptmg.smoother.blocks`. Returns the number of codes that changed, and the sums
    of squares of the natural residual and of the reactions.
    """
    dim = np.uint64(len(zero))
    changed = 0
    natural = 0.0
    reactions = 0.0
    for node in range(len(nodes)):
        k = np.uint64(node)
        r = times(frames, dim * dim * k, read(defect, dim * np.uint64(nodes[k]), zero))
        w, place = read(values, dim * k, zero), read_reference(reference, k, zero)
        code = CLOSED if w[0] == gap[k] else 0
        if limit[k] > 0.0 or (code and friction[k] > 0.0):
            code += _tangential(w, place)
        changed += code != codes[k]
        codes[k] = code
        p = max(r[0], 0.0)
        pressure[k] = p
        g = natural_at(read_upper(blocks, k, zero), r, w, gap[k], place, limit[k] + friction[k] * p)
        natural += inner(g, g)
        reactions += inner(r, r)
    return changed, natural, reactions


@in_loop
def _tangential(w, reference):
    """The code of the slip; in 3D its direction is no part of it."""
    if len(w) == 2:
        if w[1] == reference[0]:
            return HELD
        return SLIPS if w[1] > reference[0] else BACKWARDS
    return HELD if w[1] == reference[0] and w[2] == reference[1] else SLIPS
