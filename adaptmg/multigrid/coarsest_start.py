"""The contact problem of the coarsest level, by projected symmetric sweeps: where a nested start begins."""

from __future__ import annotations

import numpy as np

from adaptmg.multigrid import projected_sweeps_2d, projected_sweeps_3d
from adaptmg.multigrid.correction import Recorder
from adaptmg.multigrid.halves import Halves
from adaptmg.multigrid.obstacle import Obstacle

__all__ = ["solve_coarsest"]

_SWEEPS = {2: projected_sweeps_2d, 3: projected_sweeps_3d}
BATCH, MOST = 25, 2000


def solve_coarsest(level: Halves, obstacle: Obstacle, load: np.ndarray, unknowns: np.ndarray, rtol: float,
                   recorder: Recorder) -> None:
    """Sweep until the natural residual is ``rtol`` times that of the first sweeps, or for ``MOST`` sweeps; in place.

    Parameters
    ----------
    level : Halves
    obstacle : Obstacle
    load, unknowns : (n_dofs,) arrays
        Cartesian, N and m.
    rtol : float
    recorder : Recorder
        Counts the passes.
    """
    sweeps, defect = _SWEEPS[level.dim], np.zeros_like(load)
    first, done = np.inf, 0
    while done < MOST:
        for _ in range(BATCH):
            sweeps.backward(*level.lower_arrays, *level.upper_arrays, level.inverse, load, obstacle.contact_of,
                            *obstacle.node_data, unknowns, defect)
            sweeps.forward(*level.lower_arrays, level.inverse, obstacle.diagonal, obstacle.contact_of,
                           *obstacle.node_data, unknowns, defect)
        done += BATCH
        status = obstacle.look(defect)
        at = (obstacle.nodes[:, None].astype(np.int64) * level.dim + np.arange(level.dim)).reshape(-1)
        size = np.sqrt(max(defect @ defect - defect[at] @ defect[at], 0.0) + status.natural)
        first = size if done == BATCH else first
        if size <= rtol * first:
            break
    recorder.count(1.5 * done, level.nonzeros)
    recorder.visit(0, "solve", done)
