"""Past: what is known before a load step, on every level; and the protocol of what goes from step to step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.sparse.linalg import lsmr

from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.result.examiner import Examiner
from adaptmg.solver.run import Outcome, Run

__all__ = ["Past", "StepSolver", "better_start", "coarse_displacements", "past_of"]


@dataclass(frozen=True, eq=False)
class Past:
    """What is known before a step.

    Attributes
    ----------
    levels : list of (n_dofs,) arrays
        Displacement of the step before, coarsest level first, Cartesian, m; between bodies relative. On the finest
        level alone where the coarse ones are no contact problems.
    extrapolated : (n_dofs,) array
        On the finest level; the displacement of the step before where nothing is known.
    given : bool
        Whether there is a step before, or a start.
    """

    levels: list[np.ndarray]
    extrapolated: np.ndarray
    given: bool


class StepSolver(Protocol):
    """What :func:`adaptmg.solve_path` needs of a method."""

    def run(self, hierarchy: Hierarchy, examiner: Examiner, run: Run, past: Past
            ) -> tuple[Outcome, list[np.ndarray] | None]:
        """Solve a step; with the displacement of the coarse levels if the method has it."""

    def replay(self, hierarchy: Hierarchy, past: Past, rtol: float) -> list[np.ndarray] | None:
        """The coarse displacements of a step whose result is known, solved to ``rtol``."""


def better_start(examiner: Examiner, past: Past, run: Run) -> np.ndarray:
    """The displacement of the step before or the extrapolated one, whichever has the smaller natural residual."""
    with run.phase("start"):
        return min(past.levels[-1], past.extrapolated, key=examiner.relative_residual)


def past_of(hierarchy: Hierarchy, displacement: np.ndarray, given: bool) -> Past:
    """What is known before the first step: a displacement (n_dofs,) of the finest level, zero if none is given."""
    if not hierarchy.discretised:
        return Past([displacement], displacement, given)
    if not given:
        return Past([np.zeros(level.discrete.n_dofs) for level in hierarchy.levels], displacement, given)
    return Past(coarse_displacements(hierarchy, displacement), displacement, given)


def coarse_displacements(hierarchy: Hierarchy, displacement: np.ndarray) -> list[np.ndarray]:
    """A displacement of the finest level on all levels: each next coarser one that interpolates it best.

    Parameters
    ----------
    hierarchy : Hierarchy
        Discretised on all levels.
    displacement : (n_dofs,) array
        m; between bodies relative.

    Returns
    -------
    list of (n_dofs,) arrays
        Coarsest first, least squares in the nodal values.
    """
    result = [displacement]
    for level in reversed(hierarchy.levels[1:]):
        columns = result[0].reshape(level.n_nodes, -1).T
        nodal = [lsmr(level.prolongation, column, atol=1e-8, btol=1e-8)[0] for column in columns]
        result.insert(0, np.stack(nodal, axis=1).reshape(-1))
    return result
