"""What one's own linear solver and smoother must offer to take part in the linear cycle, and how they are called."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from scipy import sparse

from adaptmg.multigrid.linear.split_matrix import SplitMatrix
from adaptmg.problem import check_arrays, checks

__all__ = ["LinearSmoother", "LinearSolve", "OwnSmoother", "OwnSolve", "regular_matrix"]


class LinearSolve(Protocol):
    """One's own solver of the coarsest linear problems."""

    def setup(self, matrix: sparse.csr_array) -> Any:
        """Prepare for a matrix (n_dofs, n_dofs): return an object with ``solve(rhs (n_dofs,)) -> (n_dofs,) array``.

        Called whenever the contact status changes the matrix. It has a diagonal entry alone where dofs are fixed or
        truncated; with Coulomb friction it is not symmetric; where only contact holds a body it may be singular. An
        object with a number ``passes``, the passes over the matrix that its last solve took, has them counted as work.
        """


class LinearSmoother(Protocol):
    """One's own smoother of the linear problems between the coarsest level and the finest."""

    def setup(self, matrix: sparse.csr_array) -> Any:
        """Prepare for a matrix as :meth:`LinearSolve.setup`: return an object with ``smooth(rhs, x) -> passes``.

        That improves x (n_dofs,) in place and returns the passes over the matrix that it took.
        """


def regular_matrix(level: SplitMatrix, scale: np.ndarray) -> sparse.csr_array:
    """The matrix of a level with entries of ``scale`` (n_dofs,) on the diagonal where rows are empty."""
    matrix = sparse.csr_array(level.matrix())
    empty = np.asarray(abs(matrix).sum(axis=1)).reshape(-1) == 0
    return matrix + sparse.diags_array(np.where(empty, scale, 0.0))


class OwnSolve:
    """A :class:`LinearSolve` set up for a matrix."""

    def __init__(self, own: LinearSolve, matrix: sparse.csr_array) -> None:
        self._solver = checks.offers("coarse_solve: what setup returns", own.setup(matrix), "solve",
                                     "an object with solve(rhs) -> solution")

    def solve(self, load: np.ndarray, result: np.ndarray) -> float:
        """Solve into ``result``; returns the passes it took."""
        # a copy: what is handed out may be changed
        result[:] = check_arrays.array("coarse_solve: what solve returns", self._solver.solve(load.copy()), load.shape)
        return checks.nonnegative("coarse_solve: passes", getattr(self._solver, "passes", 0.0))


class OwnSmoother:
    """A :class:`LinearSmoother` set up for a level as its matrix is now."""

    def __init__(self, own: LinearSmoother, level: SplitMatrix) -> None:
        diagonal = level.diagonal.reshape(-1, level.dim, level.dim).diagonal(axis1=1, axis2=2).reshape(-1)
        self.matrix = regular_matrix(level, np.full(level.n_dofs, np.abs(diagonal).max()))
        self._smoother = checks.offers("coarse_smoother: what setup returns", own.setup(self.matrix), "smooth",
                                       "an object with smooth(rhs, x) -> passes")

    def smooth(self, load: np.ndarray, unknowns: np.ndarray) -> float:
        """Improve ``unknowns`` in place; returns the passes it took."""
        passes = self._smoother.smooth(load.copy(), unknowns)
        return checks.nonnegative("coarse_smoother: the passes that smooth returns", passes)
