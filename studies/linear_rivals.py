"""Linear solvers on the glued problem (all contact dofs fixed): rivals stopped at a true error.

Each rival first runs to a relative energy error of 1e-8, measured against its own solution at
1e-13, to learn how many iterations that takes; then exactly that many are timed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyamg
from scipy import sparse

import adaptmg as am
from adaptmg.multigrid.linear_cycle import LinearCycle
from adaptmg.multigrid.split_matrix import nodal_prolongations, split
from adaptmg.solver.record import Run
from adaptmg.transfer import without_fixed

TOLERANCE = 1e-8


@dataclass(frozen=True)
class Glued:
    """The glued linear problem of one hierarchy."""

    hierarchy: am.Hierarchy
    matrix: sparse.bsr_array
    load: np.ndarray
    modes: np.ndarray
    fixed: list[np.ndarray]


def glued(hierarchy: am.Hierarchy) -> Glued:
    """All contact dofs fixed, on every level."""
    fixed = []
    for level in hierarchy.levels:
        mask = level.discrete.fixed.copy().reshape(-1, level.discrete.dim)
        mask[level.discrete.contact.nodes] = True
        fixed.append(mask.reshape(-1))
    finest = hierarchy.finest.discrete
    load = np.where(fixed[-1], 0.0, finest.load)
    modes = np.where(fixed[-1][:, None], 0.0, finest.near_nullspace)
    return Glued(hierarchy, without_fixed(finest.matrix, fixed[-1]), load, modes, fixed)


def conjugate_gradients(
    matrix: sparse.bsr_array,
    load: np.ndarray,
    precondition: Callable[[np.ndarray], np.ndarray],
    iterations: int,
    exact: np.ndarray | None = None,
) -> tuple[np.ndarray, int]:
    """Preconditioned conjugate gradients; with ``exact`` until the relative energy error is
    1e-8."""
    x, r = np.zeros_like(load), load.copy()
    size = 1.0 if exact is None else float(np.sqrt(exact @ (matrix @ exact)))
    z = precondition(r).copy()
    p, rz = z.copy(), float(r @ z)
    first = rz
    for k in range(1, iterations + 1):
        product = matrix @ p
        alpha = rz / float(p @ product)
        x += alpha * p
        r -= alpha * product
        z = precondition(r)
        before, rz = rz, float(r @ z)
        if exact is not None:
            error = x - exact
            if np.sqrt(max(error @ (matrix @ error), 0.0)) <= TOLERANCE * size:
                return x, k
        elif iterations == REFERENCE and rz <= 1e-26 * first:
            return x, k
        p *= rz / before
        p += z
    return x, iterations


REFERENCE = 400


def iterations_needed(problem: Glued, precondition: Callable[[np.ndarray], np.ndarray]) -> int:
    """Iterations to the true error of 1e-8."""
    exact, _ = conjugate_gradients(problem.matrix, problem.load, precondition, REFERENCE)
    return conjugate_gradients(problem.matrix, problem.load, precondition, REFERENCE - 1, exact)[1]


def pyamg_preconditioner(problem: Glued) -> Callable[[np.ndarray], np.ndarray]:
    """Smoothed aggregation with rigid-body modes, pyamg's defaults; one V-cycle an application."""
    hierarchy = pyamg.smoothed_aggregation_solver(
        sparse.bsr_matrix(problem.matrix), B=problem.modes
    )
    return hierarchy.aspreconditioner(cycle="V").matvec


def geometric_preconditioner(problem: Glued) -> Callable[[np.ndarray], np.ndarray]:
    """The linear V-cycle of the package (symmetric), on the glued matrices."""
    run = Run(unit=problem.matrix.nnz)
    levels = [
        split(level.discrete.matrix, fixed)
        for level, fixed in zip(problem.hierarchy.levels, problem.fixed, strict=True)
    ]
    cycle = LinearCycle(levels, nodal_prolongations(problem.hierarchy), run, [2] * len(levels))
    cycle.factors.renew()
    top = len(levels) - 1

    return lambda r: cycle.solve(top, r)


def iterate(
    problem: Glued, precondition: Callable[[np.ndarray], np.ndarray], iterations: int
) -> None:
    """Iterate n times."""
    conjugate_gradients(problem.matrix, problem.load, precondition, iterations)
