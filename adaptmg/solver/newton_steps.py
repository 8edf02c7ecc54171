"""Solves of the linear equations of Newton steps, condensed to the contact nodes or on the sparse matrix.

Their right-hand side is the residual of the full matrix, so that every step is one of iterative refinement, too.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Protocol

import numpy as np
from scipy import linalg, sparse

from adaptmg.discrete.coordinates import rotate
from adaptmg.smoother.factorisation import Condensed
from adaptmg.smoother.interior_point import ContactDofs, Interior, Span
from adaptmg.smoother.linear import Direct, LinearSolution, LinearSolver, Prepared, solution_of
from adaptmg.smoother.newton_rows import Linearised
from adaptmg.smoother.system import LocalProblem
from adaptmg.solver.record import Run
from adaptmg.transfer.galerkin import without_fixed

_LOG = logging.getLogger(__name__)


class LinearSteps(Protocol):
    """Takes the linear steps of one problem."""

    @property
    def stiffness(self) -> np.ndarray:
        """Diagonal (n_contact, dim) of the matrix that the contact nodes see, N/m."""

    def contact_residual(self, residual: np.ndarray) -> np.ndarray:
        """The residual (n_contact, dim) at contact nodes that decides their status, from that at all dofs."""

    def solve(self, equations: Linearised) -> np.ndarray:
        """The change (n_dofs,) for the last residual. LinAlgError if the equations are singular or an iterative linear
        solver does not converge."""

    def inside(self) -> tuple[Span, np.ndarray]:
        """The unknowns of the interior point method, and their load."""

    def outside(self, found: Interior) -> np.ndarray:
        """The unknowns (n_dofs,) for what the interior point method found."""


class CondensedSteps:
    """Steps on the dense Schur complement; one sparse factorisation serves them all."""

    SINGULAR = 1e-13  # reciprocal condition number below which the equations count as singular

    def __init__(self, condensed: Condensed, run: Run) -> None:
        self.local, self.run, self.condensed = condensed.full, run, condensed

    @property
    def stiffness(self) -> np.ndarray:
        return self.condensed.matrix.diagonal().reshape(-1, self.local.system.dim)

    def contact_residual(self, residual: np.ndarray) -> np.ndarray:
        """The residual with the interior in equilibrium."""
        with self.run.phase("solve"):
            self._particular, force = self.condensed.reduce(residual)
        return force.reshape(-1, self.local.system.dim)

    def inside(self) -> tuple[Span, np.ndarray]:
        free = ~self.local.system.fixed[self.condensed.contact]
        with self.run.phase("solve"):
            return (ContactDofs(self.condensed.matrix, free.reshape(-1, self.local.system.dim)),
                    self.condensed.reduced[1][free])

    def outside(self, found: Interior) -> np.ndarray:
        with self.run.phase("solve"):
            return self.condensed.recover(found.values.reshape(-1))

    def solve(self, equations: Linearised) -> np.ndarray:
        with self.run.phase("solve"):
            n, dim = equations.force.shape
            matrix = self.condensed.matrix.copy().reshape(n, dim, n, dim)
            node = np.arange(n)
            pull = equations.coupling[:, None] * equations.direction
            for k in range(1, dim):
                matrix[:, k] -= pull[:, k - 1, None, None] * matrix[:, 0]
                for j in range(1, dim):
                    matrix[node, k, node, j] += equations.curvature[:, k - 1, j - 1]
            matrix = matrix.reshape(n * dim, n * dim)
            change = equations.change.reshape(-1).copy()
            free = np.flatnonzero(~equations.prescribed.reshape(-1))
            rhs = equations.force.reshape(-1)[free] - matrix[free] @ change
            change[free] = self._dense(matrix[np.ix_(free, free)], rhs)
            return self.condensed.complete(self._particular, change)

    def _dense(self, matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
        if not len(rhs):
            return rhs
        norm = np.abs(matrix).sum(axis=0).max()
        factors, pivots, info = linalg.lapack.dgetrf(matrix)
        rcond = linalg.lapack.dgecon(factors, norm)[0] if info == 0 else 0.0
        if not rcond > self.SINGULAR:
            raise np.linalg.LinAlgError(f"the condensed equations are singular: reciprocal condition {rcond:.1e}")
        return linalg.lapack.dgetrs(factors, pivots, rhs)[0]


class SparseSteps:
    """Steps on the sparse matrix, of which only rows (and eliminated columns) of contact nodes change."""

    #: relative residual to which an iterative linear solver solves each Newton step, and each interior point step
    RTOL, INSIDE = 1e-2, 1e-4

    def __init__(self, local: LocalProblem, linear: LinearSolver, run: Run) -> None:
        self.local, self.linear, self.run = local, linear, run
        self._matrix = local.system.matrix
        self._contact = local.system.contact_of[np.repeat(np.arange(local.system.n_nodes),
                                                          np.diff(self._matrix.indptr))]  # of each block's row, or -1
        self._prepared: Prepared | None = None
        self._prepared_for: bytes | None = None

    @property
    def stiffness(self) -> np.ndarray:
        system = self.local.system
        return self._matrix.diagonal().reshape(-1, system.dim)[system.nodes]

    def contact_residual(self, residual: np.ndarray) -> np.ndarray:
        self._residual = residual
        return residual.reshape(-1, self.local.system.dim)[self.local.system.nodes]

    def inside(self) -> tuple[Span, np.ndarray]:
        return _SparseUnknowns(self), self.local.load

    def outside(self, found: Interior) -> np.ndarray:
        return found.unknowns

    def solve(self, equations: Linearised) -> np.ndarray:
        system = self.local.system
        released = np.zeros((system.n_nodes, system.dim), dtype=bool)
        released[system.nodes] = equations.prescribed
        change = np.zeros((system.n_nodes, system.dim))
        change[system.nodes] = equations.change
        rhs = self._residual.reshape(-1, system.dim).copy()
        rhs[system.nodes] = equations.force
        released, rhs, change = released.reshape(-1), rhs.reshape(-1), change.reshape(-1)
        with self.run.phase("setup"):
            matrix = self._contact_rows(equations)
            if change.any():
                rhs -= matrix @ change
                self.run.count(1, system.nonzeros)
            rhs[released] = 0.0
        self._prepare(equations, matrix, released)
        with self.run.phase("solve"):
            solution = self._solution(self._prepared, rhs, self.RTOL)
        if not solution.converged and not isinstance(self.linear, Direct):
            raise np.linalg.LinAlgError("the Newton step is not solved")
        return solution.unknowns + change

    def solver_with(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        """What solves with blocks (n_contact, dim, dim) added at the contact nodes; None where that is singular."""
        system, matrix = self.local.system, self._matrix.copy()
        free = ~system.fixed.reshape(-1, system.dim)[system.nodes]
        added = np.zeros((system.n_nodes, system.dim, system.dim))
        added[system.nodes] = blocks * free[:, :, None] * free[:, None, :]
        row = np.repeat(np.arange(system.n_nodes), np.diff(matrix.indptr))
        own = row == matrix.indices
        symmetric = matrix.copy()
        matrix.data[own] += added[row[own]]
        symmetric.data[own] += 0.5 * (added + added.swapaxes(1, 2))[row[own]]
        direct = isinstance(self.linear, Direct)
        try:
            with self.run.phase("factorise" if direct else "setup"):
                prepared = self.linear.setup(matrix, local_near_nullspace(self.local), symmetric=False,
                                             preconditioner=symmetric)
        except np.linalg.LinAlgError:
            return None

        return lambda rhs: self._solution(prepared, rhs, self.INSIDE).unknowns

    def _solution(self, prepared: Prepared, rhs: np.ndarray, rtol: float) -> LinearSolution:
        solution = solution_of(self.linear, prepared, rhs, rtol)
        self.run.count(solution.passes, self.local.system.nonzeros)
        if not solution.converged and not isinstance(self.linear, Direct):
            _LOG.warning("%r stopped after %d iterations at a relative residual of %.1e, not %.0e: take "
                         "Direct()", self.linear, solution.iterations, solution.residual, rtol)
        return solution

    def _prepare(self, equations: Linearised, matrix: sparse.bsr_array, released: np.ndarray) -> None:
        key = equations.key
        if equations.same_matrix and key == self._prepared_for:
            return
        with self.run.phase("factorise" if isinstance(self.linear, Direct) else "setup"):
            eliminated, basis = without_fixed(matrix, released, copy=False), None
            if not equations.symmetric:
                basis = without_fixed(self._contact_rows(equations, coupled=False), released, copy=False)
            modes = local_near_nullspace(self.local, released)
            self._prepared = self.linear.setup(eliminated, modes, symmetric=equations.symmetric, preconditioner=basis,
                                               previous=self._prepared)
        self._prepared_for = key

    def _contact_rows(self, equations: Linearised, coupled: bool = True) -> sparse.bsr_array:
        """The matrix with Coulomb coupling (if ``coupled``) and curvature in the rows of contact nodes."""
        system, data = self.local.system, self._matrix.data.copy()
        rows = np.flatnonzero(self._contact >= 0)
        diagonal = rows[system.nodes[self._contact[rows]] == self._matrix.indices[rows]]
        node = self._contact[diagonal]
        if coupled and not equations.symmetric:
            pull = (equations.coupling[:, None] * equations.direction)[self._contact[rows]]
            data[rows, 1:] -= pull[:, :, None] * data[rows, :1]
        data[diagonal, 1:, 1:] += equations.curvature[node]
        return sparse.bsr_array((data, self._matrix.indices, self._matrix.indptr), shape=self._matrix.shape)


class _SparseUnknowns:
    """All dofs as the unknowns of the interior point method."""

    def __init__(self, steps: SparseSteps) -> None:
        self.steps, self.system = steps, steps.local.system

    def product(self, unknowns: np.ndarray) -> np.ndarray:
        self.steps.run.count(1, self.system.nonzeros)
        return self.system.matrix @ unknowns

    def values(self, unknowns: np.ndarray) -> np.ndarray:
        return unknowns.reshape(-1, self.system.dim)[self.system.nodes]

    def restricted(self, forces: np.ndarray) -> np.ndarray:
        result = np.zeros((self.system.n_nodes, self.system.dim))
        result[self.system.nodes] = forces
        result.reshape(-1)[self.system.fixed] = 0.0
        return result.reshape(-1)

    def factors(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        return self.steps.solver_with(blocks)


def local_near_nullspace(local: LocalProblem, released: np.ndarray | None = None) -> np.ndarray:
    """Rigid-body modes (n_dofs, k) in local components, zero at fixed dofs; without ``near_nullspace`` translations."""
    problem = local.discrete
    modes = problem.near_nullspace
    if modes is None:
        modes = np.tile(np.eye(problem.dim), (problem.n_nodes, 1))
    modes = np.column_stack([rotate(mode, local.frames, local.system.nodes) for mode in modes.T])
    modes[local.system.fixed if released is None else local.system.fixed | released] = 0.0
    return modes
